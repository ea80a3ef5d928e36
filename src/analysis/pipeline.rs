//! From recorded runs to a model and its errors, for `identify` and `estimator`.

use crate::dataset::Run;
use crate::dataset::columns::DESIRED_POSITIONS;
use crate::failure::Failure;
use crate::report::figures::TorqueFigure;
use nalgebra::DMatrix;
use plumbline_core::{BadInput, parallel, threads};
use plumbline_identify::consistency::{Nearest, Prior, Uncertainty, nearest};
use plumbline_identify::external::{ResidualSpectrum, residual_spectrum};
use plumbline_identify::{EstimateError, Experiment, Modelled, Rms, Settings, TorqueUncertainty, compare, solve};

use plumbline_identify::solve::{Identification, identify_with};
use plumbline_model::term::{Motion, torque_offset};
use plumbline_model::{Reduction, Robot, Structure, TorqueModel, TorqueSensing};

pub struct Identified {
    pub model: TorqueModel,
    pub identification: Identification,
    /// What the model leaves over along the runs; `None` where unknown.
    pub residual_spectrum: Option<ResidualSpectrum>,
}

pub struct Judged {
    /// Errors, raw and filtered.
    pub rms: Rms,
    pub figure: TorqueFigure,
}

/// Default terms beside the rigid body: motor-side torques contain rotor inertia, and every
/// torque sensor has an offset.
pub fn default_terms(robot: &Robot) -> Vec<&'static str> {
    match robot.torque_sensing {
        TorqueSensing::Link => vec!["friction", "torque-offset"],
        TorqueSensing::Motor => vec!["friction", "torque-offset", "rotor-inertia"],
    }
}

/// Default terms of a diagnosis, which reports an offset as an effect.
pub fn plain_terms(robot: &Robot) -> Vec<&'static str> {
    default_terms(robot).into_iter().filter(|id| *id != torque_offset::ID).collect()
}

pub fn measured_velocities(option: &str) -> Result<bool, BadInput> {
    match option {
        "measured" => Ok(true),
        "derived" => Ok(false),
        other => Err(BadInput::new("command line", "--velocities", format!("`{other}`"), "measured or derived")),
    }
}

/// The parameters that runs in these mountings can determine: one mounting has its own base set, several need the general one.
pub fn structure(robot: &Robot, runs: &[&Run], terms: &[&str]) -> Result<Structure, Failure> {
    let chain = robot.chain.clone();
    let same = runs
        .windows(2)
        .all(|pair| pair[0].data.mounting.angle_to(&pair[1].data.mounting) < crate::analysis::SAME_MOUNTING);
    let reduction = match runs.first() {
        Some(first) if same => Reduction::in_mounting(&chain, &first.data.mounting),
        _ => Reduction::any_mounting(&chain),
    };
    Ok(Structure::of(chain, reduction, terms).map_err(Failure::job)?.identifiable())
}

/// Refuses runs to identify from in which a channel does not vary: a torque in any run, a position in all of them.
pub fn check_channels(runs: &[&Run]) -> Result<(), BadInput> {
    check_torques(runs)?;
    let Some(first) = runs.first() else { return Ok(()) };
    for j in 0..first.joints() {
        if runs.iter().all(|run| constant(&run.data.q, j).is_some()) {
            let expected = "a position that varies in at least one run to identify from: move, or check the encoder of";
            return Err(not_varying(first, "q", &first.data.q, j, expected));
        }
    }
    Ok(())
}

/// Refuses runs with a constant torque, as from a dead sensor: its noise would be zero and its weight
/// infinite.
pub fn check_torques(runs: &[&Run]) -> Result<(), BadInput> {
    for run in runs {
        if let Some(j) = (0..run.data.tau.ncols()).find(|&j| constant(&run.data.tau, j).is_some()) {
            return Err(not_varying(run, "tau", &run.data.tau, j, "a torque that varies: check the torque sensor of"));
        }
    }
    Ok(())
}

/// The value of a column, where all samples have the same.
fn constant(channel: &DMatrix<f64>, j: usize) -> Option<f64> {
    let first = channel.column(j).iter().next().copied()?;
    channel.column(j).iter().all(|value| *value == first).then_some(first)
}

fn not_varying(run: &Run, name: &str, channel: &DMatrix<f64>, j: usize, expected: &str) -> BadInput {
    let found = format!("{} in all {} samples", channel[(0, j)], run.samples());
    BadInput::new(&run.data.name, format!("column {name}{}", j + 1), found, format!("{expected} joint {}", j + 1))
}

/// Averages, filters and differentiates a run.
pub fn experiment(run: &plumbline_identify::Run, settings: &Settings) -> Result<Experiment, Failure> {
    let expected = "a run that is long and even enough for the filters";
    Experiment::prepare(run, settings).map_err(|error| BadInput::new(&run.name, "samples", error, expected).into())
}

/// [`experiment`] of several runs, on all processors.
pub fn experiments(runs: &[&Run], settings: &Settings) -> Result<Vec<Experiment>, Failure> {
    parallel(runs, threads(), |run| experiment(&run.data, settings)).into_iter().collect()
}

