//! Fixed-size messages in shared memory.
//!
//! Their layout is a contract with clients in other languages: `repr(C)`, only `u32`, `u64`, `f64` and arrays of them, so that
//! every bit pattern is a valid value. Each has a type name that iceoryx2 compares. A test asserts every offset.

use iceoryx2::prelude::ZeroCopySend;
use serde::{Deserialize, Serialize};

use plumbline_core::{Command, JointVec, MAX_JOINTS, Phase, Record, Setpoint, State, Torque, Validity};

/// Invalid value in a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum MessageError {
    /// Unknown code of [`Phase`].
    #[error("phase {code} of record {seq} does not exist")]
    Phase { code: u32, seq: u64 },
    /// Unknown code of [`Validity`].
    #[error("validity {code} of record {seq} does not exist")]
    Validity { code: u32, seq: u64 },
    #[error("{joints} joints, the message has room for {MAX_JOINTS}")]
    Joints { joints: u32 },
    #[error("layout {layout} of the message, this version reads {LAYOUT}")]
    Layout { layout: u32 },
    #[error("a number of sample {seq} is not finite")]
    NotFinite { seq: u64 },
}

/// One [`Record`] as it is published.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("plumbline::SampleMessage")]
pub struct SampleMessage {
    /// Epoch: identity of the daemon's start that published this record.
    pub epoch: u64,
    /// Sequence number of the record since the daemon's start, from 0 without gaps.
    pub seq: u64,
    /// See [`Record::cycle`].
    pub cycle: u64,
    /// See [`State::seq`].
    pub state_seq: u64,
    /// See [`State::time`] \[s\].
    pub time: f64,
    /// See [`State::q`] \[rad\].
    pub q: JointVec,
    /// See [`State::dq`] \[rad/s\].
    pub dq: JointVec,
    /// See [`State::tau`] \[Nm\].
    pub tau: JointVec,
    /// See [`State::q_d`] \[rad\].
    pub q_d: JointVec,
    /// See [`Command::seq`].
    pub command_seq: u64,
    /// Commanded position \[rad\].
    pub desired_q: JointVec,
    /// Commanded velocity \[rad/s\].
    pub desired_dq: JointVec,
    /// Commanded acceleration \[rad/s2\].
    pub desired_ddq: JointVec,
    /// Feed-forward torque of the command \[Nm\].
    pub tau_ff: JointVec,
    /// [`Phase`] as a number.
    pub phase: u32,
    /// See [`Record::motion`].
    pub motion: u32,
    /// See [`Record::tick`].
    pub tick: u64,
    /// See [`Record::model`].
    pub model: u64,
    /// See [`Record::stamp_ns`] \[ns\].
    pub stamp_ns: u64,
    /// See [`Record::wake_ns`] \[ns\].
    pub wake_ns: u64,
    /// See [`Record::work_ns`] \[ns\].
    pub work_ns: u64,
    /// See [`Command::tau_vendor`] \[Nm\].
    pub tau_vendor: JointVec,
    /// [`Validity`] as a number.
    pub validity: u32,
    /// Always 0.
    pub reserved: u32,
}

impl SampleMessage {
    /// The message of `record` with sequence number `seq` and the daemon's `epoch`.
    pub fn new(epoch: u64, seq: u64, record: &Record) -> SampleMessage {
        let Record { state, command, .. } = record;
        SampleMessage {
            epoch,
            seq,
            cycle: record.cycle,
            state_seq: state.seq,
            time: state.time,
            q: state.q,
            dq: state.dq,
            tau: state.tau,
            q_d: state.q_d,
            command_seq: command.seq,
            desired_q: command.desired.q,
            desired_dq: command.desired.dq,
            desired_ddq: command.desired.ddq,
            tau_ff: command.tau_ff.0,
            phase: record.phase as u32,
            motion: record.motion,
            tick: record.tick,
            model: record.model,
            stamp_ns: record.stamp_ns,
            wake_ns: record.wake_ns,
            work_ns: record.work_ns,
            tau_vendor: command.tau_vendor.0,
            validity: record.validity as u32,
            reserved: 0,
        }
    }

