//! The served model, followed: outside the control loop.

use crate::background::Background;
use crate::error::{Error, robot_id};
use crate::evaluation::Evaluation;
use crate::model::{Inbox, Model};
use nalgebra::Vector3;
use plumbline_core::{BadInput, Validity};
use plumbline_ipc::{ModelClient, ModelHeader, ModelMessage, Presence, boot_ns};
use plumbline_model::angle_between;
use plumbline_model_file::{ModelFile, model_identity, models};
use rtrb::{Consumer, Producer, PushError, RingBuffer};
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Largest angle between expected and served gravity \[rad\]: one degree.
const MAX_TILT: f64 = std::f64::consts::PI / 180.0;
/// Models on their way to the loop, and back from it.
const MODELS: usize = 2;
/// Interval of the thread that follows.
const INTERVAL: Duration = Duration::from_millis(10);

/// What the caller expects of the served model; `None` accepts any.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Expected {
    /// Robot of the model, as in the key `robot` of its file.
    pub robot: Option<String>,
    /// Gravity on the arm \[m/s2\]. A model that is served with a gravity more than one degree away is refused.
    pub gravity: Option<[f64; 3]>,
}

/// What has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A model was handed to the loop, also the same one under another gravity.
    Served {
        /// Its identity.
        model: u64,
    },
    /// The daemon serves no model any more. The loop keeps its last one; see [`Status::validity`](crate::Status::validity).
    Withdrawn,
    /// The measured torques contradict the model, and no model has the change yet.
    Doubtful,
    /// Another daemon runs: the one before has ended.
    Restarted {
        /// Identity of its start.
        epoch: u64,
    },
}

/// What both ends know.
pub(crate) struct Shared {
    validity: AtomicU32,
    seen_ns: AtomicU64,
    /// For the thread that follows and for [`Model::trouble`]; never touched by the loop.
    trouble: Mutex<Option<Error>>,
}

impl Shared {
    pub fn valid() -> Shared {
        let validity = AtomicU32::new(Validity::Valid as u32);
        Shared { validity, seen_ns: AtomicU64::new(0), trouble: Mutex::new(None) }
    }

    pub fn validity(&self) -> Validity {
        Validity::from_u32(self.validity.load(Ordering::Relaxed)).unwrap_or_default()
    }

    pub fn seen_ns(&self) -> u64 {
        self.seen_ns.load(Ordering::Relaxed)
    }

    pub fn trouble(&self) -> Option<Error> {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_trouble(&self, trouble: Option<Error>) {
        *self.trouble.lock().unwrap_or_else(PoisonError::into_inner) = trouble;
    }
}

/// Follows the model of one daemon and hands it to a [`Model`]. Not `Send`; no call is for the control loop.
pub struct Follower {
    robot: String,
    expected: Expected,
    client: ModelClient,
    shared: Arc<Shared>,
    models: Producer<Box<Evaluation>>,
    retired: Consumer<Box<Evaluation>>,
    /// A model that the loop has no room for yet.
    waiting: Option<Box<Evaluation>>,
    newest: Option<ModelHeader>,
}

impl Follower {
    /// Connects to the daemon of `robot` (key `serve.id` of its job), waiting up to `timeout` for it.
    ///
    /// # Errors
    /// [`Error::Ipc`]: no daemon, another layout of its messages, no slot left; [`Error::Input`] for a name that is no robot's.
    pub fn connect(robot: &str, expected: Expected, timeout: Duration) -> Result<(Follower, Model), Error> {
        let client = ModelClient::connect(&robot_id(robot)?, timeout)?;
        let (models, served) = RingBuffer::new(MODELS);
        let (retire, retired) = RingBuffer::new(MODELS);
        let shared = Arc::new(Shared::valid());
        shared.validity.store(Validity::None as u32, Ordering::Relaxed);
        let model = Model::of(None, Some(Inbox { models: served, retired: retire }), Arc::clone(&shared));
        let (robot, waiting, newest) = (robot.to_string(), None, None);
        Ok((Follower { robot, expected, client, shared, models, retired, waiting, newest }, model))
    }

