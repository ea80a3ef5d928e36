//! An undeclared tool or load on the last link.

use super::all_rows::*;
use super::family::*;
use super::quantity;
use super::{Column, Sample};
use crate::fast::links::LinkColumns;
use crate::inertia::Body;
use crate::regressor::LINK_COLUMNS;
use nalgebra::DVector;
use plumbline_core::JointVec;

/// A rigid body fixed to the last link.
pub static FAMILY: Family = Family {
    id: "payload",
    physics: "A rigid body is fixed to the last link that was not there at the identification.",
    place: Place::Arm,
    forms: &[
        Form {
            name: "",
            equation: "tau = Y_n [Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m], the body's in the last link's frame, in all rows",
            settings: &[],
            build: |operating_point, site, settings| build(operating_point, site, settings, "", 0),
            in_c: InC::LastLink,
            plot_over: PlotOver::Nothing,
        },
        Form {
            name: "light",
            equation: "tau = Y_n [lx ly lz m], alike, of a body whose inertia is too small to show",
            settings: &[],
            build: |operating_point, site, settings| build(operating_point, site, settings, "light", LIGHT),
            in_c: InC::LastLink,
            plot_over: PlotOver::Nothing,
        },
    ],
    stratum: Stratum::Reference,
    typical: "0.1 to 3 kg",
    confounded: &[
        confounded("the last link's own parameters", "a recording without the load, or a model from before"),
        confounded("torque-gain", "weigh the load: a gain common to all joints scales all masses"),
        confounded("the link before the last", "turn the wrist: a centre of mass on the last axis looks like theirs"),
    ],
    reference: "Khalil, Gautier, Lemoine, ICRA 2007; Swevers et al., IEEE Control Systems Magazine 27 (2007)",
    rare: Rare {
        may_change: true,
        comes_at_once: true,
        in_bodies: InBodies::LastLink,
        quantities: body_or_parameters,
        ..Rare::NONE
    },
};

const PARAMETERS: [(&str, &str); LINK_COLUMNS] = [
    ("Lxx", "kg m2"),
    ("Lxy", "kg m2"),
    ("Lxz", "kg m2"),
    ("Lyy", "kg m2"),
    ("Lyz", "kg m2"),
    ("Lzz", "kg m2"),
    ("lx", "kg m"),
    ("ly", "kg m"),
    ("lz", "kg m"),
    ("m", "kg"),
];

/// Parameters that a light body lacks: the first ones.
const LIGHT: usize = 6;

/// Position of a column's parameter among those of a link, by the column's name.
pub fn slot(column: &str) -> Option<usize> {
    let own = column.strip_prefix("payload_")?.trim_end_matches("_light");
    PARAMETERS.iter().position(|(name, _)| *name == own)
}

/// With the parameters from `least` on.
fn build(
    operating_point: &OperatingPoint,
    site: Site,
    settings: &[f64],
    form: &'static str,
    least: usize,
) -> Arc<dyn Term> {
    let chain = operating_point.chain.clone();
    let named = |(what, unit): (&str, &'static str)| {
        let suffix = if form.is_empty() { String::new() } else { format!("_{form}") };
        let name = format!("payload_{what}{suffix}");
        Column { symbol: name.clone(), expression: name.clone(), name, joint: chain.len(), unit }
    };
    let columns = PARAMETERS[least..].iter().copied().map(named).collect();
    AllRows::term(&FAMILY, form, site, settings, columns, move |gravity| {
        let first = LINK_COLUMNS * (chain.len() - 1);
        let slots: Vec<usize> = (first + least..first + LINK_COLUMNS).collect();
        BodyColumns(LinkColumns::new(&chain, &slots, gravity))
    })
}

struct BodyColumns(LinkColumns);

impl Law for BodyColumns {
    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        self.0.fill(sample, columns);
    }
}

