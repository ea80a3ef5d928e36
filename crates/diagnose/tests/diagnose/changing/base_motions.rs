//! A base that shakes, added to simulated recordings by hand.

use super::{PERIODS, Stage, found, kept, prepared, recorded, recorded_periods, stage};
use nalgebra::{DMatrix, Vector3};
use plumbline_diagnose::Trial;
use plumbline_diagnose::changing::{BaseMotion, Changing, add_once, changing, cleaned, without_base_motions};
use plumbline_diagnose::outcome::{Diagnosis, JointFacts, Verdict};
use plumbline_identify::signal::spectral::Spectral;
use plumbline_identify::{Experiment, Run};
use plumbline_model::rnea;
use plumbline_model::term::Motion;
use plumbline_testkit::scene::DT;
use std::f64::consts::TAU;

/// Torque of all joints while the base accelerates by `a`, the arm being slow.
fn of_base(stage: &Stage, q: &[f64], a: Vector3<f64>) -> Vec<f64> {
    let zero = vec![0.0; q.len()];
    let mut tau = vec![0.0; q.len()];
    rnea(&stage.chain, &stage.truth.link_parameters(), &-a, q, &zero, &zero, &mut tau);
    tau
}

#[test]
fn a_base_that_shakes_is_found_with_frequency_direction_and_amplitude() {
    let stage = stage();
    let direction = Vector3::new(0.6, 0.0, 0.8);
    for periods in [PERIODS, 2] {
        let runs = recorded_periods(1, periods, 4, |at, tau| {
            let a = direction * 0.05 * (TAU * 7.33 * at.t + 0.4).sin();
            of_base(stage, &at.q, a).iter().zip(tau).for_each(|(own, tau)| *tau += own);
        });
        let found = found(&runs);
        assert_eq!(found.base_motions.len(), 1, "{:?}", found.base_motions);
        let line = &found.base_motions[0];
        // Of half the deviation of a mean, in two periods; the frequency's error falls with the length to the power of 1.5.
        let fewer = (PERIODS / periods) as f64;
        assert!((line.frequency - 7.33).abs() < 0.002 * fewer.powf(1.5), "{line:?}");
        assert!((line.amplitude - 0.05).abs() < 3.5 * line.std && line.std < 0.005 * (2.0 * fewer).sqrt(), "{line:?}");
        assert!(line.direction.dot(&direction).abs() > 0.98 - 0.02 * fewer, "{line:?}");
        assert!(line.explained > 0.7 && line.ratio > 12.0, "{line:?}");
        assert!(found.drifts.is_empty() && found.leave_out.is_empty(), "{found:?}");
    }
    // A motor that hums in one joint is no base motion.
    let hum = recorded(1, 5, |at, tau| tau[2] += 0.3 * (TAU * 7.33 * at.t).sin());
    let found = super::found(&hum);
    assert!(found.base_motions.is_empty(), "{:?}", found.base_motions);
}

#[test]
fn what_a_base_that_shakes_near_a_harmonic_does_to_the_mean_is_found_and_taken_off() {
    let stage = stage();
    let direction = Vector3::new(0.6, 0.0, 0.8);
    let clean = |run: usize| &stage.periods[run].0.tau;
    // The motion repeats after 10 s. Two periods deviate by a third of the amplitude from their mean, which has the rest.
    let runs = recorded_periods(2, 2, 6, |at, tau| {
        let a = direction * 0.2 * (TAU * 3.91 * at.t + 0.4).sin();
        of_base(stage, &at.q, a).iter().zip(tau).for_each(|(own, tau)| *tau += own);
    });
    let mut experiments = prepared(&runs, &kept());
    for (run, experiment) in experiments.iter_mut().enumerate() {
        experiment.follow_own_motion(|motion| repeated(clean(run), motion.samples()));
    }
    let mut unseen = experiments.split_off(1);
    let found = changing(&stage.operating_point, &Trial::in_turn(&experiments), |motion| stage.plain(motion));
    assert_eq!(found.base_motions.len(), 1, "{:?}", found.base_motions);
    let line = &found.base_motions[0];
    assert!((line.amplitude - 0.2).abs() < 3.5 * line.std && line.std < 0.005, "{line:?}");
    let off = |run: usize, experiment: &Experiment| near(3.91, &(&experiment.tau - clean(run)));
    let before = [off(0, &experiments[0]), off(1, &unseen[0])];
    cleaned(&mut experiments, &found, &stage.operating_point);
    without_base_motions(&mut unseen, &found, &stage.operating_point, |motion| repeated(clean(1), motion.samples()));
    let after = [off(0, &experiments[0]), off(1, &unseen[0])];
    assert!(after[0] < 0.3 * before[0] && after[1] < 0.3 * before[1], "{after:?} {before:?}");
    // Its torque is that in the periods, not that in their deviations.
    let rms = |joint: usize| of_base_rms(stage, direction * 0.2, joint);
    assert!((line.rms[1] / rms(1) - 1.0).abs() < 0.15, "{} {}", line.rms[1], rms(1));
}

#[test]
fn a_base_that_shakes_at_a_harmonic_is_found_in_the_mean() {
    let stage = stage();
    // Both periods of 10 s have the same of it, and no deviation tells of it.
    let runs = recorded_periods(1, 2, 8, |at, tau| {
        let a = Vector3::new(0.6, 0.0, 0.8) * 0.2 * (TAU * 3.9 * at.t + 0.4).sin();
        of_base(stage, &at.q, a).iter().zip(tau).for_each(|(own, tau)| *tau += own);
    });
    let mut experiments = prepared(&runs, &kept());
    experiments[0].follow_own_motion(|motion| repeated(&stage.periods[0].0.tau, motion.samples()));
    let found = changing(&stage.operating_point, &Trial::in_turn(&experiments), |motion| stage.plain(motion));
    assert_eq!(found.base_motions.len(), 1, "{:?}", found.base_motions);
    let line = &found.base_motions[0];
    assert!((line.frequency - 3.9).abs() < 0.01 && (line.amplitude - 0.2).abs() < 0.02, "{line:?}");
}

