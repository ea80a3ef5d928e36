//! Cone of consistent parameters: one positive semi-definite 4 x 4 matrix per link and one non-negative number per rotor.
//!
//! Coordinates of a symmetric matrix `X` are `[X00 X11 X22 X33 r X01 r X02 r X03 r X12 r X13 r X23]` with `r = sqrt(2)`, so that the
//! product of two coordinate vectors is `tr(X Y)`. A rotor has one coordinate, the ratio of its inertia to the prior's.

use nalgebra::{DVector, DVectorView, Matrix4, SMatrix, SVector};
use plumbline_core::symmetric_eigen;
use std::f64::consts::SQRT_2;

/// Coordinates of a link.
pub const LINK: usize = 10;
/// Off-diagonal entries in their order.
const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Coordinates of a symmetric matrix.
pub fn coordinates(x: &Matrix4<f64>) -> SVector<f64, LINK> {
    SVector::from_fn(|k, _| if k < 4 { x[(k, k)] } else { SQRT_2 * x[PAIRS[k - 4]] })
}

/// The symmetric matrix of coordinates.
pub fn matrix(v: &[f64]) -> Matrix4<f64> {
    let mut x = Matrix4::zeros();
    for k in 0..4 {
        x[(k, k)] = v[k];
    }
    for (k, &(i, j)) in PAIRS.iter().enumerate() {
        x[(i, j)] = v[k + 4] / SQRT_2;
        x[(j, i)] = x[(i, j)];
    }
    x
}

/// The map `X -> R X R'` in coordinates.
pub fn congruence(r: &Matrix4<f64>) -> SMatrix<f64, LINK, LINK> {
    let mut map = SMatrix::<f64, LINK, LINK>::zeros();
    for k in 0..LINK {
        let mut unit = [0.0; LINK];
        unit[k] = 1.0;
        map.set_column(k, &coordinates(&(r * matrix(&unit) * r.transpose())));
    }
    map
}

/// Numbers of blocks of a cone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// 4 x 4 blocks.
    pub links: usize,
    /// 1 x 1 blocks, after the links.
    pub rotors: usize,
}

impl Shape {
    /// Number of coordinates.
    pub fn len(&self) -> usize {
        LINK * self.links + self.rotors
    }

    /// Order of the cone: the sum of the blocks' orders.
    pub fn order(&self) -> f64 {
        (4 * self.links + self.rotors) as f64
    }

    /// The point whose blocks are identities.
    pub fn identity(&self) -> DVector<f64> {
        DVector::from_fn(self.len(), |k, _| if k >= LINK * self.links || k % LINK < 4 { 1.0 } else { 0.0 })
    }
}

/// Per block a matrix `R`, as the factor of a metric: `T(X) = R X R'`.
pub struct Factor {
    shape: Shape,
    links: Vec<SMatrix<f64, LINK, LINK>>,
    rotors: Vec<f64>,
}

impl Factor {
    /// `T(X)`, or with `transposed` its adjoint `R' X R`, of one point.
    pub fn apply(&self, v: &DVector<f64>, transposed: bool) -> DVector<f64> {
        let mut out = DVector::zeros(v.len());
        for (i, map) in self.links.iter().enumerate() {
            let part = v.fixed_rows::<LINK>(LINK * i);
            out.fixed_rows_mut::<LINK>(LINK * i).copy_from(&if transposed { map.tr_mul(&part) } else { map * part });
        }
        for (k, r) in self.rotors.iter().enumerate() {
            let at = LINK * self.shape.links + k;
            out[at] = r * v[at];
        }
        out
    }

    /// The adjoint of every column of `kt` (coordinates x rows) in place of it.
    pub fn adjoint_columns(&self, kt: &nalgebra::DMatrix<f64>, out: &mut nalgebra::DMatrix<f64>) {
        for (i, map) in self.links.iter().enumerate() {
            let part = kt.fixed_rows::<LINK>(LINK * i);
            out.fixed_rows_mut::<LINK>(LINK * i).gemm_tr(1.0, map, &part, 0.0);
        }
        for (k, r) in self.rotors.iter().enumerate() {
            let at = LINK * self.shape.links + k;
            out.row_mut(at).copy_from(&(kt.row(at) * *r));
        }
    }
}

/// Interior point of the cone with its factorisation.
pub struct Inside {
    shape: Shape,
    /// Lower Cholesky factors and their inverses.
    links: Vec<(Matrix4<f64>, Matrix4<f64>)>,
    rotors: Vec<f64>,
}

impl Inside {
    /// `None` outside the cone.
    pub fn new(shape: Shape, b: &DVector<f64>) -> Option<Inside> {
        let mut links = Vec::with_capacity(shape.links);
        for i in 0..shape.links {
            let l = matrix(link(b, i)).cholesky()?.l();
            links.push((l, l.solve_lower_triangular(&Matrix4::identity())?));
        }
        let own = rotors(shape, b);
        own.iter().all(|&b| b > 0.0).then(|| Inside { shape, links, rotors: own.iter().copied().collect() })
    }

