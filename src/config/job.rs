//! The job configuration: what `plumbline run`, `daemon` and `estimator` do.
//!
//! Every value has its default here; only `robot`, `mounting` and `[backend]` must be given. Angles, durations and frequencies carry
//! their unit in the file (`"90 deg"`, `"10 s"`, `"5 Hz"`) and are in rad, s and Hz here.

mod check;
pub mod franka;
pub mod inclinometer;
mod sets;

pub use franka::Franka;
pub use inclinometer::{Inclinometer, MountingCheck};

use super::units;
use plumbline_core::BadInput;
use plumbline_excite::{Criterion, Margins};
use plumbline_identify::{Derivative, Method, solve};
use plumbline_model::Mounting;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A whole job.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Job {
    /// The file that the job came from, as it was named.
    #[serde(skip)]
    pub file: PathBuf,
    /// A shipped robot (`panda`), or the path of a robot description.
    pub robot: String,
    /// How the base is mounted during identification.
    #[serde(deserialize_with = "units::mounting")]
    pub mounting: Mounting,
    /// The arm that is driven.
    pub backend: Backend,
    /// The motion that parameters are identified from.
    #[serde(default)]
    pub excitation: Excitation,
    /// The motions that the model is judged by.
    #[serde(default)]
    pub validation: Validation,
    /// How far the arm's limits are used.
    #[serde(default)]
    pub limits: Limits,
    /// Where the end effector may be, in place of the robot's own setting.
    #[serde(default)]
    pub workspace: Option<Workspace>,
    /// Signal processing before the least squares.
    #[serde(default)]
    pub estimator: Estimator,
    /// The search for what the model lacks.
    #[serde(default)]
    pub diagnosis: Diagnosis,
    /// What the loop's thread asks of the machine.
    #[serde(default)]
    pub realtime: Realtime,
    /// When a motion is ended.
    #[serde(default)]
    pub safety: Safety,
    /// An inclinometer on the base.
    #[serde(default)]
    pub inclinometer: Option<Inclinometer>,
    /// What has to agree on the mounting before anything is served.
    #[serde(default)]
    pub mounting_check: MountingCheck,
    /// The served feed-forward torque.
    #[serde(default)]
    pub serve: Serve,
    /// The watch over the served model.
    #[serde(default)]
    pub live: Live,
    /// What is kept of a fault.
    #[serde(default)]
    pub recorder: Recorder,
    /// What is left behind.
    #[serde(default)]
    pub output: Output,
}

/// The search for what the model lacks, after the identification.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Diagnosis {
    /// Whether it is done.
    pub enabled: bool,
    /// Highest frequency that is looked at \[Hz\].
    pub band: f64,
    /// Least torque RMS of an effect that matters \[Nm\]; by default 0.7 of the noise of the mean period.
    pub threshold: Option<f64>,
}

impl Default for Diagnosis {
    fn default() -> Diagnosis {
        Diagnosis { enabled: true, band: 16.0, threshold: None }
    }
}

/// The arm that is driven.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Backend {
    /// Which backend.
    pub kind: BackendKind,
    /// The simulated arm's truth: a built-in name (`sim-panda`) or the path of a file. Given where `kind` is `sim`, and nowhere else.
    #[serde(default)]
    pub arm: Option<Resource>,
    /// A Franka arm. Given where `kind` is `franka`, and nowhere else.
    #[serde(default)]
    pub franka: Option<Franka>,
    /// Whether simulated time follows the clock.
    #[serde(default)]
    pub pace: Pace,
    /// Seed of the simulated noise and losses.
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Pose that the arm returns to, and that a simulated one starts in; the middle of every joint's range where absent \[rad\].
    #[serde(default, deserialize_with = "units::optional_positions")]
    pub start: Option<Vec<f64>>,
}

/// Backends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BackendKind {
    /// The simulated arm.
    Sim,
    /// A Franka arm behind the Franka Control Interface, or what emulates one.
    Franka,
}

impl Backend {
    /// Whether time is simulated and may run faster than the clock.
    pub fn is_fast(&self) -> bool {
        self.kind == BackendKind::Sim && self.pace == Pace::Fast
    }
}

/// Pace of the simulated arm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// As fast as the machine can, without losing a sample.
    #[default]
    Fast,
    /// One cycle per millisecond of the clock.
    WallClock,
}

