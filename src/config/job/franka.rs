//! `[backend.franka]`: connection and control of a Franka arm.

use crate::config::units;
use nalgebra::Matrix3;
use plumbline_core::{BadInput, Purpose, symmetric_eigen};
use plumbline_franka::{Controller, FrankaConnector, Interface, RobotKind, TorqueControl};
use plumbline_model::Mounting;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::SeqAccessDeserializer;
use serde::de::{Error, SeqAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::json;
use std::borrow::Cow;
use std::net::IpAddr;
use std::time::Duration;

/// A Franka arm behind the Franka Control Interface.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Franka {
    /// Address of the robot's control unit in the shop-floor network.
    #[schemars(regex(pattern = "^[0-9A-Fa-f:.]+$"))]
    pub address: IpAddr,
    #[serde(default)]
    pub interface: Interface,
    /// Controller of the robot for commanded positions and velocities.
    #[serde(default)]
    pub controller: Controller,
    /// Recovery after a reflex: by an operator or automatic.
    #[serde(default)]
    pub recovery: Recovery,
    #[serde(default = "default_max_recoveries")]
    pub max_recoveries: u32,
    /// Ratio of the robot's limits of velocity, acceleration and jerk for commands.
    #[serde(default = "default_limits_share")]
    pub limits_share: f64,
    /// Stiffness of the joint impedance controller \[Nm/rad\]; the robot's own where absent.
    #[serde(default)]
    pub joint_impedance: Option<[f64; 7]>,
    /// plumbline's own impedance, with `interface = "torque"`.
    #[serde(default)]
    pub torque: TorqueControl,
    /// Gravity that the robot's own controller compensates: `"upright"`, `"true"` (the one of `mounting`) or a vector in the base
    /// frame \[m/s2\]; the robot's own value (`O_ddP_O` of its state) where absent. One that disagrees with the robot's is refused.
    #[serde(default, with = "CompensatesSetting")]
    pub compensates: Option<Compensates>,
    #[serde(default)]
    pub collision: Collision,
    /// Load at the flange beside the end effector configured in Desk.
    #[serde(default)]
    pub load: Option<Load>,
    #[serde(default)]
    pub socket: Socket,
    /// Timeout of a state \[s\].
    #[serde(default = "state_timeout", with = "units::Duration")]
    pub state_timeout: f64,
    /// Timeout of the connection \[s\].
    #[serde(default = "connect_timeout", with = "units::Duration")]
    pub connect_timeout: f64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Recovery {
    /// By an operator: the job ends with the next steps.
    #[default]
    Operator,
    /// Automatic after `communication_constraints_violation`, at most `max-recoveries` times in a job:
    /// the interrupted motion is repeated from its beginning. Other reflexes need an operator.
    Automatic,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Compensates {
    /// Along the base's negative z axis, whatever the mounting.
    Upright,
    True,
    /// This one, in the base frame \[m/s2\].
    Along([f64; 3]),
}

const COMPENSATES: &str = "\"upright\", \"true\" or a gravity [x, y, z] in the base frame in m/s2";

/// `with` for [`Compensates`].
struct CompensatesSetting;

impl CompensatesSetting {
    fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Compensates>, D::Error> {
        struct Setting;
        impl<'de> Visitor<'de> for Setting {
            type Value = Compensates;

            fn expecting(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
                f.write_str(COMPENSATES)
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<Compensates, E> {
                match name {
                    "upright" => Ok(Compensates::Upright),
                    "true" => Ok(Compensates::True),
                    _ => Err(E::invalid_value(Unexpected::Str(name), &self)),
                }
            }

            // `--set backend.franka.compensates=true` is a truth value in TOML.
            fn visit_bool<E: Error>(self, is: bool) -> Result<Compensates, E> {
                if is { Ok(Compensates::True) } else { Err(E::invalid_value(Unexpected::Bool(is), &self)) }
            }

            fn visit_seq<S: SeqAccess<'de>>(self, seq: S) -> Result<Compensates, S::Error> {
                <[f64; 3]>::deserialize(SeqAccessDeserializer::new(seq)).map(Compensates::Along)
            }
        }
        deserializer.deserialize_any(Setting).map(Some)
    }

    fn serialize<S: Serializer>(value: &Option<Compensates>, serializer: S) -> Result<S::Ok, S::Error> {
        match value {
            None => serializer.serialize_none(),
            Some(Compensates::Upright) => serializer.serialize_str("upright"),
            Some(Compensates::True) => serializer.serialize_str("true"),
            Some(Compensates::Along(gravity)) => gravity.serialize(serializer),
        }
    }
}

impl JsonSchema for CompensatesSetting {
    fn schema_name() -> Cow<'static, str> {
        "Compensates".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        let vector = json!({ "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 });
        json_schema!({ "description": COMPENSATES, "anyOf": [{ "enum": ["upright", "true", true] }, vector] })
    }
}

impl Compensates {
    /// The gravity itself on an arm in `mounting` \[m/s2\].
    fn gravity(&self, mounting: &Mounting) -> [f64; 3] {
        match self {
            Compensates::Upright => Mounting::UPRIGHT.gravity().into(),
            Compensates::True => mounting.gravity().into(),
            Compensates::Along(gravity) => *gravity,
        }
    }
}

/// Thresholds of the robot's own contact and collision detection, while accelerating or not.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Collision {
    /// External torque that counts as a contact \[Nm\].
    pub contact_torque: [f64; 7],
    /// External torque that stops the arm \[Nm\].
    pub collision_torque: [f64; 7],
    /// External force and moment at the end effector that count as a contact \[N\], \[Nm\].
    pub contact_force: [f64; 6],
    /// Those that stop the arm \[N\], \[Nm\].
    pub collision_force: [f64; 6],
}

impl Default for Collision {
    /// The thresholds of libfranka's examples.
    fn default() -> Collision {
        Collision {
            contact_torque: [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0],
            collision_torque: [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0],
            contact_force: [20.0, 20.0, 20.0, 25.0, 25.0, 25.0],
            collision_force: [20.0, 20.0, 20.0, 25.0, 25.0, 25.0],
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Load {
    /// Mass \[kg\].
    pub mass: f64,
    /// Centre of mass in the flange frame \[m\].
    pub com: [f64; 3],
    /// Inertia about the centre of mass: xx, xy, xz, yy, yz, zz \[kg m2\].
    #[serde(default)]
    pub inertia: [f64; 6],
}

/// Options of the UDP socket; absent ones have the system's defaults.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Socket {
    /// `SO_PRIORITY`, 0 to 6 without privileges.
    pub priority: Option<u32>,
    /// `SO_BUSY_POLL`: how long the driver polls for a packet before it sleeps \[us\].
    pub busy_poll: Option<u32>,
    /// `SO_RCVBUF` \[bytes\].
    pub receive_buffer: Option<usize>,
}

/// Rated payload of both arms by their data sheets \[kg\].
const RATED_PAYLOAD_KG: f64 = 3.0;

/// Whether some body of `mass` \[kg\] has this inertia about its centre of mass: no principal moment below zero or above the sum of the others.
fn is_inertia(mass: f64, &[xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> bool {
    let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    let slack = 1e-6 * inertia.amax();
    let Some(moments) = symmetric_eigen(inertia).map(|eigen| eigen.eigenvalues) else { return false };
    let of_a_body = |moment: &f64| *moment >= -slack && *moment <= 0.5 * moments.sum() + slack;
    moments.iter().all(of_a_body) && moments.max() <= mass * 0.25
}

fn default_max_recoveries() -> u32 {
    2
}

fn default_limits_share() -> f64 {
    0.98
}

fn state_timeout() -> f64 {
    0.1
}

fn connect_timeout() -> f64 {
    5.0
}

impl Franka {
    pub(super) fn robot(job: &super::Job) -> Result<RobotKind, BadInput> {
        match job.robot.as_str() {
            "panda" => Ok(RobotKind::Panda),
            "fr3" => Ok(RobotKind::Fr3),
            other => {
                let file = job.file.display().to_string();
                let expected = "panda or fr3, for backend.kind = \"franka\"";
                Err(BadInput::new(file, "key `robot`", format!("`{other}`"), expected))
            }
        }
    }

    /// The arm as a backend.
    pub fn connector(&self, job: &super::Job) -> Result<FrankaConnector, BadInput> {
        let max_recoveries = match self.recovery {
            Recovery::Operator => 0,
            Recovery::Automatic => self.max_recoveries,
        };
        Ok(FrankaConnector { settings: self.settings(job, Purpose::Drive)?, max_recoveries })
    }

    /// Settings of a session with the arm.
    pub fn settings(&self, job: &super::Job, purpose: Purpose) -> Result<plumbline_franka::Settings, BadInput> {
        let robot = Franka::robot(job)?;
        let Collision { contact_torque, collision_torque, contact_force, collision_force } = self.collision;
        let Socket { priority, busy_poll, receive_buffer } = self.socket;
        Ok(plumbline_franka::Settings {
            interface: self.interface,
            purpose,
            controller: self.controller,
            collision: plumbline_franka::Collision {
                lower_torque_acceleration: contact_torque,
                upper_torque_acceleration: collision_torque,
                lower_torque_nominal: contact_torque,
                upper_torque_nominal: collision_torque,
                lower_force_acceleration: contact_force,
                upper_force_acceleration: collision_force,
                lower_force_nominal: contact_force,
                upper_force_nominal: collision_force,
            },
            joint_impedance: self.joint_impedance,
            load: self.load.as_ref().map(|load| {
                let [xx, xy, xz, yy, yz, zz] = load.inertia;
                plumbline_franka::Load { mass: load.mass, com: load.com, inertia: [xx, xy, xz, xy, yy, yz, xz, yz, zz] }
            }),
            torque: self.torque,
            compensates: self.compensates.map(|compensates| compensates.gravity(&job.mounting)),
            socket: plumbline_franka::SocketOptions { priority, busy_poll_us: busy_poll, receive_buffer },
            state_timeout: Duration::from_secs_f64(self.state_timeout),
            connect_timeout: Duration::from_secs_f64(self.connect_timeout),
            limits_share: self.limits_share,
            ..plumbline_franka::Settings::new(self.address, robot)
        })
    }

    /// Checks every range; `file` is named in errors.
    pub(super) fn check(&self, file: &str) -> Result<(), BadInput> {
        let bad = |key: &str, value: String, expected: &str| {
            Err(BadInput::new(file, format!("key `backend.franka.{key}`"), value, expected))
        };
        if self.max_recoveries > 100 {
            return bad("max-recoveries", self.max_recoveries.to_string(), "0 to 100");
        }
        if !(0.05..=0.99).contains(&self.limits_share) {
            return bad("limits-share", self.limits_share.to_string(), "0.05 to 0.99 of the robot's limits");
        }
        for (key, value, least, most) in
            [("state-timeout", self.state_timeout, 0.005, 5.0), ("connect-timeout", self.connect_timeout, 0.1, 60.0)]
        {
            if !(least..=most).contains(&value) {
                return bad(key, format!("{value} s"), &format!("{least} s to {most} s"));
            }
        }
        if let Some(stiffness) = self.joint_impedance
            && let Some(value) = stiffness.iter().find(|value| !(**value > 0.0 && **value <= 14_250.0))
        {
            return bad("joint-impedance", format!("{value} Nm/rad"), "above 0, at most 14250 Nm/rad for every joint");
        }
        if let Some(Compensates::Along(gravity)) = &self.compensates {
            let norm = gravity.iter().map(|x| x * x).sum::<f64>().sqrt();
            if !(8.0..12.0).contains(&norm) {
                return bad("compensates", format!("{gravity:?}, {norm} m/s2 long"), "a gravity of 8 to 12 m/s2");
            }
        }
        let TorqueControl { stiffness, damping, reach, feed_forward: _ } = &self.torque;
        for (key, values, most, unit) in
            [("stiffness", stiffness, 2000.0, "Nm/rad"), ("damping", damping, 200.0, "Nms/rad")]
        {
            if let Some(value) = values.iter().find(|value| !(0.0..=most).contains(*value)) {
                return bad(
                    &format!("torque.{key}"),
                    format!("{value} {unit}"),
                    &format!("0 to {most} {unit} for every joint"),
                );
            }
        }
        if !(*reach > 0.0 && *reach <= 0.5) {
            return bad("torque.reach", format!("{reach} rad"), "above 0, at most 0.5 rad");
        }
        let Collision { contact_torque, collision_torque, contact_force, collision_force } = &self.collision;
        let thresholds: [(&str, &[f64], f64); 4] = [
            ("contact-torque", contact_torque, 100.0),
            ("collision-torque", collision_torque, 100.0),
            ("contact-force", contact_force, 200.0),
            ("collision-force", collision_force, 200.0),
        ];
        for (key, values, most) in thresholds {
            if let Some(value) = values.iter().find(|value| !(**value > 0.0 && **value <= most)) {
                return bad(&format!("collision.{key}"), value.to_string(), &format!("above 0, at most {most}"));
            }
        }
        if let Some(Load { mass, com, inertia }) = &self.load {
            if !(0.0..=RATED_PAYLOAD_KG).contains(mass) {
                return bad("load.mass", format!("{mass} kg"), "0 kg to 3 kg, the arm's rated payload");
            }
            if !com.iter().all(|value| value.is_finite()) || com.iter().map(|value| value * value).sum::<f64>() > 0.25 {
                return bad(
                    "load.com",
                    format!("{com:?} m"),
                    "a centre of mass in the flange frame, within 0.5 m of the flange",
                );
            }
            if !is_inertia(*mass, inertia) {
                let expected =
                    "xx, xy, xz, yy, yz, zz of a body of that mass, with a radius of gyration of at most 0.5 m";
                return bad("load.inertia", format!("{inertia:?} kg m2"), expected);
            }
        }
        if let Some(priority) = self.socket.priority.filter(|&priority| priority > 15) {
            return bad("socket.priority", priority.to_string(), "0 to 15 (above 6 takes CAP_NET_ADMIN)");
        }
        if let Some(poll) = self.socket.busy_poll.filter(|&poll| poll > 1000) {
            return bad("socket.busy-poll", format!("{poll} us"), "0 us to 1000 us");
        }
        if let Some(buffer) = self.socket.receive_buffer.filter(|buffer| !(4096..=16 << 20).contains(buffer)) {
            return bad("socket.receive-buffer", format!("{buffer} bytes"), "4096 bytes to 16 MiB");
        }
        Ok(())
    }
}
