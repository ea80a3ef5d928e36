//! A robot of the user's own: the model file holds its description, so that the model can be used wherever that file is.

use plumbline::dataset::{Dataset, Role};
use plumbline_testkit::job::*;
use plumbline_testkit::scene::Scene;
use std::path::{Path, PathBuf};

/// The shipped Panda under another name and with a longer upper arm.
fn description(name: &str, upper_arm: &str) -> String {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/robots/panda.toml");
    let text = std::fs::read_to_string(shipped).unwrap();
    let own = text
        .replace("name = \"panda\"", &format!("name = \"{name}\""))
        .replace("d = 0.316", &format!("d = {upper_arm}"));
    assert!(own.contains(&format!("name = \"{name}\"")) && own.contains(&format!("d = {upper_arm}")), "{own}");
    own
}

/// A model of the robot in `own.toml`, identified from a dataset beside it: the folder, its dataset and the model file.
fn identified(place: &Place) -> (PathBuf, PathBuf, PathBuf) {
    let scene = Scene::panda_on_the_wall();
    let run = |file: &str, role: Role| scene.dataset_run(file, role, (3, 11), 4, true);
    let folder = place.path().join("lab");
    let data = folder.join("data");
    let runs = vec![run("identify.csv", Role::Identify), run("validate.csv", Role::Validate)];
    let (name, robot) = ("own".into(), "../own.toml".into());
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("own.toml"), description("own-arm", "0.316")).unwrap();
    Dataset { name, robot, mounting: scene.mounting, source: toml::Table::new(), runs }.write(&data).unwrap();
    Done::of(plumbline().arg("identify").arg(&data).arg("--out").arg(place.out()).args(["--terms", "friction"]))
        .expect_code(0);
    let model = place.path().join("model.toml");
    std::fs::copy(place.out().join("model.toml"), &model).unwrap();
    (folder, data, model)
}

fn usable(place: &Place, model: &Path, run: &Path) {
    let out = place.path().join("written");
    let with = |arguments: &[&str]| {
        let mut command = plumbline();
        command.arg(arguments[0]).arg(model);
        arguments[1..].iter().for_each(|argument| {
            command.arg(argument);
        });
        command.arg("--out").arg(&out);
        Done::of(command).expect_code(0);
        std::fs::read_to_string(&out).unwrap()
    };
    with(&["predict", run.to_str().unwrap(), "--mounting", "wall"]);
    assert!(with(&["export", "--format", "c"]).contains("void own_arm_torque("));
    assert!(with(&["export", "--format", "urdf"]).contains("<robot name=\"own-arm\">"));
    assert!(with(&["export", "--format", "mjcf"]).contains("own-arm"));
}

fn compare(place: &Place, model: &Path, data: &Path) -> Done {
    Done::of(plumbline().arg("compare").arg(model).arg(data).arg("--out").arg(place.path().join("compared")))
}

#[test]
fn the_model_of_an_own_robot_is_independent_of_its_file() {
    let place = Place::new("own-robot");
    let (folder, data, model) = identified(&place);
    // Without the dataset beside it, a run has the mounting that the command line says.
    let run = place.path().join("run.csv");
    std::fs::copy(data.join("validate.csv"), &run).unwrap();
    let text = std::fs::read_to_string(&model).unwrap();
    assert!(text.contains("robot = \"own-arm\"") && text.contains("robot-description = "), "{text}");
    usable(&place, &model, &run);
    compare(&place, &model, &data).expect_code(0);

    // The same arm in another place, with other words and limits of its own.
    let own = folder.join("own.toml");
    let changed = description("own-arm", "0.316").replace("dq = 2.175", "dq = 2.0") + "\n# changed\n";
    std::fs::write(&own, changed).unwrap();
    usable(&place, &model, &run);
    compare(&place, &model, &data).expect_code(0);

    // Another arm of the same name, and one of another name.
    for (name, upper_arm, part) in [
        ("own-arm", "0.416", "another `own-arm`: its joints or its flange lie elsewhere"),
        ("other", "0.316", "got `own-arm`"),
    ] {
        std::fs::write(&own, description(name, upper_arm)).unwrap();
        usable(&place, &model, &run);
        let done = compare(&place, &model, &data).expect_code(2);
        assert!(done.err.contains(part) && done.err.contains("key `robot`"), "{}", done.output());
    }

    // Gone.
    std::fs::remove_file(&own).unwrap();
    usable(&place, &model, &run);
}

