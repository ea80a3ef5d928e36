//! Effects: terms that diagnosis can add to a model, and what it has to know about each kind of them.
//!
//! A kind of effect is one file beside this one that gives a [`Family`] and a [`Term`]; [`FAMILIES`] lists them all.

use super::load::Load;
use super::{Subset, Term};
use super::{
    asymmetric_coulomb, asymmetric_viscous, backlash, base_motion, contact, delay, encoder_eccentricity,
    encoder_offset, friction_change, friction_drift, joint_elasticity, load_dependent_friction, mounting,
    nonlinear_viscous, offset_drift, payload, position_dependent_friction, position_ripple, presliding, rotor_inertia,
    spring, stribeck, torque_crosstalk, torque_gain, torque_offset, transmission_coupling,
};
use crate::chain::Chain;
use std::fmt;
use std::sync::Arc;

/// Where in the arm an effect sits. Joints count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Site {
    /// The arm as a whole.
    Arm,
    /// One joint.
    Joint(usize),
    /// What one joint does to the torque of another.
    Pair {
        /// The joint whose torque it is.
        row: usize,
        /// The joint that it comes from.
        cause: usize,
    },
}

impl Site {
    /// Joints that it names: none, one, or the row and its cause.
    pub fn joints(self) -> Vec<usize> {
        match self {
            Site::Arm => Vec::new(),
            Site::Joint(joint) => vec![joint],
            Site::Pair { row, cause } => vec![row, cause],
        }
    }

    /// End of a column's name, joints from 1: `4`, `5_6`, nothing for the whole arm.
    pub fn suffix(self) -> String {
        self.joints().iter().map(|joint| (joint + 1).to_string()).collect::<Vec<_>>().join("_")
    }
}

impl fmt::Display for Site {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Site::Arm => f.write_str("the arm"),
            Site::Joint(joint) => write!(f, "joint {}", joint + 1),
            Site::Pair { row, cause } => write!(f, "joint {} from joint {}", row + 1, cause + 1),
        }
    }
}

/// What kind of [`Site`] a family needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// [`Site::Arm`].
    Arm,
    /// [`Site::Joint`].
    Joint,
    /// [`Site::Pair`], two different joints.
    Pair,
}

impl Place {
    /// Every such site of an arm with `n` joints.
    pub fn sites(self, n: usize) -> Vec<Site> {
        let pair = |row| (0..n).filter(move |&cause| cause != row).map(move |cause| Site::Pair { row, cause });
        match self {
            Place::Arm => vec![Site::Arm],
            Place::Joint => (0..n).map(Site::Joint).collect(),
            Place::Pair => (0..n).flat_map(pair).collect(),
        }
    }
}

/// How the values of a nonlinear parameter are spread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// Evenly.
    Linear,
    /// Evenly in the logarithm.
    Logarithmic,
}

/// A nonlinear parameter of an effect: its columns depend on it, and it is searched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Name in files: `delta`.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// What it is.
    pub what: &'static str,
    /// Least value that makes sense.
    pub low: f64,
    /// Largest value that makes sense.
    pub high: f64,
    /// Values that a search starts from; 0 where it starts from the parameter that another form of the family has found.
    pub steps: usize,
    /// How they are spread.
    pub scale: Scale,
}

impl Setting {
    /// Position between `low` (0) and `high` (1) as a value.
    pub fn at(&self, share: f64) -> f64 {
        match self.scale {
            Scale::Linear => self.low + share * (self.high - self.low),
            Scale::Logarithmic => self.low * (self.high / self.low).powf(share),
        }
    }

    /// Inverse of [`Setting::at`].
    pub fn share(&self, value: f64) -> f64 {
        match self.scale {
            Scale::Linear => (value - self.low) / (self.high - self.low),
            Scale::Logarithmic => (value / self.low).ln() / (self.high / self.low).ln(),
        }
    }

    /// The values that a search starts from.
    pub fn grid(&self) -> Vec<f64> {
        (0..self.steps).map(|step| self.at(step as f64 * self.spacing())).collect()
    }

    /// Distance between two of them, as a share of the range: a search looks as far to either side.
    pub fn spacing(&self) -> f64 {
        if self.steps == 0 { 0.5 } else { 1.0 / (self.steps.max(2) - 1) as f64 }
    }
}

