//! Physical consistency: the nearest standard parameters of physically possible bodies.
//!
//! Base parameters `beta = K delta` leave 25 of a Panda's 70 standard parameters undetermined, and with noise no physically possible `delta`
//! may exist. [`nearest`] finds, with every link's pseudo-inertia `J_i(delta_i)` positive definite
//! ([`plumbline_model::is_consistent`]) and every rotor inertia positive,
//!
//! - where `beta` is consistent: the `delta` with `K delta = beta` that is nearest to a prior in the entropic divergence;
//! - else: the `delta` that minimises `(beta - K delta)' C^-1 (beta - K delta)` with `C` the estimate's covariance.
//!
//! `C` is the marginal covariance of the rigid-body and rotor parameters, so that the result is the minimum over all parameters at once:
//! friction and offsets are unconstrained and change with the others by their correlation ([`Nearest::beta`]).

mod cone;
mod prior;
mod solve;
mod space;

pub use prior::Prior;

use cone::LINK;
use nalgebra::{DMatrix, DVector};
use plumbline_model::{LinkParameters, Structure, is_consistent};
use space::{Map, Metric, Space};

/// Uncertainty of the parameters.
#[derive(Clone, Copy, Debug)]
pub enum Uncertainty<'a> {
    /// Covariance of all columns of the structure, and which of them the data determined.
    Covariance(&'a DMatrix<f64>, &'a [Option<f64>]),
    /// Standard deviations alone, where known.
    Deviations(&'a [Option<f64>]),
}

/// Metric of the distances.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Weights {
    /// The whole covariance.
    Covariance,
    /// Standard deviations, as if the parameters were independent.
    Deviations,
    /// One per cent of every parameter's size, without any known standard deviation.
    Relative,
}

impl Weights {
    /// Description for reports.
    pub fn text(&self) -> &'static str {
        match self {
            Weights::Covariance => "in the estimate's covariance",
            Weights::Deviations => "by each parameter's standard deviation alone",
            Weights::Relative => "with 1 % of each parameter's size for one, since no standard deviation is known",
        }
    }
}

/// Nearest consistent standard parameters, and their distance to the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Nearest {
    /// Standard parameters of every link.
    pub links: Vec<LinkParameters>,
    /// Rotor inertia of every joint, reflected through its gear; zero where the model has no such term \[kg m2\].
    pub rotors: Vec<f64>,
    /// Parameters of all columns: `K delta` for the rigid body; friction and offsets by their correlation with it.
    pub beta: Vec<f64>,
    /// Whether the rigid-body parameters of the estimate are reproduced to rounding.
    pub exact: bool,
    /// `sqrt((beta - K delta)' C^-1 (beta - K delta))`, zero where reproduced.
    pub distance: f64,
    /// How far every column moved, in its standard deviations.
    pub moved: Vec<f64>,
    /// Metric of the distance.
    pub weights: Weights,
    /// Linear systems that were solved.
    pub iterations: usize,
}

/// Why no consistent parameters were found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum ConsistencyError {
    #[error(
        "link {link} of the prior is not physically consistent: its pseudo-inertia is not positive definite ({parameters:?})"
    )]
    Prior { link: usize, parameters: LinkParameters },
    #[error("the rotor inertia of joint {joint} in the prior is {value}, not positive")]
    Rotor { joint: usize, value: f64 },
    /// Values that are not finite, or no convergence.
    #[error("no consistent parameters were found: the parameters or their covariance are not usable numbers")]
    Failed,
}

/// Minimum ratio of a link's `J` to the prior's in any direction, where the estimate is not consistent. The bodies' thickness is at least a
/// hundredth of the prior's, so that a simulator can use them.
pub const FLOOR: f64 = 1e-4;
/// Maximum Newton steps for reproducing consistent parameters.
const EXACT_STEPS: usize = 15;
/// Distance of the nearest body in standard deviations below which the exact problem is tried again, and its maximum steps.
const EDGE: f64 = 0.05;
const EDGE_STEPS: usize = 60;

