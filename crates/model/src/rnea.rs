//! Inverse dynamics by the recursive Newton-Euler algorithm.

use super::chain::{Chain, JointKind};
use nalgebra::{Matrix3, Vector3};
use plumbline_core::MAX_JOINTS;

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
    debug_assert!([links.len(), q.len(), dq.len(), ddq.len(), tau.len()].iter().all(|&len| len >= chain.len()));
    let still = Link {
        rotation: Matrix3::zeros(),
        origin: Vector3::zeros(),
        force: Vector3::zeros(),
        moment: Vector3::zeros(),
    };
    let mut all = [still; MAX_JOINTS];

    // Outward: motion of every frame, then the wrench its link needs. The base accelerates against gravity.
    let mut w = Vector3::zeros();
    let mut dw = Vector3::zeros();
    let mut a = -gravity;
    let given = links.iter().zip(q).zip(dq).zip(ddq);
    for ((link, joint), (((p, &q), &dq), &ddq)) in all.iter_mut().zip(chain.joints()).zip(given) {
        let placement = joint.placement(q);
        let to_child = placement.rotation.transpose();
        a = to_child * (a + dw.cross(&placement.origin) + w.cross(&w.cross(&placement.origin)));
        let w_parent = to_child * w;
        let dw_parent = to_child * dw;
        match joint.kind {
            JointKind::Revolute => {
                w = w_parent + Vector3::new(0.0, 0.0, dq);
                dw = dw_parent + w_parent.cross(&Vector3::new(0.0, 0.0, dq)) + Vector3::new(0.0, 0.0, ddq);
            }
            JointKind::Prismatic => {
                (w, dw) = (w_parent, dw_parent);
                a += 2.0 * w.cross(&Vector3::new(0.0, 0.0, dq)) + Vector3::new(0.0, 0.0, ddq);
            }
        }
        let inertia = Matrix3::new(p[0], p[1], p[2], p[1], p[3], p[4], p[2], p[4], p[5]);
        let first = Vector3::new(p[6], p[7], p[8]);
        link.force = p[9] * a + dw.cross(&first) + w.cross(&w.cross(&first));
        link.moment = inertia * dw + w.cross(&(inertia * w)) + first.cross(&a);
        link.rotation = placement.rotation;
        link.origin = placement.origin;
    }

    // Inward: every joint carries the wrenches of all links beyond it.
    let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
    for ((link, joint), tau) in all.iter().zip(chain.joints()).zip(tau).rev() {
        force += link.force;
        moment += link.moment;
        *tau = match joint.kind {
            JointKind::Revolute => moment.z,
            JointKind::Prismatic => force.z,
        };
        force = link.rotation * force;
        moment = link.rotation * moment + link.origin.cross(&force);
    }
}

/// A link's frame in the one before, and the wrench about its origin that the link needs.
#[derive(Clone, Copy)]
struct Link {
    rotation: Matrix3<f64>,
    origin: Vector3<f64>,
    force: Vector3<f64>,
    moment: Vector3<f64>,
}
