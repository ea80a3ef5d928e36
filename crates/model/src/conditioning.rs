//! Condition numbers of a stacked regressor, in every definition in use.
//!
//! The paper reports a "normalized condition number" without defining it.

use super::structure::Structure;
use super::term::Entry;
use nalgebra::DMatrix;
use plumbline_core::{singular_values, svd};
use serde::{Deserialize, Serialize};

/// `cond = s_max / s_min` of the stacked base regressor `W`, with and without the friction columns. Infinite (or beyond 1e15)
/// when the motion does not determine every parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Conditions {
    /// Of `W` as it is.
    pub raw: f64,
    /// Of `W` with every column divided by its norm.
    pub equilibrated: f64,
    /// Of `Sigma^-1/2 W`: every row divided by its joint's noise (paper eq. 11).
    pub weighted: f64,
    /// Of `W` without the friction columns.
    pub raw_rigid: f64,
    /// Of the equilibrated `W` without the friction columns.
    pub equilibrated_rigid: f64,
    /// Of `Sigma^-1/2 W` without the friction columns.
    pub weighted_rigid: f64,
}

/// Ratio of a column's norm to the largest one, below which the column is rounding.
pub const ZERO_COLUMN: f64 = 1e-10;

/// All condition numbers of `w`, whose rows are joint by joint (n equal blocks).
///
/// `friction[c]` marks the friction columns, `sigma` is the standard deviation of each joint's torque noise, n \[Nm\].
pub fn conditions(w: &DMatrix<f64>, friction: &[bool], sigma: &[f64]) -> Conditions {
    assert_eq!(w.ncols(), friction.len(), "one flag per column");
    assert_eq!(w.nrows() % sigma.len(), 0, "equal blocks of rows");
    let samples = w.nrows() / sigma.len();
    let mut weighted = w.clone();
    for (joint, sigma) in sigma.iter().enumerate() {
        weighted.rows_mut(joint * samples, samples).scale_mut(1.0 / sigma);
    }
    let rigid: Vec<usize> = (0..w.ncols()).filter(|&c| !friction[c]).collect();
    // W = Q R: every choice of columns of W has the condition of the same columns of R, which is small.
    let (raw, weighted) = (triangle(w), triangle(&weighted));
    Conditions {
        raw: condition(&raw),
        equilibrated: condition(&equilibrated(&raw)),
        weighted: condition(&weighted),
        raw_rigid: condition(&raw.select_columns(&rigid)),
        equilibrated_rigid: condition(&equilibrated(&raw.select_columns(&rigid))),
        weighted_rigid: condition(&weighted.select_columns(&rigid)),
    }
}

/// Condition number of the column-equilibrated `w`, and the columns that take part in its near dependencies: those with more than half of
/// their variance in singular directions with `s_max / s_i > most` (Belsley, Kuh and Welsch 1980, section 3.2), and columns of zeros.
pub fn dependent_columns(w: &DMatrix<f64>, most: f64) -> (f64, Vec<usize>) {
    let all = || (0..w.ncols()).collect();
    if w.nrows() < w.ncols() || w.ncols() == 0 || w.iter().any(|value| !value.is_finite()) {
        return (f64::INFINITY, all());
    }
    let Some(decomposed) = svd(equilibrated(&triangle(w))) else { return (f64::INFINITY, all()) };
    let (Some(v_t), s) = (decomposed.v_t, decomposed.singular_values) else { return (f64::INFINITY, all()) };
    let (largest, smallest) = (s.max(), s.min());
    // A direction without any excitation has a finite, very large variance here.
    let variance = |i: usize, c: usize| (v_t[(i, c)] / s[i].max(f64::EPSILON * largest)).powi(2);
    let share = |c: usize| {
        let of = |directions: &mut dyn Iterator<Item = usize>| directions.map(|i| variance(i, c)).sum::<f64>();
        of(&mut (0..s.len()).filter(|&i| s[i] * most < largest)) / of(&mut (0..s.len()))
    };
    let dependent = (0..w.ncols()).filter(|&c| share(c).is_nan() || share(c) > 0.5).collect();
    (if smallest > 0.0 { largest / smallest } else { f64::INFINITY }, dependent)
}

