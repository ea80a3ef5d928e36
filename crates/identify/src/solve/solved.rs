//! Solution of an estimator, before it is described by parameter.

use super::super::covariance::Spread;
use super::linear::Fit;

/// Share of a parameter in undetermined directions above which it is undetermined.
const UNDETERMINED_SHARE: f64 = 1e-3;

/// Outcome of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Solved directly, or the weights converged.
    Settled,
    /// The weights did not converge; the parameters are those of the last round.
    Unconverged,
}

/// Result of every estimator.
#[derive(Clone, Debug)]
pub struct Solved {
    /// Linear estimate of the parameters.
    pub fit: Fit,
    /// Covariance of the parameters.
    pub spread: Spread,
    /// Standard deviation used as weight of each joint \[Nm\].
    pub sigma: Vec<f64>,
    /// Weight of each equation.
    pub row_weights: Option<Vec<f64>>,
    /// Rounds of weights.
    pub rounds: usize,
    /// Outcome of the iteration.
    pub outcome: Outcome,
}

impl Solved {
    /// Whether parameter `c` is determined.
    pub fn determined(&self, c: usize) -> bool {
        self.fit.null_share[c] <= UNDETERMINED_SHARE
    }
}
