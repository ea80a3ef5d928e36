//! The daemon's flight recorder, in whole jobs: every kind of fault leaves a file that tells what happened and runs again bit for bit; a
//! disk that does not take it is said, and a kill while writing leaves whole files.

use plumbline::recording::Recording;
use plumbline_ipc::{Client, Request, Response, RobotId};
use plumbline_testkit::job::*;
use plumbline_testkit::peers;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// One second before the fault: the window begins in the middle of a motion.
const SPAN: &str = "recorder.span=1 s";

fn recordings(dir: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(dir).map(|entries| entries.map(|entry| entry.unwrap().path()).collect()).unwrap_or_default();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    found.sort();
    found
}

#[track_caller]
fn recording(place: &Place) -> PathBuf {
    let found = recordings(&place.out().join("flight"));
    assert_eq!(found.len(), 1, "{found:?}");
    found[0].clone()
}

/// What `plumbline postmortem --replay --json` says of it; the replay gave the same commands, or this fails.
#[track_caller]
fn facts(file: &Path) -> Value {
    let done = Done::of(plumbline().arg("postmortem").arg(file).args(["--replay", "--json"])).expect_code(0);
    let page = std::fs::read_to_string(file.with_extension("html")).unwrap();
    assert!(page.contains("<svg") && !page.contains("src=") && !page.contains("href="));
    let facts: Value = serde_json::from_str(&done.out).unwrap();
    let steps = facts["next"].as_array().unwrap();
    assert_eq!(page.contains("What to do next"), !steps.is_empty());
    facts
}

/// A simulated arm with more in its truth file.
fn arm_with(place: &Place, keys: &str) -> String {
    let plain = std::fs::read_to_string("config/arms/sim-panda.toml").unwrap();
    let path = place.path().join("arm.toml");
    let plain: Vec<&str> = plain.lines().filter(|line| !line.starts_with("drop-")).collect();
    std::fs::write(&path, format!("{keys}\n{}", plain.join("\n"))).unwrap();
    format!("backend.arm={}", path.display())
}

fn texts<'v>(facts: &'v Value, key: &str) -> Vec<&'v str> {
    facts["timeline"].as_array().unwrap().iter().map(|line| line[key].as_str().unwrap()).collect()
}

#[test]
fn a_guard_stop_during_a_motion() {
    let place = Place::new("flight-guard");
    let done = place.run(&short(&[SPAN, "safety.tracking-error=0.1 deg"])).expect_code(1);
    let file = recording(&place);
    assert!(done.err.contains(&format!("plumbline postmortem {}", file.display())), "{}", done.output());
    let facts = facts(&file);
    assert_eq!((facts["kind"].as_str(), facts["first_limit"]["limit"].as_str()), (Some("guard"), Some("tracking")));
    assert!(facts["during"].as_str().unwrap().contains("identify-wall"), "{facts}");
    assert_eq!(
        (facts["stop"]["at_rest"].as_bool(), facts["replay"]["from_the_start"].as_bool()),
        (Some(true), Some(false))
    );
    assert!(facts["stop"]["seconds"].as_f64().unwrap() < 1.0);
    // In order, with the cause before the effect and the end at zero.
    let what = texts(&facts, "text");
    let place_of =
        |part: &str| what.iter().position(|text| text.contains(part)).unwrap_or_else(|| panic!("{part}: {what:?}"));
    assert!(
        place_of("recording begins") < place_of("is being stopped")
            && place_of("is being stopped") < place_of("at rest")
    );
    assert!(facts["next"].as_array().unwrap().iter().any(|step| step.as_str().unwrap().contains("command resume")));
    let before = facts["first_limit"]["before"].as_f64().unwrap();
    let seconds = facts["timing"]["elapsed"].as_u64().unwrap() as f64 * 1e-3;
    assert!((seconds - 1.0 - before).abs() < 0.005, "one second before the fault, and the stop: {seconds} {before}");

    // What plumbline wrote, it also takes as a run.
    let data = place.path().join("data");
    std::fs::create_dir(&data).unwrap();
    std::fs::copy(&file, data.join("run.mcap")).unwrap();
    let run = plumbline::dataset::Run::read(&data.join("run.mcap"), plumbline_model::Mounting::WALL).unwrap();
    let cycles = Recording::read(&file).unwrap().records.len();
    assert_eq!((run.samples(), run.joints(), run.data.tau.ncols()), (cycles, 7, 7));

    // Other people's reader finds every message.
    if let Some(python) = peers::interpreter_in("flight", &["mcap-ros2-support==0.5.*"]) {
        let script = "import sys, collections\n\
                      from mcap_ros2.reader import read_ros2_messages\n\
                      count, last = collections.Counter(), {}\n\
                      for m in read_ros2_messages(sys.argv[1]):\n\
                      \x20   count[m.channel.topic] += 1\n\
                      \x20   last[m.channel.topic] = m.ros_msg\n\
                      position, frames = last['/joint_states'].position, last['/tf'].transforms\n\
                      print(count['/joint_states'], count['/command'], count['/plumbline/cycle'], len(position), repr(position[6]))\n\
                      joints = last['/robot_description'].data.count('type=\"revolute\"')\n\
                      print(count['/tf'], len(frames), frames[-1].child_frame_id, joints)\n";
        let done = Done::of(Command::new(python).args(["-c", script]).arg(&file)).expect_code(0);
        let last = Recording::read(&file).unwrap().records[cycles - 1];
        let placements = cycles.div_ceil(20);
        let expected = format!("{cycles} {cycles} {cycles} 7 {:?}\n{placements} 9 panda_flange 7", last.state.q[6]);
        assert_eq!(done.out.trim(), expected, "{}", done.output());
    }
}

