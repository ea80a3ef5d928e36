//! What changed: since a model was identified, or between the sessions of one recording.
//!
//! The selection is the one of `select`, with a prior. Against a stored model the torques are what that model
//! leaves over, and its parameters are not free: `theta = beta - beta_stored` has a Gaussian prior with the covariance of the
//! file. That is what makes a payload visible: within one session the last link's parameters would absorb it. Parameters whose standard deviations are large
//! are known well in most of their combinations, and without their correlations would absorb what is small. A parameter without a
//! standard deviation was not identifiable when the model was made; it stays free, so that no effect is blamed for it, and
//! [`Doubt`] names it where the new data has something to say about it. Between sessions the parameters are free but common to all,
//! and an effect has columns only in the sessions since it came.

mod extend;
mod held;
mod outcome;
mod tilt;

pub use extend::extended;
pub use held::Stored;
pub use outcome::Comparison;

use super::evidence::{BAND_EDGES_HZ, Evidence, LOW_BANDS, Trial};
use super::fit::{Prior, Problem, inverse};
use super::found::{Found, Step, Watch};
use super::input::Settings;
use super::library::{self, Candidate};
use super::moments::Columns;
use super::proposals::Scored;
use super::select::{Search, Selected, TIE_RATIO};
use super::span::Span;
use super::state::{State, unmodelled_below};
use nalgebra::{DMatrix, DVector};
use plumbline_core::symmetric_eigen;
use plumbline_model::term::effect::{Family, OperatingPoint, Quantity, Results, Spec};
use plumbline_model::term::{Column, effect};
use plumbline_model::{Mounting, Parameter, Structure, TorqueModel};
use std::ops::Range;

/// Factor on the stored standard deviations, which contain the noise of their recording, but neither missing effects nor the variation of friction.
const STD_ALLOWANCE_RATIO: f64 = 2.0;
/// A parameter whose file has no standard deviation at all is held as if it were known to this share of its size.
const ASSUMED_STD_RATIO: f64 = 1e-3;
/// Directions of parameters below this share of their square are not determined.
const RANK_RATIO: f64 = 1e-9;
/// A parameter is undetermined when more than this share of it lies in such directions.
const UNDETERMINED_RATIO: f64 = 1e-3;
/// A free parameter is determined by the data from this many of its standard deviations on.
const MIN_MOVED_DEVIATIONS: f64 = 4.0;
/// RMS over noise at which an effect is found with high probability.
const FOUND_FLOOR_RATIO: f64 = 0.75;
/// A run needs the free parameters when they change a joint's torque by more than this share of its noise.
const NEEDED_NOISE_RATIO: f64 = 1.0;
/// The same share of the residual where the noise is unknown.
const NEEDED_RESIDUAL_RATIO: f64 = 0.3;

/// One thing that changed.
#[derive(Clone, Debug)]
pub struct Change {
    /// What it is.
    pub spec: Spec,
    /// First session that has it; against a stored model, none.
    pub since: Option<u32>,
    /// Its linear parameters. One without a standard deviation is not determined by this data.
    pub parameters: Vec<Parameter>,
    /// Their covariance in the determined directions.
    pub covariance: DMatrix<f64>,
    /// Directions of the parameters that nothing determines, orthonormal; one row per parameter.
    pub undetermined: DMatrix<f64>,
    /// The evidence for it.
    pub found: Found,
}

impl Change {
    /// The quantities that are reported for its parameters. `stored` is the model that it changes, `declared` the mounting of the base.
    pub fn quantities(&self, stored: &[Parameter], declared: Option<&Mounting>) -> Vec<Quantity> {
        let Change { parameters, covariance, undetermined, .. } = self;
        let results = Results { parameters, covariance, undetermined, stored, declared };
        self.spec.family().map_or_else(|_| Vec::new(), |family| (family.rare.quantities)(&results))
    }
}

/// Parameters that were not identifiable in the stored model, and the runs that need them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Doubt {
    /// Names of parameters that were not identifiable when the model was made and that this data moves.
    pub parameters: Vec<String>,
    /// Names of the runs whose torques need them.
    pub runs: Vec<String>,
}

