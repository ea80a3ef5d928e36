//! What the daemon and the estimator tell systemd, and what they refuse when they run as services. systemd is played by a socket of
//! this test's own.

use plumbline_testkit::job::*;
use std::os::unix::net::UnixDatagram;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

/// As a unit's WatchdogSec=; short, so that the test is.
const WATCHDOG: Duration = Duration::from_secs(2);

/// The end of the notify socket that systemd would hold: read at once, whether the test asks or not, for a sender waits where nobody reads.
struct FakeSystemd(Receiver<String>);

impl FakeSystemd {
    fn listen(place: &Place) -> FakeSystemd {
        let socket = UnixDatagram::bind(place.path().join("notify")).unwrap();
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(length) = socket.recv(&mut buffer) {
                if sender.send(String::from_utf8_lossy(&buffer[..length]).into_owned()).is_err() {
                    break;
                }
            }
        });
        FakeSystemd(receiver)
    }

    /// Every message that arrives within `time`, and those that nobody has asked for yet.
    fn hear(&self, time: Duration) -> Vec<String> {
        let deadline = Instant::now() + time;
        let left = || deadline.saturating_duration_since(Instant::now());
        std::iter::from_fn(|| self.0.recv_timeout(left()).ok()).collect()
    }

    /// Waits for a message that contains `text`.
    #[track_caller]
    fn await_word(&self, text: &str) {
        wait_for(text, || self.hear(Duration::from_millis(20)).iter().any(|word| word.contains(text)).then_some(()));
    }
}

fn beats(heard: &[String]) -> usize {
    heard.iter().filter(|word| word.lines().any(|line| line == "WATCHDOG=1")).count()
}

/// A process that believes that systemd started it. The watchdog's variables name no process, as where a shell is in between.
fn as_service(place: &Place, subcommand: &str, more: &[&str]) -> Running {
    as_watched(place, subcommand, WATCHDOG, more)
}

fn as_watched(place: &Place, subcommand: &str, watchdog: Duration, more: &[&str]) -> Running {
    // How late a cycle may come is the machine's business, not this test's: no loss stops the arm.
    let mut sets = vec!["backend.pace=wall-clock", "realtime.lock-memory=false", "safety.max-lost=1000"];
    sets.extend(more);
    let mut command = place.job(subcommand, &short(&sets));
    command.env("NOTIFY_SOCKET", place.path().join("notify"));
    command.env("WATCHDOG_USEC", watchdog.as_micros().to_string()).env_remove("WATCHDOG_PID");
    Running::start(command)
}

#[test]
fn the_watchdog_is_fed_while_the_loop_turns_and_not_when_it_stands() {
    let place = Place::new("watchdog");
    let systemd = FakeSystemd::listen(&place);
    let daemon = as_service(&place, "daemon", &[]);
    systemd.await_word("READY=1\nSTATUS=at rest");
    // Four times per limit at least, as long as the loop turns.
    systemd.hear(Duration::ZERO);
    let fed = beats(&systemd.hear(2 * WATCHDOG));
    assert!((4..=40).contains(&fed), "{fed} beats in two limits");

    // The whole process stands: the loop does not turn, nobody is told otherwise.
    signal(daemon.pid(), "STOP");
    systemd.hear(Duration::from_millis(200));
    assert_eq!(beats(&systemd.hear(WATCHDOG)), 0);
    signal(daemon.pid(), "CONT");
    systemd.await_word("WATCHDOG=1");
    place.command("quit").expect_code(0);
    systemd.await_word("STOPPING=1");
    daemon.end().expect_code(0);
}

#[test]
fn a_systemd_that_has_died_does_not_hold_up_the_daemon() {
    let place = Place::new("deaf");
    // A socket that nobody reads takes some messages, then its senders wait.
    let _deaf = UnixDatagram::bind(place.path().join("notify")).unwrap();
    let daemon = as_watched(&place, "daemon", Duration::from_millis(20), &[]);
    let cycles = || place.status().map(|status| status.cycles);
    // A beat per 5 ms: in this time a few hundred, many more than a socket holds.
    wait_for("two seconds of cycles", || cycles().filter(|&cycles| cycles > 2_000));
    place.quit(daemon);
}

#[test]
fn a_restarted_daemon_only_holds() {
    let place = Place::new("holds");
    let systemd = FakeSystemd::listen(&place);
    let status = || place.status();
    let mut daemon = as_service(&place, "daemon", &[]);
    for round in 0..2 {
        systemd.await_word("READY=1");
        place.command("start").expect_code(0);
        systemd.await_word("STATUS=moving");
        wait_for("motion", || {
            let now = status()?;
            assert!(now.stopped.is_none(), "round {round}: {now:?}");
            (now.motion != 0).then_some(())
        });
        signal(daemon.pid(), "KILL");
        assert_eq!(daemon.end().code, None);

        let killed = Instant::now();
        daemon = as_service(&place, "daemon", &[]);
        let first = wait_for("the next daemon", status);
        let up = killed.elapsed();
        assert_eq!(first.served.trouble, None, "round {round}");
        // It turns, and it does not move.
        let watched = Instant::now();
        while watched.elapsed() < Duration::from_secs(1) {
            let now = wait_for("the daemon", status);
            assert_eq!((now.phase, now.motion), (plumbline_core::Phase::Hold, 0), "round {round}, up after {up:?}");
            assert_eq!(now.progress, plumbline_ipc::Progress::Idle);
        }
        wait_for("cycles", || (status()?.cycles > 100).then_some(()));
    }
    place.quit(daemon);
}

#[test]
fn an_estimator_is_ready_before_there_is_a_daemon_and_survives_its_end() {
    let place = Place::new("waits");
    let systemd = FakeSystemd::listen(&place);
    let mut estimator = as_service(&place, "estimator", &[]);
    systemd.await_word("READY=1");
    let mut daemon = Running::start(place.job("daemon", &short(&["backend.pace=wall-clock"])));
    systemd.await_word("STATUS=follows the samples");
    assert!(beats(&systemd.hear(2 * WATCHDOG)) >= 2);
    if !daemon.runs() {
        panic!("the daemon has ended: {}", daemon.end().output());
    }
    place.quit(daemon);
    assert!(estimator.runs());
    signal(estimator.pid(), "TERM");
    estimator.end();
}

#[test]
fn files_that_others_can_change_set_no_limits_of_a_service() {
    use std::os::unix::fs::PermissionsExt;
    let place = Place::new("owners");
    let file = place.path().join("job.toml");
    std::fs::copy(std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(WALL), &file).unwrap();
    std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o646)).unwrap();
    let daemon = |file: &std::path::Path| {
        Done::of(plumbline().args(["daemon", "--root-owned"]).arg(file).arg("--out").arg(place.out()))
    };
    // Root is told of the mode, anybody else of the owner.
    let refused = daemon(&file).expect_code(2);
    assert!(
        refused.err.contains(file.to_str().unwrap()) && refused.err.contains("belong to root"),
        "{}",
        refused.output()
    );
    assert!(refused.err.contains("(mode 646)") || refused.err.contains("belongs to user"), "{}", refused.output());
}
