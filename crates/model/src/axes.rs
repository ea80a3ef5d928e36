//! Modified Denavit-Hartenberg rows of a chain that is given by its joint axes, as a URDF gives it.
//!
//! Craig, "Introduction to Robotics", 3rd edition, section 3.4: frame `i` has its origin where the common normal of axes `i` and `i + 1` leaves
//! axis `i`, its z along axis `i` and its x along that normal.

use super::chain::{Chain, Joint, JointKind, Placement};
use nalgebra::{Matrix3, Vector3};
use plumbline_core::MAX_JOINTS;
use std::f64::consts::{FRAC_PI_2, PI};

/// Two axes at an angle within this of a multiple of a right angle are taken as at exactly that angle \[rad\].
///
/// Descriptions round right angles to three or more digits, and base parameters depend on them.
const RIGHT_ANGLE_SLIP: f64 = 1e-3;
/// Offsets below this are zero: what rounded angles leave of axes that intersect \[m\].
const OFFSET_SLIP: f64 = 1e-6;

/// A joint's axis at position zero, in a frame that is fixed to the base.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// A point on the axis \[m\]. It is the origin of the link's frame where axes leave that open: the last one, and one parallel to the next.
    pub point: Vector3<f64>,
    /// Direction of a positive rotation (right hand) or translation; any length above 0.
    pub direction: Vector3<f64>,
}

impl Chain {
    /// The chain of `axes` (at most [`MAX_JOINTS`]) with the end effector at `tool`, both at position zero in one fixed frame, and the
    /// placement of the chain's base frame in that frame.
    ///
    /// `base.then(&chain.end_effector_placement(q))` is the end effector's placement at every `q`. The base frame is the fixed frame itself
    /// where axis 1 is its z axis, in either direction. Elsewhere its z axis is axis 1 and its origin the nearest point of axis 1. Angles between
    /// successive axes within 1e-3 rad of a multiple of a right angle become exactly that, and offsets below 1 um become zero.
    pub fn of_axes(axes: &[Axis], tool: &Placement) -> (Placement, Chain) {
        assert!(axes.len() <= MAX_JOINTS, "{} joints, room for {MAX_JOINTS}", axes.len());
        let Some(first) = axes.first() else {
            return (Placement::identity(), Chain::modified(Vec::new(), *tool));
        };
        let base = base(first);
        let upward = Axis { kind: JointKind::Revolute, point: base.origin, direction: base.rotation.column(2).into() };
        let mut lines = vec![upward];
        for axis in axes {
            let before = lines[lines.len() - 1].direction;
            lines.push(Axis { direction: squared(&before, &axis.direction.normalize()), ..*axis });
        }

        // Row i leads from the normal of axes i - 1 and i, which meets axis i at `foot`, to the normal of axes i and i + 1.
        let mut joints = Vec::with_capacity(axes.len());
        let (mut x, mut foot, mut a, mut alpha) = (base.rotation.column(0).into_owned(), base.origin, 0.0, 0.0);
        if lines[1].direction.dot(&lines[0].direction) < 0.0 {
            alpha = PI;
        }
        for (i, line) in lines.iter().enumerate().skip(1) {
            let z = line.direction;
            let normal = lines
                .get(i + 1)
                .map_or(Normal { leaves: line.point, x, a: 0.0, alpha: 0.0 }, |next| Normal::between(line, next, &x));
            let theta = tidy_angle(x.cross(&normal.x).dot(&z).atan2(x.dot(&normal.x)));
            joints.push(Joint { kind: line.kind, a, alpha, d: tidy_length((normal.leaves - foot).dot(&z)), theta });
            (a, alpha, x) = (normal.a, normal.alpha, normal.x);
            foot = normal.leaves + a * x;
        }
        let chain = Chain::modified(joints, Placement::identity());
        let last = base.then(&chain.end_effector_placement(&[0.0; MAX_JOINTS]));
        let flange = last.inverse().then(tool);
        (base, Chain::modified(chain.joints().to_vec(), flange))
    }
}

