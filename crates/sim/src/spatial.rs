//! Spatial (6D) vectors and inertias in the link frames, the simulated arm's own mechanics (Featherstone, Rigid Body Dynamics
//! Algorithms, 2008, chapter 2). Angular part first; everything is about the origin of the frame it is expressed in.

use nalgebra::{Matrix3, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::{Chain, Joint, JointKind, Placement};

/// Velocity or acceleration of a link: angular \[rad/s\] and linear \[m/s\], or per second more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub w: Vector3<f64>,
    pub v: Vector3<f64>,
}

/// Moment \[Nm\] and force \[N\] on a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Force {
    pub n: Vector3<f64>,
    pub f: Vector3<f64>,
}

impl Force {
    pub const ZERO: Force = Force { n: Vector3::new(0.0, 0.0, 0.0), f: Vector3::new(0.0, 0.0, 0.0) };

    /// The same wrench about the parent frame's origin and in its axes.
    pub fn to_parent(self, child: &Placement) -> Force {
        let f = child.rotation * self.f;
        Force { n: child.rotation * self.n + child.origin.cross(&f), f }
    }
}

impl std::ops::AddAssign for Force {
    fn add_assign(&mut self, other: Force) {
        self.n += other.n;
        self.f += other.f;
    }
}

impl Motion {
    /// The same motion at the child frame's origin and in its axes.
    pub fn to_child(self, child: &Placement) -> Motion {
        Motion { w: child.rotation.tr_mul(&self.w), v: child.rotation.tr_mul(&(self.v + self.w.cross(&child.origin))) }
    }

    /// `self x* force`, the rate of change of a momentum that moves along.
    pub fn cross_force(&self, force: &Force) -> Force {
        Force { n: self.w.cross(&force.n) + self.v.cross(&force.f), f: self.w.cross(&force.f) }
    }

    /// `self x (axis * rate)`, the velocity-product acceleration of a joint along z.
    pub fn cross_axis(&self, kind: JointKind, rate: f64) -> Motion {
        let along = |u: &Vector3<f64>| Vector3::new(u.y * rate, -u.x * rate, 0.0);
        match kind {
            JointKind::Revolute => Motion { w: along(&self.w), v: along(&self.v) },
            JointKind::Prismatic => Motion { w: Vector3::zeros(), v: along(&self.w) },
        }
    }

    /// Adds the motion of a joint along z.
    pub fn add_axis(&mut self, kind: JointKind, rate: f64) {
        match kind {
            JointKind::Revolute => self.w.z += rate,
            JointKind::Prismatic => self.v.z += rate,
        }
    }
}

/// A symmetric 6 x 6 inertia in blocks: `n = i w + h v`, `f = h' w + m v`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inertia {
    pub i: Matrix3<f64>,
    pub h: Matrix3<f64>,
    pub m: Matrix3<f64>,
}

impl Inertia {
    /// A rigid body of `mass` \[kg\], centre of mass `com` \[m\], inertia about it \[kg m2\], in the frame's axes.
    pub fn rigid(mass: f64, com: Vector3<f64>, about_com: Matrix3<f64>) -> Inertia {
        let h = mass * com.cross_matrix();
        let steiner = mass * (com.norm_squared() * Matrix3::identity() - com * com.transpose());
        Inertia { i: about_com + steiner, h, m: mass * Matrix3::identity() }
    }

    pub fn times(&self, motion: &Motion) -> Force {
        Force { n: self.i * motion.w + self.h * motion.v, f: self.h.tr_mul(&motion.w) + self.m * motion.v }
    }

    /// The same inertia about the parent frame's origin and in its axes.
    pub fn to_parent(self, child: &Placement) -> Inertia {
        let (r, p) = (&child.rotation, &child.origin);
        let (i, m) = (turned(r, &self.i), turned(r, &self.m));
        let h = r * self.h * r.transpose();
        let h_parent = h + crossed(p, &m);
        // i - h p x + p x h_parent', of which the middle is the transpose of p x h'.
        let i_parent = i + crossed(p, &h.transpose()).transpose() + crossed(p, &h_parent.transpose());
        Inertia { i: i_parent, h: h_parent, m }
    }

