//! The fault campaign: the daemon as people start it, on an arm behind the emulator of Franka's interface, and faults of the
//! network, of the robot and by people, in every phase of a job. In every case the arm must stay inside its limits and end at rest, and the
//! daemon must report the cause and the next step.
//!
//! A selection runs with the tests; all cases run by `hil/fci-faults/run.sh`, which writes `docs/results/franka-faults.md`.

mod before_motion;
mod case;
mod judge;

mod scene;
mod table;

use case::{Case, Disturbance, Ending, When};
use plumbline_franka::wire::RobotMode;
use plumbline_testkit::turns::Turns;

/// Arms answer within a millisecond, and daemon and emulator are a processor's work each: one at a time on a small machine.
static MOTIONS: Turns = Turns::new(1);
/// How often a case is played at most.
const TRIES: u32 = 6;

/// Plays a case until `is_right`, or [`TRIES`] times. It is played again only where the arm missed commands or the daemon states: a machine
/// without real-time kernel that has other work stalls for the 20 ms that a robot waits, and that is no fault of the case's. Whatever
/// else is wrong counts at once.
fn play(case: &Case, is_right: impl Fn(&Ending) -> bool) -> Ending {
    // Cases without a motion are not in a hurry.
    let _turn = (case.when != When::Connect).then(|| MOTIONS.take());
    for attempt in 1.. {
        let ending = case.run();
        assert_eq!(ending.objection(), None, "{case:?}: {}", ending.describe());
        if is_right(&ending) {
            return ending;
        }
        assert!(ending.stalled() && attempt < TRIES, "{case:?}, try {attempt}: {}", ending.describe());
        eprintln!("RETRY {attempt} of {case:?}: {}", ending.last_line());
    }
    unreachable!("the loop returns")
}

/// The daemon stopped, and its last line contains `words`.
fn stops(ending: &Ending, words: &[&str]) -> bool {
    ending.code == Some(1) && words.iter().all(|words| ending.last_line().contains(words))
}

/// The case is driven to its end, and the daemon has counted what was lost, what was odd, and what was late.
fn counts_of_a_completed_job(faults: &'static [&'static str]) -> (u64, u64, u64) {
    let ending =
        play(&Case::new(Disturbance::Faults(faults), When::Excite), |ending| ending.code == Some(0) && ending.done);
    let status = ending.status.as_ref().unwrap_or_else(|| panic!("{}", ending.describe()));
    let links = status.sessions.iter().filter_map(|session| session.link.as_ref());
    links.fold((0, 0, 0), |(lost, odd, late), link| (lost + link.lost, odd + link.odd, late + link.late))
}

#[test]
fn datagrams_that_are_lost_doubled_or_damaged_now_and_then_do_not_stop_a_job() {
    let (lost, odd, late) = counts_of_a_completed_job(&[
        "loss=0.02,for=1",
        "duplicate=0.1,for=1",
        "truncate=0.01,for=1",
        "garbage=0.01,for=1",
    ]);
    assert!(lost > 5 && odd > 50 && late > 5, "{lost} {odd} {late}");
}

#[test]
fn datagrams_that_come_unevenly_or_swapped_do_not_stop_a_job() {
    let (_, odd, late) = counts_of_a_completed_job(&["jitter=0.0003,for=1", "reorder=0.01,for=1"]);
    assert!(odd > 0 && late > 0, "{odd} {late}");
}

#[test]
fn an_arm_without_commands_stops_and_the_operator_decides() {
    let case = Case::new(Disturbance::Faults(&["loss=1,of=commands,for=0.1"]), When::Excite);
    let ending = play(&case, |ending| stops(ending, &["communication_constraints_violation", "Next: "]));
    assert_eq!((ending.recoveries(), ending.mode), (0, RobotMode::Reflex), "{}", ending.describe());
}

