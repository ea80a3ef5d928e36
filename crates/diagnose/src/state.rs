//! A model under test: the base parameters and the effects taken in so far, fitted to the evidence.

use super::evidence::{BAND_EDGES_HZ, Evidence};
use super::fit::{Fit, Problem};
use super::library::Candidate;
use super::moments::{Columns, Cross, GroupedColumns, GroupedCross, GroupedMoments, Moments};
use super::rows::Rows;
use nalgebra::DVector;
use plumbline_model::term::effect::Site;
use std::ops::Range;
use std::sync::OnceLock;

/// Base and effects with their fit.
#[derive(Clone, Debug)]
pub struct State {
    /// Number of base columns.
    pub base: usize,
    /// The effects, in the order in which they came in.
    pub items: Vec<Candidate>,
    /// Columns of all, and the torques.
    pub columns: Columns,
    /// The fit to all folds.
    pub fit: Fit,
    grouped: OnceLock<GroupedColumns>,
    moments: OnceLock<Moments>,
}

impl State {
    /// The base alone.
    pub fn base(problem: &Problem, columns: Columns) -> State {
        let moments = columns.moments(problem.evidence);
        let fit = problem.fit(problem.bounded(GroupedMoments::of(&moments, problem.evidence)), None);
        let base = moments.width;
        State { base, items: Vec::new(), columns, fit, grouped: OnceLock::new(), moments: moments.into() }
    }

    /// Columns of an effect.
    pub fn range(&self, item: usize) -> Range<usize> {
        let first = self.base + self.items[..item].iter().map(|item| item.rows.width).sum::<usize>();
        first..first + self.items[item].rows.width
    }

    /// Whether more than half of the joints have [such an effect](Candidate::is_kindred), this one's own not counted: it is one of the arm then.
    pub fn has_in_most_joints(&self, item: &Candidate) -> bool {
        2 * self.others(item) > self.columns.m.len()
    }

    /// Whether another joint has such an effect.
    pub fn has_in_another_joint(&self, item: &Candidate) -> bool {
        self.others(item) > 0
    }

    /// Other joints that have such an effect in the whole recording; none for one of several joints, or in a part of it.
    fn others(&self, item: &Candidate) -> usize {
        if !matches!(item.spec.site, Site::Joint(_)) || !item.span.is_all() {
            return 0;
        }
        let mut others: Vec<Site> = Vec::new();
        for own in self.items.iter().filter(|own| own.span.is_all() && own.is_kindred(item)) {
            if own.spec.site != item.spec.site && !others.contains(&own.spec.site) {
                others.push(own.spec.site);
            }
        }
        others.len()
    }

    /// With one more effect.
    pub fn with(&self, problem: &Problem, item: Candidate) -> State {
        let fit = problem.fit_with(&self.fit, &self.cross(problem.evidence, &item.rows));
        let mut columns = self.columns.clone();
        columns.push(&item.rows);
        let mut items = self.items.clone();
        items.push(item);
        State { base: self.base, items, columns, fit, grouped: OnceLock::new(), moments: OnceLock::new() }
    }

    /// Without one effect.
    pub fn without(&self, problem: &Problem, item: usize) -> State {
        let columns = self.columns.without(self.range(item));
        let fit = self.fit_without(problem, item);
        let mut items = self.items.clone();
        items.remove(item);
        State { base: self.base, items, columns, fit, grouped: OnceLock::new(), moments: OnceLock::new() }
    }

    /// The fit without one effect.
    pub fn fit_without(&self, problem: &Problem, item: usize) -> Fit {
        problem.fit_without(&self.fit, self.range(item))
    }

    /// The sums of the columns, cell by cell: tens of megabytes where a motion has many folds.
    pub fn moments(&self, evidence: &Evidence) -> &Moments {
        self.moments.get_or_init(|| self.columns.moments(evidence))
    }

