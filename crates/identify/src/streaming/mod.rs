//! Recursive least-squares identification: one sample at a time, parameters at any time, constant memory.
//!
//! The live watch does not use this module yet; it is needed for live identification. Only tests and `benches/speed.rs` call it.
//!
//! Positions and torques go through one causal low-pass, positions are differentiated, the regressor is computed, and torques and
//! every column go through a second, narrower low-pass; every `decimation`-th row enters the normal equations of its joint
//! ([`gram::Gram`]). [`Streaming::estimate`] gives the least-squares solution of those rows, equal to the batch solution but for rounding.
//!
//! The causal low-passes delay both sides of the equation alike. The first low-pass affects motion and torque
//! equally as far as its delay is constant over the motion's frequencies: its cut-off must be several times the motion's bandwidth.

pub mod filter;
pub mod gram;
pub mod solve;

use super::signal::{SignalError, butterworth::Butterworth, decimation};
use filter::Bank;
use gram::Gram;
use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::term::Sample;
use plumbline_model::{SampleRegressor, Structure};
use solve::{Solution, solve};

/// Number of rounds of weights from residuals.
const ROUNDS: usize = 3;
/// Minimum ratio of a joint's noise to its torque: the residual is a difference of squares, exact to 1e-13 of them.
const MIN_NOISE_RATIO: f64 = 1e-6;
/// Share of a parameter in undetermined directions above which it is undetermined.
const UNDETERMINED_SHARE: f64 = 1e-3;
/// Number of lags of the residual's correlation.
const LAGS: usize = 8;
/// Minimum number of residuals for their correlation.
const MIN_RESIDUALS: usize = 200;

/// Settings of filters and forgetting.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Cut-off of the low-pass on positions and torques before the positions are differentiated \[Hz\].
    pub position_cutoff: f64,
    /// Order of that low-pass, even.
    pub position_order: usize,
    /// Cut-off of the low-pass on torques and columns \[Hz\].
    pub torque_cutoff: f64,
    /// Order of that low-pass, even.
    pub torque_order: usize,
    /// Decimation factor; absent: paper eq. 16 for twice the torque cut-off.
    pub decimation: Option<usize>,
    /// Forgetting factor per kept row: 1 for no forgetting, `1 - 1 / m` for a memory of about `m` rows.
    pub forgetting: f64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            position_cutoff: 20.0,
            position_order: 4,
            torque_cutoff: 5.0,
            torque_order: 8,
            decimation: None,
            forgetting: 1.0,
        }
    }
}

/// Error of the recursive estimator.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum StreamingError {
    /// Invalid low-pass settings.
    #[error(transparent)]
    Signal(#[from] SignalError),
    #[error("term `{id}` depends on more than one sample: it can't be estimated one by one")]
    Term { id: &'static str },
    #[error("forgetting factor {value}: expected more than 0 and at most 1")]
    Forgetting { value: f64 },
    #[error("{rows} equations so far for {columns} parameters")]
    TooFewRows { rows: usize, columns: usize },
    #[error("the normal equations of {columns} parameters have no eigenvalues (are all samples finite?)")]
    Decomposition { columns: usize },
}

/// A sample was not finite and was ignored; the low-passes are restarted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("joint {joint}: the sample is not a finite number")]
pub struct NotFinite {
    /// Joint, counted from 1.
    pub joint: usize,
}

/// Estimated parameters with their uncertainty.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// Parameters in the order of the structure's columns. Undetermined ones are those of the minimum-norm solution.
    pub beta: Vec<f64>,
    /// Standard deviations of the parameters; `None` for undetermined ones.
    pub std: Vec<Option<f64>>,
    /// Covariance of the parameters in the determined directions.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of each joint's filtered torque, n \[Nm\]: from the residual, and the weight of the joint.
    pub sigma: Vec<f64>,
    /// Factor of each joint's variance by the correlation between kept rows, n: 1 without correlation.
    pub correlation: Vec<f64>,
    /// Equations, all joints together.
    pub rows: usize,
    /// Number of determined directions.
    pub rank: usize,
    /// Condition number of the weighted, equilibrated regressor.
    pub condition: f64,
}

/// The recursive estimator. [`Streaming::push`] allocates nothing.
#[derive(Clone, Debug)]
pub struct Streaming {
    regressor: SampleRegressor,
    rate: f64,
    /// Positions and torques.
    first: Bank,
    /// Columns and torques.
    second: Bank,
    /// The last two filtered positions and the last filtered torque: derivatives are central, one sample late.
    before: [JointVec; 2],
    torque_before: JointVec,
    /// The columns, then the torque.
    values: Vec<[f64; MAX_JOINTS]>,
    gram: Gram,
    /// Samples since the low-passes started.
    tick: u64,
    /// Samples until the low-passes have settled.
    settled: u64,
    step: u64,
    /// Sum of the correlations of kept rows for white noise.
    white: f64,
    residuals: Residuals,
}

