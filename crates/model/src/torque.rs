//! A torque model: a structure with parameter values, and its evaluation at 1 kHz.

use super::base::{BaseKind, Reduction};
use super::chain::Chain;
use super::fast::closed::ClosedForm;
use super::gravity::{Mounting, VERTICAL_TOLERANCE};
pub use super::parameter::Parameter;
use super::rnea::LinkParameters;
use super::structure::{ModelError, Structure};
use super::term::effect::{self, Place, Setting, Site, Spec};
use super::term::subset::Subset;
use super::term::{self, Column, FixedTerm, Motion, Sample, Term, payload, rigid_body, rotor_inertia};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{JointVec, Torque};
use std::ops::Range;
use std::sync::Arc;

/// A parameter of a model file: name of the column, value, standard deviation where known.
pub type NamedValue = (String, f64, Option<f64>);

/// A term of a model file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NamedTerm {
    /// Its identity.
    pub id: String,
    /// Form, site and settings of an effect; default for a term of the whole arm.
    pub effect: NamedEffect,
    /// Its parameters, in any order.
    pub parameters: Vec<NamedValue>,
}

/// [`Spec`] of a model file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NamedEffect {
    /// Form, where its family has several.
    pub form: String,
    /// Joint that it acts on, counted from 1.
    pub joint: Option<usize>,
    /// Joint that causes it, counted from 1.
    pub cause: Option<usize>,
    /// Second joint that causes it, counted from 1.
    pub other: Option<usize>,
    /// Nonlinear parameters by name, in any order.
    pub settings: Vec<(String, f64)>,
}

/// A VBS model is invalid in the requested mounting.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the {kind} model of {robot} is valid only with gravity along axis 1 (upright or hanging), not in the mounting {mounting}: \
     it was identified {identified} and lacks {}", missing.join(" and ")
)]
pub struct MountingRefused {
    /// Robot of the model.
    pub robot: String,
    /// Its kind, VBS.
    pub kind: BaseKind,
    /// Mountings of the identification.
    pub identified: String,
    /// Requested mounting.
    pub mounting: Mounting,
    /// Symbols of the parameters that the model lacks for the mounting.
    pub missing: Vec<String>,
}

/// An identified model of an arm's torques, `tau = Y beta`.
#[derive(Clone, Debug)]
pub struct TorqueModel {
    robot: String,
    structure: Structure,
    mountings: Vec<Mounting>,
    parameters: Vec<Parameter>,
}

impl TorqueModel {
    /// A model from one value per column of `structure`, with its standard deviation where known.
    ///
    /// `mountings` are those of the identification.
    pub fn new(
        robot: impl Into<String>,
        structure: Structure,
        mountings: Vec<Mounting>,
        values: &[(f64, Option<f64>)],
    ) -> Result<TorqueModel, ModelError> {
        let expected = structure.columns().len();
        if values.len() != expected {
            return Err(ModelError::Count { found: values.len(), expected });
        }
        let mut parameters = Vec::with_capacity(expected);
        for (column, &(value, std)) in structure.columns().iter().zip(values) {
            for number in [Some(value), std].into_iter().flatten() {
                if !number.is_finite() {
                    return Err(ModelError::NotFinite { name: column.name.clone(), value: number });
                }
            }
            parameters.push(Parameter { column: column.clone(), value, std });
        }
        Ok(TorqueModel { robot: robot.into(), structure, mountings, parameters })
    }

