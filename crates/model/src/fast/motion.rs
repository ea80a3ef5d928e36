//! Outward along an all-revolute arm: how every link's frame moves.

use super::frames::{Frames, Twist, untwist};
use super::trig::sin_cos;
use super::{Lanes, fused};
use crate::motion::Sample;
use fearless_simd::{Simd, SimdBase, f64x8};
use nalgebra::Vector3;
use plumbline_core::MAX_JOINTS;

/// How every frame of an arm moves at one sample, one lane per link, and the sines and cosines of its joints.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    /// Sines of the joints' angles.
    pub sin: Lanes,
    /// Cosines of the joints' angles.
    pub cos: Lanes,
    /// Angular velocity \[rad/s\].
    pub w: [Lanes; 3],
    /// Angular acceleration \[rad/s2\].
    pub dw: [Lanes; 3],
    /// Acceleration of the origin, against gravity \[m/s2\].
    pub a: [Lanes; 3],
}

/// An arm under one gravity.
#[derive(Clone, Debug)]
pub struct Carrier {
    /// Its frames.
    pub frames: Frames,
    /// Acceleration of the base against gravity, turned by the first twist \[m/s2\].
    base: [f64; 3],
}

impl Carrier {
    /// An arm under `gravity` in the base frame \[m/s2\].
    pub fn new(frames: Frames, gravity: &Vector3<f64>) -> Carrier {
        let mut carrier = Carrier { frames, base: [0.0; 3] };
        carrier.set_gravity(gravity);
        carrier
    }

    /// Puts the arm under another `gravity` in the base frame \[m/s2\].
    pub fn set_gravity(&mut self, gravity: &Vector3<f64>) {
        self.base = untwist(self.frames.frames[0].twist, [-gravity.x, -gravity.y, -gravity.z]);
    }

    /// Angular velocity and acceleration of every frame, and its origin's acceleration, each in its own frame.
    #[inline(always)]
    pub fn outward<S: Simd>(&self, simd: S, motion: &mut Motion, sample: &Sample) {
        let q = f64x8::from_slice(simd, &sample.q) + f64x8::from_slice(simd, &self.frames.theta);
        let (sin, cos) = sin_cos(simd, q);
        sin.store_slice(&mut motion.sin.0);
        cos.store_slice(&mut motion.cos.0);

        let fma = |a: f64, b: f64, c: f64| fused(simd, a, b, c);
        // The base is at rest, so frame 1 turns about its own axis only.
        let mut w = [0.0, 0.0, sample.dq[0]];
        let mut dw = [0.0, 0.0, sample.ddq[0]];
        let (s, c) = (motion.sin.0[0], motion.cos.0[0]);
        let mut a = [fma(c, self.base[0], s * self.base[1]), fma(c, self.base[1], -s * self.base[0]), self.base[2]];
        motion.keep(0, w, dw, a);
        for i in 1..self.frames.len.min(MAX_JOINTS) {
            let frame = &self.frames.frames[i];
            if frame.levered {
                // a + dw x p + w x (w x p)
                let [x, y, z] = frame.lever;
                let along = fma(w[0], x, fma(w[1], y, w[2] * z));
                let square = fma(w[0], w[0], fma(w[1], w[1], w[2] * w[2]));
                a[0] += fma(dw[1], z, fma(-dw[2], y, fma(along, w[0], -square * x)));
                a[1] += fma(dw[2], x, fma(-dw[0], z, fma(along, w[1], -square * y)));
                a[2] += fma(dw[0], y, fma(-dw[1], x, fma(along, w[2], -square * z)));
            }
            let turn = (motion.sin.0[i], motion.cos.0[i], sample.dq[i], sample.ddq[i]);
            // One copy per twist, so that its signs and swaps are part of the products.
            (w, dw, a) = match frame.twist {
                Twist::None => step(simd, w, dw, a, turn),
                Twist::Left => {
                    let to = |v| untwist(Twist::Left, v);
                    step(simd, to(w), to(dw), to(a), turn)
                }
                Twist::Right => {
                    let to = |v| untwist(Twist::Right, v);
                    step(simd, to(w), to(dw), to(a), turn)
                }
                twist => step(simd, untwist(twist, w), untwist(twist, dw), untwist(twist, a), turn),
            };
            motion.keep(i, w, dw, a);
        }
    }
}

impl Motion {
    #[inline(always)]
    fn keep(&mut self, i: usize, w: [f64; 3], dw: [f64; 3], a: [f64; 3]) {
        for axis in 0..3 {
            (self.w[axis].0[i], self.dw[axis].0[i], self.a[axis].0[i]) = (w[axis], dw[axis], a[axis]);
        }
    }
}

/// Motion of a frame from its parent's, twisted already, by sine and cosine of its joint's angle and the joint's velocity and acceleration.
#[inline(always)]
fn step<S: Simd>(
    simd: S,
    w: [f64; 3],
    dw: [f64; 3],
    a: [f64; 3],
    (s, c, dq, ddq): (f64, f64, f64, f64),
) -> ([f64; 3], [f64; 3], [f64; 3]) {
    let fma = |a: f64, b: f64, c: f64| fused(simd, a, b, c);
    let w = [fma(c, w[0], s * w[1]), fma(c, w[1], -s * w[0]), w[2] + dq];
    let x = fma(c, dw[0], fma(s, dw[1], w[1] * dq));
    let y = fma(c, dw[1], fma(-s, dw[0], -w[0] * dq));
    (w, [x, y, dw[2] + ddq], [fma(c, a[0], s * a[1]), fma(c, a[1], -s * a[0]), a[2]])
}
