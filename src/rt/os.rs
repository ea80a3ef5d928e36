//! What the loop asks of the operating system: a clock, absolute deadlines, real-time rights. The only unsafe code of the crate.

#![allow(unsafe_code)]

use rustix::process::{Resource, getrlimit};
use rustix::thread::{ClockId, CpuSet};
use rustix::time::{Timespec, clock_gettime};
use std::fs;
use std::io;
use std::os::fd::{AsFd, AsRawFd};

const SECOND_NS: u64 = 1_000_000_000;
/// Stack that the loop may use without a page fault.
const STACK: usize = 256 * 1024;
/// Bit of `CAP_IPC_LOCK` in a capability mask.
const CAP_IPC_LOCK: u64 = 1 << 14;

/// `CLOCK_MONOTONIC` \[ns\].
pub fn now_ns() -> u64 {
    let now = clock_gettime(rustix::time::ClockId::Monotonic);
    u64::try_from(now.tv_sec).unwrap_or(0) * SECOND_NS + u64::try_from(now.tv_nsec).unwrap_or(0)
}

/// Sleeps until `CLOCK_MONOTONIC` shows `deadline_ns`; returns at once when it has passed. Signals don't shorten the sleep.
pub fn sleep_until(deadline_ns: u64) {
    let request = Timespec {
        tv_sec: (deadline_ns / SECOND_NS).try_into().unwrap_or(i64::MAX),
        tv_nsec: (deadline_ns % SECOND_NS).try_into().unwrap_or(0),
    };
    while rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &request) == Err(rustix::io::Errno::INTR) {}
}

/// What the loop's thread should ask for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rights {
    /// `SCHED_FIFO` priority, 1 to 99; `None` leaves the thread at normal priority.
    pub priority: Option<u8>,
    /// CPU to pin the thread to, counted from 0; `None` leaves it to the scheduler.
    pub cpu: Option<usize>,
    /// Whether to lock the process's memory into RAM.
    pub lock_memory: bool,
}

impl Default for Rights {
    /// Priority 80, no pinning, locked memory.
    fn default() -> Rights {
        Rights { priority: Some(80), cpu: None, lock_memory: true }
    }
}

impl Rights {
    /// Asks for nothing: tests and simulated time.
    pub const NONE: Rights = Rights { priority: None, cpu: None, lock_memory: false };
}

/// What became of one request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grant {
    /// It was not asked for.
    NotAsked,
    /// It holds; the text says exactly what.
    Granted(String),
    /// It does not hold; the text says why and what to change.
    Refused(String),
}

impl Grant {
    /// Why it was refused and what to change, if it was.
    pub fn refusal(&self) -> Option<&str> {
        match self {
            Grant::Refused(text) => Some(text),
            Grant::NotAsked | Grant::Granted(_) => None,
        }
    }
}

/// What the system granted the loop's thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Granted {
    /// Real-time scheduling.
    pub fifo: Grant,
    /// Locked memory.
    pub memory: Grant,
    /// Pinning to one CPU.
    pub cpu: Grant,
    /// Whether the kernel is a PREEMPT_RT one.
    pub preempt_rt: bool,
}

impl Granted {
    /// Every refusal, with what to change.
    pub fn refusals(&self) -> impl Iterator<Item = &str> {
        [&self.fifo, &self.memory, &self.cpu].into_iter().filter_map(Grant::refusal)
    }
}

/// Applies `rights` to the calling thread and touches its stack. Threads started from it later run at normal priority again.
pub fn become_realtime(rights: &Rights) -> Granted {
    let memory = if rights.lock_memory { lock_memory() } else { Grant::NotAsked };
    touch_stack();
    Granted {
        fifo: rights.priority.map_or(Grant::NotAsked, schedule_fifo),
        memory,
        cpu: rights.cpu.map_or(Grant::NotAsked, pin),
        preempt_rt: preempt_rt(),
    }
}

/// Whether the running kernel is a PREEMPT_RT one (`/sys/kernel/realtime` reads 1).
pub fn preempt_rt() -> bool {
    fs::read_to_string("/sys/kernel/realtime").is_ok_and(|text| text.trim() == "1")
}

