//! Forward dynamics by the articulated-body algorithm (Featherstone 2008, section 7.3).
//!
//! Independent of `model::rnea` and `model::regressor`, whose results it checks.

use super::spatial::{Force, Mechanism, Motion};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::{JointKind, Placement};

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
    let mut articulated = arm.links;

    // Outward: velocities and velocity-product forces.
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

    // Inward: articulated inertia and bias force of each link with a free joint, added to its parent.
    let mut along = [Force::ZERO; MAX_JOINTS];
    let mut inertia_along = [0.0; MAX_JOINTS];
    let mut unbalanced = [0.0; MAX_JOINTS];
    for i in (0..arm.n).rev() {
        let whole = &articulated[i];
        (along[i], inertia_along[i], unbalanced[i]) = match arm.frames[i].kind {
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
            let mut projected = articulated[i];
            projected.without(&along[i], inertia_along[i]);
            let share = unbalanced[i] / inertia_along[i];
            let mut force = projected.times(&bias_motion[i]);
            force += bias_force[i];
            force += Force { n: along[i].n * share, f: along[i].f * share };
            articulated[i - 1] += projected.to_parent(&placement[i]);
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
        let bound = along[i].n.dot(&acceleration.w) + along[i].f.dot(&acceleration.v);
        ddq[i] = (unbalanced[i] - bound) / inertia_along[i];
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

#[cfg(test)]
mod tests {
    use super::super::spatial::Inertia;
    use super::*;
    use nalgebra::Matrix3;
    use plumbline_model::{Chain, Joint, LinkParameters, rnea};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A chain of random geometry, a random distribution of mass on every link, and its standard parameters.
    fn random_arm(rng: &mut ChaCha8Rng, n: usize) -> (Chain, Mechanism, Vec<LinkParameters>) {
        let mut joints = Vec::new();
        let mut links = Vec::new();
        let mut parameters = Vec::new();
        for _ in 0..n {
            let kind = if rng.random_bool(0.7) { JointKind::Revolute } else { JointKind::Prismatic };
            let mut length = || rng.random_range(-0.5..0.5);
            let (a, d) = (length(), length());
            joints.push(Joint { kind, a, d, alpha: rng.random_range(-3.0..3.0), theta: rng.random_range(-3.0..3.0) });
            // The inertia of twelve point masses: consistent by construction, and summed here without the parallel axis theorem.
            let points: Vec<(f64, Vector3<f64>)> = (0..12)
                .map(|_| (rng.random_range(0.05..0.5), Vector3::from_fn(|_, _| rng.random_range(-0.3..0.3))))
                .collect();
            let mass: f64 = points.iter().map(|(m, _)| m).sum();
            let first: Vector3<f64> = points.iter().map(|(m, r)| *m * r).sum();
            let about = |centre: Vector3<f64>| -> Matrix3<f64> {
                let part = |(m, r): &(f64, Vector3<f64>)| {
                    let r = r - centre;
                    *m * (r.norm_squared() * Matrix3::identity() - r * r.transpose())
                };
                points.iter().map(part).sum()
            };
            let (com, l) = (first / mass, about(Vector3::zeros()));
            links.push(Inertia::rigid(mass, com, about(com)));
            let moments = [l[(0, 0)], l[(0, 1)], l[(0, 2)], l[(1, 1)], l[(1, 2)], l[(2, 2)]];
            let mut row = [0.0; 10];
            row[..6].copy_from_slice(&moments);
            row[6..9].copy_from_slice(first.as_slice());
            row[9] = mass;
            parameters.push(row);
        }
        let chain = Chain::modified(joints, Placement::identity());
        let arm = Mechanism::new(&chain, &links);
        (chain, arm, parameters)
    }

    /// Two routes to the same torque: articulated bodies and their own inverse on one side, the estimator's Newton-Euler on the other.
    #[test]
    fn agrees_with_newton_euler() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for case in 0..400 {
            let n = rng.random_range(1..=MAX_JOINTS);
            let (chain, mut arm, parameters) = random_arm(&mut rng, n);
            let mut draw = |span: f64| -> JointVec {
                std::array::from_fn(|j| if j < n { rng.random_range(-span..span) } else { 0.0 })
            };
            let (q, dq, tau, rotors) = (draw(3.0), draw(3.0), draw(30.0), draw(0.5));
            let gravity = Vector3::from_column_slice(&draw(9.81)[..3.min(MAX_JOINTS)]);
            arm.armature = rotors.map(f64::abs);

            let ddq = aba(&arm, &gravity, &[Force::ZERO; MAX_JOINTS], &q, &dq, &tau);
            let mut back = [0.0; MAX_JOINTS];
            rnea(&chain, &parameters, &gravity, &q, &dq, &ddq, &mut back);
            let own = inverse(&arm, &gravity, &q, &dq, &ddq);
            for j in 0..n {
                let scale = 1.0 + ddq[j].abs();
                let newton_euler = back[j] + arm.armature[j] * ddq[j];
                assert!(
                    (newton_euler - tau[j]).abs() < 1e-9 * scale,
                    "case {case} joint {j}: {newton_euler} {}",
                    tau[j]
                );
                assert!((own[j] - tau[j]).abs() < 1e-9 * scale, "case {case} joint {j}: {} {}", own[j], tau[j]);
            }
        }
    }
}
