//! The model in the control loop.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use crate::background::Background;
use crate::error::{Error, Fault};
use crate::evaluation::Evaluation;
use crate::follower::{Expected, Shared, follow, read};
use plumbline_core::{JointVec, Validity};
use plumbline_identify::external::{External, ObserverSettings, Way};
use plumbline_ipc::boot_ns;
use plumbline_model::term::Sample;
use rtrb::{Consumer, Producer};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// The model as the loop has it at this moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Identity of the model that the next call uses, 0 for none.
    pub model: u64,
    /// Validity of the daemon's model by its last message; [`Validity::Valid`] for a file.
    pub validity: Validity,
    /// Time since the follower last found the daemon running \[ns\] (on another machine it finds the end after 5 s); 0 for a file. A model stays usable when the daemon has ended, but
    /// nothing contradicts it any more.
    pub age_ns: u64,
}

/// The loop's end of the hand-over: `hil/loom` runs these two rings under every order of events.
pub(crate) struct Inbox {
    pub models: Consumer<Box<Evaluation>>,
    /// Replaced models, which another thread frees.
    pub retired: Producer<Box<Evaluation>>,
}

/// The identified model of an arm's torques, evaluated at the caller's states.
///
/// A model that is followed is replaced between two calls: every answer is the old model's or the new one's. The torque changes at once; a
/// controller that needs a ramp makes its own.
///
/// **Terms with a memory** (presliding, backlash, delay, elasticity) take every call of [`Model::torque`] as the next sample, one period
/// after the one before: call it once per cycle with the state of that cycle. Their memory is empty before the first call and after a new
/// model. For states that are not the arm's (planning, simulation) make a second `Model`. The regressor and the standard deviation have a
/// memory of their own with the same rule; all other calls have none.
///
/// Arrays have one entry per joint. Angles in rad, torques in Nm (prismatic joints: m, N). Acceleration of gravity is in the base frame.
pub struct Model {
    evaluation: Option<Box<Evaluation>>,
    inbox: Option<Inbox>,
    shared: Arc<Shared>,
    observer: ObserverSettings,
    /// The thread that follows the daemon, where this model has its own.
    background: Option<Background>,
}

impl Model {
    /// The model of a file under `gravity` \[m/s2\], for example `[0.0, 0.0, -9.81]` upright.
    ///
    /// # Errors
    /// [`Error::Input`] for a file that can't be used, [`Error::OtherMounting`] where the model is not valid under this gravity.
    pub fn load(path: &Path, gravity: [f64; 3]) -> Result<Model, Error> {
        let (id, file) = read(path)?;
        Ok(Model::of(Some(Evaluation::new(id, file, gravity)?), None, Arc::new(Shared::valid())))
    }

    /// The model that the daemon of `robot` serves; a thread of its own follows it until the model is dropped. Waits up to `timeout` for the
    /// daemon and for its model. Without a model in time, or with one that is refused ([`Model::trouble`]), calls return [`Fault::NoModel`] until
    /// one is served.
    ///
    /// # Errors
    /// As [`Follower::connect`](crate::Follower::connect), and [`Error::Thread`].
    pub fn follow(robot: &str, expected: Expected, timeout: Duration) -> Result<Model, Error> {
        let (mut model, background) = follow(robot, expected, timeout)?;
        model.background = Some(background);
        Ok(model)
    }

    pub(crate) fn of(evaluation: Option<Evaluation>, inbox: Option<Inbox>, shared: Arc<Shared>) -> Model {
        Model {
            evaluation: evaluation.map(Box::new),
            inbox,
            shared,
            observer: ObserverSettings::default(),
            background: None,
        }
    }

    /// What the thread that follows the daemon has last failed at; `None` while it succeeds. The error of a refused model stays until another one
    /// is served. Locks: not for the control loop.
    pub fn trouble(&self) -> Option<Error> {
        self.shared.trouble()
    }

    /// Sets the period of the calls for terms with a memory and for [`Model::external`] \[s\]; 1 ms before.
    pub fn set_period(&mut self, period: f64) {
        self.observer.dt = period;
        let settings = self.observer;
        self.evaluation.iter_mut().for_each(|own| take_up(own, settings));
    }