/// The common normal from one axis to the next.
struct Normal {
    /// Where it leaves the first axis \[m\].
    leaves: Vector3<f64>,
    /// Its direction, a unit vector.
    x: Vector3<f64>,
    /// Distance of the axes along `x` \[m\].
    a: f64,
    /// Angle from the first axis to the next about `x` \[rad\].
    alpha: f64,
}

impl Normal {
    /// Of two lines whose directions are [`squared`]; `before` is the normal before it, to which this one is turned the least.
    fn between(line: &Axis, next: &Axis, before: &Vector3<f64>) -> Normal {
        let (z, to) = (line.direction, next.direction);
        let across = z.cross(&to);
        let between = next.point - line.point;
        let aside = between - between.dot(&z) * z;
        let (leaves, x) = if across.norm() < 0.5 * RIGHT_ANGLE_SLIP {
            // Parallel: every point of the axis has a normal.
            let x = if aside.norm() < OFFSET_SLIP { *before } else { aside.normalize() };
            (line.point, x)
        } else {
            (line.point + between.cross(&to).dot(&across) / across.norm_squared() * z, across.normalize())
        };
        let x = if x.dot(before) < -1e-9 { -x } else { x };
        let alpha = tidy_angle(across.dot(&x).atan2(z.dot(&to)));
        Normal { leaves, x, a: tidy_length(between.dot(&x)), alpha }
    }
}

/// The fixed frame itself, or a frame on the first axis.
fn base(first: &Axis) -> Placement {
    let z = squared(&Vector3::z(), &first.direction.normalize());
    let foot = first.point - first.point.dot(&z) * z;
    let origin = if foot.norm() < OFFSET_SLIP { Vector3::zeros() } else { foot };
    if z.cross(&Vector3::z()).norm() == 0.0 {
        return Placement { rotation: Matrix3::identity(), origin };
    }
    let x = [Vector3::x(), Vector3::y()].map(|axis| axis - axis.dot(&z) * z);
    let x = if x[0].norm() > 0.5 { x[0] } else { x[1] }.normalize();
    Placement { rotation: Matrix3::from_columns(&[x, z.cross(&x), z]), origin }
}

/// The unit vector `to`, turned to a multiple of a right angle from the unit vector `from` where it is within [`RIGHT_ANGLE_SLIP`] of one.
fn squared(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let (along, across) = (from.dot(to), from.cross(to).norm());
    if across < RIGHT_ANGLE_SLIP {
        return *from * along.signum();
    }
    if along.abs() < RIGHT_ANGLE_SLIP { (to - along * from).normalize() } else { *to }
}

/// A multiple of a right angle without rounding errors, `pi` rather than `-pi`.
fn tidy_angle(angle: f64) -> f64 {
    let turns = (angle / FRAC_PI_2).round();
    if (angle - turns * FRAC_PI_2).abs() > 1e-9 {
        angle
    } else if turns == -2.0 {
        PI
    } else {
        // Without the sign of a zero.
        turns * FRAC_PI_2 + 0.0
    }
}

