//! A simulated CiA 410 inclinometer: object dictionary, NMT states, heartbeat, boot-up, emergency, one transmit PDO, and faults on demand.
//!
//! Does no I/O, reads no clock and uses no code of the product: both sides were written from the standards (CiA 301, CiA 410)
//! independently.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::{BTreeMap, VecDeque};

const NS_PER_MS: u64 = 1_000_000;
/// Time from power-on or a reset to the boot-up message \[ns\].
const BOOT_TIME_NS: u64 = 50 * NS_PER_MS;

const INITIALISING: u8 = 0;
const STOPPED: u8 = 4;
const OPERATIONAL: u8 = 5;
const PRE_OPERATIONAL: u8 = 127;

struct Object {
    bytes: Vec<u8>,
    writable: bool,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Faults {
    /// Unplugged: nothing is received or sent.
    pub unplugged: bool,
    pub no_heartbeat: bool,
    pub no_slopes: bool,
    /// Process data a byte short.
    pub short_pdo: bool,
    /// Heartbeats and process data twice: another node has the same id.
    pub duplicate_id: bool,
    pub fixed_mapping: bool,
}

pub type CanFrame = (u16, Vec<u8>);

pub struct Device {
    node: u8,
    state: u8,
    objects: BTreeMap<(u16, u8), Object>,
    /// True slopes without a ramp \[deg\].
    tilt: [f64; 2],
    ramp: Option<Ramp>,
    noise: f64,
    rng: ChaCha8Rng,
    pub faults: Faults,
    boot_at_ns: Option<u64>,
    next_beat: u64,
    next_slopes: u64,
    out: VecDeque<CanFrame>,
    pub answered: u64,
}

struct Ramp {
    from: [f64; 2],
    to: [f64; 2],
    start: u64,
    end: u64,
}

impl Device {
    /// A device that is powered on at `now` \[ns\].
    pub fn new(node: u8, tilt: [f64; 2], noise: f64, seed: u64, now: u64) -> Device {
        Device {
            node,
            state: INITIALISING,
            objects: factory(node),
            tilt,
            ramp: None,
            noise,
            rng: ChaCha8Rng::seed_from_u64(seed),
            faults: Faults::default(),
            boot_at_ns: Some(now + BOOT_TIME_NS),
            next_beat: 0,
            next_slopes: 0,
            out: VecDeque::new(),
            answered: 0,
        }
    }

    /// Sets the bytes of an object, as an earlier configuration of the device. A new object is read-only.
    pub fn set(&mut self, index: u16, sub: u8, bytes: &[u8]) {
        let writable = self.objects.get(&(index, sub)).is_some_and(|object| object.writable);
        self.objects.insert((index, sub), Object { bytes: bytes.to_vec(), writable });
    }

    pub fn remove(&mut self, index: u16, sub: u8) {
        self.objects.remove(&(index, sub));
    }

    pub fn get(&self, index: u16, sub: u8) -> Option<&[u8]> {
        self.objects.get(&(index, sub)).map(|object| &object.bytes[..])
    }

    pub fn is_operational(&self) -> bool {
        self.state == OPERATIONAL
    }

    /// Tilts the base so that the slopes are `to` \[deg\], over `seconds`.
    pub fn tilt(&mut self, now: u64, to: [f64; 2], seconds: f64) {
        let from = self.slopes(now);
        self.ramp = Some(Ramp { from, to, start: now, end: now + (seconds * 1e9) as u64 });
    }

