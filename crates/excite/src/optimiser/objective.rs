//! Objective of the optimiser: surrogate of the criterion plus augmented Lagrangian of the constraints, with the exact gradient.
//!
//! One evaluation runs the recursion at every sample of the grid and sums `M = W' W`. It computes the surrogate of the criterion and its
//! gradient `G = dL/dM`, then the reverse pass `dL = sum_k <2 Y_k G, dY_k>` for the regressor `Y_k` of sample k. Torques of the nominal
//! model use the same regressor and reverse pass; positions of bodies have their own.

use super::super::ExciteError;
use super::super::criterion::Criterion;
use super::super::fourier::Fourier;
use super::super::limits::Bounds;
use super::super::nominal::Nominal;
use super::super::search::Problem;
use super::adjoint::{Arm, Frame, Gradient, LinkWrenches, Tape};
use super::augmented_lagrangian::AugmentedLagrangian;
use super::columns::{Columns, LinkRows};
use super::grid::Grid;
use super::grid_limits::GridLimits;
use super::spectral::surrogate;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::{Capsule, FIRST_BOXED, LINK_COLUMNS, nearest};

/// Smoothing of the criterion and of Coulomb friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothing {
    /// Order p of the surrogate.
    pub p: f64,
    /// Slope of the smoothed sign in the friction columns \[s/rad\]. The model's slope (100) would be a step on a coarse grid.
    pub sign: f64,
}

/// Length unit of distance constraints, which scales them to order one \[m\].
const DISTANCE_SCALE_M: f64 = 0.1;
/// Distance beyond the clearance above which a pair of bodies is not computed exactly \[m\].
const MAX_EXACT_DISTANCE_M: f64 = 0.25;

/// Intermediate values of one sample of the grid.
struct Sample {
    tape: Tape,
    frames: [Frame; MAX_JOINTS],
    gradient: Gradient,
    jerk_bar: JointVec,
    tau: JointVec,
    tau_bar: JointVec,
}

/// The objective with its workspace.
pub struct Objective<'a> {
    bounds: Bounds<'a>,
    nominal: Option<&'a Nominal>,
    arm: Arm,
    gravity: Vector3<f64>,
    columns: Columns,
    criterion: Criterion,
    /// Weight of each joint's rows.
    weights: JointVec,
    /// Information matrix of the prior motions.
    prior: Option<DMatrix<f64>>,
    grid: Grid,
    fixed: Option<Vec<f64>>,
    /// Limits on the grid.
    pub limits_on_grid: GridLimits,
    /// Augmented Lagrangian.
    pub constraints: AugmentedLagrangian,
    /// Surrogate and smoothing.
    pub smoothing: Smoothing,
    // Workspace.
    samples: Vec<Sample>,
    motion: [DMatrix<f64>; 4],
    rows: Vec<DMatrix<f64>>,
    gram: DMatrix<f64>,
}

impl<'a> Objective<'a> {
    /// The objective of a problem on a grid.
    ///
    /// # Errors
    /// A term without a gradient here.
    pub fn new(problem: &Problem<'a>, grid: Grid, criterion: Criterion) -> Result<Objective<'a>, ExciteError> {
        let n = problem.bounds.chain.len();
        let columns = Columns::of(problem.structure)?;
        let mut weights = [1.0 / grid.samples() as f64; MAX_JOINTS];
        if criterion.is_weighted() {
            weights.iter_mut().zip(problem.sigma).for_each(|(weight, sigma)| *weight /= sigma * sigma);
        }
        let count = grid.samples();
        let sample = || Sample {
            tape: Tape::default(),
            frames: [Frame::base(); MAX_JOINTS],
            gradient: Gradient::default(),
            jerk_bar: JointVec::default(),
            tau: JointVec::default(),
            tau_bar: JointVec::default(),
        };
        Ok(Objective {
            bounds: problem.bounds,
            nominal: problem.nominal,
            arm: Arm::new(problem.bounds.chain),
            gravity: problem.mounting.gravity(),
            criterion,
            weights,
            prior: None,
            fixed: problem.q0.map(<[f64]>::to_vec),
            limits_on_grid: GridLimits::of(&problem.bounds),
            constraints: AugmentedLagrangian::new(1.0),
            smoothing: Smoothing { p: 1.0, sign: 10.0 },
            samples: std::iter::repeat_with(sample).take(count).collect(),
            motion: std::array::from_fn(|_| DMatrix::zeros(count, n)),
            rows: columns.rows.iter().map(|row| DMatrix::zeros(row.global.len(), count)).collect(),
            gram: DMatrix::zeros(columns.count, columns.count),
            columns,
            grid,
        })
    }

    /// Adds the information of other motions in the same mounting: the criterion is that of the stacked
    /// regressor.
    pub fn with_prior(mut self, motions: &[Fourier]) -> Objective<'a> {
        for motion in motions {
            self.load(&motion.q0, &self.grid.coordinates(motion));
            self.information();
            let sum = self.prior.take().map_or_else(|| self.gram.clone(), |prior| prior + &self.gram);
            self.prior = Some(sum);
        }
        self
    }

