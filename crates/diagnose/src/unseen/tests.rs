//! What a model lacks on unseen runs, row by row on the two-joint arm.

use super::*;
use crate::synthetic::{FLOOR, Recorded, recorded, truth};
use plumbline_identify::solve::identify;

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
            let found = unseen.variance(joint, &covariance);
            assert!(expected > 1e-6 && (found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        }
    });
}

#[test]
fn a_lack_is_the_power_above_that_of_the_noise() {
    of_truth(&recorded(4, 92, |_| [0.0, 6.0 * FLOOR]), |unseen, _, theta| {
        let lacks = unseen.lacks(theta);
        // The true model lacks nothing in joint 1, and an offset of six times the noise in joint 2.
        assert!((0.0..0.3).contains(&lacks[0].unwrap()) && (lacks[1].unwrap() / 36.0 - 1.0).abs() < 0.15, "{lacks:?}");
        // The same model as before explains nothing of it; of twice as much it would explain half.
        let lack = lacks[1].unwrap();
        assert_eq!(unseen.explained(&[None, Some(lack)], theta), [None, Some(0.0)]);
        assert_eq!(unseen.explained(&[None, Some(2.0 * lack)], theta), [None, Some(0.5)]);
        // No share is taken of a lack that does not count: three quarters of the noise.
        let counts = |lack: f64| unseen.explained(&[Some(lack), None], theta)[0].is_some();
        assert!(counts(0.5626) && !counts(0.5625) && !counts(0.5) && !counts(0.0));
    });
}
