//! The inclinometer adapter against a simulated device, frame by frame and without a bus between them.
//!
//! More cases for the fuzzers: `PROPTEST_CASES=1000000 cargo test --release --test inclinometer no_frames_make_it_panic`.

use nalgebra::{Rotation3, Vector3};
use plumbline::inclinometer::attitude::{Seat, SeatError, Slopes};
use plumbline::inclinometer::canopen::{self, Entry, NmtState, Width};
use plumbline::inclinometer::follow::{FollowSettings, Follower, OnLoss, Refusal, Source};
use plumbline::inclinometer::frame::{BusState, Frame, Heard};
use plumbline::inclinometer::node::{Fault, NodeSettings};
use plumbline::inclinometer::sensor::{Health, Note, Reading, Sensor, SensorSettings};
use plumbline::inclinometer::smooth::SmoothSettings;
use plumbline_model::{G, Mounting, angle_between};
use plumbline_testkit::inclinometer::Device;
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const MS: u64 = 1_000_000;
const NODE: u8 = 10;
/// NMT commands.
const START: u8 = 1;
const STOP: u8 = 2;

fn seat() -> Seat {
    Seat::new([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]).unwrap()
}

fn settings() -> SensorSettings {
    SensorSettings {
        node: NodeSettings { node: NODE, heartbeat: 100, period: 20, width: Width::Bits16, serial: None },
        seat: seat(),
        smooth: SmoothSettings::default(),
        declared: Mounting::UPRIGHT,
    }
}

/// Device and adapter, a millisecond at a time.
struct World {
    now: u64,
    device: Device,
    sensor: Sensor,
    notes: Vec<Note>,
}

impl World {
    fn new(settings: SensorSettings, tilt: [f64; 2]) -> World {
        World::with(settings, Device::new(NODE, tilt, 0.0, 1, 0))
    }

    fn with(settings: SensorSettings, device: Device) -> World {
        World { now: 0, device, sensor: Sensor::new(settings).unwrap(), notes: Vec::new() }
    }

    /// A device that has booted and heard an NMT command before anybody asks it.
    fn after(settings: SensorSettings, device: Device, command: u8) -> World {
        let mut world = World::with(settings, device);
        world.now = 60 * MS;
        world.device.tick(world.now);
        while world.device.send().is_some() {}
        world.device.hear(world.now, 0, &[command, NODE]);
        world
    }

    fn pass(&mut self, ms: u64) {
        for _ in 0..ms {
            self.now += MS;
            self.device.tick(self.now);
            while let Some((id, data)) = self.device.send() {
                self.sensor.hear(self.now, &Heard::Frame(Frame::new(id, &data).unwrap()));
            }
            self.sensor.hear(self.now, &Heard::Nothing);
            self.sensor.tick(self.now);
            while let Some(frame) = self.sensor.transmit() {
                self.device.hear(self.now, frame.id(), frame.data());
            }
            while let Some(note) = self.sensor.note() {
                self.notes.push(note);
            }
        }
    }

    /// The thread that listens does not run for so long. Then it finds all that was sent meanwhile, and takes it in as it does: 64 frames
    /// at a time.
    fn stall(&mut self, ms: u64) {
        let mut waiting = Vec::new();
        for _ in 0..ms {
            self.now += MS;
            self.device.tick(self.now);
            waiting.extend(std::iter::from_fn(|| self.device.send()));
        }
        for taken in waiting.chunks(64) {
            for (id, data) in taken {
                self.sensor.hear(self.now, &Heard::Frame(Frame::new(*id, data).unwrap()));
            }
            self.sensor.tick(self.now);
        }
    }

    fn good(&self) -> Reading {
        match self.sensor.health() {
            Health::Good(reading) => reading,
            Health::Bad(fault) => panic!("{fault}; {:?}", self.notes),
        }
    }

    fn bad(&self) -> Fault {
        match self.sensor.health() {
            Health::Good(reading) => panic!("{reading:?}"),
            Health::Bad(fault) => fault,
        }
    }

    /// Milliseconds until there is a fault, at most `ms`.
    fn until_bad(&mut self, ms: u64) -> u64 {
        (1..=ms)
            .find(|_| {
                self.pass(1);
                matches!(self.sensor.health(), Health::Bad(_))
            })
            .unwrap_or_else(|| panic!("still good after {ms} ms"))
    }

