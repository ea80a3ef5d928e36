//! The command line, as settings.

use crate::emulator::{Fault, RobotKind, Settings};
use clap::Parser;
use plumbline_franka::wire::Protocol;
use plumbline_model::Mounting;
use plumbline_sim::Truth;
use std::error::Error;
use std::net::IpAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Serves the Franka Control Interface, versions 5, 9 and 10, with a simulated arm behind it.
///
/// A client finds what it would find at a robot: states at 1 kHz, joint position, joint velocity and torque motions judged by Franka's
/// limits with Franka's error names, setters, recovery, robot description. Cartesian motions and asynchronous ones are answered with
/// "not possible". One client at a time: a second one is sent away. Lines on standard input play the operator and the network; `help`
/// lists them.
#[derive(Parser)]
#[command(name = "fci-emulator", version)]
pub struct Options {
    /// Address to serve on; every one of 127.0.0.0/8 can be a robot of its own, on port 1337 of TCP and UDP
    #[arg(long, default_value = "127.0.0.7")]
    address: IpAddr,
    /// Protocol version: 5, 9 or 10
    #[arg(long, default_value = "10", value_parser = protocol)]
    protocol: Protocol,
    /// Limits and name of the arm: panda or fr3; default is the one that speaks the version
    #[arg(long, value_parser = robot)]
    robot: Option<RobotKind>,
    /// Truth of the simulated arm; default is the built-in Panda
    #[arg(long, value_name = "FILE")]
    arm: Option<PathBuf>,
    /// upright, wall, ceiling, or RHO,PHI in rad: the direction of gravity in the base frame
    #[arg(long, default_value = "upright", value_parser = mounting)]
    mounting: Mounting,
    /// Seven joint positions to start at \[rad\], separated by commas
    #[arg(long, value_parser = pose, allow_hyphen_values = true)]
    start: Option<[f64; 7]>,
    /// Gravity that the arm's own controller compensates under torque commands: upright, whatever the mounting, or true, that of the mounting
    #[arg(long, default_value = "upright", value_parser = ["upright", "true"])]
    compensates: String,
    /// O_ddP_O of every state \[m/s2\], or `mounting` for the true gravity; default is what the arm compensates
    #[arg(long, allow_hyphen_values = true, value_name = "X,Y,Z")]
    base_acceleration: Option<String>,
    /// Fault: KIND[=VALUE][,at=SECONDS|motion[+SECONDS]][,for=SECONDS][,of=states|commands], KIND one of loss, delay, jitter,
    /// duplicate, reorder, truncate, garbage, tcp-reset, silence, wrong-version; may be given several times
    #[arg(long = "fault", value_name = "FAULT")]
    faults: Vec<Fault>,
    /// Shared library that LoadModelLibrary answers with (versions 5 and 9); without it they receive an error
    #[arg(long, value_name = "FILE")]
    model_library: Option<PathBuf>,
    /// Milliseconds that the robot's time stands still at most to wait for the next command: not what a robot does
    #[arg(long, default_value_t = 0)]
    command_wait: u64,
    /// Decides noise and chance
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// CSV file with one line per millisecond
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
}

fn protocol(text: &str) -> Result<Protocol, String> {
    let number = text.parse().map_err(|error| format!("{error}"))?;
    Protocol::from_number(number).ok_or_else(|| "versions 5, 9 and 10 are served".into())
}

fn robot(text: &str) -> Result<RobotKind, String> {
    let known = [RobotKind::Panda, RobotKind::Fr3];
    known.into_iter().find(|kind| kind.name() == text).ok_or_else(|| "panda or fr3".into())
}

fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    let numbers = numbers.map_err(|error| format!("{error}"))?;
    let count = numbers.len();
    match numbers.iter().all(|number: &f64| number.is_finite()) {
        true => numbers.try_into().map_err(|_| format!("{count} numbers, expected {N}")),
        false => Err("expected finite numbers".into()),
    }
}

fn pose(text: &str) -> Result<[f64; 7], String> {
    numbers(text)
}

fn mounting(text: &str) -> Result<Mounting, String> {
    match text {
        "upright" => Ok(Mounting::UPRIGHT),
        "wall" => Ok(Mounting::WALL),
        "ceiling" => Ok(Mounting::CEILING),
        angles => numbers(angles).map(|[rho, phi]| Mounting { rho, phi }),
    }
}

/// The settings of these options; events are logged.
pub fn settings(options: Options) -> Result<Settings, Box<dyn Error>> {
    let mut settings = Settings::new(options.address, options.protocol);
    settings.robot = options.robot.unwrap_or(settings.robot);
    if let Some(path) = options.arm {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(&path).map_err(|error| format!("{file}: {error}"))?;
        settings.arm = Truth::parse(&file, &text)?;
    }
    settings.mounting = options.mounting;
    settings.start = options.start.unwrap_or(settings.start);
    if options.compensates == "true" {
        settings.compensates = settings.mounting.gravity().into();
    }
    settings.base_acceleration = match options.base_acceleration.as_deref() {
        None => settings.compensates,
        Some("mounting") => settings.mounting.gravity().into(),
        Some(text) => numbers(text)?,
    };
    settings.faults = options.faults;
    if let Some(path) = options.model_library {
        settings.model_library = Some(std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?);
    }
    settings.command_wait = Duration::from_millis(options.command_wait);
    settings.seed = options.seed;
    settings.log = options.log;
    settings.speaks = true;
    Ok(settings)
}
