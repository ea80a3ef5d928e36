//! Datasets: folders of recorded motions for import and export.
//!
//! A dataset is a folder with `dataset.toml` and one file per run, CSV or MCAP. The CSV has a header row, then one row per sample: `t` \[s\],
//! `q1..qn` \[rad\], optional `dq1..dqn` \[rad/s\], `tau1..taun` (\[Nm\], or \[A\] where `dataset.toml` gives a gain), and any further
//! columns of numbers (`temp1`, `tau_cmd1`, ...), which are kept by name. Sampling may be uneven; samples may be missing or repeated.
//! A file whose name ends in `.mcap` has the same columns as messages ([`crate::recording::run`]), or is a recording of the flight recorder.

pub mod columns;
pub(crate) mod csv;
mod file;
mod format;
mod hash;
mod hygiene;
mod layout;
mod manifest;
mod write;

pub use format::{Format, stem};
pub use hygiene::Hygiene;
pub use manifest::Role;

use layout::{Columns, Torque};
use plumbline_core::BadInput;
use plumbline_model::Mounting;
use std::path::Path;

#[derive(Clone, Debug)]
pub struct Dataset {
    pub name: String,
    /// The robot description that fits the arm: a shipped name or a path.
    pub robot: String,
    /// Mounting of every run that has none of its own.
    pub mounting: Mounting,
    /// Source of the data: the table `[source]`, possibly empty.
    pub source: toml::Table,
    /// The runs, in the order of the file; at least one, all with the same number of joints.
    pub runs: Vec<Run>,
}

/// One recorded motion: N samples of n joints.
#[derive(Clone, Debug)]
pub struct Run {
    /// Measured data, named after the file in the dataset's folder; time never decreases.
    pub data: plumbline_identify::Run,
    pub role: Role,
    pub note: String,
    /// Between sessions something about the arm may have changed; session 1 is the reference for the others.
    pub session: u32,
    /// Its begin on the clock of the recording; where that is not known, the end of the run before \[s\].
    pub start: f64,
    /// Further columns by name, in the order of the file.
    pub extra: Vec<(String, Vec<f64>)>,
}

impl Dataset {
    /// Reads the dataset in folder `dir`.
    /// Errors: any deviation from the format, with file, line, column, found and expected value: an unknown key, a missing column, a
    /// cell that is no finite number, time that runs backwards, fewer than [`Run::LEAST_SAMPLES`] samples, currents without gains, runs
    /// with different numbers of joints.
    pub fn read(dir: &Path) -> Result<Dataset, BadInput> {
        manifest::read(dir)
    }

    /// Writes the dataset atomically as folder `dir`.
    ///
    /// Each run's file is CSV or MCAP by its name. Torques are written in Nm; every number reads back as the same `f64`.
    /// Errors: I/O errors with their path; also when `dir` is a folder with content that is no dataset, which is left alone.
    pub fn write(&self, dir: &Path) -> std::io::Result<()> {
        write::write(self, dir)
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.runs.first().map_or(0, Run::joints)
    }

    /// Whether the run of this index begins later than the run before ends.
    fn pause_before(&self, index: usize) -> bool {
        let end = index.checked_sub(1).map_or(0.0, |before| self.runs[before].end());
        self.runs[index].start > end + manifest::SAME_TIME_S
    }

    /// Checks that the data has as many joints as the robot it names.
    pub fn expect_joints(&self, n: usize) -> Result<(), BadInput> {
        if self.joints() == n {
            return Ok(());
        }
        let found = format!("q1..q{}", self.joints());
        let expected = format!("q1..q{n}, the joints of robot `{}`", self.robot);
        Err(BadInput::new(format!("dataset {}", self.name), "header, columns q", found, expected))
    }

    /// SHA-256 over everything that an identification depends on, in hexadecimal: the same data under another name, note or number
    /// format has the same hash.
    pub fn content_hash(&self) -> String {
        hash::content_hash(self)
    }
}

impl Run {
    pub const LEAST_SAMPLES: usize = 10;

    /// One motion from its file alone, in a given mounting; torques (in Nm) may be absent, `tau` then has no columns.
    pub fn read(path: &Path, mounting: Mounting) -> Result<Run, BadInput> {
        let mut columns = file::read_run(path, Torque::Optional)?;
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        columns.take_times_of_sender(&name);
        let Columns { t, q, dq, tau, extra } = columns;
        let data = plumbline_identify::Run { name, t, q, dq, tau, mounting, period: None };
        Ok(Run { extra, ..Run::new(data, Role::Validate) })
    }

    /// A run of session 1 without a remark and further columns.
    pub fn new(data: plumbline_identify::Run, role: Role) -> Run {
        Run { data, role, note: String::new(), session: 1, start: 0.0, extra: Vec::new() }
    }

    /// Its end on the same clock as its start, one sample after the last \[s\].
    pub fn end(&self) -> f64 {
        let length = self.data.t.last().zip(self.data.t.first()).map_or(0.0, |(last, first)| last - first);
        self.start + length * self.samples() as f64 / (self.samples() as f64 - 1.0).max(1.0)
    }

    /// Number of samples, N.
    pub fn samples(&self) -> usize {
        self.data.samples()
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.data.joints()
    }

    /// Repeats, gaps and resolution of the recording.
    pub fn hygiene(&self) -> Hygiene {
        Hygiene::of(self)
    }

    pub fn extra(&self, name: &str) -> Option<&[f64]> {
        self.extra.iter().find(|(other, _)| other == name).map(|(_, values)| values.as_slice())
    }
}
