//! Conformance tests of [`Backend`] for every implementation.
//!
//! `make` connects a fresh arm at rest; it is called several times, each arm is dropped before the next is made. A broken promise panics
//! with its name. The arm moves by a few hundredths of a radian. At 1 kHz the suite takes about three seconds.

use plumbline_core::{Backend, Command, Fault, JointVec, MAX_MISSED_COMMANDS, Setpoint, State};

/// Position tolerance at rest \[rad\].
const HOLD: f64 = 2e-3;
/// Tracking tolerance of a slow motion \[rad\].
const TRACK: f64 = 5e-3;
/// Distance and duration of the small motion \[rad\], \[ms\].
const DISTANCE: f64 = 0.03;
const DURATION: u64 = 800;

pub fn conformance<B: Backend>(make: impl Fn() -> B) {
    states_follow_each_other(make());
    holds_still(make());
    follows_a_small_motion(make());
    reports_what_it_accepted(make());
    does_not_move_on_a_bad_number(make());
    stops_before_anything_happened(make());
    stops_in_motion_and_stays_stopped(make());
}

/// Every state is newer than the one before, finite, and nothing past the arm's joints.
fn states_follow_each_other(mut arm: impl Backend) {
    let joints = arm.joints();
    assert!((1..=plumbline_core::MAX_JOINTS).contains(&joints), "joints() is {joints}");
    let mut last = first(&mut arm);
    for _ in 0..100 {
        hold(&mut arm, &last, &last.q_d);
        let state = next(&mut arm);
        assert!(state.seq > last.seq, "seq went from {} to {}", last.seq, state.seq);
        let elapsed = (state.seq - last.seq) as f64 * 1e-3;
        assert!(
            (state.time - last.time - elapsed).abs() < 1e-6,
            "time does not go by seq: {} after {}",
            state.time,
            last.time
        );
        assert_sound(&state, joints);
        last = state;
    }
    assert_eq!(arm.joints(), joints, "joints() changed");
}

fn holds_still(mut arm: impl Backend) {
    let start = first(&mut arm);
    let joints = arm.joints();
    for _ in 0..300 {
        hold(&mut arm, &start, &start.q_d);
        let state = next(&mut arm);
        assert_near(&state.q, &start.q_d, HOLD, joints, "holding still");
    }
}

/// A slow motion of all joints is tracked by the arm's clock, also after lost states.
fn follows_a_small_motion(mut arm: impl Backend) {
    let start = first(&mut arm);
    let joints = arm.joints();
    let mut last = start;
    let mut farthest = 0.0f64;
    while last.seq < start.seq + DURATION + 100 {
        let desired = small_motion(&start.q_d, last.seq + 1 - start.seq, joints);
        send(&mut arm, &last, desired).expect("a slow motion is not refused");
        let state = next(&mut arm);
        // After a longer delay the arm has extrapolated the motion.
        if state.seq - last.seq <= u64::from(MAX_MISSED_COMMANDS) {
            assert_near(&state.q, &desired.q, TRACK, joints, "following");
        }
        last = state;
        farthest = farthest.max((last.q[joints - 1] - start.q_d[joints - 1]).abs());
    }
    assert!(farthest > DISTANCE - TRACK, "the arm moved by {farthest} rad instead of {DISTANCE}");
    assert_near(&last.q, &start.q_d, HOLD, joints, "back at the start");
}

/// `q_d` is the command that was accepted.
fn reports_what_it_accepted(mut arm: impl Backend) {
    let start = first(&mut arm);
    let joints = arm.joints();
    let mut last = start;
    for tick in 1..50 {
        let desired = small_motion(&start.q_d, tick, joints);
        send(&mut arm, &last, desired).expect("a slow motion is not refused");
        let state = next(&mut arm);
        // After a lost state the arm extrapolates.
        if state.seq == last.seq + 1 {
            assert_near(&state.q_d, &desired.q, 1e-6, joints, "q_d after a command");
        }
        last = state;
    }
}

