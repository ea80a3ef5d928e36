//! The geometry of an all-revolute arm, in the form that costs least to walk along.

use super::super::chain::{Chain, JointKind};
use super::super::rnea::LinkParameters;
use plumbline_core::MAX_JOINTS;

/// Twist between two joint axes. Most arms have right angles alone, which cost no multiplication.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Twist {
    /// `alpha = 0`.
    None,
    /// `alpha = pi/2`.
    Left,
    /// `alpha = -pi/2`.
    Right,
    /// Any other angle, by its sine and cosine.
    Any(f64, f64),
}

/// One frame in its parent: `T = Rx(alpha) Tx(a) Rz(theta) Tz(d)` with the constant lengths as one lever.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// Twist about the parent's x axis.
    pub twist: Twist,
    /// Origin in the parent frame \[m\].
    pub lever: [f64; 3],
    /// Whether the lever counts: it is not zero, and its parent frame can turn.
    pub levered: bool,
}

/// Frames of an all-revolute arm: those of the [`Chain`], or each moved along its own z axis by [`Frames::shift`].
#[derive(Clone, Debug)]
pub struct Frames {
    /// Number of joints.
    pub len: usize,
    /// One per joint, base first.
    pub frames: [Frame; MAX_JOINTS],
    /// Constant part of each joint's angle \[rad\].
    pub theta: [f64; MAX_JOINTS],
    /// How far each frame is moved along its own z axis \[m\].
    pub shift: [f64; MAX_JOINTS],
}

impl Frames {
    /// The chain's own frames; `None` when it has a prismatic joint or no joint.
    pub fn of(chain: &Chain) -> Option<Frames> {
        Frames::with(chain, false)
    }

    /// Frames moved along their own z axes where that leaves fewer levers; the links' motions and joint torques stay the same.
    pub fn moved(chain: &Chain) -> Option<Frames> {
        Frames::with(chain, true)
    }

    fn with(chain: &Chain, may_move: bool) -> Option<Frames> {
        let joints = chain.joints();
        if joints.is_empty() || joints.iter().any(|joint| joint.kind == JointKind::Prismatic) {
            return None;
        }
        let still = Frame { twist: Twist::None, lever: [0.0; 3], levered: false };
        let mut all = Frames {
            len: joints.len(),
            frames: [still; MAX_JOINTS],
            theta: [0.0; MAX_JOINTS],
            shift: [0.0; MAX_JOINTS],
        };
        // What the frame before was moved back by lengthens this lever.
        let mut carried = 0.0;
        for (i, joint) in joints.iter().enumerate() {
            // Column 3 of the placement's rotation is the joint's axis in the parent frame: (0, -sin alpha, cos alpha).
            let rotation = joint.placement(0.0).rotation;
            let (sin, cos) = (-rotation[(1, 2)], rotation[(2, 2)]);
            // A lever along the joint's own axis alone vanishes when the frame moves along that axis. The last frame has no one to
            // carry it to, and the parent of the first is at rest.
            let vanishes = joint.a == 0.0 && carried == 0.0;
            let moved = may_move && (i == 0 || i + 1 == joints.len() || vanishes);
            let d = if moved { 0.0 } else { joint.d };
            let lever = [joint.a, -sin * d, cos * d + carried];
            carried = if moved { joint.d } else { 0.0 };
            all.frames[i] = Frame {
                twist: match (sin, cos) {
                    (0.0, 1.0) => Twist::None,
                    (1.0, 0.0) => Twist::Left,
                    (-1.0, 0.0) => Twist::Right,
                    _ => Twist::Any(sin, cos),
                },
                lever,
                levered: i > 0 && lever != [0.0; 3],
            };
            all.theta[i] = joint.theta;
            all.shift[i] = -carried;
        }
        Some(all)
    }

    /// Standard parameters of link `i` about this arm's frame, from those about the chain's.
    pub fn parameters(&self, i: usize, p: &LinkParameters) -> LinkParameters {
        let t = self.shift[i];
        let [xx, xy, xz, yy, yz, zz, x, y, z, m] = *p;
        // Steiner's theorem for a step t along z.
        let turned = m * t * t - 2.0 * t * z;
        [xx + turned, xy, xz + t * x, yy + turned, yz + t * y, zz, x, y, z - m * t, m]
    }
}

/// A parent's vector in the twisted frame: `Rx(alpha)' v`.
#[inline(always)]
pub fn untwist(twist: Twist, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match twist {
        Twist::None => [x, y, z],
        Twist::Left => [x, z, -y],
        Twist::Right => [x, -z, y],
        Twist::Any(sin, cos) => [x, cos * y + sin * z, cos * z - sin * y],
    }
}

/// The other way: `Rx(alpha) v`.
#[inline(always)]
pub fn twist(twist: Twist, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match twist {
        Twist::None => [x, y, z],
        Twist::Left => [x, -z, y],
        Twist::Right => [x, z, -y],
        Twist::Any(sin, cos) => [x, cos * y - sin * z, sin * y + cos * z],
    }
}
