//! The whole inclinometer: frames in, gravity or a fault out.

use super::attitude::{Attitude, Seat, SeatError};
use super::frame::{Frame, Heard};
use super::node::{Fault, Identity, Node, NodeEvent, NodeSettings, unit};
use super::smooth::{Calm, SmoothSettings, Smoother};
use plumbline_model::Mounting;
use std::collections::VecDeque;

/// Everything that is set of an inclinometer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSettings {
    /// The device on its bus.
    pub node: NodeSettings,
    /// How it sits on the base.
    pub seat: Seat,
    /// How its slopes are made calm.
    pub smooth: SmoothSettings,
    /// The declared mounting: decides whether the sensor's z axis points up or down.
    pub declared: Mounting,
}

/// What the sensor says, calm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// When its last frame came \[ns\].
    pub at: u64,
    /// Gravity in the base frame, with its covariance.
    pub attitude: Attitude,
    /// The same without the low-pass: what a moving base shows first.
    pub raw: Attitude,
    /// The base has been at rest for three time constants.
    pub still: bool,
}

/// How the inclinometer is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Health {
    /// It is served.
    Good(Reading),
    /// It is not.
    Bad(Fault),
}

/// Something to be said.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Note {
    /// The device is up.
    Up(Identity),
    /// A fault has come.
    Fault(Fault),
    /// The first reading after a fault, or at all.
    Well,
    /// A frame was passed over.
    Odd(Fault),
}

/// Notes that wait to be taken at most; what comes after them is not said.
const NOTES: usize = 64;

/// An inclinometer.
#[derive(Clone, Debug)]
pub struct Sensor {
    settings: SensorSettings,
    hemisphere: f64,
    node: Node,
    smoother: Smoother,
    /// One unit of the device's slopes \[rad\].
    unit: f64,
    health: Health,
    notes: VecDeque<Note>,
}

impl Sensor {
    /// An inclinometer that nobody has spoken to yet.
    ///
    /// # Errors
    /// A declared mounting that the sensor can't see.
    pub fn new(settings: SensorSettings) -> Result<Sensor, SeatError> {
        Ok(Sensor {
            settings,
            hemisphere: settings.seat.hemisphere(&settings.declared)?,
            node: Node::new(settings.node, settings.seat.range),
            smoother: Smoother::new(settings.smooth),
            unit: 0.0,
            health: Health::Bad(Fault::Starting),
            notes: VecDeque::new(),
        })
    }

    /// What it was made with.
    pub fn settings(&self) -> &SensorSettings {
        &self.settings
    }

    /// How it is.
    pub fn health(&self) -> Health {
        self.health
    }

    /// The next frame to send.
    pub fn transmit(&mut self) -> Option<Frame> {
        self.node.transmit()
    }

    /// What there is to say, in order.
    pub fn note(&mut self) -> Option<Note> {
        self.notes.pop_front()
    }

    /// Takes in what came from the bus at `now` \[ns\].
    pub fn hear(&mut self, now: u64, heard: &Heard) {
        self.node.hear(now, heard);
        self.follow(now);
    }

    /// Lets time pass; call it at least every 10 ms.
    pub fn tick(&mut self, now: u64) {
        self.node.tick(now);
        self.follow(now);
    }

    fn follow(&mut self, now: u64) {
        while let Some(event) = self.node.event() {
            match event {
                NodeEvent::Up(identity) => {
                    self.unit = unit(identity.resolution);
                    self.smoother.reset();
                    self.tell(Note::Up(identity));
                }
                NodeEvent::Slopes(slopes) => self.slopes(now, slopes.map(|slope| f64::from(slope) * self.unit)),
                NodeEvent::Down(fault) => {
                    self.smoother.reset();
                    self.fail(fault);
                }
                NodeEvent::Odd(fault) => self.tell(Note::Odd(fault)),
            }
        }
    }

    fn tell(&mut self, note: Note) {
        if self.notes.len() < NOTES {
            self.notes.push_back(note);
        }
    }

    /// The first fault is the cause; what follows from it is said only where it is of another kind.
    fn fail(&mut self, fault: Fault) {
        let same = match self.health {
            Health::Bad(before) => std::mem::discriminant(&before) == std::mem::discriminant(&fault),
            Health::Good(_) => false,
        };
        self.health = Health::Bad(fault);
        if !same {
            self.tell(Note::Fault(fault));
        }
    }

    fn slopes(&mut self, now: u64, slopes: [f64; 2]) {
        let Seat { range, .. } = self.settings.seat;
        let Some(raw) = self.settings.seat.attitude(slopes, [0.0; 2], self.hemisphere) else {
            self.smoother.reset();
            return self.fail(Fault::OutOfRange { slopes, range });
        };
        match self.smoother.take(now, slopes) {
            Err(by) => self.fail(Fault::Jump { by }),
            Ok(None) => {}
            Ok(Some(Calm { slopes, std, still })) => {
                // Two slopes in range have a mean in range.
                let Some(attitude) = self.settings.seat.attitude(slopes, std, self.hemisphere) else { return };
                if matches!(self.health, Health::Bad(_)) {
                    self.tell(Note::Well);
                }
                self.health = Health::Good(Reading { at: now, attitude, raw, still });
            }
        }
    }
}
