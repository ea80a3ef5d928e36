//! `plumbline plan`: several motions that differ, a nominal model, ctrl-C, and a job whose plan leads the arm into itself.

use plumbline::store::load_plan;
use plumbline_excite::{Plan, plan_text};
use plumbline_testkit::job::*;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

fn plan(out: &Path, more: &[&str]) -> Command {
    let mut command = plumbline();
    command.args(["plan", "--robot", "panda", "--mounting", "wall", "--starts", "1", "--out"]).arg(out).args(more);
    command
}

#[test]
fn motions_for_identification_and_validation_differ_and_repeat_by_seed() {
    let place = Place::new("plan-set");
    let out = place.path().join("plan.toml");
    let model = "config/models/panda-paper-table3.toml";
    let more = [
        "--rounds",
        "0",
        "--trajectories",
        "2",
        "--validate",
        "1",
        "--model",
        model,
        "--criterion",
        "equilibrated",
        "--links-in-box",
    ];
    let mut command = plan(&out, &more);
    let done = Done::of(command.arg("--page").arg(place.path().join("page.html"))).expect_code(0);
    assert!(done.out.contains("with the 1 before it: condition raw"), "{}", done.output());
    assert!(!out.exists());
    let load = |name: &str| load_plan(&place.path().join(name)).unwrap();
    let plans: Vec<Plan> = ["plan-1.toml", "plan-2.toml", "plan-validate-1.toml"].map(load).into();
    assert!(plans[0].a != plans[1].a && plans[1].a != plans[2].a && plans[0].q0 != plans[1].q0);
    assert!(plans.iter().all(|plan| plan.constraints.tau.is_some() && plan.constraints.links_in_box));
    assert!(plans[0].conditions.equilibrated < plans[2].conditions.equilibrated);

    // The pages show the motions; a random one was not searched for.
    for (page, searched) in [("page-1.html", true), ("page-2.html", true), ("page-validate-1.html", false)] {
        let html = std::fs::read_to_string(place.path().join(page)).unwrap();
        assert_eq!(html.contains("evaluations / 1000"), searched, "{page}");
        assert!(html.contains("id=\"arm\"") && html.contains("Use of the joints' limits"), "{page}");
        assert!(!html.contains("0 base parameters") && !html.contains(">Parameters<"), "{page}");
    }
    let course = plans[0].search.as_ref().unwrap();
    assert!((course.best.last().unwrap() / plans[0].conditions.equilibrated - 1.0).abs() < 1e-9, "{course:?}");
    assert_eq!(plans[2].search, None);

    let again = place.path().join("again.toml");
    Done::of(plan(&again, &["--rounds", "0", "--model", model, "--criterion", "equilibrated", "--links-in-box"]))
        .expect_code(0);
    assert_eq!(load("again.toml"), plans[0]);
}

/// Nothing can be identified from a motion of a millimetre a second: a failed job that names the parameters, and no file.
#[test]
fn a_plan_without_excitation_is_a_failed_job() {
    let place = Place::new("plan-useless");
    let text = std::fs::read_to_string("config/robots/panda.toml").unwrap();
    let slow: Vec<&str> =
        text.lines().map(|line| if line.starts_with("dq = ") { "dq = 0.001" } else { line }).collect();
    let robot = place.path().join("slow.toml");
    std::fs::write(&robot, slow.join("\n")).unwrap();
    let out = place.path().join("plan.toml");
    let done = Done::of(
        plumbline().arg("plan").arg("--robot").arg(&robot).args(["--starts", "1", "--rounds", "0", "--out"]).arg(&out),
    )
    .expect_code(1);
    assert!(done.err.contains("the motion does not determine L"), "{}", done.output());
    assert!(done.err.contains("expected at most 10000"), "{}", done.output());
    assert!(!out.exists());
}

