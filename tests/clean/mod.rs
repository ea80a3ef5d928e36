//! One whole run of the loop on every kind of arm: approach, excitation, two models, a stop in mid-motion, the operator's permission, a
//! return, the end. Sealed, the loop's thread dies at its first stray system call, and the program with it.

use plumbline::store::ModelFile;
use plumbline_core::{ArmLimits, Backend, Command, Fault, FeedForward, JointVec, MAX_JOINTS, Setpoint, State, Torque};
use plumbline_franka::RobotKind;
use plumbline_franka::wire::Protocol;
use plumbline_model::term::Sample;
use plumbline_model::{Evaluator, Mounting, Robot};
use plumbline_rt::Rights;
use plumbline_rt::cycle::{End, Outcome};
use plumbline_rt::os::{Monotonic, sleep_until};
use plumbline_rt::recorder::{Drain, ring};
use plumbline_rt::{CycleSettings, Event, GuardSettings, Handles, cycle};
use plumbline_sim::{Gate, Pace};
use plumbline_testkit::emulator;
use plumbline_testkit::fake_arm::drive::{Wave, dwell, follow, move_to, panda_limits, settings};
use plumbline_testkit::sim::{THREE_EFFECTS, arm_with, sim};
use seccompiler::{BpfProgram, SeccompAction, SeccompFilter};
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

pub const ARMS: [&str; 4] = ["sim-fast", "sim-wall-clock", "franka-panda", "franka-fr3"];
/// In the middle of a run \[reads\].
const MIDDLE: u64 = 700;
/// Long enough for a loaded machine.
const TIMEOUT: Duration = Duration::from_secs(60);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seal {
    /// By the allocator alone (and by RTSan, where it is built in).
    Open,
    /// A stray system call kills the program.
    Calls,
    /// The same, and the loop's thread makes one in the middle of the run.
    Stray(Stray),
    /// The thread makes one without being sealed.
    Loose(Stray),
}

/// A call that has no place in a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stray {
    Getpid,
    Mmap,
    Print,
    File,
}

impl Seal {
    /// From `calls`, `stray-NAME` or `loose-NAME`.
    pub fn parse(text: &str) -> Seal {
        match text.split_once('-') {
            Some(("stray", name)) => Seal::Stray(Stray::parse(name)),
            Some(("loose", name)) => Seal::Loose(Stray::parse(name)),
            _ => Seal::Calls,
        }
    }
}

impl Stray {
    fn parse(name: &str) -> Stray {
        match name {
            "getpid" => Stray::Getpid,
            "mmap" => Stray::Mmap,
            "print" => Stray::Print,
            "file" => Stray::File,
            other => panic!("no stray call `{other}`"),
        }
    }
}

/// What an arm's thread may call beside the clock: number and why.
fn allowed(arm: &str) -> Vec<i64> {
    // The clock itself: by the vDSO where the clock source allows it, as a call where not. A signal (SIGSTOP, SIGCONT) restarts a sleep.
    let mut calls = vec![libc::SYS_clock_gettime, libc::SYS_clock_nanosleep, libc::SYS_restart_syscall];
    if arm == "sim-fast" {
        // Simulated time waits for the reader of its records: it yields, then naps.
        calls.push(libc::SYS_sched_yield);
    }
    if arm.starts_with("franka") {
        // States in, commands out (UDP and TCP), and the kernel's time stamp of a datagram.
        calls.extend([libc::SYS_recvfrom, libc::SYS_sendto, libc::SYS_ioctl]);
    }
    calls
}

fn filter(arm: &str) -> BpfProgram {
    let rules = allowed(arm).into_iter().map(|call| (call, Vec::new())).collect();
    let here = std::env::consts::ARCH.try_into().expect("an architecture that seccomp knows");
    let filter = SeccompFilter::new(rules, SeccompAction::KillProcess, SeccompAction::Allow, here);
    filter.and_then(TryInto::try_into).expect("a filter of a few calls")
}

/// An arm that puts the thread that reads it under a filter, for good, before its first state.
pub struct SealedArm<B> {
    arm: B,
    filter: Option<BpfProgram>,
    stray: Option<Stray>,
    sealed: bool,
    reads: u64,
    /// The run is over: the arm was stopped.
    stopped: Arc<AtomicBool>,
}

