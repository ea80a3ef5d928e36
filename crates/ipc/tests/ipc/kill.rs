//! Killed processes: no retained record is lost, and the next start is clean.
//!
//! The child processes are this test binary with a role in [`ROLE`].

use std::io::{BufRead, BufReader};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use plumbline_ipc::{
    Client, Delivery, FeedForwardClient, FeedForwardMessage, FeedForwardSettings, FollowerEvent, GuestDelivery,
    GuestMessage, GuestPublisher, GuestReceiver, Lock, Presence, Request, Response, RobotId, SampleStream, Server,
    ServerSettings, Status, StreamSettings,
};
use plumbline_testkit::memory::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ROLE: &str = "PLUMBLINE_TEST_ROLE";
const ROBOT: &str = "PLUMBLINE_TEST_ROBOT";
const LOCKS: &str = "PLUMBLINE_TEST_LOCKS";

/// Entry point of the child processes; does nothing without a role.
#[test]
fn child() {
    let Ok(role) = std::env::var(ROLE) else { return };
    let robot = RobotId::parse("test", "robot", &std::env::var(ROBOT).unwrap()).unwrap();
    match role.as_str() {
        "follower" => follow(&robot),
        "guest" => publish_states(&robot),
        "daemon" => serve(&robot, Path::new(&std::env::var(LOCKS).unwrap())),
        other => panic!("no role {other}"),
    }
}

/// Follows the samples for ever and prints its position.
fn follow(robot: &RobotId) {
    let mut stream = SampleStream::connect(robot, StreamSettings::default(), TIMEOUT).unwrap();
    loop {
        let goal = stream.position() + 100;
        read_until(&mut stream, goal, || ());
        println!("at {}", stream.position());
    }
}

/// Publishes the states of an arm for ever.
fn publish_states(robot: &RobotId) {
    let mut publisher = GuestPublisher::open(robot).unwrap();
    for seq in 0.. {
        publisher.send(&[GuestMessage { n: 7, seq, ..GuestMessage::default() }]).unwrap();
        println!("at {seq}");
        std::thread::sleep(Duration::from_micros(500));
    }
}

