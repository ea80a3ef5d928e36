//! The inclinometer over SocketCAN, on a thread of its own at ordinary priority.
//!
//! Bit rate and restart after bus-off belong to the interface and are set where it is brought up (`ip link set can0 up type can bitrate
//! 250000 restart-ms 100`), not here. Only the device's own identifiers pass the kernel's filter, so a babbling bus costs nothing.
//! What is learned last lies where the daemon looks for it; the daemon never waits.
//!
//! `simulated:PATH` in place of an interface is no bus: a Unix socket stands for it, for machines without CAN. A job may name one only
//! beside a simulated arm.

use super::frame::{BusState, Frame, Heard};
use super::node::Fault;
use super::sensor::{Health, Note, Sensor, SensorSettings};
use plumbline_rt::os::now_ns;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use socketcan::errors::{ControllerProblems, ErrorCause};
use socketcan::{CanDataFrame, CanError, CanFilter, CanFrame, CanSocket, EmbeddedFrame, StandardId};
use socketcan::{ShouldRetry, Socket, SocketOptions};
use std::io::{Error, ErrorKind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// What stands before the path of the Unix socket (`SOCK_SEQPACKET`, one `struct can_frame` per packet) that plays a bus.
pub const SIMULATED: &str = "simulated:";
/// How long the thread waits for a frame, and with it how often time passes for the device.
const PATIENCE: Duration = Duration::from_millis(5);
/// From one attempt to open the interface to the next.
const REOPEN: Duration = Duration::from_millis(500);
/// Frames that are taken in before time passes for the device again.
const BACKLOG: usize = 64;
/// Least time between two reports \[ns\].
const REPORT: u64 = 4_000_000;
/// Silence after which the thread counts as gone \[ns\].
const GONE: u64 = 500_000_000;
/// Frames flow without an error for so long: the controller is well again \[ns\].
const WELL: u64 = 1_000_000_000;

/// An interface that can't be listened to.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// There is no such interface, or it is none of CAN's.
    #[error("CAN interface `{interface}` can't be opened: {error}")]
    Open {
        /// Name of the interface.
        interface: String,
        /// Why.
        error: Error,
    },
    /// No thread could be started.
    #[error("no thread for the inclinometer: {0}")]
    Thread(Error),
}

/// What the thread says of the sensor.
#[derive(Clone, Copy, Debug)]
struct Report {
    at: u64,
    health: Health,
}

/// The newest report alone: a daemon that was busy for seconds, with connecting to its arm, has no use for the older ones.
#[derive(Clone)]
struct Board(Arc<Mutex<Report>>);

impl Board {
    fn put(&self, report: Report) {
        // Held for a copy and nothing else, so nobody can have panicked with it.
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = report;
    }

    /// `None` while a report is being put there: the one read before is as good.
    fn look(&self) -> Option<Report> {
        self.0.try_lock().ok().map(|report| *report)
    }
}

/// This side of the thread that listens.
pub struct Listener {
    board: Board,
    last: Report,
    quit: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Opens `interface` and brings the device up on a thread of its own; the thread has the priority of the caller, so call this before
    /// that goes up.
    ///
    /// # Errors
    /// An interface that does not exist or is none of CAN's. One that is down is waited for.
    pub fn start(interface: &str, sensor: Sensor, settings: &SensorSettings) -> Result<Listener, ListenError> {
        let named = |error| ListenError::Open { interface: interface.to_string(), error };
        let socket = open(interface, settings.node.node).map_err(named)?;
        if let Some(path) = interface.strip_prefix(SIMULATED) {
            tracing::warn!("the inclinometer is simulated: `{path}` stands for a CAN bus");
        }
        let quit = Arc::new(AtomicBool::new(false));
        let last = Report { at: now_ns(), health: sensor.health() };
        let board = Board(Arc::new(Mutex::new(last)));
        let thread = Thread {
            interface: interface.to_string(),
            node: settings.node.node,
            socket: Some(socket),
            sensor,
            bus: BusState::Active,
            troubled: 0,
            board: board.clone(),
            reported: 0,
            quit: Arc::clone(&quit),
        };
        let builder = std::thread::Builder::new().name("plumbline-can".into());
        let thread = builder.spawn(move || thread.run()).map_err(ListenError::Thread)?;
        Ok(Listener { board, last, quit, thread: Some(thread) })
    }

