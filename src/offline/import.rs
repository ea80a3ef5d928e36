//! A dataset of the recordings of other programs.

use crate::analysis::checks;
use crate::config::units::parse_mounting;
use crate::dataset::{Dataset, Role, Run};
use crate::failure::Failure;
use crate::import::{self, Wanted};
use clap::{Args, ValueEnum};
use plumbline_core::BadInput;
use plumbline_identify::check::Finding;
use plumbline_model::Robot;
use std::path::{Path, PathBuf};

/// Options of [`import()`], in the words of `plumbline import`.
#[derive(Args)]
#[group(id = "import")]
pub struct Options {
    /// Recordings, one run each: CSV, npz, MCAP or rosbag2 database (.db3) with sensor_msgs/JointState
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Robot: a shipped name such as ur10e, or the path of a robot description
    #[arg(long)]
    robot: String,
    /// Folder of the dataset to write
    #[arg(long, value_name = "DIR", required_unless_present = "dry_run")]
    pub out: Option<PathBuf>,
    /// Print what was understood, make the checks, and write nothing
    #[arg(long)]
    pub dry_run: bool,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units
    #[arg(long, default_value = "upright")]
    mounting: String,
    /// The last K files are runs to validate with; by default the last 40 % of every run are held out
    #[arg(long, value_name = "K", default_value_t = 0)]
    validate: usize,
    /// Period of motions that repeat in s
    #[arg(long, value_name = "S")]
    period: Option<f64>,
    /// Topic of the joint states, where a file has several
    #[arg(long)]
    topic: Option<String>,
    /// Names of the joints in the messages, base first, where they do not tell
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    joint_names: Option<Vec<String>>,
    /// Unit of the time of CSV and npz; by default s, or found where it counts from 1970
    #[arg(long, value_enum)]
    time_unit: Option<TimeUnit>,
    /// Positions and velocities are in degrees
    #[arg(long)]
    degrees: bool,
    /// Nm per unit of torque, one per joint: for currents, or torques with the other sign
    #[arg(long, value_name = "K1,..,KN", value_delimiter = ',', allow_hyphen_values = true)]
    torque_gain: Option<Vec<f64>>,
}

#[derive(Clone, Copy, ValueEnum)]
enum TimeUnit {
    S,
    Ms,
    Us,
    Ns,
}

/// What the recordings hold.
pub struct Imported {
    /// One run per recording; not written.
    pub dataset: Dataset,
    /// What was understood of each recording.
    pub notes: Vec<(PathBuf, Vec<String>)>,
    /// Results of the checks of `plumbline check`.
    pub findings: Vec<Finding>,
}

/// Reads the recordings and checks them.
///
/// # Errors
/// Options and files that can't be used.
pub fn import(options: &Options) -> Result<Imported, Failure> {
    let robot = Robot::load(&options.robot, None)?;
    let wanted = options.wanted(robot.chain.len())?;
    let mounting = parse_mounting("--mounting", &options.mounting)?;
    let (mut runs, mut notes) = (Vec::new(), Vec::new());
    let mut at = 0.0;
    for (index, path) in options.files.iter().enumerate() {
        let import::Imported { t, q, dq, tau, notes: own } = import::read(path, &wanted)?;
        notes.push((path.clone(), own));
        let name = run_name(path, &runs);
        let length = t.last().copied().unwrap_or_default();
        let data = plumbline_identify::Run { name, t, q, dq, tau, mounting, period: options.period };
        let role = if index + options.validate >= options.files.len() { Role::Validate } else { Role::Identify };
        runs.push(Run { start: at, ..Run::new(data, role) });
        at += length;
    }
    let mut source = toml::Table::new();
    source.insert("program".into(), format!("plumbline {}, import", env!("CARGO_PKG_VERSION")).into());
    let files: Vec<toml::Value> = options.files.iter().map(|path| path.display().to_string().into()).collect();
    source.insert("files".into(), files.into());
    let name = options.out.as_deref().and_then(Path::file_name);
    let dataset = Dataset {
        name: name.map_or("imported".into(), |name| name.to_string_lossy().into_owned()),
        robot: options.robot_in_dataset()?,
        mounting,
        source,
        runs,
    };
    let findings = checks::findings(&dataset, &robot);
    Ok(Imported { dataset, notes, findings })
}

impl Options {
    fn wanted(&self, n: usize) -> Result<Wanted, BadInput> {
        let count = |option: &str, found: usize| {
            let expected = format!("{n}, one per joint of `{}`", self.robot);
            if found == n {
                Ok(())
            } else {
                Err(BadInput::new("command line", option, format!("{found} values"), expected))
            }
        };
        self.joint_names.as_ref().map_or(Ok(()), |names| count("--joint-names", names.len()))?;
        self.torque_gain.as_ref().map_or(Ok(()), |gain| count("--torque-gain", gain.len()))?;
        if let Some(gain) = self.torque_gain.iter().flatten().find(|gain| !(gain.is_finite() && **gain != 0.0)) {
            return Err(BadInput::new("command line", "--torque-gain", gain.to_string(), "numbers other than 0"));
        }
        if let Some(period) = self.period.filter(|period| !(period.is_finite() && *period > 0.0)) {
            return Err(BadInput::new("command line", "--period", period.to_string(), "a period in s, above 0"));
        }
        if self.validate >= self.files.len() {
            let expected = format!("less than the {} files: at least one to identify from", self.files.len());
            return Err(BadInput::new("command line", "--validate", self.validate.to_string(), expected));
        }
        let unit = |unit: TimeUnit| match unit {
            TimeUnit::S => 1.0,
            TimeUnit::Ms => 1e-3,
            TimeUnit::Us => 1e-6,
            TimeUnit::Ns => 1e-9,
        };
        Ok(Wanted {
            joints: n,
            names: self.joint_names.clone(),
            topic: self.topic.clone(),
            time_unit: self.time_unit.map(unit),
            degrees: self.degrees,
            gain: self.torque_gain.clone(),
        })
    }

    /// A description of the user's own is named by its whole path, because the dataset may lie elsewhere.
    fn robot_in_dataset(&self) -> Result<String, BadInput> {
        if !self.robot.ends_with(".toml") {
            return Ok(self.robot.clone());
        }
        let whole = std::fs::canonicalize(&self.robot)
            .map_err(|error| BadInput::new(&self.robot, "file", error, "a readable robot description"))?;
        Ok(whole.display().to_string())
    }
}

/// `recording.csv`, or `recording-2.csv` where another run has that name.
fn run_name(path: &Path, before: &[Run]) -> String {
    let stem = path.file_stem().map_or("run".into(), |stem| stem.to_string_lossy().into_owned());
    let taken = |name: &String| before.iter().any(|run| run.data.name == *name);
    let numbered = (1..).map(|k| if k == 1 { format!("{stem}.csv") } else { format!("{stem}-{k}.csv") });
    numbered.into_iter().find(|name| !taken(name)).unwrap_or_default()
}
