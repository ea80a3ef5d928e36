//! Steps 3 and 4: the job itself, small and slow, then whole. Both run the `plumbline` that was installed beside this program.

use super::verdict::Verdict;
use super::{Given, Rig};
use plumbline::report::Report;
use plumbline::report::diagnosis::Verdict as Found;
use std::error::Error;
use std::path::Path;
use std::process::Command;

/// How far joints may move from `backend.start` in the slow step \[rad\].
const RANGE: f64 = 0.35;
/// Largest error on unseen motions, in units of the noise floor.
const NOISE: f64 = 3.0;

/// A tenth of the speed, a fifth of the acceleration and jerk, a small range, one period.
pub fn slow(rig: &Rig, given: &Given) -> Result<Verdict, Box<dyn Error>> {
    let n = rig.robot.chain.len();
    let Some(start) = rig.job.backend.start.clone().filter(|start| start.len() == n) else {
        return Err(format!(
            "{}: key `backend.start`: expected one position per joint: the slow step stays near it",
            given.config.display()
        )
        .into());
    };
    let limits = rig.job.guard_limits(&rig.robot.limits, n)?;
    let list = |of: &dyn Fn(usize) -> f64| format!("{:?}", (0..n).map(of).collect::<Vec<f64>>());
    let sets = [
        format!("limits.override.q-min={}", list(&|j| limits.q_min[j].max(start[j] - RANGE))),
        format!("limits.override.q-max={}", list(&|j| limits.q_max[j].min(start[j] + RANGE))),
        "limits.margin=0 rad".into(),
        "limits.speed=0.1".into(),
        "limits.acceleration=0.2".into(),
        "limits.jerk=0.2".into(),
        "excitation.trajectories=1".into(),
        "excitation.periods=2".into(),
        "excitation.lead-in=0".into(),
        "validation.trajectories=0".into(),
        "diagnosis.enabled=false".into(),
        "safety.tracking-error=0.02 rad".into(),
    ];
    let out = rig.job.output.dir.join("rig-slow");
    println!("planning, then driving a small, slow excitation; keep your hand on the stop button");
    let driven = run(rig, given, &sets, &out)?;
    let mut reasons = Vec::new();
    if !driven {
        reasons.push("the arm was stopped or the job failed; the lines above say why and what to do".to_string());
    } else {
        reasons.extend(faults(&report(&out)?));
    }
    Ok(Verdict::of(
        reasons,
        format!("driven to the end, every joint within 0.02 rad; look at {}", out.join("report.html").display()),
    ))
}

pub fn full(rig: &Rig, given: &Given) -> Result<Verdict, Box<dyn Error>> {
    let out = rig.job.output.dir.clone();
    println!("running the whole job; keep your hand on the stop button");
    if !run(rig, given, &[], &out)? {
        return Ok(Verdict::Fail(vec![
            "the arm was stopped or the job failed; the lines above say why and what to do".into(),
        ]));
    }
    let report = report(&out)?;
    let mut reasons = faults(&report);
    if let Some(missed) = report.ipc.map(|ipc| ipc.counters.missed).filter(|&missed| missed > 0) {
        reasons.push(format!("{missed} samples never reached the estimator: look at the load of this machine"));
    }
    let explained = report
        .diagnosis
        .as_ref()
        .is_some_and(|found| found.verdict == Found::Diagnosed || found.verdict == Found::NothingSignificant);
    for validation in &report.validate {
        let over = |(j, (rms, floor)): (usize, (&f64, &f64))| (*rms > NOISE * floor).then_some(j + 1);
        let joints: Vec<usize> =
            validation.rms_raw.iter().zip(&report.noise_floor).enumerate().filter_map(over).collect();
        if !joints.is_empty() && !explained {
            reasons.push(format!(
                "{}: the model misses joints {joints:?} by more than {NOISE} times their noise, and the diagnosis does not explain it",
                validation.run
            ));
        }
    }
    Ok(Verdict::of(reasons, format!("the whole job; the result is {}", out.join("report.html").display())))
}

/// Whether `plumbline run` succeeded.
fn run(rig: &Rig, given: &Given, sets: &[String], out: &Path) -> Result<bool, Box<dyn Error>> {
    let program = &rig.program;
    let mut command = Command::new(program);
    command.arg("run").arg(&given.config).arg("--out").arg(out);
    for set in given.sets.iter().chain(sets) {
        command.args(["--set", set]);
    }
    let ended = command
        .status()
        .map_err(|error| format!("{}: {error}; build it with `cargo build --release`", program.display()))?;
    Ok(ended.success())
}

fn report(out: &Path) -> Result<Report, Box<dyn Error>> {
    let path = out.join("report.json");
    let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
    Ok(serde_json::from_str(&text)?)
}

/// Faults from which the robot was recovered during the job.
fn faults(report: &Report) -> Vec<String> {
    let sessions = report.control_loop.iter().flat_map(|of| &of.sessions);
    sessions.filter_map(|session| session.link.as_ref()?.fault.clone()).collect()
}
