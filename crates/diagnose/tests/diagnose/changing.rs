//! What differs from period to period, put into simulated recordings by hand: contacts, steps, single samples; `base_motions` has a base that moves,
//! `drifts` what wanders.

mod base_motions;
mod contacts;
mod drifts;

use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_diagnose::changing::{Changing, Course, Drifting, Shared, changing, cleaned, until_the_end};
use plumbline_diagnose::{Fitted, Input, Trial, diagnose};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_identify::signal::spectral::Spectral;
use plumbline_identify::solve::Options;
use plumbline_identify::{ExcludedSpan, Experiment, Run, Settings};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{OperatingPoint, Site};
use plumbline_model::term::friction::SHARPNESS;
use plumbline_model::{Chain, Reduction, Robot, Structure};
use plumbline_sim::Truth;
use plumbline_testkit::scene;
use plumbline_testkit::scene::DT;
use plumbline_testkit::scene::lab::{Noise, Period};
use plumbline_testkit::sim::{arm, arm_with};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::sync::OnceLock;

const PERIODS: usize = 10;

/// The arm, what is known of it, and one period of each trajectory with its velocities.
struct Stage {
    chain: Chain,
    truth: Truth,
    operating_point: OperatingPoint,
    friction: Vec<[f64; 2]>,
    periods: Vec<(Period, DMatrix<f64>)>,
}

impl Stage {
    /// Torques of the arm as it is known along a motion.
    fn plain(&self, motion: &Motion) -> DMatrix<f64> {
        let rigid = self.operating_point.load.along(motion);
        DMatrix::from_fn(motion.samples(), motion.joints(), |k, j| {
            let ([fv, fc], dq) = (self.friction[j], motion.dq[(k, j)]);
            rigid[(k, j)] + fv * dq + fc * (SHARPNESS * dq).tanh()
        })
    }
}

fn stage() -> &'static Stage {
    static STAGE: OnceLock<Stage> = OnceLock::new();
    STAGE.get_or_init(|| {
        let truth = arm("sim-panda");
        let chain = Robot::load("panda", None).unwrap().chain;
        let [plans, _] = scene::lab::plans();
        let of = |k: usize| {
            let plan = &plans[k];
            let period = scene::lab::period(&chain, &truth, plan, plan.mounting(), &format!("run{k}"));
            let mut spectral = Spectral::new(period.q.nrows(), DT);
            let mut velocity = |q: &[f64]| {
                let [_, dq, _] = spectral.derivatives(q, |f| if f < 80.0 { 1.0 } else { 0.0 });
                DVector::from_vec(dq)
            };
            let columns: Vec<_> = period.q.column_iter().map(|q| velocity(q.as_slice())).collect();
            (period, DMatrix::from_columns(&columns))
        };
        let periods = vec![of(0), of(1)];
        let reduction = Reduction::in_mounting(&chain, &plans[0].mounting());
        let structure = Structure::of(chain.clone(), reduction, &["friction"]).unwrap();
        let delta = DVector::from_iterator(10 * chain.len(), truth.link_parameters().into_iter().flatten());
        let base = structure.reduction().base_of(&delta);
        let beta: Vec<f64> = base.iter().copied().chain(vec![0.0; 2 * chain.len()]).collect();
        let friction: Vec<[f64; 2]> = truth.joints.iter().map(|joint| [joint.fv, joint.fc]).collect();
        let operating_point = OperatingPoint { friction: friction.clone(), ..structure.operating_point(&beta) };
        Stage { operating_point, chain, truth, friction, periods }
    })
}

/// One sample of a recording.
struct At {
    /// Since the first sample \[s\].
    t: f64,
    q: Vec<f64>,
    dq: Vec<f64>,
}

/// Recordings of the first `count` trajectories with something added to the torques.
fn recorded(count: usize, seed: u64, added: impl FnMut(&At, &mut [f64])) -> Vec<Run> {
    recorded_periods(count, PERIODS, seed, added)
}