/// What changed, and what is left over.
#[derive(Clone, Debug, Default)]
pub struct Changes {
    /// What was found.
    pub effects: Vec<Change>,
    /// RMS that repeats and that the model lacks, per joint, in the band \[Nm\]; without repeats, of the whole residual.
    pub before: Vec<f64>,
    /// The same with the changes.
    pub after: Vec<f64>,
    /// Noise of the same, per joint \[Nm\]; nothing without repeats.
    pub floor: Option<Vec<f64>>,
    /// What is left over the noise, per joint, before and after, when the stored parameters may move within their errors: 1 where
    /// nothing but noise is left. Nothing without repeats.
    pub lack_of_fit: Option<Vec<[f64; 2]>>,
    /// Parameters that the model does not determine.
    pub doubt: Doubt,
    /// How it was found.
    pub path: Vec<Step>,
    /// The best candidates at the first step.
    pub first: Vec<Scored>,
    /// Trajectories, or blocks of motions that do not repeat.
    pub folds: usize,
    /// Per family, the least RMS of its torque that would have been seen, per joint \[Nm\]: 0.75 of the noise over the root of the share
    /// that nothing else can take over. Empty without repeats.
    pub least: Vec<(&'static str, Vec<f64>)>,
}

/// Kinds of effect that may have come or changed since an identification.
pub fn families() -> Vec<&'static Family> {
    effect::FAMILIES.iter().copied().filter(|family| family.rare.may_change).collect()
}

/// What changed since `reference` was identified; where the trials are of several sessions, before the first or with a later one. They
/// are in mountings that the model is valid in. Nothing is found when they are too short. `covariance` is that of the model's parameters, p x p; `None`
/// where nothing but their standard deviations is known.
pub fn changes(
    reference: &TorqueModel,
    covariance: Option<&DMatrix<f64>>,
    trials: &[Trial],
    settings: &Settings,
    progress: &Watch,
) -> Changes {
    let evidence = Evidence::of(reference.structure().chain(), trials, settings.band);
    searched((reference, covariance), &evidence, trials, BAND_EDGES_HZ.len(), settings, progress)
}

/// Changes of which each by itself may be what [`changes`] looks for, the best first; where the noise is unknown, the simplest of those that are nearly as
/// good.
pub fn single_changes(reference: &TorqueModel, trials: &[Trial], settings: &Settings) -> Vec<Change> {
    let evidence = Evidence::of(reference.structure().chain(), trials, settings.band);
    let alone = |search: &Search, base: State| {
        let one = |one: Scored| {
            let found = search.found(&base, &one, Vec::new());
            let (state, _) = tilt::exact(search, base.with(&search.problem, one.item));
            change(search, &state, 0, found)
        };
        let mut scored = search.propose(&base, |_| true);
        scored.retain(|one| one.score > 0.0);
        let best = scored.first().map_or(0.0, |one| one.score);
        let least = if evidence.repeats() { best } else { TIE_RATIO * best };
        let tied = scored.partition_point(|one| one.score >= least);
        scored[..tied].sort_by_key(Scored::cost);
        scored.into_iter().map(one).collect()
    };
    with_prior((reference, None), &evidence, trials, settings, alone).unwrap_or_default()
}

/// [`changes`] in runs that are unseen by the identification of `reference`; the noise is that of the runs that it was `identified` from. What is
/// left over is that below 4 Hz.
pub fn in_unseen(
    reference: &TorqueModel,
    covariance: Option<&DMatrix<f64>>,
    identified: &[Trial],
    unseen: &[Trial],
    settings: &Settings,
) -> Changes {
    let evidence = Evidence::with_noise_of(reference.structure().chain(), unseen, identified, settings.band);
    searched((reference, covariance), &evidence, unseen, LOW_BANDS, settings, &|_| {})
}

