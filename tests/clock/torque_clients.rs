//! Sixteen torque clients of one daemon, some of them slow, stopped, killed or hostile: the loop does not notice.
//!
//! With the tests runs what any machine can decide. `hil/torque-clients/run.sh` compares the loop's statistics and writes the table of docs/results/campaigns.md.

use plumbline_client::{Expected, FeedForwardClient, FeedForwardSettings, Model};
use plumbline_core::Validity;
use plumbline_ipc::{Client, RobotId, Status};
use plumbline_testkit::job::*;
use std::fmt::Write as _;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const HOLD: [&str; 2] = ["backend.pace=wall-clock", "safety.max-lost=1000"];
/// How long the daemon holds with nobody there, and with everybody.
const HELD: Duration = Duration::from_secs(6);

fn client(place: &Place, rate: &str) -> Running {
    let mut command: Command = plumbline();
    command.args(["torque", "--follow", "--robot", &place.id, "--rate", rate, "--count", "100000"]);
    Running::start(command)
}

/// What the daemon says of its session: the line, and the numbers in it in order.
fn account(done: &Done) -> (String, Vec<f64>) {
    let line =
        done.err.lines().find(|line| line.contains("session `hold`")).unwrap_or_else(|| panic!("{}", done.output()));
    let text = line.split("session `hold`:").nth(1).unwrap();
    let numbers = text.split(|c: char| !c.is_ascii_digit() && c != '.').filter_map(|word| word.parse().ok()).collect();
    (text.trim().to_string(), numbers)
}

/// Sixteen of them, at work until they are dropped.
struct Crowd {
    _healthy: Vec<Running>,
    frozen: Vec<Running>,
    killed: Vec<Running>,
}

impl Crowd {
    fn of(place: &Place) -> Crowd {
        let rates = ["100", "100", "100", "100", "100", "100", "1", "1", "0.1", "0.1"];
        let some = |rates: &[&str]| rates.iter().map(|rate| client(place, rate)).collect();
        Crowd { _healthy: some(&rates), frozen: some(&rates[..3]), killed: some(&rates[..3]) }
    }

    /// Three are stopped in mid-read for good, three go without a word, and somebody talks nonsense as fast as he can and never reads an answer.
    fn misbehave(&self, place: &Place) {
        std::thread::sleep(Duration::from_secs(1));
        self.frozen.iter().for_each(|client| signal(client.pid(), "STOP"));
        self.killed.iter().for_each(|client| signal(client.pid(), "KILL"));
        let robot = RobotId::parse("test", "robot", &place.id).unwrap();
        babble(&robot, Duration::from_secs(2));
        flood(place, &robot, Duration::from_secs(2));
    }
}

/// Eleven clients send what takes long to read and is still small enough to be read at once, as fast as it is answered. The bridge thread spends its share of the time on the answers, and no more; as a share of
/// time it does not depend on the machine.
fn flood(place: &Place, robot: &RobotId, long: Duration) {
    let over = AtomicBool::new(false);
    let bytes = format!("{{\"request\":\"status\",\"more\":[{}0]}}", "0,".repeat(2000)).into_bytes();
    std::thread::scope(|scope| {
        for _ in 0..11 {
            scope.spawn(|| {
                let mut client = Client::connect(robot, TIMEOUT).unwrap();
                while !over.load(Ordering::Relaxed) {
                    let _ = client.send_bytes(&bytes, TIMEOUT);
                }
            });
        }
        let spent = || {
            let status = wait_for("an answer", || place.status());
            (plumbline_ipc::now_ns(), status.served.answering_ns)
        };
        spent();
        let (begin, before) = spent();
        std::thread::sleep(long);
        let (end, after) = spent();
        over.store(true, Ordering::Relaxed);
        let share = (after - before) as f64 / (end - begin) as f64;
        println!("eleven clients get {:.1} % of the bridge thread's time", 100.0 * share);
        assert!(
            (0.01..0.3).contains(&share),
            "{share} of the bridge thread's time went to requests: a fifth is theirs"
        );
    });
}