/// A command that is not a number is refused or ends in a fault, and the arm stays where it is.
fn does_not_move_on_a_bad_number(mut arm: impl Backend) {
    let start = first(&mut arm);
    let joints = arm.joints();
    hold(&mut arm, &start, &start.q_d);
    let mut last = next(&mut arm);
    let mut bad = start.q_d;
    bad[joints - 1] = f64::NAN;
    let mut objected = send(&mut arm, &last, at_rest(&bad)).is_err();
    for _ in 0..50 {
        match arm.read() {
            Ok(state) => last = state,
            Err(_) => {
                objected = true;
                break;
            }
        }
        assert_sound(&last, joints);
        assert_near(&last.q, &start.q_d, HOLD, joints, "after a command that is not a number");
    }
    assert!(objected, "NaN was accepted");
    arm.stop();
}

/// Stopping an arm that was never moved, twice, before and after a read.
fn stops_before_anything_happened(mut arm: impl Backend) {
    let joints = arm.joints();
    arm.stop();
    arm.stop();
    if let Ok(state) = arm.read() {
        assert_sound(&state, joints);
        arm.stop();
    }
}

/// After a stop during a motion the arm comes to rest, and all states are finite.
fn stops_in_motion_and_stays_stopped(mut arm: impl Backend) {
    let start = first(&mut arm);
    let joints = arm.joints();
    let mut last = start;
    while last.seq < start.seq + DURATION / 4 {
        let desired = small_motion(&start.q_d, last.seq + 1 - start.seq, joints);
        send(&mut arm, &last, desired).expect("a slow motion is not refused");
        last = next(&mut arm);
    }
    arm.stop();
    arm.stop();
    let mut rest: Option<State> = None;
    for tick in 0..300 {
        let Ok(state) = arm.read() else { break };
        assert_sound(&state, joints);
        assert_near(&state.q, &last.q, DISTANCE, joints, "stopping");
        if tick == 200 {
            rest = Some(state);
        }
        if let Some(rest) = &rest {
            assert_near(&state.q, &rest.q, HOLD, joints, "at rest after a stop");
        }
    }
    arm.stop();
}

/// Out by [`DISTANCE`] and back within [`DURATION`], smooth to the third derivative.
fn small_motion(from: &JointVec, tick: u64, joints: usize) -> Setpoint {
    use std::f64::consts::PI;
    let omega = PI / (DURATION as f64 * 1e-3);
    let t = tick.min(DURATION) as f64 * 1e-3;
    let (sin, cos) = (omega * t).sin_cos();
    let mut desired = at_rest(from);
    for j in 0..joints {
        desired.q[j] += DISTANCE * sin.powi(4);
        desired.dq[j] = DISTANCE * omega * 4.0 * sin.powi(3) * cos;
        desired.ddq[j] = DISTANCE * omega * omega * 4.0 * sin * sin * (3.0 * cos * cos - sin * sin);
    }
    desired
}

fn at_rest(q: &JointVec) -> Setpoint {
    Setpoint { q: *q, ..Setpoint::default() }
}

fn first(arm: &mut impl Backend) -> State {
    arm.read().expect("a fresh arm has a state")
}

fn next(arm: &mut impl Backend) -> State {
    arm.read().expect("an arm that gets its commands goes on")
}

fn hold(arm: &mut impl Backend, state: &State, q: &JointVec) {
    send(arm, state, at_rest(q)).expect("holding still is not refused");
}

fn send(arm: &mut impl Backend, state: &State, desired: Setpoint) -> Result<(), Fault> {
    arm.write(&Command { seq: state.seq, desired, ..Command::default() })
}

fn assert_sound(state: &State, joints: usize) {
    for (name, vector) in [("q", &state.q), ("dq", &state.dq), ("tau", &state.tau), ("q_d", &state.q_d)] {
        assert!(vector.iter().all(|value| value.is_finite()), "{name} is not finite: {vector:?}");
        assert!(
            vector[joints..].iter().all(|&value| value == 0.0),
            "{name} past joint {joints} is not zero: {vector:?}"
        );
    }
}

fn assert_near(q: &JointVec, goal: &JointVec, tolerance: f64, joints: usize, when: &str) {
    for j in 0..joints {
        let off = (q[j] - goal[j]).abs();
        assert!(off <= tolerance, "{when}: joint {} is {off} rad off, {tolerance} allowed", j + 1);
    }
}
