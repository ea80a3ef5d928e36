//! The direction of gravity that the torques of the arm at rest imply under a model.

use super::super::models::Accepted;
use super::super::rest_poses::RestPoses;
use plumbline_identify::{DirectionError, Disagreement, GravitySource, ImpliedGravity, implied_gravity};

/// The check of one model by the torques at rest.
#[derive(Clone)]
pub struct TorqueCheck {
    pub model: u64,
    /// Poses completed before the model: the arm may have carried something else then.
    after: u64,
    seen: u64,
    /// What the torques imply, where they determine it; the error is a torque sensor with the wrong sign.
    implied: Result<Option<ImpliedGravity>, Disagreement>,
    /// The torques have agreed once. A payload taken up later does not concern the mounting.
    passed: bool,
    /// The poses so far do not determine the direction: nothing waits for more of them, but the next one is evaluated.
    undetermined: bool,
}

/// A remark for the operator that does not fail the check.
#[derive(Clone, Debug, PartialEq)]
pub enum Remark {
    Implied(String),
    Undetermined(DirectionError),
}

impl std::fmt::Display for Remark {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        match self {
            Remark::Implied(words) => f.write_str(words),
            Remark::Undetermined(error) => {
                write!(f, "{error}; the mounting is checked without them until another pose tells more")
            }
        }
    }
}

impl TorqueCheck {
    /// Nothing evaluated yet; the first `after` poses do not count.
    pub fn new(model: u64, after: u64) -> TorqueCheck {
        TorqueCheck { model, after, seen: 0, implied: Ok(None), passed: false, undetermined: false }
    }

    /// The check of `model`, which follows `self` in the same connection.
    pub fn followed_by(&self, model: u64, rests: &RestPoses) -> TorqueCheck {
        TorqueCheck::new(model, if self.passed { rests.completed() } else { self.after })
    }

    /// Whether no pose has to be awaited before the model serves: the torques have agreed, do not determine it, or have agreed with a model before it.
    pub fn is_settled(&self) -> bool {
        self.passed || self.undetermined || self.after > 0
    }

    /// Evaluates poses that have been completed since the last call.
    pub fn update(&mut self, model: &Accepted, rests: &RestPoses) -> Option<Remark> {
        let completed = rests.completed();
        if self.passed || self.seen == completed {
            return None;
        }
        self.seen = completed;
        let poses = rests.since(self.after);
        if poses.is_empty() {
            return None;
        }
        match implied_gravity(&model.model, &poses, &model.noise) {
            Ok(Ok(found)) => {
                let remark = found.remark().map(Remark::Implied);
                self.implied = Ok(Some(found));
                remark
            }
            Ok(Err(wrong)) => {
                self.implied = Err(wrong);
                None
            }
            Err(error) => {
                self.implied = Ok(None);
                let first = !std::mem::replace(&mut self.undetermined, true);
                first.then_some(Remark::Undetermined(error))
            }
        }
    }

    /// The side of the mounting check that the torques take; none before a pose, or where the poses do not determine it.
    /// Errors: a torque sensor with the wrong sign: no direction.
    pub fn side(&self) -> Result<Option<GravitySource>, Disagreement> {
        self.implied.as_ref().map(|found| found.as_ref().map(|found| found.side)).map_err(Disagreement::clone)
    }

    pub fn agreed(&mut self) {
        self.passed |= matches!(self.implied, Ok(Some(_)));
    }
}
