//! A fake control unit: it serves the protocol over real sockets, follows every command that comes in time exactly, checks none of them, and commits the
//! faults of a test's script. Checks of a real robot are in the emulator.

use plumbline_franka::wire::{
    COMMAND_PORT, CommandKind, Connect, ConnectStatus, Connected, ControllerMode, ErrorBit, Errors, HEADER_BYTES,
    Header, MAX_REQUEST, MAX_STATE, MotionGeneratorMode, MoveStatus, Protocol, RecoveryStatus, Request, Response,
    RobotCommand, RobotMode, RobotModelStatus, RobotState, SetterStatus, StopStatus,
};
use plumbline_rt::os::{now_ns, sleep_until};
use std::io::{Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex};

pub const READY: [f64; 7] = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5];
const TICK: f64 = 1e-3;
/// Longest wait for the answer to a state. Twenty of them are longer than a loaded machine stalls, and one is shorter than a client waits for the
/// next state where it leaves the last without an answer, as it does when it stops.
const PATIENCE_NS: u64 = 30_000_000;

/// What the fake is made of, and what it has seen.
pub struct World {
    pub protocol: Protocol,
    pub speaks: u16,
    pub sends: bool,
    pub moves: bool,
    pub state: RobotState,
    /// Number of the call of Move, while a motion runs.
    pub motion: Option<u32>,
    /// Milliseconds since the motion began.
    pub ticks: u64,
    /// Datagrams to send besides the state.
    pub extra: Vec<Vec<u8>>,
    /// Messages to send over TCP.
    pub answers: Vec<u8>,
    pub closes: bool,
    /// Every command that came, with the tick at which it was used.
    pub commands: Vec<(u64, RobotCommand)>,
    pub requests: Vec<Request>,
    /// Whether the clock stands until a client that has begun to command answers the last state, so that a loaded machine is no
    /// stall of the client. Off in the tests whose client stalls.
    pub waits: bool,
    /// Whether the client commands the motion that runs.
    commands_come: bool,
    /// Whether the last state went out.
    sent: bool,
    missing: u32,
}

impl World {
    pub fn answer(&mut self, id: u32, response: Response) {
        let mut bytes = vec![0; response.bytes()];
        let length = response.encode(self.protocol, id, &mut bytes).unwrap();
        self.answers.extend_from_slice(&bytes[..length]);
    }

    /// Ends the motion: modes, mode of the robot, reasons, and the final answer over TCP.
    pub fn end(&mut self, mode: RobotMode, reasons: Errors, status: Option<MoveStatus>) {
        self.state.motion_generator_mode = MotionGeneratorMode::Idle;
        self.state.controller_mode = ControllerMode::Other;
        self.state.robot_mode = mode;
        self.state.reflex_reason = reasons;
        self.state.errors = reasons;
        (self.state.dq_d, self.state.ddq_d) = ([0.0; 7], [0.0; 7]);
        self.state.control_command_success_rate = 0.0;
        if let (Some(id), Some(status)) = (self.motion.take(), status) {
            self.answer(id, Response::Move(status));
        }
    }

    fn serve(&mut self, id: u32, request: Request) {
        self.requests.push(request);
        match request {
            Request::Move(_) if !self.moves => {}
            Request::Move(_) if self.state.robot_mode != RobotMode::Idle => {
                self.answer(id, Response::Move(MoveStatus::NotPossible));
            }
            Request::Move(wanted) => {
                self.answer(id, Response::Move(MoveStatus::MotionStarted));
                self.state.motion_generator_mode = wanted.generator.shown().shown_at(self.protocol);
                self.state.controller_mode = wanted.controller.shown();
                self.state.robot_mode = RobotMode::Move;
                self.state.reflex_reason = Errors::NONE;
                (self.motion, self.ticks, self.missing) = (Some(id), 0, 0);
                self.commands_come = false;
            }
            Request::StopMove => {
                self.end(RobotMode::Idle, Errors::NONE, Some(MoveStatus::Preempted));
                self.answer(id, Response::StopMove(StopStatus::Success));
            }
            Request::AutomaticErrorRecovery => {
                self.end(RobotMode::Idle, Errors::NONE, None);
                self.answer(id, Response::AutomaticErrorRecovery(RecoveryStatus::Success));
            }
            Request::GetRobotModel => {
                let urdf = urdf();
                self.answer(id, Response::GetRobotModel { status: RobotModelStatus::Success, urdf: &urdf });
            }
            other => self.answer(id, Response::Setter(other.kind(), SetterStatus::Success)),
        }
    }

