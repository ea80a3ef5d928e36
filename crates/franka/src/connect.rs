//! From settings to an arm that is ready to be driven, and back to that state after a reflex.

use super::cycle::{FrankaArm, Transport};
use super::error::{ConnectError, next_step};
use super::gravity::{Estimate, Gravity, compensated};
use super::limits::{self, RobotLimits, widen};
use super::session::Session;
use super::settings::{Interface, Purpose, RobotKind, Settings};
use super::telemetry::Telemetry;
use super::wire::{ErrorBit, Errors, Protocol, RecoveryStatus, Request, Response, RobotMode, RobotState};
use plumbline_core::JointVec;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest time that a recovery may take: the arm may have to move back into its range.
const RECOVERY_TIMEOUT: Duration = Duration::from_secs(30);
/// Pause before an arm that can't be reached is tried again.
const RETRY_PAUSE: Duration = Duration::from_millis(200);
/// Longest wait for states at rest.
const GRAVITY_TIMEOUT: Duration = Duration::from_secs(2);

/// What is known of an arm at connection.
#[derive(Clone, Debug, PartialEq)]
pub struct Info {
    /// Version of the protocol: what libfranka calls the robot server version.
    pub protocol: Protocol,
    /// Robots, system images and libfranka versions of that version.
    pub image: &'static str,
    /// The state at connection.
    pub state: RobotState,
    /// The limits that commands are held to a share of.
    pub limits: RobotLimits,
    /// Whether the limits are the arm's own, from its description; otherwise they are those of the documentation's table.
    pub limits_from_arm: bool,
    /// The description that the arm serves, at versions 9 and 10.
    pub urdf: Option<String>,
    /// Gravity in the base frame that the arm's own controller compensates \[m/s2\].
    pub compensates: [f64; 3],
    /// The direction of gravity that the arm's sensors show; `None` when it was not at rest.
    pub gravity: Option<Gravity>,
    /// Socket options that the system refused, with its reasons.
    pub refused_options: Vec<String>,
}

impl Info {
    /// Where the arm stood \[rad\].
    pub fn pose(&self) -> JointVec {
        widen(&self.state.q)
    }
}

/// What comes with an arm.
#[derive(Clone, Debug)]
pub struct Connection {
    /// What is known of it.
    pub info: Info,
    /// Its counters.
    pub telemetry: Arc<Telemetry>,
}

/// Connects to an arm and makes it ready: version, mode, settings, description, direction of gravity. No motion is started yet.
///
/// Everything that may block or allocate happens in here; it takes about half a second.
///
/// # Errors
///
/// [`ConnectError`], whose text says what the operator can do.
pub fn connect(settings: &Settings) -> Result<(FrankaArm, Connection), ConnectError> {
    let mut session = Session::open(settings)?;
    let state = session.first;
    let commanded = settings.purpose == Purpose::Drive && settings.interface == Interface::Torque;
    let compensates = compensated(&state, settings.compensates, commanded)?;
    if settings.purpose == Purpose::Drive {
        ready(&state)?;
        configure(&mut session, settings)?;
    }
    let (urdf, limits, limits_from_arm) = limits_of(&mut session, settings)?;
    let gravity = estimate_gravity(&mut session, &state);
    let telemetry = Arc::new(Telemetry::default());
    telemetry.in_mode(state.robot_mode);
    let info = Info {
        protocol: session.protocol,
        image: session.protocol.images(),
        state,
        limits,
        limits_from_arm,
        urdf,
        compensates,
        gravity,
        refused_options: std::mem::take(&mut session.refused),
    };
    let cant = |cause| ConnectError::Socket { address: settings.address, what: "switching blocking off", cause };
    let transport = Transport::new(session.commands, session.states, telemetry.clone(), state).map_err(cant)?;
    let arm = FrankaArm::new(settings, transport, limits);
    Ok((arm, Connection { info, telemetry }))
}

