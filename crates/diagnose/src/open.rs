//! What a diagnosis leaves open, and what a planned motion would answer.
//!
//! Let `J` be the information about all parameters: base parameters, and of each effect its linear parameters and its settings (as columns of their
//! slopes). It is the sum of that of the recorded runs and that of a planned one, which needs its positions and the known noise alone.
//!
//! Rivals. If effect A with torque `t` is true and effect B is fitted in its place, with all other parameters `F` free,
//!
//!   D(A, B) = t' W t - t' W F (F' W F)^-1 F' W t
//!
//! is the least squared residual (T-optimality: Atkinson and Fedorov, Biometrika 62, 1975). The scale `phi_g` of the noise of each joint and band is
//! fitted with it, so a residual of `D_g` in the `n_g` rows of a joint and band raises twice the log likelihood by `n_g ln(1 + D_g / (phi_g n_g))`. The
//! sum is the score difference to expect, the smaller one of A against B and B against A. It is that of the form in which the rival fits the recorded
//! runs; a richer form may fit more of the planned one. Intervals: the half width that `J^-1` gives. Anything else:
//! `1/2 ln det J`, D-optimality.

use super::deviations::slopes;
use super::evidence::{BAND_EDGES_HZ, Evidence, Trial};
use super::fit::{Problem, group, inverse};
use super::input::Settings;
use super::library::Candidate;
use super::moments::Columns;
use super::outcome::{self, OpenKind, Verdict};
use super::rows::Rows;
use super::select::{MAX_RIVAL_SCORE_GAP, Search, Selected};
use super::unseen::columns_of;
use nalgebra::{DMatrix, DVector};
use plumbline_core::symmetric_eigen;
use plumbline_identify::{EstimateError, Experiment, Run, Scatter};
use plumbline_model::Structure;
use plumbline_model::term::effect::Spec;
use std::f64::consts::LN_2;
use std::ops::Range;

/// Rivals of one effect that are asked about.
const MAX_RIVALS: usize = 2;
/// Expected score difference of a decided pair: twice the largest one of rivals.
const DECIDED_SCORE_GAP: f64 = 2.0 * MAX_RIVAL_SCORE_GAP;
/// Smallest expected score difference that is not zero.
const MIN_SCORE_GAP: f64 = 1e-3;
/// Half width of a 95 % interval in standard deviations.
const INTERVAL_DEVIATIONS: f64 = 1.96;
/// Weight of what a motion answers beyond what was asked.
const BEYOND: f64 = 0.01;

/// A question that the recorded runs leave open.
#[derive(Clone, Debug)]
pub enum Question {
    /// Which of two effects acts.
    Rivals {
        /// The chosen one.
        effect: Spec,
        /// The other one.
        rival: Spec,
        /// Score of the chosen one less that of the other.
        gap: f64,
    },
    /// An interval of a parameter that is wider than wanted.
    Interval {
        /// The effect.
        effect: Spec,
        /// Name of its parameter.
        parameter: String,
        /// Half width of its 95 % interval.
        half_width: f64,
        /// Wanted half width.
        wanted: f64,
    },
    /// What stays unexplained or undetermined: it asks for a motion unlike the recorded ones.
    Parameters,
}

/// What a motion is expected to answer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Rivals: expected score difference, recorded and planned runs together. An interval: expected half width. The parameters: expected ratio of the
    /// parameters' standard deviations to those of the recorded runs, geometric mean.
    pub expected: f64,
    /// Share of what is asked for; 1 and more is an answer.
    pub share: f64,
}

/// Where the numbers of a question stand in the information matrix.
#[derive(Clone, Copy, Debug)]
enum Place {
    Rivals { effect: usize, rival: usize },
    Interval { column: usize },
    Parameters,
}

/// An effect with the parameters that it was fitted with, and its columns.
#[derive(Clone, Debug)]
struct Part {
    item: Candidate,
    parameters: Vec<f64>,
    /// Linear parameters, then settings.
    columns: Range<usize>,
}

/// Information about all columns, joint by joint and band by band, each with its rows; not divided by the scale of the noise.
#[derive(Clone, Debug)]
struct Information {
    groups: Vec<(DMatrix<f64>, f64)>,
}

impl Information {
    fn of(problem: &Problem, columns: &Columns) -> Information {
        let moments = columns.moments(problem.evidence);
        let groups = problem.evidence.joints() * BAND_EDGES_HZ.len();
        let mut groups = vec![(DMatrix::zeros(moments.width, moments.width), 0.0); groups];
        for (cell, own) in problem.evidence.cells().iter().zip(&moments.cells) {
            let (sum, rows) = &mut groups[group(cell.joint, cell.band)];
            *sum += &own.g;
            *rows += own.count as f64;
        }
        Information { groups }
    }

