//! `plumbline command stop` reaches the loop whatever else is the matter: clients that flood the daemon or take every place, shared memory that is
//! full, a daemon without a file descriptor. An arm that keeps the clock's time; the daemon's own stamps.
//!
//! With the tests runs a short form; `hil/stop/run.sh` runs each case a hundred times and prints the figures.

use plumbline_core::{Phase, Record};
use plumbline_ipc::{
    Client, Delivery, IpcError, Progress, Request, Response, RobotId, SampleStream, Status, StreamSettings, now_ns,
    runtime_dir,
};
use plumbline_testkit::job::*;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

const HELD: [&str; 4] =
    ["backend.pace=wall-clock", "realtime.lock-memory=false", "safety.max-lost=1000", "recorder.span=0 s"];
/// Far more than a stop may take on any machine that this runs on; the figures are printed.
const BOUND_MS: f64 = 2000.0;

/// What one stop took, from before its command was started \[ms\].
#[derive(Clone, Copy, Debug)]
struct Figures {
    /// Until the daemon had taken it, by its own stamp.
    taken: f64,
    /// Until the first cycle in which the loop brakes, by its own stamp.
    braking: f64,
    command: f64,
}

/// A daemon, and what has been connected to it before anything goes wrong.
struct Scene {
    place: Place,
    daemon: Option<Running>,
    operator: Client,
    samples: SampleStream,
}

impl Scene {
    fn new(test: &str) -> Scene {
        let place = Place::new(test);
        let daemon = Running::start(place.job("daemon", &short(&HELD)));
        wait_for("the loop", || place.status().filter(|now| now.cycles > 100));
        let robot = RobotId::parse("test", "robot", &place.id).unwrap();
        let operator = Client::connect_operator(&robot, TIMEOUT).unwrap();
        let samples = SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
        Scene { place, daemon: Some(daemon), operator, samples }
    }

    fn robot(&self) -> RobotId {
        RobotId::parse("test", "robot", &self.place.id).unwrap()
    }

    fn pid(&self) -> u32 {
        self.daemon.as_ref().unwrap().pid()
    }

    fn ask(&mut self, request: &Request) -> Option<Response> {
        self.operator.send(request, Duration::from_secs(5)).ok()
    }

    fn status(&mut self) -> Option<Status> {
        match self.ask(&Request::Status {})? {
            Response::Status(status) => Some(*status),
            _ => None,
        }
    }

    /// The first record, stamped after `after_ns`, that `is` one.
    fn record(&mut self, what: &str, after_ns: u64, is: impl Fn(&Record) -> bool) -> Record {
        let start = Instant::now();
        loop {
            assert!(start.elapsed() < Duration::from_secs(60), "{what} did not come");
            if let Delivery::Records { records, .. } = self.samples.next(Duration::from_millis(5)).unwrap()
                && let Some(found) = records.iter().find(|record| record.stamp_ns > after_ns && is(record))
            {
                return *found;
            }
        }
    }

    fn lock(&self) -> PathBuf {
        runtime_dir::directory().unwrap().join(format!("{}.lock", self.place.id))
    }

    fn taken_ns(&self) -> u64 {
        let text = std::fs::read_to_string(self.lock()).unwrap();
        text.lines().find_map(|line| line.strip_prefix("stop-ns ")?.parse().ok()).unwrap()
    }

    /// One stop by the command line. It stands: the arm rests after it.
    fn stop(&mut self) -> Figures {
        let begin = now_ns();
        let done = self.place.command("stop").expect_code(0);
        let command = now_ns();
        assert!(done.out.contains("has received the stop"), "{}", done.output());
        let taken = self.taken_ns();
        assert!(taken > begin, "the stop before this one is shown");
        let braking = self.record("the brake", begin, |record| matches!(record.phase, Phase::Stop | Phase::Stopped));
        let ms = |at: u64| at.saturating_sub(begin) as f64 * 1e-6;
        let figures = Figures { taken: ms(taken), braking: ms(braking.stamp_ns), command: ms(command) };
        assert!(figures.taken < BOUND_MS && figures.braking < BOUND_MS, "{figures:?}");
        figures
    }

    /// Lets the arm hold again.
    fn resume(&mut self) {
        let at_rest = self.record("rest", 0, |record| record.phase == Phase::Stopped);
        wait_for("a permission", || self.ask(&Request::Resume {}).filter(|answer| *answer == Response::Accepted {}));
        self.record("hold", at_rest.stamp_ns, |record| record.phase == Phase::Hold);
    }

