//! Torque and model for another user of a group, and states from that user; no request passes. Needs root, else SKIPPED.
//!
//! The users are numbers without an account. The user's program is this test binary with a role in [`ROLE`].

use plumbline_client::{Error, Expected, FeedForwardClient, FeedForwardSettings, Guest, Model};
use plumbline_core::Validity;
use plumbline_ipc::{FeedForwardMessage, GuestDelivery, GuestReceiver, ModelHeader, RobotId, ServerSettings};
use plumbline_model_file::model_identity;
use plumbline_testkit::job::*;
use plumbline_testkit::memory::{Daemon, record, robot};
use std::os::unix::fs::{PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::Ordering;
use std::time::Duration;

const ROLE: &str = "PLUMBLINE_TEST_ROLE";
const ROBOT: &str = "PLUMBLINE_TEST_ROBOT";
const GROUP: u32 = 64_321;
const USER: u32 = 64_322;
const WALL: [f64; 3] = [9.81, 0.0, 0.0];
const STATES: u64 = 300;

/// A program as another user, of the group or not.
fn as_user(of_group: bool, runtime: &Path, program: &Path) -> Command {
    let mut command = Command::new("setpriv");
    command.arg(format!("--reuid={USER}")).arg(format!("--regid={USER}"));
    command.arg(if of_group { format!("--groups={GROUP}") } else { "--clear-groups".into() });
    command.arg(program).env("PLUMBLINE_RUNTIME_DIR", runtime).env_remove("PLUMBLINE_LOG").current_dir("/");
    command
}

fn folder(path: PathBuf, mode: u32, owner: u32, group: u32) -> PathBuf {
    std::fs::create_dir(&path).unwrap();
    chown(&path, Some(owner), Some(group)).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
    path
}

/// The user's controller: follows model and torque, publishes states, and sees the end of the daemon.
#[test]
#[ignore = "a role of the test below"]
fn controller() {
    let Some(name) = std::env::var_os(ROBOT).filter(|_| std::env::var_os(ROLE).is_some()) else { return };
    let name = name.to_str().unwrap();
    let expected = Expected { robot: Some("panda".into()), gravity: Some(WALL) };
    let mut model = Model::follow(name, expected, TIMEOUT).unwrap();
    assert_eq!(model.trouble(), None);
    let (zero, mut tau) = ([0.0; 7], [0.0; 7]);
    model.torque(&zero, &zero, &zero, None, &mut tau).unwrap();
    assert!(tau.iter().any(|tau| tau.abs() > 1.0));
    let id = RobotId::parse("test", "robot", name).unwrap();
    let mut torque = FeedForwardClient::connect(&id, FeedForwardSettings { stale_after_ms: 1000 }, TIMEOUT).unwrap();
    let latest = wait_for("a torque", || torque.latest().unwrap().filter(|latest| latest.usable));
    assert_eq!((latest.message.model, latest.message.gravity), (model.status().model, WALL));
    assert_eq!(latest.message.tau_ff, record(1).command.tau_ff.0);
    assert!(latest.age_ns < 1_000_000_000);
    let mut guest = Guest::open(name, 7).unwrap();
    for k in 0..STATES {
        guest.publish(&[k as f64; 7], &[0.25; 7], &[1.0 / 3.0; 7], &[0.5; 7]).unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(guest.lost(), 0);
    println!("published");
    wait_for("the daemon's end", || matches!(model.trouble(), Some(Error::DaemonGone { .. })));
}

#[test]
fn another_user_of_the_group_follows_and_publishes_and_commands_nothing() {
    if std::fs::metadata("/proc/self").is_ok_and(|own| std::os::unix::fs::MetadataExt::uid(&own) != 0) {
        return eprintln!("SKIPPED: two users: it needs root");
    }
    let place = tempfile::tempdir().unwrap();
    std::fs::set_permissions(place.path(), std::fs::Permissions::from_mode(0o711)).unwrap();
    let sockets = folder(place.path().join("relay"), 0o750, 0, GROUP);
    let runtime = folder(place.path().join("user"), 0o700, USER, USER);
    // The build's folder may be closed to other users.
    let copy = |from: &Path, name: &str| {
        let to = place.path().join(name);
        std::fs::copy(from, &to).unwrap();
        to
    };
    let (program, test) = (copy(&program(), "plumbline"), copy(&std::env::current_exe().unwrap(), "test"));

    let robot = robot("relay");
    let name = robot.as_str();
    let text = std::fs::read_to_string(plumbline_testkit::path("config/models/panda-paper-table3.toml")).unwrap();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let (model, validity) = (model_identity(&text), Validity::Valid as u32);
        server.model(ModelHeader { model, validity, gravity: WALL, ..ModelHeader::default() }, &text);
        while !stop.load(Ordering::Relaxed) {
            let mut record = record(1);
            record.model = model;
            server.feed_forward(FeedForwardMessage::new(&record, 7, WALL, [0.0; 3]));
            server.poll(|request, _| panic!("a request passed the relay: {request:?}"));
            std::thread::sleep(Duration::from_millis(1));
        }
    });
    let mut receiver = GuestReceiver::open(&robot).unwrap();

    let relay = |command: &mut Command, end: &str| {
        command.args(["relay", end, "--robot", name, "--folder"]).arg(&sockets);
        Running::start(command)
    };
    let mut serve = Command::new("setpriv");
    serve.arg(format!("--regid={GROUP}")).arg("--clear-groups").arg(&program);
    let serve = relay(&mut serve, "serve");
    let socket = sockets.join(format!("{name}.sock"));
    wait_for("the socket", || {
        std::fs::symlink_metadata(&socket).is_ok_and(|found| found.permissions().mode() & 0o777 == 0o660)
    });

    // Without the group: the folder is closed.
    let stranger = relay(&mut as_user(false, &runtime, &program), "join").end();
    assert!(stranger.code != Some(0) && stranger.err.contains("Permission denied"), "{}", stranger.output());

    let join = relay(&mut as_user(true, &runtime, &program), "join");
    let controller = |command: &mut Command| {
        let filter = ["relay::controller", "--exact", "--ignored", "--nocapture"];
        Running::start(command.args(filter).env(ROLE, "controller").env(ROBOT, name))
    };
    let controller = controller(&mut as_user(true, &runtime, &test));
    let mut samples = Vec::new();
    wait_for("every state", || {
        for delivery in receiver.receive().unwrap() {
            if let GuestDelivery::Samples(some) = delivery {
                samples.extend(some);
            }
        }
        samples.len() as u64 == STATES
    });
    let expected: Vec<f64> = (0..STATES).map(|k| k as f64).collect();
    assert_eq!(samples.iter().map(|sample| sample.q[6]).collect::<Vec<_>>(), expected);
    assert!(samples.iter().all(|sample| sample.tau[..7] == [1.0 / 3.0; 7]));
    assert_eq!(receiver.rejected(), 0);

    let user = |arguments: &[&str]| Done::of(as_user(true, &runtime, &program).args(arguments).args(["--robot", name]));
    assert!(user(&["torque"]).expect_code(0).out.contains("tau_ff"));
    for what in ["start", "resume", "quit", "adopt", "status"] {
        let refused = user(&["command", what]).expect_code(1);
        assert!(refused.err.contains("a relay passes no requests"), "{}", refused.output());
    }
    user(&["command", "stop"]).expect_code(1);
    // Nor by hand: what is no state ends the connection, and the relay goes on.
    let shout = format!(
        "import socket,struct\ns=socket.socket(socket.AF_UNIX);s.connect('{}')\nt=b'{{\"command\":\"start\"}}'\ns.sendall(struct.pack('<I',len(t))+t)\nwhile s.recv(65536): pass",
        socket.display()
    );
    let python = Done::of(as_user(true, &runtime, Path::new("/usr/bin/env")).args(["python3", "-c", &shout]));
    assert!(python.code == Some(0) || python.err.contains("No such file"), "{}", python.output());
    user(&["torque"]).expect_code(0);

    daemon.stop();
    let controller = controller.end().expect_code(0);
    assert!(controller.out.contains("published"), "{}", controller.output());
    signal(join.pid(), "TERM");
    signal(serve.pid(), "TERM");
    join.end().expect_code(0);
    serve.end().expect_code(0);
    assert!(!socket.exists());
}