/// The same of so many periods each.
fn recorded_periods(count: usize, periods: usize, seed: u64, mut added: impl FnMut(&At, &mut [f64])) -> Vec<Run> {
    let stage = stage();
    let mut runs = Vec::new();
    for (k, (period, dq)) in stage.periods.iter().take(count).enumerate() {
        let mut run = period.record(&stage.truth, periods, Noise { coloured: 0.05 }, 17 * seed + k as u64);
        let samples = period.q.nrows();
        let mut tau = vec![0.0; run.tau.ncols()];
        for row in 0..run.tau.nrows() {
            let at = At {
                t: row as f64 * DT,
                q: period.q.row(row % samples).iter().copied().collect(),
                dq: dq.row(row % samples).iter().copied().collect(),
            };
            tau.fill(0.0);
            added(&at, &mut tau);
            tau.iter().enumerate().for_each(|(j, tau)| run.tau[(row, j)] += tau);
        }
        runs.push(run);
    }
    runs
}

fn prepared(runs: &[Run], settings: &Settings) -> Vec<Experiment> {
    runs.iter().map(|run| Experiment::prepare(run, settings).unwrap()).collect()
}

fn kept() -> Settings {
    Settings { keep_periods: true, ..Settings::default() }
}

fn found(runs: &[Run]) -> Changing {
    let stage = stage();
    let experiments = prepared(runs, &kept());
    let trials = Trial::in_turn(&experiments);
    changing(&stage.operating_point, &trials, |motion| stage.plain(motion))
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn noise_alone_raises_no_alarm() {
    for seed in 100..116 {
        let found = found(&recorded(1, seed, |_, _| {}));
        assert!(found.is_empty(), "seed {seed}: {found:?}");
    }
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn noise_of_few_periods_raises_no_alarm_either() {
    let mut alarms = Vec::new();
    for seed in 200..205 {
        for (runs, periods) in [(1, 2), (1, 4), (2, 3)] {
            let found = found(&recorded_periods(runs, periods, seed, |_, _| {}));
            if !found.is_empty() {
                alarms.push(format!("seed {seed}, {runs} runs of {periods}: {found:?}"));
            }
        }
    }
    assert!(alarms.is_empty(), "{}: {}", alarms.len(), alarms.join("\n\n"));
}

#[test]
fn a_stretch_of_a_free_run_that_is_left_out_does_not_count() {
    let run = Run { period: None, ..recorded(1, 10, |_, _| {}).remove(0) };
    let leave_out = vec![ExcludedSpan { run: run.name.clone(), from: 20.0, to: 25.0 }];
    let whole = Experiment::prepare(&run, &Settings::default()).unwrap();
    let less = Experiment::prepare(&run, &Settings { leave_out, ..Settings::default() }).unwrap();
    assert_eq!(less.resting().iter().filter(|left_out| **left_out).count(), 5000);
    let share = less.kept().len() as f64 / whole.kept().len() as f64;
    assert!((share - 0.95).abs() < 0.005, "{share}");
}

#[test]
fn single_samples_that_are_off_are_counted_and_not_used() {
    let mut runs = recorded(1, 11, |_, _| {});
    for (row, joint) in [(12_345, 0), (40_000, 2), (77_001, 2)] {
        runs[0].tau[(row, joint)] += 4.0;
    }
    // What every period does is no outlier.
    for period in 0..PERIODS {
        runs[0].tau[(period * 10_000 + 555, 5)] += 4.0;
    }
    runs[0].q[(23_456, 1)] += 1e-3;
    let found = found(&runs);
    let hygiene = &found.hygiene[0];
    assert_eq!(hygiene.torques, [1, 0, 2, 0, 0, 0, 0], "{hygiene:?}");
    assert_eq!(hygiene.positions, [0, 1, 0, 0, 0, 0, 0], "{hygiene:?}");
    // Torques are replaced; around a position nothing is used.
    assert_eq!(found.leave_out.len(), 1, "{:?}", found.leave_out);
    assert!(found.leave_out.iter().any(|one| one.from < 23.456 && one.to > 23.456 && one.to - one.from < 0.02));
    assert!(found.drifts.is_empty() && found.contacts.is_empty() && found.transients.is_empty());
}

#[test]
fn a_step_of_a_coarse_encoder_is_no_outlier() {
    // Steps of 10 mrad: every 31st sample of an otherwise exact recording is one step off.
    let mut runs = recorded(1, 12, |_, _| {});
    runs[0].q.apply(|q| *q = (*q * 1e2).round() / 1e2);
    (0..runs[0].q.nrows()).step_by(31).for_each(|row| runs[0].q[(row, 1)] += 1e-2);
    assert_eq!(found(&runs).hygiene[0].positions, [0; 7]);
}

/// Ten periods of the simulated arm with effects of its own, after one that nobody records.
fn driven(effects: &str, seed: u64) -> Run {
    let [plans, _] = scene::lab::plans();
    driven_along(&plans[0].fourier().unwrap(), PERIODS, effects, seed)
}

/// So many periods of a motion.
fn driven_along(motion: &Fourier, periods: usize, effects: &str, seed: u64) -> Run {
    let stage = stage();
    let truth = arm_with("sim-panda", effects);
    let [plans, _] = scene::lab::plans();
    let mounting = plans[0].mounting();
    let mut arm = scene::still(&stage.chain, &truth, mounting, &motion.q0, seed);
    let reference = PeriodicMotion::new(motion, periods as u32 + 1).unwrap();
    let samples = (motion.period / DT).round() as usize;
    let (rows, n) = (periods * samples, stage.chain.len());
    let [mut q, mut dq, mut tau] = [0; 3].map(|_| DMatrix::zeros(rows, n));
    scene::drive(&mut arm, &reference, rows + samples, |tick, state, _| {
        let Some(k) = tick.checked_sub(samples) else { return };
        for j in 0..n {
            (q[(k, j)], dq[(k, j)], tau[(k, j)]) = (state.q[j], state.dq[j], state.tau[j]);
        }
    });
    let t = (0..rows).map(|k| k as f64 * DT).collect();
    Run { name: "driven".into(), t, q, dq: Some(dq), tau, mounting, period: Some(motion.period) }
}

#[test]
fn three_changes_of_the_simulated_arm_at_once_are_told_apart() {
    // The arm's clock runs ten seconds ahead of the recording's.
    let run = driven(
        r#"
[[effect]]
id = "offset-drift"
joint = 3
drift = 0.3
time = 60.0
trend = "linear"

[[effect]]
id = "base-motion"
frequency = 6.37
amplitude = 0.06
direction = [1.0, 1.0, 0.0]

[[effect]]
id = "contact"
link = 7
point = [0.0, 0.05, 0.1]
force = [6.0, -3.0, 8.0]
from = 62.3
to = 63.3
"#,
        5,
    );
    let found = found(&[run]);
    assert_eq!(found.drifts.len(), 1, "{:?}", found.drifts);
    let offset = &found.drifts[0];
    assert_eq!(offset.what, Drifting::Offset(2), "{offset:?}");
    assert!((offset.values[0][0] - 0.3).abs() < 3.0 * offset.std[0][0], "{offset:?}");
    let line = &found.base_motions[0];
    assert!(found.base_motions.len() == 1 && (line.frequency - 6.37).abs() < 0.005, "{:?}", found.base_motions);
    assert!((line.amplitude / 0.06 - 1.0).abs() < 0.1, "{line:?}");
    assert!(line.direction.dot(&Vector3::new(1.0, 1.0, 0.0).normalize()).abs() > 0.97, "{line:?}");
    let contact = &found.contacts[0];
    assert!(found.contacts.len() == 1 && found.transients.is_empty(), "{:?} {:?}", found.contacts, found.transients);
    assert!((contact.from - 52.3).abs() < 0.2 && (contact.to - 53.3).abs() < 0.2, "{contact:?}");
    assert!((contact.force - Vector3::new(6.0, -3.0, 8.0)).norm() < 2.0 && contact.link == 6, "{contact:?}");
}

/// The first period is left out where the offset comes in the second, and no other tells of that time.
#[test]
fn what_comes_while_one_period_alone_tells_of_it_may_have_come_earlier() {
    let stage = stage();
    let (mut run, mut before) = (0, 0.0);
    let runs = recorded_periods(2, 2, 33, |at, tau| {
        run += usize::from(at.t < before);
        before = at.t;
        tau[2] += if run == 1 && at.t > 10.4 { 0.6 } else { 0.0 };
    });
    let out = ExcludedSpan { run: runs[1].name.clone(), from: 0.0, to: 1.5 };
    let experiments = prepared(&runs, &Settings { leave_out: vec![out], ..kept() });
    let trials = Trial::in_turn(&experiments);
    let found = changing(&stage.operating_point, &trials, |motion| stage.plain(motion));
    let [step] = &found.steps[..] else { panic!("{} steps, {} drifts", found.steps.len(), found.drifts.len()) };
    assert!((9.7..=10.4).contains(&step.earliest) && (10.4..13.0).contains(&step.time), "{step:?}");
    let begin = trials[1].start + 10.4;
    let nearest = found.came(&trials).into_iter().map(|(_, span)| (span.from - begin).abs()).fold(f64::MAX, f64::min);
    assert!(nearest < 0.15, "{nearest} s");
}

/// Between 13 and 16 s the second period alone tells of what comes. Single samples of slow noise would have it begin before that in the second of these.
#[test]
fn what_comes_begins_where_the_likelihood_of_its_spectrum_is_largest() {
    let stage = stage();
    for seed in [41, 57, 61] {
        let runs = recorded_periods(1, 2, seed, |at, tau| tau[2] += if at.t > 14.3 { 0.25 } else { 0.0 });
        let out = ExcludedSpan { run: runs[0].name.clone(), from: 3.0, to: 6.0 };
        let experiments = prepared(&runs, &Settings { leave_out: vec![out], ..kept() });
        let found = changing(&stage.operating_point, &Trial::in_turn(&experiments), |motion| stage.plain(motion));
        let [step] = &found.steps[..] else { panic!("{seed}: {} steps", found.steps.len()) };
        assert!(
            (step.earliest - 13.0).abs() < 0.02 && (step.time - 16.0).abs() < 0.02,
            "{seed}: {} to {}",
            step.earliest,
            step.time
        );
    }
}

#[test]
fn what_comes_at_once_is_found_with_its_time_in_two_periods() {
    // An offset in the first run; more friction in the second, to its end.
    let friction = |dq: f64| 0.2 * (100.0 * dq).tanh() + 0.3 * dq;
    let mut run = 0;
    let mut before = 0.0;
    let runs = recorded_periods(2, 2, 31, |at, tau| {
        run += usize::from(at.t < before);
        before = at.t;
        match run {
            0 if at.t >= 13.27 => tau[3] += 0.4,
            1 if at.t >= 6.41 => tau[1] += friction(at.dq[1]),
            _ => {}
        }
    });
    let found = found(&runs);
    let mut steps: Vec<_> =
        found.steps.iter().map(|step| (step.run.as_str(), step.spec.family, step.spec.site, step.time)).collect();
    steps.sort_by(|a, b| a.0.cmp(b.0));
    let [offset, change] = steps[..] else { panic!("{steps:?}") };
    assert_eq!((offset.0, offset.1, offset.2), ("run0", "torque-offset", Site::Joint(3)));
    assert_eq!((change.0, change.1, change.2), ("run1", "friction-change", Site::Joint(1)));
    assert!((offset.3 - 13.27).abs() < 0.1 && (change.3 - 6.41).abs() < 0.3, "{steps:?}");
    assert!(found.drifts.is_empty() && found.contacts.is_empty() && found.transients.is_empty(), "{found:?}");
}

#[test]
fn slow_noise_is_no_step_and_no_drift() {
    // Six times the usual: of 0.2 Nm with a time constant of half a second.
    for (seed, periods) in [(1, 2), (2, 2), (3, 3), (4, 5)] {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut slow = [0.0; 7];
        let decay = (-DT / 0.53_f64).exp();
        let runs = recorded_periods(2, periods, 40 + seed, |_, tau| {
            for (tau, slow) in tau.iter_mut().zip(&mut slow) {
                let white: f64 = rng.sample(StandardNormal);
                *slow = decay * *slow + (1.0 - decay * decay).sqrt() * 0.2 * white;
                *tau += *slow;
            }
        });
        let found = found(&runs);
        assert!(found.steps.is_empty() && found.drifts.is_empty(), "{seed}: {:?} {:?}", found.steps, found.drifts);
    }
}

#[test]
fn the_noise_of_velocities_is_no_body_that_comes_while_the_deviations_fade_in() {
    // Stretched out, where accelerations weigh most.
    let [plans, _] = scene::lab::plans();
    let mut slow = plans[0].fourier().unwrap();
    (slow.period, slow.q0) = (40.0, vec![0.0, 1.1, 0.0, -0.5, 0.0, 1.6, 0.0]);
    (0..7).for_each(|joint| slow.scale_joint(joint, 0.3));
    let stage = stage();
    for seed in 0..4 {
        let mut experiments = prepared(&[driven_along(&slow, 3, "", seed)], &kept());
        experiments[0].follow_own_motion(|motion| stage.plain(motion));
        let trials = Trial::in_turn(&experiments);
        let found = changing(&stage.operating_point, &trials, |motion| stage.plain(motion));
        assert!(found.steps.is_empty(), "seed {seed}: {:?}", found.steps[0].spec);
    }
}
