//! Plausibility check of an offered model, before its torque is sent to an arm.

use nalgebra::Vector3;
use plumbline_core::{JointVec, Limits, MAX_JOINTS, Record};
use plumbline_model::term::Sample;
use plumbline_model::{G, TorqueModel};

/// Number of poses between the position limits at which the inertia is evaluated.
const POSES: u32 = 16;
/// Minimum sum of the joints' inertias \[kg m2\]. The inertia of a single joint is not checked: that of a light wrist is below the resolution of
/// an identification and can be negative.
const MIN_INERTIA: f64 = 1e-6;
/// Maximum ratio of the offered model's error to the served model's: with a new payload both are wrong.
const MAX_ERROR_RATIO: f64 = 2.0;
/// Ratio of the joint's torque limit below which an error is always accepted.
const ACCEPTED_ERROR_RATIO: f64 = 0.1;

/// Why an offered model is not served.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum Implausible {
    #[error("it has no inertia: the joints' sum is at most {inertia:e} kg m2 in {POSES} poses")]
    NoInertia { inertia: f64 },
    /// Its torque exceeds the arm's limit at a recent state.
    #[error("it asks joint {} for {tau:.2} Nm where the arm is, and the limit is {bound:.2} Nm", .joint + 1)]
    Limit { joint: usize, tau: f64, bound: f64 },
    #[error(
        "the torque measured in joint {} is {error:.2} Nm away from it, at most {allowed:.2} Nm are allowed{}", .joint + 1, beside(.served)
    )]
    Measured { joint: usize, error: f64, served: Option<f64>, allowed: f64 },
}

fn beside(served: &Option<f64>) -> String {
    served.map_or(String::new(), |served| format!(" (the served model: {served:.2} Nm)"))
}

/// Checks whether `offered` may replace `served` under `gravity` \[m/s2\], on the recent records of the arm (empty where unknown).
///
/// The trace of the mass matrix must be positive. Along `recent` the torque must be inside the limits, and its RMS error against the measured torque at most
/// `MAX_ERROR_RATIO` times that of the served model, or `ACCEPTED_ERROR_RATIO` of the joint's limit.
///
/// # Errors
/// [`Implausible`] names the joint.
pub fn plausible(
    offered: &TorqueModel,
    served: Option<&TorqueModel>,
    gravity: &Vector3<f64>,
    recent: &[Record],
    limits: &Limits,
) -> Result<(), Implausible> {
    let n = offered.structure().chain().len().min(MAX_JOINTS);
    let inertia = largest_inertia(offered, n, limits);
    if inertia.is_nan() || inertia <= MIN_INERTIA {
        return Err(Implausible::NoInertia { inertia });
    }
    if recent.is_empty() {
        return Ok(());
    }
    let torques = torques(offered, gravity, recent);
    for (joint, &bound) in limits.tau.iter().enumerate().take(n) {
        let beyond = |tau: &f64| tau.is_nan() || tau.abs() > bound;
        if let Some(tau) = torques.iter().map(|tau| tau[joint]).find(beyond) {
            return Err(Implausible::Limit { joint, tau, bound });
        }
    }
    let errors = errors(&torques, recent);
    let served = served.map(|served| self::errors(&self::torques(served, gravity, recent), recent));
    for joint in 0..n {
        let (error, served) = (errors[joint], served.map(|errors| errors[joint]));
        let allowed = (ACCEPTED_ERROR_RATIO * limits.tau[joint]).max(MAX_ERROR_RATIO * served.unwrap_or(0.0));
        if error.is_nan() || error > allowed {
            return Err(Implausible::Measured { joint, error, served, allowed });
        }
    }
    Ok(())
}

/// Largest trace of the mass matrix of `n` joints over poses in their ranges \[kg m2\].
fn largest_inertia(model: &TorqueModel, n: usize, limits: &Limits) -> f64 {
    let mut evaluator = model.evaluator(&Vector3::new(0.0, 0.0, -G));
    let mut torque = |q: JointVec, joint: usize, ddq: f64| {
        let mut sample = Sample { q, ..Sample::default() };
        sample.ddq[joint] = ddq;
        evaluator.torque(&sample).0[joint]
    };
    let inertia = |pose: u32| {
        // Low-discrepancy sequence from powers of the golden ratio.
        let fraction = |j: usize| (f64::from(pose + 1) * 0.618_033_988_75_f64.powi(j as i32 + 1)).fract();
        let q = std::array::from_fn(|j| limits.q_min[j] + fraction(j) * (limits.q_max[j] - limits.q_min[j]));
        (0..n).map(|joint| torque(q, joint, 1.0) - torque(q, joint, 0.0)).sum::<f64>()
    };
    (0..POSES).map(inertia).fold(f64::NEG_INFINITY, f64::max)
}

/// A model's torques at recent states, with the commanded acceleration \[Nm\].
fn torques(model: &TorqueModel, gravity: &Vector3<f64>, recent: &[Record]) -> Vec<JointVec> {
    let mut evaluator = model.evaluator(gravity);
    let sample = |record: &Record| Sample { q: record.state.q, dq: record.state.dq, ddq: record.command.desired.ddq };
    recent.iter().map(|record| evaluator.torque(&sample(record)).0).collect()
}

/// RMS of measured minus modelled torque per joint \[Nm\].
fn errors(torques: &[JointVec], recent: &[Record]) -> JointVec {
    std::array::from_fn(|j| {
        let square: f64 = torques.iter().zip(recent).map(|(tau, record)| (record.state.tau[j] - tau[j]).powi(2)).sum();
        (square / recent.len().max(1) as f64).sqrt()
    })
}
