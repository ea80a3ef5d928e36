//! Inequality constraints `c <= 0` by an augmented Lagrangian (Powell, Hestenes, Rockafellar).
//!
//! `psi = sum_i (max(0, lambda_i + rho c_i)^2 - lambda_i^2) / (2 rho)` is once differentiable. The multipliers are updated by
//! `lambda_i <- max(0, lambda_i + rho c_i)` between two minimisations, so the penalty `rho` stays bounded.

/// Multipliers and penalty of a list of constraints that is evaluated in a fixed order.
#[derive(Clone, Debug)]
pub struct AugmentedLagrangian {
    rho: f64,
    lambda: Vec<f64>,
    last: Vec<f64>,
    at: usize,
    psi: f64,
    worst: f64,
}

impl AugmentedLagrangian {
    /// All multipliers zero.
    pub fn new(rho: f64) -> AugmentedLagrangian {
        AugmentedLagrangian { rho, lambda: Vec::new(), last: Vec::new(), at: 0, psi: 0.0, worst: f64::NEG_INFINITY }
    }

    /// Starts an evaluation of all constraints.
    pub fn start(&mut self) {
        (self.at, self.psi, self.worst) = (0, 0.0, f64::NEG_INFINITY);
    }

    /// Adds the next constraint with value `c`; returns `d psi / d c`, zero for an inactive constraint.
    pub fn next(&mut self, c: f64) -> f64 {
        if self.at == self.lambda.len() {
            self.lambda.push(0.0);
            self.last.push(0.0);
        }
        let lambda = self.lambda[self.at];
        self.last[self.at] = c;
        self.at += 1;
        self.worst = self.worst.max(c);
        let slope = lambda + self.rho * c;
        if slope > 0.0 {
            self.psi += (slope * slope - lambda * lambda) / (2.0 * self.rho);
            slope
        } else {
            self.psi -= lambda * lambda / (2.0 * self.rho);
            0.0
        }
    }

    /// `psi` of this evaluation.
    pub fn psi(&self) -> f64 {
        self.psi
    }

    /// Largest `c` of this evaluation; positive when a constraint is violated.
    pub fn worst(&self) -> f64 {
        self.worst
    }

    /// Updates the multipliers from the last evaluation and sets the penalty to `rho`.
    pub fn update(&mut self, rho: f64) {
        for (lambda, c) in self.lambda.iter_mut().zip(&self.last) {
            *lambda = (*lambda + self.rho * c).max(0.0);
        }
        self.rho = rho;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_multiplier_converges() {
        // min (x - 3)^2 / 2 with x <= 1: x = 1, lambda = 2. The minimum for a given lambda and rho is known.
        let mut constraints = AugmentedLagrangian::new(5.0);
        let mut x = 3.0;
        for _ in 0..30 {
            x = (3.0 - constraints.lambda.first().unwrap_or(&0.0) + constraints.rho) / (1.0 + constraints.rho);
            constraints.start();
            let slope = constraints.next(x - 1.0);
            assert!((x - 3.0 + slope).abs() < 1e-12, "stationary");
            assert!((constraints.worst() - (x - 1.0)).abs() < 1e-15);
            constraints.update(5.0);
        }
        assert!((x - 1.0).abs() < 1e-9 && (constraints.lambda[0] - 2.0).abs() < 1e-8);
    }
}