    /// The record of this message.
    ///
    /// # Errors
    /// Unknown code of phase or validity.
    pub fn record(&self) -> Result<Record, MessageError> {
        let phase = Phase::from_u32(self.phase).ok_or(MessageError::Phase { code: self.phase, seq: self.seq })?;
        let validity =
            Validity::from_u32(self.validity).ok_or(MessageError::Validity { code: self.validity, seq: self.seq })?;
        Ok(Record {
            cycle: self.cycle,
            state: State { seq: self.state_seq, time: self.time, q: self.q, dq: self.dq, tau: self.tau, q_d: self.q_d },
            command: Command {
                seq: self.command_seq,
                desired: Setpoint { q: self.desired_q, dq: self.desired_dq, ddq: self.desired_ddq },
                tau_ff: Torque(self.tau_ff),
                tau_vendor: Torque(self.tau_vendor),
            },
            phase,
            motion: self.motion,
            tick: self.tick,
            model: self.model,
            validity,
            stamp_ns: self.stamp_ns,
            wake_ns: self.wake_ns,
            work_ns: self.work_ns,
        })
    }
}

/// Feed-forward torque of the served model at the current desired state. Only the latest value is kept.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ZeroCopySend)]
#[type_name("plumbline::FeedForwardMessage")]
pub struct FeedForwardMessage {
    /// Sequence number since the daemon's start, from 1; a client may skip values. Set by [`Server`](super::Server).
    pub sequence: u64,
    /// Time at which the state of this value had been read, `CLOCK_BOOTTIME` \[ns\]: the age includes time suspended.
    /// [`Server`](super::Server) converts it from the record's `CLOCK_MONOTONIC`.
    pub stamp_ns: u64,
    /// Epoch: identity of the daemon's start. Set by [`Server`](super::Server).
    pub epoch: u64,
    /// Identity of the model, 0 while none is served: see `validity`.
    pub model: u64,
    /// Number of joints; entries past it are zero.
    pub n: u32,
    /// [`Phase`] as a number.
    pub phase: u32,
    /// Desired position \[rad\].
    pub q_d: JointVec,
    /// Desired velocity \[rad/s\].
    pub dq_d: JointVec,
    /// Feed-forward torque \[Nm\].
    pub tau_ff: JointVec,
    /// Gravitational acceleration in the base frame that the model was evaluated with \[m/s2\].
    pub gravity: [f64; 3],
    /// Torque of the same model at rest at `q_d` under `gravity_vendor` \[Nm\]. The arm's own controller adds it; such an arm is sent
    /// `tau_ff - tau_vendor`.
    pub tau_vendor: JointVec,
    /// Gravitational acceleration in the base frame that the arm's own controller compensates \[m/s2\].
    pub gravity_vendor: [f64; 3],
    /// [`Validity`] as a number.
    pub validity: u32,
    /// Identity of the clock of `stamp_ns`: of boot and time namespace, 0 where it is unknown. Ages by another clock than the own one are
    /// estimates. Set by [`Server`](super::Server).
    pub clock: u32,
}

impl FeedForwardMessage {
    /// The message of `record`, for an arm with `joints` joints (at most [`MAX_JOINTS`]) under `gravity`, whose controller
    /// compensates `gravity_vendor` \[m/s2\].
    pub fn new(record: &Record, joints: usize, gravity: [f64; 3], gravity_vendor: [f64; 3]) -> FeedForwardMessage {
        FeedForwardMessage {
            sequence: 0,
            stamp_ns: record.stamp_ns,
            epoch: 0,
            model: record.model,
            n: joints.min(MAX_JOINTS) as u32,
            phase: record.phase as u32,
            q_d: record.command.desired.q,
            dq_d: record.command.desired.dq,
            tau_ff: record.command.tau_ff.0,
            gravity,
            tau_vendor: record.command.tau_vendor.0,
            gravity_vendor,
            validity: record.validity as u32,
            clock: 0,
        }
    }

