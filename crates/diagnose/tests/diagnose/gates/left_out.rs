//! What folds that are left out say of an effect, computed once more row by row: least squares by a singular value decomposition on the rows of
//! all other folds, and the sums of squares of the rows that were left out.

use super::synthetic::{At, FLOOR, Recorded, once, recorded};
use plumbline_diagnose::{Search, Settings, State, group};

use nalgebra::{DMatrix, DVector, RowDVector};
use plumbline_model::term::effect::Family;
use plumbline_model::term::torque_offset;
use std::f64::consts::TAU;

/// One row of the data.
struct Row {
    joint: usize,
    weight: f64,
    /// Below 4 Hz.
    low: bool,
    /// Noise of its torque.
    sigma: f64,
    columns: RowDVector<f64>,
    torque: f64,
}

/// Rows of the chosen folds.
fn rows(search: &Search, state: &State, phi: &[f64], chosen: impl Fn(usize) -> bool) -> Vec<Row> {
    let evidence = search.problem.evidence;
    let mut found = Vec::new();
    for cell in evidence.cells().iter().filter(|cell| chosen(cell.fold)) {
        let joint = cell.joint;
        let own = |row: usize| Row {
            joint,
            weight: 1.0 / phi[group(joint, cell.band)],
            low: cell.band < 4,
            sigma: evidence.sigma(joint)[row],
            columns: state.columns.m[joint].row(row).into_owned(),
            torque: state.columns.r[joint][row],
        };
        found.extend(cell.rows.clone().map(own));
    }
    found
}

/// Parameters that the chosen folds determine, and their least weighed squared error.
fn least(search: &Search, state: &State, phi: &[f64], chosen: impl Fn(usize) -> bool) -> (DVector<f64>, f64) {
    let rows = rows(search, state, phi, chosen);
    let a: Vec<RowDVector<f64>> = rows.iter().map(|row| &row.columns * row.weight.sqrt()).collect();
    let b = DVector::from_iterator(rows.len(), rows.iter().map(|row| row.torque * row.weight.sqrt()));
    let a = DMatrix::from_rows(&a);
    let theta = a.clone().svd(true, true).solve(&b, 1e-12).unwrap();
    let error = (b - a * &theta).norm_squared();
    (theta, error)
}

/// Squared errors of each joint in `fold` under parameters of the other folds: weighed, as they are, below 4 Hz, and in Nm.
fn errors(search: &Search, state: &State, phi: &[f64], fold: usize) -> Vec<[f64; 4]> {
    let (theta, _) = least(search, state, phi, |other| other != fold);
    let mut errors = vec![[0.0; 4]; search.problem.evidence.joints()];
    for row in rows(search, state, phi, |other| other == fold) {
        let square = (row.torque - (row.columns * &theta)[0]).powi(2);
        let low = if row.low { square } else { 0.0 };
        let sums = errors[row.joint].iter_mut();
        sums.zip([row.weight * square, square, low, row.sigma.powi(2) * square]).for_each(|(sum, one)| *sum += one);
    }
    errors
}

/// The sums over all folds.
fn sums(search: &Search, state: &State, phi: &[f64]) -> Vec<[f64; 4]> {
    let folds = 0..search.problem.evidence.folds().len();
    let all = folds.map(|fold| errors(search, state, phi, fold));
    all.reduce(|sums, own| sums.iter().zip(own).map(|(sum, own)| std::array::from_fn(|k| sum[k] + own[k])).collect())
        .unwrap()
}