    /// One millisecond: a command, or going on at constant acceleration.
    fn step(&mut self, command: Option<RobotCommand>) {
        if self.motion.is_none() {
            return;
        }
        self.ticks += 1;
        let state = &mut self.state;
        let last = (state.q_d, state.dq_d);
        let position = state.motion_generator_mode == MotionGeneratorMode::JointPosition;
        let velocity = state.motion_generator_mode == MotionGeneratorMode::JointVelocity
            && state.controller_mode != ControllerMode::External;
        self.missing = if command.is_some() { 0 } else { self.missing + 1 };
        for j in 0..7 {
            let next = match command {
                Some(command) if position => command.q_c[j],
                Some(command) if velocity => last.0[j] + TICK * command.dq_c[j],
                None if position || velocity => last.0[j] + TICK * (last.1[j] + TICK * state.ddq_d[j]),
                _ => last.0[j],
            };
            state.dq_d[j] = (next - last.0[j]) / TICK;
            state.ddq_d[j] = (state.dq_d[j] - last.1[j]) / TICK;
            (state.q_d[j], state.q[j], state.dq[j]) = (next, next, state.dq_d[j]);
        }
        let rate = &mut state.control_command_success_rate;
        *rate = 0.99 * *rate + if command.is_some() { 0.01 } else { 0.0 };
        if let Some(command) = command {
            self.state.tau_j_d = command.tau_j_d;
            self.commands.push((self.ticks, command));
            if command.motion_generation_finished || command.torque_command_finished {
                self.end(RobotMode::Idle, Errors::NONE, Some(MoveStatus::Success));
            }
        }
        if self.motion.is_some() && self.ticks > 50 && self.missing >= 20 {
            let reasons = Errors::NONE.with(ErrorBit::CommunicationConstraintsViolation);
            self.end(RobotMode::Reflex, reasons, Some(MoveStatus::ReflexAborted));
        }
    }
}

/// A description with the limits of the FR3's table, but for joint 1.
pub fn urdf() -> String {
    let limits = plumbline_franka::fr3_limits();
    let joints: String = (0..7)
        .map(|j| {
            format!(
                "<joint name=\"fr3_joint{}\"><limit lower=\"{}\" upper=\"{}\" velocity=\"{}\" effort=\"{}\"/><position_based_velocity_limits \
                 velocity_offset=\"{}\" deceleration_limit=\"{}\"/></joint>",
                j + 1,
                limits.q_min[j],
                limits.q_max[j],
                if j == 0 { 2.5 } else { limits.dq[j] },
                limits.tau[j],
                limits.dq_offset[j],
                limits.dq_dec[j]
            )
        })
        .collect();
    format!("<robot name=\"fake\">{joints}</robot>")
}

type Script = Box<dyn FnMut(&mut World) + Send>;

/// A running fake; it ends when it is dropped.
pub struct Fake {
    pub address: IpAddr,
    pub world: Arc<Mutex<World>>,
    ends: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

/// Each fake has an address of its own, so that tests run side by side.
static NEXT: AtomicU8 = AtomicU8::new(1);

impl Fake {
    /// A fake of `protocol`; `script` is called before the first client, and once per millisecond before the state is sent.
    pub fn start(protocol: Protocol, script: impl FnMut(&mut World) + Send + 'static) -> Fake {
        // The process number keeps test programs apart that run at the same time.
        let third = (std::process::id() % 200) as u8 + 20;
        let address = IpAddr::V4(Ipv4Addr::new(127, 3, third, NEXT.fetch_add(1, Ordering::Relaxed)));
        let listener = TcpListener::bind((address, COMMAND_PORT)).expect("a loopback address of its own");
        let state = RobotState {
            q: READY,
            q_d: READY,
            robot_mode: RobotMode::Idle,
            o_ddp_o: [0.0, 0.0, -9.81],
            message_id: 5000,
            ..RobotState::default()
        };
        let world = Arc::new(Mutex::new(World {
            protocol,
            speaks: protocol.number(),
            sends: true,
            moves: true,
            state,
            motion: None,
            ticks: 0,
            extra: Vec::new(),
            answers: Vec::new(),
            closes: false,
            commands: Vec::new(),
            requests: Vec::new(),
            waits: true,
            commands_come: false,
            sent: false,
            missing: 0,
        }));
        let ends = Arc::new(AtomicBool::new(false));
        let thread = std::thread::spawn({
            let (world, ends) = (world.clone(), ends.clone());
            move || run(address, &listener, &world, &ends, Box::new(script))
        });
        Fake { address, world, ends, thread: Some(thread) }
    }

