//! Faults: detection, named cause, recovery.

use super::*;
use nalgebra::Vector3;
use plumbline::inclinometer::canopen::NmtState;
use plumbline::inclinometer::frame::BusState;
use plumbline_model::{G, angle_between};

#[test]
fn every_fault_is_detected_in_time_and_recovered_from() {
    type Case = (&'static str, u64, fn(&mut Harness), fn(&mut Harness), fn(&Fault) -> bool);
    // Period 20 ms, heartbeat 100 ms; the timeouts are three periods and 20 ms.
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
            |w| w.device.faults.short_pdo = true,
            |w| w.device.faults.short_pdo = false,
            |f| matches!(f, Fault::NoSlopes { .. }),
        ),
        (
            "duplicate_id",
            // Up to two counts of ten heartbeats and a margin.
            1602,
            |w| w.device.faults.duplicate_id = true,
            |w| w.device.faults.duplicate_id = false,
            |f| matches!(f, Fault::DuplicateNodeId { .. }),
        ),
        (
            "emergency",
            2,
            |w| w.device.emergency(0x5000),
            |w| w.device.emergency(0),
            |f| matches!(f, Fault::Emergency { code: 0x5000, register: 1 }),
        ),
        // A single frame, while slopes continue.
        ("boot-up", 2, |w| w.device.inject_frame(0x700 + u16::from(NODE), &[0]), |_| {}, |f| *f == Fault::Restarted),
        (
            "pre-operational",
            2,
            |w| w.device.inject_frame(0x700 + u16::from(NODE), &[127]),
            |_| {},
            |f| *f == Fault::State { state: NmtState::PreOperational },
        ),
        (
            "stopped",
            2,
            |w| w.device.inject_frame(0x700 + u16::from(NODE), &[4]),
            |_| {},
            |f| *f == Fault::State { state: NmtState::Stopped },
        ),
        // The boot-up message comes before the timeout of the slopes.
        ("reset", 52, |w| w.device.reset(w.now), |_| {}, |f| *f == Fault::Restarted),
        // Heartbeat and timeout of the slopes come at about the same time.
        (
            "stopped by another master",
            102,
            |w| w.device.receive(w.now, 0, &[STOP, NODE]),
            |_| {},
            |f| matches!(f, Fault::State { state: NmtState::Stopped } | Fault::NoSlopes { .. }),
        ),
    ];
    for (name, within, begin, end, right) in cases {
        let mut harness = Harness::new(settings(), [1.0, 2.0]).brought_up();
        let before = harness.reading().attitude.gravity;
        begin(&mut harness);
        let took = harness.time_to_fault(within + 1);
        let fault = harness.fault();
        assert!(right(&fault), "{name}: {fault} after {took} ms");
        end(&mut harness);
        harness.advance(6000);
        assert!(angle_between(&harness.reading().attitude.gravity, &before) < 1e-9, "{name}");
        assert_eq!(harness.events.last(), Some(&SensorEvent::Recovered), "{name}: {:?}", harness.events);
    }
}

#[test]
fn a_stall_is_not_detected_as_a_second_sender() {
    for (heartbeat, stalls) in
        [(100, [800, 0]), (20, [800, 0]), (20, [250, 150]), (20, [5000, 100]), (200, [3000, 3000])]
    {
        // At any phase of the heartbeat count.
        for phase in (0..1000).step_by(90) {
            let mut own = settings();
            own.node.heartbeat = heartbeat;
            let mut harness = Harness::new(own, [1.0, 2.0]).brought_up();
            harness.advance(phase);
            for stall in stalls {
                harness.stall(stall);
            }
            harness.advance(2000);
            harness.reading();
            // Events of the bring-up only.
            assert_eq!(harness.events.len(), 2, "{heartbeat} ms, {stalls:?}, {phase}: {:?}", harness.events);
        }
    }
}

