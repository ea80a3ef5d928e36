//! The inclinometer over SocketCAN, on its own thread at ordinary priority.
//!
//! Bit rate and restart after bus-off are properties of the interface (`ip link set can0 up type can bitrate 250000 restart-ms 100`).
//! The kernel's filter passes only the device's identifiers. The daemon reads the latest report without blocking.
//!
//! `simulated:PATH` in place of an interface is a Unix socket that simulates a CAN bus, for machines without CAN. A job may use it only
//! with a simulated arm.

use super::fault::Fault;
use super::frame::{BusEvent, BusState, Frame};
use super::sensor::{Health, Sensor, SensorEvent, SensorSettings};
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

/// Prefix of the path of a Unix socket that simulates a bus: `SOCK_SEQPACKET`, one `struct can_frame` per packet.
pub const SIMULATED_PREFIX: &str = "simulated:";
/// Timeout of one read, and the interval of the device's timers.
const READ_TIMEOUT: Duration = Duration::from_millis(5);
/// Time between two attempts to open the interface.
const REOPEN_INTERVAL: Duration = Duration::from_millis(500);
/// Frames that are processed between two updates of the device's timers.
const MAX_FRAMES_PER_TICK: usize = 64;
/// Minimum time between two reports \[ns\].
const REPORT_INTERVAL_NS: u64 = 4_000_000;
/// Time without a report after which the thread counts as hung \[ns\].
const REPORT_TIMEOUT_NS: u64 = 500_000_000;
/// Time without an error frame after which the controller counts as error-active again \[ns\].
const RECOVERY_TIME_NS: u64 = 1_000_000_000;

#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    #[error("CAN interface `{interface}` can't be opened: {error}")]
    Open { interface: String, error: Error },
    #[error("the thread of the inclinometer can't be started: {0}")]
    Thread(Error),
}

/// State of the sensor, with its time.
#[derive(Clone, Copy, Debug)]
struct Report {
    at: u64,
    health: Health,
}

/// Slot for the newest report; older ones are overwritten.
#[derive(Clone)]
struct LatestReport(Arc<Mutex<Report>>);

impl LatestReport {
    fn store(&self, report: Report) {
        // The lock is held for a copy only, so a poisoned lock still holds a whole report.
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = report;
    }

    /// The newest report; `None` while the other thread is writing it.
    fn load(&self) -> Option<Report> {
        self.0.try_lock().ok().map(|report| *report)
    }
}

pub struct Listener {
    latest: LatestReport,
    last: Report,
    quit: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listener {
    /// Opens `interface` and starts the thread, which brings the device up. The thread inherits the caller's priority: call this before
    /// raising the priority.
    /// Errors: an interface that does not exist or is not a CAN interface. An interface that is down is no error.
    pub fn start(interface: &str, sensor: Sensor, settings: &SensorSettings) -> Result<Listener, ListenError> {
        let named = |error| ListenError::Open { interface: interface.to_string(), error };
        let socket = open(interface, settings.node.node).map_err(named)?;
        if let Some(path) = interface.strip_prefix(SIMULATED_PREFIX) {
            tracing::warn!("the inclinometer is simulated: `{path}` replaces a CAN bus");
        }
        let quit = Arc::new(AtomicBool::new(false));
        let last = Report { at: now_ns(), health: sensor.health() };
        let latest = LatestReport(Arc::new(Mutex::new(last)));
        let thread = ListenerThread {
            interface: interface.to_string(),
            node: settings.node.node,
            socket: Some(socket),
            sensor,
            bus: BusState::Active,
            last_bus_error: 0,
            latest: latest.clone(),
            reported: 0,
            quit: Arc::clone(&quit),
        };
        let builder = std::thread::Builder::new().name("plumbline-can".into());
        let thread = builder.spawn(move || thread.run()).map_err(ListenError::Thread)?;
        Ok(Listener { latest, last, quit, thread: Some(thread) })
    }

    /// State of the sensor at `now` \[ns\]; does not block.
    pub fn health(&mut self, now: u64) -> Health {
        self.last = self.latest.load().unwrap_or(self.last);
        let elapsed = now.saturating_sub(self.last.at);
        if elapsed > REPORT_TIMEOUT_NS {
            Health::Bad(Fault::ListenerTimeout { elapsed_ms: elapsed / 1_000_000 })
        } else {
            self.last.health
        }
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        self.quit.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            // The panic hook has already logged a panic.
            let _ = thread.join();
        }
    }
}

