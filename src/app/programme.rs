//! What a job drives, in order. The daemon and the estimator derive the same programme from the same files.

use super::Failure;
use crate::config::job::Job;
use crate::config::robot::Robot;
use crate::excite::fourier::Fourier;
use crate::excite::plan::Plan;
use crate::model::gravity::{Mounting, VERTICAL_TOLERANCE};
use crate::store::{load_plan, save_plan};
use std::path::Path;

/// What a motion is driven for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The parameters are identified from it.
    Identify,
    /// The model is judged by it.
    Validate,
    /// The counter-experiment: the vertical base set is identified from it, to show where that set fails.
    Counter,
}

/// One periodic motion.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Number in orders and records, from 1.
    pub number: u32,
    /// Name for people and files: `identify-wall`, `validate-upright-3`.
    pub name: String,
    /// What it is for.
    pub role: Role,
    /// How the arm is mounted meanwhile.
    pub mounting: Mounting,
    /// The plan it came from.
    pub plan: Plan,
    /// The motion itself.
    pub fourier: Fourier,
    /// Periods that count.
    pub periods: usize,
    /// Periods before those.
    pub lead_in: usize,
}

impl Motion {
    /// Samples of one period, at 1 kHz.
    pub fn period_ticks(&self) -> usize {
        (self.plan.period * 1000.0).round() as usize
    }

    /// Samples of the whole motion, lead-in included.
    pub fn ticks(&self) -> usize {
        self.period_ticks() * (self.periods + self.lead_in)
    }
}

/// Motions in one mounting.
#[derive(Clone, Debug)]
pub struct Stage {
    /// The mounting.
    pub mounting: Mounting,
    /// The motions, in order.
    pub motions: Vec<Motion>,
}

/// All stages, in order.
#[derive(Clone, Debug)]
pub struct Programme {
    /// The stages.
    pub stages: Vec<Stage>,
}

/// A motion before it has a plan.
struct Slot {
    name: String,
    role: Role,
    mounting: Mounting,
    seed: u64,
}

impl Programme {
    /// Plans every motion; `progress` hears which one is being planned and how far it is.
    pub fn plan(job: &Job, robot: &Robot, progress: &mut dyn FnMut(&str, f64)) -> Result<Programme, Failure> {
        let slots = slots(job);
        let all = slots.len() as f64;
        let mut done = 0.0;
        fill(job, slots, |slot| {
            let mut hear = |share: f64| progress(&slot.name, (done + share) / all);
            let plan = match slot.role {
                Role::Validate => super::plan::random(job, robot, &slot.mounting, slot.seed, &mut hear),
                Role::Identify | Role::Counter => super::plan::best(job, robot, &slot.mounting, slot.seed, &mut hear),
            };
            done += 1.0;
            plan
        })
    }

    /// Reads the plans that [`Programme::save`] wrote.
    pub fn load(job: &Job, robot: &Robot, dir: &Path) -> Result<Programme, Failure> {
        fill(job, slots(job), |slot| {
            let plan = load_plan(&file(dir, &slot.name))?;
            super::plan::check(job, robot, &plan, &file(dir, &slot.name))?;
            Ok(plan)
        })
    }

    /// Writes one plan file per motion.
    pub fn save(&self, dir: &Path) -> Result<(), Failure> {
        std::fs::create_dir_all(dir).map_err(|error| Failure::job(format!("{}: {error}", dir.display())))?;
        for motion in self.motions() {
            save_plan(&motion.plan, &file(dir, &motion.name)).map_err(Failure::job)?;
        }
        Ok(())
    }

    /// Every motion of every stage.
    pub fn motions(&self) -> impl Iterator<Item = &Motion> {
        self.stages.iter().flat_map(|stage| &stage.motions)
    }
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

/// The motions a job asks for: the identification's mounting first, then the others.
fn slots(job: &Job) -> Vec<Slot> {
    let mut mountings = vec![job.mounting];
    mountings.extend(job.validation.mountings.iter().filter(|&&other| other != job.mounting));
    let mut slots = Vec::new();
    for mounting in mountings {
        let place = slug(&mounting.to_string());
        if mounting == job.mounting {
            let name = format!("identify-{place}");
            slots.push(Slot { name, role: Role::Identify, mounting, seed: job.excitation.seed });
        } else if job.validation.counter_experiment && mounting.is_along_axis_1(VERTICAL_TOLERANCE) {
            let name = format!("counter-{place}");
            slots.push(Slot { name, role: Role::Counter, mounting, seed: job.excitation.seed + 1 });
        }
        if job.validation.mountings.contains(&mounting) {
            for k in 1..=job.validation.trajectories {
                let name = format!("validate-{place}-{k}");
                let seed = job.validation.seed + slots.len() as u64;
                slots.push(Slot { name, role: Role::Validate, mounting, seed });
            }
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
            Role::Identify | Role::Counter => (job.excitation.periods, job.excitation.lead_in),
        };
        let Slot { name, role, mounting, .. } = slot;
        let fourier = super::plan::motion(&plan)?;
        let motion = Motion { number: index as u32 + 1, name, role, mounting, plan, fourier, periods, lead_in };
        match stages.last_mut() {
            Some(stage) if stage.mounting == mounting => stage.motions.push(motion),
            _ => stages.push(Stage { mounting, motions: vec![motion] }),
        }
    }
    Ok(Programme { stages })
}