    fn up(mut self) -> World {
        self.pass(3000);
        self.good();
        self
    }
}

#[test]
fn a_device_from_the_factory_is_set_up_and_read() {
    let mut world = World::new(settings(), [0.0, 0.0]).up();
    assert!(world.good().attitude.mounting().angle_to(&Mounting::UPRIGHT) < 1e-9);
    assert!(world.good().still);
    let device = &world.device;
    assert_eq!(device.get(0x1017, 0), Some(&100_u16.to_le_bytes()[..]));
    // Without remote requests, as the device came.
    assert_eq!(device.get(0x1800, 1), Some(&0x4000_018a_u32.to_le_bytes()[..]));
    assert_eq!(device.get(0x1800, 2), Some(&[254][..]));
    assert_eq!(device.get(0x1800, 5), Some(&20_u16.to_le_bytes()[..]));
    let Note::Up(identity) = world.notes[0] else { panic!("{:?}", world.notes) };
    assert_eq!((identity.vendor, identity.product, identity.serial, identity.resolution), (0x5349_4d21, 410, 4711, 10));
    assert_eq!(world.notes[1], Note::Well);
    // Nothing more is asked of a device that is up.
    let answered = world.device.answered;
    world.pass(5000);
    assert_eq!((world.device.answered, world.notes.len()), (answered, 2));
}

#[test]
fn a_device_that_answers_remote_requests_goes_on_doing_so() {
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.set(0x1800, 1, &0x18a_u32.to_le_bytes());
    let world = World::with(settings(), device).up();
    assert_eq!(world.device.get(0x1800, 1), Some(&0x18a_u32.to_le_bytes()[..]));
}

#[test]
fn what_somebody_left_in_the_device_does_not_turn_gravity() {
    let mut device = Device::new(NODE, [3.0, -2.0], 0.0, 1, 0);
    // Inverted, with 5 deg added, in another unit, on another mapping.
    for (index, bytes) in [(0x6011, &[3][..]), (0x6021, &[3]), (0x6013, &500_i16.to_le_bytes()), (0x6000, &[1, 0])] {
        device.set(index, 0, bytes);
    }
    device.set(0x1a00, 1, &0x6020_0010_u32.to_le_bytes());
    device.set(0x1a00, 2, &0x6010_0010_u32.to_le_bytes());
    let mut narrow = settings();
    narrow.seat.range = 30f64.to_radians();
    let world = World::with(narrow, device).up();
    let up = -world.good().attitude.gravity / G;
    assert!((up.x - 3f64.to_radians().sin()).abs() < 1e-9 && (up.y + 2f64.to_radians().sin()).abs() < 1e-9, "{up}");
}

#[test]
fn slopes_of_32_bits_are_mapped_and_a_fixed_mapping_is_taken_as_it_is() {
    let mut wide = settings();
    wide.node.width = Width::Bits32;
    let mut device = Device::new(NODE, [1.0, 79.0], 0.0, 1, 0);
    device.set(0x6000, 0, &1_u16.to_le_bytes());
    let world = World::with(wide, device).up();
    let up = -world.good().attitude.gravity / G;
    assert!((up.y - 79f64.to_radians().sin()).abs() < 1e-9);

    // The right mapping, read-only: nothing has to be written.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.faults.fixed_mapping = true;
    World::with(settings(), device).up();
    // The wrong one: it is said which object is refused.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.faults.fixed_mapping = true;
    let mut world = World::with(wide, device);
    world.pass(400);
    assert_eq!(world.bad(), Fault::Refused { entry: Entry(0x1a00, 0), code: 0x0601_0002 });
    // A device without operating parameters or serial number does without.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    for (index, sub) in [(0x6011, 0), (0x6021, 0), (0x1018, 4)] {
        device.lacks(index, sub);
    }
    World::with(settings(), device).up();
}

