//! The candidates: every family at every site, in every form, at every start value of its settings.

use super::evidence::Evidence;
use super::rows::Rows;
use super::span::Span;
use plumbline_core::parallel;
use plumbline_model::term::effect::{FAMILIES, Family, Form, OperatingPoint, Setting, Site, Spec, Stratum};
use plumbline_model::term::{Expected, Term, encoder_offset, friction_change, friction_drift};

/// Joints whose transmissions may be coupled without a declaration: those of one wrist.
const COUPLED_JOINTS_APART: usize = 2;

/// Largest ratio of the speeds of two joints' friction of one make.
const MAX_SPEED_RATIO: f64 = 4.0;

/// An effect that may be missing from the model.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// What it is.
    pub spec: Spec,
    /// Where in the recording it acts.
    pub span: Span,
    /// Its columns on the evidence.
    pub rows: Rows,
    /// Range of its parameters.
    expected: Expected,
}

/// Largest ratio of a parameter to the setting that its column was evaluated at, or its inverse; or to the largest expected.
const MAX_PARAMETER_RATIO: f64 = 2.0;
/// A parameter that is a setting, too, is at most this ratio of the setting's limits beyond them.
const BEYOND_LIMIT_RATIO: f64 = 1.1;

/// Plausibility of an effect's parameters, 0 to 1: 0 for a negative gap, less than 1 for a gap that differs from the setting that its column was evaluated
/// at, and for an encoder that is off by more than its column is good for.
fn plausibility(expected: Expected, settings: &[f64], parameters: &[f64]) -> f64 {
    match (expected, parameters, settings.first()) {
        (Expected::NotNegative, &[parameter], _) if parameter < 0.0 => 0.0,
        (Expected::NotPositive, &[parameter], _) if parameter > 0.0 => 0.0,
        (Expected::FirstSetting, &[parameter], Some(value)) => (parameter / value).min(value / parameter).max(0.0),
        (Expected::AtMost(most), _, _) => {
            let largest = parameters.iter().fold(0.0, |largest: f64, parameter| largest.max(parameter.abs()));
            (most / largest).min(1.0)
        }
        _ => 1.0,
    }
}

/// Whether these parameters of an effect are plausible enough for it to be selected.
pub fn allows(expected: Expected, settings: &[f64], parameters: &[f64]) -> bool {
    plausibility(expected, settings, parameters) * MAX_PARAMETER_RATIO >= 1.0
}

impl Candidate {
    /// Evaluates the columns; `None` when they can't be built or are zero in this data.
    pub fn of(evidence: &Evidence, operating_point: &OperatingPoint, spec: Spec, span: Span) -> Option<Candidate> {
        let term = spec.build(operating_point).ok()?;
        Candidate::with(evidence, &*term, evidence.columns(&*term, span), spec, span)
    }

    /// Approximate and faster for effects that are integrated in time; used to screen candidates.
    pub fn sketch(evidence: &Evidence, operating_point: &OperatingPoint, spec: Spec, span: Span) -> Option<Candidate> {
        let term = spec.build(operating_point).ok()?;
        Candidate::with(evidence, &*term, evidence.sketch(&*term, span), spec, span)
    }

    fn with(evidence: &Evidence, term: &dyn Term, rows: Rows, spec: Spec, span: Span) -> Option<Candidate> {
        let mut item = Candidate { spec, span, rows, expected: term.expects() };
        // A constant is known as it is.
        item.rows.exact = item.is_usual() && evidence.repeats();
        (item.rows.is_finite() && !item.rows.is_empty()).then_some(item)
    }

    /// The same effect in a part of the recording that consists of whole folds; `None` where its columns are zero there.
    pub fn in_folds(&self, evidence: &Evidence, span: Span) -> Option<Candidate> {
        let rows = self.rows.in_folds(evidence, span);
        (!rows.is_empty()).then(|| Candidate { rows, span, ..self.clone() })
    }

    /// [`plausibility`] of the parameters.
    pub fn plausibility(&self, parameters: &[f64]) -> f64 {
        plausibility(self.expected, &self.spec.settings, parameters)
    }

    /// Whether these parameters are plausible enough for the candidate to be selected. One that is the first setting, too, is within the setting's limits: past
    /// them the likelihood has no maximum in the range of the effect.
    pub fn allows(&self, parameters: &[f64]) -> bool {
        let setting = self.spec.form().and_then(|form| form.settings.first());
        let within = match (self.expected, parameters, setting) {
            (Expected::FirstSetting, &[parameter], Some(Setting { low, high, .. })) => {
                (low / BEYOND_LIMIT_RATIO..=BEYOND_LIMIT_RATIO * high).contains(&parameter)
            }
            _ => true,
        };
        within && allows(self.expected, &self.spec.settings, parameters)
    }

    /// Number of parameters: linear and nonlinear, the begin of a part among them.
    pub fn parameters(&self) -> usize {
        self.rows.width + self.spec.settings.len() + usize::from(!self.span.is_all())
    }

