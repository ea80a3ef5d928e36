//! The smoothed commanded positions, which the inner controller tracks.
//!
//! A uniform cubic B-spline over the last four commands. Position, velocity and acceleration are continuous, and the acceleration runs
//! straight from one second difference of the commands to the next, so the arm's inertial feed-forward has no steps. At the end of a
//! millisecond the spline passes the command before the one accepted at its beginning: one millisecond behind the newest.

use plumbline_core::{JointVec, MAX_JOINTS, Setpoint};

/// Time between commands \[s\].
pub(super) const TICK_S: f64 = 1e-3;
/// Largest step of a command, 10 rad/s \[rad\].
const MAX_STEP_RAD: f64 = 10.0 * TICK_S;
/// Largest step of the commanded velocity between two commands, 0.5 rad/s: a position jump from rest is larger \[rad\].
const MAX_STEP_CHANGE_RAD: f64 = 0.5 * TICK_S;
/// Deceleration of the arm's own braking \[rad/s2\].
const BRAKE_RAD_PER_S2: f64 = 10.0;

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Refusal {
    NotFinite,
    Jump,
}

/// The last four commands, oldest first, and the last received one.
#[derive(Clone, Debug)]
pub(super) struct Commands {
    n: usize,
    last: [JointVec; 4],
    received: JointVec,
    /// Its difference from the command before it \[rad\].
    step: JointVec,
}

impl Commands {
    pub fn at_rest(n: usize, q: &JointVec) -> Commands {
        Commands { n, last: [*q; 4], received: *q, step: [0.0; MAX_JOINTS] }
    }

    /// Commands of joints that pass `q` with velocity `dq`.
    pub fn passing(n: usize, q: &JointVec, dq: &JointVec) -> Commands {
        let back = |ticks: f64| std::array::from_fn(|j| q[j] - ticks * TICK_S * dq[j]);
        // At the end of its millisecond the spline passes the command before the newest.
        let step = std::array::from_fn(|j| TICK_S * dq[j]);
        Commands { n, last: [back(2.0), back(1.0), *q, back(-1.0)], received: back(-1.0), step }
    }

    /// The newest command.
    pub fn newest(&self) -> &JointVec {
        &self.last[3]
    }

    /// Whether a robot would refuse `q` as the next command.
    pub fn refusal(&self, q: &JointVec) -> Option<Refusal> {
        let [_, _, before, newest] = &self.last;
        self.refuse(q, |j| {
            let step = q[j] - newest[j];
            step.abs() > MAX_STEP_RAD || (step - (newest[j] - before[j])).abs() > MAX_STEP_CHANGE_RAD
        })
    }

    /// Whether an arm that tolerates gaps would refuse `q`, `gap` milliseconds after the command before it: limits the mean velocity since then.
    pub fn refusal_after_gap(&self, q: &JointVec, gap: u32) -> Option<Refusal> {
        let most = MAX_STEP_RAD * f64::from(gap);
        self.refuse(q, |j| (q[j] - self.received[j]).abs() > most)
    }

    fn refuse(&self, q: &JointVec, jumps: impl Fn(usize) -> bool) -> Option<Refusal> {
        if q[..self.n].iter().any(|value| !value.is_finite()) {
            return Some(Refusal::NotFinite);
        }
        (0..self.n).any(jumps).then_some(Refusal::Jump)
    }

    /// Adds `q`, `gap` milliseconds after the command before it. The extrapolated commands are replaced by the parabola through the received
    /// ones: the position steps, the velocity hardly.
    pub fn join(&mut self, q: &JointVec, gap: u32) {
        let gap = f64::from(gap);
        let mut last = [[0.0; MAX_JOINTS]; 4];
        for j in 0..self.n {
            let acceleration = 2.0 * (q[j] - self.received[j] - gap * self.step[j]) / (gap * gap);
            let step = self.step[j] + gap * acceleration;
            for (k, command) in last.iter_mut().enumerate() {
                let ticks = k as f64 - 3.0;
                command[j] = q[j] + ticks * (step + 0.5 * ticks * acceleration);
            }
        }
        self.last = last;
        self.remember();
    }

    /// Adds the next command.
    pub fn push(&mut self, q: &JointVec) {
        self.shift(q);
        self.remember();
    }

    /// Marks the newest command as received.
    fn remember(&mut self) {
        let [_, _, before, newest] = &self.last;
        self.step = std::array::from_fn(|j| newest[j] - before[j]);
        self.received = *newest;
    }

    fn shift(&mut self, q: &JointVec) {
        self.last.rotate_left(1);
        self.last[3] = [0.0; MAX_JOINTS];
        self.last[3][..self.n].copy_from_slice(&q[..self.n]);
    }

