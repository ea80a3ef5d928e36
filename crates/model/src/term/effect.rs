//! Effects: terms that diagnosis can add to a model.
//!
//! A kind of effect is one file that declares a [`Family`] and builds its [`Term`], and one line of [`FAMILIES`].

pub use super::catalogue::{FAMILIES, family};
pub use super::family::{
    Confounded, Expressions, Family, Form, InBodies, InC, Inputs, Place, PlotOver, Rare, Scale, Setting, Site, Spec,
    Stratum, WholeArm,
};
pub use super::load::OperatingPoint;
pub use super::quantity::{Quantity, Results};

use super::Term;
use super::family::joint;
use super::subset::Subset;
use std::sync::Arc;

/// Why an effect can't be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EffectError {
    /// No such family.
    #[error("there is no effect `{id}`")]
    Family {
        /// Requested identity.
        id: String,
    },
    /// No such form.
    #[error("effect {family} has no form `{form}` (known: {known})")]
    Form {
        /// The family.
        family: &'static str,
        /// Requested form.
        form: String,
        /// Its forms.
        known: String,
    },
    /// A site of another kind, or a joint that the arm does not have.
    #[error("effect {family} can't be at {site}")]
    Site {
        /// The family.
        family: &'static str,
        /// Requested site.
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
    /// Another number of nonlinear parameters than the form has.
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

impl Spec {
    /// The family it is of.
    ///
    /// # Errors
    /// [`EffectError::Family`].
    pub fn family(&self) -> Result<&'static Family, EffectError> {
        family(self.family).ok_or_else(|| EffectError::Family { id: self.family.to_string() })
    }

    /// Its form; `None` where the family or the form is unknown.
    pub fn form(&self) -> Option<&'static Form> {
        self.family().ok()?.form(self.form)
    }

    /// Whether the other is the same effect at the same place, whatever form and settings it has.
    pub fn is_same_effect(&self, other: &Spec) -> bool {
        (self.family, self.site) == (other.family, other.site)
    }

    /// Whether it is a body on the last link.
    pub fn is_on_last_link(&self) -> bool {
        self.family().is_ok_and(|family| family.rare.in_bodies == InBodies::LastLink)
    }

    /// Builds the term.
    ///
    /// # Errors
    /// An unknown family, form or site, or a setting out of range.
    pub fn build(&self, operating_point: &OperatingPoint) -> Result<Arc<dyn Term>, EffectError> {
        let family = self.family()?;
        let form = family.form(self.form).ok_or_else(|| EffectError::Form {
            family: family.id,
            form: self.form.to_string(),
            known: family.forms.iter().map(|form| format!("`{}`", form.name)).collect::<Vec<_>>().join(", "),
        })?;
        if !family.sites(form, operating_point.chain.len()).contains(&self.site) {
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
        Ok((form.build)(operating_point, self.site, &self.settings))
    }
}

/// The terms of several effects. Effects with a term of the whole arm (`torque-offset`, `rotor-inertia`) are columns of that one term.
///
/// # Errors
/// As [`Spec::build`].
pub fn assemble(specs: &[Spec], operating_point: &OperatingPoint) -> Result<Vec<Arc<dyn Term>>, EffectError> {
    let mut terms = Vec::new();
    let mut whole: Vec<(&'static str, Arc<dyn Term>, Vec<usize>)> = Vec::new();
    for spec in specs {
        let term = spec.build(operating_point)?;
        let Some(whole_arm) = spec.family()?.rare.whole_arm else {
            terms.push(term);
            continue;
        };
        let joint = joint(spec.site) + 1;
        match whole.iter_mut().find(|(id, ..)| *id == spec.family) {
            Some((.., joints)) => joints.push(joint),
            None => whole.push((spec.family, whole_arm(&operating_point.chain), vec![joint])),
        }
    }
    let own = |(_, term, joints): (_, _, Vec<usize>)| Subset::of(term, |column| joints.contains(&column.joint));
    Ok(whole.into_iter().filter_map(own).chain(terms).collect())
}
