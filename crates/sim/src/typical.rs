//! A simulated arm for a robot of which only bodies and limits are known.

use super::commands::TICK_S;
use super::stability::{Loads, SLOPE};
use super::truth::{JointTruth, LinkTruth, Truth};
use plumbline_core::{JointVec, Limits};
use plumbline_model::{Body, Chain};
use std::fmt::Write;

/// Largest bandwidth of the inner controller at the joint's median inertia \[rad/s\].
const MAX_BANDWIDTH_RAD_PER_S: f64 = 200.0;
/// Shares of the damping that the shortest step bears at the joint's smallest inertia: of the controller, Coulomb and viscous friction.
const DAMPING_SHARE: f64 = 0.4;
const COULOMB_SHARE: f64 = 0.3;
const VISCOUS_SHARE: f64 = 0.1;
/// Largest `h d / m` of a damping `d` on a mass `m` that Runge-Kutta 4 is stable with.
const MOST_DAMPED: f64 = 2.785;
/// The step is shorter than the longest stable one by this ratio.
const RESERVE: f64 = 1.5;
/// Steps per millisecond that the bandwidth is chosen for.
const USUAL_SUBSTEPS: u32 = 8;
/// The stiffness is at least this multiple of the largest torque of gravity: an arm on its way down pulls with as much per rad.
const STIFFNESS_PER_GRAVITY: f64 = 4.0;
/// Friction and noise as shares of a joint's torque limit, of the order of a Panda's.
const COULOMB_RATIO: f64 = 5e-3;
const VISCOUS_RATIO: f64 = 2e-3;
const TORQUE_NOISE_RATIO: f64 = 2e-3;
/// Noise of a Panda's encoders \[rad\] and velocities \[rad/s\].
const POSITION_NOISE: f64 = 1e-5;
const VELOCITY_NOISE: f64 = 5e-4;

/// What is known of an arm.
pub struct Known<'a> {
    /// Robot file that the arm file names.
    pub robot: &'a str,
    /// Kinematics.
    pub chain: &'a Chain,
    /// Limits of the joints.
    pub limits: &'a Limits,
    /// A body per link, in the link's frame.
    pub bodies: &'a [Body],
    /// Viscous \[Nms/rad\] and Coulomb friction \[Nm\] of each joint; `None` for one of the order of a Panda's.
    pub friction: &'a [[Option<f64>; 2]],
    /// Position at connection \[rad\].
    pub start: &'a JointVec,
}

impl Truth {
    /// A simulated arm with stable gains: a joint impedance, critically damped at each joint's median inertia with the others free, of 200 rad/s
    /// or as much as eight steps per millisecond allow, and at least four times as stiff as gravity needs in any mounting.
    ///
    /// Steps per millisecond are the fewest from 4 on that keep the integration stable with a reserve. Friction, where it is not known, and noise
    /// are shares of the torque limit; friction is lowered to what these steps bear without chatter.
    pub fn typical(known: &Known) -> Truth {
        let n = known.chain.len();
        let link = |body: &Body| {
            let i = &body.inertia;
            let inertia = [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)]];
            LinkTruth { mass: body.mass, com: body.com.into(), inertia }
        };
        let joint = |j: usize| {
            let (tau, [fv, fc]) = (known.limits.tau[j], known.friction[j]);
            JointTruth {
                fv: fv.unwrap_or(VISCOUS_RATIO * tau / known.limits.dq[j]),
                fc: fc.unwrap_or(COULOMB_RATIO * tau),
                stiffness: 0.0,
                damping: 0.0,
                torque_noise: TORQUE_NOISE_RATIO * tau,
                torque_noise_coloured: 0.0,
                torque_quantum: 0.0,
                position_noise: POSITION_NOISE,
                position_quantum: 0.0,
                velocity_noise: VELOCITY_NOISE,
            }
        };
        let mut truth = Truth {
            robot: known.robot.to_string(),
            links: known.bodies.iter().map(link).collect(),
            joints: (0..n).map(joint).collect(),
            substeps: 4,
            ..super::truth_file::DEFAULTS
        };
        let loads = Loads::of(known.chain, &truth, known.start, &known.limits.q_min, &known.limits.q_max);
        let gravity = loads.gravity();
        let extremes: Vec<(f64, f64)> = (0..n).map(|j| extremes(loads.free(j).collect())).collect();
        let most_damped = |least: f64, steps: u32| MOST_DAMPED * least * f64::from(steps) / (RESERVE * TICK_S);
        for (j, joint) in truth.joints.iter_mut().enumerate() {
            let (least, median) = extremes[j];
            let usual = DAMPING_SHARE * most_damped(least, USUAL_SUBSTEPS);
            let needed = 2.0 * (STIFFNESS_PER_GRAVITY * gravity[j] * median).sqrt();
            joint.damping = (2.0 * median * MAX_BANDWIDTH_RAD_PER_S).min(usual).max(needed);
            joint.stiffness = joint.damping * joint.damping / (4.0 * median);
        }
        // Without friction, which is chosen for the steps.
        let gains: Vec<JointTruth> =
            truth.joints.iter().map(|joint| JointTruth { fv: 0.0, fc: 0.0, ..*joint }).collect();
        truth.substeps = loads.substeps(&gains, truth.substeps, RESERVE).unwrap_or(1000);
        for (joint, (least, _)) in truth.joints.iter_mut().zip(&extremes) {
            let most = most_damped(*least, truth.substeps);
            joint.fc = joint.fc.min(COULOMB_SHARE * most / SLOPE);
            joint.fv = joint.fv.min(VISCOUS_SHARE * most);
        }
        // Joints that share a mode bear less than each alone.
        for _ in 0..20 {
            if loads.quiet(&truth.joints, RESERVE * TICK_S / f64::from(truth.substeps)) {
                break;
            }
            for joint in &mut truth.joints {
                joint.fc *= 0.7;
                joint.fv *= 0.7;
            }
        }
        truth.joints.iter_mut().for_each(|joint| *joint = rounded(joint));
        truth
    }

    /// Text of an arm file with robot, links, joints and steps; effects and faults are not written.
    pub fn text(&self) -> String {
        let mut text = format!("robot = {:?}\nsubsteps = {}\n", self.robot, self.substeps);
        for LinkTruth { mass, com, inertia } in &self.links {
            let _ = write!(text, "\n[[link]]\nmass = {mass:?}\ncom = {com:?}\ninertia = {inertia:?}\n");
        }
        for joint in &self.joints {
            let _ = write!(
                text,
                "\n[[joint]]\nfv = {:?}\nfc = {:?}\nstiffness = {:?}\ndamping = {:?}\ntorque-noise = {:?}\nposition-noise = \
                 {:?}\nvelocity-noise = {:?}\n",
                joint.fv,
                joint.fc,
                joint.stiffness,
                joint.damping,
                joint.torque_noise,
                joint.position_noise,
                joint.velocity_noise
            );
        }
        text
    }
}

/// Smallest value and median; 1 and 1 of none.
fn extremes(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |index: usize| values.get(index).copied().unwrap_or(1.0);
    (at(0), at(values.len() / 2))
}

/// Gains, friction and noise to three digits.
fn rounded(joint: &JointTruth) -> JointTruth {
    let three = |value: f64| format!("{value:.2e}").parse().unwrap_or(value);
    JointTruth {
        fv: three(joint.fv),
        fc: three(joint.fc),
        stiffness: three(joint.stiffness),
        damping: three(joint.damping),
        torque_noise: three(joint.torque_noise),
        ..*joint
    }
}
