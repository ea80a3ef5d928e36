//! Drifts: what wanders through a recording, alone or beside steps.

use super::*;
use plumbline_diagnose::outcome::{Acts, Diagnosis, Effect, JointFacts};

#[test]
fn an_offset_that_drifts_is_found_within_its_deviation() {
    let runs = recorded(2, 1, |at, tau| tau[3] += 0.2 * at.t / 60.0);
    let found = found(&runs);
    assert_eq!(found.drifts.len(), 1, "{:?}", found.drifts);
    let drift = &found.drifts[0];
    assert_eq!((drift.what, drift.course), (Drifting::Offset(3), Course::Linear), "{drift:?}");
    assert!(drift.shared == Shared::Parameters && drift.score > 0.0);
    let error = drift.values[0][0] - 0.2;
    assert!(error.abs() < 3.0 * drift.std[0][0] && drift.std[0][0] < 0.02, "{drift:?}");
    assert!(found.contacts.is_empty() && found.transients.is_empty() && found.base_motions.is_empty(), "{found:?}");
}

#[test]
fn friction_that_falls_as_the_arm_warms_is_found_with_its_time() {
    let stage = stage();
    let course = |t: f64| 1.0 - (-t / 80.0).exp();
    let one = recorded(2, 2, |at, tau| {
        tau[1] += course(at.t) * (-0.25 * (100.0 * at.dq[1]).tanh() - 0.2 * at.dq[1]);
    });
    let of_one = found(&one);
    assert_eq!(of_one.drifts.len(), 1, "{:?}", of_one.drifts);
    let drift = &of_one.drifts[0];
    assert_eq!(drift.what, Drifting::Friction(1), "{drift:?}");
    let Course::Saturating { time } = drift.course else { panic!("{drift:?}") };
    assert!((50.0..130.0).contains(&time), "{drift:?}");
    for (value, truth) in drift.values[0].iter().zip([-0.25, -0.2]) {
        // The time constant is not exact either.
        assert!((value - truth).abs() < 0.25 * truth.abs(), "{drift:?}");
    }
    let all = recorded(2, 3, |at, tau| {
        for (j, [fv, fc]) in stage.friction.iter().enumerate() {
            tau[j] -= 0.4 * course(at.t) * (fc * (100.0 * at.dq[j]).tanh() + fv * at.dq[j]);
        }
    });
    let of_all = found(&all);
    assert_eq!(of_all.drifts.len(), 1, "{:?}", of_all.drifts);
    let drift = &of_all.drifts[0];
    assert_eq!((drift.what, drift.shared), (Drifting::AllFriction, Shared::Parameters), "{drift:?}");
    assert!((drift.values[0][0] + 0.4).abs() < 0.1, "{drift:?}");
    // The first period is far from the others, and yet nothing happened in it.
    assert!(of_all.contacts.is_empty() && of_all.transients.is_empty() && of_all.leave_out.is_empty(), "{of_all:?}");
    assert!(of_one.contacts.is_empty() && of_one.transients.is_empty() && of_one.leave_out.is_empty(), "{of_one:?}");
}

/// An arm that warms up through two runs with a pause: one drift with one time constant, and without it nothing is left to explain.
#[test]
fn a_joint_that_warms_up_from_run_to_run_has_one_drift() {
    let stage = stage();
    // The second run begins 15 s after the end of the first.
    let starts = [0.0, 75.0];
    let (mut run, mut last) = (0, 0.0);
    let runs = recorded_periods(2, 6, 5, |at, tau| {
        run += usize::from(at.t < last);
        last = at.t;
        let course = 1.0 - (-(starts[run] + at.t) / 100.0).exp();
        tau[1] += course * (-0.25 * (100.0 * at.dq[1]).tanh() - 0.2 * at.dq[1]);
    });
    fn trials(experiments: &[Experiment], starts: [f64; 2]) -> Vec<Trial<'_>> {
        experiments.iter().zip(starts).map(|(experiment, start)| Trial { experiment, session: 1, start }).collect()
    }
    let mut experiments = prepared(&runs, &kept());
    let found = changing(&stage.operating_point, &trials(&experiments, starts), |motion| stage.plain(motion));
    let torques = until_the_end(&found, &stage.operating_point, &trials(&experiments, starts)).unwrap();
    assert_eq!(found.drifts.len(), 1, "{:?}", found.drifts);
    let drift = &found.drifts[0];
    assert_eq!((drift.what, drift.shared, drift.values.len()), (Drifting::Friction(1), Shared::Course, 1), "{drift:?}");
    let Course::Saturating { time } = drift.course else { panic!("{drift:?}") };
    assert!((70.0..140.0).contains(&time), "{drift:?}");
    for (value, truth) in drift.values[0].iter().zip([-0.25, -0.2]) {
        assert!((value - truth).abs() < 0.25 * truth.abs(), "{drift:?}");
    }

    cleaned(&mut experiments, &found, &stage.operating_point);
    experiments.iter_mut().zip(torques).for_each(|(experiment, torque)| experiment.take_off_drift(torque));
    let identify = trials(&experiments, starts);
    let reduction = Reduction::any_mounting(&stage.chain);
    let structure = Structure::of(stage.chain.clone(), reduction, &["friction"]).unwrap();
    let options = Options::default();
    let input =
        Input { structure: &structure, identify: &identify, veto: &[], judge: &[], options: &options, came: &[] };
    let outcome = diagnose(&input, &plumbline_diagnose::Settings::default(), &|_| {}).unwrap();
    assert!(outcome.diagnosis.effects.is_empty() && outcome.residuals.is_empty(), "{:#?}", outcome.diagnosis.effects);
    let unmodelled = outcome.diagnosis.joints[1].unmodelled;
    assert!(unmodelled.before.unwrap() > 4.0 * unmodelled.after.unwrap(), "{unmodelled:?}");
    // The friction at the end, colder in the model of the runs as they were recorded.
    let friction = |fitted: &Fitted| {
        let at = fitted.structure.columns().iter().position(|column| column.name == "fc2").unwrap();
        fitted.identification.beta[at] - stage.friction[1][1]
    };
    let end = -0.25 * (1.0 - f64::exp(-135.0 / 100.0));
    assert!((friction(&outcome.after) - end).abs() < 0.02, "{} for {end}", friction(&outcome.after));
    assert!(friction(&outcome.before) > end + 0.03, "{} for {end}", friction(&outcome.before));
}

