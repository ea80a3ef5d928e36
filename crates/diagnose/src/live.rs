//! The live watch: detects when the served model no longer predicts the torques, and searches for what changed.
//!
//! The detector checks one short stretch of samples after the other. It compares the RMS of measured minus modelled torque in the
//! band with what it was on the motion that the model was identified from, joint by joint. Two bad stretches in a row are an alarm,
//! which says since when and in which joint. When the model has been wrong for long enough, the search of [`mod@super::reference`] goes over that
//! time; the last part of it takes no part in the search and judges what was found.

use super::Settings;
use super::evidence::Trial;
use super::reference::{self, Change, Changes};
use nalgebra::DMatrix;
use plumbline_identify::Experiment;
use plumbline_model::TorqueModel;
use std::ops::Range;

/// Length of a stretch \[s\].
pub const STRETCH_S: f64 = 1.0;
/// Time excluded at both ends of a motion because of the filters \[s\].
pub const END_MARGIN_S: f64 = 0.4;
/// A stretch is bad above this multiple of the usual error
const BAD_USUAL_RATIO: f64 = 2.0;
/// and above this multiple of the worst stretch of the identification.
const BAD_WORST_RATIO: f64 = 1.3;
/// Bad stretches in a row that are an alarm.
const ALARM_STRETCHES: usize = 2;
/// Share of the search's window that is held out to accept the changes.
const JUDGED_RATIO: f64 = 0.25;
/// Largest error of the worst joint with the changes, as a share of the error without them, for a proposal.
const MAX_REMAINING_RATIO: f64 = 0.8;

/// Error in the band, per joint: what is usual, and from where on a stretch is bad \[Nm\].
#[derive(Clone, Debug, PartialEq)]
pub struct Floor {
    /// RMS on the motion that the model was identified from.
    pub usual: Vec<f64>,
    /// The least that is bad.
    pub limit: Vec<f64>,
}

/// A change of the watch's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum News {
    /// The model does not hold any more.
    Lost {
        /// Start of the first bad stretch \[s\].
        since: f64,
        /// Joint whose error is farthest above its limit, from 0.
        joint: usize,
        /// Its RMS \[Nm\].
        rms: f64,
        /// What it usually is \[Nm\].
        floor: f64,
    },
    /// It holds again.
    Holds {
        /// End of the last bad stretch \[s\].
        since: f64,
    },
}

/// Detector over consecutive stretches.
#[derive(Clone, Debug)]
pub struct Watch {
    floor: Floor,
    /// Start of the bad stretches in a row, how many they are, and the end of the last.
    bad: Option<(f64, usize, f64)>,
    lost: bool,
}

impl Floor {
    /// Of the motion that the model was identified from, prepared like those that will be watched.
    pub fn of(model: &TorqueModel, experiment: &Experiment) -> Floor {
        let residual = residual(model, experiment);
        let inside = inside(experiment);
        let usual = rms(&residual, inside.clone());
        let stretch = ((STRETCH_S / experiment.motion.dt) as usize).clamp(1, inside.len().max(1));
        let mut worst = vec![0.0; experiment.joints()];
        for first in (inside.start..(inside.end + 1).saturating_sub(stretch)).step_by(stretch) {
            for (worst, own) in worst.iter_mut().zip(rms(&residual, first..first + stretch)) {
                *worst = own.max(*worst);
            }
        }
        let limit = usual
            .iter()
            .zip(&worst)
            .map(|(usual, worst)| (BAD_USUAL_RATIO * usual).max(BAD_WORST_RATIO * worst))
            .collect();
        Floor { usual, limit }
    }
}

impl Watch {
    /// Before the first stretch.
    pub fn new(floor: Floor) -> Watch {
        Watch { floor, bad: None, lost: false }
    }

    /// What is usual, and what is bad.
    pub fn floor(&self) -> &Floor {
        &self.floor
    }

    /// Takes a stretch from `start` to `end` \[s\] with its RMS per joint in the band \[Nm\]; returns a change of state.
    pub fn look(&mut self, start: f64, end: f64, rms: &[f64]) -> Option<News> {
        let over = |joint: &usize| rms[*joint] / self.floor.limit[*joint].max(f64::MIN_POSITIVE);
        let worst = (0..rms.len()).max_by(|a, b| over(a).total_cmp(&over(b)))?;
        if over(&worst) < 1.0 {
            let (was, until) = (self.lost, self.bad.map_or(start, |(_, _, until)| until));
            (self.bad, self.lost) = (None, false);
            return was.then_some(News::Holds { since: until });
        }
        let (since, count) = self.bad.map_or((start, 1), |(since, count, _)| (since, count + 1));
        self.bad = Some((since, count, end));
        if self.lost || count < ALARM_STRETCHES {
            return None;
        }
        self.lost = true;
        Some(News::Lost { since, joint: worst, rms: rms[worst], floor: self.floor.usual[worst] })
    }

    /// When the model stopped to hold, while it does not \[s\].
    pub fn lost_since(&self) -> Option<f64> {
        self.bad.filter(|_| self.lost).map(|(since, ..)| since)
    }

    /// Starts anew, under another model.
    pub fn reset(&mut self) {
        (self.bad, self.lost) = (None, false);
    }
}

