//! Bad input ends with exit code 2 and one error that names the place, the value and what was expected; nothing is left behind.

use plumbline_testkit::job::*;
use std::fmt::Write;
use std::path::PathBuf;
use std::process::Command;

/// Runs a command that must refuse: exit code 2, every part in its error, nothing on standard output, no file that was not there.
#[track_caller]
fn refused(place: &Place, command: Command, parts: &[&str]) {
    let before = place.files();
    let done = Running::start(command).end().expect_code(2);
    let errors: Vec<&str> = done.err.lines().filter(|line| line.starts_with("plumbline: ")).collect();
    assert_eq!(errors.len(), 1, "one error, said once: {}", done.output());
    for part in parts {
        assert!(errors[0].contains(part), "no `{part}` in {}", done.output());
    }
    assert!(errors[0].contains(": got ") && errors[0].contains(", expected "), "{}", done.output());
    assert!(done.out.is_empty(), "{}", done.output());
    assert_eq!(place.files(), before, "{}", done.output());
}

/// `plumbline run` of the shipped job with one override.
#[track_caller]
fn override_refused(name: &str, set: &str, parts: &[&str]) {
    let place = Place::new(name);
    refused(&place, place.job("run", &[set]), parts);
}

fn put(place: &Place, name: &str, text: &str) -> PathBuf {
    let path = place.path().join(name);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, text).unwrap();
    path
}

/// `plumbline SUBCOMMAND FILES.. --out ..` in a place.
fn on_files(place: &Place, subcommand: &str, files: &[PathBuf]) -> Command {
    let mut command = plumbline();
    command.arg(subcommand).args(files).arg("--out").arg(place.out());
    command
}

const DATASET: &str = "name = \"small\"\nrobot = \"panda\"\nmounting = { rho = 1.5707963267948966, phi = 0.0 }\n\n[[run]]\nfile = \"run.csv\"\nrole = \"identify\"\n";

/// A recorded motion of 40 samples with this text in the cell of joint 3's torque on line 12.
fn csv(cell: &str) -> String {
    let columns = |stem: &str| (1..=7).map(|j| format!(",{stem}{j}")).collect::<String>();
    let mut text = format!("t{}{}\n", columns("q"), columns("tau"));
    for k in 0..40 {
        write!(text, "{}", f64::from(k) * 1e-3).unwrap();
        for column in 0..14 {
            // Joints 4 and 6 of a Panda move on one side of zero.
            let centre = if column == 3 { -1.6 } else { f64::from(u8::from(column == 5)) * 1.6 };
            let value = centre + (f64::from(k) * 0.1 + f64::from(column)).sin();
            match (k, column) {
                (10, 9) => write!(text, ",{cell}").unwrap(),
                _ => write!(text, ",{value}").unwrap(),
            }
        }
        text.push('\n');
    }
    text
}

#[test]
fn an_unknown_key() {
    override_refused("key", "excitation.peroids=3", &["excitation.peroids=3", "excitation", "peroids", "periods"]);

    let place = Place::new("key-in-file");
    let shipped = std::fs::read_to_string(WALL).unwrap();
    let file = put(&place, "job.toml", &shipped.replace("harmonics = 5", "harmonic = 5"));
    let line = shipped.lines().position(|line| line.starts_with("harmonics")).unwrap() + 1;
    let named = file.display().to_string();
    refused(&place, on_files(&place, "run", &[file]), &[&named, &format!("line {line}"), "excitation", "`harmonic`"]);
}

#[test]
fn a_robot_that_does_not_exist() {
    override_refused("robot", "robot=pandora", &["robot", "pandora", "panda", "ur10e"]);

    let place = Place::new("plan-robot");
    let mut command = plumbline();
    command.args(["plan", "--robot", "pandora", "--out"]).arg(place.path().join("plan.toml"));
    refused(&place, command, &["pandora", "panda", "ur10e"]);
}

#[test]
fn a_gravity_direction_without_a_unit() {
    override_refused("unit", "mounting={rho = 1.57, phi = 0.0}", &["mounting", "rho", "1.57", "unit"]);
    override_refused("number", "mounting=1.57", &["mounting", "1.57", "unit"]);

    let place = Place::new("plan-unit");
    let mut command = plumbline();
    command.args(["plan", "--robot", "panda", "--mounting", "1.57,0", "--out"]).arg(place.path().join("plan.toml"));
    refused(&place, command, &["--mounting", "1.57,0", "60 deg,0 deg"]);
}

#[test]
fn an_infeasible_start_pose() {
    let start = |q2: &str| {
        format!("backend.start=[\"0 deg\", \"{q2}\", \"0 deg\", \"-135 deg\", \"0 deg\", \"90 deg\", \"45 deg\"]")
    };
    override_refused("range", &start("-140 deg"), &["backend.start", "joint 2", "-2.44"]);
    override_refused("count", "backend.start=[\"0 deg\"]", &["backend.start", "1 positions", "7"]);
    override_refused("no-unit", "backend.start=[0, 0, 0, -2, 0, 2, 0]", &["backend.start", "unit"]);
    // Inside every joint's range, but with the hand below the table.
    let low = "backend.start=[\"0 deg\", \"100 deg\", \"0 deg\", \"-20 deg\", \"0 deg\", \"90 deg\", \"0 deg\"]";
    override_refused("low", low, &["backend.start", "end effector"]);

    let q0 = "excitation.q0=[\"0 deg\", \"-140 deg\", \"0 deg\", \"-135 deg\", \"0 deg\", \"90 deg\", \"45 deg\"]";
    override_refused("q0", q0, &["excitation", "joint 2", "-2.44", "-1.71"]);
}