#[test]
fn lost_states_and_a_reflex() {
    for (name, keys, set, kind) in [
        ("lost", "drop-probability = 0.0004\ndrop-burst = 4", "safety.max-lost=3", "lost-states"),
        ("reflex", "drop-probability = 0.0004\ndrop-burst = 40", "safety.max-lost=25", "reflex"),
    ] {
        let place = Place::new(&format!("flight-{name}"));
        let arm = arm_with(&place, keys);
        place.run(&short(&[SPAN, &arm, set])).expect_code(1);
        let facts = facts(&recording(&place));
        assert_eq!(facts["kind"].as_str(), Some(kind), "{facts}");
        if kind == "lost-states" {
            assert!(facts["timing"]["lost"].as_u64().unwrap() >= 4 && facts["end"].is_null(), "{facts}");
            assert!(facts["timing"]["outliers"].to_string().contains("4 states lost"), "{facts}");
        } else {
            assert!(facts["end"].as_str().unwrap().contains("code 25"), "{facts}");
            assert!(texts(&facts, "text").last().unwrap().contains("the loop ended"), "{facts}");
        }
    }
}

/// A run in motion with a recording on demand, and its estimator. A machine that stalls makes the daemon lose the estimator before: then another run.
fn recorded_on_demand() -> (Place, Running, u32) {
    for attempt in 1.. {
        let place = Place::new(&format!("flight-estimator-{attempt}"));
        let sets = ["safety.on-estimator-loss=stop", "excitation.periods=500", SPAN, "excitation.starts=1"];
        let run = Running::start(place.job("run", &short(&sets)));
        let estimator = wait_for("the estimator", || children(run.pid(), "estimator").first().copied());
        wait_for("the motion", || (place.status()?.cycles > 6_000).then_some(()));
        let answer = place.command("record");
        if answer.code == Some(0) {
            return (place, run, estimator);
        }
        let done = run.end();
        assert!(done.err.contains("has been silent for") && attempt < 5, "{}\n{}", answer.output(), done.output());
        eprintln!("RETRY {attempt}: {}", done.err.lines().last().unwrap_or(""));
    }
    unreachable!("the loop returns")
}

#[test]
fn an_estimator_that_is_gone_a_recording_on_demand_and_an_end_that_is_none() {
    let (place, run, estimator) = recorded_on_demand();
    let first = wait_for("a recording", || recordings(&place.out().join("flight")).first().cloned());
    assert_eq!(facts(&first)["kind"].as_str(), Some("on-demand"));
    signal(estimator, "KILL");
    run.end().expect_code(1);
    let found = recordings(&place.out().join("flight"));
    assert_eq!(found.len(), 2, "{found:?}");
    let second =
        found.iter().find(|path| path.to_string_lossy().contains("estimator-lost")).expect("its reason is its name");
    let facts = facts(second);
    assert!(facts["reason"].as_str().unwrap().contains("by safety.on-estimator-loss, the arm stops"), "{facts}");
    assert!(texts(&facts, "text").iter().any(|text| text.contains("died")), "{facts}");

    // A program that is asked to end leaves none.
    let place = Place::new("flight-quit");
    let daemon = place.daemon(&short(&[SPAN]));
    let refused = place.command("record").expect_code(1);
    assert!(refused.err.contains("nothing to record"), "{}", refused.output());
    place.command("start").expect_code(0);
    wait_for("the motion", || (place.status()?.cycles > 2_000).then_some(()));
    // A loaded machine may end the daemon before its answer has been read.
    place.command("quit");
    daemon.end().expect_code(0);
    assert!(recordings(&place.out().join("flight")).is_empty());
}