    /// Extrapolates a missing command with constant acceleration, as the FCI does.
    pub fn extrapolate(&mut self) {
        let [_, a, b, c] = self.last;
        self.shift(&std::array::from_fn(|j| 3.0 * (c[j] - b[j]) + a[j]));
    }

    /// Brakes each joint independently.
    pub fn brake(&mut self) {
        let [_, _, b, c] = self.last;
        let most = BRAKE_RAD_PER_S2 * TICK_S * TICK_S;
        self.shift(&std::array::from_fn(|j| {
            let step = c[j] - b[j];
            c[j] + step - step.clamp(-most, most)
        }));
    }

    /// The desired motion at share `s` of the present millisecond, 0 to 1.
    pub fn at(&self, s: f64) -> Setpoint {
        let r = 1.0 - s;
        let position = [
            r * r * r / 6.0,
            (s * s * (3.0 * s - 6.0) + 4.0) / 6.0,
            (s * (3.0 + s * (3.0 - 3.0 * s)) + 1.0) / 6.0,
            s * s * s / 6.0,
        ];
        let velocity = [-r * r / 2.0, s * (1.5 * s - 2.0), s * (1.0 - 1.5 * s) + 0.5, s * s / 2.0];
        let acceleration = [r, 3.0 * s - 2.0, 1.0 - 3.0 * s, s];
        let blend = |weights: &[f64; 4], scale: f64| -> JointVec {
            std::array::from_fn(|j| (0..4).map(|k| weights[k] * self.last[k][j]).sum::<f64>() * scale)
        };
        Setpoint {
            q: blend(&position, 1.0),
            dq: blend(&velocity, 1.0 / TICK_S),
            ddq: blend(&acceleration, 1.0 / (TICK_S * TICK_S)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cubic(t: f64) -> f64 {
        0.3 + 0.7 * t - 1.1 * t * t + 4.0 * t * t * t
    }

    #[test]
    fn follows_a_cubic_one_command_behind() {
        let mut commands = Commands::at_rest(1, &[0.0; MAX_JOINTS]);
        for k in 0..4 {
            commands.push(&[cubic(k as f64 * TICK_S), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        // Uniform cubic B-splines smooth by T^2/6 of the second derivative, and reproduce derivatives of a cubic else.
        for s in [0.0, 0.3, 1.0] {
            let t = (1.0 + s) * TICK_S;
            let ddq = -2.2 + 24.0 * t;
            let point = commands.at(s);
            assert!((point.q[0] - cubic(t) - ddq * TICK_S * TICK_S / 6.0).abs() < 1e-12);
            assert!((point.dq[0] - (0.7 - 2.2 * t + 12.0 * t * t) - 24.0 * TICK_S * TICK_S / 6.0).abs() < 1e-9);
            assert!((point.ddq[0] - ddq).abs() < 1e-6);
        }
    }

    #[test]
    fn is_smooth_across_commands() {
        let mut commands = Commands::at_rest(1, &[0.2; MAX_JOINTS]);
        for step in [1e-4, -2e-4, 3e-4, 0.0] {
            let end = commands.at(1.0);
            let mut next = *commands.newest();
            next[0] += step;
            commands.push(&next);
            let start = commands.at(0.0);
            assert!((end.q[0] - start.q[0]).abs() < 1e-15);
            assert!((end.dq[0] - start.dq[0]).abs() < 1e-12);
            assert!((end.ddq[0] - start.ddq[0]).abs() < 1e-9);
        }
    }

    #[test]
    fn brakes_to_rest_and_refuses_jumps() {
        let mut commands = Commands::at_rest(2, &[0.0; MAX_JOINTS]);
        for k in 1..=4 {
            let q = 4e-4 * f64::from(k);
            assert_eq!(commands.refusal(&[q; MAX_JOINTS]), None);
            commands.push(&[q; MAX_JOINTS]);
        }
        assert_eq!(commands.refusal(&[0.0; MAX_JOINTS]), Some(Refusal::Jump));
        assert_eq!(commands.refusal(&[f64::NAN; MAX_JOINTS]), Some(Refusal::NotFinite));
        for _ in 0..50 {
            commands.brake();
        }
        let rest = commands.at(1.0);
        assert!(rest.dq[0].abs() < 1e-12 && rest.ddq[0].abs() < 1e-9);
        assert!(rest.q[0] > 1.6e-3 && rest.q[0] < 1.6e-3 + 0.4 * 0.4 / 2.0 / BRAKE_RAD_PER_S2 + 1e-3);
        assert_eq!(rest.q[2], 0.0);
    }
}
