//! One CiA 410 device: how it is brought up, and how its loss is noticed.
//!
//! Bring-up, by SDO: profile, identity and resolution are read; a device that is the right one goes to pre-operational, and is told: no
//! inversion or offsets of its own, first transmit PDO with both slopes on its event timer, heartbeat; then started. From then on a missing
//! heartbeat, missing process data, a boot-up message, another state, an emergency or a second sender each end the service, and the device is
//! brought up anew. Time is an argument \[ns\].

use super::canopen::{self as co, Entry, NmtCommand, NmtState, Reply, Said, Value, Width};
use super::frame::{BusState, Frame, Heard};
use std::collections::VecDeque;

const MS: u64 = 1_000_000;
/// Patience for one SDO answer \[ns\].
const SDO_PATIENCE: u64 = 250 * MS;
/// How often a request is sent before it counts as unanswered.
const SDO_TRIES: u32 = 3;
/// The first step of the bring-up that changes something in the device; before it, it is read who that is.
const CHANGES: usize = 5;
/// From a failed bring-up to the next \[ns\].
const BACK_OFF: u64 = 500 * MS;
/// Patience for heartbeat and process data after the start \[ns\].
const FIRST_PATIENCE: u64 = 1000 * MS;
/// Heartbeats and process data that may be missing: silence counts after this many periods.
const MISSING: u64 = 3;
/// What a busy machine and a busy bus may add to a silence \[ns\].
const SLACK: u64 = 20 * MS;
/// Heartbeats are counted over this many periods of them, to notice a second sender.
const COUNTED: u64 = 10;
/// Frames that wait to be sent at most.
const QUEUE: usize = 4;

/// What a device is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeSettings {
    /// Node id, 1 to 127.
    pub node: u8,
    /// Time between two heartbeats \[ms\].
    pub heartbeat: u16,
    /// Time between two process data \[ms\].
    pub period: u16,
    /// Slope objects.
    pub width: Width,
    /// Serial number that the device must have, where one is demanded.
    pub serial: Option<u32>,
}

/// Who the device is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Identity {
    /// Vendor, 1018h:1.
    pub vendor: u32,
    /// Product code, 1018h:2; 0 where the device has none.
    pub product: u32,
    /// Serial number, 1018h:4; 0 where the device has none.
    pub serial: u32,
    /// Unit of its slopes \[0.001 deg\].
    pub resolution: u32,
}

