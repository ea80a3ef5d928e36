//! Learned terms: what no effect of the catalogue has is learned where it helps, and nothing else is.

use super::synthetic::{At, FLOOR, Recorded, once, recorded};
use plumbline_diagnose::Outcome;
use plumbline_diagnose::outcome::{Empirical, Verdict};
use plumbline_diagnose::{Input, Settings, diagnose};
use plumbline_identify::solve;
use plumbline_model::term::effect::Spec;

/// Highest torque of each joint \[Nm\].
const LIMITS: [f64; 2] = [50.0, 20.0];

/// Diagnoses `identify`; `veto` decides, errors are measured on `judge`.
fn outcome(identify: &Recorded, veto: Option<&Recorded>, judge: Option<&Recorded>, limits: [f64; 2]) -> Outcome {
    let [identified, veto, judge] =
        [Some(identify), veto, judge].map(|runs| runs.map(Recorded::trials).unwrap_or_default());
    let input = Input {
        structure: &identify.structure,
        identify: &identified,
        veto: &veto,
        judge: &judge,
        options: &solve::Options::default(),
        came: &[],
    };
    let settings = Settings { torque_limits: limits.to_vec(), ..Settings::default() };
    let outcome = diagnose(&input, &settings, &|_| {}).unwrap();
    let of = &outcome.diagnosis;
    println!("{:?} {:?} {:?} {:?}", of.verdict, of.effects, of.unexplained, of.empirical);
    outcome
}

/// The same torque in all runs: four trajectories to identify from, four that decide, two to measure on.
fn of(seed: u64, torque: impl Fn(&At) -> [f64; 2] + Copy) -> Outcome {
    of_three(seed, torque, torque, torque)
}

fn of_three(
    seed: u64,
    identify: impl Fn(&At) -> [f64; 2],
    veto: impl Fn(&At) -> [f64; 2],
    judge: impl Fn(&At) -> [f64; 2],
) -> Outcome {
    let (veto, judge) = (recorded(4, seed + 2000, veto), recorded(2, seed + 1000, judge));
    outcome(&recorded(4, seed, identify), Some(&veto), Some(&judge), LIMITS)
}

/// A torque of joint 2 near one position of joint 1.
fn bump(size: f64) -> impl Fn(&At) -> [f64; 2] + Copy {
    move |at| [0.0, size * (-((at.q[0] - 0.1) / 0.12).powi(2)).exp()]
}

fn terms(outcome: &Outcome) -> Vec<Spec> {
    let specs = outcome.after.structure.terms().iter().filter_map(|term| term.spec());
    specs.filter(|spec| spec.family == "empirical").collect()
}

fn only(outcome: &Outcome) -> &Empirical {
    let [one] = &outcome.diagnosis.empirical[..] else { panic!("{:?}", outcome.diagnosis.empirical) };
    one
}

#[test]
fn a_function_of_one_variable_is_learned_and_predicts_runs_that_decided_nothing() {
    let found = of(61, bump(0.4));
    let one = only(&found);
    assert_eq!((one.joint, one.in_model, one.withheld.as_deref()), (2, true, None));
    assert_eq!(one.variables, ["q1"]);
    // The base parameters keep what they have absorbed of it.
    assert!(one.share.unwrap() > 0.2, "{one:?}");
    let (before, after) = (one.rms.before.unwrap(), one.rms.after.unwrap());
    assert!(after < 0.65 * before, "{before} {after}");
    assert!(
        (found.diagnosis.after.validate_rms[1] - after).abs() < 1e-12,
        "the errors are those of the delivered model"
    );
    // It has no name: the joint is still unexplained.
    assert!(matches!(found.diagnosis.verdict, Verdict::Unexplained | Verdict::Partly));
    assert!(found.diagnosis.unexplained.iter().any(|one| one.joint == 2));
    assert!(found.diagnosis.effects.iter().all(|effect| effect.id != "empirical"));
    // Only its coefficients were estimated, with a covariance of their own.
    let [spec] = &terms(&found)[..] else { panic!("{:?}", terms(&found)) };
    assert_eq!(spec.form, "q");
    let identification = &found.after.identification;
    let named = identification.beta.len() - 10;
    if found.diagnosis.effects.iter().all(|effect| !effect.in_model) {
        assert_eq!(identification.beta[..named], found.before.identification.beta[..]);
    }
    assert!(identification.std[named..].iter().all(|std| std.is_some_and(|std| std > 0.0 && std < 0.4)));
    let cross = identification.covariance.view((named, 0), (10, named)).amax();
    assert_eq!(cross, 0.0);
    // The curve is the one that was put in, within its band nearly everywhere.
    let drawn = found.curves.effects.iter().find(|figure| figure.title.contains("empirical")).unwrap();
    assert_eq!((drawn.fitted.len(), drawn.fitted_deviation.len()), (121, 121));
    let top = drawn.fitted.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    assert!((top.0 - 0.1).abs() < 0.1 && top.1 > 0.15, "{top:?}");
}

