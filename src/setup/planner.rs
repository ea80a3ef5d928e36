//! The planning of a job's motions.

use crate::config::job::Job;
use crate::failure::Failure;
use crate::setup::friction_structure;
use crate::store::load_plan;
use plumbline_core::{ArmLimits, BadInput, Limits, SpeedEnvelope, Workspace, threads};
use plumbline_excite::{
    Bounds, ExciteError, Fourier, Margins, Nominal, Plan, PlanUsage, Problem, Progress, Search, SearchControl, Usage,
    check_excitation, check_usage, motion_samples, optimise, usage, verify_with_guard,
};
use plumbline_model::{Mounting, Robot};
use plumbline_model_file::models;
use plumbline_rt::MoveFactors;
use sha2::{Digest, Sha256};
use std::path::Path;

/// Share of the room that a validation motion uses.
const VALIDATION_AMPLITUDE: f64 = 0.7;

pub fn nominal(path: &Path, robot: &Robot) -> Result<Nominal, Failure> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|error| BadInput::new(&file, "file", error, "a readable model file"))?;
    let model = models::of_robot(&file, &text, robot, "the robot that is planned for")?.model;
    let left_out = Nominal::left_out(&model);
    if !left_out.is_empty() {
        tracing::warn!("{file}: a plan's torques are those without {}", left_out.join(", "));
    }
    Nominal::of(&model).map_err(|error| {
        let expected = "a model of rigid body, friction, torque-offset, rotor-inertia and effects";
        BadInput::new(&file, "term", error, expected).into()
    })
}

/// What motions of a job and the loop's guard are held to: the limits of robot file and job and, inside them, those of the connected `arm`.
pub fn held_to(job: &Job, robot: &Robot, arm: Option<&ArmLimits>) -> Result<(Limits, Option<SpeedEnvelope>), Failure> {
    let limits = job.guard_limits(&robot.limits, robot.chain.len())?;
    Ok(match arm {
        Some(arm) => (arm.within(&limits), arm.envelope_within(robot.envelope.as_ref())),
        None => (limits, robot.envelope),
    })
}

pub struct Planner<'a> {
    pub job: &'a Job,
    pub robot: &'a Robot,
    room: Room,
    nominal: Option<Nominal>,
    /// The limits of a connected arm are among those of `room`.
    connected: bool,
}

impl<'a> Planner<'a> {
    /// Reads what the job names; `arm` is the connected arm. Errors on limits that are none, and on a nominal model that can't be read.
    pub fn of(job: &'a Job, robot: &'a Robot, arm: Option<&ArmLimits>) -> Result<Planner<'a>, Failure> {
        let held_to = held_to(job, robot, arm)?;
        let nominal = job.excitation.model.as_deref().map(|path| nominal(path, robot)).transpose()?;
        let links_in_box = job.workspace.is_some_and(|own| own.links_in_box);
        let room = Room::of(held_to, job.workspace(&robot.workspace), links_in_box);
        Ok(Planner { job, robot, room, nominal, connected: arm.is_some() })
    }

    /// Hash of everything that the plans depend on.
    pub fn fingerprint(&self) -> String {
        let Planner { job, robot, room, nominal, connected: _ } = self;
        let parts = (&job.excitation, &job.validation, &job.limits, &job.mounting, robot, room, nominal);
        let version = env!("CARGO_PKG_VERSION");
        Sha256::digest(format!("{version} {parts:?}")).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The motion to identify from: the job's own plan file, or the best that a search finds.
    pub fn best(&self, mounting: &Mounting, seed: u64, progress: &(dyn Fn(f64) + Sync)) -> Result<Plan, Failure> {
        if let (Some(path), true) = (&self.job.excitation.plan, *mounting == self.job.mounting) {
            let plan = load_plan(path)?;
            self.check(&plan, path).map_err(|broken| self.other_plan(broken))?;
            let usage = PlanUsage::of(&self.usage(&motion(&plan)?));
            return Ok(Plan { usage: Some(usage), ..plan });
        }
        let report = |now: Progress| progress(now.done as f64 / now.of as f64);
        let watch = SearchControl { threads: threads(), stop: &|| false, progress: &report };
        self.task(mounting, self.job.margins())
            .best(&self.search(seed), &[], &watch)
            .map_err(|error| self.no_plan(error))
    }

    /// Says what to do about a plan that the job names and that can't be driven.
    fn other_plan(&self, broken: Failure) -> Failure {
        let job = self.job.file.display();
        let next = format!(
            "Without `excitation.plan` in {job}, `plumbline run {job}` plans a motion under the limits of this job and its arm"
        );
        match broken {
            Failure::Input(bad) => Failure::Input(BadInput { expected: format!("{}. {next}", bad.expected), ..bad }),
            Failure::Job(what) => Failure::Job(format!("{what}. {next}")),
        }
    }

    pub fn random(&self, mounting: &Mounting, seed: u64) -> Result<Plan, Failure> {
        self.task(mounting, self.job.margins()).random(&self.search(seed)).map_err(|error| self.no_plan(error))
    }

    /// The motion with the largest `score` of those that keep every limit.
    pub fn next<T>(
        &self,
        mounting: &Mounting,
        find: impl FnOnce(&Problem, &Search) -> Result<T, ExciteError>,
    ) -> Result<T, Failure> {
        let search = self.search(self.job.excitation.seed);
        self.task(mounting, self.job.margins())
            .with_problem(|problem| find(problem, &search))
            .map_err(|error| self.no_plan(error))
    }

    /// Checks that a plan from a file fits the job's robot, keeps every limit, margins apart, at 1 kHz, passes the guard, and moves every joint.
    pub fn check(&self, plan: &Plan, path: &Path) -> Result<(), Failure> {
        let file = path.display().to_string();
        if plan.robot != self.robot.name {
            return Err(BadInput::new(&file, "key `robot`", &plan.robot, format!("`{}`", self.robot.name)).into());
        }
        let fourier = plan.fourier().map_err(|error| infeasible(&file, &error))?;
        if fourier.joints() != self.robot.chain.len() {
            let expected = format!("{} joints", self.robot.chain.len());
            return Err(BadInput::new(&file, "key `q0`", format!("{} joints", fourier.joints()), expected).into());
        }
        let verdict =
            self.task(&plan.mounting(), Margins::none()).with_problem(|problem| verify_with_guard(problem, &fourier));
        if let Some(peak) = verdict.violations().next() {
            let expected = if self.connected {
                "a motion inside every limit of the job and of the connected arm"
            } else {
                "a motion inside every limit of the job"
            };
            return Err(BadInput::new(&file, "motion", peak, expected).into());
        }
        check_usage(&self.usage(&fourier), None, 1).map_err(|error| no_plan(&file, error))
    }

    /// How much of each joint's limits a motion uses.
    pub fn usage(&self, fourier: &Fourier) -> Vec<Usage> {
        usage(&self.room.bounds(self.robot, self.job.margins()), fourier)
    }

    /// Checks that motions in one mounting together determine every parameter.
    pub fn check_excitation(&self, mounting: &Mounting, motions: &[Fourier]) -> Result<(), Failure> {
        let task = self.task(mounting, Margins::none());
        let determined =
            task.with_problem(|problem| check_excitation(problem.structure, &motion_samples(problem, motions)));
        determined.map_err(|error| self.no_plan(error))
    }

    /// What the arm is held to on the ways between motions: everything to its full.
    pub fn bounds(&self) -> Bounds<'_> {
        self.room.bounds(self.robot, Margins::none())
    }

    fn task(&self, mounting: &Mounting, margins: Margins) -> Task<'_> {
        Task {
            robot: self.robot,
            mounting: *mounting,
            room: self.room,
            margins,
            nominal: self.nominal.as_ref(),
            q0: self.job.excitation.q0.as_deref(),
        }
    }

    fn search(&self, seed: u64) -> Search {
        let excitation = &self.job.excitation;
        Search {
            period: excitation.period,
            harmonics: excitation.harmonics,
            criterion: excitation.criterion,
            starts: excitation.starts,
            rounds: excitation.rounds,
            seed,
            ..Search::default()
        }
    }

    fn no_plan(&self, error: ExciteError) -> Failure {
        no_plan(&self.job.file.display().to_string(), error)
    }
}

