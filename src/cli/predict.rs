//! `plumbline predict`: computes the torques of a model along a recorded motion.

use crate::analysis::pipeline::Predicted;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::predict::{self, Prediction, predict};
use clap::Args;
use std::fmt::Write;
use std::path::PathBuf;

/// Options of `plumbline predict`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    predict: predict::Options,
    /// CSV file to write: t, tau1..taun and at_end, one row per sample. at_end is 1 near both ends of the motion, where the acceleration
    /// depends on how the filter continues the motion past its end; elsewhere 0. A model file with the key `uncertainty` adds tau1_low,
    /// tau1_high .. taun_low, taun_high: the 95 % prediction interval of one measured sample
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Writes the predicted torques and prints the error against measured torques, if there are any.
pub fn run(options: Options) -> Result<(), Failure> {
    let Prediction { run, predicted, warnings } = predict(&options.predict)?;
    for warning in warnings {
        eprintln!("plumbline: {warning}");
    }
    let coverage = predicted.coverage(&run.data.tau);
    let Predicted { torques, at_end, rms, half_widths } = predicted;
    let mut text = String::from("t");
    for j in 1..=run.joints() {
        write!(text, ",tau{j}").expect("a string takes everything");
    }
    text.push_str(",at_end");
    for j in (1..=run.joints()).filter(|_| half_widths.is_some()) {
        write!(text, ",tau{j}_low,tau{j}_high").expect("a string takes everything");
    }
    text.push('\n');
    for (k, t) in run.data.t.iter().enumerate() {
        write!(text, "{t}").expect("a string takes everything");
        for j in 0..run.joints() {
            write!(text, ",{}", torques[(k, j)]).expect("a string takes everything");
        }
        write!(text, ",{}", u8::from(at_end[k])).expect("a string takes everything");
        if let Some(half_widths) = &half_widths {
            for (torque, half) in torques.row(k).iter().zip(&half_widths.row(k)) {
                write!(text, ",{},{}", torque - half, torque + half).expect("a string takes everything");
            }
        }
        text.push('\n');
    }
    crate::atomic::write_result(&options.out, text.as_bytes())?;
    if let Some(rms) = rms {
        let list = |values: &[f64]| values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ");
        say!("RMS of measured minus predicted torque [Nm]: raw {} | filtered {}", list(&rms.raw), list(&rms.filtered));
    }
    if let Some(coverage) = coverage {
        let percent: Vec<String> = coverage.iter().map(|share| format!("{:.1}", 100.0 * share)).collect();
        say!("measured torques within the 95 % prediction interval [%]: {}", percent.join(" "));
    }
    let ends = at_end.iter().filter(|at_end| **at_end).count();
    say!("{}: {} samples, {ends} of them marked `at_end`", options.out.display(), run.samples());
    Ok(())
}