/// The limits that an arm serves, or those of its version's table: what motions are planned and checked under before anything moves.
/// Connects, reads, and ends the connection; nothing is commanded.
///
/// # Errors
///
/// [`ConnectError`], whose text says what the operator can do.
pub fn read_limits(settings: &Settings) -> Result<RobotLimits, ConnectError> {
    limits_of(&mut reach(settings)?, settings).map(|(_, limits, _)| limits)
}

/// The description that the arm serves, its limits, and whether these are from the description.
fn limits_of(session: &mut Session, settings: &Settings) -> Result<(Option<String>, RobotLimits, bool), ConnectError> {
    let urdf = session.description()?;
    let limits = match (&urdf, settings.robot) {
        (Some(text), RobotKind::Fr3) => Some(limits::from_urdf(text)),
        _ => None,
    };
    let (limits, from_arm) = match limits {
        // An arm of version 9 may serve a description without the elements that version 10 has added.
        Some(Err(_)) if session.protocol == Protocol::V9 => (settings.table(session.protocol), false),
        Some(found) => (found?, true),
        None => (settings.table(session.protocol), false),
    };
    Ok((urdf, limits, from_arm))
}

/// Asks an arm that was stopped by a reflex to recover, and waits until it is idle. An arm that is idle already is not changed.
///
/// It may move a little, back into its range. Recovers from every reflex: only for an operator who has looked at the arm. A program without an operator
/// uses [`recover_communication`].
///
/// # Errors
///
/// [`ConnectError::Mode`] in any other mode, [`ConnectError::Recovery`] when the arm can't, and what [`connect()`] has.
pub fn recover(settings: &Settings) -> Result<(), ConnectError> {
    let session = reach(settings)?;
    recover_in(session, settings)
}

/// The same for a program without an operator: only from a reflex of `communication_constraints_violation` and nothing else, by the
/// arm's own state at this moment. The fault that the loop saw is not enough: while states were lost the arm may have collided.
///
/// # Errors
///
/// [`ConnectError::NotByItself`] where something else led to the reflex, too, or holds by now; otherwise those of [`recover`].
pub fn recover_communication(settings: &Settings) -> Result<(), ConnectError> {
    let session = reach(settings)?;
    for_communication_alone(&session.first)?;
    recover_in(session, settings)
}

/// Whether a reflex, if there is one, was caused by lost communication alone. A reflex without a reason was not.
fn for_communication_alone(state: &RobotState) -> Result<(), ConnectError> {
    const ALONE: Errors = Errors::NONE.with(ErrorBit::CommunicationConstraintsViolation);
    // The present errors may have cleared; where they have not they count like the reasons.
    let alone = state.reflex_reason == ALONE && (state.errors == ALONE || state.errors.is_empty());
    if state.robot_mode != RobotMode::Reflex || alone {
        return Ok(());
    }
    let reasons = state.reflex_reason.iter().chain(state.errors.iter()).collect();
    Err(ConnectError::NotByItself { reasons })
}

fn recover_in(mut session: Session, settings: &Settings) -> Result<(), ConnectError> {
    // The mode decides: the errors of a reflex clear as soon as the arm rests.
    match session.first.robot_mode {
        RobotMode::Reflex => {}
        RobotMode::Idle => return Ok(()),
        _ => return ready(&session.first),
    }
    let request = Request::AutomaticErrorRecovery;
    let payload = session.commands.call(session.protocol, &request, RECOVERY_TIMEOUT)?;
    if let Response::AutomaticErrorRecovery(status) = Response::decode(session.protocol, request.kind(), &payload)?
        && status != RecoveryStatus::Success
    {
        return Err(ConnectError::Recovery { status, next: after_recovery(status) });
    }
    let deadline = Instant::now() + settings.connect_timeout;
    let mut mode = session.first.robot_mode;
    let mut id = session.first.message_id;
    while Instant::now() < deadline {
        let Some(state) = session.newer_than(id) else { break };
        (mode, id) = (state.robot_mode, state.message_id);
        if mode == RobotMode::Idle {
            return Ok(());
        }
    }
    Err(ConnectError::StillNotIdle { mode, waited: settings.connect_timeout })
}

