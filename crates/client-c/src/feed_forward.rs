//! Torque of the daemon's own motion.

use crate::PlumblineCode::{self, *};
use crate::{failed, give, guarded, text};
use plumbline_client::{Error, FeedForwardClient, FeedForwardSettings, Presence, RobotId};
use std::ffi::c_char;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

/// Client of the feed-forward torque of the daemon's own motion.
pub struct PlumblineFeedForward(FeedForwardClient);

/// Feed-forward torque of the daemon's own motion in one cycle. Entries past the number of joints are zero.
#[repr(C)]
pub struct PlumblineTorque {
    /// Number of the value since the daemon's start, from 1.
    pub sequence: u64,
    /// Identity of the daemon's start.
    pub epoch: u64,
    /// Identity of the served model, 0 for none.
    pub model: u64,
    /// Time from the arm's state to this call \[ns\]; of a daemon on another machine, the part beyond the fastest transit of the last 5 to 10 s of values.
    pub age_ns: u64,
    /// Number of joints.
    pub n: u32,
    /// 0 none served yet, 1 valid, 2 on its way to the model's torque, 3 withdrawn, 4 contradicted by the measured torques.
    pub validity: u32,
    /// 0 hold, 1 approach, 2 excite, 3 return, 4 stop, 5 stopped.
    pub phase: u32,
    /// 1 where the torque may be used: a model is served, and the value is no older than the limit of plumbline_feed_forward_open. Else 0.
    pub usable: u32,
    /// Desired position \[rad\].
    pub q_d: [f64; 8],
    /// Desired velocity \[rad/s\].
    pub dq_d: [f64; 8],
    /// Feed-forward torque \[Nm\].
    pub tau: [f64; 8],
    /// Part of it that the arm's own controller adds \[Nm\]: send tau - tau_vendor.
    pub tau_vendor: [f64; 8],
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: [f64; 3],
    /// Gravitational acceleration that the arm's own controller compensates \[m/s2\].
    pub gravity_vendor: [f64; 3],
}

/// Connects to the daemon of `robot`, waiting up to `timeout_s` seconds for it. A value older than `stale_after_ms` is not usable.
///
/// # Safety
/// `robot` ends with a zero, `feed_forward` may be written to; either may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_feed_forward_open(
    robot: *const c_char,
    stale_after_ms: u64,
    timeout_s: f64,
    feed_forward: *mut *mut PlumblineFeedForward,
) -> PlumblineCode {
    guarded(|| {
        let (robot, timeout) = (unsafe { text(robot)? }, Duration::try_from_secs_f64(timeout_s).ok()?);
        let opened = || {
            let id = RobotId::parse("the call", "robot", robot)?;
            let client = FeedForwardClient::connect(&id, FeedForwardSettings { stale_after_ms }, timeout)?;
            Ok::<_, Error>(PlumblineFeedForward(client))
        };
        (!feed_forward.is_null()).then(|| unsafe { give(feed_forward, opened()) })
    })
}

/// The latest value with its present age; PLUMBLINE_NO_VALUE before the first, and before the second of a daemon on another machine. The same value is returned until a newer one arrives. The first call
/// after the daemon's start maps memory; later ones read it.
///
/// # Safety
/// `feed_forward` is null or from this library, `torque` is null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_feed_forward_latest(
    feed_forward: *mut PlumblineFeedForward,
    torque: *mut PlumblineTorque,
) -> PlumblineCode {
    guarded(|| {
        let (client, torque) = unsafe { (feed_forward.as_mut()?, torque.as_mut()?) };
        let latest = match client.0.latest() {
            Ok(Some(latest)) => latest,
            Ok(None) => return Some(PLUMBLINE_NO_VALUE),
            Err(error) => return Some(failed(error.into())),
        };
        let value = latest.message;
        *torque = PlumblineTorque {
            sequence: value.sequence,
            epoch: value.epoch,
            model: value.model,
            age_ns: latest.age_ns,
            n: value.n,
            validity: value.validity,
            phase: value.phase,
            usable: u32::from(latest.usable),
            q_d: value.q_d,
            dq_d: value.dq_d,
            tau: value.tau_ff,
            tau_vendor: value.tau_vendor,
            gravity: value.gravity,
            gravity_vendor: value.gravity_vendor,
        };
        Some(PLUMBLINE_OK)
    })
}

/// PLUMBLINE_OK while the daemon's process (on another machine: the tunnel's) runs, else PLUMBLINE_DAEMON_GONE. Reads files: not for the control loop.
///
/// # Safety
/// `feed_forward` is null or from this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_feed_forward_daemon(feed_forward: *const PlumblineFeedForward) -> PlumblineCode {
    guarded(|| {
        let presence = unsafe { feed_forward.as_ref()? }.0.daemon();
        Some(if presence == Presence::Running { PLUMBLINE_OK } else { PLUMBLINE_DAEMON_GONE })
    })
}

/// Frees a client; null is allowed.
///
/// # Safety
/// `feed_forward` is null or from this library, and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_feed_forward_free(feed_forward: *mut PlumblineFeedForward) {
    if !feed_forward.is_null() {
        let _ = catch_unwind(AssertUnwindSafe(|| drop(unsafe { Box::from_raw(feed_forward) })));
    }
}
