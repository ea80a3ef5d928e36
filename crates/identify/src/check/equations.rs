//! The equations of motion of one run, for any direction of gravity and any lag of the torques.
//!
//! The regressor is affine in the direction of gravity, `W(u) = W_0 + sum_i u_i W_i`: four evaluations give it for every mounting. Rows are means over
//! blocks of samples, which filter regressor and torque alike.

use crate::{EstimateError, Experiment, Run, Settings};
use nalgebra::{Cholesky, DMatrix, DVector, Vector3};
use plumbline_core::transposed_product;
use plumbline_model::term::Motion;
use plumbline_model::{G, Reduction, Robot, Structure, TorqueSensing};

/// Length of a block \[s\].
const BLOCK_S: f64 = 0.04;
/// Most blocks of a run, spread evenly.
const MAX_BLOCKS: usize = 300;
/// Speed below which a joint is at rest \[rad/s\]; blocks of an arm at rest have no determined Coulomb friction.
const REST_SPEED: f64 = 0.01;
/// Sampling rate to which a faster recording is averaged \[Hz\].
const MAX_RATE_HZ: f64 = 250.0;
/// Regularisation of equilibrated columns, relative to the equations.
const RIDGE: f64 = 1e-9;
/// Rounds of reweighting by the joints' residuals.
const ROUNDS: usize = 3;
/// Least residual of a joint as a share of its torque's deviation.
const MIN_RESIDUAL_RATIO: f64 = 1e-4;
/// Largest lag of a torque \[s\].
pub(super) const MAX_LAG_S: f64 = 0.3;

/// The arm in any mounting, with friction, offsets and, for motor-side torques, rotor inertia.
pub(super) fn structure(robot: &Robot) -> Option<Structure> {
    let terms: &[&str] = match robot.torque_sensing {
        TorqueSensing::Link => &["friction", "torque-offset"],
        TorqueSensing::Motor => &["friction", "torque-offset", "rotor-inertia"],
    };
    Structure::of(robot.chain.clone(), Reduction::any_mounting(&robot.chain), terms).ok()
}

/// One run, prepared.
pub(super) struct Prepared {
    motion: Motion,
    tau: DMatrix<f64>,
    /// First sample of every block.
    blocks: Vec<usize>,
    /// Samples of a block.
    length: usize,
}

impl Prepared {
    /// # Errors
    /// Samples that can't be processed.
    pub fn of(run: &Run) -> Result<Prepared, EstimateError> {
        let run = Run { period: None, ..averaged(run) };
        let settings =
            Settings { torque_cutoff: 4.0, measured_velocities: true, rest: Some(REST_SPEED), ..Settings::default() };
        let experiment = Experiment::prepare(&run, &settings)?;
        let motion = experiment.motion.clone();
        let length = ((BLOCK_S / motion.dt).round() as usize).max(1);
        let margin = (MAX_LAG_S / motion.dt).ceil() as usize + 1;
        let last = motion.samples().saturating_sub(margin + length);
        let moving = |first: &usize| !experiment.resting()[*first..first + length].contains(&true);
        let all: Vec<usize> = (margin..last.max(margin)).step_by(length).filter(moving).collect();
        let stride = all.len() as f64 / MAX_BLOCKS.min(all.len()).max(1) as f64;
        let blocks = (0..MAX_BLOCKS.min(all.len())).map(|k| all[(k as f64 * stride) as usize]).collect();
        Ok(Prepared { motion, tau: experiment.tau, blocks, length })
    }

    /// Number of blocks, m.
    pub fn len(&self) -> usize {
        self.blocks.len()
    }

    /// Time between samples \[s\].
    pub fn dt(&self) -> f64 {
        self.motion.dt
    }

    /// The motion at the blocks' samples, block by block.
    pub fn motion(&self) -> Motion {
        let rows: Vec<usize> = self.blocks.iter().flat_map(|&first| first..first + self.length).collect();
        let select = |of: &DMatrix<f64>| of.select_rows(&rows);
        let Motion { q, dq, ddq, .. } = &self.motion;
        Motion { q: select(q), dq: select(dq), ddq: select(ddq), periodic: false, ..self.motion }
    }

