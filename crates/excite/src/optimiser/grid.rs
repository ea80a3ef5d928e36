//! Unknowns of a motion and their linear map to its samples.
//!
//! The amplitudes of a joint that starts and ends at rest form a linear space: `sum_k k a_k = 0`, `sum_k b_k = 0`,
//! `sum_k k^2 b_k = 0`. The unknowns are coordinates in an orthonormal basis of that space, so every point of a search
//! satisfies the boundary conditions.

use super::super::fourier::{Fourier, orthonormal};
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Basis of one joint's amplitudes and its samples on an even grid over one period.
#[derive(Clone)]
pub struct Grid {
    period: f64,
    harmonics: usize,
    /// Amplitudes per coordinate, N x free, sines and cosines.
    a: DMatrix<f64>,
    b: DMatrix<f64>,
    /// Samples per coordinate of position and its derivatives, S x free.
    pub q: DMatrix<f64>,
    /// As `q`, velocity.
    pub dq: DMatrix<f64>,
    /// As `q`, acceleration.
    pub ddq: DMatrix<f64>,
    /// As `q`, jerk.
    pub jerk: DMatrix<f64>,
}

impl Grid {
    /// A grid of `samples` over one `period` \[s\] for `harmonics` harmonics.
    pub fn new(period: f64, harmonics: usize, samples: usize) -> Grid {
        // In units of velocity (k a_k, k b_k), so that the coordinates have similar curvature.
        let (a, b) = (null_space(harmonics, &[0]), null_space(harmonics, &[-1, 1]));
        let (na, nb) = (a.ncols(), b.ncols());
        let free = na + nb;
        let mut grid = Grid {
            period,
            harmonics,
            a: DMatrix::from_fn(harmonics, free, |k, c| if c < na { a[(k, c)] / (k + 1) as f64 } else { 0.0 }),
            b: DMatrix::from_fn(harmonics, free, |k, c| if c >= na { b[(k, c - na)] / (k + 1) as f64 } else { 0.0 }),
            q: DMatrix::zeros(samples, free),
            dq: DMatrix::zeros(samples, free),
            ddq: DMatrix::zeros(samples, free),
            jerk: DMatrix::zeros(samples, free),
        };
        let omega = 2.0 * PI / period;
        for s in 0..samples {
            let angle = 2.0 * PI * s as f64 / samples as f64;
            for k in 0..harmonics {
                let order = (k + 1) as f64;
                let (sin, cos) = (order * angle).sin_cos();
                let kw = order * omega;
                for c in 0..free {
                    let (a, b) = (grid.a[(k, c)], grid.b[(k, c)]);
                    let (even, odd) = (a * sin + b * cos, a * cos - b * sin);
                    grid.q[(s, c)] += even;
                    grid.dq[(s, c)] += kw * odd;
                    grid.ddq[(s, c)] -= kw * kw * even;
                    grid.jerk[(s, c)] -= kw * kw * kw * odd;
                }
            }
        }
        grid
    }

    /// Coordinates per joint: 2 N - 3 from N = 3 on.
    pub fn free(&self) -> usize {
        self.a.ncols()
    }

    /// Samples of a period, S.
    pub fn samples(&self) -> usize {
        self.q.nrows()
    }

    /// Time between two samples \[s\].
    pub fn step(&self) -> f64 {
        self.period / self.samples() as f64
    }

    /// The motion of the coordinates `x` (joint by joint, [`Grid::free`] each) about `q0`.
    pub fn fourier(&self, q0: &[f64], x: &[f64]) -> Fourier {
        let n = q0.len();
        let amplitudes = |basis: &DMatrix<f64>| {
            DMatrix::from_fn(n, self.harmonics, |j, k| {
                (0..self.free()).map(|c| basis[(k, c)] * x[j * self.free() + c]).sum()
            })
        };
        let mut fourier =
            Fourier { period: self.period, q0: q0.to_vec(), a: amplitudes(&self.a), b: amplitudes(&self.b) };
        fourier.project();
        fourier
    }

    /// Coordinates of a motion's amplitudes, joint by joint: their projection onto the boundary conditions.
    pub fn coordinates(&self, fourier: &Fourier) -> Vec<f64> {
        // The basis is orthonormal in k a_k and k b_k.
        let mut x = Vec::with_capacity(fourier.joints() * self.free());
        for j in 0..fourier.joints() {
            for c in 0..self.free() {
                let along = |k: usize| {
                    let square = ((k + 1) * (k + 1)) as f64;
                    square * (self.a[(k, c)] * fourier.a[(j, k)] + self.b[(k, c)] * fourier.b[(j, k)])
                };
                x.push((0..self.harmonics).map(along).sum());
            }
        }
        x
    }
}

/// Orthonormal basis (N x free) of all `x` with `sum_k k^p x_k = 0` for every `p` of `powers`.
fn null_space(harmonics: usize, powers: &[i32]) -> DMatrix<f64> {
    let conditions: Vec<Vec<f64>> =
        powers.iter().map(|&p| (1..=harmonics).map(|k| (k as f64).powi(p)).collect()).collect();
    let taken = orthonormal(conditions.clone()).len();
    let units = (0..harmonics).map(|k| (0..harmonics).map(|i| f64::from(u8::from(i == k))).collect());
    let all = orthonormal(conditions.into_iter().chain(units).collect());
    DMatrix::from_fn(harmonics, all.len() - taken, |k, c| all[taken + c][k])
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn coordinates_span_all_motions_at_rest_at_their_ends() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for harmonics in 1..=12 {
            let grid = Grid::new(8.0, harmonics, 40);
            assert_eq!(grid.free(), if harmonics < 3 { harmonics - 1 } else { 2 * harmonics - 3 });
            let q0 = [0.3, -0.2];
            let x: Vec<f64> = (0..2 * grid.free()).map(|_| rng.random_range(-1.0..1.0)).collect();
            let fourier = grid.fourier(&q0, &x);
            assert!(fourier.boundary_error().iter().all(|&error| error < 1e-11), "{:?}", fourier.boundary_error());
            let back = grid.coordinates(&fourier);
            assert!(x.iter().zip(&back).all(|(one, other)| (one - other).abs() < 1e-12), "{x:?} {back:?}");
        }
    }

    #[test]
    fn grid_samples_agree_with_the_fourier_series() {
        let grid = Grid::new(5.0, 4, 30);
        let x: Vec<f64> = (0..grid.free()).map(|c| 0.3 - 0.1 * c as f64).collect();
        let fourier = grid.fourier(&[0.7], &x);
        for s in [0, 7, 29] {
            let point = fourier.at(0, s as f64 * grid.step());
            let sample = |basis: &DMatrix<f64>| (0..x.len()).map(|c| basis[(s, c)] * x[c]).sum::<f64>();
            assert!((0.7 + sample(&grid.q) - point.q).abs() < 1e-12);
            assert!((sample(&grid.dq) - point.dq).abs() < 1e-12);
            assert!((sample(&grid.ddq) - point.ddq).abs() < 1e-11);
            assert!((sample(&grid.jerk) - point.jerk).abs() < 1e-10);
        }
    }
}
