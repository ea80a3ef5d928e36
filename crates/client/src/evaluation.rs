//! A model ready for the control loop: everything that a call needs, computed in advance.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use crate::error::{Error, Fault};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{BadInput, JointVec, MAX_JOINTS, Torque};
use plumbline_identify::TorqueUncertainty;
use plumbline_model::term::{FixedTerm, Sample, Term, friction};
use plumbline_model::{
    BaseKind, ClosedForm, Evaluator, ModelError, Mounting, SampleRegressor, TorqueModel, VERTICAL_TOLERANCE,
};
use plumbline_model_file::ModelFile;

const ROTOR_INERTIA: &str = "rotor-inertia";

/// The model of one file under one gravity.
pub(crate) struct Evaluation {
    pub id: u64,
    pub joints: usize,
    kind: BaseKind,
    /// Gravity that the model was made for, and the one that it is under now \[m/s2\].
    own: Vector3<f64>,
    now: Vector3<f64>,
    torque: Evaluator,
    /// Rigid links, bodies on the last link and rotors, under the model's gravity and under none.
    inertial: Evaluator,
    weightless: Evaluator,
    friction: ClosedForm,
    regressor: Regressor,
    uncertainty: Option<TorqueUncertainty>,
}

impl Evaluation {
    /// The model of a file under `gravity` in the base frame \[m/s2\]. `id` is its identity.
    ///
    /// # Errors
    /// [`Error::OtherMounting`] where the model is not valid under this gravity.
    pub fn new(id: u64, file: ModelFile, gravity: [f64; 3]) -> Result<Evaluation, Error> {
        let ModelFile { model, uncertainty, .. } = file;
        let gravity = Vector3::from(gravity);
        let refused = |what: String| Error::OtherMounting(what);
        if !gravity.iter().all(|value| value.is_finite()) {
            return Err(refused(format!("gravity is {:?} m/s2, expected finite numbers", gravity.as_slice())));
        }
        model.valid_in(&Mounting::along(&gravity)).map_err(|error| refused(error.to_string()))?;
        let unusable = |error: ModelError| BadInput::new("model", "[[term]]", error, "terms that can be evaluated");
        let is_inertial =
            |term: &dyn Term| term.id() == ROTOR_INERTIA || term.spec().is_some_and(|spec| spec.is_on_last_link());
        let inertial = model.part(is_inertial).map_err(unusable)?;
        let structure = model.structure();
        let mut closed = ClosedForm::default();
        for (term, parameters) in model.terms().iter().filter(|(term, _)| term.id() == friction::ID) {
            let beta: Vec<f64> = parameters.iter().map(|parameter| parameter.value).collect();
            // Friction of every joint always has a closed form.
            term.fix(structure.chain(), &gravity, &beta).join(&mut closed);
        }
        Ok(Evaluation {
            id,
            joints: structure.chain().len(),
            kind: model.kind(),
            own: gravity,
            now: gravity,
            torque: model.evaluator(&gravity),
            weightless: inertial.evaluator(&Vector3::zeros()),
            inertial: inertial.evaluator(&gravity),
            friction: closed,
            regressor: Regressor::new(&model, &gravity).map_err(unusable)?,
            uncertainty,
        })
    }

    /// Sets the period of the calls \[s\].
    pub fn every(&mut self, dt: f64) {
        self.torque.every(dt);
        self.regressor.effects.iter_mut().for_each(|(_, effect)| effect.every(dt));
    }

    pub fn torque(&mut self, sample: &Sample, gravity: Option<[f64; 3]>) -> Result<JointVec, Fault> {
        let wanted = gravity.map_or(self.own, Vector3::from);
        if wanted != self.now {
            if !wanted.iter().all(|value| value.is_finite()) {
                return Err(Fault::NotFinite);
            }
            let is_along = || Mounting::along(&wanted).is_along_axis_1(VERTICAL_TOLERANCE);
            if self.kind == BaseKind::Vbs && !is_along() {
                return Err(Fault::Mounting);
            }
            if !self.torque.set_gravity(&wanted) {
                return Err(Fault::FixedGravity);
            }
            self.now = wanted;
        }
        let Torque(tau) = self.torque.torque(sample);
        Ok(tau)
    }

