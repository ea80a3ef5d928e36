//! Explanation of a fault: what happened, why, and what the operator does next.

use super::codes::*;
use super::error::{first_bytes, next_step};
use super::telemetry::{Stall, Statistics};
use super::wire::{ErrorBit, MoveStatus, RobotMode};
use plumbline_core::{Explanation, Fault};

/// Explains `fault` of a [`super::FrankaArm`]; `telemetry` is a snapshot taken after it.
pub fn explain(fault: &Fault, telemetry: &Statistics) -> Explanation {
    match fault {
        Fault::Silent { waited_ms } => silent(*waited_ms, telemetry),
        Fault::Reflex { code } if *code >= REFLEX_MODE => stopped_without_error(code - REFLEX_MODE, telemetry),
        Fault::Reflex { code } => reflex(*code, telemetry),
        Fault::Refused { code } if *code >= REFUSED_MOVE => refused_motion(code - REFUSED_MOVE, telemetry),
        Fault::Refused { code } => refused_command(*code),
        Fault::Disconnected if telemetry.garbled.is_some() => garbled(&telemetry.garbled.unwrap_or_default()),
        Fault::Disconnected => Explanation {
            what: "the arm closed the command connection, or its network is gone".into(),
            cause: (telemetry.robot_mode == RobotMode::Move.code())
                .then(|| "a motion was running: the arm stops by itself when the connection goes".into()),
            next: "Look at the cable, at the control unit's power, and whether somebody took control in Desk; then start again.".into(),
        },
    }
}

/// What came over the command connection was no message.
fn garbled(bytes: &[u8]) -> Explanation {
    Explanation {
        what: format!(
            "what came over the command connection is no message of the control interface: it begins with {}",
            first_bytes(bytes)
        ),
        cause: Some("another program answers at this address and port, or something on the way changes the data".into()),
        next: "See that the address is that of the control unit and that nothing forwards or filters its TCP port 1337; then start again."
            .into(),
    }
}

fn silent(waited_ms: u32, telemetry: &Statistics) -> Explanation {
    if let Some([last, number]) = telemetry.restarted {
        return Explanation {
            what: format!("the arm's states count from the beginning again: number {number} after {last}"),
            cause: Some("the control unit was started again, or another one answers at its address".into()),
            next: "See that one control unit has this address and that it is up and unlocked; then start again.".into(),
        };
    }
    let cause = match telemetry.status() {
        _ if telemetry.bad_packets > 0 => Some(format!(
            "{} datagrams of the arm were no states: something on the way changes or cuts them",
            telemetry.bad_packets
        )),
        // The answer to StopMove of this side is not the cause.
        Some(status) if status != MoveStatus::Preempted && status != MoveStatus::Success => {
            Some(format!("over its command connection it says that {status}: the way of its states alone is broken"))
        }
        _ => None,
    };
    Explanation {
        what: format!("no state came from the arm for {waited_ms} ms"),
        cause,
        next: "Look at the cable, the switch and the control unit's power; an arm without commands stops by itself. Then start again."
            .into(),
    }
}

fn reflex(code: u32, telemetry: &Statistics) -> Explanation {
    let named = telemetry.reflex();
    let first = u8::try_from(code).ok().and_then(ErrorBit::from_index);
    let names = if named.is_empty() {
        first.map_or_else(|| format!("error {code}"), |bit| bit.name().into())
    } else {
        named.to_string()
    };
    let cause = match first {
        Some(ErrorBit::CommunicationConstraintsViolation) => Some(stalled(&telemetry.stall, telemetry)),
        Some(
            ErrorBit::JointMotionGeneratorVelocityDiscontinuity
            | ErrorBit::JointMotionGeneratorAccelerationDiscontinuity
            | ErrorBit::JointMotionGeneratorVelocityLimitsViolation
            | ErrorBit::ControllerTorqueDiscontinuity,
        ) if telemetry.lost + telemetry.late_commands + telemetry.skipped > 0 => Some(format!(
            "before it {} states were lost, {} passed over and {} commands came late; {}",
            telemetry.lost,
            telemetry.skipped,
            telemetry.late_commands,
            stalled(&telemetry.stall, telemetry)
        )),
        _ => None,
    };
    let mut next = first.map_or("", after).to_string();
    if telemetry.mode() == RobotMode::Reflex {
        next += " Then allow the recovery (automatic error recovery): the arm stays in its reflex until then, though its errors may have \
                 cleared.";
    }
    Explanation { what: format!("the arm stopped itself: {names}"), cause, next: next.trim().into() }
}