    /// A model from the contents of a model file: identity and parameters of each term.
    ///
    /// The rigid body has to be complete. Missing columns of other terms are zero; unknown columns are errors. The operating point of
    /// effects is this model's rigid body and friction.
    pub fn from_named(
        robot: impl Into<String>,
        chain: Chain,
        kind: BaseKind,
        mountings: Vec<Mounting>,
        terms: &[NamedTerm],
    ) -> Result<TorqueModel, ModelError> {
        let reduction = Reduction::of_kind(&chain, kind);
        if reduction.kind() != kind {
            return Err(ModelError::Kind { expected: kind, found: reduction.kind() });
        }
        let known = |named: &&NamedTerm| term::KNOWN.contains(&named.id.as_str());
        let (arm, effects): (Vec<&NamedTerm>, Vec<&NamedTerm>) = terms.iter().partition(known);
        let ids: Vec<&str> = arm.iter().map(|named| named.id.as_str()).collect();
        let full = Structure::of(chain, reduction, &ids)?;
        let rigid = arm.iter().find(|named| named.id == rigid_body::ID);
        for column in &full.columns()[..full.reduction().len()] {
            if !rigid.is_some_and(|named| named.parameters.iter().any(|own| own.0 == column.name)) {
                return Err(ModelError::MissingColumn { name: column.name.clone() });
            }
        }
        for named in &arm {
            let term = full.terms().iter().find(|term| term.id() == named.id);
            check_names(named, &term.map_or(Vec::new(), |term| term.columns()))?;
        }
        let all: Vec<&NamedValue> = terms.iter().flat_map(|named| &named.parameters).collect();
        let mut structure = full.restricted(|column| all.iter().any(|(name, _, _)| *name == column.name));
        let value = |column: &Column| all.iter().find(|named| named.0 == column.name).map(|named| (named.1, named.2));
        let beta: Vec<f64> =
            structure.columns().iter().map(|column| value(column).map_or(0.0, |(value, _)| value)).collect();
        let operating_point = structure.operating_point(&beta);
        let mut built = Vec::new();
        for named in effects {
            let term = named.spec()?.build(&operating_point)?;
            check_names(named, &term.columns())?;
            built.extend(Subset::of(term, |column| named.parameters.iter().any(|(name, _, _)| *name == column.name)));
        }
        structure = structure.with(built)?;
        let missing = |column: &Column| ModelError::MissingColumn { name: column.name.clone() };
        let values = structure.columns().iter().map(|column| value(column).ok_or_else(|| missing(column)));
        let values = values.collect::<Result<Vec<_>, _>>()?;
        TorqueModel::new(robot, structure, mountings, &values)
    }

    /// Name of the robot.
    pub fn robot(&self) -> &str {
        &self.robot
    }

    /// GBS or VBS.
    pub fn kind(&self) -> BaseKind {
        self.structure.kind()
    }

    /// Its structure.
    pub fn structure(&self) -> &Structure {
        &self.structure
    }

    /// The mountings it was identified in.
    pub fn mountings(&self) -> &[Mounting] {
        &self.mountings
    }

    /// All parameters, in the order of the structure's columns.
    pub fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    /// Each term with its parameters, the rigid body first.
    pub fn terms(&self) -> Vec<(&dyn Term, &[Parameter])> {
        let ranges = self.structure.ranges();
        self.structure
            .terms()
            .iter()
            .map(|term| &**term)
            .zip(ranges.into_iter().map(|range| &self.parameters[range]))
            .collect()
    }

    /// Parameters of the bodies that effects put on the last link, about that link's frame; zero where there are none.
    pub fn on_last_link(&self) -> LinkParameters {
        let mut sum = LinkParameters::default();
        for (term, parameters) in self.terms() {
            if !term.spec().is_some_and(|spec| spec.is_on_last_link()) {
                continue;
            }
            for parameter in parameters {
                if let Some(slot) = payload::slot(&parameter.column.name) {
                    sum[slot] += parameter.value;
                }
            }
        }
        sum
    }

