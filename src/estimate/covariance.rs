//! Standard deviations that hold for coloured noise.
//!
//! Least squares weighs as if the noise were white; its estimate stays unbiased when it is not, but the usual formula for its
//! covariance is then wrong. With `beta = B tau` the covariance is `B C B'` whatever the noise's covariance `C` is: per joint,
//! the autocovariance of the scatter between periods or, without repeats, of the residual.

use nalgebra::DMatrix;

/// Rows of one joint in one experiment.
#[derive(Clone, Debug)]
pub struct Block {
    /// Its first row in the stacked equations.
    pub first: usize,
    /// When its rows were sampled, in units of the autocovariance's lag.
    pub at: Vec<usize>,
    /// Autocovariance of its noise by lag; zero beyond its end.
    pub autocovariance: Vec<f64>,
}

/// `B C B'` for a `C` that is block diagonal (`b` is p x rows).
pub fn sandwich(b: &DMatrix<f64>, blocks: &[Block]) -> DMatrix<f64> {
    let p = b.nrows();
    let mut covariance = DMatrix::zeros(p, p);
    for block in blocks {
        let m = block.at.len();
        let part = b.columns(block.first, m);
        let mut coloured = DMatrix::zeros(p, m);
        for i in 0..m {
            for k in 0..m {
                let lag = block.at[i].abs_diff(block.at[k]);
                if let Some(&c) = block.autocovariance.get(lag).filter(|&&c| c != 0.0) {
                    coloured.column_mut(i).axpy(c, &part.column(k), 1.0);
                }
            }
        }
        covariance += coloured * part.transpose();
    }
    // Equal to its transpose but for rounding.
    (&covariance + covariance.transpose()) * 0.5
}

/// Autocovariance of a residual, tapered so that its spectrum is never negative (Bartlett), up to `2 m^(1/3)` lags; `scale` makes up for
/// the degrees of freedom that the fit took.
pub fn tapered_autocovariance(residual: &[f64], scale: f64) -> Vec<f64> {
    let m = residual.len();
    let lags = ((2.0 * (m as f64).cbrt()).ceil() as usize).min(m.saturating_sub(1));
    (0..=lags)
        .map(|lag| {
            let sum: f64 = residual.iter().zip(&residual[lag..]).map(|(a, b)| a * b).sum();
            scale * sum / m as f64 * (1.0 - lag as f64 / (lags + 1) as f64)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sandwich_is_the_product_with_the_whole_covariance() {
        let b = DMatrix::from_fn(3, 9, |i, k| ((i * 7 + k * 3) as f64).sin());
        let blocks = [
            Block { first: 0, at: vec![0, 2, 4, 6, 8], autocovariance: vec![2.0, 0.0, 1.0, 0.0, 0.3] },
            Block { first: 5, at: vec![0, 1, 2, 3], autocovariance: vec![0.5, -0.2] },
        ];
        let mut c = DMatrix::zeros(9, 9);
        for block in &blocks {
            for i in 0..block.at.len() {
                for k in 0..block.at.len() {
                    let lag = block.at[i].abs_diff(block.at[k]);
                    c[(block.first + i, block.first + k)] = block.autocovariance.get(lag).copied().unwrap_or(0.0);
                }
            }
        }
        assert!((sandwich(&b, &blocks) - &b * c * b.transpose()).abs().max() < 1e-12);
    }

    #[test]
    fn white_noise_gives_the_textbook_covariance() {
        let w = DMatrix::from_fn(40, 3, |k, c| ((k * (c + 1)) as f64 * 0.37).cos());
        let inverse = (w.transpose() * &w).try_inverse().unwrap();
        let b = &inverse * w.transpose();
        let block = Block { first: 0, at: (0..40).collect(), autocovariance: vec![0.04] };
        assert!((sandwich(&b, &[block]) - inverse * 0.04).abs().max() < 1e-12);
    }

    #[test]
    fn the_taper_ends_at_its_last_lag() {
        let residual: Vec<f64> = (0..1000).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let r = tapered_autocovariance(&residual, 1.0);
        assert_eq!(r.len(), 21);
        assert!((r[0] - 1.0).abs() < 1e-12 && (r[1] + 0.999 * 20.0 / 21.0).abs() < 1e-12);
    }
}
