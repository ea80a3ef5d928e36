//! A learned torque without a name: a smooth function of one or two joint variables, fitted to what all other terms leave.
//!
//! `tau_j = w(x) sum_s c_s B_s(x)` of one variable, `tau_j = w(x) w(y) sum_st c_st B_s(x) B_t(y)` of two. `B_s` are uniform B-splines over the
//! domain, `middle - reach` to `middle + reach`, cubic for one variable and quadratic for two (de Boor, A Practical Guide to Splines, 1978).
//! The last function of a velocity is `tanh(100 dq)` instead.
//!
//! The splines are not negative and sum to one, so the torque is bounded by the coefficients in every state ([`bound`]). Outside the domain the
//! value at its end fades to zero within a tenth of the domain's width (`w`): nothing was learned there, and the model of named effects
//! remains, without a step.

use super::family::*;
use super::one_row::{smooth_sign, unit};
use super::{Column, FixedTerm, Motion, Sample};
use crate::chain::Chain;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::fmt;

/// Functions of a single variable.
pub const FINE: usize = 10;
/// Functions of each of two variables.
pub const COARSE: usize = 5;
/// Degree of the splines of a single variable.
const FINE_DEGREE: usize = 3;
/// Degree of the splines of each of two.
const COARSE_DEGREE: usize = 2;
/// Distance beyond the domain at which the torque has faded to zero, as a ratio of `reach`.
const FADE_RATIO: f64 = 0.2;

macro_rules! form {
    ($name:literal, $equation:literal, $settings:expr, $over:ident) => {
        Form {
            name: $name,
            equation: $equation,
            settings: $settings,
            build: |operating_point, site, settings| Arc::new(Empirical::new($name, operating_point, site, settings)),
            in_c: InC::Columns(|at, settings| in_c($name, at, settings)),
            plot_over: PlotOver::$over,
        }
    };
}

/// A smooth function of the motion, learned from what is left over.
pub static FAMILY: Family = Family {
    id: "empirical",
    physics: "Unknown: a smooth function of one or two joint variables takes a part of what no named effect explains.",
    place: Place::Function,
    forms: &[
        form!("q", "tau_j = sum_s c_s B_s(q_k; middle, reach)", &[MIDDLE, REACH], Position),
        form!("dq", "tau_j = sum_s c_s B_s(dq_k; middle, reach)", &[MIDDLE, REACH], Velocity),
        form!("q-q", "tau_j = sum_st c_st B_s(q_k; middle, reach) B_t(q_l; middle2, reach2)", &PAIR, Nothing),
        form!("q-dq", "tau_j = sum_st c_st B_s(q_k; middle, reach) B_t(dq_l; middle2, reach2)", &PAIR, Nothing),
        form!("dq-dq", "tau_j = sum_st c_st B_s(dq_k; middle, reach) B_t(dq_l; middle2, reach2)", &PAIR, Nothing),
    ],
    stratum: Stratum::Remainder,
    typical: "at most what was fitted, and a fifth of the joint's highest torque",
    confounded: &[confounded(
        "the effect that has no name yet",
        "the experiment that the diagnosis proposes for the joint",
    )],
    reference: "Eilers, Marx, Statistical Science 11 (1996): splines with a penalty on differences",
    rare: Rare { fits, ..Rare::NONE },
};

const MIDDLE: Setting = Setting {
    name: "middle",
    unit: "rad or rad/s",
    what: "middle of the domain of the first variable",
    low: -100.0,
    high: 100.0,
    steps: 1,
    scale: Scale::Linear,
};
const REACH: Setting = Setting {
    name: "reach",
    unit: "rad or rad/s",
    what: "half the width of that domain",
    low: 1e-4,
    high: 100.0,
    steps: 1,
    scale: Scale::Logarithmic,
};
const PAIR: [Setting; 4] = [
    MIDDLE,
    REACH,
    Setting { name: "middle2", what: "middle of the domain of the second variable", ..MIDDLE },
    Setting { name: "reach2", what: "half the width of that domain", ..REACH },
];

/// Kind of a variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Follows {
    /// Position.
    Position,
    /// Velocity.
    Velocity,
}

impl fmt::Display for Follows {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Follows::Position => "q",
            Follows::Velocity => "dq",
        })
    }
}

/// Kinds of the variables of a form.
pub fn follows(form: &str) -> (Follows, Option<Follows>) {
    use Follows::{Position, Velocity};
    match form {
        "dq" => (Velocity, None),
        "q-q" => (Position, Some(Position)),
        "q-dq" => (Position, Some(Velocity)),
        "dq-dq" => (Velocity, Some(Velocity)),
        _ => (Position, None),
    }
}

