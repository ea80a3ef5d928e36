//! The whole program on an arm that holds something which nobody declared: drawn by seed, written into the arm's own truth file, and
//! compared with what the report says at the very end.

use plumbline::report::Report;
use plumbline::report::diagnosis::{Diagnosis, Verdict};
use plumbline_testkit::job::Place;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Three short motions to find an effect on, two to hold it against and to measure it on.
const JOB: [&str; 11] = [
    "excitation.trajectories=3",
    "excitation.period=5 s",
    "excitation.periods=6",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=2",
    "validation.mountings=[\"wall\"]",
    "validation.counter-experiment=false",
    "validation.periods=4",
    "output.dataset=false",
    "live.watch=false",
];

/// Runs the job on the shipped arm with more in its truth file, and gives what the report says.
fn diagnosed(test: &str, effect: &str) -> (Diagnosis, Report) {
    let place = Place::new(test);
    let plain = concat!(env!("CARGO_MANIFEST_DIR"), "/config/arms/sim-panda.toml");
    let arm = place.path().join("arm.toml");
    std::fs::write(&arm, format!("{}\n{effect}\n", std::fs::read_to_string(plain).unwrap())).unwrap();
    let own = format!("backend.arm={}", arm.display());
    let mut sets = JOB.to_vec();
    sets.push(&own);
    let done = place.run(&sets).expect_code(0);
    let report = place.report();
    let diagnosis = report.diagnosis.clone().unwrap_or_else(|| panic!("no diagnosis: {}", done.output()));
    assert!(done.out.lines().any(|line| line.starts_with("diagnosis: ")), "{}", done.output());
    (diagnosis, report)
}

/// What an arm may hold: identity, joint, and its entry in the truth file.
fn draw(rng: &mut ChaCha8Rng) -> (&'static str, usize, String) {
    let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
    let kind = ["torque-offset", "presliding", "load-dependent-friction", "rotor-inertia", "position-ripple"];
    let id = *kind.choose(rng).unwrap();
    let (joints, rest): (&[usize], String) = match id {
        "torque-offset" => (&[1, 3, 4, 5, 6], format!("offset = {}", sign * rng.random_range(0.2..0.5))),
        "presliding" => (&[4, 5, 6, 7], format!("delta = {}", rng.random_range(0.002..0.006))),
        "load-dependent-friction" => (&[2, 4], format!("coulomb = {}", rng.random_range(0.02..0.05))),
        "rotor-inertia" => (&[4, 5, 6], format!("inertia = {}", rng.random_range(0.1..0.3))),
        _ => (
            &[3, 4, 5],
            format!("order = {}\nsine = {}", rng.random_range(6.0..12.0), sign * rng.random_range(0.15..0.3)),
        ),
    };
    let joint = *joints.choose(rng).unwrap();
    (id, joint, format!("[[effect]]\nid = \"{id}\"\njoint = {joint}\n{rest}"))
}

#[test]
fn an_undeclared_effect_is_found_named_and_added() {
    let mut rng = ChaCha8Rng::seed_from_u64(20_261_121);
    let (id, joint, entry) = draw(&mut rng);
    let (found, report) = diagnosed("undeclared", &entry);

    let truth = format!("{entry}\n\nfound {found:#?}");
    assert!(matches!(found.verdict, Verdict::Diagnosed | Verdict::Ambiguous | Verdict::Partly), "{truth}");
    let effect = found.effects.iter().find(|effect| effect.joints.first() == Some(&joint));
    let effect = effect.unwrap_or_else(|| panic!("nothing in joint {joint}: {truth}"));
    assert!(effect.id == id || effect.alternatives.iter().any(|other| other == id), "{truth}");
    assert!(effect.in_model && effect.confirmed, "{truth}");
    // Nothing is a number: in the other joints an offset well below the noise of one sample would have been found.
    let offsets = &found.minimum_detectable["torque-offset"].torque_rms;
    for (j, (offset, noise)) in offsets.iter().zip(&report.noise_floor).enumerate().filter(|(j, _)| j + 1 != joint) {
        assert!(*offset > 0.0 && *offset < 0.25 * noise, "joint {}: {offsets:?}: {truth}", j + 1);
    }
    // The model that is delivered has it, and predicts unseen runs better by what it was.
    assert!(report.base.count == 59 && report.base.parameters.len() == 59 + report.base.effects, "{truth}");
    assert!(report.base.effects > 0, "{truth}");
    let (before, after) = (found.before.validate_rms[joint - 1], found.after.validate_rms[joint - 1]);
    assert!(after < before && after < 1.15 * found.noise_floor[joint - 1], "{before} -> {after}: {truth}");
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn what_no_catalogue_holds_is_not_explained_away() {
    // A torque of joint 3 that comes and goes with where joint 2 is and how fast joint 5 turns.
    let foreign = "[[effect]]\nid = \"foreign\"\nform = \"bump\"\njoint = 3\nsize = 0.6\nfirst = 2\nmiddle = -0.6\nwidth = 0.3\nsecond = 5\n\
                   speed = 0.4\nspread = 0.4";
    let (found, _) = diagnosed("undeclared-foreign", foreign);
    assert!(matches!(found.verdict, Verdict::Unexplained | Verdict::Partly), "{found:#?}");
    let left = found.unexplained.iter().find(|one| one.joint == 3);
    let left = left.unwrap_or_else(|| panic!("joint 3 is not among the unexplained: {found:#?}"));
    assert!(!left.deciding_experiment.is_empty(), "{left:?}");
}
