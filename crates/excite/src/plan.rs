//! A planned motion as plain data, with all that is needed to rebuild and to judge it.

use super::ExciteError;
use super::fourier::Fourier;
use super::limits::{Bounds, Margins};
use super::usage::Usage;
use nalgebra::DMatrix;
use plumbline_core::{BadInput, Workspace, from_toml};
use plumbline_model::{Conditions, Mounting};
use serde::{Deserialize, Serialize};

/// The plan file's content.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Plan {
    /// Name of the robot.
    pub robot: String,
    /// Mounting it was planned for, paper eq. 3 \[rad\].
    pub rho: f64,
    /// Mounting it was planned for, paper eq. 3 \[rad\].
    pub phi: f64,
    /// Period \[s\].
    pub period: f64,
    /// Number of harmonics, N.
    pub harmonics: usize,
    /// Seed of the search that found it.
    pub seed: u64,
    /// Start pose, n \[rad\].
    pub q0: Vec<f64>,
    /// Sine amplitudes per joint and harmonic, paper eq. 12 \[rad\].
    pub a: Vec<Vec<f64>>,
    /// Cosine amplitudes per joint and harmonic, paper eq. 12 \[rad\].
    pub b: Vec<Vec<f64>>,
    /// Condition numbers of the stacked base regressor on one period.
    pub conditions: Conditions,
    /// What the motion was held to.
    pub constraints: Constraints,
    /// How much of each joint's limits the motion uses, for people and the report; absent in plans of earlier versions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub usage: Option<PlanUsage>,
}

/// Shares of the limits, less their margins, that a motion uses, one entry per joint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct PlanUsage {
    /// Distance between the highest and the lowest position, of the range.
    pub range: Vec<f64>,
    /// Highest speed, of the highest speed that the joint has anywhere.
    pub speed: Vec<f64>,
}

impl PlanUsage {
    /// The shares of every joint, n, in thousandths.
    pub fn of(usage: &[Usage]) -> PlanUsage {
        let rounded = |of: fn(&Usage) -> f64| usage.iter().map(|usage| (of(usage) * 1e3).round() / 1e3).collect();
        PlanUsage { range: rounded(|usage| usage.range), speed: rounded(|usage| usage.speed) }
    }
}

/// The limits that a plan was held to, one entry per joint, and what it left free of them.
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
    /// Lower corner of the end effector's box \[m\]; absent when it was left free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_min: Option<[f64; 3]>,
    /// Upper corner of the end effector's box \[m\]; absent when it was left free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub box_max: Option<[f64; 3]>,
    /// Radius of the sphere round the base that it stays out of \[m\]; absent when it was left free.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub base_radius: Option<f64>,
    /// Whether the links were held in the box, too.
    #[serde(default)]
    pub links_in_box: bool,
    /// What was left free of each limit.
    pub margins: Margins,
}

impl Constraints {
    /// The bounds as plain data; `torque` says whether a nominal model's torques were checked.
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
    /// The motion. Errors when the amplitudes do not fit `q0` and `harmonics`, or a number is not finite.
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

    /// The mounting it was planned for.
    pub fn mounting(&self) -> Mounting {
        Mounting { rho: self.rho, phi: self.phi }
    }
}

/// Text of a plan file; reading it gives the same plan bit by bit.
///
/// # Errors
/// None for a plan of finite numbers.
pub fn plan_text(plan: &Plan) -> Result<String, toml::ser::Error> {
    let text = toml::to_string(plan)?;
    Ok(format!("# Excitation of one period: paper eq. 12 with q0, a, b. Angles in rad, times in s.\n{text}"))
}

/// Reads a plan from text; `file` is only named in errors.
///
/// # Errors
/// An unknown or missing key, a number that is not finite, amplitudes that don't fit the joints and harmonics.
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
