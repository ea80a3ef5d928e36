//! Sockets and time around the robot: one thread paces the milliseconds, answers TCP without waiting for it, and sends the states.
//!
//! The robot's clock is not the wall's where the machine is late: a millisecond that begins more than a fifth late moves all that
//! follow, so that the emulator's own lateness is never charged to the client.

use super::faults::{Fault, Injector, Line, Of};
use super::log::Log;
use super::robot::{OperatorAction, Robot};
use plumbline_franka::wire::{
    CommandKind, Connect, ConnectStatus, Connected, HEADER_BYTES, Header, MAX_COMMAND, MAX_FIXED_RESPONSE, MAX_REQUEST,
    MAX_STATE, Protocol, Request, Response, RobotCommand, RobotMode, RobotState,
};
use plumbline_rt::os::{now_ns, sleep_until};
use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::mpsc::{Receiver, TryRecvError};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const MILLISECOND: u64 = 1_000_000;
/// Lateness that is caught up instead of moving the clock \[ns\].
const MAX_CAUGHT_UP_NS: u64 = MILLISECOND / 5;
/// Lateness that is logged \[ns\].
const LOGGED_LATENESS_NS: u64 = 50 * MILLISECOND;
/// Pause between two polls of the socket while the robot's time is paused \[ns\].
const POLL_NS: u64 = 50_000;

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    Operator(OperatorAction),
    Fault(Fault),
    Heal,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counts {
    /// Milliseconds of the robot's time.
    pub cycles: u64,
    /// Times that the clock was moved because the machine was late.
    pub slips: u64,
    pub taken: u64,
    /// Commands that were good but for another state: late, repeated or of the future.
    pub untimely: u64,
    /// Datagrams that were no commands, or not from the client.
    pub bad: u64,
    /// Clients that were sent away because there was one already.
    pub refused: u64,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Snapshot {
    pub state: RobotState,
    pub counts: Counts,
    /// Whether a client's session is open.
    pub connected: bool,
}

struct Client {
    stream: TcpStream,
    /// Where states go; known from Connect on.
    states_to: Option<SocketAddr>,
    /// Its version was refused: its connection does not block others.
    sent_away: bool,
    inbox: Vec<u8>,
    outbox: Vec<u8>,
}

/// Why a client's connection ended.
enum Gone {
    Closed,
    Broken(String),
}

pub struct Server {
    protocol: Protocol,
    listener: TcpListener,
    udp: UdpSocket,
    robot: Robot,
    injector: Injector,
    states: Line,
    commands: Line,
    client: Option<Client>,
    command_wait: u64,
    moving_since: Option<u64>,
    orders: Receiver<Order>,
    shared: Arc<Mutex<Snapshot>>,
    counts: Counts,
    log: Log,
}

pub struct Parts {
    pub protocol: Protocol,
    pub listener: TcpListener,
    pub udp: UdpSocket,
    pub robot: Robot,
    pub injector: Injector,
    pub command_wait: Duration,
    pub orders: Receiver<Order>,
    pub shared: Arc<Mutex<Snapshot>>,
    pub log: Log,
}

impl Server {
    /// A server on sockets that are bound and do not block.
    pub fn new(parts: Parts) -> Server {
        Server {
            protocol: parts.protocol,
            listener: parts.listener,
            udp: parts.udp,
            robot: parts.robot,
            injector: parts.injector,
            states: Line::default(),
            commands: Line::default(),
            client: None,
            command_wait: u64::try_from(parts.command_wait.as_nanos()).unwrap_or(u64::MAX),
            moving_since: None,
            orders: parts.orders,
            shared: parts.shared,
            counts: Counts::default(),
            log: parts.log,
        }
    }

    /// Serves until the handle is dropped.
    pub fn run(mut self) {
        let mut next = now_ns() + MILLISECOND;
        while self.obey() {
            self.wait(next);
            self.listen();
            let command = self.command(next);
            let late = now_ns().saturating_sub(next);
            if late > MAX_CAUGHT_UP_NS {
                if late > LOGGED_LATENESS_NS {
                    self.log.event(&format!(
                        "the machine was {} ms late: the robot's clock stood still",
                        late / MILLISECOND
                    ));
                }
                self.counts.slips += 1;
                next += late;
            }
            next += MILLISECOND;
            self.cycle(command.as_ref());
        }
    }

    /// Carries out what was ordered; `false` when there is no one left to order.
    fn obey(&mut self) -> bool {
        loop {
            match self.orders.try_recv() {
                Ok(Order::Operator(action)) => self.robot.operate(action),
                Ok(Order::Fault(fault)) => self.injector.give(fault),
                Ok(Order::Heal) => self.injector.heal(),
                Err(TryRecvError::Empty) => return true,
                Err(TryRecvError::Disconnected) => return false,
            }
        }
    }

    /// Sleeps until `next`, but for states that a fault has delayed to some moment before, and for commands whose delay begins as they come.
    fn wait(&mut self, next: u64) {
        let watches = self.injector.delays_commands();
        loop {
            let look = if watches { now_ns() + POLL_NS } else { u64::MAX };
            let due = self.states.next().map_or(look, |due| due.min(look));
            if due >= next {
                break;
            }
            sleep_until(due);
            self.deliver();
            if watches {
                self.gather();
            }
        }
        sleep_until(next);
        self.deliver();
    }

    /// Sends the states whose time has come.
    fn deliver(&mut self) {
        let to = self.client.as_ref().and_then(|client| client.states_to);
        for datagram in self.states.arrived(now_ns()) {
            if let Some(to) = to {
                // A full buffer or a closed socket of the client: one more lost datagram.
                let _ = self.udp.send_to(&datagram, to);
            }
        }
    }

    /// Looks at TCP: ends what has ended, takes requests, lets clients in.
    fn listen(&mut self) {
        if self.injector.resets() {
            self.reset();
        }
        self.attend();
        while let Ok((stream, peer)) = self.listener.accept() {
            // The client before may have disconnected just now.
            self.attend();
            if self.client.as_ref().is_some_and(|client| !client.sent_away) {
                // How a real robot treats a second client is not published.
                self.counts.refused += 1;
                self.log.event(&format!("second client {peer} refused"));
                continue;
            }
            if stream.set_nonblocking(true).and(stream.set_nodelay(true)).is_ok() {
                self.log.event(&format!("client {peer}"));
                let (inbox, outbox) = (Vec::new(), Vec::new());
                self.client = Some(Client { stream, states_to: None, sent_away: false, inbox, outbox });
            }
        }
    }

    /// Serves the connected client; drops one that has disconnected.
    fn attend(&mut self) {
        let Some(mut client) = self.client.take() else { return };
        match self.serve(&mut client) {
            Ok(()) => self.client = Some(client),
            Err(gone) => {
                let why = match gone {
                    Gone::Closed => "client gone".to_string(),
                    Gone::Broken(why) => format!("client gone: {why}"),
                };
                self.log.event(&why);
                self.forget();
            }
        }
    }

    fn forget(&mut self) {
        self.client = None;
        self.robot.client_gone();
        self.states.clear();
        self.commands.clear();
    }

    /// Ends the connection with a reset instead of an orderly close.
    fn reset(&mut self) {
        if let Some(client) = self.client.take() {
            let lingering = rustix::net::sockopt::set_socket_linger(&client.stream, Some(Duration::ZERO));
            self.log.event(&format!("fault: TCP reset ({lingering:?})"));
            drop(client);
            self.forget();
        }
    }

    fn serve(&mut self, client: &mut Client) -> Result<(), Gone> {
        let broken = |error: std::io::Error| Gone::Broken(error.to_string());
        let mut closed = false;
        let mut buffer = [0; 4096];
        loop {
            match client.stream.read(&mut buffer) {
                Ok(0) => {
                    closed = true;
                    break;
                }
                Ok(count) => client.inbox.extend_from_slice(&buffer[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(broken(error)),
            }
        }
        while let Some(head) = client.inbox.first_chunk::<HEADER_BYTES>() {
            let header = Header::decode(head, MAX_REQUEST as u32).map_err(|error| Gone::Broken(error.to_string()))?;
            let size = header.size as usize;
            if client.inbox.len() < size {
                break;
            }
            let message: Vec<u8> = client.inbox.drain(..size).collect();
            self.take(client, &header, &message[HEADER_BYTES..])?;
        }
        if closed {
            return Err(Gone::Closed);
        }
        flush(client).map_err(broken)
    }

    fn take(&mut self, client: &mut Client, header: &Header, payload: &[u8]) -> Result<(), Gone> {
        let id = header.command_id;
        if client.states_to.is_none() {
            if header.command != CommandKind::CONNECT {
                return Err(Gone::Broken(format!("command {} before Connect", header.command)));
            }
            let connect = Connect::decode(payload).map_err(|error| Gone::Broken(error.to_string()))?;
            return self.connect(client, id, &connect);
        }
        let kind = CommandKind::from_number(self.protocol, header.command);
        let kind = kind.map_err(|error| Gone::Broken(error.to_string()))?;
        match Request::decode(self.protocol, kind, payload) {
            Ok(Request::Connect(_)) => Err(Gone::Broken("a second Connect".into())),
            Ok(request) => {
                self.robot.request(id, &request);
                Ok(())
            }
            Err(error) if kind == CommandKind::Move => {
                self.log.event(&format!("Move refused: {error}"));
                self.robot.malformed_move(id);
                Ok(())
            }
            Err(error) => Err(Gone::Broken(error.to_string())),
        }
    }

    fn connect(&mut self, client: &mut Client, id: u32, connect: &Connect) -> Result<(), Gone> {
        let version = self.injector.version().unwrap_or(self.protocol.number());
        let fits = connect.version == version && version == self.protocol.number();
        let status = if fits { ConnectStatus::Success } else { ConnectStatus::IncompatibleVersion };
        let response = Response::Connect(Connected { status, version });
        let mut message = [0; MAX_FIXED_RESPONSE];
        let written = response.encode(self.protocol, id, &mut message);
        let length = written.map_err(|error| Gone::Broken(error.to_string()))?;
        client.outbox.extend_from_slice(&message[..length]);
        self.log.event(&format!("Connect with version {}, served {version}: {status}", connect.version));
        client.sent_away = !fits;
        if fits {
            let peer = client.stream.peer_addr().map_err(|error| Gone::Broken(error.to_string()))?;
            client.states_to = Some(SocketAddr::new(peer.ip(), connect.udp_port));
        }
        Ok(())
    }

    /// The command that answers the state sent last, if it has come. With a command wait the robot's time is paused until then.
    fn command(&mut self, next: u64) -> Option<RobotCommand> {
        let mut found = self.look();
        if self.robot.awaits_command() && !self.injector.is_silent() {
            while found.is_none() && now_ns() < next.saturating_add(self.command_wait) {
                sleep_until(now_ns() + POLL_NS);
                self.deliver();
                self.listen();
                if !self.robot.awaits_command() {
                    break;
                }
                found = self.look();
            }
        }
        found
    }

    fn gather(&mut self) {
        let from_client = self.client.as_ref().and_then(|client| client.states_to);
        let mut buffer = [0; MAX_COMMAND + 1];
        loop {
            match self.udp.recv_from(&mut buffer) {
                Ok((count, from)) if Some(from) == from_client && !self.injector.is_silent() => {
                    self.injector.send(Of::Commands, now_ns(), buffer[..count].to_vec(), &mut self.commands);
                }
                Ok(_) => self.counts.bad += 1,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // What an earlier datagram met at the other end.
                Err(_) => {}
            }
        }
    }

    /// Of the commands that have arrived for the newest state the first counts.
    fn look(&mut self) -> Option<RobotCommand> {
        self.gather();
        let mut found = None;
        for datagram in self.commands.arrived(now_ns()) {
            match RobotCommand::decode(self.protocol, &datagram) {
                Ok(command) if command.message_id == self.robot.message_id() && found.is_none() => {
                    self.counts.taken += 1;
                    found = Some(command);
                }
                Ok(_) => self.counts.untimely += 1,
                Err(error) => {
                    self.counts.bad += 1;
                    self.log.event(&format!("command dropped: {error}"));
                }
            }
        }
        found
    }

    /// One millisecond of the robot, and its state on the way.
    fn cycle(&mut self, command: Option<&RobotCommand>) {
        let state = self.robot.cycle(command);
        self.counts.cycles += 1;
        let moves = state.robot_mode == RobotMode::Move;
        self.moving_since = moves.then(|| self.moving_since.unwrap_or(self.counts.cycles));
        let motion = self.moving_since.map(|since| self.counts.cycles - since);
        self.injector.tick(self.counts.cycles, motion);
        let connected = self.client.as_ref().is_some_and(|client| client.states_to.is_some());
        // Whoever has seen a state finds it in the snapshot.
        if let Ok(mut shared) = self.shared.lock() {
            *shared = Snapshot { state, counts: self.counts, connected };
        }
        if connected && !self.injector.is_silent() {
            let mut datagram = [0; MAX_STATE];
            let length = state.encode(self.protocol, &mut datagram);
            self.injector.send(Of::States, now_ns(), datagram[..length].to_vec(), &mut self.states);
            self.deliver();
        }
        let answers = self.robot.outbox();
        if let Some(client) = &mut self.client {
            answers.iter().for_each(|answer| client.outbox.extend_from_slice(answer));
            // A connection that can't be written to is found broken when it is read.
            let _ = flush(client);
        }
        self.log.cycle(&state);
        for event in self.robot.events() {
            self.log.event(&event);
        }
    }
}

/// Writes as much of the answers as the socket takes.
fn flush(client: &mut Client) -> std::io::Result<()> {
    while !client.outbox.is_empty() {
        match client.stream.write(&client.outbox) {
            Ok(count) => drop(client.outbox.drain(..count)),
            Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Sockets of a robot at `address`: TCP that listens, UDP that sends from the same port.
pub fn bind(address: IpAddr, port: u16) -> std::io::Result<(TcpListener, UdpSocket)> {
    let listener = TcpListener::bind((address, port))?;
    listener.set_nonblocking(true)?;
    let udp = UdpSocket::bind((address, port))?;
    udp.set_nonblocking(true)?;
    Ok((listener, udp))
}
