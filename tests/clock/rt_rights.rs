//! Real-time rights as the kernel has them: which threads of a running daemon are real-time, that a refusal is said everywhere, and that a
//! job which wants all of it or nothing gets nothing.

use plumbline_testkit::job::*;
use std::collections::BTreeMap;

/// A daemon that holds its arm at the pace of the clock. How late a cycle may come is this machine's business.
const HOLD: [&str; 2] = ["backend.pace=wall-clock", "safety.max-lost=1000"];

/// A processor that no machine has.
const NO_CPU: &str = "realtime.cpu=1000";

/// Scheduling policy and real-time priority of every thread of `pid`, by the thread's number, with its name.
fn threads(pid: u32) -> BTreeMap<u32, (String, u32, u32)> {
    let folder = std::fs::read_dir(format!("/proc/{pid}/task")).unwrap();
    let thread = |id: u32| {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/task/{id}/stat")).ok()?;
        let (before, after) = stat.rsplit_once(')')?;
        let name = before.split_once('(')?.1.to_string();
        // proc(5): field 40 is rt_priority, field 41 the policy; the text after the name begins with field 3.
        let fields: Vec<&str> = after.split_whitespace().collect();
        Some((name, fields[41 - 3].parse().ok()?, fields[40 - 3].parse().ok()?))
    };
    folder
        .filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok())
        .filter_map(|id| Some((id, thread(id)?)))
        .collect()
}

const SCHED_OTHER: u32 = 0;
const SCHED_FIFO: u32 = 1;

#[test]
fn only_loop_stop_listener_and_bridge_are_real_time_and_the_daemon_says_what_it_lacks() {
    let place = Place::new("rights");
    let daemon = Running::start(place.job("daemon", &short(&HOLD)));
    let running = wait_for("the loop", || place.status().filter(|status| status.cycles > 200));
    // A client has come and gone by now, and the programme is planned: every helper that there will be has been there.
    let threads = threads(daemon.pid());
    let of = |name: &str| threads.values().find(|thread| thread.0 == name).unwrap_or_else(|| panic!("{threads:?}"));
    let fifo_refused = running.degraded.iter().any(|line| line.contains("SCHED_FIFO"));
    let (bridge, looping) = (threads[&daemon.pid()].clone(), of("plumbline-loop"));
    if fifo_refused {
        assert!(threads.values().all(|thread| thread.1 == SCHED_OTHER), "{threads:?} {:?}", running.degraded);
    } else {
        assert_eq!((looping.1, looping.2), (SCHED_FIFO, 80), "{threads:?}");
        assert_eq!((bridge.1, bridge.2), (SCHED_FIFO, 70), "{threads:?}");
        // A stop is read before requests are, and never delays the loop.
        let listener = of("plumbline-stop");
        assert_eq!((listener.1, listener.2), (SCHED_FIFO, 75), "{threads:?}");
        let real_time: Vec<_> = threads.values().filter(|thread| thread.1 != SCHED_OTHER).collect();
        assert_eq!(real_time.len(), 3, "a helper inherited the loop's priority: {threads:?}");
    }
    // What the kernel says of its own kind is what the daemon says, in the status and in the log.
    let preempt_rt = std::fs::read_to_string("/sys/kernel/realtime").is_ok_and(|text| text.trim() == "1");
    assert_eq!(running.degraded.iter().any(|line| line.contains("PREEMPT_RT")), !preempt_rt, "{:?}", running.degraded);
    let locked = std::fs::read_to_string(format!("/proc/{}/status", daemon.pid())).unwrap();
    let locked: u64 =
        locked.lines().find_map(|l| l.strip_prefix("VmLck:")?.trim().strip_suffix(" kB")?.parse().ok()).unwrap();
    assert_eq!(locked > 0, !running.degraded.iter().any(|line| line.contains("no KiB locked")), "{locked} kB locked");
    let done = quit(&place, daemon);
    for line in &running.degraded {
        assert!(done.err.contains(line.as_str()), "{line}\n{}", done.output());
    }
}

#[test]
fn a_refusal_is_run_with_and_said_or_refused_as_the_job_says() {
    // Degraded: it runs, and says what it lacks while it runs.
    let place = Place::new("degraded");
    let daemon = Running::start(place.job("daemon", &short(&[&HOLD[..], &[NO_CPU]].concat())));
    let running = wait_for("the loop", || place.status().filter(|status| status.cycles > 100));
    assert!(running.degraded.iter().any(|line| line.contains("CPU 1000")), "{:?}", running.degraded);
    quit(&place, daemon);

    // Refused: nothing is driven, and the message names the right that is missing and the key that wants it.
    let place = Place::new("refused");
    let done = Done::of(place.job("daemon", &short(&[&HOLD[..], &[NO_CPU, "realtime.on-refusal=refuse"]].concat())));
    let done = done.expect_code(1);
    assert!(done.err.contains("CPU 1000") && done.err.contains("realtime.on-refusal"), "{}", done.output());

    // Where nothing is asked, nothing is missing.
    let place = Place::new("unasked");
    let nothing = [
        "realtime.priority=0",
        "realtime.lock-memory=false",
        "realtime.preempt-rt=false",
        "realtime.on-refusal=refuse",
    ];
    let daemon = Running::start(place.job("daemon", &short(&[&HOLD[..], &nothing].concat())));
    let running = wait_for("the loop", || place.status().filter(|status| status.cycles > 100));
    assert_eq!(running.degraded, Vec::<String>::new());
    quit(&place, daemon);

    let place = Place::new("unknown-word");
    let done = Done::of(place.job("daemon", &["realtime.on-refusal=maybe"])).expect_code(2);
    assert!(done.err.contains("on-refusal") && done.err.contains("degrade"), "{}", done.output());
}

/// Ends the daemon by command; what it said.
#[track_caller]
fn quit(place: &Place, mut daemon: Running) -> Done {
    let done = place.command("quit");
    if !daemon.runs() && done.code != Some(0) {
        panic!("the daemon had ended: {}", daemon.end().output());
    }
    assert_eq!(done.code, Some(0), "{}", done.output());
    daemon.end().expect_code(0)
}
