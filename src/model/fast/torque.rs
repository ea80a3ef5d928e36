//! Inverse dynamics for the loop: the recursion of [`super::super::rnea::rnea`] with all that is zero left out.

use super::frames::{Frames, Twist};
use super::trig::sin_cos;
use super::{Lanes, fused};
use crate::joint::{JointVec, MAX_JOINTS};
use crate::model::chain::Chain;
use crate::model::rnea::LinkParameters;
use crate::model::term::Sample;
use fearless_simd::{Simd, SimdBase, SimdFloat, f64x4, f64x8};
use nalgebra::Vector3;

/// The rigid body of an all-revolute arm with its numbers in place.
///
/// Outward, joint after joint, go the frames' angular velocities and accelerations and their origins' accelerations, in scalars without
/// the products that a right angle makes zero. The wrenches of all links are then one pass over eight lanes, one link each, without the
/// parameters that regrouping leaves zero (`Lyy`, `lz` and `m` of every link of a base set). Inward go moments, and forces as far as a
/// lever needs them.
#[derive(Clone, Debug)]
pub struct RigidTorque {
    frames: Frames,
    /// Acceleration of the base against gravity, turned by the first twist \[m/s2\].
    base: [f64; 3],
    /// Standard parameters, each with one lane per link.
    p: [Lanes; 10],
    /// Whether any of `Lyy`, `lz`, `m` is not zero.
    whole: bool,
    /// First joint whose torque needs the forces beyond it: its index is that of the first lever.
    first_lever: usize,
}

impl RigidTorque {
    /// The arm with `links` (one row of standard or regrouped parameters per link) under `gravity` in the base frame \[m/s2\];
    /// `None` when a joint is prismatic.
    pub fn new(chain: &Chain, links: &[LinkParameters], gravity: &Vector3<f64>) -> Option<RigidTorque> {
        assert_eq!(links.len(), chain.len(), "one row of parameters per link");
        let frames = Frames::of(chain)?;
        let mut p = [Lanes::default(); 10];
        for (i, link) in links.iter().enumerate() {
            for (lanes, value) in p.iter_mut().zip(frames.parameters(i, link)) {
                lanes.0[i] = value;
            }
        }
        let whole = [3, 8, 9].iter().any(|&slot: &usize| p[slot].0.iter().any(|&value| value != 0.0));
        let first_lever = (0..frames.len).find(|&i| frames.frames[i].levered).unwrap_or(MAX_JOINTS);
        let against = [-gravity.x, -gravity.y, -gravity.z];
        let base = untwist(frames.frames[0].twist, against);
        Some(RigidTorque { frames, base, p, whole, first_lever })
    }

    /// Adds the arm's torques at a sample to `tau` \[Nm\].
    #[inline(always)]
    pub fn torque<S: Simd>(&self, simd: S, work: &mut Workspace, sample: &Sample, tau: &mut JointVec) {
        let n = self.frames.len;
        let q = f64x8::from_slice(simd, &sample.q) + f64x8::from_slice(simd, &self.frames.theta);
        let (sin, cos) = sin_cos(simd, q);
        sin.store_slice(&mut work.sin.0);
        cos.store_slice(&mut work.cos.0);
        self.outward(simd, work, sample);
        // Half the lanes at a time fit into sixteen registers.
        self.wrenches(simd, work, 0);
        if n > 4 {
            self.wrenches(simd, work, 4);
        }
        self.inward(simd, work, tau);
    }