/// Friction that its own heat thins, with a time constant that is short beside the motion: one drift, whose course follows the dissipated power.
#[test]
fn a_joint_that_its_own_friction_warms_has_one_drift_with_a_short_time_constant() {
    let stage = stage();
    let [fv, fc] = stage.friction[1];
    let drag = |dq: f64| fc * (100.0 * dq).tanh() + fv * dq;
    let power = |dq: f64| (drag(dq) * dq).abs();
    let all: Vec<f64> =
        stage.periods.iter().flat_map(|(_, dq)| dq.column(1).iter().copied().collect::<Vec<_>>()).collect();
    let mean = all.iter().map(|dq| power(*dq)).sum::<f64>() / all.len() as f64;
    let (mut warmth, mut last) = (0.0, 0.0);
    let runs = recorded_periods(2, 6, 6, |at, tau| {
        // 15 s of rest between the runs.
        warmth *= if at.t < last { f64::exp(-15.0 / 35.0) } else { 1.0 };
        last = at.t;
        warmth += DT / 35.0 * (power(at.dq[1]) / mean - warmth);
        tau[1] += warmth * (-0.4 * (100.0 * at.dq[1]).tanh() - 0.3 * at.dq[1]);
    });
    let experiments = prepared(&runs, &kept());
    let trials: Vec<Trial> = experiments
        .iter()
        .zip([0.0, 75.0])
        .map(|(experiment, start)| Trial { experiment, session: 1, start })
        .collect();
    let found = changing(&stage.operating_point, &trials, |motion| stage.plain(motion));
    let [drift] = &found.drifts[..] else { panic!("{:?}", found.drifts) };
    assert_eq!((drift.what, drift.shared, drift.values.len()), (Drifting::Friction(1), Shared::Course, 1), "{drift:?}");
    let Course::Warming { joint: 1, time } = drift.course else { panic!("{drift:?}") };
    assert!((25.0..50.0).contains(&time), "{time} s");
    for (value, truth) in drift.values[0].iter().zip([-0.4, -0.3]) {
        assert!((value - truth).abs() < 0.25 * truth.abs(), "{value} for {truth}");
    }
}

/// An offset in the second half of one of two runs is no drift of the joint.
#[test]
fn what_one_run_alone_does_is_no_drift() {
    let mut run = 0;
    let mut last = 0.0;
    let runs = recorded_periods(2, 2, 7, |at, tau| {
        run += usize::from(at.t < last);
        last = at.t;
        tau[3] += if run == 1 && at.t > 11.0 { 0.3 } else { 0.0 };
    });
    let found = found(&runs);
    assert!(found.drifts.is_empty(), "{:?}", found.drifts);
    let [step] = &found.steps[..] else { panic!("{:?}", found.steps) };
    assert!(step.spec.family == "torque-offset" && (step.time - 11.0).abs() < 1.0, "{step:?}");
    // Beside a payload that the search of the means found there it is how that came.
    for (later, effects) in [(0.2, 1), (0.4, 2)] {
        let acts = Acts { run: step.run.clone(), from: step.time + later, to_end_of_recording: true };
        let payload = Effect { id: "payload".into(), acts: Some(acts), ..Effect::default() };
        let joint = JointFacts { floor_of_mean: Some(0.01), ..JointFacts::default() };
        let mut diagnosis =
            Diagnosis { effects: vec![payload], joints: vec![joint; step.rms.len()], ..Diagnosis::default() };
        found.add_to(&mut diagnosis, 0.7, None);
        assert_eq!(diagnosis.effects.len(), effects, "{later} s: {:?}", diagnosis.effects);
    }
}
