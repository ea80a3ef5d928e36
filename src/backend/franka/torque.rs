//! The impedance law of the torque interface, inside the torque limits and their rate.

// The walls of the real-time loop: clippy.toml.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use super::limits::RobotLimits;
use super::reference::TICK;
use super::settings::TorqueControl;

/// Law, limits, and the torque sent last.
#[derive(Clone, Copy, Debug)]
pub(super) struct TorqueLaw {
    control: TorqueControl,
    /// \[Nm\]
    most: [f64; 7],
    /// Per cycle \[Nm\].
    step: [f64; 7],
    last: [f64; 7],
}

/// A desired point and what was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tracking {
    pub q_d: [f64; 7],
    pub dq_d: [f64; 7],
    pub q: [f64; 7],
    pub dq: [f64; 7],
}

impl TorqueLaw {
    /// Begins at `last`, the torque that the arm shows as desired.
    pub fn new(control: TorqueControl, limits: &RobotLimits, share: f64, last: [f64; 7]) -> TorqueLaw {
        TorqueLaw {
            control,
            most: limits.tau.map(|tau| share * tau),
            step: limits.dtau.map(|dtau| share * dtau * TICK),
            last: last.map(|tau| if tau.is_finite() { tau } else { 0.0 }),
        }
    }

    /// Whether the desired point is too far from the measured one.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn out_of_reach(&self, tracking: &Tracking) -> bool {
        // Written so that a NaN is out of reach.
        !tracking.q_d.iter().zip(&tracking.q).all(|(desired, q)| (desired - q).abs() <= self.control.reach)
    }

    /// The torque, without gravity, and whether a limit had to be held. `feed_forward` counts only where the settings say so.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn torque(&mut self, tracking: &Tracking, feed_forward: &[f64; 7]) -> ([f64; 7], bool) {
        let mut held = false;
        for (j, last) in self.last.iter_mut().enumerate() {
            let ahead = if self.control.feed_forward { feed_forward[j] } else { 0.0 };
            let wanted = self.control.stiffness[j] * (tracking.q_d[j] - tracking.q[j])
                + self.control.damping[j] * (tracking.dq_d[j] - tracking.dq[j])
                + ahead;
            // Where a measurement is no number the last torque stays. Not `clamp`, which panics on such.
            let wanted = if wanted.is_finite() { wanted } else { *last };
            let allowed =
                wanted.max(-self.most[j]).min(self.most[j]).max(*last - self.step[j]).min(*last + self.step[j]);
            held |= allowed != wanted;
            *last = allowed;
        }
        (self.last, held)
    }
}

#[cfg(test)]
mod tests {
    use super::super::limits::panda;
    use super::*;

    fn law(feed_forward: bool) -> TorqueLaw {
        let control = TorqueControl { feed_forward, ..TorqueControl::default() };
        TorqueLaw::new(control, &panda(), 0.5, [0.0; 7])
    }

    #[test]
    fn a_small_error_is_answered_by_the_law_and_nothing_else() {
        let mut tracking = Tracking::default();
        (tracking.q_d[0], tracking.dq[1]) = (0.0005, 0.002);
        let (tau, held) = law(false).torque(&tracking, &[0.2; 7]);
        assert_eq!((tau[0], tau[1], tau[2], held), (600.0 * 0.0005, -50.0 * 0.002, 0.0, false));
        let (tau, _) = law(true).torque(&tracking, &[0.2; 7]);
        assert_eq!((tau[0], tau[2]), (600.0 * 0.0005 + 0.2, 0.2));
    }

    #[test]
    fn rate_and_size_of_the_torque_are_held() {
        let mut law = law(false);
        let tracking = Tracking { q_d: [0.09; 7], ..Tracking::default() };
        assert!(!law.out_of_reach(&tracking));
        let mut last = [0.0; 7];
        for _ in 0..200 {
            let (tau, held) = law.torque(&tracking, &[0.0; 7]);
            assert!(held || last == tau || tau.iter().zip(&last).all(|(a, b)| (a - b).abs() <= 0.5));
            assert!(tau.iter().zip(&last).all(|(a, b)| (a - b).abs() <= 0.5 + 1e-12));
            last = tau;
        }
        // Half of 87 and 12 Nm at most; what asks for less gets what it asks for.
        assert_eq!((last[0], last[4], last[6]), (43.5, 6.0, 4.5));
        let noise = Tracking { dq: [f64::NAN; 7], ..Tracking::default() };
        assert_eq!(law.torque(&noise, &[0.0; 7]).0, last);
        let far = Tracking { q_d: [0.11; 7], ..Tracking::default() };
        let nan = Tracking { q_d: [f64::NAN; 7], ..Tracking::default() };
        assert!(law.out_of_reach(&far) && law.out_of_reach(&nan));
    }
}
