//! Maps between parameters and the coordinates of [`super::solve`].

use super::cone::{LINK, Shape, coordinates, matrix};
use super::prior::{Prior, sizes, stacked};
use super::solve::Problem;
use super::{Uncertainty, Weights};
use nalgebra::{DMatrix, DVector, Matrix4};
use plumbline_model::term::Entry;
use plumbline_model::{Structure, link_parameters, pseudo_inertia};

/// Ratio of standard deviation to size of a parameter where none is known.
const UNKNOWN_STD_RATIO: f64 = 0.01;
/// Ratio of standard deviation to size of an undetermined parameter.
const UNDETERMINED_STD_RATIO: f64 = 10.0;
/// Minimum ratio of standard deviation to size of a parameter, so that exact data has finite weights.
const MIN_STD_RATIO: f64 = 1e-9;
/// Added to every correlation's diagonal, so that directions without noise can be solved for.
const RIDGE: f64 = 1e-12;

/// `beta = K [delta; ia]` for the columns that bodies and rotors determine.
pub struct Map {
    /// The structure's columns that are rows of `k`: those of the rigid body, then the rotors' own.
    pub rows: Vec<usize>,
    /// Joints with a rotor of their own in the model, from 0; their inertias are the variables behind `delta`.
    pub rotors: Vec<usize>,
    /// rows x (10 n + rotors).
    pub k: DMatrix<f64>,
    /// For every row a variable with coefficient 1 in it and 0 in all others.
    pub own: Vec<usize>,
}

impl Map {
    /// Of a model's structure.
    pub fn of(structure: &Structure) -> Map {
        let n = structure.chain().len();
        let reduction = structure.reduction();
        let rigid = reduction.len();
        let columns = structure.columns();
        let mut rows: Vec<usize> = (0..rigid).collect();
        let mut own = reduction.independent().to_vec();
        let mut rotors: Vec<(usize, Vec<(usize, f64)>)> = Vec::new();
        for (term, range) in structure.terms().iter().zip(structure.ranges()) {
            for (entry, c) in term.entries().unwrap_or_default().into_iter().zip(range) {
                if let Entry::Acceleration { joint } = entry {
                    rotors.push((joint, vec![(rows.len(), 1.0)]));
                    rows.push(c);
                }
            }
        }
        let known: Vec<String> = rotor_inertia_names(n);
        for absorbed in structure.absorbed().iter().filter(|absorbed| known.contains(&absorbed.column.name)) {
            let row = |name: &str| rows.iter().position(|&row| columns[row].name == *name);
            let into = absorbed.into.iter().map(|(name, value)| row(name).map(|row| (row, *value)));
            if let Some(into) = into.collect::<Option<Vec<_>>>() {
                rotors.push((absorbed.column.joint - 1, into));
            }
        }
        let mut k = DMatrix::zeros(rows.len(), LINK * n + rotors.len());
        k.view_mut((0, 0), (rigid, LINK * n)).copy_from(reduction.regroup());
        for (index, (_, into)) in rotors.iter().enumerate() {
            for &(row, value) in into {
                k[(row, LINK * n + index)] = value;
            }
        }
        own.extend((0..rows.len() - rigid).map(|index| LINK * n + index));
        Map { rows, rotors: rotors.into_iter().map(|(joint, _)| joint).collect(), k, own }
    }

    fn sizes(&self, prior: &Prior) -> DVector<f64> {
        self.k.abs() * self.variables(sizes(&prior.links), prior)
    }

    fn prior(&self, prior: &Prior) -> DVector<f64> {
        self.variables(stacked(&prior.links), prior)
    }

    fn variables(&self, links: DVector<f64>, prior: &Prior) -> DVector<f64> {
        let rotors = self.rotors.iter().map(|&joint| prior.rotors[joint]);
        DVector::from_iterator(self.k.ncols(), links.iter().copied().chain(rotors))
    }
}

/// Names of the columns of rotors, joint by joint.
fn rotor_inertia_names(n: usize) -> Vec<String> {
    (1..=n).map(|joint| format!("ia{joint}")).collect()
}

/// Covariance of the rows of a [`Map`], as deviations and correlation.
pub struct Metric {
    /// Standard deviation of every row, in its unit.
    pub deviations: DVector<f64>,
    /// Correlation, rows x rows.
    pub correlation: DMatrix<f64>,
    /// Where it comes from.
    pub weights: Weights,
}

