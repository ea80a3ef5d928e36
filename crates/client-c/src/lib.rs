//! C interface of `plumbline-client`; `include/plumbline.h` is made from this file.
//!
//! Handles are opaque. Every function returns a [`PlumblineCode`]; no panic leaves the library. A handle may be used by one thread at a time.
//! `unsafe` is for the pointers of the caller alone.

#![allow(unsafe_code)]
#![allow(non_camel_case_types, reason = "names of the C interface")]

mod feed_forward;
mod guest;

pub use feed_forward::{PlumblineFeedForward, PlumblineTorque};
pub use guest::PlumblineGuest;

use plumbline_client::{Error, Expected, Fault, IpcError, Model};
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::slice::{from_raw_parts, from_raw_parts_mut};
use std::time::Duration;

/// Result of a call. 1 to 19: of a call in the control loop, which then has written nothing.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlumblineCode {
    /// Success.
    PLUMBLINE_OK = 0,
    /// A pointer is null, or a text is not UTF-8.
    PLUMBLINE_ARGUMENT = 1,
    /// No model has arrived yet.
    PLUMBLINE_NO_MODEL = 2,
    /// An array has another length than the model needs.
    PLUMBLINE_LENGTH = 3,
    /// A number of the input is infinite or NaN.
    PLUMBLINE_NOT_FINITE = 4,
    /// The model has effects that are computed for its own gravity in advance.
    PLUMBLINE_FIXED_GRAVITY = 5,
    /// The model is not valid under this gravity.
    PLUMBLINE_MOUNTING = 6,
    /// The model file has no `[uncertainty]`.
    PLUMBLINE_NO_UNCERTAINTY = 7,
    /// The queue of samples is full: the sample is lost, and counted.
    PLUMBLINE_QUEUE_FULL = 8,
    /// No torque of the daemon has arrived yet.
    PLUMBLINE_NO_VALUE = 9,
    /// A file or a name that can't be used.
    PLUMBLINE_INPUT = 20,
    /// No daemon serves the robot.
    PLUMBLINE_NO_DAEMON = 21,
    /// The daemon's messages have another layout.
    PLUMBLINE_LAYOUT = 22,
    /// No slot is left for another client.
    PLUMBLINE_FULL = 23,
    /// Shared memory failed.
    PLUMBLINE_TRANSPORT = 24,
    /// The followed daemon has ended, or sends nothing; the last model is kept, and the next daemon is followed.
    PLUMBLINE_DAEMON_GONE = 25,
    /// The daemon serves a model of another robot than expected.
    PLUMBLINE_OTHER_ROBOT = 26,
    /// Gravity is not the expected one, or the model is not valid under it.
    PLUMBLINE_OTHER_MOUNTING = 27,
    /// The served text is not that of the model that its header names.
    PLUMBLINE_DAMAGED = 28,
    /// Another process publishes the states of this arm.
    PLUMBLINE_SECOND_PUBLISHER = 29,
    /// A thread of the library failed.
    PLUMBLINE_THREAD = 30,
    /// The library panicked: a bug. Free the handle, and use it for nothing else.
    PLUMBLINE_PANIC = 31,
}
use PlumblineCode::*;

/// The identified model of an arm's torques.
pub struct PlumblineModel(Model);

/// The model as the loop has it at this moment.
#[repr(C)]
pub struct PlumblineStatus {
    /// Identity of the model that the next call uses, 0 for none.
    pub model: u64,
    /// Time since the follower last found the daemon running \[ns\]; 0 for a file.
    pub age_ns: u64,
    /// 0 none served yet, 1 valid, 3 withdrawn, 4 contradicted by the measured torques.
    pub validity: u32,
}

thread_local! {
    static LAST: RefCell<CString> = RefCell::default();
}

fn code_of(error: &Error) -> PlumblineCode {
    match error {
        Error::Input(_) => PLUMBLINE_INPUT,
        Error::Ipc(IpcError::NoDaemon { .. } | IpcError::NoAnswer { .. }) => PLUMBLINE_NO_DAEMON,
        Error::Ipc(IpcError::Incompatible { .. }) => PLUMBLINE_LAYOUT,
        Error::Ipc(IpcError::Full { .. }) => PLUMBLINE_FULL,
        Error::Ipc(_) => PLUMBLINE_TRANSPORT,
        Error::DaemonGone { .. } => PLUMBLINE_DAEMON_GONE,
        Error::OtherRobot { .. } => PLUMBLINE_OTHER_ROBOT,
        Error::OtherMounting(_) => PLUMBLINE_OTHER_MOUNTING,
        Error::Damaged { .. } => PLUMBLINE_DAMAGED,
        Error::SecondPublisher { .. } => PLUMBLINE_SECOND_PUBLISHER,
        Error::Thread(_) => PLUMBLINE_THREAD,
    }
}

