//! What no effect of the catalogue explains: on what it depends, where it is, and which experiment would tell more.
//!
//! The residual of a joint is regressed on smooth functions of each variable and of each pair of positions and velocities, always judged
//! on trajectories that the functions were not fitted to. A residual that none of them predicts follows no function of one or two joint variables.

mod place;
mod screen;
mod variable;
mod words;

pub(super) use place::Signals;
pub use place::{Dependence, Line, Map, Window};
pub(super) use screen::{Part, gained, parts};
pub use variable::Variable;
pub(super) use variable::{Course, products};

use super::evidence::{BAND_EDGES_HZ, Evidence};
use super::fit::group;
use super::input::Settings;
use super::outcome::{LACK_OF_FIT_RATIO, Unexplained};
use super::state::State;
use nalgebra::DMatrix;
use plumbline_core::parallel;
use screen::Screen;

/// Standard deviations above what is predicted of the same residual elsewhere from which on a dependence is no chance: by the distribution of the
/// largest of many (Gumbel) 0.3 % of joints of noise alone are beyond.
const MIN_CHANCE_DEVIATIONS: f64 = 4.0;
/// A residual of which the best variables predict less than this share is flat.
pub const MIN_DEPENDENT_R2: f64 = 0.1;
/// Smallest R2 of a residual on its variables for it to count as unexplained, where the noise is unknown.
const MIN_DEPENDENCE_R2: f64 = 0.25;
/// Smallest lack of fit for a residual that depends on no variable to count as unexplained.
const MIN_FLAT_LACK_OF_FIT_RATIO: f64 = 2.0;
/// A second or a trajectory with more than this share of the residual's square has it to itself.
const CONCENTRATED_RATIO: f64 = 0.5;
/// A window that is longer is most of its trajectory \[s\].
const MAX_WINDOW_S: f64 = 5.0;
/// A second variable has to add so much to the share that one predicts.
pub(super) const MIN_SECOND_VARIABLE_R2: f64 = 0.05;

/// How well variables predict a residual.
#[derive(Clone, Debug, PartialEq)]
pub struct Predictor {
    /// One variable, or two.
    pub variables: Vec<Variable>,
    /// Share of the residual's square that they predict on trajectories left out of the fit, R2; at most the ceiling, below zero for what
    /// does harm.
    pub r2: f64,
}

/// A residual that no effect explains.
#[derive(Clone, Debug, PartialEq)]
pub struct Residual {
    /// The joint, from 0.
    pub joint: usize,
    /// RMS of what repeats and the model lacks \[Nm\].
    pub unmodelled: f64,
    /// Mean square of the residual over that of the noise; nothing without repeats.
    pub lack_of_fit: Option<f64>,
    /// Largest R2 that there can be, for the rest is noise; nothing without repeats.
    pub ceiling: Option<f64>,
    /// Single variables, the best first.
    pub singles: Vec<Predictor>,
    /// Pairs of positions and velocities, the best first.
    pub pairs: Vec<Predictor>,
    /// The variables that it depends on: one, or two where the second adds something; none for a flat residual.
    pub depends_on: Vec<Variable>,
    /// Mean residual over the best single variable.
    pub dependence: Vec<Dependence>,
    /// Mean residual over the best pair.
    pub map: Option<Map>,
    /// Every second of every trajectory.
    pub windows: Vec<Window>,
    /// Frequencies that stand out.
    pub lines: Vec<Line>,
    /// What all of that says, a sentence each.
    pub findings: Vec<String>,
    /// The experiments that would tell more, a sentence each, the most telling first.
    pub experiments: Vec<String>,
}

impl Residual {
    /// Whether no variable predicts it.
    pub fn flat(&self) -> bool {
        self.depends_on.is_empty()
    }

    /// Whether it depends on positions alone.
    pub fn follows_positions(&self) -> bool {
        !self.flat() && self.depends_on.iter().all(|variable| matches!(variable, Variable::Position(_)))
    }

    /// The second that has more than half of its square, if any.
    pub fn concentrated(&self) -> Option<&Window> {
        let has = |window: &&Window| window.share > CONCENTRATED_RATIO && window.seconds < MAX_WINDOW_S;
        self.windows.iter().find(has)
    }