impl Metric {
    /// Metric of the known uncertainty. A row without a standard deviation gets one by its size for `usual` bodies, independent of the prior.
    pub fn of(map: &Map, uncertainty: Uncertainty, usual: &Prior) -> Metric {
        let (deviations_of, weights) = match uncertainty {
            Uncertainty::Covariance(_, deviations) => (deviations, Weights::Covariance),
            Uncertainty::Deviations(deviations) if map.rows.iter().any(|&row| deviations[row].is_some()) => {
                (deviations, Weights::Deviations)
            }
            Uncertainty::Deviations(deviations) => (deviations, Weights::Relative),
        };
        let size = map.sizes(usual);
        let unknown = if weights == Weights::Relative { UNKNOWN_STD_RATIO } else { UNDETERMINED_STD_RATIO };
        let deviation = |(&row, size): (&usize, &f64)| match deviations_of[row] {
            Some(deviation) => deviation.max(MIN_STD_RATIO * size),
            None => unknown * size,
        };
        let rows = map.rows.len();
        let deviations = DVector::from_iterator(rows, map.rows.iter().zip(&size).map(deviation));
        let mut correlation = DMatrix::identity(rows, rows);
        if let Uncertainty::Covariance(covariance, _) = uncertainty {
            for (i, &row) in map.rows.iter().enumerate() {
                for (k, &column) in map.rows.iter().enumerate().filter(|(k, _)| *k != i) {
                    correlation[(i, k)] = covariance[(row, column)] / (deviations[i] * deviations[k]);
                }
            }
        }
        for i in 0..rows {
            correlation[(i, i)] += RIDGE;
        }
        Metric { deviations, correlation, weights }
    }
}

/// Map from a point of the cone to parameters: `J_i = (1 - floor) L_i B_i L_i' + floor J0_i` with `J0_i = L_i L_i'` the prior's.
pub struct Space {
    prior: DVector<f64>,
    roots: Vec<Matrix4<f64>>,
    floor: f64,
}

impl Space {
    /// `None` where a body of the prior is inconsistent.
    pub fn new(map: &Map, prior: &Prior, floor: f64) -> Option<Space> {
        let root = |link| pseudo_inertia(link).cholesky().map(|factor| factor.l());
        let roots = prior.links.iter().map(root).collect::<Option<_>>()?;
        Some(Space { prior: map.prior(prior), roots, floor })
    }

    /// Parameters `[delta; ia]` of a point.
    pub fn parameters(&self, point: &DVector<f64>) -> DVector<f64> {
        self.linear(point) + &self.prior * self.floor
    }

    fn linear(&self, point: &DVector<f64>) -> DVector<f64> {
        let mut out = DVector::zeros(point.len());
        let scale = 1.0 - self.floor;
        for (i, root) in self.roots.iter().enumerate() {
            let b = matrix(&point.as_slice()[LINK * i..LINK * (i + 1)]);
            let link = link_parameters(&(root * b * root.transpose()));
            for (k, value) in link.iter().enumerate() {
                out[LINK * i + k] = scale * value;
            }
        }
        for k in LINK * self.roots.len()..point.len() {
            out[k] = scale * self.prior[k] * point[k];
        }
        out
    }

    /// The adjoint of the linear part, for one row of `K`.
    fn adjoint(&self, row: &[f64], out: &mut [f64]) {
        let scale = 1.0 - self.floor;
        for (i, root) in self.roots.iter().enumerate() {
            let own = &row[LINK * i..LINK * (i + 1)];
            let mapped = if own.iter().all(|value| *value == 0.0) {
                Matrix4::zeros()
            } else {
                scale * (root.transpose() * weights_on_pseudo_inertia(own) * root)
            };
            out[LINK * i..LINK * (i + 1)].copy_from_slice(coordinates(&mapped).as_slice());
        }
        for k in LINK * self.roots.len()..row.len() {
            out[k] = scale * self.prior[k] * row[k];
        }
    }

    /// The problem in these coordinates, every row over its standard deviation.
    pub fn problem(&self, map: &Map, metric: &Metric, target: &DVector<f64>) -> Problem {
        let variables = map.k.ncols();
        let links = self.roots.len();
        let mut kt = DMatrix::zeros(variables, map.rows.len());
        let mut row = vec![0.0; variables];
        for r in 0..map.rows.len() {
            for (c, value) in row.iter_mut().enumerate() {
                *value = map.k[(r, c)] / metric.deviations[r];
            }
            self.adjoint(&row, &mut kt.as_mut_slice()[r * variables..(r + 1) * variables]);
        }
        Problem {
            shape: Shape { links, rotors: variables - LINK * links },
            kt,
            c: metric.correlation.clone(),
            target: (target - &map.k * &self.prior * self.floor).component_div(&metric.deviations),
        }
    }
}

/// The symmetric `M` with `tr(M J(delta)) = row . delta` for every `delta`.
fn weights_on_pseudo_inertia(row: &[f64]) -> Matrix4<f64> {
    let (xx, yy, zz) = (row[0], row[3], row[5]);
    let half = |value: f64| 0.5 * value;
    Matrix4::new(
        yy + zz,
        half(-row[1]),
        half(-row[2]),
        half(row[6]), //
        half(-row[1]),
        xx + zz,
        half(-row[4]),
        half(row[7]), //
        half(-row[2]),
        half(-row[4]),
        xx + yy,
        half(row[8]), //
        half(row[6]),
        half(row[7]),
        half(row[8]),
        row[9],
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_the_adjoint_of_the_parameters() {
        let link = [0.3, -0.1, 0.2, 0.5, 0.07, 0.4, 0.1, -0.2, 0.3, 2.0];
        let row: Vec<f64> = (0..LINK).map(|k| (k as f64 * 1.7).sin()).collect();
        let product: f64 = row.iter().zip(&link).map(|(a, b)| a * b).sum();
        let trace = (weights_on_pseudo_inertia(&row) * pseudo_inertia(&link)).trace();
        assert!((product - trace).abs() < 1e-14);
    }
}
