//! Rigid-body regressor of one sample and its reverse-mode derivative (adjoint).
//!
//! Row `j` of the regressor needs, for every link `i` beyond joint `j`, two vectors in frame `i`: the axis `omega` of joint `j` and the
//! velocity `v` that a unit speed of joint `j` gives frame `i`'s origin. With the link's angular velocity `w`, its derivative `dw` and
//! the acceleration `a` of the frame's origin (gravity taken off), the columns of link `i` in that row are, by virtual power,
//!
//! - inertia `L`: `omega' L dw + (omega x w)' L w`, linear in the six entries of `L`;
//! - first moments: `a x omega + v x dw + w x (w x v)`;
//! - mass: `v . a`.
//!
//! [`Tape::backward`] computes the exact gradients `dF/dq`, `dF/ddq`, `dF/dddq` from `dF/dY` at a small multiple of the cost of the
//! regressor. A test compares the regressor with `plumbline_model::regressor`.

use nalgebra::{Matrix3, Vector3};
use plumbline_core::MAX_JOINTS;
use plumbline_model::{Chain, Joint, JointKind, LINK_COLUMNS};

type V3 = Vector3<f64>;

/// Constants of a joint, with the sine and cosine of its twist.
#[derive(Clone, Copy)]
struct Row {
    kind: JointKind,
    a: f64,
    sin_alpha: f64,
    cos_alpha: f64,
    d: f64,
    theta: f64,
}

/// Constants of an arm for the recursion.
#[derive(Clone)]
pub struct Arm {
    rows: Vec<Row>,
    flange: V3,
}

impl Arm {
    /// Constants of a chain.
    pub fn new(chain: &Chain) -> Arm {
        let row = |joint: &Joint| {
            let rest = joint.placement(0.0).rotation;
            let (sin_alpha, cos_alpha) = (-rest[(1, 2)], rest[(2, 2)]);
            Row { kind: joint.kind, a: joint.a, sin_alpha, cos_alpha, d: joint.d, theta: joint.theta }
        };
        Arm { rows: chain.joints().iter().map(row).collect(), flange: chain.flange().origin }
    }

    /// Number of joints, n.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// The end effector's position in the last link's frame \[m\].
    pub fn flange(&self) -> &V3 {
        &self.flange
    }
}

/// Coefficients of one row on one link's standard parameters `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`.
pub type LinkRow = [f64; LINK_COLUMNS];

/// Intermediate values of the recursion at one sample, filled by [`Tape::forward`].
#[derive(Clone)]
pub struct Tape {
    rotation: [Matrix3<f64>; MAX_JOINTS],
    origin: [V3; MAX_JOINTS],
    /// Angular velocity and acceleration, acceleration of the origin: before (`_in`) and after the joint's own contribution.
    w_in: [V3; MAX_JOINTS],
    dw_in: [V3; MAX_JOINTS],
    a_in: [V3; MAX_JOINTS],
    w: [V3; MAX_JOINTS],
    dw: [V3; MAX_JOINTS],
    a: [V3; MAX_JOINTS],
    /// `omega[i][j]`, `v[i][j]` of the module's documentation, `j <= i`.
    omega: [[V3; MAX_JOINTS]; MAX_JOINTS],
    v: [[V3; MAX_JOINTS]; MAX_JOINTS],
    dq: [f64; MAX_JOINTS],
}

/// Gradient of a function with respect to one sample's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gradient {
    /// With respect to `q`.
    pub q: [f64; MAX_JOINTS],
    /// With respect to `dq`.
    pub dq: [f64; MAX_JOINTS],
    /// With respect to `ddq`.
    pub ddq: [f64; MAX_JOINTS],
}

/// `x cross z`, the derivative of `Rz(-q) x` with respect to `q`.
fn cross_z(x: &V3) -> V3 {
    V3::new(x.y, -x.x, 0.0)
}

impl Default for Tape {
    fn default() -> Tape {
        let zero = [V3::zeros(); MAX_JOINTS];
        Tape {
            rotation: [Matrix3::identity(); MAX_JOINTS],
            origin: zero,
            w_in: zero,
            dw_in: zero,
            a_in: zero,
            w: zero,
            dw: zero,
            a: zero,
            omega: [zero; MAX_JOINTS],
            v: [zero; MAX_JOINTS],
            dq: [0.0; MAX_JOINTS],
        }
    }
}