    /// A stop in mid-motion, then `more` while the arm holds.
    fn stops(&mut self, what: &str, more: usize) {
        let moving = self.stop();
        wait_for("the programme's end", || self.status().filter(|now| now.progress == Progress::Stopped));
        let mut all = vec![moving];
        for _ in 0..more {
            self.resume();
            all.push(self.stop());
        }
        let spread = |of: fn(&Figures) -> f64| {
            let mut values: Vec<f64> = all.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            format!("{:.1} / {:.1}", values[values.len() / 2], values[values.len() - 1])
        };
        let within = all.iter().filter(|figures| figures.taken <= 100.0 && figures.braking <= 100.0).count();
        eprintln!(
            "STOP | {what} | {} | {} | {} | {} | {within} |",
            all.len(),
            spread(|figures| figures.taken),
            spread(|figures| figures.braking),
            spread(|figures| figures.command)
        );
    }

    fn drive(&mut self) {
        let begin = now_ns();
        assert_eq!(self.ask(&Request::Start {}), Some(Response::Accepted {}));
        self.record("motion", begin, |record| record.phase == Phase::Excite);
    }

    /// Ends the daemon by a signal, with exit code `code`; what it said.
    fn end(mut self, code: i32) -> Done {
        let daemon = self.daemon.take().unwrap();
        signal(daemon.pid(), "TERM");
        daemon.end().expect_code(code)
    }
}

/// How many stops of each kind after the first, which is in mid-motion.
fn more() -> usize {
    std::env::var("ROUNDS")
        .ok()
        .and_then(|text| text.parse::<usize>().ok())
        .map_or(2, |rounds| rounds.saturating_sub(1))
}

/// Clients that always have a model on offer: two that wait for its answer, and one that does not and offers the next.
struct Flood {
    end: Arc<AtomicBool>,
    sent: Arc<AtomicU64>,
    threads: Vec<std::thread::JoinHandle<()>>,
}

impl Flood {
    fn of(robot: &RobotId) -> Flood {
        let (end, sent) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let toml = std::fs::read_to_string("config/models/panda-paper-table3.toml").unwrap();
        let offer = serde_json::to_vec(&Request::OfferModel { toml }).unwrap();
        let one = |patience: Duration| {
            let (robot, over, count, offer) = (robot.clone(), end.clone(), sent.clone(), offer.clone());
            std::thread::spawn(move || {
                let mut client = Client::connect(&robot, TIMEOUT).unwrap();
                while !over.load(Ordering::Relaxed) {
                    let _ = client.send_bytes(&offer, patience);
                    count.fetch_add(1, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_micros(100));
                }
            })
        };
        let threads = [Duration::from_secs(5), Duration::from_secs(5), Duration::ZERO].into_iter().map(one).collect();
        Flood { end, sent, threads }
    }
}

impl Drop for Flood {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        self.threads.drain(..).for_each(|thread| drop(thread.join()));
    }
}

#[test]
fn a_flood_of_models_keeps_no_stop_and_no_other_client_from_the_daemon() {
    let mut scene = Scene::new("flood");
    let flood = Flood::of(&scene.robot());
    wait_for("the flood", || (flood.sent.load(Ordering::Relaxed) > 100).then_some(()));
    scene.drive();
    scene.stops("three clients with models on offer all the time", more());
    // Everybody else is served, and the models, too.
    for _ in 0..5 {
        scene.place.command("status").expect_code(0);
    }
    let offered = scene
        .ask(&Request::OfferModel { toml: std::fs::read_to_string("config/models/panda-paper-table3.toml").unwrap() });
    assert!(matches!(offered, Some(Response::ModelAccepted { .. } | Response::Refused { .. })), "{offered:?}");
    drop(flood);
    scene.end(0);
}

#[test]
fn clients_that_take_every_place_keep_no_stop_from_the_daemon() {
    let mut scene = Scene::new("places");
    let robot = scene.robot();
    // Programs leave the last places to operators, and are told who has the others.
    let mut idle: Vec<Client> = (0..11).map(|_| Client::connect(&robot, TIMEOUT).unwrap()).collect();
    let refused = Client::connect(&robot, Duration::from_millis(20)).err().unwrap();
    let words = refused.to_string();
    assert!(matches!(refused, IpcError::Full { .. }), "{words}");
    assert!(words.contains(&format!("process {} has 12", std::process::id())), "{words}");
    scene.place.command("status").expect_code(0);
    // Whoever does not leave them takes them all.
    idle.extend((0..4).map(|_| Client::connect_operator(&robot, TIMEOUT).unwrap()));
    let status = scene.place.command("status").expect_code(1);
    assert!(status.err.contains(&format!("process {} has 16", std::process::id())), "{}", status.output());
    scene.drive();
    scene.stops("16 idle clients", more());
    drop(idle);
    scene.end(0);
}