    /// How the sensor is at `now` \[ns\]; never waits.
    pub fn health(&mut self, now: u64) -> Health {
        self.last = self.board.look().unwrap_or(self.last);
        let silent = now.saturating_sub(self.last.at);
        if silent > GONE { Health::Bad(Fault::NoListener { silent_ms: silent / 1_000_000 }) } else { self.last.health }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.quit.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // A thread that has panicked has already said so.
            let _ = thread.join();
        }
    }
}

struct Thread {
    interface: String,
    node: u8,
    socket: Option<CanSocket>,
    sensor: Sensor,
    bus: BusState,
    /// When the bus was last in trouble \[ns\].
    troubled: u64,
    board: Board,
    reported: u64,
    quit: Arc<AtomicBool>,
}

impl Thread {
    fn run(mut self) {
        while !self.quit.load(Ordering::Acquire) {
            if self.socket.is_none() {
                std::thread::sleep(REOPEN.min(Duration::from_nanos(GONE / 2)));
                self.reopen();
            }
            self.listen();
            self.sensor.tick(now_ns());
            self.send();
            self.say();
            self.report();
        }
    }

    fn reopen(&mut self) {
        if is_up(&self.interface) {
            self.socket = open(&self.interface, self.node).ok();
            if self.socket.is_some() {
                self.bus_is(BusState::Active);
            }
        }
    }

    /// Waits for a frame, or for [`PATIENCE`], and takes in what else has come: after a time without the processor, what waits in the
    /// socket is not silence.
    fn listen(&mut self) {
        let mut patience = PATIENCE;
        for _ in 0..BACKLOG {
            let Some(socket) = &self.socket else { return };
            let asked = now_ns();
            match socket.read_frame_timeout(patience) {
                Ok(frame) => self.hear(&frame),
                // A signal says nothing of what waits.
                Err(error) if error.kind() == ErrorKind::Interrupted => return,
                Err(error) if error.should_retry() || error.kind() == ErrorKind::TimedOut => {
                    // By the time before the answer: what has come since then, with this thread asleep, was sent later than that.
                    return self.sensor.hear(asked, &Heard::Nothing);
                }
                // ENETDOWN, ENODEV, and whatever else makes this socket useless.
                Err(_) => return self.close(),
            }
            patience = Duration::ZERO;
        }
    }

    fn hear(&mut self, frame: &CanFrame) {
        let data = match frame {
            CanFrame::Data(data) => data,
            CanFrame::Remote(_) => return,
            CanFrame::Error(error) => return self.trouble(&CanError::from(*error)),
        };
        if self.bus != BusState::Active && now_ns().saturating_sub(self.troubled) > WELL {
            self.bus_is(BusState::Active);
        }
        if let socketcan::Id::Standard(id) = data.id()
            && let Some(frame) = Frame::new(id.as_raw(), data.data())
        {
            self.sensor.hear(now_ns(), &Heard::Frame(frame));
        }
    }

    fn close(&mut self) {
        self.socket = None;
        self.bus_is(BusState::Down);
    }

    /// What the controller says of itself.
    fn trouble(&mut self, error: &CanError) {
        let passive = ControllerProblems::RX_PASSIVE | ControllerProblems::TX_PASSIVE;
        let controller = |problem: ControllerProblems| {
            error.causes().any(|cause| matches!(cause, ErrorCause::Controller(own) if own.intersects(problem)))
        };
        if error.is_bus_off() {
            self.bus_is(BusState::Off);
        } else if controller(passive) {
            self.bus_is(BusState::Passive);
        } else if error.is_restarted() || controller(ControllerProblems::ACTIVE) {
            self.bus_is(BusState::Active);
        }
    }

    fn bus_is(&mut self, state: BusState) {
        if state != BusState::Active {
            self.troubled = now_ns();
        }
        if std::mem::replace(&mut self.bus, state) != state {
            self.sensor.hear(now_ns(), &Heard::Bus(state));
        }
    }

