//! Base parameters: the independent combinations of standard parameters that the joint torques determine.

use super::chain::{Chain, JointKind};
use super::gravity::{Mounting, VERTICAL_TOLERANCE};
use super::regressor::{LINK_COLUMNS, regressor};
use nalgebra::{DMatrix, DVector, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Which mountings a base parameter set predicts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BaseKind {
    /// Generalized base set: valid in any mounting.
    Gbs,
    /// Vertical base-axis set: gravity along axis 1, valid only there.
    Vbs,
}

/// `GBS` or `VBS`.
impl std::fmt::Display for BaseKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            BaseKind::Gbs => "GBS",
            BaseKind::Vbs => "VBS",
        })
    }
}

/// Linear map from standard to base parameters, `beta = regroup * delta`.
#[derive(Clone, Debug)]
pub struct Reduction {
    kind: BaseKind,
    independent: Vec<usize>,
    regroup: DMatrix<f64>,
}

/// Ratio of a column's norm after and before projection on the earlier columns, below which the column is dependent.
pub(super) const INDEPENDENCE: f64 = 1e-8;
/// Random states used; each gives n rows.
const STATES: usize = 120;

impl Reduction {
    /// The set that any mounting can need: gravity points anywhere.
    pub fn any_mounting(chain: &Chain) -> Reduction {
        let mut reduction = reduce(chain, None);
        reduction.kind = BaseKind::Gbs;
        reduction
    }

    /// The set that can be identified in one mounting. It is the GBS when it spans as much as every mounting needs.
    ///
    /// Gravity within [`VERTICAL_TOLERANCE`] of axis 1 counts as parallel to it.
    pub fn in_mounting(chain: &Chain, mounting: &Mounting) -> Reduction {
        let generalized = Reduction::any_mounting(chain);
        let along = mounting.is_along_axis_1(VERTICAL_TOLERANCE);
        let here = reduce(chain, Some(if along { Mounting::UPRIGHT.gravity() } else { mounting.gravity() }));
        if here.len() == generalized.len() { generalized } else { here }
    }

    /// The set of one kind; the GBS for an arm whose torques contain the same parameters in every mounting.
    pub fn of_kind(chain: &Chain, kind: BaseKind) -> Reduction {
        match kind {
            BaseKind::Gbs => Reduction::any_mounting(chain),
            BaseKind::Vbs => Reduction::in_mounting(chain, &Mounting::UPRIGHT),
        }
    }

    /// GBS or VBS.
    pub fn kind(&self) -> BaseKind {
        self.kind
    }

    /// Number of base parameters.
    pub fn len(&self) -> usize {
        self.independent.len()
    }

    /// Whether no parameter can be identified.
    pub fn is_empty(&self) -> bool {
        self.independent.is_empty()
    }

    /// Standard parameter whose slot each base parameter takes: `10 * link + position` in `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`.
    pub fn independent(&self) -> &[usize] {
        &self.independent
    }

    /// `beta = regroup * delta` (b x 10 n).
    pub fn regroup(&self) -> &DMatrix<f64> {
        &self.regroup
    }

    /// Base parameters of given standard parameters (10 n).
    pub fn base_of(&self, delta: &DVector<f64>) -> DVector<f64> {
        &self.regroup * delta
    }
}

/// Slots in the order in which they are selected. The usual regrouping (Gautier, Khalil) moves `Lyy, lz, m` of a revolute link
/// and the whole inertia of a prismatic one towards the base, so those are last.
fn order(chain: &Chain) -> Vec<usize> {
    let kept = |kind| match kind {
        JointKind::Revolute => [0, 1, 2, 4, 5, 6, 7].as_slice(),
        JointKind::Prismatic => [6, 7, 8, 9].as_slice(),
    };
    let slots = |keep: bool| {
        chain.joints().iter().enumerate().flat_map(move |(link, joint)| {
            (0..LINK_COLUMNS)
                .filter(move |slot| kept(joint.kind).contains(slot) == keep)
                .map(move |slot| link * LINK_COLUMNS + slot)
        })
    };
    slots(true).chain(slots(false)).collect()
}

/// Greedy column selection with two-pass Gram-Schmidt on regressors of random states.
#[expect(clippy::expect_used, reason = "runs when a model is made, before the loop")]
fn reduce(chain: &Chain, gravity: Option<Vector3<f64>>) -> Reduction {
    let n = chain.len();
    let w = random_regressor(chain, gravity);
    let scale = w.norm() / (w.ncols() as f64).sqrt();
    let mut basis: Vec<DVector<f64>> = Vec::new();
    let mut independent = Vec::new();
    let mut dependent = Vec::new();
    for slot in order(chain) {
        let column = w.column(slot).into_owned();
        let norm = column.norm();
        let rest = project_out(&basis, column);
        if norm > INDEPENDENCE * scale && rest.norm() > INDEPENDENCE * norm {
            basis.push(rest.normalize());
            independent.push(slot);
        } else {
            dependent.push(slot);
        }
    }
    // Sorted by link; the map does not depend on the order of selection.
    independent.sort_unstable();
    let kept = DMatrix::from_columns(&independent.iter().map(|&slot| w.column(slot)).collect::<Vec<_>>());
    let qr = kept.qr();
    let (q, r) = (qr.q(), qr.r());
    let mut regroup = DMatrix::zeros(independent.len(), n * LINK_COLUMNS);
    for (row, &slot) in independent.iter().enumerate() {
        regroup[(row, slot)] = 1.0;
    }
    for slot in dependent {
        let coefficients = r.solve_upper_triangular(&(q.transpose() * w.column(slot))).expect("independent columns");
        for (row, &value) in coefficients.iter().enumerate() {
            regroup[(row, slot)] = tidy(value);
        }
    }
    Reduction { kind: BaseKind::Vbs, independent, regroup }
}

/// What an orthonormal basis leaves of a vector. The second pass removes the rounding of the first.
pub(super) fn project_out(basis: &[DVector<f64>], mut vector: DVector<f64>) -> DVector<f64> {
    for q in basis.iter().chain(basis) {
        let along = q.dot(&vector);
        vector.axpy(-along, q, 1.0);
    }
    vector
}

/// Rounds zeros and ones. Any other coefficient is a sum of products of the arm's lengths and is not rounded.
fn tidy(value: f64) -> f64 {
    if (value - value.round()).abs() < 1e-9 { value.round() } else { value }
}

fn random_regressor(chain: &Chain, gravity: Option<Vector3<f64>>) -> DMatrix<f64> {
    let n = chain.len();
    let mut rng = ChaCha8Rng::seed_from_u64(0x706c_756d_6220);
    let mut stacked = DMatrix::zeros(STATES * n, n * LINK_COLUMNS);
    let mut y = DMatrix::zeros(n, n * LINK_COLUMNS);
    for k in 0..STATES {
        let mut draw = |span: f64| (0..n).map(|_| rng.random_range(-span..span)).collect::<Vec<f64>>();
        let (q, dq, ddq) = (draw(3.0), draw(2.0), draw(4.0));
        let gravity = gravity.unwrap_or_else(|| {
            Mounting { rho: rng.random_range(0.0..3.1), phi: rng.random_range(-3.1..3.1) }.gravity()
        });
        regressor(chain, &gravity, &q, &dq, &ddq, &mut y);
        stacked.rows_mut(k * n, n).copy_from(&y);
    }
    stacked
}
