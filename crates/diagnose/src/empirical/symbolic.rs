//! A simple law in the place of a spline of one variable, where one takes nearly all that the spline takes.
//!
//! Each law is fitted by least squares over a grid of its nonlinear parameter. The one with the smallest `n ln S + k ln n + 2 ln N` counts: `S` the
//! square of what is left of `n` rows, `k` parameters, `N` laws with every value of the grid (extended BIC, Chen and Chen 2008).

use super::spline::{Spline, Variables};
use crate::evidence::Evidence;
use crate::fallback::{Course, Variable};
use crate::outcome::{Parameters, Quantity, Symbolic};
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::friction::SHARPNESS;

/// Smallest share of the spline's gain that a law has to reach.
const MIN_GAIN_RATIO: f64 = 0.95;
/// Largest order of a sine, in cycles per turn of the joint: gears have up to some hundred.
const MAX_ORDER: usize = 200;
/// Speeds at which a law bends \[rad/s\], smallest and largest, and how many.
const BENDS: (f64, f64, usize) = (0.01, 2.0, 24);
/// Step of a derivative, as a ratio of the parameter.
const STEP_RATIO: f64 = 1e-4;

/// A law with its parameters.
#[derive(Clone, Copy)]
struct Law {
    kind: Kind,
    /// Order of a sine.
    order: usize,
    /// The speed at which the law bends, or 0.
    bend: f64,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Linear,
    Square,
    Cube,
    Magnitude,
    Sign,
    Sine,
    Saturating,
    Decaying,
}

impl Law {
    /// Linear parts at `x`; the second is used by a sine alone.
    fn parts(self, x: f64) -> [f64; 2] {
        let one = match self.kind {
            Kind::Linear => x,
            Kind::Square => x * x,
            Kind::Cube => x * x * x,
            Kind::Magnitude => x.abs(),
            Kind::Sign => (SHARPNESS * x).tanh(),
            Kind::Sine => (self.order as f64 * x).sin(),
            Kind::Saturating => (x / self.bend).tanh(),
            Kind::Decaying => (-x.abs() / self.bend).exp() * (SHARPNESS * x).tanh(),
        };
        [one, if self.kind == Kind::Sine { (self.order as f64 * x).cos() } else { 0.0 }]
    }

    fn width(self) -> usize {
        if self.kind == Kind::Sine { 2 } else { 1 }
    }

    /// Parameters that are fitted.
    fn count(self) -> usize {
        self.width() + usize::from(self.bend > 0.0)
    }

    /// Its text over a variable, its amplitude `a`.
    fn text(self, x: &str) -> String {
        match self.kind {
            Kind::Linear => format!("a {x}"),
            Kind::Square => format!("a {x}^2"),
            Kind::Cube => format!("a {x}^3"),
            Kind::Magnitude => format!("a |{x}|"),
            Kind::Sign => format!("a sign({x})"),
            Kind::Sine if self.order == 1 => format!("a sin({x} + phi)"),
            Kind::Sine => format!("a sin({} {x} + phi)", self.order),
            Kind::Saturating => format!("a tanh({x} / v)"),
            Kind::Decaying => format!("a exp(-|{x}| / v) sign({x})"),
        }
    }
}

/// Every law of a variable with every value of its nonlinear parameter.
fn laws(variable: Variable) -> Vec<Law> {
    let plain = |kind: Kind| Law { kind, order: 0, bend: 0.0 };
    let mut laws: Vec<Law> = [Kind::Linear, Kind::Square, Kind::Cube, Kind::Magnitude].map(plain).to_vec();
    if matches!(variable, Variable::Velocity(_)) {
        laws.push(plain(Kind::Sign));
        let (low, high, count) = BENDS;
        let bend = |k: usize| low * f64::powf(high / low, k as f64 / (count - 1) as f64);
        let bent = |kind: Kind| (0..count).map(move |k| Law { bend: bend(k), ..plain(kind) });
        laws.extend(bent(Kind::Saturating).chain(bent(Kind::Decaying)));
    } else {
        laws.extend((1..=MAX_ORDER).map(|order| Law { order, ..plain(Kind::Sine) }));
    }
    laws
}

