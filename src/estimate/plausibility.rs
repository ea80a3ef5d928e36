//! Whether an offered model can be right, before its torque takes part in driving an arm.

use crate::joint::{JointVec, Limits, MAX_JOINTS, Record};
use crate::model::gravity::G;
use crate::model::term::Sample;
use crate::model::torque::TorqueModel;
use nalgebra::Vector3;

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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::robot::Robot;
    use crate::model::gravity::Mounting;
    use crate::store::ModelFile;
    use std::path::Path;

    const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];

    fn model() -> (TorqueModel, Limits) {
        let robot = Robot::load("panda", None).unwrap();
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/config/models/panda-paper-table3.toml");
        let file = ModelFile::load(Path::new(path), |_| Ok(robot.chain.clone())).unwrap();
        (file.model, robot.limits)
    }

    /// The same model with other numbers.
    fn with(model: &TorqueModel, change: impl Fn(usize, f64) -> f64) -> TorqueModel {
        let values: Vec<(f64, Option<f64>)> =
            model.beta().iter().enumerate().map(|(k, value)| (change(k, *value), None)).collect();
        TorqueModel::new("panda", model.structure().clone(), model.mountings().to_vec(), &values).unwrap()
    }

    /// An arm at rest, and in motion, that measures `model`'s torque and `more` in joint 2.
    fn measured(model: &TorqueModel, gravity: &Vector3<f64>, more: f64) -> Vec<Record> {
        let mut evaluator = model.evaluator(gravity);
        let record = |k: i32| {
            let mut record = Record::default();
            record.state.q = READY.map(|q| q + 0.01 * f64::from(k));
            record.state.dq = [0.02 * f64::from(k); 8];
            record.command.desired.ddq = [0.5; 8];
            let sample = Sample { q: record.state.q, dq: record.state.dq, ddq: record.command.desired.ddq };
            record.state.tau = evaluator.torque(&sample).0;
            record.state.tau[1] += more;
            record
        };
        (0..32).map(record).collect()
    }

    #[test]
    fn a_model_without_inertia_is_refused_with_or_without_a_moving_arm() {
        let (model, limits) = model();
        let gravity = Mounting::WALL.gravity();
        let recent = measured(&model, &gravity, 0.0);
        assert_eq!(plausible(&model, None, &gravity, &[], &limits), Ok(()));
        for value in [0.0, 1e-310, -1e-310, 1e-12] {
            let nothing = with(&model, |_, _| value);
            for recent in [&[][..], &recent] {
                let why = plausible(&nothing, Some(&model), &gravity, recent, &limits).unwrap_err();
                assert!(matches!(why, Implausible::NoInertia { .. }), "{why}");
            }
        }
        // Every number with the wrong sign.
        let why = plausible(&with(&model, |_, value| -value), None, &gravity, &[], &limits).unwrap_err();
        assert!(matches!(why, Implausible::NoInertia { .. }), "{why}");
    }

    #[test]
    fn a_model_that_the_measured_torque_contradicts_is_refused_beside_one_that_agrees() {
        let (model, limits) = model();
        let gravity = Mounting::WALL.gravity();
        let recent = measured(&model, &gravity, 0.5);
        assert_eq!(plausible(&model, Some(&model), &gravity, &recent, &limits), Ok(()));
        // A few percent are a better fit or another payload.
        let near = with(&model, |_, value| 1.05 * value);
        assert_eq!(plausible(&near, Some(&model), &gravity, &recent, &limits), Ok(()));
        let twice = with(&model, |_, value| 2.0 * value);
        for served in [None, Some(&model)] {
            let why = plausible(&twice, served, &gravity, &recent, &limits).unwrap_err();
            let Implausible::Measured { error, served: beside, allowed, .. } = why else { panic!("{why}") };
            assert!(error > allowed && beside.is_some() == served.is_some(), "{why}");
        }
        let wild = with(&model, |_, value| 1e3 * value);
        let why = plausible(&wild, Some(&model), &gravity, &recent, &limits).unwrap_err();
        assert!(matches!(why, Implausible::Limit { .. }), "{why}");
    }

    #[test]
    fn where_the_served_model_is_wrong_too_a_better_one_is_taken() {
        // Something heavy was picked up: 12 Nm more in joint 2 than any of the models explains.
        let (model, limits) = model();
        let gravity = Mounting::UPRIGHT.gravity();
        let recent = measured(&model, &gravity, 12.0);
        assert_eq!(plausible(&model, Some(&model), &gravity, &recent, &limits), Ok(()));
        assert!(plausible(&model, None, &gravity, &recent, &limits).is_err());
    }
}
