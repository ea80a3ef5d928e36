//! Weighted fits to the spectra of deviations: in each joint and band noise has one variance `phi`, which is estimated with the parameters (Whittle's
//! profile log likelihood):
//!
//!   -2 L = sum_(joint, band) [ n ln phi + |y - C theta|^2 / phi ]

use nalgebra::{DMatrix, DVector};

/// Most rounds of weights,
const MAX_WEIGHT_ROUNDS: usize = 100;
/// and the change of the logarithm of `phi` at which they have settled: from what a strong step does to the deviations they take tens.
const SETTLED_LOG_RATIO: f64 = 0.01;

/// `phi` of each joint, band by band.
type Noise = Vec<Vec<f64>>;

/// Parameters that were fitted to deviations.
pub(super) struct Fitted {
    pub theta: DVector<f64>,
    pub covariance: DMatrix<f64>,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Share of the squares that it explains.
    pub explained: f64,
}

/// Sums over the coefficients of a joint in one band.
#[derive(Clone)]
pub(super) struct Moments {
    /// Of columns and columns, and columns and deviations.
    g: DMatrix<f64>,
    b: DVector<f64>,
    /// Of the squared deviations, and how many independent ones there are.
    square: f64,
    count: f64,
}

impl Moments {
    pub fn new(columns: usize) -> Moments {
        Moments { g: DMatrix::zeros(columns, columns), b: DVector::zeros(columns), square: 0.0, count: 0.0 }
    }

    /// Takes one coefficient in: its columns from the `first` on, and its deviation.
    pub fn add(&mut self, first: usize, columns: &[f64], deviation: f64, freedom: f64) {
        for (i, left) in columns.iter().enumerate() {
            self.b[first + i] += left * deviation;
            for (k, right) in columns.iter().enumerate() {
                self.g[(first + i, first + k)] += left * right;
            }
        }
        self.square += deviation * deviation;
        self.count += freedom;
    }

    /// Squares that are left with these parameters.
    fn left(&self, theta: &DVector<f64>) -> f64 {
        (self.square - 2.0 * theta.dot(&self.b) + theta.dot(&(&self.g * theta))).max(1e-12 * self.square)
    }
}

/// Mean squares that are left of a joint in each band, with `theta` or without a trial; none is less than that of the highest band, for noise is
/// strongest at the lowest frequencies, and a band of few coefficients can be explained altogether. 0 where nothing deviates.
fn noise(bands: &[Moments], theta: Option<&DVector<f64>>) -> Vec<f64> {
    let mean = |band: &Moments| theta.map_or(band.square, |theta| band.left(theta)) / band.count.max(f64::MIN_POSITIVE);
    let least = bands.iter().rfind(|band| band.count > 0.0).map_or(0.0, mean);
    bands.iter().map(|band| if band.square > 0.0 { mean(band).max(least) } else { least }).collect()
}

/// Parameters and their covariance with the noise of each joint's bands that they leave, where it has settled from `phi` on.
fn settled(moments: &[Vec<Moments>], mut phi: Noise) -> Option<(DVector<f64>, DMatrix<f64>, Noise)> {
    let width = moments.first()?.first()?.b.len();
    let mut round = 1;
    loop {
        let (mut g, mut b) = (DMatrix::zeros(width, width), DVector::zeros(width));
        for (band, phi) in moments.iter().flatten().zip(phi.iter().flatten()).filter(|(_, phi)| **phi > 0.0) {
            g.zip_apply(&band.g, |sum, own| *sum += own / phi);
            b.axpy(1.0 / phi, &band.b, 1.0);
        }
        let covariance = g.cholesky()?.inverse();
        let theta = &covariance * b;
        let next: Noise = moments.iter().map(|bands| noise(bands, Some(&theta))).collect();
        let moved = |(new, old): (&f64, &f64)| *old > 0.0 && (new / old).ln().abs() > SETTLED_LOG_RATIO;
        let moves = next.iter().flatten().zip(phi.iter().flatten()).any(moved);
        if !moves || round == MAX_WEIGHT_ROUNDS {
            return Some((theta, covariance, next));
        }
        (phi, round) = (next, round + 1);
    }
}

/// The likelier of two fits: `phi` settles from what the deviations are without the trial, and from the noise at the highest frequencies, where a step
/// is weakest. The moments are those of each joint, band by band.
pub(super) fn fit(moments: &[Vec<Moments>]) -> Option<Fitted> {
    let before: Noise = moments.iter().map(|bands| noise(bands, None)).collect();
    let white: Noise = before.iter().map(|noise| vec![noise[noise.len() - 1]; noise.len()]).collect();
    let likelihood = |square: f64, count: f64, phi: f64| count * phi.ln() + square / phi;
    let fitted = |start: Noise| {
        let (theta, covariance, phi) = settled(moments, start)?;
        let (mut evidence, mut square_before, mut square_after) = (0.0, 0.0, 0.0);
        let noises = before.iter().flatten().zip(phi.iter().flatten());
        for (band, (before, after)) in moments.iter().flatten().zip(noises).filter(|(band, _)| band.square > 0.0) {
            let left = band.left(&theta);
            evidence += likelihood(band.square, band.count, *before) - likelihood(left, band.count, *after);
            (square_before, square_after) = (square_before + band.square, square_after + left);
        }
        let explained = 1.0 - square_after / square_before.max(f64::MIN_POSITIVE);
        Some(Fitted { theta, covariance, evidence, explained })
    };
    let fits = [before.clone(), white].into_iter().filter_map(fitted);
    fits.max_by(|a, b| a.evidence.total_cmp(&b.evidence))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// Deviations in three bands, slow ones of twice the noise, and an effect of two columns. It begins less suddenly than the columns do, so that
    /// quick ones have a part of it.
    fn moments(counts: [usize; 3], effect: [f64; 2], seed: u64) -> Vec<Vec<Moments>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut gauss = || rng.sample::<f64, _>(StandardNormal);
        let mut bands = vec![Moments::new(2); 3];
        for (band, count) in counts.into_iter().enumerate() {
            let [size, part, noise] = [[1.0, 1.0, 2.0], [0.1, 0.95, 1.0], [0.05, 0.95, 1.0]][band];
            for _ in 0..count {
                let columns = [size * gauss(), 0.3 * size * gauss()];
                let deviation = part * (effect[0] * columns[0] + effect[1] * columns[1]) + noise * gauss();
                bands[band].add(0, &columns, deviation, 1.0);
            }
        }
        vec![bands]
    }

    #[test]
    fn weights_settle_where_an_effect_was_most_of_the_deviations() {
        for seed in 0..20 {
            let moments = moments([40, 200, 800], [100.0, 50.0], seed);
            let fitted = fit(&moments).unwrap();
            // Once more with the noise that it leaves.
            let phi = noise(&moments[0], Some(&fitted.theta));
            let (mut g, mut b) = (DMatrix::zeros(2, 2), DVector::zeros(2));
            for (band, phi) in moments[0].iter().zip(phi) {
                g += &band.g / phi;
                b += &band.b / phi;
            }
            let again = g.cholesky().unwrap().solve(&b);
            let moved = (again - &fitted.theta).component_div(&fitted.covariance.diagonal().map(f64::sqrt));
            assert!(moved.amax() < 0.1, "seed {seed}: by {moved} standard deviations");
        }
    }

    #[test]
    fn a_band_that_can_be_explained_altogether_proves_nothing() {
        for seed in 0..20 {
            let fitted = fit(&moments([2, 0, 400], [0.0; 2], seed)).unwrap();
            assert!(fitted.evidence < 25.0, "seed {seed}: {}", fitted.evidence);
        }
    }
}
