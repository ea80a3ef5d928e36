//! Holds commanded positions below the arm's limits, and leads back to the motion without a jump after missed commands.

use super::reference::{Point, TICK};
use crate::limits::RobotLimits;

/// Pole of the return to the motion, per cycle: a small distance vanishes within some 150 ms.
const POLE: f64 = 0.95;
/// Farthest that the way back may begin from the motion \[rad\].
const REACH: f64 = 0.02;
/// Where the way back ends \[rad\]: what is left makes a jerk of 1 rad/s3 at most.
const ARRIVED: f64 = 1e-9;
/// Share of acceleration and jerk limits that the adapter's own braking uses.
const BRAKE: f64 = 0.9;

/// Why no command is made of a desired position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Objection {
    /// It is not a number.
    NotFinite,
    /// It is outside the arm's range.
    Position,
    /// It is too far away from where the arm was sent last.
    Jump,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limited {
    /// Where the arm is sent.
    pub point: Point,
    /// Whether a limit had to be held.
    pub held: bool,
    /// Whether it is on its way back to the motion.
    pub returning: bool,
    /// The limiter's next start once the command has left.
    pub aim: Aim,
}

/// What a limiter goes by from one command to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Aim {
    /// The desired motion at its last sample, which need not be where the arm is.
    target: Point,
    /// Whether the next command leads back to the motion, too.
    returning: bool,
}

/// The limits, and the motion as it was desired so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limiter {
    limits: RobotLimits,
    share: f64,
    aim: Aim,
}

impl Limiter {
    /// For a motion that begins at rest at `q`, held to `share` of `limits`.
    pub fn new(limits: RobotLimits, share: f64, q: [f64; 7]) -> Limiter {
        Limiter { limits, share, aim: Aim { target: Point::at_rest(q), returning: false } }
    }

