//! `plumbline doctor`: every finding against a machine of the test's own making, and the command on this one.

use plumbline::machine::{Finding, Requirements, Tree, Verdict, inspect};
use plumbline_rt::Rights;
use plumbline_testkit::job::*;
use std::net::IpAddr;
use std::path::Path;
use tempfile::TempDir;

struct FakeMachine(TempDir);

impl FakeMachine {
    /// One with nothing to complain about: two real cores, CPU 1 for the loop alone.
    fn good() -> FakeMachine {
        let machine = FakeMachine(tempfile::tempdir().unwrap());
        for cpu in 0..2 {
            let folder = format!("sys/devices/system/cpu/cpu{cpu}");
            machine.put(&format!("{folder}/cpufreq/scaling_governor"), "performance\n");
            machine.put(&format!("{folder}/cpuidle/state1/latency"), "2\n");
            machine.put(&format!("{folder}/cpuidle/state1/name"), "C1\n");
            machine.put(&format!("{folder}/cpuidle/state1/disable"), "0\n");
            machine.put(&format!("{folder}/topology/thread_siblings_list"), &format!("{cpu}\n"));
        }
        machine.put("sys/devices/system/cpu/online", "0-1\n");
        machine.put("sys/devices/system/cpu/isolated", "1\n");
        machine.put("sys/devices/system/cpu/nohz_full", "1\n");
        machine.put("proc/irq/24/smp_affinity_list", "0\n");
        machine.put("proc/irq/24/eth0/x", "");
        machine.put("proc/cpuinfo", "flags\t\t: fpu tsc avx2\n");
        machine.put("proc/swaps", "Filename Type Size Used Priority\n");
        machine.put("proc/sys/kernel/sched_rt_runtime_us", "950000\n");
        machine.put("proc/sys/kernel/sched_rt_period_us", "1000000\n");
        machine.put("sys/devices/system/clocksource/clocksource0/current_clocksource", "tsc\n");
        // 172.16.0.0/24 over eth7, everything else over eth0.
        machine.put(
            "proc/net/route",
            "Iface\tDestination\tGateway\tFlags\tRefCnt\tUse\tMetric\tMask\tMTU\nplb0\t00000000\t0100000A\t3\t0\t0\t0\t00000000\t0\n\
             plb7\t000010AC\t00000000\t1\t0\t0\t0\t00FFFFFF\t0\n",
        );
        machine.put("sys/class/net/plb7/carrier", "1\n");
        machine
    }

    fn put(&self, path: &str, text: &str) {
        let path = self.0.path().join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    fn inspect(&self, requirements: &Requirements) -> Vec<Finding> {
        inspect(&Tree::at(self.0.path()), requirements)
    }
}

fn requirements(cpu: Option<usize>) -> Requirements {
    Requirements { rights: Rights { cpu, ..Rights::default() }, robot: None }
}

fn named<'a>(findings: &'a [Finding], name: &str) -> &'a Finding {
    findings.iter().find(|finding| finding.name == name).unwrap_or_else(|| panic!("no finding `{name}`"))
}

#[test]
fn a_suitable_machine_has_no_advice() {
    for finding in FakeMachine::good().inspect(&requirements(Some(1))) {
        assert_eq!(finding.verdict, Verdict::Fit, "{finding:?}");
    }
}

