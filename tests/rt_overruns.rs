//! Cycles that the loop misses are skipped and counted, never caught up; misses in a row end in a controlled stop, a lifetime of single ones
//! never does; and whoever falls silent leaves an arm at rest. The clock of these runs is the test's own, so a stall is where the test
//! puts it; one test stops a real daemon with SIGSTOP.

use plumbline_core::{Clock, Fault, JointVec, PERIOD_NS, Phase, Record, Setpoint};
use plumbline_rt::cycle::{End, Outcome};
use plumbline_rt::recorder::ring;
use plumbline_rt::{Controls, StopReason, cycle};
use plumbline_sim::{Pace, REFLEX_COMMUNICATION};
use plumbline_testkit::fake_arm::Disturbance;
use plumbline_testkit::fake_arm::drive::{Job, Model, READY, Wave, dwell, follow, move_to, panda_limits, settings};
use plumbline_testkit::job::{Done, Place, Running, signal, wait_for};
use plumbline_testkit::sim::{READY as SIM_READY, silent_panda, sim};
use proptest::prelude::*;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// A clock that shows what the test wants: sleeping takes no time, and some wake-ups come late.
#[derive(Clone)]
struct StallingClock(Arc<Stalls>);

struct Stalls {
    now_ns: AtomicU64,
    /// When, and for how long \[ms\], in order.
    script: Vec<(u64, u64)>,
    next: AtomicUsize,
    quit_at: u64,
    controls: OnceLock<Arc<Controls>>,
}

impl Clock for StallingClock {
    fn now_ns(&self) -> u64 {
        self.0.now_ns.load(Ordering::Relaxed)
    }

    fn sleep_until(&self, deadline_ns: u64) {
        let Stalls { now_ns, script, next, quit_at, controls } = &*self.0;
        let mut now = now_ns.load(Ordering::Relaxed).max(deadline_ns);
        let at = next.load(Ordering::Relaxed);
        if let Some((_, long)) = script.get(at).filter(|(when, _)| now >= when * PERIOD_NS) {
            now += long * PERIOD_NS;
            next.store(at + 1, Ordering::Relaxed);
        }
        now_ns.store(now, Ordering::Relaxed);
        if now >= quit_at * PERIOD_NS {
            controls.get().unwrap().quit();
        }
    }
}

/// The simulated arm at wall-clock pace, by a clock that stalls: a motion of one and a half seconds, then rest until `quit_at` \[ms\].
fn stalled(script: &[(u64, u64)], quit_at: u64) -> (Outcome, Vec<Record>) {
    let stalls = Stalls {
        now_ns: AtomicU64::new(0),
        script: script.to_vec(),
        next: AtomicUsize::new(0),
        quit_at,
        controls: OnceLock::new(),
    };
    let clock = StallingClock(Arc::new(stalls));
    let arm = sim(&silent_panda(), 1, Pace::WallClock(Box::new(clock.clone())));
    let (sink, mut drain) = ring(100_000);
    let (mut cycle, mut handles) = cycle::new(arm, sink, None, settings()).unwrap();
    assert!(clock.0.controls.set(Arc::clone(&handles.controls)).is_ok());
    let wave = Wave { q0: SIM_READY, amplitude: Wave::gentle().amplitude.map(|a| 0.5 * a), ..Wave::gentle() };
    assert!(handles.orders.give(dwell(1, 50)).is_ok() && handles.orders.give(follow(2, wave)).is_ok());
    let outcome = cycle.run();
    handles.free_retired();
    let mut records = Vec::new();
    drain.take_into(&mut records, usize::MAX);
    assert_eq!(clock.0.next.load(Ordering::Relaxed), script.len(), "not every stall came: {outcome:?}");
    (outcome, records)
}