fn schedule_fifo(priority: u8) -> Grant {
    if !(1..=99).contains(&priority) {
        return Grant::Refused(format!("SCHED_FIFO priority {priority} does not exist: choose 1 to 99"));
    }
    let parameters = libc::sched_param { sched_priority: libc::c_int::from(priority) };
    // SAFETY: `parameters` is a valid sched_param that outlives the call; thread 0 is the calling thread.
    let failed = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, &parameters) };
    if failed == 0 {
        return Grant::Granted(format!("SCHED_FIFO priority {priority}"));
    }
    let error = io::Error::last_os_error();
    let limit = getrlimit(Resource::Rtprio).current.map_or("unlimited".to_string(), |limit| limit.to_string());
    Grant::Refused(format!(
        "SCHED_FIFO priority {priority}: {error}; the limit on real-time priority is {limit}. Set LimitRTPRIO={priority} in \
         the systemd unit, or `rtprio {priority}` for the user in /etc/security/limits.d, or give the program CAP_SYS_NICE"
    ))
}

fn lock_memory() -> Grant {
    use rustix::mm::{MlockAllFlags, mlockall};
    let limit = getrlimit(Resource::Memlock).current;
    // Under a finite limit every later allocation of the process could fail, so the future is locked only without one.
    let unlimited = limit.is_none() || has_capability(CAP_IPC_LOCK);
    let limit = limit.map_or("unlimited".to_string(), |bytes| format!("{} KiB", bytes / 1024));
    let advice = "Set LimitMEMLOCK=infinity in the systemd unit, or `memlock unlimited` for the user in \
                  /etc/security/limits.d, or give the program CAP_IPC_LOCK";
    let flags = if unlimited { MlockAllFlags::CURRENT | MlockAllFlags::FUTURE } else { MlockAllFlags::CURRENT };
    match mlockall(flags) {
        Ok(()) if unlimited => Grant::Granted("all memory, present and future".to_string()),
        Ok(()) => Grant::Refused(format!(
            "only the present memory could be locked: the limit on locked memory is {limit}. {advice}"
        )),
        Err(error) => {
            let error = io::Error::from(error);
            Grant::Refused(format!("locking memory: {error}; the limit on locked memory is {limit}. {advice}"))
        }
    }
}

fn has_capability(bit: u64) -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("CapEff:"));
    mask.and_then(|hex| u64::from_str_radix(hex.trim(), 16).ok()).is_some_and(|mask| mask & bit != 0)
}

fn pin(cpu: usize) -> Grant {
    if cpu >= CpuSet::MAX_CPU {
        return Grant::Refused(format!("CPU {cpu} does not exist"));
    }
    let mut set = CpuSet::new();
    set.set(cpu);
    match rustix::thread::sched_setaffinity(None, &set) {
        Ok(()) => Grant::Granted(format!("pinned to CPU {cpu}")),
        Err(error) => Grant::Refused(format!(
            "pinning to CPU {cpu}: {}; choose a CPU that exists and that the service may use (AllowedCPUs, CPUAffinity)",
            io::Error::from(error)
        )),
    }
}

/// Touches the stack once, so that the loop meets no page fault on it.
#[inline(never)]
fn touch_stack() {
    let mut pages = [0_u8; STACK];
    for page in pages.chunks_mut(4096) {
        if let Some(byte) = page.first_mut() {
            // SAFETY: `byte` is a valid exclusive reference; the write is volatile so that it is not optimised away.
            unsafe { std::ptr::write_volatile(byte, 1) };
        }
    }
    std::hint::black_box(&pages);
}

/// Kernel's queueing priority of what a socket sends (`SO_PRIORITY`); above 6 it needs CAP_NET_ADMIN.
///
/// # Errors
/// What the system says.
pub fn set_socket_priority(socket: impl AsFd, priority: u32) -> io::Result<()> {
    set_socket_number(socket, libc::SO_PRIORITY, priority)
}

/// How long a blocking receive polls the network card before it sleeps (`SO_BUSY_POLL`) \[us\]; raising it needs CAP_NET_ADMIN.
///
/// # Errors
/// What the system says.
pub fn set_socket_busy_poll(socket: impl AsFd, micros: u32) -> io::Result<()> {
    set_socket_number(socket, libc::SO_BUSY_POLL, micros)
}