    /// The model of some of its terms, with the same parameters. The rigid body is always one of them.
    ///
    /// # Errors
    /// As [`Structure::new`].
    pub fn part(&self, keep: impl Fn(&dyn Term) -> bool) -> Result<TorqueModel, ModelError> {
        let of = &self.structure;
        let kept = self.terms().into_iter().skip(1).zip(&of.terms()[1..]).filter(|((term, _), _)| keep(*term));
        let (parameters, terms): (Vec<&[Parameter]>, Vec<_>) =
            kept.map(|((_, parameters), term)| (parameters, Arc::clone(term))).unzip();
        let structure = Structure::new(of.chain().clone(), of.reduction().clone(), terms)?;
        let rigid = &self.parameters[..of.reduction().len()];
        let all = rigid.iter().chain(parameters.into_iter().flatten());
        let values: Vec<_> = all.map(|parameter| (parameter.value, parameter.std)).collect();
        TorqueModel::new(self.robot.clone(), structure, self.mountings.clone(), &values)
    }

    /// The part with inertia: rigid links, bodies on the last link and rotors, with the same parameters.
    ///
    /// # Errors
    /// As [`Structure::new`].
    pub fn inertial(&self) -> Result<TorqueModel, ModelError> {
        let on_last_link = |term: &dyn Term| term.spec().is_some_and(|spec| spec.is_on_last_link());
        self.part(|term| term.id() == rotor_inertia::ID || on_last_link(term))
    }

    /// `beta`.
    pub fn beta(&self) -> Vec<f64> {
        self.parameters.iter().map(|parameter| parameter.value).collect()
    }

    /// Whether the model has every parameter for a mounting: a GBS always, a VBS only with gravity along axis 1.
    pub fn holds_in(&self, mounting: &Mounting) -> bool {
        self.kind() == BaseKind::Gbs || mounting.is_along_axis_1(VERTICAL_TOLERANCE)
    }

    /// As [`TorqueModel::holds_in`]. Takes milliseconds where the model is not valid.
    ///
    /// # Errors
    /// The parameters that the model lacks for the mounting.
    pub fn valid_in(&self, mounting: &Mounting) -> Result<(), MountingRefused> {
        if self.holds_in(mounting) {
            return Ok(());
        }
        let own = self.structure.reduction().independent();
        let generalized = Reduction::any_mounting(self.structure.chain());
        let missing = generalized.independent().iter().filter(|slot| !own.contains(slot));
        let identified: Vec<String> = self.mountings.iter().map(|mounting| mounting.to_string()).collect();
        Err(MountingRefused {
            robot: self.robot.clone(),
            kind: self.kind(),
            identified: if identified.is_empty() { "in no stated mounting".into() } else { identified.join(", ") },
            mounting: *mounting,
            missing: missing.map(|&slot| super::expression::symbol(slot)).collect(),
        })
    }

    /// The model with precomputed parameters for one gravity vector in the base frame \[m/s2\]. Does not check
    /// [`TorqueModel::valid_in`].
    pub fn evaluator(&self, gravity: &Vector3<f64>) -> Evaluator {
        let beta = self.beta();
        let fixed =
            |(term, range): (&Arc<dyn Term>, Range<usize>)| term.fix(self.structure.chain(), gravity, &beta[range]);
        let mut closed = ClosedForm::default();
        let terms = self.structure.terms().iter().zip(self.structure.ranges()).map(fixed);
        Evaluator { terms: terms.filter(|term| !term.join(&mut closed)).collect(), closed }
    }

    /// Torques along a motion, N x n \[Nm\], sample after sample with [`Evaluator::torque`].
    pub fn predict(&self, motion: &Motion) -> DMatrix<f64> {
        let n = motion.joints();
        let mut evaluator = self.evaluator(&motion.gravity);
        evaluator.every(motion.dt);
        let mut tau = DMatrix::zeros(motion.samples(), n);
        if motion.periodic && evaluator.may_remember() {
            // The state at the end of the period before.
            for k in 0..motion.samples() {
                evaluator.torque(&motion.sample(k));
            }
        }
        for k in 0..motion.samples() {
            let Torque(now) = evaluator.torque(&motion.sample(k));
            for j in 0..n {
                tau[(k, j)] = now[j];
            }
        }
        tau
    }
}

/// A model ready for the loop: its torque neither allocates nor panics.
pub struct Evaluator {
    closed: ClosedForm,
    /// Terms without a closed form.
    terms: Vec<Box<dyn FixedTerm>>,
}

