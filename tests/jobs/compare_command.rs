//! `plumbline compare`, the real binary on datasets in their folder form.

use plumbline::dataset::{Dataset, Role, Run};
use plumbline::report::Report;
use plumbline::report::diagnosis::Confirmation;
use plumbline_model::{Mounting, Robot};
use plumbline_sim::Truth;
use plumbline_testkit::job::plumbline;
use plumbline_testkit::scene::lab::{Noise, period, plans};
use plumbline_testkit::sim::arm_with;
use std::path::Path;
use std::process::Output;

const ENCODER_STEP: f64 = std::f64::consts::TAU / 65536.0;
const PAYLOAD: &str = "[[effect]]\nid = \"payload\"\nmass = 0.73\ncom = [0.0, 0.0, 0.15]\n";

fn truth(more: &str) -> Truth {
    arm_with("sim-panda", more)
}

/// Writes a dataset of that arm: `identify` runs to fit, `validate` runs to judge by; free runs say nothing of a period.
fn write(dir: &Path, more: &str, mounting: Mounting, runs: [usize; 2], free: bool, seed: u64) {
    dataset(mounting, record(more, mounting, runs, free, seed)).write(dir).unwrap();
}

fn dataset(mounting: Mounting, runs: Vec<Run>) -> Dataset {
    Dataset { name: "test".into(), robot: "panda".into(), mounting, source: toml::Table::new(), runs }
}

fn record(more: &str, mounting: Mounting, runs: [usize; 2], free: bool, seed: u64) -> Vec<Run> {
    let (arm, chain) = (truth(more), Robot::load("panda", None).unwrap().chain);
    let mut recorded = Vec::new();
    for (role, (plans, count)) in [Role::Identify, Role::Validate].into_iter().zip(plans().into_iter().zip(runs)) {
        for (k, plan) in plans.iter().take(count).enumerate() {
            let name = format!("{role:?}-{k}.csv").to_lowercase();
            let noise = Noise { coloured: 0.05 };
            let periods = if free { 2 } else { 4 };
            let run = period(&chain, &arm, plan, mounting, &name).record(&arm, periods, noise, seed + k as u64);
            let period = run.period.filter(|_| !free);
            recorded.push(Run::new(plumbline_identify::Run { name, period, ..run }, role));
        }
    }
    recorded
}

fn program(arguments: &[&str]) -> Output {
    plumbline().args(arguments).output().unwrap()
}