#[test]
fn where_the_job_allows_it_the_daemon_recovers_and_drives_the_motion_again() {
    let case = Case::new(Disturbance::Faults(&["loss=1,of=commands,for=0.1"]), When::Excite);
    let case = case.with(&["backend.franka.recovery=automatic"]);
    let ending = play(&case, |ending| ending.code == Some(0) && ending.done);
    assert!(
        ending.recoveries() >= 1 && ending.output.contains("communication_constraints_violation"),
        "{}",
        ending.describe()
    );
    // The motion that was interrupted is driven from its beginning.
    assert!(ending.output.matches("identify-wall has started").count() >= 2, "{}", ending.describe());
    assert_eq!(ending.output.matches("identify-wall has ended").count(), 1, "{}", ending.describe());
}

#[test]
fn recoveries_are_limited_to_their_number() {
    // No command arrives ever again.
    let case = Case::new(Disturbance::Faults(&["loss=1,of=commands"]), When::Approach);
    let case = case.with(&["backend.franka.recovery=automatic", "backend.franka.max-recoveries=1"]);
    let ending = play(&case, |ending| ending.code == Some(1));
    assert_eq!(ending.recoveries(), 1, "{}", ending.describe());
    assert!(stops(&ending, &["communication_constraints_violation", "Next: "]), "{}", ending.describe());
}

#[test]
fn a_requested_end_is_not_recovered_from() {
    let case = Case::new(Disturbance::Faults(&["loss=1,of=commands,for=0.1"]), When::Stop);
    let case = case.with(&["backend.franka.recovery=automatic"]);
    let ending = play(&case, |ending| stops(ending, &["communication_constraints_violation"]));
    assert_eq!(ending.recoveries(), 0, "{}", ending.describe());
    assert_eq!(ending.output.matches("identify-wall has started").count(), 1, "{}", ending.describe());
    // To watch, and to drive: not once more after that.
    assert_eq!(ending.output.matches("connected to").count(), 2, "{}", ending.describe());
}

#[test]
fn a_collision_is_never_recovered_from_without_an_operator() {
    let case = Case::new(Disturbance::Reflex, When::Excite).with(&["backend.franka.recovery=automatic"]);
    let ending = play(&case, |ending| stops(ending, &["_reflex", "See what the arm touched"]));
    assert_eq!((ending.recoveries(), ending.mode), (0, RobotMode::Reflex), "{}", ending.describe());
}

#[test]
fn a_user_stop_in_mid_motion_is_named_and_ends_the_job() {
    let case = Case::new(Disturbance::UserStop, When::Approach).with(&["backend.franka.recovery=automatic"]);
    let ending = play(&case, |ending| stops(ending, &["user stopped", "activation device"]));
    assert_eq!((ending.recoveries(), ending.mode), (0, RobotMode::UserStopped), "{}", ending.describe());
}

#[test]
fn a_connection_that_breaks_while_a_model_is_served_is_made_again() {
    let case = Case::new(Disturbance::Faults(&["tcp-reset"]), When::Serve);
    let ending = play(&case.clone().with(&["backend.franka.recovery=automatic"]), |ending| ending.code == Some(0));
    assert!(ending.recoveries() == 1 && ending.output.matches("connected to").count() == 2, "{}", ending.describe());
    play(&case, |ending| stops(ending, &["closed the command connection", "Next: "]));
}

#[test]
fn a_user_stop_while_a_model_is_served_is_reported_and_nothing_ends() {
    let ending = play(&Case::new(Disturbance::UserStop, When::Serve), |ending| ending.code == Some(0));
    assert!(
        ending.output.contains("`user stopped`") && ending.output.contains("activation device"),
        "{}",
        ending.describe()
    );
    assert!(ending.output.contains("the arm's mode is now `idle`"), "{}", ending.describe());
}

#[test]
#[ignore = "six minutes; hil/fci-faults/run.sh runs it and writes docs/results/franka-faults.md"]
fn the_whole_campaign() {
    table::campaign();
}
