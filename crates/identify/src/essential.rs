//! Essential parameters: backward elimination of parameters that are not significant (Pham and Gautier 1991; Khalil and
//! Dombre 2002, section 12.4).
//!
//! Each step eliminates the parameter with the largest relative standard deviation and estimates the others again. It ends when the eliminated
//! parameters are jointly significant: their test statistic `b' C^-1 b`, with values `b` and covariance `C` in the whole model, exceeds the 95 %
//! quantile of the chi-squared distribution. This is the textbook F-test with a covariance that is valid for coloured noise.

use super::EstimateError;
use super::solve::solved::Solved;
use nalgebra::{Cholesky, DMatrix, DVector};
use plumbline_model::term::Column;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Eliminated parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Dropped {
    /// Name of its column.
    pub name: String,
    /// Its value before the elimination \[its unit\].
    pub value: f64,
    /// Standard deviation of that value \[its unit\].
    pub std: f64,
}

/// Eliminates insignificant parameters of a solution; `again` solves for the remaining columns. Returns the solution, its columns, and the
/// eliminated parameters.
pub fn reduce(
    columns: &[Column],
    whole: Solved,
    again: impl Fn(&[usize]) -> Result<Solved, EstimateError>,
) -> Result<(Solved, Vec<usize>, Vec<Dropped>), EstimateError> {
    let mut kept: Vec<usize> = (0..columns.len()).collect();
    let (mut eliminated, mut dropped) = (Vec::new(), Vec::new());
    let mut solved = whole.clone();
    while let Some((own, value, std)) = least_significant(&solved) {
        let mut next = eliminated.clone();
        next.push(kept[own]);
        if statistic(&whole, &next).is_none_or(|statistic| statistic > chi_squared_95(next.len())) {
            break;
        }
        eliminated = next;
        dropped.push(Dropped { name: columns[kept.remove(own)].name.clone(), value, std });
        solved = again(&kept)?;
    }
    Ok((solved, kept, dropped))
}

/// The determined parameter with the largest relative standard deviation: index, value and standard deviation. `None` when a single
/// one is left.
fn least_significant(solved: &Solved) -> Option<(usize, f64, f64)> {
    if solved.fit.beta.len() < 2 {
        return None;
    }
    let of = |c: usize| (c, solved.fit.beta[c], solved.spread.covariance[(c, c)].max(0.0).sqrt());
    let relative = |(_, value, std): &(usize, f64, f64)| std / value.abs();
    (0..solved.fit.beta.len())
        .filter(|&c| solved.determined(c))
        .map(of)
        .filter(|one| relative(one) > 0.0)
        .max_by(|a, b| relative(a).total_cmp(&relative(b)))
}

/// Test statistic `b' C^-1 b` of some parameters of a solution; `None` where it is not finite.
fn statistic(whole: &Solved, eliminated: &[usize]) -> Option<f64> {
    let b = DVector::from_iterator(eliminated.len(), eliminated.iter().map(|&c| whole.fit.beta[c]));
    let c = DMatrix::from_fn(eliminated.len(), eliminated.len(), |i, k| {
        whole.spread.covariance[(eliminated[i], eliminated[k])]
    });
    // Scaled to correlations: the parameters' units differ by orders of magnitude.
    let std = c.diagonal().map(f64::sqrt);
    let correlations = DMatrix::from_fn(eliminated.len(), eliminated.len(), |i, k| c[(i, k)] / (std[i] * std[k]));
    let scaled = b.component_div(&std);
    Some(Cholesky::new(correlations)?.solve(&scaled).dot(&scaled)).filter(|statistic| statistic.is_finite())
}

/// 95 % quantile of the chi-squared distribution.
fn chi_squared_95(freedom: usize) -> f64 {
    ChiSquared::new(freedom as f64).map_or(f64::NAN, |distribution| distribution.inverse_cdf(0.95))
}

#[cfg(test)]
mod tests {
    use super::chi_squared_95;

    #[test]
    fn chi_squared_quantiles_agree_with_the_tables() {
        for (freedom, table) in [(1, 3.841), (2, 5.991), (5, 11.070), (10, 18.307), (40, 55.758)] {
            let ratio = chi_squared_95(freedom) / table;
            assert!((ratio - 1.0).abs() < 1e-3, "{freedom}: {ratio}");
        }
    }
}
