//! A client whose clock is not the daemon's, as on another machine: in a time namespace of its own.

use std::fs;
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

use plumbline_ipc::{FeedForwardClient, FeedForwardMessage, FeedForwardSettings, RobotId, ServerSettings};
use plumbline_testkit::memory::*;

const ROBOT: &str = "PLUMBLINE_TEST_CLOCK_ROBOT";
/// Values that the client reads.
const VALUES: usize = 2000;
/// Far below the difference of the clocks, far above any pause of a test machine.
const MAX_AGE_NS: u64 = 60_000_000_000;

/// Entry point of the client's process; does nothing without a robot.
#[test]
fn child() {
    let Ok(robot) = std::env::var(ROBOT) else { return };
    let robot = RobotId::parse("test", "robot", &robot).unwrap();
    let mut client = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();
    let (mut ages, mut last) = (Vec::new(), 0);
    while ages.len() < VALUES {
        if let Some(latest) = client.latest().unwrap().filter(|latest| latest.message.sequence > last) {
            last = latest.message.sequence;
            ages.push(latest.age_ns);
        }
        std::thread::sleep(Duration::from_micros(100));
    }
    ages.sort_unstable();
    let us = |share: f64| ages[(share * (VALUES - 1) as f64) as usize] as f64 * 1e-3;
    println!("age p50 {:.1}, p99 {:.1}, max {:.1} us", us(0.5), us(0.99), us(1.0));
    assert!(ages[VALUES - 1] < MAX_AGE_NS, "{} ns", ages[VALUES - 1]);
    assert_eq!(client.rejected(), 0);
}

#[test]
fn a_client_with_another_clock_gives_ages_beyond_the_fastest_transit() {
    let uptime = fs::read_to_string("/proc/uptime").unwrap();
    let uptime = uptime.split('.').next().unwrap().parse::<i64>().unwrap();
    let in_namespace = |seconds: i64| {
        let mut unshare = Command::new("unshare");
        unshare.args(["--time", "--boottime", &seconds.to_string(), "--fork", "--kill-child"]);
        unshare
    };
    match in_namespace(1).arg("true").output() {
        Ok(out) if out.status.success() => {}
        Ok(out) => return eprintln!("SKIPPED: unshare --time: {}", String::from_utf8_lossy(&out.stderr)),
        Err(error) => return eprintln!("SKIPPED: unshare: {error}"),
    }
    let robot = robot("clock");
    let daemon = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        let mut cycle = 0;
        while !stop.load(Ordering::Relaxed) {
            cycle += 1;
            server.feed_forward(FeedForwardMessage::new(&record(cycle), 7, [0.0; 3], [0.0; 3]));
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    // Ahead by a day; behind by as much as a machine that has just started can be.
    for seconds in [86_400, -uptime / 2] {
        let out = in_namespace(seconds)
            .arg(std::env::current_exe().unwrap())
            .args(["clock::child", "--exact", "--nocapture"])
            .env(ROBOT, robot.as_str())
            .output()
            .unwrap();
        let (stdout, stderr) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
        assert!(out.status.success(), "{seconds} s: {stdout}{stderr}");
        let ages = stdout.lines().find(|line| line.contains("age p50")).expect("a line");
        println!("{seconds:+} s: {ages}");
    }
    daemon.stop();
}