    pub fn with<T>(&self, look: impl FnOnce(&mut World) -> T) -> T {
        look(&mut self.world.lock().unwrap())
    }
}

impl Drop for Fake {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Client {
    stream: TcpStream,
    states_to: Option<SocketAddr>,
    bytes: Vec<u8>,
}

fn run(address: IpAddr, listener: &TcpListener, world: &Mutex<World>, ends: &AtomicBool, mut script: Script) {
    listener.set_nonblocking(true).unwrap();
    let udp = UdpSocket::bind((address, COMMAND_PORT)).unwrap();
    udp.set_nonblocking(true).unwrap();
    let mut client: Option<Client> = None;
    script(&mut world.lock().unwrap());
    let mut due = now_ns();
    while !ends.load(Ordering::Relaxed) {
        due += 1_000_000;
        sleep_until(due);
        let answer = answer(&udp, world);
        // A machine that stalled does not cause a burst of states.
        due = due.max(now_ns().saturating_sub(3_000_000));
        let mut world = world.lock().unwrap();
        let world = &mut *world;
        if let Ok((stream, _)) = listener.accept() {
            stream.set_nonblocking(true).unwrap();
            client = Some(Client { stream, states_to: None, bytes: Vec::new() });
        }
        world.step(answer);
        if let Some(connected) = &mut client
            && !listen(connected, world)
        {
            client = None;
            // A client that has disconnected ends its motion. A reflex outlasts it.
            if world.motion.is_some() {
                world.end(RobotMode::Idle, Errors::NONE, None);
            }
        }
        script(world);
        world.state.message_id += 1;
        if let Some(connected) = &mut client {
            let mut datagram = [0; MAX_STATE];
            let length = world.state.encode(world.protocol, &mut datagram);
            if let Some(to) = connected.states_to.filter(|_| world.sends) {
                for extra in world.extra.drain(..) {
                    let _ = udp.send_to(&extra, to);
                }
                let _ = udp.send_to(&datagram[..length], to);
                world.sent = true;
            }
            let _ = connected.stream.write_all(&std::mem::take(&mut world.answers));
        }
        if std::mem::take(&mut world.closes) {
            client = None;
        }
    }
}

/// The command that answers the last state. Where the world waits and one is due, it is waited for.
fn answer(udp: &UdpSocket, world: &Mutex<World>) -> Option<RobotCommand> {
    let mut datagram = [0; 1024];
    let begin = now_ns();
    loop {
        let mut world = world.lock().unwrap();
        let mut newest = None;
        while let Ok((length, _)) = udp.recv_from(&mut datagram) {
            let command = RobotCommand::decode(world.protocol, &datagram[..length]).ok();
            // A robot drops what answers an older state.
            newest = command.filter(|command| command.message_id == world.state.message_id).or(newest);
        }
        let due = world.waits && world.motion.is_some() && world.commands_come && world.sent;
        if newest.is_some() || !due || now_ns() > begin + PATIENCE_NS {
            world.commands_come |= newest.is_some();
            world.sent = false;
            return newest;
        }
        drop(world);
        sleep_until(now_ns() + 100_000);
    }
}

/// Serves what came over TCP; `false` when the client has disconnected.
fn listen(client: &mut Client, world: &mut World) -> bool {
    let mut more = [0; 4096];
    match client.stream.read(&mut more) {
        Ok(0) => return false,
        Ok(length) => client.bytes.extend_from_slice(&more[..length]),
        Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
        Err(_) => return false,
    }
    while let Some(head) = client.bytes.first_chunk::<HEADER_BYTES>() {
        let header = Header::decode(head, MAX_REQUEST as u32).unwrap();
        let Some(payload) = client.bytes.get(HEADER_BYTES..header.size as usize) else { break };
        if header.command == CommandKind::CONNECT {
            let connect = Connect::decode(payload).unwrap();
            let fits = connect.version == world.speaks;
            let status = if fits { ConnectStatus::Success } else { ConnectStatus::IncompatibleVersion };
            let version = world.speaks;
            world.answer(header.command_id, Response::Connect(Connected { status, version }));
            if fits {
                client.states_to = Some(SocketAddr::new(client.stream.peer_addr().unwrap().ip(), connect.udp_port));
            }
        } else {
            let kind = CommandKind::from_number(world.protocol, header.command).unwrap();
            let request = Request::decode(world.protocol, kind, payload).unwrap();
            world.serve(header.command_id, request);
        }
        client.bytes.drain(..header.size as usize);
    }
    true
}
