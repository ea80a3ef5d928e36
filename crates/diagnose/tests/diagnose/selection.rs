//! The study of benches/diagnosis in short: what nobody declared about drawn arms is found, and nothing besides.

use plumbline_diagnose::Verdict;
use plumbline_model::Mounting;
use plumbline_model::term::effect::Site;
use plumbline_testkit::diagnosis::case::{Case, Injected, What};
use plumbline_testkit::diagnosis::trial::{Bench, Judged};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Diagnoses an arm that is drawn by seed and has these effects, from two trajectories.
fn diagnosed(seed: u64, effects: &[(&'static str, Site, &str)]) -> Judged {
    let bench = Bench::new();
    let (arm, _) = plumbline_testkit::diagnosis::case::arm(&mut ChaCha8Rng::seed_from_u64(seed), &bench.base);
    let injected = |&(family, site, text): &(&'static str, Site, &str)| Injected {
        family,
        site,
        text: format!("id = \"{family}\"\n{text}\n"),
        variables: Vec::new(),
    };
    let effects: Vec<Injected> = effects.iter().map(injected).collect();
    let truth = effects.iter().fold(arm, |text, one| text + "\n[[effect]]\n" + &one.text);
    let case = Case {
        what: What::Single,
        number: 0,
        truth,
        effects,
        background: None,
        mounting: Mounting::WALL,
        trajectories: 2,
        noise: 1000 * seed,
    };
    bench.judge(&case, 1)
}

/// One effect, found where it is, and nothing besides; the worst joint then errs near its noise: its held-out RMS over the floor.
#[track_caller]
fn found(seed: u64, family: &'static str, site: Site, text: &str) -> f64 {
    let judged = diagnosed(seed, &[(family, site, text)]);
    let said = format!("{:?}: {:?}, rivals {:?}", judged.verdict, judged.found, judged.others);
    assert!(judged.ratio > 1.0, "the base parameters hide it: {}", judged.ratio);
    assert_eq!((judged.right.as_slice(), judged.extra), ([true].as_slice(), 0), "{said}");
    assert!(matches!(judged.verdict, Verdict::Diagnosed | Verdict::Ambiguous), "{said}");
    let [before, after] = judged.held_out;
    // Parameters from two trajectories alone have errors of their own.
    assert!(after < 2.0 && after < 0.8 * before, "held-out RMS over the floor {before} before, {after} after");
    after
}

#[test]
fn a_torque_offset() {
    found(11, "torque-offset", Site::Joint(4), "joint = 5\noffset = 0.3");
}

/// Coulomb friction as an arc tangent of speed.
#[test]
#[ignore = "hil/long-tests/run.sh"]
fn friction_that_rises_over_a_range_of_speeds() {
    let text = "joint = 3\nform = \"arctan\"\nsize = 0.2\nvelocity = 0.02";
    found(13, "coulomb-slope", Site::Joint(2), text);
}

/// Contacts that slide one after the other, over two decades of displacement. One contact would leave 1.9 floors.
#[test]
fn friction_of_contacts_that_slide_one_after_the_other() {
    let element = |delta: f64| format!("{{ share = 0.2, delta = {delta} }}");
    let elements: Vec<String> = [0.0003, 0.001, 0.003, 0.01, 0.03].into_iter().map(element).collect();
    let text = format!("joint = 4\nelements = [{}]", elements.join(", "));
    let after = found(17, "presliding", Site::Joint(3), &text);
    assert!(after < 1.5, "held-out RMS over the floor {after}");
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_ripple() {
    found(14, "position-ripple", Site::Joint(5), "joint = 6\norder = 23.0\nsine = 0.1\ncosine = 0.1");
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_sensor_that_feels_another_joint() {
    let site = Site::Pair { row: 5, cause: 3 };
    found(15, "torque-crosstalk", site, "joint = 6\nother = 4\nshare = 0.03");
}

/// A link that falls from flank to flank swings there.
#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_gap_that_a_link_swings_in() {
    found(16, "backlash", Site::Joint(5), "joint = 6\ngap = 0.0025");
}