    /// Takes what has arrived, hands a new model to the loop and frees replaced ones; what has changed. Call it some times per second. Making
    /// a model ready takes milliseconds.
    ///
    /// # Errors
    /// The loop keeps its model after every error. [`Error::DaemonGone`] until a daemon sends again; [`Error::OtherRobot`],
    /// [`Error::OtherMounting`], [`Error::Damaged`], [`Error::Input`], [`Error::Ipc`] once per refused model.
    pub fn poll(&mut self) -> Result<Vec<Change>, Error> {
        while self.retired.pop().is_ok() {}
        let mut changes = Vec::new();
        if let Some(message) = self.client.receive()? {
            self.take(&message, &mut changes)?;
        }
        if let Some(model) = self.waiting.take()
            && let Err(PushError::Full(model)) = self.models.push(model)
        {
            self.waiting = Some(model);
        }
        if self.client.daemon() == Presence::Gone {
            return if changes.is_empty() { Err(Error::DaemonGone { robot: self.robot.clone() }) } else { Ok(changes) };
        }
        self.shared.seen_ns.store(boot_ns(), Ordering::Relaxed);
        Ok(changes)
    }

    fn take(&mut self, message: &ModelMessage, changes: &mut Vec<Change>) -> Result<(), Error> {
        let ModelMessage { header, text } = message;
        let before = self.newest.replace(*header);
        if before.is_some_and(|before| before.epoch != header.epoch) {
            changes.push(Change::Restarted { epoch: header.epoch });
        }
        let of = |header: &ModelHeader| (header.model, header.gravity);
        if header.model != 0 && before.as_ref().map(of) != Some(of(header)) {
            let evaluation = self.ready(header, text)?;
            self.waiting = Some(Box::new(evaluation));
            changes.push(Change::Served { model: header.model });
        }
        let validity = header.validity().unwrap_or_default();
        // A daemon that has no model yet takes none away: the loop has the one of the daemon before.
        let validity = if validity == Validity::None && before.is_some() { Validity::Withdrawn } else { validity };
        self.shared.validity.store(validity as u32, Ordering::Relaxed);
        match validity {
            Validity::Withdrawn => changes.push(Change::Withdrawn),
            Validity::Doubtful => changes.push(Change::Doubtful),
            Validity::None | Validity::Valid | Validity::HandOver => {}
        }
        Ok(())
    }

    /// The model of a message, checked against what is expected and made ready.
    fn ready(&self, header: &ModelHeader, text: &str) -> Result<Evaluation, Error> {
        let found = model_identity(text);
        if found != header.model {
            return Err(Error::Damaged { model: header.model, found });
        }
        if let Some(expected) = self.expected.gravity {
            let [expected, served] = [expected, header.gravity].map(Vector3::from);
            let angle = angle_between(&expected, &served);
            // Also what is not a number.
            if !matches!(angle.partial_cmp(&MAX_TILT), Some(std::cmp::Ordering::Less)) {
                let (served, expected) = (served.as_slice(), expected.as_slice());
                return Err(Error::OtherMounting(format!(
                    "the model is served with gravity {served:?} m/s2, expected {expected:?} within one degree"
                )));
            }
        }
        let (file, _) = models::parse("served model", text, None)?;
        let found = file.model.robot();
        if let Some(expected) = self.expected.robot.as_ref().filter(|expected| *expected != found) {
            return Err(Error::OtherRobot { expected: expected.clone(), found: found.into() });
        }
        Evaluation::new(header.model, file, header.gravity)
    }
}

/// A model file with its identity.
pub(crate) fn read(path: &Path) -> Result<(u64, ModelFile), Error> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path);
    let text = text.map_err(|error| BadInput::new(&file, "file", error, "a readable model file"))?;
    let (model, _) = models::parse(&file, &text, path.parent())?;
    Ok((model_identity(&text), model))
}

/// A model that a thread of its own follows.
pub(crate) fn follow(robot: &str, expected: Expected, timeout: Duration) -> Result<(Model, Background), Error> {
    let robot = robot.to_string();
    Background::start("plumbline-follow", INTERVAL, move || {
        let start = Instant::now();
        let (mut follower, model) = Follower::connect(&robot, expected, timeout)?;
        // Whether the wait is over: a model was served or refused.
        let mut step = move || match follower.poll() {
            Ok(changes) => {
                let served = changes.iter().any(|change| matches!(change, Change::Served { .. }));
                // `poll` reports a refused model once. The error stays until another model is served.
                if served || !follower.shared.trouble().is_some_and(|trouble| trouble.refuses_model()) {
                    follower.shared.set_trouble(None);
                }
                served
            }
            Err(error) => {
                let refused = error.refuses_model();
                follower.shared.set_trouble(Some(error));
                refused
            }
        };
        while !step() && start.elapsed() < timeout {
            std::thread::sleep(Duration::from_millis(1));
        }
        let repeat = move || {
            step();
        };
        Ok((model, repeat))
    })
}
