//! The impedance law of the torque interface, inside the torque limits and their rate.

use super::reference::TICK;
use crate::limits::RobotLimits;
use crate::settings::TorqueControl;
use crate::wire::RobotState;

/// Law, limits, and the torque sent last.
///
/// The arm differences a torque with the one that it holds: it repeats the last that reached it. Its state shows that one as `tau_J_d`
/// (desired, without gravity, as commands are), so each torque stays within a cycle's rate of it, as in libfranka. A state may be a command
/// behind, though: the torque stays within the rate of the one sent last, too. The two lie apart by one cycle's rate at most, because every
/// torque is bound by both, so there is a torque that suits both; where both contradict each other the arm's counts.
#[derive(Clone, Copy, Debug)]
pub(super) struct TorqueLaw {
    control: TorqueControl,
    /// \[Nm\]
    most: [f64; 7],
    /// Per cycle \[Nm\].
    step: [f64; 7],
    sent: [f64; 7],
}

/// A desired point and what was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tracking {
    pub q_d: [f64; 7],
    pub dq_d: [f64; 7],
    pub q: [f64; 7],
    pub dq: [f64; 7],
    /// The torque that the arm holds, `tau_J_d` of the state \[Nm\].
    pub tau: [f64; 7],
}

impl Tracking {
    /// The desired point against what `state` shows.
    pub fn of(q_d: [f64; 7], dq_d: [f64; 7], state: &RobotState) -> Tracking {
        Tracking { q_d, dq_d, q: state.q, dq: state.dq, tau: state.tau_j_d }
    }
}

impl TorqueLaw {
    /// Begins at `shown`, the torque that the arm shows as desired.
    pub fn new(control: TorqueControl, limits: &RobotLimits, share: f64, shown: [f64; 7]) -> TorqueLaw {
        TorqueLaw {
            control,
            most: limits.tau.map(|tau| share * tau),
            step: limits.dtau.map(|dtau| share * dtau * TICK),
            sent: shown.map(|tau| if tau.is_finite() { tau } else { 0.0 }),
        }
    }

