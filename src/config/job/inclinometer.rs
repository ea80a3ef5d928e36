//! `[inclinometer]`: a CiA 410 inclinometer on the base. `[mounting-check]`: agreement of mountings before serving.

use crate::config::units;
use crate::inclinometer::attitude::{Installation, SlopeConvention};
use crate::inclinometer::canopen::Width;
use crate::inclinometer::follow::{FollowSettings, OnSensorLoss};
use crate::inclinometer::node::NodeSettings;
use crate::inclinometer::sensor::SensorSettings;
use crate::inclinometer::slope_filter::SlopeFilterSettings;
use crate::inclinometer::socket::SIMULATED_PREFIX;
use plumbline_core::BadInput;
use plumbline_model::Mounting;
use schemars::JsonSchema;
use serde::Deserialize;

/// Check that all sources of the mounting agree before anything is served.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct MountingCheck {
    /// Largest angle, beyond the uncertainty, between any two of: declared mounting, inclinometer, direction of gravity from torques at
    /// rest \[rad\].
    #[serde(with = "units::Angle")]
    pub tolerance: f64,
    /// Whether torques at rest are part of the check.
    pub torques: bool,
}

impl Default for MountingCheck {
    fn default() -> MountingCheck {
        MountingCheck { tolerance: 5f64.to_radians(), torques: true }
    }
}

/// A CiA 410 inclinometer on the base, over SocketCAN.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Inclinometer {
    /// CAN interface, such as `can0`; its bit rate is set with `ip link`. `simulated:PATH` is a Unix socket in place of a bus, for
    /// simulated arms only.
    pub interface: String,
    /// CANopen node id of the device, 1 to 127.
    pub node: u8,
    /// Required serial number (1018h:4); any if absent.
    #[serde(default)]
    pub serial: Option<u32>,
    /// Heartbeat period of the device; three missing heartbeats are a loss \[s\].
    #[serde(default = "heartbeat", with = "units::Duration")]
    pub heartbeat: f64,
    /// Rate of the slopes \[Hz\].
    #[serde(default = "rate", with = "units::Frequency")]
    pub rate: f64,
    /// Slope objects: 16 (6010h, 6020h) or 32 bits (6110h, 6120h).
    #[serde(default = "bits")]
    pub bits: u8,
    #[serde(default)]
    pub slopes: SlopeConvention,
    /// The sensor's x axis (longitudinal slope) in the base frame.
    pub x: Axis,
    /// The sensor's z axis (normal to its mounting plate) in the base frame.
    pub z: Axis,
    /// Zero offset of the two slopes \[rad\].
    #[serde(default, with = "units::AnglePair")]
    pub zero: [f64; 2],
    /// Largest slope that the sensor measures \[rad\].
    #[serde(default = "range", with = "units::Angle")]
    pub range: f64,
    /// Systematic standard deviation of a slope, from the data sheet \[rad\].
    #[serde(default = "accuracy", with = "units::Angle")]
    pub accuracy: f64,
    /// Time constant of the low-pass \[s\].
    #[serde(default = "time_constant", with = "units::Duration")]
    pub time_constant: f64,
    /// Largest plausible step of a slope between two frames \[rad\].
    #[serde(default = "jump", with = "units::Angle")]
    pub jump: f64,
    /// Largest deviation from the low-pass of a base at rest \[rad\].
    #[serde(default = "still", with = "units::Angle")]
    pub still: f64,
    /// Smallest change of gravity that is handed over to the model \[rad\].
    #[serde(default = "step", with = "units::Angle")]
    pub step: f64,
    /// Largest rate of change of the model's gravity \[rad/s\].
    #[serde(default = "turn", with = "units::AngularRate")]
    pub turn: f64,
    #[serde(default)]
    pub on_loss: OnSensorLoss,
    /// What the arm does when the base moves during an excitation.
    #[serde(default)]
    pub on_base_motion: BaseMotion,
}

/// What the arm does when the base moves during an excitation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BaseMotion {
    /// A controlled stop: the samples have no single mounting.
    #[default]
    Stop,
    /// Continues; the event is logged and shown in the status.
    Say,
}

#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(untagged, expecting = "\"x\", \"-x\", \"y\", \"-y\", \"z\", \"-z\" or a unit vector such as [0.0, 0.6, 0.8]")]
pub enum Axis {
    /// An axis of the base frame, or its opposite.
    Named(AxisName),
    /// A unit vector.
    Vector([f64; 3]),
}

/// An axis of the base frame, or its opposite.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AxisName {
    X,
    Y,
    Z,
    #[serde(rename = "-x")]
    MinusX,
    #[serde(rename = "-y")]
    MinusY,
    #[serde(rename = "-z")]
    MinusZ,
}

impl Axis {
    fn vector(self) -> [f64; 3] {
        match self {
            Axis::Vector(vector) => vector,
            Axis::Named(name) => match name {
                AxisName::X => [1.0, 0.0, 0.0],
                AxisName::Y => [0.0, 1.0, 0.0],
                AxisName::Z => [0.0, 0.0, 1.0],
                AxisName::MinusX => [-1.0, 0.0, 0.0],
                AxisName::MinusY => [0.0, -1.0, 0.0],
                AxisName::MinusZ => [0.0, 0.0, -1.0],
            },
        }
    }
}

fn heartbeat() -> f64 {
    0.2
}

fn rate() -> f64 {
    50.0
}

