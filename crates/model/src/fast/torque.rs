//! Inverse dynamics for the loop: the recursion of [`super::super::rnea::rnea`] without zero terms.

use super::frames::{Frames, twist, untwist};
use super::motion::{Carrier, Motion};
use super::{Lanes, fused};
use crate::chain::Chain;
use crate::motion::Sample;
use crate::rnea::LinkParameters;
use fearless_simd::{Simd, SimdBase, SimdFloat, f64x4};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// The rigid body of an all-revolute arm with its numbers in place.
///
/// Outward, joint after joint, go the frames' angular velocities and accelerations and their origins' accelerations, in scalars without
/// the products that a right angle makes zero. The wrenches of all links are then one pass over eight lanes, one link each, without the
/// parameters that regrouping leaves zero (`Lyy`, `lz` and `m` of every link of a base set). Inward go moments, and forces as far as a
/// lever needs them.
#[derive(Clone, Debug)]
pub struct RigidTorque {
    carrier: Carrier,
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
        let frames = Frames::moved(chain)?;
        let mut p = [Lanes::default(); 10];
        for (i, link) in links.iter().enumerate() {
            for (lanes, value) in p.iter_mut().zip(frames.parameters(i, link)) {
                lanes.0[i] = value;
            }
        }
        let whole = [3, 8, 9].iter().any(|&slot: &usize| p[slot].0.iter().any(|&value| value != 0.0));
        let first_lever = (0..frames.len).find(|&i| frames.frames[i].levered).unwrap_or(MAX_JOINTS);
        Some(RigidTorque { carrier: Carrier::new(frames, gravity), p, whole, first_lever })
    }

    /// Puts the arm under another `gravity` in the base frame \[m/s2\].
    pub fn set_gravity(&mut self, gravity: &Vector3<f64>) {
        self.carrier.set_gravity(gravity);
    }

    /// Adds the arm's torques at a sample to `tau` \[Nm\].
    #[inline(always)]
    pub fn torque<S: Simd>(&self, simd: S, work: &mut Workspace, sample: &Sample, tau: &mut JointVec) {
        self.carrier.outward(simd, &mut work.motion, sample);
        // Half the lanes at a time fit into sixteen registers.
        self.wrenches(simd, work, 0);
        if self.carrier.frames.len > 4 {
            self.wrenches(simd, work, 4);
        }
        self.inward(simd, work, tau);
    }

    /// Force and moment about its frame's origin that each link needs, for four links from `first`.
    #[inline(always)]
    fn wrenches<S: Simd>(&self, simd: S, work: &mut Workspace, first: usize) {
        let motion = &work.motion;
        let load = |lanes: &Lanes| f64x4::from_slice(simd, &lanes.0[first..first + 4]);
        let ([wx, wy, wz], [dx, dy, dz]) = (motion.w.each_ref().map(load), motion.dw.each_ref().map(load));
        let [ax, ay, az] = motion.a.each_ref().map(load);
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
            mx -= iyy.mul_add(wyz, lz * ay);
            my += iyy.mul_add(dy, lz * ax);
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
        let frames = &self.carrier.frames;
        let count = frames.len.min(MAX_JOINTS);
        let Some(last) = count.checked_sub(1) else { return };
        let (mut f, mut m) = (own(&work.f, last), own(&work.m, last));
        for i in (1..count).rev() {
            tau[i] += m[2];
            let frame = &frames.frames[i];
            let (s, c) = (work.motion.sin.0[i], work.motion.cos.0[i]);
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

/// What the passes hand to each other, one lane per link.
#[derive(Clone, Debug, Default)]
pub struct Workspace {
    motion: Motion,
    /// Force of each link \[N\].
    f: [Lanes; 3],
    /// Moment of each link about its frame's origin \[Nm\].
    m: [Lanes; 3],
}
