//! The columns of the rigid links at one sample, for all joints at once.

use super::frames::{Frames, Twist};
use super::motion::{Carrier, Motion};
use super::{Lanes, vector_level};
use crate::chain::Chain;
use crate::motion::Sample;
use crate::regressor::LINK_COLUMNS;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f64x4};
use nalgebra::Vector3;

/// Slots that the usual regrouping leaves of a revolute link: all but `Lyy`, `lz`, `m`.
const BASE_LINK: u16 = 0b00_1111_0111;

/// Chosen columns of the standard regressor of an all-revolute arm, `Y[j, c] = d tau_j / d delta_c`.
///
/// The plain route ([`crate::regressor()`]) carries the wrench of every parameter inward, joint by joint. Here the joints' axes go
/// outward instead: with joint `j`'s axis `u_j` and the velocity `v_j` that it gives the origin of frame `i`, both in frame `i`, a
/// parameter whose wrench is (force `f`, moment `m`) has the entry `u_j . m + v_j . f`. The wrenches are sparse, so that an entry
/// costs two to six products, and four joints are computed at a time.
#[derive(Clone, Debug)]
pub struct LinkRegressor {
    level: Level,
    carrier: Carrier,
    /// One bit per slot of each link that has a column.
    kept: [u16; 8],
    /// Index of the first link at whose origin any joint's velocity is not zero.
    first_lever: usize,
    work: Wrenches,
    columns: usize,
}

/// A one among zeros, to be read from the place that puts it into the wanted lane.
const OWN_AXIS: [f64; 7] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];

/// Wrenches of single parameters about their frames' origins, one lane per link.
#[derive(Clone, Debug, Default)]
struct Wrenches {
    motion: Motion,
    /// Moments of the six inertias: `L dw + w x L w` for a unit of each.
    inertia: [[Lanes; 3]; 6],
    /// Forces of the three first moments: the columns of `U = [dw]x + [w]x [w]x`.
    first: [[Lanes; 3]; 3],
    /// Their moments are `axis x a`, the force of the mass is `a`.
    a: [Lanes; 3],
    /// `-a`.
    minus_a: [Lanes; 3],
}

impl LinkRegressor {
    /// The columns `slots` (rising, `10 * link + position` in `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`) under `gravity` in the base
    /// frame \[m/s2\]; `None` when a joint is prismatic. Panics when the slots do not rise or name no link of the arm.
    pub fn new(chain: &Chain, slots: &[usize], gravity: &Vector3<f64>) -> Option<LinkRegressor> {
        assert!(slots.windows(2).all(|pair| pair[0] < pair[1]), "slots rise: {slots:?}");
        assert!(slots.last().is_none_or(|&last| last < LINK_COLUMNS * chain.len()), "slots of {} links", chain.len());
        let frames = Frames::of(chain)?;
        let mut kept = [0; 8];
        for slot in slots {
            kept[slot / LINK_COLUMNS] |= 1 << (slot % LINK_COLUMNS);
        }
        let first_lever = (0..frames.len).find(|&i| frames.frames[i].levered).unwrap_or(frames.len);
        Some(LinkRegressor {
            level: vector_level(),
            carrier: Carrier::new(frames, gravity),
            kept,
            first_lever,
            work: Wrenches::default(),
            columns: slots.len(),
        })
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        self.columns
    }

    /// Writes the columns at a sample, each with one entry per joint; entries past the arm's joints, and of joints that a link does not
    /// move, are zero. `out` has one element per column.
    pub fn fill(&mut self, sample: &Sample, out: &mut [[f64; 8]]) {
        debug_assert_eq!(out.len(), self.columns, "one element per column");
        let level = self.level;
        dispatch!(level, simd => self.fill_with(simd, sample, out));
    }

    #[inline(always)]
    fn fill_with<S: Simd>(&mut self, simd: S, sample: &Sample, out: &mut [[f64; 8]]) {
        let n = self.carrier.frames.len;
        self.carrier.outward(simd, &mut self.work.motion, sample);
        self.work.derive(simd, 0);
        if n > 4 {
            self.work.derive(simd, 4);
        }
        self.joints::<S, 0>(simd, out);
        if n > 4 {
            self.joints::<S, 4>(simd, out);
        } else {
            out.iter_mut().for_each(|column| column[4..].fill(0.0));
        }
    }

