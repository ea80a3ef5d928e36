//! `plumbline predict`: torques of a model along a recorded motion.

use super::{Failure, pipeline};
use crate::config::robot::Robot;
use crate::config::units::parse_mounting;
use crate::dataset::Run;
use crate::estimate::experiment::Settings;
use crate::input::BadInput;
use crate::store::ModelFile;
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `plumbline predict`.
#[derive(Args)]
pub struct Options {
    /// Model file
    model: PathBuf,
    /// Recorded motion: a CSV file with columns t, q1..qn and, to compare with, tau1..taun
    run: PathBuf,
    /// CSV file to write: t, tau1..taun, one row per sample
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Mounting of that motion: upright, wall, ceiling, or RHO,PHI with units; by default the dataset.toml beside the motion says
    /// it, and where there is none, the model's own mounting holds
    #[arg(long)]
    mounting: Option<String>,
    /// Predict even where the model is not valid
    #[arg(long)]
    force: bool,
}

/// Predicts, writes, and says how far off the measured torques are where there are any.
pub fn run(options: Options) -> Result<(), Failure> {
    let file = ModelFile::load(&options.model, |name| Ok(Robot::load(name, options.model.parent())?.chain))?;
    let model = &file.model;
    let mut run = Run::read_csv(&options.run, model.structure().chain().len())?;
    if let Some(text) = &options.mounting {
        run.mounting = parse_mounting("--mounting", text)?;
    } else if let Some(mounting) = run.mounting_beside(&options.run)? {
        run.mounting = mounting;
    } else if let Some(&own) = model.mountings().first() {
        run.mounting = own;
    }
    if let Err(refused) = model.valid_in(&run.mounting)
        && !options.force
    {
        let name = options.model.display().to_string();
        let expected = "a model that holds in this mounting, or --force";
        return Err(BadInput::new(name, "key `kind`", refused, expected).into());
    }
    let judged = pipeline::predict(model, &run, &Settings::default())?;
    let mut text = String::from("t");
    for j in 1..=run.joints() {
        write!(text, ",tau{j}").expect("a string takes everything");
    }
    text.push('\n');
    for (k, t) in run.t.iter().enumerate() {
        write!(text, "{t}").expect("a string takes everything");
        for j in 0..run.joints() {
            write!(text, ",{}", judged.torques[(k, j)]).expect("a string takes everything");
        }
        text.push('\n');
    }
    super::write(&options.out, text.as_bytes())?;
    if let Some(rms) = judged.rms {
        let list = |values: &[f64]| values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ");
        println!("RMS of measured minus predicted torque [Nm]: raw {} | filtered {}", list(&rms.raw), list(&rms.filtered));
    }
    println!("{}: {} samples", options.out.display(), run.samples());
    Ok(())
}
