//! Serves Franka's control interface with a simulated arm behind it: for clients that have no robot at hand.

use clap::Parser;
use plumbline_testkit::emulator::Emulator;
use plumbline_testkit::emulator::options::Options;
use std::error::Error;
use std::process::ExitCode;

fn run(options: Options) -> Result<(), Box<dyn Error>> {
    let settings = plumbline_testkit::emulator::options::settings(options)?;
    eprintln!("fci-emulator: {}, protocol {}, {}", settings.robot.name(), settings.protocol, settings.address);
    plumbline_testkit::emulator::control::obey(&Emulator::start(settings)?);
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