impl Tape {
    /// Runs the recursion at one sample; `gravity` is the gravitational acceleration in the base frame \[m/s2\]. The slices have at
    /// least n entries.
    pub fn forward(&mut self, arm: &Arm, gravity: &V3, q: &[f64], dq: &[f64], ddq: &[f64]) {
        let (mut w, mut dw, mut a) = (V3::zeros(), V3::zeros(), -gravity);
        for (i, row) in arm.rows.iter().enumerate() {
            let (theta, d) = match row.kind {
                JointKind::Revolute => (row.theta + q[i], row.d),
                JointKind::Prismatic => (row.theta, row.d + q[i]),
            };
            let (st, ct) = theta.sin_cos();
            let (sa, ca) = (row.sin_alpha, row.cos_alpha);
            let rotation = Matrix3::new(ct, -st, 0.0, st * ca, ct * ca, -sa, st * sa, ct * sa, ca);
            let r = V3::new(row.a, -sa * d, ca * d);
            self.rotation[i] = rotation;
            self.origin[i] = r;
            self.dq[i] = dq[i];
            let (w_in, dw_in) = (rotation.tr_mul(&w), rotation.tr_mul(&dw));
            let a_in = rotation.tr_mul(&(a + dw.cross(&r) + w.cross(&w.cross(&r))));
            (self.w_in[i], self.dw_in[i], self.a_in[i]) = (w_in, dw_in, a_in);
            (w, dw, a) = (w_in, dw_in, a_in);
            let own = match row.kind {
                JointKind::Revolute => {
                    dw += cross_z(&w_in) * dq[i];
                    dw.z += ddq[i];
                    w.z += dq[i];
                    (V3::z(), V3::zeros())
                }
                JointKind::Prismatic => {
                    a += cross_z(&w_in) * (2.0 * dq[i]);
                    a.z += ddq[i];
                    (V3::zeros(), V3::z())
                }
            };
            (self.w[i], self.dw[i], self.a[i]) = (w, dw, a);
            for j in 0..i {
                let (omega, v) = (self.omega[i - 1][j], self.v[i - 1][j]);
                self.omega[i][j] = rotation.tr_mul(&omega);
                self.v[i][j] = rotation.tr_mul(&(v + omega.cross(&r)));
            }
            (self.omega[i][i], self.v[i][i]) = own;
        }
    }

    /// Row `j` of the standard regressor on the parameters of link `i >= j` (both from 0).
    pub fn row(&self, i: usize, j: usize) -> LinkRow {
        let (o, v) = (&self.omega[i][j], &self.v[i][j]);
        let (w, dw, a) = (&self.w[i], &self.dw[i], &self.a[i]);
        let u = o.cross(w);
        let first = a.cross(o) + v.cross(dw) + w.cross(&w.cross(v));
        [
            o.x * dw.x + u.x * w.x,
            o.x * dw.y + o.y * dw.x + u.x * w.y + u.y * w.x,
            o.x * dw.z + o.z * dw.x + u.x * w.z + u.z * w.x,
            o.y * dw.y + u.y * w.y,
            o.y * dw.z + o.z * dw.y + u.y * w.z + u.z * w.y,
            o.z * dw.z + u.z * w.z,
            first.x,
            first.y,
            first.z,
            v.dot(a),
        ]
    }

