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
use nalgebra::Vector3;
use plumbline_core::{BadInput, JointVec, Torque};
use plumbline_identify::TorqueUncertainty;
use plumbline_identify::external::{External, ExternalObserver, ObserverSettings};
use plumbline_model::term::{Sample, friction};
use plumbline_model::{BaseKind, ClosedForm, Evaluator, LoopRegressor, ModelError, Mounting, VERTICAL_TOLERANCE};
use plumbline_model_file::ModelFile;

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
    regressor: LoopRegressor,
    uncertainty: Option<TorqueUncertainty>,
    /// `None` where the file has no spectrum of the residual.
    observer: Option<ExternalObserver>,
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
        let inertial = model.inertial().map_err(unusable)?;
        let structure = model.structure();
        let mut closed = ClosedForm::default();
        for (term, parameters) in model.terms().iter().filter(|(term, _)| term.id() == friction::ID) {
            let beta: Vec<f64> = parameters.iter().map(|parameter| parameter.value).collect();
            // Friction of every joint always has a closed form.
            term.fix(structure.chain(), &gravity, &beta).join(&mut closed);
        }
        let spectral = uncertainty.as_ref().filter(|of| of.residual_spectrum.is_some());
        let usual = ObserverSettings::default();
        let observer = spectral.map(|of| ExternalObserver::new(&model, of, &gravity, usual)).transpose();
        let observer = observer.map_err(|error| BadInput::new("model", "[uncertainty]", error, "a usable spectrum"))?;
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
            regressor: LoopRegressor::new(&model, &gravity).map_err(unusable)?,
            uncertainty,
            observer,
        })
    }

    /// Sets the period of the calls \[s\].
    pub fn every(&mut self, dt: f64) {
        self.torque.every(dt);
        self.regressor.every(dt);
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
        self.regressor.len()
    }

    /// Standard deviation of each joint's torque by the covariance of the parameters, `sqrt(y C y')` with `y` the joint's row \[Nm\].
    pub fn std(&mut self, sample: &Sample) -> Result<JointVec, Fault> {
        let Evaluation { regressor, uncertainty, .. } = self;
        let uncertainty = uncertainty.as_ref().ok_or(Fault::NoUncertainty)?;
        Ok(uncertainty.parameters.variance(regressor.at(sample)).map(f64::sqrt))
    }

    /// The external torque at the next sample.
    pub fn external(&mut self, q: &JointVec, dq: &JointVec, tau: &JointVec) -> Result<External, Fault> {
        Ok(self.observer.as_mut().ok_or(Fault::NoUncertainty)?.next(q, dq, tau))
    }

    /// Settings of the external torque; the observer begins anew.
    pub fn observe(&mut self, settings: ObserverSettings) -> Result<(), Fault> {
        self.observer.as_mut().map_or(Ok(()), |observer| observer.configure(settings)).map_err(|_| Fault::Setting)
    }
}