#[test]
fn a_function_of_two_variables_is_learned_over_both() {
    let saddle = |at: &At| [0.0, 0.4 * (5.0 * at.q[0]).sin() * (5.0 * at.q[1]).sin()];
    let found = of(62, saddle);
    let one = only(&found);
    assert!(one.in_model && one.variables == ["q1", "q2"], "{one:?}");
    assert_eq!((terms(&found)[0].form, one.joint), ("q-q", 2));
    let (before, after) = (one.rms.before.unwrap(), one.rms.after.unwrap());
    assert!(after < 0.75 * before, "{before} {after}");
    assert!(found.curves.maps.iter().any(|figure| figure.title.contains("empirical")));
}

#[test]
fn what_does_harm_on_runs_that_decide_is_not_delivered() {
    for other in [0.0, -0.4] {
        let found = of_three(61, bump(0.4), bump(other), bump(0.4));
        let one = only(&found);
        assert!(!one.in_model && one.withheld.as_ref().is_some_and(|why| why.contains("unseen runs")), "{one:?}");
        assert_eq!(terms(&found), []);
    }
}

#[test]
fn nothing_is_learned_from_noise_or_in_the_place_of_a_named_effect() {
    for seed in [63, 64, 65] {
        let quiet = of(seed, |_| [0.0; 2]);
        assert!(quiet.diagnosis.empirical.is_empty() && terms(&quiet).is_empty());
        let named = of(seed, |_| [0.0, 6.0 * FLOOR]);
        assert!(named.diagnosis.effects.iter().any(|effect| effect.in_model));
        assert!(named.diagnosis.empirical.is_empty(), "{:?}", named.diagnosis.empirical);
    }
    // Without repeats no joint is known to be at its noise.
    let identify = once(24.0, 66, |at| [0.0, 0.4 + 0.0 * at.t]);
    let free = outcome(&identify, Some(&once(12.0, 67, |_| [0.0, 0.4])), None, LIMITS);
    assert!(free.diagnosis.effects.iter().any(|effect| effect.id == "torque-offset" && effect.in_model));
    assert_eq!(terms(&free), []);
}

#[test]
fn runs_that_judge_decide_nothing_about_a_learned_term() {
    let [same, other] = [0.4, -0.4].map(|judge| of_three(61, bump(0.4), bump(0.4), bump(judge)));
    assert_eq!(same.after.identification.beta, other.after.identification.beta);
    assert_eq!(same.after.identification.covariance, other.after.identification.covariance);
    let decided = |outcome: &Outcome| {
        let one = only(outcome).clone();
        (one.in_model, one.variables, one.share, one.cap, one.symbolic)
    };
    assert_eq!(decided(&same), decided(&other));
    // There it does harm, and that is said.
    let worse = |outcome: &Outcome| only(outcome).rms.after.unwrap() / only(outcome).rms.before.unwrap();
    assert!(worse(&same) < 0.65 && worse(&other) > 1.1, "{} {}", worse(&same), worse(&other));
}

#[test]
fn without_runs_that_decide_blocks_that_were_left_out_do() {
    let found = outcome(&once(40.0, 68, bump(0.8)), None, None, LIMITS);
    let one = found.diagnosis.empirical.iter().find(|one| one.joint == 2).unwrap();
    assert!(one.in_model && one.variables.contains(&"q1".to_string()), "{one:?}");
    assert_eq!(one.rms.before, None, "no run is unseen");
}

#[test]
fn a_share_of_the_joints_highest_torque_is_the_most() {
    let (identify, veto) = (recorded(4, 61, bump(0.4)), recorded(4, 2061, bump(0.4)));
    let caps = [20.0, 0.5].map(|limit| only(&outcome(&identify, Some(&veto), None, [50.0, limit])).cap.unwrap());
    assert!(caps[0] > 0.2 && caps[0] < 0.6, "about what it was fitted to: {caps:?}");
    assert!((caps[1] - 0.1).abs() < 1e-9, "a fifth of 0.5 Nm: {caps:?}");
}

#[test]
fn a_simple_law_is_proposed_where_it_takes_as_much() {
    let found = of(69, |at| [0.0, 0.3 * (12.0 * at.q[0] + 0.6).sin()]);
    let law = only(&found).symbolic.clone().unwrap_or_else(|| panic!("{:?}", only(&found)));
    assert_eq!(law.law, "a sin(12 q1 + phi)");
    for (quantity, truth) in law.parameters.0.iter().zip([0.3, 0.6]) {
        // The base parameters have taken a part of it over: to a tenth rather than to the deviation alone.
        let off = (quantity.value - truth).abs();
        assert!(off < 0.1 * truth + 3.0 * quantity.std.unwrap() && quantity.std.unwrap() < 0.1, "{quantity:?}");
    }
    // A narrow hill is none of the laws.
    assert_eq!(only(&of(61, bump(0.4))).symbolic, None);
}
