//! `plumbline next`: a diagnosis, and the motion that would answer what it leaves open.

use crate::analysis::next::{self, next};
use crate::cli::output::Output;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::diagnose;
use crate::process::signals::Ending;
use crate::setup::planner::{Room, Task, no_plan};
use crate::store::save_plan;
use clap::Args;
use plumbline_core::BadInput;
use plumbline_excite::{Margins, Search};

/// Options of `plumbline next`.
#[derive(Args)]
#[group(id = "next")]
pub struct Options {
    #[command(flatten)]
    diagnose: diagnose::Options,
    /// Period of the motion in s
    #[arg(long, default_value_t = 10.0)]
    period: f64,
    /// How often the motion will be repeated
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=1000))]
    periods: u64,
    /// Random motions that are compared
    #[arg(long, default_value_t = next::STARTS as u64, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    starts: u64,
    /// Rounds in which the best motions are perturbed
    #[arg(long, default_value_t = next::ROUNDS as u64, value_parser = clap::value_parser!(u64).range(0..=1000))]
    rounds: u64,
    /// Seed of the search: the same seed finds the same motion
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: Output,
}

impl Options {
    pub(super) fn output(&self) -> &Output {
        &self.output
    }
}

/// Diagnoses, writes the results, and writes `next.toml` beside them where something is left open.
pub fn run(options: Options) -> Result<(), Failure> {
    let Options { period, .. } = options;
    if !((0.1..=250.0).contains(&period) && (period * 1e3).fract().abs() < 1e-6) {
        return Err(BadInput::new("command line", "--period", period, "0.1 to 250 s, in whole milliseconds").into());
    }
    options.output.may_replace(options.diagnose.out(), options.diagnose.dataset())?;
    let path = options.diagnose.out().join(next::FILE);
    // A plan of an earlier diagnosis would pass for the answer of this one.
    crate::atomic::remove_file(&path).map_err(Failure::job)?;
    let ending = Ending::interrupts()?;
    let mut planned = None;
    let report = diagnose::diagnose_and_plan(&options.diagnose, |open, block, robot, mounting| {
        if open.questions().len() == 0 {
            return Ok(());
        }
        let task = Task {
            robot,
            mounting,
            room: Room::of((robot.limits, robot.envelope), robot.workspace, false),
            margins: Margins::default(),
            nominal: None,
            q0: None,
        };
        let Options { starts, rounds, seed, periods, .. } = options;
        let search = Search { period, starts: starts as usize, rounds: rounds as usize, seed, ..Search::default() };
        let found = task
            .with_problem(|problem| next(open, problem, &search, periods as usize, &|_| true, &|| ending.arrived()));
        let (plan, questions) = found.map_err(|error| no_plan("command line", error))?;
        block.open = questions;
        planned = Some(plan);
        Ok(())
    })?;
    options.output.show(&report, options.diagnose.out())?;
    // Nothing but the report is JSON.
    let silent = options.output.quiet || options.output.json;
    match planned {
        Some(Some(plan)) if silent => save_plan(&plan, &path).map_err(Failure::job)?,
        _ if silent => {}
        None => say!("nothing is left open: no motion is planned"),
        Some(None) => say!("no motion within the robot's limits is expected to answer what is open"),
        Some(Some(plan)) => {
            save_plan(&plan, &path).map_err(Failure::job)?;
            say!("plan: {} (`excitation.plan` of a job)", path.display());
        }
    }
    Ok(())
}
