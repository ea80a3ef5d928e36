//! Whether an offered model can be right, before its torque takes part in driving an arm.

use nalgebra::Vector3;
use plumbline_core::{JointVec, Limits, MAX_JOINTS, Record};
use plumbline_model::term::Sample;
use plumbline_model::{G, TorqueModel};

/// Poses between the position limits at which the arm's inertia is looked for.
const POSES: u32 = 16;
/// A model whose joints' inertias sum up to no more than this describes no arm. A single joint's may be anything: that of a light wrist is below what
/// an identification resolves, and comes out negative now and then \[kg m2\].
const LEAST_INERTIA: f64 = 1e-6;
/// The offered model's error may be so many times the served one's: a new payload makes both wrong until one is identified.
const ERROR_RATIO: f64 = 2.0;
/// An error below this share of the joint's torque limit is no reason to refuse a model.
const ERROR_SHARE: f64 = 0.1;

/// Why an offered model is not served.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Implausible {
    /// The joints cost no torque to accelerate in any pose.
    #[error("it has no inertia: the joints' sum is at most {inertia:e} kg m2 in {POSES} poses")]
    NoInertia {
        /// Largest sum found \[kg m2\].
        inertia: f64,
    },
    /// Its torque is beyond the arm's limit where the arm is.
    #[error("it asks joint {} for {tau:.2} Nm where the arm is, and the limit is {bound:.2} Nm", .joint + 1)]
    Limit {
        /// Joint, counted from 0.
        joint: usize,
        /// Its torque \[Nm\].
        tau: f64,
        /// The joint's limit \[Nm\].
        bound: f64,
    },
    /// It does not explain the torque that the arm measures.
    #[error(
        "the torque measured in joint {} is {error:.2} Nm away from it, at most {allowed:.2} Nm are allowed{}", .joint + 1, beside(.served)
    )]
    Measured {
        /// Joint, counted from 0.
        joint: usize,
        /// RMS of measured minus modelled torque \[Nm\].
        error: f64,
        /// The served model's, where one is served \[Nm\].
        served: Option<f64>,
        /// What is allowed \[Nm\].
        allowed: f64,
    },
}

fn beside(served: &Option<f64>) -> String {
    served.map_or(String::new(), |served| format!(" (the served model: {served:.2} Nm)"))
}

/// Whether `offered` may take the place of `served` under `gravity` \[m/s2\], by what the arm did last (`recent`, empty where it is not known).
///
/// The trace of the mass matrix must be positive. Along `recent` the torque must be inside the limits, and its RMS error against the measured torque at most
/// `ERROR_RATIO` times that of the served model, or `ERROR_SHARE` of the joint's limit.
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
    if inertia.is_nan() || inertia <= LEAST_INERTIA {
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
        let allowed = (ERROR_SHARE * limits.tau[joint]).max(ERROR_RATIO * served.unwrap_or(0.0));
        if error.is_nan() || error > allowed {
            return Err(Implausible::Measured { joint, error, served, allowed });
        }
    }
    Ok(())
}

/// Trace of the mass matrix of `n` joints, the largest over poses all over their ranges \[kg m2\].
fn largest_inertia(model: &TorqueModel, n: usize, limits: &Limits) -> f64 {
    let mut evaluator = model.evaluator(&Vector3::new(0.0, 0.0, -G));
    let mut torque = |q: JointVec, joint: usize, ddq: f64| {
        let mut sample = Sample { q, ..Sample::default() };
        sample.ddq[joint] = ddq;
        evaluator.torque(&sample).0[joint]
    };
    let inertia = |pose: u32| {
        // Fractions of the golden ratio's powers: poses that no two joints share.
        let place = |j: usize| (f64::from(pose + 1) * 0.618_033_988_75_f64.powi(j as i32 + 1)).fract();
        let q = std::array::from_fn(|j| limits.q_min[j] + place(j) * (limits.q_max[j] - limits.q_min[j]));
        (0..n).map(|joint| torque(q, joint, 1.0) - torque(q, joint, 0.0)).sum::<f64>()
    };
    (0..POSES).map(inertia).fold(f64::NEG_INFINITY, f64::max)
}

/// A model's torques where the arm was, with the acceleration that was commanded \[Nm\].
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
