//! One case: the emulator, the daemon as its users start it, and a fault at a moment of the job.

use super::judge::{Judged, judge};
use super::scene::Scene;
use plumbline_core::Backend;
use plumbline_franka::RobotKind;
use plumbline_franka::wire::{Protocol, RobotMode};
use plumbline_ipc::Status;
use plumbline_model::Mounting;
use plumbline_testkit::emulator::limits::JOINTS;
use plumbline_testkit::emulator::{Emulator, Fault, OperatorAction, Settings, address};
use plumbline_testkit::job::{Place, Running, plumbline};
use std::net::IpAddr;
use std::process::Command;
use std::time::{Duration, Instant};

#[derive(Clone, Copy, Debug)]
pub enum Disturbance {
    /// Faults of the emulator, as its command line has them.
    Faults(&'static [&'static str]),
    UserStop,
    /// Somebody runs into the arm. Before a connection: another program has left it in a reflex.
    Reflex,
    None,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum When {
    /// Before the daemon connects, until the arm moves.
    Connect,
    /// On the way to the start of the motion.
    Approach,
    Excite,
    /// While the arm brakes because an operator has ended the job in mid-motion.
    Stop,
    /// While the daemon holds and serves a model, before any motion.
    Serve,
}

impl When {
    pub const ALL: [When; 5] = [When::Connect, When::Approach, When::Excite, When::Stop, When::Serve];
}

#[derive(Clone, Debug)]
pub struct Case {
    pub disturbance: Disturbance,
    pub when: When,
    /// More of the job: `key=value`.
    pub sets: Vec<String>,
}

#[derive(Clone, Debug)]
pub struct Ending {
    pub code: Option<i32>,
    pub output: String,
    pub status: Option<Box<Status>>,
    pub done: bool,
    /// What the emulator's log shows.
    pub arm: Judged,
    /// From the fault to the arm's rest, where it moved when the fault came \[ms\].
    pub rest_after: Option<u64>,
    pub mode: RobotMode,
}

/// What the operator does next is in the daemon's last line: after a fault in motion behind `Next: `, before a motion at the end of the reason.
const NEXT_STEPS: [&str; 10] = [
    "Look at cable, network card and switch",
    "Next: ",
    "Update the robot",
    "A newer version of this program",
    "then try again",
    "clear the workspace",
    "firewall",
    "In Desk,",
    "in Desk",
    "Is another program connected",
];

/// Lets the emulator's thread go before everything else on this machine, where that is permitted: a robot is not late.
fn prioritise(address: IpAddr) {
    let name = format!("fci {address}");
    for task in std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten() {
        if std::fs::read_to_string(task.path().join("comm")).is_ok_and(|comm| name.starts_with(comm.trim())) {
            let id = task.file_name();
            let _ = Command::new("chrt").args(["-f", "-p", "85"]).arg(id).output();
        }
    }
}

/// Another program starts a motion, commands nothing, and goes.
fn leave_in_reflex(address: IpAddr) {
    let settings = plumbline_franka::Settings::new(address, RobotKind::Panda);
    let (mut arm, _) = plumbline_franka::connect(&settings).unwrap_or_else(|error| panic!("{error}"));
    arm.read().unwrap_or_else(|fault| panic!("{fault:?}"));
    // The robot may wait for each of the 20 commands.
    std::thread::sleep(Duration::from_millis(300));
}

impl Case {
    pub fn new(disturbance: Disturbance, when: When) -> Case {
        Case { disturbance, when, sets: Vec::new() }
    }

    pub fn with(mut self, sets: &[&str]) -> Case {
        self.sets.extend(sets.iter().map(|set| set.to_string()));
        self
    }

    pub fn inject(&self, emulator: &Emulator) {
        match self.disturbance {
            Disturbance::Faults(texts) => texts.iter().for_each(|text| {
                let fault: Fault = text.parse().unwrap_or_else(|error| panic!("{error}"));
                // Whatever is wrong before the connection stays so until the arm moves.
                let lasting = Fault { lasts: None, ..fault };
                emulator.fault(if self.when == When::Connect { lasting } else { fault });
            }),
            Disturbance::UserStop => emulator.operate(OperatorAction::UserStop),
            Disturbance::Reflex => emulator.operate(OperatorAction::Push),
            Disturbance::None => {}
        }
    }

    /// How long the robot's time is paused at most for a command that is due. A machine with other work stalls for longer than the
    /// 20 ms that a robot waits, which is no fault of the case's: 20 commands are missing after 80 ms then, still before the daemon
    /// calls the robot silent. Where the fault is one of timing, a robot's time is as strict as it is.
    fn command_wait(&self) -> Duration {
        let timing = |text: &&str| ["delay", "jitter", "reorder"].iter().any(|kind| text.starts_with(kind));
        match self.disturbance {
            Disturbance::Faults(texts) if texts.iter().any(timing) => Duration::ZERO,
            _ => Duration::from_millis(3),
        }
    }

