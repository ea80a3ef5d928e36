//! The job configuration: what `plumbline run`, `daemon` and `estimator` do.
//!
//! Every value has its default here; only `robot`, `mounting` and `[backend]` must be given. Angles, durations and frequencies carry
//! their unit in the file (`"90 deg"`, `"10 s"`, `"5 Hz"`) and are in rad, s and Hz here.

mod check;
pub mod franka;
pub mod guest;
pub mod inclinometer;
mod resource;
mod sets;
pub mod sim;

pub use franka::Franka;
pub use guest::Guest;
pub use inclinometer::{Inclinometer, MountingCheck};
pub use resource::Resource;

use super::units;
use crate::dataset::Format;
use plumbline_core::{BadInput, PERIOD_S};
use plumbline_excite::{Criterion, Margins};
use plumbline_identify::{Derivative, Method, solve};
use plumbline_model::Mounting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Job {
    #[serde(skip)]
    pub file: PathBuf,
    /// A shipped robot (`panda`), or the path of a robot description.
    pub robot: String,
    #[serde(with = "units::MountingSetting")]
    pub mounting: Mounting,
    pub backend: Backend,
    #[serde(default)]
    pub excitation: Excitation,
    #[serde(default)]
    pub validation: Validation,
    #[serde(default)]
    pub limits: Limits,
    /// Workspace of the end effector; the robot's if absent.
    #[serde(default)]
    pub workspace: Option<Workspace>,
    /// Signal processing before the least squares.
    #[serde(default)]
    pub estimator: Estimator,
    #[serde(default)]
    pub diagnosis: Diagnosis,
    /// Real-time rights of the loop's thread.
    #[serde(default)]
    pub realtime: Realtime,
    #[serde(default)]
    pub safety: Safety,
    #[serde(default)]
    pub inclinometer: Option<Inclinometer>,
    #[serde(default)]
    pub mounting_check: MountingCheck,
    #[serde(default)]
    pub serve: Serve,
    #[serde(default)]
    pub live: Live,
    #[serde(default)]
    pub recorder: Recorder,
    #[serde(default)]
    pub output: Output,
}

#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Diagnosis {
    pub enabled: bool,
    /// Highest analysed frequency \[Hz\].
    pub band: f64,
    /// Detection threshold: smallest torque RMS of an effect \[Nm\]; by default 0.7 of the noise of the mean period.
    pub threshold: Option<f64>,
    /// Further motions that are planned and driven while the diagnosis leaves something open.
    pub rounds: usize,
    /// Wanted half width of the 95 % intervals of effects' parameters, as a share of the effect's size; a wider one is left open.
    pub until: Option<f64>,
}

