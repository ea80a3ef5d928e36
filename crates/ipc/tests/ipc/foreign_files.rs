//! A file of the daemon's names that somebody else has laid into shared memory: whoever serves is refused, whoever wants the arm stopped is not.
//!
//! The test runs once more in a mount namespace with a `/dev/shm` of its own: in the machine's it would keep every other test's daemon down.

use std::os::unix::fs::symlink;
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

use plumbline_ipc::{
    Client, FeedForwardClient, FeedForwardSettings, Request, Response, SampleStream, Server, ServerSettings,
    StreamSettings,
};
use plumbline_testkit::memory::*;

/// Set for the run in the namespace.
const INSIDE: &str = "PLUMBLINE_TEST_SQUATTERS";
const OWN_MEMORY: &str = "mount -t tmpfs tmpfs /dev/shm";

fn in_namespace(script: &str) -> Command {
    let mut command = Command::new("unshare");
    command.args(["--map-root-user", "--mount", "sh", "-c", script]);
    command
}

#[test]
fn a_squatter_keeps_no_client_from_a_running_daemon() {
    if std::env::var_os(INSIDE).is_some() {
        return inside();
    }
    if !in_namespace(OWN_MEMORY).output().is_ok_and(|tried| tried.status.success()) {
        eprintln!("not tried: this machine lets nobody make a namespace");
        return;
    }
    let names = tempfile::tempdir().unwrap();
    let script =
        format!("{OWN_MEMORY} && exec \"$0\" --exact squatters::a_squatter_keeps_no_client_from_a_running_daemon");
    let mut again = in_namespace(&script);
    again.arg(std::env::current_exe().unwrap()).env(INSIDE, "1").env("PLUMBLINE_RUNTIME_DIR", names.path());
    let run = again.output().unwrap();
    let said = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
    assert!(run.status.success() && said.contains("1 passed"), "{said}");
}

fn inside() {
    let robot = robot("squatters");
    let daemon = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        while !stop.load(Ordering::Relaxed) {
            server.poll(|_, _| Response::Refused { reason: "heard".into() });
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let ask = || Client::connect(&robot, PATIENCE).unwrap().send(&Request::Status {}, PATIENCE).unwrap();
    ask();
    // A link is as bad as another user's file, and can be laid without a second user.
    let squat = format!("/dev/shm/plumbline_{}_x", rustix::process::geteuid().as_raw());
    symlink("/etc/hostname", &squat).unwrap();

    assert!(matches!(ask(), Response::Refused { reason } if reason == "heard"));
    SampleStream::connect(&robot, StreamSettings::default(), PATIENCE).unwrap();
    FeedForwardClient::connect(&robot, FeedForwardSettings::default(), PATIENCE).unwrap();
    let refused = Server::open(&plumbline_testkit::memory::robot("second"), ServerSettings::default()).err().unwrap();
    assert!(refused.to_string().contains(&squat), "{refused}");
    daemon.stop();
}
