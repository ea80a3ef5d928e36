//! Real-time fitness of the computer from `/proc` and `/sys`.

use super::tree::list_has;
use super::{Finding, Requirements, Tree};
use std::net::IpAddr;
use std::path::Path;

/// Largest acceptable exit latency of an idle state \[us\].
const MAX_IDLE_EXIT_US: i64 = 20;
/// Shared memory needed for one robot \[bytes\].
const REQUIRED_SHM_BYTES: u64 = 64 << 20;

/// All findings that need no measurement, in order of importance.
pub fn inspect(tree: &Tree, requirements: &Requirements) -> Vec<Finding> {
    let mut findings = vec![
        hypervisor(tree),
        governor(tree),
        idle_states(tree, requirements.rights.cpu),
        isolation(tree, requirements.rights.cpu),
        interrupts(tree, requirements.rights.cpu),
        siblings(tree, requirements.rights.cpu),
        throttling(tree),
        swap(tree, requirements.rights.lock_memory),
        clock_source(tree),
        shared_memory(),
    ];
    findings.extend(requirements.robot.map(|robot| network(tree, robot)));
    findings
}

fn hypervisor(tree: &Tree) -> Finding {
    let cpuinfo = tree.read("proc/cpuinfo").unwrap_or_default();
    let flags = cpuinfo.lines().find(|line| line.starts_with("flags")).unwrap_or_default();
    if !flags.split_whitespace().any(|flag| flag == "hypervisor") {
        return Finding::fit("hypervisor", "none: a physical machine");
    }
    let maker = tree.read("sys/class/dmi/id/sys_vendor").unwrap_or_else(|| "of unknown make".to_string());
    Finding::advice(
        "hypervisor",
        format!("a virtual machine ({maker}): its host may take processors away for milliseconds"),
        "drive a real arm from a physical machine",
    )
}

fn governor(tree: &Tree) -> Finding {
    let governors: Vec<(usize, String)> = tree
        .cpus()
        .into_iter()
        .filter_map(|(cpu, folder)| Some((cpu, tree.read(folder.join("cpufreq/scaling_governor"))?)))
        .collect();
    let slow: Vec<String> = governors
        .iter()
        .filter(|(_, governor)| governor != "performance")
        .map(|(cpu, governor)| format!("{governor} on CPU {cpu}"))
        .collect();
    match (governors.is_empty(), slow.is_empty()) {
        (true, _) => Finding::unknown("governor", "no frequency scaling visible: set by firmware or host"),
        (_, true) => Finding::fit("governor", "performance on every CPU"),
        _ => Finding::advice("governor", slow.join(", "), "cpupower frequency-set -g performance"),
    }
}

fn idle_states(tree: &Tree, cpu: Option<usize>) -> Finding {
    let mut worst: Option<(i64, String, usize)> = None;
    let mut any = false;
    for (number, folder) in tree.cpus().into_iter().filter(|(number, _)| cpu.is_none_or(|cpu| cpu == *number)) {
        for state in tree.names(folder.join("cpuidle")) {
            let state = folder.join("cpuidle").join(state);
            let Some(latency) = tree.number(state.join("latency")) else { continue };
            any = true;
            if tree.number(state.join("disable")) != Some(1) && worst.as_ref().is_none_or(|(most, ..)| latency > *most)
            {
                worst = Some((latency, tree.read(state.join("name")).unwrap_or_default(), number));
            }
        }
    }
    match worst {
        None if any => Finding::fit("idle-states", "all switched off"),
        None => Finding::unknown("idle-states", "none visible: set by firmware or host"),
        Some((latency, name, _)) if latency <= MAX_IDLE_EXIT_US => {
            Finding::fit("idle-states", format!("the deepest, {name}, takes {latency} us to leave"))
        }
        Some((latency, name, number)) => Finding::advice(
            "idle-states",
            format!("{name} takes {latency} us to leave (CPU {number})"),
            format!(
                "hold /dev/cpu_dma_latency at 0 while the daemon runs (tuned's profile `realtime` does), or boot with \
                 processor.max_cstate=1 intel_idle.max_cstate=1, or `cpupower idle-set -D {MAX_IDLE_EXIT_US}`"
            ),
        ),
    }
}

