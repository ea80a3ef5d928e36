use super::*;
use crate::limits::{fr3, panda};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const Q: [f64; 7] = [0.1, -0.4, 0.2, -2.0, 0.3, 1.8, 0.5];

/// A lively motion, as quick as a Panda's excitation.
fn motion(tick: u64) -> [f64; 7] {
    let t = tick as f64 * TICK;
    let fade = if t < 1.0 { (t * std::f64::consts::FRAC_PI_2).sin().powi(4) } else { 1.0 };
    std::array::from_fn(|j| Q[j] + fade * 0.25 * ((2.0 + 0.3 * j as f64) * t).sin() + fade * 0.04 * (9.0 * t).cos())
}

/// The limits as the arm checks them, whatever made the step.
fn assert_inside(limits: &RobotLimits, from: &Point, step: &Point, when: &str) {
    for j in 0..7 {
        let (low, high) = limits.velocities(j, step.q[j]).unwrap();
        assert!(step.dq[j] >= low && step.dq[j] <= high, "{when}: joint {j} velocity {} in {low}..{high}", step.dq[j]);
        assert!(step.ddq[j].abs() <= limits.ddq[j], "{when}: joint {j} acceleration {}", step.ddq[j]);
        let jerk = (step.ddq[j] - from.ddq[j]) / TICK;
        assert!(jerk.abs() <= limits.jerk[j], "{when}: joint {j} jerk {jerk}");
    }
}

fn step(limiter: &mut Limiter, from: &Point, desired: &[f64; 7], ticks: u64, own: bool) -> Limited {
    let limited = limiter.step(from, desired, ticks, own);
    limiter.sent(limited.aim);
    limited
}

#[test]
fn a_motion_inside_the_limits_goes_through_bit_by_bit() {
    let mut limiter = Limiter::new(panda(), 0.98, Q);
    let mut arm = Point::at_rest(Q);
    for tick in 0..4000 {
        let desired = motion(tick);
        assert_eq!(limiter.objection(&arm, &desired), None);
        let step = step(&mut limiter, &arm, &desired, 1, true);
        assert_eq!((step.point.q, step.held, step.returning), (desired, false, false), "{tick}");
        arm = step.point;
    }
}

#[test]
fn after_the_arm_went_on_alone_it_is_led_back_inside_the_limits() {
    for limits in [panda(), fr3()] {
        for (lost, begins) in [(1, 1400), (3, 1517), (8, 1650), (19, 1800), (19, 2111)] {
            let mut limiter = Limiter::new(limits, 0.98, Q);
            let mut arm = Point::at_rest(Q);
            let mut ticks = 1;
            let mut returned = 0;
            let mut naive = 0.0f64;
            for tick in 0..4000 {
                if (begins..begins + lost).contains(&tick) {
                    arm = arm.after(1);
                    ticks += 1;
                    continue;
                }
                let desired = motion(tick);
                assert_eq!(limiter.objection(&arm, &desired), None);
                if ticks > 1 {
                    naive = ((arm.step_to(&desired).ddq[1] - arm.ddq[1]) / TICK).abs();
                }
                let step = step(&mut limiter, &arm, &desired, ticks, ticks == 1);
                assert_inside(&limits, &arm, &step.point, &format!("{lost} lost, tick {tick}"));
                returned += u64::from(step.returning);
                arm = step.point;
                ticks = 1;
            }
            assert!(returned > 0 && returned < 800, "{lost} lost: {returned} cycles on the way back");
            let end = motion(3999);
            assert!((0..7).all(|j| (arm.q[j] - end[j]).abs() < 1e-9));
            // Without the limiter the arm would have seen a discontinuity.
            assert!(lost < 19 || naive > limits.jerk[1], "{lost} lost: naive jerk {naive}");
        }
    }
}

