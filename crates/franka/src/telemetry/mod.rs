//! Counters of the real-time thread, which any other thread reads without a lock.

use super::wire::{Errors, HEADER_BYTES, MoveStatus, RobotMode};
use plumbline_core::{Distribution, Histogram};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Counters of a session. The arm's thread writes, anyone reads.
#[derive(Debug, Default)]
pub struct Telemetry {
    states: AtomicU64,
    lost: AtomicU64,
    skipped: AtomicU64,
    out_of_order: AtomicU64,
    duplicates: AtomicU64,
    bad: AtomicU64,
    foreign: AtomicU64,
    commands: AtomicU64,
    unsent: AtomicU64,
    late: AtomicU64,
    slow: AtomicU64,
    held: AtomicU64,
    returning: AtomicU64,
    foreign_points: AtomicU64,
    longest_gap: AtomicU64,
    rate_count: AtomicU64,
    rate_sum: AtomicU64,
    rate_min: AtomicU64,
    rate_last: AtomicU64,
    reflex: AtomicU64,
    errors: AtomicU64,
    mode: AtomicU64,
    move_status: AtomicU64,
    stall_work: AtomicU64,
    stall_wake: AtomicU64,
    stall_network: AtomicU64,
    stall_lost: AtomicU64,
    garbled: [AtomicU64; 3],
    restarted: [AtomicU64; 2],
    work: Histogram,
    wake: Histogram,
    interval: Histogram,
    round_trip: Histogram,
}

/// The longest delays of the last cycles before a motion ended, by who caused them \[ns\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Stall {
    /// From a state's being read to its command's leaving: our own work.
    pub work_ns: u64,
    /// A state lay in the socket for so long before our thread read it: the thread woke up late, or was still busy.
    pub wake_ns: u64,
    /// Time between two states at our network card, beyond the millisecond that is due: the network, or the arm itself.
    pub network_ns: u64,
    /// States that never arrived.
    pub lost: u64,
}

/// What [`Telemetry`] held at one moment.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Statistics {
    /// States taken, each newer than all before it.
    pub states: u64,
    /// States that never arrived, or only after a newer one had been taken.
    pub lost: u64,
    /// States that arrived and were passed over, because a newer one had arrived by the time of the read.
    pub skipped: u64,
    /// States that came after a newer one.
    pub out_of_order: u64,
    /// States that came twice.
    pub duplicates: u64,
    /// Datagrams of the arm that were no state.
    pub bad_packets: u64,
    /// Datagrams of other senders.
    pub foreign_packets: u64,
    /// Commands sent.
    pub commands: u64,
    /// Commands that the system did not take.
    pub unsent: u64,
    /// Commands that the arm had not used by the next state, though that state was not lost.
    pub late_commands: u64,
    /// Cycles in which the command left more than a millisecond after the state had arrived.
    pub slow_cycles: u64,
    /// Commands that were changed to hold a limit of the arm.
    pub limited: u64,
    /// Commands that led the arm back to the motion after missed commands or a held limit.
    pub returning: u64,
    /// States whose desired position follows from none of the commands sent.
    pub unexplained_points: u64,
    /// Most states missing in a row.
    pub longest_gap: u64,
    /// `control_command_success_rate` of the motion: lowest, mean and last, 0 to 1. Its first 100 ms don't count; zero before there is one.
    pub success_rate: Rate,
    /// Why the last motion ended: `reflex_reason` of the first state that showed the end, bit `i` for error `i`.
    pub reflex_reason: u64,
    /// Errors that stood in that state.
    pub errors: u64,
    /// `robot_mode` of the newest state, as a number on the wire.
    pub robot_mode: u8,
    /// The arm's final answer about the last motion, as an index into [`MoveStatus::ALL`].
    pub move_status: Option<u8>,
    /// First bytes of what came over TCP and was no message.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub garbled: Option<[u8; HEADER_BYTES]>,
    /// Number of the last state taken, and a smaller one that the arm counted from then on instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub restarted: Option<[u64; 2]>,
    /// The delays of the last cycles before the motion ended.
    pub stall: Stall,
    /// From a state's being read to its command's leaving \[us\].
    pub work: Distribution,
    /// From a state's arrival in the kernel to its being read \[us\]: the wake-up.
    pub wake: Distribution,
    /// Between the arrivals of states in the kernel \[us\].
    pub interval: Distribution,
    /// From a command's leaving to the arrival of the first state whose `q_d` shows it; not measured where torques are commanded \[us\]. It holds the way there,
    /// the wait for the arm's next cycle, and the way back; commands that equal the one before don't count.
    pub round_trip: Distribution,
}