#[test]
fn a_base_that_shakes_is_found_in_motions_that_do_not_repeat_and_taken_off_them() {
    let stage = stage();
    let clean = |run: usize| &stage.periods[run].0.tau;
    let shaking = |at: &super::At, tau: &mut [f64]| {
        let a = Vector3::new(0.6, 0.0, 0.8) * 0.2 * (TAU * 3.93 * at.t + 0.4).sin();
        of_base(stage, &at.q, a).iter().zip(tau).for_each(|(own, tau)| *tau += own);
    };
    let once = |run: Run| Run { period: None, ..run };
    let found_in = |seed: u64, added: &dyn Fn(&super::At, &mut [f64])| {
        let runs = recorded_periods(2, 1, seed, added);
        let mut experiments = prepared(&runs.into_iter().map(once).collect::<Vec<_>>(), &kept());
        let mut unseen = experiments.split_off(1);
        let plain = |run: usize| {
            move |motion: &Motion| clean(run).rows((clean(run).nrows() - motion.samples()) / 2, motion.samples()).into()
        };
        let off = |run: usize, experiment: &Experiment| near(3.93, &(&experiment.tau - plain(run)(&experiment.motion)));
        let mut found = Changing::default();
        add_once(&mut found, &Trial::in_turn(&experiments), &stage.operating_point, &[], plain(0));
        let before = [off(0, &experiments[0]), off(1, &unseen[0])];
        cleaned(&mut experiments, &found, &stage.operating_point);
        without_base_motions(&mut unseen, &found, &stage.operating_point, plain(1));
        let after = [off(0, &experiments[0]), off(1, &unseen[0])];
        (found, [after[0] / before[0], after[1] / before[1]])
    };
    let (found, left) = found_in(7, &shaking);
    assert_eq!(found.base_motions.len(), 1, "{:?}", found.base_motions);
    let line = &found.base_motions[0];
    assert!((line.frequency - 3.93).abs() < 0.01 && (line.amplitude - 0.2).abs() < 0.02, "{line:?}");
    assert!(left.iter().all(|left| *left < 0.3), "{left:?}");
    // What the model lacks along a motion has lines, too, but none that goes on.
    let ends = |at: &super::At, tau: &mut [f64]| {
        if at.t < 7.0 {
            shaking(at, tau);
        }
    };
    let (found, _) = found_in(7, &ends);
    assert!(found.base_motions.is_empty(), "{:?}", found.base_motions);
}

#[test]
fn what_a_diagnosis_lists_counts_for_its_verdict_however_small() {
    let told = |rms: f64, threshold: Option<f64>| {
        let line = BaseMotion {
            run: "run0".into(),
            frequency: 3.5,
            amplitude: 0.01,
            std: 0.001,
            direction: Vector3::x(),
            cosine: Vector3::x() * 0.01,
            sine: Vector3::zeros(),
            ratio: 50.0,
            explained: 1.0,
            rms: vec![rms],
        };
        let found = Changing { base_motions: vec![line], runs: vec!["run0".into()], ..Changing::default() };
        let joint = JointFacts { floor_of_mean: Some(0.14), ..JointFacts::default() };
        let mut diagnosis =
            Diagnosis { verdict: Verdict::NothingSignificant, joints: vec![joint], ..Diagnosis::default() };
        found.add_to(&mut diagnosis, 0.7, threshold);
        (diagnosis.verdict, diagnosis.effects.len())
    };
    assert_eq!([told(0.05, None), told(0.02, Some(0.01))], [(Verdict::Diagnosed, 1); 2]);
    assert_eq!(told(0.02, Some(0.03)), (Verdict::NothingSignificant, 0));
}

/// RMS of a joint's torque while the base shakes with this amplitude along the first trajectory.
fn of_base_rms(stage: &Stage, a: Vector3<f64>, joint: usize) -> f64 {
    let q = &stage.periods[0].0.q;
    let square = |k: usize| of_base(stage, q.row(k).iter().copied().collect::<Vec<_>>().as_slice(), a)[joint].powi(2);
    ((0..q.nrows()).map(square).sum::<f64>() / (2 * q.nrows()) as f64).sqrt()
}

/// Rows of one period, again and again.
fn repeated(tau: &DMatrix<f64>, rows: usize) -> DMatrix<f64> {
    DMatrix::from_fn(rows, tau.ncols(), |k, j| tau[(k % tau.nrows(), j)])
}

/// Magnitude within half a hertz of a frequency, of all joints together.
fn near(frequency: f64, x: &DMatrix<f64>) -> f64 {
    let spectral = Spectral::new(x.nrows(), DT);
    let bins: Vec<usize> =
        (0..spectral.bins()).filter(|bin| (spectral.frequency(*bin) - frequency).abs() < 0.5).collect();
    let square = |x: &[f64]| {
        let spectrum = spectral.transform(x);
        bins.iter().map(|bin| spectrum[*bin].norm_sqr()).sum::<f64>()
    };
    x.column_iter().map(|column| square(column.into_owned().as_slice())).sum::<f64>().sqrt()
}
