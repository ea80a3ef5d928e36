//! The model that is delivered: the plain one with the effects that help.

use super::diagnosis::Input;
use super::evidence::Evidence;
use super::library::Candidate;
use super::outcome::Fitted;
use super::select::{Found, Selected};
use super::state::State;
use super::unseen::Unseen;
use crate::estimate::EstimateError;
use crate::estimate::experiment::Experiment;
use crate::estimate::solve::{Estimator, Identification, identify_weighted, identify_with};
use crate::model::term::effect::{self, Spec};
use nalgebra::DVector;

/// What a joint's effects have to explain of what was unmodelled there, to be put into the model.
const HELPFUL: f64 = 0.5;
/// Times the noise that the unseen runs may show of what the plain model lacks, for an effect that hardly comes in there: the errors of the parameters
/// are as large, and it has to do no harm alone.
const FAINT: f64 = 1.5;
/// Parameters that moved by less than this, times their standard deviation, are those that the load was computed with.
const SETTLED: f64 = 0.1;

/// What a delivery is made of.
pub struct Delivery<'a> {
    /// What is diagnosed.
    pub input: &'a Input<'a>,
    /// Its unseen runs.
    pub unseen: &'a Evidence,
    /// The runs to identify from.
    pub experiments: &'a [Experiment],
    /// The plain model.
    pub before: &'a Identification,
    /// Effects that the search started with.
    pub seeds: &'a [Candidate],
}

impl Delivery<'_> {
    /// The model with the effects that help, and which they are. They have to help in the selection's fit, of which `adequacy` tells each joint's
    /// share (as far as the unseen runs show what the plain model `lacks`), and must do no harm in the model that is
    /// delivered: identified once more upon its own load, an effect near a resonance may come out as another one.
    ///
    /// # Errors
    /// As [`identify_with`].
    pub fn of(
        &self,
        selected: &Selected,
        lacks: &[Option<f64>],
        adequacy: &[Option<f64>],
    ) -> Result<(Fitted, Vec<bool>), EstimateError> {
        let explains = |share: &[Option<f64>], found: &Found, least: f64| {
            share[found.relevance.joint].is_none_or(|share| share >= least)
        };
        let least = |found: &Found| {
            let faint = lacks[found.relevance.joint].is_some_and(|lack| lack <= FAINT * FAINT);
            if faint { 0.0 } else { HELPFUL }
        };
        let mut kept: Vec<bool> = selected.found.iter().map(|found| explains(adequacy, found, least(found))).collect();
        loop {
            let after = self.extended(&selected.state, &kept)?;
            if !kept.contains(&true) {
                return Ok((after, kept));
            }
            let unseen = Unseen::of_model(self.unseen, &after, self.input.unseen());
            let share = unseen.explained(lacks, &DVector::from_column_slice(&after.identification.beta));
            let still = kept.iter().zip(&selected.found).map(|(kept, found)| *kept && explains(&share, found, 0.0));
            let still: Vec<bool> = still.collect();
            if still == kept {
                return Ok((after, kept));
            }
            kept = still;
        }
    }

    /// Standard deviation of each joint's residual under the model that the search starts from.
    ///
    /// The weights of the joints stay as they are there: a joint that an effect repairs would weigh more otherwise, and the parameters that
    /// it shares with the others would follow what it still lacks.
    fn weights(&self, beta: &[f64]) -> Result<Vec<f64>, EstimateError> {
        let specs: Vec<Spec> = self.seeds.iter().map(|seed| seed.spec.clone()).collect();
        let terms = effect::assemble(&specs, &self.input.structure.ground(beta)).ok().filter(|_| !specs.is_empty());
        match terms.and_then(|terms| self.input.structure.clone().with(terms).ok()) {
            Some(structure) => Ok(identify_with(&structure, self.experiments, self.input.options)?.sigma),
            None => Ok(self.before.sigma.clone()),
        }
    }

    /// Identified as a whole.
    fn extended(&self, state: &State, kept: &[bool]) -> Result<Fitted, EstimateError> {
        let Delivery { input, experiments, before, .. } = *self;
        let plain = || Fitted { structure: input.structure.clone(), identification: before.clone() };
        let specs: Vec<Spec> =
            state.items.iter().zip(kept).filter(|(_, kept)| **kept).map(|(item, _)| item.spec.clone()).collect();
        if specs.is_empty() {
            return Ok(plain());
        }
        let mut beta = state.fit.theta.as_slice().to_vec();
        let mut fitted = plain();
        let known = experiments.iter().all(|experiment| experiment.scatter.is_some());
        let own_weights = input.options.estimator == Estimator::Wls && !known;
        let sigma = own_weights.then(|| self.weights(&beta)).transpose()?;
        // Once more with the load of the parameters just found.
        for _ in 0..2 {
            let ground = input.structure.ground(&beta);
            let terms = effect::assemble(&specs, &ground).ok();
            let Some(structure) = terms.and_then(|terms| input.structure.clone().with(terms).ok()) else {
                return Ok(plain());
            };
            let identification = match &sigma {
                Some(sigma) => identify_weighted(&structure, experiments, sigma)?,
                None => identify_with(&structure, experiments, input.options)?,
            };
            let plain = 0..input.structure.columns().len();
            let near = plain.into_iter().all(|c| {
                identification.std[c].is_none_or(|std| (identification.beta[c] - beta[c]).abs() <= SETTLED * std)
            });
            beta.clone_from(&identification.beta);
            fitted = Fitted { structure, identification };
            if near {
                break;
            }
        }
        Ok(fitted)
    }
}