    /// Number of unknowns: n (2 N - 3) amplitudes, then n positions of the start where it is free.
    pub fn unknowns(&self) -> usize {
        self.arm.len() * (self.grid.free() + usize::from(self.fixed.is_none()))
    }

    /// The unknowns of a motion.
    pub fn pack(&self, fourier: &Fourier) -> Vec<f64> {
        let mut x = self.grid.coordinates(fourier);
        if self.fixed.is_none() {
            x.extend(&fourier.q0);
        }
        x
    }

    /// The motion of the unknowns.
    pub fn unpack(&self, x: &[f64]) -> Fourier {
        self.grid.fourier(self.start(x), x)
    }

    fn start<'b>(&'b self, x: &'b [f64]) -> &'b [f64] {
        self.fixed.as_deref().unwrap_or(&x[self.arm.len() * self.grid.free()..])
    }

    /// Surrogate of the criterion plus the constraints' term, and its gradient; infinite where a parameter is not excited.
    /// Panics when `x` or `gradient` does not have [`Objective::unknowns`] entries.
    pub fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
        assert_eq!((x.len(), gradient.len()), (self.unknowns(), self.unknowns()), "unknowns");
        let q0 = self.start(x).to_vec();
        self.load(&q0, x);
        self.information();
        let total = match &self.prior {
            Some(prior) => &self.gram + prior,
            None => self.gram.clone(),
        };
        let Smoothing { p, .. } = self.smoothing;
        let Some((value, by_gram)) = surrogate(self.criterion, &total, self.columns.rigid, p) else {
            return f64::INFINITY;
        };
        self.constrain();
        self.backward(&by_gram);
        self.gradient_of_unknowns(gradient);
        value + self.constraints.psi()
    }

    /// Computes positions, derivatives and the recursion at every sample.
    fn load(&mut self, q0: &[f64], x: &[f64]) {
        let (n, free) = (self.arm.len(), self.grid.free());
        let coordinates = nalgebra::DMatrixView::from_slice(&x[..n * free], free, n);
        let bases = [&self.grid.q, &self.grid.dq, &self.grid.ddq, &self.grid.jerk];
        for (motion, basis) in self.motion.iter_mut().zip(bases) {
            motion.gemm(1.0, basis, &coordinates, 0.0);
        }
        for (j, &q0) in q0.iter().enumerate().take(n) {
            self.motion[0].column_mut(j).add_scalar_mut(q0);
        }
        for (k, sample) in self.samples.iter_mut().enumerate() {
            let at =
                |m: &DMatrix<f64>| std::array::from_fn::<f64, MAX_JOINTS, _>(|j| if j < n { m[(k, j)] } else { 0.0 });
            let [q, dq, ddq] = [0, 1, 2].map(|d| at(&self.motion[d]));
            sample.tape.forward(&self.arm, &self.gravity, &q, &dq, &ddq);
        }
    }

    /// Computes `M` from the rows of all samples.
    fn information(&mut self) {
        self.gram.fill(0.0);
        for (j, (layout, rows)) in self.columns.rows.iter().zip(&mut self.rows).enumerate() {
            for (k, sample) in self.samples.iter().enumerate() {
                let mut column = rows.column_mut(k);
                let mut link = (usize::MAX, [0.0; LINK_COLUMNS]);
                for (c, &(i, parameter)) in layout.rigid.iter().enumerate() {
                    if link.0 != i {
                        link = (i, sample.tape.row(i, j));
                    }
                    column[c] = link.1[parameter];
                }
                let (dq, ddq) = (self.motion[1][(k, j)], self.motion[2][(k, j)]);
                for (c, own) in layout.own.iter().enumerate() {
                    column[layout.rigid.len() + c] = own.value(dq, ddq, self.smoothing.sign).0;
                }
            }
            let block = &*rows * rows.transpose();
            for (c, &to) in layout.global.iter().enumerate() {
                for (r, &row) in layout.global.iter().enumerate() {
                    self.gram[(row, to)] += self.weights[j] * block[(r, c)];
                }
            }
        }
    }

    /// Evaluates all constraints and adds their gradients to the samples.
    fn constrain(&mut self) {
        for sample in &mut self.samples {
            (sample.gradient, sample.jerk_bar, sample.tau_bar) = Default::default();
        }
        self.constraints.start();
        self.constrain_joints();
        if let Some(nominal) = self.nominal {
            self.constrain_torques(nominal);
        }
        if self.bounds.workspace.is_some() || self.bounds.shape.is_some() {
            self.constrain_space();
        }
    }

    fn constrain_joints(&mut self) {
        let (limits_on_grid, constraints, limits) = (&self.limits_on_grid, &mut self.constraints, self.bounds.limits);
        for j in 0..self.arm.len() {
            let range = 0.5 * (limits.q_max[j] - limits.q_min[j]);
            for (k, sample) in self.samples.iter_mut().enumerate() {
                let [q, dq, ddq, jerk] = [0, 1, 2, 3].map(|d| self.motion[d][(k, j)]);
                let out = &mut sample.gradient;
                out.q[j] += constraints.next((q - limits_on_grid.q_max[j]) / range) / range;
                out.q[j] -= constraints.next((limits_on_grid.q_min[j] - q) / range) / range;
                let most = limits.dq[j];
                for (sign, room) in [(1.0, limits.q_max[j] - q), (-1.0, q - limits.q_min[j])] {
                    let (speed, speed_derivative) = self.bounds.envelope.map_or((most, 0.0), |e| e.at(j, room, most));
                    let slope = constraints.next((sign * dq - limits_on_grid.speed[j] * speed) / most) / most;
                    out.dq[j] += sign * slope;
                    out.q[j] += sign * slope * limits_on_grid.speed[j] * speed_derivative;
                }
                for (value, cap, bar) in [
                    (ddq, limits_on_grid.ddq[j], &mut out.ddq[j]),
                    (jerk, limits_on_grid.jerk[j], &mut sample.jerk_bar[j]),
                ] {
                    *bar += (constraints.next(value / cap - 1.0) - constraints.next(-value / cap - 1.0)) / cap;
                }
            }
        }
    }

    fn constrain_torques(&mut self, nominal: &Nominal) {
        let (n, count) = (self.arm.len(), self.samples.len());
        for (k, sample) in self.samples.iter_mut().enumerate() {
            for j in 0..n {
                let (dq, ddq) = (self.motion[1][(k, j)], self.motion[2][(k, j)]);
                let mut tau = nominal.offset[j] + nominal.fv[j] * dq + nominal.rotor[j] * ddq;
                for (i, link) in nominal.links.iter().enumerate().skip(j) {
                    tau += sample.tape.row(i, j).iter().zip(link).map(|(y, delta)| y * delta).sum::<f64>();
                }
                sample.tau[j] = tau;
            }
        }
        let step = self.grid.step();
        // Fourth-order differences over the periodic grid: d/dt tau = sum_m D_m (tau_{k+m} - tau_{k-m}).
        let difference = [(1, 2.0 / (3.0 * step)), (2, -1.0 / (12.0 * step))];
        let wrap = |k: usize, by: isize| (k as isize + by).rem_euclid(count as isize) as usize;
        for j in 0..n {
            let (tau_max, rate_max) = (self.limits_on_grid.tau[j], self.limits_on_grid.dtau[j]);
            for k in 0..count {
                let dq = self.motion[1][(k, j)];
                let sign = (self.smoothing.sign * dq).tanh();
                let value = (self.samples[k].tau[j] + nominal.fc[j] * sign) / tau_max;
                let slope = (self.constraints.next(value - 1.0) - self.constraints.next(-value - 1.0)) / tau_max;
                self.samples[k].tau_bar[j] += slope;
                self.samples[k].gradient.dq[j] += slope * nominal.fc[j] * self.smoothing.sign * (1.0 - sign * sign);
                let tau = |by| self.samples[wrap(k, by)].tau[j];
                let rate: f64 = difference.iter().map(|&(m, d)| d * (tau(m) - tau(-m))).sum::<f64>() / rate_max;
                let slope = (self.constraints.next(rate - 1.0) - self.constraints.next(-rate - 1.0)) / rate_max;
                if slope != 0.0 {
                    for (m, d) in difference {
                        self.samples[wrap(k, m)].tau_bar[j] += slope * d;
                        self.samples[wrap(k, -m)].tau_bar[j] -= slope * d;
                    }
                }
            }
        }
        for sample in &mut self.samples {
            for j in 0..n {
                sample.gradient.dq[j] += sample.tau_bar[j] * nominal.fv[j];
                sample.gradient.ddq[j] += sample.tau_bar[j] * nominal.rotor[j];
            }
        }
    }

    fn constrain_space(&mut self) {
        let n = self.arm.len();
        let (limits_on_grid, constraints, workspace) =
            (&self.limits_on_grid, &mut self.constraints, self.bounds.workspace);
        let mut ends: Vec<[Vector3<f64>; 2]> = Vec::new();
        for sample in &mut self.samples {
            sample.tape.place(n, &mut sample.frames);
            let frames = &sample.frames;
            let mut wrenches = LinkWrenches::default();
            if workspace.is_some() {
                let at = frames[n - 1].point(self.arm.flange());
                keep_in_box(constraints, &limits_on_grid.end, n - 1, &at, 0.0, &mut wrenches);
                keep_off_base(constraints, limits_on_grid.radius, n - 1, &at, &mut wrenches);
            }
            if let Some(shape) = self.bounds.shape {
                ends.clear();
                ends.extend(shape.capsules().iter().map(|capsule| {
                    let frame = if capsule.link == 0 { Frame::base() } else { frames[capsule.link - 1] };
                    [capsule.from, capsule.to].map(|end| frame.point(&Vector3::from(end)))
                }));
                let links_in_box = workspace.is_some() && self.bounds.links_in_box;
                let boxed = |capsule: &Capsule| links_in_box && capsule.link >= FIRST_BOXED;
                for (capsule, ends) in shape.capsules().iter().zip(&ends).filter(|(capsule, _)| boxed(capsule)) {
                    for at in ends {
                        keep_in_box(
                            constraints,
                            &limits_on_grid.links,
                            capsule.link - 1,
                            at,
                            capsule.radius,
                            &mut wrenches,
                        );
                    }
                }
                for &(a, b) in shape.pairs() {
                    let bodies = [&shape.capsules()[a], &shape.capsules()[b]];
                    keep_apart(constraints, limits_on_grid.clearance, bodies, [&ends[a], &ends[b]], &mut wrenches);
                }
            }
            wrenches.backward(&self.arm, frames, &mut sample.gradient);
        }
    }

    /// Reverse pass from `dL/dM` and the torque constraints to the samples.
    fn backward(&mut self, by_gram: &DMatrix<f64>) {
        let n = self.arm.len();
        let bars: Vec<DMatrix<f64>> = (0..n)
            .map(|j| {
                let global = &self.columns.rows[j].global;
                let part = DMatrix::from_fn(global.len(), global.len(), |r, c| by_gram[(global[r], global[c])]);
                (part * &self.rows[j]) * (2.0 * self.weights[j])
            })
            .collect();
        let mut bar: LinkRows = [[[0.0; LINK_COLUMNS]; MAX_JOINTS]; MAX_JOINTS];
        for (k, sample) in self.samples.iter_mut().enumerate() {
            for (j, layout) in self.columns.rows.iter().enumerate() {
                for (i, bar) in bar.iter_mut().enumerate().take(n).skip(j) {
                    bar[j] = match self.nominal {
                        Some(nominal) if sample.tau_bar[j] != 0.0 => {
                            nominal.links[i].map(|delta| delta * sample.tau_bar[j])
                        }
                        _ => [0.0; LINK_COLUMNS],
                    };
                }
                let column = bars[j].column(k);
                for (c, &(i, parameter)) in layout.rigid.iter().enumerate() {
                    bar[i][j][parameter] += column[c];
                }
                let (dq, ddq) = (self.motion[1][(k, j)], self.motion[2][(k, j)]);
                for (c, own) in layout.own.iter().enumerate() {
                    let (_, by_dq, by_ddq) = own.value(dq, ddq, self.smoothing.sign);
                    sample.gradient.dq[j] += column[layout.rigid.len() + c] * by_dq;
                    sample.gradient.ddq[j] += column[layout.rigid.len() + c] * by_ddq;
                }
            }
            sample.tape.backward(&self.arm, &bar, &mut sample.gradient);
        }
    }

    /// Reverse pass from the samples to the unknowns.
    fn gradient_of_unknowns(&mut self, gradient: &mut [f64]) {
        let (n, free) = (self.arm.len(), self.grid.free());
        gradient.fill(0.0);
        let bases = [&self.grid.q, &self.grid.dq, &self.grid.ddq, &self.grid.jerk];
        for j in 0..n {
            for (k, sample) in self.samples.iter().enumerate() {
                let bars = [sample.gradient.q[j], sample.gradient.dq[j], sample.gradient.ddq[j], sample.jerk_bar[j]];
                for c in 0..free {
                    gradient[j * free + c] +=
                        bases.iter().zip(bars).map(|(basis, bar)| basis[(k, c)] * bar).sum::<f64>();
                }
                if self.fixed.is_none() {
                    gradient[n * free + j] += bars[0];
                }
            }
        }
    }
}