impl<B> SealedArm<B> {
    pub fn open(arm: B) -> SealedArm<B> {
        let stopped = Arc::new(AtomicBool::new(false));
        SealedArm { arm, filter: None, stray: None, sealed: false, reads: 0, stopped }
    }

    fn new(arm: B, name: &str, seal: Seal) -> SealedArm<B> {
        let (sealed, stray) = match seal {
            Seal::Open => (false, None),
            Seal::Calls => (true, None),
            Seal::Stray(stray) => (true, Some(stray)),
            Seal::Loose(stray) => (false, Some(stray)),
        };
        SealedArm { filter: sealed.then(|| filter(name)), stray, ..SealedArm::open(arm) }
    }

    fn go_astray(&self) {
        match self.stray {
            None => {}
            Some(Stray::Getpid) => drop(std::hint::black_box(std::process::id())),
            Some(Stray::Mmap) => drop(std::hint::black_box(Vec::<u8>::with_capacity(64 << 20))),
            Some(Stray::Print) => drop(std::io::stderr().write_all(b"a line\n")),
            Some(Stray::File) => drop(std::hint::black_box(std::fs::File::open("/dev/null"))),
        }
    }
}

impl<B: Backend> Backend for SealedArm<B> {
    fn joints(&self) -> usize {
        self.arm.joints()
    }

    fn read(&mut self) -> Result<State, Fault> {
        if let Some(filter) = self.filter.take() {
            seccompiler::apply_filter(&filter).expect("this thread may restrict itself");
            // Dropping it would free memory, which may call.
            std::mem::forget(filter);
            self.sealed = true;
        }
        self.reads += 1;
        if self.reads == MIDDLE {
            self.go_astray();
        }
        self.arm.read()
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
        self.stopped.store(true, Ordering::Release);
        if self.sealed {
            // The run is over; what the loop leaves behind is made by calls that are not the cycle's. The test ends the program.
            loop {
                sleep_until(u64::MAX);
            }
        }
    }

    fn deadline_ns(&self) -> Option<u64> {
        self.arm.deadline_ns()
    }
}

/// The paper's model of a Panda, as the daemon serves it.
struct Served(u64, Evaluator);

impl FeedForward for Served {
    fn id(&self) -> u64 {
        self.0
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        let &Setpoint { q, dq, ddq } = desired;
        self.1.torque(&Sample { q, dq, ddq })
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        self.1.rest(q)
    }
}

fn model(id: u64) -> Box<dyn FeedForward> {
    let file = format!("{}/config/models/panda-paper-table3.toml", env!("CARGO_MANIFEST_DIR"));
    let model = ModelFile::load(file.as_ref(), |name| Robot::load(name, None).map(|robot| robot.chain)).unwrap().model;
    Box::new(Served(id, model.evaluator(&Mounting::WALL.gravity())))
}

/// One whole run on the arm of this name. A sealed run does not return: it ends the program.
pub fn run(name: &str, seal: Seal) -> Result<Outcome, Interrupted> {
    let limits = GuardSettings { limits: panda_limits(), envelope: None, workspace: None, tracking: [0.2; MAX_JOINTS] };
    match name {
        "sim-fast" => {
            let gate = Arc::new(Gate::new(1000));
            let arm = sim(&arm_with("sim-panda", THREE_EFFECTS), 3, Pace::Fast(Arc::clone(&gate)));
            whole(SealedArm::new(arm, name, seal), Some(gate), limits, name)
        }
        "sim-wall-clock" => {
            let arm = sim(&arm_with("sim-panda", THREE_EFFECTS), 3, Pace::WallClock(Box::new(Monotonic)));
            whole(SealedArm::new(arm.with_max_missed(1000), name, seal), None, limits, name)
        }
        _ => {
            let (protocol, robot) =
                if name == "franka-fr3" { (Protocol::V10, RobotKind::Fr3) } else { (Protocol::V5, RobotKind::Panda) };
            let address = emulator::address();
            let command_wait = Duration::from_millis(200);
            let emulated = emulator::Settings { command_wait, ..emulator::Settings::new(address, protocol) };
            let _emulator = emulator::Emulator::start(emulated).unwrap();
            let (arm, connection) =
                plumbline_franka::connect(&plumbline_franka::Settings::new(address, robot)).unwrap();
            let ArmLimits { limits, envelope, .. } = connection.info.limits.for_guard(1.0);
            let limits = GuardSettings { limits, envelope, workspace: None, tracking: [0.2; MAX_JOINTS] };
            whole(SealedArm::new(arm, name, seal), None, limits, name)
        }
    }
}