/// Publishes for ever, with sequence numbers from 0.
fn serve(robot: &RobotId, locks: &Path) {
    let _lock = Lock::take_in(locks, robot).unwrap();
    let mut server = Server::open(robot, ServerSettings::default()).unwrap();
    println!("at {}", server.epoch());
    for cycle in 0.. {
        let record = record(cycle);
        server.publish(&[record]);
        server.feed_forward(FeedForwardMessage::new(&record, 7, [0.0; 3], [0.0; 3]));
        server.poll(|_, served| Response::Status(Box::new(Status { served: served.clone(), ..Status::default() })));
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Child process that is killed (SIGKILL) when dropped.
struct Process {
    child: Child,
    at: Arc<AtomicU64>,
}

impl Process {
    fn start(role: &str, robot: &RobotId, locks: &Path) -> Process {
        Process::of(Command::new(std::env::current_exe().unwrap()), role, robot, locks)
    }

    /// With its own runtime directory: no other process cleans up its resources.
    fn with_own_directory(role: &str, robot: &RobotId, place: &Path) -> Process {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.env(plumbline_ipc::runtime_dir::VARIABLE, place);
        Process::of(command, role, robot, place)
    }

    fn of(mut command: Command, role: &str, robot: &RobotId, locks: &Path) -> Process {
        let mut child = command
            .args(["kill::child", "--exact", "--nocapture"])
            .env(ROLE, role)
            .env(ROBOT, robot.as_str())
            .env(LOCKS, locks)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let at = Arc::new(AtomicU64::new(0));
        let (lines, seen) = (BufReader::new(child.stdout.take().unwrap()), at.clone());
        std::thread::spawn(move || {
            for line in lines.lines().map_while(Result::ok) {
                if let Some(number) = line.rsplit("at ").next().and_then(|number| number.parse().ok()) {
                    seen.store(number, Ordering::Relaxed);
                }
            }
        });
        Process { child, at }
    }

    /// The last number that it printed.
    fn at(&self) -> u64 {
        self.at.load(Ordering::Relaxed)
    }
}

impl Drop for Process {
    /// Kills and waits for the child. A child that ended by itself has failed.
    fn drop(&mut self) {
        let ended = self.child.try_wait().unwrap();
        assert!(ended.is_none() || std::thread::panicking(), "the child ended by itself: {ended:?}");
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

#[test]
fn the_successor_of_a_killed_follower_receives_every_record_and_the_daemon_never_blocks() {
    let robot = robot("killed-follower");
    let directory = tempfile::tempdir().unwrap();
    let published = Arc::new(AtomicU64::new(0));
    let news = Arc::new(Mutex::new(Vec::new()));
    let (count, events) = (published.clone(), news.clone());
    let daemon = Daemon::start(&robot, ServerSettings { silent_ms: 300, ..Default::default() }, move |server, stop| {
        let mut next = 0;
        while !stop.load(Ordering::Relaxed) {
            server.publish(&(next..next + 10).map(record).collect::<Vec<_>>());
            next += 10;
            count.store(next, Ordering::Relaxed);
            server.poll(|_, _| unreachable!());
            events.lock().unwrap().extend(std::iter::from_fn(|| server.take_follower_event()));
            std::thread::sleep(Duration::from_micros(500));
        }
        poll_until(server, stop);
        server.served()
    });

    let mut random = ChaCha8Rng::seed_from_u64(4);
    for round in 1..=5 {
        let follower = Process::start("follower", &robot, directory.path());
        wait_for("the follower's progress", || follower.at() > 1000);
        std::thread::sleep(Duration::from_millis(random.random_range(0..30)));
        let pid = follower.child.id();
        drop(follower);
        let at_death = published.load(Ordering::Relaxed);
        let died = |news: &&FollowerEvent| matches!(news, FollowerEvent::Died { pid: dead, .. } if *dead == pid);
        wait_for("the event of its death", || news.lock().unwrap().iter().find(died).is_some());
        // The daemon continued meanwhile.
        assert!(published.load(Ordering::Relaxed) > at_death, "round {round}");
    }

    let mut successor = SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
    let end = published.load(Ordering::Relaxed) + 5000;
    assert!(read_until(&mut successor, end, || ()).is_empty());
    let counters = successor.counters();
    assert!(counters.received >= end && counters.missed == 0 && counters.replayed > 0, "{counters:?}");
    drop(successor);
    let served = daemon.stop();
    assert_eq!((served.unsent_batches, served.given_up_unacknowledged), (0, 0));
}

#[test]
fn after_a_killed_daemon_the_next_start_is_clean() {
    let robot = robot("killed-daemon");
    let directory = tempfile::tempdir().unwrap();
    let locks = directory.path();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut daemon = Process::start("daemon", &robot, locks);
    let mut stream = SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
    let mut client = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();

    for round in 1..=5 {
        wait_for("the daemon's start", || daemon.at() != 0);
        let epoch = daemon.at();
        read_until(&mut stream, 500, || ());
        assert_eq!(stream.epoch(), epoch);
        wait_for("a value", || client.latest().unwrap().is_some_and(|value| value.message.epoch == epoch));
        assert_eq!(client.daemon(), Presence::Running);
        assert!(Lock::take_in(locks, &robot).is_err());

        std::thread::sleep(Duration::from_millis(random.random_range(0..20)));
        drop(daemon);
        assert_eq!(client.daemon(), Presence::Gone, "round {round}");
        drop(Lock::take_in(locks, &robot).expect("a killed daemon leaves no lock"));
        // The follower receives the remaining records, then detects the missing daemon.
        wait_for("the detection of the daemon's end", || {
            matches!(stream.next(Duration::from_millis(20)).unwrap(), Delivery::Gone)
        });

        daemon = Process::start("daemon", &robot, locks);
        let mut restarted = None;
        wait_for("the detection of the next daemon", || {
            if let Delivery::Restarted { epoch } = stream.next(Duration::from_millis(20)).unwrap() {
                restarted = Some(epoch);
            }
            restarted.is_some()
        });
        wait_for("the daemon's start", || daemon.at() != 0);
        assert_eq!(restarted, Some(daemon.at()));
        assert_eq!(stream.position(), 0);
        assert_eq!(stream.counters().restarts, round);
    }
    assert_eq!(stream.counters().missed, 0);

    // A new client connects to the running daemon.
    let mut commands = Client::connect(&robot, TIMEOUT).unwrap();
    let Response::Status(status) = commands.send(&Request::Status {}, TIMEOUT).unwrap() else { panic!() };
    assert_eq!(status.served.epoch, daemon.at());
    assert_eq!(status.served.trouble, None);
}

/// Connection files in shared memory with an end in this process. Their names contain both ends' ids; bits 64 to 95 of an id are the
/// process.
fn connections_of(pid: u32) -> Vec<PathBuf> {
    let of = |path: &Path| {
        let Some(ends) = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".connection")) else {
            return false;
        };
        ends.split('_').filter_map(|id| id.parse::<u128>().ok()).any(|id| (id >> 64) as u32 == pid)
    };
    let files = std::fs::read_dir("/dev/shm").unwrap().map(|entry| entry.unwrap().path());
    files.filter(|path| of(path)).collect()
}

#[test]
fn an_incomplete_connection_of_a_killed_process_does_not_block_the_next_daemon() {
    let robot = robot("half-made");
    let place = tempfile::tempdir().unwrap();
    let daemon = Process::with_own_directory("daemon", &robot, place.path());
    wait_for("the daemon", || daemon.at() > 0);
    let follower = Process::with_own_directory("follower", &robot, place.path());
    wait_for("the follower's progress", || follower.at() > 100);
    let pid = follower.child.id();
    drop(follower);
    drop(daemon);

    // The state between creating the file and setting its size.
    let incomplete = connections_of(pid);
    assert!(!incomplete.is_empty());
    for path in &incomplete {
        std::fs::File::options().write(true).open(path).unwrap().set_len(0).unwrap();
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o200)).unwrap();
    }
    let next = Process::with_own_directory("daemon", &robot, place.path());
    wait_for("the next daemon", || next.at() > 0);
    assert!(incomplete.iter().all(|path| !path.exists()));
}

#[test]
fn the_successor_of_a_killed_publisher_of_states_is_received() {
    let robot = robot("killed-guest");
    let directory = tempfile::tempdir().unwrap();
    let mut receiver = GuestReceiver::open(&robot).unwrap();
    let mut epochs = Vec::new();
    for round in 0..5 {
        let publisher = Process::start("guest", &robot, directory.path());
        let mut newest = 0;
        wait_for("its samples", || {
            for delivery in receiver.receive().unwrap() {
                match delivery {
                    GuestDelivery::Started { epoch } => (newest, epochs) = (0, [epochs.clone(), vec![epoch]].concat()),
                    GuestDelivery::Samples(samples) => newest = samples.last().unwrap().seq,
                    GuestDelivery::Lost { .. } => {}
                }
            }
            epochs.len() == round + 1 && newest > 100
        });
        assert!(receiver.is_published());
        // In mid-motion.
        drop(publisher);
        assert!(!receiver.is_published(), "round {round}");
    }
    assert_eq!(receiver.rejected(), 0);
}