    /// True slopes \[deg\].
    pub fn slopes(&self, now: u64) -> [f64; 2] {
        let Some(Ramp { from, to, start, end }) = &self.ramp else { return self.tilt };
        let share = if now >= *end { 1.0 } else { now.saturating_sub(*start) as f64 / (end - start) as f64 };
        [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]))
    }

    /// Sets the standard deviation of a slope's noise \[deg\].
    pub fn noise(&mut self, noise: f64) {
        self.noise = noise;
    }

    pub fn reset(&mut self, now: u64) {
        self.state = INITIALISING;
        self.objects = factory(self.node);
        self.boot_at_ns = Some(now + BOOT_TIME_NS);
        self.out.clear();
    }

    /// Sends an emergency; code 0 clears it.
    pub fn emergency(&mut self, code: u16) {
        let register = u8::from(code != 0);
        self.set(0x1001, 0, &[register]);
        let [low, high] = code.to_le_bytes();
        self.out.push_back((0x080 + u16::from(self.node), vec![low, high, register, 0, 0, 0, 0, 0]));
    }

    pub fn inject_frame(&mut self, id: u16, data: &[u8]) {
        self.out.push_back((id, data.to_vec()));
    }

    /// Processes a frame from the bus at `now` \[ns\].
    pub fn receive(&mut self, now: u64, id: u16, data: &[u8]) {
        if self.faults.unplugged || self.state == INITIALISING {
            return;
        }
        match (id, data) {
            (0, &[command, node]) if node == 0 || node == self.node => self.nmt(now, command),
            (id, &[command, low, high, sub, a, b, c, d])
                if id == 0x600 + u16::from(self.node) && self.state != STOPPED =>
            {
                let entry = (u16::from_le_bytes([low, high]), sub);
                let answer = self.sdo(command, entry, [a, b, c, d]);
                self.answered += 1;
                self.out.push_back((0x580 + u16::from(self.node), answer));
            }
            _ => {}
        }
    }

    fn nmt(&mut self, now: u64, command: u8) {
        match command {
            0x01 => (self.state, self.next_slopes) = (OPERATIONAL, now),
            0x02 => self.state = STOPPED,
            0x80 => self.state = PRE_OPERATIONAL,
            0x81 | 0x82 => self.reset(now),
            _ => {}
        }
    }

    fn sdo(&mut self, command: u8, entry: (u16, u8), bytes: [u8; 4]) -> Vec<u8> {
        let ((index, sub), fixed) = (entry, self.faults.fixed_mapping && entry.0 == 0x1a00);
        let [low, high] = index.to_le_bytes();
        let answer = |command: u8, rest: [u8; 4]| [&[command, low, high, sub][..], &rest].concat();
        let abort = |code: u32| answer(0x80, code.to_le_bytes());
        let any_sub = self.objects.range((index, 0)..=(index, 255)).next().is_some();
        let Some(object) = self.objects.get_mut(&entry) else {
            return abort(if any_sub { 0x0609_0011 } else { 0x0602_0000 });
        };
        match command {
            0x40 => {
                let mut padded = [0; 4];
                padded[..object.bytes.len()].copy_from_slice(&object.bytes);
                answer(0x43 | (4 - object.bytes.len() as u8) << 2, padded)
            }
            0x23 | 0x27 | 0x2b | 0x2f => {
                let length = 4 - usize::from(command >> 2 & 3);
                if !object.writable || fixed {
                    return abort(0x0601_0002);
                }
                if length != object.bytes.len() {
                    return abort(0x0607_0010);
                }
                // Remote requests are not supported: a write that clears bit 30 is aborted.
                if entry == (0x1800, 1) && object.bytes[3] & 0x40 != 0 && bytes[3] & 0x40 == 0 {
                    return abort(0x0609_0030);
                }
                object.bytes = bytes[..length].to_vec();
                answer(0x60, [0; 4])
            }
            _ => abort(0x0504_0001),
        }
    }

    /// Advances the timers to `now` \[ns\].
    pub fn tick(&mut self, now: u64) {
        if self.boot_at_ns.is_some_and(|at| now >= at) {
            self.boot_at_ns = None;
            self.state = PRE_OPERATIONAL;
            self.next_beat = now;
            self.out.push_back((0x700 + u16::from(self.node), vec![0]));
        }
        let heartbeat = self.number(0x1017, 0) as u64 * NS_PER_MS;
        if self.state != INITIALISING && heartbeat > 0 && now >= self.next_beat {
            self.next_beat = now.max(self.next_beat + heartbeat);
            if !self.faults.no_heartbeat {
                for _ in 0..self.senders() {
                    self.out.push_back((0x700 + u16::from(self.node), vec![self.state]));
                }
            }
        }
        let (timer, id) = (self.number(0x1800, 5) as u64 * NS_PER_MS, self.number(0x1800, 1));
        if self.state == OPERATIONAL && timer > 0 && id >> 31 == 0 && now >= self.next_slopes {
            self.next_slopes = (self.next_slopes + timer).max(now.saturating_sub(timer) + timer);
            self.send_slopes(now, (id & 0x7ff) as u16);
        }
        if self.faults.unplugged {
            self.out.clear();
        }
    }

    fn send_slopes(&mut self, now: u64, id: u16) {
        if self.faults.no_slopes {
            return;
        }
        let mut payload = Vec::new();
        for sub in 1..=self.number(0x1a00, 0) as u8 {
            let mapped = self.number(0x1a00, sub);
            let value = self.slope((mapped >> 16) as u16, now);
            payload.extend_from_slice(&value.to_le_bytes()[..(mapped & 0xff) as usize / 8]);
        }
        payload.truncate(8);
        if self.faults.short_pdo {
            payload.pop();
        }
        for _ in 0..self.senders() {
            self.out.push_back((id, payload.clone()));
        }
    }

    fn senders(&self) -> usize {
        1 + usize::from(self.faults.duplicate_id)
    }

    /// Value of a slope object, in units of the resolution.
    fn slope(&mut self, index: u16, now: u64) -> i32 {
        let axis = usize::from(index & 0xff == 0x20);
        let gaussian: f64 = self.rng.sample(rand_distr::StandardNormal);
        let degrees = self.slopes(now)[axis] + self.noise * gaussian;
        let value = (degrees * 1000.0 / f64::from(self.number(0x6000, 0))).round() as i32;
        let operating = self.number(index + 1, 0);
        let turned = if operating & 1 == 1 { -value } else { value };
        let offset = if operating & 2 == 2 { self.number(index + 3, 0) as i16 } else { 0 };
        turned + i32::from(offset)
    }

    fn number(&self, index: u16, sub: u8) -> u32 {
        let mut padded = [0; 4];
        if let Some(object) = self.objects.get(&(index, sub)) {
            padded[..object.bytes.len()].copy_from_slice(&object.bytes);
        }
        u32::from_le_bytes(padded)
    }

    pub fn transmit(&mut self) -> Option<CanFrame> {
        self.out.pop_front()
    }
}

