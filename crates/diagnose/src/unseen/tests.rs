//! What a model lacks on unseen runs, row by row on the two-joint arm.

use super::*;
use crate::evidence::BAND_EDGES_HZ;
use crate::fit::Problem;
use crate::moments::GroupedMoments;
use crate::synthetic::{At, FLOOR, Recorded, once, recorded, truth};
use plumbline_identify::solve::identify;
use std::f64::consts::TAU;

/// The true model on runs, with their evidence and columns.
fn of_truth(recorded: &Recorded, look: impl FnOnce(&Unseen, &Columns, &DVector<f64>)) {
    let (structure, trials) = (&recorded.structure, recorded.trials());
    let evidence = Evidence::of(structure.chain(), &trials, 16.0);
    let identification = identify(structure, &recorded.experiments).unwrap();
    let fitted = Fitted { structure: structure.clone(), identification };
    let columns = columns_of(&evidence, structure, &trials);
    look(&Unseen::of_model(&evidence, &fitted, &trials), &columns, &truth(structure));
}

#[test]
fn errors_of_the_parameters_cause_the_mean_of_m_c_m_over_the_rows() {
    of_truth(&recorded(2, 91, |_| [0.0; 2]), |unseen, columns, theta| {
        let n = theta.len();
        // Correlated parameters of different sizes.
        let root = DMatrix::from_fn(n, n, |i, k| 0.01 * ((i * n + k) as f64).sin() * (1 + i) as f64);
        let covariance = &root * root.transpose();
        for joint in 0..2 {
            let sigma = unseen.evidence.sigma(joint);
            let rows = columns.m[joint].row_iter().zip(sigma);
            let sum: f64 = rows.map(|(m, sigma)| (m * &covariance * m.transpose())[0] * sigma * sigma).sum();
            let expected = sum / unseen.evidence.samples();
            let found = unseen.variance(joint, &covariance, BAND_EDGES_HZ.len());
            assert!(expected > 1e-6 && (found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        }
    });
}

#[test]
fn an_update_is_the_fit_to_all_runs_and_its_cost_what_their_residual_grows_by() {
    // Six trajectories, of which two are unseen, with more in joint 2 than the model has.
    let recorded = recorded(6, 94, |at| [0.0, 2.0 * FLOOR * (5.0 * at.q[0]).sin()]);
    let (structure, trials) = (&recorded.structure, recorded.trials());
    let phi: Vec<f64> = (0..2 * BAND_EDGES_HZ.len()).map(|k| 1.0 + 0.1 * k as f64).collect();
    let fitted = |chosen: &[Trial]| {
        let evidence = Evidence::with_noise_of(structure.chain(), chosen, &trials, 16.0);
        let problem = Problem { evidence: &evidence, prior: None };
        let moments = columns_of(&evidence, structure, chosen).moments(&evidence);
        let fit = problem.weighted(GroupedMoments::of(&moments, &evidence), &phi);
        let square: f64 = fit.rss.iter().zip(&phi).map(|(rss, phi)| rss / phi).sum();
        (fit.theta.clone(), problem.information(&moments, &phi), square)
    };
    let (theta, information, square) = fitted(&trials[..4]);
    let (of_all, _, square_of_all) = fitted(&trials);
    let evidence = Evidence::with_noise_of(structure.chain(), &trials[4..], &trials, 16.0);
    let unseen = Unseen { evidence: &evidence, columns: columns_of(&evidence, structure, &trials[4..]), repeats: true };
    let (updated, cost) = unseen.update(Known { theta: &theta, information: &information, phi: &phi });
    assert!((&updated - &of_all).norm() < 1e-6 * of_all.norm(), "{updated} {of_all}");
    assert!((&theta - &of_all).norm() > 1e-4 * of_all.norm());
    assert!((cost - (square_of_all - square)).abs() < 1e-6 * cost, "{cost} {square_of_all} {square}");
    // Columns that are not there cost as if they had never been: two of the joints' columns are left out on both sides.
    let fewer = unseen.without(0..1);
    let known = theta.clone().remove_row(0);
    let rest = information.clone().remove_row(0).remove_column(0);
    let (updated, _) = fewer.update(Known { theta: &known, information: &rest, phi: &phi });
    assert_eq!(updated.len() + 1, theta.len());
}

#[test]
fn what_every_period_repeats_is_in_any_number_of_periods() {
    let mut recorded = recorded(2, 96, |_| [0.0; 2]);
    let chain = recorded.structure.chain().clone();
    let scattered = Evidence::of(&chain, &recorded.trials(), 16.0).floor(0).unwrap();
    let periods = recorded.experiments[0].averaged_periods();
    for scatter in recorded.experiments.iter_mut().filter_map(|experiment| experiment.scatter.as_mut()) {
        // As much as the scatter leaves in the mean.
        scatter.repeated = &scatter.power / periods;
    }
    let evidence = Evidence::of(&chain, &recorded.trials(), 16.0);
    let same = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
    same(evidence.floor(0).unwrap(), 2.0_f64.sqrt() * scattered);
    for of in [1.0, periods, 100.0] {
        let floor = evidence.floor_of_periods_below(0, BAND_EDGES_HZ.len(), of).unwrap();
        same(floor, (1.0 + periods / of).sqrt() * scattered);
    }
}

#[test]
fn the_noise_of_a_run_that_does_not_repeat_is_that_of_the_known_runs() {
    let (repeating, once) = (recorded(4, 95, |_| [0.0; 2]), once(20.0, 95, |_| [0.0; 2]));
    let chain = repeating.structure.chain();
    let own = Evidence::of(chain, &once.trials(), 16.0);
    let known = Evidence::with_noise_of(chain, &once.trials(), &repeating.trials(), 16.0);
    assert!(!own.repeats() && own.floor(0).is_none() && known.repeats());
    // One period has twice the noise of the mean of four.
    let floor = known.floor(0).unwrap();
    assert!((floor / (2.0 * FLOOR) - 1.0).abs() < 0.1, "{floor}");
    // What it lacks is not judged: the arm of such a run may rest.
    of_truth(&once, |unseen, _, theta| {
        let left = left_by(unseen, theta);
        assert_eq!(unseen.explained(&left, &left), [None, None]);
        assert!(unseen.taken(&left, &left).iter().all(Option::is_none));
    });
}

/// What a model leaves whose parameters stay as they are.
fn left_by(unseen: &Unseen, theta: &DVector<f64>) -> Residuals {
    let left: Vec<_> = (0..2).map(|joint| unseen.residual(joint, theta)).collect();
    Residuals { known: left.clone(), updated: left }
}

#[test]
fn a_share_is_that_of_the_power_above_the_noise() {
    of_truth(&recorded(4, 92, |_| [0.0, 6.0 * FLOOR]), |unseen, _, theta| {
        let left = left_by(unseen, theta);
        let lacks = [0, 1].map(|joint| unseen.lack(joint, &left.updated[joint]).unwrap());
        // The true model lacks nothing in joint 1, and an offset of six times the noise in joint 2.
        assert!((0.0..0.3).contains(&lacks[0]) && (lacks[1] / 36.0 - 1.0).abs() < 0.15, "{lacks:?}");
        // The same model as before explains nothing of it; of twice as much it would explain half.
        assert_eq!(unseen.explained(&left, &left), [None, Some(0.0)]);
        let of = |lack: f64| {
            let scaled = ((1.0 + lack) / (1.0 + lacks[1])).sqrt() * &left.updated[1];
            let before = Residuals { known: left.known.clone(), updated: vec![left.updated[0].clone(), scaled] };
            unseen.explained(&before, &left)[1]
        };
        assert!((of(2.0 * lacks[1]).unwrap() - 0.5).abs() < 1e-9);
        // No share is taken of a lack that does not count: three quarters of the noise.
        assert!(of(0.5626).is_some() && of(0.5624).is_none() && of(0.0).is_none());
    });
}

#[test]
fn an_effect_takes_what_it_should_whatever_else_a_run_has() {
    // An offset in joint 2, in floors, of which this share is there, and a tone beside it. Of the offset this share is left by all runs.
    let of = |offset: f64, share: f64, tone: f64, updated: f64| {
        let torque =
            move |at: &At| [0.0, FLOOR * (offset * share + tone * std::f64::consts::SQRT_2 * (TAU * 7.0 * at.t).sin())];
        let mut found = None;
        of_truth(&recorded(4, 96, torque), |unseen, _, theta| {
            let (before, mut after) = (left_by(unseen, theta), left_by(unseen, theta));
            for cell in unseen.evidence.cells().iter().filter(|cell| cell.joint == 1 && cell.band == 0) {
                // The constant is the first of a fold's coefficients.
                let first = cell.rows.start;
                let constant = FLOOR * (unseen.evidence.samples() / 4.0).sqrt() / unseen.evidence.sigma(1)[first];
                after.known[1][first] -= offset * constant;
                after.updated[1][first] -= updated * offset * constant;
            }
            found = Some(unseen.taken(&before, &after));
        });
        let [None, taken] = found.unwrap()[..] else { panic!("joint 1 has nothing") };
        taken
    };
    for (share, tone) in [(1.0, 0.0), (1.0, 8.0), (0.9, 8.0)] {
        let taken = of(6.0, share, tone, 1.0).unwrap();
        assert!(taken.falls_short(0.5).is_none(), "{share} {tone} {taken:?}");
        // Its square, or what the other model lacks.
        assert!((taken.right / f64::min(36.0, (6.0 * share).powi(2) + tone * tone) - 1.0).abs() < 0.1, "{taken:?}");
    }
    // Where a share `s` is there, `2 s - 1` falls: nothing for a half, and the error rises where nothing is there.
    for (share, tone) in [(0.5, 8.0), (0.0, 8.0), (0.6, 8.0)] {
        let taken = of(6.0, share, tone, 1.0).unwrap();
        let short = taken.falls_short(0.5).unwrap();
        assert!((short - (2.0 * share - 1.0)).abs() < 0.1, "{share} {tone} {taken:?}");
    }
    // What these runs make of the parameter does not make it right: of 2 / 3, 5 / 6 are fitted, which take 5 / 6 (2 2 / 3 - 5 / 6) of its square.
    let short = of(6.0, 2.0 / 3.0, 8.0, 5.0 / 6.0).unwrap().falls_short(0.5).unwrap();
    assert!((short - 5.0 / 12.0).abs() < 0.05, "{short}");
    // 0.4 of what should be taken is less than a half; not beyond the noise where that is as large.
    let short = |offset: f64| of(offset, 0.7, 4.0, 1.0).unwrap().falls_short(0.5);
    assert!(short(6.0).is_some() && short(0.8).is_none());
    // So little is not judged.
    assert!(of(0.7, 1.0, 4.0, 1.0).is_none());
}

#[test]
fn a_gain_is_in_units_of_the_noise_also_where_that_is_unknown() {
    // Joint 2 lacks an offset of 0.02 Nm of its own, and joint 1 has a hundred times the residual.
    let tone = |at: &At| [2.0 * (6.0 * at.t + 1.3 * at.trajectory as f64).sin(), 0.02];
    for recorded in [recorded(4, 93, tone), once(20.0, 93, tone)] {
        of_truth(&recorded, |unseen, columns, theta| {
            let phi = vec![1.0; 2 * BAND_EDGES_HZ.len()];
            let joint_2 = unseen.residual(1, theta);
            // A parameter that moves both: joint 2's error falls to nearly nothing, joint 1's rises by a share that is less than one.
            let mut other = theta.clone();
            let which = (0..theta.len()).max_by(|&a, &b| {
                let fit =
                    |k: usize| columns.m[1].column(k).dot(&joint_2).powi(2) / columns.m[1].column(k).norm_squared();
                fit(a).total_cmp(&fit(b))
            });
            let column = columns.m[1].column(which.unwrap());
            other[which.unwrap()] += column.dot(&joint_2) / column.norm_squared();
            let squares = |joint: usize| [theta, &other].map(|theta| unseen.residual(joint, theta).norm_squared());
            let rows = unseen.evidence.per_joint() as f64;
            let fall = |joint: usize| {
                let [before, after] = squares(joint);
                let scale = if unseen.evidence.repeats() { 1.0 } else { before.min(after) / rows };
                (before - after) / scale
            };
            let found = unseen.gain(&phi, theta, &other);
            assert!((found - fall(0) - fall(1)).abs() < 1e-9 * (fall(0).abs() + fall(1).abs()), "{found}");
            assert_eq!(unseen.gain(&phi, theta, theta), 0.0);
        });
    }
}