/// The offset of joint 2 beside tones of 5 Hz in joint 1 and 12 Hz in joint 2, and all that was said of it.
fn said(recorded: &Recorded, repeats: bool) {
    let families: [&Family; 1] = [&torque_offset::FAMILY];
    recorded.search(&families, &Settings::default(), |search, base| {
        let evidence = search.problem.evidence;
        let item = search.library.iter().find(|item| item.joints() == [1]).unwrap();
        let tried = base.try_in(&search.problem, item).unwrap();
        let after = base.with(&search.problem, item.clone());
        let close = |found: f64, expected: f64| (found - expected).abs() <= 1e-6 * expected.abs();

        let found = plumbline_diagnose::folds(&search.problem, base, &tried);
        let (without, with) = (sums(search, base, &tried.fit.phi), sums(search, &after, &tried.fit.phi));
        // Every fold is asked, so all of them are in the sums.
        assert_eq!((evidence.repeats(), found.informative), (repeats, evidence.folds().len()));
        if repeats {
            let phi = &tried.fit.phi;
            let surprise = |state: &State, fold: usize| {
                least(search, state, phi, |_| true).1 - least(search, state, phi, |other| other != fold).1
            };
            for state in [base, &after] {
                let found = search.problem.surprise(state.moments(search.problem.evidence), phi);
                for (fold, found) in found.into_iter().enumerate() {
                    let expected = surprise(state, fold);
                    // A difference of sums of squares of all torques.
                    assert!((found - expected).abs() <= 1e-4 * expected.abs(), "{found}, by rows {expected}");
                }
            }
            let better = |fold: &usize| surprise(&after, *fold) < surprise(base, *fold);
            assert_eq!(found.positive, (0..evidence.folds().len()).filter(better).count());
        } else {
            let gains = without.iter().zip(&with).map(|(without, with)| (without[0] / with[0]).ln());
            let gain = evidence.per_joint() as f64 * gains.sum::<f64>();
            assert!(close(found.evidence, gain), "{found:?}, by rows {gain}");
            let share = |joint: usize, bands: usize| 1.0 - with[joint][bands] / without[joint][bands];
            let (all, low) = (share(1, 1), share(1, 2));
            // The tone above the low bands hides most of the offset in all of them.
            assert!(low > all + 0.1 && close(found.share, low), "{found:?}, {all} of all bands, {low} of the low ones");
            assert!(close(found.worst, share(0, 1).min(all)), "{found:?}, {all}");
            let weighed = |state: &State, fold: usize| -> f64 {
                errors(search, state, &tried.fit.phi, fold).iter().map(|own| own[0]).sum()
            };
            let falls: Vec<f64> =
                (0..evidence.folds().len()).map(|fold| weighed(base, fold) - weighed(&after, fold)).collect();
            let agreeing: f64 = falls.iter().filter(|fall| **fall > 0.0).sum();
            let of: f64 = falls.iter().map(|fall| fall.abs()).sum();
            assert!(close(found.agreement, agreeing / of) && agreeing < of, "{found:?}, {agreeing} of {of}");
            assert_eq!(found.positive, falls.iter().filter(|fall| **fall > 0.0).count());
        }

        let found = plumbline_diagnose::left_out(&search.problem, base, &after);
        let expected = [base, &after].map(|state| sums(search, state, &base.fit.phi));
        assert_eq!(found.len(), 2);
        for (joint, found) in found.iter().enumerate() {
            for (found, sums) in found.iter().zip(&expected) {
                let expected = (sums[joint][3] / evidence.samples()).sqrt();
                assert!(close(*found, expected), "joint {}: {found}, by rows {expected}", joint + 1);
            }
        }
    });
}

#[test]
fn errors_of_folds_that_are_left_out_are_those_of_a_fit_to_the_others() {
    let tone = |f: f64, t: f64| FLOOR * (TAU * f * t).sin();
    let beside = |offset: f64| move |at: &At| [2.0 * tone(5.0, at.t), offset * FLOOR + 4.0 * tone(12.0, at.t)];
    said(&recorded(4, 41, beside(5.0)), true);
    // For three of twenty seconds it is the other way round.
    said(&once(20.0, 41, |at| beside(if (8.0..11.0).contains(&at.t) { -3.0 } else { 3.0 })(at)), false);
}
