//! The rigid-body regressor: joint torques as a linear map of the standard inertial parameters.

use super::chain::{Chain, JointKind, Placement};
use nalgebra::{DMatrix, Matrix3, Matrix3x6, Vector3};
use plumbline_core::MAX_JOINTS;

/// Columns of one link in a standard regressor.
pub const LINK_COLUMNS: usize = 10;

/// Writes `Y` (n x 10 n) with `tau = Y delta`, `delta` the stacked standard parameters of all links (paper eq. 5 without friction).
///
/// `gravity` is the gravitational acceleration in the base frame \[m/s2\]. Rows past `chain.len()` are not written.
/// It shares the outward recursion's formulas with no one: `rnea` is the second route to the same number.
pub fn regressor(chain: &Chain, gravity: &Vector3<f64>, q: &[f64], dq: &[f64], ddq: &[f64], y: &mut DMatrix<f64>) {
    let height = y.nrows();
    debug_assert!(height >= chain.len() && y.ncols() >= chain.len() * LINK_COLUMNS);
    debug_assert!([q.len(), dq.len(), ddq.len()].iter().all(|&len| len >= chain.len()));
    y.fill(0.0);
    // The columns of one link are one piece of memory.
    let links = y.as_mut_slice().chunks_exact_mut((height * LINK_COLUMNS).max(1));
    let mut placements = [Placement::identity(); MAX_JOINTS];
    let mut w = Vector3::zeros();
    let mut dw = Vector3::zeros();
    let mut a = -gravity;
    let given = q.iter().zip(dq).zip(ddq);
    for (i, ((joint, link), ((&q, &dq), &ddq))) in chain.joints().iter().zip(links).zip(given).enumerate() {
        let placement = joint.placement(q);
        if let Some(slot) = placements.get_mut(i) {
            *slot = placement;
        }
        let r_t = placement.rotation.transpose();
        a = r_t * (a + (skew(&dw) + skew(&w) * skew(&w)) * placement.origin);
        w = r_t * w;
        dw = r_t * dw;
        let z = Vector3::z();
        match joint.kind {
            JointKind::Revolute => {
                dw += w.cross(&z) * dq + z * ddq;
                w += z * dq;
            }
            JointKind::Prismatic => a += w.cross(&z) * (2.0 * dq) + z * ddq,
        }

        // Wrench of link i per unit of each of its parameters: force (3 x 10) over moment (3 x 10).
        let inertia_part = spread(&dw) + skew(&w) * spread(&w);
        let moment_part = skew(&dw) + skew(&w) * skew(&w);
        let mut force = [Vector3::zeros(); LINK_COLUMNS];
        let mut moment = [Vector3::zeros(); LINK_COLUMNS];
        for (column, part) in moment.iter_mut().zip(inertia_part.column_iter()) {
            column.copy_from(&part);
        }
        for c in 0..3 {
            force[6 + c] = moment_part.column(c).into();
            moment[6 + c] = -skew(&a).column(c);
        }
        force[9] = a;

        // Carry it inward; each joint takes the component along its axis.
        for (j, (joint, up)) in chain.joints().iter().zip(&placements).enumerate().take(i + 1).rev() {
            for (column, (force, moment)) in link.chunks_exact_mut(height.max(1)).zip(force.iter().zip(&moment)) {
                if let Some(entry) = column.get_mut(j) {
                    *entry = match joint.kind {
                        JointKind::Revolute => moment.z,
                        JointKind::Prismatic => force.z,
                    };
                }
            }
            if j > 0 {
                for (force, moment) in force.iter_mut().zip(&mut moment) {
                    *force = up.rotation * *force;
                    *moment = up.rotation * *moment + up.origin.cross(force);
                }
            }
        }
    }
}

/// `skew(v) x = v cross x`.
fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

/// `spread(v) [Lxx Lxy Lxz Lyy Lyz Lzz]' = L v`.
fn spread(v: &Vector3<f64>) -> Matrix3x6<f64> {
    let (x, y, z) = (v.x, v.y, v.z);
    Matrix3x6::new(
        x, y, z, 0.0, 0.0, 0.0, //
        0.0, x, 0.0, y, z, 0.0, //
        0.0, 0.0, x, 0.0, y, z,
    )
}
