//! Which inertial parameters a body can have: the pseudo-inertia, and the body that belongs to given parameters.
//!
//! A body of density `d(x) >= 0` has `J = integral of [x; 1] [x; 1]' d(x) dx` (4 x 4), so `J` is positive semi-definite, and every positive
//! definite `J` is some body's (Wensing, Kim, Slotine 2018, "Linear matrix inequalities for physically consistent inertial parameter
//! identification"). With `L` about the frame's origin, first moments `l` and mass `m` (paper eq. 5),
//! `J = [[tr(L)/2 - L, l], [l', m]]`: mass positive, moments positive and the triangle inequality, all in one matrix.

use super::chain::Placement;
use super::rnea::LinkParameters;
use nalgebra::{Matrix3, Matrix4, Vector3};
use plumbline_core::symmetric_eigen;

/// A rigid body as drawings and robot descriptions state it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Mass \[kg\].
    pub mass: f64,
    /// Centre of mass in the link's frame \[m\].
    pub com: Vector3<f64>,
    /// Inertia about the centre of mass, in the axes of the link's frame \[kg m2\]; the off-diagonal entries are those of the matrix,
    /// that is, negative products of inertia.
    pub inertia: Matrix3<f64>,
}

/// `J` of standard parameters, 4 x 4. Linear.
pub fn pseudo_inertia(link: &LinkParameters) -> Matrix4<f64> {
    let [xx, xy, xz, yy, yz, zz, lx, ly, lz, m] = *link;
    let (sx, sy, sz) = (0.5 * (yy + zz - xx), 0.5 * (xx + zz - yy), 0.5 * (xx + yy - zz));
    Matrix4::new(
        sx, -xy, -xz, lx, //
        -xy, sy, -yz, ly, //
        -xz, -yz, sz, lz, //
        lx, ly, lz, m,
    )
}

/// The standard parameters of `J`: the inverse of [`pseudo_inertia`]. Only the upper triangle is read.
pub fn link_parameters(j: &Matrix4<f64>) -> LinkParameters {
    let (x, y, z) = (j[(0, 0)], j[(1, 1)], j[(2, 2)]);
    [y + z, -j[(0, 1)], -j[(0, 2)], x + z, -j[(1, 2)], x + y, j[(0, 3)], j[(1, 3)], j[(2, 3)], j[(3, 3)]]
}

/// Whether some body with mass and extent in every direction has these parameters: `J` is positive definite.
pub fn is_consistent(link: &LinkParameters) -> bool {
    link.iter().all(|value| value.is_finite()) && pseudo_inertia(link).cholesky().is_some()
}

impl Body {
    /// The body of standard parameters. The mass must not be zero.
    pub fn of(link: &LinkParameters) -> Body {
        let [xx, xy, xz, yy, yz, zz, lx, ly, lz, mass] = *link;
        let com = Vector3::new(lx, ly, lz) / mass;
        let about_origin = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        Body { mass, com, inertia: about_origin - steiner(mass, &com) }
    }

    /// Its standard parameters.
    pub fn link_parameters(&self) -> LinkParameters {
        let i = self.inertia + steiner(self.mass, &self.com);
        let l = self.mass * self.com;
        [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)], l.x, l.y, l.z, self.mass]
    }

    /// The same body in the parent frame, in which its own frame is at `placement`.
    pub fn seen_from(&self, placement: &Placement) -> Body {
        let r = placement.rotation;
        Body { mass: self.mass, com: r * self.com + placement.origin, inertia: r * self.inertia * r.transpose() }
    }

    /// Two bodies fixed to each other, both in one frame.
    pub fn with(&self, other: &Body) -> Body {
        let (a, b) = (self.link_parameters(), other.link_parameters());
        Body::of(&std::array::from_fn(|k| a[k] + b[k]))
    }

    /// Principal moments \[kg m2\] and axes (columns, a right-handed frame) of the inertia about the centre of mass.
    /// `None` where the inertia is not finite.
    pub fn principal(&self) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let eigen = symmetric_eigen(self.inertia)?;
        let mut axes = eigen.eigenvectors;
        if axes.determinant() < 0.0 {
            axes.column_mut(0).neg_mut();
        }
        Some((eigen.eigenvalues, axes))
    }
}

