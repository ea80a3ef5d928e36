//! Opening a session: sockets, version, first state, one answer per request. Everything that may block or allocate.

use super::cycle::{Received, StateLink};
use super::error::ConnectError;
use super::hints;
use super::settings::{RobotKind, Settings};
use super::tcp::CommandLink;
use super::wire::{
    COMMAND_PORT, CommandKind, Connect, ConnectStatus, Connected, Protocol, Request, Response, RobotModelStatus,
    RobotState, SetterStatus,
};
use plumbline_rt::os;
use std::net::{SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

/// An open session, no motion running.
pub(super) struct Session {
    pub protocol: Protocol,
    pub commands: CommandLink,
    pub states: StateLink,
    /// The first state.
    pub first: RobotState,
    /// Socket options that the system refused.
    pub refused: Vec<String>,
    timeout: Duration,
}

/// Versions to begin with, the likeliest for the robot first.
fn first_guess(robot: RobotKind) -> Protocol {
    match robot {
        RobotKind::Panda => Protocol::V5,
        RobotKind::Fr3 => Protocol::V10,
    }
}

impl Session {
    /// Connects, settles the version, and waits for the first state.
    pub fn open(settings: &Settings) -> Result<Session, ConnectError> {
        settings.check()?;
        let guess = first_guess(settings.robot);
        let (protocol, commands, socket, refused) = match attempt(settings, guess)? {
            Attempt::Open(open) => open,
            // An arm of another version closes the connection: once more in its own.
            Attempt::Speaks(version) => {
                let theirs = Protocol::from_number(version)
                    .filter(|theirs| *theirs != guess)
                    .ok_or(ConnectError::Version { robot: version, tried: guess.number() })?;
                match attempt(settings, theirs)? {
                    Attempt::Open(open) => open,
                    Attempt::Speaks(robot) => return Err(ConnectError::Version { robot, tried: theirs.number() }),
                }
            }
        };
        let expected = match (settings.robot, protocol) {
            (RobotKind::Panda, Protocol::V9 | Protocol::V10) => Some("Panda"),
            (RobotKind::Fr3, Protocol::V5) => Some("FR3"),
            _ => None,
        };
        if let Some(expected) = expected {
            return Err(ConnectError::Robot { expected, protocol });
        }
        let address = settings.address;
        let port = socket.local_addr().map_or(0, |local| local.port());
        let cant = |cause| ConnectError::Socket { address, what: "setting a time limit", cause };
        let mut states = StateLink::new(socket, address, protocol).map_err(cant)?;
        let first = next_state(&mut states, settings.connect_timeout);
        let first = first.ok_or_else(|| ConnectError::NoStates {
            port,
            waited: settings.connect_timeout,
            hint: match states.damaged() {
                Some(bytes) => hints::damaged(protocol, bytes),
                None => hints::no_states(&hints::route_to(address), protocol, port, states.other_sender()),
            },
        })?;
        Ok(Session { protocol, commands, states, first, refused, timeout: settings.connect_timeout })
    }

    /// A state that is newer than `id`.
    pub fn newer_than(&mut self, id: u64) -> Option<RobotState> {
        let deadline = Instant::now() + self.timeout;
        loop {
            let state = next_state(&mut self.states, deadline.saturating_duration_since(Instant::now()))?;
            if state.message_id > id {
                return Some(state);
            }
        }
    }

    /// Sends a setter and checks its answer.
    pub fn set(&mut self, request: &Request) -> Result<(), ConnectError> {
        let command = request.kind();
        let payload = self.commands.call(self.protocol, request, self.timeout)?;
        match Response::decode(self.protocol, command, &payload)? {
            Response::Setter(_, SetterStatus::Success) => Ok(()),
            Response::Setter(_, status) => Err(ConnectError::Refused { command, status }),
            // The answer is decoded by the command, so this can't be.
            _ => Err(ConnectError::Closed { command }),
        }
    }

    /// The arm's description as URDF; `None` at version 5, which has none.
    pub fn description(&mut self) -> Result<Option<String>, ConnectError> {
        let command = CommandKind::GetRobotModel;
        if command.number(self.protocol).is_none() {
            return Ok(None);
        }
        let payload = self.commands.call(self.protocol, &Request::GetRobotModel, self.timeout)?;
        match Response::decode(self.protocol, command, &payload)? {
            Response::GetRobotModel { status: RobotModelStatus::Success, urdf } => Ok(Some(urdf.to_string())),
            Response::GetRobotModel { status, .. } => Err(ConnectError::NoDescription { what: status.to_string() }),
            _ => Err(ConnectError::Closed { command }),
        }
    }
}

fn next_state(states: &mut StateLink, timeout: Duration) -> Option<RobotState> {
    let deadline = Instant::now() + timeout;
    loop {
        match states.receive(true) {
            Received::State(state, _) => return Some(state),
            Received::Broken => return None,
            Received::Bad | Received::Foreign | Received::Nothing => {}
        }
        if Instant::now() >= deadline {
            return None;
        }
    }
}

enum Attempt {
    Open((Protocol, CommandLink, UdpSocket, Vec<String>)),
    Speaks(u16),
}

fn attempt(settings: &Settings, protocol: Protocol) -> Result<Attempt, ConnectError> {
    let address = settings.address;
    let timeout = settings.connect_timeout;
    let stream = TcpStream::connect_timeout(&SocketAddr::new(address, COMMAND_PORT), timeout).map_err(|cause| {
        let hint = hints::unreachable(&hints::route_to(address), cause.kind());
        ConnectError::Unreachable { address, cause, hint }
    })?;
    let cant = |what| move |cause| ConnectError::Socket { address, what, cause };
    stream.set_nodelay(true).map_err(cant("switching delays off"))?;
    keep_alive(&stream).map_err(cant("switching keep-alive on"))?;
    // States come to the address that the arm sees, and to no other.
    let local = stream.local_addr().map_err(cant("asking for its address"))?;
    let socket = UdpSocket::bind((local.ip(), 0)).map_err(cant("binding a UDP port"))?;
    let udp_port = socket.local_addr().map_err(cant("asking for its port"))?.port();
    let refused = set_options(settings, &socket);

    let mut commands = CommandLink::new(stream);
    let request = Request::Connect(Connect { version: protocol.number(), udp_port });
    let payload = commands.call(protocol, &request, timeout)?;
    let answer = Connected::decode(&payload)?;
    Ok(match answer.status {
        ConnectStatus::Success => Attempt::Open((protocol, commands, socket, refused)),
        ConnectStatus::IncompatibleVersion => Attempt::Speaks(answer.version),
    })
}

/// As libfranka sets it: a lost peer is detected after some four seconds.
fn keep_alive(stream: &TcpStream) -> std::io::Result<()> {
    use rustix::net::sockopt;
    sockopt::set_socket_keepalive(stream, true)?;
    sockopt::set_tcp_keepidle(stream, Duration::from_secs(1))?;
    sockopt::set_tcp_keepintvl(stream, Duration::from_secs(1))?;
    sockopt::set_tcp_keepcnt(stream, 3)?;
    Ok(())
}

/// Applies the options and names those that the system refused.
fn set_options(settings: &Settings, socket: &UdpSocket) -> Vec<String> {
    let mut refused = Vec::new();
    let mut note = |what: String, done: std::io::Result<()>| {
        if let Err(error) = done {
            refused.push(format!("{what}: {error}"));
        }
    };
    if let Some(priority) = settings.socket.priority {
        note(format!("socket priority {priority}"), os::set_socket_priority(socket, priority));
    }
    if let Some(micros) = settings.socket.busy_poll_us {
        note(format!("busy polling for {micros} us"), os::set_socket_busy_poll(socket, micros));
    }
    if let Some(bytes) = settings.socket.receive_buffer {
        let set = rustix::net::sockopt::set_socket_recv_buffer_size(socket, bytes);
        note(format!("receive buffer of {bytes} bytes"), set.map_err(Into::into));
        // Linux doubles the size asked for, and cuts it to net.core.rmem_max silently.
        if let Ok(got) = rustix::net::sockopt::socket_recv_buffer_size(socket)
            && got < 2 * bytes
        {
            refused.push(format!("receive buffer of {bytes} bytes: only {} granted, raise net.core.rmem_max", got / 2));
        }
    }
    refused
}