    fn send(&mut self) {
        while let Some(frame) = self.sensor.transmit() {
            let Some(socket) = &self.socket else { return };
            let Some(id) = StandardId::new(frame.id()) else { continue };
            let Some(frame) = CanDataFrame::new(id, frame.data()) else { continue };
            match socket.write_frame(&frame) {
                Ok(()) if self.bus == BusState::Blocked => self.bus_is(BusState::Active),
                Ok(()) => {}
                Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) || error.kind() == ErrorKind::WouldBlock => {
                    self.bus_is(BusState::Blocked);
                }
                Err(_) => self.close(),
            }
        }
    }

    /// Faults are said here, where there is time for it.
    fn say(&mut self) {
        while let Some(note) = self.sensor.note() {
            match note {
                Note::Up(identity) => tracing::info!(
                    "inclinometer on {}: vendor {:08X}h, product {:08X}h, serial number {}, unit {} millidegrees",
                    self.interface,
                    identity.vendor,
                    identity.product,
                    identity.serial,
                    identity.resolution
                ),
                Note::Fault(fault) => tracing::warn!("{}: {fault}", self.interface),
                Note::Well => tracing::info!("{}: the inclinometer's slopes are good", self.interface),
                Note::Odd(fault) => tracing::warn!("{}: {fault}; passed over", self.interface),
            }
        }
    }

    fn report(&mut self) {
        let at = now_ns();
        if at.saturating_sub(self.reported) >= REPORT {
            self.reported = at;
            self.board.put(Report { at, health: self.sensor.health() });
        }
    }
}

/// A socket that hears the device and the controller's errors alone.
fn open(interface: &str, node: u8) -> std::io::Result<CanSocket> {
    let socket = match interface.strip_prefix(SIMULATED) {
        Some(path) => simulated(path)?,
        None => bus(interface, node)?,
    };
    socket.set_read_timeout(PATIENCE)?;
    socket.set_write_timeout(PATIENCE)?;
    Ok(socket)
}

fn bus(interface: &str, node: u8) -> std::io::Result<CanSocket> {
    let socket = CanSocket::open(interface)?;
    // The flags are part of the mask: frames with 29-bit identifiers and remote requests are none of the device's.
    let mask = libc::CAN_SFF_MASK | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG;
    let filter = |base: u32| CanFilter::new(base + u32::from(node), mask);
    socket.set_filters(&[0x080, 0x180, 0x580, 0x700].map(filter))?;
    socket.set_error_filter_accept_all()?;
    Ok(socket)
}

/// Frames go over this socket as they go over a bus's; the kernel's filter is missing.
fn simulated(path: &str) -> std::io::Result<CanSocket> {
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?;
    rustix::net::connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(CanSocket::from(socket))
}

/// `IFF_UP`, by the kernel's own table.
fn is_up(interface: &str) -> bool {
    if let Some(path) = interface.strip_prefix(SIMULATED) {
        return std::path::Path::new(path).exists();
    }
    let flags = std::fs::read_to_string(format!("/sys/class/net/{interface}/flags")).unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16).unwrap_or(0);
    flags & libc::IFF_UP as u32 != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A listener whose thread is played by the test.
    fn listener() -> Listener {
        let last = Report { at: 0, health: Health::Bad(Fault::NoListener { silent_ms: 0 }) };
        let board = Board(Arc::new(Mutex::new(last)));
        Listener { board, last, quit: Arc::new(AtomicBool::new(false)), thread: None }
    }

    #[test]
    fn after_a_pause_of_the_reader_the_newest_report_is_what_counts() {
        let mut listener = listener();
        // Ten seconds in which the daemon connects to its arm and looks at nothing.
        let of = |at: u64| Health::Bad(Fault::NoListener { silent_ms: at });
        for at in (0..=10_000_000_000).step_by(REPORT as usize) {
            listener.board.put(Report { at, health: of(at) });
        }
        assert_eq!(listener.health(10_000_000_000), of(10_000_000_000));
    }

    #[test]
    fn a_report_that_is_being_written_is_not_waited_for() {
        let mut listener = listener();
        let board = listener.board.clone();
        let held = board.0.lock().unwrap();
        assert_eq!(listener.health(GONE), listener.last.health);
        assert_eq!(listener.health(GONE + 5_000_000), Health::Bad(Fault::NoListener { silent_ms: 505 }));
        drop(held);
    }
}