    /// `self - u u' / d`: inertia of the body with a free joint.
    pub fn without(&mut self, u: &Force, d: f64) {
        let (n, f) = (u.n / d, u.f / d);
        self.i -= u.n * n.transpose();
        self.h -= u.n * f.transpose();
        self.m -= u.f * f.transpose();
    }
}

/// `r s r'` of a symmetric `s`, one triangle of it worked out.
fn turned(r: &Matrix3<f64>, s: &Matrix3<f64>) -> Matrix3<f64> {
    let half = r * s;
    let at = |row: usize, column: usize| {
        half[(row, 0)] * r[(column, 0)] + half[(row, 1)] * r[(column, 1)] + half[(row, 2)] * r[(column, 2)]
    };
    let (xx, xy, xz, yy, yz, zz) = (at(0, 0), at(0, 1), at(0, 2), at(1, 1), at(1, 2), at(2, 2));
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// `p x` every column of `m`. By elements: nalgebra copies rows that are views through an iterator.
fn crossed(p: &Vector3<f64>, m: &Matrix3<f64>) -> Matrix3<f64> {
    let mut out = Matrix3::zeros();
    for c in 0..3 {
        let (x, y, z) = (m[(0, c)], m[(1, c)], m[(2, c)]);
        out[(0, c)] = p.y * z - p.z * y;
        out[(1, c)] = p.z * x - p.x * z;
        out[(2, c)] = p.x * y - p.y * x;
    }
    out
}

impl std::ops::AddAssign for Inertia {
    fn add_assign(&mut self, other: Inertia) {
        self.i += other.i;
        self.h += other.h;
        self.m += other.m;
    }
}

/// A joint with precomputed constants: `T(q) = T(0) Rz(q)`, or `T(0) Tz(q)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub kind: JointKind,
    rest: Placement,
}

impl Frame {
    pub fn new(joint: &Joint) -> Frame {
        Frame { kind: joint.kind, rest: joint.placement(0.0) }
    }

    pub fn at(&self, q: f64) -> Placement {
        let mut placement = self.rest;
        match self.kind {
            JointKind::Revolute => {
                let (sin, cos) = q.sin_cos();
                for row in 0..3 {
                    let (x, y) = (self.rest.rotation[(row, 0)], self.rest.rotation[(row, 1)]);
                    placement.rotation[(row, 0)] = x * cos + y * sin;
                    placement.rotation[(row, 1)] = y * cos - x * sin;
                }
            }
            JointKind::Prismatic => placement.origin += self.rest.rotation.column(2) * q,
        }
        placement
    }
}

/// The moving bodies of an arm.
#[derive(Clone, Debug)]
pub(super) struct Mechanism {
    pub n: usize,
    pub frames: [Frame; MAX_JOINTS],
    pub links: [Inertia; MAX_JOINTS],
    /// Rotor inertia at the joint \[kg m2\].
    pub armature: JointVec,
}

impl Mechanism {
    /// `links` holds one inertia per joint of `chain`, at most [`MAX_JOINTS`].
    pub fn new(chain: &Chain, links: &[Inertia]) -> Mechanism {
        assert_eq!(chain.len(), links.len(), "one inertia per link");
        let none = Frame { kind: JointKind::Revolute, rest: Placement::identity() };
        let nothing = Inertia { i: Matrix3::zeros(), h: Matrix3::zeros(), m: Matrix3::zeros() };
        let mut mechanism = Mechanism {
            n: chain.len(),
            frames: [none; MAX_JOINTS],
            links: [nothing; MAX_JOINTS],
            armature: [0.0; MAX_JOINTS],
        };
        for (i, (joint, inertia)) in chain.joints().iter().zip(links).enumerate() {
            mechanism.frames[i] = Frame::new(joint);
            mechanism.links[i] = *inertia;
        }
        mechanism
    }
}
