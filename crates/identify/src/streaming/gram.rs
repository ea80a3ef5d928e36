//! Normal equations in joint blocks: all that least squares needs of any number of rows, in constant memory.

use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f64x4};
use nalgebra::{DMatrix, DVector};
use plumbline_core::MAX_JOINTS;

/// Rows of each joint that are gathered before their products are added: enough to keep the products in registers, few enough for the cache.
const BLOCK: usize = 32;
/// Columns of one register tile; rows are padded to a multiple of it.
const TILE: usize = 8;

/// `W_j' W_j`, `W_j' tau_j` and `tau_j' tau_j` of every joint's rows `tau_j = W_j beta`, so that joints can be weighed afterwards.
///
/// A joint's rows have entries for the links from its own outward and for its own friction alone; the products of the other columns are
/// never formed, which is a third of the work of one Gram matrix for all rows.
#[derive(Clone, Debug)]
pub struct Gram {
    level: Level,
    columns: usize,
    joints: Vec<JointGram>,
    /// Buffered rows of each joint.
    buffered: usize,
    /// Rows of each joint so far.
    count: usize,
    /// Forgetting factor.
    forgetting: f64,
    /// Sum of the rows' weights.
    weight: f64,
}

#[derive(Clone, Debug)]
struct JointGram {
    /// Columns that have entries in this joint's rows, rising.
    active: Vec<usize>,
    /// Entries of a row: the active columns, the torque, zeros up to a multiple of [`TILE`].
    width: usize,
    /// [`BLOCK`] rows.
    rows: Vec<f64>,
    /// Products of all pairs of entries (the upper triangle, by tiles), row by row.
    products: Vec<f64>,
}

impl Gram {
    /// No rows yet. `active[j]` are the columns, of `columns`, that have entries in joint `j`'s rows. Each row leaves the weight
    /// `forgetting` to those before it: 1 forgets nothing. Panics for a weight outside (0, 1] and columns that are none.
    pub fn new(columns: usize, active: Vec<Vec<usize>>, forgetting: f64) -> Gram {
        assert!(
            forgetting > 0.0 && forgetting <= 1.0,
            "forgetting factor {forgetting}: expected more than 0, at most 1"
        );
        assert!(active.len() <= MAX_JOINTS, "{} joints, room for {MAX_JOINTS}", active.len());
        assert!(active.iter().flatten().all(|&c| c < columns), "active columns of {columns}");
        let joint = |active: Vec<usize>| {
            let width = (active.len() + 1).next_multiple_of(TILE);
            JointGram { active, width, rows: vec![0.0; BLOCK * width], products: vec![0.0; width * width] }
        };
        let joints = active.into_iter().map(joint).collect();
        Gram { level: Level::new(), columns, joints, buffered: 0, count: 0, forgetting, weight: 0.0 }
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.joints.len()
    }

    /// Number of columns, p.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Rows of each joint so far.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Sum of the weights of a joint's rows: their number when nothing is forgotten.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Adds one sample, a row for every joint: `y[c][j]` is column `c` in joint `j`'s row, `tau[j]` its right side. Allocates nothing.
    pub fn add(&mut self, y: &[[f64; MAX_JOINTS]], tau: &[f64; MAX_JOINTS]) {
        assert_eq!(y.len(), self.columns, "one element per column");
        for (j, (joint, tau)) in self.joints.iter_mut().zip(tau).enumerate() {
            let row = &mut joint.rows[self.buffered * joint.width..][..joint.width];
            for (entry, &c) in row.iter_mut().zip(&joint.active) {
                *entry = y[c][j];
            }
            row[joint.active.len()] = *tau;
        }
        self.buffered += 1;
        self.count += 1;
        self.weight = self.forgetting * self.weight + 1.0;
        if self.buffered == BLOCK {
            self.flush();
        }
    }

    /// Adds the products of the buffered rows.
    fn flush(&mut self) {
        let (rows, forgetting, level) = (self.buffered, self.forgetting, self.level);
        if rows == 0 {
            return;
        }
        for joint in &mut self.joints {
            if forgetting < 1.0 {
                let fade = forgetting.powi(rows as i32);
                joint.products.iter_mut().for_each(|product| *product *= fade);
                for (k, row) in joint.rows.chunks_exact_mut(joint.width).take(rows).enumerate() {
                    let weight = forgetting.powi((rows - 1 - k) as i32).sqrt();
                    row.iter_mut().for_each(|entry| *entry *= weight);
                }
            }
            let JointGram { width, rows: block, products, .. } = joint;
            let (width, block) = (*width, &block[..rows * *width]);
            dispatch!(level, simd => add_products(simd, width, block, products));
        }
        self.buffered = 0;
    }