/// Without rounding errors below 1e-13 m.
fn tidy_length(length: f64) -> f64 {
    if length.abs() < OFFSET_SLIP { 0.0 } else { (length * 1e13).round() / 1e13 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, Unit};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// The end effector by the product of exponentials, which knows nothing of Denavit and Hartenberg.
    fn exponentials(axes: &[Axis], tool: &Placement, q: &[f64]) -> Placement {
        let mut at = *tool;
        for (axis, &q) in axes.iter().zip(q).rev() {
            let direction = Unit::new_normalize(axis.direction);
            at = match axis.kind {
                JointKind::Revolute => {
                    let turn = *Rotation3::from_axis_angle(&direction, q).matrix();
                    Placement { rotation: turn * at.rotation, origin: turn * (at.origin - axis.point) + axis.point }
                }
                JointKind::Prismatic => Placement { origin: at.origin + q * *direction, ..at },
            };
        }
        at
    }

    fn unit(rng: &mut ChaCha8Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.random_range(-1.0..1.0)).normalize()
    }

    /// Axes of every kind: skew, parallel, antiparallel, the same line, at right angles, intersecting.
    fn axes(rng: &mut ChaCha8Rng) -> Vec<Axis> {
        let mut axes: Vec<Axis> = Vec::new();
        for i in 0..rng.random_range(1..=MAX_JOINTS) {
            let kind = if rng.random_bool(0.2) { JointKind::Prismatic } else { JointKind::Revolute };
            let (before, last) =
                axes.last().map_or((Vector3::z(), Vector3::zeros()), |axis| (axis.direction.normalize(), axis.point));
            let side = before.cross(&unit(rng)).normalize();
            let direction = match rng.random_range(0..4) {
                0 => unit(rng),
                1 => before,
                2 => -before,
                _ => side,
            };
            let point = match rng.random_range(0..4) {
                0 if i > 0 => last + 0.3 * before,
                1 => last + 0.2 * side,
                2 => last,
                _ => last + 0.5 * unit(rng),
            };
            axes.push(Axis { kind, point, direction: 0.7 * direction });
        }
        axes
    }

    #[test]
    fn rows_place_the_end_effector_where_the_product_of_exponentials_does() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        for case in 0..2000 {
            let axes = axes(&mut rng);
            let turn = *Rotation3::from_euler_angles(rng.random(), rng.random(), rng.random()).matrix();
            let tool = Placement { rotation: turn, origin: unit(&mut rng) };
            let (base, chain) = Chain::of_axes(&axes, &tool);
            for _ in 0..5 {
                let q: Vec<f64> = axes.iter().map(|_| rng.random_range(-3.0..3.0)).collect();
                let (ours, theirs) = (base.then(&chain.end_effector_placement(&q)), exponentials(&axes, &tool, &q));
                // Axes at 2e-3 rad have normals as far away as 500 times their distance.
                let apart = (ours.origin - theirs.origin).amax().max((ours.rotation - theirs.rotation).amax());
                assert!(apart < 1e-9, "case {case}: {apart:e}\n{axes:?}\n{:?}", chain.joints());
            }
            let first = chain.joints()[0];
            assert!(first.a == 0.0 && (first.alpha == 0.0 || first.alpha == PI), "case {case}: {first:?}");
        }
    }

    #[test]
    fn an_axis_1_along_z_keeps_the_base_frame_whichever_way_it_points() {
        for direction in [Vector3::z(), -Vector3::z(), Vector3::new(1e-5, -2e-5, -1.0)] {
            let axis = Axis { kind: JointKind::Revolute, point: Vector3::new(0.0, 0.0, 0.3), direction };
            let (base, chain) = Chain::of_axes(&[axis], &Placement::identity());
            assert_eq!(base, Placement::identity());
            assert_eq!(chain.joints()[0].alpha, if direction.z > 0.0 { 0.0 } else { PI });
        }
    }

    #[test]
    fn rounded_right_angles_are_right_angles() {
        let axis = |x: f64, y: f64, z: f64, height: f64| Axis {
            kind: JointKind::Revolute,
            point: Vector3::new(0.0, 0.0, height),
            direction: Vector3::new(x, y, z),
        };
        let axes = [axis(0.0, 0.0, 1.0, 0.1), axis(0.0, -1.0, -3.7e-6, 0.3), axis(0.0, 7.3e-6, 1.0, 0.7)];
        let (_, chain) = Chain::of_axes(&axes, &Placement::identity());
        let rows: Vec<(f64, f64)> = chain.joints().iter().map(|joint| (joint.a, joint.alpha.abs())).collect();
        assert_eq!(rows, [(0.0, 0.0), (0.0, FRAC_PI_2), (0.0, FRAC_PI_2)]);
    }
}