#[test]
fn slopes_of_16_bits_that_end_before_the_range_does_are_not_believed() {
    let world = |range: f64, width: Width, unit: u16| {
        let mut settings = settings();
        (settings.node.width, settings.seat.range) = (width, range.to_radians());
        let mut device = Device::new(NODE, [1.0, 2.0], 0.0, 1, 0);
        device.set(0x6000, 0, &unit.to_le_bytes());
        let mut world = World::with(settings, device);
        world.pass(3000);
        world
    };
    let fault = world(80.0, Width::Bits16, 1).bad();
    assert_eq!(fault, Fault::Narrow { resolution: 1, range: 80f64.to_radians() });
    let said = fault.to_string();
    for part in ["end at 32.767 deg", "range is 80.0 deg", "`bits = 32`", "`range` of at most 32.7 deg"] {
        assert!(said.contains(part), "no `{part}` in {said}");
    }
    assert!(matches!(world(32.8, Width::Bits16, 1).bad(), Fault::Narrow { .. }));
    // What the words ask for.
    world(32.7, Width::Bits16, 1).good();
    world(80.0, Width::Bits32, 1).good();
    world(90.0, Width::Bits16, 10).good();
}

#[test]
fn a_stranger_on_the_bus_is_not_taken_for_the_inclinometer() {
    let world = |change: &dyn Fn(&mut SensorSettings, &mut Device)| {
        let (mut settings, mut device) = (settings(), Device::new(NODE, [0.0, 0.0], 0.0, 1, 0));
        change(&mut settings, &mut device);
        // Somebody else uses it.
        let mut world = World::after(settings, device, START);
        world.pass(1500);
        (world.bad(), world.device.is_operational())
    };
    // What is no inclinometer, or not this one, goes on with what it did.
    let encoder = 0x0001_0196;
    let found = world(&|_, device| device.set(0x1000, 0, &u32::to_le_bytes(encoder)));
    assert_eq!(found, (Fault::NoInclinometer { found: encoder }, true));
    let found = world(&|settings, _| settings.node.serial = Some(99));
    assert_eq!(found, (Fault::Foreign { found: 4711, expected: 99 }, true));
    let found = world(&|_, device| device.set(0x6000, 0, &7_u16.to_le_bytes()));
    assert_eq!(found, (Fault::Resolution { found: 7 }, true));
    // One axis is not enough.
    let found = world(&|_, device| device.set(0x1001, 0, &[0x20]));
    assert_eq!(found, (Fault::Emergency { code: 0, register: 0x20 }, false));
    let (fault, _) = world(&|_, device| device.faults.unplugged = true);
    assert_eq!(fault, Fault::Unanswered { node: NODE, entry: Entry(0x1000, 0) });
}

#[test]
fn a_device_that_somebody_has_stopped_is_brought_up() {
    let device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    World::after(settings(), device, STOP).up();
}

/// The direction by the test's own mathematics: where up lies in a sensor that sits in the base as `axes` says.
fn shown(axes: &Rotation3<f64>, gravity: &Vector3<f64>, slopes: Slopes) -> [f64; 2] {
    let up = axes.inverse() * (-gravity.normalize());
    match slopes {
        Slopes::Horizon => [up.x, up.y].map(|share| share.asin().to_degrees()),
        Slopes::Projected => [(up.x / up.z).atan(), (up.y / up.z).atan()].map(f64::to_degrees),
    }
}

#[test]
fn any_seat_gives_the_true_direction() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut seen = 0;
    while seen < 60 {
        let mut draw = |range: f64| rng.random_range(-range..range);
        let axes = Rotation3::from_euler_angles(draw(3.1), draw(1.5), draw(3.1));
        let declared = Mounting { rho: draw(1.57) + 1.57, phi: draw(3.1) };
        let tilted = Rotation3::from_euler_angles(draw(0.2), draw(0.2), draw(0.2)) * declared.gravity();
        let slopes = if seen % 2 == 0 { Slopes::Horizon } else { Slopes::Projected };
        let zero = [draw(0.02), draw(0.02)];
        let column = |k: usize| -> [f64; 3] { axes.matrix().column(k).into_owned().into() };
        let mut own = Seat::new(column(0), column(2)).unwrap();
        (own.slopes, own.zero) = (slopes, zero);
        let Ok(_) = own.hemisphere(&declared) else { continue };
        let raw = shown(&axes, &tilted, slopes);
        let tilt = [0, 1].map(|axis| raw[axis] + zero[axis].to_degrees());
        let up = axes.inverse() * -tilted;
        let same_side = up.z * (axes.inverse() * -declared.gravity()).z > 0.0;
        if tilt.iter().any(|slope| slope.abs() > 75.0) || up.z.abs() < 3.0 || !same_side {
            continue;
        }
        seen += 1;
        let mut device = Device::new(NODE, tilt, 0.0, 1, 0);
        device.set(0x6000, 0, &1_u16.to_le_bytes());
        let mut world = World::with(SensorSettings { seat: own, declared, ..settings() }, device);
        world.node_is_wide();
        world.pass(3000);
        let reading = world.good();
        let off = angle_between(&reading.attitude.gravity, &tilted);
        // A unit of 0.001 deg, which a slope close to the vertical spreads.
        assert!(off < 1.5e-4, "{off} rad at {tilt:?}, z {}", up.z);
        assert!((reading.attitude.gravity.norm() - G).abs() < 1e-9);
        let back = reading.attitude.mounting().gravity();
        assert!(angle_between(&back, &reading.attitude.gravity) < 1e-9);
    }
}

