//! A client of the command service.

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::client::Client as RequestClient;
use iceoryx2::prelude::*;

use super::command::{self, Envelope, MAX_REQUEST_BYTES, MAX_RESPONSE_BYTES, Request, Response};
use super::error::IpcError;
use super::robot::RobotId;
use super::runtime_dir;
use super::services::{self, ServiceNode, transport};

/// First size of a request's memory; it grows when a model is offered \[bytes\].
const REQUEST_BYTES: usize = 1024;
/// Pause between two looks for an answer.
const PAUSE: Duration = Duration::from_micros(500);

/// Sends requests to the daemon of one robot. Not `Send`.
pub struct Client {
    robot: RobotId,
    /// The start of the daemon that requests are meant for; any where this is `None`.
    epoch: Option<u64>,
    port: RequestClient<ipc::Service, [u8], (), [u8], ()>,
    service: services::Commands,
    node: ServiceNode,
}

impl Client {
    /// Connects to the daemon of `robot`, waiting up to `patience` for it to appear. The last places are left to operators.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, patience: Duration) -> Result<Client, IpcError> {
        Client::connect_up_to(services::MAX_COMMAND_CLIENTS - services::OPERATORS, robot, patience)
    }

    /// The same for an operator, whose place no program takes.
    ///
    /// # Errors
    /// As [`Client::connect`].
    pub fn connect_operator(robot: &RobotId, patience: Duration) -> Result<Client, IpcError> {
        Client::connect_up_to(services::MAX_COMMAND_CLIENTS, robot, patience)
    }

    fn connect_up_to(places: usize, robot: &RobotId, patience: Duration) -> Result<Client, IpcError> {
        let start = Instant::now();
        let node = services::joining_node()?;
        let service = services::join_commands(&node, robot, patience)?;
        while service.dynamic_config().number_of_servers() == 0 {
            if start.elapsed() >= patience {
                return Err(services::no_daemon(robot, patience));
            }
            thread::sleep(PAUSE);
        }
        let name = services::command_name(robot);
        while service.dynamic_config().number_of_clients() >= places {
            if start.elapsed() >= patience {
                return Err(services::full(&name, &service));
            }
            thread::sleep(PAUSE);
        }
        let port = services::patiently(&name, patience.saturating_sub(start.elapsed()), || {
            let builder = service.client_builder().initial_max_slice_len(REQUEST_BYTES);
            let builder = builder.allocation_strategy(AllocationStrategy::PowerOfTwo);
            Ok(builder.backpressure_strategy(BackpressureStrategy::DiscardData).create())
        });
        let port = port.map_err(|error| match error {
            IpcError::Full { .. } => services::full(&name, &service),
            other => other,
        })?;
        Ok(Client { robot: robot.clone(), epoch: None, port, service, node })
    }

    /// Requests from now on are meant for this start of the daemon, [`Served::epoch`](super::Served::epoch), alone: any other refuses them.
    pub fn bind(&mut self, epoch: u64) {
        self.epoch = Some(epoch);
    }

    /// Sends `request` and waits up to `timeout` for the answer.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`] when the daemon has ended, [`IpcError::NoAnswer`] when it is there but does not answer,
    /// [`IpcError::TooLong`], [`IpcError::Malformed`], [`IpcError::Transport`].
    pub fn send(&mut self, request: &Request, timeout: Duration) -> Result<Response, IpcError> {
        let envelope = Envelope { epoch: self.epoch, request: request.clone() };
        let bytes = command::encode("request", &envelope, MAX_REQUEST_BYTES)?;
        self.send_bytes(&bytes, timeout)
    }

    /// Sends a request that is JSON already, as a script would.
    ///
    /// # Errors
    /// As [`Client::send`].
    pub fn send_bytes(&mut self, bytes: &[u8], timeout: Duration) -> Result<Response, IpcError> {
        let name = services::command_name(&self.robot);
        if let Some(full) = runtime_dir::no_room().filter(|_| bytes.len() > REQUEST_BYTES) {
            return Err(transport("asking", &name, full));
        }
        let memory = self.port.loan_slice_uninit(bytes.len()).map_err(|error| transport("asking", &name, error))?;
        let pending = memory.write_from_slice(bytes).send().map_err(|error| transport("asking", &name, error))?;
        if pending.number_of_server_connections() == 0 {
            // No one took it: there is no daemon, or one that is too busy to have read our earlier requests.
            return Err(self.silence(Duration::ZERO));
        }
        let start = Instant::now();
        loop {
            if let Some(answer) = pending.receive().map_err(|error| transport("hearing", &name, error))? {
                return command::decode("answer", answer.payload(), MAX_RESPONSE_BYTES);
            }
            if start.elapsed() >= timeout {
                return Err(self.silence(timeout));
            }
            thread::sleep(PAUSE);
        }
    }

    /// What a missing answer means: a daemon that is gone, or one that is busy.
    fn silence(&self, waited: Duration) -> IpcError {
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
