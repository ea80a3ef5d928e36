//! How the real-time loop and shared memory did, as it stands in `report.json`: times in microseconds, `null` where a figure has no
//! meaning or nobody measured it.

use plumbline_core::Distribution;
use plumbline_ipc::{Link, Session};
use serde::{Deserialize, Serialize};

/// How the real-time loop did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopFacts {
    /// `fast` or `wall-clock`.
    pub pace: String,
    /// Cycles run.
    pub cycles: u64,
    /// Cycles that came late; absent where simulated time doesn't follow the clock.
    pub late: Option<u64>,
    /// States that the arm sent and the loop never saw.
    pub lost: u64,
    /// Records that found no room.
    pub records_lost: u64,
    /// Heap allocations inside cycles; absent when nobody watched.
    pub allocations: Option<u64>,
    /// Lateness of wake-ups \[us\]; absent where simulated time doesn't follow the clock.
    pub wake_us: Option<Quantiles>,
    /// Time from state read to command written \[us\].
    pub work_us: Option<Quantiles>,
    /// What the machine granted and refused, as text.
    #[serde(default)]
    pub realtime: Vec<String>,
}

/// The same for one connection to the arm: `elapsed == cycles + lost`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SessionFacts {
    /// What it was for.
    pub name: String,
    /// Cycles of the arm, by the arm's own counter.
    pub elapsed: u64,
    /// Cycles of the loop.
    pub cycles: u64,
    /// States that never arrived.
    pub lost: u64,
    /// Longest run of lost states.
    pub longest_lost: u64,
    /// Whether `elapsed == cycles + lost`: every period of the arm was either a cycle or is counted as skipped.
    #[serde(default)]
    pub accounted: bool,
    /// The same as `elapsed` by this machine's clock; absent where simulated time doesn't follow it.
    #[serde(default)]
    pub clock: Option<u64>,
    /// Cycles that came late; absent where simulated time doesn't follow the clock.
    pub late: Option<u64>,
    /// Records that found no room between the loop and the bridge thread.
    pub records_lost: u64,
    /// Heap allocations inside cycles; absent when nobody watched.
    pub allocations: Option<u64>,
    /// Lateness of wake-ups \[us\]; absent where simulated time doesn't follow the clock.
    pub wake_us: Option<Quantiles>,
    /// From state read to command written \[us\].
    pub work_us: Option<Quantiles>,
    /// From one state to the next \[us\]; absent where simulated time doesn't follow the clock.
    pub period_us: Option<Quantiles>,
    /// From state read to shared memory \[us\].
    pub bridge_us: Option<Quantiles>,
    /// What the operating system did not grant, with what to change.
    pub refusals: Vec<String>,
    /// How it ended.
    pub end: String,
    /// The network to the robot; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<LinkFacts>,
}

/// The connection to a robot over a network.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinkFacts {
    /// Robot, protocol version and system image, in words.
    pub robot: String,
    /// States received.
    pub states: u64,
    /// States that never arrived.
    pub lost: u64,
    /// States that arrived and were passed over, for a newer one was there when the loop looked.
    pub passed_over: u64,
    /// Packets that came out of order, twice or damaged.
    pub odd: u64,
    /// Commands that left late for the robot's next cycle.
    pub late: u64,
    /// Commands that the rate limiter changed.
    pub limited: u64,
    /// Least and mean share of commands that reached the robot in time, by the robot's own count over 100 at a time.
    pub success: Option<[f64; 2]>,
    /// From a state's being read to its command on the way \[us\].
    pub turnaround_us: Option<Quantiles>,
    /// From a state's arrival at this machine to its being read \[us\].
    pub wake_us: Option<Quantiles>,
    /// From a command on the way to the first state that shows it \[us\].
    pub round_trip_us: Option<Quantiles>,
    /// From one state's arrival to the next one's \[us\].
    pub interval_us: Option<Quantiles>,
    /// Direction of gravity in the base frame that the robot's sensors show, or its own constant without any; a unit vector.
    pub gravity: Option<[f64; 3]>,
    /// Gravity in the base frame that the robot's own controller compensates \[m/s2\].
    pub compensates: Option<[f64; 3]>,
    /// What the robot stopped for and what to do next.
    pub fault: Option<String>,
}

impl LinkFacts {
    fn of(link: &Link) -> LinkFacts {
        LinkFacts {
            robot: link.robot.clone(),
            states: link.states,
            lost: link.lost,
            passed_over: link.passed_over,
            odd: link.odd,
            late: link.late,
            limited: link.limited,
            success: link.success,
            turnaround_us: Quantiles::of(&link.turnaround),
            wake_us: Quantiles::of(&link.wake),
            round_trip_us: Quantiles::of(&link.round_trip),
            interval_us: Quantiles::of(&link.interval),
            gravity: link.gravity,
            compensates: link.compensates,
            fault: link.fault.clone(),
        }
    }
}

impl SessionFacts {
    /// What a session says about itself; `wall_clock` tells whether its arm kept the time of a clock.
    pub fn of(session: &Session, wall_clock: bool) -> SessionFacts {
        SessionFacts {
            name: session.name.clone(),
            elapsed: session.elapsed,
            cycles: session.cycles,
            lost: session.lost,
            longest_lost: session.longest_lost,
            accounted: session.elapsed == session.cycles + session.lost,
            clock: session.clock,
            late: wall_clock.then_some(session.late),
            records_lost: session.unrecorded,
            allocations: session.allocations.map(u64::from),
            wake_us: Quantiles::of(&session.wake).filter(|_| wall_clock),
            work_us: Quantiles::of(&session.work),
            period_us: Quantiles::of(&session.period).filter(|_| wall_clock),
            bridge_us: Quantiles::of(&session.bridge),
            refusals: session.refusals.clone(),
            end: session.end.clone(),
            link: session.link.as_ref().map(LinkFacts::of),
        }
    }
}

/// A distribution in four numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are below.
    pub p99: f64,
    /// 999 of 1000 are below.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

impl Quantiles {
    /// Nanoseconds as microseconds; `None` when nothing was measured.
    pub fn of(times: &Distribution) -> Option<Quantiles> {
        let us = |ns: u64| ns as f64 / 1e3;
        let &Distribution { count, p50, p99, p999, max } = times;
        (count > 0).then(|| Quantiles { p50: us(p50), p99: us(p99), p999: us(p999), max: us(max) })
    }
}

/// What went through shared memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct IpcFacts {
    /// Samples that the daemon published.
    pub sent: u64,
    /// Samples that the estimator has, each once.
    pub received: u64,
    /// Of those, samples that had to be asked for again.
    pub replayed: u64,
    /// Samples that the estimator never got.
    pub missed: u64,
}
