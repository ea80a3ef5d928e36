//! The live watch: detects when the served model no longer predicts the torques, and searches for what changed.

mod onset;
mod search;
mod watch;

pub use onset::onset;
pub use search::{Found, Remedy, divide, search};
pub use watch::{Floor, News, Watch, holds};

use nalgebra::DMatrix;
use plumbline_identify::Experiment;
use plumbline_model::term::Motion;
use plumbline_model::{Structure, TorqueModel};
use std::ops::Range;

/// Length of a stretch \[s\].
pub const STRETCH_S: f64 = 0.5;
/// Time excluded at both ends of a motion because of the filters \[s\].
pub const END_MARGIN_S: f64 = 0.4;
/// Error that is looked for, as a ratio to the usual one.
const LOST_RATIO: f64 = 2.0;
/// Time between samples for which the spread of the parameters is computed \[s\]: it changes with the pose.
const SPREAD_STEP_S: f64 = 0.05;

/// Measured minus modelled torque in the band, N x n \[Nm\].
pub fn residual(model: &TorqueModel, experiment: &Experiment) -> DMatrix<f64> {
    in_band(experiment, &(&experiment.tau - model.predict(&experiment.motion)))
}

fn in_band(experiment: &Experiment, torque: &DMatrix<f64>) -> DMatrix<f64> {
    let stacked = DMatrix::from_column_slice(torque.len(), 1, torque.as_slice());
    DMatrix::from_column_slice(torque.nrows(), torque.ncols(), experiment.filter(&stacked).as_slice())
}

/// Samples without the ends.
fn inside(experiment: &Experiment) -> Range<usize> {
    let samples = experiment.motion.samples();
    let ends = ((END_MARGIN_S / experiment.motion.dt) as usize).min(samples / 3);
    ends..samples - ends
}

/// RMS of measured minus modelled torque over each stretch of a motion without its ends, per joint \[Nm\].
fn stretches(model: &TorqueModel, experiment: &Experiment) -> Vec<Vec<f64>> {
    let residual = residual(model, experiment);
    let inside = inside(experiment);
    let stretch = ((STRETCH_S / experiment.motion.dt) as usize).clamp(1, inside.len().max(1));
    // The last samples count most.
    let begin = inside.start + inside.len() % stretch;
    (begin..inside.end).step_by(stretch).map(|first| rms(&residual, first..first + stretch)).collect()
}

/// RMS per joint over some of the samples \[Nm\].
pub fn rms(residual: &DMatrix<f64>, samples: Range<usize>) -> Vec<f64> {
    let count = samples.len().max(1) as f64;
    let part = residual.rows(samples.start, samples.len());
    part.column_iter().map(|column| (column.norm_squared() / count).sqrt()).collect()
}

/// RMS of a joint as a ratio to what is usual of it.
fn over(rms: &[f64], usual: &[f64], joint: usize) -> f64 {
    rms[joint] / usual[joint].max(f64::MIN_POSITIVE)
}

/// The joint whose RMS is farthest above what is usual of it; `None` without joints.
pub fn worst(rms: &[f64], usual: &[f64]) -> Option<usize> {
    let over = |joint: usize| over(rms, usual, joint);
    (0..rms.len()).max_by(|&a, &b| over(a).total_cmp(&over(b)))
}

/// Standard deviation of a model's torque in the band over some of a motion's samples, per joint \[Nm\]: [`Remedy::deviations`].
pub fn spread(deviations: &[TorqueModel], experiment: &Experiment, samples: Range<usize>) -> Vec<f64> {
    let mut squares = vec![0.0; experiment.motion.joints()];
    for model in deviations {
        let torque = in_band(experiment, &model.predict(&experiment.motion));
        squares.iter_mut().zip(rms(&torque, samples.clone())).for_each(|(sum, rms)| *sum += rms * rms);
    }
    squares.into_iter().map(f64::sqrt).collect()
}

/// Standard deviation of the torque of parameters with a covariance over some of a motion's samples, per joint \[Nm\].
pub fn parameter_spread(
    structure: &Structure,
    covariance: &DMatrix<f64>,
    experiment: &Experiment,
    samples: Range<usize>,
) -> Vec<f64> {
    let motion = &experiment.motion;
    let step = ((SPREAD_STEP_S / motion.dt) as usize).clamp(1, samples.len().max(1));
    let part =
        |values: &DMatrix<f64>| values.rows_with_step(samples.start, samples.len() / step, step - 1).into_owned();
    let part = Motion {
        dt: step as f64 * motion.dt,
        q: part(&motion.q),
        dq: part(&motion.dq),
        ddq: part(&motion.ddq),
        periodic: false,
        ..motion.clone()
    };
    let rows = structure.regressor(&part);
    let variances: Vec<f64> =
        (&rows * covariance).row_iter().zip(rows.row_iter()).map(|(spread, row)| spread.dot(&row).max(0.0)).collect();
    // Joint by joint.
    variances.chunks(part.samples().max(1)).map(|own| (own.iter().sum::<f64>() / own.len() as f64).sqrt()).collect()
}