    /// Torques that were recorded `lag` after the motion, means over the blocks, m x n \[Nm\].
    pub fn torques(&self, lag: f64) -> DMatrix<f64> {
        let at = lag / self.motion.dt;
        let (whole, part) = (at.floor() as isize, at - at.floor());
        DMatrix::from_fn(self.blocks.len(), self.tau.ncols(), |k, j| {
            let value = |row: usize| {
                let row = row as isize + whole;
                let clamp = |row: isize| row.clamp(0, self.tau.nrows() as isize - 1) as usize;
                (1.0 - part) * self.tau[(clamp(row), j)] + part * self.tau[(clamp(row + 1), j)]
            };
            (self.blocks[k]..self.blocks[k] + self.length).map(value).sum::<f64>() / self.length as f64
        })
    }

    /// Means over the blocks of a regressor along [`Prepared::motion`], per joint, m x p.
    fn means(&self, y: &DMatrix<f64>, joints: usize) -> Vec<DMatrix<f64>> {
        let (m, samples) = (self.blocks.len(), self.blocks.len() * self.length);
        let of = |j: usize| {
            DMatrix::from_fn(m, y.ncols(), |k, c| {
                let first = j * samples + k * self.length;
                (first..first + self.length).map(|row| y[(row, c)]).sum::<f64>() / self.length as f64
            })
        };
        (0..joints).map(of).collect()
    }

    /// The equations of this structure along `motion`, in the mounting of the motion.
    pub fn system(&self, structure: &Structure, motion: &Motion) -> System {
        System::new(self.means(&structure.regressor(motion), motion.joints()))
    }

    /// The regressor of this structure along `motion`, for every direction of gravity.
    pub fn equations(&self, structure: &Structure, motion: &Motion) -> Equations {
        let along = |gravity: Vector3<f64>| {
            self.means(&structure.regressor(&Motion { gravity, ..motion.clone() }), motion.joints())
        };
        let free = along(Vector3::zeros());
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| {
            let mut with = along(G * axis);
            with.iter_mut().zip(&free).for_each(|(with, free)| *with -= free);
            with
        });
        Equations { free, axes }
    }
}

/// A recording of more than [`MAX_RATE_HZ`], averaged over whole numbers of samples.
fn averaged(run: &Run) -> Run {
    let factor = (1.0 / (MAX_RATE_HZ * super::samples::step(run))).round().max(1.0) as usize;
    if factor == 1 {
        return run.clone();
    }
    let rows = run.samples() / factor;
    let mean = |of: &DMatrix<f64>| {
        DMatrix::from_fn(rows, of.ncols(), |k, j| of.view((k * factor, j), (factor, 1)).sum() / factor as f64)
    };
    Run {
        name: run.name.clone(),
        t: (0..rows).map(|k| run.t[k * factor..(k + 1) * factor].iter().sum::<f64>() / factor as f64).collect(),
        q: mean(&run.q),
        dq: run.dq.as_ref().map(mean),
        tau: mean(&run.tau),
        ..*run
    }
}

/// Regressor of one run for every direction of gravity: without gravity, and what gravity along each axis adds; per joint, m x p.
pub(super) struct Equations {
    free: Vec<DMatrix<f64>>,
    axes: [Vec<DMatrix<f64>>; 3],
}

impl Equations {
    /// With gravity in this direction.
    pub fn towards(&self, gravity: &Vector3<f64>) -> System {
        let u = gravity.normalize();
        let of = |j: usize| {
            let mut w = self.free[j].clone();
            for (axis, share) in self.axes.iter().zip(u.iter()) {
                w += &axis[j] * *share;
            }
            w
        };
        System::new((0..self.free.len()).map(of).collect())
    }
}

/// The equations in one mounting, per joint.
pub(super) struct System {
    w: Vec<DMatrix<f64>>,
    gram: Vec<DMatrix<f64>>,
}