/// The emulated robot stopped by itself, as a real one does when its network or the machine beside it stalls.
#[derive(Clone, Copy, Debug)]
#[allow(dead_code, reason = "shown where a test fails")]
pub struct Interrupted {
    step: u32,
    end: End,
}

/// Drives the loop from this thread until it has ended.
fn whole<B: Backend + 'static>(
    arm: SealedArm<B>,
    gate: Option<Arc<Gate>>,
    guard: GuardSettings,
    name: &str,
) -> Result<Outcome, Interrupted> {
    // A stalled test machine is for the arm to judge, not for the loop.
    let rights = Rights { priority: Some(10), ..Rights::NONE };
    let settings = CycleSettings { guard, rights, max_consecutive_lost: 1000, ..settings() };
    let (sealed, stopped) = (arm.filter.is_some(), Arc::clone(&arm.stopped));
    let (sink, mut drain) = ring(60_000);
    let (mut cycle, mut handles) = cycle::new(arm, sink, None, settings).unwrap();
    let looping = std::thread::spawn(move || cycle.run());
    let begin = Instant::now();
    let mut away: JointVec = [0.0; MAX_JOINTS];
    let mut pose = None;
    let mut step = 0;
    while !looping.is_finished() && !stopped.load(Ordering::Acquire) {
        assert!(begin.elapsed() < TIMEOUT, "{name}: stuck at step {step}");
        consume(&mut drain, gate.as_deref(), &mut pose);
        let Some(at) = pose else { continue };
        let wave = |q0| Wave { q0, amplitude: Wave::gentle().amplitude.map(|a| 0.5 * a), ..Wave::gentle() };
        match step {
            0 => {
                (0..7).for_each(|j| away[j] = at[j] + if j % 2 == 0 { 0.05 } else { -0.05 });
                assert!(handles.models.serve(model(1)).is_ok());
                for order in [dwell(1, 100), move_to(2, away), follow(3, wave(away)), move_to(4, at)] {
                    assert!(handles.orders.give(order).is_ok());
                }
                step = 1;
            }
            // A model for another, and a stop in mid-motion, when the excitation has ended.
            1 if seen(&mut handles, Event::Ended { motion: 3 }) => {
                assert!(handles.models.serve(model(2)).is_ok());
                step = 2;
            }
            2 if seen(&mut handles, Event::Started { motion: 4 }) => {
                handles.controls.stop();
                step = 3;
            }
            3 if handles.controls.is_waiting() => {
                assert!(handles.controls.resume());
                assert!(handles.orders.give(move_to(5, away)).is_ok());
                step = 4;
            }
            4 if seen(&mut handles, Event::Ended { motion: 5 }) => {
                handles.controls.quit();
                step = 5;
            }
            _ => std::thread::sleep(Duration::from_micros(200)),
        }
        handles.free_retired();
    }
    if sealed && !looping.is_finished() {
        println!("sealed run {}", if step == 5 { "complete" } else { "interrupted" });
        std::process::exit(0);
    }
    let outcome = looping.join().unwrap();
    let end = outcome.end;
    (step == 5).then_some(outcome).ok_or(Interrupted { step, end })
}

/// Takes the records that are there and learns where the arm began.
fn consume(drain: &mut Drain, gate: Option<&Gate>, pose: &mut Option<JointVec>) {
    while let Some(record) = drain.pop() {
        pose.get_or_insert(record.command.desired.q);
        gate.iter().for_each(|gate| gate.consumed(1));
    }
}

/// Whether this event is among those that have come since the last question; those before it are gone then.
fn seen(handles: &mut Handles, wanted: Event) -> bool {
    std::iter::from_fn(|| handles.events.pop().ok()).any(|timed| timed.event == wanted)
}
