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

/// Of one model in each group: all folds together.
#[derive(Clone, Debug)]
pub struct GroupedMoments {
    /// Number of columns.
    pub width: usize,
    /// `M'M` and `M'r` of each group that has rows.
    pub groups: Vec<Option<(DMatrix<f64>, DVector<f64>)>>,
    /// `r'r`.
    pub r2: Vec<f64>,
    /// Rows.
    pub count: Vec<f64>,
    /// Largest over-dispersion.
    pub most: Vec<f64>,
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
            cells.push((index, CrossMoment::of(transposed_product(&m, &c), &c, &r)));
        }
        Cross { width: rows.width, exact: rows.exact, cells }
    }
}

/// The columns of a model with the rows of a group side by side. What candidates bring to all folds together, which is asked of every one of the library, is
/// a product of two matrices then instead of many of short columns.
#[derive(Clone, Debug)]
pub struct GroupedColumns {
    /// `M'` of each joint, columns x rows.
    transposed: Vec<DMatrix<f64>>,
    /// `r` of each joint.
    r: Vec<DVector<f64>>,
    /// Rows of a joint, band by band, in pieces.
    pieces: Vec<Range<usize>>,
    /// The rows of each band in that order.
    bands: Vec<Range<usize>>,
}

impl GroupedColumns {
    /// Of columns.
    pub fn of(columns: &Columns, evidence: &Evidence) -> GroupedColumns {
        let (mut pieces, mut bands, mut rows) = (Vec::new(), Vec::new(), 0);
        for band in 0..BAND_EDGES_HZ.len() {
            let first = rows;
            for cell in evidence.cells().iter().filter(|cell| cell.joint == 0 && cell.band == band) {
                pieces.push(cell.rows.clone());
                rows += cell.rows.len();
            }
            bands.push(first..rows);
        }
        let order: Vec<usize> = pieces.iter().cloned().flatten().collect();
        let transposed = columns.m.iter().map(|m| m.select_rows(&order).transpose()).collect();
        let r = columns.r.iter().map(|r| r.select_rows(&order)).collect();
        GroupedColumns { transposed, r, pieces, bands }
    }

    /// The sums of candidates with them, in their order.
    pub fn cross(&self, candidates: &[&Rows]) -> Vec<GroupedCross> {
        let empty = |rows: &&Rows| GroupedCross { width: rows.width, exact: rows.exact, groups: Vec::new() };
        let mut crosses: Vec<GroupedCross> = candidates.iter().map(empty).collect();
        for joint in 0..self.transposed.len() {
            let own: Vec<_> =
                candidates.iter().enumerate().filter_map(|(at, rows)| Some((at, rows.of(joint)?))).collect();
            let columns: usize = own.iter().map(|(_, part)| part.ncols()).sum();
            let mut c = Vec::with_capacity(columns * self.r[joint].len());
            for part in own.iter().flat_map(|(_, part)| part.as_slice().chunks_exact(part.nrows().max(1))) {
                self.pieces.iter().for_each(|rows| c.extend_from_slice(&part[rows.clone()]));
            }
            let c = DMatrix::from_vec(self.r[joint].len(), columns, c);
            for (band, rows) in self.bands.iter().enumerate() {
                let c = c.rows(rows.start, rows.len());
                let a = self.transposed[joint].columns(rows.start, rows.len()) * c;
                let r = self.r[joint].rows(rows.start, rows.len());
                let mut first = 0;
                for (at, part) in &own {
                    let width = part.ncols();
                    let (c, a) = (c.columns(first, width), a.columns(first, width).into_owned());
                    first += width;
                    // What acts in a part of the recording is zero before and after it.
                    if c.iter().any(|value| *value != 0.0) {
                        crosses[*at].groups.push((group(joint, band), CrossMoment::of(a, &c, &r)));
                    }
                }
            }
        }
        crosses
    }
}

impl CrossMoment {
    /// Of a candidate's columns and the torques, with their products `a` with the model's.
    fn of(a: DMatrix<f64>, c: &DMatrixView<f64>, r: &DVectorView<f64>) -> CrossMoment {
        CrossMoment { a, c: transposed_product(c, c), d: c.tr_mul(r) }
    }
}

