//! The two convex problems of consistency, in coordinates in which the prior is the identity.
//!
//! Exact: the point `B` of the cone with `K B = t` that is nearest to the prior in the entropic (log-det) divergence
//! `D(B) = tr B - log det B - order` (Lee, Park 2018, "A geometric algorithm for robust multibody inertial parameter
//! identification"). Its dual `min_nu -log det(I - A(nu)) - nu' t` with `A(nu)` the matrices of `K' nu` is unconstrained and
//! self-concordant: a damped Newton method with an exact line search, from `nu = 0`, which is the prior itself.
//!
//! Nearest: `min 1/2 r' C^-1 r` with `r = t - K B` over the cone, by the primal-dual interior-point method with Nesterov-Todd
//! scaling and Mehrotra's second order (Vandenberghe 2010, "The CVXOPT linear and quadratic cone program solvers"). Its central path
//! `min 1/2 r' C^-1 r + mu D(B)` leads, as `mu` becomes small, to the nearest point, and among several of those to one the prior
//! prefers. `C` is never inverted: with the multiplier `y`, `r = C y`.

use super::cone::{Inside, Shape};
use nalgebra::{Cholesky, DMatrix, DVector};

/// The data of both problems.
pub struct Problem {
    /// Blocks of the cone.
    pub shape: Shape,
    /// `K'`, coordinates x rows.
    pub kt: DMatrix<f64>,
    /// `C`, rows x rows.
    pub c: DMatrix<f64>,
    /// `t`, rows.
    pub target: DVector<f64>,
}

/// Newton decrement at which the exact problem is solved: the next step changes the point by less than rounding does.
const DECREMENT: f64 = 1e-9;
const MAX_NEAREST_STEPS: usize = 60;
/// Weight at which the barrier stays, as a bound on what is left to gain on `r' C^-1 r / 2`, relative to 1 + its value. It is not
/// smaller, because for some estimates the infimum is not attained: ever heavier bodies come ever nearer. The last hundredth of a
/// standard deviation does not justify a mass of tonnes.
pub const GAP: f64 = 1e-4;
/// Bound on the equations left open, in standard deviations, relative to 1 + the distance.
const OPEN: f64 = 1e-7;
/// Maximum relative distance of the last point from the central path.
const CENTRED: f64 = 0.1;
/// Maximum ratio of a step to the distance to the cone's boundary.
const BACK_OFF: f64 = 0.95;

/// The exact problem: its solution and the Newton steps it took, or the steps after which it was given up, `most` or less.
pub fn exact(problem: &Problem, most: usize) -> Result<(DVector<f64>, usize), usize> {
    let Problem { shape, kt, target, .. } = problem;
    let mut s = shape.identity();
    let mut z = kt.clone();
    for iterations in 1..=most {
        let Some(inside) = Inside::new(*shape, &s) else { return Err(iterations) };
        let b = inside.inverse();
        let (rest, hessian) = dual_derivatives(problem, &inside, &b, &mut z);
        let Some(system) = Cholesky::new(hessian) else { return Err(iterations) };
        let d_nu = system.solve(&rest);
        let decrement = d_nu.dot(&rest).max(0.0).sqrt();
        let d_s = -(kt * &d_nu);
        if decrement < DECREMENT {
            return Ok((b, iterations));
        }
        let eigenvalues = inside.relative_eigenvalues(&d_s).ok_or(iterations)?;
        let Some(step) = line_search(&eigenvalues, d_nu.dot(target)) else {
            return Err(iterations);
        };
        s.axpy(step, &d_s, 1.0);
    }
    Err(most)
}

/// Negative gradient `t - K B` and Hessian `K (B x B) K'` of the dual at `B^-1`, which is `inside`; `z` is room for scaled columns.
fn dual_derivatives(
    problem: &Problem,
    inside: &Inside,
    b: &DVector<f64>,
    z: &mut DMatrix<f64>,
) -> (DVector<f64>, DMatrix<f64>) {
    inside.inverse_factor().adjoint_columns(&problem.kt, z);
    (&problem.target - problem.kt.tr_mul(b), gram(z))
}

