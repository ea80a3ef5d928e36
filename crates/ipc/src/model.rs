//! Client of the served model: its text, the gravity that it is served with, and its validity.

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::error::IpcError;
use super::feed_forward::Presence;
use super::messages::{LAYOUT, ModelHeader};
use super::robot::RobotId;
use super::services::{self, ServiceNode};

/// Maximum values read in one call; the buffer holds one per daemon, running or ended.
const VALUES_PER_CALL: usize = 4;

/// The served model as the daemon published it last.
#[derive(Clone, Debug, PartialEq)]
pub struct ModelMessage {
    /// Identity, gravity and validity.
    pub header: ModelHeader,
    /// Text of the model file; empty where no model is served.
    pub text: String,
}

/// Client of the served model of one robot. Not `Send`. No call is for a real-time thread.
pub struct ModelClient {
    newest: Option<ModelHeader>,
    subscriber: Subscriber<ipc::Service, [u8], ModelHeader>,
    service: services::Model,
    node: ServiceNode,
}

impl ModelClient {
    /// Connects to the daemon of `robot`, waiting up to `timeout` for it to appear.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, timeout: Duration) -> Result<ModelClient, IpcError> {
        let start = Instant::now();
        let node = services::joining_node()?;
        let service = services::join_model(&node, robot, timeout)?;
        while service.dynamic_config().number_of_publishers() == 0 {
            if start.elapsed() >= timeout {
                return Err(services::no_daemon(robot, timeout));
            }
            thread::sleep(Duration::from_millis(1));
        }
        let name = services::model_name(robot);
        let subscriber = services::retry_until(&name, timeout.saturating_sub(start.elapsed()), || {
            Ok(service.subscriber_builder().buffer_size(1).create())
        })?;
        Ok(ModelClient { newest: None, subscriber, service, node })
    }

    /// The newest message that arrived since the last call, `None` for none.
    ///
    /// # Errors
    /// [`IpcError::Incompatible`] for a header of another layout, [`IpcError::Malformed`] for a text that is not UTF-8,
    /// [`IpcError::Transport`] when shared memory failed.
    pub fn receive(&mut self) -> Result<Option<ModelMessage>, IpcError> {
        let mut newest = None;
        for _ in 0..VALUES_PER_CALL {
            let received = self.subscriber.receive();
            let received = received.map_err(|error| services::transport("reading", "model", error))?;
            let Some(sample) = received else { break };
            let header = *sample.user_header();
            if header.layout != LAYOUT {
                let reason = format!("its layout is {}, this version reads {LAYOUT}", header.layout);
                return Err(IpcError::Incompatible { service: "model".into(), reason });
            }
            // The last message of an ended daemon may arrive after the first one of its successor.
            let is_newer = |old: ModelHeader| {
                header.stamp_ns >= old.stamp_ns && (header.epoch != old.epoch || header.sequence > old.sequence)
            };
            if self.newest.is_none_or(is_newer) {
                self.newest = Some(header);
                let text = std::str::from_utf8(sample.payload());
                let text = text.map_err(|error| IpcError::Malformed { what: "model", reason: error.to_string() })?;
                newest = Some(ModelMessage { header, text: text.into() });
            }
        }
        Ok(newest)
    }

    /// Whether the daemon's process runs. Reads files.
    pub fn daemon(&self) -> Presence {
        let mut state = Presence::Gone;
        self.service.dynamic_config().list_publishers(|details| {
            if services::runs(&self.node, details.node_id) {
                state = Presence::Running;
            }
            CallbackProgression::Continue
        });
        state
    }
}
