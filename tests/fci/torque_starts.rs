//! Torque-controlled starts in every mounting: the arm adds the compensation of an upright arm by itself, and stays where it stands.
//!
//! `hil/torque-starts/run.sh` makes ten starts per mounting and prints the table of docs/results/franka-clients.md.

use nalgebra::Vector3;
use plumbline_core::{ArmLimits, FeedForward, JointVec, Record, Setpoint, Torque};
use plumbline_franka::wire::Protocol;
use plumbline_franka::{Interface, RobotKind, Settings, connect, explain, recover};
use plumbline_model::{Chain, LinkParameters, Mounting, Robot, rnea};
use plumbline_rt::Rights;
use plumbline_rt::cycle::End;
use plumbline_rt::recorder::ring;
use plumbline_rt::{CycleSettings, Event, GuardSettings, Order, OrderKind, cycle};
use plumbline_testkit::emulator::{Emulator, Settings as Emulated, address};
use std::time::Duration;

/// Largest way of a joint in the first second \[rad\].
const STAYS: f64 = 2e-3;
/// Length of a start \[ms\].
const SECOND: u64 = 1000;

/// The emulated arm's links, by another route than its own dynamics.
struct Links {
    chain: Chain,
    links: Vec<LinkParameters>,
    gravity: Vector3<f64>,
    vendor: Vector3<f64>,
}

impl FeedForward for Links {
    fn id(&self) -> u64 {
        1
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        let mut tau = JointVec::default();
        rnea(&self.chain, &self.links, &self.gravity, &desired.q, &desired.dq, &desired.ddq, &mut tau);
        Torque(tau)
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        let mut tau = JointVec::default();
        rnea(&self.chain, &self.links, &self.vendor, q, &[0.0; 8], &[0.0; 8], &mut tau);
        Torque(tau)
    }
}

struct Start {
    /// Largest way of any joint from where it stood \[rad\].
    way: f64,
    /// Joint that went that way, from 1.
    joint: usize,
    ended: Option<String>,
}