    /// Whether it counts as unexplained. Where the noise is not known it has to follow some variables. Position noise enters the mean through the model and is
    /// not in the scatter of the torques: what follows none is noise up to twice as much, unless one second has most of it.
    pub fn counts(&self) -> bool {
        match self.lack_of_fit {
            Some(lack) => !self.flat() || lack > MIN_FLAT_LACK_OF_FIT_RATIO || self.concentrated().is_some(),
            None => self.r2() > MIN_DEPENDENCE_R2,
        }
    }

    /// R2 of the variables that it depends on.
    pub fn r2(&self) -> f64 {
        let best = |list: &[Predictor]| list.first().map_or(f64::NEG_INFINITY, |one| one.r2);
        if self.depends_on.len() == 2 { best(&self.pairs) } else { best(&self.singles) }
    }

    /// R2 of the best variables that a model can follow: positions and velocities.
    pub fn best_servable(&self) -> f64 {
        let served = |variable: &Variable| matches!(variable, Variable::Position(_) | Variable::Velocity(_));
        let servable = self.singles.iter().chain(&self.pairs).filter(|one| one.variables.iter().all(served));
        servable.map(|one| one.r2).fold(f64::NEG_INFINITY, f64::max)
    }

    /// As it stands in files; `floor` is the noise of the mean period \[Nm\].
    pub fn unexplained(&self, floor: Option<f64>) -> Unexplained {
        Unexplained {
            joint: self.joint + 1,
            rms: Some(self.unmodelled),
            floor,
            depends_on: self.depends_on.iter().map(|variable| variable.to_string()).collect(),
            r2: Some(self.r2()).filter(|r2| r2.is_finite()),
            deciding_experiment: self.experiments.first().cloned().unwrap_or_default(),
            note: self.findings.join(" "),
        }
    }

    /// Share of the residual's square in each trajectory.
    pub fn trajectories(&self) -> Vec<(String, f64)> {
        let mut shares: Vec<(String, f64)> = Vec::new();
        for window in &self.windows {
            match shares.iter_mut().find(|(name, _)| *name == window.run) {
                Some((_, share)) => *share += window.share,
                None => shares.push((window.run.clone(), window.share)),
            }
        }
        shares
    }
}

/// Mean square of a joint's residual over that of its noise, F; nothing without repeats.
pub fn lack_of_fit(evidence: &Evidence, state: &State, joint: usize) -> Option<f64> {
    let groups = (0..BAND_EDGES_HZ.len()).map(|band| group(joint, band));
    let sums = groups.fold((0.0, 0.0), |sum, at| (sum.0 + state.fit.rss[at], sum.1 + state.fit.sums.count[at]));
    evidence.repeats().then(|| sums.0 / f64::max(sums.1, 1.0))
}

/// Whether the model lacks something relevant in this joint. False without repeats, where the noise is unknown.
pub fn lacks(evidence: &Evidence, state: &State, joint: usize, settings: &Settings) -> bool {
    let (Some(floor), Some(lack)) = (evidence.floor(joint), lack_of_fit(evidence, state, joint)) else { return false };
    let threshold = settings.threshold.unwrap_or(settings.least_floor * floor);
    state.unmodelled(evidence, joint).sqrt() > threshold && lack > LACK_OF_FIT_RATIO
}

/// What `of` says to the functions of each variable, and to those of each pair of positions and velocities.
fn each_function<T: Send>(
    courses: &[Course],
    threads: usize,
    of: impl Fn(Vec<Variable>, &[DMatrix<f64>]) -> T + Sync,
) -> [Vec<T>; 2] {
    let singles = parallel(courses, threads, |course| of(vec![course.variable], &course.functions()));
    let of_pairs: Vec<(&Course, Vec<_>)> = courses
        .iter()
        .filter(|course| matches!(course.variable, Variable::Position(_) | Variable::Velocity(_)))
        .map(|course| (course, course.coarse()))
        .collect();
    let both: Vec<(usize, usize)> =
        (0..of_pairs.len()).flat_map(|a| (a + 1..of_pairs.len()).map(move |b| (a, b))).collect();
    let pair = |&(a, b): &(usize, usize)| {
        let ((first, left), (second, right)) = (&of_pairs[a], &of_pairs[b]);
        of(vec![first.variable, second.variable], &products(left, right))
    };
    [singles, parallel(&both, threads, pair)]
}