/// Why there is no reading.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// The device is being brought up.
    #[error("the inclinometer is being brought up")]
    Starting,
    /// Nobody answers.
    #[error("node {node} does not answer a request for {entry}")]
    Unanswered {
        /// Node id.
        node: u8,
        /// Object.
        entry: Entry,
    },
    /// A request was refused.
    #[error("the inclinometer refuses access to {entry} (abort code {code:08X}h)")]
    Refused {
        /// Object.
        entry: Entry,
        /// CiA 301's abort code.
        code: u32,
    },
    /// It is no inclinometer.
    #[error("the node's device type is {found:08X}h, expected profile 410 (inclinometer)")]
    NoInclinometer {
        /// Its device type.
        found: u32,
    },
    /// It is another inclinometer.
    #[error("the inclinometer's serial number is {found}, expected {expected}")]
    Foreign {
        /// Its serial number.
        found: u32,
        /// The one that the configuration demands.
        expected: u32,
    },
    /// Its resolution is none of CiA 410's.
    #[error("the inclinometer's resolution is {found}, expected 1, 10, 100 or 1000 (in 0.001 deg)")]
    Resolution {
        /// Its resolution.
        found: u32,
    },
    /// Its slopes end before the range does: what lies beyond would be cut off, or wrapped around.
    #[error(
        "the inclinometer's slopes of 16 bits end at {:.3} deg, the range is {:.1} deg: set `bits = 32`, or a `range` of at most \
         {:.1} deg", end(*.resolution).to_degrees(), .range.to_degrees(), (10.0 * end(*.resolution).to_degrees()).floor() / 10.0
    )]
    Narrow {
        /// Its resolution \[0.001 deg\].
        resolution: u32,
        /// The range that is wanted \[rad\].
        range: f64,
    },
    /// An object does not hold what was written.
    #[error("{entry} holds {found:08X}h, expected {expected:08X}h")]
    NotTaken {
        /// Object.
        entry: Entry,
        /// What it holds.
        found: u32,
        /// What it was to hold.
        expected: u32,
    },
    /// No heartbeat.
    #[error("no heartbeat of the inclinometer for {silent_ms} ms")]
    NoHeartbeat {
        /// Silence \[ms\].
        silent_ms: u64,
    },
    /// No process data.
    #[error("no slopes from the inclinometer for {silent_ms} ms")]
    NoSlopes {
        /// Silence \[ms\].
        silent_ms: u64,
    },
    /// It has restarted.
    #[error("the inclinometer has restarted")]
    Restarted,
    /// It has left the operational state.
    #[error("the inclinometer is {state}, expected operational")]
    State {
        /// Its state.
        state: NmtState,
    },
    /// It says that something is wrong with it.
    #[error("emergency {code:04X}h of the inclinometer, error register {register:02X}h")]
    Emergency {
        /// Error code.
        code: u16,
        /// Error register.
        register: u8,
    },
    /// More heartbeats than one device sends.
    #[error("{count} heartbeats in {passed_ms} ms, expected {expected}: does another node have the same id?")]
    TwoSenders {
        /// Heartbeats.
        count: u32,
        /// Time in which they came \[ms\].
        passed_ms: u64,
        /// Heartbeats that one device sends in this time.
        expected: u64,
    },
    /// Frames that the device can't have sent.
    #[error("frame of {length} bytes under the inclinometer's identifier {id:03X}h")]
    Malformed {
        /// Identifier.
        id: u16,
        /// Length.
        length: usize,
    },
    /// The bus is not well.
    #[error("{}", bus_words(*.0))]
    Bus(BusState),
    /// An angle that the sensor can't measure.
    #[error("slopes of {:.2} and {:.2} deg, expected at most {:.0} deg", .slopes[0].to_degrees(), .slopes[1].to_degrees(), .range.to_degrees())]
    OutOfRange {
        /// Slopes \[rad\].
        slopes: [f64; 2],
        /// Largest \[rad\].
        range: f64,
    },
    /// The angle has jumped.
    #[error("a slope has jumped by {:.2} deg from one frame to the next", .by.to_degrees())]
    Jump {
        /// By how much \[rad\].
        by: f64,
    },
    /// The thread that listens has ended, or hangs.
    #[error("the thread that listens to the inclinometer has said nothing for {silent_ms} ms")]
    NoListener {
        /// Silence \[ms\].
        silent_ms: u64,
    },
}

/// Largest slope that 16 bits hold in units of `resolution` \[0.001 deg\]; in rad.
fn end(resolution: u32) -> f64 {
    f64::from(i16::MAX) * unit(resolution)
}

/// One unit of the slopes of a device with this resolution \[0.001 deg\]; in rad.
pub(super) fn unit(resolution: u32) -> f64 {
    f64::from(resolution) * 1e-3_f64.to_radians()
}

fn bus_words(state: BusState) -> &'static str {
    match state {
        BusState::Active => "the CAN bus is well",
        BusState::Passive => "the CAN controller is error-passive: check wiring, termination and bit rate",
        BusState::Off => "the CAN controller is bus-off: check wiring, termination and bit rate",
        BusState::Down => "the CAN interface is down or gone",
        BusState::Blocked => "nothing can be sent on the CAN bus (ENOBUFS): nobody acknowledges",
    }
}

/// What the device's owner learns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NodeEvent {
    /// The device is up.
    Up(Identity),
    /// Two slopes, in units of the device's resolution.
    Slopes([i32; 2]),
    /// The service has ended; the device is brought up again.
    Down(Fault),
    /// A frame was passed over, for its length is wrong. The service goes on.
    Odd(Fault),
}

