//! What has no name: a learned term for the residual of a joint that stays unexplained.
//!
//! It comes after everything else. The delivered model's parameters keep their values, the variables are those that the screening found
//! ([`crate::unexplained()`]), and only the coefficients of a spline are estimated ([`spline`]). It is delivered where runs that decide are predicted
//! better by the whole 95 % interval. The joint stays unexplained, and the verdict is what it was.

mod spline;
mod symbolic;

use super::curves::edges;
use super::delivery::Delivery;
use super::errors::Compared;
use super::evidence::{Evidence, Trial};
use super::fallback::{Course, MIN_DEPENDENT_R2, MIN_SECOND_VARIABLE_R2, Predictor, Residual, Signals};
use super::figures::{EffectFigure, MapFigure};
use super::outcome::{BeforeAfter, Empirical, Fitted, listed};
use super::unseen::Unseen;
use nalgebra::DVector;
use plumbline_identify::EstimateError;
use spline::{Spline, Variables};

/// Single variables, and pairs of them, that a spline is fitted over, the best of the screening first.
const MAX_TRIED: usize = 4;
/// Largest learned torque, as a ratio of the joint's highest torque.
const MAX_TORQUE_RATIO: f64 = 0.2;
/// Points of a drawn curve.
const CURVE_POINTS: usize = 121;
/// Values of each variable of a drawn map.
const MAP_POINTS: usize = 12;

/// What learned terms are fitted to.
pub struct Learning<'a> {
    /// The delivery of the named effects.
    pub delivery: &'a Delivery<'a>,
    /// The runs to identify from.
    pub evidence: &'a Evidence,
    /// The same runs.
    pub identified: &'a [Trial<'a>],
}

/// The model with learned terms, and what is said of them.
pub struct Learned {
    /// The delivered model.
    pub model: Fitted,
    /// The terms, delivered or not.
    pub terms: Vec<Empirical>,
    /// Curves over one variable.
    pub curves: Vec<EffectFigure>,
    /// Maps over two variables.
    pub maps: Vec<MapFigure>,
}

impl Learning<'_> {
    /// Learned terms for the joints that were screened, on top of the delivered model `named`.
    ///
    /// # Errors
    /// As [`plumbline_identify::solve::Equations::identify`].
    pub fn of(&self, named: &Fitted, screened: &[Residual]) -> Result<Learned, EstimateError> {
        let mut learned = Learned { model: named.clone(), terms: Vec::new(), curves: Vec::new(), maps: Vec::new() };
        let wanted = |one: &&Residual| one.best_servable() >= MIN_DEPENDENT_R2;
        let screened: Vec<&Residual> = screened.iter().filter(wanted).collect();
        if screened.is_empty() {
            return Ok(learned);
        }
        let unexplained = Unseen::of_model(self.evidence, named, self.identified);
        let beta = DVector::from_column_slice(&named.identification.beta);
        let courses = Course::all(self.evidence);
        for residual in screened {
            let rest = unexplained.residual(residual.joint, &beta);
            if let Some((variables, spline)) = self.best(residual, &courses, &rest) {
                self.take(&mut learned, residual.joint, &variables, spline, &rest)?;
            }
        }
        Ok(learned)
    }

    /// The variables whose spline predicts the residual of left-out trajectories or blocks best: one, or two where the second adds something.
    fn best<'c>(
        &self,
        residual: &Residual,
        courses: &'c [Course],
        rest: &DVector<f64>,
    ) -> Option<(Variables<'c>, Spline)> {
        let limit = self.limit(residual.joint);
        let best = |of: &[Predictor]| {
            let tried = of.iter().filter(|one| one.r2 >= MIN_DEPENDENT_R2);
            let servable = tried.filter_map(|one| Variables::of(&one.variables, courses)).take(MAX_TRIED);
            let fitted = servable.filter_map(|variables| {
                let spline = Spline::fit(self.evidence, residual.joint, &variables, rest, limit)?;
                Some((variables, spline))
            });
            fitted.max_by(|(_, a), (_, b)| a.share.total_cmp(&b.share))
        };
        let (single, pair) = (best(&residual.singles), best(&residual.pairs));
        let share = |of: &Option<(Variables, Spline)>| of.as_ref().map_or(f64::NEG_INFINITY, |(_, one)| one.share);
        let best = if share(&pair) > share(&single) + MIN_SECOND_VARIABLE_R2 { pair } else { single.or(pair) };
        best.filter(|(_, spline)| spline.share >= MIN_DEPENDENT_R2)
    }

    /// Adds the term to the model where nothing speaks against it, and to the list in any case.
    fn take(
        &self,
        learned: &mut Learned,
        joint: usize,
        variables: &Variables,
        spline: Spline,
        rest: &DVector<f64>,
    ) -> Result<(), EstimateError> {
        let Some(with) = self.extended(&learned.model, joint, variables, &spline)? else { return Ok(()) };
        let input = self.delivery.input;
        let decided = self.delivery.compared_with(&learned.model, &with, input.veto);
        let withheld = refusal(joint, &spline, decided.as_ref());
        let measured = self.delivery.compared_with(&learned.model, &with, input.measuring());
        let rms = |compared: Compared| {
            BeforeAfter::both([compared.before.validate_rms[joint], compared.after.validate_rms[joint]])
        };
        let symbolic = symbolic::proposed(self.evidence, joint, variables, rest, &spline);
        learned.terms.push(Empirical {
            joint: joint + 1,
            variables: variables.names(),
            share: Some(spline.share),
            rms: measured.map_or(BeforeAfter::default(), rms),
            cap: Some(spline.cap),
            in_model: withheld.is_none(),
            withheld,
            symbolic,
        });
        let title = format!("joint {}, empirical term", joint + 1);
        let signals = Signals::of(self.evidence, joint, rest);
        match variables {
            Variables::One(course) => learned.curves.push(curve(title, joint, course, &spline, &signals)),
            Variables::Two(first, second) => learned.maps.extend(map(title, first, second, &spline)),
        }
        if learned.terms.last().is_some_and(|term| term.in_model) {
            learned.model = with;
        }
        Ok(())
    }

    /// The model with the term: every other parameter keeps its value.
    fn extended(
        &self,
        model: &Fitted,
        joint: usize,
        variables: &Variables,
        spline: &Spline,
    ) -> Result<Option<Fitted>, EstimateError> {
        let Fitted { structure, identification } = model;
        let term = variables.spec(joint).build(&structure.operating_point(&identification.beta)).ok();
        let Some(structure) = term.and_then(|term| structure.clone().with(vec![term]).ok()) else { return Ok(None) };
        let Spline { coefficients, covariance, freedom, .. } = spline;
        let experiments = self.delivery.equations.experiments();
        let identification =
            identification.extended(&structure, experiments, coefficients.as_slice(), covariance, *freedom)?;
        Ok(Some(Fitted { structure, identification }))
    }

    /// Largest torque that a learned term may have \[Nm\]: a share of the joint's highest torque, or of the highest recorded one where that is
    /// not known.
    fn limit(&self, joint: usize) -> f64 {
        let known = self.delivery.settings.torque_limits.get(joint).copied().filter(|limit| *limit > 0.0);
        let recorded = || self.identified.iter().map(|trial| trial.experiment.tau.column(joint).amax());
        MAX_TORQUE_RATIO * known.unwrap_or_else(|| recorded().fold(0.0, f64::max))
    }
}

