//! The live watch: the simulated arm picks up 0.73 kg while its model is served; the estimator says so, and the served torque recovers.

use plumbline_testkit::job::*;
use serde_json::Value;
use std::process::Command;

const JOB: &str = "config/sim-panda-live.toml";
/// A coarse search for the motions; everything else is the shipped job.
const COARSE: [&str; 3] = ["excitation.starts=1", "excitation.rounds=0", "excitation.periods=4"];
/// When the arm picks it up, by its truth file \[s\].
const PICKED_UP: f64 = 110.0;

fn job(place: &Place, subcommand: &str, more: &[&str]) -> Command {
    let sets: Vec<&str> = COARSE.iter().chain(more).copied().collect();
    place.reuse_plans(JOB, &sets);
    let mut command = plumbline();
    command.arg(subcommand).arg(JOB).arg("--out").arg(place.out());
    command.arg("--set").arg(format!("serve.id={}", place.id));
    for set in sets {
        command.arg("--set").arg(set);
    }
    command
}

fn live(place: &Place) -> Value {
    serde_json::from_str(&std::fs::read_to_string(place.out().join("live.json")).unwrap()).unwrap()
}

fn events<'v>(log: &'v Value, kind: &str) -> Vec<&'v Value> {
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

/// What the estimator found out, whoever decides.
fn found_the_payload(log: &Value) -> f64 {
    let lost = events(log, "lost");
    assert_eq!(lost.len(), 1, "{lost:?}");
    let since = lost[0]["since"].as_f64().unwrap();
    assert!((since - PICKED_UP).abs() < 2.0, "lost since {since} s");
    let proposed = events(log, "proposed");
    assert_eq!(proposed.len(), 1, "{proposed:?}");
    let effects = proposed[0]["effects"].as_array().unwrap();
    assert_eq!(effects.iter().map(|effect| effect["id"].as_str().unwrap()).collect::<Vec<_>>(), ["payload"]);
    let (mass, std) = (effects[0]["parameters"]["mass"].as_f64().unwrap(), effects[0]["std"]["mass"].as_f64().unwrap());
    assert!((mass - 0.73).abs() < 4.0 * std && std < 0.03, "{mass} +- {std} kg");
    let worst =
        |key: &str| proposed[0][key].as_array().unwrap().iter().map(|rms| rms.as_f64().unwrap()).fold(0.0, f64::max);
    assert!(worst("before") > 1.0 && worst("after") < 0.1, "{} -> {}", worst("before"), worst("after"));
    proposed[0]["t"].as_f64().unwrap()
}

#[test]
fn the_payload_is_found_and_the_served_error_recovers() {
    let place = Place::new("live-auto");
    let done = Done::of(job(&place, "run", &[])).expect_code(0);
    let log = live(&place);
    let proposed = found_the_payload(&log);
    assert!(proposed < PICKED_UP + 20.0, "proposed at {proposed} s");
    let swaps = events(&log, "served");
    assert_eq!(swaps.len(), 2, "{swaps:?}");
    let swapped = swaps[1]["t"].as_f64().unwrap();
    assert!(swapped >= proposed && swapped < proposed + 5.0, "proposed at {proposed} s, served from {swapped} s on");
    // Raw torque against what was served: the sensors' noise, a payload, the noise again.
    let before = served(&log, PICKED_UP - 10.0, PICKED_UP);
    let during = served(&log, PICKED_UP + 1.0, proposed);
    let after = served(&log, swapped, swapped + 10.0);
    assert!(during > 1.0 && before < 0.3 && after < 1.3 * before, "{before} {during} {after}");
    assert!(done.out.contains("live: since") && done.out.contains("payload (mass 0.7"), "{}", done.output());
    // The loop was not disturbed by any of it.
    let cycle = place.report().control_loop.unwrap();
    assert_eq!((cycle.lost, cycle.dropped_records, cycle.allocations()), (0, 0, Some(0)));
    let has = |name: &str| std::fs::read_to_string(place.out().join(name)).unwrap().contains("[uncertainty]");
    assert!(has("model.toml") && !has("model-live.toml"));
}

#[test]
fn who_is_asked_decides() {
    let place = Place::new("live-ask");
    let ask = ["live.adopt=ask"];
    let daemon = Running::start(job(&place, "daemon", &ask));
    wait_for("the daemon", || (place.command("status").code == Some(0)).then_some(()));
    let estimator = Running::start({
        let mut command = job(&place, "estimator", &ask);
        command.arg("--once");
        command
    });
    let status = || serde_json::from_str::<Value>(&place.command("status").expect_code(0).out).unwrap();
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
    assert!(offered["model"] != serves && offered["before"].as_f64() > offered["after"].as_f64(), "{offered}");
    assert!(served(&log, PICKED_UP + 25.0, PICKED_UP + 35.0) > 1.0, "the served torque is still the old one");

    place.command("adopt").expect_code(0);
    let now = status();
    assert_eq!(now["model"], offered["model"]);
    assert!(now["offered"].is_null());
    assert_eq!(place.command("reject").code, Some(1), "nothing is held any more");
    place.quit(daemon);
}