/// Whether a form can be at a site: a form of one variable follows one joint, and no form two equal variables.
fn fits(form: &str, site: Site) -> bool {
    let Site::Function { of: [first, second], .. } = site else { return false };
    match follows(form) {
        (_, None) => first == second,
        // The order is fixed, so that one function has one name.
        (one, Some(other)) if one == other => first < second,
        _ => true,
    }
}

/// Largest torque that coefficients of a form can make \[Nm\]: that of the largest coefficient, and of the largest one of each kind of sign.
pub fn bound(form: &str, coefficients: &[f64]) -> f64 {
    let largest = |of: &mut dyn Iterator<Item = &f64>| of.fold(0.0, |most: f64, value| most.max(value.abs()));
    let (first, second) = follows(form);
    let splines = |kind: Follows, count: usize| count - usize::from(kind == Follows::Velocity);
    let Some(second) = second else {
        let (splines, sign) = coefficients.split_at(splines(first, FINE).min(coefficients.len()));
        return largest(&mut splines.iter()) + largest(&mut sign.iter());
    };
    let (rows, columns) = (splines(first, COARSE), splines(second, COARSE));
    // Splines of both variables; the sign of one times the other's splines; both signs.
    let part = |row: bool, column: bool| {
        let own = |&(k, _): &(usize, &f64)| (k / COARSE < rows) == row && (k % COARSE < columns) == column;
        largest(&mut coefficients.iter().enumerate().filter(own).map(|(_, value)| value))
    };
    part(true, true) + part(true, false) + part(false, true) + part(false, false)
}

/// The functions of one of several variables: splines over a domain, and the sign of a velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Kind of the variable.
    pub follows: Follows,
    /// Middle of the domain.
    pub middle: f64,
    /// Half the width of the domain, above zero.
    pub reach: f64,
}

impl Axis {
    /// The functions of a single variable at `x`.
    pub fn fine(&self, x: f64) -> [f64; FINE] {
        self.functions(x, FINE_DEGREE)
    }

    /// The functions of one of two variables at `x`.
    pub fn coarse(&self, x: f64) -> [f64; COARSE] {
        self.functions(x, COARSE_DEGREE)
    }

    /// Splines that there are among `count` functions.
    pub fn splines(&self, count: usize) -> usize {
        count - usize::from(self.follows == Follows::Velocity)
    }

    fn functions<const N: usize>(&self, x: f64, degree: usize) -> [f64; N] {
        let share = (x - self.middle) / self.reach;
        let weight = (1.0 - (share.abs() - 1.0).max(0.0) / FADE_RATIO).max(0.0);
        let splines = self.splines(N);
        let place = 0.5 * (share.clamp(-1.0, 1.0) + 1.0) * (splines - degree) as f64;
        std::array::from_fn(|s| {
            weight * if s < splines { b_spline(degree, place - centre(degree, s)) } else { smooth_sign(x) }
        })
    }
}

/// Place of the middle of spline `s`, in spacings of the splines from the begin of the domain.
fn centre(degree: usize, s: usize) -> f64 {
    s as f64 - 0.5 * (degree as f64 - 1.0)
}

