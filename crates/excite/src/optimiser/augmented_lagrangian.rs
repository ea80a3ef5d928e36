//! Inequality constraints `c <= 0` by an augmented Lagrangian (Powell, Hestenes, Rockafellar).
//!
//! `psi = sum_i (max(0, lambda_i + rho c_i)^2 - lambda_i^2) / (2 rho)` is once differentiable, and `lambda_i <- max(0, lambda_i + rho c_i)`
//! between two minimisations takes the place of a penalty that would have to grow without end.

/// Multipliers and penalty of a fixed list of constraints that is walked in the same order every time.
#[derive(Clone, Debug)]
pub struct Held {
    rho: f64,
    lambda: Vec<f64>,
    last: Vec<f64>,
    at: usize,
    psi: f64,
    worst: f64,
}

impl Held {
    /// No multipliers yet.
    pub fn new(rho: f64) -> Held {
        Held { rho, lambda: Vec::new(), last: Vec::new(), at: 0, psi: 0.0, worst: f64::NEG_INFINITY }
    }

    /// Starts a walk.
    pub fn start(&mut self) {
        (self.at, self.psi, self.worst) = (0, 0.0, f64::NEG_INFINITY);
    }

    /// The next constraint has the value `c`; returns `d psi / d c`, zero when it does not act.
    pub fn next(&mut self, c: f64) -> f64 {
        if self.at == self.lambda.len() {
            self.lambda.push(0.0);
            self.last.push(0.0);
        }
        let lambda = self.lambda[self.at];
        self.last[self.at] = c;
        self.at += 1;
        self.worst = self.worst.max(c);
        let pull = lambda + self.rho * c;
        if pull > 0.0 {
            self.psi += (pull * pull - lambda * lambda) / (2.0 * self.rho);
            pull
        } else {
            self.psi -= lambda * lambda / (2.0 * self.rho);
            0.0
        }
    }

    /// `psi` of the walk.
    pub fn psi(&self) -> f64 {
        self.psi
    }

    /// Largest `c` of the walk: above zero, a constraint is broken.
    pub fn worst(&self) -> f64 {
        self.worst
    }

    /// Takes the multipliers of the last walk, then the new penalty.
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
    fn the_multiplier_is_found() {
        // min (x - 3)^2 / 2 with x <= 1: x = 1, lambda = 2. The minimum for a given lambda and rho is known.
        let mut held = Held::new(5.0);
        let mut x = 3.0;
        for _ in 0..30 {
            x = (3.0 - held.lambda.first().unwrap_or(&0.0) + held.rho) / (1.0 + held.rho);
            held.start();
            let pull = held.next(x - 1.0);
            assert!((x - 3.0 + pull).abs() < 1e-12, "stationary");
            assert!((held.worst() - (x - 1.0)).abs() < 1e-15);
            held.update(5.0);
        }
        assert!((x - 1.0).abs() < 1e-9 && (held.lambda[0] - 2.0).abs() < 1e-8);
    }

    #[test]
    fn the_pull_is_the_slope_of_psi() {
        let mut held = Held::new(7.0);
        held.start();
        held.next(0.2);
        held.update(11.0);
        for c in [-0.5, -0.05, 0.1] {
            let mut psi = |c: f64| {
                held.start();
                let pull = held.next(c);
                (held.psi(), pull)
            };
            let (up, down) = (psi(c + 1e-6).0, psi(c - 1e-6).0);
            assert!(((up - down) / 2e-6 - psi(c).1).abs() < 1e-6);
        }
    }
}
