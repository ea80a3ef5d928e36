//! Whether the integration of an arm is stable: its step against the controller's gains, friction and the arm's inertia.
//!
//! Near a pose the arm is `M ddq = -K q - D dq` with `D = damping + fv`. A step `h` of Runge-Kutta 4 multiplies each mode by
//! `1 + z + z^2/2 + z^3/6 + z^4/24`, `z = h lambda`. Coulomb friction adds its slope at rest, `100 fc`, where velocities are a few mrad/s: a step
//! that is too long for that makes the arm chatter, within bounds.

use super::aba::inverse;
use super::commands::TICK_S;
use super::spatial::Mechanism;
use super::truth::{JointTruth, Truth};
use nalgebra::{Complex, DMatrix, Schur, Vector3};
use plumbline_core::{BadInput, JointVec, MAX_JOINTS};
use plumbline_model::{Chain, G};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Random poses at which the inertia is taken, besides the start and those in which a joint has the smallest inertia.
const POSES: usize = 40;
/// Steps of the search for the pose in which a joint has the smallest inertia.
const CLIMB: u32 = 60;
/// Slope of `tanh(100 dq)` at rest \[s/rad\].
pub(super) const SLOPE: f64 = 100.0;
/// Growth of a mode in one step that rounding explains.
const ROUNDING: f64 = 1e-7;
/// Largest number of steps in a millisecond.
const MAX_SUBSTEPS: u32 = 1000;

/// Inverse mass matrices of an arm at poses of its range, and its weight.
pub(super) struct Loads {
    inverses: Vec<DMatrix<f64>>,
    gravity: JointVec,
}

impl Loads {
    /// At the start, at random poses between `low` and `high` \[rad\], and where a search finds the smallest inertia of each joint.
    pub fn of(chain: &Chain, truth: &Truth, start: &JointVec, low: &JointVec, high: &JointVec) -> Loads {
        let n = chain.len();
        let mut mechanism = Mechanism::new(chain, &truth.inertias());
        for effect in truth.build_effects() {
            for (joint, armature) in mechanism.armature.iter_mut().enumerate().take(n) {
                *armature += effect.armature(0.0, joint);
            }
        }
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let random = |rng: &mut ChaCha8Rng| {
            let mut q = [0.0; MAX_JOINTS];
            for j in 0..n {
                q[j] = if low[j] < high[j] { rng.random_range(low[j]..=high[j]) } else { start[j] };
            }
            q
        };
        let mut poses: Vec<JointVec> = std::iter::once(*start).chain((0..POSES).map(|_| random(&mut rng))).collect();
        // From the pose with the smallest inertia of each joint on, to one in which it is smaller still.
        let lightness =
            |q: &JointVec, j: usize| mass(&mechanism, q).try_inverse().map_or(0.0, |inverse| inverse[(j, j)]);
        for j in 0..n {
            let from = poses.iter().take(POSES + 1).map(|q| (lightness(q, j), *q));
            let Some((mut most, mut q)) = from.max_by(|a, b| a.0.total_cmp(&b.0)) else { continue };
            for step in 0..CLIMB {
                let size = 0.5 * (1.0 - f64::from(step) / f64::from(CLIMB));
                let mut near = q;
                for k in 0..n {
                    let turned = q[k] + size * rng.random_range(-1.0..1.0);
                    near[k] = if low[k] < high[k] { turned.clamp(low[k], high[k]) } else { turned };
                }
                let other = lightness(&near, j);
                if other > most {
                    (most, q) = (other, near);
                }
            }
            poses.push(q);
        }
        let mut gravity = [0.0f64; MAX_JOINTS];
        for q in &poses {
            for direction in [Vector3::x(), Vector3::y(), Vector3::z()] {
                let still = [0.0; MAX_JOINTS];
                let held = inverse(&mechanism, &(G * direction), q, &still, &still);
                gravity.iter_mut().zip(held).for_each(|(most, tau)| *most = most.max(tau.abs()));
            }
        }
        Loads { inverses: poses.iter().filter_map(|q| mass(&mechanism, q).try_inverse()).collect(), gravity }
    }