fn isolation(tree: &Tree, cpu: Option<usize>) -> Finding {
    let isolated = tree.read("sys/devices/system/cpu/isolated").unwrap_or_default();
    let tickless = tree.read("sys/devices/system/cpu/nohz_full").unwrap_or_default();
    let Some(cpu) = cpu else {
        return Finding::advice(
            "isolation",
            format!("the loop is not pinned (realtime.cpu); isolated CPUs: `{isolated}`"),
            "set realtime.cpu to a CPU of its own and boot with isolcpus=N nohz_full=N rcu_nocbs=N for it",
        );
    };
    let online = tree.read("sys/devices/system/cpu/online").unwrap_or_default();
    if !list_has(&online, cpu) {
        return Finding::unfit(
            "isolation",
            format!("realtime.cpu = {cpu}, but the CPUs online are `{online}`"),
            "set realtime.cpu to an online CPU",
        );
    }
    match (list_has(&isolated, cpu), list_has(&tickless, cpu)) {
        (true, true) => Finding::fit("isolation", format!("CPU {cpu} is isolated and tickless")),
        (true, false) => Finding::advice(
            "isolation",
            format!("CPU {cpu} is isolated, but not tickless"),
            format!("boot with nohz_full={cpu} rcu_nocbs={cpu}"),
        ),
        _ => Finding::advice(
            "isolation",
            format!("CPU {cpu} also runs other programs (isolated CPUs: `{isolated}`)"),
            format!("boot with isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu}"),
        ),
    }
}

fn interrupts(tree: &Tree, cpu: Option<usize>) -> Finding {
    let Some(cpu) = cpu else { return Finding::unknown("interrupts", "the loop is not pinned (realtime.cpu)") };
    let here = |irq: &String| {
        let folder = Path::new("proc/irq").join(irq);
        let list = tree.read(folder.join("effective_affinity_list")).filter(|list| !list.is_empty());
        let list = list.or_else(|| tree.read(folder.join("smp_affinity_list")))?;
        // Interrupts that nothing listens to have no name below their folder.
        let name = tree.names(&folder).into_iter().find(|name| !IRQ_FILES.contains(&name.as_str()))?;
        list_has(&list, cpu).then(|| format!("{irq} ({name})"))
    };
    let irqs: Vec<String> = tree.names("proc/irq").iter().filter_map(here).collect();
    if irqs.is_empty() {
        return Finding::fit("interrupts", format!("no device interrupts CPU {cpu}"));
    }
    Finding::advice(
        "interrupts",
        format!("on CPU {cpu}: {}", irqs.join(", ")),
        format!(
            "stop irqbalance or set IRQBALANCE_BANNED_CPULIST={cpu}, and write another CPU into /proc/irq/N/smp_affinity_list; the \
             network card of the robot is best beside the loop, not on it"
        ),
    )
}

/// Files of `/proc/irq/N` that are not a handler's folder.
const IRQ_FILES: [&str; 8] = [
    "affinity_hint",
    "effective_affinity",
    "effective_affinity_list",
    "node",
    "smp_affinity",
    "smp_affinity_list",
    "spurious",
    "default_smp_affinity",
];

fn siblings(tree: &Tree, cpu: Option<usize>) -> Finding {
    let pair = cpu.unwrap_or(0);
    let list = tree.read(format!("sys/devices/system/cpu/cpu{pair}/topology/thread_siblings_list"));
    match list {
        None => Finding::unknown("hyper-threading", "unknown"),
        Some(list) if list.contains([',', '-']) => Finding::advice(
            "hyper-threading",
            format!("CPUs {list} share one core and its execution time"),
            "switch it off in the firmware or boot with nosmt",
        ),
        Some(_) => Finding::fit("hyper-threading", "every CPU is a core of its own"),
    }
}

fn throttling(tree: &Tree) -> Finding {
    let runtime = tree.number("proc/sys/kernel/sched_rt_runtime_us");
    let period = tree.number("proc/sys/kernel/sched_rt_period_us").filter(|&period| period > 0);
    match (runtime, period) {
        (Some(-1), _) => Finding::fit("throttling", "real-time threads are never throttled"),
        (Some(runtime), Some(period)) if runtime * 10 >= period * 9 => Finding::fit(
            "throttling",
            format!(
                "real-time threads may use {:.0} % of a CPU; the loop uses a few",
                100.0 * runtime as f64 / period as f64
            ),
        ),
        (Some(runtime), Some(period)) => Finding::advice(
            "throttling",
            format!("real-time threads may use {runtime} us of every {period} us only"),
            "sysctl kernel.sched_rt_runtime_us=950000",
        ),
        _ => Finding::unknown("throttling", "kernel.sched_rt_runtime_us can't be read"),
    }
}

fn swap(tree: &Tree, locked: bool) -> Finding {
    let swaps = tree.read("proc/swaps").unwrap_or_default();
    let used: Vec<&str> = swaps.lines().skip(1).filter_map(|line| line.split_whitespace().next()).collect();
    match (used.is_empty(), locked) {
        (true, _) => Finding::fit("swap", "none"),
        (_, true) => Finding::fit("swap", format!("{}; the daemon's memory is locked", used.join(", "))),
        _ => Finding::advice(
            "swap",
            format!("{}, and realtime.lock-memory is off", used.join(", ")),
            "set realtime.lock-memory = true, or swapoff -a",
        ),
    }
}

