//! A spline with a penalty on its differences (Eilers and Marx, Statistical Science 11, 1996), fitted to a joint's residual `r`.
//!
//! The coefficients minimise `|r - C c|^2 + lambda c' P c` in units of the noise. `C` are the functions of the learned term
//! ([`plumbline_model::term::empirical`]) in the band, `P` the squares of the second differences along each variable. `lambda` is the weight with
//! which trajectories or blocks that were left out are predicted best. As a Gaussian prior the penalty gives the covariance
//! `s^2 (C'C + lambda P)^-1`, with `s^2` the mean square of what is left.
//!
//! A constant is no part of it: an offset is a named effect. The mean of the splines over the samples is taken off them, and given back to the
//! coefficients, for the splines sum to one.

use crate::evidence::Evidence;
use crate::fallback::{Course, Part, Variable, gained, parts, products};
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::term::empirical::{COARSE, FAMILY, FINE, Follows, bound, follows};

/// Weights of the penalty that are tried, as ratios of the mean square of a function.
const WEIGHTS: [f64; 6] = [1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0];
/// Weight of the coefficients' own squares in the penalty: what no sample shows is small.
const RIDGE_RATIO: f64 = 1e-3;
/// Largest value over the samples from which on a function was seen.
const SEEN: f64 = 0.1;

/// The variables of a learned term, in the order of its form.
pub enum Variables<'c> {
    /// One.
    One(&'c Course),
    /// Two.
    Two(&'c Course, &'c Course),
}

impl<'c> Variables<'c> {
    /// Of the screening; `None` where one is neither position nor velocity.
    pub fn of(variables: &[Variable], courses: &'c [Course]) -> Option<Variables<'c>> {
        let course = |variable: &Variable| {
            let served = matches!(variable, Variable::Position(_) | Variable::Velocity(_));
            courses.iter().find(|course| served && course.variable == *variable)
        };
        match variables {
            [one] => Some(Variables::One(course(one)?)),
            [first, second] => {
                let (first, second) = (course(first)?, course(second)?);
                let place = |course: &Course| (course.axis().follows == Follows::Velocity, course.variable.joint());
                Some(if place(first) < place(second) {
                    Variables::Two(first, second)
                } else {
                    Variables::Two(second, first)
                })
            }
            _ => None,
        }
    }

    fn courses(&self) -> Vec<&'c Course> {
        match *self {
            Variables::One(course) => vec![course],
            Variables::Two(first, second) => vec![first, second],
        }
    }

    /// `q4`, `dq2`.
    pub fn names(&self) -> Vec<String> {
        self.courses().iter().map(|course| course.variable.to_string()).collect()
    }

    /// The term that follows them in a joint's row.
    pub fn spec(&self, row: usize) -> Spec {
        let courses = self.courses();
        let kinds: Vec<Follows> = courses.iter().map(|course| course.axis().follows).collect();
        let form = FAMILY.forms.iter().map(|form| form.name).find(|form| {
            let (first, second) = follows(form);
            [first].into_iter().chain(second).eq(kinds.iter().copied())
        });
        let joint = |which: usize| courses.get(which).and_then(|course| course.variable.joint());
        let first = joint(0).unwrap_or(row);
        let settings = courses.iter().flat_map(|course| [course.axis().middle, course.axis().reach]);
        Spec {
            family: FAMILY.id,
            form: form.unwrap_or_default(),
            site: Site::Function { row, of: [first, joint(1).unwrap_or(first)] },
            settings: settings.collect(),
        }
    }

    /// Its functions at the samples of each motion.
    fn functions(&self) -> Vec<DMatrix<f64>> {
        match self {
            Variables::One(course) => course.functions(),
            Variables::Two(first, second) => products(&first.coarse(), &second.coarse()),
        }
    }

    /// Which functions are products of splines; they sum to one.
    fn splines(&self) -> Vec<bool> {
        let of = |course: &Course, count: usize| -> Vec<bool> {
            (0..count).map(|k| k < course.axis().splines(count)).collect()
        };
        match self {
            Variables::One(course) => of(course, FINE),
            Variables::Two(first, second) => {
                let second = of(second, COARSE);
                of(first, COARSE).iter().flat_map(|one| second.iter().map(move |other| *one && *other)).collect()
            }
        }
    }

    /// Squares of the second differences along each variable, with a small ridge.
    fn penalty(&self) -> DMatrix<f64> {
        let along = |course: &Course, count: usize| {
            let splines = course.axis().splines(count);
            let differences = DMatrix::from_fn(splines.saturating_sub(2), count, |row, c| match c.wrapping_sub(row) {
                0 | 2 => 1.0,
                1 => -2.0,
                _ => 0.0,
            });
            differences.transpose() * differences
        };
        let rough = match self {
            Variables::One(course) => along(course, FINE),
            Variables::Two(first, second) => {
                let one = DMatrix::identity(COARSE, COARSE);
                along(first, COARSE).kronecker(&one) + one.kronecker(&along(second, COARSE))
            }
        };
        let ridge = DMatrix::identity(rough.nrows(), rough.nrows()) * RIDGE_RATIO;
        rough + ridge
    }
}

