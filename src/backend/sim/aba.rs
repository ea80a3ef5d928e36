//! Forward dynamics by the articulated-body algorithm (Featherstone 2008, section 7.3).
//!
//! It shares no formula with `model::rnea` or `model::regressor`: the simulated arm is the second route to their numbers.

use super::spatial::{Force, Mechanism, Motion};
use crate::joint::{JointVec, MAX_JOINTS};
use crate::model::chain::{JointKind, Placement};
use nalgebra::Vector3;

/// Joint accelerations \[rad/s2\] of `arm` under joint torques `tau` \[Nm\] and the wrenches `external` on its links (each in its link
/// frame, about that frame's origin). `gravity` is the gravitational acceleration in the base frame \[m/s2\]. Allocates nothing.
pub(super) fn aba(
    arm: &Mechanism,
    gravity: &Vector3<f64>,
    external: &[Force; MAX_JOINTS],
    q: &JointVec,
    dq: &JointVec,
    tau: &JointVec,
) -> JointVec {
    let still = Motion { w: Vector3::zeros(), v: Vector3::zeros() };
    let mut placement = [Placement::identity(); MAX_JOINTS];
    let mut bias_motion = [still; MAX_JOINTS];
    let mut bias_force = [Force::ZERO; MAX_JOINTS];
    let mut felt = arm.links;

    // Outward: velocities, and the forces that they alone need.
    let mut velocity = still;
    for i in 0..arm.n {
        let kind = arm.frames[i].kind;
        placement[i] = arm.frames[i].at(q[i]);
        velocity = velocity.to_child(&placement[i]);
        velocity.add_axis(kind, dq[i]);
        bias_motion[i] = velocity.cross_axis(kind, dq[i]);
        let momentum = arm.links[i].times(&velocity);
        bias_force[i] = velocity.cross_force(&momentum);
        bias_force[i] += Force { n: -external[i].n, f: -external[i].f };
    }

    // Inward: the inertia and bias force that each link shows its parent when its own joint is free.
    let mut along = [Force::ZERO; MAX_JOINTS];
    let mut inertia_along = [0.0; MAX_JOINTS];
    let mut left = [0.0; MAX_JOINTS];
    for i in (0..arm.n).rev() {
        let whole = &felt[i];
        (along[i], inertia_along[i], left[i]) = match arm.frames[i].kind {
            JointKind::Revolute => {
                let u = Force { n: whole.i.column(2).into(), f: whole.h.row(2).transpose() };
                (u, u.n.z + arm.armature[i], tau[i] - bias_force[i].n.z)
            }
            JointKind::Prismatic => {
                let u = Force { n: whole.h.column(2).into(), f: whole.m.column(2).into() };
                (u, u.f.z + arm.armature[i], tau[i] - bias_force[i].f.z)
            }
        };
        if i > 0 {
            let mut shown = felt[i];
            shown.without(&along[i], inertia_along[i]);
            let share = left[i] / inertia_along[i];
            let mut force = shown.times(&bias_motion[i]);
            force += bias_force[i];
            force += Force { n: along[i].n * share, f: along[i].f * share };
            felt[i - 1] += shown.to_parent(&placement[i]);
            bias_force[i - 1] += force.to_parent(&placement[i]);
        }
    }

    // Outward: accelerations. The base accelerates against gravity.
    let mut ddq = [0.0; MAX_JOINTS];
    let mut acceleration = Motion { w: Vector3::zeros(), v: -gravity };
    for i in 0..arm.n {
        acceleration = acceleration.to_child(&placement[i]);
        acceleration.w += bias_motion[i].w;
        acceleration.v += bias_motion[i].v;
        let taken = along[i].n.dot(&acceleration.w) + along[i].f.dot(&acceleration.v);
        ddq[i] = (left[i] - taken) / inertia_along[i];
        acceleration.add_axis(arm.frames[i].kind, ddq[i]);
    }
    ddq
}

/// Joint torques \[Nm\] that move `arm` with `ddq` when no friction and no external wrench acts: the feed-forward of the arm's own controller,
/// by a recursion over spatial vectors (Featherstone 2008, section 5.3). Allocates nothing.
pub(super) fn inverse(
    arm: &Mechanism,
    gravity: &Vector3<f64>,
    q: &JointVec,
    dq: &JointVec,
    ddq: &JointVec,
) -> JointVec {
    let mut placement = [Placement::identity(); MAX_JOINTS];
    let mut force = [Force::ZERO; MAX_JOINTS];
    let mut velocity = Motion { w: Vector3::zeros(), v: Vector3::zeros() };
    let mut acceleration = Motion { w: Vector3::zeros(), v: -gravity };
    for i in 0..arm.n {
        let kind = arm.frames[i].kind;
        placement[i] = arm.frames[i].at(q[i]);
        velocity = velocity.to_child(&placement[i]);
        velocity.add_axis(kind, dq[i]);
        acceleration = acceleration.to_child(&placement[i]);
        let product = velocity.cross_axis(kind, dq[i]);
        acceleration.w += product.w;
        acceleration.v += product.v;
        acceleration.add_axis(kind, ddq[i]);
        force[i] = arm.links[i].times(&acceleration);
        force[i] += velocity.cross_force(&arm.links[i].times(&velocity));
    }
    let mut tau = [0.0; MAX_JOINTS];
    for i in (0..arm.n).rev() {
        let along = match arm.frames[i].kind {
            JointKind::Revolute => force[i].n.z,
            JointKind::Prismatic => force[i].f.z,
        };
        tau[i] = along + arm.armature[i] * ddq[i];
        if i > 0 {
            let carried = force[i].to_parent(&placement[i]);
            force[i - 1] += carried;
        }
    }
    tau
}