/// Minimises `-sum log(1 + a e) - a slope` over the steps `a >= 0` that stay in the cone, slope negative at 0. `None` where it is unbounded
/// below: then no point of the cone meets the target (Farkas).
fn line_search(e: &[f64], slope: f64) -> Option<f64> {
    let derivative = |a: f64| -e.iter().map(|e| e / (1.0 + a * e)).sum::<f64>() - slope;
    let curvature = |a: f64| e.iter().map(|e| (e / (1.0 + a * e)).powi(2)).sum::<f64>();
    let least = e.iter().copied().fold(0.0, f64::min);
    let mut high = if least < 0.0 { -1.0 / least } else { f64::INFINITY };
    if high.is_infinite() && slope >= 0.0 {
        return None;
    }
    let mut low = 0.0;
    let mut a = 1f64.min(0.5 * high);
    for _ in 0..40 {
        let at = derivative(a);
        if at < 0.0 {
            low = a;
        } else {
            high = a;
        }
        let newton = a - at / curvature(a);
        if (newton - a).abs() < 1e-3 * a {
            return Some(a);
        }
        let middle = if high.is_finite() { 0.5 * (low + high) } else { 2.0 * a };
        a = if newton > low && newton < high { newton } else { middle };
    }
    Some(low)
}

/// The nearest point, its multiplier `y` (`C y = t - K B`), and the steps it took. `None` where it does not converge, which has not
/// been observed with finite values.
pub fn nearest(problem: &Problem) -> Option<(DVector<f64>, DVector<f64>, usize)> {
    let Problem { shape, kt, c, target } = problem;
    let identity = shape.identity();
    let order = shape.order();
    let mut b = identity.clone();
    let mut y = DVector::zeros(target.len());
    // Initial barrier weight: of the size of the prior's residual.
    let residual = target - kt.tr_mul(&b);
    let weighed = residual.iter().enumerate().map(|(r, value)| value * value / c[(r, r)]).sum::<f64>();
    // The barrier's weight: `z = mu I - K' y` all along, and `B Z = mu I` but for the steps' curvature.
    let mut mu = (weighed / order).max(1.0);
    let mut z = &identity * mu;
    let mut scaled = kt.clone();
    for iterations in 1..=MAX_NEAREST_STEPS {
        let inside = Inside::new(*shape, &b)?;
        let dual = Inside::new(*shape, &z)?;
        let open = target - kt.tr_mul(&b) - c * &y;
        let distance = y.dot(&(c * &y));
        let least = GAP * (1.0 + 0.5 * distance) / order;
        let off = (b.dot(&z) / (order * mu) - 1.0).abs();
        if mu <= 1.01 * least && off < CENTRED && open.norm() < OPEN * (1.0 + distance.sqrt()) {
            return Some((b, y, iterations));
        }
        let scaling = inside.scaling(&z)?;
        let factor = &scaling.factor;
        factor.adjoint_columns(kt, &mut scaled);
        let system = Cholesky::new(gram(&scaled) + c)?;
        // In scaled coordinates dB = K' dy + u with u = K' y + mu (B^-1 - I) for a barrier of weight mu: in steps of y, so that rounding
        // is one of the step and not of y itself.
        let pull = factor.apply(&(kt * &y), true);
        let centring = factor.apply(&(inside.inverse() - &identity), true);
        let direction = |mu: f64, second_order: Option<&DVector<f64>>| {
            let mut u = &pull + &centring * mu;
            if let Some(second_order) = second_order {
                u -= second_order;
            }
            let d_y = system.solve(&(&open - scaled.tr_mul(&u)));
            let d_b = &scaled * &d_y + u;
            let d_z = &identity * mu - kt * (&y + &d_y) - &z;
            (d_y, d_b, d_z)
        };
        let step = |d_b: &DVector<f64>, d_z: &DVector<f64>| {
            (BACK_OFF * inside.longest_step(d_b).min(dual.longest_step(d_z))).min(1.0)
        };

        // Predictor: the progress of a step without a barrier determines the barrier weight of the corrector.
        let (_, scaled_d_b, d_z) = direction(0.0, None);
        let d_b = factor.apply(&scaled_d_b, false);
        let a = step(&d_b, &d_z);
        let ahead = (&b + &d_b * a).dot(&(&z + &d_z * a)) / order;
        let weight = (mu * (ahead / b.dot(&z) * order).clamp(0.0, 1.0).powi(3)).max(least);
        // Corrector: the second-order term is scaled by the square of the ratio by which the barrier is lowered.
        let share = 1.0 - (weight / mu).min(1.0);
        let second_order = scaling.second_order(&scaled_d_b, &factor.apply(&d_z, true)) * (share * share);
        let (d_y, scaled_d_b, d_z) = direction(weight, Some(&second_order));
        let d_b = factor.apply(&scaled_d_b, false);
        let a = step(&d_b, &d_z);
        b.axpy(a, &d_b, 1.0);
        z.axpy(a, &d_z, 1.0);
        y.axpy(a, &d_y, 1.0);
        mu += a * (weight - mu);
    }
    None
}