    /// Whether the desired point is too far from the measured one.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn out_of_reach(&self, tracking: &Tracking) -> bool {
        // Written so that a NaN is out of reach.
        !tracking.q_d.iter().zip(&tracking.q).all(|(desired, q)| (desired - q).abs() <= self.control.reach)
    }

    /// The torque, without gravity, and whether a limit had to be held. `feed_forward` counts only where the settings say so. It becomes the
    /// last one only when it is [`sent`](TorqueLaw::sent).
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn torque(&self, tracking: &Tracking, feed_forward: &[f64; 7]) -> ([f64; 7], bool) {
        let mut held = false;
        let mut tau = self.sent;
        for (j, tau) in tau.iter_mut().enumerate() {
            let ahead = if self.control.feed_forward { feed_forward[j] } else { 0.0 };
            let wanted = self.control.stiffness[j] * (tracking.q_d[j] - tracking.q[j])
                + self.control.damping[j] * (tracking.dq_d[j] - tracking.dq[j])
                + ahead;
            // Where a measurement is no number the last torque stays. Not `clamp`, which panics on such.
            let wanted = if wanted.is_finite() { wanted } else { *tau };
            let (low, high) = self.window(j, tracking.tau[j]);
            let allowed = wanted.max(-self.most[j]).min(self.most[j]).max(low).min(high);
            held |= allowed != wanted;
            *tau = allowed;
        }
        (tau, held)
    }

    /// Where the next torque of joint `j` may be when the arm shows `shown`: within a cycle's rate of it and of the one sent last.
    fn window(&self, j: usize, shown: f64) -> (f64, f64) {
        let (sent, step) = (self.sent[j], self.step[j]);
        // A state with a NaN shows nothing.
        let shown = if shown.is_finite() { shown } else { sent };
        let (low, high) = (shown.max(sent) - step, shown.min(sent) + step);
        if low <= high { (low, high) } else { (shown - step, shown + step) }
    }

    /// Takes in that `tau` has left.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, tau: [f64; 7]) {
        self.sent = tau;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::panda;

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
            let (tau, held) = law.torque(&Tracking { tau: last, ..tracking }, &[0.0; 7]);
            law.sent(tau);
            assert!(held || last == tau || tau.iter().zip(&last).all(|(a, b)| (a - b).abs() <= 0.5));
            assert!(tau.iter().zip(&last).all(|(a, b)| (a - b).abs() <= 0.5 + 1e-12));
            last = tau;
        }
        // Half of 87 and 12 Nm at most; what asks for less gets what it asks for.
        assert_eq!((last[0], last[4], last[6]), (43.5, 6.0, 4.5));
        let noise = Tracking { dq: [f64::NAN; 7], tau: [f64::NAN; 7], ..Tracking::default() };
        assert_eq!(law.torque(&noise, &[0.0; 7]).0, last);
        let far = Tracking { q_d: [0.11; 7], ..Tracking::default() };
        let nan = Tracking { q_d: [f64::NAN; 7], ..Tracking::default() };
        assert!(law.out_of_reach(&far) && law.out_of_reach(&nan));
    }

    /// An arm that shows what it holds `behind` cycles late, and gets the commands that `arrives` lets through; the largest step that it sees.
    fn worst_step(
        law: &mut TorqueLaw,
        behind: usize,
        arrives: impl Fn(usize) -> bool,
        leaves: impl Fn(usize) -> bool,
    ) -> f64 {
        let mut holds = vec![[0.0f64; 7]];
        let mut worst = 0.0f64;
        for cycle in 0..800 {
            let held = holds[cycle];
            let shown = holds[cycle.saturating_sub(behind)];
            // Up and down as quickly as the rate allows.
            let way = if cycle / 200 % 2 == 0 { 0.09 } else { -0.09 };
            let (tau, _) = law.torque(&Tracking { q_d: [way; 7], tau: shown, ..Tracking::default() }, &[0.0; 7]);
            if leaves(cycle) {
                law.sent(tau);
            }
            let next = if leaves(cycle) && arrives(cycle) { tau } else { held };
            worst = next.iter().zip(&held).fold(worst, |worst, (next, held)| worst.max((next - held).abs()));
            holds.push(next);
        }
        let most = holds.iter().fold(f64::MIN, |most, tau| most.max(tau[0]));
        let least = holds.iter().skip(200).fold(f64::MAX, |least, tau| least.min(tau[0]));
        assert!(most - least > 40.0, "the torque must follow: {least} to {most}");
        worst
    }

    #[test]
    fn after_lost_commands_the_arm_sees_no_jump_of_the_torque() {
        // A half of 1000 Nm/s is the law's share of the rate.
        for run in [1, 2, 5, 19] {
            let worst = worst_step(&mut law(false), 0, |cycle| cycle % 40 >= run, |_| true);
            assert!(worst <= 0.5 + 1e-9, "{run} lost on the way: {worst} Nm");
            let worst = worst_step(&mut law(false), 0, |_| true, |cycle| cycle % 40 >= run);
            assert!(worst <= 0.5 + 1e-9, "{run} that did not leave: {worst} Nm");
        }
        // States that are a command behind: what was sent counts beside what they show.
        let worst = worst_step(&mut law(false), 1, |_| true, |_| true);
        assert!(worst <= 0.5 + 1e-9, "a cycle behind: {worst} Nm");
    }

    #[test]
    fn an_arm_that_holds_another_torque_is_led_from_there() {
        let mut law = law(false);
        law.sent([8.0; 7]);
        let tracking = |tau| Tracking { q_d: [0.09; 7], tau, ..Tracking::default() };
        // Two windows that don't meet: the arm's own counts.
        assert_eq!(law.torque(&tracking([2.0; 7]), &[0.0; 7]), ([2.5; 7], true));
        // A state that is no number: what was sent last.
        assert_eq!(law.torque(&tracking([f64::NAN; 7]), &[0.0; 7]).0[0], 8.5);
        // Nothing has left since, so nothing has changed.
        assert_eq!(law.torque(&tracking([8.0; 7]), &[0.0; 7]).0[0], 8.5);
    }
}