    /// Adds the gradient of `F` with respect to the sample's motion to `out`, from `bar[i][j] = dF/d row(i, j)` (only `j <= i` is read).
    pub fn backward(&self, arm: &Arm, bar: &[[LinkRow; MAX_JOINTS]; MAX_JOINTS], out: &mut Gradient) {
        let n = arm.len();
        let zero = [V3::zeros(); MAX_JOINTS];
        // Adjoints of omega, v, w, dw, a of the current frame, accumulated from later frames.
        let (mut omega_bar, mut v_bar) = (zero, zero);
        let (mut w_bar, mut dw_bar, mut a_bar) = (V3::zeros(), V3::zeros(), V3::zeros());
        for i in (0..n).rev() {
            let (w, dw, a) = (&self.w[i], &self.dw[i], &self.a[i]);
            for j in 0..=i {
                let z = &bar[i][j];
                let s = Matrix3::new(z[0], z[1], z[2], z[1], z[3], z[4], z[2], z[4], z[5]);
                let first = V3::new(z[6], z[7], z[8]);
                let (o, v) = (&self.omega[i][j], &self.v[i][j]);
                let u = o.cross(w);
                let u_bar = s * w;
                omega_bar[j] += s * dw + w.cross(&u_bar) + first.cross(a);
                dw_bar += s * o + first.cross(v);
                // w x (w x v): t = w x v.
                let t = w.cross(v);
                let t_bar = first.cross(w);
                w_bar += s * u + u_bar.cross(o) + t.cross(&first) + v.cross(&t_bar);
                v_bar[j] += dw.cross(&first) + t_bar.cross(w) + a * z[9];
                a_bar += o.cross(&first) + v * z[9];
            }
            // Joint's own contribution.
            let (w_in, dw_in, a_in) = (&self.w_in[i], &self.dw_in[i], &self.a_in[i]);
            let revolute = arm.rows[i].kind == JointKind::Revolute;
            if revolute {
                out.ddq[i] += dw_bar.z;
                out.dq[i] += dw_bar.dot(&cross_z(w_in)) + w_bar.z;
                // z x dw_bar = -(dw_bar x z)
                w_bar -= cross_z(&dw_bar) * self.dq[i];
            } else {
                out.ddq[i] += a_bar.z;
                out.dq[i] += 2.0 * a_bar.dot(&cross_z(w_in));
                w_bar -= cross_z(&a_bar) * (2.0 * self.dq[i]);
            }
            // Rotation into frame i and translation from frame i - 1.
            let mut turn = w_bar.dot(&cross_z(w_in)) + dw_bar.dot(&cross_z(dw_in)) + a_bar.dot(&cross_z(a_in));
            let rotation = &self.rotation[i];
            let r = &self.origin[i];
            let mut r_bar = V3::zeros();
            for j in 0..i {
                turn += omega_bar[j].dot(&cross_z(&self.omega[i][j])) + v_bar[j].dot(&cross_z(&self.v[i][j]));
                let (omega_up, v_up) = (rotation * omega_bar[j], rotation * v_bar[j]);
                r_bar += v_up.cross(&self.omega[i - 1][j]);
                omega_bar[j] = omega_up + r.cross(&v_up);
                v_bar[j] = v_up;
            }
            // The joint's axis is constant in its own frame.
            (omega_bar[i], v_bar[i]) = (V3::zeros(), V3::zeros());
            if i > 0 {
                let (w, dw) = (&self.w[i - 1], &self.dw[i - 1]);
                let a_up = rotation * a_bar;
                let t = w.cross(r);
                let t_bar = a_up.cross(w);
                r_bar += a_up.cross(dw) + t_bar.cross(w);
                w_bar = rotation * w_bar + t.cross(&a_up) + r.cross(&t_bar);
                dw_bar = rotation * dw_bar + r.cross(&a_up);
                a_bar = a_up;
            }
            out.q[i] += if revolute { turn } else { r_bar.dot(&rotation.column(2)) };
        }
    }

    /// Places every link frame in the base frame.
    pub fn place(&self, n: usize, frames: &mut [Frame; MAX_JOINTS]) {
        let (mut rotation, mut origin) = (Matrix3::identity(), V3::zeros());
        for (i, frame) in frames.iter_mut().enumerate().take(n) {
            origin += rotation * self.origin[i];
            rotation *= self.rotation[i];
            *frame = Frame { rotation, origin };
        }
    }
}

/// A link frame in the base frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Orientation.
    pub rotation: Matrix3<f64>,
    /// Origin \[m\].
    pub origin: V3,
}

impl Frame {
    /// The base frame itself.
    pub fn base() -> Frame {
        Frame { rotation: Matrix3::identity(), origin: V3::zeros() }
    }

    /// Base-frame coordinates of a point of this frame \[m\].
    pub fn point(&self, p: &V3) -> V3 {
        self.rotation * p + self.origin
    }
}

/// Gradients with respect to points fixed to links, summed per link as a wrench about the base frame's origin.
#[derive(Clone, Copy)]
pub struct LinkWrenches {
    force: [V3; MAX_JOINTS],
    moment: [V3; MAX_JOINTS],
}

impl Default for LinkWrenches {
    fn default() -> LinkWrenches {
        LinkWrenches { force: [V3::zeros(); MAX_JOINTS], moment: [V3::zeros(); MAX_JOINTS] }
    }
}

impl LinkWrenches {
    /// Adds `dF/dx` of a point at `x` in the base frame that is fixed to link `i` (from 0).
    pub fn add(&mut self, i: usize, x: &V3, gradient: &V3) {
        self.force[i] += gradient;
        self.moment[i] += x.cross(gradient);
    }