/// Weighted least squares of a system.
pub(super) struct Fit {
    /// Parameters, p.
    pub beta: DVector<f64>,
    /// RMS of the residual per joint, n \[Nm\].
    pub sigma: Vec<f64>,
    /// Inverse of the weighted normal matrix, p x p.
    pub covariance: DMatrix<f64>,
    /// Residuals, m x n \[Nm\].
    pub residual: DMatrix<f64>,
}

impl Fit {
    /// Logarithm of the product of the joints' residuals: the log likelihood of one sample, but for a constant and its sign.
    pub fn score(&self) -> f64 {
        self.sigma.iter().map(|sigma| sigma.ln()).sum()
    }
}

impl System {
    fn new(w: Vec<DMatrix<f64>>) -> System {
        let gram = w.iter().map(|w| transposed_product(w, w)).collect();
        System { w, gram }
    }

    /// The systems of several runs of one arm, one below the other.
    pub fn stacked(of: &[&System]) -> System {
        let joints = of.first().map_or(0, |first| first.w.len());
        let stack = |j: usize| {
            let parts: Vec<&DMatrix<f64>> = of.iter().map(|system| &system.w[j]).collect();
            stack_rows(&parts)
        };
        System::new((0..joints).map(stack).collect())
    }

    /// Modelled torques, m x n \[Nm\].
    pub fn modelled(&self, beta: &DVector<f64>) -> DMatrix<f64> {
        DMatrix::from_columns(&self.w.iter().map(|w| w * beta).collect::<Vec<_>>())
    }

    /// RMS of a joint's torque that errors of the parameters with this covariance cause.
    pub fn spread(&self, joint: usize, covariance: &DMatrix<f64>) -> f64 {
        (covariance.dot(&self.gram[joint]) / self.w[joint].nrows() as f64).max(0.0).sqrt()
    }

    /// Weighted least squares to `tau`, m x n, with weights by the joints' residuals; `None` where the equations are not finite.
    pub fn fit(&self, tau: &DMatrix<f64>) -> Option<Fit> {
        let n = tau.ncols();
        let right: Vec<DVector<f64>> = (0..n).map(|j| self.w[j].tr_mul(&tau.column(j))).collect();
        let floor: Vec<f64> =
            (0..n).map(|j| (MIN_RESIDUAL_RATIO * super::deviation(tau.column(j).as_slice())).max(1e-9)).collect();
        let mut sigma: Vec<f64> = floor.iter().map(|floor| floor / MIN_RESIDUAL_RATIO).collect();
        let mut last = None;
        for _ in 0..ROUNDS {
            let p = right.first()?.len();
            let (mut normal, mut b) = (DMatrix::zeros(p, p), DVector::zeros(p));
            for j in 0..n {
                let weight = sigma[j].powi(-2);
                normal += &self.gram[j] * weight;
                b.axpy(weight, &right[j], 1.0);
            }
            let scale = normal.diagonal().map(|d| if d > 0.0 { d.sqrt().recip() } else { 1.0 });
            let mut scaled = DMatrix::from_fn(p, p, |i, k| scale[i] * normal[(i, k)] * scale[k]);
            for i in 0..p {
                scaled[(i, i)] += RIDGE;
            }
            let inverse = Cholesky::new(scaled)?.inverse();
            let covariance = DMatrix::from_fn(p, p, |i, k| scale[i] * inverse[(i, k)] * scale[k]);
            let beta = &covariance * &b;
            let residual = tau - self.modelled(&beta);
            sigma =
                (0..n).map(|j| (residual.column(j).norm_squared() / tau.nrows() as f64).sqrt().max(floor[j])).collect();
            last = Some(Fit { beta, sigma: sigma.clone(), covariance, residual });
        }
        last.filter(|fit| fit.score().is_finite())
    }
}

/// Matrices with the same columns, one below the other.
pub(super) fn stack_rows(of: &[&DMatrix<f64>]) -> DMatrix<f64> {
    let (rows, columns) = (of.iter().map(|part| part.nrows()).sum(), of.first().map_or(0, |first| first.ncols()));
    let mut all = DMatrix::zeros(rows, columns);
    let mut first = 0;
    for part in of {
        all.rows_mut(first, part.nrows()).copy_from(part);
        first += part.nrows();
    }
    all
}