impl Evaluator {
    /// Whether the torque may depend on the samples before: only terms without a closed form can.
    fn may_remember(&self) -> bool {
        !self.terms.is_empty()
    }

    /// Puts the model under another `gravity` in the base frame \[m/s2\]; `false`, and nothing is changed, where it has terms without a
    /// closed form: they are computed for one gravity in advance. Neither allocates nor panics.
    pub fn set_gravity(&mut self, gravity: &Vector3<f64>) -> bool {
        if self.terms.is_empty() {
            self.closed.set_gravity(gravity);
        }
        self.terms.is_empty()
    }

    /// Sets the sample period \[s\]; 1 ms before the first call.
    pub fn every(&mut self, dt: f64) {
        self.terms.iter_mut().for_each(|term| term.every(dt));
    }

    /// Torque that the arm needs at `sample`: Newton-Euler with the regrouped parameters in their slots, plus the other terms \[Nm\].
    pub fn torque(&mut self, sample: &Sample) -> Torque {
        let mut tau = self.closed.torque(sample);
        for term in &mut self.terms {
            term.torque(sample, &mut tau);
        }
        Torque(tau)
    }

    /// Torque of the terms with a closed form at rest at `q`: rigid body and sensor offsets \[Nm\]. Terms with a memory are not evaluated.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn rest(&mut self, q: &JointVec) -> Torque {
        Torque(self.closed.torque(&Sample { q: *q, ..Sample::default() }))
    }
}

impl NamedTerm {
    /// The effect that it describes.
    fn spec(&self) -> Result<Spec, ModelError> {
        let unknown = || ModelError::UnknownTerm { id: self.id.clone() };
        let family = effect::family(&self.id).ok_or_else(unknown)?;
        let NamedEffect { form: name, joint, cause, other, settings } = &self.effect;
        let foreign = |what: String| ModelError::Effect { term: self.id.clone(), what };
        let form = family.form(name).ok_or_else(|| foreign(format!("no form `{name}`")))?;
        let from_0 = |joint: usize| joint.checked_sub(1).ok_or_else(|| foreign("no joint 0".into()));
        let site = match (*joint, *cause, *other) {
            (Some(row), Some(cause), other) if family.place == Place::Function => {
                Site::Function { row: from_0(row)?, of: [from_0(cause)?, from_0(other.unwrap_or(cause))?] }
            }
            (_, _, Some(_)) => return Err(foreign("no second cause".into())),
            (None, None, None) => Site::Arm,
            (Some(joint), None, None) => Site::Joint(from_0(joint)?),
            (Some(row), Some(cause), None) => Site::Pair { row: from_0(row)?, cause: from_0(cause)? },
            (None, Some(_), None) => return Err(foreign("no cause without a joint".into())),
        };
        if let Some((name, _)) = settings.iter().find(|(name, _)| form.settings.iter().all(|one| one.name != name)) {
            return Err(foreign(format!("no setting `{name}`")));
        }
        let value = |one: &Setting| settings.iter().find(|(name, _)| name == one.name).map(|(_, value)| *value);
        let given = |one| value(one).ok_or_else(|| foreign(format!("a setting `{}`, which is missing", one.name)));
        let settings = form.settings.iter().map(given).collect::<Result<_, _>>()?;
        Ok(Spec { family: family.id, form: form.name, site, settings })
    }
}

/// Checks that every parameter is a column of the term, and that none occurs twice.
fn check_names(named: &NamedTerm, columns: &[Column]) -> Result<(), ModelError> {
    for (index, (name, _, _)) in named.parameters.iter().enumerate() {
        if !columns.iter().any(|column| column.name == *name) {
            return Err(ModelError::UnknownColumn { term: named.id.clone(), name: name.clone() });
        }
        if named.parameters[..index].iter().any(|(before, _, _)| before == name) {
            return Err(ModelError::DuplicateColumn { name: name.clone() });
        }
    }
    Ok(())
}