/// Names and units of a body's numbers: mass, centre of mass, inertia about it (entries of the matrix), in the frame of the last link.
const NUMBERS: [(&str, &str); LINK_COLUMNS] = [
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

/// Step of the differences, in standard deviations of the parameter.
const STEP_RATIO: f64 = 1e-3;
/// Largest squared share of a number's sensitivity in undetermined directions for which it has a standard deviation.
const UNDETERMINED_RATIO: f64 = 1e-3;
/// Smallest mass for which a centre of mass is reported, in its standard deviations.
const MASS_DEVIATIONS: f64 = 2.0;

/// The body, or the parameters where its mass may be zero.
fn body_or_parameters(results: &Results) -> Vec<Quantity> {
    body(results).unwrap_or_else(|| quantity::own(results))
}

/// Mass, centre of mass and inertia with standard deviations of first order (delta method).
fn body(results: &Results) -> Option<Vec<Quantity>> {
    let Results { parameters, covariance, undetermined, .. } = *results;
    let slots: Vec<usize> = parameters.iter().filter_map(|parameter| slot(&parameter.column.name)).collect();
    let mut values = [0.0; LINK_COLUMNS];
    slots.iter().zip(parameters).for_each(|(&slot, parameter)| values[slot] = parameter.value);
    let mass = slots.iter().position(|slot| *slot == LINK_COLUMNS - 1)?;
    let mass_std = covariance[(mass, mass)].max(0.0).sqrt();
    if values[9].abs() < MASS_DEVIATIONS * mass_std || values[9] == 0.0 {
        return None;
    }
    let std = |k: usize| covariance[(k, k)].max(0.0).sqrt().max(1e-9);
    let slope = |k: usize| {
        let moved = |by: f64| {
            let mut values = values;
            values[slots[k]] += by * STEP_RATIO * std(k);
            numbers(&values)
        };
        let (up, down) = (moved(1.0), moved(-1.0));
        std::array::from_fn(|i| (up[i] - down[i]) / (2.0 * STEP_RATIO * std(k)))
    };
    let slopes: Vec<[f64; LINK_COLUMNS]> = (0..slots.len()).map(slope).collect();
    // Of a light body only mass and centre are known.
    let known = if slots.len() == LINK_COLUMNS { LINK_COLUMNS } else { LINK_COLUMNS - LIGHT };
    let quantity = |(i, value): (usize, f64)| {
        let slope = DVector::from_fn(slots.len(), |k, _| slopes[k][i]);
        let variance = (covariance * &slope).dot(&slope);
        let known =
            undetermined.ncols() == 0 || undetermined.tr_mul(&slope.normalize()).norm_squared() <= UNDETERMINED_RATIO;
        let (name, unit) = NUMBERS[i];
        Quantity { name: name.into(), value, std: known.then(|| variance.max(0.0).sqrt()), unit: unit.into() }
    };
    Some(numbers(&values).into_iter().enumerate().take(known).map(quantity).collect())
}

/// The numbers of [`NUMBERS`] from standard parameters.
fn numbers(values: &[f64; LINK_COLUMNS]) -> [f64; LINK_COLUMNS] {
    let Body { mass, com, inertia: i } = Body::of(values);
    [mass, com.x, com.y, com.z, i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::torque::Parameter;
    use nalgebra::{DMatrix, Matrix3, Vector3};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn parameters(values: &[f64]) -> Vec<Parameter> {
        let column = |k: usize| {
            let name = format!("payload_{}", PARAMETERS[k].0);
            Column { symbol: name.clone(), expression: name.clone(), name, joint: 7, unit: "kg" }
        };
        values.iter().enumerate().map(|(k, &value)| Parameter { column: column(k), value, std: None }).collect()
    }

    fn body_of(values: &[f64], covariance: &DMatrix<f64>, undetermined: &DMatrix<f64>) -> Option<Vec<Quantity>> {
        let parameters = parameters(values);
        body(&Results { parameters: &parameters, covariance, undetermined, stored: &[], declared: None })
    }

    #[test]
    fn standard_deviations_are_those_of_random_draws() {
        let inertia = Matrix3::new(0.001, 0.0, 0.0, 0.0, 0.0025, 0.0001, 0.0, 0.0001, 0.0017);
        let payload = Body { mass: 0.73, com: Vector3::new(0.01, -0.02, 0.15), inertia };
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        // The sum of twelve uniform numbers has the variance of a normal one.
        let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
        let factor = DMatrix::from_fn(10, 10, |i, k| if k <= i { 2e-4 * normal() } else { 0.0 });
        let covariance = &factor * factor.transpose();
        let found = body_of(&payload.link_parameters(), &covariance, &DMatrix::zeros(10, 0)).unwrap();
        assert!((found[0].value - 0.73).abs() < 1e-12 && (found[3].value - 0.15).abs() < 1e-12);
        assert!((found[8].value - 0.0001).abs() < 1e-12);
        let (draws, mut sum) = (20_000, [0.0; 10]);
        for _ in 0..draws {
            let noise = &factor * DVector::from_fn(10, |_, _| normal());
            let drawn: [f64; 10] = std::array::from_fn(|k| payload.link_parameters()[k] + noise[k]);
            let numbers = numbers(&drawn);
            for (k, sum) in sum.iter_mut().enumerate() {
                *sum += (numbers[k] - found[k].value).powi(2) / f64::from(draws);
            }
        }
        for (quantity, square) in found.iter().zip(sum) {
            let ratio = quantity.std.unwrap() / square.sqrt();
            assert!((ratio - 1.0).abs() < 0.05, "{ratio}");
        }
    }

    #[test]
    fn an_undetermined_number_has_no_standard_deviation() {
        let values = [0.02, 0.0, 0.0, 0.02, 0.0, 0.001, 0.0, 0.0, 0.1, 0.7];
        let mut undetermined = DMatrix::zeros(10, 1);
        undetermined[(3, 0)] = 1.0;
        let covariance = DMatrix::from_diagonal_element(10, 10, 1e-6);
        let found = body_of(&values, &covariance, &undetermined).unwrap();
        assert!(found[0].std.is_some() && found[7].std.is_none());
        // A mass that may be zero has no centre.
        assert!(body_of(&[0.0; 10], &covariance, &DMatrix::zeros(10, 0)).is_none());
    }
}
