//! Faults before the first motion, as the daemon reports them after its start.

use super::case::{Case, Disturbance, When};
use super::{play, stops};

/// The daemon ends before a motion, and its last line contains `words`.
#[track_caller]
fn is_refused(disturbance: Disturbance, words: &[&str]) {
    let ending = play(&Case::new(disturbance, When::Connect), |ending| stops(ending, words));
    assert_eq!(ending.arm.last_moved, None, "{}", ending.describe());
}

#[test]
fn blocked_udp_is_named_with_the_firewall() {
    is_refused(Disturbance::Faults(&["loss=1"]), &["none of its states arrived at UDP port", "firewall"]);
}

#[test]
fn states_that_are_cut_on_the_way_are_told_from_none() {
    is_refused(Disturbance::Faults(&["truncate=1"]), &["none is a state", "changes or cuts them"]);
}

#[test]
fn a_declared_compensation_that_the_arm_contradicts_is_refused_by_name() {
    let case = Case::new(Disturbance::None, When::Connect).with(&["backend.franka.compensates=true"]);
    play(&case, |ending| stops(ending, &["compensates", "O_ddP_O"]));
}