/// The cardinal B-spline of degree 2 or 3 about zero, by truncated powers.
fn b_spline(degree: usize, x: f64) -> f64 {
    let end = 0.5 * (degree as f64 + 1.0);
    let (outer, inner) = ((end - x.abs()).max(0.0), (end - 1.0 - x.abs()).max(0.0));
    match degree {
        2 => 0.5 * (outer * outer - 3.0 * inner * inner),
        _ => (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0,
    }
}

/// The variables of a form and the row that they act on. Joints count from 0.
#[derive(Clone, Copy)]
struct Law {
    row: usize,
    of: [usize; 2],
    first: Axis,
    second: Option<Axis>,
}

impl Law {
    fn of(form: &str, site: Site, settings: &[f64]) -> Law {
        let (row, of) = match site {
            Site::Function { row, of } => (row, of),
            _ => (0, [0, 0]),
        };
        let axis = |which: usize, follows: Follows| {
            let value = |k: usize| settings.get(2 * which + k).copied().unwrap_or(1.0);
            Axis { follows, middle: value(0), reach: value(1) }
        };
        let (first, second) = follows(form);
        Law { row, of, first: axis(0, first), second: second.map(|second| axis(1, second)) }
    }

    /// Calls `each` with every function's value; `q` and `dq` are of the first and of the second variable's joint.
    fn each(&self, q: [f64; 2], dq: [f64; 2], mut each: impl FnMut(f64)) {
        let value = |axis: &Axis, q: f64, dq: f64| match axis.follows {
            Follows::Position => q,
            Follows::Velocity => dq,
        };
        let x = value(&self.first, q[0], dq[0]);
        match &self.second {
            None => self.first.fine(x).into_iter().for_each(each),
            Some(second) => {
                let others = second.coarse(value(second, q[1], dq[1]));
                for one in self.first.coarse(x) {
                    others.iter().for_each(|other| each(one * other));
                }
            }
        }
    }
}

struct Empirical {
    spec: Spec,
    law: Law,
    columns: Vec<Column>,
}

impl Empirical {
    fn new(form: &'static str, operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Empirical {
        let law = Law::of(form, site, settings);
        let unit = unit(operating_point, law.row, "Nm", "N");
        let stem = format!("emp{}_{}{}", law.row + 1, law.first.follows, law.of[0] + 1);
        let names: Vec<String> = match &law.second {
            None => (1..=FINE).map(|s| format!("{stem}_{s}")).collect(),
            Some(second) => {
                let stem = format!("{stem}_{}{}", second.follows, law.of[1] + 1);
                (0..COARSE * COARSE).map(|k| format!("{stem}_{}_{}", k / COARSE + 1, k % COARSE + 1)).collect()
            }
        };
        let column =
            |name: String| Column { symbol: name.clone(), expression: name.clone(), name, joint: law.row + 1, unit };
        let spec = Spec { family: FAMILY.id, form, site, settings: settings.to_vec() };
        Empirical { spec, law, columns: names.into_iter().map(column).collect() }
    }
}

impl Term for Empirical {
    fn id(&self) -> &'static str {
        FAMILY.id
    }

    fn physics(&self) -> &'static str {
        FAMILY.physics
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let samples = motion.samples();
        for k in 0..samples {
            let [q, dq] = [&motion.q, &motion.dq].map(|of| self.law.of.map(|joint| of[(k, joint)]));
            let mut column = first;
            self.law.each(q, dq, |value| {
                y[(self.law.row * samples + k, column)] = value;
                column += 1;
            });
        }
    }

    fn smooth(&self) -> bool {
        let steps = |axis: &Axis| axis.follows == Follows::Velocity;
        !steps(&self.law.first) && !self.law.second.as_ref().is_some_and(steps)
    }

    fn spec(&self) -> Option<Spec> {
        Some(self.spec.clone())
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        let mut own = [0.0; COARSE * COARSE];
        own.iter_mut().zip(beta).for_each(|(own, beta)| *own = *beta);
        Box::new(Fixed { law: self.law, beta: own })
    }
}

struct Fixed {
    law: Law,
    /// Padded with zeros.
    beta: [f64; COARSE * COARSE],
}

impl FixedTerm for Fixed {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let of = |all: &JointVec| self.law.of.map(|joint| all.get(joint).copied().unwrap_or_default());
        let (mut sum, mut beta) = (0.0, self.beta.iter());
        self.law.each(of(&sample.q), of(&sample.dq), |value| sum += value * beta.next().copied().unwrap_or_default());
        if let Some(tau) = tau.get_mut(self.law.row) {
            *tau += sum;
        }
    }
}

/// The columns of a form in C.
fn in_c(form: &str, at: &Inputs, settings: &[f64]) -> Vec<String> {
    let law = Law::of(form, Site::Function { row: 0, of: [0, 0] }, settings);
    let functions = |axis: &Axis, count: usize, degree: usize, q: &str, dq: &str, sign: &str| -> Vec<String> {
        let x = if axis.follows == Follows::Position { q } else { dq };
        let share = format!("(({x} - ({:?}))/{:?})", axis.middle, axis.reach);
        let weight = format!("fmax(0.0, 1.0 - fmax(0.0, fabs({share}) - 1.0)/{FADE_RATIO:?})");
        let splines = axis.splines(count);
        let place = format!("0.5*(fmax(-1.0, fmin(1.0, {share})) + 1.0)*{:?}", (splines - degree) as f64);
        let one = |s: usize| {
            if s >= splines {
                return format!("{weight}*{sign}");
            }
            let end = 0.5 * (degree as f64 + 1.0);
            let part = |end: f64| format!("fmax(0.0, {end:?} - fabs({place} - ({:?})))", centre(degree, s));
            let power = |of: String| vec![of; degree].join("*");
            let (outer, inner) = (power(part(end)), power(part(end - 1.0)));
            let [times, over] = if degree == 2 { [3.0, 2.0] } else { [4.0, 6.0] };
            format!("{weight}*({outer} - {times:?}*{inner})/{over:?}")
        };
        (0..count).map(one).collect()
    };
    let Some(second) = &law.second else {
        return functions(&law.first, FINE, FINE_DEGREE, &at.cause_q, &at.cause_dq, &at.cause_sign);
    };
    let others = functions(second, COARSE, COARSE_DEGREE, &at.other_q, &at.other_dq, &at.other_sign);
    functions(&law.first, COARSE, COARSE_DEGREE, &at.cause_q, &at.cause_dq, &at.cause_sign)
        .iter()
        .flat_map(|one| others.iter().map(move |other| format!("({one})*({other})")))
        .collect()
}
