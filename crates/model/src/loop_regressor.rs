//! The regressor of a model in a control loop, terms with a memory included.

use crate::sample_regressor::SampleRegressor;
use crate::structure::ModelError;
use crate::term::{FixedTerm, Sample};
use crate::torque::TorqueModel;
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// `Y` sample by sample, for any model. Allocates at creation only.
///
/// Terms with a memory take every call as the next sample.
pub struct LoopRegressor {
    /// Terms of one sample, and the model's column of each of their columns.
    plain: SampleRegressor,
    places: Vec<usize>,
    /// The other terms, one per column, with a unit parameter: the served torque's own arithmetic.
    effects: Vec<(usize, Box<dyn FixedTerm>)>,
    columns: Vec<JointVec>,
}

impl LoopRegressor {
    /// The regressor of `model` under `gravity` in the base frame \[m/s2\].
    ///
    /// # Errors
    /// Terms that cannot be evaluated.
    pub fn new(model: &TorqueModel, gravity: &Vector3<f64>) -> Result<LoopRegressor, ModelError> {
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
        Ok(LoopRegressor { plain, places, effects, columns })
    }

    /// Number of columns, p.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there is no column.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// Sets the period of the calls \[s\]; 1 ms before.
    pub fn every(&mut self, dt: f64) {
        self.effects.iter_mut().for_each(|(_, effect)| effect.every(dt));
    }

    /// The columns at `sample`: element `c` is column `c`, its entry `j` is joint `j`'s row.
    pub fn at(&mut self, sample: &Sample) -> &[JointVec] {
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
