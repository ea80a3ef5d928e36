//! Whether the arm kept its limits and came to rest, by what the emulator wrote down every millisecond.

use plumbline_franka::wire::{Protocol, RobotMode};
use plumbline_testkit::emulator::RobotKind;
use plumbline_testkit::emulator::limits::{JOINTS, Joints, Limits, TICK};
use std::path::Path;

/// Measured positions and velocities are noisy: this far beyond a limit is still inside \[rad\], \[rad/s\].
const NOISE: (f64, f64) = (2e-3, 0.1);
const ROUNDING: f64 = 1.0 + 1e-6;
/// Measured speed of an arm that stands \[rad/s\].
const STANDS: f64 = 0.05;

#[derive(Clone, Debug, Default)]
pub struct Judged {
    /// Limits that were broken, in words; the first few.
    pub violations: Vec<String>,
    /// Whether the arm stood still in the end, and no motion ran.
    pub at_rest: bool,
    /// Number of the last state in which the arm was still to move.
    pub last_moved: Option<u64>,
    /// Largest share of any joint's speed limit that the arm used, by its desired velocity.
    pub speed: f64,
}

struct Row {
    id: u64,
    mode: u8,
    q_d: Joints,
    dq_d: Joints,
    q: Joints,
    dq: Joints,
    tau: Joints,
}

fn row(line: &str) -> Option<Row> {
    let mut fields = line.split(',');
    let id = fields.next()?.parse().ok()?;
    let mode = fields.next()?.parse().ok()?;
    // Errors, reasons and the success rate are the client's to report.
    let mut numbers = fields.skip(3).map(|field| field.parse::<f64>().unwrap_or(f64::NAN));
    let mut joints = || -> Option<Joints> {
        let values: Vec<f64> = numbers.by_ref().take(JOINTS).collect();
        values.try_into().ok()
    };
    Some(Row { id, mode, q_d: joints()?, dq_d: joints()?, q: joints()?, dq: joints()?, tau: joints()? })
}

pub fn judge(log: &Path) -> Judged {
    let limits = Limits::of(RobotKind::Panda, Protocol::V5);
    let text = std::fs::read_to_string(log).unwrap_or_else(|error| panic!("{}: {error}", log.display()));
    let rows: Vec<Row> = text.lines().skip(1).filter_map(row).collect();
    let mut judged = Judged::default();
    // NaN is inside nothing.
    let inside = |value: f64, limit: f64| value.abs() <= limit;
    for (index, now) in rows.iter().enumerate() {
        let before = &rows[index.saturating_sub(1)];
        for j in 0..JOINTS {
            let (least, most) = (limits.q_min[j], limits.q_max[j]);
            let range = |q: f64, more: f64| (least - more..=most + more).contains(&q);
            let ddq = (now.dq_d[j] - before.dq_d[j]) / TICK;
            let checks = [
                ("desired position", now.q_d[j], range(now.q_d[j], 0.0)),
                ("position", now.q[j], range(now.q[j], NOISE.0)),
                ("desired velocity", now.dq_d[j], inside(now.dq_d[j], limits.dq[j] * ROUNDING)),
                ("velocity", now.dq[j], inside(now.dq[j], limits.dq[j] + NOISE.1)),
                ("desired acceleration", ddq, inside(ddq, limits.ddq[j] * (1.0 + 1e-3))),
                ("torque", now.tau[j], inside(now.tau[j], limits.tau[j])),
            ];
            for (what, value, kept) in checks {
                if !kept && judged.violations.len() < 5 {
                    judged.violations.push(format!("state {}: {what} of joint {} is {value}", now.id, j + 1));
                }
            }
            judged.speed = judged.speed.max(now.dq_d[j].abs() / limits.dq[j]);
        }
        if now.dq_d != [0.0; JOINTS] {
            judged.last_moved = Some(now.id);
        }
    }
    judged.at_rest = rows.last().is_some_and(|last| {
        last.mode != RobotMode::Move.code() && last.dq_d == [0.0; JOINTS] && last.dq.iter().all(|dq| dq.abs() < STANDS)
    });
    judged
}
