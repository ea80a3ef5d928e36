//! A client that does exactly what a test tells it, well-behaved or not, over the codec alone.

use plumbline_franka::wire::{
    CommandKind, Connect, Connected, HEADER_BYTES, Header, MAX_COMMAND, MAX_MESSAGE, MAX_REQUEST, MAX_STATE, Move,
    MoveController, MoveGenerator, MoveStatus, Protocol, RecoveryStatus, Request, Response, RobotCommand, RobotMode,
    RobotState, SetterStatus, StopStatus,
};
use std::collections::HashMap;
use std::io::{Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

/// Long for a robot on this machine, short for a test that hangs.
const DEADLINE: Duration = Duration::from_secs(10);

/// An answer, its text and library left out.
#[derive(Clone, Debug, PartialEq)]
pub enum Answer {
    Move(MoveStatus),
    StopMove(StopStatus),
    Setter(SetterStatus),
    Recovery(RecoveryStatus),
    Library(Option<Vec<u8>>),
    Model(Option<String>),
    Other(CommandKind),
}

pub struct Client {
    pub protocol: Protocol,
    stream: TcpStream,
    udp: UdpSocket,
    robot: Option<SocketAddr>,
    calls: HashMap<u32, CommandKind>,
    next_id: u32,
    inbox: Vec<u8>,
    answers: Vec<(u32, Answer)>,
    pub state: RobotState,
}

/// What an emulator at `address` answers to Connect with `version`, and the connection with the socket for states.
pub fn knock(address: IpAddr, version: u16) -> (Connected, TcpStream, UdpSocket) {
    let mut stream = TcpStream::connect((address, 1337)).expect("an emulator");
    stream.set_nodelay(true).expect("a TCP option");
    stream.set_read_timeout(Some(DEADLINE)).expect("a timeout");
    let udp = UdpSocket::bind("0.0.0.0:0").expect("a free port");
    udp.set_read_timeout(Some(DEADLINE)).expect("a timeout");
    let request = Request::Connect(Connect { version, udp_port: udp.local_addr().expect("bound").port() });
    let mut buffer = [0; MAX_REQUEST];
    let length = request.encode(Protocol::V10, 0, &mut buffer).expect("a request");
    stream.write_all(&buffer[..length]).expect("a connection");
    let mut answer = [0; HEADER_BYTES + 3];
    stream.read_exact(&mut answer).expect("an answer");
    let connected = Connected::decode(&answer[HEADER_BYTES..]).expect("an answer to Connect");
    (connected, stream, udp)
}

impl Client {
    pub fn connect(address: IpAddr, protocol: Protocol) -> Client {
        let (connected, stream, udp) = knock(address, protocol.number());
        assert_eq!(connected.version, protocol.number());
        stream.set_nonblocking(true).expect("a TCP option");
        let mut client = Client {
            protocol,
            stream,
            udp,
            robot: None,
            calls: HashMap::new(),
            next_id: 1,
            inbox: Vec::new(),
            answers: Vec::new(),
            state: RobotState::default(),
        };
        client.read();
        client
    }

    /// The next datagram that arrives and whether it is a state.
    pub fn receive(&mut self) -> Result<RobotState, plumbline_franka::wire::WireError> {
        let mut buffer = [0; MAX_STATE + 1];
        let (length, from) = self.udp.recv_from(&mut buffer).expect("a state");
        self.robot = Some(from);
        RobotState::decode(self.protocol, &buffer[..length])
    }

    /// The next state in the order in which they arrive.
    pub fn read(&mut self) -> RobotState {
        self.state = self.receive().expect("a whole state");
        self.state
    }

    /// Whether a state comes within `wait`.
    pub fn hears(&mut self, wait: Duration) -> bool {
        self.udp.set_read_timeout(Some(wait)).expect("a timeout");
        let heard = self.udp.recv_from(&mut [0; MAX_STATE + 1]).is_ok();
        self.udp.set_read_timeout(Some(DEADLINE)).expect("a timeout");
        heard
    }

    pub fn drain(&mut self) {
        self.udp.set_nonblocking(true).expect("a UDP option");
        while self.udp.recv_from(&mut [0; MAX_STATE + 1]).is_ok() {}
        self.udp.set_nonblocking(false).expect("a UDP option");
    }

    pub fn address(&self) -> IpAddr {
        self.stream.peer_addr().expect("a connection").ip()
    }

    pub fn send_bytes(&self, bytes: &[u8]) {
        self.udp.send_to(bytes, self.robot.expect("a state was read")).expect("sent");
    }

    pub fn send(&self, command: &RobotCommand) {
        let mut buffer = [0; MAX_COMMAND];
        let length = command.encode(self.protocol, &mut buffer);
        self.send_bytes(&buffer[..length]);
    }

    /// Answers the state read last.
    pub fn write(&self, command: RobotCommand) {
        self.send(&RobotCommand { message_id: self.state.message_id, ..command });
    }

    /// A new call, whose request the test sends itself.
    pub fn expect(&mut self, kind: CommandKind) -> u32 {
        let id = self.next_id;
        self.next_id += 1;
        self.calls.insert(id, kind);
        id
    }

    pub fn call(&mut self, request: Request) -> u32 {
        let id = self.expect(request.kind());
        let mut buffer = [0; MAX_REQUEST];
        let length = request.encode(self.protocol, id, &mut buffer).expect("a request of this version");
        self.stream.write_all(&buffer[..length]).expect("a connection");
        id
    }

    pub fn say(&mut self, bytes: &[u8]) {
        self.stream.write_all(bytes).expect("a connection");
    }

    /// Takes what TCP has; an error or `Ok(false)` when the connection has ended.
    pub fn poll(&mut self) -> std::io::Result<bool> {
        let mut buffer = [0; 65536];
        loop {
            match self.stream.read(&mut buffer) {
                Ok(0) => return Ok(false),
                Ok(count) => self.inbox.extend_from_slice(&buffer[..count]),
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        while let Some(head) = self.inbox.first_chunk::<HEADER_BYTES>() {
            let header = Header::decode(head, MAX_MESSAGE).expect("a header");
            let size = header.size as usize;
            if self.inbox.len() < size {
                break;
            }
            let message: Vec<u8> = self.inbox.drain(..size).collect();
            let kind = self.calls[&header.command_id];
            assert_eq!(CommandKind::from_number(self.protocol, header.command), Ok(kind), "answers name their command");
            let payload = &message[HEADER_BYTES..];
            let answer = match Response::decode(self.protocol, kind, payload).expect("an answer") {
                Response::Move(status) => Answer::Move(status),
                Response::StopMove(status) => Answer::StopMove(status),
                Response::Setter(_, status) => Answer::Setter(status),
                Response::AutomaticErrorRecovery(status) => Answer::Recovery(status),
                Response::LoadModelLibrary { library, .. } => {
                    Answer::Library((!library.is_empty()).then(|| library.to_vec()))
                }
                Response::GetRobotModel { urdf, .. } => Answer::Model((!urdf.is_empty()).then(|| urdf.to_string())),
                other => Answer::Other(other.kind()),
            };
            self.answers.push((header.command_id, answer));
        }
        Ok(true)
    }

    /// The answer to a call, if it is here.
    pub fn answer(&mut self, id: u32) -> Option<Answer> {
        self.poll().expect("a connection");
        let place = self.answers.iter().position(|(call, _)| *call == id)?;
        Some(self.answers.remove(place).1)
    }

    /// Waits for the answer to a call, reading states meanwhile.
    pub fn await_answer(&mut self, id: u32) -> Answer {
        let start = Instant::now();
        loop {
            if let Some(answer) = self.answer(id) {
                return answer;
            }
            assert!(start.elapsed() < DEADLINE, "no answer to call {id}");
            self.read();
        }
    }

    pub fn ask(&mut self, request: Request) -> Answer {
        let id = self.call(request);
        self.await_answer(id)
    }

    /// Asks for a motion and returns its call and the first answer; where it has started, states show it.
    pub fn begin(&mut self, wanted: Move) -> (u32, Answer) {
        let id = self.call(Request::Move(wanted));
        let answer = self.await_answer(id);
        if answer == Answer::Move(MoveStatus::MotionStarted) {
            let start = Instant::now();
            let shown = wanted.generator.shown().shown_at(self.protocol);
            while (self.state.motion_generator_mode, self.state.controller_mode) != (shown, wanted.controller.shown()) {
                assert!(start.elapsed() < DEADLINE, "the motion never shows");
                self.read();
            }
        }
        (id, answer)
    }

    pub fn start(&mut self, controller: MoveController, generator: MoveGenerator) -> u32 {
        let (id, answer) = self.begin(Move::new(controller, generator));
        assert_eq!(answer, Answer::Move(MoveStatus::MotionStarted));
        id
    }

    pub fn start_positions(&mut self) -> u32 {
        self.start(MoveController::JointImpedance, MoveGenerator::JointPosition)
    }

    /// Commands `q` in answer to the state read last, and reads the next one.
    pub fn step_to(&mut self, q: [f64; 7]) -> RobotState {
        self.write(RobotCommand { q_c: q, ..RobotCommand::default() });
        self.read()
    }

    /// Commands `last` with both flags of an end until states show it, and returns the answer to the motion's call.
    pub fn finish(&mut self, id: u32, last: RobotCommand) -> Answer {
        let command = RobotCommand { motion_generation_finished: true, torque_command_finished: true, ..last };
        let start = Instant::now();
        while self.state.robot_mode == RobotMode::Move {
            assert!(start.elapsed() < DEADLINE, "the motion never ends");
            self.write(command);
            self.read();
        }
        self.await_answer(id)
    }

    /// Reads until the arm shows `mode`.
    pub fn until(&mut self, mode: RobotMode) -> RobotState {
        let start = Instant::now();
        while self.state.robot_mode != mode {
            assert!(start.elapsed() < DEADLINE, "the arm never shows {mode}, but {}", self.state.robot_mode);
            self.read();
        }
        self.state
    }

    /// Ends the session with an orderly close.
    pub fn close(self) {
        drop(self);
    }
}