/// Changes that were found, and the model with them.
#[derive(Clone, Debug)]
pub struct Remedy {
    /// The changes.
    pub changes: Vec<Change>,
    /// The model with them.
    pub model: TorqueModel,
    /// RMS per joint in the band on the samples that took no part, of the served model \[Nm\].
    pub before: Vec<f64>,
    /// The same of the model with the changes \[Nm\].
    pub after: Vec<f64>,
}

/// What a search ended with.
#[derive(Clone, Debug)]
pub enum Found {
    /// Something that lowers the error.
    Remedy(Box<Remedy>),
    /// Nothing that does: how many changes were tried, and the error per joint \[Nm\].
    Nothing {
        /// Effects that were found but do not lower the held-out error.
        tried: usize,
        /// RMS per joint in the band of the served model \[Nm\].
        before: Vec<f64>,
    },
}

/// Searches the time since the model was lost. `find` and `judge` are two motions of it, prepared alike.
pub fn search(model: &TorqueModel, find: &Experiment, judge: &Experiment, settings: &Settings) -> Found {
    let trials = [Trial::alone(find)];
    let Changes { effects, .. } = reference::changes(model, &trials, settings, &|_| {});
    let error = |model: &TorqueModel| rms(&residual(model, judge), inside(judge));
    let before = error(model);
    let nothing = |tried: usize| Found::Nothing { tried, before: before.clone() };
    let Ok(extended) = reference::extended(model, &effects) else { return nothing(effects.len()) };
    let after = error(&extended);
    let worst = |rms: &[f64]| rms.iter().copied().fold(0.0, f64::max);
    if effects.is_empty() || worst(&after) > MAX_REMAINING_RATIO * worst(&before) {
        return nothing(effects.len());
    }
    Found::Remedy(Box::new(Remedy { changes: effects, model: extended, before, after }))
}

/// Sample that divides a window into the part to search and the held-out part.
pub fn divide(samples: usize) -> usize {
    ((1.0 - JUDGED_RATIO) * samples as f64) as usize
}

/// Measured minus modelled torque in the band, N x n \[Nm\].
pub fn residual(model: &TorqueModel, experiment: &Experiment) -> DMatrix<f64> {
    let rest = &experiment.tau - model.predict(&experiment.motion);
    let stacked = DMatrix::from_column_slice(rest.len(), 1, rest.as_slice());
    DMatrix::from_column_slice(rest.nrows(), rest.ncols(), experiment.filter(&stacked).as_slice())
}

/// Samples without the ends.
fn inside(experiment: &Experiment) -> Range<usize> {
    let samples = experiment.motion.samples();
    let ends = ((END_MARGIN_S / experiment.motion.dt) as usize).min(samples / 3);
    ends..samples - ends
}

/// RMS per joint over some of the samples \[Nm\].
pub fn rms(residual: &DMatrix<f64>, samples: Range<usize>) -> Vec<f64> {
    let count = samples.len().max(1) as f64;
    let part = residual.rows(samples.start, samples.len());
    part.column_iter().map(|column| (column.norm_squared() / count).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> Watch {
        Watch::new(Floor { usual: vec![0.02, 0.01], limit: vec![0.05, 0.04] })
    }

    #[test]
    fn two_bad_stretches_in_a_row_are_an_alarm_that_says_where_and_since_when() {
        let mut watch = watch();
        assert_eq!(watch.look(0.0, 1.0, &[0.02, 0.01]), None);
        // One bad stretch is no alarm.
        assert_eq!(watch.look(1.0, 2.0, &[0.02, 0.9]), None);
        assert_eq!(watch.look(2.0, 3.0, &[0.02, 0.01]), None);
        assert_eq!(watch.look(3.0, 4.0, &[0.06, 0.30]), None);
        assert_eq!(watch.lost_since(), None);
        let news = watch.look(4.0, 5.0, &[0.06, 0.30]);
        assert_eq!(news, Some(News::Lost { since: 3.0, joint: 1, rms: 0.30, floor: 0.01 }));
        assert_eq!(watch.lost_since(), Some(3.0));
        // Reported once.
        assert_eq!(watch.look(5.0, 6.0, &[0.06, 0.30]), None);
        assert_eq!(watch.look(6.0, 7.0, &[0.02, 0.01]), Some(News::Holds { since: 6.0 }));
        assert_eq!((watch.lost_since(), watch.look(7.0, 8.0, &[0.02, 0.01])), (None, None));
    }

    #[test]
    fn another_model_starts_anew() {
        let mut watch = watch();
        watch.look(0.0, 1.0, &[1.0, 1.0]);
        watch.look(1.0, 2.0, &[1.0, 1.0]);
        assert!(watch.lost_since().is_some());
        watch.reset();
        assert_eq!((watch.lost_since(), watch.look(2.0, 3.0, &[1.0, 1.0])), (None, None));
    }

    #[test]
    fn a_window_leaves_a_quarter_to_judge_by() {
        assert_eq!(divide(10_000), 7_500);
        let residual = DMatrix::from_row_slice(4, 1, &[1.0, 3.0, 3.0, 3.0]);
        assert_eq!(rms(&residual, 1..4), [3.0]);
    }
}
