//! Fixtures for tests of inter-process communication: a server on a thread, distinct records.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub use crate::wait::{TIMEOUT, wait_for};
use plumbline_core::{Phase, Record, Validity};
use plumbline_ipc::{Delivery, RobotId, SampleStream, Server, ServerSettings, now_ns};

pub fn robot(test: &str) -> RobotId {
    RobotId::parse("test", "robot", &format!("test-{test}-{}", std::process::id())).unwrap()
}

/// Record number `cycle`, every part of which depends on that number.
pub fn record(cycle: u64) -> Record {
    let mut record = Record { cycle, motion: cycle as u32, tick: !cycle, phase: Phase::Excite, ..Record::default() };
    record.validity = Validity::Valid;
    record.state.seq = cycle + 7;
    record.state.q = std::array::from_fn(|i| cycle as f64 + i as f64 / 8.0);
    record.command.tau_ff.0 = record.state.q.map(|q| -q);
    record.stamp_ns = now_ns();
    record
}

/// Whether two records are equal but for their time.
pub fn assert_is_record(record_: &Record, cycle: u64) {
    assert_eq!(*record_, Record { stamp_ns: record_.stamp_ns, ..record(cycle) });
}

/// A server on its own thread, because `Server` is not `Send`.
pub struct Daemon<T> {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<T>,
}

impl<T: Send + 'static> Daemon<T> {
    /// Runs `body` with a server; it should return when the flag is set.
    pub fn start(
        robot: &RobotId,
        settings: ServerSettings,
        body: impl FnOnce(&mut Server, &AtomicBool) -> T + Send + 'static,
    ) -> Daemon<T> {
        let stop = Arc::new(AtomicBool::new(false));
        let (robot, flag) = (robot.clone(), stop.clone());
        let thread = std::thread::spawn(move || body(&mut Server::open(&robot, settings).unwrap(), &flag));
        Daemon { stop, thread }
    }

    pub fn stop(self) -> T {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// Polls until the flag is set.
pub fn poll_until(server: &mut Server, stop: &AtomicBool) {
    while !stop.load(Ordering::Relaxed) {
        server.poll(|_, _| unreachable!("nobody sends commands"));
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Reads until record `end` has been delivered, checking order, completeness and content; returns the ranges missed.
pub fn read_until(stream: &mut SampleStream, end: u64, mut pause: impl FnMut()) -> Vec<(u64, u64)> {
    let start = Instant::now();
    let mut expected = stream.position();
    let mut missed = Vec::new();
    while expected < end {
        assert!(start.elapsed() < TIMEOUT, "stuck at {expected} of {end}: {:?}", stream.counters());
        match stream.next(Duration::from_millis(100)).unwrap() {
            Delivery::Records { first, records } => {
                assert_eq!(first, expected);
                for record in &records {
                    assert_is_record(record, expected);
                    expected += 1;
                }
                pause();
            }
            Delivery::Missed { from, to } => {
                assert_eq!(from, expected);
                expected = to;
                missed.push((from, to));
            }
            Delivery::Idle => {}
            other => panic!("{other:?} at {expected}"),
        }
    }
    missed
}
