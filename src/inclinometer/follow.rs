//! Which gravity the model gets, and whether it may be served at all.
//!
//! The measured direction is followed at a bounded rate and in steps that are worth a hand-over; every step makes the served torque
//! step by at most `step` times the arm's gravity torque. Without a reading the configured fall-back decides.

use super::node::Fault;
use super::sensor::{Health, Reading};
use nalgebra::{Unit, UnitQuaternion, Vector3};
use plumbline_model::{Mounting, angle_between};

/// What is served while the inclinometer is not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnLoss {
    /// No torque: the arm is stopped if it moves, and the model is withdrawn until the inclinometer is back.
    #[default]
    Refuse,
    /// The model with the direction measured last; the declared one where there was none.
    Hold,
    /// The model with the declared direction.
    Declared,
}

impl std::fmt::Display for OnLoss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            OnLoss::Refuse => "refuse",
            OnLoss::Hold => "hold",
            OnLoss::Declared => "declared",
        })
    }
}

/// Settings of the following.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowSettings {
    /// The declared mounting.
    pub declared: Mounting,
    /// Largest angle between the declared and the measured direction, beyond their uncertainty \[rad\].
    pub tolerance: f64,
    /// Smallest change that is handed over \[rad\].
    pub step: f64,
    /// Fastest change of the gravity served \[rad/s\].
    pub rate: f64,
    /// What is served without a reading.
    pub on_loss: OnLoss,
}

/// Where the gravity served comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// The inclinometer.
    Measured,
    /// The inclinometer, before it was lost.
    Held,
    /// The configuration.
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

/// Why nothing may be served.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// No reading, and the configuration wants none served then.
    #[error("{0}; inclinometer.on-loss = \"refuse\"")]
    Lost(Fault),
    /// The base is not as declared.
    #[error(
        "the inclinometer says {measured}, {:.2} +- {:.2} deg off the declared {declared} (at most {:.2} deg are allowed)",
        .angle.to_degrees(), .std.to_degrees(), .tolerance.to_degrees()
    )]
    Tilted {
        /// The declared mounting.
        declared: Mounting,
        /// The measured one.
        measured: Mounting,
        /// Angle between them \[rad\].
        angle: f64,
        /// Standard deviation of the measured one \[rad\].
        std: f64,
        /// Largest angle \[rad\].
        tolerance: f64,
    },
}

/// How many standard deviations are allowed for on top of a tolerance.
pub const SPREAD: f64 = 2.0;

/// A decision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Decision {
    /// Gravity for the model \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Where it comes from.
    pub source: Source,
    /// Why nothing may be served.
    pub refusal: Option<Refusal>,
}

/// Follows the inclinometer.
#[derive(Clone, Debug)]
pub struct Follower {
    settings: FollowSettings,
    /// What the model has.
    served: Vector3<f64>,
    last: Option<Reading>,
    /// Time up to which the rate was used \[ns\].
    moved: Option<u64>,
}

impl Follower {
    /// Begins with the declared direction.
    pub fn new(settings: FollowSettings) -> Follower {
        Follower { settings, served: settings.declared.gravity(), last: None, moved: None }
    }

    /// What was measured last.
    pub fn last(&self) -> Option<&Reading> {
        self.last.as_ref()
    }

    /// Nothing is served yet: the next decision may go to the measured direction at once.
    pub fn restart(&mut self) {
        self.moved = None;
    }

    /// What holds at `now` \[ns\].
    pub fn decide(&mut self, now: u64, health: &Health) -> Decision {
        if let Health::Good(reading) = health {
            self.last = Some(*reading);
        }
        let declared = self.settings.declared.gravity();
        let (target, source) = match (health, self.settings.on_loss, self.last) {
            (Health::Good(reading), _, _) => (reading.attitude.gravity, Source::Measured),
            (Health::Bad(_), OnLoss::Hold | OnLoss::Refuse, Some(last)) => (last.attitude.gravity, Source::Held),
            (Health::Bad(_), _, _) => (declared, Source::Declared),
        };
        let refusal = match (health, self.settings.on_loss) {
            (Health::Bad(fault), OnLoss::Refuse) => Some(Refusal::Lost(*fault)),
            _ => self.tilted(),
        };
        self.approach(now, &target);
        Decision { gravity: self.served, source, refusal }
    }

    /// What was measured last must go with the declaration, also after the sensor was lost.
    fn tilted(&self) -> Option<Refusal> {
        let Reading { attitude, .. } = self.last?;
        let FollowSettings { declared, tolerance, .. } = self.settings;
        let (angle, std) = (angle_between(&attitude.gravity, &declared.gravity()), attitude.std());
        let measured = attitude.mounting();
        (angle > tolerance + SPREAD * std).then_some(Refusal::Tilted { declared, measured, angle, std, tolerance })
    }

    /// Turns what is served towards `target`, no faster than the rate and not for less than a step.
    fn approach(&mut self, now: u64, target: &Vector3<f64>) {
        let FollowSettings { step, rate, .. } = self.settings;
        let Some(moved) = self.moved else {
            (self.served, self.moved) = (*target, Some(now));
            return;
        };
        let angle = angle_between(&self.served, target);
        if angle < step {
            // Rest does not save up for a leap.
            self.moved = Some(now);
            return;
        }
        let allowed = rate * now.saturating_sub(moved) as f64 * 1e-9;
        if allowed < step {
            return;
        }
        self.moved = Some(now);
        // A daemon that was busy for long does not leap either.
        let by = angle.min(allowed).min(2.0 * step);
        let about = self.served.cross(target);
        let about = if about.norm() > 1e-9 { about } else { any_across(&self.served) };
        self.served = UnitQuaternion::from_axis_angle(&Unit::new_normalize(about), by) * self.served;
    }
}

/// Some vector at right angles: the way from a direction to its opposite is not determined.
fn any_across(vector: &Vector3<f64>) -> Vector3<f64> {
    vector.cross(&Vector3::ith(vector.iamin(), 1.0))
}