/// A plan file in which a joint stands still is refused with the joint, and with what to do.
#[test]
fn a_plan_with_a_frozen_joint_is_refused() {
    let place = Place::new("plan-frozen");
    let out = place.path().join("plan.toml");
    Done::of(plan(&out, &["--rounds", "0"])).expect_code(0);
    let mut frozen = load_plan(&out).unwrap();
    frozen.a[3].iter_mut().chain(&mut frozen.b[3]).for_each(|amplitude| *amplitude *= 0.01);
    std::fs::write(&out, plan_text(&frozen).unwrap()).unwrap();
    let set = format!("excitation.plan={}", out.display());
    let space = "workspace={ box-min = [-2.0, -2.0, -2.0], box-max = [2.0, 2.0, 2.0], base-radius = 0.0 }";
    let done = Done::of(place.job("run", &[&set, space])).expect_code(1);
    assert!(done.err.contains("plan.toml: joint 4 is frozen"), "{}", done.output());
    assert!(done.err.contains("Without `excitation.plan` in config/sim-panda-wall.toml"), "{}", done.output());
}

#[test]
fn an_interrupted_search_keeps_the_best() {
    let place = Place::new("plan-stop");
    let out = place.path().join("plan.toml");
    let running = Running::start(plan(&out, &["--rounds", "10000"]));
    wait_for("a handler of Ctrl-C", || catches(running.pid(), libc::SIGINT).then_some(()));
    // Ctrl-Z stops it as it does any program that drives no arm.
    assert!(!catches(running.pid(), libc::SIGTSTP));
    std::thread::sleep(Duration::from_secs(3));
    signal(running.pid(), "INT");
    let done = running.end().expect_code(0);
    assert!(done.err.contains("interrupted; the best motion so far is kept"), "{}", done.output());
    assert!(load_plan(&out).unwrap().conditions.raw < 1000.0);
}

/// Whether a process has a handler for a signal.
fn catches(pid: u32, signal: i32) -> bool {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:")).unwrap();
    u64::from_str_radix(mask.trim(), 16).unwrap() >> (signal - 1) & 1 == 1
}

#[test]
fn a_time_limit_ends_a_search() {
    let place = Place::new("plan-clock");
    let out = place.path().join("plan.toml");
    let done = Done::of(plan(&out, &["--seconds", "1"])).expect_code(0);
    assert!(done.out.contains("condition raw") && !done.err.contains("interrupted"), "{}", done.output());
}

#[test]
fn bad_options_are_named() {
    let place = Place::new("plan-bad");
    let out = place.path().join("plan.toml");
    let model = place.path().join("none.toml");
    let model = model.to_str().unwrap();
    for (more, parts) in [
        (["--seconds", "0"], ["--seconds", "got 0"]),
        (["--period", "1.00005"], ["--period", "whole milliseconds"]),
        (["--harmonics", "2"], ["2 harmonics", "3 to 16"]),
        (["--model", model], ["none.toml", "file"]),
    ] {
        let done = Done::of(plan(&out, &more)).expect_code(2);
        assert!(parts.iter().all(|part| done.err.contains(part)), "{}", done.output());
    }
    assert!(!out.exists());
}

/// A plan file whose motion, or whose way there, brings the arm into itself is refused with the links by name.
#[test]
fn a_self_colliding_plan_is_refused() {
    let place = Place::new("plan-touch");
    let out = place.path().join("plan.toml");
    Done::of(plan(&out, &["--rounds", "0"])).expect_code(0);
    let mut touching = load_plan(&out).unwrap();
    // Folded over its own base, at rest.
    touching.q0 = vec![0.0, 1.6, 0.0, -2.8, 0.0, 2.0, 0.0];
    touching.a.iter_mut().chain(&mut touching.b).for_each(|row| row.fill(0.0));
    std::fs::write(&out, plan_text(&touching).unwrap()).unwrap();
    let set = format!("excitation.plan={}", out.display());
    // The box is set wide, so that only the bodies object.
    let space = "workspace={ box-min = [-2.0, -2.0, -2.0], box-max = [2.0, 2.0, 2.0], base-radius = 0.0 }";
    let done = Done::of(place.job("run", &[&set, space])).expect_code(2);
    assert!(done.err.contains("plan.toml") && done.err.contains("distance of link"), "{}", done.output());
}
