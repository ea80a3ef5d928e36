//! What the daemon knows of gravity: the declared mounting, the inclinometer, the robot's own sensors, the torques at rest; and what
//! follows for the model: which gravity it gets, and whether it is served at all.

use super::desk::Accepted;
use super::rest::Rests;
use crate::config::job::inclinometer::BaseMotion;
use crate::config::job::{Job, MountingCheck};
use crate::failure::Failure;
use crate::inclinometer::follow::{Decision, FollowSettings, Follower, OnSensorLoss, Source};
use crate::inclinometer::sensor::{Health, Reading, Sensor};
use crate::inclinometer::socket::Listener;
use nalgebra::Vector3;
use plumbline_core::{Phase, Record};
use plumbline_identify::{Implied, Side, cross_check, implied};
use plumbline_ipc::{Gravity as GravityMessage, MotionGravity, now_ns};
use plumbline_model::{Mounting, angle_between};

/// Events that the status keeps, the latest ones.
const EVENTS: usize = 32;
/// What the arm compensates may be off by so much \[m/s2\]: half a degree of gravity, some 0.4 Nm in the Panda's shoulder.
const COMPENSATED: f64 = 0.09;
/// Standard deviations of a reading beyond which a base has moved.
const MOVED: f64 = 4.0;

/// Whether a model may be served, and with which gravity.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// It may.
    Serve(Vector3<f64>),
    /// Nobody can say yet: the arm has to rest first, or the inclinometer to come up.
    Wait(String),
    /// It may not.
    Refuse(String),
}

/// The inclinometer, listened to.
struct Inclinometer {
    listener: Listener,
    follower: Follower,
    on_loss: OnSensorLoss,
    on_motion: BaseMotion,
    still: f64,
    health: Health,
    decision: Decision,
    simulated: bool,
    losses: Losses,
}

/// How often and how long the inclinometer was gone after it had been there.
#[derive(Clone, Copy, Debug, Default)]
struct Losses {
    count: u64,
    /// Since when it is gone \[ns\].
    since: Option<u64>,
    /// How long it was gone before \[ns\].
    before: u64,
}

impl Losses {
    /// Seconds up to `now` \[ns\].
    fn seconds(&self, now: u64) -> f64 {
        let present = self.since.map_or(0, |since| now.saturating_sub(since));
        (self.before + present) as f64 * 1e-9
    }
}

/// The base during a motion.
#[derive(Clone, Copy, Debug)]
struct During {
    motion: u32,
    /// What was measured when it began; the first reading after that where the inclinometer was lost then.
    reading: Option<Reading>,
    moved: bool,
}

impl During {
    /// By how much the base has turned beyond what is `still` and what the sensor does not know \[rad\].
    fn turned(&mut self, reading: Option<Reading>, still: f64) -> Option<f64> {
        let now = reading?;
        let first = *self.reading.get_or_insert(now);
        let by = angle_between(&first.attitude.gravity, &now.attitude.gravity);
        let allowed = still.max(MOVED * first.attitude.std().hypot(now.attitude.std()));
        (by > allowed).then_some(by)
    }
}

/// What the torques said of a model.
#[derive(Clone)]
struct Judged {
    model: u64,
    /// Poses that were there before the model: they may be of an arm that it does not describe.
    after: u64,
    /// Poses that were looked at.
    seen: u64,
    implied: Option<Implied>,
    outcome: Result<(), String>,
    /// The torques have agreed once; what the arm picks up later is no matter of the mounting.
    passed: bool,
    /// The poses up to now told nothing: nothing waits for more of them, and the next one is asked all the same.
    blind: bool,
}

