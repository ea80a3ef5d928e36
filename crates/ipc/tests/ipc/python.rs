//! The Python client of the feed-forward torque against the Rust server.

use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use plumbline_ipc::{FeedForwardMessage, RobotId, Server, ServerSettings};
use plumbline_testkit::memory::*;
use plumbline_testkit::peers::interpreter;

/// Runs the client and returns its standard output.
fn torque_follow(python: &str, robot: &RobotId, options: &[&str]) -> String {
    let client = plumbline_testkit::path("examples/clients/python/torque_follow.py");
    let out = Command::new(python)
        .arg(client)
        .args(["--robot", robot.as_str(), "--wait", "20"])
        .args(options)
        .output()
        .unwrap();
    let (stdout, stderr) = (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    assert!(out.status.success(), "{stdout}{stderr}");
    stdout.into_owned()
}

/// The numbers after `word` on each line with a torque.
fn column(text: &str, word: &str) -> Vec<f64> {
    let after = |line: &str| line.split(word).nth(1).and_then(|rest| rest.split_whitespace().next()?.parse().ok());
    text.lines()
        .filter(|line| line.contains("tau"))
        .map(|line| after(line).unwrap_or_else(|| panic!("{line}")))
        .collect()
}

/// Publishes a value every millisecond whose torque follows from its sequence number.
fn serve(server: &mut Server, stop: &AtomicBool, sent: &AtomicU64) {
    while !stop.load(Ordering::Relaxed) {
        let cycle = sent.load(Ordering::Relaxed) + 1;
        server.feed_forward(FeedForwardMessage::new(&record(cycle), 7, [0.0, 0.0, -9.81], [0.0, 0.0, -9.81]));
        sent.store(cycle, Ordering::Relaxed);
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[test]
fn the_python_client_reads_the_values_of_the_rust_server() {
    let Some(python) = interpreter() else { return };
    let robot = robot("python");
    let sent = Arc::new(AtomicU64::new(0));
    let counter = sent.clone();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| serve(server, stop, &counter));

    let text = torque_follow(&python, &robot, &["--count", "50", "--stale-ms", "60000"]);
    let (seq, tau) = (column(&text, "seq"), column(&text, "tau"));
    assert_eq!(seq.len(), 50);
    assert!(seq.windows(2).all(|pair| pair[0] < pair[1]), "{text}");
    for (seq, tau) in seq.iter().zip(&tau) {
        assert_eq!(*tau, -seq, "{text}");
    }
    assert!(text.lines().all(|line| line.contains("  excite  ") && !line.contains("STALE")), "{text}");
    assert!(column(&text, "age").iter().all(|age| (0.0..60_000.0).contains(age)), "{text}");

    // A slow client skips values and gets the latest each time; the server continues.
    let before = sent.load(Ordering::Relaxed);
    let text = torque_follow(&python, &robot, &["--count", "4", "--slow", "0.1"]);
    let seq = column(&text, "seq");
    assert!(seq.windows(2).all(|pair| pair[1] > pair[0] + 1.0), "{text}");
    assert!(seq[0] > before as f64);

    // With a limit of 0 ms every value is stale.
    let text = torque_follow(&python, &robot, &["--count", "3", "--stale-ms", "0"]);
    assert_eq!(text.lines().filter(|line| line.ends_with("STALE")).count(), 3, "{text}");
    daemon.stop();
}