/// Why a term is not delivered: runs that decide are not predicted better by the whole interval; without any, left-out blocks are not.
fn refusal(joint: usize, spline: &Spline, decided: Option<&Compared>) -> Option<String> {
    match decided {
        Some(Compared { change, .. }) => {
            let (change, [low, high]) = (change.validate_rms[joint], change.intervals[joint]);
            let words = || format!("unseen runs are predicted no better: {change:+.4} [{low:.4}, {high:.4}] Nm");
            (high >= 0.0).then(words)
        }
        None => (spline.surely <= 0.0).then(|| "what was left out of its fit is not surely predicted better".into()),
    }
}

fn curve(title: String, joint: usize, course: &Course, spline: &Spline, signals: &Signals) -> EffectFigure {
    let bins = signals.dependence(course);
    let (low, high) = course.range;
    let point = |k: usize| low + (high - low) * k as f64 / (CURVE_POINTS - 1) as f64;
    let (fitted, deviation) = (0..CURVE_POINTS)
        .map(|k| {
            let [torque, deviation] = spline.at(&course.axis().fine(point(k)));
            ((point(k), torque), deviation)
        })
        .unzip();
    EffectFigure {
        title,
        variable: format!("{} / {}", course.variable, course.variable.unit()),
        joint: joint + 1,
        x: bins.iter().map(|bin| bin.at).collect(),
        mean: bins.iter().map(|bin| bin.mean).collect(),
        deviation: bins.iter().map(|bin| bin.error).collect(),
        fitted,
        fitted_deviation: deviation,
    }
}

fn map(title: String, first: &Course, second: &Course, spline: &Spline) -> Option<MapFigure> {
    let middles = |course: &Course| -> Vec<f64> {
        let (low, high) = course.range;
        (0..MAP_POINTS).map(|k| low + (high - low) * (k as f64 + 0.5) / MAP_POINTS as f64).collect()
    };
    let (x, y) = (middles(first), middles(second));
    let torque = |x: f64, y: f64| spline.at(&spline::product(first.axis().coarse(x), second.axis().coarse(y)))[0];
    let name = |course: &Course| format!("{} / {}", course.variable, course.variable.unit());
    Some(MapFigure {
        title,
        x_name: name(first),
        y_name: name(second),
        x: edges(&x)?,
        y: edges(&y)?,
        mean: y.iter().map(|&y| x.iter().map(|&x| torque(x, y)).collect()).collect(),
    })
}

impl Empirical {
    /// `an empirical term on q4`.
    pub fn name(&self) -> String {
        format!("an empirical term on {}", listed(self.variables.iter().cloned()))
    }
}