    /// Inertia that a joint moves when all other joints are free \[kg m2\], at each pose.
    pub fn free(&self, joint: usize) -> impl Iterator<Item = f64> + '_ {
        self.inverses.iter().map(move |inverse| 1.0 / inverse[(joint, joint)])
    }

    /// Whether every mode decays, or stays, at every pose under these joints' gains with a step of `h` \[s\].
    pub fn stable(&self, joints: &[JointTruth], h: f64) -> bool {
        self.decays(joints, 0.0, h)
    }

    /// Whether the arm is [`stable`](Loads::stable) and does not chatter at rest either.
    pub fn quiet(&self, joints: &[JointTruth], h: f64) -> bool {
        self.decays(joints, SLOPE, h) && self.decays(joints, 0.0, h)
    }

    fn decays(&self, joints: &[JointTruth], slope: f64, h: f64) -> bool {
        let damping: Vec<f64> = joints.iter().map(|joint| joint.damping + joint.fv + slope * joint.fc).collect();
        self.inverses.iter().all(|inverse| growth(inverse, joints, &damping, h) <= 1.0 + ROUNDING)
    }

    /// Largest torque of gravity in each joint at these poses, in mountings along every axis of the base frame \[Nm\].
    pub fn gravity(&self) -> JointVec {
        self.gravity
    }

    /// The fewest steps per millisecond from `from` on that are stable with a step `reserve` times as long.
    pub fn substeps(&self, joints: &[JointTruth], from: u32, reserve: f64) -> Option<u32> {
        let (mut low, mut high) = (from, from);
        while !self.stable(joints, reserve * TICK_S / f64::from(high)) {
            if high >= MAX_SUBSTEPS {
                return None;
            }
            (low, high) = (high + 1, (2 * high).min(MAX_SUBSTEPS));
        }
        while low < high {
            let middle = (low + high) / 2;
            if self.stable(joints, reserve * TICK_S / f64::from(middle)) {
                high = middle;
            } else {
                low = middle + 1;
            }
        }
        Some(high)
    }
}

