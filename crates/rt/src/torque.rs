//! The feed-forward torque: the serving model, and the transition from one model's torque to another's.
//!
//! - A hand-over changes the torque to that of the new model at a share of the torque-rate limit, joint by joint, from the torque sent last
//!   (bumpless transfer): for the first model, a change of gravity, a withdrawal and a fall-back.
//! - A model whose torque breaks a limit is replaced by the model before it; without one the torque returns to zero in the same way.
//! - While the arm brakes the torque follows the model within the whole rate limit, since a stop may need it.

use super::retired::Retired;
use plumbline_core::{FeedForward, JointVec, MAX_JOINTS, PERIOD_S, Setpoint, Torque, Validity};
use rtrb::{Producer, PushError};

/// Share of the torque-rate limit that a hand-over uses.
const HAND_OVER_SHARE: f64 = 0.5;
/// Room that a new model needs in the ring of retired boxes: two replaced models, the new one where it has no torque, and a reference.
const ROOM: usize = 4;

/// The two torques of a command.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Torques {
    /// See [`Command::tau_ff`](plumbline_core::Command::tau_ff) \[Nm\].
    pub tau_ff: Torque,
    /// See [`Command::tau_vendor`](plumbline_core::Command::tau_vendor) \[Nm\].
    pub tau_vendor: Torque,
}

impl Torques {
    fn each(&self, other: &Torques, f: impl Fn(&JointVec, &JointVec) -> JointVec) -> Torques {
        Torques {
            tau_ff: Torque(f(&self.tau_ff.0, &other.tau_ff.0)),
            tau_vendor: Torque(f(&self.tau_vendor.0, &other.tau_vendor.0)),
        }
    }
}

/// Torques of the serving model; zero while none serves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ModelTorques {
    /// In this cycle.
    pub now: Torques,
    /// The same model in the cycle before, where it was evaluated.
    pub before: Option<Torques>,
}

/// The torque of one cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Answer {
    pub asked: ModelTorques,
    /// The sent torque.
    pub served: Torques,
    pub validity: Validity,
}

/// The serving model, and its fallback when it breaks a limit: the one that served before it.
#[derive(Clone, Debug)]
pub struct Succession<T> {
    serving: Option<(u64, T)>,
    reserve: Option<(u64, T)>,
}

impl<T> Default for Succession<T> {
    fn default() -> Succession<T> {
        Succession { serving: None, reserve: None }
    }
}

impl<T> Succession<T> {
    /// Identity of the serving model, 0 for none.
    pub fn id(&self) -> u64 {
        self.serving.as_ref().map_or(0, |(id, _)| *id)
    }

    /// The serving model.
    pub fn serving(&self) -> Option<&T> {
        self.serving.as_ref().map(|(_, model)| model)
    }

    /// The serving model, and its fallback.
    pub fn into_parts(self) -> [Option<(u64, T)>; 2] {
        [self.serving, self.reserve]
    }

    /// Puts `model` in service; returns the retired models. A model of the same identity replaces the serving one, one of identity 0 replaces
    /// both: then none serves.
    pub fn serve(&mut self, id: u64, model: T) -> [Option<T>; 3] {
        let only = |of: Option<(u64, T)>| of.map(|(_, model)| model);
        if id == 0 {
            return [only(self.serving.take()), only(self.reserve.take()), Some(model)];
        }
        let before = self.serving.replace((id, model));
        match before {
            Some((same, model)) if same == id => [Some(model), None, None],
            None => [None, None, None],
            another => [only(std::mem::replace(&mut self.reserve, another)), None, None],
        }
    }

    /// The serving model broke a limit: the one before it serves, where there is one. Gives the broken one.
    pub fn fall_back(&mut self) -> Option<T> {
        let broken = std::mem::replace(&mut self.serving, self.reserve.take());
        broken.map(|(_, model)| model)
    }
}

/// The models of the loop and the torque that was sent last.
pub(super) struct TorqueSource {
    joints: usize,
    /// What the torque-rate limit allows per command \[Nm\].
    step: JointVec,
    models: Succession<Box<dyn FeedForward>>,
    /// Models that broke a limit and wait for room in the ring: nothing is freed here.
    spent: [Option<Box<dyn FeedForward>>; 2],
    before: Option<Torques>,
    sent: Option<Torques>,
    /// The torque sent last was not the serving model's own.
    hand_over: bool,
    /// A model served, and none does now.
    withdrawn: bool,
}