/// One request of the bring-up.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ask {
    Read(Entry),
    Write(Entry, Value),
}

/// One step: what is asked, and what may come of it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    ask: Ask,
    /// Whether the device may be without this object.
    optional: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Nothing is asked before this time.
    Waiting { until: u64 },
    /// Request `step` was sent `tries` times, last at `since`.
    Asking { step: usize, tries: u32, since: u64 },
    /// Started: heartbeat and process data are awaited.
    Started { since: u64 },
    /// Both have come.
    Up,
}

/// A device and what it was last heard to say.
#[derive(Clone, Debug)]
pub struct Node {
    settings: NodeSettings,
    /// Largest slope that is to be measured \[rad\].
    range: f64,
    stage: Stage,
    identity: Identity,
    /// What the PDO mapping was read to be; it is rewritten only where it is another.
    mapped: [u32; 3],
    /// The bit of the PDO's identifier that says that it is not asked for by remote requests, as it was read.
    remote: u32,
    heartbeat: Option<u64>,
    slopes: Option<u64>,
    /// Heartbeats since a time at which none waited to be heard.
    counted: Option<(u64, u32)>,
    /// Two senders were heard, and not yet one alone since then.
    doubted: bool,
    emergency: Option<Fault>,
    bus: BusState,
    outgoing: VecDeque<Frame>,
    events: VecDeque<NodeEvent>,
}

impl Node {
    /// A device that nobody has spoken to yet. It has to measure slopes up to `range` \[rad\].
    pub fn new(settings: NodeSettings, range: f64) -> Node {
        Node {
            settings,
            range,
            stage: Stage::Waiting { until: 0 },
            identity: Identity::default(),
            mapped: [0; 3],
            remote: 0,
            heartbeat: None,
            slopes: None,
            counted: None,
            doubted: false,
            emergency: None,
            bus: BusState::Active,
            outgoing: VecDeque::with_capacity(QUEUE),
            events: VecDeque::new(),
        }
    }

    /// Whether slopes are being served.
    pub fn is_up(&self) -> bool {
        self.stage == Stage::Up
    }

    /// The next frame to send.
    pub fn transmit(&mut self) -> Option<Frame> {
        self.outgoing.pop_front()
    }

    /// What has happened, in order.
    pub fn event(&mut self) -> Option<NodeEvent> {
        self.events.pop_front()
    }

    /// Takes in what came from the bus at `now` \[ns\].
    pub fn hear(&mut self, now: u64, heard: &Heard) {
        match heard {
            Heard::Bus(state) => self.bus_is(now, *state),
            Heard::Nothing => {
                self.counted.get_or_insert((now, 0));
            }
            Heard::Frame(frame) => {
                if let Some(said) = co::hear(self.settings.node, frame) {
                    self.said(now, said, frame);
                }
            }
        }
    }

    /// Lets time pass: asks what is due, and notices silence. Call it at least every 10 ms.
    pub fn tick(&mut self, now: u64) {
        match self.stage {
            Stage::Waiting { until } if now >= until => self.begin(now),
            Stage::Waiting { .. } => {}
            Stage::Asking { step, tries, since } if now.saturating_sub(since) >= SDO_PATIENCE => {
                if tries < SDO_TRIES {
                    self.ask(now, step, tries + 1);
                } else if let Some(Step { ask: Ask::Read(entry) | Ask::Write(entry, _), .. }) = self.step(step) {
                    self.fail(now, Fault::Unanswered { node: self.settings.node, entry });
                }
            }
            Stage::Asking { .. } => {}
            // Only the count of heartbeats is awaited still.
            Stage::Started { .. } if self.doubted && self.has_spoken() => self.notice_silence(now),
            Stage::Started { since } => {
                let silent_ms = now.saturating_sub(since) / MS;
                if now.saturating_sub(since) >= FIRST_PATIENCE + self.heartbeat_patience() {
                    let fault = match self.heartbeat {
                        None => Fault::NoHeartbeat { silent_ms },
                        Some(_) => Fault::NoSlopes { silent_ms },
                    };
                    self.fail(now, fault);
                }
            }
            Stage::Up => self.notice_silence(now),
        }
    }

