//! Every limit of the guard, crossed on purpose in every phase: the arm comes to rest, or is stopped by its own means, and nothing that was
//! sent crossed the arm's limits. `hil/limits/run.sh` writes the table of the margins to docs/results/campaigns.md.

use plumbline_core::{JointVec, Limits, MAX_JOINTS, Phase, Reference, Setpoint, Workspace};
use plumbline_rt::cycle::End;
use plumbline_rt::{Limit, Order, OrderKind, StopReason};
use plumbline_testkit::fake_arm::Disturbance;
use plumbline_testkit::fake_arm::drive::{
    Job, Model, READY, Run, Shape, Tool, Wave, dwell, follow, move_to, panda_limits,
};
use std::fmt::Write;

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// Where the excitation begins.
const AWAY: JointVec = [0.4, -0.3, -0.5, -1.9, 0.6, 1.2, 0.1, 0.0];
/// Cycles of a run.
const LENGTH: u64 = 8_000;

/// Phase in which the limit is crossed, and a read within it.
const PHASES: [(Phase, u64); 6] = [
    (Phase::Hold, 60),
    (Phase::Approach, 700),
    (Phase::Excite, 2_900),
    (Phase::Return, 4_300),
    (Phase::Stop, 2_960),
    (Phase::Stopped, 3_900),
];
/// Read at which an operator stops the arm, in the last two.
const STOPPED_AT: u64 = 2_920;

/// How a limit is crossed.
#[derive(Clone, Copy)]
enum How {
    /// By a motion that was ordered: only a motion that is followed can be wrong.
    Motion(fn(&mut Setpoint)),
    /// By a motion that needs room to get there: from a tick on, joint 7 is pushed so fast \[rad/s2\] up to that speed \[rad/s\].
    Push(f64, f64),
    /// By the torque of the served model; what it gives from that cycle on.
    Torque(fn(u64) -> f64),
    /// By where the tool is.
    Tool(fn(bool) -> [f64; 3]),
    /// By what the arm measures.
    Measured(fn() -> Disturbance),
}

const LIMITS: [(Limit, &str, How); 17] = [
    (Limit::NotFinite, "a number of the command", How::Motion(|s| s.q[6] = f64::NAN)),
    (Limit::Position, "position", How::Motion(|s| s.q[6] = 2.9)),
    (Limit::StoppingPosition, "position after braking", How::Push(15.0, 2.4)),
    (Limit::Velocity, "velocity", How::Motion(|s| s.dq[6] = 2.7)),
    (Limit::VelocityAhead, "velocity ahead", How::Push(19.0, 2.7)),
    (Limit::Acceleration, "acceleration", How::Motion(|s| s.ddq[6] = 20.5)),
    (Limit::Jerk, "jerk", How::Motion(|s| s.q[6] += 1.2e-5)),
    (Limit::StatedVelocity, "stated velocity", How::Motion(|s| s.dq[6] += 0.02)),
    (Limit::StatedAcceleration, "stated acceleration", How::Motion(lie)),
    (Limit::TorqueNotFinite, "a number of the torque", How::Torque(|_| f64::NAN)),
    (Limit::Torque, "torque", How::Torque(|since| 0.5 + 0.9 * since as f64)),
    (Limit::TorqueRate, "torque rate", How::Torque(|_| 2.0)),
    (Limit::EndEffectorBox, "tool in its box", How::Tool(|out| if out { [0.6, 0.0, 0.4] } else { [0.4, 0.0, 0.4] })),
    (Limit::BaseSphere, "tool off the base", How::Tool(|out| if out { [0.1, 0.0, 0.15] } else { [0.4, 0.0, 0.4] })),
    (Limit::Tracking, "following", How::Measured(|| Disturbance::Push(6, 0.12))),
    (Limit::MeasuredTorque, "measured torque", How::Measured(|| Disturbance::Torque(6, 12.5))),
    (Limit::MeasuredNotFinite, "a measured number", How::Measured(|| Disturbance::NanPosition(6))),
];

/// An acceleration that no motion has, at a velocity that goes with it.
fn lie(s: &mut Setpoint) {
    s.ddq[6] -= 15.0;
    s.dq[6] -= 0.5e-3 * 15.0;
}

/// Limits of the job, inside those of the arm, as a job's shares set them.
fn guarded() -> Limits {
    let hardware = panda_limits();
    let share = |of: JointVec, share: f64| of.map(|value| share * value);
    Limits {
        dq: share(hardware.dq, 0.98),
        ddq: share(hardware.ddq, 0.98),
        jerk: share(hardware.jerk, 0.98),
        ..hardware
    }
}

/// Joint 7 continues from the wave's sample at `from` with an acceleration that ramps up, to a speed that it keeps.
fn pushed(from: u64, ddq: f64, top: f64) -> impl Fn(u64) -> Setpoint + Send {
    let wave = || Wave { q0: AWAY, ticks: 2_000, ..Wave::gentle() };
    move |tick| {
        let mut out = wave().at(tick);
        if tick > from {
            let begin = wave().at(from);
            let (mut q, mut dq, mut a) = (begin.q[6], begin.dq[6], begin.ddq[6]);
            for _ in from..tick {
                let aim = if dq + 0.5 * a * a / 4000.0 < top { ddq } else { 0.0 };
                let jerk = ((aim - a) / 1e-3).clamp(-4000.0, 4000.0);
                q += dq * 1e-3 + 0.5 * a * 1e-6 + jerk * 1e-9 / 6.0;
                dq += a * 1e-3 + 0.5 * jerk * 1e-6;
                a += jerk * 1e-3;
            }
            (out.q[6], out.dq[6], out.ddq[6]) = (q, dq, a);
        }
        out
    }
}

