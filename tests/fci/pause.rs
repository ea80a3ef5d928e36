//! A pause on a Franka: the session ends with the arm at rest, the arm is only monitored meanwhile, and `resume` drives from where the arm is
//! then.

use plumbline_core::Phase;
use plumbline_franka::wire::Protocol;
use plumbline_ipc::{Progress, Status};
use plumbline_testkit::emulator::{Emulator, Settings, address};
use plumbline_testkit::job::*;
use std::time::Duration;

#[test]
fn a_paused_franka_is_monitored_and_goes_on_from_where_it_is() {
    let address = address();
    let settings = Settings { command_wait: Duration::from_millis(200), ..Settings::new(address, Protocol::V5) };
    let emulator = Emulator::start(settings).unwrap();
    let place = Place::new("fci-pause");
    let at = format!("backend.franka.address={address}");
    let sets = short(&[
        "excitation.trajectories=1",
        "excitation.periods=20",
        "validation.mountings=[\"wall\"]",
        "realtime.lock-memory=false",
        &at,
    ]);
    let mut command = plumbline();
    command.args(["daemon", "config/panda-emulator-wall.toml", "--out"]).arg(place.out());
    command.arg("--set").arg(format!("serve.id={}", place.id));
    for set in &sets {
        command.arg("--set").arg(set);
    }
    let daemon = Running::start(command);
    wait_for("the daemon", || place.status());
    place.command("start").expect_code(0);
    let speed = || emulator.snapshot().state.dq_d.iter().fold(0.0, |most: f64, dq| most.max(dq.abs()));
    let in_motion = |now: &Status| now.progress == Progress::Driving && now.phase == Phase::Excite;
    for _ in 0..2 {
        wait_for("the motion", || place.status().filter(in_motion));
        wait_for("speed", || (speed() > 0.2).then_some(()));
        place.command("pause").expect_code(0);
        wait_for("the rest", || (speed() == 0.0).then_some(()));
        let paused = |now: &Status| now.progress == Progress::Paused && now.phase == Phase::Hold;
        wait_for("the monitor's connection", || place.status().filter(paused));
        let before = emulator.snapshot().state.q_d;
        std::thread::sleep(Duration::from_millis(500));
        assert_eq!((emulator.snapshot().state.q_d, emulator.snapshot().connected), (before, true));
        place.command("resume").expect_code(0);
    }
    wait_for("the motion", || place.status().filter(in_motion));
    place.command("stop").expect_code(0);
    wait_for("the stop", || place.status().filter(|now| now.progress == Progress::Stopped));
    let done = place.quit(daemon);
    assert_eq!(done.err.matches("identify-wall has started").count(), 3, "{}", done.output());
}
