//! The live watch: the simulated arm picks up 0.73 kg while its model is served, and puts it down again; the estimator says so, and the served torque
//! recovers.

use plumbline_testkit::job::*;
use serde_json::Value;
use std::process::Command;

const JOB: &str = "config/sim-panda-live.toml";
/// A coarse search for the motions; everything else is the shipped job.
const COARSE: [&str; 3] = ["excitation.starts=1", "excitation.rounds=0", "excitation.periods=4"];
/// When the arm picks it up, and when it puts it down, by its truth file \[s\].
const PICKED_UP: f64 = 110.0;
const PUT_DOWN: f64 = 155.0;

pub fn job(place: &Place, subcommand: &str, more: &[&str]) -> Command {
    let sets: Vec<&str> = COARSE.iter().chain(more).copied().collect();
    place.reuse_plans(JOB, &sets);
    let mut command = plumbline();
    command.arg(subcommand).arg(JOB).arg("--out").arg(place.out());
    command.args((subcommand == "run").then_some("--verbose"));
    command.arg("--set").arg(format!("serve.id={}", place.id));
    for set in sets {
        command.arg("--set").arg(set);
    }
    command
}

pub fn live(place: &Place) -> Value {
    serde_json::from_str(&std::fs::read_to_string(place.out().join("live.json")).unwrap()).unwrap()
}

pub fn events<'v>(log: &'v Value, kind: &str) -> Vec<&'v Value> {
    log["events"].as_array().unwrap().iter().filter(|event| event["event"] == kind).collect()
}

/// Largest joint's RMS of measured minus served torque, mean over the stretches that lie between two moments \[Nm\].
fn served(log: &Value, from: f64, to: f64) -> f64 {
    let stretches = log["stretches"].as_array().unwrap().iter();
    let within = stretches.filter(|one| one["start"].as_f64().unwrap() >= from && one["end"].as_f64().unwrap() <= to);
    let worst: Vec<f64> = within
        .map(|one| one["served_rms"].as_array().unwrap().iter().map(|rms| rms.as_f64().unwrap()).fold(0.0, f64::max))
        .collect();
    assert!(worst.len() >= 3, "{} stretches from {from} s to {to} s", worst.len());
    mean(&worst)
}

/// Time of an event \[s\].
pub fn time(event: &Value) -> f64 {
    event["t"].as_f64().unwrap()
}

/// What the estimator found out about the payload, whoever decides: when it was proposed first and last \[s\].
fn found_the_payload(log: &Value) -> [f64; 2] {
    let lost = events(log, "lost");
    assert!(time(lost[0]) - PICKED_UP < 1.0, "lost at {} s", time(lost[0]));
    let proposed: Vec<&Value> =
        events(log, "proposed").into_iter().filter(|event| !event["effects"].as_array().unwrap().is_empty()).collect();
    let mut stds = Vec::new();
    for event in &proposed {
        let since = event["since"].as_f64().unwrap();
        assert!((since - PICKED_UP).abs() < 0.1, "changed at {since} s");
        let effects = event["effects"].as_array().unwrap();
        assert_eq!(effects.iter().map(|effect| effect["id"].as_str().unwrap()).collect::<Vec<_>>(), ["payload"]);
        let of = |key: &str| effects[0][key]["mass"].as_f64().unwrap();
        let (mass, std) = (of("parameters"), of("std"));
        assert!((mass - 0.73).abs() < 4.0 * std && (mass / 0.73 - 1.0).abs() < 0.005, "{mass} +- {std} kg");
        let worst =
            |key: &str| event[key].as_array().unwrap().iter().map(|rms| rms.as_f64().unwrap()).fold(0.0, f64::max);
        assert!(worst("before") > 1.0 && worst("after") < 0.1, "{} -> {}", worst("before"), worst("after"));
        stds.push(std);
    }
    assert!(stds.len() > 1 && stds.windows(2).all(|pair| pair[1] < pair[0]), "{stds:?} kg");
    let (first, last) = (time(proposed[0]), time(proposed[proposed.len() - 1]));
    assert!(first - PICKED_UP < 5.0, "named at {first} s");
    [first, last]
}