impl GroupedMoments {
    /// Of the columns of a model, whose over-dispersion is not bounded.
    pub fn of(moments: &Moments, evidence: &Evidence) -> GroupedMoments {
        let count = evidence.joints() * BAND_EDGES_HZ.len();
        let mut sums = GroupedMoments {
            width: moments.width,
            groups: vec![None; count],
            r2: vec![0.0; count],
            count: vec![0.0; count],
            most: vec![f64::INFINITY; count],
        };
        for (cell, own) in evidence.cells().iter().zip(&moments.cells) {
            let at = group(cell.joint, cell.band);
            sums.r2[at] += own.r2;
            sums.count[at] += own.count as f64;
            match &mut sums.groups[at] {
                Some((g, b)) => {
                    *g += &own.g;
                    *b += &own.b;
                }
                empty => *empty = Some((own.g.clone(), own.b.clone())),
            }
        }
        sums
    }

    /// The model with the candidate as its last columns.
    pub fn with(&self, cross: &GroupedCross) -> GroupedMoments {
        let (p, l) = (self.width, cross.width);
        let more = |(g, b): &(DMatrix<f64>, DVector<f64>)| grown(g, b, l);
        let mut groups: Vec<_> = self.groups.iter().map(|own| own.as_ref().map(more)).collect();
        for (at, add) in &cross.groups {
            if let Some((g, b)) = &mut groups[*at] {
                fill(g, b, p, add);
            }
        }
        self.of_width(p + l, groups)
    }

    /// The model without some of its columns.
    pub fn without(&self, gone: Range<usize>) -> GroupedMoments {
        let less = |(g, b): &(DMatrix<f64>, DVector<f64>)| {
            let g = g.clone().remove_rows(gone.start, gone.len()).remove_columns(gone.start, gone.len());
            (g, b.clone().remove_rows(gone.start, gone.len()))
        };
        let groups = self.groups.iter().map(|own| own.as_ref().map(less)).collect();
        self.of_width(self.width - gone.len(), groups)
    }

    fn of_width(&self, width: usize, groups: Vec<Option<(DMatrix<f64>, DVector<f64>)>>) -> GroupedMoments {
        GroupedMoments { width, groups, r2: self.r2.clone(), count: self.count.clone(), most: self.most.clone() }
    }
}

/// Sums with zeros for so many more columns.
fn grown(g: &DMatrix<f64>, b: &DVector<f64>, by: usize) -> (DMatrix<f64>, DVector<f64>) {
    let p = b.len();
    let (mut more_g, mut more_b) = (DMatrix::zeros(p + by, p + by), DVector::zeros(p + by));
    more_g.view_mut((0, 0), (p, p)).copy_from(g);
    more_b.rows_mut(0, p).copy_from(b);
    (more_g, more_b)
}

/// Writes a candidate's sums behind the first `p` columns.
fn fill(g: &mut DMatrix<f64>, b: &mut DVector<f64>, p: usize, add: &CrossMoment) {
    let l = add.d.len();
    g.view_mut((0, p), (p, l)).copy_from(&add.a);
    g.view_mut((p, 0), (l, p)).tr_copy_from(&add.a);
    g.view_mut((p, p), (l, l)).copy_from(&add.c);
    b.rows_mut(p, l).copy_from(&add.d);
}

impl Moments {
    /// The model with the candidate as its last columns.
    pub fn with(&self, cross: &Cross) -> Moments {
        let (p, l) = (self.width, cross.width);
        let more = |own: &Moment| {
            let (g, b) = grown(&own.g, &own.b, l);
            Moment { g, b, r2: own.r2, count: own.count }
        };
        let mut cells: Vec<Moment> = self.cells.iter().map(more).collect();
        for (index, add) in &cross.cells {
            let Moment { g, b, .. } = &mut cells[*index];
            fill(g, b, p, add);
        }
        Moments { width: p + l, cells }
    }
}