struct ListenerThread {
    interface: String,
    node: u8,
    socket: Option<CanSocket>,
    sensor: Sensor,
    bus: BusState,
    /// Time of the last bus error \[ns\].
    last_bus_error: u64,
    latest: LatestReport,
    reported: u64,
    quit: Arc<AtomicBool>,
}

impl ListenerThread {
    fn run(mut self) {
        while !self.quit.load(Ordering::Acquire) {
            if self.socket.is_none() {
                std::thread::sleep(REOPEN_INTERVAL.min(Duration::from_nanos(REPORT_TIMEOUT_NS / 2)));
                self.reopen();
            }
            self.receive();
            self.sensor.tick(now_ns());
            self.transmit();
            self.log_events();
            self.report();
        }
    }

    fn reopen(&mut self) {
        if is_up(&self.interface) {
            self.socket = open(&self.interface, self.node).ok();
            if self.socket.is_some() {
                self.set_bus_state(BusState::Active);
            }
        }
    }

    /// Waits up to [`READ_TIMEOUT`] for a frame, then reads the queued ones before any timeout is checked.
    fn receive(&mut self) {
        let mut timeout = READ_TIMEOUT;
        for _ in 0..MAX_FRAMES_PER_TICK {
            let Some(socket) = &self.socket else { return };
            let polled_at = now_ns();
            match socket.read_frame_timeout(timeout) {
                Ok(frame) => self.handle_frame(&frame),
                // After a signal the queue may not be empty.
                Err(error) if error.kind() == ErrorKind::Interrupted => return,
                Err(error) if error.should_retry() || error.kind() == ErrorKind::TimedOut => {
                    // The queue was empty at some time after `polled_at`, so later frames were sent after `polled_at`.
                    return self.sensor.handle(polled_at, &BusEvent::Idle);
                }
                // ENETDOWN, ENODEV and other errors of an unusable socket.
                Err(_) => return self.close(),
            }
            timeout = Duration::ZERO;
        }
    }

    fn handle_frame(&mut self, frame: &CanFrame) {
        let data = match frame {
            CanFrame::Data(data) => data,
            CanFrame::Remote(_) => return,
            CanFrame::Error(error) => return self.handle_error_frame(&CanError::from(*error)),
        };
        if self.bus != BusState::Active && now_ns().saturating_sub(self.last_bus_error) > RECOVERY_TIME_NS {
            self.set_bus_state(BusState::Active);
        }
        if let socketcan::Id::Standard(id) = data.id()
            && let Some(frame) = Frame::new(id.as_raw(), data.data())
        {
            self.sensor.handle(now_ns(), &BusEvent::Frame(frame));
        }
    }

    fn close(&mut self) {
        self.socket = None;
        self.set_bus_state(BusState::Down);
    }

    /// Updates the bus state from an error frame of the controller.
    fn handle_error_frame(&mut self, error: &CanError) {
        let passive = ControllerProblems::RX_PASSIVE | ControllerProblems::TX_PASSIVE;
        let controller = |problem: ControllerProblems| {
            error.causes().any(|cause| matches!(cause, ErrorCause::Controller(own) if own.intersects(problem)))
        };
        if error.is_bus_off() {
            self.set_bus_state(BusState::Off);
        } else if controller(passive) {
            self.set_bus_state(BusState::Passive);
        } else if error.is_restarted() || controller(ControllerProblems::ACTIVE) {
            self.set_bus_state(BusState::Active);
        }
    }

    fn set_bus_state(&mut self, state: BusState) {
        if state != BusState::Active {
            self.last_bus_error = now_ns();
        }
        if std::mem::replace(&mut self.bus, state) != state {
            self.sensor.handle(now_ns(), &BusEvent::Bus(state));
        }
    }

    fn transmit(&mut self) {
        while let Some(frame) = self.sensor.transmit() {
            let Some(socket) = &self.socket else { return };
            let Some(id) = StandardId::new(frame.id()) else { continue };
            let Some(frame) = CanDataFrame::new(id, frame.data()) else { continue };
            match socket.write_frame(&frame) {
                Ok(()) if self.bus == BusState::Blocked => self.set_bus_state(BusState::Active),
                Ok(()) => {}
                Err(error) if error.raw_os_error() == Some(libc::ENOBUFS) || error.kind() == ErrorKind::WouldBlock => {
                    self.set_bus_state(BusState::Blocked);
                }
                Err(_) => self.close(),
            }
        }
    }

