//! The rigid-body regressor: joint torques as a linear map of the standard inertial parameters.

use super::chain::{Chain, JointKind, Placement};
use crate::joint::MAX_JOINTS;
use nalgebra::{DMatrix, Matrix3, Matrix3x6, Vector3};

/// Columns of one link in a standard regressor.
pub const LINK_COLUMNS: usize = 10;

/// Writes `Y` (n x 10 n) with `tau = Y delta`, `delta` the stacked standard parameters of all links (paper eq. 5 without friction).
///
/// `gravity` is the gravitational acceleration in the base frame \[m/s2\]. Rows past `chain.len()` are left alone.
/// It shares the outward recursion's formulas with no one: `rnea` is the second route to the same number.
pub fn regressor(chain: &Chain, gravity: &Vector3<f64>, q: &[f64], dq: &[f64], ddq: &[f64], y: &mut DMatrix<f64>) {
    let n = chain.len();
    y.fill(0.0);
    let mut placements = [Placement::identity(); MAX_JOINTS];
    let mut w = Vector3::zeros();
    let mut dw = Vector3::zeros();
    let mut a = -gravity;
    for i in 0..n {
        let joint = &chain.joints()[i];
        let placement = joint.placement(q[i]);
        placements[i] = placement;
        let r_t = placement.rotation.transpose();
        a = r_t * (a + (skew(&dw) + skew(&w) * skew(&w)) * placement.origin);
        w = r_t * w;
        dw = r_t * dw;
        let z = Vector3::z();
        match joint.kind {
            JointKind::Revolute => {
                dw += w.cross(&z) * dq[i] + z * ddq[i];
                w += z * dq[i];
            }
            JointKind::Prismatic => a += w.cross(&z) * (2.0 * dq[i]) + z * ddq[i],
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
        for j in (0..=i).rev() {
            let kind = chain.joints()[j].kind;
            for c in 0..LINK_COLUMNS {
                y[(j, i * LINK_COLUMNS + c)] = match kind {
                    JointKind::Revolute => moment[c].z,
                    JointKind::Prismatic => force[c].z,
                };
            }
            if j > 0 {
                let up = &placements[j];
                for c in 0..LINK_COLUMNS {
                    force[c] = up.rotation * force[c];
                    moment[c] = up.rotation * moment[c] + up.origin.cross(&force[c]);
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
