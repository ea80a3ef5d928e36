//! `plumbline predict`: computes the torques of a model along a recorded motion.

use crate::analysis::external::{Contact, Seen};
use crate::analysis::pipeline::Predicted;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::predict::{self, Prediction, predict};
use clap::Args;
use plumbline_identify::external::Way;
use plumbline_model::Chain;
use std::fmt::Write;
use std::path::PathBuf;

/// Largest number of contacts that are listed.
const LISTED: usize = 10;

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
    let Prediction { run, predicted, external, chain, warnings } = predict(&options.predict)?;
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
    if external.is_some() {
        for j in 1..=run.joints() {
            write!(text, ",tau_ext{j},tau_ext{j}_low,tau_ext{j}_high").expect("a string takes everything");
        }
        text.push_str(",contact");
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
        if let Some(external) = &external {
            let found = external.at(*t);
            for (tau, half) in found.tau.iter().zip(&found.half_width).take(run.joints()) {
                write!(text, ",{tau},{},{}", tau - half, tau + half).expect("a string takes everything");
            }
            write!(text, ",{}", u8::from(found.contact)).expect("a string takes everything");
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
    if let Some(external) = &external {
        external_lines(external, &chain).iter().for_each(|line| say!("{line}"));
    }
    let ends = at_end.iter().filter(|at_end| **at_end).count();
    say!("{}: {} samples, {ends} of them marked `at_end`", options.out.display(), run.samples());
    Ok(())
}

/// Contacts of a motion, thresholds along it, and the thresholds as a line for libfranka.
fn external_lines(external: &Seen, chain: &Chain) -> Vec<String> {
    let settings = external.settings();
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(", ");
    let way = match settings.way {
        Way::Momentum => "generalised momentum",
        Way::Acceleration => "accelerations",
    };
    let mut lines = vec![format!(
        "external torque by {way}, low-pass {} Hz, {:.1} ms late; thresholds for {} false alarms an hour",
        settings.bandwidth,
        1e3 * external.delay(),
        settings.false_alarms
    )];
    let contacts = external.contacts();
    for Contact { span: [from, to], torque, joints } in contacts.iter().take(LISTED) {
        let joints = joints.iter().map(usize::to_string).collect::<Vec<_>>().join(" ");
        lines.push(format!("contact {from:.3} to {to:.3} s, joints {joints}: up to [{}] Nm", list(torque)));
    }
    match contacts.len() {
        0 => lines.push("no contact".into()),
        count if count > LISTED => lines.push(format!("and {} more contacts", count - LISTED)),
        _ => {}
    }
    let torques = list(&external.thresholds());
    lines.push(format!("largest thresholds along the motion [Nm]: {torques}"));
    match external.wrench_thresholds(|q| chain.jacobian(q)) {
        Some(wrench) => {
            let wrench = list(&wrench);
            lines.push(format!("as a wrench at the end effector, base frame [N, Nm]: {wrench}"));
            if chain.len() == 7 {
                let (torques, wrench) = (format!("{{{{{torques}}}}}"), format!("{{{{{wrench}}}}}"));
                lines.push(format!("robot.setCollisionBehavior({torques}, {torques}, {wrench}, {wrench});"));
            }
        }
        None => lines.push("as a wrench: not determined, every pose is nearly singular".into()),
    }
    lines
}
