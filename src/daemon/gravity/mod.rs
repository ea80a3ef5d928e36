//! Gravity on the arm by every source: the declared mounting, the inclinometer, the robot's own sensors, the torques at rest. Decides with which
//! gravity a model is served, and whether it is served at all.
//!
//! Decisions are values. [`GravityMonitor::decide`] makes one, [`GravityMonitor::apply`] takes it over and returns what is to be reported; the caller logs
//! and acts.

mod base_motion;
mod inclinometer;
mod torque_check;

pub use inclinometer::HealthChange;
pub use torque_check::Remark;

use super::models::Accepted;
use super::rest_poses::RestPoses;
use crate::config::job::inclinometer::BaseMotion as BaseMotionRule;
use crate::config::job::{Job, MountingCheck};
use crate::failure::Failure;
use crate::inclinometer::follow;
use crate::inclinometer::sensor::Reading;
use base_motion::BaseMotion;
use inclinometer::Inclinometer;
use nalgebra::Vector3;
use plumbline_core::{Phase, Record};
use plumbline_identify::{Disagreement, GravitySource, cross_check};
use plumbline_ipc::{Gravity as GravityMessage, MotionGravity};
use plumbline_model::{Mounting, angle_between};
use torque_check::TorqueCheck;

/// Events that the status keeps, the latest ones.
const MAX_EVENTS: usize = 32;
/// Largest difference between the gravity that acts and the one that the arm compensates \[m/s2\]: half a degree of gravity, some 0.4 Nm in the
/// Panda's shoulder.
const MAX_UNCOMPENSATED: f64 = 0.09;