    /// Sets how the external torque is found: half-power frequency of its low-pass \[Hz\] (20 before), false alarms an hour that are accepted over all
    /// joints (0.1 before), way (by momentum before). The observer begins anew.
    ///
    /// # Errors
    /// [`Fault::Setting`]; the settings before stay.
    pub fn set_observer(&mut self, way: Way, bandwidth: f64, false_alarms: f64) -> Result<(), Fault> {
        let settings = ObserverSettings { way, bandwidth, false_alarms, dt: self.observer.dt };
        settings.check().map_err(|_| Fault::Setting)?;
        self.observer = settings;
        self.evaluation.as_mut().map_or(Ok(()), |own| own.observe(settings))
    }

    /// Takes over a model that has arrived. Wait-free.
    fn current(&mut self) -> Result<&mut Evaluation, Fault> {
        if let Some(Inbox { models, retired }) = &mut self.inbox {
            // As many as the ring holds.
            while !retired.is_full()
                && let Ok(mut new) = models.pop()
            {
                take_up(&mut new, self.observer);
                if let Some(old) = self.evaluation.replace(new) {
                    // There is room.
                    let _ = retired.push(old);
                }
            }
        }
        self.evaluation.as_deref_mut().ok_or(Fault::NoModel)
    }

    /// Takes over a model that has arrived; its identity, and what is known of the daemon.
    pub fn status(&mut self) -> Status {
        let model = self.current().map_or(0, |own| own.id);
        let seen = self.shared.seen_ns();
        let age_ns = if self.inbox.is_some() { boot_ns().saturating_sub(seen) } else { 0 };
        Status { model, validity: self.shared.validity(), age_ns }
    }

    /// Number of joints of the arm.
    ///
    /// # Errors
    /// [`Fault::NoModel`].
    pub fn joints(&mut self) -> Result<usize, Fault> {
        self.current().map(|own| own.joints)
    }