/// One second of a torque motion that holds the arm where it stands, with the arm's model in the loop.
fn start(settings: &Settings, mounting: &Mounting) -> Start {
    let (arm, connection) = connect(settings).unwrap_or_else(|error| panic!("{mounting}: {error}"));
    let ArmLimits { limits, envelope, .. } = connection.info.limits.for_guard(1.0);
    // The guard's tolerance lies beyond the adapter's reach: what moves is measured, not stopped.
    let guard = GuardSettings { limits, envelope, workspace: None, tracking: [0.2; 8] };
    let rights = Rights { priority: Some(10), ..Rights::NONE };
    let settings = CycleSettings { rights, max_consecutive_lost: 19, ..CycleSettings::new(guard) };
    let (sink, mut drain) = ring(10 * SECOND as usize);
    let (mut cycle, mut handles) = cycle::new(arm, sink, None, settings).unwrap();
    let robot = Robot::load("panda", None).unwrap();
    let truth = plumbline_testkit::sim::arm("sim-panda");
    let model = Links {
        chain: robot.chain,
        links: truth.link_parameters(),
        gravity: mounting.gravity(),
        vendor: Vector3::from(connection.info.compensates),
    };
    assert!(handles.models.serve(Box::new(model)).is_ok());
    assert!(handles.orders.give(Order { motion: 1, kind: OrderKind::Dwell { ticks: SECOND } }).is_ok());
    let looping = std::thread::spawn(move || cycle.run());
    while !looping.is_finished() {
        while let Ok(timed) = handles.events.pop() {
            if matches!(timed.event, Event::Ended { .. } | Event::Stopping { .. }) {
                handles.controls.quit();
            }
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    let outcome = looping.join().unwrap();
    let mut records: Vec<Record> = Vec::new();
    drain.take_into(&mut records, usize::MAX);
    let stood = records.first().map_or([0.0; 8], |record| record.state.q);
    let (mut way, mut joint) = (0.0, 0);
    for record in &records {
        for (j, (q, stood)) in record.state.q.iter().zip(&stood).enumerate() {
            let gone = (q - stood).abs();
            if gone > way {
                (way, joint) = (gone, j + 1);
            }
        }
    }
    let ended = match outcome.end {
        End::Quit => outcome.last_stop.map(|reason| reason.to_string()),
        End::Fault(fault) => Some(explain(&fault, &connection.telemetry.snapshot()).what.to_string()),
        end => Some(end.to_string()),
    };
    Start { way, joint, ended }
}

/// An emulated Panda in `mounting` that compensates what an upright arm needs, and what reaches it.
fn arm(mounting: Mounting) -> (Emulator, Settings) {
    let address = address();
    // The robot's time waits for this machine: what is measured is torque.
    let command_wait = Duration::from_millis(200);
    let emulated = Emulated { mounting, command_wait, ..Emulated::new(address, Protocol::V5) };
    let settings = Settings {
        interface: Interface::Torque,
        state_timeout: Duration::from_secs(1),
        ..Settings::new(emulated.address, RobotKind::Panda)
    };
    (Emulator::start(emulated).unwrap_or_else(|error| panic!("{error}")), settings)
}

/// `times` starts in each mounting, the mountings side by side; one line each, and the worst.
fn starts(mountings: &[Mounting], times: usize) -> Vec<(Mounting, Vec<Start>)> {
    std::thread::scope(|scope| {
        let threads: Vec<_> = mountings
            .iter()
            .map(|&mounting| {
                scope.spawn(move || {
                    let (_emulator, settings) = arm(mounting);
                    let once = || {
                        let started = start(&settings, &mounting);
                        // The arm ends its motion a moment after its client has gone.
                        std::thread::sleep(Duration::from_millis(700));
                        if started.ended.is_some() {
                            let _ = recover(&settings);
                        }
                        started
                    };
                    (mounting, (0..times).map(|_| once()).collect())
                })
            })
            .collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    })
}

fn assert_they_stay(found: &[(Mounting, Vec<Start>)]) {
    println!("| mounting | starts | ended early | largest way of a joint, mrad |\n|---|---|---|---|");
    let mut bad = Vec::new();
    for (mounting, starts) in found {
        let worst = starts.iter().max_by(|a, b| a.way.total_cmp(&b.way)).unwrap();
        let ended: Vec<&String> = starts.iter().filter_map(|start| start.ended.as_ref()).collect();
        println!(
            "| {mounting} | {} | {} | {:.2} (joint {}) |",
            starts.len(),
            ended.len(),
            1e3 * worst.way,
            worst.joint
        );
        if worst.way > STAYS || !ended.is_empty() {
            bad.push(format!("{mounting}: {:.2} mrad in joint {}, {ended:?}", 1e3 * worst.way, worst.joint));
        }
    }
    assert!(bad.is_empty(), "{bad:#?}");
}

fn tilted(rho: f64, phi: f64) -> Mounting {
    Mounting { rho: rho.to_radians(), phi: phi.to_radians() }
}

#[test]
fn under_torque_control_the_arm_stays_where_it_stands_in_any_mounting() {
    assert_they_stay(&starts(&[Mounting::WALL, Mounting::CEILING, tilted(135.0, 60.0)], 1));
}

#[test]
#[ignore = "minutes: hil/torque-starts/run.sh"]
fn ten_starts_in_each_of_ten_mountings() {
    let tilts = [
        (165.0, 0.0),
        (150.0, 45.0),
        (135.0, 90.0),
        (120.0, 180.0),
        (90.0, 90.0),
        (75.0, -45.0),
        (60.0, -90.0),
        (30.0, 135.0),
    ];
    let mountings: Vec<Mounting> =
        [Mounting::WALL, Mounting::CEILING].into_iter().chain(tilts.map(|(rho, phi)| tilted(rho, phi))).collect();
    let found: Vec<_> = mountings.chunks(2).flat_map(|pair| starts(pair, 10)).collect();
    assert_they_stay(&found);
}
