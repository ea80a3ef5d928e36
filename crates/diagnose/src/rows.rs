//! Columns as the evidence has them: coefficients in the pass-band, divided by their noise.

use super::evidence::{Cell, Evidence};
use super::span::Span;
use nalgebra::{DMatrix, DMatrixView};
use std::borrow::Cow;
use std::ops::Range;
use std::sync::Arc;

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
    /// Of joints with coefficients, divided by their noise.
    pub fn new(width: usize, parts: Vec<(usize, DMatrix<f64>)>) -> Rows {
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

    /// Whether every coefficient is a number.
    pub fn is_finite(&self) -> bool {
        self.parts.iter().all(|(_, part)| part.iter().all(|value| value.is_finite()))
    }
}