impl World {
    /// 16 bits of 0.001 deg end at 32.8 deg.
    fn node_is_wide(&mut self) {
        let mut settings = *self.sensor.settings();
        settings.node.width = Width::Bits32;
        self.sensor = Sensor::new(settings).unwrap();
    }
}

#[test]
fn the_stated_uncertainty_is_that_of_many_draws() {
    let mut settings = settings();
    settings.seat.accuracy = 0.0;
    // A noisy device: its noise is no motion of the base.
    settings.smooth = SmoothSettings { time_constant: 0.2, still: 2f64.to_radians(), ..settings.smooth };
    let true_up = |tilt: [f64; 2]| {
        let [x, y] = tilt.map(|slope| slope.to_radians().sin());
        Vector3::new(x, y, (1.0 - x * x - y * y).sqrt())
    };
    for tilt in [[0.0, 0.0], [30.0, -45.0]] {
        let mut device = Device::new(NODE, tilt, 0.2, 7, 0);
        device.set(0x6000, 0, &1_u16.to_le_bytes());
        let mut wide = settings;
        wide.node.width = Width::Bits32;
        let mut world = World::with(wide, device).up();
        let (mut square, mut stated, mut count) = (0.0, 0.0, 0);
        for _ in 0..400 {
            // Further apart than the low-pass remembers.
            world.pass(1000);
            let reading = world.good();
            let off = -reading.attitude.gravity / G - true_up(tilt);
            square += off.norm_squared();
            stated += reading.attitude.covariance.trace();
            count += 1;
        }
        let ratio = square / stated;
        assert!((0.75..1.33).contains(&ratio), "{tilt:?}: variance of the draws over the stated one {ratio} ({count})");
    }
}

#[test]
fn angles_and_their_uncertainty_follow_from_the_direction() {
    let mut settings = settings();
    settings.seat.accuracy = 0.1f64.to_radians();
    let world = World::new(settings, [20.0, 0.0]).up();
    let attitude = world.good().attitude;
    let Mounting { rho, phi } = attitude.mounting();
    // Tilted 20 deg about -y: gravity leans towards -x.
    assert!((rho - 160f64.to_radians()).abs() < 1e-4 && (phi.abs() - std::f64::consts::PI).abs() < 1e-4, "{rho} {phi}");
    let [std_rho, std_phi] = attitude.std_of_angles();
    assert!((std_rho.to_degrees() - 0.1).abs() < 1e-3, "{std_rho}");
    assert!((std_phi.to_degrees() - 0.1 / 20f64.to_radians().sin()).abs() < 2e-3, "{std_phi}");
    // Along axis 1 phi means nothing, and says so.
    let upright = World::new(settings, [0.0, 0.0]).up().good().attitude;
    assert_eq!(upright.std_of_angles()[1], std::f64::consts::PI);
    assert_eq!(Mounting::along(&Mounting::CEILING.gravity()), Mounting::CEILING);
}