/// Something that ships with the program under a name, or a file of the user's.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(from = "String")]
pub enum Resource {
    /// A name without `/` and `.toml`.
    BuiltIn(String),
    /// A file; relative paths are relative to the folder of the configuration that names it.
    File(PathBuf),
}

impl From<String> for Resource {
    fn from(text: String) -> Resource {
        if text.contains('/') || text.ends_with(".toml") {
            Resource::File(text.into())
        } else {
            Resource::BuiltIn(text)
        }
    }
}

impl Resource {
    /// Name for errors and text of the resource; `built_in` holds the names and texts that the program carries.
    ///
    /// # Errors
    /// An unknown name, with those that are known, or a file that can't be read.
    pub fn read(&self, key: &str, built_in: &[(&str, &str)]) -> Result<(String, String), BadInput> {
        match self {
            Resource::File(path) => {
                let file = path.display().to_string();
                let text = std::fs::read_to_string(path)
                    .map_err(|error| BadInput::new(&file, "file", error, format!("a readable file, for `{key}`")))?;
                Ok((file, text))
            }
            Resource::BuiltIn(name) => {
                let known: Vec<&str> = built_in.iter().map(|(known, _)| *known).collect();
                let found = built_in.iter().find(|(known, _)| known == name).ok_or_else(|| {
                    let expected = format!("the path of a .toml file or one of {}", known.join(", "));
                    BadInput::new("configuration", format!("key `{key}`"), format!("`{name}`"), expected)
                })?;
                Ok((name.clone(), found.1.to_string()))
            }
        }
    }
}

/// The excitation: a Fourier series per joint (paper eq. 12).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Excitation {
    /// A plan to drive instead of searching one; period, harmonics and seed then come from it.
    pub plan: Option<PathBuf>,
    /// Harmonics per joint, N.
    pub harmonics: usize,
    /// Period \[s\].
    #[serde(deserialize_with = "units::duration")]
    pub period: f64,
    /// Motions to identify from: the first is searched for (or is `plan`), the others are random. What a diagnosis finds has to hold on
    /// motions that it was not found on, so it wants three or more.
    pub trajectories: usize,
    /// Periods that are averaged.
    pub periods: usize,
    /// Periods driven before those, while transients die out.
    pub lead_in: usize,
    /// What the search makes small.
    pub criterion: Criterion,
    /// Random motions that the search descends from.
    pub starts: usize,
    /// Rounds in which the search shakes its best motions and descends again.
    pub rounds: usize,
    /// Nominal model (a model file) whose torques are held to the limits, too; relative to the job's folder.
    pub model: Option<PathBuf>,
    /// Seed of the search.
    pub seed: u64,
    /// Centre of the motion, where it starts and ends; chosen by the search where absent \[rad\].
    #[serde(deserialize_with = "units::optional_positions")]
    pub q0: Option<Vec<f64>>,
}

impl Default for Excitation {
    fn default() -> Excitation {
        Excitation {
            plan: None,
            harmonics: 5,
            period: 10.0,
            trajectories: 1,
            periods: 10,
            lead_in: 1,
            criterion: Criterion::Raw,
            starts: 12,
            rounds: 2,
            model: None,
            seed: 1,
            q0: None,
        }
    }
}

/// Random motions that the model did not see (paper, Tables IV and V).
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Validation {
    /// Motions per mounting.
    pub trajectories: usize,
    /// Mountings to validate in.
    #[serde(deserialize_with = "units::mountings")]
    pub mountings: Vec<Mounting>,
    /// Periods of each motion.
    pub periods: usize,
    /// Seed of the motions.
    pub seed: u64,
    /// Whether the usual vertical set is identified, too, in a mounting of the list with gravity along axis 1, to show where it fails.
    pub counter_experiment: bool,
}

impl Default for Validation {
    fn default() -> Validation {
        Validation {
            trajectories: 5,
            mountings: vec![Mounting::WALL, Mounting::UPRIGHT],
            periods: 1,
            seed: 1000,
            counter_experiment: false,
        }
    }
}

/// How far planned motions may use the robot's limits, and limits of one's own.
///
/// Shares hold for planned motions alone; the guard stops the arm at the limits themselves.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Limits {
    /// Distance that planned motions keep from both ends of every joint \[rad\].
    #[serde(deserialize_with = "units::angle")]
    pub margin: f64,
    /// Share of the speed limits.
    pub speed: f64,
    /// Share of the acceleration limits.
    pub acceleration: f64,
    /// Share of the jerk limits.
    pub jerk: f64,
    /// Share of the limits of torque and torque rate.
    pub torque: f64,
    /// Limits of one's own, for planning and guard; they can only be tighter than the robot's.
    #[serde(rename = "override")]
    pub overrides: LimitOverrides,
}