#[test]
fn the_payload_is_found_and_the_served_error_recovers() {
    let place = Place::new("live-auto");
    let done = Done::of(job(&place, "run", &[])).expect_code(0);
    let log = live(&place);
    let [proposed, _] = found_the_payload(&log);
    let lost = events(&log, "lost");
    assert!(lost.len() == 2 && time(lost[1]) - PUT_DOWN < 1.0, "{lost:?}");
    let swaps = events(&log, "served");
    let swapped = time(swaps[1]);
    assert!(swapped >= proposed && swapped < proposed + 5.0, "proposed at {proposed} s, served from {swapped} s on");
    // Put down, the arm is what it was: no new effect, the first model.
    let last = *events(&log, "proposed").last().unwrap();
    let since = last["since"].as_f64().unwrap();
    assert!(last["what"].as_str().unwrap().starts_with("as it was") && (since - PUT_DOWN).abs() < 0.1, "{last}");
    assert!(time(last) - PUT_DOWN < 5.0 && last["model"] == swaps[0]["model"], "{last}");
    assert_eq!(swaps.last().unwrap()["model"], swaps[0]["model"]);
    // Raw torque against what was served: the sensors' noise, a payload, the noise again; and again.
    let before = served(&log, PICKED_UP - 10.0, PICKED_UP - 0.5);
    let during = served(&log, PICKED_UP + 0.5, proposed);
    let after = served(&log, swapped + 0.5, swapped + 10.0);
    let again = served(&log, time(swaps.last().unwrap()) + 0.5, PUT_DOWN + 12.0);
    assert!(during > 1.0 && before < 0.3 && after < 1.3 * before, "{before} {during} {after}");
    assert!(again < 1.3 * before, "{before} {again}");
    for words in ["live: since", "payload (mass 0.7", "as it was", "marked as doubtful"] {
        assert!(done.output().contains(words), "no `{words}`: {}", done.output());
    }
    // The loop was not disturbed by any of it.
    let cycle = place.report().control_loop.unwrap();
    assert_eq!((cycle.lost, cycle.dropped_records, cycle.allocations()), (0, 0, Some(0)));
    let has = |name: &str| std::fs::read_to_string(place.out().join(name)).unwrap().contains("[uncertainty]");
    assert!(has("model.toml") && !has("model-live.toml"));
}

#[test]
fn who_is_asked_decides() {
    let place = Place::new("live-ask");
    // It keeps what it has picked up.
    let shipped = std::fs::read_to_string("config/arms/sim-panda-live.toml").unwrap();
    let arm = place.path().join("arm.toml");
    let base = format!("base = \"{}/config/arms/sim-panda.toml\"", env!("CARGO_MANIFEST_DIR"));
    let kept = shipped.replace("until = 155.0\n", "").replace("base = \"sim-panda.toml\"", &base);
    assert_ne!(kept, shipped);
    std::fs::write(&arm, kept).unwrap();
    let arm = format!("backend.arm={}", arm.display());
    let ask = ["live.adopt=ask", &arm, "live.motion=60 s"];
    let daemon = Running::start(job(&place, "daemon", &ask));
    wait_for("the daemon", || (place.command("status").code == Some(0)).then_some(()));
    let estimator = Running::start({
        let mut command = job(&place, "estimator", &ask);
        command.arg("--once");
        command
    });
    let status = || {
        let mut command = plumbline();
        command.args(["command", "status", "--json", "--robot", &place.id]);
        serde_json::from_str::<Value>(&Done::of(command).expect_code(0).out).unwrap()
    };
    wait_for("the estimator", || (!status()["served"]["followers"].as_array().unwrap().is_empty()).then_some(()));
    // Nobody has proposed anything.
    assert_eq!(place.command("adopt").code, Some(1));
    place.command("start").expect_code(0);
    estimator.end().expect_code(0);

    let log = live(&place);
    found_the_payload(&log);
    assert_eq!(events(&log, "served").len(), 1, "nothing is served unasked");
    let now = status();
    let (serves, offered) = (now["model"].clone(), now["offered"].clone());
    assert!(offered["what"].as_str().unwrap().starts_with("payload (mass 0.7"), "{offered}");
    assert!(now["doubt"].as_str().unwrap().contains("an error of"), "{now}");
    assert!(offered["model"] != serves && offered["before"].as_f64() > offered["after"].as_f64(), "{offered}");
    assert!(served(&log, PICKED_UP + 15.0, PICKED_UP + 25.0) > 1.0, "the served torque is still the old one");

    place.command("adopt").expect_code(0);
    let now = status();
    assert_eq!(now["model"], offered["model"]);
    assert!(now["offered"].is_null() && now["doubt"].is_null(), "{now}");
    assert_eq!(place.command("reject").code, Some(1), "nothing is held any more");
    place.quit(daemon);
}
