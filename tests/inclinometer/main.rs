//! The inclinometer adapter against a simulated device, frame by frame and without a bus between them.

mod attitude;
mod bring_up;
mod faults;
mod follower;
mod fuzz;

use plumbline::inclinometer::attitude::Installation;
use plumbline::inclinometer::canopen::Width;
use plumbline::inclinometer::fault::Fault;
use plumbline::inclinometer::follow::{FollowSettings, Follower, OnSensorLoss};
use plumbline::inclinometer::frame::{BusEvent, Frame};
use plumbline::inclinometer::node::NodeSettings;
use plumbline::inclinometer::sensor::{Health, Reading, Sensor, SensorEvent, SensorSettings};
use plumbline::inclinometer::slope_filter::SlopeFilterSettings;
use plumbline_model::Mounting;
use plumbline_testkit::inclinometer::Device;

const NS_PER_MS: u64 = 1_000_000;
const NODE: u8 = 10;
const START: u8 = 1;
const STOP: u8 = 2;

fn installation() -> Installation {
    Installation::new([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]).unwrap()
}

fn settings() -> SensorSettings {
    SensorSettings {
        node: NodeSettings { node: NODE, heartbeat: 100, period: 20, width: Width::Bits16, serial: None },
        installation: installation(),
        filter: SlopeFilterSettings::default(),
        declared: Mounting::UPRIGHT,
    }
}

/// Device and adapter in simulated time, in steps of a millisecond.
struct Harness {
    now: u64,
    device: Device,
    sensor: Sensor,
    events: Vec<SensorEvent>,
}

impl Harness {
    fn new(settings: SensorSettings, tilt: [f64; 2]) -> Harness {
        Harness::with(settings, Device::new(NODE, tilt, 0.0, 1, 0))
    }

    fn with(settings: SensorSettings, device: Device) -> Harness {
        Harness { now: 0, device, sensor: Sensor::new(settings).unwrap(), events: Vec::new() }
    }

    /// A device that has booted and received an NMT command before the bring-up.
    fn after_nmt(settings: SensorSettings, device: Device, command: u8) -> Harness {
        let mut harness = Harness::with(settings, device);
        harness.now = 60 * NS_PER_MS;
        harness.device.tick(harness.now);
        while harness.device.transmit().is_some() {}
        harness.device.receive(harness.now, 0, &[command, NODE]);
        harness
    }

    fn advance(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += NS_PER_MS;
            self.device.tick(self.now);
            while let Some((id, data)) = self.device.transmit() {
                self.sensor.handle(self.now, &BusEvent::Frame(Frame::new(id, &data).unwrap()));
            }
            self.sensor.handle(self.now, &BusEvent::Idle);
            self.sensor.tick(self.now);
            while let Some(frame) = self.sensor.transmit() {
                self.device.receive(self.now, frame.id(), frame.data());
            }
            while let Some(event) = self.sensor.event() {
                self.events.push(event);
            }
        }
    }

    /// Simulates a stall of the adapter's thread: the frames of `ms` milliseconds are queued, then processed 64 at a time.
    fn stall(&mut self, ms: u64) {
        let mut queued = Vec::new();
        for _ in 0..ms {
            self.now += NS_PER_MS;
            self.device.tick(self.now);
            queued.extend(std::iter::from_fn(|| self.device.transmit()));
        }
        for batch in queued.chunks(64) {
            for (id, data) in batch {
                self.sensor.handle(self.now, &BusEvent::Frame(Frame::new(*id, data).unwrap()));
            }
            self.sensor.tick(self.now);
        }
    }

    fn reading(&self) -> Reading {
        match self.sensor.health() {
            Health::Good(reading) => reading,
            Health::Bad(fault) => panic!("{fault}; {:?}", self.events),
        }
    }

    fn fault(&self) -> Fault {
        match self.sensor.health() {
            Health::Good(reading) => panic!("{reading:?}"),
            Health::Bad(fault) => fault,
        }
    }

    /// Time until the first fault, at most `ms` \[ms\].
    fn time_to_fault(&mut self, ms: u64) -> u64 {
        (1..=ms)
            .find(|_| {
                self.advance(1);
                matches!(self.sensor.health(), Health::Bad(_))
            })
            .unwrap_or_else(|| panic!("no fault within {ms} ms"))
    }

    fn brought_up(mut self) -> Harness {
        self.advance(3000);
        self.reading();
        self
    }
}

fn follower(on_loss: OnSensorLoss) -> (Follower, FollowSettings) {
    let settings = FollowSettings {
        declared: Mounting::UPRIGHT,
        tolerance: 5f64.to_radians(),
        step: 0.1f64.to_radians(),
        rate: 1f64.to_radians(),
        on_loss,
    };
    (Follower::new(settings), settings)
}