/// Holds for a while with whatever `beside` starts; what it said, and its status before the end.
fn hold<T>(test: &str, beside: impl FnOnce(&Place) -> T, during: impl FnOnce(&Place, &mut T)) -> (Done, Status) {
    let place = Place::new(test);
    let mut daemon = Running::start(place.job("daemon", &short(&HOLD)));
    wait_for("the loop", || place.status().filter(|status| status.cycles > 200));
    let begin = Instant::now();
    let mut others = beside(&place);
    during(&place, &mut others);
    std::thread::sleep(HELD.saturating_sub(begin.elapsed()));
    assert!(daemon.runs(), "the daemon ended by itself: {}", daemon.end().output());
    let last = wait_for("an answer", || place.status());
    let done = place.quit(daemon);
    drop(others);
    (done, last)
}

/// The numbers of [`account`], where the session kept its promises.
fn checked(what: &str, done: &Done) -> Vec<f64> {
    let (line, numbers) = account(done);
    // periods = cycles + skipped (longest run), clock; late, dropped records, allocations; ...
    let [periods, cycles, skipped, _, clock, _, lost, allocations] = numbers[..8] else { panic!("{line}") };
    assert_eq!((periods, clock), (cycles + skipped, periods), "{what}: {line}");
    assert_eq!((lost, allocations), (0.0, 0.0), "{what}: {line}");
    numbers
}

#[test]
fn sixteen_clients_of_which_some_are_slow_dead_or_hostile_cost_the_loop_nothing() {
    let (alone, _) = hold("alone", |_| (), |_, _| ());
    let (crowded, last) = hold("crowd", Crowd::of, |place, crowd| crowd.misbehave(place));
    for (what, done) in [("alone", &alone), ("with sixteen clients and nonsense", &crowded)] {
        println!("{what}: {}", account(done).0);
        assert!(checked(what, done)[0] >= 5_000.0, "{what}: {}", done.output());
    }
    assert!(last.served.garbled_requests > 0, "no nonsense arrived: {:?}", last.served);
    assert_eq!(last.stopped, None);
}

/// A controller's own evaluation of the served model, beside a daemon whose arm rests: at the daemon's own setpoint it is the daemon's torque.
#[test]
fn a_model_that_is_followed_has_the_daemons_torque_to_the_last_bit() {
    let place = Place::new("controller");
    let mut command = place.job("daemon", &short(&HOLD));
    command.args(["--model", "config/models/panda-paper-table3.toml"]);
    let daemon = Running::start(command);
    let expected = Expected { robot: Some("panda".into()), gravity: Some([9.81, 0.0, 0.0]) };
    let mut model = Model::follow(&place.id, expected, TIMEOUT).unwrap();
    wait_for("the model", || model.status().model != 0);
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut torques = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();
    let served = wait_for("a torque of the model alone", || {
        let message = torques.latest().unwrap()?.message;
        (message.validity() == Ok(Validity::Valid)).then_some(message)
    });
    assert_eq!((model.status().model, model.status().validity), (served.model, Validity::Valid));
    let (rest, mut tau) = ([0.0; 7], [0.0; 7]);
    assert_eq!(served.dq_d[..7], rest);
    model.torque(&served.q_d[..7], &rest, &rest, None, &mut tau).unwrap();
    assert_eq!(tau, served.torque());
    place.quit(daemon).expect_code(0);
    wait_for("the end of the daemon", || model.trouble().is_some());
    assert_eq!(model.torque(&served.q_d[..7], &rest, &rest, None, &mut tau), Ok(()));
}

/// Sends requests that are none, and waits for no answer.
fn babble(robot: &RobotId, long: Duration) {
    let begin = Instant::now();
    let mut client = Client::connect(robot, TIMEOUT).unwrap();
    let mut sent = 0_u64;
    while begin.elapsed() < long {
        // Whatever becomes of it: the daemon is busy with the nonsense before.
        let _ = client.send_bytes(&nonsense(sent), Duration::ZERO);
        sent += 1;
    }
    println!("{sent} requests of nonsense in {:.1} s", begin.elapsed().as_secs_f64());
}

/// Bytes that are no request: random, half of one, too deep, too long.
fn nonsense(k: u64) -> Vec<u8> {
    match k % 4 {
        0 => (0..257).map(|i: u64| (k.wrapping_mul(6364136223846793005).wrapping_add(i * i) >> 3) as u8).collect(),
        1 => br#"{"request":"sto"#.to_vec(),
        2 => vec![b'['; 60_000],
        _ => vec![b' '; 2 << 20],
    }
}