fn bits() -> u8 {
    16
}

fn range() -> f64 {
    80f64.to_radians()
}

fn accuracy() -> f64 {
    0.2f64.to_radians()
}

fn time_constant() -> f64 {
    SlopeFilterSettings::default().time_constant
}

fn jump() -> f64 {
    SlopeFilterSettings::default().jump
}

fn still() -> f64 {
    SlopeFilterSettings::default().still
}

fn step() -> f64 {
    0.1f64.to_radians()
}

fn turn() -> f64 {
    1f64.to_radians()
}

impl Inclinometer {
    /// Checks ranges, and that the declared mounting is in the sensor's range.
    pub(super) fn check(&self, file: &str, declared: &Mounting) -> Result<(), BadInput> {
        let bad = |key: &str, value: String, expected: &str| {
            Err(BadInput::new(file, format!("key `inclinometer.{key}`"), value, expected))
        };
        let name = &self.interface;
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        if let Some(path) = name.strip_prefix(SIMULATED_PREFIX) {
            // Capacity of sun_path.
            if path.is_empty() || path.len() > 107 {
                return bad("interface", format!("`{name}`"), "a path of 1 to 107 bytes after `simulated:`");
            }
        } else if name.is_empty() || name.len() > 15 || !name.chars().all(plain) || name.starts_with('.') {
            return bad("interface", format!("`{name}`"), "the name of a CAN interface, such as can0");
        }
        if !(1..=127).contains(&self.node) {
            return bad("node", self.node.to_string(), "a CANopen node id, 1 to 127");
        }
        if ![16, 32].contains(&self.bits) {
            return bad("bits", self.bits.to_string(), "16 or 32");
        }
        let degrees = |angle: f64| format!("{:.3} deg", angle.to_degrees());
        let within = |key: &str, value: f64, low: f64, high: f64, text: String, expected: &str| {
            if (low..=high).contains(&value) { Ok(()) } else { bad(key, text, expected) }
        };
        within("rate", self.rate, 10.0, 100.0, format!("{} Hz", self.rate), "10 Hz to 100 Hz")?;
        within("heartbeat", self.heartbeat, 0.02, 5.0, format!("{} s", self.heartbeat), "20 ms to 5 s")?;
        let constant = self.time_constant;
        within("time-constant", constant, 0.02, 30.0, format!("{constant} s"), "20 ms to 30 s")?;
        let angles = [
            ("range", self.range, 1.0, 90.0, "1 deg to 90 deg"),
            ("accuracy", self.accuracy, 0.0, 5.0, "0 deg to 5 deg"),
            ("jump", self.jump, 0.1, 90.0, "0.1 deg to 90 deg"),
            ("still", self.still, 0.01, 10.0, "0.01 deg to 10 deg"),
            ("step", self.step, 0.01, 5.0, "0.01 deg to 5 deg"),
            ("turn", self.turn, 0.01, 30.0, "0.01 deg/s to 30 deg/s"),
            ("zero[0]", self.zero[0].abs(), 0.0, 45.0, "-45 deg to 45 deg"),
            ("zero[1]", self.zero[1].abs(), 0.0, 45.0, "-45 deg to 45 deg"),
        ];
        for (key, value, low, high, expected) in angles {
            let (low, high): (f64, f64) = (low, high);
            // Both ends are valid despite the rounding of the conversion.
            let (low, high) = (low.to_radians() - 1e-9, high.to_radians() + 1e-9);
            within(key, value, low, high, degrees(value), expected)?;
        }
        let installation = match Installation::new(self.x.vector(), self.z.vector()) {
            Ok(installation) => self.installation(installation),
            Err(error) => return bad("z", error.to_string(), "two unit vectors at right angles, as `x` and `z`"),
        };
        match installation.hemisphere(declared) {
            Ok(_) => Ok(()),
            Err(error) => bad(
                "z",
                error.to_string(),
                "a sensor whose range includes the declared `mounting`: put it on a bracket",
            ),
        }
    }

    pub fn is_simulated(&self) -> bool {
        self.interface.starts_with(SIMULATED_PREFIX)
    }

    fn installation(&self, mut installation: Installation) -> Installation {
        installation.zero = self.zero;
        installation.range = self.range;
        installation.accuracy = self.accuracy;
        installation.slopes = self.slopes;
        installation
    }

    /// Settings of the sensor for the declared mounting.
    pub fn sensor(&self, file: &str, declared: Mounting) -> Result<SensorSettings, BadInput> {
        self.check(file, &declared)?;
        let installation = Installation::new(self.x.vector(), self.z.vector())
            .map_err(|error| BadInput::new(file, "key `inclinometer.z`", error, "axes at right angles"))?;
        let ms = |seconds: f64| (1e3 * seconds).round() as u16;
        Ok(SensorSettings {
            node: NodeSettings {
                node: self.node,
                heartbeat: ms(self.heartbeat),
                period: ms(1.0 / self.rate),
                width: if self.bits == 32 { Width::Bits32 } else { Width::Bits16 },
                serial: self.serial,
            },
            installation: self.installation(installation),
            filter: SlopeFilterSettings { time_constant: self.time_constant, jump: self.jump, still: self.still },
            declared,
        })
    }

    pub fn follow(&self, declared: Mounting, check: &MountingCheck) -> FollowSettings {
        FollowSettings { declared, tolerance: check.tolerance, step: self.step, rate: self.turn, on_loss: self.on_loss }
    }
}