    fn log_events(&mut self) {
        while let Some(event) = self.sensor.event() {
            match event {
                SensorEvent::Up(identity) => tracing::info!(
                    "inclinometer on {}: vendor {:08X}h, product {:08X}h, serial number {}, unit {} millidegrees",
                    self.interface,
                    identity.vendor,
                    identity.product,
                    identity.serial,
                    identity.resolution
                ),
                SensorEvent::Fault(fault) => tracing::warn!("{}: {fault}", self.interface),
                SensorEvent::Recovered => tracing::info!("{}: the inclinometer's readings are valid", self.interface),
                SensorEvent::Malformed(fault) => tracing::warn!("{}: {fault}; ignored", self.interface),
            }
        }
    }

    fn report(&mut self) {
        let at = now_ns();
        if at.saturating_sub(self.reported) >= REPORT_INTERVAL_NS {
            self.reported = at;
            self.latest.store(Report { at, health: self.sensor.health() });
        }
    }
}

/// Opens a socket that receives the device's frames and the controller's error frames.
fn open(interface: &str, node: u8) -> std::io::Result<CanSocket> {
    let socket = match interface.strip_prefix(SIMULATED_PREFIX) {
        Some(path) => simulated(path)?,
        None => bus(interface, node)?,
    };
    socket.set_read_timeout(READ_TIMEOUT)?;
    socket.set_write_timeout(READ_TIMEOUT)?;
    Ok(socket)
}

fn bus(interface: &str, node: u8) -> std::io::Result<CanSocket> {
    let socket = CanSocket::open(interface)?;
    // With the flags in the mask, frames with 29-bit identifiers and remote requests are filtered out.
    let mask = libc::CAN_SFF_MASK | libc::CAN_EFF_FLAG | libc::CAN_RTR_FLAG;
    let filter = |base: u32| CanFilter::new(base + u32::from(node), mask);
    socket.set_filters(&[0x080, 0x180, 0x580, 0x700].map(filter))?;
    socket.set_error_filter_accept_all()?;
    Ok(socket)
}

/// Opens a simulated bus: the same frames, without the kernel's filter.
fn simulated(path: &str) -> std::io::Result<CanSocket> {
    let socket = rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?;
    rustix::net::connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(CanSocket::from(socket))
}

/// Whether the kernel reports `IFF_UP` for the interface.
fn is_up(interface: &str) -> bool {
    if let Some(path) = interface.strip_prefix(SIMULATED_PREFIX) {
        return std::path::Path::new(path).exists();
    }
    let flags = std::fs::read_to_string(format!("/sys/class/net/{interface}/flags")).unwrap_or_default();
    let flags = u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16).unwrap_or(0);
    flags & libc::IFF_UP as u32 != 0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A listener without a thread: the test writes the reports.
    fn listener() -> Listener {
        let last = Report { at: 0, health: Health::Bad(Fault::ListenerTimeout { elapsed_ms: 0 }) };
        let latest = LatestReport(Arc::new(Mutex::new(last)));
        Listener { latest, last, quit: Arc::new(AtomicBool::new(false)), thread: None }
    }

    #[test]
    fn health_returns_the_newest_report() {
        let mut listener = listener();
        // Ten seconds without a read, as while the daemon connects to an arm.
        let of = |at: u64| Health::Bad(Fault::ListenerTimeout { elapsed_ms: at });
        for at in (0..=10_000_000_000).step_by(REPORT_INTERVAL_NS as usize) {
            listener.latest.store(Report { at, health: of(at) });
        }
        assert_eq!(listener.health(10_000_000_000), of(10_000_000_000));
    }

    #[test]
    fn health_does_not_block_on_a_report_being_written() {
        let mut listener = listener();
        let latest = listener.latest.clone();
        let held = latest.0.lock().unwrap();
        assert_eq!(listener.health(REPORT_TIMEOUT_NS), listener.last.health);
        assert_eq!(
            listener.health(REPORT_TIMEOUT_NS + 5_000_000),
            Health::Bad(Fault::ListenerTimeout { elapsed_ms: 505 })
        );
        drop(held);
    }
}
