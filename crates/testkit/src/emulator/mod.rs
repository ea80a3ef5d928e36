//! An emulator of a Franka arm's control interface: protocol versions 5, 9 and 10 over TCP and UDP at 1 kHz, with the simulated arm of
//! plumbline behind it.
//!
//! It shares the codec with plumbline's own client, and nothing else: limits, checks and behaviour are implemented here a second
//! time, and clients of other origin are what proves them (`hil/fci-peers`). It never accepts what a robot would refuse; where Franka has
//! not published what a robot does, it takes the stricter way and says so.
//!
//! | file | what |
//! |---|---|
//! | `limits` | what a robot allows its commands |
//! | `geometry`, `body` | kinematics; the simulated arm and its firmware |
//! | `motion`, `robot` | modes, motions, errors; no sockets, no clock |
//! | `requests`, `setters` | what it answers, and which arguments it takes |
//! | `faults` | faults of network and robot, on demand |
//! | `server`, `log` | sockets and time; output |
//! | `urdf` | the robot description that it serves |
//!
//! What it does not do: Cartesian motions and asynchronous ones are answered with not-possible; setting impedances and filters is judged and
//! has no effect; self-collision and virtual walls are not watched; the brakes make no noise.
//!
//! In a test: `Emulator::start(Settings::new(address, Protocol::V10))`; dropping the value ends it.

pub mod body;
pub mod control;
pub mod faults;
pub mod geometry;
pub mod limits;
pub mod log;
pub mod motion;
pub mod options;
mod requests;
pub mod robot;
pub mod server;
pub mod setters;
pub mod urdf;

pub use faults::{Fault, Injector, Kind, Of, Start};
pub use limits::RobotKind;
pub use robot::OperatorAction;
pub use server::{Counts, Snapshot};

use body::Body;
use limits::{JOINTS, Joints, Limits};
use log::Log;
use plumbline_core::BadInput;
use plumbline_franka::wire::{COMMAND_PORT, Protocol};
use plumbline_model::{G, Mounting, Robot as Description};
use plumbline_sim::{SimError, Truth};
use robot::{Robot, Served};
use server::{Order, Parts, Server};
use std::net::{IpAddr, Ipv4Addr};
use std::path::PathBuf;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

/// Position of the arm at the start: Franka's own ready pose \[rad\].
pub const READY: Joints = [
    0.0,
    -std::f64::consts::FRAC_PI_4,
    0.0,
    -2.356194490192345,
    0.0,
    std::f64::consts::FRAC_PI_2,
    std::f64::consts::FRAC_PI_4,
];

/// An address of its own for every emulator; the port is fixed. The process number keeps programs apart that run at the same time.
pub fn address() -> IpAddr {
    static NEXT: AtomicU16 = AtomicU16::new(1);
    let [high, low] = NEXT.fetch_add(1, Ordering::Relaxed).to_be_bytes();
    Ipv4Addr::new(127, 64 | (high & 63), (std::process::id() % 251) as u8, low).into()
}

#[derive(Clone, Debug)]
pub struct Settings {
    /// Address that it serves on, usually one of 127.0.0.0/8.
    pub address: IpAddr,
    /// Port of TCP and UDP; that of real robots unless a test sets another.
    pub port: u16,
    pub protocol: Protocol,
    /// Which arm's limits and name.
    pub robot: RobotKind,
    /// Limits that it serves and checks; those of `robot` where absent.
    pub limits: Option<Limits>,
    pub arm: Truth,
    pub mounting: Mounting,
    /// Gravity in the base frame that the firmware adds torque against \[m/s2\]: (0, 0, -9.81) in any mounting, as robots do.
    pub compensates: [f64; 3],
    /// Position at the start \[rad\].
    pub start: Joints,
    pub seed: u64,
    /// Longest pause of the robot's time for a motion's next command. Zero is a robot. More than zero is for tests
    /// of other things than timing on machines that stall: the robot's clock then runs slower than the wall's.
    pub command_wait: Duration,
    /// Shared library that LoadModelLibrary answers with, versions 5 and 9.
    pub model_library: Option<Vec<u8>>,
    /// `O_ddP_O` of every state \[m/s2\]: (0, 0, -9.81) in any mounting, as robots report without a declared mounting.
    pub base_acceleration: [f64; 3],
    pub first_message_id: u64,
    pub faults: Vec<Fault>,
    /// Whether events go to standard error.
    pub speaks: bool,
    pub log: Option<PathBuf>,
}

/// The arm behind the emulator, built in: the program also runs where the repository is not.
const ARM: &str = include_str!("../../../../config/arms/sim-panda.toml");

