//! What folds that are left out say of an effect, computed once more row by row: least squares by a singular value decomposition on the rows of
//! all other folds, and the sums of squares of the rows that were left out.

use super::synthetic::{At, FLOOR, Recorded, once, recorded};
use plumbline_diagnose::{Search, Settings, State, group};

use nalgebra::{DMatrix, DVector, RowDVector};
use plumbline_model::term::effect::Family;
use plumbline_model::term::torque_offset;
use std::f64::consts::TAU;

/// Rows of one fold: joint, weight, noise of the row's torque, columns, torque.
fn rows(
    search: &Search,
    state: &State,
    phi: &[f64],
    chosen: impl Fn(usize) -> bool,
) -> Vec<(usize, f64, f64, RowDVector<f64>, f64)> {
    let evidence = search.problem.evidence;
    let mut found = Vec::new();
    for cell in evidence.cells().iter().filter(|cell| chosen(cell.fold)) {
        let (joint, weight) = (cell.joint, 1.0 / phi[group(cell.joint, cell.band)]);
        for row in cell.rows.clone() {
            let columns = state.columns.m[joint].row(row).into_owned();
            found.push((joint, weight, evidence.sigma(joint)[row], columns, state.columns.r[joint][row]));
        }
    }
    found
}

/// Parameters that the chosen folds determine, and their least weighed squared error.
fn least(search: &Search, state: &State, phi: &[f64], chosen: impl Fn(usize) -> bool) -> (DVector<f64>, f64) {
    let rows = rows(search, state, phi, chosen);
    let a: Vec<RowDVector<f64>> = rows.iter().map(|(_, weight, _, columns, _)| columns * weight.sqrt()).collect();
    let b = DVector::from_iterator(rows.len(), rows.iter().map(|(_, weight, _, _, torque)| torque * weight.sqrt()));
    let a = DMatrix::from_rows(&a);
    let theta = a.clone().svd(true, true).solve(&b, 1e-12).unwrap();
    let error = (b - a * &theta).norm_squared();
    (theta, error)
}

/// Squared errors of each joint in `fold` under parameters of the other folds: weighed, as they are, and in Nm.
fn errors(search: &Search, state: &State, phi: &[f64], fold: usize) -> Vec<[f64; 3]> {
    let (theta, _) = least(search, state, phi, |other| other != fold);
    let mut errors = vec![[0.0; 3]; search.problem.evidence.joints()];
    for (joint, weight, sigma, columns, torque) in rows(search, state, phi, |other| other == fold) {
        let error = torque - (columns * &theta)[0];
        for (sum, one) in errors[joint].iter_mut().zip([weight * error * error, error * error, (sigma * error).powi(2)])
        {
            *sum += one;
        }
    }
    errors
}

/// The sums over all folds.
fn sums(search: &Search, state: &State, phi: &[f64]) -> Vec<[f64; 3]> {
    let folds = 0..search.problem.evidence.folds().len();
    let all = folds.map(|fold| errors(search, state, phi, fold));
    all.reduce(|sums, own| sums.iter().zip(own).map(|(sum, own)| std::array::from_fn(|k| sum[k] + own[k])).collect())
        .unwrap()
}

/// The offset of joint 2 beside a tone of 5 Hz in joint 1, and all that was said of it.
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
                let found = search.problem.surprise(&state.moments, phi);
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
            let shares: Vec<f64> =
                without.iter().zip(&with).map(|(without, with)| 1.0 - with[1] / without[1]).collect();
            assert!(close(found.share, shares[1]), "{found:?}, {shares:?}");
            assert!(close(found.worst, shares[0].min(shares[1])), "{found:?}, {shares:?}");
        }

        let found = plumbline_diagnose::left_out(&search.problem, base, &after);
        let expected = [base, &after].map(|state| sums(search, state, &base.fit.phi));
        assert_eq!(found.len(), 2);
        for (joint, found) in found.iter().enumerate() {
            for (found, sums) in found.iter().zip(&expected) {
                let expected = (sums[joint][2] / evidence.samples()).sqrt();
                assert!(close(*found, expected), "joint {}: {found}, by rows {expected}", joint + 1);
            }
        }
    });
}

#[test]
fn errors_of_folds_that_are_left_out_are_those_of_a_fit_to_the_others() {
    let added = |at: &At| [2.0 * FLOOR * (TAU * 5.0 * at.t).sin(), 5.0 * FLOOR];
    said(&recorded(4, 41, added), true);
    said(&once(20.0, 41, added), false);
}
