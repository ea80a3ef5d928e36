//! The whole loop on a Franka arm over real sockets: to the start of an excitation, through one period of it, and to an orderly end.

use plumbline_core::{ArmLimits, FeedForward, JointVec, Phase, Record};
use plumbline_excite::{Fourier, PeriodicMotion, parse_plan};
use plumbline_franka::{ConnectError, Connection, FrankaArm, Settings, Statistics, connect, explain, recover};
use plumbline_rt::Rights;
use plumbline_rt::cycle::{End, Outcome};
use plumbline_rt::recorder::ring;
use plumbline_rt::{CycleSettings, Event, GuardSettings, Order, OrderKind, StopReason, TimedEvent, cycle};
use std::time::{Duration, Instant};

pub struct Run {
    pub outcome: Outcome,
    pub records: Vec<Record>,
    pub statistics: Statistics,
    pub connection: Connection,
    pub ended: bool,
}

impl Run {
    pub fn describe(&self) -> String {
        match &self.outcome.end {
            End::Fault(fault) => explain(fault, &self.statistics).to_string(),
            other => format!("{other}, last stop {:?}", self.outcome.last_stop),
        }
    }

    /// Root mean square of measured against commanded position per joint, while the excitation ran \[rad\].
    pub fn tracking(&self) -> [f64; 7] {
        let excited: Vec<&Record> = self.records.iter().filter(|record| record.phase == Phase::Excite).collect();
        std::array::from_fn(|j| {
            let sum: f64 = excited.iter().map(|r| (r.state.q[j] - r.command.desired.q[j]).powi(2)).sum();
            (sum / excited.len().max(1) as f64).sqrt()
        })
    }
}

/// The shipped 10 s excitation, made smaller: an FR3 is slower to accelerate than the Panda it was planned for.
pub fn plan(share: f64) -> Fourier {
    let file = crate::path("config/plans/panda-wall.toml");
    let mut fourier =
        parse_plan("panda-wall.toml", &std::fs::read_to_string(file).unwrap()).unwrap().fourier().unwrap();
    (0..7).for_each(|joint| fourier.scale_joint(joint, share));
    fourier
}

/// The same in half the time: `share` of the way at twice the speed.
pub fn quick_plan(share: f64) -> Fourier {
    let fourier = plan(share);
    Fourier { period: 0.5 * fourier.period, ..fourier }
}

/// Connects, goes to where `fourier` begins, follows one period of it (or what `most` leaves time for), and ends.
pub fn drive(settings: &Settings, fourier: &Fourier, most: Duration) -> Result<Run, ConnectError> {
    let (arm, connection) = connect(settings)?;
    Ok(drive_arm(arm, connection, fourier, most))
}

pub fn drive_arm(arm: FrankaArm, connection: Connection, fourier: &Fourier, most: Duration) -> Run {
    drive_serving(arm, connection, fourier, most, None)
}

/// The same with a model's torque as feed-forward.
pub fn drive_serving(
    arm: FrankaArm,
    connection: Connection,
    fourier: &Fourier,
    most: Duration,
    model: Option<Box<dyn FeedForward>>,
) -> Run {
    let motion = PeriodicMotion::new(fourier, 1).unwrap();
    let mut start = JointVec::default();
    (0..7).for_each(|j| start[j] = fourier.at(j, 0.0).q);
    let ArmLimits { limits, envelope, .. } = connection.info.limits.for_guard(1.0);
    let guard = GuardSettings { limits, envelope, workspace: None, tracking: [0.2; 8] };
    // A test machine is no robot PC: what it loses is for the arm to judge, not for the loop; and what it grants in priority, it grants.
    let rights = Rights { priority: Some(10), ..Rights::NONE };
    let settings = CycleSettings { rights, max_consecutive_lost: 19, ..CycleSettings::new(guard) };
    let (sink, mut drain) = ring(60_000);
    let (mut cycle, mut handles) = cycle::new(arm, sink, None, settings).unwrap();
    if let Some(model) = model {
        assert!(handles.models.serve(model).is_ok());
    }
    let loop_thread = std::thread::spawn(move || cycle.run());
    for (motion, kind) in [
        (1, OrderKind::Dwell { ticks: 300 }),
        (2, OrderKind::MoveTo { target: start, phase: Phase::Approach }),
        (3, OrderKind::Follow(Box::new(motion))),
    ] {
        assert!(handles.orders.give(Order { motion, kind }).is_ok());
    }
    let deadline = Instant::now() + most;
    let mut ended = false;
    while !loop_thread.is_finished() && Instant::now() < deadline {
        while let Ok(TimedEvent { event, .. }) = handles.events.pop() {
            ended |= event == (Event::Ended { motion: 3 });
            if matches!(event, Event::Stopping { .. } | Event::Stopped) {
                handles.controls.quit();
            }
        }
        if ended {
            handles.controls.quit();
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    handles.controls.quit();
    let outcome = loop_thread.join().unwrap();
    handles.free_retired();
    let mut records = Vec::new();
    drain.take_into(&mut records, usize::MAX);
    let statistics = connection.telemetry.snapshot();
    Run { outcome, records, statistics, connection, ended }
}

/// Tries again where this machine stalled: where the motion ended in a reflex, and a state had lain in our socket for 2 ms or more shortly
/// before, or where the server's own process stood still. Without a real-time kernel, beside other work, that happens every few seconds; a violation of the communication constraints is the
/// right end of 20 ms of it. franka-sim also takes commands that come a few milliseconds late and goes back on what it had extrapolated for
/// them, where a robot drops them; after that its point is one that no client can know. Everything else that ends a run stands.
pub fn drive_with_retries(settings: &Settings, fourier: &Fourier, most: Duration, tries: u32) -> Run {
    use plumbline_core::Fault;
    let mut attempt = 1;
    loop {
        let run = drive(settings, fourier, most).unwrap_or_else(|error| panic!("{error}"));
        let reflex = matches!(run.outcome.end, End::Fault(Fault::Reflex { .. }));
        let silent = matches!(run.outcome.end, End::Fault(Fault::Silent { .. }));
        let stalled = run.statistics.stall.wake_ns.max(run.statistics.stall.work_ns) >= 2_000_000;
        let lost = matches!(run.outcome.last_stop, Some(StopReason::LostStates { .. }));
        if !(reflex && stalled || silent || lost) || attempt >= tries {
            return run;
        }
        eprintln!("RETRY {attempt}: {}", run.describe());
        attempt += 1;
        if let Err(error) = recover(settings) {
            eprintln!("recovery: {error}");
        }
    }
}
