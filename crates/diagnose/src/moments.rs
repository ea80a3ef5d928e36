//! Sums of products of columns and torques, cell by cell: all that fits, scores and folds need of the data.
//!
//! With `M` the columns of a model, `C` those of a candidate and `r` the torques, in one cell, these are `M'M`, `M'r`, `r'r` and `M'C`,
//! `C'C`, `C'r`. Weighing a band anew or leaving a trajectory out is another sum of the same small matrices.

use super::evidence::{BAND_EDGES_HZ, Evidence};
use super::fit::group;
use super::rows::Rows;
use nalgebra::{DMatrix, DMatrixView, DVector, DVectorView};
use plumbline_core::transposed_product;
use std::ops::Range;

/// Of one model on all cells.
#[derive(Clone, Debug)]
pub struct Moments {
    /// Number of columns.
    pub width: usize,
    /// One per cell of the evidence, in its order.
    pub cells: Vec<Moment>,
}

/// Of one cell.
#[derive(Clone, Debug)]
pub struct Moment {
    /// `M'M`.
    pub g: DMatrix<f64>,
    /// `M'r`.
    pub b: DVector<f64>,
    /// `r'r`.
    pub r2: f64,
    /// Rows.
    pub count: usize,
}

/// Of a candidate with a model, in the cells of the candidate's joints.
#[derive(Clone, Debug)]
pub struct Cross {
    /// Columns of the candidate.
    pub width: usize,
    /// Whether they are [exact](Rows::exact).
    pub exact: bool,
    /// Index of the cell and its sums.
    pub cells: Vec<(usize, CrossMoment)>,
}

/// Of one cell.
#[derive(Clone, Debug)]
pub struct CrossMoment {
    /// `M'C`.
    pub a: DMatrix<f64>,
    /// `C'C`.
    pub c: DMatrix<f64>,
    /// `C'r`.
    pub d: DVector<f64>,
}

/// Of a candidate with a model, in the groups of the candidate's joints: all folds together.
#[derive(Clone, Debug)]
pub struct GroupedCross {
    /// Columns of the candidate.
    pub width: usize,
    /// Whether they are [exact](Rows::exact).
    pub exact: bool,
    /// The group and its sums.
    pub groups: Vec<(usize, CrossMoment)>,
}

/// The columns of a model and the torques, per joint, divided by the noise.
#[derive(Clone, Debug)]
pub struct Columns {
    /// `M`, rows of a joint x columns.
    pub m: Vec<DMatrix<f64>>,
    /// `r`.
    pub r: Vec<DVector<f64>>,
}

impl Columns {
    /// With a candidate's columns behind its own.
    pub fn push(&mut self, rows: &Rows) {
        for (joint, m) in self.m.iter_mut().enumerate() {
            let width = m.ncols();
            let grown = std::mem::replace(m, DMatrix::zeros(0, 0)).resize_horizontally(width + rows.width, 0.0);
            *m = grown;
            if let Some(part) = rows.of(joint) {
                m.columns_mut(width, rows.width).copy_from(&part);
            }
        }
    }

    /// Without some of its columns.
    pub fn without(&self, gone: Range<usize>) -> Columns {
        let kept = |m: &DMatrix<f64>| m.clone().remove_columns(gone.start, gone.len());
        Columns { m: self.m.iter().map(kept).collect(), r: self.r.clone() }
    }

    /// Its sums.
    pub fn moments(&self, evidence: &Evidence) -> Moments {
        let of = |cell: &super::evidence::Cell| {
            let m = self.m[cell.joint].rows(cell.rows.start, cell.rows.len());
            let r = self.r[cell.joint].rows(cell.rows.start, cell.rows.len());
            Moment { g: transposed_product(&m, &m), b: m.tr_mul(&r), r2: r.norm_squared(), count: cell.rows.len() }
        };
        let width = self.m.first().map_or(0, DMatrix::ncols);
        Moments { width, cells: evidence.cells().iter().map(of).collect() }
    }