/// Finds the nearest consistent parameters of `beta`, one value per column of `structure`.
///
/// # Errors
/// An inconsistent prior; values that are not finite.
///
/// # Panics
/// When the sizes of `beta`, `uncertainty` and `prior` are not those of the structure.
pub fn nearest(
    structure: &Structure,
    beta: &[f64],
    uncertainty: Uncertainty,
    prior: &Prior,
) -> Result<Nearest, ConsistencyError> {
    check(structure, beta, uncertainty, prior)?;
    let map = Map::of(structure);
    let usual = Prior::of_geometry(structure, beta);
    let metric = Metric::of(&map, uncertainty, &usual);
    let target = DVector::from_iterator(map.rows.len(), map.rows.iter().map(|&row| beta[row]));
    let space = |floor| Space::new(&map, prior, floor).ok_or(ConsistencyError::Failed);

    // Consistent parameters first: about ten steps. Parameters at the boundary of the cone take more steps; they are tried again only when
    // // the nearest body is very close.
    let strict = space(0.0)?;
    let problem = strict.problem(&map, &metric, &target);
    let mut attempt = solve::exact(&problem, EXACT_STEPS);
    let mut apart = None;
    if let Err(before) = attempt {
        let floored = space(FLOOR)?;
        let (point, y, steps) =
            solve::nearest(&floored.problem(&map, &metric, &target)).ok_or(ConsistencyError::Failed)?;
        let iterations = before + steps;
        if distance(&metric, &y) < EDGE {
            attempt = solve::exact(&problem, EDGE_STEPS);
        }
        apart = Some((floored.parameters(&point), y, iterations));
    }
    let (delta, y, exact, iterations) = match (attempt, apart) {
        (Ok((point, steps)), apart) => {
            let delta = polished(&map, &target, strict.parameters(&point));
            (delta, DVector::zeros(target.len()), true, steps + apart.map_or(0, |(_, _, before)| before))
        }
        (Err(_), Some((delta, y, steps))) => (delta, y, false, steps),
        (Err(_), None) => return Err(ConsistencyError::Failed),
    };

    let n = structure.chain().len();
    let links: Vec<LinkParameters> = (0..n).map(|i| std::array::from_fn(|k| delta[LINK * i + k])).collect();
    let mut rotors = vec![0.0; n];
    for (index, &joint) in map.rotors.iter().enumerate() {
        rotors[joint] = delta[LINK * n + index];
    }
    if !links.iter().all(is_consistent) || rotors.iter().any(|rotor| *rotor < 0.0) {
        return Err(ConsistencyError::Failed);
    }
    let mut now = beta.to_vec();
    if !exact {
        for (&row, value) in map.rows.iter().zip(&(&map.k * &delta)) {
            now[row] = *value;
        }
    }
    if let (false, Uncertainty::Covariance(covariance, _)) = (exact, uncertainty) {
        // The others' best values given these: beta_o - C_or C_rr^-1 (beta_r - K delta), and C_rr^-1 (..) is y.
        let y = y.component_div(&metric.deviations);
        for c in (0..beta.len()).filter(|c| !map.rows.contains(c)) {
            now[c] -= map.rows.iter().zip(&y).map(|(&row, y)| covariance[(c, row)] * y).sum::<f64>();
        }
    }
    let distance = distance(&metric, &y);
    let moved = if exact { vec![0.0; beta.len()] } else { deviations(&map, &metric, uncertainty, beta, &now) };
    Ok(Nearest { links, rotors, beta: now, exact, distance, moved, weights: metric.weights, iterations })
}

/// Parameters of given bodies and rotors: the structure's columns that they determine, with their values.
pub fn parameters_of(structure: &Structure, links: &[LinkParameters], rotors: &[f64]) -> Vec<(usize, f64)> {
    let n = structure.chain().len();
    assert_eq!((links.len(), rotors.len()), (n, n), "one body and one rotor per joint");
    let map = Map::of(structure);
    let variables = map.rotors.iter().map(|&joint| rotors[joint]);
    let variables = links.iter().flatten().copied().chain(variables);
    let values = &map.k * DVector::from_iterator(map.k.ncols(), variables);
    map.rows.iter().copied().zip(values.iter().copied()).collect()
}

/// Removes the rounding error through variables with one row each, so that `K delta` is the target.
fn polished(map: &Map, target: &DVector<f64>, mut delta: DVector<f64>) -> DVector<f64> {
    let rest = target - &map.k * &delta;
    for (&own, rest) in map.own.iter().zip(&rest) {
        delta[own] += rest;
    }
    delta
}

/// `sqrt(y' C y)`.
fn distance(metric: &Metric, y: &DVector<f64>) -> f64 {
    y.dot(&(&metric.correlation * y)).max(0.0).sqrt()
}

/// How far every column moved, in its standard deviations.
fn deviations(map: &Map, metric: &Metric, uncertainty: Uncertainty, from: &[f64], to: &[f64]) -> Vec<f64> {
    let (Uncertainty::Covariance(_, known) | Uncertainty::Deviations(known)) = uncertainty;
    let deviation = |c: usize| match map.rows.iter().position(|&row| row == c) {
        Some(r) => Some(metric.deviations[r]),
        None => known[c],
    };
    let moved = |c: usize| match deviation(c) {
        Some(deviation) if to[c] != from[c] => (to[c] - from[c]) / deviation,
        _ => 0.0,
    };
    (0..from.len()).map(moved).collect()
}

fn check(structure: &Structure, beta: &[f64], uncertainty: Uncertainty, prior: &Prior) -> Result<(), ConsistencyError> {
    let (n, columns) = (structure.chain().len(), structure.columns().len());
    assert_eq!(beta.len(), columns, "one value per column");
    assert_eq!((prior.links.len(), prior.rotors.len()), (n, n), "one body and one rotor per joint in the prior");
    let known = match uncertainty {
        Uncertainty::Covariance(covariance, known) => {
            assert_eq!(covariance.shape(), (columns, columns), "a covariance of all columns");
            if covariance.iter().any(|value| !value.is_finite()) {
                return Err(ConsistencyError::Failed);
            }
            known
        }
        Uncertainty::Deviations(known) => known,
    };
    assert_eq!(known.len(), columns, "one standard deviation per column");
    if beta.iter().chain(known.iter().flatten()).any(|value| !value.is_finite()) {
        return Err(ConsistencyError::Failed);
    }
    if let Some(i) = prior.links.iter().position(|link| !is_consistent(link)) {
        return Err(ConsistencyError::Prior { link: i + 1, parameters: prior.links[i] });
    }
    if let Some(j) = prior.rotors.iter().position(|rotor| !(rotor.is_finite() && *rotor > 0.0)) {
        return Err(ConsistencyError::Rotor { joint: j + 1, value: prior.rotors[j] });
    }
    Ok(())
}