/// What is known of gravity.
pub struct Watch {
    declared: Mounting,
    check: MountingCheck,
    /// Time is simulated: nobody stands beside that arm, and a model is served before its first rest.
    simulated_time: bool,
    inclinometer: Option<Inclinometer>,
    /// What the robot's own accelerometers say.
    robot: Option<Side>,
    /// What the arm's own controller compensates \[m/s2\]; none before the first connection.
    vendor: Option<Vector3<f64>>,
    /// The model's check by the torques of this connection waits for the arm's rest.
    awaits_rest: bool,
    rests: Rests,
    judged: Option<Judged>,
    during: During,
    motions: Vec<MotionGravity>,
    events: Vec<String>,
    forgotten: u64,
    /// What was said last of serving, so that it is said once.
    said: Option<String>,
    /// The model that lacks parameters for the mounting, and which.
    lacking: Option<(u64, String)>,
    served: Vector3<f64>,
    hand_overs: u64,
    /// Largest angle between gravity served and declared \[rad\].
    furthest: f64,
    /// What the flight recorder has not been told yet.
    untold: Vec<String>,
}

impl Watch {
    /// Opens the inclinometer, where the job has one. Call it before the priority of this thread goes up.
    pub fn open(job: &Job) -> Result<Watch, Failure> {
        let inclinometer = job.inclinometer.as_ref().map(|own| {
            let settings = own.sensor(&job.file.display().to_string(), job.mounting)?;
            let sensor = Sensor::new(settings).map_err(Failure::job)?;
            let health = sensor.health();
            let listener = Listener::start(&own.interface, sensor, &settings).map_err(Failure::job)?;
            let follow: FollowSettings = own.follow(job.mounting, &job.mounting_check);
            let mut follower = Follower::new(follow);
            // Nobody has heard it yet: what holds without a reading holds from the start.
            let decision = follower.decide(now_ns(), &health);
            Ok::<_, Failure>(Inclinometer {
                listener,
                follower,
                on_loss: own.on_loss.into(),
                on_motion: own.on_base_motion,
                still: own.still,
                health,
                decision,
                simulated: own.is_simulated(),
                losses: Losses::default(),
            })
        });
        Ok(Watch {
            declared: job.mounting,
            check: job.mounting_check,
            simulated_time: job.backend.is_fast(),
            inclinometer: inclinometer.transpose()?,
            robot: None,
            vendor: None,
            awaits_rest: true,
            rests: Rests::default(),
            judged: None,
            during: During { motion: 0, reading: None, moved: false },
            motions: Vec::new(),
            events: Vec::new(),
            forgotten: 0,
            said: None,
            lacking: None,
            served: job.mounting.gravity(),
            hand_overs: 0,
            furthest: 0.0,
            untold: Vec::new(),
        })
    }

    /// Another connection to the arm, declared to be mounted so; `robot` is what its own accelerometers show, `vendor` what its own
    /// controller compensates. `from_the_start`: a model has to serve from the first cycle on, so the torques of the connection before count.
    pub fn connect(&mut self, declared: Mounting, robot: Option<Side>, vendor: Vector3<f64>, from_the_start: bool) {
        let known = self.judged.as_ref().map(|judged| judged.model);
        let remounted = self.declared != declared;
        (self.declared, self.robot, self.vendor) = (declared, robot, Some(vendor));
        if remounted || !from_the_start {
            self.rests = Rests::default();
            self.awaits_rest = true;
            // A model that was served is asked again, by torques of this connection.
            self.judged = known.map(|model| Judged::new(model, 0));
        }
        self.served = self.inclinometer.as_ref().map_or(declared.gravity(), |own| own.decision.gravity);
    }

    /// Takes in what the loop has recorded; why a motion has to end, where its base has moved.
    pub fn take(&mut self, records: &[Record]) -> Option<String> {
        for record in records {
            self.rests.take(record);
        }
        self.base_motion(records.last()?)
    }

