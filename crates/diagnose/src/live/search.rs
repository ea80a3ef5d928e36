//! What changed: the search since a model was lost.
//!
//! The search of [`mod@crate::reference`] goes over all samples since the change, again whenever there are half as many more; the last part of them takes
//! no part in the search and judges what was found.

use super::watch::{Floor, holds};
use super::{LOST_RATIO, inside, over, residual, rms, stretches, worst};
use crate::evidence::Trial;
use crate::input::Settings;
use crate::reference::{self, Change};
use crate::select::{MAX_RIVAL_SCORE_GAP, TIE_RATIO};
use plumbline_core::symmetric_eigen;
use plumbline_identify::Experiment;
use plumbline_model::term::effect::Site;
use plumbline_model::{ModelError, TorqueModel};

/// Share of the search's window that is held out to accept the changes.
const JUDGED_RATIO: f64 = 0.25;
/// Largest error of the worst joint with the changes, as a share of the error without them, for a proposal. The worst joint is that whose error is farthest above
/// what is usual of it: a wrist's may be a hundredth of the shoulder's.
const MAX_REMAINING_RATIO: f64 = 0.8;
/// Largest error of a refined model on the held-out samples, as a ratio to that of the served one.
const MAX_REFINED_RATIO: f64 = 1.02;

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
    /// How well the changes are known: one model for each independent direction of their parameters, with one standard deviation of them and nothing else.
    /// The squares of these models' torques add up to the variance of the torque.
    pub deviations: Vec<TorqueModel>,
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

/// Searches the time since a model was lost. `find` and `judge` are two motions of it, prepared alike. `served` is the model that is served now: the
/// lost one, or one with changes from fewer samples, which then are refined. `floor` is what the lost model's errors were before. One change with which
/// they are so again is more likely than several.
pub fn search(
    lost: &TorqueModel,
    served: &TorqueModel,
    find: &Experiment,
    judge: &Experiment,
    floor: &Floor,
    settings: &Settings,
) -> Found {
    let trials = [Trial::alone(find)];
    let with = |changes: Vec<Change>| reference::extended(lost, &changes).ok().map(|model| (changes, model));
    let usual = |motion: &Experiment, model: &TorqueModel| holds(model, motion, floor, 0.0);
    let explains = |(_, model): &(Vec<Change>, TorqueModel)| usual(find, model) && usual(judge, model);
    let singles = reference::single_changes(lost, &trials, settings);
    let best = singles.iter().map(|change| change.found.score).fold(0.0, f64::max);
    let (near, far): (Vec<Change>, Vec<Change>) =
        singles.into_iter().partition(|change| change.found.score >= TIE_RATIO * best);
    let places: Vec<(Site, f64)> = near.iter().map(|change| (change.spec.site, change.found.score)).collect();
    let better = better_than_simpler(&places);
    let near = near.into_iter().zip(better).filter_map(|(change, better)| better.then_some(change)).collect();
    let alone = |changes: Vec<Change>| changes.into_iter().filter_map(|change| with(vec![change])).filter(explains);
    // The search does not know the noise; what is usual tells more of what is nearly as good. Of what is likely then, the simplest.
    let fit = |(changes, model): &(Vec<Change>, TorqueModel)| {
        let numbers = changes.iter().map(|change| change.parameters.len()).sum();
        floor.fit(&[stretches(model, find), stretches(model, judge)].concat(), numbers)
    };
    let likely = || {
        let fitted: Vec<_> = alone(near).map(|one| (fit(&one), one)).collect();
        let best = fitted.iter().map(|(fit, _)| *fit).fold(f64::NEG_INFINITY, f64::max);
        fitted.into_iter().find(|(fit, _)| *fit >= best - 0.5 * MAX_RIVAL_SCORE_GAP).map(|(_, one)| one)
    };
    // What alone would not double the error is not named beside others.
    let least = |usual: &f64| (LOST_RATIO * LOST_RATIO - 1.0).sqrt() * usual;
    let seen = Settings { usual: floor.usual.iter().map(least).collect(), ..settings.clone() };
    let several = || with(reference::changes(lost, None, &trials, &seen, &|_| {}).effects);
    let error = |model: &TorqueModel| rms(&residual(model, judge), inside(judge));
    let (before, now) = (error(lost), error(served));
    let Some((effects, extended)) = likely().or_else(|| alone(far).next()).or_else(several) else {
        return Found::Nothing { tried: 0, before: now };
    };
    let after = error(&extended);
    let worst = |rms: &[f64]| worst(rms, &floor.usual).map_or(0.0, |joint| over(rms, &floor.usual, joint));
    let enough = (MAX_REMAINING_RATIO * worst(&before)).min(MAX_REFINED_RATIO * worst(&now));
    if effects.is_empty() || worst(&after) > enough {
        return Found::Nothing { tried: effects.len(), before: now };
    }
    let deviations = deviations(lost, &effects, &extended).unwrap_or_default();
    Found::Remedy(Box::new(Remedy { changes: effects, model: extended, before, after, deviations }))
}