/// The code of an error whose text [`plumbline_last_error`] returns.
fn failed(error: Error) -> PlumblineCode {
    let text = CString::new(error.to_string().replace('\0', " ")).unwrap_or_default();
    LAST.with_borrow_mut(|last| *last = text);
    code_of(&error)
}

fn fault(outcome: Result<(), Fault>) -> PlumblineCode {
    match outcome {
        Ok(()) => PLUMBLINE_OK,
        Err(Fault::NoModel) => PLUMBLINE_NO_MODEL,
        Err(Fault::Length { .. }) => PLUMBLINE_LENGTH,
        Err(Fault::NotFinite) => PLUMBLINE_NOT_FINITE,
        Err(Fault::FixedGravity) => PLUMBLINE_FIXED_GRAVITY,
        Err(Fault::Mounting) => PLUMBLINE_MOUNTING,
        Err(Fault::NoUncertainty) => PLUMBLINE_NO_UNCERTAINTY,
        Err(Fault::QueueFull) => PLUMBLINE_QUEUE_FULL,
        Err(Fault::Setting) => PLUMBLINE_ARGUMENT,
    }
}

/// Runs `call`; [`PLUMBLINE_ARGUMENT`] where it returns `None`.
fn guarded(call: impl FnOnce() -> Option<PlumblineCode>) -> PlumblineCode {
    catch_unwind(AssertUnwindSafe(call)).map_or(PLUMBLINE_PANIC, |code| code.unwrap_or(PLUMBLINE_ARGUMENT))
}

/// Text of the caller. Safety: null, or a text that ends with a zero.
unsafe fn text<'a>(text: *const c_char) -> Option<&'a str> {
    if text.is_null() { None } else { unsafe { CStr::from_ptr(text) }.to_str().ok() }
}

/// Input of the caller. Safety: null, or `n` values.
unsafe fn input<'a>(values: *const f64, n: usize) -> Option<&'a [f64]> {
    if values.is_null() { None } else { Some(unsafe { from_raw_parts(values, n) }) }
}

/// Output of the caller. Safety: null, or `n` values that nothing else refers to.
unsafe fn output<'a>(values: *mut f64, n: usize) -> Option<&'a mut [f64]> {
    if values.is_null() { None } else { Some(unsafe { from_raw_parts_mut(values, n) }) }
}

/// A vector of the caller, `None` where it is null. Safety: null, or three values.
unsafe fn vector(values: *const f64) -> Option<[f64; 3]> {
    unsafe { input(values, 3) }.and_then(|values| values.try_into().ok())
}

/// Gives the caller what `made` holds. Safety: `out` is null or may be written to.
unsafe fn give<T>(out: *mut *mut T, made: Result<T, Error>) -> PlumblineCode {
    match made {
        Ok(value) => {
            unsafe { *out = Box::into_raw(Box::new(value)) };
            PLUMBLINE_OK
        }
        Err(error) => failed(error),
    }
}

/// Texts of the codes.
const TEXTS: [(PlumblineCode, &CStr); 22] = [
    (PLUMBLINE_OK, c"success"),
    (PLUMBLINE_ARGUMENT, c"a pointer is null, or a text is not UTF-8"),
    (PLUMBLINE_NO_MODEL, c"no model has been received yet"),
    (PLUMBLINE_LENGTH, c"an array has another length than the model needs"),
    (PLUMBLINE_NOT_FINITE, c"a number of the input is not finite"),
    (PLUMBLINE_FIXED_GRAVITY, c"the model has effects that are computed for its own gravity in advance"),
    (PLUMBLINE_MOUNTING, c"the model is not valid under this gravity"),
    (PLUMBLINE_NO_UNCERTAINTY, c"the model file has no [uncertainty]"),
    (PLUMBLINE_QUEUE_FULL, c"the queue of samples is full: the sample is lost"),
    (PLUMBLINE_NO_VALUE, c"no torque of the daemon has been received yet"),
    (PLUMBLINE_INPUT, c"a file or a name that can't be used"),
    (PLUMBLINE_NO_DAEMON, c"no daemon serves the robot"),
    (PLUMBLINE_LAYOUT, c"the daemon's messages have another layout"),
    (PLUMBLINE_FULL, c"no slot is left for another client"),
    (PLUMBLINE_TRANSPORT, c"shared memory failed"),
    (PLUMBLINE_DAEMON_GONE, c"the followed daemon has ended, or sends nothing; the last model is kept"),
    (PLUMBLINE_OTHER_ROBOT, c"the daemon serves a model of another robot than expected"),
    (PLUMBLINE_OTHER_MOUNTING, c"gravity is not the expected one, or the model is not valid under it"),
    (PLUMBLINE_DAMAGED, c"the served text is not that of the model that its header names"),
    (PLUMBLINE_SECOND_PUBLISHER, c"another process publishes the states of this arm"),
    (PLUMBLINE_THREAD, c"a thread of the library failed"),
    (PLUMBLINE_PANIC, c"the library panicked: a bug"),
];