/// A search without a plan: a failed job where motions were found and none is of use, else bad input.
pub fn no_plan(file: &str, error: ExciteError) -> Failure {
    match error {
        ExciteError::Frozen { .. } => Failure::job(format!(
            "{file}: {error}. Give the joint more room: wider limits or box, another start pose, or another period"
        )),
        ExciteError::Unexcited { .. } => Failure::job(format!(
            "{file}: {error}. Search longer (more starts), or give the arm more room: wider limits or box, more speed, a longer period"
        )),
        _ => infeasible(file, &error),
    }
}

fn infeasible(file: &str, error: &ExciteError) -> Failure {
    BadInput::new(file, "excitation", error, "a start pose and limits that leave room for a motion").into()
}

/// Where an arm may move, and how fast.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    limits: Limits,
    workspace: Workspace,
    links_in_box: bool,
    envelope: Option<SpeedEnvelope>,
}

impl Room {
    /// The speed envelope is that which the loop's guard holds motions to: a stop has to stay under it, too.
    pub fn of((limits, envelope): (Limits, Option<SpeedEnvelope>), workspace: Workspace, links_in_box: bool) -> Room {
        let ddq = limits.ddq.map(|ddq| MoveFactors::default().brake * ddq);
        Room { limits, workspace, links_in_box, envelope: envelope.map(|envelope| envelope.braked_with(&ddq)) }
    }

    fn bounds<'a>(&'a self, robot: &'a Robot, margins: Margins) -> Bounds<'a> {
        Bounds {
            workspace: Some(&self.workspace),
            shape: Some(&robot.shape),
            links_in_box: self.links_in_box,
            envelope: self.envelope.as_ref(),
            ..Bounds::new(&robot.chain, &self.limits, margins)
        }
    }
}

/// One search: the arm, its mounting and what it is held to.
pub struct Task<'a> {
    pub robot: &'a Robot,
    pub mounting: Mounting,
    pub room: Room,
    pub margins: Margins,
    pub nominal: Option<&'a Nominal>,
    pub q0: Option<&'a [f64]>,
}

impl Task<'_> {
    pub fn best(&self, search: &Search, prior: &[Fourier], watch: &SearchControl) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| optimise(problem, search, prior, watch))
    }

    pub fn random(&self, search: &Search) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| plumbline_excite::random_plan(problem, search, VALIDATION_AMPLITUDE))
    }

    pub fn with_problem<T>(&self, find: impl FnOnce(&Problem) -> T) -> T {
        let n = self.robot.chain.len();
        let structure = friction_structure(self.robot, &self.mounting);
        // Before anything is measured, the noise of a joint is taken as proportional to its torque range.
        let sigma: Vec<f64> = self.room.limits.tau[..n].iter().map(|tau| tau * 1e-3).collect();
        find(&Problem {
            robot: &self.robot.name,
            structure: &structure,
            mounting: self.mounting,
            bounds: self.room.bounds(self.robot, self.margins),
            nominal: self.nominal,
            sigma: &sigma,
            q0: self.q0,
        })
    }
}

/// The motion of a plan that was checked before.
pub fn motion(plan: &Plan) -> Result<Fourier, Failure> {
    plan.fourier().map_err(Failure::job)
}