impl Default for Limits {
    fn default() -> Limits {
        let Margins { position, velocity, acceleration, jerk, torque, .. } = Margins::default();
        Limits { margin: position, speed: velocity, acceleration, jerk, torque, overrides: LimitOverrides::default() }
    }
}

/// Limits in place of the robot's, one number per joint, named and in units as in robot descriptions.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct LimitOverrides {
    /// Lowest position \[rad\].
    pub q_min: Option<Vec<f64>>,
    /// Highest position \[rad\].
    pub q_max: Option<Vec<f64>>,
    /// Highest speed \[rad/s\].
    pub dq: Option<Vec<f64>>,
    /// Highest acceleration \[rad/s2\].
    pub ddq: Option<Vec<f64>>,
    /// Highest jerk \[rad/s3\].
    pub jerk: Option<Vec<f64>>,
    /// Highest torque \[Nm\].
    pub tau: Option<Vec<f64>>,
    /// Highest torque rate \[Nm/s\].
    pub dtau: Option<Vec<f64>>,
}

/// Where the end effector may be, in the base frame (paper eq. 14).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Workspace {
    /// Lower corner of the box around the arm \[m\].
    pub box_min: [f64; 3],
    /// Upper corner of that box \[m\].
    pub box_max: [f64; 3],
    /// Radius of the sphere around the base that the end effector stays out of \[m\].
    pub base_radius: f64,
    /// Whether planned motions keep the surfaces of the links from link 3 on in the box, too: the elbow, for instance. The paper's box is
    /// the end effector's alone, and so is the guard's.
    #[serde(default)]
    pub links_in_box: bool,
}

/// Signal processing and estimator; what is absent is left to the estimator's own defaults.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Estimator {
    /// Estimator: `ols`, `wls`, `wls-full`, `huber`, `tls` or `iv`.
    pub solver: solve::Estimator,
    /// Whether parameters that can't be told from zero are taken out.
    pub essential: bool,
    /// Signal processing: `spectral`, or `paper` (order 20, 2 Hz, central differences); the keys below go over it.
    pub method: Method,
    /// Cut-off of the filter that torque and every regressor column pass through \[Hz\].
    #[serde(deserialize_with = "units::optional_frequency")]
    pub torque_cutoff: Option<f64>,
    /// Cut-off of the position filter before derivatives are taken \[Hz\].
    #[serde(deserialize_with = "units::optional_frequency")]
    pub position_cutoff: Option<f64>,
    /// Order of both filters, even.
    pub filter_order: Option<usize>,
    /// How velocity and acceleration come from positions: `spectral` or, as in the paper, `central`.
    pub derivative: Option<Derivative>,
}

/// What the loop's thread asks of the machine, and what is done when the machine does not grant it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Realtime {
    /// SCHED_FIFO priority from 1 to 99, or 0 for ordinary scheduling.
    pub priority: u8,
    /// Processor that the loop is pinned to.
    pub cpu: Option<usize>,
    /// Whether memory is locked.
    pub lock_memory: bool,
    /// Whether the kernel should be a PREEMPT_RT one.
    pub preempt_rt: bool,
    /// What the daemon does when one of these is not granted.
    pub on_refusal: OnRefusal,
}

/// What the daemon does when the machine does not grant what the loop's thread asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnRefusal {
    /// Runs without it, and says so: in the log, in the status and in the report.
    #[default]
    Degrade,
    /// Ends before the arm is commanded anything.
    Refuse,
}

impl Default for Realtime {
    fn default() -> Realtime {
        Realtime { priority: 80, cpu: None, lock_memory: true, preempt_rt: true, on_refusal: OnRefusal::Degrade }
    }
}

/// When a motion is ended.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Safety {
    /// Largest distance of a joint from its desired position \[rad\].
    #[serde(deserialize_with = "units::angle")]
    pub tracking_error: f64,
    /// Most states that may be lost in a row. A Franka stops by itself after 20 missing commands, and more abruptly: half of that leaves room for
    /// a controlled stop.
    pub max_lost: u32,
    /// What the arm does when the estimator is gone in mid-run.
    pub on_estimator_loss: OnEstimatorLoss,
    /// How long the arm holds for the model after the motions that it is identified from; then the programme ends with a controlled stop \[s\].
    #[serde(deserialize_with = "units::duration")]
    pub model_timeout: f64,
}