#[test]
fn what_the_sensor_cannot_see_is_refused() {
    // Flat on the base of an arm on a wall, its z axis lies horizontally.
    assert!(matches!(seat().hemisphere(&Mounting::WALL), Err(SeatError::Blind { .. })));
    // On a bracket it sees: z axis of the sensor along -x of the base, which points up on the wall.
    let bracket = Seat::new([0.0, 0.0, 1.0], [-1.0, 0.0, 0.0]).unwrap();
    assert_eq!(bracket.hemisphere(&Mounting::WALL), Ok(1.0));
    // Standing and hanging show the same slopes; the declaration tells them apart.
    let level = |slopes: [f64; 2]| slopes.iter().all(|slope| slope.abs() < 1e-12);
    assert!(level(seat().expected(&Mounting::UPRIGHT)) && level(seat().expected(&Mounting::CEILING)));
    assert_eq!(seat().hemisphere(&Mounting::UPRIGHT), Ok(1.0));
    assert_eq!(seat().hemisphere(&Mounting::CEILING), Ok(-1.0));
    let hanging = World::new(SensorSettings { declared: Mounting::CEILING, ..settings() }, [0.0, 0.0]).up();
    assert!(hanging.good().attitude.mounting().angle_to(&Mounting::CEILING) < 1e-9);
    for (x, z) in [([1.0, 0.0, 0.0], [1.0, 0.0, 0.0]), ([2.0, 0.0, 0.0], [0.0, 0.0, 1.0]), ([0.0; 3], [0.0; 3])] {
        assert!(matches!(Seat::new(x, z), Err(SeatError::Axes { .. })));
    }
    assert!(matches!(Seat::new([f64::NAN, 0.0, 0.0], [0.0, 0.0, 1.0]), Err(SeatError::Axes { .. })));
}

