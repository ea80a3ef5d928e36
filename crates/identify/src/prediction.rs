//! Prediction intervals of torques.

use super::covariance::Spread;
use super::external::ResidualSpectrum;
use super::solve::{Identification, student_975};
use nalgebra::DMatrix;

/// Rows of a regressor that are multiplied by the covariance at a time.
const ROWS_AT_A_TIME: usize = 4096;

/// Uncertainty of predicted torques: that of the parameters and that of one sample.
#[derive(Clone, Debug)]
pub struct TorqueUncertainty {
    /// Covariance of the parameters in the determined directions, in the order of the model's columns.
    pub parameters: Spread,
    /// Standard deviation of measured minus modelled torque of one raw sample of the identification, per joint \[Nm\].
    pub residual_std: Vec<f64>,
    /// Degrees of freedom of the variance of each joint's residual.
    pub residual_freedom: f64,
    /// The residual of the identification's runs by frequency, for external torques; `None` where unknown.
    pub residual_spectrum: Option<ResidualSpectrum>,
}

impl TorqueUncertainty {
    /// From an identification. Of the `N` raw samples per joint, the fit takes `rank / n` degrees of freedom.
    pub fn of(identification: &Identification) -> TorqueUncertainty {
        let rms = &identification.rms;
        let samples = rms.samples as f64;
        let residual_freedom = samples - identification.rank as f64 / rms.raw.len() as f64;
        let corrected = (samples / residual_freedom).sqrt();
        let mut covariance = identification.covariance.clone();
        for c in 0..covariance.nrows() {
            // A parameter without variance has no covariance but rounding.
            if covariance[(c, c)] <= 0.0 {
                covariance.row_mut(c).fill(0.0);
                covariance.column_mut(c).fill(0.0);
            }
        }
        TorqueUncertainty {
            parameters: Spread { covariance, freedom: identification.freedom.clone() },
            residual_std: rms.raw.iter().map(|rms| rms * corrected).collect(),
            residual_freedom,
            residual_spectrum: None,
        }
    }

    /// Half the width of the 95 % prediction interval of one raw torque sample, per row of a regressor, n N joint by joint \[Nm\].
    ///
    /// The variance is `y C y' + s_j^2` with `y` the row, `C` the covariance of the parameters and `s_j` the standard deviation of the joint's
    /// residual. The quantile is that of Student's t distribution with the degrees of freedom of the sum (Satterthwaite). Those of `y C y'` are
    /// the harmonic mean of the parameters', weighted by `y_c^2 C_cc`.
    pub fn half_widths(&self, regressor: &DMatrix<f64>) -> Vec<f64> {
        let Spread { covariance, freedom } = &self.parameters;
        let samples = regressor.nrows() / self.residual_std.len();
        let mut widths = Vec::with_capacity(regressor.nrows());
        for first in (0..regressor.nrows()).step_by(ROWS_AT_A_TIME) {
            let rows = regressor.rows(first, ROWS_AT_A_TIME.min(regressor.nrows() - first));
            let spread = rows * covariance;
            for (k, (row, spread)) in rows.row_iter().zip(spread.row_iter()).enumerate() {
                let of_parameters = row.dot(&spread).max(0.0);
                let (mut weights, mut inverses) = (0.0, 0.0);
                for (c, freedom) in freedom.iter().enumerate() {
                    let weight = row[c].powi(2) * covariance[(c, c)];
                    weights += weight;
                    inverses += weight / freedom;
                }
                let inverse = if weights > 0.0 { inverses / weights } else { 0.0 };
                let of_sample = self.residual_std[(first + k) / samples].powi(2);
                let variance = of_parameters + of_sample;
                let over_freedom = of_parameters.powi(2) * inverse + of_sample.powi(2) / self.residual_freedom;
                let combined = if over_freedom > 0.0 { variance.powi(2) / over_freedom } else { f64::INFINITY };
                widths.push(student_975(combined) * variance.sqrt());
            }
        }
        widths
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two joints, two parameters with correlated errors.
    fn uncertainty(freedom: f64) -> TorqueUncertainty {
        TorqueUncertainty {
            parameters: Spread {
                covariance: DMatrix::from_row_slice(2, 2, &[0.04, -0.018, -0.018, 0.01]),
                freedom: vec![freedom, 2.0 * freedom],
            },
            residual_std: vec![0.3, 0.0],
            residual_freedom: 1e9,
            residual_spectrum: None,
        }
    }

    #[test]
    fn half_widths_are_those_of_the_textbook() {
        // One sample of two joints: parameter 1 alone; the sum of both.
        let regressor = DMatrix::from_row_slice(2, 2, &[2.0, 0.0, 1.0, 1.0]);
        let widths = uncertainty(f64::INFINITY).half_widths(&regressor);
        // sqrt(4 * 0.04 + 0.09) = 0.5; sqrt(0.04 + 0.01 - 2 * 0.018), which is less than that of either parameter.
        let expected = [1.959964 * 0.5, 1.959964 * 0.014_f64.sqrt()];
        for (width, expected) in widths.iter().zip(expected) {
            assert!((width / expected - 1.0).abs() < 1e-6, "{width} {expected}");
        }
        // Parameters alone: 0.05 / (0.04 / 5 + 0.01 / 10) = 5.56 degrees of freedom.
        let widths = uncertainty(5.0).half_widths(&regressor);
        let expected = student_975(0.05 / 0.009) * 0.014_f64.sqrt();
        assert!((widths[1] / expected - 1.0).abs() < 1e-9, "{} {expected}", widths[1]);
        // Variances 0.16 with 5 degrees of freedom and 0.09 with many: 0.25^2 / (0.16^2 / 5) = 12.2, where Student's quantile is 2.1750.
        assert!((widths[0] / (2.1750 * 0.5) - 1.0).abs() < 1e-3, "{}", widths[0]);
    }
}