    fn heartbeat_patience(&self) -> u64 {
        MISSING * u64::from(self.settings.heartbeat) * MS + SLACK
    }

    fn notice_silence(&mut self, now: u64) {
        let silent = |since: Option<u64>| now.saturating_sub(since.unwrap_or(0));
        let slopes = silent(self.slopes);
        let heartbeat = silent(self.heartbeat);
        if slopes > MISSING * u64::from(self.settings.period) * MS + SLACK {
            self.fail(now, Fault::NoSlopes { silent_ms: slopes / MS });
        } else if heartbeat > self.heartbeat_patience() {
            self.fail(now, Fault::NoHeartbeat { silent_ms: heartbeat / MS });
        }
    }

    fn bus_is(&mut self, now: u64, state: BusState) {
        if std::mem::replace(&mut self.bus, state) == state {
            return;
        }
        if state != BusState::Active {
            self.fail(now, Fault::Bus(state));
        } else {
            self.stage = Stage::Waiting { until: now };
        }
    }

    /// The service has ended; another bring-up follows. A bus that is not well is waited for, with a probe now and then.
    ///
    /// A bad bus or a standing emergency is the cause of whatever else goes wrong meanwhile.
    fn fail(&mut self, now: u64, fault: Fault) {
        let bus = (self.bus != BusState::Active).then_some(Fault::Bus(self.bus));
        let fault = bus.or(self.emergency).unwrap_or(fault);
        self.stage = Stage::Waiting { until: now.saturating_add(BACK_OFF) };
        self.outgoing.clear();
        self.events.push_back(NodeEvent::Down(fault));
    }

    fn begin(&mut self, now: u64) {
        (self.heartbeat, self.slopes) = (None, None);
        self.identity = Identity::default();
        self.mapped = [0; 3];
        self.remote = 0;
        self.ask(now, 0, 1);
    }

    fn send(&mut self, frame: Frame) {
        if self.outgoing.len() < QUEUE {
            self.outgoing.push_back(frame);
        }
    }

    /// Sends request `step`; after the last one the device is started.
    ///
    /// A node that is none of ours keeps its state: CiA 301 lets it be read in operation, too. In the state "stopped" it answers nobody, and what
    /// says nothing is taken for that before it is given up.
    fn ask(&mut self, now: u64, step: usize, tries: u32) {
        let node = self.settings.node;
        if step == CHANGES || (step == 0 && tries == SDO_TRIES) {
            self.send(co::nmt(node, NmtCommand::PreOperational));
        }
        match self.step(step) {
            Some(Step { ask: Ask::Read(entry), .. }) => self.send(co::read(node, entry)),
            Some(Step { ask: Ask::Write(entry, value), .. }) => self.send(co::write(node, entry, value)),
            None => {
                self.send(co::nmt(node, NmtCommand::Start));
                self.counted = None;
                self.stage = Stage::Started { since: now };
                return;
            }
        }
        self.stage = Stage::Asking { step, tries, since: now };
    }