/// The arm's count of the commands that reached it.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Rate {
    /// Lowest.
    pub min: f64,
    /// Mean.
    pub mean: f64,
    /// Last.
    pub last: f64,
}

impl Statistics {
    /// [`Statistics::reflex_reason`] as a set of named errors.
    pub fn reflex(&self) -> Errors {
        Errors::from_bits(self.reflex_reason).unwrap_or_default()
    }

    /// [`Statistics::robot_mode`] by name.
    pub fn mode(&self) -> RobotMode {
        RobotMode::from_code(self.robot_mode).unwrap_or_default()
    }

    /// [`Statistics::move_status`] by name.
    pub fn status(&self) -> Option<MoveStatus> {
        MoveStatus::ALL.get(usize::from(self.move_status?)).copied()
    }
}

/// What one read of the socket found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Arrivals {
    pub skipped: u64,
    pub lost: u64,
    pub gap: u64,
    pub interval_ns: Option<u64>,
    pub wake_ns: Option<u64>,
}

fn add(counter: &AtomicU64, more: u64) {
    if more > 0 {
        counter.store(counter.load(Relaxed).wrapping_add(more), Relaxed);
    }
}

impl Telemetry {
    /// Everything counted so far. The numbers are each right, but need not be of the same cycle.
    pub fn snapshot(&self) -> Statistics {
        let get = |counter: &AtomicU64| counter.load(Relaxed);
        let real = |counter: &AtomicU64| f64::from_bits(counter.load(Relaxed));
        let count = get(&self.rate_count);
        let success_rate = if count == 0 {
            Rate::default()
        } else {
            Rate { min: real(&self.rate_min), mean: real(&self.rate_sum) / count as f64, last: real(&self.rate_last) }
        };
        Statistics {
            states: get(&self.states),
            lost: get(&self.lost),
            skipped: get(&self.skipped),
            out_of_order: get(&self.out_of_order),
            duplicates: get(&self.duplicates),
            bad_packets: get(&self.bad),
            foreign_packets: get(&self.foreign),
            commands: get(&self.commands),
            unsent: get(&self.unsent),
            late_commands: get(&self.late),
            slow_cycles: get(&self.slow),
            limited: get(&self.held),
            returning: get(&self.returning),
            unexplained_points: get(&self.foreign_points),
            longest_gap: get(&self.longest_gap),
            success_rate,
            reflex_reason: get(&self.reflex),
            errors: get(&self.errors),
            robot_mode: get(&self.mode) as u8,
            // Kept one higher, so that zero is none.
            move_status: get(&self.move_status).checked_sub(1).map(|index| index as u8),
            garbled: (get(&self.garbled[0]) > 0).then(|| {
                let mut bytes = [0; HEADER_BYTES];
                bytes[..8].copy_from_slice(&get(&self.garbled[1]).to_le_bytes());
                bytes[8..].copy_from_slice(&(get(&self.garbled[2]) as u32).to_le_bytes());
                bytes
            }),
            restarted: Some(self.restarted.each_ref().map(get)).filter(|[last, _]| *last > 0),
            stall: Stall {
                work_ns: get(&self.stall_work),
                wake_ns: get(&self.stall_wake),
                network_ns: get(&self.stall_network),
                lost: get(&self.stall_lost),
            },
            work: self.work.distribution(),
            wake: self.wake.distribution(),
            interval: self.interval.distribution(),
            round_trip: self.round_trip.distribution(),
        }
    }

    /// `robot_mode` of the newest state.
    pub fn newest_mode(&self) -> RobotMode {
        RobotMode::from_code(self.mode.load(Relaxed) as u8).unwrap_or_default()
    }

