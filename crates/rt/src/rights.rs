//! Real-time rights: requested by the loop's thread, and granted by the machine.
//!
//! A call can succeed without effect, in a container for example. Therefore every grant is read back from the kernel: the policy by
//! `sched_getscheduler`, the locked pages by `VmLck` of `/proc/self/status`, the CPUs by
//! `sched_getaffinity`, the kernel's kind by `/sys/kernel/realtime`.

// Rights are requested and read back before the first cycle: the lint walls of the loop do not apply here.
#![allow(clippy::disallowed_methods)]

use super::os::{Scheduling, now_ns, schedule_fifo, scheduling, touch_stack};
use rustix::process::{Resource, getrlimit};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
use std::fs;
use std::io;

/// Bit of `CAP_IPC_LOCK` in a capability mask.
const CAP_IPC_LOCK: u64 = 1 << 14;

/// Rights that a thread requests.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rights {
    /// `SCHED_FIFO` priority, 1 to 99; `None` leaves the thread at normal priority.
    pub priority: Option<u8>,
    /// CPU to pin the thread to, counted from 0; `None` for any.
    pub cpu: Option<usize>,
    /// Whether to lock the process's memory into RAM.
    pub lock_memory: bool,
    /// Whether the kernel should be a PREEMPT_RT one.
    pub preempt_rt: bool,
}

impl Default for Rights {
    /// Priority 80, no pinning, locked memory, a PREEMPT_RT kernel.
    fn default() -> Rights {
        Rights { priority: Some(80), cpu: None, lock_memory: true, preempt_rt: true }
    }
}

impl Rights {
    /// No request: tests and simulated time.
    pub const NONE: Rights = Rights { priority: None, cpu: None, lock_memory: false, preempt_rt: false };
}

/// Result of one request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Grant {
    /// It was not requested.
    NotAsked,
    /// It holds; the details.
    Granted(String),
    /// It does not hold; why, and what to change.
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
    /// A PREEMPT_RT kernel.
    pub kernel: Grant,
}

impl Granted {
    /// Every refusal, with what to change. While there is one, the loop is *degraded*.
    pub fn refusals(&self) -> impl Iterator<Item = &str> {
        [&self.fifo, &self.memory, &self.cpu, &self.kernel].into_iter().filter_map(Grant::refusal)
    }
}

/// Applies `rights` to the calling thread, touches its stack, and reads back what holds. Threads started from it later run at
/// normal priority again.
pub fn become_realtime(rights: &Rights) -> Granted {
    let memory = if rights.lock_memory { lock_memory() } else { Grant::NotAsked };
    touch_stack();
    // The first call finds the kernel's clock page by system calls, which a cycle must not make.
    now_ns();
    Granted {
        fifo: rights.priority.map_or(Grant::NotAsked, fifo),
        memory,
        cpu: rights.cpu.map_or(Grant::NotAsked, pin),
        kernel: if rights.preempt_rt { kernel(preempt_rt()) } else { Grant::NotAsked },
    }
}

/// Whether the running kernel is a PREEMPT_RT one (`/sys/kernel/realtime` reads 1).
pub fn preempt_rt() -> bool {
    fs::read_to_string("/sys/kernel/realtime").is_ok_and(|text| text.trim() == "1")
}

fn kernel(preempt_rt: bool) -> Grant {
    if preempt_rt {
        return Grant::Granted("a PREEMPT_RT kernel".to_string());
    }
    Grant::Refused(
        "the kernel is not a PREEMPT_RT one: /sys/kernel/realtime does not read 1. Install one (Debian: linux-image-rt-amd64, \
         Ubuntu: linux-realtime), or set realtime.preempt-rt = false where an ordinary kernel is meant"
            .to_string(),
    )
}

fn fifo(priority: u8) -> Grant {
    if !(1..=99).contains(&priority) {
        return Grant::Refused(format!("SCHED_FIFO priority {priority} does not exist: choose 1 to 99"));
    }
    if let Err(error) = schedule_fifo(priority) {
        let limit = getrlimit(Resource::Rtprio).current.map_or("unlimited".to_string(), |limit| limit.to_string());
        return Grant::Refused(format!(
            "SCHED_FIFO priority {priority}: {error}; the limit on real-time priority is {limit}. Set LimitRTPRIO={priority} in \
             the systemd unit, or `rtprio {priority}` for the user in /etc/security/limits.d, or give the program CAP_SYS_NICE"
        ));
    }
    fifo_by_kernel(priority, scheduling())
}