    /// Whether the likelihood may have several maxima over its settings: more than one of them has several start values.
    pub fn has_several_maxima(&self) -> bool {
        let form = self.spec.form();
        form.is_some_and(|form| form.settings.iter().filter(|setting| setting.steps > 1).count() > 1)
    }

    /// As it is reported: friction that changes by and by is a drift of friction.
    pub fn named(&self) -> Spec {
        match self.span.is_slow() {
            true => Spec {
                family: friction_drift::ID,
                form: "exponential",
                site: self.spec.site,
                settings: vec![self.span.rise],
            },
            false => self.spec.clone(),
        }
    }

    /// Joints whose torque it touches.
    pub fn joints(&self) -> Vec<usize> {
        self.rows.joints().collect()
    }

    /// Whether every arm has such an effect, all the time.
    pub fn is_usual(&self) -> bool {
        self.span.is_all() && self.spec.family().is_ok_and(|family| family.rare.in_every_arm)
    }

    /// Whether a little of it is a defect.
    pub fn is_defect(&self) -> bool {
        let of_every_arm = |family: &Family| family.rare.in_every_arm || family.rare.slight_in_every_arm;
        self.spec.family().is_ok_and(|family| !of_every_arm(family))
    }

    /// Whether it is the likelier of two that explain as much: a form of the same effect with fewer settings, or what every arm has where the other is rare.
    pub fn is_likelier(&self, other: &Candidate) -> bool {
        let fewer = self.spec.settings.len() < other.spec.settings.len();
        fewer && self.same_effect(other) || self.is_usual() && !other.is_usual()
    }

    /// Whether both are of one family and, where their laws have a speed, these are alike, as those of gears of one make are.
    pub fn is_kindred(&self, other: &Candidate) -> bool {
        let speed = |item: &Candidate| {
            let at = item.spec.form()?.settings.iter().position(Setting::is_speed)?;
            item.spec.settings.get(at).copied()
        };
        let apart = |(own, other): (f64, f64)| own.max(other) > MAX_SPEED_RATIO * own.min(other);
        self.spec.family == other.spec.family && !speed(self).zip(speed(other)).is_some_and(apart)
    }

    /// Whether both touch the torque of one joint.
    pub fn meets(&self, other: &Candidate) -> bool {
        let own = self.joints();
        other.rows.joints().any(|joint| own.contains(&joint))
    }

    /// Whether the other is the same effect but for its settings.
    pub fn alike(&self, other: &Candidate) -> bool {
        self.is_of(&other.spec, other.span)
    }

    /// Whether it is this effect but for its settings.
    pub fn is_of(&self, spec: &Spec, span: Span) -> bool {
        let key = |spec: &Spec| (spec.family, spec.form, spec.site);
        key(&self.spec) == key(spec) && self.span.begins_near(span)
    }

    /// Whether the other is of the same family, at the same place.
    pub fn same_effect(&self, other: &Candidate) -> bool {
        self.spec.is_same_effect(&other.spec) && self.span.begins_near(other.span)
    }
}

/// A sketch of every candidate that these families have, computed on `threads` threads; in the order of the families whatever their number.
pub fn library(
    evidence: &Evidence,
    operating_point: &OperatingPoint,
    families: &[&'static Family],
    span: Span,
    threads: usize,
) -> Vec<Candidate> {
    // A law of another joint's motion fits much that has no name, and unknown noise does not tell the two apart; one that takes torque of both joints fits
    // nothing else.
    let plausible = |family: &Family, form: &Form, site: Site| match site {
        Site::Pair { row, cause } if is_undeclared_coupling(family, site, operating_point) => {
            (evidence.repeats() || form.is_of_both_joints()) && are_near(row, cause)
        }
        Site::Joint(joint) if family.rare.with_rotor == Some(form.name) => operating_point.rotors[joint],
        _ => true,
    };
    let specs = specs(families, operating_point.chain.len(), plausible);
    parallel(&specs, threads, |spec| Candidate::sketch(evidence, operating_point, spec.clone(), span))
        .into_iter()
        .flatten()
        .collect()
}

/// Whether it couples two transmissions that the robot file does not declare as coupled.
pub(super) fn is_undeclared_coupling(family: &Family, site: Site, operating_point: &OperatingPoint) -> bool {
    match site {
        Site::Pair { row, cause } => family.rare.between_coupled && !operating_point.chain.are_coupled(row, cause),
        _ => false,
    }
}

/// Whether the transmissions of two joints may be coupled although nobody declares it.
fn are_near(one: usize, other: usize) -> bool {
    one.abs_diff(other) <= COUPLED_JOINTS_APART
}

/// Every form of families at every site of an arm that passes, at every start value of its settings. The zero of joint 1 is none: it turns the arm about its
/// first axis as a tilt of the base does, whose angle is known less well.
pub fn specs(families: &[&'static Family], joints: usize, passes: impl Fn(&Family, &Form, Site) -> bool) -> Vec<Spec> {
    let turns_base = |family: &Family, site: Site| family.id == encoder_offset::ID && site == Site::Joint(0);
    let mut specs = Vec::new();
    for family in families {
        for site in family.place.sites(joints).into_iter().filter(|site| !turns_base(family, *site)) {
            for form in family.forms.iter().filter(|form| passes(family, form, site)) {
                specs.extend(grid(family, form, site));
            }
        }
    }
    specs
}

/// Families whose effects may come within a recording.
pub fn sudden() -> Vec<&'static Family> {
    FAMILIES.iter().copied().filter(|family| family.rare.comes_at_once).collect()
}

/// Families whose effects may come by and by.
pub fn slow() -> Vec<&'static Family> {
    FAMILIES.iter().copied().filter(|family| family.id == friction_change::ID).collect()
}

