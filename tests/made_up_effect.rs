//! An effect that is added by the recipe in CONTRIBUTING.md (one file for the model, one for the simulated arm, one line of registry each)
//! is listed, found, reported, and exported, without a change elsewhere.
//!
//! `cargo test --features made-up-effect --test made_up_effect`; the files are `made_up.rs` in `crates/model/src/term` and
//! `crates/sim/src/effect`.

use plumbline::report::diagnosis::Verdict;
use plumbline_testkit::job::{Done, Place, plumbline};

/// Joint of the effect, from 1, and its true parameter \[Nms/rad2\].
const JOINT: usize = 5;
const SIZE: f64 = 0.6;

/// Two short motions to find the effect on, one to hold it against.
const JOB: [&str; 10] = [
    "excitation.trajectories=2",
    "excitation.period=5 s",
    "excitation.periods=6",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=1",
    "validation.mountings=[\"wall\"]",
    "validation.counter-experiment=false",
    "output.dataset=false",
    "live.watch=false",
];

#[test]
fn an_added_effect_is_listed_found_reported_and_exported() {
    let done = |arguments: &[&str]| Done::of(plumbline().args(arguments)).expect_code(0);
    let listed = done(&["effects", "made-up"]).out;
    assert!(listed.contains("tau_j = madeup_j q_j dq_j") && listed.contains("export to C"), "{listed}");
    assert!(done(&["effects"]).out.contains(&listed), "the same as in the whole list");

    let place = Place::new("made-up");
    let plain = concat!(env!("CARGO_MANIFEST_DIR"), "/config/arms/sim-panda.toml");
    let arm = place.path().join("arm.toml");
    let effect = format!("[[effect]]\nid = \"made-up\"\njoint = {JOINT}\nsize = {SIZE}\n");
    std::fs::write(&arm, format!("{}\n{effect}", std::fs::read_to_string(plain).unwrap())).unwrap();
    let own = format!("backend.arm={}", arm.display());
    let ran = place.run(&JOB.into_iter().chain([own.as_str()]).collect::<Vec<_>>()).expect_code(0);
    let report = place.report();
    let found = report.diagnosis.unwrap_or_else(|| panic!("no diagnosis: {}", ran.output()));
    assert!(matches!(found.verdict, Verdict::Diagnosed | Verdict::Ambiguous), "{found:#?}");
    let effect = found.effects.iter().find(|effect| effect.id == "made-up").unwrap_or_else(|| panic!("{found:#?}"));
    assert!(effect.joints == [JOINT] && effect.in_model, "{effect:#?}");
    let parameter = effect.parameters.0.iter().find(|own| own.name == format!("madeup{JOINT}")).unwrap();
    assert!((parameter.value - SIZE).abs() < 0.1 * SIZE && parameter.unit == "Nms/rad2", "{parameter:?}");
    assert!(found.minimum_detectable.contains_key("made-up"));
    let page = std::fs::read_to_string(place.out().join("report.html")).unwrap();
    for part in ["made up in joint 5", "Made up for a test", "tau_j = madeup_j q_j dq_j", "q5 / rad"] {
        assert!(page.contains(part), "{part} in report.html");
    }

    let (model, c) = (place.out().join("model.toml"), place.out().join("arm.c"));
    let exported = done(&["export", model.to_str().unwrap(), "--format", "c", "--out", c.to_str().unwrap()]);
    assert!(!exported.out.contains("left out"), "{}", exported.output());
    assert!(std::fs::read_to_string(&c).unwrap().contains("q[4]*dq[4]"), "its expression is in the C function");
    let urdf = place.out().join("arm.urdf");
    let exported = done(&["export", model.to_str().unwrap(), "--format", "urdf", "--out", urdf.to_str().unwrap()]);
    assert!(exported.out.contains("effect `made-up` is left out"), "{}", exported.output());
}
