//! Essential parameters: what is left when parameters that do not show in the data are taken out (Pham and Gautier 1991; Khalil and
//! Dombre 2002, section 12.4).
//!
//! The parameter with the largest relative standard deviation goes, the others are estimated anew, and so on, while all that has gone
//! could be zero: the test statistic `b' C^-1 b` of the parameters taken out, with their values `b` and their covariance `C` in the whole
//! model, stays below the 95 % point of the chi-squared distribution. It is the F-test of the textbooks with a covariance that holds for
//! coloured noise.

use super::EstimateError;
use super::solve::Solved;
use nalgebra::{Cholesky, DMatrix, DVector};
use plumbline_model::term::Column;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// A parameter that was taken out.
#[derive(Clone, Debug, PartialEq)]
pub struct Dropped {
    /// Name of its column.
    pub name: String,
    /// Its value when it was still in \[its unit\].
    pub value: f64,
    /// Standard deviation of that \[its unit\].
    pub std: f64,
}

/// Takes parameters out of a solution; `again` solves for the columns that are left. Gives the solution, its columns, and what went.
pub fn reduce(
    columns: &[Column],
    whole: Solved,
    again: impl Fn(&[usize]) -> Result<Solved, EstimateError>,
) -> Result<(Solved, Vec<usize>, Vec<Dropped>), EstimateError> {
    let mut kept: Vec<usize> = (0..columns.len()).collect();
    let (mut gone, mut dropped) = (Vec::new(), Vec::new());
    let mut solved = whole.clone();
    while let Some((own, value, std)) = least_known(&solved) {
        let mut next = gone.clone();
        next.push(kept[own]);
        if statistic(&whole, &next).is_none_or(|statistic| statistic > chi_squared_95(next.len())) {
            break;
        }
        gone = next;
        dropped.push(Dropped { name: columns[kept.remove(own)].name.clone(), value, std });
        solved = again(&kept)?;
    }
    Ok((solved, kept, dropped))
}

/// The determined parameter with the largest relative standard deviation: its place, value and standard deviation. `None` when a single
/// one is left.
fn least_known(solved: &Solved) -> Option<(usize, f64, f64)> {
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

/// `b' C^-1 b` of some parameters of a solution; `None` where they are not known well enough to say.
fn statistic(whole: &Solved, gone: &[usize]) -> Option<f64> {
    let b = DVector::from_iterator(gone.len(), gone.iter().map(|&c| whole.fit.beta[c]));
    let c = DMatrix::from_fn(gone.len(), gone.len(), |i, k| whole.spread.covariance[(gone[i], gone[k])]);
    // Scaled to correlations first: the parameters' units differ by orders of magnitude.
    let std = c.diagonal().map(f64::sqrt);
    let correlations = DMatrix::from_fn(gone.len(), gone.len(), |i, k| c[(i, k)] / (std[i] * std[k]));
    let scaled = b.component_div(&std);
    Some(Cholesky::new(correlations)?.solve(&scaled).dot(&scaled)).filter(|statistic| statistic.is_finite())
}

/// 95 % point of the chi-squared distribution.
fn chi_squared_95(freedom: usize) -> f64 {
    ChiSquared::new(freedom as f64).map_or(f64::NAN, |distribution| distribution.inverse_cdf(0.95))
}

#[cfg(test)]
mod tests {
    use super::chi_squared_95;

    #[test]
    fn points_of_the_chi_squared_distribution_are_the_tables() {
        for (freedom, table) in [(1, 3.841), (2, 5.991), (5, 11.070), (10, 18.307), (40, 55.758)] {
            let ratio = chi_squared_95(freedom) / table;
            assert!((ratio - 1.0).abs() < 1e-3, "{freedom}: {ratio}");
        }
    }
}