impl Default for Safety {
    fn default() -> Safety {
        Safety { tracking_error: 0.1, max_lost: 10, on_estimator_loss: OnEstimatorLoss::Finish, model_timeout: 120.0 }
    }
}

/// What the arm does when the estimator is gone in mid-run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OnEstimatorLoss {
    /// Drives the motion to its end; the samples are kept for the next estimator.
    #[default]
    Finish,
    /// Brakes to a stop.
    Stop,
}

/// The served feed-forward torque. From which age on a value is stale, each client says itself
/// (`FeedForwardSettings::stale_after_ms`).
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Serve {
    /// Name under which the robot is found in shared memory; the robot's own where absent. Two arms of one kind need two names.
    pub id: Option<String>,
}

/// The watch over the served model: whether it still holds, and what is done when it does not.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Live {
    /// Whether the estimator watches the model while it is served and the arm moves.
    pub watch: bool,
    /// How long the model must have been wrong before the search for a change \[s\].
    #[serde(deserialize_with = "units::duration")]
    pub window: f64,
    /// Who decides that a model with the changes is served.
    pub adopt: Adopt,
    /// How long an unseen motion is repeated after the validation, so that there is something to watch; 0 s for none \[s\].
    #[serde(deserialize_with = "units::duration")]
    pub motion: f64,
}

impl Default for Live {
    fn default() -> Live {
        Live { watch: false, window: 10.0, adopt: Adopt::Ask, motion: 0.0 }
    }
}

/// Who decides that an offered model is served.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Adopt {
    /// A person: `plumbline command adopt`, or `reject`.
    #[default]
    Ask,
    /// The daemon, at once.
    Auto,
}

/// The flight recorder: the last seconds before a fault, and what follows up to the end of the stop.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Recorder {
    /// How long before the fault a recording begins; 0 s records nothing \[s\].
    #[serde(deserialize_with = "units::duration")]
    pub span: f64,
    /// Folder of the recordings, relative to the working directory; `flight` in the folder of the results where absent.
    pub dir: Option<PathBuf>,
    /// How many recordings of this robot's faults and stops are kept there; the oldest go.
    pub keep: usize,
    /// How many recordings on demand are kept beside them; the oldest go.
    pub keep_on_demand: usize,
}

impl Default for Recorder {
    fn default() -> Recorder {
        Recorder { span: 10.0, dir: None, keep: 20, keep_on_demand: 10 }
    }
}

/// What is left behind.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Output {
    /// Folder of the results; a relative path is relative to the working directory.
    pub dir: PathBuf,
    /// Whether the recorded motions are kept as a dataset.
    pub dataset: bool,
}

impl Default for Output {
    fn default() -> Output {
        Output { dir: PathBuf::from("results"), dataset: true }
    }
}

fn default_seed() -> u64 {
    1
}

impl Job {
    /// Reads a job from a file. Each of `sets` is a `key.path=value` of the command line's `--set` and wins over the file; a value that
    /// isn't TOML is taken as a string (`backend.pace=wall-clock`).
    ///
    /// # Errors
    /// An unreadable file, an unknown key, a value of the wrong kind or out of range, a quantity without a unit; each names the line
    /// and key, or the `--set` that brought it.
    pub fn load(path: &Path, sets: &[String]) -> Result<Job, BadInput> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|error| BadInput::new(&file, "file", error, "a readable configuration"))?;
        Job::parse(path, &text, sets)
    }

    /// As [`Job::load`], from text; `path` is only named in errors and resolves relative paths.
    pub fn parse(path: &Path, text: &str, sets: &[String]) -> Result<Job, BadInput> {
        let file = path.display().to_string();
        let mut job: Job = sets::typed(&file, text, sets)?;
        job.file = path.to_path_buf();
        check::check(&job).map_err(|bad| sets::attribute(bad, &file, sets))?;
        let dir = job.dir().to_path_buf();
        if let Some(Resource::File(arm)) = &mut job.backend.arm {
            *arm = dir.join(&*arm);
        }
        for file in [&mut job.excitation.plan, &mut job.excitation.model].into_iter().flatten() {
            *file = dir.join(&*file);
        }
        Ok(job)
    }

    /// Folder of the configuration file: relative paths of files that it names start here.
    pub fn dir(&self) -> &Path {
        self.file.parent().unwrap_or(Path::new(""))
    }
}