/// Text of a [`PlumblineCode`]. Never null, never freed.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_text(code: i32) -> *const c_char {
    let known = TEXTS.iter().find(|(known, _)| *known as i32 == code);
    known.map_or(c"unknown code", |(_, text)| text).as_ptr()
}

/// Text of this thread's last error with a code of 20 or more, with its file, value or robot; valid until this thread's next call of this
/// library. Not for the control loop.
#[unsafe(no_mangle)]
pub extern "C" fn plumbline_last_error() -> *const c_char {
    LAST.with_borrow(|last| last.as_ptr())
}

/// The model of a file under `gravity`, 3 values in the base frame \[m/s2\].
///
/// # Safety
/// `path` ends with a zero, `gravity` has 3 values, `model` may be written to; any may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_model_load(
    path: *const c_char,
    gravity: *const f64,
    model: *mut *mut PlumblineModel,
) -> PlumblineCode {
    guarded(|| {
        let (path, gravity) = unsafe { (text(path)?, vector(gravity)?) };
        let loaded = || Model::load(Path::new(path), gravity).map(PlumblineModel);
        (!model.is_null()).then(|| unsafe { give(model, loaded()) })
    })
}

/// The model that the daemon of `robot` serves, followed by a thread of the library. Waits up to `timeout_s` seconds for daemon and model.
/// `expected_robot` and `expected_gravity` (3 values \[m/s2\]) may be null: anything is accepted.
///
/// # Safety
/// Texts end with a zero, `expected_gravity` has 3 values, `model` may be written to; any may be null.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_model_follow(
    robot: *const c_char,
    expected_robot: *const c_char,
    expected_gravity: *const f64,
    timeout_s: f64,
    model: *mut *mut PlumblineModel,
) -> PlumblineCode {
    guarded(|| {
        let expected = unsafe {
            let robot = if expected_robot.is_null() { None } else { Some(text(expected_robot)?.to_string()) };
            Expected { robot, gravity: vector(expected_gravity) }
        };
        let timeout = Duration::try_from_secs_f64(timeout_s).ok()?;
        let robot = unsafe { text(robot)? };
        let followed = || Model::follow(robot, expected, timeout).map(PlumblineModel);
        (!model.is_null()).then(|| unsafe { give(model, followed()) })
    })
}

/// Frees a model; null is allowed.
///
/// # Safety
/// `model` is null or from this library, and not used afterwards.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_model_free(model: *mut PlumblineModel) {
    if !model.is_null() {
        // A panic ends here; what is left is leaked.
        let _ = catch_unwind(AssertUnwindSafe(|| drop(unsafe { Box::from_raw(model) })));
    }
}

/// What following the daemon has last failed at, PLUMBLINE_OK while it succeeds; its text by plumbline_last_error. Not for the control loop.
///
/// # Safety
/// `model` is null or from this library.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_model_trouble(model: *const PlumblineModel) -> PlumblineCode {
    guarded(|| Some(unsafe { model.as_ref()? }.0.trouble().map_or(PLUMBLINE_OK, failed)))
}

/// Identity and validity of the model, and time since the daemon was found running.
///
/// # Safety
/// `model` is null or from this library, `status` is null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_status(model: *mut PlumblineModel, status: *mut PlumblineStatus) -> PlumblineCode {
    guarded(|| {
        let (model, status) = unsafe { (model.as_mut()?, status.as_mut()?) };
        let now = model.0.status();
        *status = PlumblineStatus { model: now.model, age_ns: now.age_ns, validity: now.validity as u32 };
        Some(PLUMBLINE_OK)
    })
}

/// Number of joints, and of columns of the regressor.
///
/// # Safety
/// `model` is null or from this library, `joints` and `columns` are null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_sizes(
    model: *mut PlumblineModel,
    joints: *mut usize,
    columns: *mut usize,
) -> PlumblineCode {
    guarded(|| {
        let (model, joints, columns) = unsafe { (model.as_mut()?, joints.as_mut()?, columns.as_mut()?) };
        let sizes = model.0.joints().and_then(|n| Ok((n, model.0.columns()?)));
        Some(fault(sizes.map(|sizes| (*joints, *columns) = sizes)))
    })
}