    /// Angular velocity and acceleration of every frame, and its origin's acceleration.
    #[inline(always)]
    fn outward<S: Simd>(&self, simd: S, work: &mut Workspace, sample: &Sample) {
        let fma = |a: f64, b: f64, c: f64| fused(simd, a, b, c);
        // The base stands still, so that frame 1 turns about its own axis alone.
        let mut w = [0.0, 0.0, sample.dq[0]];
        let mut dw = [0.0, 0.0, sample.ddq[0]];
        let (s, c) = (work.sin.0[0], work.cos.0[0]);
        let mut a = [fma(c, self.base[0], s * self.base[1]), fma(c, self.base[1], -s * self.base[0]), self.base[2]];
        work.keep(0, w, dw, a);
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
            let turn = (work.sin.0[i], work.cos.0[i], sample.dq[i], sample.ddq[i]);
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
            work.keep(i, w, dw, a);
        }
    }

    /// Force and moment about its frame's origin that each link needs, for four links from `first`.
    #[inline(always)]
    fn wrenches<S: Simd>(&self, simd: S, work: &mut Workspace, first: usize) {
        let load = |lanes: &Lanes| f64x4::from_slice(simd, &lanes.0[first..first + 4]);
        let ([wx, wy, wz], [dx, dy, dz]) = (work.w.each_ref().map(load), work.dw.each_ref().map(load));
        let [ax, ay, az] = work.a.each_ref().map(load);
        let p = |slot: usize| load(&self.p[slot]);

        // U = [dw]x + [w]x [w]x.
        let (xx, yy, zz) = (wx * wx, wy * wy, wz * wz);
        let (wxy, wxz, wyz) = (wx * wy, wx * wz, wy * wz);
        let (uxy, uyx) = (wxy - dz, wxy + dz);
        let (uxz, uzx) = (wxz + dy, wxz - dy);
        let (uyz, uzy) = (wyz - dx, wyz + dx);

        // Force U l + m a, moment L dw + w x L w + l x a.
        let (lx, ly) = (p(6), p(7));
        let mut fx = uxy.mul_sub(ly, (yy + zz) * lx);
        let mut fy = uyx.mul_sub(lx, (xx + zz) * ly);
        let mut fz = uzx.mul_add(lx, uzy * ly);
        let (ixx, ixy, ixz, iyz, izz) = (p(0), p(1), p(2), p(4), p(5));
        let mut mx = ixx.mul_add(dx, izz * wyz) + ixz.mul_sub(uyx, ixy * uzx) + iyz.mul_add(yy - zz, ly * az);
        let mut my = (ixx - izz).mul_add(wxz, ixy * uzy) + ixz.mul_sub(zz - xx, iyz * uxy) - lx * az;
        let mut mz =
            izz.mul_sub(dz, ixx * wxy) + ixy.mul_sub(xx - yy, ixz * uyz) + iyz.mul_add(uxz, lx.mul_sub(ay, ly * ax));
        if self.whole {
            let (iyy, lz, mass) = (p(3), p(8), p(9));
            fx = mass.mul_add(ax, lz.mul_add(uxz, fx));
            fy = mass.mul_add(ay, lz.mul_add(uyz, fy));
            fz = mass.mul_add(az, fz - lz * (xx + yy));
            mx = mx - iyy.mul_add(wyz, lz * ay);
            my = my + iyy.mul_add(dy, lz * ax);
            mz = iyy.mul_add(wxy, mz);
        }
        for (lanes, value) in work.f.iter_mut().chain(&mut work.m).zip([fx, fy, fz, mx, my, mz]) {
            value.store_slice(&mut lanes.0[first..first + 4]);
        }
    }

    /// Every joint carries the wrenches of all links beyond it; its torque is their moment about its axis.
    #[inline(always)]
    fn inward<S: Simd>(&self, simd: S, work: &Workspace, tau: &mut JointVec) {
        let fma = |a: f64, b: f64, c: f64| fused(simd, a, b, c);
        let own = |lanes: &[Lanes; 3], i: usize| [lanes[0].0[i], lanes[1].0[i], lanes[2].0[i]];
        let last = self.frames.len.min(MAX_JOINTS) - 1;
        let (mut f, mut m) = (own(&work.f, last), own(&work.m, last));
        for i in (1..=last).rev() {
            tau[i] += m[2];
            let frame = &self.frames.frames[i];
            let (s, c) = (work.sin.0[i], work.cos.0[i]);
            // Everything but the moment beyond is ready before that moment is: it goes through two products alone.
            let mut link = own(&work.m, i - 1);
            if i >= self.first_lever {
                let g = own(&work.f, i - 1);
                f = twist(frame.twist, [fma(c, f[0], -s * f[1]), fma(s, f[0], c * f[1]), f[2]]);
                if frame.levered {
                    let [x, y, z] = frame.lever;
                    link[0] = fma(y, f[2], fma(-z, f[1], link[0]));
                    link[1] = fma(z, f[0], fma(-x, f[2], link[1]));
                    link[2] = fma(x, f[1], fma(-y, f[0], link[2]));
                }
                f = [f[0] + g[0], f[1] + g[1], f[2] + g[2]];
            }
            let link = untwist(frame.twist, link);
            let turned = [fma(c, m[0], fma(-s, m[1], link[0])), fma(s, m[0], fma(c, m[1], link[1])), m[2] + link[2]];
            m = twist(frame.twist, turned);
        }
        tau[0] += m[2];
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

/// What the passes hand to each other, one lane per link or joint.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    sin: Lanes,
    cos: Lanes,
    w: [Lanes; 3],
    dw: [Lanes; 3],
    a: [Lanes; 3],
    f: [Lanes; 3],
    m: [Lanes; 3],
}

impl Workspace {
    #[inline(always)]
    fn keep(&mut self, i: usize, w: [f64; 3], dw: [f64; 3], a: [f64; 3]) {
        for axis in 0..3 {
            (self.w[axis].0[i], self.dw[axis].0[i], self.a[axis].0[i]) = (w[axis], dw[axis], a[axis]);
        }
    }
}

/// A parent's vector in the twisted frame: `Rx(alpha)' v`.
#[inline(always)]
fn untwist(twist: Twist, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match twist {
        Twist::None => [x, y, z],
        Twist::Left => [x, z, -y],
        Twist::Right => [x, -z, y],
        Twist::Any(sin, cos) => [x, cos * y + sin * z, cos * z - sin * y],
    }
}

/// The other way: `Rx(alpha) v`.
#[inline(always)]
fn twist(twist: Twist, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match twist {
        Twist::None => [x, y, z],
        Twist::Left => [x, -z, y],
        Twist::Right => [x, z, -y],
        Twist::Any(sin, cos) => [x, cos * y - sin * z, sin * y + cos * z],
    }
}