#[test]
fn a_slow_machine_skips_cycles_and_accounts_for_each_of_them() {
    // Ten states may be lost in a row; a stall of k ms loses k - 1 of them.
    let script = [(100, 2), (300, 5), (302, 1), (500, 11), (900, 3), (1400, 8), (1700, 4)];
    let (outcome, records) = stalled(&script, 2000);
    let summary = outcome.summary;
    assert_eq!((outcome.end, outcome.stops), (End::Quit, 0), "{outcome:?}");
    let lost: u64 = script.iter().map(|(_, long)| long - 1).sum();
    assert_eq!((summary.lost, summary.longest_lost), (lost, 10));
    // elapsed / period == cycles + skipped, by the arm's counter and by the clock.
    assert!(summary.accounted());
    assert_eq!((summary.elapsed, summary.clock), (summary.cycles + lost, Some(summary.elapsed)));
    // Nothing is caught up: one gap for each stall that lost something, and every other state follows the one before.
    let gaps: Vec<u64> =
        records.windows(2).map(|pair| pair[1].state.seq - pair[0].state.seq).filter(|&gap| gap > 1).collect();
    assert_eq!(gaps, script.iter().map(|(_, long)| *long).filter(|&long| long > 1).collect::<Vec<_>>());
    // The motion kept the arm's time: its last sample is where it belongs.
    let excited: Vec<&Record> = records.iter().filter(|record| record.phase == Phase::Excite).collect();
    let (first, last) = (excited[0], excited[excited.len() - 1]);
    assert_eq!(last.tick - first.tick, last.state.seq - first.state.seq);
}

#[test]
fn misses_in_a_row_stop_the_arm_and_a_lifetime_of_single_ones_never_does() {
    let (outcome, records) = stalled(&[(700, 12)], 2000);
    assert_eq!((outcome.stops, outcome.last_stop), (1, Some(StopReason::LostStates { lost: 11 })));
    assert_eq!(outcome.end, End::Quit);
    assert_eq!(records.last().unwrap().phase, Phase::Stopped);
    assert!(outcome.summary.accounted() && outcome.summary.clock == Some(outcome.summary.elapsed));

    let often: Vec<(u64, u64)> = (0..1500).map(|k| (60 + 6 * k, 2)).collect();
    let (outcome, _) = stalled(&often, 9_500);
    assert_eq!((outcome.stops, outcome.end, outcome.summary.lost), (0, End::Quit, 1500));
    assert!(outcome.summary.accounted() && outcome.summary.clock == Some(outcome.summary.elapsed));
}

#[test]
fn what_is_missed_for_longer_than_a_robot_waits_is_its_reflex() {
    let (outcome, _) = stalled(&[(700, 40)], 2000);
    assert_eq!(outcome.end, End::Fault(Fault::Reflex { code: REFLEX_COMMUNICATION }));
    assert!(outcome.summary.accounted());
}

/// The line in which the daemon accounts for a session: periods, cycles, skipped, and the periods by the machine's clock.
fn account(done: &Done) -> [u64; 4] {
    let line =
        done.err.lines().find(|line| line.contains("session `hold`")).unwrap_or_else(|| panic!("{}", done.output()));
    let numbers = |text: &str| -> Vec<u64> {
        text.split(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse().ok()).collect()
    };
    let all = numbers(line.split("session `hold`:").nth(1).unwrap());
    assert!(line.contains(" = ") && line.contains("by this machine's clock"), "{line}");
    // 12 periods = 10 cycles + 2 skipped (longest run 2), 12 by this machine's clock
    [all[0], all[1], all[2], all[4]]
}