#[test]
fn every_loss_is_noticed_in_time_and_named_and_gone_when_it_is_gone() {
    type Case = (&'static str, u64, fn(&mut World), fn(&mut World), fn(&Fault) -> bool);
    // A period is 20 ms, a heartbeat 100 ms; silence counts after three of them and 20 ms.
    let cases: [Case; 11] = [
        (
            "unplugged",
            102,
            |w| w.device.faults.unplugged = true,
            |w| w.device.faults.unplugged = false,
            |f| matches!(f, Fault::NoSlopes { .. }),
        ),
        (
            "slopes",
            102,
            |w| w.device.faults.no_slopes = true,
            |w| w.device.faults.no_slopes = false,
            |f| matches!(f, Fault::NoSlopes { .. }),
        ),
        (
            "heartbeat",
            422,
            |w| w.device.faults.no_heartbeat = true,
            |w| w.device.faults.no_heartbeat = false,
            |f| matches!(f, Fault::NoHeartbeat { .. }),
        ),
        (
            "short",
            102,
            |w| w.device.faults.short = true,
            |w| w.device.faults.short = false,
            |f| matches!(f, Fault::NoSlopes { .. }),
        ),
        (
            "twin",
            // Counted over ten heartbeats; a count that it came into late may still be one sender's.
            1602,
            |w| w.device.faults.twin = true,
            |w| w.device.faults.twin = false,
            |f| matches!(f, Fault::TwoSenders { .. }),
        ),
        (
            "emergency",
            2,
            |w| w.device.emergency(0x5000),
            |w| w.device.emergency(0),
            |f| matches!(f, Fault::Emergency { code: 0x5000, register: 1 }),
        ),
        // Slopes go on: the frame alone tells.
        ("boot-up", 2, |w| w.device.say(0x700 + u16::from(NODE), &[0]), |_| {}, |f| *f == Fault::Restarted),
        (
            "pre-operational",
            2,
            |w| w.device.say(0x700 + u16::from(NODE), &[127]),
            |_| {},
            |f| *f == Fault::State { state: NmtState::PreOperational },
        ),
        (
            "says that it is stopped",
            2,
            |w| w.device.say(0x700 + u16::from(NODE), &[4]),
            |_| {},
            |f| *f == Fault::State { state: NmtState::Stopped },
        ),
        // Its boot-up message comes before its slopes are missed.
        ("reset", 52, |w| w.device.reset(w.now), |_| {}, |f| *f == Fault::Restarted),
        // Its next heartbeat and its missing slopes come at about the same time: what counts here is the way back.
        (
            "stopped by another master",
            102,
            |w| w.device.hear(w.now, 0, &[STOP, NODE]),
            |_| {},
            |f| matches!(f, Fault::State { state: NmtState::Stopped } | Fault::NoSlopes { .. }),
        ),
    ];
    for (name, within, begin, end, right) in cases {
        let mut world = World::new(settings(), [1.0, 2.0]).up();
        let before = world.good().attitude.gravity;
        begin(&mut world);
        let took = world.until_bad(within + 1);
        let fault = world.bad();
        assert!(right(&fault), "{name}: {fault} after {took} ms");
        end(&mut world);
        world.pass(6000);
        assert!(angle_between(&world.good().attitude.gravity, &before) < 1e-9, "{name}");
        assert_eq!(world.notes.last(), Some(&Note::Well), "{name}: {:?}", world.notes);
    }
}

#[test]
fn a_stall_of_any_length_makes_no_second_sender() {
    for (heartbeat, stalls) in
        [(100, [800, 0]), (20, [800, 0]), (20, [250, 150]), (20, [5000, 100]), (200, [3000, 3000])]
    {
        // Wherever it comes between two counts.
        for phase in (0..1000).step_by(90) {
            let mut own = settings();
            own.node.heartbeat = heartbeat;
            let mut world = World::new(own, [1.0, 2.0]).up();
            world.pass(phase);
            for stall in stalls {
                world.stall(stall);
            }
            world.pass(2000);
            world.good();
            // Up and well, and nothing since.
            assert_eq!(world.notes.len(), 2, "{heartbeat} ms, {stalls:?}, {phase}: {:?}", world.notes);
        }
    }
}

#[test]
fn slopes_that_also_come_on_events_are_those_of_one_sender() {
    let mut world = World::new(settings(), [1.0, 2.0]).up();
    for _ in 0..5000 {
        let slopes = [100_i16.to_le_bytes(), 200_i16.to_le_bytes()].concat();
        world.device.say(0x180 + u16::from(NODE), &slopes);
        world.pass(1);
        world.good();
    }
}

#[test]
fn a_second_sender_is_not_believed_again_before_it_is_gone() {
    let mut world = World::new(settings(), [1.0, 2.0]).up();
    world.device.faults.twin = true;
    world.until_bad(1603);
    for _ in 0..20_000 {
        world.pass(1);
        assert!(matches!(world.bad(), Fault::TwoSenders { .. }), "{}", world.bad());
    }
    // Silent then, it is brought up again like any other.
    world.device.faults.unplugged = true;
    world.pass(5000);
    world.device.faults = Default::default();
    world.pass(5000);
    world.good();
}

#[test]
fn a_bus_that_is_not_well_is_the_cause_that_is_named() {
    for state in [BusState::Passive, BusState::Off, BusState::Down, BusState::Blocked] {
        let mut world = World::new(settings(), [0.0, 0.0]).up();
        world.sensor.hear(world.now, &Heard::Bus(state));
        assert_eq!(world.bad(), Fault::Bus(state));
        world.device.faults.unplugged = true;
        world.pass(5000);
        assert_eq!(world.bad(), Fault::Bus(state), "a symptom took the cause's place");
        world.device.faults.unplugged = false;
        world.sensor.hear(world.now, &Heard::Bus(BusState::Active));
        world.pass(4000);
        world.good();
    }
}

#[test]
fn an_emergency_whose_end_was_not_heard_ends() {
    let mut world = World::new(settings(), [0.0, 0.0]).up();
    world.device.emergency(0x8110);
    world.pass(3000);
    assert_eq!(world.bad(), Fault::Emergency { code: 0x8110, register: 1 });
    // The error register is well again; nobody says so.
    world.device.set(0x1001, 0, &[0]);
    world.pass(6000);
    world.good();
}

#[test]
fn angles_that_jump_or_leave_the_range_are_not_believed() {
    let mut world = World::new(settings(), [0.0, 0.0]).up();
    world.device.tilt(world.now, [7.0, 0.0], 0.0);
    let took = world.until_bad(25);
    let Fault::Jump { by } = world.bad() else { panic!("{}", world.bad()) };
    assert!((by.to_degrees() - 7.0).abs() < 0.02 && took <= 21, "{by} {took}");
    // Where it stays, it is believed after three time constants: then the declaration decides.
    world.pass(1400);
    world.bad();
    world.pass(300);
    let up = -world.good().attitude.gravity / G;
    assert!((up.x - 7f64.to_radians().sin()).abs() < 1e-9);

    // A fast but possible tilt: followed, and never called rest.
    world.device.tilt(world.now, [27.0, 0.0], 1.0);
    world.pass(500);
    let reading = world.good();
    assert!(!reading.still);
    let truth = Vector3::new(17f64.to_radians().sin(), 0.0, 17f64.to_radians().cos());
    let off = angle_between(&-reading.attitude.gravity, &truth);
    // The low-pass lags by at most its time constant times the speed, and its uncertainty says so.
    assert!(off.to_degrees() < 10.0 && off < 3.0 * reading.attitude.std() + 0.01, "{off} {}", reading.attitude.std());
    assert!(angle_between(&-reading.raw.gravity, &truth) < 0.01);

    world.device.tilt(world.now, [27.0, 85.0], 30.0);
    world.pass(30_000);
    assert!(matches!(world.bad(), Fault::OutOfRange { .. }), "{}", world.bad());
    // Both axes on end at once: no direction has these slopes.
    let mut world = World::new(settings(), [44.0, 44.0]).up();
    world.device.tilt(world.now, [60.0, 60.0], 2.0);
    world.pass(2100);
    assert!(matches!(world.bad(), Fault::OutOfRange { .. }), "{}", world.bad());
}

fn follower(on_loss: OnLoss) -> (Follower, FollowSettings) {
    let settings = FollowSettings {
        declared: Mounting::UPRIGHT,
        tolerance: 5f64.to_radians(),
        step: 0.1f64.to_radians(),
        rate: 1f64.to_radians(),
        on_loss,
    };
    (Follower::new(settings), settings)
}

#[test]
fn the_model_follows_a_tilt_in_small_steps_and_no_faster_than_allowed() {
    let (mut follower, settings) = follower(OnLoss::Hold);
    let mut world = World::new(self::settings(), [1.0, 0.0]).up();
    // Before anything is served, the measured direction is taken at once.
    let first = follower.decide(world.now, &world.sensor.health());
    assert_eq!((first.source, first.refusal), (Source::Measured, None));
    assert!(angle_between(&first.gravity, &world.good().attitude.gravity) < 1e-9);

    world.device.tilt(world.now, [4.0, 0.0], 0.5);
    let (mut served, mut last_step, mut steps) = (first.gravity, world.now, 0);
    for _ in 0..5000 {
        world.pass(1);
        let decision = follower.decide(world.now, &world.sensor.health());
        let by = angle_between(&decision.gravity, &served);
        if by > 1e-12 {
            assert!(
                by >= settings.step * 0.999 && by <= 2.0 * settings.step * 1.001,
                "a step of {} deg",
                by.to_degrees()
            );
            let seconds = (world.now - last_step) as f64 * 1e-9;
            assert!(by <= settings.rate * seconds * 1.001 || steps == 0, "{} deg in {seconds} s", by.to_degrees());
            (served, last_step, steps) = (decision.gravity, world.now, steps + 1);
            assert!((decision.gravity.norm() - G).abs() < 1e-9);
        }
    }
    let left = angle_between(&served, &world.good().attitude.gravity);
    assert!(steps >= 25 && left < settings.step, "{steps} steps, {} deg left", left.to_degrees());
    // At rest nothing is handed over, however long.
    for _ in 0..20_000 {
        world.pass(1);
        assert_eq!(follower.decide(world.now, &world.sensor.health()).gravity, served);
    }
}

#[test]
fn a_lost_sensor_is_replaced_as_configured() {
    for on_loss in [OnLoss::Hold, OnLoss::Declared, OnLoss::Refuse] {
        let (mut follower, _) = follower(on_loss);
        // Nothing was ever measured.
        let never = follower.decide(0, &Health::Bad(Fault::Starting));
        assert_eq!((never.gravity, never.source), (Mounting::UPRIGHT.gravity(), Source::Declared));
        assert_eq!(never.refusal.is_some(), on_loss == OnLoss::Refuse);
        follower.restart();

        let mut world = World::new(settings(), [3.0, 0.0]).up();
        let served = follower.decide(world.now, &world.sensor.health()).gravity;
        world.device.faults.unplugged = true;
        world.until_bad(200);
        let mut decision = follower.decide(world.now, &world.sensor.health());
        for _ in 0..5000 {
            world.pass(1);
            decision = follower.decide(world.now, &world.sensor.health());
        }
        let off = angle_between(&decision.gravity, &served).to_degrees();
        match on_loss {
            OnLoss::Hold => assert_eq!((off, decision.source, decision.refusal), (0.0, Source::Held, None)),
            OnLoss::Declared => {
                assert!((2.85..=3.01).contains(&off), "{off}");
                assert_eq!((decision.source, decision.refusal), (Source::Declared, None));
            }
            OnLoss::Refuse => assert!(matches!(decision.refusal, Some(Refusal::Lost(_))), "{decision:?}"),
        }
    }
}

#[test]
fn a_base_that_is_not_as_declared_refuses_and_says_by_how_much() {
    let (mut follower, _) = follower(OnLoss::Hold);
    let mut world = World::new(settings(), [8.0, 0.0]).up();
    let refusal = follower.decide(world.now, &world.sensor.health()).refusal.expect("a refusal");
    let said = refusal.to_string();
    for part in ["8.00", "upright", "5.00 deg", "inclinometer"] {
        assert!(said.contains(part), "no `{part}` in {said}");
    }
    // Losing the sensor then is no way out.
    world.device.faults.unplugged = true;
    world.until_bad(200);
    assert!(matches!(follower.decide(world.now, &world.sensor.health()).refusal, Some(Refusal::Tilted { .. })));
    // Within tolerance and uncertainty it is served.
    let (mut follower, _) = self::follower(OnLoss::Hold);
    let world = World::new(settings(), [4.9, 0.0]).up();
    assert_eq!(follower.decide(world.now, &world.sensor.health()).refusal, None);
}

/// A frame of the device's identifiers more often than not, and one that is nearly right more often than not.
fn frames() -> impl Strategy<Value = Heard> {
    let id = prop_oneof![
        4 => prop::sample::select(vec![0x08a_u16, 0x18a, 0x58a, 0x70a, 0x000, 0x60a]),
        1 => 0_u16..0x800,
    ];
    let bytes = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..=8),
        prop::collection::vec(prop::sample::select(vec![0_u8, 1, 4, 5, 0x7f, 0x80, 0xff]), 0..=8),
        (prop::sample::select(vec![0x43_u8, 0x4b, 0x4f, 0x60, 0x80, 0x42, 0x41]), step(), any::<u32>()).prop_map(
            |(command, Entry(index, sub), value)| {
                [&[command][..], &index.to_le_bytes(), &[sub], &value.to_le_bytes()].concat()
            }
        ),
    ];
    prop_oneof![
        20 => (id, bytes).prop_map(|(id, bytes)| Heard::Frame(Frame::new(id, &bytes).unwrap())),
        1 => Just(Heard::Nothing),
        1 => prop::sample::select(vec![BusState::Active, BusState::Passive, BusState::Off, BusState::Down, BusState::Blocked])
            .prop_map(Heard::Bus),
    ]
}