/// Torque that the arm needs at a state, n values \[Nm\]: all terms of the model. Call it once per cycle. `gravity` is 3 values \[m/s2\], or null
/// for the model's own.
///
/// # Safety
/// `model` is null or from this library; arrays are null or have n values, `gravity` 3. `tau` does not overlap the others.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_torque(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    dq: *const f64,
    ddq: *const f64,
    gravity: *const f64,
    tau: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe {
        let (q, dq, ddq, tau) = (input(q, n)?, input(dq, n)?, input(ddq, n)?, output(tau, n)?);
        Some(fault(model.as_mut()?.0.torque(q, dq, ddq, vector(gravity), tau)))
    })
}

/// Torque of gravity at rest at `q` under the model's own gravity, n values \[Nm\].
///
/// # Safety
/// As plumbline_torque.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_gravity(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    tau: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe { Some(fault(model.as_mut()?.0.gravity(input(q, n)?, output(tau, n)?))) })
}

/// Centrifugal and Coriolis torques, n values \[Nm\].
///
/// # Safety
/// As plumbline_torque.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_coriolis(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    dq: *const f64,
    tau: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe { Some(fault(model.as_mut()?.0.coriolis(input(q, n)?, input(dq, n)?, output(tau, n)?))) })
}

/// Viscous and Coulomb friction, n values \[Nm\].
///
/// # Safety
/// As plumbline_torque.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_friction(
    model: *mut PlumblineModel,
    n: usize,
    dq: *const f64,
    tau: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe { Some(fault(model.as_mut()?.0.friction(input(dq, n)?, output(tau, n)?))) })
}

/// Inertia matrix, n n values (symmetric) \[kg m2\].
///
/// # Safety
/// As plumbline_torque; `matrix` has n n values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_inertia(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    matrix: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe {
        let matrix = output(matrix, n.checked_mul(n)?)?;
        Some(fault(model.as_mut()?.0.inertia(input(q, n)?, matrix)))
    })
}

/// Regressor Y with tau = Y beta, n p values, column after column; p is the number of columns by plumbline_sizes.
///
/// # Safety
/// As plumbline_torque; `y` has n p values.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_regressor(
    model: *mut PlumblineModel,
    n: usize,
    p: usize,
    q: *const f64,
    dq: *const f64,
    ddq: *const f64,
    y: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe {
        let (q, dq, ddq, y) = (input(q, n)?, input(dq, n)?, input(ddq, n)?, output(y, n.checked_mul(p)?)?);
        Some(fault(model.as_mut()?.0.regressor(q, dq, ddq, y)))
    })
}

/// Standard deviation of the model's torque by the covariance of its parameters, n values \[Nm\].
///
/// # Safety
/// As plumbline_torque.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_torque_std(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    dq: *const f64,
    ddq: *const f64,
    std: *mut f64,
) -> PlumblineCode {
    guarded(|| unsafe {
        let (q, dq, ddq, std) = (input(q, n)?, input(dq, n)?, input(ddq, n)?, output(std, n)?);
        Some(fault(model.as_mut()?.0.torque_std(q, dq, ddq, std)))
    })
}

/// External torque, measured less modelled, 11 ms late: n values \[Nm\], half the width of their 95 % intervals \[Nm\], and in `contact` 1 where a joint
/// exceeds its threshold (one false alarm in ten hours), else 0. Measured position \[rad\], velocity \[rad/s\] and torque \[Nm\]. Once per cycle.
///
/// # Safety
/// As plumbline_torque; `contact` is null or may be written to.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn plumbline_external(
    model: *mut PlumblineModel,
    n: usize,
    q: *const f64,
    dq: *const f64,
    tau: *const f64,
    tau_ext: *mut f64,
    half_width: *mut f64,
    contact: *mut u32,
) -> PlumblineCode {
    guarded(|| unsafe {
        let (q, dq, tau) = (input(q, n)?, input(dq, n)?, input(tau, n)?);
        let (tau_ext, half_width, contact) = (output(tau_ext, n)?, output(half_width, n)?, contact.as_mut()?);
        Some(match model.as_mut()?.0.external(q, dq, tau) {
            Ok(found) => {
                tau_ext.iter_mut().zip(found.tau).for_each(|(to, value)| *to = value);
                half_width.iter_mut().zip(found.half_width).for_each(|(to, value)| *to = value);
                *contact = u32::from(found.contact);
                PLUMBLINE_OK
            }
            Err(error) => fault(Err(error)),
        })
    })
}
