//! Exceptions: one class per error of the library, with its text.

use plumbline::Failure;
use plumbline_client::{Error as ClientError, Fault, IpcError};
use plumbline_core::BadInput;
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::{PyTypeInfo, create_exception};

create_exception!(plumbline.errors, Error, PyException, "An error of plumbline.");

/// The classes below [`Error`] and their registration.
macro_rules! classes {
    ($($name:ident: $doc:literal,)+) => {
        $(create_exception!(plumbline.errors, $name, Error, $doc);)+

        /// Adds every class to the module.
        pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
            let py = module.py();
            module.add(stringify!(Error), Error::type_object(py))?;
            $(module.add(stringify!($name), $name::type_object(py))?;)+
            Ok(())
        }
    };
}

classes! {
    InputError: "A file, an option or a name that can't be used: attributes file, place, value, expected.",
    JobError: "The work itself failed.",
    NoDaemon: "No daemon serves the robot.",
    Incompatible: "The daemon's messages have another layout.",
    Full: "No slot is left for another client.",
    TransportError: "Shared memory failed.",
    DaemonGone: "The followed daemon has ended, or sends nothing; the last model is kept.",
    OtherRobot: "The daemon serves a model of another robot than expected.",
    OtherMounting: "Gravity is not the expected one, or the model is not valid under it.",
    Damaged: "The served text is not that of the model that its header names.",
    SecondPublisher: "Another process publishes the states of this arm.",
    ThreadError: "A thread of the library failed.",
    NoModel: "No model has been received yet.",
    LengthError: "An array has another length than the model needs.",
    NotFinite: "A number of the input is infinite or NaN.",
    FixedGravity: "The model has effects that are computed for its own gravity in advance.",
    MountingError: "The model is not valid under this gravity.",
    NoUncertainty: "The model file has no [uncertainty].",
    SettingError: "A setting of the external torque is out of range.",
    QueueFull: "The queue of samples is full: the sample is lost, and counted.",
}

/// Exception of bad input, with its four parts as attributes.
pub fn bad_input(py: Python<'_>, bad: &BadInput) -> PyErr {
    let error = InputError::new_err(bad.to_string());
    let BadInput { file, place, value, expected } = bad;
    let parts = [("file", file), ("place", place), ("value", value), ("expected", expected)];
    let set = parts.into_iter().try_for_each(|(name, part)| error.value(py).setattr(name, part));
    set.map_or_else(|failed| failed, |()| error)
}

pub fn failure(py: Python<'_>, failure: &Failure) -> PyErr {
    match failure {
        Failure::Input(bad) => bad_input(py, bad),
        Failure::Job(what) => JobError::new_err(what.clone()),
    }
}

pub fn client(py: Python<'_>, error: &ClientError) -> PyErr {
    let text = error.to_string();
    match error {
        ClientError::Input(bad) => bad_input(py, bad),
        ClientError::Ipc(error) => ipc(error),
        ClientError::DaemonGone { .. } => DaemonGone::new_err(text),
        ClientError::OtherRobot { .. } => OtherRobot::new_err(text),
        ClientError::OtherMounting(_) => OtherMounting::new_err(text),
        ClientError::Damaged { .. } => Damaged::new_err(text),
        ClientError::SecondPublisher { .. } => SecondPublisher::new_err(text),
        ClientError::Thread(_) => ThreadError::new_err(text),
    }
}

pub fn ipc(error: &IpcError) -> PyErr {
    let text = error.to_string();
    match error {
        IpcError::NoDaemon { .. } | IpcError::NoAnswer { .. } => NoDaemon::new_err(text),
        IpcError::Incompatible { .. } => Incompatible::new_err(text),
        IpcError::Full { .. } => Full::new_err(text),
        IpcError::TooLong { .. } | IpcError::Malformed { .. } | IpcError::Transport { .. } => {
            TransportError::new_err(text)
        }
    }
}

/// Exception of a call in the loop; `place` is put in front of its text where it is not empty.
pub fn fault(fault: Fault, place: &str) -> PyErr {
    let text = format!("{place}{fault}");
    match fault {
        Fault::NoModel => NoModel::new_err(text),
        Fault::Length { .. } => LengthError::new_err(text),
        Fault::NotFinite => NotFinite::new_err(text),
        Fault::FixedGravity => FixedGravity::new_err(text),
        Fault::Mounting => MountingError::new_err(text),
        Fault::NoUncertainty => NoUncertainty::new_err(text),
        Fault::Setting => SettingError::new_err(text),
        Fault::QueueFull => QueueFull::new_err(text),
    }
}
