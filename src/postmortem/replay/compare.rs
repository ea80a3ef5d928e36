//! Comparison of the replayed commands and events with the recorded ones.

use super::ReplayResult;
use crate::recording::Recording;
use plumbline_core::{MAX_JOINTS, Record, Validity};
use plumbline_rt::{Event, StopReason, TimedEvent};

fn bitwise_equal(a: &[f64], b: &[f64]) -> bool {
    a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()))
}

fn difference(was: &Record, is: &Record) -> Option<String> {
    let (a, b) = (&was.command.desired, &is.command.desired);
    if was.command.seq != is.command.seq {
        return Some(format!("the command is for state {}, recorded {}", is.command.seq, was.command.seq));
    }
    for (what, x, y) in [("position", &a.q, &b.q), ("velocity", &a.dq, &b.dq), ("acceleration", &a.ddq, &b.ddq)] {
        if let Some(j) = (0..MAX_JOINTS).find(|&j| x[j].to_bits() != y[j].to_bits()) {
            return Some(format!("joint {}: desired {what} {:e}, recorded {:e}", j + 1, y[j], x[j]));
        }
    }
    if was.phase != is.phase {
        return Some(format!("phase {:?}, recorded {:?}", is.phase, was.phase));
    }
    // That the torque was doubted came from outside the loop.
    let validity = if was.validity == Validity::Doubtful { Validity::Valid } else { was.validity };
    if validity != is.validity {
        return Some(format!("validity {:?}, recorded {:?}", is.validity, was.validity));
    }
    (was.model != is.model).then(|| format!("model {:016x}, recorded {:016x}", is.model, was.model))
}

pub(super) fn compare(were: &[Record], are: &[Record], from_the_start: bool) -> ReplayResult {
    let mut result = ReplayResult {
        first: were.first().map_or(0, |record| record.cycle),
        compared: 0,
        from_the_start,
        different: 0,
        first_difference: None,
        torque_different: 0,
        last_torque_difference: None,
        same_events: false,
        end: None,
        same_end: None,
    };
    for (place, was) in were.iter().enumerate() {
        let differs = match are.get(place) {
            Some(is) => {
                result.compared += 1;
                let torques = |of: &Record| [of.command.tau_ff.0, of.command.tau_vendor.0].concat();
                if !bitwise_equal(&torques(was), &torques(is)) {
                    result.torque_different += 1;
                    result.last_torque_difference = Some(was.cycle);
                }
                difference(was, is)
            }
            None => Some("no command: the loop had ended".to_string()),
        };
        if let Some(words) = differs {
            result.different += 1;
            result.first_difference.get_or_insert_with(|| format!("cycle {}: {words}", was.cycle));
        }
    }
    result
}

/// Whether the events from cycle `first` on are the recorded ones. Stops at the program's end and after a heartbeat timeout are replayed
/// as requested stops, and discarded orders are not replayed.
pub(super) fn same_events(recording: &Recording, timed: &[TimedEvent], first: u64) -> bool {
    let plain = |timed: &TimedEvent| match timed.event {
        Event::Discarded { .. } => None,
        Event::Stopping { motion, reason: StopReason::Quit | StopReason::HeartbeatLost { .. } } => {
            Some((timed.cycle, Event::Stopping { motion, reason: StopReason::Requested }))
        }
        event => Some((timed.cycle, event)),
    };
    let were: Vec<_> = recording.events.iter().filter(|timed| timed.cycle >= first).filter_map(plain).collect();
    let are: Vec<_> = timed.iter().filter_map(plain).collect();
    // A NaN in a violation is equal to itself here.
    format!("{were:?}") == format!("{are:?}")
}