/// Compares the kernel's answer with the request.
fn fifo_by_kernel(priority: u8, found: io::Result<Scheduling>) -> Grant {
    match found {
        Ok(Scheduling { fifo: true, priority: held, reset_on_fork: true }) if held == i32::from(priority) => {
            Grant::Granted(format!("SCHED_FIFO priority {priority}"))
        }
        Ok(found) => Grant::Refused(format!(
            "SCHED_FIFO priority {priority}: the call succeeded, but the kernel has {found:?}. Look for a sandbox (gVisor, a seccomp \
             rule that answers for the kernel) around the program"
        )),
        Err(error) => Grant::Refused(format!("SCHED_FIFO priority {priority}: it can't be read back: {error}")),
    }
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
        Ok(()) if unlimited => locked_by_kernel(&fs::read_to_string("/proc/self/status").unwrap_or_default()),
        Ok(()) => Grant::Refused(format!(
            "only the present memory could be locked: the limit on locked memory is {limit}. {advice}"
        )),
        Err(error) => {
            let error = io::Error::from(error);
            Grant::Refused(format!("locking memory: {error}; the limit on locked memory is {limit}. {advice}"))
        }
    }
}

/// Holds `VmLck` of a process's status file against `VmRSS`: what is in memory must be locked there.
fn locked_by_kernel(status: &str) -> Grant {
    let kib = |field: &str| -> Option<u64> {
        let line = status.lines().find_map(|line| line.strip_prefix(field))?;
        line.trim().strip_suffix("kB")?.trim().parse().ok()
    };
    match (kib("VmLck:"), kib("VmRSS:")) {
        // The kernel's own pages in the process (vdso) count as resident and are not locked.
        (Some(locked), Some(resident)) if locked > 0 && locked >= resident - resident / 16 => {
            Grant::Granted("all memory, present and future".to_string())
        }
        (locked, resident) => Grant::Refused(format!(
            "locking memory: the call succeeded, but the kernel has {} KiB locked of {} KiB resident (/proc/self/status). Look for a \
             sandbox around the program",
            locked.map_or("no".to_string(), |kib| kib.to_string()),
            resident.map_or("?".to_string(), |kib| kib.to_string()),
        )),
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
    if let Err(error) = sched_setaffinity(None, &set) {
        return Grant::Refused(format!(
            "pinning to CPU {cpu}: {}; choose a CPU that exists and that the service may use (AllowedCPUs, CPUAffinity)",
            io::Error::from(error)
        ));
    }
    match sched_getaffinity(None) {
        Ok(held) if held.is_set(cpu) && held.count() == 1 => Grant::Granted(format!("pinned to CPU {cpu}")),
        Ok(held) => Grant::Refused(format!(
            "pinning to CPU {cpu}: the call succeeded, but the kernel allows {} CPUs. Look for a sandbox around the program",
            held.count()
        )),
        Err(error) => {
            Grant::Refused(format!("pinning to CPU {cpu}: it can't be read back: {}", io::Error::from(error)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rights_that_are_not_requested_are_not_changed() {
        let granted = std::thread::spawn(|| become_realtime(&Rights::NONE)).join().unwrap();
        let Granted { fifo, memory, cpu, kernel } = &granted;
        assert!([fifo, memory, cpu, kernel].into_iter().all(|grant| *grant == Grant::NotAsked), "{granted:?}");
        assert_eq!(granted.refusals().count(), 0);
    }

    #[test]
    fn refusals_name_the_request() {
        let rights = Rights { priority: Some(200), cpu: Some(100_000), ..Rights::NONE };
        let granted = std::thread::spawn(move || become_realtime(&rights)).join().unwrap();
        let refusals: Vec<&str> = granted.refusals().collect();
        assert_eq!(refusals.len(), 2);
        assert!(refusals[0].contains("200") && refusals[1].contains("100000"));
    }

    #[test]
    fn the_scheduler_agrees_with_the_grant_and_helpers_inherit_nothing() {
        let (granted, own, helper) = std::thread::spawn(move || {
            let granted = become_realtime(&Rights { priority: Some(10), cpu: Some(0), ..Rights::NONE });
            (granted, scheduling().unwrap(), std::thread::spawn(scheduling).join().unwrap().unwrap())
        })
        .join()
        .unwrap();
        assert_eq!(own.fifo, granted.fifo.refusal().is_none(), "{granted:?} {own:?}");
        assert_eq!((helper.fifo, helper.priority), (false, 0));
    }

    #[test]
    fn a_grant_needs_a_call_that_succeeds_and_the_kernels_confirmation() {
        let held = |fifo, priority, reset_on_fork| Ok(Scheduling { fifo, priority, reset_on_fork });
        assert!(fifo_by_kernel(80, held(true, 80, true)).refusal().is_none());
        for other in [held(false, 0, false), held(true, 79, true), held(true, 80, false), held(false, 80, true)] {
            assert!(fifo_by_kernel(80, other).refusal().is_some());
        }
        assert!(fifo_by_kernel(80, Err(io::ErrorKind::PermissionDenied.into())).refusal().is_some());

        assert!(locked_by_kernel("VmLck:\t   71000 kB\nVmRSS:\t    9000 kB\n").refusal().is_none());
        for status in ["", "VmLck:\t       0 kB\nVmRSS:\t    9000 kB\n", "VmLck:\t    5000 kB\nVmRSS:\t    9000 kB\n"] {
            assert!(locked_by_kernel(status).refusal().is_some(), "{status:?}");
        }
        assert!(kernel(true).refusal().is_none());
        assert!(kernel(false).refusal().is_some_and(|text| text.contains("PREEMPT_RT")));
    }
}
