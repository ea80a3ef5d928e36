//! Random frames. More cases: `PROPTEST_CASES=1000000 cargo test --release --test inclinometer random_frames_cause_no_panic`.

use super::*;
use plumbline::inclinometer::canopen::{self, Entry};
use plumbline::inclinometer::frame::BusState;
use plumbline_model::G;
use proptest::prelude::*;

/// Bus events: mostly frames with the device's identifiers and nearly valid content.
fn frames() -> impl Strategy<Value = BusEvent> {
    let id = prop_oneof![
        4 => prop::sample::select(vec![0x08a_u16, 0x18a, 0x58a, 0x70a, 0x000, 0x60a]),
        1 => 0_u16..0x800,
    ];
    let bytes = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..=8),
        prop::collection::vec(prop::sample::select(vec![0_u8, 1, 4, 5, 0x7f, 0x80, 0xff]), 0..=8),
        (prop::sample::select(vec![0x43_u8, 0x4b, 0x4f, 0x60, 0x80, 0x42, 0x41]), entry(), any::<u32>()).prop_map(
            |(command, Entry(index, sub), value)| {
                [&[command][..], &index.to_le_bytes(), &[sub], &value.to_le_bytes()].concat()
            }
        ),
    ];
    prop_oneof![
        20 => (id, bytes).prop_map(|(id, bytes)| BusEvent::Frame(Frame::new(id, &bytes).unwrap())),
        1 => Just(BusEvent::Idle),
        1 => prop::sample::select(vec![BusState::Active, BusState::Passive, BusState::Off, BusState::Down, BusState::Blocked])
            .prop_map(BusEvent::Bus),
    ]
}

fn entry() -> impl Strategy<Value = Entry> {
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

    /// Random events at random times cause neither a panic nor a non-finite reading.
    #[test]
    fn random_frames_cause_no_panic(
        event in prop::collection::vec((frames(), prop_oneof![0_u64..50, any::<u64>()], any::<bool>()), 1..40),
        start in prop_oneof![Just(0_u64), any::<u64>()],
        wide in any::<bool>(),
        up in any::<bool>(),
    ) {
        let mut own = settings();
        own.node.width = if wide { Width::Bits32 } else { Width::Bits16 };
        let mut harness = Harness::new(own, [0.5, -0.5]);
        if up {
            harness.advance(1700);
        } else {
            harness.now = start;
        }
        let mut follower = follower(OnSensorLoss::Hold).0;
        for (event, passed, device) in event {
            harness.now = harness.now.wrapping_add(if passed < 50 { passed * NS_PER_MS } else { passed });
            harness.sensor.handle(harness.now, &event);
            if device && harness.now < u64::MAX / 4 {
                harness.advance(3);
            }
            harness.sensor.tick(harness.now);
            while harness.sensor.transmit().is_some() {}
            if let Health::Good(reading) = harness.sensor.health() {
                let Mounting { rho, phi } = reading.attitude.mounting();
                prop_assert!(rho.is_finite() && phi.is_finite() && reading.attitude.std().is_finite());
                prop_assert!((reading.attitude.gravity.norm() - G).abs() < 1e-6);
            }
            let decision = follower.decide(harness.now, &harness.sensor.health());
            prop_assert!((decision.gravity.norm() - G).abs() < 1e-6);
        }
    }
}