    /// The sums of a candidate with all columns, all folds together.
    pub fn cross(&self, evidence: &Evidence, rows: &Rows) -> GroupedCross {
        let mut crosses = self.crosses(evidence, &[rows]);
        crosses.swap_remove(0)
    }

    /// The same of several, which is quicker than one by one.
    pub fn crosses(&self, evidence: &Evidence, candidates: &[&Rows]) -> Vec<GroupedCross> {
        self.grouped.get_or_init(|| GroupedColumns::of(&self.columns, evidence)).cross(candidates)
    }

    /// Fits state and candidate together until the weights converge; `None` when the candidate is not identifiable.
    pub fn try_in(&self, problem: &Problem, item: &Candidate) -> Option<Tried> {
        let cross = self.cross(problem.evidence, &item.rows);
        let quiet = || problem.gain(&problem.quiet(&self.fit), &cross, None);
        let gain = problem.gain(&self.fit, &cross, None).or_else(quiet)?;
        let fit = problem.fit_with(&self.fit, &cross);
        let evidence = 2.0 * (fit.likelihood - self.fit.likelihood);
        let (rows, held) = (item.rows.clone(), problem.prior.is_some());
        Some(Tried { rows, fit, evidence, independence: gain.independence, held, cross: OnceLock::new() })
    }

    /// Residual torque of a joint, divided by its noise.
    pub fn residual(&self, joint: usize) -> DVector<f64> {
        &self.columns.r[joint] - &self.columns.m[joint] * &self.fit.theta
    }

    /// Mean square of a joint's residual in the band \[Nm2\].
    pub fn mean_square(&self, evidence: &Evidence, joint: usize) -> f64 {
        mean_square(evidence, joint, &self.residual(joint))
    }

    /// Mean square of what repeats and the model lacks, per joint \[Nm2\]: the noise is taken off where it is known.
    pub fn unmodelled(&self, evidence: &Evidence, joint: usize) -> f64 {
        unmodelled_below(evidence, joint, &self.residual(joint), BAND_EDGES_HZ.len())
    }
}

/// Mean square of a signal by its weighed coefficients \[Nm2\].
pub fn mean_square(evidence: &Evidence, joint: usize, rows: &DVector<f64>) -> f64 {
    mean_square_below(evidence, joint, rows, BAND_EDGES_HZ.len())
}

/// The same in the lowest `bands` of [`BAND_EDGES_HZ`] alone.
pub fn mean_square_below(evidence: &Evidence, joint: usize, rows: &DVector<f64>, bands: usize) -> f64 {
    let sigma = evidence.sigma(joint);
    let square = |row: usize| (rows[row] * sigma[row]).powi(2);
    evidence.rows_below(joint, bands).map(square).sum::<f64>() / evidence.samples()
}

/// Mean square of a residual beyond the noise, where that is known, in the lowest `bands` \[Nm2\].
pub fn unmodelled_below(evidence: &Evidence, joint: usize, rows: &DVector<f64>, bands: usize) -> f64 {
    let floor = evidence.floor_below(joint, bands).unwrap_or(0.0);
    (mean_square_below(evidence, joint, rows, bands) - floor * floor).max(0.0)
}

/// A candidate tried in a state.
#[derive(Clone, Debug)]
pub struct Tried {
    /// Its columns.
    pub rows: Rows,
    /// Fit of both.
    pub fit: Fit,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Share of its fitted torque that the other columns cannot represent.
    pub independence: f64,
    /// Whether the other parameters have a prior. Then torque that they represent at the prior's cost still counts for the candidate.
    pub held: bool,
    cross: OnceLock<Cross>,
}

impl Tried {
    /// Its sums with the columns of the state that it was tried in, cell by cell.
    pub fn cross(&self, evidence: &Evidence, state: &State) -> &Cross {
        self.cross.get_or_init(|| state.columns.cross(evidence, &self.rows))
    }

    /// Sums of both.
    pub fn moments(&self, evidence: &Evidence, state: &State) -> Moments {
        state.moments(evidence).with(self.cross(evidence, state))
    }
}