/// Whether a model may be served, and with which gravity.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    Serve(Vector3<f64>),
    /// Not yet: the arm has to rest first, so that its torques show the mounting.
    Wait,
    Refuse(Refusal),
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    #[error("{0}")]
    Parameters(String),
    /// The inclinometer is lost, or the base is not mounted as declared.
    #[error(transparent)]
    Inclinometer(#[from] follow::Refusal),
    #[error(transparent)]
    Mounting(#[from] Disagreement),
}

impl Refusal {
    /// Whether both are reported as one. Angles change with every rest: another refusal has another kind, other sides or another joint.
    fn is_like(&self, other: &Refusal) -> bool {
        use Disagreement::{Off, Unclear, WrongSign};
        use std::mem::discriminant;
        macro_rules! sides {
            ($pairs:expr) => {
                $pairs.iter().map(|pair| (pair.first.name, pair.second.name))
            };
        }
        match (self, other) {
            (Refusal::Parameters(one), Refusal::Parameters(other)) => one == other,
            (
                Refusal::Inclinometer(follow::Refusal::Lost(one)),
                Refusal::Inclinometer(follow::Refusal::Lost(other)),
            ) => discriminant(one) == discriminant(other),
            (Refusal::Inclinometer(one), Refusal::Inclinometer(other)) => discriminant(one) == discriminant(other),
            (Refusal::Mounting(one), Refusal::Mounting(other)) => match (one, other) {
                (Off { side, pairs, .. }, Off { side: other_side, pairs: other_pairs, .. }) => {
                    side.name == other_side.name && sides!(pairs).eq(sides!(other_pairs))
                }
                (Unclear { pairs, .. }, Unclear { pairs: other_pairs, .. }) => sides!(pairs).eq(sides!(other_pairs)),
                (WrongSign { joint }, WrongSign { joint: other_joint }) => joint == other_joint,
                _ => false,
            },
            _ => false,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub struct Decision {
    pub model: u64,
    pub verdict: Verdict,
    /// Something else that the torques at rest have shown.
    pub remark: Option<Remark>,
}

/// A change of what is served that is to be reported.
#[derive(Clone, Debug, PartialEq)]
pub enum ServiceChange {
    /// The model waits for a rest of the arm.
    Waits(String),
    Refused(String),
    ServedAgain {
        model: u64,
    },
}

/// What ends a motion, or is reported during it.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseMoved {
    pub event: String,
    /// Why the arm stops, where it does.
    pub stop: Option<String>,
}

/// Gravity by every source, and the checks between them.
pub struct GravityMonitor {
    declared: Mounting,
    check: MountingCheck,
    /// A model is served before the first rest of the arm: time is simulated, or another program moves the arm, which may never rest.
    needs_no_rest: bool,
    inclinometer: Option<Inclinometer>,
    /// Gravity by the robot's own accelerometers.
    robot: Option<GravitySource>,
    /// Gravity that the arm's own controller compensates \[m/s2\]; none before the first connection.
    vendor: Option<Vector3<f64>>,
    rests: RestPoses,
    torques: Option<TorqueCheck>,
    base: BaseMotion,
    motions: Vec<MotionGravity>,
    events: Vec<String>,
    dropped_events: u64,
    /// The model that is not served and its verdict, by the last decision; `None` where the last one served.
    unserved: Option<(u64, Verdict)>,
    /// The model's check by the torques of this connection waits for the arm's rest.
    awaits_rest: bool,
    /// The model that lacks parameters for the mounting, and which.
    lacking: Option<(u64, String)>,
    served: Vector3<f64>,
    hand_overs: u64,
    /// Largest angle between gravity served and declared \[rad\].
    furthest: f64,
}

impl GravityMonitor {
    /// Opens the inclinometer, where the job has one. Call it before the priority of this thread goes up.
    pub fn open(job: &Job) -> Result<GravityMonitor, Failure> {
        Ok(GravityMonitor {
            declared: job.mounting,
            check: job.mounting_check,
            needs_no_rest: !job.backend.needs_realtime(),
            inclinometer: Inclinometer::open(job)?,
            robot: None,
            vendor: None,
            rests: RestPoses::default(),
            torques: None,
            base: BaseMotion::default(),
            motions: Vec::new(),
            events: Vec::new(),
            dropped_events: 0,
            unserved: None,
            awaits_rest: true,
            lacking: None,
            served: job.mounting.gravity(),
            hand_overs: 0,
            furthest: 0.0,
        })
    }

    /// Another connection to the arm, declared to be mounted so. `robot` is gravity by its own accelerometers, `vendor` the one that its own
    /// controller compensates. `from_the_start`: a model has to serve from the first cycle on, so the torques of the connection before count.
    pub fn connect(
        &mut self,
        declared: Mounting,
        robot: Option<GravitySource>,
        vendor: Vector3<f64>,
        from_the_start: bool,
    ) {
        let remounted = self.declared != declared;
        (self.declared, self.robot, self.vendor) = (declared, robot, Some(vendor));
        if remounted || !from_the_start {
            self.rests = RestPoses::default();
            self.awaits_rest = true;
            // A model that was served is checked again, by torques of this connection.
            self.torques = self.torques.as_ref().map(|check| TorqueCheck::new(check.model, 0));
        }
        self.served = self.gravity();
    }

    pub fn take(&mut self, records: &[Record]) -> Option<BaseMoved> {
        for record in records {
            self.rests.take(record);
        }
        self.check_base(records.last()?)
    }

    /// Reads the inclinometer at `now` \[ns\]; call it often. While no model is `serving`, the gravity served need not change slowly.
    pub fn poll(&mut self, now: u64, serving: bool) -> Option<HealthChange> {
        self.inclinometer.as_mut()?.poll(now, serving)
    }

    pub fn keep(&mut self, event: String) {
        if self.events.len() >= MAX_EVENTS {
            self.events.remove(0);
            self.dropped_events += 1;
        }
        self.events.push(event);
    }

    /// Why nothing may move by the inclinometer.
    pub fn refusal(&self) -> Option<follow::Refusal> {
        self.inclinometer.as_ref()?.decision.refusal
    }

    /// A base that turns while parameters are measured makes the samples those of no mounting.
    fn check_base(&mut self, record: &Record) -> Option<BaseMoved> {
        let own = self.inclinometer.as_ref()?;
        if record.phase != Phase::Excite {
            self.base.motion = 0;
            return None;
        }
        let reading = own.reading();
        if self.base.motion != record.motion {
            self.base = BaseMotion { motion: record.motion, reading, reported: false };
            if let Some(Reading { attitude, .. }) = reading {
                let Mounting { rho, phi } = attitude.mounting();
                self.motions.push(MotionGravity { motion: record.motion, rho, phi, std: attitude.std() });
            }
        }
        if self.base.reported {
            return None;
        }
        if let Some(refusal) = own.decision.refusal {
            self.base.reported = true;
            let event = format!("the arm stops in motion {}: {refusal}", record.motion);
            return Some(BaseMoved { event, stop: Some(refusal.to_string()) });
        }
        let by = self.base.turned(reading, own.still)?;
        self.base.reported = true;
        let stop = own.on_motion == BaseMotionRule::Stop;
        let rule = if stop { "the arm stops" } else { "the motion goes on" };
        let event = format!(
            "base-motion: the base has turned by {:.2} deg during motion {}; by inclinometer.on-base-motion, {rule}",
            by.to_degrees(),
            record.motion
        );
        Some(BaseMoved { stop: stop.then(|| event.clone()), event })
    }

    /// Gravity by which a model is evaluated now \[m/s2\].
    fn gravity(&self) -> Vector3<f64> {
        self.inclinometer.as_ref().map_or(self.declared.gravity(), |own| own.decision.gravity)
    }

    /// Whether `model` may be served now. Changes nothing but what has been computed of the model so far.
    pub fn decide(&mut self, model: &Accepted) -> Decision {
        let of = |verdict, remark| Decision { model: model.id, verdict, remark };
        let gravity = self.gravity();
        // A model has to hold under the gravity measured, under the one served, which may still be on its way there, and under the one that the
        // arm's own controller compensates.
        let measured = self.inclinometer.as_ref().and_then(Inclinometer::measured);
        let acting = [measured.unwrap_or(gravity), gravity].into_iter();
        let mountings: Vec<Mounting> = acting.chain(self.vendor).map(|gravity| Mounting::along(&gravity)).collect();
        if let Some(lacks) = self.lacks(model, &mountings) {
            return of(Verdict::Refuse(Refusal::Parameters(lacks)), None);
        }
        if let Some(refusal) = self.refusal() {
            return of(Verdict::Refuse(refusal.into()), None);
        }
        let remark = self.update_torques(model);
        let verdict = match self.cross_check() {
            Err(off) => Verdict::Refuse(off.into()),
            Ok(()) if self.must_rest_first() => Verdict::Wait,
            Ok(()) => Verdict::Serve(gravity),
        };
        of(verdict, remark)
    }

    /// Takes over a decision; what changes with it.
    pub fn apply(&mut self, decision: &Decision) -> Option<ServiceChange> {
        let Decision { model, verdict, .. } = decision;
        self.awaits_rest = *verdict == Verdict::Wait;
        if let Verdict::Serve(gravity) = verdict {
            self.hand_overs += u64::from(self.served != *gravity);
            self.served = *gravity;
            self.furthest = self.furthest.max(angle_between(gravity, &self.declared.gravity()));
        }
        let now = (!matches!(verdict, Verdict::Serve(_))).then(|| (*model, verdict.clone()));
        let before = std::mem::replace(&mut self.unserved, now);
        let is_same = match (&before, &self.unserved) {
            (None, None) => true,
            (Some((model, Verdict::Refuse(before))), Some((other, Verdict::Refuse(now)))) => {
                model == other && before.is_like(now)
            }
            (before, now) => before == now,
        };
        if is_same {
            return None;
        }
        let words = self.refused();
        Some(match (verdict, words) {
            (Verdict::Wait, Some(words)) => ServiceChange::Waits(words),
            (_, Some(words)) => ServiceChange::Refused(words),
            (_, None) => ServiceChange::ServedAgain { model: *model },
        })
    }

    /// Why the model is not served, by the last decision.
    pub fn refused(&self) -> Option<String> {
        match self.unserved.as_ref()? {
            (_, Verdict::Serve(_)) => None,
            (model, Verdict::Wait) => Some(format!(
                "model {model:016x} is not served yet: the arm has to rest for a moment first, so that its torques tell the mounting"
            )),
            (model, Verdict::Refuse(why)) => Some(format!("model {model:016x} is not served: {why}")),
        }
    }

    /// Parameters that `model` lacks for one of the `mountings`. Called in every turn of a real-time thread, and finding them takes milliseconds: they
    /// are those of the first such mounting, computed once per model.
    fn lacks(&mut self, model: &Accepted, mountings: &[Mounting]) -> Option<String> {
        let Some(mounting) = mountings.iter().find(|mounting| !model.model.holds_in(mounting)) else {
            self.lacking = None;
            return None;
        };
        if self.lacking.as_ref().is_none_or(|(id, _)| *id != model.id) {
            self.lacking = model.model.valid_in(mounting).err().map(|refused| (model.id, refused.to_string()));
        }
        self.lacking.as_ref().map(|(_, words)| words.clone())
    }

    /// Whether the torques are still to be compared, of an arm that people may stand beside. A model that follows another one in mid-motion waits for
    /// no rest: the mounting was checked with the first one.
    fn must_rest_first(&self) -> bool {
        let settled = self.torques.as_ref().is_some_and(TorqueCheck::is_settled);
        self.check.torques && !self.needs_no_rest && !settled
    }

    /// Whether every side agrees with `model`, which was offered. One that does not leaves no trace.
    /// Errors: which side is off, and by how much.
    pub fn try_out(&mut self, model: &Accepted) -> Result<Option<Remark>, Disagreement> {
        let before = self.torques.clone();
        let remark = self.update_torques(model);
        self.cross_check().inspect_err(|_| self.torques = before).map(|()| remark)
    }

    /// Evaluates the torques at rest under `model`, until they have agreed.
    fn update_torques(&mut self, model: &Accepted) -> Option<Remark> {
        if !self.check.torques {
            return None;
        }
        let check = match self.torques.take() {
            Some(check) if check.model == model.id => check,
            Some(other) => other.followed_by(model.id, &self.rests),
            None => TorqueCheck::new(model.id, 0),
        };
        self.torques.insert(check).update(model, &self.rests)
    }

    fn cross_check(&mut self) -> Result<(), Disagreement> {
        let torques = self.torques.as_ref().map_or(Ok(None), TorqueCheck::side)?;
        let mut sides = vec![GravitySource::declared(&self.declared)];
        if let Some(Reading { attitude, .. }) = self.inclinometer.as_ref().and_then(Inclinometer::last) {
            sides.push(GravitySource { name: "the inclinometer", gravity: attitude.gravity, std: attitude.std() });
        }
        sides.extend(self.robot);
        sides.extend(torques);
        cross_check(&sides, self.check.tolerance)?;
        self.torques.iter_mut().for_each(TorqueCheck::agreed);
        Ok(())
    }

    /// The mounting by every source at `now` \[ns\], for the status.
    pub fn message(&self, now: u64) -> GravityMessage {
        let sensor = self.inclinometer.as_ref();
        let reading = sensor.and_then(Inclinometer::last);
        let angles = |gravity: &Vector3<f64>| {
            let Mounting { rho, phi } = Mounting::along(gravity);
            [rho, phi]
        };
        let torques = self.torques.as_ref().and_then(|check| check.side().ok().flatten());
        GravityMessage {
            source: sensor.map_or(follow::Source::Declared, |own| own.decision.source).to_string(),
            inclinometer: sensor.map(Inclinometer::health),
            measured: reading.map(|reading| angles(&reading.attitude.gravity)),
            std: reading.map(|reading| reading.attitude.std_of_angles()),
            uncertainty: reading.map(|reading| reading.attitude.std()),
            robot: self.robot.map(|side| angles(&side.gravity)),
            torques: torques.map(|side| angles(&side.gravity)),
            vendor: self.vendor.map(Into::into),
            refused: self.refused(),
            events: self.events.clone(),
            forgotten: self.dropped_events,
            motions: self.motions.clone(),
            simulated: sensor.is_some_and(|own| own.simulated),
            on_loss: sensor.map(|own| own.on_loss.to_string()),
            losses: sensor.map_or(0, |own| own.losses),
            lost_s: sensor.map_or(0.0, |own| own.lost_seconds(now)),
            hand_overs: self.hand_overs,
            furthest: self.furthest,
        }
    }

    /// Whether the arm is [`uncompensated`]; `None` before the first connection.
    pub fn uncompensated(&self) -> Option<bool> {
        self.vendor.map(|vendor| uncompensated(&self.declared.gravity(), &vendor))
    }

    /// Whether a model is still to be checked by the torques of an arm at rest.
    pub fn awaits_rest(&self) -> bool {
        self.awaits_rest
    }

    /// Gravity that the model has now \[m/s2\].
    pub fn served(&self) -> Vector3<f64> {
        self.served
    }
}

/// Whether an arm on which `gravity` acts, and whose own controller compensates `vendor`, would fall under torque control without a model.
pub fn uncompensated(gravity: &Vector3<f64>, vendor: &Vector3<f64>) -> bool {
    (gravity - vendor).norm() > MAX_UNCOMPENSATED
}

#[cfg(test)]
mod tests;
