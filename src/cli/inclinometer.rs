//! `plumbline inclinometer`: reads the inclinometer of a job and prints its readings; no arm is connected.

use crate::cli::say::say;
use crate::config::job::Job;
use crate::config::job::inclinometer::Inclinometer;
use crate::failure::Failure;
use crate::inclinometer::sensor::{Health, Reading, Sensor};
use crate::inclinometer::socket::Listener;
use clap::Args;
use plumbline_core::BadInput;
use plumbline_ipc::now_ns;
use plumbline_model::{Mounting, angle_between};
use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

/// Options of `plumbline inclinometer`.
#[derive(Args)]
pub struct Options {
    /// Job file with the inclinometer
    config: PathBuf,
    /// Override one key of the job, as in --set inclinometer.interface=vcan0 (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    sets: Vec<String>,
    /// Print until interrupted
    #[arg(long)]
    watch: bool,
    /// Lines per second while watching
    #[arg(long, default_value_t = 5.0, value_parser = rate)]
    rate: f64,
    /// End after this many lines
    #[arg(long)]
    count: Option<u64>,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.1..=200.0).contains(&rate) { Ok(rate) } else { Err("expected 0.1 to 200 lines per second".into()) }
}

/// Timeout of the first reading \[ns\].
const TIMEOUT_NS: u64 = 10_000_000_000;

/// Prints the first reading, or one after another.
pub fn run(options: Options) -> Result<(), Failure> {
    let job = Job::load(&options.config, &options.sets)?;
    let file = job.file.display().to_string();
    let own: &Inclinometer = job.inclinometer.as_ref().ok_or_else(|| {
        BadInput::new(&file, "key `inclinometer`", "nothing", "a table with `interface`, `node`, `x` and `z`")
    })?;
    let settings = own.sensor(&file, job.mounting)?;
    let sensor = Sensor::new(settings).map_err(Failure::job)?;
    let mut listener = Listener::start(&own.interface, sensor, &settings).map_err(Failure::job)?;
    let start = now_ns();
    let pause = Duration::from_secs_f64(1.0 / options.rate);
    if !options.watch {
        return once(&mut listener, start, &job.mounting);
    }
    let mut out = std::io::stdout();
    for _ in 0..options.count.unwrap_or(u64::MAX) {
        let now = now_ns();
        let line = match listener.health(now) {
            Health::Good(reading) => line_of(&reading, &job.mounting),
            Health::Bad(fault) => format!("no reading: {fault}"),
        };
        // The reader has closed the pipe.
        if writeln!(out, "{:8.3} s  {line}", now.saturating_sub(start) as f64 * 1e-9).is_err() {
            break;
        }
        std::thread::sleep(pause);
    }
    Ok(())
}

fn once(listener: &mut Listener, start: u64, declared: &Mounting) -> Result<(), Failure> {
    loop {
        let now = now_ns();
        match listener.health(now) {
            Health::Good(reading) => {
                say!("{}", line_of(&reading, declared));
                return Ok(());
            }
            Health::Bad(fault) if now.saturating_sub(start) > TIMEOUT_NS => return Err(Failure::job(fault)),
            Health::Bad(_) => std::thread::sleep(Duration::from_millis(10)),
        }
    }
}

fn line_of(reading: &Reading, declared: &Mounting) -> String {
    let Mounting { rho, phi } = reading.attitude.mounting();
    let [std_rho, std_phi] = reading.attitude.std_of_angles().map(f64::to_degrees);
    let off = angle_between(&reading.attitude.gravity, &declared.gravity()).to_degrees();
    let rest = if reading.still { "at rest" } else { "moving" };
    format!(
        "rho {:8.3} +- {std_rho:.3} deg, phi {:8.3} +- {std_phi:.3} deg, {off:.3} +- {:.3} deg off the declared mounting, {rest}",
        rho.to_degrees(),
        phi.to_degrees(),
        reading.attitude.std().to_degrees()
    )
}
