//! What the loop needs of the operating system: a clock, absolute deadlines, a priority, socket options. The only unsafe code of the
//! crate; rights requested and granted are in [`super::rights`].

#![allow(unsafe_code)]

use plumbline_core::Clock;
use rustix::thread::ClockId;
use rustix::time::{Timespec, clock_gettime};
use std::io;
use std::os::fd::{AsFd, AsRawFd};

const SECOND_NS: u64 = 1_000_000_000;
/// Stack that the loop may use without a page fault.
const STACK: usize = 256 * 1024;

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

/// `CLOCK_MONOTONIC`, for an arm without hardware.
#[derive(Clone, Copy, Debug)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now_ns(&self) -> u64 {
        now_ns()
    }

    fn sleep_until(&self, ns: u64) {
        sleep_until(ns);
    }
}

/// Scheduling policy of the calling thread, as the kernel has it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scheduling {
    /// Whether it is `SCHED_FIFO`.
    pub fifo: bool,
    /// Real-time priority, 0 for ordinary scheduling.
    pub priority: i32,
    /// Whether threads that it starts begin at ordinary priority (`SCHED_RESET_ON_FORK`).
    pub reset_on_fork: bool,
}

/// Asks the kernel how the calling thread is scheduled.
pub(super) fn scheduling() -> io::Result<Scheduling> {
    let mut parameters = libc::sched_param { sched_priority: 0 };
    // SAFETY: thread 0 is the calling thread; `parameters` is a valid sched_param that outlives the calls.
    let (policy, failed) = unsafe { (libc::sched_getscheduler(0), libc::sched_getparam(0, &raw mut parameters)) };
    if policy < 0 || failed != 0 {
        return Err(io::Error::last_os_error());
    }
    Ok(Scheduling {
        fifo: policy & !libc::SCHED_RESET_ON_FORK == libc::SCHED_FIFO,
        priority: parameters.sched_priority,
        reset_on_fork: policy & libc::SCHED_RESET_ON_FORK != 0,
    })
}

/// Puts the calling thread under `SCHED_FIFO`; threads that it starts later begin at ordinary priority.
pub(super) fn schedule_fifo(priority: u8) -> io::Result<()> {
    let parameters = libc::sched_param { sched_priority: libc::c_int::from(priority) };
    // SAFETY: `parameters` is a valid sched_param that outlives the call; thread 0 is the calling thread.
    let failed = unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, &parameters) };
    if failed == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Touches the stack once, so that the loop meets no page fault on it.
#[inline(never)]
pub(super) fn touch_stack() {
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
/// Answer of the system.
pub fn set_socket_priority(socket: impl AsFd, priority: u32) -> io::Result<()> {
    set_socket_number(socket, libc::SO_PRIORITY, priority)
}

/// How long a blocking receive polls the network card before it sleeps (`SO_BUSY_POLL`) \[us\]; raising it needs CAP_NET_ADMIN.
///
/// # Errors
/// Answer of the system.
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
/// Where a datagram seems older than this, the real-time clock was set.
const OLDEST_NS: u64 = 10 * SECOND_NS;

/// How long the datagram that was read last from `socket` had waited since the kernel took it in \[ns\]: what its reader slept through.
/// `None` before the first datagram, and when the real-time clock, which stamps datagrams, was set in between.
// A call that answers at once; RTSan objects to any ioctl.
#[cfg_attr(feature = "rtsan", rtsan_standalone::no_sanitize_realtime)]
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
        // The kernel switches its time stamps on asynchronously: the first datagrams may be stamped only when they are read.
        assert!((0..50).any(|_| waited() >= 15_000_000), "no datagram aged");
        set_socket_priority(&receiver, 6).unwrap();
        assert!(set_socket_priority(&receiver, u32::MAX).is_err());
    }
}