    /// Validates joint count, validity and phase.
    pub fn check(&self) -> Result<(), MessageError> {
        if self.n as usize > MAX_JOINTS {
            return Err(MessageError::Joints { joints: self.n });
        }
        self.validity()?;
        self.phase().map(|_| ())
    }

    /// The validity, decoded.
    pub fn validity(&self) -> Result<Validity, MessageError> {
        Validity::from_u32(self.validity).ok_or(MessageError::Validity { code: self.validity, seq: self.sequence })
    }

    /// The phase, decoded.
    pub fn phase(&self) -> Result<Phase, MessageError> {
        Phase::from_u32(self.phase).ok_or(MessageError::Phase { code: self.phase, seq: self.sequence })
    }

    /// Feed-forward torque of the arm's joints, n \[Nm\].
    pub fn torque(&self) -> &[f64] {
        &self.tau_ff[..(self.n as usize).min(MAX_JOINTS)]
    }
}

/// Version of the layout of [`ModelHeader`] and [`GuestMessage`].
pub const LAYOUT: u32 = 1;

/// Header of the served model; the payload is the text of the model file, empty where no model is served.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ZeroCopySend)]
#[type_name("plumbline::ModelHeader")]
pub struct ModelHeader {
    /// [`LAYOUT`]. Set by [`Server`](super::Server).
    pub layout: u32,
    /// [`Validity`] as a number.
    pub validity: u32,
    /// Epoch: identity of the daemon's start. Set by [`Server`](super::Server).
    pub epoch: u64,
    /// Number of the message since the daemon's start, from 1. Set by [`Server`](super::Server).
    pub sequence: u64,
    /// Time of the message, `CLOCK_BOOTTIME` \[ns\]. Set by [`Server`](super::Server).
    pub stamp_ns: u64,
    /// Identity of the model: the first 64 bits of the SHA-256 of its text; 0 for none.
    pub model: u64,
    /// Gravitational acceleration in the base frame that the model is served with \[m/s2\].
    pub gravity: [f64; 3],
    /// Gravitational acceleration in the base frame that the arm's own controller compensates \[m/s2\].
    pub gravity_vendor: [f64; 3],
}

impl ModelHeader {
    /// The validity, decoded.
    pub fn validity(&self) -> Result<Validity, MessageError> {
        Validity::from_u32(self.validity).ok_or(MessageError::Validity { code: self.validity, seq: self.sequence })
    }
}

/// State of an arm in one cycle of a controller that is not plumbline's.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ZeroCopySend)]
#[type_name("plumbline::GuestMessage")]
pub struct GuestMessage {
    /// [`LAYOUT`]. Set by [`GuestPublisher`](super::GuestPublisher).
    pub layout: u32,
    /// Number of joints; entries past it are zero.
    pub n: u32,
    /// Epoch: identity of the publisher's start. Set by [`GuestPublisher`](super::GuestPublisher).
    pub epoch: u64,
    /// Number of the sample since the publisher's start, from 0. A number that is missing is a lost sample.
    pub seq: u64,
    /// Time at which the controller had read the state, `CLOCK_MONOTONIC` \[ns\].
    pub stamp_ns: u64,
    /// Measured position \[rad\].
    pub q: JointVec,
    /// Measured velocity \[rad/s\].
    pub dq: JointVec,
    /// Measured torque, gravity included \[Nm\].
    pub tau: JointVec,
    /// Desired position \[rad\].
    pub q_d: JointVec,
}

impl GuestMessage {
    /// Validates layout, joint count and numbers.
    pub fn check(&self) -> Result<(), MessageError> {
        if self.layout != LAYOUT {
            return Err(MessageError::Layout { layout: self.layout });
        }
        if self.n == 0 || self.n as usize > MAX_JOINTS {
            return Err(MessageError::Joints { joints: self.n });
        }
        let finite = [&self.q, &self.dq, &self.tau, &self.q_d].into_iter().flatten().all(|value| value.is_finite());
        if finite { Ok(()) } else { Err(MessageError::NotFinite { seq: self.seq }) }
    }
}

