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
/// Timeout of the message that a daemon repeats every second.
const REPEAT_TIMEOUT: Duration = Duration::from_secs(5);

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
    /// Time of the last message of a daemon that repeats its message; those of earlier versions do not.
    repeated: Option<Instant>,
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
        Ok(ModelClient { newest: None, repeated: None, subscriber, service, node })
    }

    /// The newest message that arrived since the last call, `None` for none. Repeats of a message are not returned.
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
            let of = |header: &ModelHeader| (header.epoch, header.sequence);
            if self.newest.as_ref().map(of) == Some(of(&header)) {
                self.repeated = Some(Instant::now());
            } else if self.newest.is_none_or(|old| supersedes(&header, &old, self.is_silent())) {
                let same_daemon = self.newest.is_some_and(|old| old.epoch == header.epoch);
                self.repeated = self.repeated.filter(|_| same_daemon).map(|_| Instant::now());
                self.newest = Some(header);
                let text = std::str::from_utf8(sample.payload());
                let text = text.map_err(|error| IpcError::Malformed { what: "model", reason: error.to_string() })?;
                newest = Some(ModelMessage { header, text: text.into() });
            }
        }
        Ok(newest)
    }

    /// Whether a daemon runs: its process does (on another machine: that of the tunnel), and a daemon that has repeated its message has done so
    /// within 5 s, as [`ModelClient::receive`] found. Reads files.
    pub fn daemon(&self) -> Presence {
        let mut state = Presence::Gone;
        if self.is_silent() {
            return state;
        }
        self.service.dynamic_config().list_publishers(|details| {
            if services::runs(&self.node, details.node_id) {
                state = Presence::Running;
            }
            CallbackProgression::Continue
        });
        state
    }

    fn is_silent(&self) -> bool {
        self.repeated.is_some_and(|last| last.elapsed() > REPEAT_TIMEOUT)
    }
}

/// Whether a message is newer than the one before. The last message of an ended daemon may arrive after the first one of its successor; but if
/// the daemon before is silent and its machine was started again, the successor's stamps are of a clock that began anew.
fn supersedes(header: &ModelHeader, old: &ModelHeader, old_is_silent: bool) -> bool {
    if header.epoch == old.epoch {
        return header.sequence > old.sequence;
    }
    header.stamp_ns >= old.stamp_ns || old_is_silent
}

#[cfg(test)]
mod tests {
    use super::super::command::Response;
    use super::super::server::{Server, ServerSettings};
    use super::*;

    #[test]
    fn only_newer_messages_supersede() {
        let old = ModelHeader { epoch: 1, sequence: 5, stamp_ns: 100, ..ModelHeader::default() };
        assert!(supersedes(&ModelHeader { sequence: 6, ..old }, &old, false));
        assert!(!supersedes(&old, &old, true) && !supersedes(&ModelHeader { sequence: 4, ..old }, &old, true));

        let successor = ModelHeader { epoch: 2, sequence: 1, stamp_ns: 101, ..old };
        assert!(supersedes(&successor, &old, false) && !supersedes(&old, &successor, false));
        let rebooted = ModelHeader { stamp_ns: 3, ..successor };
        assert!(!supersedes(&rebooted, &old, false) && supersedes(&rebooted, &old, true));
    }

    /// Reads messages of one robot's daemon and publishes them under another's name, as a tunnel does on another machine.
    struct Tunnel {
        server: Server,
        near: Subscriber<ipc::Service, [u8], ModelHeader>,
        far: iceoryx2::port::publisher::Publisher<ipc::Service, [u8], ModelHeader>,
    }

    impl Tunnel {
        /// Passes `count` messages on, or none of them where the link is down.
        fn pass(&mut self, count: usize, link_is_up: bool) {
            let (start, mut passed) = (Instant::now(), 0);
            while passed < count {
                assert!(start.elapsed() < Duration::from_secs(60), "{passed} messages");
                self.server.poll(|_, _| Response::Accepted {});
                if let Some(sample) = self.near.receive().unwrap() {
                    passed += 1;
                    let mut memory = self.far.loan_slice_uninit(sample.payload().len()).unwrap();
                    *memory.user_header_mut() = *sample.user_header();
                    let filled = memory.write_from_slice(sample.payload());
                    if link_is_up {
                        filled.send().unwrap();
                    }
                }
                thread::sleep(Duration::from_millis(1));
            }
        }
    }

    #[test]
    fn a_client_behind_a_tunnel_gets_the_model_and_the_state_of_the_link_by_repeats() {
        let robot = |end: &str| RobotId::parse("test", "robot", &format!("test-{end}-{}", std::process::id())).unwrap();
        let (near, far) = (robot("near"), robot("far"));
        let mut server = Server::open(&near, ServerSettings { retain: 1, silent_ms: 1000 }).unwrap();
        server.model(ModelHeader { model: 7, ..ModelHeader::default() }, "text");
        let node = services::joining_node().unwrap();
        let (from, to) = (services::join_model(&node, &near, Duration::ZERO), services::serve_model(&node, &far));
        let near = from.unwrap().subscriber_builder().create().unwrap();
        let to = to.unwrap();
        let publisher = to.publisher_builder().initial_max_slice_len(100).create().unwrap();
        let mut tunnel = Tunnel { server, near, far: publisher };
        // The daemon's message of the model is read here before the client is there, and never published.
        tunnel.pass(1, false);
        let mut client = ModelClient::connect(&far, Duration::ZERO).unwrap();
        assert_eq!(client.receive().unwrap(), None);

        tunnel.pass(1, true);
        let message = client.receive().unwrap().unwrap();
        assert_eq!((message.header.model, message.header.sequence, message.text.as_str()), (7, 2, "text"));
        tunnel.pass(1, true);
        assert_eq!((client.receive().unwrap(), client.daemon()), (None, Presence::Running));

        // The link breaks, and is there again.
        tunnel.pass(REPEAT_TIMEOUT.as_secs() as usize + 1, false);
        assert_eq!((client.receive().unwrap(), client.daemon()), (None, Presence::Gone));
        tunnel.pass(1, true);
        assert_eq!((client.receive().unwrap(), client.daemon()), (None, Presence::Running));
    }
}
