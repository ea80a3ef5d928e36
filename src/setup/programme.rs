//! What a job drives, in order. The daemon and the estimator derive the same programme from the same files.

use crate::config::job::{Guest, Job};
use crate::failure::Failure;
use crate::process::progress;
use crate::setup::planner::Planner;
use crate::store::{load_plan, save_plan};
use plumbline_core::{ArmLimits, BadInput, JointVec, Limits, PERIOD_S, Setpoint, from_toml};
use plumbline_excite::{Bounds, Fourier, Peak, Plan, Quantity, check_points_with_guard, check_pose};
use plumbline_model::{Mounting, Robot, VERTICAL_TOLERANCE};
use plumbline_rt::MoveFactors;
use std::path::Path;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Identify,
    Validate,
    /// The model is watched along it, and nothing else.
    Live,
    /// The counter-experiment: the vertical base set is identified from it, to show where that set fails.
    Counter,
}

#[derive(Clone, Debug)]
pub struct Motion {
    /// Number in orders and records, from 1.
    pub number: u32,
    /// Name for people and files: `identify-wall`, `validate-upright-3`.
    pub name: String,
    pub role: Role,
    /// How the arm is mounted meanwhile.
    pub mounting: Mounting,
    pub course: Course,
}

/// How the arm moves.
#[derive(Clone, Debug)]
pub enum Course {
    Planned(Box<Planned>),
    /// As the program that controls the arm wants; the motion is recorded for this long.
    Unplanned {
        /// Samples.
        ticks: usize,
        /// Time between two of them \[s\].
        period: f64,
    },
}

/// A periodic motion that the arm is driven along.
#[derive(Clone, Debug)]
pub struct Planned {
    pub plan: Plan,
    pub fourier: Fourier,
    pub periods: usize,
    pub lead_in: usize,
}

impl Planned {
    /// Samples of one period, at 1 kHz.
    pub fn period_ticks(&self) -> usize {
        (self.plan.period * 1000.0).round() as usize
    }
}

impl Motion {
    /// The motion that the arm is driven along, where it is driven.
    pub fn planned(&self) -> Option<&Planned> {
        match &self.course {
            Course::Planned(planned) => Some(planned),
            Course::Unplanned { .. } => None,
        }
    }

    /// Samples of the whole motion, lead-in included.
    pub fn ticks(&self) -> usize {
        match &self.course {
            Course::Planned(planned) => planned.period_ticks() * (planned.periods + planned.lead_in),
            Course::Unplanned { ticks, .. } => *ticks,
        }
    }

    /// Time between two samples \[s\].
    pub fn sample_period(&self) -> f64 {
        match self.course {
            Course::Planned(_) => PERIOD_S,
            Course::Unplanned { period, .. } => period,
        }
    }
}

#[derive(Clone, Debug)]
pub struct Stage {
    pub mounting: Mounting,
    /// The motions, in order.
    pub motions: Vec<Motion>,
}

/// All stages, in order.
#[derive(Clone, Debug)]
pub struct Programme {
    pub stages: Vec<Stage>,
}

struct Slot {
    name: String,
    role: Role,
    /// Whether its motion is searched for; the others are random.
    first: bool,
    mounting: Mounting,
    seed: u64,
}

impl Programme {
    /// Plans every motion; `progress` is called with the name of the motion and the share done.
    pub fn plan(planner: &Planner, progress: &(dyn Fn(&str, f64) + Sync)) -> Result<Programme, Failure> {
        let job = planner.job;
        let slots = slots(job);
        // Random motions take no time against those that are searched for.
        let all = slots.iter().filter(|slot| slot.first).count().max(1) as f64;
        let mut done = 0.0;
        let mut ways = Ways::new(planner)?;
        let programme = fill(job, slots, |slot| {
            let given = job.excitation.plan.is_some() && slot.role == Role::Identify && slot.first;
            let attempts = if given { 1 } else { ATTEMPTS };
            let mut broken = None;
            for attempt in 0..attempts {
                let seed = slot.seed + attempt * SEED_STEP;
                let report = |share: f64| progress(&slot.name, (done + share) / all);
                report(0.0);
                let plan = if slot.first {
                    planner.best(&slot.mounting, seed, &report)?
                } else {
                    planner.random(&slot.mounting, seed)?
                };
                match ways.go(&slot.mounting, &plan.q0) {
                    Ok(()) => {
                        done += f64::from(u8::from(slot.first));
                        return Ok(plan);
                    }
                    Err(peak) => broken = Some(peak),
                }
            }
            Err(way_blocked(job, &slot.name, broken, attempts))
        })?;
        programme.check_excitation(planner)?;
        Ok(programme)
    }