fn set_socket_number(socket: impl AsFd, option: libc::c_int, value: u32) -> io::Result<()> {
    let value = libc::c_int::try_from(value).map_err(|_| io::ErrorKind::InvalidInput)?;
    let size = size_of_val(&value) as libc::socklen_t;
    let fd = socket.as_fd().as_raw_fd();
    // SAFETY: the descriptor is open for as long as it is borrowed; pointer and size describe `value`, which outlives the call.
    let failed = unsafe { libc::setsockopt(fd, libc::SOL_SOCKET, option, (&raw const value).cast(), size) };
    if failed == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// `SIOCGSTAMPNS` of Linux (`asm-generic/sockios.h`), which the libc crate does not name.
const SIOCGSTAMPNS: u32 = 0x8907;
/// A datagram that seems older than this says that the real-time clock was set.
const OLDEST_NS: u64 = 10 * SECOND_NS;

/// How long the datagram that was read last from `socket` had waited since the kernel took it in \[ns\]: what its reader slept through.
/// `None` before the first datagram, and when the real-time clock, which stamps datagrams, was set in between.
pub fn datagram_age_ns(socket: impl AsFd) -> Option<u64> {
    let mut stamp = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    let fd = socket.as_fd().as_raw_fd();
    // SAFETY: the descriptor is open for as long as it is borrowed, and this request writes one timespec, which outlives the call.
    let failed = unsafe { libc::ioctl(fd, SIOCGSTAMPNS as _, &raw mut stamp) };
    if failed != 0 || stamp.tv_sec <= 0 {
        return None;
    }
    let now = clock_gettime(rustix::time::ClockId::Realtime);
    let seconds = now.tv_sec.checked_sub(stamp.tv_sec)?;
    let age = seconds.checked_mul(SECOND_NS as i64)?.checked_add(now.tv_nsec - stamp.tv_nsec)?;
    u64::try_from(age).ok().filter(|&age| age <= OLDEST_NS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absolute_sleep_never_wakes_early_and_a_past_deadline_returns_at_once() {
        let start = now_ns();
        for k in 1..=5 {
            sleep_until(start + k * 1_000_000);
            assert!(now_ns() >= start + k * 1_000_000);
        }
        sleep_until(0);
        sleep_until(start);
    }

    #[test]
    fn a_datagram_is_as_old_as_it_has_waited() {
        let sender = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        let receiver = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
        // The first question switches the stamps on.
        assert_eq!(datagram_age_ns(&receiver), None);
        let waited = || {
            let before = now_ns();
            sender.send_to(&[1], receiver.local_addr().unwrap()).unwrap();
            sleep_until(before + 20_000_000);
            receiver.recv(&mut [0]).unwrap();
            let age = datagram_age_ns(&receiver).unwrap();
            assert!(age <= now_ns() - before + 5_000_000, "{age}");
            age
        };
        // The kernel switches its own stamping on behind the scenes: the first datagrams may be stamped only when they are read.
        assert!((0..50).any(|_| waited() >= 15_000_000), "no datagram aged");
        set_socket_priority(&receiver, 6).unwrap();
        assert!(set_socket_priority(&receiver, u32::MAX).is_err());
    }

    #[test]
    fn what_is_not_asked_is_not_done() {
        let granted = std::thread::spawn(|| become_realtime(&Rights::NONE)).join().unwrap();
        assert_eq!(
            (&granted.fifo, &granted.memory, &granted.cpu),
            (&Grant::NotAsked, &Grant::NotAsked, &Grant::NotAsked)
        );
        assert_eq!(granted.refusals().count(), 0);
    }

    #[test]
    fn refusals_say_what_was_asked() {
        let rights = Rights { priority: Some(200), cpu: Some(100_000), lock_memory: false };
        let granted = std::thread::spawn(move || become_realtime(&rights)).join().unwrap();
        let refusals: Vec<&str> = granted.refusals().collect();
        assert_eq!(refusals.len(), 2);
        assert!(refusals[0].contains("200") && refusals[1].contains("100000"));
    }

    #[test]
    fn the_scheduler_agrees_with_the_grant_and_helpers_inherit_nothing() {
        // SAFETY: asks for the calling thread's own policy.
        let policy = || unsafe { libc::sched_getscheduler(0) } & !libc::SCHED_RESET_ON_FORK;
        let (granted, own, helper) = std::thread::spawn(move || {
            let granted = become_realtime(&Rights { priority: Some(10), cpu: Some(0), lock_memory: false });
            (granted, policy(), std::thread::spawn(policy).join().unwrap())
        })
        .join()
        .unwrap();
        assert_eq!(own == libc::SCHED_FIFO, granted.fifo.refusal().is_none(), "{granted:?}");
        assert_eq!(helper, libc::SCHED_OTHER);
    }
}