/// Correlation of the residuals of the last estimate.
#[derive(Clone, Debug)]
struct Residuals {
    beta: Option<Vec<f64>>,
    last: [JointVec; LAGS],
    squares: [JointVec; LAGS + 1],
    count: usize,
}

impl Streaming {
    /// An estimator of a structure's parameters from samples at `rate` \[Hz\] of an arm under `gravity` in the base frame \[m/s2\].
    pub fn new(
        structure: &Structure,
        gravity: &Vector3<f64>,
        rate: f64,
        settings: &Settings,
    ) -> Result<Streaming, StreamingError> {
        if !(settings.forgetting > 0.0 && settings.forgetting <= 1.0) {
            return Err(StreamingError::Forgetting { value: settings.forgetting });
        }
        let regressor = SampleRegressor::new(structure, gravity).map_err(|id| StreamingError::Term { id })?;
        let p = regressor.len();
        let narrow = Butterworth::new(settings.torque_order, settings.torque_cutoff, rate)?;
        let wide = Butterworth::new(settings.position_order, settings.position_cutoff, rate)?;
        // Only nonzero lanes are filtered; the torque has all lanes.
        let active = active(structure);
        let mut lanes = vec![[false; MAX_JOINTS]; p + 1];
        active.iter().enumerate().for_each(|(j, columns)| columns.iter().for_each(|&c| lanes[c][j] = true));
        lanes[p] = [true; MAX_JOINTS];
        let step = settings.decimation.unwrap_or_else(|| decimation(rate, 2.0 * settings.torque_cutoff)).max(1);
        Ok(Streaming {
            rate,
            first: Bank::new(settings.position_order, settings.position_cutoff, rate, &[[true; MAX_JOINTS]; 2])?,
            second: Bank::new(settings.torque_order, settings.torque_cutoff, rate, &lanes)?,
            before: Default::default(),
            torque_before: JointVec::default(),
            values: vec![[0.0; MAX_JOINTS]; p + 1],
            gram: Gram::new(p, active, settings.forgetting),
            tick: 0,
            settled: 2 + ((wide.settling() + narrow.settling()) * rate).ceil() as u64,
            step: step as u64,
            white: white_correlation(&narrow, rate, step),
            residuals: Residuals {
                beta: None,
                last: [[0.0; MAX_JOINTS]; LAGS],
                squares: [[0.0; MAX_JOINTS]; LAGS + 1],
                count: 0,
            },
            regressor,
        })
    }

    /// Takes the next sample on the even grid: measured positions \[rad\] and torques \[Nm\]; entries past the arm's joints are not read.
    ///
    /// After a gap, or when samples are not finite, the low-passes have to start again: [`Streaming::interrupt`], which the error has
    /// done already.
    pub fn push(&mut self, q: &JointVec, tau: &JointVec) -> Result<(), NotFinite> {
        let n = self.regressor.joints();
        let (mut position, mut torque) = (JointVec::default(), JointVec::default());
        for j in 0..n {
            if !(q[j].is_finite() && tau[j].is_finite()) {
                self.interrupt();
                return Err(NotFinite { joint: j + 1 });
            }
            (position[j], torque[j]) = (q[j], tau[j]);
        }
        let mut both = [position, torque];
        self.first.step(&mut both);
        let [position, torque] = both;
        let [older, old] = self.before;
        self.before = [old, position];
        let torque = std::mem::replace(&mut self.torque_before, torque);
        self.tick += 1;
        if self.tick < 3 {
            return Ok(());
        }

        // One sample late, for central differences.
        let mut sample = Sample { q: old, ..Sample::default() };
        for j in 0..n {
            sample.dq[j] = (position[j] - older[j]) * (0.5 * self.rate);
            sample.ddq[j] = (position[j] - 2.0 * old[j] + older[j]) * (self.rate * self.rate);
        }
        let columns = self.regressor.at(&sample);
        let (last, first) = self.values.split_last_mut().expect("the torque at least");
        first.copy_from_slice(columns);
        *last = torque;
        self.second.step(&mut self.values);
        if self.tick >= self.settled && self.tick.is_multiple_of(self.step) {
            let (torque, columns) = self.values.split_last().expect("the torque at least");
            self.gram.add(columns, torque);
            self.residuals.add(columns, torque);
        }
        Ok(())
    }

    /// Restarts the low-passes, for a gap before the next sample. The normal equations are kept.
    pub fn interrupt(&mut self) {
        self.tick = 0;
        self.first.restart();
        self.second.restart();
        self.residuals.count = 0;
        self.residuals.squares = [[0.0; MAX_JOINTS]; LAGS + 1];
    }

    /// Rows of each joint so far.
    pub fn rows(&self) -> usize {
        self.gram.count()
    }

