//! The arm of a recording for 3-D viewers: its description, and the placements of its links.

use super::Recording;
use super::cdr::Encoder;
use super::messages::stamp;
use crate::store::export::urdf;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use plumbline_core::JointVec;
use plumbline_model::{Mounting, Placement, Robot};

/// Cycles between two messages of placements: 50 a second, as viewers draw.
pub const CYCLES_PER_MESSAGE: u64 = 20;
/// Frame with its z axis up.
const WORLD: &str = "world";

/// The arm in its mounting.
pub struct Scene {
    robot: Robot,
    /// Prefix of the names of joints and links.
    prefix: String,
    /// The base frame in [`WORLD`].
    base: Placement,
}

impl Scene {
    /// Of a recording with the description of its robot; `None` where that is absent, damaged, or of another number of joints.
    pub fn of(recording: &Recording) -> Option<Scene> {
        let about = &recording.about;
        let robot = Robot::parse("robot.toml", recording.text("robot.toml")?).ok()?;
        let gravity = Mounting { rho: about.rho, phi: about.phi }.gravity();
        // Gravity along the base frame's z axis: half a turn about any horizontal axis.
        let upright = Rotation3::rotation_between(&gravity, &-Vector3::z())
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let base = Placement { rotation: *upright.matrix(), origin: Vector3::zeros() };
        (robot.chain.len() == about.joints).then(|| Scene { robot, prefix: about.robot.clone(), base })
    }

    /// `std_msgs/String` with the URDF.
    pub fn description(&self) -> Vec<u8> {
        let mut message = Encoder::default();
        message.string(&urdf::shown(&self.robot, &self.prefix));
        message.finish()
    }

    /// `tf2_msgs/TFMessage` at positions `q` \[rad\]: base in the world, each link in the one before, flange in the last.
    pub fn transforms(&self, q: &JointVec, log_ns: u64) -> Vec<u8> {
        let (chain, link) = (&self.robot.chain, |k: usize| format!("{}_link{k}", self.prefix));
        let mut frames = vec![(WORLD.to_string(), link(0), self.base)];
        for (j, (joint, q)) in chain.joints().iter().zip(q).enumerate() {
            frames.push((link(j), link(j + 1), joint.placement(*q)));
        }
        frames.push((link(chain.len()), format!("{}_flange", self.prefix), *chain.flange()));
        let mut message = Encoder::default();
        message.u32(frames.len() as u32);
        for (parent, child, Placement { rotation, origin }) in frames {
            let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
            stamp(&mut message, log_ns);
            message.string(&parent).string(&child);
            origin.iter().chain(turn.coords.iter()).for_each(|value| {
                message.f64(*value);
            });
        }
        message.finish()
    }
}