impl Default for Diagnosis {
    fn default() -> Diagnosis {
        Diagnosis { enabled: true, band: 16.0, threshold: None, rounds: 0, until: None }
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Backend {
    pub kind: BackendKind,
    /// The simulated arm's truth: a built-in name (`sim-panda`) or the path of a file. Given where `kind` is `sim`, and nowhere else.
    #[serde(default)]
    pub arm: Option<Resource>,
    /// A Franka arm. Given where `kind` is `franka`, and nowhere else.
    #[serde(default)]
    pub franka: Option<Franka>,
    /// How long is listened. Only where `kind` is `guest`; its defaults where absent.
    #[serde(default)]
    pub guest: Option<Guest>,
    /// Whether simulated time follows the clock.
    #[serde(default)]
    pub pace: Pace,
    #[serde(default = "default_seed")]
    pub seed: u64,
    /// Pose that the arm returns to, and that a simulated one starts in; the middle of every joint's range where absent \[rad\].
    #[serde(default, with = "units::Positions")]
    pub start: Option<Vec<f64>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum BackendKind {
    Sim,
    /// A Franka arm, or its emulator, over the Franka Control Interface.
    Franka,
    /// An arm that another program controls and publishes the states of. It is listened to and never commanded.
    Guest,
}

impl Backend {
    /// How long is listened to an arm that another program controls; `None` for an arm that plumbline drives.
    pub fn guest(&self) -> Option<Guest> {
        (self.kind == BackendKind::Guest).then(|| self.guest.clone().unwrap_or_default())
    }

    /// Time between two states of the arm \[s\].
    pub fn sample_period(&self) -> f64 {
        self.guest().map_or(PERIOD_S, |guest| guest.period())
    }

    /// Whether a loop commands the arm at the pace of the clock.
    pub fn needs_realtime(&self) -> bool {
        self.kind != BackendKind::Guest && !self.is_fast()
    }

    /// Whether time is simulated and may run faster than the clock.
    pub fn is_fast(&self) -> bool {
        self.kind == BackendKind::Sim && self.pace == Pace::Fast
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Pace {
    /// As fast as possible, without losing a sample.
    #[default]
    Fast,
    WallClock,
}

/// The excitation: a Fourier series per joint (paper eq. 12).
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Excitation {
    /// A plan to use instead of a search; it also sets period, harmonics and seed.
    pub plan: Option<PathBuf>,
    /// Harmonics per joint, N.
    pub harmonics: usize,
    /// Period \[s\].
    #[serde(with = "units::Duration")]
    pub period: f64,
    /// Motions to identify from: the first is searched for (or is `plan`), the others are random. What a diagnosis finds has to hold on
    /// motions that it was not found on, so it wants three or more.
    pub trajectories: usize,
    pub periods: usize,
    /// Periods driven before those, while transients die out.
    pub lead_in: usize,
    pub criterion: Criterion,
    pub starts: usize,
    /// Rounds in which the best motions are perturbed and optimised again.
    pub rounds: usize,
    /// Nominal model (a model file) whose torques are held to the limits, too; relative to the job's folder.
    pub model: Option<PathBuf>,
    pub seed: u64,
    /// Centre of the motion, where it starts and ends; chosen by the search where absent \[rad\].
    #[serde(with = "units::Positions")]
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

/// Validation motions (paper, Tables IV and V).
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Validation {
    pub trajectories: usize,
    #[serde(with = "units::Mountings")]
    pub mountings: Vec<Mounting>,
    pub periods: usize,
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

/// Ratios of the robot's limits for planned motions, and tighter limits of the job.
///
/// Shares hold for planned motions alone; the guard stops the arm at the limits themselves.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Limits {
    /// Distance that planned motions keep from both ends of every joint \[rad\].
    #[serde(with = "units::Angle")]
    pub margin: f64,
    pub speed: f64,
    pub acceleration: f64,
    pub jerk: f64,
    /// Share of the limits of torque and torque rate.
    pub torque: f64,
    /// Limits for planning and guard; they can only be tighter than the robot's.
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
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
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

/// Workspace of the end effector in the base frame (paper eq. 14).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, JsonSchema)]
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

/// Signal processing and estimator; absent keys have the estimator's defaults.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Estimator {
    /// Estimator: `ols`, `wls`, `wls-full`, `huber`, `tls` or `iv`.
    pub solver: solve::Estimator,
    /// Whether parameters that are not significantly different from zero are removed.
    pub essential: bool,
    /// Signal processing: `spectral`, or `paper` (order 20, 2 Hz, central differences); the keys below go over it.
    pub method: Method,
    /// Cut-off of the filter that torque and every regressor column pass through \[Hz\].
    #[serde(with = "units::OptionalFrequency")]
    pub torque_cutoff: Option<f64>,
    /// Cut-off of the position filter before derivatives are taken \[Hz\].
    #[serde(with = "units::OptionalFrequency")]
    pub position_cutoff: Option<f64>,
    /// Order of both filters, even.
    pub filter_order: Option<usize>,
    /// How velocity and acceleration come from positions: `spectral` or, as in the paper, `central`.
    pub derivative: Option<Derivative>,
}

/// Real-time rights of the loop's thread, and the action if they are refused.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Realtime {
    /// SCHED_FIFO priority from 1 to 99, or 0 for ordinary scheduling.
    pub priority: u8,
    pub cpu: Option<usize>,
    pub lock_memory: bool,
    pub preempt_rt: bool,
    pub on_refusal: OnRefusal,
}

/// Action if a real-time right is refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnRefusal {
    /// Run without it and report that in log, status and report.
    #[default]
    Degrade,
    /// End before the first command.
    Refuse,
}

impl Default for Realtime {
    fn default() -> Realtime {
        Realtime { priority: 80, cpu: None, lock_memory: true, preempt_rt: true, on_refusal: OnRefusal::Degrade }
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Safety {
    /// Largest distance of a joint from its desired position \[rad\].
    #[serde(with = "units::Angle")]
    pub tracking_error: f64,
    /// Maximum number of states lost in a row while the arm moves. A Franka stops by itself, and more abruptly, after 20 missing commands; half of that leaves time for
    /// a controlled stop.
    pub max_lost: u32,
    /// Action if the estimator is lost during a motion.
    pub on_estimator_loss: OnEstimatorLoss,
    /// Timeout of the model after the identification motions, while the arm holds; then there is a controlled stop \[s\].
    #[serde(with = "units::Duration")]
    pub model_timeout: f64,
}

impl Default for Safety {
    fn default() -> Safety {
        Safety { tracking_error: 0.1, max_lost: 10, on_estimator_loss: OnEstimatorLoss::Finish, model_timeout: 120.0 }
    }
}

/// Action if the estimator is lost during a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum OnEstimatorLoss {
    /// Complete the motion; the samples are kept for the next estimator.
    #[default]
    Finish,
    Stop,
}

/// The served feed-forward torque. Each client sets the age of a stale value
/// (`FeedForwardSettings::stale_after_ms`).
#[derive(Clone, Debug, Default, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Serve {
    /// Name under which the robot is found in shared memory; the robot's own where absent. Two arms of one kind need two names.
    pub id: Option<String>,
    /// TCP port of 127.0.0.1 at which the daemon answers Prometheus; none where absent.
    pub metrics_port: Option<i64>,
}

/// Live watch: monitors the residual of the served model.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Live {
    /// Whether the estimator watches the model while it is served and the arm moves.
    pub watch: bool,
    /// Duration of an alarm before the search for a change \[s\].
    #[serde(with = "units::Duration")]
    pub window: f64,
    /// Whether a proposed model is served at once or after an operator's decision.
    pub adopt: Adopt,
    /// Duration of a repeated motion after the validation, for the live watch; 0 s for none \[s\].
    #[serde(with = "units::Duration")]
    pub motion: f64,
}

impl Default for Live {
    fn default() -> Live {
        Live { watch: false, window: 4.0, adopt: Adopt::Ask, motion: 0.0 }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Adopt {
    /// By an operator: `plumbline command adopt`, or `reject`.
    #[default]
    Ask,
    Auto,
}

/// The flight recorder: the last seconds before a fault, up to the end of the stop.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Recorder {
    /// Recorded time before a fault; 0 s for no recordings \[s\].
    #[serde(with = "units::Duration")]
    pub span: f64,
    /// Folder of the recordings, relative to the working directory; `flight` in the folder of the results where absent.
    pub dir: Option<PathBuf>,
    /// Maximum number of recordings of faults and stops; the oldest are removed.
    pub keep: usize,
    /// Maximum number of recordings on demand; the oldest are removed.
    pub keep_on_demand: usize,
}

impl Default for Recorder {
    fn default() -> Recorder {
        Recorder { span: 10.0, dir: None, keep: 20, keep_on_demand: 10 }
    }
}

#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Output {
    /// Folder of the results; a relative path is relative to the working directory.
    pub dir: PathBuf,
    /// Whether the recorded motions are kept as a dataset.
    pub dataset: bool,
    /// Format of the dataset's runs.
    pub dataset_format: Format,
}

impl Default for Output {
    fn default() -> Output {
        Output { dir: PathBuf::from("results"), dataset: true, dataset_format: Format::Csv }
    }
}

fn default_seed() -> u64 {
    1
}

impl Job {
    /// Reads a job from a file. Each of `sets` is a `key.path=value` of the command line's `--set` and wins over the file; a value that
    /// isn't TOML is taken as a string (`backend.pace=wall-clock`).
    /// Errors: an unreadable file, an unknown key, a value of the wrong kind or out of range, a quantity without a unit; each names the line
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