    fn with(mut self, other: &Information, scale: f64) -> Information {
        for ((sum, rows), (more, count)) in self.groups.iter_mut().zip(&other.groups) {
            sum.zip_apply(more, |sum, more| *sum += scale * more);
            *rows += count;
        }
        self
    }

    /// All of them, divided by the scale of each.
    fn total(&self, phi: &[f64]) -> DMatrix<f64> {
        let width = self.groups.first().map_or(0, |(sum, _)| sum.nrows());
        let mut total = DMatrix::zeros(width, width);
        for ((sum, _), phi) in self.groups.iter().zip(phi) {
            total.zip_apply(sum, |total, own| *total += own / phi);
        }
        total
    }
}

/// The open questions of a diagnosis, with what the recorded runs tell.
#[derive(Clone, Debug)]
pub struct OpenQuestions {
    questions: Vec<(Question, Place)>,
    structure: Structure,
    beta: Vec<f64>,
    /// Effects of the model, then rivals.
    parts: Vec<Part>,
    /// How many of them are in the model.
    modelled: usize,
    recorded: Information,
    phi: Vec<f64>,
    scatter: Option<Scatter>,
    /// Time between samples of the recorded runs \[s\].
    dt: f64,
    /// End of the recording on its clock \[s\].
    end: f64,
    band: f64,
}

impl Question {
    /// As it stands in files, before a motion is planned.
    pub fn facts(&self) -> outcome::Open {
        let (question, kind, now, wanted) = match self {
            Question::Rivals { effect, rival, gap } => {
                (format!("{effect}, or {rival}"), OpenKind::Rivals, *gap, DECIDED_SCORE_GAP)
            }
            Question::Interval { effect, parameter, half_width, wanted } => {
                (format!("{parameter} of {effect}"), OpenKind::Interval, *half_width, *wanted)
            }
            Question::Parameters => ("the parameters of the model".into(), OpenKind::Parameters, 1.0, 0.5),
        };
        outcome::Open { question, kind, now, wanted, expected: None }
    }
}

impl OpenQuestions {
    /// Those of a finished search. `trials` are the runs that it was made on.
    pub(super) fn of(
        search: &Search,
        structure: &Structure,
        selected: &Selected,
        verdict: Verdict,
        trials: &[Trial],
        settings: &Settings,
    ) -> OpenQuestions {
        let (state, evidence) = (&selected.state, search.problem.evidence);
        let mut parts: Vec<Part> = Vec::new();
        let mut next = state.base;
        let mut part = |item: &Candidate, parameters: &[f64]| {
            let columns = next..next + item.rows.width + item.spec.settings.len();
            next = columns.end;
            Part { item: item.clone(), parameters: parameters.to_vec(), columns }
        };
        for (index, item) in state.items.iter().enumerate() {
            parts.push(part(item, &state.fit.theta.as_slice()[state.range(index)]));
        }
        let modelled = parts.len();
        let mut asked = Vec::new();
        for (index, found) in selected.found.iter().enumerate() {
            // What came within the recording is over, or acts whatever is driven next.
            if !state.items[index].span.is_all() {
                continue;
            }
            for rival in found.rivals.iter().filter(|rival| rival.item.span.is_all()).take(MAX_RIVALS) {
                let with = state.without(&search.problem, index).with(&search.problem, rival.item.clone());
                let first = with.fit.theta.len() - rival.item.rows.width;
                parts.push(part(&rival.item, &with.fit.theta.as_slice()[first..]));
                let (effect, rival_spec) = (state.items[index].spec.clone(), rival.item.spec.clone());
                let question = Question::Rivals { effect, rival: rival_spec, gap: rival.gap };
                asked.push((question, Place::Rivals { effect: index, rival: parts.len() - 1 }));
            }
        }
        if matches!(verdict, Verdict::Partly | Verdict::Unexplained | Verdict::NotDetermined) {
            asked.push((Question::Parameters, Place::Parameters));
        }
        let mut columns = Columns {
            m: state.columns.m.iter().map(|m| m.columns(0, state.base).into_owned()).collect(),
            r: state.columns.r.clone(),
        };
        for part in &parts {
            columns.push(&part.item.rows);
            columns.push(&slopes(evidence, search.operating_point, &part.item, &part.parameters));
        }
        let phi = state.fit.weights.clone();
        let recorded = Information::of(&search.problem, &columns);
        let ends = trials.iter().map(Trial::end);
        let first = trials.first().map(|trial| trial.experiment);
        let mut open = OpenQuestions {
            questions: asked,
            structure: structure.clone(),
            beta: state.fit.theta.as_slice()[..state.base].to_vec(),
            parts,
            modelled,
            recorded,
            phi,
            scatter: first.and_then(|experiment| experiment.scatter.clone()).filter(|_| evidence.repeats()),
            dt: first.map_or(1e-3, |experiment| experiment.motion.dt),
            end: ends.fold(0.0, f64::max),
            band: settings.band,
        };
        if let Some(share) = settings.until {
            open.ask_for_intervals(share);
        }
        open
    }

