//! A pause in mid-job: the arm brakes as for a stop, `resume` drives the interrupted motion again from its start, and the job ends as one
//! that was not paused.

use plumbline_core::Phase;
use plumbline_ipc::{Progress, Status};
use plumbline_testkit::job::*;
use std::process::Command;

/// A motion that takes seconds in simulated time.
const LONG: &str = "excitation.periods=100";

fn at(place: &Place, progress: Progress) -> Status {
    wait_for(&format!("{progress:?}"), || place.status().filter(|now| now.progress == progress))
}

fn in_mid_motion(place: &Place) -> Status {
    wait_for("the motion", || place.status().filter(|now| now.phase == Phase::Excite && now.cycles > 5_000))
}

#[test]
fn a_paused_job_ends_as_one_that_was_not() {
    let place = Place::new("pause");
    let run = Running::start(place.job("run", &short(&[LONG])));
    in_mid_motion(&place);
    place.command("pause").expect_code(0);
    let rests = |now: &Status| now.progress == Progress::Paused && now.phase == Phase::Stopped;
    wait_for("the pause", || place.status().filter(rests));
    // Nothing moves, and only `resume` changes that.
    let cycles = || {
        std::thread::sleep(std::time::Duration::from_millis(400));
        place.status().unwrap().cycles
    };
    assert_eq!(cycles(), cycles());
    for (order, says) in [("start", "started before"), ("pause", "nothing is being driven")] {
        let refused = place.command(order).expect_code(1);
        assert!(refused.err.contains(says), "{}", refused.output());
    }
    place.command("resume").expect_code(0);
    let done = run.end().expect_code(0);
    assert!(done.err.contains("identify-wall is incomplete and left out"), "{}", done.output());
    let report = place.report();
    let ipc = report.ipc.unwrap();
    assert_eq!((ipc.counters.received, ipc.counters.missed), (ipc.sent, 0), "{ipc:?}");
    assert_eq!(report.control_loop.unwrap().dropped_records, 0);
}

#[test]
fn a_pause_outlasts_the_wait_for_a_model_and_a_stop_ends_it() {
    let place = Place::new("pause-model");
    let daemon = place.daemon(&short(&[]));
    let refused = place.command("pause").expect_code(1);
    assert!(refused.err.contains("nothing is being driven"), "{}", refused.output());
    place.command("start").expect_code(0);
    at(&place, Progress::AwaitingModel);
    for _ in 0..2 {
        place.command("pause").expect_code(0);
        at(&place, Progress::Paused);
        wait_for("the permission", || (place.command("resume").code == Some(0)).then_some(()));
        // What was driven stays driven.
        at(&place, Progress::AwaitingModel);
    }
    place.command("pause").expect_code(0);
    place.command("stop").expect_code(0);
    at(&place, Progress::Stopped);
    wait_for("the permission", || (place.command("resume").code == Some(0)).then_some(()));
    assert_eq!(place.status().unwrap().progress, Progress::Stopped);
    place.quit(daemon);
}

/// A terminal of 80 columns and 24 lines.
struct Terminal(String);

impl Terminal {
    fn tmux(&self, arguments: &[&str]) -> String {
        let done = Done::of(Command::new("tmux").args(["-L", &self.0]).args(arguments)).expect_code(0);
        done.out
    }

    fn await_screen(&self, text: &str) -> String {
        wait_for(text, || Some(self.tmux(&["capture-pane", "-p"])).filter(|screen| screen.contains(text)))
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = Command::new("tmux").args(["-L", &self.0, "kill-server"]).output();
    }
}

#[test]
fn keys_of_the_live_view_pause_and_resume() {
    if Command::new("tmux").arg("-V").output().is_err() {
        eprintln!("SKIPPED: tmux is not installed");
        return;
    }
    let place = Place::new("pause-keys");
    let daemon = place.daemon(&short(&LONG_ON_CLOCK));
    place.command("start").expect_code(0);
    place.await_motion();
    let terminal = Terminal(place.id.clone());
    let view = format!("{} monitor --robot {}", program().display(), place.id);
    terminal.tmux(&["new-session", "-d", "-x", "80", "-y", "24", &view]);
    let screen = terminal.await_screen("p pause");
    assert!(screen.contains("DRIVING") && screen.contains("q leave (arm goes on)"), "{screen}");
    terminal.tmux(&["send-keys", "p"]);
    let screen = terminal.await_screen("PAUSED");
    assert!(screen.contains("pause accepted"), "{screen}");
    at(&place, Progress::Paused);
    // What moves the arm is asked about.
    terminal.tmux(&["send-keys", "r"]);
    terminal.await_screen("RESUME after the stop or pause?");
    terminal.tmux(&["send-keys", "n"]);
    assert_eq!(place.status().unwrap().progress, Progress::Paused);
    wait_for("the rest", || {
        terminal.tmux(&["send-keys", "r", "y"]);
        place.status().filter(|now| now.progress == Progress::Driving)
    });
    place.await_motion();
    terminal.await_screen("DRIVING");
    terminal.tmux(&["send-keys", "Space"]);
    at(&place, Progress::Stopped);
    terminal.tmux(&["send-keys", "q"]);
    place.quit(daemon);
}
