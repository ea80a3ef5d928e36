//! Poses as the wire has them, and the arm's kinematics in them.

use super::limits::{JOINTS, Joints};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3, Vector6};
use plumbline_model::{Chain, Placement};

/// A 4x4 pose, column-major.
pub type Pose = [f64; 16];

pub type Frames = [Placement; JOINTS + 1];

/// How far a matrix may be from a rotation: clients send what they have computed.
const ROTATION_SLACK: f64 = 1e-3;

pub const IDENTITY: Pose = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];

pub fn pose(placement: &Placement) -> Pose {
    let mut pose = IDENTITY;
    for column in 0..3 {
        for row in 0..3 {
            pose[4 * column + row] = placement.rotation[(row, column)];
        }
        pose[12 + column] = placement.origin[column];
    }
    pose
}

pub fn placement(pose: &Pose) -> Placement {
    Placement {
        rotation: Matrix3::from_fn(|row, column| pose[4 * column + row]),
        origin: Vector3::new(pose[12], pose[13], pose[14]),
    }
}

pub fn is_rigid(pose: &Pose) -> bool {
    let r = placement(pose).rotation;
    let bottom = [pose[3], pose[7], pose[11], pose[15]] == [0.0, 0.0, 0.0, 1.0];
    let finite = pose.iter().all(|value| value.is_finite());
    bottom && finite && (r.transpose() * r - Matrix3::identity()).amax() < ROTATION_SLACK && r.determinant() > 0.0
}

/// Placement of the base and of every link frame in the base frame.
pub fn frames(chain: &Chain, q: &Joints) -> Frames {
    let mut frames = [Placement::identity(); JOINTS + 1];
    for (j, joint) in chain.joints().iter().enumerate().take(JOINTS) {
        frames[j + 1] = frames[j].then(&joint.placement(q[j]));
    }
    frames
}

/// Jacobian of the point `at` \[m\] in the base frame: linear velocity above angular velocity.
pub fn jacobian(frames: &Frames, at: &Vector3<f64>) -> SMatrix<f64, 6, JOINTS> {
    let mut jacobian = SMatrix::<f64, 6, JOINTS>::zeros();
    for (j, frame) in frames[1..].iter().enumerate() {
        let axis: Vector3<f64> = frame.rotation.column(2).into();
        let linear = axis.cross(&(at - frame.origin));
        jacobian.fixed_view_mut::<3, 1>(0, j).copy_from(&linear);
        jacobian.fixed_view_mut::<3, 1>(3, j).copy_from(&axis);
    }
    jacobian
}

/// The wrench at the Jacobian's point that explains joint torques best: `(J J' + small) F = J tau`, which stays finite at
/// singular poses.
pub fn wrench(jacobian: &SMatrix<f64, 6, JOINTS>, tau: &Joints) -> [f64; 6] {
    let tau = SMatrix::<f64, JOINTS, 1>::from_column_slice(tau);
    let damped: Matrix6<f64> = jacobian * jacobian.transpose() + 1e-4 * Matrix6::identity();
    let force = damped.cholesky().map_or_else(Vector6::zeros, |root| root.solve(&(jacobian * tau)));
    force.into()
}