/// Runs it, expects success, gives what it printed.
fn succeed(arguments: &[&str]) -> String {
    let output = program(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn compare(dir: &Path, data: &str, out: &str) -> (Report, String) {
    let path = |name: &str| dir.join(name).display().to_string();
    let printed = succeed(&["compare", "--verbose", &path("before/model.toml"), &path(data), "--out", &path(out)]);
    let text = std::fs::read_to_string(dir.join(out).join("report.json")).unwrap();
    assert!(dir.join(out).join("report.html").is_file());
    (serde_json::from_str(&text).unwrap(), printed)
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_payload_is_reported_and_part_of_the_written_model() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path();
    let path = |name: &str| dir.join(name).display().to_string();
    write(&dir.join("old"), "", Mounting::WALL, [2, 0], false, 7);
    succeed(&["identify", &path("old"), "--out", &path("before"), "--terms", "friction"]);

    write(&dir.join("new"), PAYLOAD, Mounting::WALL, [1, 1], false, 107);
    let (report, printed) = compare(dir, "new", "after");
    let diagnosis = report.diagnosis.unwrap();
    assert_eq!(diagnosis.verdict.to_string(), "diagnosed", "{printed}");
    let [effect] = &diagnosis.effects[..] else { panic!("{:?}", diagnosis.effects) };
    assert!(effect.id == "payload" && effect.in_model);
    let mass = effect.parameters.0.iter().find(|own| own.name == "mass").unwrap();
    assert!((mass.value - 0.73).abs() < 4.0 * mass.std.unwrap() && mass.std.unwrap() < 0.02, "{mass:?}");
    assert_eq!(diagnosis.changes[0].effects, diagnosis.effects);
    assert_eq!(diagnosis.held_out_runs, ["validate-0.csv"]);
    let worst = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
    let (before, after) = (worst(&diagnosis.before.validate_rms), worst(&diagnosis.after.validate_rms));
    assert!(before > 1.0 && after < 0.06, "{before} -> {after}");
    assert!(printed.contains("payload (mass 0.7") && printed.contains("error on unseen runs"), "{printed}");

    // The written model predicts what the arm does with its payload.
    let rms = |model: &str| {
        let printed = succeed(&["predict", &path(model), &path("new/validate-0.csv"), "--out", &path("tau.csv")]);
        let text = printed.split("filtered ").nth(1).unwrap().lines().next().unwrap().to_string();
        text.split(' ').map(|value| value.parse::<f64>().unwrap()).fold(0.0, f64::max)
    };
    assert!(rms("before/model.toml") > 1.0 && rms("after/model.toml") < 0.1);

    // One role alone, in runs that do not repeat: the last part of each judges.
    write(&dir.join("free"), PAYLOAD, Mounting::WALL, [2, 0], true, 207);
    let (report, printed) = compare(dir, "free", "free-out");
    let diagnosis = report.diagnosis.unwrap();
    assert_eq!(diagnosis.effects.iter().map(|one| one.id.as_str()).collect::<Vec<_>>(), ["payload"], "{printed}");
    assert_eq!(diagnosis.confirmation, Some(Confirmation::NoRepeats));
    assert!(diagnosis.notes.iter().any(|note| note.contains("last 40 %")), "{:?}", diagnosis.notes);

    // Nothing changed: the very same model comes out.
    write(&dir.join("same"), "", Mounting::WALL, [1, 1], false, 307);
    let (report, printed) = compare(dir, "same", "same-out");
    let diagnosis = report.diagnosis.unwrap();
    assert!(diagnosis.effects.is_empty() && diagnosis.verdict.to_string() == "nothing significant", "{printed}");
    let text = |name: &str| std::fs::read_to_string(dir.join(name).join("model.toml")).unwrap();
    assert_eq!(text("before"), text("same-out"));
    // The covariance is that of the identified parameters, not of the changed ones.
    let certain = |name: &str| !text(name).contains("[uncertainty]");
    assert_eq!(["before", "same-out", "after", "free-out"].map(certain), [false, false, true, true]);
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn diagnose_compares_later_sessions_with_the_first() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path();
    let path = |name: &str| dir.join(name).display().to_string();
    let later = record(PAYLOAD, Mounting::WALL, [1, 1], false, 107).into_iter();
    let later = later.map(|mut run| {
        run.data.name = format!("later-{}", run.data.name);
        Run { session: 2, ..run }
    });
    // Encoders of 16 bits: what their steps do to the model's torque repeats, and is in no scatter of the torques.
    let coarse = |mut run: Run| {
        run.data.q.apply(|q| *q = (*q / ENCODER_STEP).round() * ENCODER_STEP);
        run
    };
    let runs = record("", Mounting::WALL, [2, 1], false, 7).into_iter().chain(later).map(coarse).collect();
    dataset(Mounting::WALL, runs).write(&dir.join("data")).unwrap();
    let printed = succeed(&["diagnose", &path("data"), "--out", &path("out")]);
    let text = std::fs::read_to_string(dir.join("out/report.json")).unwrap();
    let report: Report = serde_json::from_str(&text).unwrap();
    let diagnosis = report.diagnosis.unwrap();
    let [effect] = &diagnosis.effects[..] else { panic!("{printed}") };
    assert_eq!((effect.id.as_str(), effect.since_session), ("payload", Some(2)), "{printed}");
    assert_eq!(diagnosis.verdict.to_string(), "diagnosed", "{printed}");
    let mass = effect.parameters.0.iter().find(|own| own.name == "mass").unwrap();
    assert!((mass.value - 0.73).abs() < 4.0 * mass.std.unwrap(), "{mass:?}");
    let [changes] = &diagnosis.changes[..] else { panic!("{:?}", diagnosis.changes) };
    assert_eq!((changes.since.as_str(), changes.session.as_str()), ("session 1", "session 2"));
    let worst = |errors: &Option<plumbline::report::diagnosis::Errors>| {
        errors.as_ref().unwrap().validate_rms.iter().copied().fold(0.0, f64::max)
    };
    assert!(worst(&changes.before) > 1.0 && worst(&changes.after) < 0.1, "{changes:?}");
    // The first session's model knows nothing of it, the other's does.
    let rms = |model: &str| {
        let run = path("data/later-validate-0.csv");
        let printed = succeed(&["predict", &path(model), &run, "--out", &path("tau.csv")]);
        let text = printed.split("filtered ").nth(1).unwrap().lines().next().unwrap().to_string();
        text.split(' ').map(|value| value.parse::<f64>().unwrap()).fold(0.0, f64::max)
    };
    assert!(rms("out/model.toml") > 1.0 && rms("out/model-session-2.toml") < 0.1);
    let has = |name: &str| std::fs::read_to_string(dir.join("out").join(name)).unwrap().contains("[uncertainty]");
    assert!(has("model.toml") && !has("model-session-2.toml"));
}

#[test]
fn an_upright_model_compared_on_the_wall_reports_no_change() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path();
    let path = |name: &str| dir.join(name).display().to_string();
    write(&dir.join("old"), "", Mounting::UPRIGHT, [1, 0], false, 7);
    succeed(&["identify", &path("old"), "--out", &path("before"), "--terms", "friction"]);
    write(&dir.join("new"), "", Mounting::WALL, [1, 1], false, 107);
    let (report, printed) = compare(dir, "new", "after");
    assert!(report.diagnosis.unwrap().effects.is_empty());
    assert_eq!(report.identifiability.not_identifiable, ["lx1", "ly1"]);
    assert_eq!(report.identifiability.untrusted_runs, ["identify-0.csv", "validate-0.csv"]);
    assert!(printed.contains("not identifiable") && printed.contains("lx1"), "{printed}");
}

#[test]
fn wrong_input_is_named() {
    let place = tempfile::tempdir().unwrap();
    let dir = place.path();
    let path = |name: &str| dir.join(name).display().to_string();
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = program(arguments);
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    let model = "config/models/panda-paper-table3.toml";
    refused(&["compare", model, &path("none"), "--out", &path("out")], &["dataset.toml"]);
    write(&dir.join("data"), "", Mounting::WALL, [1, 0], true, 7);
    let data = path("data");
    refused(&["compare", &path("none.toml"), &data, "--out", &path("out")], &["none.toml", "readable model"]);
    refused(&["compare", model, &data, "--out", &path("out"), "--threshold", "nan"], &["--threshold", "Nm"]);
    refused(&["compare", model, &data, "--out", &path("out"), "--trim", "9999"], &["--trim", "3600"]);
    let text = std::fs::read_to_string(model).unwrap().replace("robot = \"panda\"", "robot = \"ur10\"");
    std::fs::write(dir.join("other.toml"), text).unwrap();
    refused(&["compare", &path("other.toml"), &data, "--out", &path("out")], &["key `robot`", "ur10", "panda"]);
    assert!(!dir.join("out").exists());
}

#[test]
fn nothing_has_changed_between_a_model_and_its_own_dataset() {
    let Some(data) = plumbline_testkit::logs::data() else { return };
    for name in ["panda-gaz2019", "ur10-unisa", "panda-unisa"] {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path();
        let (own, before) = (data.join(name).display().to_string(), dir.join("before").display().to_string());
        succeed(&["identify", &own, "--out", &before]);
        let (report, printed) = compare(dir, &own, "after");
        let diagnosis = report.diagnosis.unwrap();
        assert!(diagnosis.effects.is_empty() && diagnosis.changes[0].effects.is_empty(), "{name}: {printed}");
        assert!(printed.contains("nothing changed"), "{name}: {printed}");
        // The very model that was compared.
        let model = |folder: &str| std::fs::read_to_string(dir.join(folder).join("model.toml")).unwrap();
        assert_eq!(model("before"), model("after"), "{name}");
    }
}
