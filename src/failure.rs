//! How a command fails: exit code 1 for a job that failed, 2 for input that can't be used.

use plumbline_core::BadInput;
use std::fmt;

/// Why a command did not succeed.
#[derive(Debug)]
pub enum Failure {
    /// Something a person wrote can't be used; exit code 2.
    Input(BadInput),
    /// The job itself failed; exit code 1.
    Job(String),
}

impl Failure {
    /// A failed job, said in one sentence.
    pub fn job(what: impl fmt::Display) -> Failure {
        Failure::Job(what.to_string())
    }

    /// The exit code of the process.
    pub fn code(&self) -> u8 {
        match self {
            Failure::Input(_) => 2,
            Failure::Job(_) => 1,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::Input(bad) => bad.fmt(f),
            Failure::Job(what) => what.fmt(f),
        }
    }
}

impl From<BadInput> for Failure {
    fn from(bad: BadInput) -> Failure {
        Failure::Input(bad)
    }
}