/// Prepared runs to compare with a known model: each period along its own motion, with what the resolution of the encoders does to the model's torque as
/// noise.
pub fn experiments_of(model: &TorqueModel, runs: &[&Run], settings: &Settings) -> Result<Vec<Experiment>, Failure> {
    let settings = Settings { keep_periods: true, ..settings.clone() };
    let mut experiments = experiments(runs, &settings)?;
    for experiment in &mut experiments {
        experiment.follow_own_motion(|motion| model.predict(motion));
        experiment.add_resolution(|motion| model.predict(motion));
        experiment.repeats = None;
    }
    Ok(experiments)
}

/// Prepared runs, with the data that the chosen estimator needs.
pub fn for_estimator(runs: &[&Run], settings: &Settings, options: &solve::Options) -> Result<Vec<Experiment>, Failure> {
    let keep_periods = settings.keep_periods || options.estimator.needs_periods();
    let settings = Settings { keep_periods, ..settings.clone() };
    let prepare = |run: &&Run| {
        let experiment = experiment(&run.data, &settings)?;
        if !options.estimator.needs_periods() {
            return Ok(experiment);
        }
        desired(run, experiment)
    };
    parallel(runs, threads(), prepare).into_iter().collect()
}

pub fn identify(
    robot: &Robot,
    runs: &[&Run],
    terms: &[&str],
    settings: &Settings,
    options: &solve::Options,
) -> Result<Identified, Failure> {
    check_channels(runs)?;
    let structure = structure(robot, runs, terms)?;
    let experiments = for_estimator(runs, settings, options)?;
    experiments.iter().filter_map(settled).for_each(|note| tracing::info!("{note}"));
    let identification = identify_with(&structure, &experiments, options).map_err(|error| match error {
        EstimateError::NoInstruments { run } => {
            let expected = "at least two periods, or columns q_d1..q_dn, for `--estimator iv`";
            Failure::from(BadInput::new(run, "samples", "a motion that does not repeat", expected))
        }
        other => Failure::job(other),
    })?;
    identified(robot, runs, structure, identification, settings)
}

/// The model of an identification from runs of one arm.
pub fn identified(
    robot: &Robot,
    runs: &[&Run],
    structure: Structure,
    identification: Identification,
    settings: &Settings,
) -> Result<Identified, Failure> {
    let mut mountings = Vec::new();
    for run in runs {
        if !mountings.contains(&run.data.mounting) {
            mountings.push(run.data.mounting);
        }
    }
    let model = TorqueModel::new(&robot.name, structure, mountings, &identification.values()).map_err(Failure::job)?;
    let data: Vec<&plumbline_identify::Run> = runs.iter().map(|run| &run.data).collect();
    let residual_spectrum = residual_spectrum(&model, &data, settings);
    Ok(Identified { model, identification, residual_spectrum })
}

/// What is left out at the start of a periodic run.
pub fn settled(experiment: &Experiment) -> Option<String> {
    (experiment.settling > 0.0).then(|| {
        let Experiment { name, settling, .. } = experiment;
        format!("run {name}, 0.00 to {settling:.2} s: the motion did not repeat yet, left out")
    })
}

/// With the desired motion, where the run has columns `q_d1` to `q_dn`.
fn desired(run: &Run, experiment: Experiment) -> Result<Experiment, Failure> {
    let Some(q_d) = DESIRED_POSITIONS.of(run) else { return Ok(experiment) };
    let expected = "one finite desired position per sample and joint";
    experiment
        .with_desired(&run.data.t, &q_d)
        .map_err(|error| BadInput::new(&run.data.name, "columns q_d1..q_dn", error, expected).into())
}

/// [`judge`] of several runs, on all processors.
pub fn judge_all<'a>(
    model: &TorqueModel,
    runs: &[&'a Run],
    settings: &Settings,
) -> Result<Vec<(&'a Run, Judged)>, Failure> {
    parallel(runs, threads(), |run| Ok((*run, judge(model, run, settings)?))).into_iter().collect()
}

/// Predicts a run with a model, in the run's own mounting.
pub fn judge(model: &TorqueModel, run: &Run, settings: &Settings) -> Result<Judged, Failure> {
    let experiment = experiment(&run.data, settings)?;
    let modelled = Modelled::of(&experiment, |motion| model.predict(motion));
    let rms = compare(&experiment, &modelled);
    let figure = TorqueFigure {
        title: title(run),
        t: times(&experiment),
        measured: columns(&experiment.tau, experiment.joints()),
        modelled: columns(modelled.comparison(), experiment.joints()),
        raw: Vec::new(),
        noise: rms.noise_floor.clone().unwrap_or_default(),
    };
    Ok(Judged { rms, figure })
}