    /// Whether a connection has to be there for it to go wrong.
    pub fn is_reset(&self) -> bool {
        matches!(self.disturbance, Disturbance::Faults([text, ..]) if text.starts_with("tcp-reset"))
    }

    fn command(&self, place: &Place, address: IpAddr) -> Command {
        let root = env!("CARGO_MANIFEST_DIR");
        let mut command = plumbline();
        command.args(["daemon", "config/panda-emulator-wall.toml", "--out"]).arg(place.out());
        command.args(["--model", "config/models/panda-paper-table3.toml"]);
        let sets = [
            format!("serve.id={}", place.id),
            format!("backend.franka.address={address}"),
            format!("excitation.plan={root}/tests/fci/fci_faults/excitation.toml"),
            "backend.franka.connect-timeout=1 s".into(),
            "excitation.periods=1".into(),
            "excitation.lead-in=0".into(),
            "validation.trajectories=0".into(),
            "output.dataset=false".into(),
        ];
        for set in sets.iter().chain(&self.sets) {
            command.arg("--set").arg(set);
        }
        command
    }

    pub fn run(&self) -> Ending {
        let address = address();
        let place = Place::new(&format!("faults-{address}"));
        let log = place.path().join("cycles.csv");
        let settings = Settings {
            mounting: Mounting::WALL,
            command_wait: self.command_wait(),
            log: Some(log.clone()),
            ..Settings::new(address, Protocol::V5)
        };
        let emulator = Emulator::start(settings).unwrap_or_else(|error| panic!("{error}"));
        prioritise(address);
        match (self.when, self.disturbance) {
            (When::Connect, Disturbance::Reflex) => leave_in_reflex(address),
            // There is no connection to reset yet.
            (When::Connect, _) if !self.is_reset() => self.inject(&emulator),
            _ => {}
        }
        let daemon = Running::start(self.command(&place, address));
        let (client, status, injected_at, begun) = (None, None, None, Instant::now());
        let mut scene = Scene { case: self, emulator, place, daemon, client, status, injected_at, moved: false, begun };
        let done = scene.play();
        let Scene { emulator, place, daemon, status, injected_at, moved, client, .. } = scene;
        drop(client);
        let ended = daemon.end();
        // The arm may still brake.
        let until = Instant::now() + Duration::from_secs(2);
        while emulator.snapshot().state.dq_d != [0.0; JOINTS] && Instant::now() < until {
            std::thread::sleep(Duration::from_millis(5));
        }
        std::thread::sleep(Duration::from_millis(50));
        let mode = emulator.snapshot().state.robot_mode;
        drop(emulator);
        let arm = judge(&log);
        drop(place);
        let rest_after = injected_at.filter(|_| moved).zip(arm.last_moved).map(|(from, to)| to.saturating_sub(from));
        Ending { code: ended.code, output: ended.err, status, done, arm, rest_after, mode }
    }
}

impl Ending {
    /// All of it, for the message of a failed assertion.
    pub fn describe(&self) -> String {
        format!(
            "exit code {:?}, all driven: {}, mode {}, {:?}\n{}\nstatus: {:#?}",
            self.code, self.done, self.mode, self.arm, self.output, self.status
        )
    }

    /// Whether the machine itself may have made it end: the arm missed commands, or none of its states came.
    pub fn stalled(&self) -> bool {
        ["communication_constraints_violation", "no state came", "states were lost"]
            .iter()
            .any(|words| self.output.contains(words))
    }

    /// How often the daemon went on by itself.
    pub fn recoveries(&self) -> usize {
        self.output.matches("going on by itself").count()
    }

    pub fn last_line(&self) -> &str {
        self.output.lines().rfind(|line| line.starts_with("plumbline: ")).unwrap_or("")
    }

    /// What must be so in every case: inside the limits, at rest in the end, and a cause and a next step where it did not go on.
    pub fn objection(&self) -> Option<String> {
        if !self.arm.violations.is_empty() {
            return Some(format!("the arm broke its limits: {:?}", self.arm.violations));
        }
        if !self.arm.at_rest {
            return Some("the arm is not at rest".into());
        }
        match self.code {
            Some(0) => None,
            Some(1) if NEXT_STEPS.iter().any(|words| self.last_line().contains(words)) => None,
            _ => Some(format!("exit code {:?} with the words `{}`", self.code, self.last_line())),
        }
    }
}
