//! A foreign file with plumbline's prefix in shared memory: a new daemon is refused, clients of a running daemon still connect.
//!
//! The test runs itself in a mount namespace with its own `/dev/shm`: in the machine's it would stop the daemons of other tests.

use std::os::unix::fs::symlink;
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

use plumbline_ipc::{
    Client, FeedForwardClient, FeedForwardSettings, Request, Response, SampleStream, Server, ServerSettings,
    StreamSettings,
};
use plumbline_testkit::memory::*;

/// Environment variable, set for the run in the namespace.
const INSIDE: &str = "PLUMBLINE_TEST_FOREIGN_FILES";
const OWN_MEMORY: &str = "mount -t tmpfs tmpfs /dev/shm";

fn in_namespace(script: &str) -> Command {
    let mut command = Command::new("unshare");
    command.args(["--map-root-user", "--mount", "sh", "-c", script]);
    command
}

#[test]
fn clients_connect_to_a_running_daemon_despite_a_foreign_file() {
    if std::env::var_os(INSIDE).is_some() {
        return inside();
    }
    if !in_namespace(OWN_MEMORY).output().is_ok_and(|tried| tried.status.success()) {
        eprintln!("SKIPPED: no namespace can be created on this machine");
        return;
    }
    let names = tempfile::tempdir().unwrap();
    let script = format!(
        "{OWN_MEMORY} && exec \"$0\" --exact foreign_files::clients_connect_to_a_running_daemon_despite_a_foreign_file"
    );
    let mut again = in_namespace(&script);
    again.arg(std::env::current_exe().unwrap()).env(INSIDE, "1").env("PLUMBLINE_RUNTIME_DIR", names.path());
    let run = again.output().unwrap();
    let output = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
    assert!(run.status.success() && output.contains("1 passed"), "{output}");
}

fn inside() {
    let robot = robot("foreign-files");
    let daemon = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        while !stop.load(Ordering::Relaxed) {
            server.poll(|_, _| Response::Refused { reason: "received".into() });
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let ask = || Client::connect(&robot, TIMEOUT).unwrap().send(&Request::Status {}, TIMEOUT).unwrap();
    ask();
    // A symbolic link is rejected like another user's file, and needs no second user.
    let foreign = format!("/dev/shm/plumbline_{}_x", rustix::process::geteuid().as_raw());
    symlink("/etc/hostname", &foreign).unwrap();

    assert!(matches!(ask(), Response::Refused { reason } if reason == "received"));
    SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
    FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();
    let refused = Server::open(&plumbline_testkit::memory::robot("second"), ServerSettings::default()).err().unwrap();
    assert!(refused.to_string().contains(&foreign), "{refused}");
    daemon.stop();
}
