//! Client of the command service.

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::client::Client as RequestClient;
use iceoryx2::prelude::*;

use super::command::{self, Envelope, MAX_REQUEST_BYTES, MAX_RESPONSE_BYTES, Request, Response};
use super::error::IpcError;
use super::robot::RobotId;
use super::runtime_dir;
use super::services::{self, ServiceNode, transport};

/// Initial size of a request's memory; a model makes it grow \[bytes\].
const INITIAL_REQUEST_BYTES: usize = 1024;
const POLL_INTERVAL: Duration = Duration::from_micros(500);

/// Client of the daemon of one robot. Not `Send`.
pub struct Client {
    robot: RobotId,
    /// Epoch that requests are bound to; `None` for any.
    epoch: Option<u64>,
    port: RequestClient<ipc::Service, [u8], (), [u8], ()>,
    service: services::Commands,
    node: ServiceNode,
}

impl Client {
    /// Connects to the daemon of `robot`, waiting up to `timeout` for it to appear. The last client slots are reserved for operators.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, timeout: Duration) -> Result<Client, IpcError> {
        Client::connect_up_to(services::MAX_COMMAND_CLIENTS - services::RESERVED_OPERATORS, robot, timeout)
    }

    /// Connects as an operator: uses the reserved client slots too.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn connect_operator(robot: &RobotId, timeout: Duration) -> Result<Client, IpcError> {
        Client::connect_up_to(services::MAX_COMMAND_CLIENTS, robot, timeout)
    }

    fn connect_up_to(slots: usize, robot: &RobotId, timeout: Duration) -> Result<Client, IpcError> {
        let start = Instant::now();
        let node = services::joining_node()?;
        let service = services::join_commands(&node, robot, timeout)?;
        while service.dynamic_config().number_of_servers() == 0 {
            if start.elapsed() >= timeout {
                return Err(services::no_daemon(robot, timeout));
            }
            thread::sleep(POLL_INTERVAL);
        }
        let name = services::command_name(robot);
        while service.dynamic_config().number_of_clients() >= slots {
            if start.elapsed() >= timeout {
                return Err(services::full(&name, &service));
            }
            thread::sleep(POLL_INTERVAL);
        }
        let port = services::retry_until(&name, timeout.saturating_sub(start.elapsed()), || {
            let builder = service.client_builder().initial_max_slice_len(INITIAL_REQUEST_BYTES);
            let builder = builder.allocation_strategy(AllocationStrategy::PowerOfTwo);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        });
        let port = port.map_err(|error| match error {
            IpcError::Full { .. } => services::full(&name, &service),
            other => other,
        })?;
        Ok(Client { robot: robot.clone(), epoch: None, port, service, node })
    }

    /// Binds later requests to this epoch, [`Served::epoch`](super::Served::epoch): a daemon of another epoch refuses them.
    pub fn bind(&mut self, epoch: u64) {
        self.epoch = Some(epoch);
    }

    /// Sends `request` and waits up to `timeout` for the response.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`] when the daemon has ended, [`IpcError::NoAnswer`] when it runs but does not respond,
    /// [`IpcError::TooLong`], [`IpcError::Malformed`], [`IpcError::Transport`].
    pub fn send(&mut self, request: &Request, timeout: Duration) -> Result<Response, IpcError> {
        let envelope = Envelope { epoch: self.epoch, request: request.clone() };
        let bytes = command::encode("request", &envelope, MAX_REQUEST_BYTES)?;
        self.send_bytes(&bytes, timeout)
    }

    /// Sends a request that is already encoded as JSON.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn send_bytes(&mut self, bytes: &[u8], timeout: Duration) -> Result<Response, IpcError> {
        let name = services::command_name(&self.robot);
        if let Some(full) = runtime_dir::shared_memory_full().filter(|_| bytes.len() > INITIAL_REQUEST_BYTES) {
            return Err(transport("sending a request to", &name, full));
        }
        let memory = self
            .port
            .loan_slice_uninit(bytes.len())
            .map_err(|error| transport("sending a request to", &name, error))?;
        let pending =
            memory.write_from_slice(bytes).send().map_err(|error| transport("sending a request to", &name, error))?;
        if pending.number_of_server_connections() == 0 {
            // Not delivered: no daemon, or the daemon has not yet read earlier requests.
            return Err(self.no_response(Duration::ZERO));
        }
        let start = Instant::now();
        loop {
            if let Some(answer) =
                pending.receive().map_err(|error| transport("receiving a response from", &name, error))?
            {
                return command::decode("answer", answer.payload(), MAX_RESPONSE_BYTES);
            }
            if start.elapsed() >= timeout {
                return Err(self.no_response(timeout));
            }
            thread::sleep(POLL_INTERVAL);
        }
    }

    /// Error for a missing response: `NoDaemon` where its process has ended, else `NoAnswer`.
    fn no_response(&self, waited: Duration) -> IpcError {
        let mut alive = false;
        self.service.dynamic_config().list_servers(|details| {
            alive |= services::runs(&self.node, details.node_id);
            CallbackProgression::Continue
        });
        if !alive {
            return services::no_daemon(&self.robot, waited);
        }
        IpcError::NoAnswer { robot: self.robot.to_string(), waited_ms: waited.as_millis() as u64 }
    }
}