/// Constraint: a ball of `radius` around the point `at` of link `i` (from 0) stays in a box.
fn keep_in_box(
    constraints: &mut AugmentedLagrangian,
    sides: &[[f64; 3]; 2],
    i: usize,
    at: &Vector3<f64>,
    radius: f64,
    wrenches: &mut LinkWrenches,
) {
    let mut slope = Vector3::zeros();
    for axis in 0..3 {
        slope[axis] -= constraints.next((sides[0][axis] + radius - at[axis]) / DISTANCE_SCALE_M) / DISTANCE_SCALE_M;
        slope[axis] += constraints.next((at[axis] + radius - sides[1][axis]) / DISTANCE_SCALE_M) / DISTANCE_SCALE_M;
    }
    if slope != Vector3::zeros() {
        wrenches.add(i, at, &slope);
    }
}

/// Constraint: the point `at` of link `i` (from 0) stays out of the sphere around the base.
fn keep_off_base(
    constraints: &mut AugmentedLagrangian,
    radius: f64,
    i: usize,
    at: &Vector3<f64>,
    wrenches: &mut LinkWrenches,
) {
    let distance = at.norm();
    let slope = constraints.next((radius - distance) / DISTANCE_SCALE_M) / DISTANCE_SCALE_M;
    if slope != 0.0 && distance > 0.0 {
        wrenches.add(i, at, &(at * (-slope / distance)));
    }
}