/// Marks the friction columns of a structure, for [`conditions`].
pub fn friction_columns(structure: &Structure) -> Vec<bool> {
    let terms = structure.terms().iter().zip(structure.ranges());
    let friction = |entry: Option<&Entry>| matches!(entry, Some(Entry::Velocity { .. } | Entry::SmoothSign { .. }));
    let of_term = |(term, range): (&std::sync::Arc<dyn super::term::Term>, std::ops::Range<usize>)| {
        let entries = term.entries().unwrap_or_default();
        (0..range.len()).map(|c| friction(entries.get(c))).collect::<Vec<bool>>()
    };
    terms.flat_map(of_term).collect()
}

/// Condition number by singular values; infinite for fewer rows than columns.
pub fn condition(w: &DMatrix<f64>) -> f64 {
    let values = (w.nrows() >= w.ncols()).then(|| singular_values(w.clone())).flatten();
    values.filter(|s| s.min() > 0.0).map_or(f64::INFINITY, |s| s.max() / s.min())
}

fn triangle(w: &DMatrix<f64>) -> DMatrix<f64> {
    if w.nrows() > w.ncols() { w.clone().qr().unpack_r() } else { w.clone() }
}

fn equilibrated(w: &DMatrix<f64>) -> DMatrix<f64> {
    let mut w = w.clone();
    let largest = w.column_iter().map(|column| column.norm()).fold(0.0, f64::max);
    for mut column in w.column_iter_mut() {
        let norm = column.norm();
        // An unexcited column contains rounding (`sin(pi)` is 1e-16), which must not become a direction.
        if norm > ZERO_COLUMN * largest {
            column /= norm;
        } else {
            column.fill(0.0);
        }
    }
    w
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn each_definition_is_what_its_matrix_has() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        // Two joints of 50 samples each; orthonormal columns, then known scales.
        let q = DMatrix::from_fn(100, 4, |_, _| rng.random_range(-1.0..1.0)).qr().q();
        let w = &q * DMatrix::from_diagonal(&DVector::from_vec(vec![2.0, 1.0, 0.1, 40.0]));
        let friction = [false, false, false, true];
        let found = conditions(&w, &friction, &[1.0, 1.0]);
        assert!((found.raw - 400.0).abs() < 1e-9 && (found.raw_rigid - 20.0).abs() < 1e-11);
        assert!((found.equilibrated - 1.0).abs() < 1e-12 && (found.equilibrated_rigid - 1.0).abs() < 1e-12);
        assert!((found.weighted - found.raw).abs() < 1e-9);
        // Noise of its own in each joint: the same as scaling the rows first.
        let found = conditions(&w, &friction, &[0.5, 0.1]);
        let mut scaled = w.clone();
        scaled.rows_mut(0, 50).scale_mut(2.0);
        scaled.rows_mut(50, 50).scale_mut(10.0);
        assert!((found.weighted / condition(&scaled) - 1.0).abs() < 1e-10);
        assert!((found.weighted_rigid / condition(&scaled.select_columns(&[0, 1, 2])) - 1.0).abs() < 1e-10);
    }

    #[test]
    fn the_columns_of_a_near_dependency_are_found() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let q = DMatrix::from_fn(100, 5, |_, _| rng.random_range(-1.0..1.0)).qr().q();
        let mut w = q.clone();
        // Column 3 is nearly column 1, in another unit; column 4 is zero.
        w.set_column(3, &(q.column(1) * 7.0 + q.column(3) * 7e-5));
        let (condition, columns) = dependent_columns(&w.columns(0, 4).into_owned(), 1e4);
        assert!((condition / 2e5 - 1.0).abs() < 1e-6, "{condition}");
        assert_eq!(columns, [1, 3]);
        assert_eq!(dependent_columns(&w.columns(0, 4).into_owned(), 1e6).1, [0; 0]);
        w.column_mut(4).fill(0.0);
        let (condition, columns) = dependent_columns(&w, 1e6);
        assert!(condition > 1e12 && columns == [4], "{condition} {columns:?}");
    }

    #[test]
    fn a_column_that_is_not_excited_is_infinite() {
        let mut w = DMatrix::from_fn(30, 3, |i, j| ((i * (j + 2)) as f64).sin());
        w.column_mut(1).fill(0.0);
        assert!(conditions(&w, &[false; 3], &[1.0]).raw > 1e15);
        assert_eq!(condition(&DMatrix::zeros(2, 3)), f64::INFINITY);
    }
}
