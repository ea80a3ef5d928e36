//! States of the controller's arm for the daemon.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use crate::background::Background;
use crate::error::{Error, Fault, robot_id};
use crate::model::padded;
use plumbline_core::MAX_JOINTS;
use plumbline_ipc::{GuestMessage, GuestPublisher, IpcError, now_ns};
use rtrb::{Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Samples between the loop and the thread that sends them: a quarter of a second.
const QUEUE: usize = 256;
/// Interval of the thread that sends.
const INTERVAL: Duration = Duration::from_millis(1);

/// Publishes the states of one arm that the caller controls. Dropping it sends what is queued.
pub struct Guest {
    joints: usize,
    seq: u64,
    lost: u64,
    queue: Producer<GuestMessage>,
    /// Samples that shared memory refused.
    unsent: Arc<AtomicU64>,
    _background: Background,
}

impl Guest {
    /// Opens the service of `robot` and starts the thread that sends. Needs no daemon.
    ///
    /// # Errors
    /// [`Error::SecondPublisher`] where another process publishes for this arm; [`Error::Ipc`]; [`Error::Input`] for a name that is no robot's
    /// or a number of joints that is not 1 to 8; [`Error::Thread`].
    pub fn open(robot: &str, joints: usize) -> Result<Guest, Error> {
        if !(1..=MAX_JOINTS).contains(&joints) {
            return Err(plumbline_core::BadInput::new("the call", "joints", joints, "1 to 8").into());
        }
        let id = robot_id(robot)?;
        let (queue, mut queued) = RingBuffer::new(QUEUE);
        let unsent = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&unsent);
        let ((), background) = Background::start("plumbline-guest", INTERVAL, move || {
            let mut publisher = GuestPublisher::open(&id).map_err(|error| match error {
                IpcError::Full { port, .. } if port == "publisher" => Error::SecondPublisher { robot: id.to_string() },
                other => other.into(),
            })?;
            let mut samples: Vec<GuestMessage> = Vec::with_capacity(QUEUE);
            let step = move || {
                samples.clear();
                samples.extend(std::iter::from_fn(|| queued.pop().ok()).take(QUEUE));
                if !samples.is_empty() && publisher.send(&samples).is_err() {
                    count.fetch_add(samples.len() as u64, Ordering::Relaxed);
                }
            };
            Ok(((), step))
        })?;
        Ok(Guest { joints, seq: 0, lost: 0, queue, unsent, _background: background })
    }

    /// Publishes the state of one cycle, stamped with the present time: measured position \[rad\], velocity \[rad/s\] and torque \[Nm\], and
    /// desired position \[rad\], n values each. For the control loop. A sample that is lost has a number, too: the receiver sees the gap.
    ///
    /// # Errors
    /// The sample is lost: [`Fault::QueueFull`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn publish(&mut self, q: &[f64], dq: &[f64], tau: &[f64], q_d: &[f64]) -> Result<(), Fault> {
        let seq = self.seq;
        self.seq += 1;
        let sent = self
            .message(seq, [q, dq, tau, q_d])
            .and_then(|message| self.queue.push(message).map_err(|_| Fault::QueueFull));
        self.lost += u64::from(sent.is_err());
        sent
    }

    fn message(&self, seq: u64, [q, dq, tau, q_d]: [&[f64]; 4]) -> Result<GuestMessage, Fault> {
        let n = self.joints;
        Ok(GuestMessage {
            n: n as u32,
            seq,
            stamp_ns: now_ns(),
            q: padded(q, n)?,
            dq: padded(dq, n)?,
            tau: padded(tau, n)?,
            q_d: padded(q_d, n)?,
            ..GuestMessage::default()
        })
    }

    /// Samples lost on this side so far: refused, without room in the queue, or refused by shared memory.
    pub fn lost(&self) -> u64 {
        self.lost + self.unsent.load(Ordering::Relaxed)
    }
}
