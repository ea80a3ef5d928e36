//! Which arguments of a setter a robot takes.
//!
//! Ranges of impedances and filters are those that libfranka documents for `setJointImpedance`, `setCartesianImpedance` and
//! `setFilters`; everything else is what has a meaning at all.

use super::geometry::is_rigid;
use nalgebra::{Matrix3, SymmetricEigen};
use plumbline::backend::franka::wire::{CollisionBehavior, Load, Request};

/// Highest joint stiffness \[Nm/rad\].
const JOINT_STIFFNESS: f64 = 14_250.0;

/// Whether a robot takes the arguments of a setter; other requests have none to be wrong.
pub fn is_valid(request: &Request) -> bool {
    match request {
        Request::SetCollisionBehavior(behavior) => thresholds(behavior),
        Request::SetJointImpedance(stiffness) => stiffness.iter().all(|k| (0.0..=JOINT_STIFFNESS).contains(k)),
        Request::SetCartesianImpedance(stiffness) => {
            let (linear, angular) = stiffness.split_at(3);
            linear.iter().all(|k| (10.0..=3000.0).contains(k)) && angular.iter().all(|k| (1.0..=300.0).contains(k))
        }
        Request::SetEeToK(pose) | Request::SetNeToEe(pose) => is_rigid(pose),
        Request::SetLoad(load) => is_body(load),
        Request::SetFilters(filters) => [
            filters.joint_position,
            filters.joint_velocity,
            filters.cartesian_position,
            filters.cartesian_velocity,
            filters.controller,
        ]
        .iter()
        .all(|frequency| (1.0..=1000.0).contains(frequency)),
        _ => true,
    }
}

/// Thresholds are not negative, and contact comes before collision.
fn thresholds(behavior: &CollisionBehavior) -> bool {
    let ordered = |lower: &[f64], upper: &[f64]| {
        let pairs = lower.iter().zip(upper);
        pairs.fold(true, |good, (lower, upper)| good && *lower >= 0.0 && lower <= upper && upper.is_finite())
    };
    ordered(&behavior.lower_torque_acceleration, &behavior.upper_torque_acceleration)
        && ordered(&behavior.lower_torque_nominal, &behavior.upper_torque_nominal)
        && ordered(&behavior.lower_force_acceleration, &behavior.upper_force_acceleration)
        && ordered(&behavior.lower_force_nominal, &behavior.upper_force_nominal)
}

/// A load has no negative mass and no negative moments.
fn is_body(load: &Load) -> bool {
    let numbers = load.com.iter().chain(&load.inertia).all(|value| value.is_finite());
    if !numbers || !load.mass.is_finite() || load.mass < 0.0 {
        return false;
    }
    let inertia = Matrix3::from_column_slice(&load.inertia);
    let size = inertia.amax().max(1e-12);
    (inertia - inertia.transpose()).amax() <= 1e-6 * size
        && SymmetricEigen::new(inertia).eigenvalues.min() >= -1e-6 * size
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline::backend::franka::wire::Filters;

    #[test]
    fn takes_what_has_a_meaning_and_nothing_else() {
        let behavior = CollisionBehavior {
            lower_torque_acceleration: [10.0; 7],
            upper_torque_acceleration: [20.0; 7],
            lower_torque_nominal: [10.0; 7],
            upper_torque_nominal: [20.0; 7],
            lower_force_acceleration: [10.0; 6],
            upper_force_acceleration: [20.0; 6],
            lower_force_nominal: [10.0; 6],
            upper_force_nominal: [20.0; 6],
        };
        let load = Load { mass: 0.5, com: [0.0, 0.0, 0.05], inertia: [0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01] };
        let filters = Filters {
            joint_position: 100.0,
            joint_velocity: 100.0,
            cartesian_position: 100.0,
            cartesian_velocity: 100.0,
            controller: 1000.0,
        };
        let mut pose = super::super::geometry::IDENTITY;
        let good = [
            Request::SetCollisionBehavior(behavior),
            Request::SetJointImpedance([3000.0; 7]),
            Request::SetCartesianImpedance([3000.0, 10.0, 100.0, 1.0, 300.0, 30.0]),
            Request::SetEeToK(pose),
            Request::SetLoad(load),
            Request::SetFilters(filters),
        ];
        pose[5] = -1.0;
        let bad = [
            Request::SetCollisionBehavior(CollisionBehavior { lower_force_nominal: [21.0; 6], ..behavior }),
            Request::SetCollisionBehavior(CollisionBehavior { upper_torque_nominal: [f64::NAN; 7], ..behavior }),
            Request::SetJointImpedance([-1.0; 7]),
            Request::SetJointImpedance([f64::NAN; 7]),
            Request::SetCartesianImpedance([9.0; 6]),
            Request::SetNeToEe(pose),
            Request::SetLoad(Load { mass: -0.1, ..load }),
            Request::SetLoad(Load { inertia: [-0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01], ..load }),
            Request::SetFilters(Filters { controller: 0.0, ..filters }),
        ];
        assert!(good.iter().all(is_valid));
        for request in bad {
            assert!(!is_valid(&request), "{request:?}");
        }
    }
}
