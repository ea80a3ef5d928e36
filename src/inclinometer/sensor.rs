//! The inclinometer: frames in, gravity or a fault out.

use super::attitude::{Attitude, Installation, InstallationError};
use super::fault::{Fault, unit};
use super::frame::{BusEvent, Frame};
use super::node::{Identity, Node, NodeEvent, NodeSettings};
use super::slope_filter::{FilteredSlopes, SlopeFilter, SlopeFilterSettings};
use plumbline_model::Mounting;
use std::collections::VecDeque;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSettings {
    pub node: NodeSettings,
    /// Orientation on the base, and accuracy.
    pub installation: Installation,
    pub filter: SlopeFilterSettings,
    /// The declared mounting, which determines the sign of the sensor's z axis.
    pub declared: Mounting,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Arrival time of the last frame \[ns\].
    pub at: u64,
    /// Gravity in the base frame, with its covariance.
    pub attitude: Attitude,
    /// The same without the low-pass, for the detection of base motion.
    pub raw: Attitude,
    /// Whether the base has been at rest for three time constants.
    pub still: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Health {
    Good(Reading),
    Bad(Fault),
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SensorEvent {
    Up(Identity),
    Fault(Fault),
    /// The first reading, or the first one after a fault.
    Recovered,
    Malformed(Fault),
}

/// Capacity of the event queue; further events are dropped.
const MAX_QUEUED_EVENTS: usize = 64;

/// An inclinometer: node, slope filter and attitude.
#[derive(Clone, Debug)]
pub struct Sensor {
    settings: SensorSettings,
    hemisphere: f64,
    node: Node,
    filter: SlopeFilter,
    /// One unit of the device's slopes \[rad\].
    unit: f64,
    health: Health,
    events: VecDeque<SensorEvent>,
}

impl Sensor {
    /// An inclinometer before its bring-up.
    pub fn new(settings: SensorSettings) -> Result<Sensor, InstallationError> {
        Ok(Sensor {
            settings,
            hemisphere: settings.installation.hemisphere(&settings.declared)?,
            node: Node::new(settings.node, settings.installation.range),
            filter: SlopeFilter::new(settings.filter),
            unit: 0.0,
            health: Health::Bad(Fault::Starting),
            events: VecDeque::new(),
        })
    }

    pub fn settings(&self) -> &SensorSettings {
        &self.settings
    }

    pub fn health(&self) -> Health {
        self.health
    }

    pub fn transmit(&mut self) -> Option<Frame> {
        self.node.transmit()
    }

    pub fn event(&mut self) -> Option<SensorEvent> {
        self.events.pop_front()
    }

    /// Processes an event of the bus at `now` \[ns\].
    pub fn handle(&mut self, now: u64, event: &BusEvent) {
        self.node.handle(now, event);
        self.process_node_events(now);
    }

    /// Advances timers to `now` \[ns\]. Call it at least every 10 ms.
    pub fn tick(&mut self, now: u64) {
        self.node.tick(now);
        self.process_node_events(now);
    }

    fn process_node_events(&mut self, now: u64) {
        while let Some(event) = self.node.event() {
            match event {
                NodeEvent::Up(identity) => {
                    self.unit = unit(identity.resolution);
                    self.filter.reset();
                    self.push_event(SensorEvent::Up(identity));
                }
                NodeEvent::Slopes(slopes) => self.handle_slopes(now, slopes.map(|slope| f64::from(slope) * self.unit)),
                NodeEvent::Down(fault) => {
                    self.filter.reset();
                    self.fail(fault);
                }
                NodeEvent::Malformed(fault) => self.push_event(SensorEvent::Malformed(fault)),
            }
        }
    }

    fn push_event(&mut self, event: SensorEvent) {
        if self.events.len() < MAX_QUEUED_EVENTS {
            self.events.push_back(event);
        }
    }

    /// Stores a fault. An event is queued only if the kind of fault has changed.
    fn fail(&mut self, fault: Fault) {
        let same = match self.health {
            Health::Bad(before) => std::mem::discriminant(&before) == std::mem::discriminant(&fault),
            Health::Good(_) => false,
        };
        self.health = Health::Bad(fault);
        if !same {
            self.push_event(SensorEvent::Fault(fault));
        }
    }

    fn handle_slopes(&mut self, now: u64, slopes: [f64; 2]) {
        let Installation { range, .. } = self.settings.installation;
        let Some(raw) = self.settings.installation.attitude(slopes, [0.0; 2], self.hemisphere) else {
            self.filter.reset();
            return self.fail(Fault::OutOfRange { slopes, range });
        };
        match self.filter.update(now, slopes) {
            Err(by) => self.fail(Fault::Jump { by }),
            Ok(None) => {}
            Ok(Some(FilteredSlopes { slopes, std, still })) => {
                // The mean of slopes in range is in range.
                let Some(attitude) = self.settings.installation.attitude(slopes, std, self.hemisphere) else { return };
                if matches!(self.health, Health::Bad(_)) {
                    self.push_event(SensorEvent::Recovered);
                }
                self.health = Health::Good(Reading { at: now, attitude, raw, still });
            }
        }
    }
}
