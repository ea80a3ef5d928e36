//! The inclinometer of the base, as the gravity monitor uses it.

use crate::config::job::Job;
use crate::config::job::inclinometer::BaseMotion;
use crate::failure::Failure;
use crate::inclinometer::follow::{Decision, Follower, OnSensorLoss, Source};
use crate::inclinometer::sensor::{Health, Reading, Sensor};
use crate::inclinometer::socket::Listener;
use nalgebra::Vector3;
use plumbline_ipc::now_ns;

pub struct Inclinometer {
    listener: Listener,
    follower: Follower,
    pub on_loss: OnSensorLoss,
    /// What a motion does when the base turns during it.
    pub on_motion: BaseMotion,
    /// Smallest turn of the base that counts \[rad\].
    pub still: f64,
    health: Health,
    /// What follows from the readings up to now.
    pub decision: Decision,
    pub simulated: bool,
    pub losses: u64,
    lost_since: Option<u64>,
    lost_before: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub enum HealthChange {
    /// It is lost; why, and what is served from now on.
    Lost(String),
    Back {
        /// Duration of the loss \[s\].
        after: f64,
    },
}

impl std::fmt::Display for HealthChange {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            HealthChange::Lost(why) => write!(f, "the inclinometer is lost: {why}"),
            HealthChange::Back { after } => write!(f, "the inclinometer is back after {after:.1} s"),
        }
    }
}

impl Inclinometer {
    /// Opens the inclinometer of the job, where it has one. Call it before the priority of this thread goes up.
    pub fn open(job: &Job) -> Result<Option<Inclinometer>, Failure> {
        let Some(own) = &job.inclinometer else { return Ok(None) };
        let settings = own.sensor(&job.file.display().to_string(), job.mounting)?;
        let sensor = Sensor::new(settings).map_err(Failure::job)?;
        let health = sensor.health();
        let listener = Listener::start(&own.interface, sensor, &settings).map_err(Failure::job)?;
        let mut follower = Follower::new(own.follow(job.mounting, &job.mounting_check));
        // Before the first reading the rule for a lost inclinometer holds.
        let decision = follower.decide(now_ns(), &health);
        Ok(Some(Inclinometer {
            listener,
            follower,
            on_loss: own.on_loss,
            on_motion: own.on_base_motion,
            still: own.still,
            health,
            decision,
            simulated: own.is_simulated(),
            losses: 0,
            lost_since: None,
            lost_before: 0,
        }))
    }

    /// Reads the sensor at `now` \[ns\]. While no model is `serving`, the gravity served need not change slowly.
    pub fn poll(&mut self, now: u64, serving: bool) -> Option<HealthChange> {
        if !serving {
            self.follower.restart();
        }
        let before = std::mem::replace(&mut self.health, self.listener.health(now));
        self.decision = self.follower.decide(now, &self.health);
        match (before, self.health) {
            (Health::Good(_), Health::Bad(fault)) => {
                self.losses += 1;
                self.lost_since = Some(now);
                let rule = match self.on_loss {
                    OnSensorLoss::Refuse => "no torque is served",
                    OnSensorLoss::Hold => "the direction measured last holds",
                    OnSensorLoss::Declared => "the declared direction holds",
                };
                Some(HealthChange::Lost(format!("{fault}; by inclinometer.on-loss = \"{}\", {rule}", self.on_loss)))
            }
            (Health::Bad(_), Health::Good(_)) => {
                let lost_ns = now.saturating_sub(self.lost_since.take()?);
                self.lost_before += lost_ns;
                Some(HealthChange::Back { after: lost_ns as f64 * 1e-9 })
            }
            _ => None,
        }
    }

    pub fn reading(&self) -> Option<Reading> {
        match self.health {
            Health::Good(reading) => Some(reading),
            Health::Bad(_) => None,
        }
    }

    /// The last reading, however old.
    pub fn last(&self) -> Option<&Reading> {
        self.follower.last()
    }

    /// Gravity measured last, unless the declared direction has taken its place \[m/s2\].
    pub fn measured(&self) -> Option<Vector3<f64>> {
        let last = self.last().filter(|_| self.decision.source != Source::Declared)?;
        Some(last.attitude.gravity)
    }

    pub fn health(&self) -> String {
        match self.health {
            Health::Good(Reading { still: true, .. }) => "good, at rest".into(),
            Health::Good(_) => "good, moving".into(),
            Health::Bad(fault) => fault.to_string(),
        }
    }

    /// Total duration of its losses up to `now` \[ns\], in seconds.
    pub fn lost_seconds(&self, now: u64) -> f64 {
        let present = self.lost_since.map_or(0, |since| now.saturating_sub(since));
        (self.lost_before + present) as f64 * 1e-9
    }
}