#[test]
fn a_robot_description_in_a_model_file_is_covered_by_its_hash() {
    let place = Place::new("own-robot-tampered");
    let (_, _, model) = identified(&place);
    let text = std::fs::read_to_string(&model).unwrap();
    let out = place.path().join("out.c");
    let refused = |text: &str, parts: &[&str]| {
        let edited = place.path().join("edited.toml");
        std::fs::write(&edited, text).unwrap();
        let done =
            Done::of(plumbline().arg("export").arg(&edited).args(["--format", "c", "--out"]).arg(&out)).expect_code(2);
        for part in parts {
            assert!(done.err.contains(part), "no `{part}` in {}", done.output());
        }
        assert!(!out.exists());
    };
    refused(&text.replace("d = 0.316", "d = 0.416"), &["edited.toml"]);
    refused(&text.replace("dq = 2.175", "dq = 2.0"), &["edited.toml", "key `content`", "edited or truncated"]);
    let unsealed: String =
        text.lines().filter(|line| !line.starts_with("content = ")).map(|line| format!("{line}\n")).collect();
    refused(
        &unsealed.replace("robot = \"own-arm\"", "robot = \"panda\""),
        &["robot-description", "robot `own-arm`", "robot `panda`"],
    );
    // As files were before they held descriptions.
    let (head, _) = unsealed.split_once("robot-description").unwrap();
    refused(head, &["key `robot`", "`own-arm`", "one of panda", "identified with this version"]);
    // A shipped robot's file holds none, and is read as ever.
    let table =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml"));
    assert!(!table.unwrap().contains("robot-description"));
}

#[test]
fn the_daemon_takes_its_model() {
    let place = Place::new("own-robot-daemon");
    let (folder, _, model) = identified(&place);
    let job = |upper_arm: &str| {
        std::fs::write(folder.join("own.toml"), description("own-arm", upper_arm)).unwrap();
        let shipped = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(WALL)).unwrap();
        let arm = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/arms/sim-panda.toml");
        let own = shipped
            .replace("robot = \"panda\"", "robot = \"own.toml\"")
            .replace("arms/sim-panda-lab.toml", arm.to_str().unwrap());
        let path = folder.join("job.toml");
        std::fs::write(&path, own).unwrap();
        let mut command = plumbline();
        command.arg("daemon").arg(&path).arg("--out").arg(place.out()).arg("--model").arg(&model);
        command.arg("--set").arg(format!("serve.id={}", place.id));
        short(&["excitation.trajectories=1"]).iter().for_each(|set| {
            command.arg("--set").arg(set);
        });
        command
    };
    let daemon = Running::start(job("0.316"));
    let status = wait_for("the daemon", || place.status());
    assert!(status.model != 0, "{status:?}");
    place.quit(daemon);
    let done = Done::of(job("0.416")).expect_code(2);
    assert!(
        done.err.contains("another `own-arm`") && done.err.contains("which this daemon drives"),
        "{}",
        done.output()
    );
}

#[test]
fn a_job_identifies_rotor_inertias_where_torques_are_those_of_the_motors() {
    let place = Place::new("own-robot-motor");
    let text = description("motor-arm", "0.316").replace("torque-sensing = \"link\"", "torque-sensing = \"motor\"");
    let own = place.path().join("own.toml");
    std::fs::write(&own, text).unwrap();
    let arm = plumbline_testkit::path("config/arms/sim-panda.toml");
    let [robot, arm] = [format!("robot={}", own.display()), format!("backend.arm={}", arm.display())];
    let sets = short(&[&robot, &arm, "excitation.trajectories=1"]);
    let mut command = plumbline();
    command.arg("run").arg(WALL).arg("--out").arg(place.out());
    command.arg("--set").arg(format!("serve.id={}", place.id));
    sets.iter().for_each(|set| {
        command.arg("--set").arg(set);
    });
    Done::of(command).expect_code(0);
    let model = std::fs::read_to_string(place.out().join("model.toml")).unwrap();
    // The inertias of the first links contain those of their rotors.
    for parameter in ["fc1", "ia3", "ia7"] {
        assert!(model.contains(&format!("name = \"{parameter}\"")), "no {parameter} in {model}");
    }
}
