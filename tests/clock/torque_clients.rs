//! Sixteen torque clients of one daemon, some of them slow, stopped, killed or hostile: the loop does not notice.

use crate::job_support::*;
use plumbline::ipc::{Client, RobotId, Status};
use std::process::Command;
use std::time::{Duration, Instant};

const HOLD: [&str; 5] = [
    "backend.pace=wall-clock",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=1",
    "safety.max-lost=1000",
];
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
        done.err.lines().find(|line| line.contains("session `hold`")).unwrap_or_else(|| panic!("{}", done.said()));
    let text = line.split("session `hold`:").nth(1).unwrap();
    let numbers = text.split(|c: char| !c.is_ascii_digit() && c != '.').filter_map(|word| word.parse().ok()).collect();
    (text.trim().to_string(), numbers)
}

/// Holds for a while with whatever `beside` starts; what it said, and its status before the end.
fn hold<T>(test: &str, beside: impl FnOnce(&Place) -> T, during: impl FnOnce(&Place, &mut T)) -> (Done, Status) {
    let place = Place::new(test);
    let mut daemon = Running::start(place.job("daemon", &HOLD));
    wait_for("the loop", || place.status().filter(|status| status.cycles > 200));
    let begin = Instant::now();
    let mut others = beside(&place);
    during(&place, &mut others);
    std::thread::sleep(HELD.saturating_sub(begin.elapsed()));
    assert!(daemon.runs(), "the daemon ended by itself: {}", daemon.end().said());
    let last = wait_for("an answer", || place.status());
    place.command("quit").expect_code(0);
    let done = daemon.end().expect_code(0);
    drop(others);
    (done, last)
}

#[test]
fn sixteen_clients_of_which_some_are_slow_dead_or_hostile_cost_the_loop_nothing() {
    let (alone, _) = hold("alone", |_| (), |_, _| ());
    let (crowded, last) = hold(
        "crowd",
        |place| {
            let rates = ["100", "100", "100", "100", "100", "100", "1", "1", "0.1", "0.1"];
            let healthy: Vec<Running> = rates.iter().map(|rate| client(place, rate)).collect();
            let frozen: Vec<Running> = (0..3).map(|_| client(place, "100")).collect();
            let killed: Vec<Running> = (0..3).map(|_| client(place, "100")).collect();
            (healthy, frozen, killed)
        },
        |place, (_, frozen, killed)| {
            std::thread::sleep(Duration::from_secs(1));
            // Three in mid-read for good, three gone without a word; their memory stays theirs.
            frozen.iter().for_each(|client| signal(client.pid(), "STOP"));
            killed.iter().for_each(|client| signal(client.pid(), "KILL"));
            // And somebody who talks nonsense as fast as he can, and never reads an answer.
            babble(&RobotId::parse("test", "robot", &place.id).unwrap(), Duration::from_secs(2));
        },
    );
    for (what, done) in [("alone", &alone), ("with sixteen clients and nonsense", &crowded)] {
        let (line, numbers) = account(done);
        println!("{what}: {line}");
        // periods = cycles + skipped (longest run), clock; late, records lost, allocations; ...
        let [periods, cycles, skipped, _, clock, _, lost, allocations] = numbers[..8] else { panic!("{line}") };
        assert_eq!((periods, clock), (cycles + skipped, periods), "{what}: {line}");
        assert_eq!((lost, allocations), (0.0, 0.0), "{what}: {line}");
        assert!(periods >= 5_000.0, "{what}: {line}");
    }
    assert!(last.served.garbled_requests > 0, "no nonsense arrived: {:?}", last.served);
    assert_eq!(last.stopped, None);
}

/// Sends requests that are none, and waits for no answer.
fn babble(robot: &RobotId, long: Duration) {
    let begin = Instant::now();
    let mut client = Client::connect(robot, PATIENCE).unwrap();
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