/// Which of these, the simplest first, with their places and scores, score better than every simpler one in the same joint: another is the same but for numbers
/// that tell nothing, as an offset is a spring without stiffness. What is of the whole arm is no part of each other.
fn better_than_simpler(places: &[(Site, f64)]) -> Vec<bool> {
    let same = |one: Site, other: Site| one == other && one != Site::Arm;
    let better = |k: usize| !places[..k].iter().any(|(site, score)| same(*site, places[k].0) && *score >= places[k].1);
    (0..places.len()).map(better).collect()
}

/// [`Remedy::deviations`] of a model that `lost` is extended to.
fn deviations(lost: &TorqueModel, changes: &[Change], extended: &TorqueModel) -> Result<Vec<TorqueModel>, ModelError> {
    let mut found = Vec::new();
    for (which, change) in changes.iter().enumerate() {
        let Some(eigen) = symmetric_eigen(change.covariance.clone()) else { continue };
        for (variance, direction) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            let mut moved = changes.to_vec();
            let parameters = moved[which].parameters.iter_mut().zip(direction.iter());
            parameters.for_each(|(own, share)| own.value += variance.max(0.0).sqrt() * share);
            let moved = reference::extended(lost, &moved)?.beta();
            let values: Vec<(f64, Option<f64>)> =
                moved.iter().zip(extended.beta()).map(|(moved, own)| (moved - own, None)).collect();
            let (structure, mountings) = (extended.structure().clone(), extended.mountings().to_vec());
            found.push(TorqueModel::new(extended.robot(), structure, mountings, &values)?);
        }
    }
    Ok(found)
}

/// Sample that divides a window into the part to search and the held-out part.
pub fn divide(samples: usize) -> usize {
    ((1.0 - JUDGED_RATIO) * samples as f64) as usize
}

#[cfg(test)]
mod tests {
    use super::super::rms;
    use super::{better_than_simpler, divide};
    use nalgebra::DMatrix;
    use plumbline_model::term::effect::Site;

    #[test]
    fn a_change_with_more_numbers_has_to_score_better_than_a_simpler_one_in_its_place() {
        let (one, other) = (Site::Joint(0), Site::Joint(1));
        let arm = |score: f64| (Site::Arm, score);
        let places = [(one, 90.0), (other, 80.0), arm(86.0), (one, 89.0), (other, 95.0), arm(85.0), (other, 94.0)];
        assert_eq!(better_than_simpler(&places), [true, true, true, false, true, true, false]);
    }

    #[test]
    fn a_window_leaves_a_quarter_to_judge_by() {
        assert_eq!(divide(10_000), 7_500);
        let residual = DMatrix::from_row_slice(4, 1, &[1.0, 3.0, 3.0, 3.0]);
        assert_eq!(rms(&residual, 1..4), [3.0]);
    }
}