/// `Z' Z` for Z = `z`, coordinates x rows.
fn gram(z: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(z.ncols(), z.ncols());
    product.gemm(1.0, &z.transpose(), z, 0.0);
    product
}

#[cfg(test)]
mod tests {
    use super::super::cone::{LINK, coordinates, matrix};
    use super::*;
    use nalgebra::Matrix4;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    fn normal(rng: &mut ChaCha8Rng, rows: usize, columns: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, columns, |_, _| rng.sample(StandardNormal))
    }

    /// A problem whose target belongs to a point `spread` away from the prior: inside the cone when small, mostly outside when large.
    fn problem(rng: &mut ChaCha8Rng, links: usize, rotors: usize, rows: usize, spread: f64) -> Problem {
        let shape = Shape { links, rotors };
        let kt = normal(rng, shape.len(), rows);
        let mix = DMatrix::identity(rows, rows) + normal(rng, rows, rows) * (0.5 / (rows as f64).sqrt());
        let point = shape.identity() + normal(rng, shape.len(), 1).column(0) * spread;
        Problem { shape, c: &mix * mix.transpose(), target: kt.tr_mul(&point), kt }
    }

    /// `-log det S - nu' t` by determinants.
    fn dual(problem: &Problem, nu: &DVector<f64>) -> f64 {
        let s = problem.shape.identity() - &problem.kt * nu;
        let links =
            (0..problem.shape.links).map(|i| matrix(&s.as_slice()[LINK * i..LINK * (i + 1)]).determinant().ln());
        let rotors = s.iter().skip(LINK * problem.shape.links).map(|s| s.ln());
        -links.chain(rotors).sum::<f64>() - nu.dot(&problem.target)
    }

    #[test]
    fn gradient_and_hessian_agree_with_differences() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let problem = problem(&mut rng, 2, 1, 9, 0.1);
        let nu = normal(&mut rng, 9, 1).column(0) * 0.02;
        let s = problem.shape.identity() - &problem.kt * &nu;
        let inside = Inside::new(problem.shape, &s).unwrap();
        let (rest, hessian) = dual_derivatives(&problem, &inside, &inside.inverse(), &mut problem.kt.clone());
        let h = 1e-4;
        let at = |steps: &[(usize, f64)]| {
            let mut nu = nu.clone();
            for (k, step) in steps {
                nu[*k] += step;
            }
            dual(&problem, &nu)
        };
        for i in 0..9 {
            let slope = (at(&[(i, h)]) - at(&[(i, -h)])) / (2.0 * h);
            assert!((slope + rest[i]).abs() < 1e-5 * (1.0 + slope.abs()), "{i}: {slope} {}", rest[i]);
            for k in 0..9 {
                let both = |a, b| at(&[(i, a), (k, b)]);
                let curve = (both(h, h) - both(h, -h) - both(-h, h) + both(-h, -h)) / (4.0 * h * h);
                assert!((curve - hessian[(i, k)]).abs() < 1e-4 * hessian.amax(), "{i} {k}: {curve}");
            }
        }
    }

    #[test]
    fn the_exact_point_is_stationary_in_the_divergence() {
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        let problem = problem(&mut rng, 3, 2, 20, 0.15);
        let (b, _) = exact(&problem, 30).expect("inside the cone");
        assert!((&problem.target - problem.kt.tr_mul(&b)).amax() < 1e-9);
        // The gradient I - B^-1 is a combination of the equations: nothing of it is left across them.
        let gradient = problem.shape.identity() - Inside::new(problem.shape, &b).unwrap().inverse();
        let nu = problem.kt.clone().svd(true, true).solve(&gradient, 1e-12).unwrap();
        assert!((gradient - &problem.kt * nu).amax() < 1e-8);
    }

    /// The optimality conditions themselves, at 30 random problems: `-K'y` in the cone, `B` in the cone, their product zero, `C y` what
    /// is left.
    #[test]
    fn the_nearest_point_meets_the_optimality_conditions() {
        let mut rng = ChaCha8Rng::seed_from_u64(13);
        let mut moved = 0;
        for round in 0..30 {
            let problem = problem(&mut rng, 1 + round % 7, round % 3, 7 * (1 + round % 7), 1.5);
            let found = exact(&problem, 60);
            let (b, y, _) = nearest(&problem).expect("converges");
            let distance = y.dot(&(&problem.c * &y)).sqrt();
            assert!(found.is_err() || distance < 0.05, "round {round}: {distance}");
            moved += usize::from(found.is_err());
            let open = &problem.target - problem.kt.tr_mul(&b) - &problem.c * &y;
            assert!(open.norm() < 1e-6 * (1.0 + distance), "round {round}: {}", open.norm());
            // Up to the barrier that is left.
            let mu = GAP * (1.0 + 0.5 * distance * distance) / problem.shape.order();
            let z = problem.shape.identity() * (1.1 * mu) - &problem.kt * &y;
            assert!(Inside::new(problem.shape, &z).is_some(), "round {round}: a nearer body exists");
            let product = b.dot(&z) / problem.shape.order();
            assert!(product < 2.0 * mu * (1.0 + b.amax()), "round {round}: {product} {mu}");
        }
        assert!(moved > 10, "{moved} of 30");
    }

    #[test]
    fn the_scaling_maps_both_points_to_one_diagonal() {
        let mut rng = ChaCha8Rng::seed_from_u64(14);
        let shape = Shape { links: 1, rotors: 1 };
        let mut point = || {
            let m = Matrix4::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
            let link = coordinates(&(m * m.transpose() + Matrix4::identity() * 0.1));
            DVector::from_iterator(11, link.iter().copied().chain([rng.random_range(0.1..3.0)]))
        };
        let (b, z, p, q) = (point(), point(), point(), point());
        let scaling = Inside::new(shape, &b).unwrap().scaling(&z).unwrap();
        let scaled = scaling.factor.apply(&z, true);
        assert!((scaling.factor.apply(&scaled, false) - &b).amax() < 1e-10, "W Z W = B");
        let d = matrix(scaled.as_slice());
        assert!((d - Matrix4::from_diagonal(&d.diagonal())).amax() < 1e-10);
        let x = scaling.second_order(&p, &q);
        let [x4, p4, q4] = [&x, &p, &q].map(|v| matrix(v.as_slice()));
        assert!((d * x4 + x4 * d - p4 * q4 - q4 * p4).amax() < 1e-9);
        assert!((scaled[10] * x[10] - p[10] * q[10]).abs() < 1e-12);
    }
}