/// Calls `then` with the search of what changed, and the state without any change; `None` where the trials are too short.
fn with_prior<T>(
    (reference, covariance): (&TorqueModel, Option<&DMatrix<f64>>),
    evidence: &Evidence,
    trials: &[Trial],
    settings: &Settings,
    then: impl FnOnce(&Search, State) -> T,
) -> Option<T> {
    let structure = reference.structure();
    if evidence.folds().is_empty() {
        return None;
    }
    let beta = reference.beta();
    let stored = DVector::from_column_slice(&beta);
    let m = evidence.regressor(structure, trials);
    let r = evidence.torques(trials).into_iter().zip(&m).map(|(tau, m)| tau - m * &stored).collect();
    let prior = prior(reference.parameters(), covariance);
    let problem = Problem { evidence, prior: Some(&prior) };
    let base = State::base(&problem, Columns { m, r });
    let operating_point = evidence.operating_point(structure, &beta);
    let families = families();
    let mut library = library::library(evidence, &operating_point, &families, Span::ALL, settings.threads);
    library.extend(since_sessions(evidence, &operating_point, &families, settings.threads));
    let search =
        Search { problem, operating_point: &operating_point, library: &library, settings, deciding: None, came: &[] };
    Some(then(&search, base))
}

fn searched(
    stored: (&TorqueModel, Option<&DMatrix<f64>>),
    evidence: &Evidence,
    trials: &[Trial],
    bands: usize,
    settings: &Settings,
    progress: &Watch,
) -> Changes {
    let select = |search: &Search, base: State| {
        let parameters = stored.0.parameters();
        let before = left_over(evidence, &base, &DVector::zeros(parameters.len()), bands);
        let (least, lacking) = (least(search, &base), lack(evidence, &base));
        let selected = with_exact_tilts(search, search.select(base, &[], progress));
        let doubt = doubt(evidence, &selected.state, parameters);
        // The stored parameters stay what they are.
        let mut theta = selected.state.fit.theta.clone();
        theta.rows_mut(0, parameters.len()).fill(0.0);
        let after = left_over(evidence, &selected.state, &theta, bands);
        Changes { least, ..report(search, selected, [before, after], lacking, doubt) }
    };
    with_prior(stored, evidence, trials, settings, select).unwrap_or_default()
}

/// What changed between sessions: parameters are fitted to all of them together, and every family may have come with any session
/// after the first. Nothing is found within one session.
pub fn between_sessions(structure: &Structure, trials: &[Trial], settings: &Settings, progress: &Watch) -> Changes {
    let evidence = Evidence::of(structure.chain(), trials, settings.band);
    if evidence.folds().is_empty() {
        return Changes::default();
    }
    let columns = Columns { m: evidence.regressor(structure, trials), r: evidence.torques(trials) };
    let problem = Problem { evidence: &evidence, prior: None };
    let base = State::base(&problem, columns);
    let before = left_over(&evidence, &base, &base.fit.theta, BAND_EDGES_HZ.len());
    let operating_point = evidence.operating_point(structure, base.fit.theta.as_slice());
    let library = since_sessions(&evidence, &operating_point, &families(), settings.threads);
    let search =
        Search { problem, operating_point: &operating_point, library: &library, settings, deciding: None, came: &[] };
    let (least, lacking) = (least(&search, &base), lack(&evidence, &base));
    let selected = with_exact_tilts(&search, search.select(base, &[], progress));
    let after = left_over(&evidence, &selected.state, &selected.state.fit.theta, BAND_EDGES_HZ.len());
    Changes { least, ..report(&search, selected, [before, after], lacking, Doubt::default()) }
}

fn with_exact_tilts(search: &Search, selected: Selected) -> Selected {
    let (state, places) = tilt::exact(search, selected.state);
    let found = places.iter().map(|&place| selected.found[place].clone()).collect();
    Selected { state, found, ..selected }
}