    /// The bring-up, in order.
    fn step(&self, number: usize) -> Option<Step> {
        let width = self.settings.width;
        let [long, lateral] = width.operating();
        let id = 0x180 + u32::from(self.settings.node);
        let must = |ask| Some(Step { ask, optional: false });
        let may = |ask| Some(Step { ask, optional: true });
        let read = |entry| must(Ask::Read(entry));
        let write = |entry, value| must(Ask::Write(entry, value));
        match number {
            0 => read(co::DEVICE_TYPE),
            1 => read(co::VENDOR),
            2 => may(Ask::Read(co::PRODUCT)),
            3 => may(Ask::Read(co::SERIAL)),
            4 => read(co::RESOLUTION),
            // Presets that somebody left in the device would turn gravity unseen. A device without the object has none.
            5 => may(Ask::Write(long, Value::U8(0))),
            6 => may(Ask::Write(lateral, Value::U8(0))),
            // A device that answers no remote requests may refuse an identifier that allows them: it keeps that bit.
            7 => read(co::TPDO_ID),
            8 => write(co::TPDO_ID, Value::U32(1 << 31 | self.remote | id)),
            9 => read(co::MAP_COUNT),
            10 => read(co::MAP_FIRST),
            11 => read(co::MAP_SECOND),
            // Devices with a fixed mapping refuse to be written to: only another mapping is rewritten.
            12..=15 if self.is_mapped() => must(Ask::Read(co::MAP_COUNT)),
            12 => write(co::MAP_COUNT, Value::U8(0)),
            13 => write(co::MAP_FIRST, Value::U32(width.mapping()[0])),
            14 => write(co::MAP_SECOND, Value::U32(width.mapping()[1])),
            15 => write(co::MAP_COUNT, Value::U8(2)),
            16 => write(co::TPDO_TYPE, Value::U8(254)),
            17 => write(co::TPDO_TIMER, Value::U16(self.settings.period)),
            18 => read(co::TPDO_TIMER),
            19 => write(co::TPDO_ID, Value::U32(self.remote | id)),
            20 => write(co::HEARTBEAT_TIME, Value::U16(self.settings.heartbeat)),
            21 => read(co::HEARTBEAT_TIME),
            // Also tells that an emergency is over whose end was not heard.
            22 => read(co::ERROR_REGISTER),
            _ => None,
        }
    }

    fn is_mapped(&self) -> bool {
        let [first, second] = self.settings.width.mapping();
        self.mapped == [2, first, second]
    }

    fn said(&mut self, now: u64, said: Said, frame: &Frame) {
        match said {
            Said::Reply(reply) => self.replied(now, reply),
            Said::Heartbeat(state) => self.beat(now, state),
            Said::BootUp => {
                self.emergency = None;
                match self.stage {
                    Stage::Started { .. } | Stage::Up => self.fail(now, Fault::Restarted),
                    // It has lost what it had been told so far; one that was waited for may be asked at once.
                    Stage::Asking { .. } | Stage::Waiting { .. } => {
                        self.stage = Stage::Waiting { until: now.saturating_add(SLACK) };
                    }
                }
            }
            Said::Emergency { code: 0, .. } => self.emergency = None,
            Said::Emergency { code, register } => {
                let fault = Fault::Emergency { code, register };
                if self.emergency.replace(fault).is_none() {
                    self.fail(now, fault);
                }
            }
            Said::Pdo(bytes, length) => self.slopes(now, bytes.get(..length).unwrap_or(&[]), frame),
            Said::Malformed => self.odd(frame),
        }
    }

    fn odd(&mut self, frame: &Frame) {
        self.events.push_back(NodeEvent::Odd(Fault::Malformed { id: frame.id(), length: frame.data().len() }));
    }

    fn beat(&mut self, now: u64, state: NmtState) {
        if matches!(self.stage, Stage::Started { .. } | Stage::Up)
            && let Err(fault) = self.count(now)
        {
            return self.fail(now, fault);
        }
        match self.stage {
            Stage::Started { .. } if state == NmtState::Operational => {
                self.heartbeat = Some(now);
                self.come_up();
            }
            Stage::Up if state == NmtState::Operational => self.heartbeat = Some(now),
            Stage::Up => self.fail(now, Fault::State { state }),
            _ => {}
        }
    }