    pub fn gravity(&mut self, q: &JointVec) -> JointVec {
        self.inertial.torque(&Sample { q: *q, ..Sample::default() }).0
    }

    pub fn coriolis(&mut self, q: &JointVec, dq: &JointVec) -> JointVec {
        self.weightless.torque(&Sample { q: *q, dq: *dq, ..Sample::default() }).0
    }

    pub fn friction(&mut self, dq: &JointVec) -> JointVec {
        self.friction.torque(&Sample { dq: *dq, ..Sample::default() })
    }

    /// Column `j` of the inertia matrix.
    pub fn inertia_column(&mut self, q: &JointVec, j: usize) -> JointVec {
        let mut sample = Sample { q: *q, ..Sample::default() };
        if let Some(ddq) = sample.ddq.get_mut(j) {
            *ddq = 1.0;
        }
        self.weightless.torque(&sample).0
    }

    /// Columns of the regressor: element `c` is column `c`, its entry `j` is joint `j`'s row.
    pub fn regressor(&mut self, sample: &Sample) -> &[JointVec] {
        self.regressor.at(sample)
    }

    pub fn columns(&self) -> usize {
        self.regressor.columns.len()
    }

    /// Standard deviation of each joint's torque by the covariance of the parameters, `sqrt(y C y')` with `y` the joint's row \[Nm\].
    pub fn std(&mut self, sample: &Sample) -> Result<JointVec, Fault> {
        let Evaluation { regressor, uncertainty, .. } = self;
        let uncertainty = uncertainty.as_ref().ok_or(Fault::NoUncertainty)?;
        let columns = regressor.at(sample);
        let covariance: &DMatrix<f64> = &uncertainty.parameters.covariance;
        let mut variance = [0.0; MAX_JOINTS];
        for (row, with) in columns.iter().zip(covariance.as_slice().chunks_exact(covariance.nrows().max(1))) {
            let mut spread = [0.0; MAX_JOINTS];
            for (column, covariance) in columns.iter().zip(with) {
                spread.iter_mut().zip(column).for_each(|(spread, value)| *spread += covariance * value);
            }
            for ((variance, row), spread) in variance.iter_mut().zip(row).zip(&spread) {
                *variance += row * spread;
            }
        }
        Ok(variance.map(|variance| variance.max(0.0).sqrt()))
    }
}

/// The regressor of a model sample by sample, terms with a memory included.
struct Regressor {
    /// Terms of one sample, and the model's column of each of their columns.
    plain: SampleRegressor,
    places: Vec<usize>,
    /// The other terms, one per column, with a unit parameter: the served torque's own arithmetic.
    effects: Vec<(usize, Box<dyn FixedTerm>)>,
    columns: Vec<JointVec>,
}

impl Regressor {
    fn new(model: &TorqueModel, gravity: &Vector3<f64>) -> Result<Regressor, ModelError> {
        let structure = model.structure();
        let part = model.part(|term| term.entries().is_some())?;
        let plain =
            SampleRegressor::new(part.structure(), gravity).map_err(|id| ModelError::UnknownTerm { id: id.into() })?;
        let (mut places, mut effects) = (Vec::new(), Vec::new());
        for (term, range) in structure.terms().iter().zip(structure.ranges()) {
            if term.entries().is_some() {
                places.extend(range);
                continue;
            }
            let width = range.len();
            for (c, place) in range.enumerate() {
                let unit: Vec<f64> = (0..width).map(|own| f64::from(u8::from(own == c))).collect();
                effects.push((place, term.fix(structure.chain(), gravity, &unit)));
            }
        }
        let columns = vec![[0.0; MAX_JOINTS]; structure.columns().len()];
        Ok(Regressor { plain, places, effects, columns })
    }

    fn at(&mut self, sample: &Sample) -> &[JointVec] {
        for (place, found) in self.places.iter().zip(self.plain.at(sample)) {
            if let Some(column) = self.columns.get_mut(*place) {
                *column = *found;
            }
        }
        for (place, effect) in &mut self.effects {
            if let Some(column) = self.columns.get_mut(*place) {
                *column = [0.0; MAX_JOINTS];
                effect.torque(sample, column);
            }
        }
        &self.columns
    }
}