    /// Entries of the four joints from `FIRST` in all columns.
    #[inline(always)]
    fn joints<S: Simd, const FIRST: usize>(&self, simd: S, out: &mut [[f64; 8]]) {
        let zero = f64x4::splat(simd, 0.0);
        // Axes and velocities of the four joints, one lane each; a joint that the link does not move has zeros.
        let (mut u, mut v) = ([zero; 3], [zero; 3]);
        let mut first = 0;
        for i in 0..self.carrier.frames.len.min(8) {
            let count = self.kept[i].count_ones() as usize;
            let Some(columns) = out.get_mut(first..first + count) else { return };
            first += count;
            if i < FIRST {
                for column in columns {
                    column[FIRST..FIRST + 4].fill(0.0);
                }
                continue;
            }
            if i > FIRST {
                self.advance(i, &mut u, &mut v);
            }
            if i < FIRST + 4 {
                // The link's own joint turns about z and leaves the frame's origin where it is.
                let lane = i - FIRST;
                u[2] += f64x4::from_slice(simd, &OWN_AXIS[3 - lane..7 - lane]);
            }
            let link = Link { work: &self.work, i, u, v, levered: i >= self.first_lever };
            if self.kept[i] == BASE_LINK
                && let Some(columns) = columns.first_chunk_mut::<7>()
            {
                let [c0, c1, c2, c3, c4, c5, c6] = columns;
                link.store::<FIRST>(0, c0);
                link.store::<FIRST>(1, c1);
                link.store::<FIRST>(2, c2);
                link.store::<FIRST>(4, c3);
                link.store::<FIRST>(5, c4);
                link.store::<FIRST>(6, c5);
                link.store::<FIRST>(7, c6);
            } else {
                let slots = (0..LINK_COLUMNS).filter(|slot| self.kept[i] >> slot & 1 == 1);
                for (column, slot) in columns.iter_mut().zip(slots) {
                    link.store::<FIRST>(slot, column);
                }
            }
        }
    }

    /// Axes and velocities in frame `i` from those in its parent.
    #[inline(always)]
    fn advance<S: Simd>(&self, i: usize, u: &mut [f64x4<S>; 3], v: &mut [f64x4<S>; 3]) {
        let frame = &self.carrier.frames.frames[i];
        let (s, c) = (self.work.motion.sin.0[i], self.work.motion.cos.0[i]);
        if i >= self.first_lever {
            // v + u x p
            let [x, y, z] = frame.lever;
            if x != 0.0 {
                v[1] = u[2].mul_add(x, v[1]);
                v[2] = u[1].mul_add(-x, v[2]);
            }
            if y != 0.0 {
                v[0] = u[2].mul_add(-y, v[0]);
                v[2] = u[0].mul_add(y, v[2]);
            }
            if z != 0.0 {
                v[0] = u[1].mul_add(z, v[0]);
                v[1] = u[0].mul_add(-z, v[1]);
            }
            *v = turn(frame.twist, *v, s, c);
        }
        *u = turn(frame.twist, *u, s, c);
    }
}

/// A parent's vectors in the frame: `Rz(theta)' Rx(alpha)' v`.
#[inline(always)]
fn turn<S: Simd>(twist: Twist, [x, y, z]: [f64x4<S>; 3], s: f64, c: f64) -> [f64x4<S>; 3] {
    match twist {
        Twist::None => about_z(x, y, z, s, c),
        Twist::Left => about_z(x, z, -y, s, c),
        Twist::Right => about_z(x, -z, y, s, c),
        Twist::Any(sin, cos) => about_z(x, y.mul_add(cos, z * sin), z.mul_sub(cos, y * sin), s, c),
    }
}

// A function, since code of the vector level has to be inlined and a closure has no inline attribute.
#[inline(always)]
fn about_z<S: Simd>(x: f64x4<S>, y: f64x4<S>, z: f64x4<S>, s: f64, c: f64) -> [f64x4<S>; 3] {
    [x.mul_add(c, y * s), y.mul_sub(c, x * s), z]
}