/// Every product of two variables' functions.
pub fn product(first: [f64; COARSE], second: [f64; COARSE]) -> [f64; COARSE * COARSE] {
    std::array::from_fn(|k| first[k / COARSE] * second[k % COARSE])
}

/// A fitted spline.
pub struct Spline {
    /// Its coefficients \[Nm\].
    pub coefficients: DVector<f64>,
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of their variance.
    pub freedom: f64,
    /// Share of the residual's square that it predicts where it was not fitted, R2.
    pub share: f64,
    /// Low end of the 95 % interval of that share, by its scatter over what was left out in turn.
    pub surely: f64,
    /// Largest torque in any state \[Nm\].
    pub cap: f64,
    /// Decrease of the residual's square.
    pub gain: f64,
}

impl Spline {
    /// Of a joint's residual over some variables, no torque above `limit` \[Nm\]; `None` where nothing can be fitted.
    pub fn fit(
        evidence: &Evidence,
        joint: usize,
        variables: &Variables,
        residual: &DVector<f64>,
        limit: f64,
    ) -> Option<Spline> {
        let functions = variables.functions();
        let centred = centring(&functions, &variables.splines());
        let columns = evidence.project(joint, &functions);
        let own = &columns * &centred;
        let column = DMatrix::from_columns(std::slice::from_ref(residual));
        let rest = parts(evidence, &column);
        let each: Vec<Part> = parts(evidence, &own).iter().zip(&rest).map(|(c, r)| Part::of(c, r)).collect();
        let whole = Part::whole(&each);
        let penalty = variables.penalty();
        let scale = whole.g.trace() / penalty.trace();
        let total: f64 = rest.iter().map(|r| r.norm_squared()).sum();
        // What each part loses where it was left out of the fit.
        let left_out = |weight: f64| {
            let penalty = &penalty * (weight * scale);
            let gains = each.iter().map(|part| Some(gained(&whole, part, &penalty)?[0]));
            Some((weight, gains.collect::<Option<Vec<f64>>>()?))
        };
        let sum = |gains: &[f64]| -> f64 { gains.iter().sum() };
        let (weight, gains) =
            WEIGHTS.into_iter().filter_map(left_out).max_by(|(_, a), (_, b)| sum(a).total_cmp(&sum(b)))?;

        let all = Part::of(&own, &column);
        let scale = all.g.trace() / penalty.trace();
        let inverse = (&all.g + &penalty * (weight * scale)).cholesky()?.inverse();
        let freedom = (own.nrows() as f64 - (&inverse * &all.g).trace()).max(1.0);
        let mut coefficients = &centred * (&inverse * all.b.column(0));
        let form = variables.spec(joint).form;
        bounded(&mut coefficients, &functions, form, limit);
        let left = (residual - &columns * &coefficients).norm_squared();
        let variance = left / freedom;
        let covariance = &centred * inverse * centred.transpose() * variance;
        let mean = sum(&gains) / gains.len() as f64;
        let scatter = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (gains.len().max(2) - 1) as f64;
        Some(Spline {
            cap: bound(form, coefficients.as_slice()),
            // Symmetric to the last bit.
            covariance: (&covariance + covariance.transpose()) * 0.5,
            coefficients,
            freedom,
            share: sum(&gains) / total,
            surely: (sum(&gains) - 1.96 * (gains.len() as f64 * scatter).sqrt()) / total,
            gain: residual.norm_squared() - left,
        })
    }

    /// Torque where the functions have these values, and its standard deviation \[Nm\].
    pub fn at(&self, functions: &[f64]) -> [f64; 2] {
        let row = DVector::from_column_slice(functions);
        [row.dot(&self.coefficients), (&self.covariance * &row).dot(&row).max(0.0).sqrt()]
    }
}

/// `c = T g`: coefficients without the mean over the samples. The splines sum to one, so the mean is taken off all of their coefficients.
fn centring(functions: &[DMatrix<f64>], splines: &[bool]) -> DMatrix<f64> {
    let samples: f64 = functions.iter().map(|of| of.nrows() as f64).sum();
    let mean = |c: usize| functions.iter().map(|of| of.column(c).sum()).sum::<f64>() / samples;
    let means: Vec<f64> = (0..splines.len()).map(|c| if splines[c] { mean(c) } else { 0.0 }).collect();
    DMatrix::from_fn(splines.len(), splines.len(), |row, c| {
        let own = if row == c { 1.0 } else { 0.0 };
        if splines[row] { own - means[c] } else { own }
    })
}

/// Coefficients of functions that no sample has seen are at most the largest of those that one has; all together make at most `limit`.
fn bounded(coefficients: &mut DVector<f64>, functions: &[DMatrix<f64>], form: &str, limit: f64) {
    let seen = |c: usize| functions.iter().any(|of| of.column(c).amax() >= SEEN);
    let largest = (0..coefficients.len()).filter(|&c| seen(c)).map(|c| coefficients[c].abs()).fold(0.0, f64::max);
    coefficients.iter_mut().for_each(|value| *value = value.clamp(-largest, largest));
    let most = bound(form, coefficients.as_slice());
    if most > limit {
        *coefficients *= limit / most;
    }
}