/// Opens a session with an arm whose network may be recovering: an unreachable arm is tried again for as long as a
/// connection may take.
fn reach(settings: &Settings) -> Result<Session, ConnectError> {
    let deadline = Instant::now() + settings.connect_timeout;
    loop {
        match Session::open(settings) {
            Err(ConnectError::Unreachable { .. }) if Instant::now() < deadline => std::thread::sleep(RETRY_PAUSE),
            outcome => return outcome,
        }
    }
}

fn after_recovery(status: RecoveryStatus) -> &'static str {
    match status {
        RecoveryStatus::Success => "Start again.",
        RecoveryStatus::NotPossible => {
            "It is not in a reflex any more, or its mode forbids it: look at its mode in Desk."
        }
        RecoveryStatus::RejectedSafetyFunction => "A safety function of Desk forbids it: acknowledge it there.",
        RecoveryStatus::ManualRequired => {
            "Unlock it in Desk and guide it by hand back into its range (joint position error recovery)."
        }
        RecoveryStatus::ReflexAborted => "Something is still in the way: clear the workspace and try again.",
        RecoveryStatus::EmergencyAborted => "Release the user stop and try again.",
        RecoveryStatus::Aborted => "Try again; if it stays, look at Desk.",
    }
}

fn ready(state: &RobotState) -> Result<(), ConnectError> {
    match next_step(state.robot_mode) {
        None => Ok(()),
        Some(next) => Err(ConnectError::Mode { mode: state.robot_mode, reasons: state.reflex_reason, next }),
    }
}

fn configure(session: &mut Session, settings: &Settings) -> Result<(), ConnectError> {
    session.set(&Request::SetCollisionBehavior(settings.collision))?;
    if let Some(stiffness) = settings.joint_impedance {
        session.set(&Request::SetJointImpedance(stiffness))?;
    }
    if let Some(stiffness) = settings.cartesian_impedance {
        session.set(&Request::SetCartesianImpedance(stiffness))?;
    }
    if let Some(load) = settings.load {
        session.set(&Request::SetLoad(load))?;
    }
    Ok(())
}

fn estimate_gravity(session: &mut Session, first: &RobotState) -> Option<Gravity> {
    let deadline = Instant::now() + GRAVITY_TIMEOUT;
    let mut estimate = Estimate::default();
    let mut id = first.message_id;
    while !estimate.is_complete() && Instant::now() < deadline {
        let state = session.newer_than(id)?;
        id = state.message_id;
        estimate.add(&state);
    }
    estimate.gravity()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reflex_of_lost_communication_alone_is_the_only_one_to_recover_from_unasked() {
        use ErrorBit::{CommunicationConstraintsViolation as Communication, JointReflex, PowerLimitViolation};
        let none: &[ErrorBit] = &[];
        let judge = |robot_mode, reasons: &[ErrorBit], errors: &[ErrorBit]| {
            let of = |bits: &[ErrorBit]| bits.iter().copied().collect::<Errors>();
            let state =
                RobotState { robot_mode, reflex_reason: of(reasons), errors: of(errors), ..RobotState::default() };
            for_communication_alone(&state).map_err(|error| error.to_string())
        };
        assert_eq!(judge(RobotMode::Reflex, &[Communication], none), Ok(()));
        assert_eq!(judge(RobotMode::Reflex, &[Communication], &[Communication]), Ok(()));
        for bit in ErrorBit::ALL.into_iter().filter(|bit| *bit != Communication) {
            for (reasons, errors) in [
                (&[bit][..], none),
                (&[bit, Communication][..], none),
                (&[Communication][..], &[bit][..]),
                (none, &[bit][..]),
            ] {
                let text = judge(RobotMode::Reflex, reasons, errors).expect_err(bit.name());
                assert!(text.contains(bit.name()) && text.contains("start again"), "{text}");
            }
        }
        assert!(judge(RobotMode::Reflex, none, none).is_err(), "a reflex without a reason");
        // An arm that is idle has nothing to recover from, whatever ended the motion before.
        assert_eq!(judge(RobotMode::Idle, &[JointReflex, PowerLimitViolation], none), Ok(()));
    }
}
