//! Known pains before the first motion: what a person sees who has just started the daemon.

use super::case::{Case, Trouble, When};
use super::{play, stops};

/// The daemon does not come as far as a motion, and its last words hold these.
#[track_caller]
fn is_told(trouble: Trouble, words: &[&str]) {
    let ending = play(&Case::new(trouble, When::Connect), |ending| stops(ending, words));
    assert_eq!(ending.arm.last_moved, None, "{}", ending.words());
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
fn a_declared_compensation_that_the_arm_contradicts_is_refused_by_name() {
    let case = Case::new(Trouble::None, When::Connect).with(&["backend.franka.compensates=true"]);
    play(&case, |ending| stops(ending, &["compensates", "O_ddP_O"]));
}