    /// Whether `desired` may be commanded at all when the arm's reference is `from`.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn objection(&self, from: &Point, desired: &[f64; 7]) -> Option<Objection> {
        if desired.iter().any(|q| !q.is_finite()) || !from.is_finite() {
            return Some(Objection::NotFinite);
        }
        for (j, &desired) in desired.iter().enumerate() {
            // An arm outside its range may be led back into it.
            let (low, high) = (self.limits.q_min[j].min(from.q[j]), self.limits.q_max[j].max(from.q[j]));
            if desired < low - ROUNDING || desired > high + ROUNDING {
                return Some(Objection::Position);
            }
            if (desired - (from.q[j] + TICK * from.dq[j])).abs() > REACH {
                return Some(Objection::Jump);
            }
        }
        None
    }

    /// The command that leads from `from`, where the arm is now, towards `desired`, `ticks` cycles after the last one that left. `own`
    /// means that the arm has followed the commands, and nothing else, since then. It changes nothing before it is [`sent`](Limiter::sent).
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn step(&self, from: &Point, desired: &[f64; 7], ticks: u64, own: bool) -> Limited {
        let last = self.target_before(desired, ticks);
        let target = last.step_to(desired);

        let direct = from.step_to(desired);
        if own && !self.aim.returning && self.fits(from, &direct) {
            return Limited { point: direct, held: false, returning: false, aim: Aim { target, returning: false } };
        }
        let mut q = [0.0; 7];
        let mut held = false;
        for j in 0..7 {
            // The distance e to the motion dies out as (1 - p/z)^3 e = 0.
            let (dq, ddq) = (self.share * self.limits.dq[j], self.share * self.limits.ddq[j]);
            let e = from.q[j] - last.q[j];
            let de = from.dq[j] - last.dq[j].max(-dq).min(dq);
            let dde = from.ddq[j] - last.ddq[j].max(-ddq).min(ddq);
            let (e2, de2) = (e - TICK * de, de - TICK * dde);
            let e3 = e2 - TICK * de2;
            let wanted = desired[j] + POLE * (3.0 * e - POLE * (3.0 * e2 - POLE * e3));
            let acceleration = ((wanted - from.q[j]) / TICK - from.dq[j]) / TICK;
            let allowed = self.allowed(j, from, acceleration);
            held |= (allowed - acceleration).abs() > 1e-6;
            q[j] = from.q[j] + TICK * (from.dq[j] + TICK * allowed);
        }
        let point = from.step_to(&q);
        let returning = (0..7).any(|j| (q[j] - desired[j]).abs() > ARRIVED);
        Limited { point, held, returning: true, aim: Aim { target, returning } }
    }

    /// Takes in that the command of a step has left.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, aim: Aim) {
        self.aim = aim;
    }

    /// The command that brakes the arm as the limits allow; at rest it stays where it is.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn brake(&self, from: &Point) -> Point {
        let mut q = [0.0; 7];
        for (j, q) in q.iter_mut().enumerate() {
            let most = BRAKE * self.share * self.limits.ddq[j];
            let jerk = BRAKE * self.share * self.limits.jerk[j];
            let (dq, ddq) = (from.dq[j], from.ddq[j]);
            // The last step: at rest at once, where neither this jerk nor that of the next step is too much.
            let last = -dq / TICK;
            if (last - ddq).abs() <= jerk * TICK && last.abs() <= jerk * TICK {
                *q = from.q[j];
                continue;
            }
            // As hard as can still be taken back in time, at half of the jerk.
            let ahead = dq + TICK * ddq;
            let wanted = -ahead.signum() * (jerk * ahead.abs()).sqrt().min(most);
            let allowed = wanted.max(ddq - jerk * TICK).min(ddq + jerk * TICK);
            *q = from.q[j] + TICK * (dq + TICK * allowed);
        }
        from.step_to(&q)
    }

    /// The desired motion one cycle before `desired`, which comes `ticks` cycles after the last sample.
    fn target_before(&self, desired: &[f64; 7], ticks: u64) -> Point {
        if ticks <= 1 {
            return self.aim.target;
        }
        // Velocity between the samples, brought forward to the last cycle by the acceleration of before.
        let n = ticks as f64;
        let mut before = self.aim.target;
        for (j, desired) in desired.iter().enumerate() {
            let ddq = self.aim.target.ddq[j];
            let dq = (desired - self.aim.target.q[j]) / (n * TICK) + 0.5 * (n - 1.0) * TICK * ddq;
            before.q[j] = desired - TICK * dq;
            before.dq[j] = dq - TICK * ddq;
        }
        before
    }

    /// Whether every derivative of the step is inside its share.
    fn fits(&self, from: &Point, step: &Point) -> bool {
        (0..7).all(|j| {
            let (low, high) = self.speeds(j, step.q[j]);
            step.dq[j] >= low - ROUNDING
                && step.dq[j] <= high + ROUNDING
                && step.ddq[j].abs() <= self.share * self.limits.ddq[j] * (1.0 + ROUNDING)
                && (step.ddq[j] - from.ddq[j]).abs() <= self.share * self.limits.jerk[j] * TICK * (1.0 + ROUNDING)
        })
    }

    /// The acceleration nearest to `wanted` that keeps jerk, acceleration and, as far as those allow it, velocity inside their shares.
    fn allowed(&self, j: usize, from: &Point, wanted: f64) -> f64 {
        let (most, jerk) = (self.share * self.limits.ddq[j], self.share * self.limits.jerk[j]);
        let (low, high) = self.speeds(j, from.q[j] + TICK * from.dq[j]);
        // The velocity still rises while the acceleration is taken back: v + a T + a^2 / (2 J) may just reach the limit.
        let up_to = |room: f64| {
            if room <= 0.0 {
                (room / TICK).max(-most)
            } else {
                (jerk * TICK).hypot((2.0 * jerk * room).sqrt()) - jerk * TICK
            }
        };
        let (least, greatest) = (-up_to(from.dq[j] - low).min(most), up_to(high - from.dq[j]).min(most));
        let wanted = wanted.min(greatest).max(least.min(greatest));
        let (down, up) = (from.ddq[j] - jerk * TICK, from.ddq[j] + jerk * TICK);
        // Not `clamp`, which panics on what is no number.
        wanted.max(down).min(up)
    }

    fn speeds(&self, j: usize, q: f64) -> (f64, f64) {
        let (low, high) = self.limits.velocities(j, q).unwrap_or_default();
        (self.share * low, self.share * high)
    }
}

const ROUNDING: f64 = 1e-9;

#[cfg(test)]
mod tests;
