//! A payload as a body: from its ten standard parameters to mass, centre of mass and inertia, with errors.

use nalgebra::{DMatrix, DVector};
use plumbline_model::{Body, Parameter};

/// A number with its standard deviation, where the data determines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The number.
    pub value: f64,
    /// Its standard deviation; `None` where the data says nothing about it.
    pub std: Option<f64>,
}

/// What was picked up, in the frame of the last link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PayloadBody {
    /// Mass \[kg\].
    pub mass: Estimate,
    /// Centre of mass \[m\].
    pub com: [Estimate; 3],
    /// Inertia about the centre of mass, `[Ixx Ixy Ixz Iyy Iyz Izz]`, entries of the matrix \[kg m2\].
    pub inertia: [Estimate; 6],
}

/// Names of the ten numbers of a [`PayloadBody`], and their units.
pub const NAMES: [(&str, &str); 10] = [
    ("mass", "kg"),
    ("com_x", "m"),
    ("com_y", "m"),
    ("com_z", "m"),
    ("Ixx", "kg m2"),
    ("Ixy", "kg m2"),
    ("Ixz", "kg m2"),
    ("Iyy", "kg m2"),
    ("Iyz", "kg m2"),
    ("Izz", "kg m2"),
];

/// Step of the differences, as a share of each parameter's standard deviation.
const STEP: f64 = 1e-3;
/// Share of a number's sensitivity that may lie in directions that nothing determines.
const UNDETERMINED_SHARE: f64 = 1e-3;

impl PayloadBody {
    /// Of the ten standard parameters, their covariance, and the directions that nothing determines (one row per parameter). First order
    /// (delta method). `None` where the mass is not to be told from nothing, so that there is no centre of mass.
    pub fn of(parameters: &[Parameter], covariance: &DMatrix<f64>, unknown: &DMatrix<f64>) -> Option<PayloadBody> {
        let values: [f64; 10] = std::array::from_fn(|k| parameters.get(k).map_or(0.0, |parameter| parameter.value));
        let of_mass = covariance[(9, 9)].max(0.0).sqrt();
        if values[9].abs() < 2.0 * of_mass || values[9] == 0.0 {
            return None;
        }
        let centre = numbers(&values);
        let std = |k: usize| covariance[(k, k)].max(0.0).sqrt().max(1e-9);
        let slopes: Vec<[f64; 10]> = (0..10)
            .map(|k| {
                let moved = |by: f64| {
                    let mut values = values;
                    values[k] += by * STEP * std(k);
                    numbers(&values)
                };
                let (up, down) = (moved(1.0), moved(-1.0));
                std::array::from_fn(|i| (up[i] - down[i]) / (2.0 * STEP * std(k)))
            })
            .collect();
        let estimate = |i: usize| {
            let slope = DVector::from_fn(10, |k, _| slopes[k][i]);
            let variance = (covariance * &slope).dot(&slope);
            let scaled = slope.normalize();
            let known = unknown.ncols() == 0 || unknown.tr_mul(&scaled).norm_squared() <= UNDETERMINED_SHARE;
            Estimate { value: centre[i], std: known.then(|| variance.max(0.0).sqrt()) }
        };
        let (mass, com) = (estimate(0), std::array::from_fn(|k| estimate(1 + k)));
        Some(PayloadBody { mass, com, inertia: std::array::from_fn(|k| estimate(4 + k)) })
    }

    /// All ten, in the order of [`NAMES`].
    pub fn numbers(&self) -> Vec<Estimate> {
        [self.mass].into_iter().chain(self.com).chain(self.inertia).collect()
    }
}

/// Mass, centre of mass, inertia about it.
fn numbers(values: &[f64; 10]) -> [f64; 10] {
    let Body { mass, com, inertia: i } = Body::of(values);
    [mass, com.x, com.y, com.z, i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use plumbline_model::term::Column;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    fn parameters(values: &[f64]) -> Vec<Parameter> {
        let column = |k: usize| {
            let name = format!("p{k}");
            Column { symbol: name.clone(), expression: name.clone(), name, joint: 7, unit: "kg" }
        };
        values.iter().enumerate().map(|(k, &value)| Parameter { column: column(k), value, std: None }).collect()
    }

    #[test]
    fn errors_are_those_of_random_draws() {
        let inertia = Matrix3::new(0.001, 0.0, 0.0, 0.0, 0.0025, 0.0001, 0.0, 0.0001, 0.0017);
        let body = Body { mass: 0.73, com: Vector3::new(0.01, -0.02, 0.15), inertia };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let factor = DMatrix::from_fn(10, 10, |i, k| if k <= i { 2e-4 * normal() } else { 0.0 });
        let covariance = &factor * factor.transpose();
        let none = DMatrix::zeros(10, 0);
        let found = PayloadBody::of(&parameters(&body.link_parameters()), &covariance, &none).unwrap();
        assert!((found.mass.value - 0.73).abs() < 1e-12 && (found.com[2].value - 0.15).abs() < 1e-12);
        assert!((found.inertia[4].value - 0.0001).abs() < 1e-12);
        let (draws, mut sum) = (20_000, [0.0; 10]);
        for _ in 0..draws {
            let noise = &factor * DVector::from_fn(10, |_, _| normal());
            let drawn: [f64; 10] = std::array::from_fn(|k| body.link_parameters()[k] + noise[k]);
            let numbers = numbers(&drawn);
            for (k, sum) in sum.iter_mut().enumerate() {
                *sum += (numbers[k] - found.numbers()[k].value).powi(2) / f64::from(draws);
            }
        }
        for (estimate, square) in found.numbers().iter().zip(sum) {
            let ratio = estimate.std.unwrap() / square.sqrt();
            assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        }
    }

    #[test]
    fn what_nothing_determines_has_no_error() {
        let values = [0.02, 0.0, 0.0, 0.02, 0.0, 0.001, 0.0, 0.0, 0.1, 0.7];
        let mut unknown = DMatrix::zeros(10, 1);
        unknown[(3, 0)] = 1.0;
        let covariance = DMatrix::from_diagonal_element(10, 10, 1e-6);
        let found = PayloadBody::of(&parameters(&values), &covariance, &unknown).unwrap();
        assert!(found.mass.std.is_some() && found.inertia[3].std.is_none());
        // A mass that may be nothing has no centre.
        let none = DMatrix::zeros(10, 0);
        assert!(PayloadBody::of(&parameters(&[0.0; 10]), &covariance, &none).is_none());
    }
}
