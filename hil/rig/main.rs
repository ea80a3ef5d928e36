//! The first hour with a real arm: four steps, each of which does one thing and ends with a verdict. docs/guide/franka.md is the
//! procedure; nothing here starts without `--i-am-at-the-robot`.

use clap::Parser;
use plumbline_testkit::rig::Cli;
use plumbline_testkit::rig::verdict::Verdict;
use std::process::ExitCode;

fn main() -> ExitCode {
    match Cli::parse().step.take() {
        Ok(verdict) => {
            println!("{verdict}");
            if matches!(verdict, Verdict::Pass(_)) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("rig: {error}");
            ExitCode::from(2)
        }
    }
}
