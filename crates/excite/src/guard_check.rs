//! Check of a motion by the real-time guard, sample by sample. It includes the guard's rules on stops, which [`super::limits`] does not
//! contain.

use super::fourier::Fourier;
use super::limits::{Bounds, Peak, Quantity, VERIFY_RATE_HZ};
use plumbline_core::{Command, JointVec, MAX_JOINTS, PERIOD_S, Setpoint, State};
use plumbline_rt::{Guard, GuardSettings, Limit, ModelTorques, MoveFactors, Violation};

/// The first rule of the guard that one period of a motion from rest violates.
pub fn check_with_guard(bounds: &Bounds, fourier: &Fourier) -> Option<Peak> {
    let ticks = (fourier.period * VERIFY_RATE_HZ).round() as u64;
    check_points_with_guard(bounds, (0..=ticks).map(|tick| setpoint(fourier, tick)))
}

/// The first rule of the guard that a sequence of setpoints at the loop's period violates. The arm rests at the first one. Box, sphere and
/// torques are checked by [`super::limits::check`].
pub fn check_points_with_guard(bounds: &Bounds, points: impl IntoIterator<Item = Setpoint>) -> Option<Peak> {
    let settings = GuardSettings {
        limits: *bounds.limits,
        envelope: bounds.envelope.copied(),
        workspace: None,
        tracking: [f64::INFINITY; MAX_JOINTS],
    };
    let mut guard = Guard::new(bounds.chain.len(), settings, MoveFactors::default().brake, None);
    let mut last: Option<JointVec> = None;
    for (tick, desired) in points.into_iter().enumerate() {
        let q = *last.get_or_insert_with(|| {
            guard.start(desired.q);
            desired.q
        });
        let state = State { q, ..State::default() };
        if let Err(violation) =
            guard.check(PERIOD_S, &Command { desired, ..Command::default() }, &ModelTorques::default(), &state)
        {
            return Some(peak(&violation, tick as f64 * PERIOD_S));
        }
        last = Some(desired.q);
    }
    None
}

fn setpoint(fourier: &Fourier, tick: u64) -> Setpoint {
    let mut setpoint = Setpoint::default();
    for j in 0..fourier.joints() {
        let point = fourier.at(j, tick as f64 * PERIOD_S);
        (setpoint.q[j], setpoint.dq[j], setpoint.ddq[j]) = (point.q, point.dq, point.ddq);
    }
    setpoint
}

fn peak(violation: &Violation, time: f64) -> Peak {
    let Violation { limit, joint, value, bound } = *violation;
    let upper = value >= bound;
    let (quantity, value) = match limit {
        Limit::Position if upper => (Quantity::PositionMax, value),
        Limit::Position => (Quantity::PositionMin, value),
        Limit::StoppingPosition if upper => (Quantity::StopMax, value),
        Limit::StoppingPosition => (Quantity::StopMin, value),
        Limit::VelocityAhead => (Quantity::VelocityAhead, value.abs()),
        Limit::Acceleration => (Quantity::Acceleration, value.abs()),
        Limit::Jerk => (Quantity::Jerk, value.abs()),
        Limit::Velocity => (Quantity::Velocity, value.abs()),
        // NaN, or derivatives that are not those of the positions: an invalid motion.
        _ => (Quantity::Velocity, f64::NAN),
    };
    Peak { quantity, joint: Some(joint + 1), time, value, limit: bound }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::{Margins, verify};
    use plumbline_core::Limits;
    use plumbline_model::{Chain, Joint, JointKind, Placement};

    fn pendulum() -> Chain {
        let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
        Chain::modified(vec![joint], Placement::identity())
    }

    fn limits() -> Limits {
        let all = |x: f64| [x; MAX_JOINTS];
        Limits {
            q_min: all(-1.0),
            q_max: all(1.0),
            dq: all(2.0),
            ddq: all(5.0),
            jerk: all(100.0),
            tau: all(20.0),
            dtau: all(100.0),
        }
    }

    /// Motion at rest at both ends of the period, with amplitude and start position \[rad\].
    fn motion(amplitude: f64, q0: f64) -> Fourier {
        let mut fourier = Fourier::still(2.0, vec![q0], 4).unwrap();
        fourier.b.row_mut(0).copy_from_slice(&[amplitude, -amplitude, 0.3 * amplitude, 0.1 * amplitude]);
        fourier.project();
        fourier
    }

    /// A motion that stops at the end of the range with the full acceleration limit. The loop's controlled stop brakes with less and would
    /// exceed the range. The limits alone do not detect this.
    #[test]
    fn a_stop_beyond_the_range_is_detected_where_every_limit_is_satisfied() {
        let (chain, limits) = (pendulum(), limits());
        let bounds = Bounds::new(&chain, &limits, Margins::none());
        let mut fourier = motion(1.0, 0.0);
        // As large as the acceleration limit allows, with its highest point at the upper end.
        let highest = |f: &Fourier| (0..2000).map(|k| f.at(0, f64::from(k) * 1e-3).q).fold(f64::NEG_INFINITY, f64::max);
        let most = (0..2000).map(|k| fourier.at(0, f64::from(k) * 1e-3).ddq.abs()).fold(0.0, f64::max);
        fourier.scale_joint(0, 0.9999 * limits.ddq[0] / most);
        let down = fourier.clone();
        fourier.scale_joint(0, if highest(&down) > -down.at(0, 1.0).q { 1.0 } else { -1.0 });
        fourier.q0[0] = 1.0 - (highest(&fourier) - fourier.q0[0]) - 1e-9;
        let check = verify(&bounds, &fourier, None);
        assert!(check.is_feasible(), "{}", check.violations().next().unwrap());
        let found = check_with_guard(&bounds, &fourier).expect("a stop beyond the range");
        assert_eq!((found.quantity, found.joint), (Quantity::StopMax, Some(1)), "{found}");
        assert!(found.is_violation() && found.to_string().contains("position after a stop"), "{found}");
        // Further inside the range it passes.
        fourier.q0[0] -= 0.2;
        assert_eq!(check_with_guard(&bounds, &fourier), None);
    }

    #[test]
    fn a_motion_that_does_not_start_at_rest_is_a_violation() {
        let (chain, limits) = (pendulum(), limits());
        let bounds = Bounds::new(&chain, &limits, Margins::none());
        let mut fourier = Fourier::still(2.0, vec![0.0], 1).unwrap();
        fourier.a[(0, 0)] = 0.1;
        assert!(check_with_guard(&bounds, &fourier).expect("a jump").is_violation());
        fourier.a[(0, 0)] = f64::NAN;
        assert!(check_with_guard(&bounds, &fourier).expect("NaN").is_violation());
    }
}