    /// Hears the inclinometer; call it often. While no model is `serving`, nothing has to change slowly.
    pub fn tick(&mut self, now: u64, serving: bool) {
        let Some(own) = &mut self.inclinometer else { return };
        if !serving {
            own.follower.restart();
        }
        let before = std::mem::replace(&mut own.health, own.listener.health(now));
        own.decision = own.follower.decide(now, &own.health);
        match (before, own.health) {
            (Health::Good(_), Health::Bad(fault)) => {
                own.losses.count += 1;
                own.losses.since = Some(now);
                let rule = match own.on_loss {
                    OnSensorLoss::Refuse => "no torque is served",
                    OnSensorLoss::Hold => "the direction measured last holds",
                    OnSensorLoss::Declared => "the declared direction holds",
                };
                let rule = format!("by inclinometer.on-loss = \"{}\", {rule}", own.on_loss);
                self.event(format!("the inclinometer is lost: {fault}; {rule}"));
            }
            (Health::Bad(_), Health::Good(_)) => {
                let Some(since) = own.losses.since.take() else { return };
                let gone = now.saturating_sub(since);
                own.losses.before += gone;
                let back = format!("the inclinometer is back after {:.1} s", gone as f64 * 1e-9);
                tracing::info!("{back}");
                self.keep(back);
            }
            _ => {}
        }
    }

    /// Why nothing may move by the inclinometer's word, if so.
    pub fn refusal(&self) -> Option<String> {
        self.inclinometer.as_ref().and_then(|own| own.decision.refusal).map(|refusal| refusal.to_string())
    }

    /// What was kept as an event since this was asked last.
    pub fn take_untold(&mut self) -> Vec<String> {
        std::mem::take(&mut self.untold)
    }

    /// A base that moves while parameters are measured makes the samples those of no mounting.
    fn base_motion(&mut self, record: &Record) -> Option<String> {
        let own = self.inclinometer.as_ref()?;
        if record.phase != Phase::Excite {
            self.during.motion = 0;
            return None;
        }
        let reading = match own.health {
            Health::Good(reading) => Some(reading),
            Health::Bad(_) => None,
        };
        if self.during.motion != record.motion {
            self.during = During { motion: record.motion, reading, moved: false };
            if let Some(Reading { attitude, .. }) = reading {
                let Mounting { rho, phi } = attitude.mounting();
                self.motions.push(MotionGravity { motion: record.motion, rho, phi, std: attitude.std() });
            }
        }
        if self.during.moved {
            return None;
        }
        if let Some(refusal) = own.decision.refusal {
            self.during.moved = true;
            self.event(format!("the arm stops in motion {}: {refusal}", record.motion));
            return Some(refusal.to_string());
        }
        let by = self.during.turned(reading, own.still)?;
        // Said once per motion.
        self.during.moved = true;
        let stop = own.on_motion == BaseMotion::Stop;
        let rule = if stop { "the arm stops" } else { "the motion goes on" };
        let event = format!(
            "base-motion: the base has turned by {:.2} deg during motion {}; by inclinometer.on-base-motion, {rule}",
            by.to_degrees(),
            record.motion
        );
        self.event(event.clone());
        stop.then_some(event)
    }

    fn event(&mut self, event: String) {
        tracing::error!("{event}");
        self.keep(event);
    }

    fn keep(&mut self, event: String) {
        if self.events.len() >= EVENTS {
            self.events.remove(0);
            self.forgotten += 1;
        }
        self.untold.push(event.clone());
        self.events.push(event);
    }

    /// Gravity by which a model is evaluated now.
    fn gravity(&self) -> Vector3<f64> {
        self.inclinometer.as_ref().map_or(self.declared.gravity(), |own| own.decision.gravity)
    }

    /// What was measured last, unless the declared direction has taken its place.
    fn measured(&self) -> Option<Vector3<f64>> {
        let own = self.inclinometer.as_ref().filter(|own| own.decision.source != Source::Declared)?;
        own.follower.last().map(|reading| reading.attitude.gravity)
    }