    /// The runs of an arm that another program controls: those to identify from, then those that validate.
    fn listened(job: &Job, guest: &Guest) -> Programme {
        let place = slug(&job.mounting.to_string());
        let mut motions = Vec::new();
        for (role, stem, seconds) in
            [(Role::Identify, "identify", guest.identify), (Role::Validate, "validate", guest.validate)]
        {
            let (count, ticks) = guest.runs(seconds);
            for k in 1..=count {
                let (number, name) = (motions.len() as u32 + 1, format!("{stem}-{place}-{k}"));
                let course = Course::Unplanned { ticks, period: guest.period() };
                motions.push(Motion { number, name, role, mounting: job.mounting, course });
            }
        }
        Programme { stages: vec![Stage { mounting: job.mounting, motions }] }
    }

    /// Reads the plans that [`Programme::save`] wrote. Whoever drives them checks them first ([`Programme::check`]).
    pub fn load(job: &Job, dir: &Path) -> Result<Programme, Failure> {
        if let Some(guest) = job.backend.guest() {
            return Ok(Programme::listened(job, &guest));
        }
        fill(job, slots(job), |slot| Ok(load_plan(&file(dir, &slot.name))?))
    }

    /// Holds every motion, and every way between two of them, to the limits and to the rules of the loop's guard. `dir` holds the plans.
    pub fn check(&self, planner: &Planner, dir: &Path) -> Result<(), Failure> {
        let mut ways = Ways::new(planner)?;
        for (motion, planned) in self.planned() {
            planner.check(&planned.plan, &file(dir, &motion.name))?;
            ways.go(&motion.mounting, &planned.plan.q0)
                .map_err(|peak| way_blocked(planner.job, &motion.name, Some(peak), 1))?;
        }
        Ok(())
    }

    /// The motions that one model is identified from determine its parameters.
    fn check_excitation(&self, planner: &Planner) -> Result<(), Failure> {
        for role in [Role::Identify, Role::Counter] {
            let motions: Vec<_> = self.planned().filter(|(motion, _)| motion.role == role).collect();
            if let Some((first, _)) = motions.first() {
                let series: Vec<_> = motions.iter().map(|(_, planned)| planned.fourier.clone()).collect();
                planner.check_excitation(&first.mounting, &series)?;
            }
        }
        Ok(())
    }

    /// Writes one plan file per motion.
    pub fn save(&self, dir: &Path) -> Result<(), Failure> {
        std::fs::create_dir_all(dir).map_err(|error| Failure::job(format!("{}: {error}", dir.display())))?;
        for (motion, planned) in self.planned() {
            save_plan(&planned.plan, &file(dir, &motion.name)).map_err(Failure::job)?;
        }
        Ok(())
    }

    pub fn motions(&self) -> impl Iterator<Item = &Motion> {
        self.stages.iter().flat_map(|stage| &stage.motions)
    }

    fn planned(&self) -> impl Iterator<Item = (&Motion, &Planned)> {
        self.motions().filter_map(|motion| Some((motion, motion.planned()?)))
    }
}

/// The job's programme, inside the limits of robot, job and the connected `arm`: the plans of an earlier run of the same job where they
/// are, else new ones, which are then kept in `out/plans`.
pub fn plan_or_load(job: &Job, robot: &Robot, out: &Path, arm: Option<&ArmLimits>) -> Result<Programme, Failure> {
    if let Some(guest) = job.backend.guest() {
        return Ok(Programme::listened(job, &guest));
    }
    let dir = out.join("plans");
    let planner = Planner::of(job, robot, arm)?;
    let stamp = planner.fingerprint();
    let stamp_file = dir.join("planned-for");
    if std::fs::read_to_string(&stamp_file).is_ok_and(|text| text.trim() == stamp) {
        let known = Programme::load(job, &dir)?;
        match known.check(&planner, &dir) {
            Ok(()) => {
                save_arm_limits(&dir, arm)?;
                return Ok(known);
            }
            Err(broken) => tracing::warn!("the plans in {} are not driven, new ones are made: {broken}", dir.display()),
        }
    }
    let bar = progress::bar("planning");
    let programme = Programme::plan(&planner, &|name, share| bar.at(share, name))?;
    bar.done();
    programme.save(&dir)?;
    save_arm_limits(&dir, arm)?;
    crate::atomic::write_file(&stamp_file, stamp.as_bytes()).map_err(Failure::job)?;
    Ok(programme)
}

/// File with the limits of the connected arm, beside the plans that were made under them; empty where the arm has none.
const ARM_LIMITS: &str = "arm-limits.toml";