/// Families whose effects every period repeats.
pub fn repeatable() -> Vec<&'static Family> {
    FAMILIES.iter().copied().filter(|family| family.stratum == Stratum::Repeatable).collect()
}

/// The start values of a form's settings, every combination.
fn grid(family: &'static Family, form: &'static Form, site: Site) -> Vec<Spec> {
    let mut settings: Vec<Vec<f64>> = vec![Vec::new()];
    for setting in form.settings {
        let grid = setting.grid();
        let longer = |before: &Vec<f64>| {
            let before = before.clone();
            grid.iter().map(move |value| before.iter().copied().chain([*value]).collect())
        };
        settings = settings.iter().flat_map(longer).collect();
    }
    settings.into_iter().map(|settings| Spec { family: family.id, form: form.name, site, settings }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_of_one_wrist_may_be_coupled_undeclared_and_no_others() {
        assert!(are_near(5, 4) && are_near(3, 5) && !are_near(5, 1) && !are_near(0, 3));
    }

    #[test]
    fn friction_of_another_speed_is_another() {
        let of = |family, form, settings: &[f64]| {
            let spec = Spec { family, form, site: Site::Joint(0), settings: settings.to_vec() };
            Candidate { spec, span: Span::ALL, rows: Rows::new(1, Vec::new()), expected: Expected::Any }
        };
        let stribeck = |form, speed| of("stribeck", form, &[speed]);
        let own = stribeck("gaussian", 0.1);
        assert!(own.is_kindred(&stribeck("exponential", 0.39)) && own.is_kindred(&stribeck("gaussian", 0.026)));
        assert!(!own.is_kindred(&stribeck("gaussian", 0.41)) && !own.is_kindred(&stribeck("exponential", 0.02)));
        assert!(!own.is_kindred(&of("coulomb-slope", "tanh", &[0.1])));
        assert!(of("presliding", "", &[1e-3]).is_kindred(&of("presliding", "", &[1e-4])), "a displacement is no speed");
        assert!(of("nonlinear-viscous", "cubic", &[]).is_kindred(&of("nonlinear-viscous", "sigmoid", &[0.2])));
    }

    #[test]
    fn a_parameter_has_to_be_what_the_effect_can_have() {
        let of = |expected| {
            let spec = Spec { family: "backlash", form: "", site: Site::Joint(0), settings: vec![1e-3] };
            Candidate { spec, span: Span::ALL, rows: Rows::new(1, Vec::new()), expected }
        };
        assert!(of(Expected::Any).allows(&[-1.0]));
        assert!(of(Expected::NotNegative).allows(&[1e-4]) && !of(Expected::NotNegative).allows(&[-1e-4]));
        assert!(of(Expected::NotPositive).allows(&[-1e-4]) && !of(Expected::NotPositive).allows(&[1e-4]));
        let swinging = of(Expected::FirstSetting);
        assert!(swinging.allows(&[0.6e-3]) && swinging.allows(&[1.9e-3]));
        assert!([0.4e-3, 2.1e-3, -1e-3, 0.0].iter().all(|gap| !swinging.allows(&[*gap])));
        let stiff = |c: f64| {
            let spec =
                Spec { family: "joint-elasticity", form: "swinging", site: Site::Joint(0), settings: vec![c, 2.5] };
            Candidate { spec, ..of(Expected::FirstSetting) }
        };
        // The limits are 1e-5 and 3.2e-2 rad/Nm.
        assert!(stiff(1e-5).allows(&[0.95e-5]) && !stiff(1e-5).allows(&[0.8e-5]));
        assert!(stiff(3.2e-2).allows(&[3.4e-2]) && !stiff(3.2e-2).allows(&[3.8e-2]));
        let encoder = of(Expected::AtMost(0.05));
        assert!(encoder.allows(&[-0.09]) && encoder.allows(&[0.0, 0.0]) && !encoder.allows(&[0.01, -0.11]));
        assert!(encoder.plausibility(&[0.04]) == 1.0 && encoder.plausibility(&[-0.1]) == 0.5);
        assert!((swinging.plausibility(&[0.5e-3]) - 0.5).abs() < 1e-12 && swinging.plausibility(&[1e-3]) == 1.0);
    }
}