#[test]
fn a_motion_beyond_the_limits_is_held_to_them_and_refused_when_it_runs_away() {
    let limits = panda();
    let mut limiter = Limiter::new(limits, 0.98, Q);
    let mut arm = Point::at_rest(Q);
    let mut held = 0;
    let refused = (0..2000).find(|&tick| {
        // Joint 2 is told to go at 8.5 rad/s2 for good; 7.5 is its limit.
        let t = tick as f64 * TICK;
        let mut desired = Q;
        desired[1] += 0.5 * 8.5 * t * t;
        if limiter.objection(&arm, &desired).is_some() {
            return true;
        }
        let step = step(&mut limiter, &arm, &desired, 1, true);
        assert_inside(&limits, &arm, &step.point, "too quick");
        held += u64::from(step.held);
        arm = step.point;
        false
    });
    assert!(held > 50 && refused.is_some_and(|tick| tick < 400), "{held} {refused:?}");
}

#[test]
fn what_can_never_be_commanded_is_refused_by_name() {
    let limiter = Limiter::new(fr3(), 0.98, Q);
    let arm = Point::at_rest(Q);
    let with = |j: usize, q: f64| {
        let mut desired = Q;
        desired[j] = q;
        limiter.objection(&arm, &desired)
    };
    assert_eq!(with(0, Q[0] + 0.019), None);
    assert_eq!(with(0, Q[0] + 0.05), Some(Objection::Jump));
    assert_eq!(with(3, f64::NAN), Some(Objection::NotFinite));
    assert_eq!(with(3, f64::INFINITY), Some(Objection::NotFinite));
    assert_eq!(with(3, 0.0), Some(Objection::Position));
    // An arm that is nowhere gets no command, and nothing here panics.
    let nowhere = Point { dq: [f64::NAN; 7], ..arm };
    assert_eq!(limiter.objection(&nowhere, &Q), Some(Objection::NotFinite));
    limiter.brake(&nowhere);
    limiter.step(&nowhere, &Q, 3, false);
    // Standing outside its range, a joint may go back but not farther out.
    let mut out = arm;
    out.q[3] = -0.10;
    let mut desired = out.q;
    desired[3] = -0.105;
    assert_eq!(limiter.objection(&out, &desired), None);
    desired[3] = -0.09;
    assert_eq!(limiter.objection(&out, &desired), Some(Objection::Position));
}

#[test]
fn braking_ends_at_rest_inside_the_limits_from_any_motion() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    for limits in [panda(), fr3()] {
        for case in 0..500 {
            let mut arm = Point::at_rest(Q);
            for (j, q) in Q.into_iter().enumerate() {
                arm.dq[j] = rng.random_range(-0.9..0.9) * limits.velocities(j, q).unwrap().1;
                arm.ddq[j] = rng.random_range(-0.5..0.5) * limits.ddq[j];
            }
            let limiter = Limiter::new(limits, 0.98, Q);
            let mut ticks = 0;
            let start = arm;
            while !arm.rests() {
                let next = limiter.brake(&arm);
                for j in 0..7 {
                    assert!(next.ddq[j].abs() <= limits.ddq[j], "case {case}");
                    let jerk = (next.ddq[j] - arm.ddq[j]) / TICK;
                    assert!(jerk.abs() <= limits.jerk[j], "case {case} tick {ticks} joint {j}: jerk {jerk}");
                }
                arm = next;
                ticks += 1;
                assert!(
                    ticks < 700,
                    "case {case}: still moving, {:?} {:?} from {:?} {:?}",
                    arm.dq,
                    arm.ddq,
                    start.dq,
                    start.ddq
                );
            }
            // No farther than a little more than v^2 / (2 a) and the time to build the braking up.
            for j in 0..7 {
                let (v, a) = (start.dq[j].abs() + 0.05, 0.8 * limits.ddq[j]);
                let bound = v * v / (2.0 * a) + 0.02 * v + 0.01;
                assert!((arm.q[j] - start.q[j]).abs() < bound, "case {case} joint {j}");
            }
        }
    }
}