fn save_arm_limits(dir: &Path, arm: Option<&ArmLimits>) -> Result<(), Failure> {
    let limits = arm.map(toml::to_string).transpose().map_err(Failure::job)?;
    crate::atomic::write_result(&dir.join(ARM_LIMITS), limits.unwrap_or_default().as_bytes())
}

/// The limits of the arm that the plans of `out` were made for.
pub fn arm_limits(out: &Path) -> Result<Option<ArmLimits>, Failure> {
    let path = out.join("plans").join(ARM_LIMITS);
    let file = path.display().to_string();
    let text = std::fs::read_to_string(&path).map_err(|error| Failure::job(format!("{file}: {error}")))?;
    (!text.is_empty()).then(|| Ok(from_toml(&file, &text)?)).transpose()
}

/// Motions that are tried when the way to a motion's start leaves the workspace.
const ATTEMPTS: u64 = 20;
/// Distance of the seeds of two tries, so that no motion takes another's.
const SEED_STEP: u64 = 10_007;

/// Distance of the live motion's seed from those of the validation.
const LIVE_SEED: u64 = 500;

/// Whether the arm reaches the start of a motion from where the job begins, and home again.
pub fn is_reached(planner: &Planner, q0: &[f64]) -> bool {
    Ways::new(planner).is_ok_and(|mut ways| ways.go(&planner.job.mounting, q0).is_ok())
}

/// The ways between motions, as the loop will drive them.
struct Ways<'a> {
    bounds: Bounds<'a>,
    rest: JointVec,
    /// Where the arm is, and in which mounting: it goes home before it is mounted anew.
    at: JointVec,
    mounting: Option<Mounting>,
}