    pub(super) fn in_mode(&self, mode: RobotMode) {
        self.mode.store(u64::from(mode.code()), Relaxed);
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(super) fn took(&self, arrivals: &Arrivals, mode: RobotMode) {
        add(&self.states, 1);
        add(&self.skipped, arrivals.skipped);
        add(&self.lost, arrivals.lost);
        if arrivals.gap > self.longest_gap.load(Relaxed) {
            self.longest_gap.store(arrivals.gap, Relaxed);
        }
        if let Some(ns) = arrivals.interval_ns {
            self.interval.add(ns);
        }
        if let Some(ns) = arrivals.wake_ns {
            self.wake.add(ns);
        }
        self.in_mode(mode);
    }

    /// What came over TCP is no message.
    pub(super) fn garbled(&self, bytes: &[u8; HEADER_BYTES]) {
        let [a, b, c, d, e, f, g, h, low @ ..] = *bytes;
        self.garbled[1].store(u64::from_le_bytes([a, b, c, d, e, f, g, h]), Relaxed);
        self.garbled[2].store(u64::from(u32::from_le_bytes(low)), Relaxed);
        self.garbled[0].store(1, Relaxed);
    }

    /// After state `last` the arm's numbers started again; by now they are at `number`.
    pub(super) fn restarted(&self, last: u64, number: u64) {
        self.restarted[1].store(number, Relaxed);
        self.restarted[0].store(last, Relaxed);
    }

    pub(super) fn out_of_order(&self) {
        add(&self.out_of_order, 1);
    }

    pub(super) fn duplicate(&self) {
        add(&self.duplicates, 1);
    }

    pub(super) fn bad(&self) {
        add(&self.bad, 1);
    }

    pub(super) fn foreign(&self) {
        add(&self.foreign, 1);
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(super) fn sent(&self, work_ns: u64, slow: bool, held: bool, returning: bool) {
        add(&self.commands, 1);
        add(&self.slow, u64::from(slow));
        add(&self.held, u64::from(held));
        add(&self.returning, u64::from(returning));
        self.work.add(work_ns);
    }

    pub(super) fn unsent(&self) {
        add(&self.unsent, 1);
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(super) fn followed(&self, late: bool, own: bool, round_trip_ns: Option<u64>) {
        add(&self.late, u64::from(late));
        add(&self.foreign_points, u64::from(!own));
        if let Some(ns) = round_trip_ns {
            self.round_trip.add(ns);
        }
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(super) fn rate(&self, rate: f64) {
        if !rate.is_finite() {
            return;
        }
        let count = self.rate_count.load(Relaxed);
        let real = |counter: &AtomicU64| f64::from_bits(counter.load(Relaxed));
        let min = if count == 0 { rate } else { rate.min(real(&self.rate_min)) };
        self.rate_min.store(min.to_bits(), Relaxed);
        self.rate_sum.store((real(&self.rate_sum) + rate).to_bits(), Relaxed);
        self.rate_last.store(rate.to_bits(), Relaxed);
        self.rate_count.store(count + 1, Relaxed);
    }

    pub(super) fn motion_began(&self) {
        self.move_status.store(0, Relaxed);
        self.reflex.store(0, Relaxed);
        self.errors.store(0, Relaxed);
    }

    pub(super) fn motion_ended(&self, reflex: Errors, errors: Errors, mode: RobotMode, stall: &Stall) {
        self.reflex.store(reflex.bits(), Relaxed);
        self.errors.store(errors.bits(), Relaxed);
        self.mode.store(u64::from(mode.code()), Relaxed);
        self.stalled(stall);
    }

    pub(super) fn stalled(&self, stall: &Stall) {
        self.stall_work.store(stall.work_ns, Relaxed);
        self.stall_wake.store(stall.wake_ns, Relaxed);
        self.stall_network.store(stall.network_ns, Relaxed);
        self.stall_lost.store(stall.lost, Relaxed);
    }

    pub(super) fn move_answered(&self, status: MoveStatus) {
        let index = MoveStatus::ALL.iter().position(|other| *other == status).unwrap_or(MoveStatus::ALL.len());
        self.move_status.store(index as u64 + 1, Relaxed);
    }
}

/// Cycles that [`Recent`] looks back on: what the arm's own 20 in a row can hide in.
const RECENT: usize = 64;

/// The delays of the last cycles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recent {
    ring: [Stall; RECENT],
    at: usize,
}

impl Default for Recent {
    fn default() -> Recent {
        Recent { ring: [Stall::default(); RECENT], at: 0 }
    }
}

impl Recent {
    /// A state was read.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn read(&mut self, wake_ns: u64, interval_ns: u64, lost: u64) {
        self.at = (self.at + 1) % RECENT;
        if let Some(slot) = self.ring.get_mut(self.at) {
            let network_ns = interval_ns.saturating_sub(plumbline_core::PERIOD_NS);
            *slot = Stall { work_ns: 0, wake_ns, network_ns, lost };
        }
    }

    /// Its command left.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, work_ns: u64) {
        if let Some(slot) = self.ring.get_mut(self.at) {
            slot.work_ns = work_ns;
        }
    }

    /// The longest of each.
    pub fn worst(&self) -> Stall {
        self.ring.iter().fold(Stall::default(), |worst, cycle| Stall {
            work_ns: worst.work_ns.max(cycle.work_ns),
            wake_ns: worst.wake_ns.max(cycle.wake_ns),
            network_ns: worst.network_ns.max(cycle.network_ns),
            lost: worst.lost + cycle.lost,
        })
    }
}
