//! Plan file: a motion with its constraints and condition numbers.

use super::ExciteError;
use super::criterion::Criterion;
use super::fourier::Fourier;
use super::limits::{Bounds, Margins};
use super::usage::Usage;
use nalgebra::DMatrix;
use plumbline_core::{BadInput, Workspace, from_toml};
use plumbline_model::{Conditions, Mounting};
use serde::{Deserialize, Serialize};

/// Content of a plan file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Plan {
    /// Name of the robot.
    pub robot: String,
    /// Planned mounting, paper eq. 3 \[rad\].
    pub rho: f64,
    /// Planned mounting, paper eq. 3 \[rad\].
    pub phi: f64,
    /// Period \[s\].
    pub period: f64,
    /// Number of harmonics, N.
    pub harmonics: usize,
    /// Seed of the search.
    pub seed: u64,
    /// Start pose, n \[rad\].
    pub q0: Vec<f64>,
    /// Sine amplitudes per joint and harmonic, paper eq. 12 \[rad\].
    pub a: Vec<Vec<f64>>,
    /// Cosine amplitudes per joint and harmonic, paper eq. 12 \[rad\].
    pub b: Vec<Vec<f64>>,
    /// Condition numbers of the stacked base regressor on one period.
    pub conditions: Conditions,
    /// Constraints of the motion.
    pub constraints: Constraints,
    /// Shares of each joint's limits that the motion uses, for reports; absent in plans of earlier versions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub usage: Option<PlanUsage>,
    /// Course of the search that found the motion, for reports; absent for a random motion and in plans of earlier versions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search: Option<PlanSearch>,
}

/// Course of a search: the best criterion over the evaluations of the objective. Both lists have one entry per group of starts or round that found a
/// better motion, and one for the end of the search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct PlanSearch {
    /// Criterion that was minimised; of the stacked regressor where the motion complements others.
    pub criterion: Criterion,
    /// Evaluations of the objective with its gradient since the begin of the search.
    pub evaluations: Vec<u64>,
    /// Best criterion: a condition number, or the exponential of [`Criterion::LogDet`].
    pub best: Vec<f64>,
}

impl PlanSearch {
    /// A search that has not found a motion.
    pub(super) fn new(criterion: Criterion) -> PlanSearch {
        PlanSearch { criterion, evaluations: Vec::new(), best: Vec::new() }
    }

    /// Adds the `best` criterion after `evaluations`, where it is better than before.
    pub(super) fn add(&mut self, evaluations: u64, best: f64) {
        if self.best.last().is_none_or(|before| best < *before) {
            self.evaluations.push(evaluations);
            self.best.push(best);
        }
    }

    /// Adds the end of the search.
    pub(super) fn end(mut self, evaluations: u64) -> PlanSearch {
        if let Some(best) = self.best.last().copied().filter(|_| self.evaluations.last() != Some(&evaluations)) {
            self.evaluations.push(evaluations);
            self.best.push(best);
        }
        self
    }
}

/// Shares of the limits less margins that a motion uses, one entry per joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct PlanUsage {
    /// Distance between the highest and the lowest position, of the range.
    pub range: Vec<f64>,
    /// Highest speed, of the highest speed that the joint has anywhere.
    pub speed: Vec<f64>,
}

impl PlanUsage {
    /// The shares of every joint, n, rounded to thousandths.
    pub fn of(usage: &[Usage]) -> PlanUsage {
        let rounded = |of: fn(&Usage) -> f64| usage.iter().map(|usage| (of(usage) * 1e3).round() / 1e3).collect();
        PlanUsage { range: rounded(|usage| usage.range), speed: rounded(|usage| usage.speed) }
    }
}