impl TorqueSource {
    /// Without a model; `dtau` is the torque-rate limit \[Nm/s\].
    pub fn new(joints: usize, dtau: &JointVec) -> TorqueSource {
        TorqueSource {
            joints: joints.min(MAX_JOINTS),
            step: dtau.map(|dtau| dtau * PERIOD_S),
            models: Succession::default(),
            spent: [None, None],
            before: None,
            sent: None,
            hand_over: false,
            withdrawn: false,
        }
    }

    /// Continues after a cycle at `desired` that sent `sent`. The serving model is evaluated once more for it.
    pub fn restore(
        &mut self,
        models: Succession<Box<dyn FeedForward>>,
        desired: &Setpoint,
        sent: Torques,
        validity: Validity,
    ) {
        self.models = models;
        let asked = self.ask(desired);
        self.before = self.models.serving().is_some().then_some(asked);
        self.sent = Some(sent);
        self.hand_over = asked != sent;
        self.withdrawn = validity == Validity::Withdrawn;
    }

    /// Identity of the serving model, 0 for none.
    pub fn id(&self) -> u64 {
        self.models.id()
    }

    /// Torque of the serving model at `desired`, zero without one.
    fn ask(&mut self, desired: &Setpoint) -> Torques {
        let Some((_, model)) = &mut self.models.serving else { return Torques::default() };
        let mut asked = Torques { tau_ff: model.torque(desired), tau_vendor: model.vendor_torque(&desired.q) };
        for torque in [&mut asked.tau_ff, &mut asked.tau_vendor] {
            torque.0.iter_mut().skip(self.joints).for_each(|tau| *tau = 0.0);
        }
        asked
    }

    /// The torque at `desired`. It counts as sent only by [`sent`](TorqueSource::sent).
    pub fn answer(&mut self, desired: &Setpoint, braking: bool) -> Answer {
        let now = self.ask(desired);
        let served = self.transfer(&now, braking);
        let validity = match (self.models.serving().is_some(), self.withdrawn) {
            (true, _) if served == now => Validity::Valid,
            (true, _) => Validity::HandOver,
            (false, true) => Validity::Withdrawn,
            (false, false) => Validity::None,
        };
        Answer { asked: ModelTorques { now, before: self.before }, served, validity }
    }

    /// `now`, limited by the rate during a hand-over or a stop.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn transfer(&self, now: &Torques, braking: bool) -> Torques {
        let Some(last) = self.sent.as_ref().filter(|_| self.hand_over || braking) else { return *now };
        let share = if braking { 1.0 } else { HAND_OVER_SHARE };
        now.each(last, |now, last| {
            let mut served = *now;
            for (served, (last, step)) in served.iter_mut().zip(last.iter().zip(&self.step)) {
                let (way, most) = (*served - last, share * step);
                if way.abs() > most {
                    *served = last + most.copysign(way);
                }
            }
            served
        })
    }

    /// Stores the sent torque.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, answer: &Answer) {
        self.before = self.models.serving.is_some().then_some(answer.asked.now);
        self.sent = Some(answer.served);
        self.hand_over = answer.served != answer.asked.now;
    }

    /// Whether a model can be taken over: the ring has room for everything that it replaces.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn has_room(&self, retired: &Producer<Retired>) -> bool {
        self.spent.iter().all(Option::is_none) && retired.slots() >= ROOM
    }

    /// Puts `model` in service; only where there [is room](TorqueSource::has_room).
    pub fn serve(&mut self, model: Box<dyn FeedForward>, retired: &mut Producer<Retired>) {
        let id = model.id();
        for done in self.models.serve(id, model).into_iter().flatten() {
            let _ = retired.push(Retired::Model(done));
        }
        (self.before, self.hand_over, self.withdrawn) = (None, true, id == 0);
    }

    /// The serving model broke a limit. Returns its identity and that of its fallback, 0 for none; `None` where none served.
    pub fn fall_back(&mut self) -> Option<(u64, u64)> {
        let id = self.id();
        let broken = self.models.fall_back()?;
        // There is room: a model is only taken over while both places are free.
        if let Some(place) = self.spent.iter_mut().find(|place| place.is_none()) {
            *place = Some(broken);
        }
        (self.before, self.hand_over, self.withdrawn) = (None, true, self.models.serving.is_none());
        Some((id, self.id()))
    }

    /// Hands out models that broke a limit, as far as there is room.
    pub fn hand_out(&mut self, retired: &mut Producer<Retired>) {
        for place in &mut self.spent {
            let Some(broken) = place.take() else { continue };
            if let Err(PushError::Full(Retired::Model(broken))) = retired.push(Retired::Model(broken)) {
                *place = Some(broken);
            }
        }
    }
}

#[cfg(test)]
mod tests;
