//! Kinematics of a serial chain.
//!
//! Every chain is held in modified (Craig) Denavit-Hartenberg frames, the paper's convention: frame `i` moves with link `i`,
//! its z axis is joint `i`'s axis, and all inertial parameters of link `i` are expressed in frame `i`. A standard-DH arm is the
//! same chain with its rows shifted: `a` and `alpha` of row `i` belong to frame `i + 1`, those of the last row to the flange.

use nalgebra::{Matrix3, Vector3};
use plumbline_core::MAX_JOINTS;
use serde::Deserialize;

/// Kind of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum JointKind {
    /// Rotates about its z axis; its position is an angle \[rad\].
    #[default]
    Revolute,
    /// Translates along its z axis; its position is a length \[m\].
    Prismatic,
}

/// A rotation and a translation: `x_parent = rotation * x_child + origin`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Orientation of the child frame in the parent frame.
    pub rotation: Matrix3<f64>,
    /// Origin of the child frame in the parent frame \[m\].
    pub origin: Vector3<f64>,
}

impl Placement {
    /// The child frame is the parent frame.
    pub fn identity() -> Placement {
        Placement { rotation: Matrix3::identity(), origin: Vector3::zeros() }
    }

    /// `self` followed by `next`.
    pub fn then(&self, next: &Placement) -> Placement {
        Placement { rotation: self.rotation * next.rotation, origin: self.rotation * next.origin + self.origin }
    }

    /// The parent frame in the child frame.
    pub fn inverse(&self) -> Placement {
        let rotation = self.rotation.transpose();
        Placement { rotation, origin: -(rotation * self.origin) }
    }
}

/// One row of a modified-DH table: `T = Rx(alpha) Tx(a) Rz(theta) Tz(d)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Distance along the previous x axis, `a_{i-1}` \[m\].
    pub a: f64,
    /// Twist about the previous x axis, `alpha_{i-1}` \[rad\].
    pub alpha: f64,
    /// Distance along this z axis; a prismatic joint's position is added to it \[m\].
    pub d: f64,
    /// Angle about this z axis; a revolute joint's position is added to it \[rad\].
    pub theta: f64,
}

impl Joint {
    /// Placement of frame `i` in frame `i - 1` at joint position `q`.
    pub fn placement(&self, q: f64) -> Placement {
        let (theta, d) = match self.kind {
            JointKind::Revolute => (self.theta + q, self.d),
            JointKind::Prismatic => (self.theta, self.d + q),
        };
        let (st, ct) = theta.sin_cos();
        let (sa, ca) = exact_sin_cos(self.alpha);
        Placement {
            rotation: Matrix3::new(ct, -st, 0.0, st * ca, ct * ca, -sa, st * sa, ct * sa, ca),
            origin: Vector3::new(self.a, -sa * d, ca * d),
        }
    }
}

/// One row of a standard-DH table: `T = Rz(theta) Tz(d) Tx(a) Rx(alpha)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StandardDh {
    /// Revolute or prismatic.
    pub kind: JointKind,
    /// Distance along this row's x axis \[m\].
    pub a: f64,
    /// Twist about this row's x axis \[rad\].
    pub alpha: f64,
    /// Distance along the joint's z axis \[m\].
    pub d: f64,
    /// Angle offset about the joint's z axis \[rad\].
    pub theta: f64,
}

/// A serial chain of one-degree-of-freedom joints on a fixed base.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    joints: Vec<Joint>,
    flange: Placement,
    coupled: Vec<[usize; 2]>,
}

impl Chain {
    /// A chain from modified-DH rows and the placement of the end effector in the last frame.
    ///
    /// Panics past [`MAX_JOINTS`] joints.
    pub fn modified(joints: Vec<Joint>, flange: Placement) -> Chain {
        assert!(joints.len() <= MAX_JOINTS, "{} joints, room for {MAX_JOINTS}", joints.len());
        Chain { joints, flange, coupled: Vec::new() }
    }

    /// A chain from standard-DH rows. Link frames are the equivalent modified-DH ones (module doc).
    ///
    /// Panics past [`MAX_JOINTS`] joints.
    pub fn standard(rows: &[StandardDh], tool: Placement) -> Chain {
        let mut joints = Vec::with_capacity(rows.len());
        let (mut a, mut alpha) = (0.0, 0.0);
        for row in rows {
            joints.push(Joint { kind: row.kind, a, alpha, d: row.d, theta: row.theta });
            (a, alpha) = (row.a, row.alpha);
        }
        let last = Joint { kind: JointKind::Revolute, a, alpha, d: 0.0, theta: 0.0 }.placement(0.0);
        Chain::modified(joints, last.then(&tool))
    }

    /// The same chain with pairs of joints, counted from 0, whose transmissions are coupled.
    pub fn with_coupled(self, coupled: Vec<[usize; 2]>) -> Chain {
        Chain { coupled, ..self }
    }

    /// Whether the transmissions of two joints, counted from 0, are declared as coupled.
    pub fn are_coupled(&self, one: usize, other: usize) -> bool {
        self.coupled.iter().any(|pair| *pair == [one, other] || *pair == [other, one])
    }

    /// Number of joints, `n`.
    pub fn len(&self) -> usize {
        self.joints.len()
    }

    /// Whether the chain has no joints at all.
    pub fn is_empty(&self) -> bool {
        self.joints.is_empty()
    }

    /// The joints, base first.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// Placement of the end effector in the last link frame.
    pub fn flange(&self) -> &Placement {
        &self.flange
    }

    /// Position of the end effector in the base frame \[m\]; `q` has at least `len()` entries \[rad\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn end_effector(&self, q: &[f64]) -> Vector3<f64> {
        self.end_effector_placement(q).origin
    }

    /// Placement of the end effector in the base frame; `q` has at least `len()` entries \[rad\].
    pub fn end_effector_placement(&self, q: &[f64]) -> Placement {
        let mut placement = Placement::identity();
        for (joint, &qi) in self.joints.iter().zip(q) {
            placement = placement.then(&joint.placement(qi));
        }
        placement.then(&self.flange)
    }

    /// Jacobian of the end effector in the base frame, one column per joint: its velocity \[m/s\] above its angular velocity \[rad/s\] at 1 rad/s (prismatic:
    /// 1 m/s). A wrench `w` (force above moment) on the end effector is balanced by `-J' w`. `q` has at least `len()` entries \[rad\].
    pub fn jacobian(&self, q: &[f64]) -> Vec<[f64; 6]> {
        let tip = self.end_effector(q);
        let mut placement = Placement::identity();
        let columns = self.joints.iter().zip(q).map(|(joint, &qi)| {
            placement = placement.then(&joint.placement(qi));
            let axis = placement.rotation.column(2).into_owned();
            let (linear, angular) = match joint.kind {
                JointKind::Revolute => (axis.cross(&(tip - placement.origin)), axis),
                JointKind::Prismatic => (axis, Vector3::zeros()),
            };
            [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
        });
        columns.collect()
    }
}

/// `sin_cos` that is exact at multiples of a right angle, so that the structure of an arm's geometry survives rounding.
fn exact_sin_cos(angle: f64) -> (f64, f64) {
    let (sin, cos) = angle.sin_cos();
    let snap = |x: f64| if (x - x.round()).abs() < 1e-15 { x.round() } else { x };
    (snap(sin), snap(cos))
}