/// Whether the best of all variables may predict as much of a residual that depends on none: of slow noise, of which a motion without repeats has
/// few independent parts. The residual itself, moved to other parts of the motion, tells what is usual.
pub fn may_be_chance(evidence: &Evidence, state: &State, residual: &Residual, settings: &Settings) -> bool {
    let screen = Screen::of(evidence, state, residual.joint);
    let elsewhere = screen.elsewhere();
    let of_each = |_: Vec<Variable>, functions: &[DMatrix<f64>]| screen.predicted_of(functions, &elsewhere);
    let all = each_function(&Course::all(evidence), settings.threads, of_each).into_iter().flatten();
    let Some(most) = all.reduce(|most, r2| most.sup(&r2)) else { return false };
    residual.r2() < most.mean() + MIN_CHANCE_DEVIATIONS * most.variance().sqrt()
}

/// Analyses the residual of one joint, from 0.
pub fn unexplained(evidence: &Evidence, state: &State, joint: usize, settings: &Settings) -> Residual {
    let courses = Course::all(evidence);
    let screen = Screen::of(evidence, state, joint);
    let sorted = |mut list: Vec<Predictor>| {
        list.sort_by(|a, b| b.r2.total_cmp(&a.r2));
        list
    };
    let predictor =
        |variables: Vec<Variable>, functions: &[DMatrix<f64>]| Predictor { variables, r2: screen.predicted(functions) };
    let [singles, pairs] = each_function(&courses, settings.threads, predictor).map(sorted);

    let lack = lack_of_fit(evidence, state, joint);
    let best = |list: &[Predictor]| list.first().map_or(f64::NEG_INFINITY, |one| one.r2);
    let (one, two) = (best(&singles), best(&pairs));
    let depends_on = match one.max(two) {
        r2 if r2 < MIN_DEPENDENT_R2 => Vec::new(),
        _ if two > one + MIN_SECOND_VARIABLE_R2 => pairs[0].variables.clone(),
        _ => singles[0].variables.clone(),
    };
    let signals = Signals::of(evidence, joint, &state.residual(joint));
    let course = |variable: &Variable| courses.iter().find(|course| course.variable == *variable);
    let best_single = singles.first().and_then(|one| course(&one.variables[0]));
    let best_pair = pairs.first().and_then(|pair| Some((course(&pair.variables[0])?, course(&pair.variables[1])?)));
    let mut found = Residual {
        joint,
        unmodelled: state.unmodelled(evidence, joint).sqrt(),
        lack_of_fit: lack,
        ceiling: lack.map(|lack| (1.0 - 1.0 / lack).max(0.0)),
        depends_on,
        dependence: best_single.map_or_else(Vec::new, |course| signals.dependence(course)),
        map: best_pair.map(|(first, second)| signals.map(first, second)),
        windows: signals.windows(),
        lines: signals.lines(),
        singles,
        pairs,
        findings: Vec::new(),
        experiments: Vec::new(),
    };
    found.findings = words::findings(&found);
    found.experiments = words::experiments(&found, evidence);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A residual that follows the velocity of joint 1 with this R2, and has this share of its square in the first of ten seconds.
    fn residual(r2: f64, share: f64, lack_of_fit: Option<f64>) -> Residual {
        let window = |second: usize| Window {
            run: "run".into(),
            from: second as f64,
            seconds: 1.0,
            share: if second == 0 { share } else { (1.0 - share) / 9.0 },
            rms: 0.1,
        };
        let variables = vec![Variable::Velocity(0)];
        Residual {
            joint: 0,
            unmodelled: 0.1,
            lack_of_fit,
            ceiling: None,
            depends_on: if r2 < MIN_DEPENDENT_R2 { Vec::new() } else { variables.clone() },
            singles: vec![Predictor { variables, r2 }],
            pairs: Vec::new(),
            dependence: Vec::new(),
            map: None,
            windows: (0..10).map(window).collect(),
            lines: Vec::new(),
            findings: Vec::new(),
            experiments: Vec::new(),
        }
    }

    #[test]
    fn a_residual_that_follows_nothing_counts_where_it_is_large_or_in_one_second() {
        for (r2, share, lack, expected) in [
            (0.05, 0.2, Some(1.9), false),
            (0.05, 0.2, Some(2.1), true),
            (0.05, 0.6, Some(1.5), true),
            (0.15, 0.2, Some(1.5), true),
            (0.2, 0.6, None, false),
            (0.3, 0.2, None, true),
        ] {
            assert_eq!(residual(r2, share, lack).counts(), expected, "{r2} {share} {lack:?}");
        }
    }
}
