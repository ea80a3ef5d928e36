//! Bring-up: configuration, identity, refusal of other devices.

use super::*;
use plumbline::inclinometer::canopen::Entry;
use plumbline_model::G;

#[test]
fn a_factory_device_is_configured_and_read() {
    let mut harness = Harness::new(settings(), [0.0, 0.0]).brought_up();
    assert!(harness.reading().attitude.mounting().angle_to(&Mounting::UPRIGHT) < 1e-9);
    assert!(harness.reading().still);
    let device = &harness.device;
    assert_eq!(device.get(0x1017, 0), Some(&100_u16.to_le_bytes()[..]));
    // The NO_REMOTE bit is kept.
    assert_eq!(device.get(0x1800, 1), Some(&0x4000_018a_u32.to_le_bytes()[..]));
    assert_eq!(device.get(0x1800, 2), Some(&[254][..]));
    assert_eq!(device.get(0x1800, 5), Some(&20_u16.to_le_bytes()[..]));
    let SensorEvent::Up(identity) = harness.events[0] else { panic!("{:?}", harness.events) };
    assert_eq!((identity.vendor, identity.product, identity.serial, identity.resolution), (0x5349_4d21, 410, 4711, 10));
    assert_eq!(harness.events[1], SensorEvent::Recovered);
    // No further requests to an operational device.
    let answered = harness.device.answered;
    harness.advance(5000);
    assert_eq!((harness.device.answered, harness.events.len()), (answered, 2));
}

#[test]
fn remote_requests_stay_enabled() {
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.set(0x1800, 1, &0x18a_u32.to_le_bytes());
    let harness = Harness::with(settings(), device).brought_up();
    assert_eq!(harness.device.get(0x1800, 1), Some(&0x18a_u32.to_le_bytes()[..]));
}

#[test]
fn stored_presets_do_not_falsify_gravity() {
    let mut device = Device::new(NODE, [3.0, -2.0], 0.0, 1, 0);
    // Inverted, with an offset of 5 deg, another unit and another mapping.
    for (index, bytes) in [(0x6011, &[3][..]), (0x6021, &[3]), (0x6013, &500_i16.to_le_bytes()), (0x6000, &[1, 0])] {
        device.set(index, 0, bytes);
    }
    device.set(0x1a00, 1, &0x6020_0010_u32.to_le_bytes());
    device.set(0x1a00, 2, &0x6010_0010_u32.to_le_bytes());
    let mut narrow = settings();
    narrow.installation.range = 30f64.to_radians();
    let harness = Harness::with(narrow, device).brought_up();
    let up = -harness.reading().attitude.gravity / G;
    assert!((up.x - 3f64.to_radians().sin()).abs() < 1e-9 && (up.y + 2f64.to_radians().sin()).abs() < 1e-9, "{up}");
}

#[test]
fn slopes_of_32_bits_are_mapped_and_a_fixed_mapping_is_accepted() {
    let mut wide = settings();
    wide.node.width = Width::Bits32;
    let mut device = Device::new(NODE, [1.0, 79.0], 0.0, 1, 0);
    device.set(0x6000, 0, &1_u16.to_le_bytes());
    let harness = Harness::with(wide, device).brought_up();
    let up = -harness.reading().attitude.gravity / G;
    assert!((up.y - 79f64.to_radians().sin()).abs() < 1e-9);

    // The right mapping, read-only: no write is needed.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.faults.fixed_mapping = true;
    Harness::with(settings(), device).brought_up();
    // The wrong mapping, read-only: the fault names the object.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    device.faults.fixed_mapping = true;
    let mut harness = Harness::with(wide, device);
    harness.advance(400);
    assert_eq!(harness.fault(), Fault::Refused { entry: Entry(0x1a00, 0), code: 0x0601_0002 });
    // Operating parameters and serial number are optional.
    let mut device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    for (index, sub) in [(0x6011, 0), (0x6021, 0), (0x1018, 4)] {
        device.remove(index, sub);
    }
    Harness::with(settings(), device).brought_up();
}

#[test]
fn a_range_beyond_16_bits_is_refused() {
    let harness = |range: f64, width: Width, unit: u16| {
        let mut settings = settings();
        (settings.node.width, settings.installation.range) = (width, range.to_radians());
        let mut device = Device::new(NODE, [1.0, 2.0], 0.0, 1, 0);
        device.set(0x6000, 0, &unit.to_le_bytes());
        let mut harness = Harness::with(settings, device);
        harness.advance(3000);
        harness
    };
    let fault = harness(80.0, Width::Bits16, 1).fault();
    assert_eq!(fault, Fault::RangeTooWide { resolution: 1, range: 80f64.to_radians() });
    let text = fault.to_string();
    for part in ["end at 32.767 deg", "range is 80.0 deg", "`bits = 32`", "`range` of at most 32.7 deg"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    assert!(matches!(harness(32.8, Width::Bits16, 1).fault(), Fault::RangeTooWide { .. }));
    // The remedies of the text.
    harness(32.7, Width::Bits16, 1).reading();
    harness(80.0, Width::Bits32, 1).reading();
    harness(90.0, Width::Bits16, 10).reading();
}

#[test]
fn another_device_with_the_node_id_is_refused() {
    let harness = |change: &dyn Fn(&mut SensorSettings, &mut Device)| {
        let (mut settings, mut device) = (settings(), Device::new(NODE, [0.0, 0.0], 0.0, 1, 0));
        change(&mut settings, &mut device);
        // The device is in operation with another master.
        let mut harness = Harness::after_nmt(settings, device, START);
        harness.advance(1500);
        (harness.fault(), harness.device.is_operational())
    };
    // A refused device keeps its NMT state.
    let encoder = 0x0001_0196;
    let found = harness(&|_, device| device.set(0x1000, 0, &u32::to_le_bytes(encoder)));
    assert_eq!(found, (Fault::NoInclinometer { found: encoder }, true));
    let found = harness(&|settings, _| settings.node.serial = Some(99));
    assert_eq!(found, (Fault::WrongSerial { found: 4711, expected: 99 }, true));
    let found = harness(&|_, device| device.set(0x6000, 0, &7_u16.to_le_bytes()));
    assert_eq!(found, (Fault::Resolution { found: 7 }, true));
    // The error register is set.
    let found = harness(&|_, device| device.set(0x1001, 0, &[0x20]));
    assert_eq!(found, (Fault::Emergency { code: 0, register: 0x20 }, false));
    let (fault, _) = harness(&|_, device| device.faults.unplugged = true);
    assert_eq!(fault, Fault::Unanswered { node: NODE, entry: Entry(0x1000, 0) });
}

#[test]
fn a_stopped_device_is_brought_up() {
    let device = Device::new(NODE, [0.0, 0.0], 0.0, 1, 0);
    Harness::after_nmt(settings(), device, STOP).brought_up();
}
