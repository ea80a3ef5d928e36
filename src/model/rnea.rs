//! Inverse dynamics by the recursive Newton-Euler algorithm.

use super::chain::{Chain, JointKind};
use crate::joint::MAX_JOINTS;
use nalgebra::{Matrix3, Vector3};

/// Standard inertial parameters of one link in its own frame: `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`, inertia about the frame's
/// origin \[kg m2\], first moments \[kg m\], mass \[kg\] (paper eq. 5).
pub type LinkParameters = [f64; 10];

/// Joint torques `tau = M(q) ddq + C(q, dq) dq + g(q)` without friction \[Nm\].
///
/// `gravity` is the gravitational acceleration in the base frame \[m/s2\]; `links` holds one row of standard parameters per link, and
/// base parameters put straight into the slots of their name give the same torque. `q`, `dq`, `ddq` and `tau` have at least
/// `chain.len()` entries. Allocates nothing.
pub fn rnea(
    chain: &Chain,
    links: &[LinkParameters],
    gravity: &Vector3<f64>,
    q: &[f64],
    dq: &[f64],
    ddq: &[f64],
    tau: &mut [f64],
) {
    let n = chain.len();
    let mut rotation = [Matrix3::zeros(); MAX_JOINTS];
    let mut origin = [Vector3::zeros(); MAX_JOINTS];
    let mut force = [Vector3::zeros(); MAX_JOINTS];
    let mut moment = [Vector3::zeros(); MAX_JOINTS];

    // Outward: motion of every frame, then the wrench its link needs. The base accelerates against gravity.
    let mut w = Vector3::zeros();
    let mut dw = Vector3::zeros();
    let mut a = -gravity;
    for i in 0..n {
        let joint = &chain.joints()[i];
        let placement = joint.placement(q[i]);
        let to_child = placement.rotation.transpose();
        a = to_child * (a + dw.cross(&placement.origin) + w.cross(&w.cross(&placement.origin)));
        let w_parent = to_child * w;
        let dw_parent = to_child * dw;
        match joint.kind {
            JointKind::Revolute => {
                w = w_parent + Vector3::new(0.0, 0.0, dq[i]);
                dw = dw_parent + w_parent.cross(&Vector3::new(0.0, 0.0, dq[i])) + Vector3::new(0.0, 0.0, ddq[i]);
            }
            JointKind::Prismatic => {
                (w, dw) = (w_parent, dw_parent);
                a += 2.0 * w.cross(&Vector3::new(0.0, 0.0, dq[i])) + Vector3::new(0.0, 0.0, ddq[i]);
            }
        }
        let p = &links[i];
        let inertia = Matrix3::new(p[0], p[1], p[2], p[1], p[3], p[4], p[2], p[4], p[5]);
        let first = Vector3::new(p[6], p[7], p[8]);
        force[i] = p[9] * a + dw.cross(&first) + w.cross(&w.cross(&first));
        moment[i] = inertia * dw + w.cross(&(inertia * w)) + first.cross(&a);
        rotation[i] = placement.rotation;
        origin[i] = placement.origin;
    }

    // Inward: every joint carries the wrenches of all links beyond it.
    for i in (0..n).rev() {
        tau[i] = match chain.joints()[i].kind {
            JointKind::Revolute => moment[i].z,
            JointKind::Prismatic => force[i].z,
        };
        if i > 0 {
            let f = rotation[i] * force[i];
            let m = rotation[i] * moment[i];
            force[i - 1] += f;
            moment[i - 1] += m + origin[i].cross(&f);
        }
    }
}