/// The factory dictionary of the device: slopes of 16 and 32 bits, unit 0.01 deg, sent on SYNC.
fn factory(node: u8) -> BTreeMap<(u16, u8), Object> {
    let mut objects = BTreeMap::new();
    let mut put = |index: u16, sub: u8, writable: bool, bytes: &[u8]| {
        objects.insert((index, sub), Object { bytes: bytes.to_vec(), writable });
    };
    put(0x1000, 0, false, &0x0004_019a_u32.to_le_bytes());
    put(0x1001, 0, false, &[0]);
    put(0x1017, 0, true, &0_u16.to_le_bytes());
    put(0x1018, 0, false, &[4]);
    put(0x1018, 1, false, &0x5349_4d21_u32.to_le_bytes());
    put(0x1018, 2, false, &410_u32.to_le_bytes());
    put(0x1018, 3, false, &1_u32.to_le_bytes());
    put(0x1018, 4, false, &4711_u32.to_le_bytes());
    put(0x1800, 0, false, &[5]);
    put(0x1800, 1, true, &(0x4000_0180 + u32::from(node)).to_le_bytes());
    put(0x1800, 2, true, &[1]);
    put(0x1800, 3, true, &0_u16.to_le_bytes());
    put(0x1800, 5, true, &0_u16.to_le_bytes());
    put(0x1a00, 0, true, &[2]);
    put(0x1a00, 1, true, &0x6010_0010_u32.to_le_bytes());
    put(0x1a00, 2, true, &0x6020_0010_u32.to_le_bytes());
    put(0x6000, 0, true, &10_u16.to_le_bytes());
    for (slope, bytes) in [(0x6010, 2), (0x6020, 2), (0x6110, 4), (0x6120, 4)] {
        put(slope, 0, false, &[0; 4][..bytes]);
        put(slope + 1, 0, true, &[0]);
        put(slope + 3, 0, true, &[0; 4][..bytes]);
    }
    objects
}
