//! A log that is not read: a full pipe, a closed one, a journal that stalls. The daemon drives on, answers, and ends when it is told to.

use plumbline_core::Phase;
use plumbline_ipc::{Delivery, Progress, RobotId, SampleStream, StreamSettings};
use plumbline_testkit::job::*;
use std::fs::{File, OpenOptions};
use std::io::{ErrorKind, PipeReader, PipeWriter, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

const INSIDE: &str = "PLUMBLINE_TEST_JOURNAL";
/// A `/run` of its own: the journal's socket has a fixed name there.
const OWN_RUN: &str = "mount -t tmpfs tmpfs /run && mkdir -p /run/systemd/journal";

/// A daemon whose standard error is the test's business; killed when the test ends before it does.
struct Daemon(Child);

impl Daemon {
    fn start(place: &Place, error: impl Into<Stdio>, variables: &[(&str, String)]) -> Daemon {
        let mut command = place.job("daemon", &short(&LONG_ON_CLOCK));
        command.stdout(Stdio::null()).stderr(error).envs(variables.iter().map(|(name, value)| (name, value)));
        Daemon(command.spawn().unwrap())
    }

    fn into_motion(self, place: &Place) -> Daemon {
        wait_for("the daemon", || place.status());
        place.command("start").expect_code(0);
        place.await_motion();
        self
    }

    /// Its exit code, which must come.
    #[track_caller]
    fn end(mut self) -> Option<i32> {
        let start = Instant::now();
        loop {
            if let Some(ended) = self.0.try_wait().unwrap() {
                return ended.code();
            }
            assert!(start.elapsed() < Duration::from_secs(60), "the daemon does not end");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Daemon {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Fills a pipe to its last byte through a description of the test's own: the daemon's end stays a blocking one.
fn fill(pipe: &PipeWriter) {
    let name = format!("/proc/self/fd/{}", pipe.as_raw_fd());
    let mut own = OpenOptions::new().write(true).custom_flags(libc::O_NONBLOCK).open(name).unwrap();
    for size in [4096, 1] {
        while own.write(&vec![b'\n'; size]).is_ok() {}
    }
    assert_eq!(own.write(b"\n").unwrap_err().kind(), ErrorKind::WouldBlock);
}

/// Everything that comes within some time.
fn drain(mut pipe: PipeReader) -> std::thread::JoinHandle<String> {
    std::thread::spawn(move || {
        let mut text = Vec::new();
        pipe.read_to_end(&mut text).unwrap();
        String::from_utf8_lossy(&text).into_owned()
    })
}

/// While the log stalls: the daemon logs, answers every question, loses no record, and stops the arm when it is told to.
#[track_caller]
fn drives_on(place: &Place) {
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    // Each of these is a line of the log.
    let mut stream = SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
    let begin = place.status().expect("an answer").cycles;
    let mut received = 0;
    for _ in 0..10 {
        place.command("status").expect_code(0);
        let until = Instant::now() + Duration::from_millis(100);
        while Instant::now() < until {
            match stream.next(Duration::from_millis(20)).unwrap() {
                Delivery::Records { records, .. } => received += records.len(),
                Delivery::Idle | Delivery::Restarted { .. } => {}
                other => panic!("{other:?}"),
            }
        }
    }
    let now = place.status().expect("an answer");
    assert!(now.cycles > begin + 500 && received > 500, "{begin} to {} cycles, {received} records", now.cycles);
    assert_eq!((now.dropped_records, now.progress, now.stopped), (0, Progress::Driving, None));
    place.command("stop").expect_code(0);
    wait_for("the stop", || place.status().filter(|now| now.phase == Phase::Stopped));
}

#[test]
fn a_full_pipe_costs_lines_of_the_log_and_nothing_else() {
    let place = Place::new("log-full");
    let (reader, writer) = std::io::pipe().unwrap();
    let daemon = Daemon::start(&place, writer.try_clone().unwrap(), &[]).into_motion(&place);
    fill(&writer);
    drives_on(&place);
    signal(daemon.0.id(), "TERM");
    assert_eq!(daemon.end(), Some(0));
    drop((reader, writer));
}

#[test]
fn lines_that_waited_for_their_reader_arrive() {
    let place = Place::new("log-late");
    let (reader, writer) = std::io::pipe().unwrap();
    let daemon = Daemon::start(&place, writer.try_clone().unwrap(), &[]).into_motion(&place);
    fill(&writer);
    drives_on(&place);
    drop(writer);
    let text = drain(reader);
    signal(daemon.0.id(), "TERM");
    assert_eq!(daemon.end(), Some(0));
    let text = text.join().unwrap();
    for words in
        ["is ready", "follows the samples", "the arm is being stopped", "signal SIGTERM arrived", "the daemon ends"]
    {
        assert!(text.contains(words), "no `{words}`: {text}");
    }
}

#[test]
fn a_closed_pipe_does_not_end_the_daemon() {
    let place = Place::new("log-closed");
    let (reader, writer) = std::io::pipe().unwrap();
    let daemon = Daemon::start(&place, writer, &[]).into_motion(&place);
    drop(reader);
    drives_on(&place);
    signal(daemon.0.id(), "TERM");
    assert_eq!(daemon.end(), Some(0));
}

#[test]
fn a_journal_that_stalls_costs_lines_of_the_log_and_nothing_else() {
    if std::env::var_os(INSIDE).is_some() {
        return beside_a_stalled_journal();
    }
    if !in_namespace(OWN_RUN).output().is_ok_and(|tried| tried.status.success()) {
        return eprintln!("SKIPPED: this machine lets nobody make a namespace");
    }
    let names = tempfile::tempdir().unwrap();
    let test = "blocked_log::a_journal_that_stalls_costs_lines_of_the_log_and_nothing_else";
    let mut again = in_namespace(&format!("{OWN_RUN} && exec \"$0\" --exact {test} --nocapture"));
    again.arg(std::env::current_exe().unwrap()).env(INSIDE, "1").env("PLUMBLINE_RUNTIME_DIR", names.path());
    let run = again.output().unwrap();
    let message = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
    assert!(run.status.success() && message.contains("1 passed"), "{message}");
}

fn beside_a_stalled_journal() {
    const SOCKET: &str = "/run/systemd/journal/socket";
    let journal = UnixDatagram::bind(SOCKET).unwrap();
    journal.set_nonblocking(true).unwrap();
    let entries = || {
        let mut buffer = vec![0; 1 << 18];
        let mut text = String::new();
        while let Ok(length) = journal.recv(&mut buffer) {
            text += &String::from_utf8_lossy(&buffer[..length]);
        }
        text
    };
    let place = Place::new("log-journal");
    let file = place.path().join("stream");
    let stream = File::create(&file).unwrap();
    let name = stream.metadata().map(|found| format!("{}:{}", found.dev(), found.ino())).unwrap();
    let daemon = Daemon::start(&place, stream, &[("JOURNAL_STREAM", name)]);
    // Some journals hold no more than ten entries: they are read until the arm moves.
    let mut before = String::new();
    wait_for("the daemon", || {
        before += &entries();
        place.status()
    });
    let daemon = daemon.into_motion(&place);
    let words = ["is ready", "has started", "PLUMBLINE_ROBOT", "PLUMBLINE_EVENT", &place.id];
    wait_for("the entries of the start", || {
        before += &entries();
        words.iter().all(|words| before.contains(words)).then_some(())
    });

    let stranger = UnixDatagram::unbound().unwrap();
    stranger.set_nonblocking(true).unwrap();
    while stranger.send_to(b"MESSAGE=full\n", SOCKET).is_ok() {}
    drives_on(&place);
    signal(daemon.0.id(), "TERM");
    assert_eq!(daemon.end(), Some(0));
    // Nothing went past the journal.
    assert_eq!(std::fs::read_to_string(file).unwrap(), "");
}