    /// Coordinates of the inverse of every block.
    pub fn inverse(&self) -> DVector<f64> {
        let mut out = DVector::zeros(self.shape.len());
        for (i, (_, inverse)) in self.links.iter().enumerate() {
            out.fixed_rows_mut::<LINK>(LINK * i).copy_from(&coordinates(&inverse.tr_mul(inverse)));
        }
        for (k, b) in self.rotors.iter().enumerate() {
            out[LINK * self.shape.links + k] = 1.0 / b;
        }
        out
    }

    /// Factor of the inverse point: `R R' = B^-1`.
    pub fn inverse_factor(&self) -> Factor {
        Factor {
            shape: self.shape,
            links: self.links.iter().map(|(_, inverse)| congruence(&inverse.transpose())).collect(),
            rotors: self.rotors.iter().map(|b| 1.0 / b).collect(),
        }
    }

    /// Eigenvalues of `B^-1/2 D B^-1/2`, block after block: `B + t D` stays in the cone while `1 + t e > 0` for all of them.
    /// `None` where they are not finite.
    pub fn relative_eigenvalues(&self, d: &DVector<f64>) -> Option<Vec<f64>> {
        let mut all = Vec::with_capacity(self.shape.order() as usize);
        for (i, (_, inverse)) in self.links.iter().enumerate() {
            let relative = inverse * matrix(link(d, i)) * inverse.transpose();
            all.extend(symmetric_eigen(relative)?.eigenvalues.iter());
        }
        all.extend(self.rotors.iter().zip(&rotors(self.shape, d)).map(|(b, d)| d / b));
        Some(all)
    }

    /// The longest step along `d` that stays in the cone; infinite where none leaves it, 0 where `d` is not finite.
    pub fn longest_step(&self, d: &DVector<f64>) -> f64 {
        let Some(eigenvalues) = self.relative_eigenvalues(d) else { return 0.0 };
        let least = eigenvalues.into_iter().fold(0.0, f64::min);
        if least < 0.0 { -1.0 / least } else { f64::INFINITY }
    }

    /// The Nesterov-Todd scaling of this point and `z`; `None` where they are not finite.
    pub fn scaling(&self, z: &DVector<f64>) -> Option<Scaling> {
        let mut links = Vec::with_capacity(self.links.len());
        let mut scaled = Vec::with_capacity(self.shape.order() as usize);
        for (i, (l, _)) in self.links.iter().enumerate() {
            let eigen = symmetric_eigen(l.tr_mul(&matrix(link(z, i))) * l)?;
            let squared = eigen.eigenvalues.map(|e| e.max(f64::MIN_POSITIVE));
            let root = Matrix4::from_diagonal(&squared.map(|e| e.powf(-0.25)));
            links.push(congruence(&(l * eigen.eigenvectors * root)));
            scaled.extend(squared.iter().map(|e| e.sqrt()));
        }
        let z = rotors(self.shape, z);
        scaled.extend(self.rotors.iter().zip(&z).map(|(b, z)| (b * z).sqrt()));
        let rotors = self.rotors.iter().zip(&z).map(|(b, z)| (b / z).sqrt()).collect();
        Some(Scaling { factor: Factor { shape: self.shape, links, rotors }, scaled })
    }
}

/// Nesterov-Todd scaling of a point `B` and a dual point `Z`: `R` with `R^-1 B R^-T = R' Z R`, which is diagonal; `W = R R'` has
/// `W Z W = B`.
pub struct Scaling {
    /// `T(X) = R X R'`.
    pub factor: Factor,
    /// The diagonals that both scaled points are, block after block.
    scaled: Vec<f64>,
}

impl Scaling {
    /// `X` with `(D X + X D)/2 = (P Q + Q P)/2` for the diagonal `D` of the scaled points: the second-order part of a step (Mehrotra).
    pub fn second_order(&self, p: &DVector<f64>, q: &DVector<f64>) -> DVector<f64> {
        let shape = self.factor.shape;
        let mut out = DVector::zeros(shape.len());
        for i in 0..shape.links {
            let (p, q, d) = (matrix(link(p, i)), matrix(link(q, i)), &self.scaled[4 * i..]);
            let product = p * q;
            let x = Matrix4::from_fn(|r, c| (product[(r, c)] + product[(c, r)]) / (d[r] + d[c]));
            out.fixed_rows_mut::<LINK>(LINK * i).copy_from(&coordinates(&x));
        }
        for k in 0..shape.rotors {
            let at = LINK * shape.links + k;
            out[at] = p[at] * q[at] / self.scaled[4 * shape.links + k];
        }
        out
    }
}

fn link(v: &DVector<f64>, i: usize) -> &[f64] {
    &v.as_slice()[LINK * i..LINK * (i + 1)]
}

fn rotors(shape: Shape, v: &DVector<f64>) -> DVectorView<'_, f64> {
    v.rows(LINK * shape.links, shape.rotors)
}