    /// Whether `model` may be served.
    pub fn verdict(&mut self, model: &Accepted) -> Verdict {
        let verdict = self.decide(model);
        self.awaits_rest = matches!(verdict, Verdict::Wait(_));
        let words = match &verdict {
            Verdict::Serve(gravity) => {
                if self.served != *gravity {
                    self.hand_overs += 1;
                }
                self.served = *gravity;
                self.furthest = self.furthest.max(angle_between(gravity, &self.declared.gravity()));
                None
            }
            Verdict::Wait(why) => Some(format!("model {:016x} is not served yet: {why}", model.id)),
            Verdict::Refuse(why) => Some(format!("model {:016x} is not served: {why}", model.id)),
        };
        // Numbers in the words change with every rest: what is said again is another kind of refusal.
        let kind = |words: &Option<String>| {
            words.as_ref().map(|words| words.chars().filter(|c| c.is_alphabetic()).collect::<String>())
        };
        if kind(&words) != kind(&self.said) {
            match (&words, &verdict) {
                (Some(words), Verdict::Wait(_)) => tracing::info!("{words}"),
                (Some(words), _) => {
                    let words = words.clone();
                    self.event(words);
                }
                (None, _) => {
                    tracing::info!("model {:016x} is served again: nothing speaks against it any more", model.id)
                }
            }
        }
        self.said = words;
        verdict
    }

    fn decide(&mut self, model: &Accepted) -> Verdict {
        let gravity = self.gravity();
        // What is measured decides here, not what was declared: a vertical model holds within one degree. What is served may still be on its
        // way there, and the model has to hold for that, too.
        let acting = [self.measured().unwrap_or(gravity), gravity].into_iter();
        // What the arm's own controller adds has to be known, too.
        let mountings: Vec<Mounting> = acting.chain(self.vendor).map(|gravity| Mounting::along(&gravity)).collect();
        if let Some(refusal) = self.lacks(model, &mountings) {
            return Verdict::Refuse(refusal);
        }
        if let Some(Inclinometer { decision: Decision { refusal: Some(refusal), .. }, .. }) = &self.inclinometer {
            return Verdict::Refuse(refusal.to_string());
        }
        match self.examine(model) {
            Err(why) => Verdict::Refuse(why),
            Ok(()) if self.must_rest_first() => {
                Verdict::Wait("the arm has to rest for a moment first, so that its torques tell the mounting".into())
            }
            Ok(()) => Verdict::Serve(gravity),
        }
    }

    /// What `model` lacks for one of the `mountings`. Asked in every turn of a real-time thread, and the words take milliseconds to find: they
    /// are those of the first such mounting.
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

    /// Whether the torques are still to be asked, of an arm that somebody may stand beside.
    fn must_rest_first(&self) -> bool {
        // A model that follows another one in mid-motion has to wait for no rest: the mounting was checked with the first one.
        let asked = self.judged.as_ref().is_some_and(|judged| judged.passed || judged.blind || judged.after > 0);
        self.check.torques && !self.simulated_time && !asked
    }

    /// Whether every side that there is goes with `model`, which was offered; one that does not leaves no trace.
    ///
    /// # Errors
    /// Who disagrees, and by how much.
    pub fn try_out(&mut self, model: &Accepted) -> Result<(), String> {
        let before = self.judged.clone();
        self.examine(model).inspect_err(|_| self.judged = before)
    }

    /// Holds every side that there is against every other.
    fn examine(&mut self, model: &Accepted) -> Result<(), String> {
        let implied = self.ask_torques(model)?;
        let mut sides = vec![Side::declared(&self.declared)];
        if let Some(Reading { attitude, .. }) = self.inclinometer.as_ref().and_then(|own| own.follower.last()) {
            sides.push(Side { name: "the inclinometer", gravity: attitude.gravity, std: attitude.std() });
        }
        sides.extend(self.robot);
        sides.extend(implied);
        let outcome = cross_check(&sides, self.check.tolerance).map(|_| ()).map_err(|off| off.to_string());
        if let Some(judged) = &mut self.judged {
            if implied.is_some() && outcome.is_ok() {
                judged.passed = true;
            }
            judged.outcome = outcome.clone();
        }
        outcome
    }