/// The run; `None` where the limit can't be crossed in this phase.
fn run(how: How, phase: Phase, at: u64) -> Option<Run> {
    let moves = phase == Phase::Excite;
    let wave = || Wave { q0: AWAY, ticks: 2_000, ..Wave::gentle() };
    let back = Order { motion: 4, kind: OrderKind::MoveTo { target: READY, phase: Phase::Return } };
    let mut job = Job::new(LENGTH).order(dwell(1, 100)).order(move_to(2, AWAY));
    job.settings.guard.limits = guarded();
    if matches!(phase, Phase::Stop | Phase::Stopped) {
        job = job.outside(STOPPED_AT, |handles| handles.controls.stop());
    }
    let from = 900;
    job = match how {
        How::Motion(spoil) if moves => job.order(follow(
            3,
            Shape(2_000, move |tick| {
                let mut out = wave().at(tick);
                if tick >= from {
                    spoil(&mut out);
                }
                out
            }),
        )),
        How::Push(ddq, top) if moves => job.order(follow(3, Shape(4_000, pushed(from, ddq, top)))),
        How::Motion(_) | How::Push(..) => return None,
        _ => job.order(follow(3, wave())),
    };
    job = job.order(back);
    Some(match how {
        How::Torque(torque) => {
            let mut cycle = 0;
            let model = move |_: &Setpoint| {
                cycle += 1;
                [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, if cycle < at { 0.5 } else { torque(cycle - at) }, 0.0]
            };
            job.model(Model(5, model)).run()
        }
        How::Tool(place) => {
            job.settings.guard.workspace =
                Some(Workspace { box_min: [-0.5, -0.5, 0.1], box_max: [0.5, 0.5, 0.8], base_radius: 0.3 });
            // Asked once a cycle while nothing brakes.
            let asked = std::sync::atomic::AtomicU64::new(0);
            job.kinematics = Some(Box::new(Tool(move |_: &JointVec| {
                place(asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) >= at)
            })));
            job.run()
        }
        How::Measured(disturbance) => job.disturb(at, disturbance()).run(),
        How::Motion(_) | How::Push(..) => job.run(),
    })
}

/// Result of a cell: the cause of the stop, and the largest used share of the arm's limits.
struct Cell {
    words: &'static str,
    shares: [f64; 4],
}

fn play(limit: Limit, how: How, phase: Phase, at: u64) -> Option<Cell> {
    let run = run(how, phase, at)?;
    run.assert_sound();
    let hardware = panda_limits();
    run.assert_inside(&hardware, 7);
    let place = format!("{limit:?} in {phase:?}");
    for record in &run.records {
        let command = &record.command;
        let numbers = command.desired.q.iter().chain(&command.desired.dq).chain(&command.desired.ddq);
        assert!(numbers.chain(&command.tau_ff.0).all(|value| value.is_finite()), "{place}");
        assert!((0..7).all(|j| command.tau_ff.0[j].abs() <= hardware.tau[j]), "{place}");
    }
    let guarded = matches!(run.outcome.last_stop, Some(StopReason::Guard(violation)) if violation.limit == limit);
    let words = match run.outcome.end {
        End::Unsafe(violation) => {
            assert_eq!(violation.limit, limit, "{place}");
            "own means"
        }
        End::Quit if guarded => "braked",
        End::Quit => "went on braking",
        other => panic!("{place}: {other:?}"),
    };
    let braking = matches!(phase, Phase::Stop | Phase::Stopped);
    assert!(words == "braked" && !braking || braking && words != "braked", "{place}: {words}, {:?}", run.outcome);
    if words != "own means" {
        let last = run.records.last().unwrap().command.desired;
        assert_eq!((last.dq, last.ddq), Default::default(), "{place}: at rest in the end");
    }
    if !braking {
        let first = run.records.iter().position(|record| record.phase == Phase::Stop).expect("it braked");
        assert_eq!(run.records[first - 1].phase, phase, "{place}");
    }
    Some(Cell { words, shares: run.shares(&hardware, 7) })
}

fn campaign() -> String {
    let mut table = String::from(
        "| limit | hold | approach | excite | return | while it brakes | at rest after a stop |\n|---|---|---|---|---|---|---|\n",
    );
    for (limit, name, how) in LIMITS {
        write!(table, "| {name} |").unwrap();
        for (phase, at) in PHASES {
            match play(limit, how, phase, at) {
                None => write!(table, " – |").unwrap(),
                Some(Cell { words, shares }) => {
                    let most = shares.iter().copied().fold(0.0, f64::max);
                    write!(table, " {words}, margin {:.1} % |", 100.0 * (1.0 - most)).unwrap();
                }
            }
        }
        table.push('\n');
    }
    table
}

#[test]
fn every_limit_crossed_in_every_phase_ends_at_rest_inside_the_arms_limits() {
    assert_eq!(MAX_JOINTS, 8);
    let table = campaign();
    println!("{table}");
    if std::env::var_os("PLUMBLINE_WRITE_DOCS").is_some() {
        plumbline_testkit::page::write_block("docs/results/campaigns.md", "limits", &table);
    }
}