impl Settings {
    /// A robot of `protocol`'s kind with the built-in simulated Panda behind it, upright, in its ready pose, without faults.
    pub fn new(address: impl Into<IpAddr>, protocol: Protocol) -> Settings {
        Settings {
            address: address.into(),
            port: COMMAND_PORT,
            protocol,
            robot: RobotKind::of(protocol),
            limits: None,
            arm: Truth::parse("sim-panda", ARM).expect("a shipped file"),
            mounting: Mounting::UPRIGHT,
            compensates: [0.0, 0.0, -G],
            start: READY,
            seed: 1,
            command_wait: Duration::ZERO,
            model_library: None,
            base_acceleration: [0.0, 0.0, -G],
            first_message_id: 1,
            faults: Vec::new(),
            speaks: false,
            log: None,
        }
    }
}

#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum StartError {
    /// Its port is taken, or its address is none of this machine's.
    #[error("{address}, port {port}: {error}")]
    Address { address: IpAddr, port: u16, error: std::io::Error },
    #[error("log {path}: {error}")]
    Log { path: PathBuf, error: std::io::Error },
    #[error("joint {joint} can't start at {q} rad: its range is {least} to {most} rad")]
    Pose { joint: usize, q: f64, least: f64, most: f64 },
    #[error(transparent)]
    Arm(#[from] SimError),
    #[error(transparent)]
    Robot(#[from] BadInput),
    #[error("the emulator's thread: {0}")]
    Thread(std::io::Error),
}

/// A running emulator. Ends when it is dropped.
pub struct Emulator {
    orders: Option<Sender<Order>>,
    shared: Arc<Mutex<Snapshot>>,
    thread: Option<JoinHandle<()>>,
}

impl Emulator {
    /// Starts an emulator in a thread of its own; once this returns, clients can connect.
    ///
    /// # Errors
    /// [`StartError`].
    pub fn start(settings: Settings) -> Result<Emulator, StartError> {
        let limits = settings.limits.unwrap_or_else(|| Limits::of(settings.robot, settings.protocol));
        for j in 0..JOINTS {
            let (q, least, most) = (settings.start[j], limits.q_min[j], limits.q_max[j]);
            if !limits.inside(j, q) {
                return Err(StartError::Pose { joint: j + 1, q, least, most });
            }
        }
        let name = settings.robot.name();
        let chain = Description::load(name, None)?.chain;
        let served = Served {
            model_library: settings.model_library.clone(),
            urdf: urdf::write(name, &chain, &limits, &settings.arm),
            base_acceleration: settings.base_acceleration,
        };
        let body =
            Body::new(chain, &settings.arm, settings.mounting, settings.compensates, &settings.start, settings.seed)?;
        let before = settings.first_message_id.saturating_sub(1);
        let robot = Robot::new(settings.protocol, limits, body, &settings.start, served, before);
        let address = |error| StartError::Address { address: settings.address, port: settings.port, error };
        let (listener, udp) = server::bind(settings.address, settings.port).map_err(address)?;
        let log = Log::new(settings.speaks, settings.log.as_deref());
        let log = log.map_err(|error| StartError::Log { path: settings.log.clone().unwrap_or_default(), error })?;
        let (orders, obeyed) = channel();
        let shared = Arc::new(Mutex::new(Snapshot::default()));
        let server = Server::new(Parts {
            protocol: settings.protocol,
            listener,
            udp,
            robot,
            injector: Injector::new(&settings.faults, settings.seed),
            command_wait: settings.command_wait,
            orders: obeyed,
            shared: Arc::clone(&shared),
            log,
        });
        let builder = std::thread::Builder::new().name(format!("fci {}", settings.address));
        let thread = builder.spawn(|| server.run()).map_err(StartError::Thread)?;
        Ok(Emulator { orders: Some(orders), shared, thread: Some(thread) })
    }

    pub fn operate(&self, action: OperatorAction) {
        self.order(Order::Operator(action));
    }

    /// One more fault, its times counted from now.
    pub fn fault(&self, fault: Fault) {
        self.order(Order::Fault(fault));
    }

    pub fn heal(&self) {
        self.order(Order::Heal);
    }

    pub fn snapshot(&self) -> Snapshot {
        self.shared.lock().map(|shared| *shared).unwrap_or_default()
    }

    fn order(&self, order: Order) {
        if let Some(orders) = &self.orders {
            // A thread that has ended obeys nothing; the snapshot stands still then.
            let _ = orders.send(order);
        }
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            let ended = thread.join();
            if !std::thread::panicking() {
                ended.expect("the emulator's thread");
            }
        }
    }
}