impl<'a> Ways<'a> {
    fn new(planner: &'a Planner) -> Result<Ways<'a>, Failure> {
        let rest = crate::setup::rest(planner.job, planner.robot)?;
        let bounds = planner.bounds();
        if let Some((j, [min, max])) = outside(bounds.limits, &rest[..bounds.chain.len()]) {
            // The job's own limits were checked before: these are the connected arm's.
            let expected = format!("{min} to {max} rad for joint {}, the range of the connected arm", j + 1);
            let file = planner.job.file.display().to_string();
            return Err(BadInput::new(file, "key `backend.start`", format!("{} rad", rest[j]), expected).into());
        }
        Ok(Ways { bounds, rest, at: rest, mounting: None })
    }

    /// Goes to the start of a motion, where the arm can also go home from: it does after the last motion of a mounting, and after a
    /// stop. Otherwise stays; the error is what the way would break.
    fn go(&mut self, mounting: &Mounting, q0: &[f64]) -> Result<(), Peak> {
        if self.mounting.replace(*mounting) != Some(*mounting) {
            self.at = self.rest;
        }
        let mut to = JointVec::default();
        to[..q0.len()].copy_from_slice(q0);
        self.way(&self.at, &to)?;
        self.way(&to, &self.rest)?;
        self.at = to;
        Ok(())
    }

    /// Checks every millisecond of a way against box, sphere, bodies and speeds, and by the rules of the guard.
    fn way(&self, from: &JointVec, to: &JointVec) -> Result<(), Peak> {
        let n = self.bounds.chain.len();
        let mut moves = plumbline_rt::Planner::new(n, *self.bounds.limits, MoveFactors::default());
        let start = Setpoint { q: *from, ..Setpoint::default() };
        // Between two poses inside the range there is always a way; a blocked one is its start.
        if moves.move_to(&start, to).is_err() {
            return Err(Peak { quantity: Quantity::PositionMax, joint: None, time: 0.0, value: f64::NAN, limit: 0.0 });
        }
        for tick in 0..=moves.last_tick() {
            let point = moves.at(tick);
            let time = tick as f64 * 1e-3;
            if let Some(peak) = check_pose(&self.bounds, &point.q[..n]).violations().next() {
                return Err(Peak { time, ..*peak });
            }
            for j in 0..n {
                let limit = self.bounds.speeds(j, point.q[j])[usize::from(point.dq[j] > 0.0)];
                let joint = Some(j + 1);
                let peak = Peak { quantity: Quantity::Velocity, joint, time, value: point.dq[j].abs(), limit };
                if peak.is_violation() {
                    return Err(peak);
                }
            }
        }
        check_points_with_guard(&self.bounds, (0..=moves.last_tick()).map(|tick| moves.at(tick))).map_or(Ok(()), Err)
    }
}

/// The first joint (from 0) outside its range, and that range \[rad\].
pub fn outside(limits: &Limits, q: &[f64]) -> Option<(usize, [f64; 2])> {
    let range = |j: usize| [limits.q_min[j], limits.q_max[j]];
    // Written so that a NaN is outside, too.
    let inside = |j: usize| q[j] >= limits.q_min[j] && q[j] <= limits.q_max[j];
    (0..q.len()).find(|&j| !inside(j)).map(|j| (j, range(j)))
}

/// Whether the connected `arm` can move from its position to the programme's first one.
/// Errors: a way that leaves the workspace or meets the arm itself, with what it breaks.
pub fn free_way(job: &Job, robot: &Robot, arm: &ArmLimits, from: &JointVec, to: &JointVec) -> Result<(), Failure> {
    let planner = Planner::of(job, robot, Some(arm))?;
    let ways = Ways::new(&planner)?;
    ways.way(from, to).map_err(|peak| {
        Failure::job(format!(
            "from where the arm stands, the way to where the job begins is not free: {peak}. Move the arm by hand (guiding mode) to the \
             pose `backend.start` of the job, or near it, and start again"
        ))
    })
}

fn way_blocked(job: &Job, name: &str, broken: Option<Peak>, attempts: u64) -> Failure {
    let what = broken.map_or("nothing".to_string(), |peak| peak.to_string());
    let found = match attempts {
        1 => format!("on the way to {name}, or home from it: {what}"),
        _ => format!("no start for {name} with a free way there and home in {attempts} tries; the last: {what}"),
    };
    let expected = "room for a motion whose start the arm reaches inside the workspace without touching itself";
    BadInput::new(job.file.display().to_string(), "workspace", found, expected).into()
}

fn file(dir: &Path, name: &str) -> std::path::PathBuf {
    dir.join(format!("{name}.toml"))
}

/// A name that is safe in a file name: `rho = 60 deg, phi = 0 deg` becomes `rho-60-deg-phi-0-deg`.
fn slug(name: &str) -> String {
    let words: Vec<&str> =
        name.split(|c: char| !c.is_ascii_alphanumeric() && c != '.').filter(|w| !w.is_empty()).collect();
    words.join("-")
}

/// The motions of a job: the identification's mounting first, then the others.
fn slots(job: &Job) -> Vec<Slot> {
    let mut mountings = vec![job.mounting];
    mountings.extend(job.validation.mountings.iter().filter(|&&other| other != job.mounting));
    let mut slots = Vec::new();
    for mounting in mountings {
        let place = slug(&mounting.to_string());
        if mounting == job.mounting {
            for k in 1..=job.excitation.trajectories {
                // The first keeps the name that it has alone.
                let name = if k == 1 { format!("identify-{place}") } else { format!("identify-{place}-{k}") };
                let seed = job.excitation.seed + 1_000 * (k as u64 - 1);
                slots.push(Slot { name, role: Role::Identify, first: k == 1, mounting, seed });
            }
        } else if job.validation.counter_experiment && mounting.is_along_axis_1(VERTICAL_TOLERANCE) {
            let name = format!("counter-{place}");
            slots.push(Slot { name, role: Role::Counter, first: true, mounting, seed: job.excitation.seed + 1 });
        }
        if job.validation.mountings.contains(&mounting) {
            for k in 1..=job.validation.trajectories {
                let name = format!("validate-{place}-{k}");
                let seed = job.validation.seed + slots.len() as u64;
                slots.push(Slot { name, role: Role::Validate, first: false, mounting, seed });
            }
        }
        if mounting == job.mounting && job.live.motion > 0.0 {
            let seed = job.validation.seed + LIVE_SEED;
            slots.push(Slot { name: format!("live-{place}"), role: Role::Live, first: false, mounting, seed });
        }
    }
    slots
}

/// Gives every slot its plan and its number, and groups them by mounting.
fn fill(
    job: &Job,
    slots: Vec<Slot>,
    mut plan: impl FnMut(&Slot) -> Result<Plan, Failure>,
) -> Result<Programme, Failure> {
    let mut stages: Vec<Stage> = Vec::new();
    for (index, slot) in slots.into_iter().enumerate() {
        let plan = plan(&slot)?;
        let (periods, lead_in) = match slot.role {
            Role::Validate => (job.validation.periods, 0),
            Role::Live => (((job.live.motion / plan.period).ceil() as usize).max(1), 0),
            Role::Identify | Role::Counter => (job.excitation.periods, job.excitation.lead_in),
        };
        let Slot { name, role, mounting, .. } = slot;
        let fourier = crate::setup::planner::motion(&plan)?;
        let course = Course::Planned(Box::new(Planned { plan, fourier, periods, lead_in }));
        let motion = Motion { number: index as u32 + 1, name, role, mounting, course };
        match stages.last_mut() {
            Some(stage) if stage.mounting == mounting => stage.motions.push(motion),
            _ => stages.push(Stage { mounting, motions: vec![motion] }),
        }
    }
    Ok(Programme { stages })
}