const COMPARED: [(&str, usize); 7] = [
    ("execution p50 \\[us\\]", 16),
    ("execution p99", 18),
    ("execution p99.9", 20),
    ("wake-up p50 \\[us\\]", 9),
    ("wake-up p99", 11),
    ("wake-up p99.9", 13),
    ("skipped", 2),
];

/// Two daemons hold side by side. The measured one has nobody, or the sixteen are the other one's, or its own: what differs between the last two is not
/// the machine's load, but whose memory they read.
struct Pair {
    measured: Place,
    other: Place,
}

impl Pair {
    fn hold(&self, whose: Option<&Place>, long: Duration) -> Vec<f64> {
        let [mut measured, mut other] = [&self.measured, &self.other].map(|place| {
            let daemon = Running::start(place.job("daemon", &short(&HOLD)));
            wait_for("the loop", || place.status().filter(|status| status.cycles > 200));
            daemon
        });
        let begin = Instant::now();
        let crowd = whose.map(Crowd::of);
        if let (Some(crowd), Some(place)) = (&crowd, whose) {
            crowd.misbehave(place);
        }
        std::thread::sleep(long.saturating_sub(begin.elapsed()));
        assert!(measured.runs() && other.runs(), "a daemon ended by itself");
        for place in [&self.measured, &self.other] {
            place.command("quit").expect_code(0);
        }
        checked("the other", &other.end().expect_code(0));
        checked("the measured one", &measured.end().expect_code(0))
    }
}

/// Writes the table of docs/results/campaigns.md; hil/torque-clients/run.sh runs it.
#[test]
#[ignore = "takes a quarter of an hour"]
fn the_loop_with_clients_and_without() {
    let number = |variable, default| std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (rounds, seconds) = (number("ROUNDS", 10_usize), number("SECONDS", 20_usize));
    let long = Duration::from_secs(seconds as u64);
    let pair = Pair { measured: Place::new("measured"), other: Place::new("other") };
    // By turns, each round in another order.
    let mut found: [Vec<Vec<f64>>; 3] = Default::default();
    for round in 0..rounds {
        for turn in 0..3 {
            let who = (round + turn) % 3;
            let numbers = pair.hold([None, Some(&pair.other), Some(&pair.measured)][who], long);
            eprintln!(
                "round {round}, {who}: {}",
                COMPARED.map(|(what, at)| format!("{what} {}", numbers[at])).join(", ")
            );
            found[who].push(numbers);
        }
    }
    let mut text = format!(
        "{rounds} rounds of {seconds} s for each column, by turns, on a machine with {} processors.\n\n\
         | the loop's own account | nobody | clients of the other | clients of its own | ratio, median (range) | larger, smaller in |\n\
         |---|---|---|---|---|---|\n",
        std::thread::available_parallelism().map_or(0, usize::from)
    );
    for (what, at) in COMPARED {
        let [alone, others, own] =
            [0, 1, 2].map(|who| found[who].iter().map(|numbers| numbers[at]).collect::<Vec<f64>>());
        let pairs = || own.iter().zip(&others);
        // Skipped periods may be none: then the ratio of one more.
        let none = if what == "skipped" { 1.0 } else { 0.0 };
        let ratios: Vec<f64> = pairs().map(|(own, other)| (own + none) / (other + none)).collect();
        let [larger, smaller] = [pairs().filter(|(a, b)| a > b).count(), pairs().filter(|(a, b)| a < b).count()];
        let columns = [alone, others, own].map(|values| spread(&values, 1)).join(" | ");
        writeln!(text, "| {what} | {columns} | {} | {larger}, {smaller} of {rounds} |", spread(&ratios, 2)).unwrap();
    }
    plumbline_testkit::page::write_block("docs/results/campaigns.md", "torque-clients", &text);
}

/// Median, least and largest.
fn spread(values: &[f64], digits: usize) -> String {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = 0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]);
    format!("{middle:.digits$} ({:.digits$} to {:.digits$})", sorted[0], sorted[sorted.len() - 1])
}