/// A wrench or twist in the axes of `frame` instead of the base's.
pub fn turned(frame: &Placement, wrench: &[f64; 6]) -> [f64; 6] {
    let turn = |part: &[f64]| frame.rotation.tr_mul(&Vector3::new(part[0], part[1], part[2]));
    let (linear, angular) = (turn(&wrench[..3]), turn(&wrench[3..]));
    [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
}

/// Specific force that an accelerometer at the origin of each of the first six link frames feels, in that frame \[m/s2\]: its
/// acceleration less gravity, so `-g` at rest.
pub fn specific_force(chain: &Chain, gravity: &Vector3<f64>, q: &Joints, dq: &Joints, ddq: &Joints) -> [[f64; 3]; 6] {
    let (mut w, mut dw, mut a) = (Vector3::zeros(), Vector3::zeros(), -gravity);
    let mut felt = [[0.0; 3]; 6];
    for (j, joint) in chain.joints().iter().enumerate().take(6) {
        let placement = joint.placement(q[j]);
        let to_child = placement.rotation.transpose();
        let origin = &placement.origin;
        a = to_child * (a + dw.cross(origin) + w.cross(&w.cross(origin)));
        let carried: Vector3<f64> = to_child * w;
        let spin = Vector3::new(0.0, 0.0, dq[j]);
        dw = to_child * dw + carried.cross(&spin) + Vector3::new(0.0, 0.0, ddq[j]);
        w = carried + spin;
        felt[j] = a.into();
    }
    felt
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_model::{Mounting, Robot};

    const POSE: Joints = [0.3, -0.4, 0.2, -2.0, 0.3, 1.8, 0.5];

    fn panda() -> Chain {
        Robot::load("panda", None).expect("a shipped robot").chain
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_flange() {
        let chain = panda();
        let flange = |q: &Joints| chain.end_effector(q);
        let jacobian = jacobian(&frames(&chain, &POSE), &flange(&POSE));
        for j in 0..JOINTS {
            let (mut up, mut down) = (POSE, POSE);
            up[j] += 1e-6;
            down[j] -= 1e-6;
            let slope = (flange(&up) - flange(&down)) / 2e-6;
            assert!((slope - jacobian.fixed_view::<3, 1>(0, j)).norm() < 1e-8, "joint {}", j + 1);
        }
    }

    #[test]
    fn a_wrench_is_found_in_the_torques_that_hold_it() {
        let chain = panda();
        let jacobian = jacobian(&frames(&chain, &POSE), &chain.end_effector(&POSE));
        let force = Vector6::new(3.0, -20.0, 11.0, 0.4, 1.0, -2.0);
        let found = wrench(&jacobian, &(jacobian.transpose() * force).into());
        assert!((Vector6::from(found) - force).norm() < 0.1, "{found:?}");
    }

    /// A third route: the acceleration of the origin of a link by differences along a motion.
    #[test]
    fn accelerometers_feel_motion_and_minus_gravity() {
        let chain = panda();
        let gravity = Mounting::WALL.gravity();
        let zero = [0.0; JOINTS];
        let still = specific_force(&chain, &gravity, &POSE, &zero, &zero);
        let turned = frames(&chain, &POSE)[6].rotation.tr_mul(&-gravity);
        assert!((Vector3::from(still[5]) - turned).norm() < 1e-12);
        let (dq, ddq) = ([0.5, -0.7, 0.2, 0.9, -0.4, 0.3, 1.0], [1.0, 2.0, -3.0, 0.5, 1.5, -2.0, 0.1]);
        let at = |t: f64| {
            let q = std::array::from_fn(|j| POSE[j] + t * dq[j] + 0.5 * t * t * ddq[j]);
            frames(&chain, &q)[6].origin
        };
        let h = 1e-4;
        let acceleration = (at(h) - 2.0 * at(0.0) + at(-h)) / (h * h);
        let expected = frames(&chain, &POSE)[6].rotation.tr_mul(&(acceleration - gravity));
        let felt = specific_force(&chain, &gravity, &POSE, &dq, &ddq)[5];
        assert!((Vector3::from(felt) - expected).norm() < 1e-5, "{felt:?} {expected}");
    }

    #[test]
    fn poses_come_back_and_others_are_seen() {
        let there = panda().end_effector_placement(&POSE);
        assert_eq!(placement(&pose(&there)), there);
        assert!(is_rigid(&pose(&there)) && is_rigid(&IDENTITY));
        let mut bent = pose(&there);
        bent[0] += 0.01;
        assert!(!is_rigid(&bent));
        for (place, value) in [(12, f64::NAN), (3, 0.1), (15, 2.0)] {
            let mut wrong = IDENTITY;
            wrong[place] = value;
            assert!(!is_rigid(&wrong));
        }
        let mut mirrored = IDENTITY;
        mirrored[10] = -1.0;
        assert!(!is_rigid(&mirrored));
    }
}
