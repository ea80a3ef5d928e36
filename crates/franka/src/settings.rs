//! What a session with an arm is opened with.

use super::wire;
use serde::Deserialize;
use std::net::IpAddr;
use std::time::Duration;

pub use super::wire::{CollisionBehavior as Collision, Load};
pub use plumbline_core::Purpose;

/// Strengths that a gravity can have \[m/s2\].
pub(super) const PLAUSIBLE_GRAVITY: std::ops::Range<f64> = 8.0..12.0;

/// Which robot is expected: it decides the limits where the arm does not serve its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotKind {
    /// Franka Emika Panda, FER.
    Panda,
    /// Franka Research 3.
    Fr3,
}

/// What the commands hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Interface {
    /// Joint positions: the arm's own controller follows them.
    #[default]
    JointPosition,
    /// Joint velocities, which the arm integrates; they are chosen so that the integral is the commanded position.
    JointVelocity,
    /// Joint torques from an impedance law in this program, see [`TorqueControl`].
    Torque,
}

/// The arm's own controller under a motion of positions or velocities.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Controller {
    /// Stiffness per joint.
    #[default]
    JointImpedance,
    /// Stiffness per direction of the end effector.
    CartesianImpedance,
}

/// The impedance law of [`Interface::Torque`]:
/// `tau_J_d = stiffness (q_d - q) + damping (dq_d - dq) + feed-forward`, within the torque limits and their rate.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct TorqueControl {
    /// Per joint \[Nm/rad\].
    pub stiffness: [f64; 7],
    /// Per joint \[Nms/rad\].
    pub damping: [f64; 7],
    /// Whether the served model's torque is added, less what the arm's own controller adds by itself: `tau_ff - tau_vendor` of the
    /// command, with `tau_vendor` the model at rest under the gravity that the arm compensates ([`super::Info::compensates`]), not the one that acts.
    pub feed_forward: bool,
    /// Largest distance between desired and measured position \[rad\]; a command beyond is refused.
    pub reach: f64,
}

impl Default for TorqueControl {
    /// Stiffness and damping of libfranka's example `joint_impedance_control`, with feed-forward, 0.1 rad.
    fn default() -> TorqueControl {
        TorqueControl {
            stiffness: [600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0],
            damping: [50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0],
            feed_forward: true,
            reach: 0.1,
        }
    }
}

/// Socket options. One that the system refuses is no error: it is listed in [`super::Info::refused_options`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SocketOptions {
    /// `SO_PRIORITY` of commands, 0 to 6 without further rights.
    pub priority: Option<u32>,
    /// `SO_BUSY_POLL` \[us\]: the card is polled so long before a read sleeps.
    pub busy_poll_us: Option<u32>,
    /// Receive buffer for states \[bytes\].
    pub receive_buffer: Option<usize>,
}

/// Everything a session is opened with. [`Settings::new`] has the defaults.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Address of the arm's control unit.
    pub address: IpAddr,
    /// Which robot is expected.
    pub robot: RobotKind,
    /// What the commands hold.
    pub interface: Interface,
    /// With [`Purpose::Drive`] the first read starts a motion and every command is sent; with [`Purpose::Monitor`] no motion is started, and
    /// commands are ignored.
    pub purpose: Purpose,
    /// The arm's own controller, not used by [`Interface::Torque`].
    pub controller: Controller,
    /// Thresholds of contact and collision; set at connection when the purpose is to drive.
    pub collision: Collision,
    /// Stiffness of the joint impedance controller \[Nm/rad\]; `None` leaves what the arm has.
    pub joint_impedance: Option<[f64; 7]>,
    /// Stiffness of the Cartesian impedance controller \[N/m, Nm/rad\]; `None` leaves what the arm has.
    pub cartesian_impedance: Option<[f64; 6]>,
    /// Load at the flange; `None` leaves what the arm has.
    pub load: Option<Load>,
    /// The impedance law of [`Interface::Torque`].
    pub torque: TorqueControl,
    /// Gravity that the arm's own controller compensates, in the base frame, as declared \[m/s2\]; `None` takes `O_ddP_O` of the arm's state.
    pub compensates: Option<[f64; 3]>,
    /// Socket options.
    pub socket: SocketOptions,
    /// Timeout of a read without a state.
    pub state_timeout: Duration,
    /// Longest wait for any one answer at connection.
    pub connect_timeout: Duration,
    /// Share of the arm's limits that commands are held to, above 0 and at most 1.
    pub limits_share: f64,
}