fn clock_source(tree: &Tree) -> Finding {
    let folder = Path::new("sys/devices/system/clocksource/clocksource0");
    let Some(current) = tree.read(folder.join("current_clocksource")) else {
        return Finding::unknown("clock-source", "unknown");
    };
    match current.as_str() {
        "tsc" | "kvm-clock" | "arch_sys_counter" => Finding::fit("clock-source", current),
        slow => Finding::advice(
            "clock-source",
            format!("{slow}: every clock read is a system call and takes microseconds"),
            format!(
                "boot with clocksource=tsc tsc=reliable if the processor's counter is good; available: {}",
                tree.read(folder.join("available_clocksource")).unwrap_or_default()
            ),
        ),
    }
}

fn shared_memory() -> Finding {
    let Ok(space) = rustix::fs::statvfs("/dev/shm") else {
        return Finding::unfit("shared-memory", "/dev/shm does not exist", "mount a tmpfs at /dev/shm");
    };
    let free = space.f_bavail.saturating_mul(space.f_frsize);
    let found = format!("{} MiB free in /dev/shm", free >> 20);
    if free >= REQUIRED_SHM_BYTES {
        Finding::fit("shared-memory", found)
    } else {
        Finding::unfit(
            "shared-memory",
            found,
            format!("free {} MiB there, or mount it larger", REQUIRED_SHM_BYTES >> 20),
        )
    }
}

/// Network card of the route to the robot, and its interrupt coalescing.
fn network(tree: &Tree, robot: IpAddr) -> Finding {
    if robot.is_loopback() {
        return Finding::unknown("network", format!("{robot} is on this machine"));
    }
    let Some(card) = card_to(tree, robot) else {
        return Finding::unfit(
            "network",
            format!("no route to the robot at {robot}"),
            "give the port that the robot is plugged into an address in the robot's network",
        );
    };
    let folder = Path::new("sys/class/net").join(&card);
    if tree.number(folder.join("carrier")) == Some(0) {
        return Finding::unfit("network", format!("{card} has no link"), "plug the cable in");
    }
    if tree.names(&folder).iter().any(|name| name == "wireless") {
        let change = "a cable from the robot's control unit to a port of its own";
        return Finding::unfit("network", format!("{card} is wireless"), change);
    }
    let report = std::process::Command::new("ethtool").args(["-c", &card]).output();
    let report = report.map(|done| String::from_utf8_lossy(&done.stdout).into_owned()).unwrap_or_default();
    match (wait_us(&report), tree.number(folder.join("speed"))) {
        (Some(0), _) => Finding::fit("network", format!("{card} does not coalesce interrupts")),
        (Some(us), _) => Finding::advice(
            "network",
            format!("{card} delays interrupts of packets by up to {us} us"),
            format!("ethtool -C {card} rx-usecs 0 tx-usecs 0 adaptive-rx off"),
        ),
        (None, speed) => Finding::unknown(
            "network",
            format!("{card}, {} Mbit/s; look with `ethtool -c {card}`: rx-usecs should be 0", speed.unwrap_or(0)),
        ),
    }
}

/// `rx-usecs` of a report of `ethtool -c`.
fn wait_us(report: &str) -> Option<i64> {
    report.lines().find_map(|line| line.trim().strip_prefix("rx-usecs:")?.trim().parse().ok())
}

/// The card of the most specific route to `robot`.
fn card_to(tree: &Tree, robot: IpAddr) -> Option<String> {
    let IpAddr::V4(robot) = robot else { return None };
    let robot = u32::from_le_bytes(robot.octets());
    let routes = tree.read("proc/net/route")?;
    let route = |line: &str| {
        let fields: Vec<&str> = line.split_whitespace().collect();
        let hex = |k: usize| u32::from_str_radix(fields.get(k)?, 16).ok();
        let (to, mask) = (hex(1)?, hex(7)?);
        (robot & mask == to).then(|| (mask.count_ones(), fields[0].to_string()))
    };
    routes.lines().skip(1).filter_map(route).max_by_key(|(width, _)| *width).map(|(_, card)| card)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rx_usecs_are_parsed_from_ethtool() {
        let report =
            "Coalesce parameters for eth0:\nAdaptive RX: on  TX: n/a\nrx-usecs:\t30\nrx-frames:\t0\n\ntx-usecs:\t8\n";
        assert_eq!(wait_us(report), Some(30));
        assert_eq!(wait_us("rx-usecs:\tn/a\n"), None);
        assert_eq!(wait_us(""), None);
    }
}