/// Where in the data an effect shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stratum {
    /// In what every period repeats.
    Repeatable,
    /// In what differs from period to period.
    Changing,
    /// Between sessions, or against a model identified before: within one session the base parameters absorb it.
    Reference,
}

/// One way to write an effect down.
pub struct Form {
    /// Name in files; empty where the family has one form.
    pub name: &'static str,
    /// The columns and what they depend on: `tau_j = k (q_j - q0)`.
    pub equation: &'static str,
    /// Its nonlinear parameters.
    pub settings: &'static [Setting],
    /// Puts it together. The site is of the family's place and in the arm, the settings are as many as listed and in their ranges.
    pub build: fn(&Ground, Site, &[f64]) -> Arc<dyn Term>,
}

impl Form {
    /// Whether it starts where another form of the family ends, with that one's only parameter as the first of its settings and that one's settings
    /// behind.
    pub fn grown(&self) -> bool {
        self.settings.first().is_some_and(|setting| setting.steps == 0)
    }
}

/// What looks alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Confounded {
    /// Identity of the other family, or a base parameter.
    pub with: &'static str,
    /// The experiment that tells the two apart.
    pub decided_by: &'static str,
}

/// A kind of effect.
pub struct Family {
    /// Stable identity.
    pub id: &'static str,
    /// What happens, in one sentence.
    pub physics: &'static str,
    /// Kind of its site.
    pub place: Place,
    /// The ways to write it down; one of them is taken.
    pub forms: &'static [Form],
    /// Where it shows.
    pub stratum: Stratum,
    /// Whether the loop serves it. What depends on when something happened does not come again: it explains a recording, and its
    /// [`FixedTerm`](super::FixedTerm) adds nothing.
    pub served: bool,
    /// Sizes met on real arms.
    pub typical: &'static str,
    /// What looks alike, and what decides.
    pub confounded: &'static [Confounded],
    /// Where it is described.
    pub reference: &'static str,
}

/// What effects are built upon.
pub struct Ground {
    /// The arm.
    pub chain: Chain,
    /// Its rigid bodies, as far as they are known.
    pub load: Arc<Load>,
    /// `[fv, fc]` of each joint, as far as they are known: \[Nms/rad\], \[Nm\]. Empty where the model has no friction.
    pub friction: Vec<[f64; 2]>,
}

/// One effect in all detail but its linear parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Spec {
    /// Identity of the family.
    pub family: &'static str,
    /// Name of the form.
    pub form: &'static str,
    /// Where it sits.
    pub site: Site,
    /// Nonlinear parameters, in the form's order.
    pub settings: Vec<f64>,
}

/// Why an effect can't be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EffectError {
    /// No such family.
    #[error("there is no effect `{id}`")]
    Family {
        /// The identity asked for.
        id: String,
    },
    /// No such form.
    #[error("effect {family} has no form `{form}` (known: {known})")]
    Form {
        /// The family.
        family: &'static str,
        /// The form asked for.
        form: String,
        /// Its forms.
        known: String,
    },
    /// Another kind of site, or a joint that is not there.
    #[error("effect {family} can't be at {site}")]
    Site {
        /// The family.
        family: &'static str,
        /// The site asked for.
        site: Site,
    },
    /// A nonlinear parameter that is out of range.
    #[error("{setting} of effect {family} is {value}: expected {low} to {high}")]
    Setting {
        /// The family.
        family: &'static str,
        /// The parameter.
        setting: &'static str,
        /// The value given.
        value: f64,
        /// Least value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// Not as many nonlinear parameters as the form has.
    #[error("effect {family} has {expected} settings, {found} were given")]
    Count {
        /// The family.
        family: &'static str,
        /// How many it has.
        expected: usize,
        /// How many were given.
        found: usize,
    },
}