impl Settings {
    /// To drive `robot` at `address` by joint positions under its joint impedance controller, with libfranka's example thresholds, and
    /// 98 % of its limits.
    pub fn new(address: IpAddr, robot: RobotKind) -> Settings {
        Settings {
            address,
            robot,
            interface: Interface::JointPosition,
            purpose: Purpose::Drive,
            controller: Controller::JointImpedance,
            collision: Collision::default(),
            joint_impedance: None,
            cartesian_impedance: None,
            load: None,
            torque: TorqueControl::default(),
            compensates: None,
            socket: SocketOptions::default(),
            state_timeout: Duration::from_millis(100),
            connect_timeout: Duration::from_secs(3),
            limits_share: 0.98,
        }
    }

    /// The first setting that can't be used.
    pub(super) fn check(&self) -> Result<(), BadSetting> {
        let positive = |what, values: &[f64]| match values.iter().find(|value| !(value.is_finite() && **value >= 0.0)) {
            Some(&value) => Err(BadSetting { what, value, expected: "a finite number, 0 or more" }),
            None => Ok(()),
        };
        let collision = &self.collision;
        positive("lower-torque-acceleration", &collision.lower_torque_acceleration)?;
        positive("upper-torque-acceleration", &collision.upper_torque_acceleration)?;
        positive("lower-torque-nominal", &collision.lower_torque_nominal)?;
        positive("upper-torque-nominal", &collision.upper_torque_nominal)?;
        positive("lower-force-acceleration", &collision.lower_force_acceleration)?;
        positive("upper-force-acceleration", &collision.upper_force_acceleration)?;
        positive("lower-force-nominal", &collision.lower_force_nominal)?;
        positive("upper-force-nominal", &collision.upper_force_nominal)?;
        positive("joint-impedance", &self.joint_impedance.unwrap_or_default())?;
        positive("cartesian-impedance", &self.cartesian_impedance.unwrap_or_default())?;
        positive("torque stiffness", &self.torque.stiffness)?;
        positive("torque damping", &self.torque.damping)?;
        positive("torque reach", &[self.torque.reach])?;
        if let Some(gravity) = self.compensates {
            let norm = gravity.iter().map(|x| x * x).sum::<f64>().sqrt();
            if !PLAUSIBLE_GRAVITY.contains(&norm) {
                return Err(BadSetting { what: "compensates", value: norm, expected: "a gravity of 8 to 12 m/s2" });
            }
        }
        if let Some(load) = &self.load {
            positive("load mass", &[load.mass])?;
            let more = load.com.iter().chain(&load.inertia);
            if let Some(&value) = more.into_iter().find(|value| !value.is_finite()) {
                return Err(BadSetting { what: "load", value, expected: "a finite number" });
            }
        }
        if !(self.limits_share > 0.0 && self.limits_share <= 1.0) {
            let expected = "more than 0 and at most 1";
            return Err(BadSetting { what: "limits-share", value: self.limits_share, expected });
        }
        for (what, time) in [("state-timeout", self.state_timeout), ("connect-timeout", self.connect_timeout)] {
            if !(0.001..=60.0).contains(&time.as_secs_f64()) {
                return Err(BadSetting { what, value: time.as_secs_f64(), expected: "0.001 to 60 s" });
            }
        }
        Ok(())
    }

    pub(super) fn table(&self, protocol: wire::Protocol) -> super::limits::RobotLimits {
        match (self.robot, protocol) {
            (RobotKind::Panda, _) => super::limits::panda(),
            (RobotKind::Fr3, wire::Protocol::V10) => super::limits::fr3(),
            (RobotKind::Fr3, _) => super::limits::fr3_before_5_9(),
        }
    }
}

/// A setting that no session can be opened with.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{what} is {value}, expected {expected}")]
pub struct BadSetting {
    /// Which setting.
    pub what: &'static str,
    /// Its value.
    pub value: f64,
    /// What it must be.
    pub expected: &'static str,
}

impl Default for Collision {
    /// The thresholds that libfranka's examples set (`setDefaultBehavior`): 20 Nm and N while accelerating, 10 at constant velocity,
    /// contact and collision alike.
    fn default() -> Collision {
        Collision {
            lower_torque_acceleration: [20.0; 7],
            upper_torque_acceleration: [20.0; 7],
            lower_torque_nominal: [10.0; 7],
            upper_torque_nominal: [10.0; 7],
            lower_force_acceleration: [20.0; 6],
            upper_force_acceleration: [20.0; 6],
            lower_force_nominal: [10.0; 6],
            upper_force_nominal: [10.0; 6],
        }
    }
}
