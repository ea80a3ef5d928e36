//! Step 1: does this machine answer the robot in time?

use super::verdict::Verdict;
use super::{Given, Rig};
use clap::Args;
use plumbline_core::{Backend, Command, Distribution, Fault, Setpoint};
use plumbline_franka::{Connection, Purpose, Statistics};
use plumbline_rt::{Rights, become_realtime};
use std::error::Error;

/// Most states that may be missing in a row.
const LONGEST_GAP: u64 = 3;
/// Least share of commands that the robot has to count.
const SUCCESS: f64 = 0.95;

#[derive(Args, Clone)]
pub struct Options {
    #[command(flatten)]
    pub given: Given,
    /// How long states are watched \[s\]
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=600))]
    pub watch: u64,
    /// How long the pose is held \[s\]
    #[arg(long, default_value_t = 30, value_parser = clap::value_parser!(u64).range(1..=600))]
    pub hold: u64,
}

/// Watches, then holds.
pub fn run(rig: &Rig, options: &Options) -> Result<Verdict, Box<dyn Error>> {
    let realtime = &rig.job.realtime;
    let priority = Some(realtime.priority).filter(|&priority| priority > 0);
    let granted = become_realtime(&Rights {
        priority,
        cpu: realtime.cpu,
        lock_memory: realtime.lock_memory,
        preempt_rt: realtime.preempt_rt,
    });
    granted.refusals().for_each(|refusal| println!("not real-time: {refusal}"));

    println!("watching {} s of states; nothing moves", options.watch);
    let (watched, fault) = session(rig, Purpose::Monitor, 1000 * options.watch)?;
    show("watched", &watched);
    if let Some(fault) = fault {
        return Ok(Verdict::Fail(vec![plumbline_franka::explain(&fault, &watched).to_string()]));
    }
    println!("holding the present pose under control for {} s; nothing is to move", options.hold);
    let (held, fault) = session(rig, Purpose::Drive, 1000 * options.hold)?;
    show("held", &held);
    let mut reasons: Vec<String> =
        fault.iter().map(|fault| plumbline_franka::explain(fault, &held).to_string()).collect();
    for (what, statistics) in [("watching", &watched), ("holding", &held)] {
        if statistics.longest_gap > LONGEST_GAP {
            reasons.push(format!(
                "while {what}, {} states in a row were lost or passed over (at most {LONGEST_GAP}); the longest wait in the socket was {:.0} us. \
                 Lost: use a network port of its own and a direct cable. Passed over: this machine woke up late, use a kernel with PREEMPT_RT",
                statistics.longest_gap,
                us(statistics.wake.max_ns)
            ));
        }
    }
    if fault.is_none() && held.success_rate.mean < SUCCESS {
        reasons.push(format!(
            "the robot counted {:.1} % of the commands in time ({:.0} % wanted); the longest answer took {:.0} us, the longest wait in the \
             socket {:.0} us",
            100.0 * held.success_rate.mean,
            100.0 * SUCCESS,
            us(held.work.max_ns),
            us(held.wake.max_ns)
        ));
    }
    Ok(Verdict::of(reasons, format!("{:.2} % of the commands came in time", 100.0 * held.success_rate.mean)))
}

fn us(ns: u64) -> f64 {
    ns as f64 / 1e3
}

/// Reads so many states, and answers each with the pose of the first where the arm is driven.
fn session(rig: &Rig, purpose: Purpose, states: u64) -> Result<(Statistics, Option<Fault>), Box<dyn Error>> {
    let (mut arm, Connection { info, telemetry }) =
        plumbline_franka::connect(&rig.franka.settings(&rig.job, purpose)?)?;
    println!("connected to {}", info.image);
    let ended = hold(&mut arm, states);
    arm.stop();
    Ok((telemetry.snapshot(), ended.err()))
}

fn hold(arm: &mut impl Backend, states: u64) -> Result<(), Fault> {
    let first = arm.read()?;
    let mut state = first;
    for _ in 0..states {
        let desired = Setpoint { q: first.q_d, ..Setpoint::default() };
        arm.write(&Command { seq: state.seq, desired, ..Command::default() })?;
        state = arm.read()?;
    }
    Ok(())
}

fn show(what: &str, statistics: &Statistics) {
    let Statistics { states, lost, skipped, longest_gap, success_rate, work, wake, round_trip, .. } = statistics;
    println!(
        "  {what}: {states} states, {lost} lost, {skipped} passed over because a newer one was there; at most {longest_gap} in a row"
    );
    let row = |name: &str, times: &Distribution| {
        if let Some([p50, p99, p999, max]) = times.in_us() {
            println!("  {name:<22} p50 {p50:>8.1}  p99 {p99:>8.1}  p99.9 {p999:>8.1}  max {max:>8.1} us");
        }
    };
    row("answer", work);
    row("wait in the socket", wake);
    row("round trip", round_trip);
    if success_rate.mean > 0.0 {
        println!(
            "  commands in time by the robot's count: {:.2} % (least {:.2} %)",
            100.0 * success_rate.mean,
            100.0 * success_rate.min
        );
    }
}
