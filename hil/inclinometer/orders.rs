//! What a person or a script may do to the simulated device.

use plumbline_testkit::inclinometer::{Device, Faults};

/// Every order, for `help`.
pub const HELP: &str = "tilt LONG LATERAL [SECONDS]   tilt the base to these slopes [deg]
noise DEG                     noise of a slope from now on
unplug | no-heartbeat | no-slopes | short | twin    a fault, until `well`
well                          no fault any more
reset                         the device restarts
emergency CODE                an emergency by its hexadecimal code; 0 ends it
error-passive | bus-off | error-active              an error frame, as a controller's driver makes it
quit";

/// An order.
#[derive(Clone, Copy, Debug)]
pub enum Order {
    /// Slopes \[deg\], reached after so many seconds.
    Tilt([f64; 2], f64),
    /// Standard deviation \[deg\].
    Noise(f64),
    /// A fault that lasts.
    Fault(fn(&mut Faults)),
    /// No fault any more.
    Well,
    /// The device restarts.
    Reset,
    /// An emergency.
    Emergency(u16),
    /// Class and data of an error frame.
    Bus((u32, [u8; 8])),
    /// The end.
    Quit,
}

/// Classes of error frames (linux/can/error.h).
const CONTROLLER: u32 = 0x04;
const BUS_OFF: u32 = 0x40;

impl Order {
    /// An order from a line.
    pub fn parse(line: &str) -> Option<Order> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |at: usize| words.get(at)?.parse::<f64>().ok().filter(|value| value.is_finite());
        let controller = |state: u8| Order::Bus((CONTROLLER, [0, state, 0, 0, 0, 0, 0, 0]));
        Some(match *words.first()? {
            "tilt" => Order::Tilt([number(1)?, number(2)?], if words.len() > 3 { number(3)?.max(0.0) } else { 0.0 }),
            "noise" => Order::Noise(number(1)?.abs()),
            "unplug" => Order::Fault(|faults| faults.unplugged = true),
            "no-heartbeat" => Order::Fault(|faults| faults.no_heartbeat = true),
            "no-slopes" => Order::Fault(|faults| faults.no_slopes = true),
            "short" => Order::Fault(|faults| faults.short = true),
            "twin" => Order::Fault(|faults| faults.twin = true),
            "well" => Order::Well,
            "reset" => Order::Reset,
            "emergency" => Order::Emergency(u16::from_str_radix(words.get(1)?, 16).ok()?),
            "error-passive" => controller(0x20),
            "error-active" => controller(0x40),
            "bus-off" => Order::Bus((BUS_OFF, [0; 8])),
            "quit" => Order::Quit,
            _ => return None,
        })
    }

    /// Does it to the device.
    pub fn carry_out(self, device: &mut Device, now: u64) {
        match self {
            Order::Tilt(slopes, seconds) => device.tilt(now, slopes, seconds),
            Order::Noise(noise) => device.noise(noise),
            Order::Fault(fault) => fault(&mut device.faults),
            Order::Well => device.faults = Faults::default(),
            Order::Reset => device.reset(now),
            Order::Emergency(code) => device.emergency(code),
            Order::Bus(_) | Order::Quit => {}
        }
    }
}