/// Request of a follower: acknowledges records and asks for further ones.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("plumbline::FollowRequest")]
pub struct FollowRequest {
    /// Epoch that the sequence numbers below belong to, 0 while it is unknown.
    pub epoch: u64,
    /// All records before this number have been received and delivered.
    pub acknowledged: u64,
    /// First record requested.
    pub from: u64,
    /// Number of records requested; 0 for an acknowledgement only.
    pub count: u32,
    /// 1 when the follower disconnects, else 0.
    pub leaving: u32,
    /// Process of the follower.
    pub pid: u32,
    /// Always 0.
    pub reserved: u32,
    /// Name of the follower for logs: ASCII, padded with zeros.
    pub name: [u8; 16],
}

/// Header of every response to a [`FollowRequest`]; the payload is the records.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, ZeroCopySend)]
#[type_name("plumbline::ReplayHeader")]
pub struct ReplayHeader {
    /// Epoch: identity of the daemon's start.
    pub epoch: u64,
    /// Sequence number of the oldest retained record.
    pub first: u64,
    /// Sequence number of the next record: records `first..end` can be requested.
    pub end: u64,
}

#[cfg(test)]
mod tests {
    use std::mem::{align_of, offset_of, size_of};

    use super::*;

    fn record() -> Record {
        let vec = |base: f64| std::array::from_fn(|i| base + i as f64);
        Record {
            cycle: 1,
            state: State { seq: 2, time: 0.5, q: vec(10.0), dq: vec(20.0), tau: vec(30.0), q_d: vec(40.0) },
            command: Command {
                seq: 3,
                desired: Setpoint { q: vec(50.0), dq: vec(60.0), ddq: vec(70.0) },
                tau_ff: Torque(vec(80.0)),
                tau_vendor: Torque(vec(90.0)),
            },
            phase: Phase::Excite,
            motion: 4,
            tick: 5,
            model: 6,
            validity: Validity::HandOver,
            stamp_ns: 7,
            wake_ns: 8,
            work_ns: 9,
        }
    }

    #[test]
    fn a_record_is_restored_from_its_message() {
        let message = SampleMessage::new(11, 12, &record());
        assert_eq!((message.epoch, message.seq), (11, 12));
        assert_eq!(message.record().unwrap(), record());
    }

    #[test]
    fn unknown_codes_and_joint_counts_are_rejected() {
        let mut sample = SampleMessage::new(0, 12, &record());
        sample.phase = 77;
        assert_eq!(sample.record(), Err(MessageError::Phase { code: 77, seq: 12 }));

        let mut value = FeedForwardMessage::new(&record(), 7, [9.81, 0.0, 0.0], [0.0, 0.0, -9.81]);
        assert_eq!(value.check(), Ok(()));
        assert_eq!(value.torque(), &record().command.tau_ff.0[..7]);
        let unknown = FeedForwardMessage { validity: 5, ..value };
        assert_eq!(unknown.check(), Err(MessageError::Validity { code: 5, seq: 0 }));
        sample.phase = 0;
        sample.validity = 5;
        assert_eq!(sample.record(), Err(MessageError::Validity { code: 5, seq: 12 }));
        value.n = u32::MAX;
        assert_eq!(value.check(), Err(MessageError::Joints { joints: u32::MAX }));
        assert_eq!(value.torque().len(), MAX_JOINTS);
    }

