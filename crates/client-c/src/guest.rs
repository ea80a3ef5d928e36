//! States of an arm that the caller controls.

use crate::PlumblineCode;
use crate::{fault, give, guarded, input, text};
use plumbline_client::Guest;
use std::ffi::c_char;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Publisher of the states of an arm that the caller controls.
pub struct PlumblineGuest(Guest);

/// Opens the publisher of the states of `robot` with n joints. Needs no daemon.
///
/// # Safety
/// `robot` ends with a zero, `guest` may be written to; either may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_guest_open(
    robot: *const c_char,
    n: usize,
    guest: *mut *mut PlumblineGuest,
) -> PlumblineCode {
    guarded(|| {
        let robot = unsafe { text(robot)? };
        (!guest.is_null()).then(|| unsafe { give(guest, Guest::open(robot, n).map(PlumblineGuest)) })
    })
}

/// Publishes the state of one cycle: measured position \[rad\], velocity \[rad/s\], torque \[Nm\], desired position \[rad\], n values each. For
/// the control loop.
///
/// # Safety
/// `guest` is null or from this library; arrays are null or have n values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_guest_publish(
    guest: *mut PlumblineGuest,
    n: usize,
    q: *const f64,
    dq: *const f64,
    tau: *const f64,
    q_d: *const f64,
) -> PlumblineCode {
    guarded(|| unsafe {
        let (q, dq, tau, q_d) = (input(q, n)?, input(dq, n)?, input(tau, n)?, input(q_d, n)?);
        Some(fault(guest.as_mut()?.0.publish(q, dq, tau, q_d)))
    })
}

/// Samples lost on this side so far; 0 for null.
///
/// # Safety
/// `guest` is null or from this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_guest_lost(guest: *const PlumblineGuest) -> u64 {
    unsafe { guest.as_ref() }.map_or(0, |guest| guest.0.lost())
}

/// Sends what is queued, and frees the publisher; null is allowed.
///
/// # Safety
/// `guest` is null or from this library, and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_guest_free(guest: *mut PlumblineGuest) {
    if !guest.is_null() {
        let _ = catch_unwind(AssertUnwindSafe(|| drop(unsafe { Box::from_raw(guest) })));
    }
}
