//! Served gravity: rate limit, fall-back, refusal.

use super::*;
use plumbline::inclinometer::follow::{Refusal, Source};
use plumbline_model::{G, angle_between};

#[test]
fn served_gravity_follows_a_tilt_in_bounded_steps_and_rate() {
    let (mut follower, settings) = follower(OnSensorLoss::Hold);
    let mut harness = Harness::new(self::settings(), [1.0, 0.0]).brought_up();
    // The first decision takes the measured direction.
    let first = follower.decide(harness.now, &harness.sensor.health());
    assert_eq!((first.source, first.refusal), (Source::Measured, None));
    assert!(angle_between(&first.gravity, &harness.reading().attitude.gravity) < 1e-9);

    harness.device.tilt(harness.now, [4.0, 0.0], 0.5);
    let (mut served, mut last_step, mut steps) = (first.gravity, harness.now, 0);
    for _ in 0..5000 {
        harness.advance(1);
        let decision = follower.decide(harness.now, &harness.sensor.health());
        let by = angle_between(&decision.gravity, &served);
        if by > 1e-12 {
            assert!(
                by >= settings.step * 0.999 && by <= 2.0 * settings.step * 1.001,
                "a step of {} deg",
                by.to_degrees()
            );
            let seconds = (harness.now - last_step) as f64 * 1e-9;
            assert!(by <= settings.rate * seconds * 1.001 || steps == 0, "{} deg in {seconds} s", by.to_degrees());
            (served, last_step, steps) = (decision.gravity, harness.now, steps + 1);
            assert!((decision.gravity.norm() - G).abs() < 1e-9);
        }
    }
    let left = angle_between(&served, &harness.reading().attitude.gravity);
    assert!(steps >= 25 && left < settings.step, "{steps} steps, {} deg left", left.to_degrees());
    // No steps at rest.
    for _ in 0..20_000 {
        harness.advance(1);
        assert_eq!(follower.decide(harness.now, &harness.sensor.health()).gravity, served);
    }
}

#[test]
fn on_loss_selects_the_fallback() {
    for on_loss in [OnSensorLoss::Hold, OnSensorLoss::Declared, OnSensorLoss::Refuse] {
        let (mut follower, _) = follower(on_loss);
        // No reading so far.
        let never = follower.decide(0, &Health::Bad(Fault::Starting));
        assert_eq!((never.gravity, never.source), (Mounting::UPRIGHT.gravity(), Source::Declared));
        assert_eq!(never.refusal.is_some(), on_loss == OnSensorLoss::Refuse);
        follower.restart();

        let mut harness = Harness::new(settings(), [3.0, 0.0]).brought_up();
        let served = follower.decide(harness.now, &harness.sensor.health()).gravity;
        harness.device.faults.unplugged = true;
        harness.time_to_fault(200);
        let mut decision = follower.decide(harness.now, &harness.sensor.health());
        for _ in 0..5000 {
            harness.advance(1);
            decision = follower.decide(harness.now, &harness.sensor.health());
        }
        let off = angle_between(&decision.gravity, &served).to_degrees();
        match on_loss {
            OnSensorLoss::Hold => assert_eq!((off, decision.source, decision.refusal), (0.0, Source::Held, None)),
            OnSensorLoss::Declared => {
                assert!((2.85..=3.01).contains(&off), "{off}");
                assert_eq!((decision.source, decision.refusal), (Source::Declared, None));
            }
            OnSensorLoss::Refuse => assert!(matches!(decision.refusal, Some(Refusal::Lost(_))), "{decision:?}"),
        }
    }
}

#[test]
fn a_tilted_base_is_refused_with_the_angle() {
    let (mut follower, _) = follower(OnSensorLoss::Hold);
    let mut harness = Harness::new(settings(), [8.0, 0.0]).brought_up();
    let refusal = follower.decide(harness.now, &harness.sensor.health()).refusal.expect("a refusal");
    let text = refusal.to_string();
    for part in ["8.00", "upright", "5.00 deg", "inclinometer"] {
        assert!(text.contains(part), "no `{part}` in {text}");
    }
    // The refusal outlasts the sensor.
    harness.device.faults.unplugged = true;
    harness.time_to_fault(200);
    assert!(matches!(follower.decide(harness.now, &harness.sensor.health()).refusal, Some(Refusal::Tilted { .. })));
    // Within tolerance and uncertainty there is no refusal.
    let (mut follower, _) = self::follower(OnSensorLoss::Hold);
    let harness = Harness::new(settings(), [4.9, 0.0]).brought_up();
    assert_eq!(follower.decide(harness.now, &harness.sensor.health()).refusal, None);
}