    #[test]
    fn message_layouts_have_fixed_offsets() {
        assert_eq!((size_of::<SampleMessage>(), align_of::<SampleMessage>()), (680, 8));
        assert_eq!(offset_of!(SampleMessage, q), 40);
        assert_eq!(offset_of!(SampleMessage, dq), 104);
        assert_eq!(offset_of!(SampleMessage, tau), 168);
        assert_eq!(offset_of!(SampleMessage, q_d), 232);
        assert_eq!(offset_of!(SampleMessage, command_seq), 296);
        assert_eq!(offset_of!(SampleMessage, desired_q), 304);
        assert_eq!(offset_of!(SampleMessage, desired_dq), 368);
        assert_eq!(offset_of!(SampleMessage, desired_ddq), 432);
        assert_eq!(offset_of!(SampleMessage, tau_ff), 496);
        assert_eq!(offset_of!(SampleMessage, phase), 560);
        assert_eq!(offset_of!(SampleMessage, motion), 564);
        assert_eq!(offset_of!(SampleMessage, tick), 568);
        assert_eq!(offset_of!(SampleMessage, model), 576);
        assert_eq!(offset_of!(SampleMessage, stamp_ns), 584);
        assert_eq!(offset_of!(SampleMessage, wake_ns), 592);
        assert_eq!(offset_of!(SampleMessage, work_ns), 600);
        assert_eq!(offset_of!(SampleMessage, tau_vendor), 608);
        assert_eq!(offset_of!(SampleMessage, validity), 672);

        assert_eq!((size_of::<FeedForwardMessage>(), align_of::<FeedForwardMessage>()), (352, 8));
        assert_eq!(offset_of!(FeedForwardMessage, stamp_ns), 8);
        assert_eq!(offset_of!(FeedForwardMessage, epoch), 16);
        assert_eq!(offset_of!(FeedForwardMessage, model), 24);
        assert_eq!(offset_of!(FeedForwardMessage, n), 32);
        assert_eq!(offset_of!(FeedForwardMessage, phase), 36);
        assert_eq!(offset_of!(FeedForwardMessage, q_d), 40);
        assert_eq!(offset_of!(FeedForwardMessage, dq_d), 104);
        assert_eq!(offset_of!(FeedForwardMessage, tau_ff), 168);
        assert_eq!(offset_of!(FeedForwardMessage, gravity), 232);
        assert_eq!(offset_of!(FeedForwardMessage, tau_vendor), 256);
        assert_eq!(offset_of!(FeedForwardMessage, gravity_vendor), 320);
        assert_eq!(offset_of!(FeedForwardMessage, validity), 344);
        assert_eq!(offset_of!(FeedForwardMessage, clock), 348);

        assert_eq!((size_of::<ModelHeader>(), align_of::<ModelHeader>()), (88, 8));
        assert_eq!(offset_of!(ModelHeader, validity), 4);
        assert_eq!(offset_of!(ModelHeader, epoch), 8);
        assert_eq!(offset_of!(ModelHeader, sequence), 16);
        assert_eq!(offset_of!(ModelHeader, stamp_ns), 24);
        assert_eq!(offset_of!(ModelHeader, model), 32);
        assert_eq!(offset_of!(ModelHeader, gravity), 40);
        assert_eq!(offset_of!(ModelHeader, gravity_vendor), 64);

        assert_eq!((size_of::<GuestMessage>(), align_of::<GuestMessage>()), (288, 8));
        assert_eq!(offset_of!(GuestMessage, n), 4);
        assert_eq!(offset_of!(GuestMessage, epoch), 8);
        assert_eq!(offset_of!(GuestMessage, seq), 16);
        assert_eq!(offset_of!(GuestMessage, stamp_ns), 24);
        assert_eq!(offset_of!(GuestMessage, q), 32);
        assert_eq!(offset_of!(GuestMessage, dq), 96);
        assert_eq!(offset_of!(GuestMessage, tau), 160);
        assert_eq!(offset_of!(GuestMessage, q_d), 224);

        assert_eq!((size_of::<FollowRequest>(), align_of::<FollowRequest>()), (56, 8));
        assert_eq!((size_of::<ReplayHeader>(), align_of::<ReplayHeader>()), (24, 8));
    }
}