    /// Adds the gradient with respect to the joints to `out`.
    pub fn backward(&self, arm: &Arm, frames: &[Frame; MAX_JOINTS], out: &mut Gradient) {
        let (mut force, mut moment) = (V3::zeros(), V3::zeros());
        for i in (0..arm.len()).rev() {
            force += self.force[i];
            moment += self.moment[i];
            let z: V3 = frames[i].rotation.column(2).into();
            out.q[i] += match arm.rows[i].kind {
                JointKind::Revolute => z.dot(&(moment - frames[i].origin.cross(&force))),
                JointKind::Prismatic => z.dot(&force),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;
    use plumbline_model::{Placement, regressor};
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Arms of random geometry with revolute and prismatic joints.
    fn arms() -> Vec<Chain> {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut chain = |kinds: &[JointKind]| {
            let joints = kinds.iter().map(|&kind| Joint {
                kind,
                a: rng.random_range(-0.4..0.4),
                alpha: rng.random_range(-1.6..1.6),
                d: rng.random_range(-0.4..0.4),
                theta: rng.random_range(-1.0..1.0),
            });
            let mut flange = Placement::identity();
            flange.origin = V3::new(0.1, -0.2, 0.15);
            Chain::modified(joints.collect(), flange)
        };
        use JointKind::{Prismatic as P, Revolute as R};
        vec![chain(&[R; 7]), chain(&[R, R, P, R, P, R]), chain(&[P, R])]
    }

    fn state(rng: &mut ChaCha8Rng) -> [[f64; MAX_JOINTS]; 3] {
        std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-2.0..2.0)))
    }

    #[test]
    fn rows_agree_with_the_regressor_of_the_model() {
        let gravity = V3::new(3.0, -5.0, 7.0);
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for chain in arms() {
            let (arm, n) = (Arm::new(&chain), chain.len());
            let [q, dq, ddq] = state(&mut rng);
            let mut y = DMatrix::zeros(n, n * LINK_COLUMNS);
            regressor(&chain, &gravity, &q[..n], &dq[..n], &ddq[..n], &mut y);
            let mut tape = Tape::default();
            tape.forward(&arm, &gravity, &q, &dq, &ddq);
            for i in 0..n {
                for j in 0..=i {
                    for (c, value) in tape.row(i, j).into_iter().enumerate() {
                        assert!(
                            (value - y[(j, i * LINK_COLUMNS + c)]).abs() < 1e-12,
                            "link {i}, joint {j}, column {c}"
                        );
                    }
                }
            }
            let mut frames = [Frame::base(); MAX_JOINTS];
            tape.place(n, &mut frames);
            let end = frames[n - 1].point(arm.flange());
            assert!((end - chain.end_effector(&q)).norm() < 1e-12);
        }
    }

    #[test]
    fn the_adjoint_agrees_with_central_differences() {
        let gravity = V3::new(3.0, -5.0, 7.0);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for chain in arms() {
            let (arm, n) = (Arm::new(&chain), chain.len());
            let at = state(&mut rng);
            let bar: [[LinkRow; MAX_JOINTS]; MAX_JOINTS] =
                std::array::from_fn(|_| std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0))));
            let point_gradient: V3 = V3::new(0.3, -0.7, 1.1);
            // F = <bar, Y> + point_gradient . (point of the last link)
            let f = |s: &[[f64; MAX_JOINTS]; 3]| {
                let mut tape = Tape::default();
                tape.forward(&arm, &gravity, &s[0], &s[1], &s[2]);
                let mut frames = [Frame::base(); MAX_JOINTS];
                tape.place(n, &mut frames);
                let pairs = (0..n).flat_map(|i| (0..=i).map(move |j| (i, j)));
                let rows = pairs.map(|(i, j)| tape.row(i, j).iter().zip(&bar[i][j]).map(|(y, z)| y * z).sum::<f64>());
                rows.sum::<f64>() + point_gradient.dot(&frames[n - 1].point(arm.flange()))
            };
            let mut tape = Tape::default();
            tape.forward(&arm, &gravity, &at[0], &at[1], &at[2]);
            let mut frames = [Frame::base(); MAX_JOINTS];
            tape.place(n, &mut frames);
            let mut out = Gradient::default();
            tape.backward(&arm, &bar, &mut out);
            let mut pulls = LinkWrenches::default();
            pulls.add(n - 1, &frames[n - 1].point(arm.flange()), &point_gradient);
            pulls.backward(&arm, &frames, &mut out);
            let h = 1e-5;
            for (kind, found) in [out.q, out.dq, out.ddq].iter().enumerate() {
                for j in 0..n {
                    let (mut up, mut down) = (at, at);
                    up[kind][j] += h;
                    down[kind][j] -= h;
                    let difference = (f(&up) - f(&down)) / (2.0 * h);
                    let scale = difference.abs().max(1.0);
                    assert!((found[j] - difference).abs() < 1e-7 * scale, "{kind} {j}: {} {difference}", found[j]);
                }
            }
        }
    }
}