impl Wrenches {
    /// Wrenches of four links from `first`.
    #[inline(always)]
    fn derive<S: Simd>(&mut self, simd: S, first: usize) {
        let load = |lanes: &Lanes| f64x4::from_slice(simd, &lanes.0[first..first + 4]);
        let motion = &self.motion;
        let (wx, wy, wz) = (load(&motion.w[0]), load(&motion.w[1]), load(&motion.w[2]));
        let (dx, dy, dz) = (load(&motion.dw[0]), load(&motion.dw[1]), load(&motion.dw[2]));
        let (ax, ay, az) = (load(&motion.a[0]), load(&motion.a[1]), load(&motion.a[2]));
        let (xx, yy, zz) = (wx * wx, wy * wy, wz * wz);
        let (xy, xz, yz) = (wx * wy, wx * wz, wy * wz);
        let (uxx, uyx, uzx) = (-(yy + zz), xy + dz, xz - dy);
        let (uxy, uyy, uzy) = (xy - dz, -(xx + zz), yz + dx);
        let (uxz, uyz, uzz) = (xz + dy, yz - dx, -(xx + yy));
        store(&mut self.inertia[0], first, dx, xz, -xy);
        store(&mut self.inertia[1], first, -uzx, uzy, xx - yy);
        store(&mut self.inertia[2], first, uyx, zz - xx, -uyz);
        store(&mut self.inertia[3], first, -yz, dy, xy);
        store(&mut self.inertia[4], first, yy - zz, -uxy, uxz);
        store(&mut self.inertia[5], first, yz, -xz, dz);
        store(&mut self.first[0], first, uxx, uyx, uzx);
        store(&mut self.first[1], first, uxy, uyy, uzy);
        store(&mut self.first[2], first, uxz, uyz, uzz);
        store(&mut self.a, first, ax, ay, az);
        store(&mut self.minus_a, first, -ax, -ay, -az);
    }
}

#[inline(always)]
fn store<S: Simd>(to: &mut [Lanes; 3], first: usize, x: f64x4<S>, y: f64x4<S>, z: f64x4<S>) {
    x.store_slice(&mut to[0].0[first..first + 4]);
    y.store_slice(&mut to[1].0[first..first + 4]);
    z.store_slice(&mut to[2].0[first..first + 4]);
}

/// One link and four joints.
struct Link<'a, S: Simd> {
    work: &'a Wrenches,
    i: usize,
    u: [f64x4<S>; 3],
    v: [f64x4<S>; 3],
    /// Whether any joint moves the link's origin.
    levered: bool,
}

impl<S: Simd> Link<'_, S> {
    #[inline(always)]
    fn store<const FIRST: usize>(&self, slot: usize, column: &mut [f64; 8]) {
        self.column(slot).store_slice(&mut column[FIRST..FIRST + 4]);
    }

    /// `u . m + v . f` for a unit of the parameter in a slot.
    #[inline(always)]
    fn column(&self, slot: usize) -> f64x4<S> {
        let a = |axis: usize| self.work.a[axis].0[self.i];
        let minus_a = |axis: usize| self.work.minus_a[axis].0[self.i];
        match slot {
            0..6 => {
                let m = &self.work.inertia[slot];
                self.u[2].mul_add(m[2].0[self.i], self.u[1].mul_add(m[1].0[self.i], self.u[0] * m[0].0[self.i]))
            }
            6 => self.first_moment(0, self.u[2].mul_add(a(1), self.u[1] * minus_a(2))),
            7 => self.first_moment(1, self.u[0].mul_add(a(2), self.u[2] * minus_a(0))),
            8 => self.first_moment(2, self.u[1].mul_add(a(0), self.u[0] * minus_a(1))),
            _ => self.v[2].mul_add(a(2), self.v[1].mul_add(a(1), self.v[0] * a(0))),
        }
    }

    /// A first moment along an axis: adds its force's part to that of its moment.
    #[inline(always)]
    fn first_moment(&self, axis: usize, moment: f64x4<S>) -> f64x4<S> {
        if !self.levered {
            return moment;
        }
        let f = &self.work.first[axis];
        self.v[2].mul_add(f[2].0[self.i], self.v[1].mul_add(f[1].0[self.i], self.v[0].mul_add(f[0].0[self.i], moment)))
    }
}
