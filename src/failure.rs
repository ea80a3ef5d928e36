//! Failure of a command: exit code 1 for a failed job, 2 for bad input.

use plumbline_core::BadInput;
use std::fmt;

#[derive(Debug)]
pub enum Failure {
    /// Bad input from a file or the command line; exit code 2.
    Input(BadInput),
    /// The job itself failed; exit code 1.
    Job(String),
}

impl Failure {
    /// A failed job, described in one sentence.
    pub fn job(what: impl fmt::Display) -> Failure {
        Failure::Job(what.to_string())
    }

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