    /// Parameters from all samples so far, with one variance per joint from its residual (paper eq. 10).
    ///
    /// Rows that follow each other are not independent. The covariance is that of least squares times what the correlation adds to each
    /// joint's variance: of white noise through the low-passes, or, after 200 rows since the first call of this
    /// function, of the residuals themselves up to 8 rows apart, where that is more.
    pub fn estimate(&mut self) -> Result<Estimate, StreamingError> {
        let (n, p) = (self.gram.joints(), self.gram.columns());
        let rows = n * self.gram.count();
        if rows < p {
            return Err(StreamingError::TooFewRows { rows, columns: p });
        }
        let squares = self.gram.torque_squares();
        let weight = self.gram.weight();
        let largest = squares.iter().fold(f64::MIN_POSITIVE, |most, &square| most.max(square / weight));
        let mut sigma = vec![1.0; n];
        let mut solution = self.solve(&sigma)?;
        for _ in 0..ROUNDS {
            let residuals = self.gram.residual_squares(&solution.beta);
            let effective = n as f64 * weight;
            let freedom = effective / (effective - solution.rank as f64).max(1.0);
            for j in 0..n {
                let least =
                    MIN_NOISE_RATIO * (squares[j] / weight).max(MIN_NOISE_RATIO * MIN_NOISE_RATIO * largest).sqrt();
                sigma[j] = (residuals[j] / weight * freedom).sqrt().max(least);
            }
            solution = self.solve(&sigma)?;
        }

        let correlation: Vec<f64> = (0..n).map(|j| self.residuals.correlation(j).max(self.white)).collect();
        let mut spread = DMatrix::zeros(p, p);
        for j in 0..n {
            spread += self.gram.of_joint(j) * (correlation[j] / (sigma[j] * sigma[j]));
        }
        let covariance = &solution.inverse * spread * &solution.inverse;
        let beta: Vec<f64> = solution.beta.iter().copied().collect();
        self.residuals.beta = Some(beta.clone());
        let determined = |c: usize| solution.null_share[c] <= UNDETERMINED_SHARE;
        Ok(Estimate {
            std: (0..p).map(|c| determined(c).then(|| covariance[(c, c)].max(0.0).sqrt())).collect(),
            beta,
            covariance,
            sigma,
            correlation,
            rows,
            rank: solution.rank,
            condition: solution.condition.sqrt(),
        })
    }

    fn solve(&mut self, sigma: &[f64]) -> Result<Solution, StreamingError> {
        let (m, b): (DMatrix<f64>, DVector<f64>) = self.gram.normal_equations(sigma);
        solve(&m, &b).ok_or(StreamingError::Decomposition { columns: self.gram.columns() })
    }
}

impl Residuals {
    fn add(&mut self, columns: &[[f64; MAX_JOINTS]], torque: &JointVec) {
        let Some(beta) = &self.beta else { return };
        let mut residual = *torque;
        for (column, beta) in columns.iter().zip(beta) {
            residual.iter_mut().zip(column).for_each(|(residual, entry)| *residual -= entry * beta);
        }
        for (lag, squares) in self.squares.iter_mut().enumerate() {
            let Some(other) = (if lag == 0 { Some(&residual) } else { self.last.get(lag - 1) }) else { continue };
            if lag <= self.count {
                squares.iter_mut().zip(residual.iter().zip(other)).for_each(|(sum, (a, b))| *sum += a * b);
            }
        }
        self.last.rotate_right(1);
        self.last[0] = residual;
        self.count += 1;
    }

    /// `1 + 2 sum of the correlations`, tapered so that it is never negative (Bartlett); 0 while there are too few residuals.
    fn correlation(&self, j: usize) -> f64 {
        let variance = self.squares[0][j];
        if self.count < MIN_RESIDUALS || variance <= 0.0 {
            return 0.0;
        }
        let lags = self.squares.iter().enumerate().skip(1);
        1.0 + 2.0 * lags.map(|(lag, sum)| (1.0 - lag as f64 / (LAGS + 1) as f64) * sum[j] / variance).sum::<f64>()
    }
}

/// Columns with entries in each joint's rows: links from the joint outward, and what belongs to the joint itself.
fn active(structure: &Structure) -> Vec<Vec<usize>> {
    let rigid = structure.reduction().len();
    let has = |j: usize, c: usize| {
        let joint = structure.columns()[c].joint;
        if c < rigid { joint > j } else { joint == j + 1 }
    };
    let columns = structure.columns().len();
    (0..structure.chain().len()).map(|j| (0..columns).filter(|&c| has(j, c)).collect()).collect()
}

/// Factor of the variance of a sum of every `step`-th sample of low-passed white noise, by their correlation.
fn white_correlation(filter: &Butterworth, rate: f64, step: usize) -> f64 {
    // Its power is the zero-phase gain of the forward-backward filter. Trapezoidal rule over one period of the spectrum.
    const POINTS: usize = 20_000;
    let power = (0..POINTS).map(|k| filter.zero_phase_gain(0.5 * rate * k as f64 / POINTS as f64)).sum::<f64>();
    (POINTS as f64 / (step as f64 * power)).max(1.0)
}