fn step() -> impl Strategy<Value = Entry> {
    prop::sample::select(vec![
        canopen::DEVICE_TYPE,
        canopen::VENDOR,
        canopen::RESOLUTION,
        canopen::MAP_COUNT,
        canopen::MAP_FIRST,
        canopen::TPDO_TIMER,
        canopen::HEARTBEAT_TIME,
    ])
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever comes, at whatever time: no panic, and no reading that the sensor could not have made.
    #[test]
    fn no_frames_make_it_panic(
        heard in prop::collection::vec((frames(), prop_oneof![0_u64..50, any::<u64>()], any::<bool>()), 1..40),
        start in prop_oneof![Just(0_u64), any::<u64>()],
        wide in any::<bool>(),
        up in any::<bool>(),
    ) {
        let mut own = settings();
        own.node.width = if wide { Width::Bits32 } else { Width::Bits16 };
        let mut world = World::new(own, [0.5, -0.5]);
        if up {
            world.pass(1700);
        } else {
            world.now = start;
        }
        let mut follower = follower(OnLoss::Hold).0;
        for (heard, passed, device) in heard {
            world.now = world.now.wrapping_add(if passed < 50 { passed * MS } else { passed });
            world.sensor.hear(world.now, &heard);
            if device && world.now < u64::MAX / 4 {
                world.pass(3);
            }
            world.sensor.tick(world.now);
            while world.sensor.transmit().is_some() {}
            if let Health::Good(reading) = world.sensor.health() {
                let Mounting { rho, phi } = reading.attitude.mounting();
                prop_assert!(rho.is_finite() && phi.is_finite() && reading.attitude.std().is_finite());
                prop_assert!((reading.attitude.gravity.norm() - G).abs() < 1e-6);
            }
            let decision = follower.decide(world.now, &world.sensor.health());
            prop_assert!((decision.gravity.norm() - G).abs() < 1e-6);
        }
    }
}