impl Truth {
    /// Checks that the arm's integration is stable in the range of the joints, between `low` and `high` \[rad\], and at `start`.
    ///
    /// Effects other than rotor inertia are not taken into account.
    ///
    /// # Errors
    /// Names `file`, the joint and the gain that the step is too long for, its largest stable value, and the steps per millisecond that would do.
    pub fn check_step(
        &self,
        file: &str,
        chain: &Chain,
        start: &JointVec,
        low: &JointVec,
        high: &JointVec,
    ) -> Result<(), BadInput> {
        if chain.len() != self.joints() {
            // Another error names it.
            return Ok(());
        }
        let loads = Loads::of(chain, self, start, low, high);
        let h = TICK_S / f64::from(self.substeps);
        if loads.stable(&self.joints, h) {
            return Ok(());
        }
        let (joint, key) = fastest(&loads, &self.joints, h);
        let truth = &self.joints[joint];
        let (name, value, unit) = match key {
            Key::Stiffness => ("stiffness", truth.stiffness, "Nm/rad"),
            Key::Damping => ("damping", truth.damping, "Nms/rad"),
            Key::Viscous => ("fv", truth.fv, "Nms/rad"),
        };
        // Beside the other joints as they are; where those are unstable, too, beside joints without gains.
        let alone = |(j, truth): (usize, &JointTruth)| if j == joint { *truth } else { slack(truth) };
        let alone = self.joints.iter().enumerate().map(alone).collect();
        let most = largest(&loads, self.joints.clone(), joint, key, h);
        let most = most.or_else(|| largest(&loads, alone, joint, key, h));
        let least = loads.free(joint).fold(f64::INFINITY, f64::min);
        let steps = match loads.substeps(&self.joints, self.substeps, 1.0) {
            Some(steps) => format!("; or substeps = {steps}"),
            None => String::new(),
        };
        let most = match most {
            Some(most) => format!("at most {} {unit}", down(most)),
            None => "gains that are stable".to_string(),
        };
        let expected = format!(
            "{most}, with which its integration is stable: a step of {h} s (substeps = {}) and an inertia as small as {least:.3e} kg m2 at \
             this joint{steps}",
            self.substeps
        );
        Err(BadInput::new(file, format!("joint {}, key `{name}`", joint + 1), format!("{value} {unit}"), expected))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Key {
    Stiffness,
    Damping,
    Viscous,
}

/// The joint whose own mode is fastest, and the gain that makes it so.
fn fastest(loads: &Loads, joints: &[JointTruth], h: f64) -> (usize, Key) {
    let mut most = (0.0, 0, Key::Damping);
    for (joint, truth) in joints.iter().enumerate() {
        let inertia = loads.free(joint).fold(f64::INFINITY, f64::min);
        let damped = if truth.damping >= truth.fv { Key::Damping } else { Key::Viscous };
        let rates = [
            (h * (truth.damping + truth.fv) / inertia / 2.785, damped),
            (h * (truth.stiffness / inertia).sqrt() / 2.828, Key::Stiffness),
        ];
        for (rate, key) in rates {
            if rate > most.0 {
                most = (rate, joint, key);
            }
        }
    }
    (most.1, most.2)
}

/// A joint without controller and friction.
fn slack(truth: &JointTruth) -> JointTruth {
    JointTruth { stiffness: 0.0, damping: 0.0, fv: 0.0, ..*truth }
}

/// Largest stable value of one gain, by bisection; `None` where not even zero is stable.
fn largest(loads: &Loads, mut joints: Vec<JointTruth>, joint: usize, key: Key, h: f64) -> Option<f64> {
    fn gain(truth: &mut JointTruth, key: Key) -> &mut f64 {
        match key {
            Key::Stiffness => &mut truth.stiffness,
            Key::Damping => &mut truth.damping,
            Key::Viscous => &mut truth.fv,
        }
    }
    let (mut low, mut high) = (0.0, *gain(&mut joints[joint], key));
    let mut stable = |value: f64| {
        *gain(&mut joints[joint], key) = value;
        loads.stable(&joints, h)
    };
    if !stable(low) {
        return None;
    }
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if stable(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(low)
}

/// Three digits, rounded down.
fn down(value: f64) -> f64 {
    if value <= 0.0 {
        return 0.0;
    }
    let scale = 10f64.powf(2.0 - value.log10().floor());
    (value * scale).floor() / scale
}

/// Largest factor that a step multiplies a mode by.
fn growth(inverse: &DMatrix<f64>, joints: &[JointTruth], damping: &[f64], h: f64) -> f64 {
    let n = joints.len();
    let mut a = DMatrix::zeros(2 * n, 2 * n);
    for j in 0..n {
        a[(j, n + j)] = h;
        for k in 0..n {
            a[(n + j, k)] = -h * inverse[(j, k)] * joints[k].stiffness;
            a[(n + j, n + k)] = -h * inverse[(j, k)] * damping[k];
        }
    }
    let Some(schur) = Schur::try_new(a, f64::EPSILON, 10_000) else { return f64::INFINITY };
    let factor = |z: &Complex<f64>| {
        let z = *z;
        let one = Complex::new(1.0, 0.0);
        (one + z * (one + z / 2.0 * (one + z / 3.0 * (one + z / 4.0)))).norm()
    };
    schur.complex_eigenvalues().iter().map(factor).fold(0.0, f64::max)
}

/// Joint-space mass matrix, n x n.
fn mass(arm: &Mechanism, q: &JointVec) -> DMatrix<f64> {
    let n = arm.n;
    let (none, still) = (Vector3::zeros(), [0.0; MAX_JOINTS]);
    let mut matrix = DMatrix::zeros(n, n);
    for j in 0..n {
        let mut ddq = still;
        ddq[j] = 1.0;
        let column = inverse(arm, &none, q, &still, &ddq);
        for k in 0..n {
            matrix[(k, j)] = column[k];
        }
    }
    for j in 0..n {
        for k in 0..j {
            let mean = 0.5 * (matrix[(j, k)] + matrix[(k, j)]);
            (matrix[(j, k)], matrix[(k, j)]) = (mean, mean);
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Gate, Pace, SimArm};
    use plumbline_core::{Backend, Command, Setpoint};
    use plumbline_model::{Mounting, Robot};
    use std::sync::Arc;

    const SHIPPED: &str = include_str!("../../../config/arms/sim-panda.toml");
    const START: JointVec = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5, 0.0];

    fn checked(text: &str) -> Result<(), BadInput> {
        let truth = Truth::parse("arm.toml", text).expect("an arm");
        let robot = Robot::load("panda", None).expect("shipped");
        truth.check_step("arm.toml", &robot.chain, &START, &robot.limits.q_min, &robot.limits.q_max)
    }

    /// Largest torque of the last joint while the arm is pushed and then held.
    fn driven(text: &str) -> f64 {
        let truth = Truth::parse("arm.toml", text).expect("an arm");
        let chain = Robot::load("panda", None).expect("shipped").chain;
        let pace = Pace::Fast(Arc::new(Gate::unlimited()));
        let mut arm = SimArm::new(&chain, &truth, Mounting::WALL, START, 1, pace).expect("an arm");
        let mut most: f64 = 0.0;
        for tick in 0..600 {
            let state = arm.read().expect("a state");
            most = most.max(state.tau[6].abs());
            let mut q = START;
            q[6] += 0.02 * (1.0 - (0.02 * f64::from(tick.min(157))).cos());
            let desired = Setpoint { q, ..Setpoint::default() };
            arm.write(&Command { seq: state.seq, desired, ..Command::default() }).expect("accepted");
        }
        most
    }

    #[test]
    fn the_largest_stable_value_is_stable_and_a_tenth_more_explodes() {
        assert_eq!(checked(SHIPPED), Ok(()));
        let (head, last) = SHIPPED.rsplit_once("damping = 6\n").expect("joint 7's");
        let with = |damping: f64| {
            format!("{head}damping = {damping}\n{last}").replace("torque-noise = 0.06", "torque-noise = 0")
        };
        let bad = checked(&with(60.0)).expect_err("unstable");
        assert_eq!((bad.place.as_str(), bad.value.as_str()), ("joint 7, key `damping`", "60 Nms/rad"));
        let most: f64 = bad.expected.split(' ').nth(2).and_then(|word| word.parse().ok()).expect("a number");
        let steps: u32 = bad.expected.rsplit(' ').next().and_then(|word| word.parse().ok()).expect("a number");
        assert_eq!(checked(&with(most)), Ok(()), "{bad}");
        assert!(checked(&with(1.02 * most)).is_err(), "{bad}");
        assert!(checked(&with(60.0).replace("substeps = 3", &format!("substeps = {steps}"))).is_ok(), "{bad}");
        assert!(checked(&with(60.0).replace("substeps = 3", &format!("substeps = {}", steps - 1))).is_err(), "{bad}");
        // The integration itself agrees.
        assert!(driven(&with(most)) < 30.0, "{}", driven(&with(most)));
        let exploded = driven(&with(2.0 * most));
        assert!(exploded.is_nan() || exploded > 1e3, "{exploded}");
    }

    #[test]
    fn stiffness_and_viscous_friction_are_named_where_they_are_the_cause() {
        let bad = checked(&SHIPPED.replace("stiffness = 2500\ndamping = 17", "stiffness = 25000000\ndamping = 17"));
        assert_eq!(bad.expect_err("unstable").place, "joint 5, key `stiffness`");
        let bad = checked(&SHIPPED.replace("fv = 0.0371", "fv = 371"));
        assert_eq!(bad.expect_err("unstable").place, "joint 7, key `fv`");
    }
}