    /// `M = sum_j W_j' W_j / sigma_j^2` (p x p) and `b = sum_j W_j' tau_j / sigma_j^2` (p).
    pub fn normal_equations(&mut self, sigma: &[f64]) -> (DMatrix<f64>, DVector<f64>) {
        self.flush();
        assert_eq!(sigma.len(), self.joints.len(), "one standard deviation per joint");
        let (mut m, mut b) = (DMatrix::zeros(self.columns, self.columns), DVector::zeros(self.columns));
        for (joint, sigma) in self.joints.iter().zip(sigma) {
            let weight = 1.0 / (sigma * sigma);
            joint.add_to(weight, &mut m, &mut b);
        }
        (m, b)
    }

    /// `W_j' W_j` of one joint (p x p).
    pub fn of_joint(&mut self, j: usize) -> DMatrix<f64> {
        self.flush();
        let (mut m, mut b) = (DMatrix::zeros(self.columns, self.columns), DVector::zeros(self.columns));
        self.joints[j].add_to(1.0, &mut m, &mut b);
        m
    }

    /// `tau_j' tau_j` of every joint.
    pub fn torque_squares(&mut self) -> Vec<f64> {
        self.flush();
        self.joints.iter().map(|joint| joint.product(joint.active.len(), joint.active.len())).collect()
    }

    /// `|tau_j - W_j beta|^2` of every joint. It is a difference of large numbers: what is below some 1e-13 of `tau_j' tau_j` is rounding.
    pub fn residual_squares(&mut self, beta: &DVector<f64>) -> Vec<f64> {
        self.flush();
        assert_eq!(beta.len(), self.columns, "one parameter per column");
        self.joints
            .iter()
            .map(|joint| {
                // (beta, -1) as a vector over the row's entries: the residual is -row . vector.
                let last = joint.active.len();
                let vector = |a: usize| if a < last { beta[joint.active[a]] } else { -1.0 };
                let mut sum = 0.0;
                for a in 0..=last {
                    let mut partial = 0.5 * joint.product(a, a) * vector(a);
                    for b in a + 1..=last {
                        partial += joint.product(a, b) * vector(b);
                    }
                    sum += 2.0 * partial * vector(a);
                }
                sum.max(0.0)
            })
            .collect()
    }
}

impl JointGram {
    fn product(&self, a: usize, b: usize) -> f64 {
        self.products[a * self.width + b]
    }

    fn add_to(&self, weight: f64, m: &mut DMatrix<f64>, b: &mut DVector<f64>) {
        let last = self.active.len();
        for (a, &row) in self.active.iter().enumerate() {
            for (k, &column) in self.active.iter().enumerate().skip(a) {
                let value = weight * self.product(a, k);
                m[(row, column)] += value;
                if row != column {
                    m[(column, row)] += value;
                }
            }
            b[row] += weight * self.product(a, last);
        }
    }
}

/// Adds the products of all pairs of entries of `block`'s rows, tile by tile of the upper triangle.
#[inline(always)]
fn add_products<S: Simd>(simd: S, width: usize, block: &[f64], products: &mut [f64]) {
    for a in (0..width).step_by(4) {
        for b in (a / TILE * TILE..width).step_by(TILE) {
            add_tile(simd, width, block, products, a, b);
        }
    }
}

/// Four entries by [`TILE`] others: the sums stay in eight registers over all rows.
#[inline(always)]
fn add_tile<S: Simd>(simd: S, width: usize, block: &[f64], products: &mut [f64], a: usize, b: usize) {
    let zero = f64x4::splat(simd, 0.0);
    let mut sums = [[zero; 2]; 4];
    for row in block.chunks_exact(width) {
        let left = f64x4::from_slice(simd, &row[b..b + 4]);
        let right = f64x4::from_slice(simd, &row[b + 4..b + 8]);
        let by = &row[a..a + 4];
        for (sum, by) in sums.iter_mut().zip(by) {
            sum[0] = left.mul_add(*by, sum[0]);
            sum[1] = right.mul_add(*by, sum[1]);
        }
    }
    for (k, [left, right]) in sums.into_iter().enumerate() {
        let place = &mut products[(a + k) * width + b..][..TILE];
        let old = (f64x4::from_slice(simd, &place[..4]), f64x4::from_slice(simd, &place[4..]));
        (left + old.0).store_slice(&mut place[..4]);
        (right + old.1).store_slice(&mut place[4..]);
    }
}