    /// The questions, those of the strongest effect first; none where nothing is open.
    pub fn questions(&self) -> impl ExactSizeIterator<Item = &Question> {
        self.questions.iter().map(|(question, _)| question)
    }

    /// The questions as they stand in files, with what a motion is expected to answer.
    pub fn facts(&self, answers: &[Answer]) -> Vec<outcome::Open> {
        let of = |(question, answer): (&Question, &Answer)| outcome::Open {
            expected: Some(answer.expected),
            ..question.facts()
        };
        self.questions().zip(answers).map(of).collect()
    }

    /// What a motion would answer, question by question: one period in `run`, whose torques do not count, driven `periods` times.
    ///
    /// # Errors
    /// As [`Experiment::prepare`].
    pub fn answers(&self, run: &Run, periods: usize) -> Result<Vec<Answer>, EstimateError> {
        let (planned, passes) = self.planned(run, periods)?;
        let together = self.recorded.clone().with(&planned, passes);
        let total = together.total(&self.phi);
        Ok(self.questions.iter().map(|(question, place)| self.answer(question, *place, &together, &total)).collect())
    }

    /// One number for a motion that answers them: the shares of all, each up to 1, and a little for what is beyond.
    pub fn score(answers: &[Answer]) -> f64 {
        answers.iter().map(|answer| answer.share.min(1.0) + BEYOND * answer.share).sum()
    }

    /// A question for each number of an effect whose interval is wider than a share of its [size](sizes).
    fn ask_for_intervals(&mut self, share: f64) {
        let covariance = self.covariance(&self.recorded.total(&self.phi));
        for part in &self.parts[..self.modelled] {
            let Some(sizes) = sizes(&self.structure, &self.beta, part) else { continue };
            for (k, parameter, size) in sizes {
                let column = part.columns.start + k;
                let half_width = INTERVAL_DEVIATIONS * covariance[(column, column)].max(0.0).sqrt();
                let wanted = share * size;
                if half_width > wanted && wanted > 0.0 {
                    let effect = part.item.spec.clone();
                    let question = Question::Interval { effect, parameter, half_width, wanted };
                    self.questions.push((question, Place::Interval { column }));
                }
            }
        }
    }

    /// Columns of the model: base parameters and its effects, without rivals.
    fn of_model(&self) -> Vec<usize> {
        let end = self.parts[..self.modelled].last().map_or(self.beta.len(), |part| part.columns.end);
        (0..end).collect()
    }

    /// Covariance of the model's parameters, at their places.
    fn covariance(&self, information: &DMatrix<f64>) -> DMatrix<f64> {
        let own = self.of_model();
        inverse(&information.select_rows(&own).select_columns(&own))
    }

    fn answer(&self, question: &Question, place: Place, together: &Information, total: &DMatrix<f64>) -> Answer {
        match (question, place) {
            (_, Place::Rivals { effect, rival }) => {
                let [one, other] =
                    [(effect, rival), (rival, effect)].map(|(a, b)| self.distance(together, total, a, b));
                // Rounding is no answer.
                let expected = if one.min(other) > MIN_SCORE_GAP { one.min(other) } else { 0.0 };
                Answer { expected, share: expected / DECIDED_SCORE_GAP }
            }
            (Question::Interval { half_width, wanted, .. }, Place::Interval { column }) => {
                let expected = INTERVAL_DEVIATIONS * self.covariance(total)[(column, column)].max(0.0).sqrt();
                Answer { expected, share: (half_width / expected).ln() / (half_width / wanted).ln() }
            }
            _ => {
                let own = self.of_model();
                let of = |information: &DMatrix<f64>| log_det(&information.select_rows(&own).select_columns(&own));
                let halvings = 0.5 * (of(total) - of(&self.recorded.total(&self.phi))) / own.len() as f64;
                Answer { expected: (-halvings).exp(), share: halvings / LN_2 }
            }
        }
    }