    /// The sums of a candidate with it.
    pub fn cross(&self, evidence: &Evidence, rows: &Rows) -> Cross {
        let mut cells = Vec::new();
        for (index, cell) in evidence.cells().iter().enumerate() {
            let Some(c) = rows.in_cell(cell) else { continue };
            let m = self.m[cell.joint].rows(cell.rows.start, cell.rows.len());
            let r = self.r[cell.joint].rows(cell.rows.start, cell.rows.len());
            cells.push((index, CrossMoment::of(&m, &c, &r)));
        }
        Cross { width: rows.width, exact: rows.exact, cells }
    }
}

/// The columns of a model with the rows of a group side by side. What a candidate brings to all folds together, which is asked of every candidate of the
/// library, is a few products of long columns then instead of many of short ones.
#[derive(Clone, Debug)]
pub struct GroupedColumns {
    /// The columns in this order.
    columns: Columns,
    /// Rows of a joint, band by band.
    order: Vec<usize>,
    /// The rows of each band in that order.
    bands: Vec<Range<usize>>,
}

impl GroupedColumns {
    /// Of columns.
    pub fn of(columns: &Columns, evidence: &Evidence) -> GroupedColumns {
        let (mut order, mut bands) = (Vec::new(), Vec::new());
        for band in 0..BAND_EDGES_HZ.len() {
            let first = order.len();
            let own = evidence.cells().iter().filter(|cell| cell.joint == 0 && cell.band == band);
            order.extend(own.flat_map(|cell| cell.rows.clone()));
            bands.push(first..order.len());
        }
        let m = columns.m.iter().map(|m| m.select_rows(&order)).collect();
        let r = columns.r.iter().map(|r| r.select_rows(&order)).collect();
        GroupedColumns { columns: Columns { m, r }, order, bands }
    }

    /// The sums of a candidate with them.
    pub fn cross(&self, rows: &Rows) -> GroupedCross {
        let mut groups = Vec::new();
        for joint in rows.joints() {
            let Some(part) = rows.of(joint) else { continue };
            let c = part.select_rows(&self.order);
            for (band, rows) in self.bands.iter().enumerate() {
                // What acts in a part of the recording is zero before and after it.
                let acts = |row: &usize| c.row(*row).iter().any(|value| *value != 0.0);
                let Some(first) = rows.clone().find(acts) else { continue };
                let count = rows.clone().rev().find(acts).map_or(0, |last| last + 1 - first);
                let [m, c] = [&self.columns.m[joint], &c].map(|all| all.rows(first, count));
                let r = self.columns.r[joint].rows(first, count);
                groups.push((group(joint, band), CrossMoment::of(&m, &c, &r)));
            }
        }
        GroupedCross { width: rows.width, exact: rows.exact, groups }
    }
}

impl CrossMoment {
    fn of(m: &DMatrixView<f64>, c: &DMatrixView<f64>, r: &DVectorView<f64>) -> CrossMoment {
        CrossMoment { a: transposed_product(m, c), c: transposed_product(c, c), d: c.tr_mul(r) }
    }
}

impl Moments {
    /// The model with the candidate as its last columns.
    pub fn with(&self, cross: &Cross) -> Moments {
        let (p, l) = (self.width, cross.width);
        let mut grown = Moments { width: p + l, cells: Vec::with_capacity(self.cells.len()) };
        for own in &self.cells {
            let mut b = own.b.clone().resize_vertically(p + l, 0.0);
            b.rows_mut(p, l).fill(0.0);
            grown.cells.push(Moment { g: own.g.clone().resize(p + l, p + l, 0.0), b, r2: own.r2, count: own.count });
        }
        for (index, add) in &cross.cells {
            let cell = &mut grown.cells[*index];
            cell.g.view_mut((0, p), (p, l)).copy_from(&add.a);
            cell.g.view_mut((p, 0), (l, p)).copy_from(&add.a.transpose());
            cell.g.view_mut((p, p), (l, l)).copy_from(&add.c);
            cell.b.rows_mut(p, l).copy_from(&add.d);
        }
        grown
    }

    /// The model without some of its columns.
    pub fn without(&self, gone: Range<usize>) -> Moments {
        let less = |own: &Moment| Moment {
            g: own.g.clone().remove_rows(gone.start, gone.len()).remove_columns(gone.start, gone.len()),
            b: own.b.clone().remove_rows(gone.start, gone.len()),
            ..own.clone()
        };
        Moments { width: self.width - gone.len(), cells: self.cells.iter().map(less).collect() }
    }
}