/// Constraint: two bodies keep a distance of `clearance`.
fn keep_apart(
    constraints: &mut AugmentedLagrangian,
    clearance: f64,
    bodies: [&Capsule; 2],
    ends: [&[Vector3<f64>; 2]; 2],
    wrenches: &mut LinkWrenches,
) {
    let apart = clearance + bodies[0].radius + bodies[1].radius;
    // Bounding balls of the segments give a lower bound of the distance, sufficient for most pairs.
    let half = |e: &[Vector3<f64>; 2]| 0.5 * (e[1] - e[0]).norm();
    let centres = 0.5 * (ends[1][0] + ends[1][1] - ends[0][0] - ends[0][1]);
    let least = centres.norm() - half(ends[0]) - half(ends[1]);
    if least > apart + MAX_EXACT_DISTANCE_M {
        constraints.next((apart - least) / DISTANCE_SCALE_M);
        return;
    }
    let near = nearest(ends[0], ends[1]);
    let distance = near.between.norm();
    let slope = constraints.next((apart - distance) / DISTANCE_SCALE_M) / DISTANCE_SCALE_M;
    if slope != 0.0 && distance > 0.0 {
        let along = near.between * (slope / distance);
        // The base (link 0) does not move.
        for (body, ends, share, along) in [(bodies[0], ends[0], near.s, along), (bodies[1], ends[1], near.t, -along)] {
            if body.link > 0 {
                wrenches.add(body.link - 1, &(ends[0] + (ends[1] - ends[0]) * share), &along);
            }
        }
    }
}