    /// The score difference to expect if the part `a` is true and the part `b` is fitted in its place.
    fn distance(&self, information: &Information, total: &DMatrix<f64>, a: usize, b: usize) -> f64 {
        let Part { item, parameters, columns } = &self.parts[a];
        let own: Vec<usize> = columns.clone().take(item.rows.width).collect();
        let in_model = |part: &usize| *part < self.modelled;
        let others = (0..self.parts.len()).filter(|part| *part == b || (in_model(part) && *part != a));
        // A rival takes the place of the effect that it is compared with, and that one is `b` then.
        let mut fitted: Vec<usize> = (0..self.beta.len()).collect();
        fitted.extend(others.flat_map(|part| self.parts[part].columns.clone()));
        let theta = DVector::from_column_slice(parameters);
        let shared = (total.select_columns(&own) * &theta).select_rows(&fitted);
        let free = inverse(&total.select_rows(&fitted).select_columns(&fitted)) * shared;
        // The torque of `a` less what the others make of it, as parameters of all columns.
        let mut residual = DVector::zeros(total.nrows());
        fitted.iter().zip(&free).for_each(|(column, value)| residual[*column] = -value);
        own.iter().zip(&theta).for_each(|(column, value)| residual[*column] = *value);
        let gain = |((sum, rows), phi): (&(DMatrix<f64>, f64), &f64)| {
            let square = (sum * &residual).dot(&residual).max(0.0);
            if *rows > 0.0 { rows * (square / (phi * rows)).ln_1p() } else { 0.0 }
        };
        information.groups.iter().zip(&self.phi).map(gain).sum()
    }

    /// Information of a planned motion, and how often it counts.
    fn planned(&self, run: &Run, periods: usize) -> Result<(Information, f64), EstimateError> {
        let mut experiment = Experiment::prepare(run, &plumbline_identify::Settings::default())?;
        experiment.scatter =
            self.scatter.clone().map(|scatter| Scatter { periods, averaged: periods as f64, ..scatter });
        let trial = Trial { experiment: &experiment, session: 1, start: self.end };
        let trials = std::slice::from_ref(&trial);
        let evidence = Evidence::of(self.structure.chain(), trials, self.band);
        let operating_point = evidence.operating_point(&self.structure, &self.beta);
        let mut columns = columns_of(&evidence, &self.structure, trials);
        for Part { item, parameters, .. } in &self.parts {
            let moved = Candidate::of(&evidence, &operating_point, item.spec.clone(), item.span);
            columns.push(&moved.map_or(Rows::new(item.rows.width, Vec::new()), |moved| moved.rows));
            columns.push(&slopes(&evidence, &operating_point, item, parameters));
        }
        let problem = Problem { evidence: &evidence, prior: None };
        // Without repeats the weights hold for one pass of a coefficient at the recorded rate.
        let passes = if self.scatter.is_some() { 1.0 } else { periods as f64 * experiment.motion.dt / self.dt };
        Ok((Information::of(&problem, &columns), passes))
    }
}

/// The numbers of an effect that an interval is asked for: place among its columns, name, and the size that the interval is compared with. A setting's size
/// is its value. Linear parameters are those in the first one's unit, and their size is the norm of all of them: the sine of a ripple may be zero.
fn sizes(structure: &Structure, beta: &[f64], part: &Part) -> Option<Vec<(usize, String, f64)>> {
    let spec = &part.item.spec;
    let linear = spec.build(&structure.operating_point(beta)).ok()?.columns();
    let unit = linear.first()?.unit;
    let alike = |k: &usize| linear[*k].unit == unit;
    let size = (0..linear.len()).filter(alike).map(|k| part.parameters[k].powi(2)).sum::<f64>().sqrt();
    let settings = spec.form()?.settings.iter().zip(&spec.settings).enumerate();
    let settings = settings.map(|(k, (setting, value))| (linear.len() + k, setting.name.to_string(), value.abs()));
    let linear_sizes = (0..linear.len()).filter(alike).map(|k| (k, linear[k].name.clone(), size));
    Some(linear_sizes.chain(settings).collect())
}

/// `ln det` of an information matrix on the directions that it determines.
fn log_det(information: &DMatrix<f64>) -> f64 {
    let scale: Vec<f64> = information.diagonal().iter().map(|d| d.max(f64::MIN_POSITIVE).sqrt()).collect();
    let n = information.nrows();
    let scaled = DMatrix::from_fn(n, n, |i, k| information[(i, k)] / (scale[i] * scale[k]));
    let least = 1e-12 * n as f64;
    let eigenvalues = symmetric_eigen(scaled).map(|eigen| eigen.eigenvalues);
    let own = eigenvalues.map_or(0.0, |values| values.iter().map(|value| value.max(least).ln()).sum::<f64>());
    own + 2.0 * scale.iter().map(|scale| scale.ln()).sum::<f64>()
}