    /// Torque that the arm needs at a state, `tau = Y(q, dq, ddq, g) beta` with all terms of the model, n values \[Nm\].
    ///
    /// `gravity` is the model's own where `None`: that of [`Model::load`], or the one that the daemon serves it with. Another one can be given
    /// to models whose terms all have a closed form (rigid links, friction, rotors, offsets).
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`], [`Fault::FixedGravity`], [`Fault::Mounting`].
    pub fn torque(
        &mut self,
        q: &[f64],
        dq: &[f64],
        ddq: &[f64],
        gravity: Option<[f64; 3]>,
        tau: &mut [f64],
    ) -> Result<(), Fault> {
        let own = self.current()?;
        let n = own.joints;
        check_length(tau, n)?;
        let sample = Sample { q: padded(q, n)?, dq: padded(dq, n)?, ddq: padded(ddq, n)? };
        write(&own.torque(&sample, gravity)?, tau);
        Ok(())
    }

    /// Torque of gravity on links and bodies on the last link at rest at `q`, under the model's own gravity, n values \[Nm\].
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn gravity(&mut self, q: &[f64], tau: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        check_length(tau, own.joints)?;
        write(&own.gravity(&padded(q, own.joints)?), tau);
        Ok(())
    }

    /// Centrifugal and Coriolis torques `C(q, dq) dq`, n values \[Nm\].
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn coriolis(&mut self, q: &[f64], dq: &[f64], tau: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        check_length(tau, own.joints)?;
        write(&own.coriolis(&padded(q, own.joints)?, &padded(dq, own.joints)?), tau);
        Ok(())
    }

    /// Viscous and Coulomb friction `fv dq + fc tanh(100 dq)`, n values \[Nm\]. Effects that diagnosis has added (Stribeck, presliding, friction
    /// under load) depend on more than the velocity or replace a part of it: they are part of [`Model::torque`] only.
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn friction(&mut self, dq: &[f64], tau: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        check_length(tau, own.joints)?;
        write(&own.friction(&padded(dq, own.joints)?), tau);
        Ok(())
    }

    /// Joint-space inertia matrix `M(q)` of links, bodies on the last link and rotors, n x n values (symmetric) \[kg m2\].
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn inertia(&mut self, q: &[f64], matrix: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        let n = own.joints;
        check_length(matrix, n * n)?;
        let q = padded(q, n)?;
        for (j, column) in matrix.chunks_exact_mut(n.max(1)).enumerate() {
            write(&own.inertia_column(&q, j), column);
        }
        Ok(())
    }

    /// Number of columns of the regressor: the parameters of the model file, in its order.
    ///
    /// # Errors
    /// [`Fault::NoModel`].
    pub fn columns(&mut self) -> Result<usize, Fault> {
        self.current().map(|own| own.columns())
    }

    /// Regressor `Y(q, dq, ddq, g)` under the model's own gravity, n x p values column after column: `tau = Y beta`.
    ///
    /// # Errors
    /// [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn regressor(&mut self, q: &[f64], dq: &[f64], ddq: &[f64], y: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        let n = own.joints;
        check_length(y, n * own.columns())?;
        let sample = Sample { q: padded(q, n)?, dq: padded(dq, n)?, ddq: padded(ddq, n)? };
        for (to, column) in y.chunks_exact_mut(n.max(1)).zip(own.regressor(&sample)) {
            write(column, to);
        }
        Ok(())
    }

    /// Standard deviation of the model's torque by the covariance of its parameters, `sqrt(y C y')` with `y` a joint's row of the regressor,
    /// n values \[Nm\]. The scatter of one measured sample is not part of it.
    ///
    /// # Errors
    /// [`Fault::NoUncertainty`], [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn torque_std(&mut self, q: &[f64], dq: &[f64], ddq: &[f64], std: &mut [f64]) -> Result<(), Fault> {
        let own = self.current()?;
        let n = own.joints;
        check_length(std, n)?;
        let sample = Sample { q: padded(q, n)?, dq: padded(dq, n)?, ddq: padded(ddq, n)? };
        write(&own.std(&sample)?, std);
        Ok(())
    }

    /// External torque: measured less modelled torque, with its 95 % interval and a flag for contact ([`External`]). Measured position \[rad\], velocity
    /// \[rad/s\] and torque \[Nm\], n values each. A force `f` on the arm at a point with Jacobian `J` gives `-J' f`.
    ///
    /// Call it once per cycle. It has a memory of its own: the first 60 ms after the first call and after a new model are not `settled`, and its values are
    /// those of 11 ms before (at 20 Hz; [`Model::set_observer`]). Gravity is the model's own.
    ///
    /// # Errors
    /// [`Fault::NoUncertainty`], [`Fault::NoModel`], [`Fault::Length`], [`Fault::NotFinite`].
    pub fn external(&mut self, q: &[f64], dq: &[f64], tau: &[f64]) -> Result<External, Fault> {
        let own = self.current()?;
        let n = own.joints;
        own.external(&padded(q, n)?, &padded(dq, n)?, &padded(tau, n)?)
    }
}

/// Gives an evaluation the caller's settings.
fn take_up(own: &mut Evaluation, settings: ObserverSettings) {
    own.every(settings.dt);
    // They were checked; a period that they do not fit leaves the observer as it is.
    let _ = own.observe(settings);
}

fn check_length(values: &[f64], expected: usize) -> Result<(), Fault> {
    if values.len() == expected { Ok(()) } else { Err(Fault::Length { expected, found: values.len() }) }
}

/// `values` of `n` joints, finite, with zeros after them.
pub(crate) fn padded(values: &[f64], n: usize) -> Result<JointVec, Fault> {
    check_length(values, n)?;
    if !values.iter().all(|value| value.is_finite()) {
        return Err(Fault::NotFinite);
    }
    let mut all = JointVec::default();
    all.iter_mut().zip(values).for_each(|(to, value)| *to = *value);
    Ok(all)
}

fn write(from: &JointVec, to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, value)| *to = *value);
}
