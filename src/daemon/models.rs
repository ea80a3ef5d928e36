//! The models of the daemon: the one that is served, the one before it, and one that waits for a person's decision.

use nalgebra::Vector3;
use plumbline_core::{BadInput, Limits, Record};
use plumbline_identify::{Implausible, plausible};
use plumbline_ipc::{HeldModel, Proposal};
use plumbline_model::{Mounting, TorqueModel};
use std::collections::VecDeque;

/// Every so many cycles one record of the arm is kept for checks of models.
const DECIMATION: u64 = 16;
/// Records kept: about one second.
const MAX_RECENT: usize = 64;

/// A model that passed every check of its text.
pub struct Accepted {
    pub id: u64,
    pub text: String,
    pub model: TorqueModel,
    /// Noise of the measured torque by its file, per joint \[Nm\]; empty where unknown.
    pub noise: Vec<f64>,
}

/// Why a model is not admitted.
pub struct NotAdmitted {
    pub bad: BadInput,
    /// Nothing is wrong with the model but that the arm's torques are no longer its own: something has come or changed since they were recorded.
    pub contradicted: bool,
}

impl From<BadInput> for NotAdmitted {
    fn from(bad: BadInput) -> NotAdmitted {
        NotAdmitted { bad, contradicted: false }
    }
}

/// The last second of the arm: every [`DECIMATION`]th record.
#[derive(Default)]
pub struct Recent(VecDeque<Record>);

impl Recent {
    pub fn take(&mut self, records: &[Record]) {
        for record in records.iter().filter(|record| record.cycle.is_multiple_of(DECIMATION)) {
            if self.0.len() == MAX_RECENT {
                self.0.pop_front();
            }
            self.0.push_back(*record);
        }
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }
}

#[derive(Default)]
pub struct Models {
    served: Option<Accepted>,
    /// The model that was served before: the loop falls back to it.
    reserve: Option<Accepted>,
    /// A proposed model that waits for a decision, and why it was proposed.
    held: Option<(Accepted, Proposal)>,
    /// The model whose torque broke a limit: it is not handed to another loop.
    rejected: Option<u64>,
    /// The model that the measured torques contradict, and how.
    doubt: Option<(u64, String)>,
    pub recent: Recent,
}

impl Models {
    /// The model that is served, also where a loop has rejected it.
    pub fn served(&self) -> Option<&Accepted> {
        self.served.as_ref()
    }

    /// Text of a model that is served, or was before.
    pub fn text(&self, model: u64) -> Option<&str> {
        let known = self.served.iter().chain(&self.reserve);
        known.into_iter().find(|known| known.id == model).map(|known| known.text.as_str())
    }

    /// The served model, if it may be handed to a loop: it holds in that loop's mounting, and no loop has rejected it.
    pub fn for_loop(&self, mounting: &Mounting) -> Option<&Accepted> {
        self.trusted().filter(|served| served.model.holds_in(mounting))
    }

    /// The served model, unless a loop has rejected it.
    fn trusted(&self) -> Option<&Accepted> {
        self.served.as_ref().filter(|served| self.rejected != Some(served.id))
    }

    /// Identity of the served model; 0 for none.
    pub fn served_id(&self) -> u64 {
        self.trusted().map_or(0, |served| served.id)
    }

    /// Doubts the model with this identity, or trusts it again; false where it is not served.
    pub fn doubt(&mut self, model: u64, why: Option<String>) -> bool {
        let served = model != 0 && self.served_id() == model;
        if served {
            self.doubt = why.map(|why| (model, why));
        }
        served
    }

    /// Identity of the served model, if it is doubted, else 0.
    pub fn doubted(&self) -> u64 {
        self.why_doubted().map_or(0, |_| self.served_id())
    }

    /// Why the served model is doubted.
    pub fn why_doubted(&self) -> Option<&String> {
        self.doubt.as_ref().filter(|(model, _)| *model == self.served_id()).map(|(_, why)| why)
    }

    pub fn offer(&self) -> Option<HeldModel> {
        self.held.as_ref().map(|(held, proposal)| HeldModel { model: held.id, proposal: proposal.clone() })
    }

    /// Checks a model against what changes after its text was checked: the mounting, and what the arm has measured in the last second under
    /// `gravity` \[m/s2\].
    /// Errors: the model does not hold in `mounting`, or its torques are not those of the arm.
    pub fn admit(
        &mut self,
        file: &str,
        model: &TorqueModel,
        mounting: &Mounting,
        gravity: &Vector3<f64>,
        limits: &Limits,
    ) -> Result<(), NotAdmitted> {
        model.valid_in(mounting).map_err(|refused| {
            BadInput::new(file, "key `kind`", refused, "a model that holds in the present mounting")
        })?;
        self.plausible(model, gravity, limits).map_err(|why| NotAdmitted {
            bad: BadInput::new(file, "parameters", why, "a model of this arm"),
            contradicted: matches!(why, Implausible::Measured { .. }),
        })
    }

    /// Whether a model's torques go with what the arm has measured in the last second.
    fn plausible(&mut self, model: &TorqueModel, gravity: &Vector3<f64>, limits: &Limits) -> Result<(), Implausible> {
        self.recent.0.make_contiguous();
        let (recent, _) = self.recent.0.as_slices();
        plausible(model, self.trusted().map(|served| &served.model), gravity, recent, limits)
    }

    /// Serves a model; its identity. What was proposed before is about another model.
    pub fn serve(&mut self, model: Accepted) -> u64 {
        self.held = None;
        let id = model.id;
        let before = self.served.replace(model);
        if before.as_ref().is_some_and(|before| before.id != id && self.rejected != Some(before.id)) {
            self.reserve = before;
        }
        self.rejected = None;
        id
    }

    /// Holds a proposed model for a decision; its identity.
    pub fn hold(&mut self, model: Accepted, proposal: Proposal) -> u64 {
        self.held.insert((model, proposal)).0.id
    }

    pub fn take_held(&mut self) -> Option<(Accepted, Proposal)> {
        self.held.take()
    }

    /// Checks the held model in `mounting` and takes it out; `None` where none is held.
    /// Errors: it does not hold there, or its torques are not those of the arm. It stays held.
    pub fn adopt(
        &mut self,
        mounting: &Mounting,
        gravity: &Vector3<f64>,
        limits: &Limits,
    ) -> Option<Result<Accepted, String>> {
        let (held, proposal) = self.held.take()?;
        let holds = held.model.valid_in(mounting).map_err(|refused| refused.to_string());
        let checked = holds.and_then(|()| self.plausible(&held.model, gravity, limits).map_err(|why| why.to_string()));
        Some(match checked {
            Ok(()) => Ok(held),
            Err(reason) => {
                self.held = Some((held, proposal));
                Err(reason)
            }
        })
    }

    /// The loop has rejected `model`, whose torque broke a limit, and falls back to `instead`, 0 for none.
    pub fn reject(&mut self, model: u64, instead: u64) {
        self.rejected = Some(model);
        let reserve = self.reserve.take_if(|reserve| reserve.id == instead || reserve.id == model);
        if self.served.as_ref().is_some_and(|served| served.id == model)
            && let Some(reserve) = reserve.filter(|reserve| reserve.id == instead)
        {
            self.served = Some(reserve);
        }
    }
}

#[cfg(test)]
mod tests;
