//! Columns as the evidence has them: coefficients in the pass-band, divided by their noise.

use super::evidence::{Cell, Evidence};
use super::fit::inverse;
use super::span::Span;
use nalgebra::{DMatrix, DMatrixView};
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

/// Largest share of a column's squares that rounding leaves of what other columns contain.
const MAX_ROUNDING_RATIO: f64 = 1e-9;
/// Largest ratio of a column that is nothing but rounding to the largest one.
const MAX_ROUNDED_COLUMN_RATIO: f64 = 1e-9;

/// Coefficients of columns; joints that are not listed have none.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    /// Number of columns.
    pub width: usize,
    /// Whether the columns are known without an error of positions or parameters, and the noise is: then less of them has to be independent of the others.
    pub exact: bool,
    /// Joint, from 0, and its coefficients, divided by their noise. Shared by the same columns in many parts of the recording.
    parts: Vec<(usize, Arc<DMatrix<f64>>)>,
    /// The rows outside which they count as zero; `None` where all count.
    within: Option<Arc<[Range<usize>]>>,
}

impl Rows {
    /// Of joints with coefficients, divided by their noise. What the arm does not excite is zero: rounding leaves something of it, and a parameter of
    /// any size would fit that.
    pub fn new(width: usize, mut parts: Vec<(usize, DMatrix<f64>)>) -> Rows {
        let square = |column| parts.iter().map(|(_, part)| part.column(column).norm_squared()).sum::<f64>();
        let squares: Vec<f64> = (0..width).map(square).collect();
        let least = MAX_ROUNDED_COLUMN_RATIO.powi(2) * squares.iter().copied().fold(0.0, f64::max);
        for column in (0..width).filter(|&column| squares[column] < least) {
            parts.iter_mut().for_each(|(_, part)| part.column_mut(column).fill(0.0));
        }
        parts.retain(|(_, part)| part.iter().any(|value| *value != 0.0));
        let shared = |(joint, part)| (joint, Arc::new(part));
        Rows { width, exact: false, parts: parts.into_iter().map(shared).collect(), within: None }
    }

    /// Without the folds that begin outside a part of the recording.
    pub fn in_folds(&self, evidence: &Evidence, span: Span) -> Rows {
        let begun =
            evidence.folds().iter().zip(evidence.begins()).filter(|(_, begin)| (span.from..span.to).contains(begin));
        let within: Arc<[Range<usize>]> = begun.map(|(fold, _)| fold.rows.clone()).collect();
        let acts = |(_, part): &&(usize, Arc<DMatrix<f64>>)| {
            let mut inside = within.iter().map(|rows| part.rows(rows.start, rows.len()));
            inside.any(|rows| rows.iter().any(|value| *value != 0.0))
        };
        let parts = self.parts.iter().filter(acts).cloned().collect();
        Rows { width: self.width, exact: self.exact, parts, within: Some(within) }
    }

    /// Joints that have some, from 0.
    pub fn joints(&self) -> impl Iterator<Item = usize> + '_ {
        self.parts.iter().map(|(joint, _)| *joint)
    }

    /// Whether no joint has any.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Those of a joint.
    pub fn of(&self, joint: usize) -> Option<Cow<'_, DMatrix<f64>>> {
        let part = self.part(joint)?;
        let Some(within) = &self.within else { return Some(Cow::Borrowed(part)) };
        let mut inside = DMatrix::zeros(part.nrows(), part.ncols());
        for rows in within.iter() {
            inside.rows_mut(rows.start, rows.len()).copy_from(&part.rows(rows.start, rows.len()));
        }
        Some(Cow::Owned(inside))
    }

    /// Those of a cell, where they are not zero.
    pub fn in_cell(&self, cell: &Cell) -> Option<DMatrixView<'_, f64>> {
        let part = self.part(cell.joint)?;
        let counts =
            self.within.as_ref().is_none_or(|within| within.iter().any(|rows| rows.contains(&cell.rows.start)));
        let rows = counts.then(|| part.rows(cell.rows.start, cell.rows.len()))?;
        rows.iter().any(|value| *value != 0.0).then_some(rows)
    }

    /// Those of a joint in the whole recording.
    fn part(&self, joint: usize) -> Option<&DMatrix<f64>> {
        self.parts.iter().find(|(own, _)| *own == joint).map(|(_, part)| &**part)
    }

    /// Whether a sum of its columns is each of the other's: an offset is a spring without stiffness, whatever the motion.
    pub fn contains(&self, other: &Rows) -> bool {
        let mut g = DMatrix::zeros(self.width, self.width);
        for own in self.joints().filter_map(|joint| self.of(joint)) {
            g.gemm_tr(1.0, &own, &own, 1.0);
        }
        let mut shared = DMatrix::zeros(self.width, other.width);
        let mut squares = vec![0.0; other.width];
        for joint in other.joints() {
            let (Some(own), Some(theirs)) = (self.of(joint), other.of(joint)) else { return false };
            shared.gemm_tr(1.0, &own, &theirs, 1.0);
            theirs.column_iter().zip(&mut squares).for_each(|(column, square)| *square += column.norm_squared());
        }
        let made = inverse(&g) * &shared;
        (0..other.width).all(|k| squares[k] - made.column(k).dot(&shared.column(k)) < MAX_ROUNDING_RATIO * squares[k])
    }

    /// Whether every coefficient is a number.
    pub fn is_finite(&self) -> bool {
        self.parts.iter().all(|(_, part)| part.iter().all(|value| value.is_finite()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(parts: &[(usize, &[[f64; 4]])]) -> Rows {
        let part = |&(joint, columns): &(usize, &[[f64; 4]])| {
            (joint, DMatrix::from_fn(4, columns.len(), |r, c| columns[c][r]))
        };
        Rows::new(parts[0].1.len(), parts.iter().map(part).collect())
    }

    #[test]
    fn an_offset_is_a_spring_without_stiffness_and_not_the_other_way_round() {
        let (q, one) = ([0.9, 1.0, 1.1, 1.3], [1.0; 4]);
        let (spring, offset) = (rows(&[(2, &[q, one])]), rows(&[(2, &[one])]));
        assert!(spring.contains(&offset) && spring.contains(&spring) && !offset.contains(&spring));
        // Over a short way a ripple is nearly a spring, and none.
        let ripple = rows(&[(2, &[q.map(f64::sin), q.map(f64::cos)])]);
        assert!(!ripple.contains(&offset) && !spring.contains(&ripple));
        let [elsewhere, in_two] = [rows(&[(1, &[one])]), rows(&[(2, &[one]), (3, &[q])])];
        assert!(!spring.contains(&elsewhere) && !spring.contains(&in_two) && !in_two.contains(&offset));
        assert!(in_two.contains(&in_two));
    }

    #[test]
    fn a_column_of_rounding_alone_is_zero() {
        let (q, rounding) = ([0.9, 1.0, 1.1, 1.3], [1e-13, -2e-13, 0.0, 1e-13]);
        let body = rows(&[(0, &[rounding, q]), (1, &[rounding, q.map(|q| 1e-3 * q)]), (2, &[rounding, [0.0; 4]])]);
        assert_eq!((body.width, body.joints().collect::<Vec<_>>()), (2, vec![0, 1]));
        for joint in body.joints() {
            let own = body.of(joint).unwrap();
            assert!(own.column(0).iter().all(|value| *value == 0.0) && own.column(1).norm() > 0.0);
        }
        // Small is not nothing.
        let small = rows(&[(0, &[q, q.map(|q| 1e-8 * q)])]);
        assert!(small.of(0).unwrap().column(1).norm() > 0.0);
    }
}