#[test]
fn a_daemon_that_was_stopped_and_goes_on_has_skipped_and_counted_what_it_slept_through() {
    let place = Place::new("stalled");
    let sets = [
        "backend.pace=wall-clock",
        "safety.max-lost=1000",
        "excitation.starts=1",
        "excitation.rounds=0",
        "validation.trajectories=1",
    ];
    let mut daemon = Running::start(place.job("daemon", &sets));
    let cycles = || place.status().map(|status| status.cycles);
    wait_for("the loop", || cycles().filter(|&cycles| cycles > 200));
    for _ in 0..3 {
        signal(daemon.pid(), "STOP");
        std::thread::sleep(Duration::from_millis(300));
        signal(daemon.pid(), "CONT");
        std::thread::sleep(Duration::from_millis(200));
    }
    assert!(daemon.runs(), "the daemon ended by itself: {}", daemon.end().output());
    let done = place.quit(daemon);
    let [periods, cycles, skipped, clock] = account(&done);
    assert_eq!((periods, clock), (cycles + skipped, periods), "{}", done.output());
    assert!(skipped >= 3 * 290, "{skipped} skipped in three stalls of 300 ms\n{}", done.output());
}

#[test]
fn an_arm_that_moves_while_nobody_could_stop_it_is_braked_and_one_at_rest_holds() {
    let silent = |job: Job| {
        let mut job = job;
        job.settings.heartbeat_timeout = Some(200);
        job
    };
    // Somebody is there until read 700.
    let mut job = silent(Job::new(3_000).order(follow(1, Wave::gentle())));
    for read in (0..=700).step_by(100) {
        job = job.outside(read, |handles| handles.controls.heartbeat());
    }
    let run = job.run();
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    assert_eq!((run.outcome.stops, run.outcome.last_stop), (1, Some(StopReason::HeartbeatLost { cycles: 201 })));
    assert_eq!(run.records.last().unwrap().phase, Phase::Stopped);

    let run = silent(Job::new(3_000)).run();
    assert_eq!((run.outcome.stops, run.outcome.end), (0, End::Quit));
    assert!(run.records.iter().all(|record| record.phase == Phase::Hold && record.command.desired.q == READY));
}

const AWAY: JointVec = [0.3, -0.5, -0.3, -2.0, 0.4, 1.3, 0.3, 0.0];

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// Whatever gets lost, whenever it stops, whoever falls silent: what is commanded stays inside every limit, each period is accounted
    /// for, and after a stop the arm rests.
    #[test]
    fn rates_stay_bounded_whatever_goes_missing(
        losses in prop::collection::vec((10_u64..3_900, 1_u64..16), 0..12),
        stop in prop::option::of(10_u64..3_900),
        silent_after in prop::option::of(0_u64..3_900),
        frequency in 0.3_f64..1.2,
        size in 0.1_f64..1.0,
        model in any::<bool>(),
    ) {
        let wave = Wave { frequency, amplitude: Wave::gentle().amplitude.map(|a| size * a), ..Wave::gentle() };
        let mut job = Job::new(4_000).order(follow(1, wave)).order(move_to(2, AWAY)).order(dwell(3, 50)).order(move_to(4, READY));
        job.settings.heartbeat_timeout = Some(300);
        if model {
            job = job.model(Model(1, |d: &Setpoint| d.q.map(|q| 4.0 * q)));
        }
        for (read, count) in losses {
            job = job.disturb(read, Disturbance::Lose(count));
        }
        if let Some(read) = stop {
            job = job.outside(read, |handles| handles.controls.stop());
        }
        for read in (0..silent_after.unwrap_or(4_000)).step_by(100) {
            job = job.outside(read, |handles| handles.controls.heartbeat());
        }
        let run = job.run();
        run.assert_sound();
        run.assert_inside(&panda_limits(), 7);
        prop_assert!(run.outcome.summary.accounted());
        prop_assert!(run.outcome.stops <= 1, "{:?}", run.outcome);
        prop_assert_eq!(run.outcome.end, End::Quit);
        let last = run.records.last().unwrap().command.desired;
        prop_assert_eq!((last.dq, last.ddq), (JointVec::default(), JointVec::default()), "not at rest");
        let in_a_row = run.outcome.summary.longest_lost > settings().max_consecutive_lost;
        prop_assert!(!in_a_row || run.outcome.stops == 1);
    }
}
