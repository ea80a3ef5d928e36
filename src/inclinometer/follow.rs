//! Gravity vector of the served model, and refusal to serve.
//!
//! The gravity vector follows the measured direction at a bounded rate, in steps of at least `step`. Each step changes the served
//! torque by at most twice `step` times the arm's gravity torque. Without a reading the configured fall-back applies.

use super::fault::Fault;
use super::sensor::{Health, Reading};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use plumbline_model::{Mounting, angle_between};
use serde::Deserialize;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnSensorLoss {
    /// No torque: a moving arm is stopped, and the model is withdrawn until there is a reading again.
    #[default]
    Refuse,
    /// The model with the last measured direction; the declared one if there was none.
    Hold,
    Declared,
}

impl std::fmt::Display for OnSensorLoss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            OnSensorLoss::Refuse => "refuse",
            OnSensorLoss::Hold => "hold",
            OnSensorLoss::Declared => "declared",
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowSettings {
    pub declared: Mounting,
    /// Largest angle between the declared and the measured direction, beyond their uncertainty \[rad\].
    pub tolerance: f64,
    /// Smallest change of gravity that is handed over to the model \[rad\].
    pub step: f64,
    /// Largest rate of change of the served gravity \[rad/s\].
    pub rate: f64,
    pub on_loss: OnSensorLoss,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    Measured,
    Held,
    Declared,
}

impl std::fmt::Display for Source {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Source::Measured => "measured",
            Source::Held => "held",
            Source::Declared => "declared",
        })
    }
}

/// Reason why no torque is served.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// No reading, with `on-loss = "refuse"`.
    #[error("{0}; inclinometer.on-loss = \"refuse\"")]
    Lost(Fault),
    #[error(
        "the inclinometer measures {measured}, {:.2} +- {:.2} deg off the declared {declared} (at most {:.2} deg are allowed)",
        .angle.to_degrees(), .std.to_degrees(), .tolerance.to_degrees()
    )]
    Tilted { declared: Mounting, measured: Mounting, angle: f64, std: f64, tolerance: f64 },
}

/// Standard deviations that are added to a tolerance.
pub const CONFIDENCE_SIGMAS: f64 = 2.0;

/// Gravity to serve, its source, and a refusal if there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Gravity for the model \[m/s2\].
    pub gravity: Vector3<f64>,
    pub source: Source,
    /// Reason why no torque is served.
    pub refusal: Option<Refusal>,
}

/// Rate limiter between measured and served gravity.
#[derive(Clone, Debug)]
pub struct Follower {
    settings: FollowSettings,
    /// Gravity of the served model \[m/s2\].
    served: Vector3<f64>,
    last: Option<Reading>,
    /// Time of the last change, or of the last decision with less than a step to go \[ns\].
    last_change: Option<u64>,
}

impl Follower {
    pub fn new(settings: FollowSettings) -> Follower {
        Follower { settings, served: settings.declared.gravity(), last: None, last_change: None }
    }

    pub fn last(&self) -> Option<&Reading> {
        self.last.as_ref()
    }

    /// Lets the next decision take the measured direction without a rate limit. For use while no torque is served.
    pub fn restart(&mut self) {
        self.last_change = None;
    }

    /// Decision at `now` \[ns\].
    pub fn decide(&mut self, now: u64, health: &Health) -> Decision {
        if let Health::Good(reading) = health {
            self.last = Some(*reading);
        }
        let declared = self.settings.declared.gravity();
        let (target, source) = match (health, self.settings.on_loss, self.last) {
            (Health::Good(reading), _, _) => (reading.attitude.gravity, Source::Measured),
            (Health::Bad(_), OnSensorLoss::Hold | OnSensorLoss::Refuse, Some(last)) => {
                (last.attitude.gravity, Source::Held)
            }
            (Health::Bad(_), _, _) => (declared, Source::Declared),
        };
        let refusal = match (health, self.settings.on_loss) {
            (Health::Bad(fault), OnSensorLoss::Refuse) => Some(Refusal::Lost(*fault)),
            _ => self.tilted(),
        };
        self.approach(now, &target);
        Decision { gravity: self.served, source, refusal }
    }

    /// Compares the last reading with the declared mounting, also after the sensor was lost.
    fn tilted(&self) -> Option<Refusal> {
        let Reading { attitude, .. } = self.last?;
        let FollowSettings { declared, tolerance, .. } = self.settings;
        let (angle, std) = (angle_between(&attitude.gravity, &declared.gravity()), attitude.std());
        let measured = attitude.mounting();
        (angle > tolerance + CONFIDENCE_SIGMAS * std).then_some(Refusal::Tilted {
            declared,
            measured,
            angle,
            std,
            tolerance,
        })
    }

    /// Rotates the served gravity towards `target`, at most at `rate` and in steps of `step` to `2 step`.
    fn approach(&mut self, now: u64, target: &Vector3<f64>) {
        let FollowSettings { step, rate, .. } = self.settings;
        let Some(last_change) = self.last_change else {
            (self.served, self.last_change) = (*target, Some(now));
            return;
        };
        let angle = angle_between(&self.served, target);
        if angle < step {
            // Time at rest does not add to the next step.
            self.last_change = Some(now);
            return;
        }
        let allowed = rate * now.saturating_sub(last_change) as f64 * 1e-9;
        if allowed < step {
            return;
        }
        self.last_change = Some(now);
        // A late call does not make a larger step.
        let angle = angle.min(allowed).min(2.0 * step);
        let axis = self.served.cross(target);
        let axis = if axis.norm() > 1e-9 { axis } else { any_perpendicular(&self.served) };
        self.served = UnitQuaternion::from_axis_angle(&Unit::new_normalize(axis), angle) * self.served;
    }
}

/// Some perpendicular vector, as rotation axis from a direction to its opposite.
fn any_perpendicular(vector: &Vector3<f64>) -> Vector3<f64> {
    vector.cross(&Vector3::ith(vector.iamin(), 1.0))
}