/// A file of the good machine that is spoiled: path, text, finding, verdict, a word of what was found, a word of what to change.
type Spoiled = (&'static str, &'static str, &'static str, Verdict, &'static str, &'static str);

#[test]
fn each_unsuitable_setting_is_found_with_its_change() {
    use Verdict::{Advice, Unfit};
    let cpu = "sys/devices/system/cpu";
    let cases: [Spoiled; 11] = [
        ("proc/cpuinfo", "flags\t: fpu hypervisor\n", "hypervisor", Advice, "virtual", "physical machine"),
        ("cpu0/cpufreq/scaling_governor", "powersave", "governor", Advice, "powersave on CPU 0", "cpupower"),
        ("cpu1/cpuidle/state1/latency", "133", "idle-states", Advice, "133 us", "cpu_dma_latency"),
        ("isolated", "", "isolation", Advice, "also runs other programs", "isolcpus=1"),
        ("nohz_full", "", "isolation", Advice, "not tickless", "nohz_full=1"),
        ("online", "0", "isolation", Unfit, "online are `0`", "realtime.cpu"),
        ("proc/irq/24/smp_affinity_list", "0-1", "interrupts", Advice, "24 (eth0)", "smp_affinity_list"),
        ("cpu1/topology/thread_siblings_list", "0-1", "hyper-threading", Advice, "share one core", "nosmt"),
        ("proc/sys/kernel/sched_rt_runtime_us", "500000", "throttling", Advice, "500000 us", "sched_rt_runtime_us"),
        ("proc/irq/24/effective_affinity_list", "1", "interrupts", Advice, "24 (eth0)", "smp_affinity_list"),
        (
            "sys/devices/system/clocksource/clocksource0/current_clocksource",
            "hpet",
            "clock-source",
            Advice,
            "hpet",
            "tsc",
        ),
    ];
    for (path, text, name, verdict, found, change) in cases {
        let machine = FakeMachine::good();
        let path =
            if path.starts_with("proc") || path.starts_with("sys") { path.into() } else { format!("{cpu}/{path}") };
        machine.put(&path, text);
        let findings = machine.inspect(&requirements(Some(1)));
        let finding = named(&findings, name);
        assert_eq!(finding.verdict, verdict, "{path}: {finding:?}");
        assert!(finding.found.contains(found), "{path}: {finding:?}");
        assert!(finding.change.as_ref().is_some_and(|text| text.contains(change)), "{path}: {finding:?}");
        // One spoiled file spoils one finding.
        let others = findings.iter().filter(|other| other.name != name);
        assert!(others.clone().all(|other| other.verdict == Verdict::Fit), "{path}: {:?}", others.collect::<Vec<_>>());
    }
}

#[test]
fn swap_without_locked_memory_and_an_unpinned_loop_are_advised_against() {
    let machine = FakeMachine::good();
    machine.put("proc/swaps", "Filename Type Size Used Priority\n/dev/sda2 partition 1 0 -2\n");
    assert_eq!(named(&machine.inspect(&requirements(Some(1))), "swap").verdict, Verdict::Fit);
    let unlocked =
        Requirements { rights: Rights { cpu: Some(1), lock_memory: false, ..Rights::default() }, robot: None };
    assert_eq!(named(&machine.inspect(&unlocked), "swap").verdict, Verdict::Advice);
    let findings = machine.inspect(&requirements(None));
    assert!(named(&findings, "isolation").change.as_ref().is_some_and(|text| text.contains("realtime.cpu")));
}

#[test]
fn the_way_to_the_robot_is_the_narrowest_route() {
    let machine = FakeMachine::good();
    let network = |robot: &str| {
        let robot: IpAddr = robot.parse().unwrap();
        let findings = machine.inspect(&Requirements { robot: Some(robot), ..requirements(Some(1)) });
        named(&findings, "network").clone()
    };
    assert!(network("172.16.0.2").found.contains("plb7"));
    assert!(network("10.1.2.3").found.contains("plb0"));
    assert_eq!(network("127.0.0.7").verdict, Verdict::Unknown);
    machine.put("sys/class/net/plb7/carrier", "0\n");
    assert_eq!(network("172.16.0.2").verdict, Verdict::Unfit);
    machine.put("sys/class/net/plb7/carrier", "1\n");
    machine.put("sys/class/net/plb7/wireless/x", "");
    assert!(network("172.16.0.2").found.contains("wireless"));
    machine.put("proc/net/route", "Iface\n");
    assert!(network("172.16.0.2").found.contains("no route"));
}

fn doctor(arguments: &[&str]) -> Done {
    Done::of(plumbline().args(["doctor", "--seconds", "1"]).args(arguments))
}

#[test]
fn the_exit_code_follows_the_verdict() {
    let config = Path::new("config/sim-panda-wall.toml").to_str().unwrap();
    let done = doctor(&[config, "--json"]);
    let report: serde_json::Value = serde_json::from_str(&done.out).unwrap_or_else(|_| panic!("{}", done.output()));
    let findings = report["findings"].as_array().unwrap();
    let unfit = findings.iter().filter(|finding| finding["verdict"] == "unfit").count();
    assert_eq!(done.code, Some(i32::from(unfit > 0)), "{}", done.output());
    assert_eq!(report["fit"], unfit == 0);
    let names: Vec<&str> = findings.iter().map(|finding| finding["name"].as_str().unwrap()).collect();
    for name in ["kernel", "priority", "locked-memory", "governor", "interrupts", "shared-memory", "wake-up"] {
        assert!(names.contains(&name), "{names:?}");
    }

    // What the job asks for is what is looked at.
    let done = doctor(&[config, "--set", "realtime.cpu=900"]).expect_code(1);
    assert!(done.out.contains("CPU 900") && done.err.contains("unfit for 1 kHz: "), "{}", done.output());
    let done = doctor(&[config, "--set", "realtime.cpu=none"]).expect_code(2);
    assert!(done.err.contains("realtime.cpu"), "{}", done.output());
    doctor(&["no-such-file.toml"]).expect_code(2);
}