#[test]
fn a_cell_that_is_not_a_number() {
    let place = Place::new("nan");
    put(&place, "data/dataset.toml", DATASET);
    let run = put(&place, "data/run.csv", &csv("NaN")).display().to_string();
    refused(&place, on_files(&place, "identify", &[place.path().join("data")]), &[&run, "line 12", "tau3"]);
    // The same file with a number there is read: what is refused is the cell, not the file (which is too short to filter).
    let place = Place::new("number");
    put(&place, "data/dataset.toml", DATASET);
    put(&place, "data/run.csv", &csv("0.5"));
    let done = Done::of(on_files(&place, "identify", &[place.path().join("data")]));
    assert!(!done.err.contains("line 12") && done.err.contains("24 samples"), "{}", done.output());
}

#[test]
fn a_term_that_does_not_exist() {
    let place = Place::new("terms");
    put(&place, "data/dataset.toml", DATASET);
    put(&place, "data/run.csv", &csv("0.5"));
    let mut command = on_files(&place, "identify", &[place.path().join("data")]);
    command.args(["--terms", "friction,fricton"]);
    refused(&place, command, &["--terms", "`fricton`", "torque-offset"]);
}

#[test]
fn a_missing_file() {
    let place = Place::new("missing");
    let missing = |name: &str| place.path().join(name);
    refused(&place, on_files(&place, "run", &[missing("job.toml")]), &["job.toml", "readable"]);
    refused(&place, on_files(&place, "identify", &[missing("data")]), &["dataset.toml", "readable"]);
    let table3 = PathBuf::from("config/models/panda-paper-table3.toml");
    refused(
        &place,
        on_files(&place, "predict", &[missing("model.toml"), missing("run.csv")]),
        &["model.toml", "readable"],
    );
    refused(&place, on_files(&place, "predict", &[table3, missing("run.csv")]), &["run.csv"]);
    refused(&place, place.job("run", &["backend.arm=arms/no-arm.toml"]), &["no-arm.toml", "backend.arm"]);
    refused(&place, place.job("run", &["backend.arm=no-arm"]), &["backend.arm", "`no-arm`", "sim-panda"]);
    refused(&place, place.job("run", &["excitation.plan=no-plan.toml"]), &["no-plan.toml"]);
    refused(&place, place.job("daemon", &["excitation.plan=no-plan.toml"]), &["no-plan.toml"]);
    let mut daemon = place.job("daemon", &["excitation.plan=no-plan.toml"]);
    daemon.arg("--model").arg(missing("model.toml"));
    refused(&place, daemon, &["model.toml", "readable"]);
}

#[test]
fn a_broken_dataset() {
    for (name, text, parts) in [
        ("data-robot", DATASET.replace("panda", "pandora"), ["pandora", "panda"]),
        ("joints", DATASET.replace("panda", "ur10"), ["q1..q7", "q1..q6"]),
    ] {
        let place = Place::new(name);
        put(&place, "data/dataset.toml", &text);
        put(&place, "data/run.csv", &csv("0.5"));
        refused(&place, on_files(&place, "identify", &[place.path().join("data")]), &parts);
    }
}

#[test]
fn a_broken_model() {
    let table3 = std::fs::read_to_string("config/models/panda-paper-table3.toml").unwrap();
    let cut = table3.lines().take(40).fold(String::new(), |text, line| text + line + "\n");
    for (name, text, parts) in [
        ("model-cut", &cut[..cut.len() - 20], ["model.toml", "line"]),
        ("model-robot", &table3.replace("robot = \"panda\"", "robot = \"pandora\""), ["robot", "pandora"]),
    ] {
        let place = Place::new(name);
        let model = put(&place, "model.toml", text);
        let run = put(&place, "run.csv", &csv("0.5"));
        refused(&place, on_files(&place, "predict", &[model, run]), &parts);
    }

    // A daemon that is to serve it refuses, too, before it opens anything; its plans are its own and stay.
    let place = Place::new("daemon-model");
    let model = put(&place, "model.toml", &table3.replace("\"panda\"", "\"fr3\""));
    let mut daemon = place.job("daemon", &short(&[]));
    daemon.arg("--model").arg(&model);
    let done = Running::start(daemon).end().expect_code(2);
    assert!(
        done.err.contains("model.toml") && done.err.contains("`panda`, which this daemon drives"),
        "{}",
        done.output()
    );
}

#[test]
fn a_broken_plan() {
    let place = Place::new("plan");
    let mut command = plumbline();
    command.args(["plan", "--robot", "panda", "--mounting", "wall", "--starts", "1", "--rounds", "0", "--out"]);
    let plan = place.path().join("plan.toml");
    command.arg(&plan);
    Done::of(command).expect_code(0);
    let good = std::fs::read_to_string(&plan).unwrap();

    let q0 = good.lines().find(|line| line.starts_with("q0")).unwrap();
    for (text, parts) in [
        (good.replace("robot = \"panda\"", "robot = \"ur10\""), ["plan.toml", "ur10"]),
        (good.replace(q0, "q0 = [0.0, 9.0, 0.0, -2.0, 0.0, 2.0, 0.0]"), ["plan.toml", "joint 2"]),
    ] {
        assert_ne!(text, good);
        std::fs::write(&plan, text).unwrap();
        let set = format!("excitation.plan={}", plan.display());
        refused(&place, place.job("run", &[&set]), &parts);
    }
}
