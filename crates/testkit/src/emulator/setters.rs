//! Which arguments of a setter a robot takes.
//!
//! Ranges of impedances and filters are those that libfranka documents for `setJointImpedance`, `setCartesianImpedance` and
//! `setFilters`, but for a joint stiffness of zero: the documented range has it, and a joint without stiffness follows no position, so the
//! emulator takes the stricter way. Franka publishes no bounds of `setLoad`; the emulator's own are the rated payload of both arms (3 kg by
//! their data sheets), a centre of mass within half a metre of the flange, and the inertia of a real body of that size. Everything else
//! is what has a meaning at all.

use super::geometry::is_rigid;
use nalgebra::{Matrix3, SymmetricEigen};
use plumbline_franka::wire::{CollisionBehavior, Load, Request};

/// Highest joint stiffness \[Nm/rad\].
const JOINT_STIFFNESS: f64 = 14_250.0;
/// Rated payload \[kg\].
const PAYLOAD: f64 = 3.0;
/// Farthest centre of mass from the flange, and largest radius of gyration \[m\].
const REACH: f64 = 0.5;
/// Rounding of an inertia, as a share of its largest element.
const ROUNDING: f64 = 1e-6;

/// Whether a robot takes the arguments of a setter; other requests have none to be wrong.
pub fn is_valid(request: &Request) -> bool {
    match request {
        Request::SetCollisionBehavior(behavior) => thresholds(behavior),
        Request::SetJointImpedance(stiffness) => stiffness.iter().all(|k| *k > 0.0 && *k <= JOINT_STIFFNESS),
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

/// Whether a load is a body that the arm may carry: no more than its payload, near the flange, with an inertia that some distribution of that
/// mass has (no principal moment above the sum of the others), and none without mass.
fn is_body(load: &Load) -> bool {
    let numbers = load.com.iter().chain(&load.inertia).all(|value| value.is_finite());
    let reach = load.com.iter().map(|value| value * value).sum::<f64>().sqrt();
    if !numbers || !(0.0..=PAYLOAD).contains(&load.mass) || reach > REACH {
        return false;
    }
    let inertia = Matrix3::from_column_slice(&load.inertia);
    let slack = ROUNDING * inertia.amax();
    let moments = SymmetricEigen::new(inertia).eigenvalues;
    (inertia - inertia.transpose()).amax() <= slack
        && moments.iter().all(|moment| *moment >= -slack && *moment <= 0.5 * moments.sum() + slack)
        && moments.max() <= load.mass * REACH * REACH
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_franka::wire::Filters;

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
            Request::SetLoad(Load { mass: 0.0, com: [0.0; 3], inertia: [0.0; 9] }),
            Request::SetLoad(Load { mass: 3.0, com: [0.0, 0.0, 0.5], inertia: [0.0; 9] }),
            Request::SetJointImpedance([14_250.0, 0.1, 1.0, 1.0, 1.0, 1.0, 1.0]),
            Request::SetFilters(filters),
        ];
        pose[5] = -1.0;
        let bad = [
            Request::SetCollisionBehavior(CollisionBehavior { lower_force_nominal: [21.0; 6], ..behavior }),
            Request::SetCollisionBehavior(CollisionBehavior { upper_torque_nominal: [f64::NAN; 7], ..behavior }),
            Request::SetJointImpedance([-1.0; 7]),
            Request::SetJointImpedance([3000.0, 3000.0, 3000.0, 3000.0, 3000.0, 3000.0, 0.0]),
            Request::SetJointImpedance([14_251.0; 7]),
            Request::SetJointImpedance([f64::NAN; 7]),
            Request::SetCartesianImpedance([9.0; 6]),
            Request::SetNeToEe(pose),
            Request::SetLoad(Load { mass: -0.1, ..load }),
            Request::SetLoad(Load { mass: 20.0, com: [5.0, 0.0, 0.0], ..load }),
            Request::SetLoad(Load { mass: 3.1, ..load }),
            Request::SetLoad(Load { com: [0.0, 0.4, 0.4], ..load }),
            // Mass without extent has no inertia, and an inertia has mass.
            Request::SetLoad(Load { mass: 0.0, ..load }),
            // A principal moment above the sum of the others: no body.
            Request::SetLoad(Load { inertia: [0.03, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01], ..load }),
            Request::SetLoad(Load { inertia: [0.2, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 0.2], ..load }),
            Request::SetLoad(Load { inertia: [-0.01, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 0.01], ..load }),
            Request::SetFilters(Filters { controller: 0.0, ..filters }),
        ];
        assert!(good.iter().all(is_valid));
        for request in bad {
            assert!(!is_valid(&request), "{request:?}");
        }
    }
}