/// Every kind of effect, in the order of the catalogue.
pub static FAMILIES: &[&Family] = &[
    &torque_offset::FAMILY,
    &torque_gain::FAMILY,
    &asymmetric_coulomb::FAMILY,
    &asymmetric_viscous::FAMILY,
    &stribeck::FAMILY,
    &nonlinear_viscous::FAMILY,
    &load_dependent_friction::FAMILY,
    &friction_drift::FAMILY,
    &offset_drift::FAMILY,
    &presliding::FAMILY,
    &rotor_inertia::FAMILY,
    &joint_elasticity::FAMILY,
    &position_ripple::FAMILY,
    &position_dependent_friction::FAMILY,
    &spring::FAMILY,
    &payload::FAMILY,
    &friction_change::FAMILY,
    &mounting::FAMILY,
    &base_motion::FAMILY,
    &torque_crosstalk::FAMILY,
    &transmission_coupling::FAMILY,
    &delay::FAMILY,
    &contact::FAMILY,
    &encoder_offset::FAMILY,
    &encoder_eccentricity::FAMILY,
    &backlash::FAMILY,
];

/// The family of that identity.
pub fn family(id: &str) -> Option<&'static Family> {
    FAMILIES.iter().copied().find(|family| family.id == id)
}

impl Family {
    /// Its form of that name.
    pub fn form(&self, name: &str) -> Option<&'static Form> {
        self.forms.iter().find(|form| form.name == name)
    }
}

impl Spec {
    /// The family it is of.
    ///
    /// # Errors
    /// [`EffectError::Family`].
    pub fn family(&self) -> Result<&'static Family, EffectError> {
        family(self.family).ok_or_else(|| EffectError::Family { id: self.family.to_string() })
    }

    /// Puts the term together.
    ///
    /// # Errors
    /// A family, form, site or setting that does not exist or is out of range.
    pub fn build(&self, ground: &Ground) -> Result<Arc<dyn Term>, EffectError> {
        let family = self.family()?;
        let form = family.form(self.form).ok_or_else(|| EffectError::Form {
            family: family.id,
            form: self.form.to_string(),
            known: family.forms.iter().map(|form| format!("`{}`", form.name)).collect::<Vec<_>>().join(", "),
        })?;
        if !family.place.sites(ground.chain.len()).contains(&self.site) {
            return Err(EffectError::Site { family: family.id, site: self.site });
        }
        if self.settings.len() != form.settings.len() {
            let (expected, found) = (form.settings.len(), self.settings.len());
            return Err(EffectError::Count { family: family.id, expected, found });
        }
        for (setting, &value) in form.settings.iter().zip(&self.settings) {
            let (low, high) = (setting.low, setting.high);
            if !(low..=high).contains(&value) {
                return Err(EffectError::Setting { family: family.id, setting: setting.name, value, low, high });
            }
        }
        Ok((form.build)(ground, self.site, &self.settings))
    }
}

/// The terms of several effects; what a term of the whole arm has columns for (`torque-offset`, `rotor-inertia`) is one term.
///
/// # Errors
/// As [`Spec::build`].
pub fn assemble(specs: &[Spec], ground: &Ground) -> Result<Vec<Arc<dyn Term>>, EffectError> {
    let mut terms = Vec::new();
    let mut whole: Vec<(&'static str, Vec<usize>)> = Vec::new();
    for spec in specs {
        let term = spec.build(ground)?;
        if term.spec().is_some() {
            terms.push(term);
            continue;
        }
        let joints = whole.iter_mut().find(|(id, _)| *id == spec.family);
        match joints {
            Some((_, joints)) => joints.push(joint(spec.site) + 1),
            None => whole.push((spec.family, vec![joint(spec.site) + 1])),
        }
    }
    let own = |(id, joints): &(&'static str, Vec<usize>)| {
        let term: Arc<dyn Term> = match *id {
            torque_offset::ID => Arc::new(torque_offset::TorqueOffset::new(&ground.chain)),
            _ => Arc::new(rotor_inertia::RotorInertia::new(&ground.chain)),
        };
        Subset::of(term, |column| joints.contains(&column.joint))
    };
    Ok(whole.iter().filter_map(own).chain(terms).collect())
}

/// The joint of a site that is one; families whose place is [`Place::Joint`] get no other.
pub(super) fn joint(site: Site) -> usize {
    match site {
        Site::Joint(joint) => joint,
        Site::Pair { row, .. } => row,
        Site::Arm => 0,
    }
}

/// One joint's column of a term that has one per joint.
pub(super) fn of_joint(term: Arc<dyn Term>, site: Site) -> Arc<dyn Term> {
    let joint = joint(site) + 1;
    let own = Subset::of(Arc::clone(&term), |column| column.joint == joint);
    own.unwrap_or(term)
}