/// Measured and modelled torque of a run after the estimator's low-pass, with the raw torque behind them.
pub fn figure_in_band(model: &TorqueModel, run: &Run, settings: &Settings) -> Result<TorqueFigure, Failure> {
    let experiment = experiment(&run.data, settings)?;
    let modelled = model.predict(&experiment.motion);
    let noise = experiment.scatter.as_ref().map(|scatter| scatter.std_of_mean(|f| experiment.gain(f)));
    let n = experiment.joints();
    let stacked = DMatrix::from_column_slice(modelled.len(), 1, modelled.as_slice());
    Ok(TorqueFigure {
        title: title(run),
        t: times(&experiment),
        measured: columns(&experiment.filter(&experiment.stacked_tau()), n),
        modelled: columns(&experiment.filter(&stacked), n),
        raw: columns(&experiment.tau, n),
        noise: noise.unwrap_or_default(),
    })
}

fn title(run: &Run) -> String {
    crate::dataset::stem(&run.data.name).to_string()
}

/// Times of the samples since the start of the recording, of a periodic run since the start of a period \[s\].
fn times(experiment: &Experiment) -> Vec<f64> {
    let Motion { start, dt, .. } = experiment.motion;
    (0..experiment.motion.samples()).map(|k| start + k as f64 * dt).collect()
}

/// One vector per joint of a matrix that holds its samples joint by joint.
fn columns(matrix: &DMatrix<f64>, joints: usize) -> Vec<Vec<f64>> {
    matrix.as_slice().chunks(matrix.len() / joints).map(<[f64]>::to_vec).collect()
}

/// Torques of a model along a recorded motion.
pub struct Predicted {
    /// At the time stamps of the recording, N x n \[Nm\].
    pub torques: DMatrix<f64>,
    /// Whether the acceleration of a sample depends on the filter's continuation of the motion
    /// past that end, N.
    pub at_end: Vec<bool>,
    /// Errors without those samples, where the recording has measured torques.
    pub rms: Option<Rms>,
    /// Half the width of each torque's 95 % prediction interval, N x n \[Nm\]; `None` without the model's uncertainty.
    pub half_widths: Option<DMatrix<f64>>,
}

impl Predicted {
    /// Share of the measured torques within the prediction interval, per joint, without the samples near an end; `None` without either.
    pub fn coverage(&self, measured: &DMatrix<f64>) -> Option<Vec<f64>> {
        let half_widths = self.half_widths.as_ref().filter(|half| half.shape() == measured.shape())?;
        let counted: Vec<usize> = (0..self.at_end.len()).filter(|&k| !self.at_end[k]).collect();
        let within = |k: usize, j: usize| (measured[(k, j)] - self.torques[(k, j)]).abs() <= half_widths[(k, j)];
        let share = |j: usize| counted.iter().filter(|&&k| within(k, j)).count() as f64 / counted.len().max(1) as f64;
        Some((0..measured.ncols()).map(share).collect())
    }
}

/// Torques of a model at every sample of a recorded motion, with prediction intervals where the model's `uncertainty` is given.
pub fn predict(
    model: &TorqueModel,
    uncertainty: Option<&TorqueUncertainty>,
    run: &Run,
    settings: &Settings,
) -> Result<Predicted, Failure> {
    let measured = run.data.tau.ncols() > 0;
    // All samples, not the mean period.
    let mut whole = plumbline_identify::Run { period: None, ..run.data.clone() };
    if !measured {
        whole.tau = DMatrix::zeros(run.samples(), run.joints());
    }
    let experiment = experiment(&whole, settings)?;
    let rms = measured.then(|| compare(&experiment, &Modelled::of(&experiment, |motion| model.predict(motion))));
    let (motion, edge) = experiment.with_ends();
    let even = model.predict(&motion);
    let samples = even.nrows();
    // The grid begins with the recording and may end up to one step before its last sample.
    let place = |t: f64| ((t - run.data.t[0]) / motion.dt).clamp(0.0, samples as f64);
    let at_stamps = |even: &DMatrix<f64>| {
        DMatrix::from_fn(run.samples(), run.joints(), |k, j| {
            let at = place(run.data.t[k]);
            let before = (at as usize).min(samples - 2);
            even[(before, j)] + (at - before as f64) * (even[(before + 1, j)] - even[(before, j)])
        })
    };
    let torques = at_stamps(&even);
    let half_widths = uncertainty.map(|uncertainty| {
        let widths = uncertainty.half_widths(&model.structure().regressor(&motion));
        at_stamps(&DMatrix::from_vec(samples, run.joints(), widths))
    });
    let kept = edge as f64..=(samples - 1 - edge) as f64;
    // A time stamp is not exact to the last digit.
    let at_end = run.data.t.iter().map(|&t| !kept.contains(&((place(t) * 1e6).round() / 1e6))).collect();
    Ok(Predicted { torques, at_end, rms, half_widths })
}

/// Nearest physically consistent bodies in the metric of the covariance; `None`, with a warning, on failure.
pub fn real_bodies(identified: &Identified) -> Option<Nearest> {
    let identification = &identified.identification;
    let uncertainty = Uncertainty::Covariance(&identification.covariance, &identification.std);
    let structure = identified.model.structure();
    let prior = Prior::of_geometry(structure, &identification.beta);
    match nearest(structure, &identification.beta, uncertainty, &prior) {
        Ok(found) => Some(found),
        Err(error) => {
            tracing::warn!("physical consistency: {error}");
            None
        }
    }
}
