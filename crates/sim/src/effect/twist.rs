//! Deflection of a transmission between encoder and link. The encoder is on the motor's side:
//!
//!   q_measured = q + theta,   lag d theta/dt + theta = deflection(tau),
//!
//! where `tau` is the motor's torque, which the transmission carries (quasi-static: the motor has no inertia). The controller's damping makes `tau` depend on `d theta/dt`,
//!
//!   tau = load + K (q_d - q - theta) + D (dq_d - dq - d theta/dt),
//!
//! so every slope solves one scalar equation for `d theta/dt`; its left side minus its right side rises, so there is one solution.

use super::{At, Effect};
use crate::truth::Truth;
use plumbline_core::JointVec;

/// Deflection of a transmission.
pub(super) trait Deflection: Send {
    /// Twist \[rad\] under a torque \[Nm\] and its derivative \[rad/Nm\], not negative.
    fn under(&self, tau: f64) -> (f64, f64);
}

/// The effect of a deflection on the joint's encoder and controller.
pub(super) struct Twist<D> {
    joint: usize,
    stiffness: f64,
    damping: f64,
    /// One step of the integration, the shortest stable lag \[s\].
    lag: f64,
    deflection: D,
}

impl<D: Deflection> Twist<D> {
    /// `joint` counts from 0.
    pub fn new(joint: usize, truth: &Truth, deflection: D) -> Twist<D> {
        let controller = &truth.joints[joint];
        let lag = 1e-3 / f64::from(truth.substeps);
        Twist { joint, stiffness: controller.stiffness, damping: controller.damping, lag, deflection }
    }

    /// `d theta/dt` of the twist `theta`, where `tau` is the controller's torque at a constant twist.
    fn rate(&self, tau: f64, theta: f64) -> f64 {
        let wrong = |rate: f64| {
            let (deflection, slope) = self.deflection.under(tau - self.damping * rate);
            (self.lag * rate + theta - deflection, self.lag + self.damping * slope)
        };
        // The solution lies between zero and the rate at the torque of a constant twist.
        let far = -wrong(0.0).0 / self.lag;
        let (mut low, mut high) = (far.min(0.0), far.max(0.0));
        let mut rate = 0.0;
        for _ in 0..60 {
            let (value, slope) = wrong(rate);
            if value > 0.0 {
                high = rate
            } else {
                low = rate
            }
            let newton = rate - value / slope;
            let next = if low <= newton && newton <= high { newton } else { 0.5 * (low + high) };
            if (next - rate).abs() <= 1e-12 * (1.0 + next.abs()) {
                return next;
            }
            rate = next;
        }
        rate
    }
}

impl<D: Deflection> Effect for Twist<D> {
    fn states(&self) -> usize {
        1
    }

    fn twists(&self, joint: usize) -> bool {
        joint == self.joint
    }

    fn encoder(&self, at: &At, x: &[f64], dx: &mut [f64], q: &mut JointVec, dq: &mut JointVec) {
        let j = self.joint;
        // A held torque does not depend on the twist, which follows it with its lag.
        if let Some(held) = at.held {
            dx[0] = (self.deflection.under(held[j]).0 - x[0]) / self.lag;
            q[j] += x[0];
            dq[j] += dx[0];
            return;
        }
        let error = at.desired.q[j] - q[j] - x[0];
        let tau = at.load[j] + self.stiffness * error + self.damping * (at.desired.dq[j] - dq[j]);
        dx[0] = self.rate(tau, x[0]);
        q[j] += x[0];
        dq[j] += dx[0];
    }
}
