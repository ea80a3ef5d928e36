//! Known pains before the first motion: what a person sees who has just started the daemon.

use super::case::{Case, Trouble, When};
use super::{play, stops};
use plumbline_testkit::emulator::Hand;
use plumbline_testkit::job::{Place, Running, plumbline};

/// The daemon does not come as far as a motion, and its last words hold these.
#[track_caller]
fn is_told(trouble: Trouble, words: &[&str]) {
    let ending = play(&Case::new(trouble, When::Connect), |ending| stops(ending, words));
    assert_eq!(ending.arm.last_moved, None, "{}", ending.words());
}

#[test]
fn another_protocol_version_is_named_with_what_to_update() {
    is_told(Trouble::Faults(&["wrong-version=4"]), &["protocol version 4", "Update the robot's system image"]);
    is_told(Trouble::Faults(&["wrong-version=12"]), &["protocol version 12", "newer version of this program"]);
}

#[test]
fn a_pressed_user_stop_is_named_with_how_to_release_it() {
    is_told(Trouble::UserStop, &["user stopped", "activation device"]);
}

#[test]
fn an_arm_in_a_wrong_mode_is_named_with_the_way_out() {
    is_told(Trouble::Reflex, &["`reflex`", "communication_constraints_violation", "automatic error recovery"]);
    is_told(Trouble::Hand(Hand::Lock), &["unlock the joints", "activate FCI"]);
    is_told(Trouble::Hand(Hand::Guide), &["guiding", "let go of the guiding buttons"]);
}

#[test]
fn blocked_udp_is_named_with_the_firewall() {
    is_told(Trouble::Faults(&["loss=1"]), &["none of its states arrived at UDP port", "firewall"]);
}

#[test]
fn states_that_are_cut_on_the_way_are_told_from_none() {
    is_told(Trouble::Faults(&["truncate=1"]), &["none is a state", "changes or cuts them"]);
}

#[test]
fn nobody_at_the_address_is_named_with_what_to_look_at() {
    let place = Place::new("faults-nobody");
    let mut daemon = plumbline();
    daemon.args(["daemon", "config/panda-emulator-wall.toml", "--out"]).arg(place.out());
    let plan = concat!("excitation.plan=", env!("CARGO_MANIFEST_DIR"), "/tests/fci/fci_faults/excitation.toml");
    let sets = ["backend.franka.address=127.0.46.254", plan, "validation.trajectories=0"];
    sets.iter().for_each(|set| {
        daemon.args(["--set", set]);
    });
    daemon.arg("--set").arg(format!("serve.id={}", place.id));
    let done = Running::start(daemon).end().expect_code(1);
    let last = done.err.lines().rfind(|line| line.starts_with("plumbline: ")).unwrap_or("");
    assert!(last.contains("no connection to the arm at 127.0.46.254"), "{}", done.said());
    assert!(last.contains("does not listen on port 1337: in Desk, activate FCI"), "{}", done.said());
}

#[test]
fn a_declared_compensation_that_the_arm_contradicts_is_refused_by_name() {
    let case = Case::new(Trouble::None, When::Connect).with(&["backend.franka.compensates=true"]);
    play(&case, |ending| stops(ending, &["compensates", "O_ddP_O"]));
}