/// Who was late: the largest of our work, our wake-up, and the network.
fn stalled(stall: &Stall, telemetry: &Statistics) -> String {
    let ms = |ns: u64| ns as f64 * 1e-6;
    let Stall { work_ns, wake_ns, network_ns, lost } = *stall;
    // A state that comes while our thread is at work lies in the socket for as long: that much of the wake-up is the work's.
    let woken_late_ns = wake_ns.saturating_sub(work_ns);
    let worst = work_ns.max(woken_late_ns).max(network_ns);
    let rate = telemetry.success_rate;
    if wake_ns.max(worst) < 1_000_000 && lost == 0 {
        return format!(
            "states came and commands left in time (work {:.2} ms, wake-up {:.2} ms at most), so commands were lost between here and the \
             arm; it counted {:.0} % of them",
            ms(work_ns),
            ms(wake_ns),
            100.0 * rate.last
        );
    }
    if worst == work_ns {
        return format!("our own work took {:.2} ms in one cycle, from a state to its command", ms(work_ns));
    }
    if worst == woken_late_ns {
        return format!(
            "a state lay in the socket for {:.2} ms: the real-time thread was not woken in time, or was still busy",
            ms(wake_ns)
        );
    }
    if lost > 0 {
        format!(
            "{lost} states never arrived, and none came for {:.2} ms: the network, or the arm itself",
            ms(network_ns)
        )
    } else {
        format!("no state came for {:.2} ms beyond the one that is due: the network, or the arm itself", ms(network_ns))
    }
}

fn after(bit: ErrorBit) -> &'static str {
    use ErrorBit::*;
    match bit {
        CommunicationConstraintsViolation => {
            "Use a kernel with PREEMPT_RT and real-time rights for the daemon; connect the arm directly, without switch, and keep its network port for it alone; `rig communication` (hil/rig) measures what is left."
        }
        JointReflex | CartesianReflex => {
            "See what the arm touched. If it touched nothing, raise the collision thresholds or set the load that it carries."
        }
        JointPositionLimitsViolation | JointMoveInWrongDirection => "Guide the arm by hand back into its range.",
        SelfCollisionAvoidanceViolation => "Guide the arm apart by hand, and plan the motion with more distance.",
        CartesianPositionLimitsViolation => "Guide the arm back into the space that Desk allows.",
        JointVelocityViolation | CartesianVelocityViolation | PowerLimitViolation => "Plan a slower motion.",
        JointMotionGeneratorPositionLimitsViolation
        | JointMotionGeneratorVelocityLimitsViolation
        | JointMotionGeneratorVelocityDiscontinuity
        | JointMotionGeneratorAccelerationDiscontinuity => {
            "Compare the limits in the robot's description with those that the arm serves, or lower the share of the limits."
        }
        JointPositionMotionGeneratorStartPoseInvalid => "Start again: the motion did not begin where the arm stands.",
        ControllerTorqueDiscontinuity | TauJRangeViolation | InstabilityDetected => {
            "Lower stiffness and damping of the torque interface."
        }
        BaseAccelerationInitializationTimeout | BaseAccelerationInvalidReading => {
            "Restart the control unit with the arm at rest."
        }
        _ => "See what happened, and clear the workspace.",
    }
}

fn stopped_without_error(mode: u32, telemetry: &Statistics) -> Explanation {
    let mode = u8::try_from(mode).ok().and_then(RobotMode::from_code).unwrap_or_default();
    Explanation {
        what: format!("the arm stopped: its mode became `{mode}`"),
        cause: telemetry.status().map(|status| format!("it says that {status}")),
        next: next_step(mode).unwrap_or("Start again.").into(),
    }
}

fn refused_motion(index: u32, telemetry: &Statistics) -> Explanation {
    let status = MoveStatus::ALL.get(index as usize).copied();
    let next = match status {
        Some(MoveStatus::NotPossible) => next_step(telemetry.mode()).unwrap_or("Start again."),
        Some(MoveStatus::StartAtSingularPose) => "Guide the arm out of the singular pose.",
        Some(MoveStatus::PreemptedSafetyFunction | MoveStatus::RejectedSafetyFunction) => {
            "A safety function of Desk is active: acknowledge it there."
        }
        Some(MoveStatus::EmergencyAborted) => "Release the user stop, then start again.",
        Some(MoveStatus::Preempted) => "Another program ended the motion: see who else is connected.",
        _ => "Start again.",
    };
    let what = status.map_or_else(|| format!("the arm answered with status {index}"), |status| status.to_string());
    Explanation { what, cause: None, next: next.into() }
}

fn refused_command(code: u32) -> Explanation {
    let (what, next) = match code {
        REFUSED_NOT_FINITE => {
            ("a command held a number that is none; it was not sent", "This is a fault of the program: report it.")
        }
        REFUSED_JUMP => (
            "a command was too far from where the arm was sent last to be reached inside its limits; it was not sent",
            "See whether the plan's limits are those of this arm, and whether states were lost.",
        ),
        REFUSED_STOPPED => ("the session was stopped", "Connect again to move the arm."),
        REFUSED_POSITION => (
            "a command was outside the arm's range; it was not sent",
            "Compare the robot's description with the arm's limits.",
        ),
        REFUSED_BEFORE_START => ("a command came before the first state", "This is a fault of the program: report it."),
        REFUSED_UNSENT => (
            "the system did not take 20 commands in a row",
            "Does a firewall on this machine block outgoing UDP to the robot? Is its network port up?",
        ),
        REFUSED_NO_START => {
            ("the arm did not start the motion within a second", "Look at its mode in Desk, then start again.")
        }
        REFUSED_REACH => (
            "the desired position is too far from the measured one for the torque interface",
            "See what holds the arm, or raise its stiffness.",
        ),
        _ => return Explanation { what: format!("refused (code {code})"), cause: None, next: "Start again.".into() },
    };
    Explanation { what: what.into(), cause: None, next: next.into() }
}