#[test]
fn a_full_disk_is_reported_and_keeps_old_results() {
    let place = Place::new("flight-disk");
    let not_a_folder = place.path().join("file");
    std::fs::write(&not_a_folder, "x").unwrap();
    let dir = format!("recorder.dir={}", not_a_folder.join("flight").display());
    let done = place.run(&short(&[SPAN, &dir, "safety.tracking-error=0.1 deg"])).expect_code(1);
    assert!(done.err.contains("recording of the fault could not be written"), "{}", done.output());
    assert!(done.err.contains(&not_a_folder.display().to_string()), "{}", done.output());
    assert!(done.err.contains("the arm is at rest"), "{}", done.output());

    // A disk that is full: a file system of 64 KiB, where this may make one.
    let tiny = place.path().join("tiny");
    std::fs::create_dir(&tiny).unwrap();
    let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", "size=64k", "tmpfs"]).arg(&tiny).status();
    if !mounted.is_ok_and(|status| status.success()) {
        return eprintln!("SKIPPED: no small file system could be mounted");
    }
    let dir = format!("recorder.dir={}", tiny.display());
    let done = place.run(&short(&[SPAN, &dir, "safety.tracking-error=0.1 deg"]));
    let left: Vec<_> = std::fs::read_dir(&tiny).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(Command::new("umount").arg(&tiny).status().unwrap().success());
    let done = done.expect_code(1);
    assert!(done.err.contains("could not be written") && done.err.contains("No space left"), "{}", done.output());
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_kill_during_a_write_leaves_complete_files_and_old_ones_are_removed() {
    let place = Place::new("flight-kill");
    let dir = place.out().join("flight");
    for round in 0..4 {
        let sets = ["excitation.periods=500", "recorder.span=1 s", "recorder.keep-on-demand=2"];
        let daemon = place.daemon(&short(&sets));
        place.command("start").expect_code(0);
        wait_for("the motion", || (place.status()?.cycles > 2_000).then_some(()));
        for _ in 0..1 + round % 2 {
            // The next one waits for the one before.
            wait_for("a recording", || (place.command("record").code == Some(0)).then_some(()));
        }
        std::thread::sleep(std::time::Duration::from_millis(3 * round));
        signal(daemon.pid(), "KILL");
        daemon.end();
        for file in recordings(&dir) {
            let whole = Recording::read(&file).unwrap();
            assert!(whole.cut.is_none() && whole.records.len() > 900, "{}: {:?}", file.display(), whole.cut);
        }
        // A kill between the new file and the removal of the oldest leaves one more.
        assert!(recordings(&dir).len() <= 3);
    }
    assert!(!recordings(&dir).is_empty());
}

#[test]
fn many_requests_remove_no_fault_recording_and_delay_no_shutdown() {
    let place = Place::new("flight-flood");
    let dir = place.out().join("flight");
    let sets = [SPAN, "safety.tracking-error=0.1 deg", "recorder.keep=1", "recorder.keep-on-demand=1"];
    let daemon = place.daemon(&short(&sets));
    place.command("start").expect_code(0);
    let fault = wait_for("the recording of the stop", || recordings(&dir).first().cloned());
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    let (mut accepted, mut refused) = (0, 0);
    let begin = std::time::Instant::now();
    while begin.elapsed() < std::time::Duration::from_secs(5) || accepted < 2 {
        match client.send(&Request::Record {}, TIMEOUT).unwrap() {
            Response::Accepted {} => accepted += 1,
            Response::Refused { reason } => {
                assert!(reason.contains("is being written") || reason.contains("one in 2 s at most"), "{reason}");
                refused += 1;
            }
            other => panic!("{other:?}"),
        }
    }
    // One at a time with a pause between: what is still to be written at the end is one.
    assert!(accepted <= 1 + begin.elapsed().as_secs() / 2, "{accepted} accepted in {:?}", begin.elapsed());
    assert!(refused > 10, "{refused} refused");
    assert!(fault.exists(), "{:?}", recordings(&dir));
    signal(daemon.pid(), "TERM");
    daemon.end().expect_code(0);
    let found = recordings(&dir);
    assert!(found.len() == 2 && fault.exists(), "{found:?}");
    assert_eq!(facts(&fault)["kind"].as_str(), Some("guard"));
}

#[test]
fn stops_of_an_arm_at_rest_leave_no_recordings() {
    let place = Place::new("flight-rest");
    let daemon =
        Running::start(place.job("daemon", &short(&[SPAN, "backend.pace=wall-clock", "safety.max-lost=1000"])));
    wait_for("the loop", || place.status().filter(|now| now.cycles > 100));
    for _ in 0..3 {
        place.command("stop").expect_code(0);
        wait_for("permission", || (place.command("resume").code == Some(0)).then_some(()));
    }
    place.quit(daemon);
    assert!(recordings(&place.out().join("flight")).is_empty());
}