    /// Counts heartbeats: two nodes with one id both take the time that was set for them. Slopes may come on events, too, and tell nothing.
    ///
    /// The count begins when nothing waited to be heard. A frame may be heard long after it was sent, but what is counted was sent within the
    /// time that it is counted over: no stall, however long, makes two senders of one.
    fn count(&mut self, now: u64) -> Result<(), Fault> {
        let Some((since, before)) = self.counted else { return Ok(()) };
        let count = before.saturating_add(1);
        let period = u64::from(self.settings.heartbeat.max(1)) * MS;
        let passed = now.saturating_sub(since);
        if passed < COUNTED * period {
            self.counted = Some((since, count));
            return Ok(());
        }
        self.counted = None;
        let expected = passed / period;
        // One sender's timer is good to a few per cent; two send twice as much.
        self.doubted = 2 * u64::from(count) > 3 * expected;
        if self.doubted { Err(Fault::TwoSenders { count, passed_ms: passed / MS, expected }) } else { Ok(()) }
    }

    /// Heartbeat and process data have come.
    fn has_spoken(&self) -> bool {
        self.heartbeat.is_some() && self.slopes.is_some()
    }

    /// A device beside which another one was heard is counted once more before it is believed.
    fn come_up(&mut self) {
        if self.has_spoken() && self.emergency.is_none() && !self.doubted {
            self.stage = Stage::Up;
            self.events.push_back(NodeEvent::Up(self.identity));
        }
    }

    fn slopes(&mut self, now: u64, data: &[u8], frame: &Frame) {
        if !matches!(self.stage, Stage::Started { .. } | Stage::Up) {
            return;
        }
        let Some(slopes) = self.settings.width.read(data) else { return self.odd(frame) };
        self.slopes = Some(now);
        if matches!(self.stage, Stage::Started { .. }) {
            return self.come_up();
        }
        self.events.push_back(NodeEvent::Slopes(slopes));
    }

    /// An answer counts when it answers what was asked last.
    fn replied(&mut self, now: u64, reply: Reply) {
        let Stage::Asking { step: number, .. } = self.stage else { return };
        let Some(step) = self.step(number) else { return };
        let outcome = match (step.ask, reply) {
            (Ask::Read(asked), Reply::Read { entry, value }) if asked == entry => self.check(number, entry, value),
            (Ask::Write(asked, _), Reply::Written { entry }) if asked == entry => Ok(()),
            (Ask::Read(asked) | Ask::Write(asked, _), Reply::Abort { entry, code }) if asked == entry => {
                let lacking = code == co::ABORT_NO_OBJECT || code == co::ABORT_NO_SUBINDEX;
                if step.optional && lacking { Ok(()) } else { Err(Fault::Refused { entry, code }) }
            }
            // Somebody else's answer, or one that came too late.
            _ => return,
        };
        match outcome {
            Ok(()) => self.ask(now, number + 1, 1),
            Err(fault) => self.fail(now, fault),
        }
    }

    /// Takes in a value that was asked for.
    fn check(&mut self, number: usize, entry: Entry, found: u32) -> Result<(), Fault> {
        let expect = |expected: u32| match found == expected {
            true => Ok(()),
            false => Err(Fault::NotTaken { entry, found, expected }),
        };
        match number {
            0 if found & 0xffff != u32::from(co::PROFILE) => return Err(Fault::NoInclinometer { found }),
            1 => self.identity.vendor = found,
            2 => self.identity.product = found,
            3 => self.identity.serial = found,
            4 if ![1, 10, 100, 1000].contains(&found) => return Err(Fault::Resolution { found }),
            4 => {
                self.identity.resolution = found;
                // Asked here, where a device without a serial number has passed by, too.
                if let Some(expected) = self.settings.serial.filter(|&serial| serial != self.identity.serial) {
                    return Err(Fault::Foreign { found: self.identity.serial, expected });
                }
                if self.settings.width == Width::Bits16 && end(found) < self.range {
                    return Err(Fault::Narrow { resolution: found, range: self.range });
                }
            }
            7 => self.remote = found & co::NO_REMOTE,
            9..=11 => self.mapped[number - 9] = found,
            18 => return expect(u32::from(self.settings.period)),
            21 => return expect(u32::from(self.settings.heartbeat)),
            22 if found & 0xff == 0 => self.emergency = None,
            22 => return Err(Fault::Emergency { code: 0, register: (found & 0xff) as u8 }),
            _ => {}
        }
        Ok(())
    }
}
