//! Serves Franka's control interface with a simulated arm behind it: for clients that have no robot at hand.

mod control;
mod emulator;
mod options;

use clap::Parser;
use emulator::Emulator;
use options::Options;
use std::error::Error;
use std::process::ExitCode;

fn run(options: Options) -> Result<(), Box<dyn Error>> {
    let settings = options::settings(options)?;
    eprintln!("fci-emulator: {}, protocol {}, {}", settings.robot.name(), settings.protocol, settings.address);
    control::obey(&Emulator::start(settings)?);
    Ok(())
}

fn main() -> ExitCode {
    match run(Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("fci-emulator: {error}");
            ExitCode::FAILURE
        }
    }
}
