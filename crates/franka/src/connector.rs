//! The arm as a backend of the daemon.

use super::connect::{Connection, Info, connect, read_limits, recover_communication};
use super::error::next_step;
use super::explain::explain;
use super::gravity::Source;
use super::settings::{Interface, Settings};
use super::telemetry::Telemetry;
use super::wire::{ErrorBit, RobotMode};
use plumbline_core::{
    ArmConnector, ArmError, ArmLimits, ArmMonitor, CommandMode, ConnectOptions, Connected, Explanation, Fault,
    Hardware, Link, MeasuredGravity, ModeChange, Purpose,
};
use std::net::IpAddr;
use std::sync::Arc;

/// Connects to one Franka arm.
#[derive(Clone, Debug)]
pub struct FrankaConnector {
    /// What a session is opened with; its purpose is that of each connection.
    pub settings: Settings,
    /// Recoveries in one job without an operator, after lost communication alone; 0: none.
    pub max_recoveries: u32,
}

impl FrankaConnector {
    fn settings(&self, purpose: Purpose) -> Settings {
        Settings { purpose, ..self.settings.clone() }
    }
}

impl ArmConnector for FrankaConnector {
    fn lock_name(&self) -> Option<String> {
        Some(format!("franka/{}", self.settings.address.to_canonical()))
    }

    fn address(&self) -> Option<IpAddr> {
        Some(self.settings.address)
    }

    fn command_mode(&self) -> CommandMode {
        match self.settings.interface {
            Interface::JointPosition | Interface::JointVelocity => CommandMode::Motion,
            Interface::Torque => CommandMode::Torque { feed_forward: self.settings.torque.feed_forward },
        }
    }

    fn read_limits(&self) -> Result<Option<ArmLimits>, ArmError> {
        let limits = read_limits(&self.settings(Purpose::Monitor))?;
        Ok(Some(limits.for_guard(self.settings.limits_share)))
    }

    fn connect(&self, options: &ConnectOptions) -> Result<Connected, ArmError> {
        let (arm, Connection { info, telemetry }) = connect(&self.settings(options.purpose))?;
        let gravity = info.gravity.as_ref().filter(|gravity| gravity.source == Source::Accelerometers);
        let accelerometers = gravity.map(|gravity| MeasuredGravity {
            direction: gravity.direction,
            std: gravity.spread.max(gravity.accelerometers.unwrap_or(0.0)),
        });
        let hardware = Hardware {
            limits: info.limits.for_guard(self.settings.limits_share),
            q: info.pose(),
            accelerometers,
            monitor: Box::new(Monitor { info: info.clone(), telemetry, mode: RobotMode::Idle }),
        };
        Ok(Connected { backend: Box::new(arm), compensates: info.compensates, gate: None, hardware: Some(hardware) })
    }

    /// Only after a fault of communication: everything else needs an operator.
    fn max_recoveries(&self, fault: &Fault) -> u32 {
        match fault {
            Fault::Reflex { code } if *code == ErrorBit::CommunicationConstraintsViolation as u32 => {
                self.max_recoveries
            }
            Fault::Silent { .. } | Fault::Disconnected => self.max_recoveries,
            Fault::Reflex { .. } | Fault::Refused { .. } => 0,
        }
    }

    fn recover(&self) -> Result<(), ArmError> {
        Ok(recover_communication(&self.settings(Purpose::Monitor))?)
    }
}

/// A session from outside the loop.
struct Monitor {
    info: Info,
    telemetry: Arc<Telemetry>,
    /// The mode that was reported last.
    mode: RobotMode,
}

impl ArmMonitor for Monitor {
    fn name(&self) -> String {
        format!("{}, protocol {}", self.info.image, self.info.protocol.number())
    }

    fn mode_change(&mut self) -> Option<ModeChange> {
        let mode = self.telemetry.newest_mode();
        let changed = std::mem::replace(&mut self.mode, mode) != mode;
        changed.then(|| ModeChange { mode: mode.to_string(), next: next_step(mode).map(str::to_string) })
    }

    fn explain(&self, fault: &Fault) -> Explanation {
        explain(fault, &self.telemetry.snapshot())
    }

    fn link(&self) -> Link {
        let of = self.telemetry.snapshot();
        Link {
            robot: self.name(),
            states: of.states,
            lost: of.lost,
            passed_over: of.skipped,
            odd: of.out_of_order + of.duplicates + of.bad_packets + of.foreign_packets,
            late: of.late_commands,
            limited: of.limited,
            success: (of.success_rate.mean > 0.0).then_some([of.success_rate.min, of.success_rate.mean]),
            turnaround: of.work,
            wake: of.wake,
            round_trip: of.round_trip,
            interval: of.interval,
            gravity: self.info.gravity.as_ref().map(|gravity| gravity.direction),
            compensates: Some(self.info.compensates),
            fault: None,
        }
    }
}