#[test]
fn a_daemon_without_a_file_descriptor_is_stopped_and_says_what_it_lacks() {
    let mut scene = Scene::new("descriptors");
    scene.drive();
    let limit = rustix::process::Rlimit { current: Some(3), maximum: Some(3) };
    let pid = i32::try_from(scene.pid()).ok().and_then(rustix::process::Pid::from_raw);
    rustix::process::prlimit(pid, rustix::process::Resource::Nofile, limit).unwrap();
    // A new client finds no way to it; those that are connected are served.
    scene.place.command("status").expect_code(1);
    assert!(scene.status().is_some());
    scene.stops("the daemon out of file descriptors", more());
    let done = scene.end(0);
    let lines = done.err.lines().filter(|line| line.contains("no file descriptor is left")).count();
    assert!((1..=3).contains(&lines), "{lines} lines; once per cause:\n{}", done.output());
}

/// Set for the run in a namespace of its own.
const INSIDE: &str = "PLUMBLINE_TEST_STOP";
const OWN_MEMORY: &str = "mount -t tmpfs -o size=96m tmpfs /dev/shm";

#[test]
fn full_shared_memory_keeps_no_stop_from_the_daemon() {
    if std::env::var_os(INSIDE).is_some() {
        return with_full_memory();
    }
    if !in_namespace(OWN_MEMORY).output().is_ok_and(|tried| tried.status.success()) {
        return eprintln!("SKIPPED: this machine lets nobody make a namespace, so shared memory was not filled");
    }
    let names = tempfile::tempdir().unwrap();
    let script = format!(
        "{OWN_MEMORY} && exec \"$0\" --nocapture --exact stop_path::full_shared_memory_keeps_no_stop_from_the_daemon"
    );
    let mut again = in_namespace(&script);
    again.arg(std::env::current_exe().unwrap()).env(INSIDE, "1").env("PLUMBLINE_RUNTIME_DIR", names.path());
    let run = again.output().unwrap();
    let message = String::from_utf8_lossy(&[run.stdout, run.stderr].concat()).into_owned();
    assert!(run.status.success() && message.contains("1 passed"), "{message}");
    message.lines().filter(|line| line.contains("STOP |")).for_each(|line| eprintln!("{line}"));
}

fn with_full_memory() {
    let mut scene = Scene::new("memory");
    scene.drive();
    let mut filler = std::fs::File::create("/dev/shm/filler").unwrap();
    while filler.write_all(&[1; 4096]).is_ok() {}
    // A new client ends with a reason instead of by a signal.
    let refused = scene.place.command("status").expect_code(1);
    assert!(refused.err.contains("/dev/shm is full"), "{}", refused.output());
    scene.stops("/dev/shm full", more());
    assert!(scene.daemon.as_mut().unwrap().runs());
    drop(filler);
    std::fs::remove_file("/dev/shm/filler").unwrap();
    scene.place.command("status").expect_code(0);
    scene.end(0);
}

#[test]
fn the_last_resort_is_a_signal_and_a_daemon_that_stands_still_is_said_so() {
    let mut scene = Scene::new("resort");
    scene.drive();
    std::fs::remove_file(scene.lock().with_extension("stop")).unwrap();
    let begin = now_ns();
    let done = scene.place.command("stop").expect_code(0);
    assert!(done.out.contains("by signal SIGUSR2; its socket failed"), "{}", done.output());
    scene.record("the brake", begin, |record| matches!(record.phase, Phase::Stop | Phase::Stopped));
    signal(scene.pid(), "STOP");
    let refused = scene.place.command("stop").expect_code(1);
    assert!(
        refused.err.contains("NOT STOPPED") && refused.err.contains("the robot's own stop"),
        "{}",
        refused.output()
    );
    signal(scene.pid(), "CONT");
    // The arm got no commands meanwhile and has stopped by itself, which ends the loop.
    let done = scene.end(1);
    assert!(done.err.contains("a stop was requested by signal SIGUSR2"), "{}", done.output());
    let gone = Place::new("nobody").command("stop").expect_code(1);
    assert!(gone.err.contains("no daemon serves robot"), "{}", gone.output());
}