/// Candidates of these families that came with each session after the first.
pub fn since_sessions(
    evidence: &Evidence,
    operating_point: &OperatingPoint,
    families: &[&'static Family],
    threads: usize,
) -> Vec<Candidate> {
    let later = evidence.sessions().into_values().skip(1);
    later.flat_map(|start| library::library(evidence, operating_point, families, Span::since(start), threads)).collect()
}

/// Precision of the stored parameters; none for those that were not identifiable. The parameters of a file without any
/// standard deviation are assumed to be known.
fn prior(parameters: &[Parameter], covariance: Option<&DMatrix<f64>>) -> Prior {
    let nobody = parameters.iter().all(|parameter| parameter.std.is_none());
    let largest = parameters.iter().map(|parameter| parameter.value.abs()).fold(0.0, f64::max);
    // A parameter that was taken out has no error of its own; one in a million of the largest stands for none.
    let allowed = |std: f64| STD_ALLOWANCE_RATIO * std.max(1e-6 * largest);
    let std = |parameter: &Parameter| {
        if nobody { Some(ASSUMED_STD_RATIO * largest.max(1e-9)) } else { parameter.std }.map(allowed)
    };
    let known: Vec<(usize, f64)> = parameters.iter().enumerate().filter_map(|(k, one)| Some((k, std(one)?))).collect();
    let uncorrelated = || DMatrix::identity(known.len(), known.len());
    let inverse =
        covariance.and_then(|covariance| inverse_correlation(covariance, &known)).unwrap_or_else(uncorrelated);
    let mut precision = DMatrix::zeros(parameters.len(), parameters.len());
    for (a, &(row, one)) in known.iter().enumerate() {
        for (b, &(column, other)) in known.iter().enumerate() {
            precision[(row, column)] = inverse[(a, b)] / (one * other);
        }
    }
    Prior { precision }
}

/// Inverse of the correlations of the parameters that are `known`; combinations that are known better than rounding tells are known as well as that.
fn inverse_correlation(covariance: &DMatrix<f64>, known: &[(usize, f64)]) -> Option<DMatrix<f64>> {
    let correlation = DMatrix::from_fn(known.len(), known.len(), |a, b| {
        let (row, column) = (known[a].0, known[b].0);
        let both = (covariance[(row, row)] * covariance[(column, column)]).sqrt();
        if a != b && both > 0.0 { covariance[(row, column)] / both } else { f64::from(a == b) }
    });
    let eigen = symmetric_eigen(correlation)?;
    let least = RANK_RATIO * eigen.eigenvalues.max();
    let scaled = DMatrix::from_fn(known.len(), known.len(), |row, k| {
        eigen.eigenvectors[(row, k)] / eigen.eigenvalues[k].max(least).sqrt()
    });
    Some(&scaled * scaled.transpose())
}

/// RMS per joint beyond the noise in the lowest `bands` of [`BAND_EDGES_HZ`], under given parameters.
fn left_over(evidence: &Evidence, state: &State, theta: &DVector<f64>, bands: usize) -> Vec<f64> {
    let beyond = |joint: usize| {
        let rest = &state.columns.r[joint] - &state.columns.m[joint] * theta;
        unmodelled_below(evidence, joint, &rest, bands).sqrt()
    };
    (0..evidence.joints()).map(beyond).collect()
}

/// Mean square of the weighed residual of a fit, per joint.
fn lack(evidence: &Evidence, state: &State) -> Vec<f64> {
    let mean = |joint: usize| state.residual(joint).norm_squared() / evidence.per_joint() as f64;
    (0..evidence.joints()).map(mean).collect()
}

fn report(
    search: &Search,
    selected: Selected,
    [before, after]: [Vec<f64>; 2],
    lacking: Vec<f64>,
    doubt: Doubt,
) -> Changes {
    let (evidence, Selected { state, found, path, first }) = (search.problem.evidence, selected);
    let floor = (0..evidence.joints()).map(|joint| evidence.floor(joint)).collect();
    let effects = found.into_iter().enumerate().map(|(item, found)| change(search, &state, item, found)).collect();
    let folds = evidence.folds().len();
    let both = lacking.into_iter().zip(lack(evidence, &state)).map(|(before, after)| [before, after]);
    let lack_of_fit = evidence.repeats().then(|| both.collect());
    Changes { effects, before, after, floor, lack_of_fit, doubt, path, first, folds, least: Vec::new() }
}

/// The least that would have been seen of each family.
fn least(search: &Search, state: &State) -> Vec<(&'static str, Vec<f64>)> {
    let evidence = search.problem.evidence;
    let mut found: Vec<(&'static str, Vec<f64>)> = Vec::new();
    if !evidence.repeats() {
        return found;
    }
    for item in search.library {
        let cross = state.cross(evidence, &item.rows);
        let share = search.problem.gain(&state.fit, &cross, None).map_or(0.0, |gain| gain.independence);
        let index = found.iter().position(|(id, _)| *id == item.spec.family).unwrap_or_else(|| {
            found.push((item.spec.family, vec![f64::INFINITY; evidence.joints()]));
            found.len() - 1
        });
        // An effect in one joint is seen in its own row; one of the whole arm in each.
        let own = item.spec.site.joints();
        for joint in item.joints().into_iter().filter(|joint| own.is_empty() || own.contains(joint)) {
            let rms = FOUND_FLOOR_RATIO * evidence.floor(joint).unwrap_or(f64::NAN) / share.sqrt();
            let least = &mut found[index].1[joint];
            if share > 0.0 {
                *least = least.min(rms);
            }
        }
    }
    found
}

/// An effect of the final state with its parameters.
pub(super) fn change(search: &Search, state: &State, item: usize, found: Found) -> Change {
    let range = state.range(item);
    let candidate = &state.items[item];
    let columns = candidate.spec.build(search.operating_point).map(|term| term.columns()).unwrap_or_default();
    let own = |of: &DMatrix<f64>| of.view((range.start, range.start), (range.len(), range.len())).into_owned();
    let covariance = at_least(
        own(&state.fit.h),
        &own(&search.problem.spread_of_folds(state.moments(search.evidence()), &state.fit)),
    );
    let unknown = unknown(&search.problem.information(state.moments(search.evidence()), &state.fit.phi), &range);
    let parameter = |(k, column): (usize, Column)| {
        let known = unknown.row(k).norm_squared() <= UNDETERMINED_RATIO;
        let std = known.then(|| covariance[(k, k)].max(0.0).sqrt());
        Parameter { column, value: state.fit.theta[range.start + k], std }
    };
    let parameters: Vec<Parameter> = columns.into_iter().enumerate().map(parameter).collect();
    let undetermined = unknown;
    let sessions = search.problem.evidence.sessions();
    let since = sessions.into_iter().find(|(_, start)| *start == candidate.span.from).map(|(session, _)| session);
    Change { spec: candidate.spec.clone(), since, parameters, covariance, undetermined, found }
}

/// A covariance whose variances are at least those of another one; its correlations stay.
fn at_least(covariance: DMatrix<f64>, other: &DMatrix<f64>) -> DMatrix<f64> {
    let growth = |k: usize| (other[(k, k)] / covariance[(k, k)].max(f64::MIN_POSITIVE)).max(1.0).sqrt();
    let growth = DVector::from_iterator(covariance.nrows(), (0..covariance.nrows()).map(growth));
    covariance.component_mul(&(&growth * growth.transpose()))
}

/// Directions of some of the parameters that nothing determines, orthonormal when every parameter is scaled to its own square; one
/// row per parameter.
fn unknown(information: &DMatrix<f64>, range: &Range<usize>) -> DMatrix<f64> {
    let (own, all) = (range.len(), information.nrows());
    let others: Vec<usize> = (0..all).filter(|k| !range.contains(k)).collect();
    let pick = |rows: &[usize], columns: &[usize]| {
        DMatrix::from_fn(rows.len(), columns.len(), |i, k| information[(rows[i], columns[k])])
    };
    let inside: Vec<usize> = range.clone().collect();
    let (a, c) = (pick(&others, &inside), pick(&inside, &inside));
    let alone = &c - a.tr_mul(&(inverse(&pick(&others, &others)) * &a));
    let scale: Vec<f64> = c.diagonal().iter().map(|d| if *d > 0.0 { 1.0 / d.sqrt() } else { 1.0 }).collect();
    let scaled = DMatrix::from_fn(own, own, |i, k| alone[(i, k)] * scale[i] * scale[k]);
    let Some(eigen) = symmetric_eigen(scaled) else { return DMatrix::identity(own, own) };
    let lost: Vec<usize> = (0..own).filter(|&k| eigen.eigenvalues[k] < RANK_RATIO).collect();
    eigen.eigenvectors.select_columns(&lost)
}

/// Free parameters that the data moves, and the runs whose torques need them.
fn doubt(evidence: &Evidence, state: &State, parameters: &[Parameter]) -> Doubt {
    let nobody = parameters.iter().all(|parameter| parameter.std.is_none());
    let free: Vec<usize> = (0..parameters.len()).filter(|&k| parameters[k].std.is_none() && !nobody).collect();
    let theta = &state.fit.theta;
    let moved = |k: &&usize| theta[**k].abs() > MIN_MOVED_DEVIATIONS * state.fit.h[(**k, **k)].max(0.0).sqrt();
    let moved: Vec<usize> = free.iter().filter(moved).copied().collect();
    let mut found = Doubt::default();
    if moved.is_empty() {
        return found;
    }
    for fold in evidence.folds() {
        let needed = |joint: usize, chosen: &[usize]| {
            let m = state.columns.m[joint].rows(fold.rows.start, fold.rows.len());
            let part = chosen
                .iter()
                .fold(DVector::zeros(fold.rows.len()), |sum: DVector<f64>, &k| sum + m.column(k) * theta[k]);
            let noise = match evidence.repeats() {
                true => NEEDED_NOISE_RATIO.powi(2) * fold.rows.len() as f64,
                false => {
                    NEEDED_RESIDUAL_RATIO.powi(2)
                        * state.residual(joint).rows(fold.rows.start, fold.rows.len()).norm_squared()
                }
            };
            part.norm_squared() > noise
        };
        let anywhere = |chosen: &[usize]| (0..evidence.joints()).any(|joint| needed(joint, chosen));
        if !anywhere(&moved) {
            continue;
        }
        if !found.runs.contains(&fold.name) {
            found.runs.push(fold.name.clone());
        }
        for &k in &moved {
            let name = &parameters[k].column.name;
            if !found.parameters.contains(name) && anywhere(&[k]) {
                found.parameters.push(name.clone());
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{At, scaled};
    use plumbline_model::term::spring;

    /// Springs of 1.6 to 2.4 Nm/rad in four trajectories: the noise alone knows their mean ten times better than that.
    #[test]
    fn what_trajectories_disagree_about_is_known_no_better_than_that() {
        let of = |apart: f64| {
            let stiffness = move |at: &At| 2.0 + apart * [-0.4, 0.1, -0.1, 0.4][at.trajectory];
            let recorded = scaled(&[1.0; 4], 84, move |at| [0.0, stiffness(at) * at.q[1]]);
            recorded.search(&[&spring::FAMILY], &Settings::default(), |search, base| {
                let item = search.library.iter().find(|item| item.joints() == [1]).unwrap().clone();
                let tried = search.propose(base, |_| true).into_iter().find(|one| one.item.joints() == [1]).unwrap();
                let found = search.found(base, &tried, Vec::new());
                let state = base.with(&search.problem, item);
                let change = change(search, &state, 0, found);
                let own = state.range(0).start;
                let estimates = search.problem.left_out(state.moments(search.evidence()), &state.fit.weights);
                let mean = estimates.iter().map(|theta| theta[own]).sum::<f64>() / 4.0;
                let jackknife = estimates.iter().map(|theta| (theta[own] - mean).powi(2)).sum::<f64>() * 0.75;
                let std = change.parameters[0].std.unwrap();
                (std, state.fit.h[(own, own)].sqrt(), jackknife.sqrt())
            })
        };
        let ((same, noise, _), (apart, of_noise, jackknife)) = (of(0.0), of(1.0));
        assert!(same < 2.0 * noise && apart > 3.0 * of_noise, "{same} {noise}, {apart} {of_noise}");
        assert!((0.5..2.0).contains(&(apart / jackknife)), "{apart} {jackknife}");
    }
}