/// Constraints of a plan: limits with one entry per joint, and margins.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Constraints {
    /// Lowest positions \[rad\].
    pub q_min: Vec<f64>,
    /// Highest positions \[rad\].
    pub q_max: Vec<f64>,
    /// Highest speeds \[rad/s\].
    pub dq: Vec<f64>,
    /// Highest accelerations \[rad/s2\].
    pub ddq: Vec<f64>,
    /// Highest jerks \[rad/s3\].
    pub jerk: Vec<f64>,
    /// Highest torques \[Nm\]; absent when no nominal model was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tau: Option<Vec<f64>>,
    /// Highest torque rates \[Nm/s\]; absent when no nominal model was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dtau: Option<Vec<f64>>,
    /// Lower corner of the end effector's box \[m\]; absent without a workspace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_min: Option<[f64; 3]>,
    /// Upper corner of the end effector's box \[m\]; absent without a workspace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_max: Option<[f64; 3]>,
    /// Radius of the forbidden sphere around the base \[m\]; absent without a workspace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_radius: Option<f64>,
    /// Whether the links had to stay in the box too.
    #[serde(default)]
    pub links_in_box: bool,
    /// Margins to the limits.
    pub margins: Margins,
}

impl Constraints {
    /// Constraints of `bounds`; `torque`: whether a nominal model's torques were checked.
    pub fn of(bounds: &Bounds, torque: bool) -> Constraints {
        let n = bounds.chain.len();
        let limits = bounds.limits;
        let space = |of: fn(&Workspace) -> [f64; 3]| bounds.workspace.map(of);
        Constraints {
            q_min: limits.q_min[..n].to_vec(),
            q_max: limits.q_max[..n].to_vec(),
            dq: limits.dq[..n].to_vec(),
            ddq: limits.ddq[..n].to_vec(),
            jerk: limits.jerk[..n].to_vec(),
            tau: torque.then(|| limits.tau[..n].to_vec()),
            dtau: torque.then(|| limits.dtau[..n].to_vec()),
            box_min: space(|workspace| workspace.box_min),
            box_max: space(|workspace| workspace.box_max),
            base_radius: bounds.workspace.map(|workspace| workspace.base_radius),
            links_in_box: bounds.links_in_box,
            margins: bounds.margins,
        }
    }
}

impl Plan {
    /// The motion.
    ///
    /// # Errors
    /// Amplitudes that do not match `q0` and `harmonics`, or a number that is not finite.
    pub fn fourier(&self) -> Result<Fourier, ExciteError> {
        let n = self.q0.len();
        let fits = |rows: &[Vec<f64>]| rows.len() == n && rows.iter().all(|row| row.len() == self.harmonics);
        if !fits(&self.a) || !fits(&self.b) {
            let shape = |rows: &[Vec<f64>]| (rows.len(), rows.iter().map(Vec::len).max().unwrap_or(0));
            return Err(ExciteError::Shape { q0: n, a: shape(&self.a), b: shape(&self.b) });
        }
        let matrix = |rows: &[Vec<f64>]| DMatrix::from_fn(n, self.harmonics, |i, k| rows[i][k]);
        Fourier::new(self.period, self.q0.clone(), matrix(&self.a), matrix(&self.b))
    }

    /// The planned mounting.
    pub fn mounting(&self) -> Mounting {
        Mounting { rho: self.rho, phi: self.phi }
    }
}

/// Text of a plan file; parsing it gives a bitwise equal plan.
///
/// # Errors
/// None for a plan of finite numbers.
pub fn plan_text(plan: &Plan) -> Result<String, toml::ser::Error> {
    let text = toml::to_string(plan)?;
    Ok(format!("# Excitation of one period: paper eq. 12 with q0, a, b. Angles in rad, times in s.\n{text}"))
}

/// Parses a plan; `file` appears in errors only.
///
/// # Errors
/// An unknown or missing key, a number that is not finite, amplitudes that do not match the joints and harmonics.
pub fn parse_plan(file: &str, text: &str) -> Result<Plan, BadInput> {
    let plan: Plan = from_toml(file, text)?;
    for (key, value) in [("rho", plan.rho), ("phi", plan.phi)] {
        if !value.is_finite() {
            return Err(BadInput::new(file, format!("key `{key}`"), value, "an angle in rad"));
        }
    }
    if !(plan.period.is_finite() && plan.period > 0.0) {
        return Err(BadInput::new(file, "key `period`", plan.period, "a period in s, above 0"));
    }
    let expected =
        "one start position per joint and, in a and b, one row per joint with one finite amplitude per harmonic";
    plan.fourier().map_err(|error| BadInput::new(file, "keys `q0`, `a`, `b`", error, expected))?;
    Ok(plan)
}
