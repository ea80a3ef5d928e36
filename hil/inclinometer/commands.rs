//! Commands to the simulated device, one per line.

use plumbline_testkit::inclinometer::{Device, Faults};

pub const HELP: &str = "tilt LONG LATERAL [SECONDS]   tilt the base to these slopes [deg]
noise DEG                     noise of a slope from now on
unplug | no-heartbeat | no-slopes | short | twin    a fault, until `well`
well                          clears the fault
reset                         the device restarts
emergency CODE                an emergency by its hexadecimal code; 0 clears it
error-passive | bus-off | error-active              an error frame, as a controller's driver sends it
quit";

#[derive(Clone, Copy, Debug)]
pub enum Command {
    /// Slopes \[deg\] and the duration of the motion \[s\].
    Tilt([f64; 2], f64),
    /// Standard deviation of the noise \[deg\].
    Noise(f64),
    Fault(fn(&mut Faults)),
    Well,
    Reset,
    Emergency(u16),
    /// Class and data of an error frame.
    Bus((u32, [u8; 8])),
    Quit,
}

/// Classes of error frames (linux/can/error.h).
const CONTROLLER: u32 = 0x04;
const BUS_OFF: u32 = 0x40;

impl Command {
    pub fn parse(line: &str) -> Option<Command> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |at: usize| words.get(at)?.parse::<f64>().ok().filter(|value| value.is_finite());
        let controller = |state: u8| Command::Bus((CONTROLLER, [0, state, 0, 0, 0, 0, 0, 0]));
        Some(match *words.first()? {
            "tilt" => Command::Tilt([number(1)?, number(2)?], if words.len() > 3 { number(3)?.max(0.0) } else { 0.0 }),
            "noise" => Command::Noise(number(1)?.abs()),
            "unplug" => Command::Fault(|faults| faults.unplugged = true),
            "no-heartbeat" => Command::Fault(|faults| faults.no_heartbeat = true),
            "no-slopes" => Command::Fault(|faults| faults.no_slopes = true),
            "short" => Command::Fault(|faults| faults.short_pdo = true),
            "twin" => Command::Fault(|faults| faults.duplicate_id = true),
            "well" => Command::Well,
            "reset" => Command::Reset,
            "emergency" => Command::Emergency(u16::from_str_radix(words.get(1)?, 16).ok()?),
            "error-passive" => controller(0x20),
            "error-active" => controller(0x40),
            "bus-off" => Command::Bus((BUS_OFF, [0; 8])),
            "quit" => Command::Quit,
            _ => return None,
        })
    }

    pub fn apply(self, device: &mut Device, now: u64) {
        match self {
            Command::Tilt(slopes, seconds) => device.tilt(now, slopes, seconds),
            Command::Noise(noise) => device.noise(noise),
            Command::Fault(fault) => fault(&mut device.faults),
            Command::Well => device.faults = Faults::default(),
            Command::Reset => device.reset(now),
            Command::Emergency(code) => device.emergency(code),
            Command::Bus(_) | Command::Quit => {}
        }
    }
}
