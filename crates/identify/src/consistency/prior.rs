//! Prior of bodies and rotors where the data does not determine them.

use nalgebra::{DVector, Matrix4, Vector3};
use plumbline_model::{LinkParameters, Structure, link_parameters, pseudo_inertia};

/// Ratio of a link's thickness (standard deviation of its mass across its length) to the length of the arm.
const THICKNESS_RATIO: f64 = 0.06;
/// Thickness of an arm without lengths \[m\].
const MIN_THICKNESS: f64 = 0.01;
/// Mass of a link where the parameters do not determine the arm's mass \[kg\].
const DEFAULT_MASS: f64 = 1.0;

/// Bodies and rotors for undetermined directions. Consistent parameters are reproduced for any prior.
#[derive(Clone, Debug, PartialEq)]
pub struct Prior {
    /// One body per link, with a positive definite pseudo-inertia.
    pub links: Vec<LinkParameters>,
    /// Rotor inertia of each joint reflected through its gear, positive \[kg m2\] (prismatic: kg).
    pub rotors: Vec<f64>,
}

impl Prior {
    /// Uniform rods of equal mass between consecutive link frames. The mass is a least-squares fit to the base parameters among `beta` (one
    /// value per column of `structure`).
    pub fn of_geometry(structure: &Structure, beta: &[f64]) -> Prior {
        assert_eq!(beta.len(), structure.columns().len(), "one value per column");
        let (chain, reduction) = (structure.chain(), structure.reduction());
        let n = chain.len();
        let end = |i: usize| match chain.joints().get(i + 1) {
            Some(next) => next.placement(0.0).origin,
            None => chain.flange().origin,
        };
        let ends: Vec<Vector3<f64>> = (0..n).map(end).collect();
        let reach: f64 = ends.iter().map(|end| end.norm()).sum();
        let thickness = (THICKNESS_RATIO * reach).max(MIN_THICKNESS);
        let unit: Vec<LinkParameters> = ends.iter().map(|end| rod(end, thickness)).collect();

        // The mass that fits best, every parameter weighted by its size for unit masses.
        let of_unit = reduction.base_of(&stacked(&unit));
        let size = reduction.regroup().abs() * sizes(&unit);
        let (mut own, mut with) = (0.0, 0.0);
        for ((unit, size), beta) in of_unit.iter().zip(&size).zip(beta) {
            own += (unit / size).powi(2);
            with += unit * beta / (size * size);
        }
        let fits = with / own;
        let mass = if fits.is_finite() && fits > 0.0 { fits } else { DEFAULT_MASS };
        let links: Vec<LinkParameters> = unit.iter().map(|link| link.map(|value| mass * value)).collect();
        Prior { rotors: links.iter().map(|link| link[5]).collect(), links }
    }
}

/// A rod of mass 1 from the origin to `end`: second moment `end end'/3` along it, thickness squared in all directions.
fn rod(end: &Vector3<f64>, thickness: f64) -> LinkParameters {
    let mut j = Matrix4::zeros();
    let second = end * end.transpose() / 3.0 + thickness * thickness * nalgebra::Matrix3::identity();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&second);
    for axis in 0..3 {
        j[(axis, 3)] = 0.5 * end[axis];
        j[(3, axis)] = 0.5 * end[axis];
    }
    j[(3, 3)] = 1.0;
    debug_assert!((pseudo_inertia(&link_parameters(&j)) - j).amax() < 1e-12);
    link_parameters(&j)
}

/// Scale of the parameters of such bodies, independent of the axes' directions: second moment, square root of second moment times mass,
/// and mass. 10 n.
pub fn sizes(links: &[LinkParameters]) -> DVector<f64> {
    let size = |link: &LinkParameters| {
        let j = pseudo_inertia(link);
        let (second, mass) = (j[(0, 0)] + j[(1, 1)] + j[(2, 2)], j[(3, 3)]);
        std::array::from_fn::<f64, 10, _>(|k| match k {
            0..=5 => second,
            6..=8 => (second * mass).sqrt(),
            _ => mass,
        })
    };
    DVector::from_iterator(10 * links.len(), links.iter().flat_map(size))
}

/// Standard parameters one after another, 10 n.
pub fn stacked(links: &[LinkParameters]) -> DVector<f64> {
    DVector::from_iterator(10 * links.len(), links.iter().flatten().copied())
}