    /// What the torques at rest imply, once per model and until they have agreed.
    fn ask_torques(&mut self, model: &Accepted) -> Result<Option<Side>, String> {
        if !self.check.torques {
            return Ok(None);
        }
        let completed = self.rests.completed();
        let after = self.judged.as_ref().map_or(0, |judged| if judged.passed { completed } else { judged.after });
        if self.judged.as_ref().is_none_or(|judged| judged.model != model.id) {
            self.judged = Some(Judged::new(model.id, after));
        }
        let Some(judged) = &mut self.judged else { return Ok(None) };
        if judged.passed || judged.seen == completed {
            return judged.answer();
        }
        judged.seen = completed;
        let poses = self.rests.since(judged.after);
        if poses.is_empty() {
            return Ok(None);
        }
        match implied(&model.model, &poses, &model.noise) {
            Ok(Ok(found)) => {
                if let Some(remark) = found.remark() {
                    tracing::warn!("{remark}");
                }
                judged.implied = Some(found);
                judged.outcome = Ok(());
            }
            Ok(Err(wrong)) => (judged.implied, judged.outcome) = (None, Err(wrong.to_string())),
            Err(blind) => {
                if !judged.blind {
                    tracing::warn!("{blind}; the mounting is checked without them until another pose tells more");
                }
                // Nothing more will come of this pose: the others decide.
                (judged.implied, judged.outcome, judged.blind) = (None, Ok(()), true);
            }
        }
        judged.answer()
    }

    /// Mounting and what is known of it at `now` \[ns\], for the status.
    pub fn message(&self, now: u64) -> GravityMessage {
        let sensor = self.inclinometer.as_ref();
        let reading = sensor.and_then(|own| own.follower.last());
        let angles = |gravity: &Vector3<f64>| {
            let Mounting { rho, phi } = Mounting::along(gravity);
            [rho, phi]
        };
        GravityMessage {
            source: sensor.map_or(Source::Declared, |own| own.decision.source).to_string(),
            inclinometer: sensor.map(|own| match own.health {
                Health::Good(Reading { still: true, .. }) => "good, at rest".into(),
                Health::Good(_) => "good, moving".into(),
                Health::Bad(fault) => fault.to_string(),
            }),
            measured: reading.map(|reading| angles(&reading.attitude.gravity)),
            std: reading.map(|reading| reading.attitude.std_of_angles()),
            uncertainty: reading.map(|reading| reading.attitude.std()),
            robot: self.robot.map(|side| angles(&side.gravity)),
            torques: self
                .judged
                .as_ref()
                .and_then(|judged| judged.implied.as_ref())
                .map(|implied| angles(&implied.side.gravity)),
            vendor: self.vendor.map(Into::into),
            refused: self.said.clone(),
            events: self.events.clone(),
            forgotten: self.forgotten,
            motions: self.motions.clone(),
            simulated: sensor.is_some_and(|own| own.simulated),
            on_loss: sensor.map(|own| own.on_loss.to_string()),
            losses: sensor.map_or(0, |own| own.losses.count),
            lost_s: sensor.map_or(0.0, |own| own.losses.seconds(now)),
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

    /// Why the model is not served, in words.
    pub fn said(&self) -> Option<&str> {
        self.said.as_deref()
    }

    /// Gravity that the model has now \[m/s2\].
    pub fn served(&self) -> Vector3<f64> {
        self.served
    }
}

/// Whether an arm on which `gravity` acts, and whose own controller compensates `vendor`, would fall under torque control without a model.
pub fn uncompensated(gravity: &Vector3<f64>, vendor: &Vector3<f64>) -> bool {
    (gravity - vendor).norm() > COMPENSATED
}

impl Judged {
    fn new(model: u64, after: u64) -> Judged {
        Judged { model, after, seen: 0, implied: None, outcome: Ok(()), passed: false, blind: false }
    }

    /// The side that the torques take, or why they can't be right.
    fn answer(&self) -> Result<Option<Side>, String> {
        match (&self.implied, &self.outcome) {
            // A wrong sign is no direction.
            (None, Err(wrong)) => Err(wrong.clone()),
            (found, _) => Ok(found.as_ref().map(|found| found.side)),
        }
    }
}

#[cfg(test)]
mod tests;
