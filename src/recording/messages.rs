//! Messages of a recording: ROS 2 definitions, encoding and decoding.
//!
//! A cycle is three messages with the cycle's number as their sequence number. State and command are `sensor_msgs/JointState`, which
//! viewers plot; the other values are `plumbline_msgs/Cycle`.

use super::cdr::{CdrError, Decoder, Encoder};
use plumbline_core::{MAX_JOINTS, Phase, Record, Validity};
use plumbline_rt::{Event, Limit, StopReason, TimedEvent, Violation};

const RULE: &str = "================================================================================";

/// Topic of the measured positions, velocities and torques.
pub const STATES: &str = "/joint_states";
/// Topic of the desired positions and velocities, and of the model's torque.
pub const COMMANDS: &str = "/command";
/// Topic of the other values of a cycle.
pub const CYCLES: &str = "/plumbline/cycle";
/// Topic of the loop's events.
pub const EVENTS: &str = "/plumbline/event";
/// Topic of the events and the daemon's remarks as text.
pub const LOG: &str = "/rosout";

/// Topic of the time and the further columns of a dataset's run.
pub const SAMPLES: &str = "/plumbline/sample";

/// Topic of the arm's description as URDF.
pub const DESCRIPTION: &str = "/robot_description";
/// Topic of the placements of its links.
pub const TRANSFORMS: &str = "/tf";

/// Name and definition of the type of `topic`.
pub(super) fn schema(topic: &str) -> (&'static str, String) {
    let time = format!("{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n");
    match topic {
        STATES | COMMANDS => (
            "sensor_msgs/msg/JointState",
            format!(
                "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n\
                 {RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{time}"
            ),
        ),
        SAMPLES => (
            "plumbline_msgs/msg/Sample",
            "float64 t          # [s]\n\
             float64[] further  # the further columns, whose names are the channel's metadata `columns`\n"
                .to_string(),
        ),
        DESCRIPTION => ("std_msgs/msg/String", "string data\n".to_string()),
        TRANSFORMS => (
            "tf2_msgs/msg/TFMessage",
            format!(
                "geometry_msgs/TransformStamped[] transforms\n\
                 {RULE}\nMSG: geometry_msgs/TransformStamped\nstd_msgs/Header header\nstring child_frame_id\nTransform transform\n\
                 {RULE}\nMSG: geometry_msgs/Transform\nVector3 translation\nQuaternion rotation\n\
                 {RULE}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n\
                 {RULE}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n\
                 {RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n{time}"
            ),
        ),
        CYCLES => (
            "plumbline_msgs/msg/Cycle",
            "uint8 HOLD=0\nuint8 APPROACH=1\nuint8 EXCITE=2\nuint8 RETURN=3\nuint8 STOP=4\nuint8 STOPPED=5\n\
             uint64 cycle      # number since the loop started\n\
             uint64 seq        # the arm's own counter\n\
             float64 time      # the arm's own clock [s]\n\
             uint64 stamp_ns   # CLOCK_MONOTONIC when the state had been read\n\
             uint64 wake_ns    # wake-up latency of that read\n\
             uint64 work_ns    # execution time of the previous cycle\n\
             uint64 model      # identity of the served model, 0 for none\n\
             uint64 tick       # sample of the motion\n\
             uint32 motion     # number of the motion\n\
             uint8 phase\n\
             float64[] position_accepted    # desired position that the arm last accepted [rad]\n\
             float64[] acceleration_desired # [rad/s2]\n\
             float64[] torque_vendor        # model torque at rest for the gravity that the arm compensates [Nm]\n\
             uint8 validity                 # 0 no model yet, 1 valid, 2 hand-over, 3 withdrawn, 4 doubtful\n"
                .to_string(),
        ),
        EVENTS => (
            "plumbline_msgs/msg/Event",
            "uint64 cycle      # number of the cycle it happened in\n\
             uint64 seq        # the arm's own counter in it\n\
             uint64 stamp_ns   # CLOCK_MONOTONIC when that cycle's state had been read\n\
             uint64 model      # of `serving` and `distrusted`\n\
             uint64 lost       # states of `lost-states`, cycles of `heartbeat-lost`\n\
             uint32 orders     # orders taken out of the queue so far\n\
             uint32 motion     # number of the motion\n\
             uint32 joint      # joint of the reason, from 1; 0 for none\n\
             float64 value     # value found\n\
             float64 bound     # limit\n\
             string kind\n\
             string reason     # of `stopping`\n\
             string limit      # of the reason `guard`\n\
             string text       # description\n\
             uint64 instead    # of `distrusted`: the model served instead, 0 for none\n"
                .to_string(),
        ),
        _ => (
            "rcl_interfaces/msg/Log",
            format!(
                "byte DEBUG=10\nbyte INFO=20\nbyte WARN=30\nbyte ERROR=40\nbyte FATAL=50\n\
                 builtin_interfaces/Time stamp\nuint8 level\nstring name\nstring msg\nstring file\nstring function\nuint32 line\n{time}"
            ),
        ),
    }
}

