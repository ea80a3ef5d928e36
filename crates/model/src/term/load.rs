//! The rigid-body torque as a load of gears, bearings and sensors, which many effects depend on.

use super::position_error::SlopesAlong;
use super::{Motion, Sample};
use crate::base::Reduction;
use crate::chain::Chain;
use crate::fast::closed::ClosedForm;
use crate::regressor::LINK_COLUMNS;
use crate::rnea::{LinkParameters, rnea};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::borrow::Cow;
use std::sync::{Arc, OnceLock};

/// Rigid bodies with their parameters, `tau_rb = Y_b beta`.
#[derive(Clone, Debug)]
pub struct Load {
    chain: Chain,
    links: Vec<LinkParameters>,
    /// What is known of it along some motions.
    known: Vec<Known>,
}

/// A [`Load`] along a motion.
#[derive(Clone, Debug)]
struct Known {
    motion: Arc<Motion>,
    /// Its torque, N x n \[Nm\].
    tau: DMatrix<f64>,
    /// Its slopes over the position of each joint, once they are asked for.
    slopes: Vec<OnceLock<Arc<SlopesAlong>>>,
}

impl Load {
    /// With the base parameters of a reduction, in its order.
    pub fn new(chain: &Chain, reduction: &Reduction, beta: &[f64]) -> Load {
        // As in the real-time model: base parameters in the slots of their names.
        let mut links = vec![LinkParameters::default(); chain.len()];
        for (&slot, &value) in reduction.independent().iter().zip(beta) {
            links[slot / LINK_COLUMNS][slot % LINK_COLUMNS] = value;
        }
        Load { chain: chain.clone(), links, known: Vec::new() }
    }

    /// The arm.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// First moments of link 1 across its axis \[kg m\]; 0 where they are no base parameters.
    pub(super) fn first_moments(&self) -> [f64; 2] {
        self.links.first().map_or([0.0; 2], |link| [link[6], link[7]])
    }

    /// Precomputed for one gravity vector in the base frame \[m/s2\].
    pub fn under(&self, gravity: &Vector3<f64>) -> LoadUnder {
        let mut closed = ClosedForm::default();
        let fast = closed.add_links(&self.chain, &self.links, gravity);
        let plain = (!fast).then(|| (self.chain.clone(), self.links.clone(), *gravity));
        LoadUnder { closed, plain }
    }

    /// Along a motion, N x n \[Nm\].
    pub fn along(&self, motion: &Motion) -> Cow<'_, DMatrix<f64>> {
        if let Some(known) = self.known(motion) {
            return Cow::Borrowed(&known.tau);
        }
        let mut load = self.under(&motion.gravity);
        let mut tau = DMatrix::zeros(motion.samples(), motion.joints());
        for k in 0..motion.samples() {
            let now = load.torque(&motion.sample(k));
            for j in 0..motion.joints() {
                tau[(k, j)] = now[j];
            }
        }
        Cow::Owned(tau)
    }

    /// Slopes over the position of a joint along a motion, where it is a [known](OperatingPoint::known_along) one; `compute` is called once, with the joint's
    /// own torque at every sample.
    #[expect(clippy::disallowed_methods, reason = "along whole motions, before the loop")]
    pub(super) fn slopes(
        &self,
        motion: &Motion,
        joint: usize,
        compute: impl FnOnce(&[f64]) -> SlopesAlong,
    ) -> Option<Arc<SlopesAlong>> {
        let Known { tau, slopes, .. } = self.known(motion)?;
        let own = || &tau.as_slice()[joint * tau.nrows()..][..tau.nrows()];
        Some(Arc::clone(slopes.get(joint)?.get_or_init(|| Arc::new(compute(own())))))
    }

    fn known(&self, motion: &Motion) -> Option<&Known> {
        // Whole motions are compared only where none is the same object.
        let same = self.known.iter().find(|known| std::ptr::eq(&*known.motion, motion));
        same.or_else(|| self.known.iter().find(|known| *known.motion == *motion))
    }
}

/// Parameters at which the columns of effects are evaluated.
#[derive(Clone, Debug)]
pub struct OperatingPoint {
    /// The arm.
    pub chain: Chain,
    /// Its rigid bodies.
    pub load: Arc<Load>,
    /// `[fv, fc]` of each joint: \[Nms/rad\], \[Nm\]. Empty where the model has no friction.
    pub friction: Vec<[f64; 2]>,
    /// Inertia of each joint's rotor where it is a parameter of its own, else 0 \[kg m2\]. Empty where the torques contain no rotors.
    pub rotor_inertias: Vec<f64>,
    /// Whether the inertia of each joint's rotor is a part of its rigid body's.
    pub rotors: Vec<bool>,
}

impl OperatingPoint {
    /// With the load along these motions computed once, for a search that evaluates many columns along them.
    pub fn known_along<'a>(self, motions: impl Iterator<Item = &'a Arc<Motion>>) -> OperatingPoint {
        let known = |motion: &Arc<Motion>| Known {
            motion: Arc::clone(motion),
            tau: self.load.along(motion).into_owned(),
            slopes: vec![OnceLock::new(); motion.joints()],
        };
        let known = motions.map(known).collect();
        OperatingPoint { load: Arc::new(Load { known, ..(*self.load).clone() }), ..self }
    }
}

/// A [`Load`] under a known gravity. Its torque neither allocates nor panics.
#[derive(Clone, Debug)]
pub struct LoadUnder {
    closed: ClosedForm,
    /// For arms without a closed form (prismatic joints).
    plain: Option<(Chain, Vec<LinkParameters>, Vector3<f64>)>,
}

impl LoadUnder {
    /// `tau_rb` at a sample \[Nm\].
    pub fn torque(&mut self, sample: &Sample) -> JointVec {
        let Some((chain, links, gravity)) = &self.plain else { return self.closed.torque(sample) };
        let mut tau = JointVec::default();
        rnea(chain, links, gravity, &sample.q, &sample.dq, &sample.ddq, &mut tau);
        tau
    }
}
