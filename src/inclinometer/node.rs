//! Bring-up and monitoring of one CiA 410 device.
//!
//! The bring-up uses SDO. It reads profile, identity and resolution. If they match, the device goes to pre-operational and is
//! configured: no inversion or offset, both slopes in the first transmit PDO on its event timer, heartbeat. Then it is started.
//!
//! The service ends on a missing heartbeat, missing process data, a boot-up message, another state, an emergency or a second sender.
//! The device is then brought up again. Time is an argument \[ns\].

use super::canopen::{self as co, Entry, Message, NmtCommand, NmtState, Reply, Value, Width};
use super::fault::{Fault, max_slope};
use super::frame::{BusEvent, BusState, Frame};
use std::collections::VecDeque;

const NS_PER_MS: u64 = 1_000_000;
/// Timeout of one SDO response \[ns\].
const SDO_TIMEOUT_NS: u64 = 250 * NS_PER_MS;
/// Transmissions of a request before it counts as unanswered.
const SDO_MAX_ATTEMPTS: u32 = 3;
/// First step of the bring-up that writes to the device; the steps before read its identity.
const FIRST_WRITE_STEP: usize = 5;
/// Time from a failed bring-up to the next one \[ns\].
const RETRY_DELAY_NS: u64 = 500 * NS_PER_MS;
/// Timeout of the first heartbeat and the first process data after the start, without the heartbeat timeout \[ns\].
const START_TIMEOUT_NS: u64 = 1000 * NS_PER_MS;
/// Timeout of heartbeat and process data, in periods.
const TIMEOUT_PERIODS: u64 = 3;
/// Margin on timeouts for a loaded computer and bus \[ns\].
const TIMEOUT_MARGIN_NS: u64 = 20 * NS_PER_MS;
/// Heartbeat periods over which heartbeats are counted to detect a second sender.
const HEARTBEAT_COUNT_PERIODS: u64 = 10;
const MAX_QUEUED_FRAMES: usize = 4;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeSettings {
    /// Node id, 1 to 127.
    pub node: u8,
    /// Time between two heartbeats \[ms\].
    pub heartbeat: u16,
    /// Time between two process data \[ms\].
    pub period: u16,
    pub width: Width,
    /// Required serial number; any if absent.
    pub serial: Option<u32>,
}

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

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NodeEvent {
    Up(Identity),
    /// Two slopes, in units of the device's resolution.
    Slopes([i32; 2]),
    /// The service has ended; the device is brought up again.
    Down(Fault),
    /// A frame of a wrong length was ignored. The service continues.
    Malformed(Fault),
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Request {
    Read(Entry),
    Write(Entry, Value),
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Step {
    request: Request,
    /// Whether the device may lack this object.
    optional: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// No request is sent before this time.
    Waiting { until: u64 },
    /// Request `step` was sent `attempt` times, last at `since`.
    Requesting { step: usize, attempt: u32, since: u64 },
    /// Started, without heartbeat or process data so far.
    Started { since: u64 },
    /// Operational: heartbeat and process data received.
    Up,
}

#[derive(Clone, Debug)]
pub struct Node {
    settings: NodeSettings,
    /// Largest slope to measure \[rad\].
    range: f64,
    stage: Stage,
    identity: Identity,
    /// PDO mapping read from the device; rewritten only if it differs.
    pdo_mapping: [u32; 3],
    /// [`co::NO_REMOTE`] of the PDO's identifier, as read from the device.
    remote_bit: u32,
    heartbeat: Option<u64>,
    slopes: Option<u64>,
    /// Start and number of the counted heartbeats; the receive queue was empty at the start.
    heartbeat_count: Option<(u64, u32)>,
    /// Two senders were detected, and no count since then shows one alone.
    duplicate_suspected: bool,
    emergency: Option<Fault>,
    bus: BusState,
    outgoing: VecDeque<Frame>,
    events: VecDeque<NodeEvent>,
}

impl Node {
    /// A device before its bring-up; it has to measure slopes up to `range` \[rad\].
    pub fn new(settings: NodeSettings, range: f64) -> Node {
        Node {
            settings,
            range,
            stage: Stage::Waiting { until: 0 },
            identity: Identity::default(),
            pdo_mapping: [0; 3],
            remote_bit: 0,
            heartbeat: None,
            slopes: None,
            heartbeat_count: None,
            duplicate_suspected: false,
            emergency: None,
            bus: BusState::Active,
            outgoing: VecDeque::with_capacity(MAX_QUEUED_FRAMES),
            events: VecDeque::new(),
        }
    }

    /// Whether the device is operational and delivers slopes.
    pub fn is_up(&self) -> bool {
        self.stage == Stage::Up
    }

    pub fn transmit(&mut self) -> Option<Frame> {
        self.outgoing.pop_front()
    }

    pub fn event(&mut self) -> Option<NodeEvent> {
        self.events.pop_front()
    }

    /// Processes an event of the bus at `now` \[ns\].
    pub fn handle(&mut self, now: u64, event: &BusEvent) {
        match event {
            BusEvent::Bus(state) => self.set_bus_state(now, *state),
            BusEvent::Idle => {
                self.heartbeat_count.get_or_insert((now, 0));
            }
            BusEvent::Frame(frame) => {
                if let Some(message) = co::parse(self.settings.node, frame) {
                    self.handle_message(now, message, frame);
                }
            }
        }
    }

    /// Advances timers to `now` \[ns\]: sends due requests and checks timeouts. Call it at least every 10 ms.
    pub fn tick(&mut self, now: u64) {
        match self.stage {
            Stage::Waiting { until } if now >= until => self.start_bring_up(now),
            Stage::Waiting { .. } => {}
            Stage::Requesting { step, attempt, since } if now.saturating_sub(since) >= SDO_TIMEOUT_NS => {
                if attempt < SDO_MAX_ATTEMPTS {
                    self.send_request(now, step, attempt + 1);
                } else if let Some(Step { request: Request::Read(entry) | Request::Write(entry, _), .. }) =
                    self.step(step)
                {
                    self.end_service(now, Fault::Unanswered { node: self.settings.node, entry });
                }
            }
            Stage::Requesting { .. } => {}
            // The device is complete but for the count of its heartbeats.
            Stage::Started { .. } if self.duplicate_suspected && self.has_received_both() => self.check_timeouts(now),
            Stage::Started { since } => {
                let elapsed_ms = now.saturating_sub(since) / NS_PER_MS;
                if now.saturating_sub(since) >= START_TIMEOUT_NS + self.heartbeat_timeout() {
                    let fault = match self.heartbeat {
                        None => Fault::NoHeartbeat { elapsed_ms },
                        Some(_) => Fault::NoSlopes { elapsed_ms },
                    };
                    self.end_service(now, fault);
                }
            }
            Stage::Up => self.check_timeouts(now),
        }
    }

    fn heartbeat_timeout(&self) -> u64 {
        TIMEOUT_PERIODS * u64::from(self.settings.heartbeat) * NS_PER_MS + TIMEOUT_MARGIN_NS
    }

    fn check_timeouts(&mut self, now: u64) {
        let elapsed = |since: Option<u64>| now.saturating_sub(since.unwrap_or(0));
        let slopes = elapsed(self.slopes);
        let heartbeat = elapsed(self.heartbeat);
        if slopes > TIMEOUT_PERIODS * u64::from(self.settings.period) * NS_PER_MS + TIMEOUT_MARGIN_NS {
            self.end_service(now, Fault::NoSlopes { elapsed_ms: slopes / NS_PER_MS });
        } else if heartbeat > self.heartbeat_timeout() {
            self.end_service(now, Fault::NoHeartbeat { elapsed_ms: heartbeat / NS_PER_MS });
        }
    }

    fn set_bus_state(&mut self, now: u64, state: BusState) {
        if std::mem::replace(&mut self.bus, state) == state {
            return;
        }
        if state != BusState::Active {
            self.end_service(now, Fault::Bus(state));
        } else {
            self.stage = Stage::Waiting { until: now };
        }
    }

    /// Ends the service and schedules the next bring-up, also while the bus is in an error state.
    ///
    /// A bus error or a pending emergency replaces `fault` as the cause.
    fn end_service(&mut self, now: u64, fault: Fault) {
        let bus = (self.bus != BusState::Active).then_some(Fault::Bus(self.bus));
        let fault = bus.or(self.emergency).unwrap_or(fault);
        self.stage = Stage::Waiting { until: now.saturating_add(RETRY_DELAY_NS) };
        self.outgoing.clear();
        self.events.push_back(NodeEvent::Down(fault));
    }

    fn start_bring_up(&mut self, now: u64) {
        (self.heartbeat, self.slopes) = (None, None);
        self.identity = Identity::default();
        self.pdo_mapping = [0; 3];
        self.remote_bit = 0;
        self.send_request(now, 0, 1);
    }

    fn send(&mut self, frame: Frame) {
        if self.outgoing.len() < MAX_QUEUED_FRAMES {
            self.outgoing.push_back(frame);
        }
    }

    /// Sends request `step`; starts the device after the last one.
    ///
    /// Until the identity matches, the node keeps its NMT state: CiA 301 allows SDO reads in operation. A stopped node answers no SDO, so
    /// the last attempt of the first request is preceded by a change to pre-operational.
    fn send_request(&mut self, now: u64, step: usize, attempt: u32) {
        let node = self.settings.node;
        if step == FIRST_WRITE_STEP || (step == 0 && attempt == SDO_MAX_ATTEMPTS) {
            self.send(co::nmt(node, NmtCommand::PreOperational));
        }
        match self.step(step) {
            Some(Step { request: Request::Read(entry), .. }) => self.send(co::read(node, entry)),
            Some(Step { request: Request::Write(entry, value), .. }) => self.send(co::write(node, entry, value)),
            None => {
                self.send(co::nmt(node, NmtCommand::Start));
                self.heartbeat_count = None;
                self.stage = Stage::Started { since: now };
                return;
            }
        }
        self.stage = Stage::Requesting { step, attempt, since: now };
    }

    /// The steps of the bring-up, in order.
    fn step(&self, number: usize) -> Option<Step> {
        let width = self.settings.width;
        let [long, lateral] = width.operating();
        let id = 0x180 + u32::from(self.settings.node);
        let must = |request| Some(Step { request, optional: false });
        let may = |request| Some(Step { request, optional: true });
        let read = |entry| must(Request::Read(entry));
        let write = |entry, value| must(Request::Write(entry, value));
        match number {
            0 => read(co::DEVICE_TYPE),
            1 => read(co::VENDOR),
            2 => may(Request::Read(co::PRODUCT)),
            3 => may(Request::Read(co::SERIAL)),
            4 => read(co::RESOLUTION),
            // Clears a stored inversion or offset, which would falsify gravity. A device without the object has none.
            5 => may(Request::Write(long, Value::U8(0))),
            6 => may(Request::Write(lateral, Value::U8(0))),
            // The NO_REMOTE bit is kept: some devices abort a write that clears it.
            7 => read(co::TPDO_ID),
            8 => write(co::TPDO_ID, Value::U32(1 << 31 | self.remote_bit | id)),
            9 => read(co::MAP_COUNT),
            10 => read(co::MAP_FIRST),
            11 => read(co::MAP_SECOND),
            // The mapping is written only if it differs: devices with a fixed mapping abort the write.
            12..=15 if self.is_mapped() => must(Request::Read(co::MAP_COUNT)),
            12 => write(co::MAP_COUNT, Value::U8(0)),
            13 => write(co::MAP_FIRST, Value::U32(width.mapping()[0])),
            14 => write(co::MAP_SECOND, Value::U32(width.mapping()[1])),
            15 => write(co::MAP_COUNT, Value::U8(2)),
            16 => write(co::TPDO_TYPE, Value::U8(254)),
            17 => write(co::TPDO_TIMER, Value::U16(self.settings.period)),
            18 => read(co::TPDO_TIMER),
            19 => write(co::TPDO_ID, Value::U32(self.remote_bit | id)),
            20 => write(co::HEARTBEAT_TIME, Value::U16(self.settings.heartbeat)),
            21 => read(co::HEARTBEAT_TIME),
            // Detects the end of an emergency whose final message was lost.
            22 => read(co::ERROR_REGISTER),
            _ => None,
        }
    }

    fn is_mapped(&self) -> bool {
        let [first, second] = self.settings.width.mapping();
        self.pdo_mapping == [2, first, second]
    }

    fn handle_message(&mut self, now: u64, message: Message, frame: &Frame) {
        match message {
            Message::Reply(reply) => self.handle_reply(now, reply),
            Message::Heartbeat(state) => self.handle_heartbeat(now, state),
            Message::BootUp => {
                self.emergency = None;
                match self.stage {
                    Stage::Started { .. } | Stage::Up => self.end_service(now, Fault::Restarted),
                    // The device has lost its configuration: restart the bring-up without the retry delay.
                    Stage::Requesting { .. } | Stage::Waiting { .. } => {
                        self.stage = Stage::Waiting { until: now.saturating_add(TIMEOUT_MARGIN_NS) };
                    }
                }
            }
            Message::Emergency { code: 0, .. } => self.emergency = None,
            Message::Emergency { code, register } => {
                let fault = Fault::Emergency { code, register };
                if self.emergency.replace(fault).is_none() {
                    self.end_service(now, fault);
                }
            }
            Message::Pdo(bytes, length) => self.handle_slopes(now, bytes.get(..length).unwrap_or(&[]), frame),
            Message::Malformed => self.report_malformed(frame),
        }
    }

    fn report_malformed(&mut self, frame: &Frame) {
        self.events.push_back(NodeEvent::Malformed(Fault::Malformed { id: frame.id(), length: frame.data().len() }));
    }

    fn handle_heartbeat(&mut self, now: u64, state: NmtState) {
        if matches!(self.stage, Stage::Started { .. } | Stage::Up)
            && let Err(fault) = self.count_heartbeat(now)
        {
            return self.end_service(now, fault);
        }
        match self.stage {
            Stage::Started { .. } if state == NmtState::Operational => {
                self.heartbeat = Some(now);
                self.enter_up();
            }
            Stage::Up if state == NmtState::Operational => self.heartbeat = Some(now),
            Stage::Up => self.end_service(now, Fault::State { state }),
            _ => {}
        }
    }

    /// Counts heartbeats to detect two nodes with the same id, which both use the configured period. Slopes are not counted, because a
    /// device may also send them on events.
    ///
    /// The count starts at an empty receive queue. All counted frames are therefore sent within the counted time, and a stall of this
    /// thread does not look like a second sender.
    fn count_heartbeat(&mut self, now: u64) -> Result<(), Fault> {
        let Some((since, before)) = self.heartbeat_count else { return Ok(()) };
        let count = before.saturating_add(1);
        let period = u64::from(self.settings.heartbeat.max(1)) * NS_PER_MS;
        let passed = now.saturating_sub(since);
        if passed < HEARTBEAT_COUNT_PERIODS * period {
            self.heartbeat_count = Some((since, count));
            return Ok(());
        }
        self.heartbeat_count = None;
        let expected = passed / period;
        // The timer of one sender is accurate to a few per cent; two senders give twice the count.
        self.duplicate_suspected = 2 * u64::from(count) > 3 * expected;
        if self.duplicate_suspected {
            Err(Fault::DuplicateNodeId { count, passed_ms: passed / NS_PER_MS, expected })
        } else {
            Ok(())
        }
    }

    /// Whether heartbeat and process data have been received since the start.
    fn has_received_both(&self) -> bool {
        self.heartbeat.is_some() && self.slopes.is_some()
    }

    /// Enters [`Stage::Up`]. After the detection of a second sender, a count with one sender is needed first.
    fn enter_up(&mut self) {
        if self.has_received_both() && self.emergency.is_none() && !self.duplicate_suspected {
            self.stage = Stage::Up;
            self.events.push_back(NodeEvent::Up(self.identity));
        }
    }

    fn handle_slopes(&mut self, now: u64, data: &[u8], frame: &Frame) {
        if !matches!(self.stage, Stage::Started { .. } | Stage::Up) {
            return;
        }
        let Some(slopes) = self.settings.width.read(data) else { return self.report_malformed(frame) };
        self.slopes = Some(now);
        if matches!(self.stage, Stage::Started { .. }) {
            return self.enter_up();
        }
        self.events.push_back(NodeEvent::Slopes(slopes));
    }

    /// Processes a response to the last request; others are ignored.
    fn handle_reply(&mut self, now: u64, reply: Reply) {
        let Stage::Requesting { step: number, .. } = self.stage else { return };
        let Some(step) = self.step(number) else { return };
        let outcome = match (step.request, reply) {
            (Request::Read(asked), Reply::Read { entry, value }) if asked == entry => self.check(number, entry, value),
            (Request::Write(asked, _), Reply::Written { entry }) if asked == entry => Ok(()),
            (Request::Read(asked) | Request::Write(asked, _), Reply::Abort { entry, code }) if asked == entry => {
                let absent = code == co::ABORT_NO_OBJECT || code == co::ABORT_NO_SUBINDEX;
                if step.optional && absent { Ok(()) } else { Err(Fault::Refused { entry, code }) }
            }
            // A response to another master, or a late one.
            _ => return,
        };
        match outcome {
            Ok(()) => self.send_request(now, number + 1, 1),
            Err(fault) => self.end_service(now, fault),
        }
    }

    fn check(&mut self, number: usize, entry: Entry, found: u32) -> Result<(), Fault> {
        let expect = |expected: u32| match found == expected {
            true => Ok(()),
            false => Err(Fault::ReadbackMismatch { entry, found, expected }),
        };
        match number {
            0 if found & 0xffff != u32::from(co::PROFILE) => return Err(Fault::NoInclinometer { found }),
            1 => self.identity.vendor = found,
            2 => self.identity.product = found,
            3 => self.identity.serial = found,
            4 if ![1, 10, 100, 1000].contains(&found) => return Err(Fault::Resolution { found }),
            4 => {
                self.identity.resolution = found;
                // Checked at this step because step 3 is skipped for a device without a serial number.
                if let Some(expected) = self.settings.serial.filter(|&serial| serial != self.identity.serial) {
                    return Err(Fault::WrongSerial { found: self.identity.serial, expected });
                }
                if self.settings.width == Width::Bits16 && max_slope(found) < self.range {
                    return Err(Fault::RangeTooWide { resolution: found, range: self.range });
                }
            }
            7 => self.remote_bit = found & co::NO_REMOTE,
            9..=11 => self.pdo_mapping[number - 9] = found,
            18 => return expect(u32::from(self.settings.period)),
            21 => return expect(u32::from(self.settings.heartbeat)),
            22 if found & 0xff == 0 => self.emergency = None,
            22 => return Err(Fault::Emergency { code: 0, register: (found & 0xff) as u8 }),
            _ => {}
        }
        Ok(())
    }
}