/// `m (c'c 1 - c c')`, what a point mass at `c` adds to the inertia about the origin.
fn steiner(mass: f64, com: &Vector3<f64>) -> Matrix3<f64> {
    mass * (com.norm_squared() * Matrix3::identity() - com * com.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// A cloud of point masses: the definition itself.
    fn cloud(rng: &mut ChaCha8Rng, points: usize) -> Vec<(f64, Vector3<f64>)> {
        let point = |rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
        (0..points).map(|_| (rng.random_range(0.1..2.0), point(rng))).collect()
    }

    fn parameters(cloud: &[(f64, Vector3<f64>)]) -> LinkParameters {
        let mut sum = [0.0; 10];
        for (mass, at) in cloud {
            let body = Body { mass: *mass, com: *at, inertia: Matrix3::zeros() };
            for (sum, part) in sum.iter_mut().zip(body.link_parameters()) {
                *sum += part;
            }
        }
        sum
    }

    #[test]
    fn the_pseudo_inertia_is_the_second_moment_of_the_mass() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for _ in 0..20 {
            let points = cloud(&mut rng, 6);
            let second = points.iter().fold(Matrix4::zeros(), |sum, (mass, at)| {
                let x = at.push(1.0);
                sum + *mass * x * x.transpose()
            });
            let link = parameters(&points);
            assert!((pseudo_inertia(&link) - second).amax() < 1e-12);
            let back = link_parameters(&pseudo_inertia(&link));
            assert!(link.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
            assert!(is_consistent(&link));
            // Three points lie in a plane: no body with extent.
            let flat = parameters(&points[..3]);
            assert!(pseudo_inertia(&flat).symmetric_eigenvalues().min().abs() < 1e-12);
        }
    }

    #[test]
    fn the_triangle_inequality_is_part_of_it() {
        let body = |inertia: [f64; 3]| {
            let inertia = Matrix3::from_diagonal(&Vector3::from(inertia));
            Body { mass: 2.0, com: Vector3::new(0.1, 0.2, -0.3), inertia }.link_parameters()
        };
        assert!(is_consistent(&body([1.0, 1.0, 1.9])));
        assert!(!is_consistent(&body([1.0, 1.0, 2.1])));
        assert!(!is_consistent(&body([1.0, -0.1, 1.0])));
    }

    #[test]
    fn a_body_survives_its_parameters_a_move_and_its_principal_axes() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let points = cloud(&mut rng, 5);
        let body = Body::of(&parameters(&points));
        let rotation = *nalgebra::Rotation3::from_euler_angles(0.3, -1.2, 2.0).matrix();
        let placement = Placement { rotation, origin: Vector3::new(0.4, -0.1, 0.7) };
        let moved: Vec<_> = points.iter().map(|(m, at)| (*m, rotation * at + placement.origin)).collect();
        let (ours, theirs) = (body.seen_from(&placement).link_parameters(), parameters(&moved));
        assert!(ours.iter().zip(theirs).all(|(a, b)| (a - b).abs() < 1e-12), "{ours:?} {theirs:?}");
        let (moments, axes) = body.principal().unwrap();
        assert!((axes * Matrix3::from_diagonal(&moments) * axes.transpose() - body.inertia).amax() < 1e-13);
        assert!((axes.determinant() - 1.0).abs() < 1e-12);
        let halves = Body::of(&parameters(&points[..2])).with(&Body::of(&parameters(&points[2..])));
        assert!((halves.inertia - body.inertia).amax() < 1e-12 && (halves.com - body.com).amax() < 1e-12);
    }
}