#[test]
fn additional_slopes_on_events_are_not_a_second_sender() {
    let mut harness = Harness::new(settings(), [1.0, 2.0]).brought_up();
    for _ in 0..5000 {
        let slopes = [100_i16.to_le_bytes(), 200_i16.to_le_bytes()].concat();
        harness.device.inject_frame(0x180 + u16::from(NODE), &slopes);
        harness.advance(1);
        harness.reading();
    }
}

#[test]
fn a_second_sender_stays_a_fault_until_it_is_gone() {
    let mut harness = Harness::new(settings(), [1.0, 2.0]).brought_up();
    harness.device.faults.duplicate_id = true;
    harness.time_to_fault(1603);
    for _ in 0..20_000 {
        harness.advance(1);
        assert!(matches!(harness.fault(), Fault::DuplicateNodeId { .. }), "{}", harness.fault());
    }
    // After a silence the device is brought up again.
    harness.device.faults.unplugged = true;
    harness.advance(5000);
    harness.device.faults = Default::default();
    harness.advance(5000);
    harness.reading();
}

#[test]
fn a_bus_error_is_reported_as_the_cause() {
    for state in [BusState::Passive, BusState::Off, BusState::Down, BusState::Blocked] {
        let mut harness = Harness::new(settings(), [0.0, 0.0]).brought_up();
        harness.sensor.handle(harness.now, &BusEvent::Bus(state));
        assert_eq!(harness.fault(), Fault::Bus(state));
        harness.device.faults.unplugged = true;
        harness.advance(5000);
        assert_eq!(harness.fault(), Fault::Bus(state), "a symptom replaced the cause");
        harness.device.faults.unplugged = false;
        harness.sensor.handle(harness.now, &BusEvent::Bus(BusState::Active));
        harness.advance(4000);
        harness.reading();
    }
}

#[test]
fn an_emergency_ends_with_a_clear_error_register() {
    let mut harness = Harness::new(settings(), [0.0, 0.0]).brought_up();
    harness.device.emergency(0x8110);
    harness.advance(3000);
    assert_eq!(harness.fault(), Fault::Emergency { code: 0x8110, register: 1 });
    // The error register is cleared without a message.
    harness.device.set(0x1001, 0, &[0]);
    harness.advance(6000);
    harness.reading();
}

#[test]
fn jumps_and_slopes_out_of_range_are_faults() {
    let mut harness = Harness::new(settings(), [0.0, 0.0]).brought_up();
    harness.device.tilt(harness.now, [7.0, 0.0], 0.0);
    let took = harness.time_to_fault(25);
    let Fault::Jump { by } = harness.fault() else { panic!("{}", harness.fault()) };
    assert!((by.to_degrees() - 7.0).abs() < 0.02 && took <= 21, "{by} {took}");
    // A constant slope is accepted after three time constants.
    harness.advance(1400);
    harness.fault();
    harness.advance(300);
    let up = -harness.reading().attitude.gravity / G;
    assert!((up.x - 7f64.to_radians().sin()).abs() < 1e-9);

    // A fast tilt is followed and not reported as rest.
    harness.device.tilt(harness.now, [27.0, 0.0], 1.0);
    harness.advance(500);
    let reading = harness.reading();
    assert!(!reading.still);
    let truth = Vector3::new(17f64.to_radians().sin(), 0.0, 17f64.to_radians().cos());
    let off = angle_between(&-reading.attitude.gravity, &truth);
    // The lag is at most time constant times speed, and within the standard deviation.
    assert!(off.to_degrees() < 10.0 && off < 3.0 * reading.attitude.std() + 0.01, "{off} {}", reading.attitude.std());
    assert!(angle_between(&-reading.raw.gravity, &truth) < 0.01);

    harness.device.tilt(harness.now, [27.0, 85.0], 30.0);
    harness.advance(30_000);
    assert!(matches!(harness.fault(), Fault::OutOfRange { .. }), "{}", harness.fault());
    // No direction has these two slopes.
    let mut harness = Harness::new(settings(), [44.0, 44.0]).brought_up();
    harness.device.tilt(harness.now, [60.0, 60.0], 2.0);
    harness.advance(2100);
    assert!(matches!(harness.fault(), Fault::OutOfRange { .. }), "{}", harness.fault());
}
