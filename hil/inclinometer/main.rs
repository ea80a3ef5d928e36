//! A simulated CiA 410 inclinometer on a CAN interface. Made for `vcan`; on a real bus it is a real node.

mod commands;

use clap::Parser;
use commands::Command;
use plumbline_testkit::inclinometer::Device;
use socketcan::{CanDataFrame, CanErrorFrame, CanFrame, CanSocket, EmbeddedFrame, ShouldRetry, Socket, StandardId};
use std::error::Error;
use std::io::BufRead;
use std::process::ExitCode;
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// Serves SDO, NMT, heartbeat, emergency and slopes as a two-axis inclinometer after CiA 410 does.
///
/// Lines on standard input are commands that tilt the device or make faults; `help` lists them. The master sets the rates of slopes and
/// heartbeat.
#[derive(Parser)]
#[command(name = "sim-inclinometer", version)]
struct Options {
    /// CAN interface
    #[arg(long, default_value = "vcan0")]
    interface: String,
    /// Node id
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u8).range(1..=127))]
    node: u8,
    /// Longitudinal and lateral slope \[deg\]
    #[arg(long, default_value = "0,0", value_parser = slopes, allow_hyphen_values = true, value_name = "LONG,LATERAL")]
    tilt: [f64; 2],
    /// Noise of a slope, standard deviation \[deg\]
    #[arg(long, default_value_t = 0.02)]
    noise: f64,
    /// Seed of the noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

fn slopes(text: &str) -> Result<[f64; 2], String> {
    let parts: Vec<f64> = text.split(',').filter_map(|part| part.trim().parse().ok()).collect();
    match parts[..] {
        [long, lateral] if long.is_finite() && lateral.is_finite() => Ok([long, lateral]),
        _ => Err("expected two angles in deg, such as 1.5,-0.3".into()),
    }
}

fn run(options: Options) -> Result<(), Box<dyn Error>> {
    let socket = CanSocket::open(&options.interface).map_err(|error| format!("{}: {error}", options.interface))?;
    socket.set_read_timeout(Duration::from_millis(1))?;
    let start = Instant::now();
    let now = || u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
    let mut device = Device::new(options.node, options.tilt, options.noise, options.seed, now());
    let commands = read_commands();
    eprintln!("sim-inclinometer: node {} on {}", options.node, options.interface);
    loop {
        while let Ok(command) = commands.try_recv() {
            eprintln!("sim-inclinometer: {:.3} s: {command:?}", start.elapsed().as_secs_f64());
            match command {
                Command::Quit => return Ok(()),
                Command::Bus(error) => send_error(&socket, error)?,
                command => command.apply(&mut device, now()),
            }
        }
        match socket.read_frame() {
            Ok(CanFrame::Data(data)) => {
                if let socketcan::Id::Standard(id) = data.id() {
                    device.receive(now(), id.as_raw(), data.data());
                }
            }
            Ok(_) => {}
            Err(error) if error.should_retry() => {}
            // A bus that is down: try again later.
            Err(_) => std::thread::sleep(Duration::from_millis(100)),
        }
        device.tick(now());
        while let Some((id, data)) = device.transmit() {
            let frame = StandardId::new(id).and_then(|id| CanDataFrame::new(id, &data));
            if let Some(frame) = frame {
                // Without a bus the frame is lost.
                let _ = socket.write_frame(&frame);
            }
        }
    }
}

/// Sends an error frame as a controller's driver does; a virtual bus has no controller.
fn send_error(socket: &CanSocket, (class, data): (u32, [u8; 8])) -> Result<(), Box<dyn Error>> {
    let frame = CanErrorFrame::new_error(class, &data)?;
    socket.write_frame(&CanFrame::Error(frame))?;
    Ok(())
}

/// Commands from standard input, read on a thread. The end of standard input is not a command.
fn read_commands() -> mpsc::Receiver<Command> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        for line in std::io::stdin().lock().lines().map_while(Result::ok) {
            match line.trim() {
                "" => {}
                "help" => eprintln!("{}", commands::HELP),
                text => match Command::parse(text) {
                    Some(command) if sender.send(command).is_ok() => {}
                    Some(_) => return,
                    None => eprintln!("sim-inclinometer: `{text}` is not a command; `help` lists them"),
                },
            }
        }
    });
    receiver
}

fn main() -> ExitCode {
    match run(Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("sim-inclinometer: {error}");
            ExitCode::from(2)
        }
    }
}