#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MessageError {
    #[error(transparent)]
    Cdr(#[from] CdrError),
    #[error("`{found}`, where {expected} was expected")]
    Word { found: String, expected: &'static str },
}

fn unknown(found: impl ToString, expected: &'static str) -> MessageError {
    MessageError::Word { found: found.to_string(), expected }
}

pub(super) fn stamp(message: &mut Encoder, log_ns: u64) {
    message.i32((log_ns / 1_000_000_000).min(i32::MAX as u64) as i32).u32((log_ns % 1_000_000_000) as u32);
}

/// A `sensor_msgs/JointState`; `values` are position, velocity and effort.
pub(super) fn joint_state(names: &[String], values: [&[f64]; 3], log_ns: u64) -> Vec<u8> {
    let mut message = Encoder::default();
    stamp(&mut message, log_ns);
    message.string("").strings(names);
    for each in values {
        message.f64s(each);
    }
    message.finish()
}

/// Reads position, velocity and effort of a `sensor_msgs/JointState` into `values` and returns the number of each.
pub(super) fn read_joint_state(bytes: &[u8], values: [&mut [f64]; 3]) -> Result<[usize; 3], CdrError> {
    let mut message = Decoder::new(bytes)?;
    message.i32()?;
    message.u32()?;
    message.string()?;
    message.skip_strings()?;
    let mut counts = [0; 3];
    for (each, count) in values.into_iter().zip(&mut counts) {
        *count = message.f64s(each)?;
    }
    Ok(counts)
}

pub(super) fn cycle(record: &Record, names: &[String], log_ns: u64) -> [(&'static str, Vec<u8>); 3] {
    let n = names.len().min(MAX_JOINTS);
    let joints = |position: &[f64], velocity: &[f64], effort: &[f64]| {
        joint_state(&names[..n], [&position[..n], &velocity[..n], &effort[..n]], log_ns)
    };
    let (state, command) = (&record.state, &record.command);
    let mut rest = Encoder::default();
    rest.u64(record.cycle).u64(state.seq).f64(state.time);
    rest.u64(record.stamp_ns).u64(record.wake_ns).u64(record.work_ns).u64(record.model).u64(record.tick);
    rest.u32(record.motion).u8(record.phase as u8);
    rest.f64s(&state.q_d[..n]).f64s(&command.desired.ddq[..n]).f64s(&command.tau_vendor.0[..n]);
    rest.u8(record.validity as u8);
    [
        (STATES, joints(&state.q, &state.dq, &state.tau)),
        (COMMANDS, joints(&command.desired.q, &command.desired.dq, &command.tau_ff.0)),
        (CYCLES, rest.finish()),
    ]
}

/// Decodes one of the three messages of a cycle into its record.
pub(super) fn read_cycle(topic: &str, bytes: &[u8], record: &mut Record) -> Result<(), MessageError> {
    if topic == CYCLES {
        let mut message = Decoder::new(bytes)?;
        record.cycle = message.u64()?;
        record.state.seq = message.u64()?;
        record.command.seq = record.state.seq;
        record.state.time = message.f64()?;
        record.stamp_ns = message.u64()?;
        record.wake_ns = message.u64()?;
        record.work_ns = message.u64()?;
        record.model = message.u64()?;
        record.tick = message.u64()?;
        record.motion = message.u32()?;
        let phase = message.u8()?;
        record.phase = Phase::from_u32(phase.into()).ok_or_else(|| unknown(phase, "a phase from 0 to 5"))?;
        message.f64s(&mut record.state.q_d)?;
        message.f64s(&mut record.command.desired.ddq)?;
        message.f64s(&mut record.command.tau_vendor.0)?;
        // Recordings of version 0.1 have no validity: it follows from the model.
        let code = message.u8().unwrap_or(if record.model == 0 { 0 } else { 1 });
        record.validity = Validity::from_u32(code.into()).ok_or_else(|| unknown(code, "a validity from 0 to 4"))?;
        return Ok(());
    }
    let [position, velocity, effort] = if topic == STATES {
        let state = &mut record.state;
        [&mut state.q, &mut state.dq, &mut state.tau]
    } else {
        let command = &mut record.command;
        [&mut command.desired.q, &mut command.desired.dq, &mut command.tau_ff.0]
    };
    read_joint_state(bytes, [position, velocity, effort])?;
    Ok(())
}

const LIMITS: [(Limit, &str); 17] = [
    (Limit::NotFinite, "not-finite"),
    (Limit::TorqueNotFinite, "torque-not-finite"),
    (Limit::MeasuredNotFinite, "measured-not-finite"),
    (Limit::Position, "position"),
    (Limit::StoppingPosition, "stopping-position"),
    (Limit::Velocity, "velocity"),
    (Limit::VelocityAhead, "velocity-ahead"),
    (Limit::Acceleration, "acceleration"),
    (Limit::Jerk, "jerk"),
    (Limit::StatedVelocity, "stated-velocity"),
    (Limit::StatedAcceleration, "stated-acceleration"),
    (Limit::Torque, "torque"),
    (Limit::TorqueRate, "torque-rate"),
    (Limit::EndEffectorBox, "end-effector-box"),
    (Limit::BaseSphere, "base-sphere"),
    (Limit::Tracking, "tracking"),
    (Limit::MeasuredTorque, "measured-torque"),
];

pub fn limit_name(limit: Limit) -> &'static str {
    LIMITS.iter().find(|(one, _)| *one == limit).map_or("another", |(_, name)| name)
}

/// Description of an event, with motions by their numbers.
pub fn event_text(event: &Event) -> String {
    event_text_with(event, &|motion| format!("motion {motion}"))
}

/// Description of an event; `name` gives a motion's name for the number that its order carries.
pub fn event_text_with(event: &Event, name: &dyn Fn(u32) -> String) -> String {
    match event {
        Event::Started { motion } => format!("{} has started", name(*motion)),
        Event::Ended { motion } => format!("{} has ended", name(*motion)),
        Event::Stopping { reason, .. } => format!("the arm is being stopped: {reason}"),
        Event::Stopped => "the arm is at rest after a stop; an operator has to resume".to_string(),
        Event::Resumed => "an operator has allowed motion again".to_string(),
        Event::Discarded { motion } => format!("order {motion} was discarded"),
        Event::Serving { model } => format!("model {model:016x} is served"),
        Event::Distrusted { model, instead: 0 } => {
            format!("the torque of model {model:016x} exceeded a limit; no model is served instead")
        }
        Event::Distrusted { model, instead } => {
            format!("the torque of model {model:016x} exceeded a limit; model {instead:016x} is served instead")
        }
    }
}

#[derive(Default)]
struct EventFields {
    kind: &'static str,
    motion: u32,
    model: u64,
    reason: &'static str,
    limit: &'static str,
    joint: u32,
    value: f64,
    bound: f64,
    lost: u64,
    instead: u64,
}

fn event_fields(event: &Event) -> EventFields {
    let of = |kind, motion| EventFields { kind, motion, ..EventFields::default() };
    match *event {
        Event::Started { motion } => of("started", motion),
        Event::Ended { motion } => of("ended", motion),
        Event::Stopped => of("stopped", 0),
        Event::Resumed => of("resumed", 0),
        Event::Discarded { motion } => of("discarded", motion),
        Event::Serving { model } => EventFields { model, ..of("serving", 0) },
        Event::Distrusted { model, instead } => EventFields { model, instead, ..of("distrusted", 0) },
        Event::Stopping { motion, reason } => {
            let of = |reason| EventFields { reason, ..of("stopping", motion) };
            match reason {
                StopReason::Guard(Violation { limit, joint, value, bound }) => {
                    EventFields { limit: limit_name(limit), joint: joint as u32 + 1, value, bound, ..of("guard") }
                }
                StopReason::Requested => of("requested"),
                StopReason::Quit => of("quit"),
                StopReason::LostStates { lost } => EventFields { lost, ..of("lost-states") },
                StopReason::HeartbeatLost { cycles } => EventFields { lost: cycles, ..of("heartbeat-lost") },
                StopReason::NotAtStart { joint, distance, .. } => {
                    EventFields { joint: joint as u32 + 1, value: distance, ..of("not-at-start") }
                }
                StopReason::NoPath { .. } => of("no-path"),
            }
        }
    }
}

pub(super) fn event(timed: &TimedEvent) -> Vec<u8> {
    let EventFields { kind, motion, model, reason, limit, joint, value, bound, lost, instead } =
        event_fields(&timed.event);
    let mut message = Encoder::default();
    message.u64(timed.cycle).u64(timed.seq).u64(timed.stamp_ns).u64(model).u64(lost);
    message.u32(timed.orders).u32(motion).u32(joint).f64(value).f64(bound);
    message.string(kind).string(reason).string(limit).string(&event_text(&timed.event)).u64(instead);
    message.finish()
}

pub(super) fn read_event(bytes: &[u8]) -> Result<TimedEvent, MessageError> {
    let mut message = Decoder::new(bytes)?;
    let (cycle, seq, stamp_ns) = (message.u64()?, message.u64()?, message.u64()?);
    let (model, lost, orders) = (message.u64()?, message.u64()?, message.u32()?);
    let (motion, joint) = (message.u32()?, message.u32()?.saturating_sub(1) as usize);
    let (value, bound) = (message.f64()?, message.f64()?);
    let (kind, reason, limit) = (message.string()?, message.string()?, message.string()?);
    message.string()?;
    // Recordings of version 0.1 end here.
    let instead = message.u64().unwrap_or(0);
    let event = match kind.as_str() {
        "started" => Event::Started { motion },
        "ended" => Event::Ended { motion },
        "stopped" => Event::Stopped,
        "resumed" => Event::Resumed,
        "discarded" => Event::Discarded { motion },
        "serving" => Event::Serving { model },
        "distrusted" => Event::Distrusted { model, instead },
        "stopping" => {
            let reason = match reason.as_str() {
                "guard" => {
                    let found = LIMITS.iter().find(|(_, name)| *name == limit);
                    let limit = found.ok_or_else(|| unknown(&limit, "the name of a limit"))?.0;
                    StopReason::Guard(Violation { limit, joint, value, bound })
                }
                "requested" => StopReason::Requested,
                "quit" => StopReason::Quit,
                "lost-states" => StopReason::LostStates { lost },
                "heartbeat-lost" | "unattended" => StopReason::HeartbeatLost { cycles: lost },
                "not-at-start" => StopReason::NotAtStart { motion, joint, distance: value },
                "no-path" => StopReason::NoPath { motion },
                other => return Err(unknown(other, "the reason of a stop")),
            };
            Event::Stopping { motion, reason }
        }
        other => return Err(unknown(other, "a kind of event")),
    };
    Ok(TimedEvent { cycle, seq, stamp_ns, orders, event })
}

/// A log message; `level` as in `rcl_interfaces/Log`.
pub(super) fn log(text: &str, level: u8, source: &str, log_ns: u64) -> Vec<u8> {
    let mut message = Encoder::default();
    stamp(&mut message, log_ns);
    message.u8(level).string(source).string(text).string("").string("").u32(0);
    message.finish()
}
