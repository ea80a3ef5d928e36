//! Minimisation of a function with gradient: BFGS with a dense inverse Hessian and a line search for the weak Wolfe conditions.
//!
//! With some dozens of unknowns the dense update is cheap against one evaluation of the function. The bisecting line search of
//! Lewis and Overton ("Nonsmooth optimization via quasi-Newton methods", 2013) handles kinks, which penalties and large p have.

use nalgebra::{DMatrix, DVector};

/// State of a minimisation. It can continue after a small change of the function.
pub struct Descent {
    x: DVector<f64>,
    inverse: DMatrix<f64>,
    fresh: bool,
}

/// Why a descent ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// The last steps decreased the value by less than the tolerance, or no step decreases it.
    Converged,
    /// Maximum iterations reached.
    Iterations,
}

/// Wolfe conditions: ratios of sufficient decrease and curvature.
const DECREASE_RATIO: f64 = 1e-4;
const CURVATURE_RATIO: f64 = 0.9;
/// Maximum trial steps of one line search.
const MAX_TRIALS: usize = 25;
/// Consecutive steps with a decrease below the tolerance until convergence.
const MAX_SMALL_STEPS: usize = 3;

impl Descent {
    /// A minimisation from `x`.
    pub fn new(x: Vec<f64>) -> Descent {
        let n = x.len();
        Descent { x: DVector::from_vec(x), inverse: DMatrix::identity(n, n), fresh: true }
    }

    /// Current point.
    pub fn x(&self) -> &[f64] {
        self.x.as_slice()
    }

    /// Resets the inverse Hessian to the identity, after a large change of the function.
    pub fn reset(&mut self) {
        self.inverse.fill_with_identity();
        self.fresh = true;
    }

    /// Runs at most `iterations` steps and returns the value. `f` writes the gradient at its first argument into the second and returns the
    /// value, infinite outside its domain. Converged when 3 steps in a row decrease the value by less than `tolerance`.
    pub fn run(
        &mut self,
        iterations: usize,
        tolerance: f64,
        mut f: impl FnMut(&[f64], &mut [f64]) -> f64,
    ) -> (f64, End) {
        let n = self.x.len();
        let mut gradient = DVector::zeros(n);
        let mut value = f(self.x.as_slice(), gradient.as_mut_slice());
        let mut small = 0;
        for _ in 0..iterations {
            let mut direction = -(&self.inverse * &gradient);
            let mut slope = direction.dot(&gradient);
            if slope.is_nan() || slope >= 0.0 {
                self.reset();
                direction = -gradient.clone();
                slope = -gradient.norm_squared();
            }
            if !value.is_finite() || slope == 0.0 {
                return (value, End::Converged);
            }
            // The first step has no curvature information and is short.
            let mut step = if self.fresh { (0.1 / direction.norm()).min(1.0) } else { 1.0 };
            let (mut low, mut high) = (0.0, f64::INFINITY);
            let mut next = None;
            for _ in 0..MAX_TRIALS {
                let x = &self.x + &direction * step;
                let mut there = DVector::zeros(n);
                let found = f(x.as_slice(), there.as_mut_slice());
                if found.is_nan() || found > value + DECREASE_RATIO * step * slope {
                    high = step;
                } else {
                    let flat = there.dot(&direction) >= CURVATURE_RATIO * slope;
                    next = Some((x, found, there));
                    if flat {
                        break;
                    }
                    low = step;
                }
                step = if high.is_finite() { 0.5 * (low + high) } else { 2.0 * low };
            }
            let Some((x, found, there)) = next else {
                if self.fresh {
                    return (value, End::Converged);
                }
                self.reset();
                continue;
            };
            self.update(&(&x - &self.x), &(&there - &gradient));
            let gain = value - found;
            (self.x, value, gradient) = (x, found, there);
            small = if gain <= tolerance { small + 1 } else { 0 };
            if small == MAX_SMALL_STEPS {
                return (value, End::Converged);
            }
        }
        (value, End::Iterations)
    }

    /// BFGS: `H+ = (I - r s y') H (I - r y s') + r s s'` with `r = 1 / s'y`.
    fn update(&mut self, s: &DVector<f64>, y: &DVector<f64>) {
        let along = s.dot(y);
        if along <= 1e-12 * s.norm() * y.norm() {
            return;
        }
        if self.fresh {
            self.inverse *= along / y.norm_squared();
            self.fresh = false;
        }
        let hy = &self.inverse * y;
        let factor = (1.0 + y.dot(&hy) / along) / along;
        self.inverse.ger(factor, s, s, 1.0);
        self.inverse.ger(-1.0 / along, &hy, s, 1.0);
        self.inverse.ger(-1.0 / along, s, &hy, 1.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_minimum_of_the_rosenbrock_function_is_found() {
        let f = |x: &[f64], g: &mut [f64]| {
            let mut value = 0.0;
            g.fill(0.0);
            for i in 0..x.len() - 1 {
                let (a, b) = (x[i + 1] - x[i] * x[i], 1.0 - x[i]);
                value += 100.0 * a * a + b * b;
                g[i] += -400.0 * x[i] * a - 2.0 * b;
                g[i + 1] += 200.0 * a;
            }
            value
        };
        let mut descent = Descent::new(vec![-1.2, 1.0, -0.5, 0.8, 1.5, -1.0]);
        let (value, end) = descent.run(500, 1e-16, f);
        assert!(value < 1e-12 && end == End::Converged, "{value}");
        assert!(descent.x().iter().all(|x| (x - 1.0).abs() < 1e-5));
    }

    #[test]
    fn kinks_and_infinite_values_are_handled() {
        // |x| + 2 |y|, infinite for x < -1.
        let f = |x: &[f64], g: &mut [f64]| {
            (g[0], g[1]) = (x[0].signum(), 2.0 * x[1].signum());
            if x[0] < -1.0 { f64::INFINITY } else { x[0].abs() + 2.0 * x[1].abs() }
        };
        let mut descent = Descent::new(vec![3.7, -2.3]);
        let (value, _) = descent.run(200, 0.0, f);
        assert!(value < 1e-6, "{value}");
    }
}