/// The law that takes nearly all of what a spline takes; `None` where none does, and for two variables.
pub fn proposed(
    evidence: &Evidence,
    joint: usize,
    variables: &Variables,
    residual: &DVector<f64>,
    spline: &Spline,
) -> Option<Symbolic> {
    let Variables::One(course) = variables else { return None };
    let laws = laws(course.variable);
    let (rows, tried) = (residual.len() as f64, laws.len() as f64);
    let penalised = |law: &Law| {
        let columns = columns(evidence, joint, course, |x| law.parts(x), law.width());
        let amplitudes = columns.tr_mul(&columns).cholesky()?.solve(&columns.tr_mul(residual));
        let left = (residual - &columns * &amplitudes).norm_squared();
        let score = rows * left.max(f64::MIN_POSITIVE).ln() + law.count() as f64 * rows.ln() + 2.0 * tried.ln();
        Some((score, *law, amplitudes, left))
    };
    let best = laws.iter().filter_map(penalised).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (_, law, amplitudes, left) = best;
    let share = (residual.norm_squared() - left) / spline.gain;
    if share < MIN_GAIN_RATIO {
        return None;
    }
    let variance = left / (rows - law.count() as f64).max(1.0);
    Some(Symbolic {
        law: law.text(&course.variable.to_string()),
        parameters: Parameters(quantities(evidence, joint, course, law, &amplitudes, variance)),
        share: Some(share),
    })
}

/// A law's linear parts in the band, each without its mean over the samples: a constant is no part of it.
fn columns(
    evidence: &Evidence,
    joint: usize,
    course: &Course,
    parts: impl Fn(f64) -> [f64; 2],
    width: usize,
) -> DMatrix<f64> {
    let mut samples: Vec<DMatrix<f64>> =
        course.values.iter().map(|values| DMatrix::from_fn(values.len(), width, |k, c| parts(values[k])[c])).collect();
    let count: f64 = samples.iter().map(|of| of.nrows() as f64).sum();
    for c in 0..width {
        let mean = samples.iter().map(|of| of.column(c).sum()).sum::<f64>() / count;
        samples.iter_mut().for_each(|of| of.column_mut(c).add_scalar_mut(-mean));
    }
    evidence.project(joint, &samples)
}

/// Amplitude, phase and bend with their standard deviations to first order.
fn quantities(
    evidence: &Evidence,
    joint: usize,
    course: &Course,
    law: Law,
    amplitudes: &DVector<f64>,
    variance: f64,
) -> Vec<Quantity> {
    let (names, values, units): (Vec<&str>, Vec<f64>, Vec<String>) = match law.kind {
        Kind::Sine => {
            let [sin, cos] = [amplitudes[0], amplitudes[1]];
            (vec!["a", "phi"], vec![sin.hypot(cos), cos.atan2(sin)], vec!["Nm".into(), "rad".into()])
        }
        _ if law.bend > 0.0 => (vec!["a", "v"], vec![amplitudes[0], law.bend], vec!["Nm".into(), "rad/s".into()]),
        kind => {
            let unit = match kind {
                Kind::Square => "Nm/({})^2",
                Kind::Cube => "Nm/({})^3",
                Kind::Sign => "Nm",
                _ => "Nm/({})",
            };
            (vec!["a"], vec![amplitudes[0]], vec![unit.replace("{}", course.variable.unit())])
        }
    };
    let torque = |values: &[f64], x: f64| match law.kind {
        Kind::Sine => values[0] * (law.order as f64 * x + values[1]).sin(),
        _ if law.bend > 0.0 => values[0] * Law { bend: values[1], ..law }.parts(x)[0],
        _ => values[0] * law.parts(x)[0],
    };
    // Derivative of the torque with respect to each parameter, in the band.
    let derivative = |which: usize| {
        let step = STEP_RATIO * values[which].abs().max(1e-3);
        let moved = |by: f64| {
            let mut moved = values.clone();
            moved[which] += by;
            moved
        };
        let (above, below) = (moved(step), moved(-step));
        let slope = |x: f64| [(torque(&above, x) - torque(&below, x)) / (2.0 * step), 0.0];
        columns(evidence, joint, course, slope, 1).column(0).into_owned()
    };
    let jacobian = DMatrix::from_columns(&(0..values.len()).map(derivative).collect::<Vec<_>>());
    let covariance = (jacobian.transpose() * &jacobian).try_inverse().map(|inverse| inverse * variance);
    let std = |which: usize| covariance.as_ref().map(|of| of[(which, which)].max(0.0).sqrt());
    let quantity = |(which, name): (usize, &&str)| Quantity {
        std: std(which),
        ..Quantity::new(*name, values[which], units[which].clone())
    };
    names.iter().enumerate().map(quantity).collect()
}
