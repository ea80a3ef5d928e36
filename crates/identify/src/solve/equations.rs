//! The filtered equations of a structure, kept for structures with more terms.

use super::stack::Stack;
use super::{Estimator, Identification, Options, Outcome, Solved, Solver, Weights, finish, linear, noise};
use crate::{EstimateError, Experiment, essential};
use plumbline_model::Structure;

/// A structure with its equations along one or more experiments of one arm, each in its own mounting.
///
/// Most of the time of an identification passes in the filter of the regressor's columns. A structure with more terms shares them
/// ([`Equations::extended`]).
pub struct Equations<'a> {
    structure: Structure,
    experiments: &'a [Experiment],
    stack: Stack,
}

impl<'a> Equations<'a> {
    /// Filters torques and columns.
    ///
    /// # Errors
    /// Experiments of another arm; fewer equations than parameters.
    pub fn of(structure: Structure, experiments: &'a [Experiment]) -> Result<Equations<'a>, EstimateError> {
        let stack = Stack::of(&structure, experiments)?;
        Ok(Equations { structure, experiments, stack })
    }

    /// Of a structure that has more terms after these, [`Structure::with`].
    ///
    /// # Errors
    /// Fewer equations than parameters.
    pub fn extended(&self, structure: Structure) -> Result<Equations<'a>, EstimateError> {
        let before = self.structure.terms().len();
        debug_assert!(structure.columns().starts_with(self.structure.columns()), "terms after these");
        let stack = self.stack.extended(&structure, self.experiments, before)?;
        Ok(Equations { structure, experiments: self.experiments, stack })
    }

    /// The structure.
    pub fn structure(&self) -> &Structure {
        &self.structure
    }

    /// The experiments.
    pub fn experiments(&self) -> &'a [Experiment] {
        self.experiments
    }

    /// The parameters by a given estimator.
    ///
    /// # Errors
    /// For instrumental variables, an experiment that has neither two periods nor a desired motion.
    pub fn identify(&self, options: &Options) -> Result<Identification, EstimateError> {
        let Equations { structure, experiments, stack } = self;
        let every: Vec<usize> = (0..structure.columns().len()).collect();
        let solver = Solver::new(structure, experiments, options.estimator)?;
        let whole = solver.solve(stack, &every)?;
        let (solved, kept, dropped) = if options.essential {
            essential::reduce(structure.columns(), whole, |kept| solver.solve(&stack.columns(kept), kept))?
        } else {
            (whole, every, Vec::new())
        };
        finish(structure, experiments, options.estimator, stack, solved, &kept, dropped)
    }

    /// The parameters by weighted least squares with given standard deviations of the joints' errors, n \[Nm\].
    ///
    /// A model extended in one joint keeps the weights of the plain model this way. New weights would bias parameters shared by several joints
    /// towards the joint with the smaller residual.
    ///
    /// # Errors
    /// Equations that are not finite.
    pub fn identify_weighted(&self, sigma: &[f64]) -> Result<Identification, EstimateError> {
        let Equations { structure, experiments, stack } = self;
        let every: Vec<usize> = (0..structure.columns().len()).collect();
        let fit = linear::least_squares(stack, &Weights::per_joint(sigma))?;
        let spread = noise::of_torques(stack, experiments, &fit);
        let (sigma, outcome) = (sigma.to_vec(), Outcome::Settled);
        let solved = Solved { fit, spread, sigma, row_weights: None, rounds: 1, outcome };
        finish(structure, experiments, Estimator::Wls, stack, solved, &every, Vec::new())
    }
}
