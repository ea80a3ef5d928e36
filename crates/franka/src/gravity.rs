//! The gravity that the arm compensates, from its state and the settings; the direction that its sensors show, from states at rest.

use super::error::ConnectError;
use super::settings::PLAUSIBLE_GRAVITY;
use super::wire::RobotState;

/// States at rest that an estimate needs.
pub(super) const STATES: usize = 200;
/// Fastest joint of an arm at rest \[rad/s\]: its velocities are noisy.
const REST: f64 = 0.02;
/// Sensors that are farther apart than this don't mean what is assumed of their frames \[rad\].
const AGREE: f64 = 0.35;

/// Where a direction comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Source {
    /// `O_ddP_O`, which libfranka documents as a constant of the arm, upright whatever the mounting.
    Base,
    /// The accelerometers of the links, carried to the base along the measured joint positions.
    Accelerometers,
}

/// The direction of the gravitational acceleration in the base frame, as the arm sees it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Gravity {
    /// Unit vector; (0, 0, -1) for an arm on a table.
    pub direction: [f64; 3],
    /// Largest angle between `direction` and any single source that it was made from \[rad\].
    pub spread: f64,
    /// Where it comes from.
    pub source: Source,
    /// Direction of `O_ddP_O`, the arm's own setting.
    pub base: [f64; 3],
    /// The largest angle between the mean of all accelerometers and any one of them, where there are any \[rad\]. Franka documents no frames
    /// for them; each is taken to lie in the frame of its link. When this exceeds 0.35 rad the assumption is wrong for this arm, and
    /// the direction is `base`.
    pub accelerometers: Option<f64>,
    /// States that were averaged.
    pub states: usize,
}

/// Largest distance of a declared compensation from the one of the state, 3 degrees of gravity \[m/s2\].
const DECLARED: f64 = 0.5;

/// The documented `O_ddP_O`, whatever the mounting \[m/s2\].
const UPRIGHT: [f64; 3] = [0.0, 0.0, -9.81];

/// Gravity in the base frame that the arm's own controller adds torque against \[m/s2\]: `O_ddP_O` of `state`, which `declared` must agree
/// with. Where the state shows no gravity, the declared one, else the documented one.
///
/// # Errors
/// [`ConnectError::Compensation`] where both disagree; [`ConnectError::NoCompensation`] where neither names one and torques are `commanded`.
pub(super) fn compensated(
    state: &RobotState,
    declared: Option<[f64; 3]>,
    commanded: bool,
) -> Result<[f64; 3], ConnectError> {
    let shown = state.o_ddp_o;
    match (unit(shown), declared) {
        (Some(_), Some(declared)) => {
            let off = (0..3).map(|i| (declared[i] - shown[i]).powi(2)).sum::<f64>().sqrt();
            // Written so that a NaN disagrees.
            if off <= DECLARED { Ok(shown) } else { Err(ConnectError::Compensation { declared, shown }) }
        }
        (Some(_), None) => Ok(shown),
        (None, Some(declared)) => Ok(declared),
        (None, None) if commanded => Err(ConnectError::NoCompensation { shown }),
        (None, None) => Ok(UPRIGHT),
    }
}

/// Sums over states at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Estimate {
    states: usize,
    base: [f64; 3],
    sensors: [[f64; 3]; 12],
}

impl Estimate {
    /// Adds a state; one in motion starts the estimate afresh.
    pub fn add(&mut self, state: &RobotState) {
        if state.dq.iter().any(|dq| dq.is_nan() || dq.abs() > REST) {
            *self = Estimate::default();
            return;
        }
        self.states += 1;
        self.base = sum(self.base, state.o_ddp_o);
        let mut rotation = IDENTITY;
        for link in 0..6 {
            rotation = product(&rotation, &joint(link, state.q[link]));
            for (row, reading) in [(0, state.accelerometer_top[link]), (6, state.accelerometer_bottom[link])] {
                // At rest a sensor shows what holds it up: the opposite of gravity.
                self.sensors[row + link] = sum(self.sensors[row + link], apply(&rotation, reading).map(|x| -x));
            }
        }
    }

    /// Whether there are enough.
    pub fn is_complete(&self) -> bool {
        self.states >= STATES
    }

    /// The result; `None` without enough states, or when they hold no gravity.
    pub fn gravity(&self) -> Option<Gravity> {
        if !self.is_complete() {
            return None;
        }
        let mean = |total: [f64; 3]| total.map(|x| x / self.states as f64);
        let base = unit(mean(self.base))?;
        let of_base = Gravity {
            direction: base,
            spread: 0.0,
            source: Source::Base,
            base,
            accelerometers: None,
            states: self.states,
        };
        let directions: Vec<[f64; 3]> = self.sensors.iter().filter_map(|total| unit(mean(*total))).collect();
        let Some(direction) = unit(
            directions
                .iter()
                .fold([0.0; 3], |total, next| sum(total, *next))
                .map(|x| x * 9.81 / directions.len().max(1) as f64),
        ) else {
            // No sensors, or they contradict each other to nothing.
            let accelerometers = (!directions.is_empty()).then_some(std::f64::consts::PI);
            return Some(Gravity { accelerometers, ..of_base });
        };
        let spread = directions.iter().map(|other| angle(&direction, other)).fold(0.0, f64::max);
        let accelerometers = Some(spread);
        if spread > AGREE {
            return Some(Gravity { accelerometers, ..of_base });
        }
        Some(Gravity { direction, spread, source: Source::Accelerometers, accelerometers, ..of_base })
    }
}

type Matrix = [[f64; 3]; 3];
const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Rotation of a link's frame in the one before: `Rot(x, alpha) Rot(z, q)`, modified DH of Panda and FR3 alike.
fn joint(link: usize, q: f64) -> Matrix {
    // Sine of alpha; its cosine is 1 for the first link and 0 for the others.
    const SIN: [f64; 6] = [0.0, -1.0, 1.0, 1.0, -1.0, 1.0];
    let (sa, ca) = (SIN[link], if link == 0 { 1.0 } else { 0.0 });
    let (s, c) = q.sin_cos();
    [[c, -s, 0.0], [s * ca, c * ca, -sa], [s * sa, c * sa, ca]]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

fn apply(a: &Matrix, x: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| (0..3).map(|k| a[i][k] * x[k]).sum())
}

fn sum(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] + b[i])
}

fn unit(x: [f64; 3]) -> Option<[f64; 3]> {
    let norm = x.iter().map(|x| x * x).sum::<f64>().sqrt();
    PLAUSIBLE_GRAVITY.contains(&norm).then(|| x.map(|x| x / norm))
}

fn angle(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let cross = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let dot: f64 = (0..3).map(|k| a[k] * b[k]).sum();
    cross.iter().map(|x| x * x).sum::<f64>().sqrt().atan2(dot)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use plumbline_model::{Mounting, Robot};

    const Q: [f64; 7] = [0.4, -0.3, 0.7, -1.9, 0.2, 1.6, 0.5];

    /// States at rest in `mounting`; the sensors' readings come from the robot's own kinematics.
    fn rest(mounting: Mounting, noise: f64) -> RobotState {
        let chain = Robot::load("panda", None).unwrap().chain;
        let gravity = mounting.gravity();
        let mut state = RobotState { q: Q, o_ddp_o: [0.0, 0.0, -9.81], ..RobotState::default() };
        let mut rotation = nalgebra::Matrix3::identity();
        for (link, joint) in chain.joints().iter().enumerate().take(6) {
            rotation *= joint.placement(Q[link]).rotation;
            let reading: Vector3<f64> = rotation.transpose() * -gravity;
            state.accelerometer_top[link] = [reading.x + noise, reading.y, reading.z];
            state.accelerometer_bottom[link] = [reading.x, reading.y - noise, reading.z];
        }
        state
    }

    fn estimate(state: &RobotState) -> Option<Gravity> {
        let mut estimate = Estimate::default();
        (0..STATES).for_each(|_| estimate.add(state));
        estimate.gravity()
    }

    #[test]
    fn accelerometers_show_the_true_mounting_where_the_arms_constant_does_not() {
        for mounting in [Mounting::UPRIGHT, Mounting::WALL, Mounting::CEILING] {
            let gravity = estimate(&rest(mounting, 0.05)).unwrap();
            let truth = mounting.gravity().normalize();
            assert_eq!((gravity.source, gravity.base), (Source::Accelerometers, [0.0, 0.0, -1.0]));
            assert!(angle(&gravity.direction, &[truth.x, truth.y, truth.z]) < 0.01, "{gravity:?} {truth:?}");
            assert!(gravity.spread > 1e-4 && gravity.spread < 0.02, "{gravity:?}");
        }
    }

    #[test]
    fn without_sensors_or_with_senseless_ones_the_arms_own_word_counts() {
        let mut state = rest(Mounting::WALL, 0.0);
        state.accelerometer_top = [[0.0; 3]; 6];
        state.accelerometer_bottom = [[0.0; 3]; 6];
        let gravity = estimate(&state).unwrap();
        assert_eq!((gravity.source, gravity.direction, gravity.accelerometers), (Source::Base, [0.0, 0.0, -1.0], None));
        // Sensors in other frames than the links' contradict each other.
        state.accelerometer_top = [[9.81, 0.0, 0.0]; 6];
        state.accelerometer_bottom = [[0.0, 0.0, 9.81]; 6];
        let gravity = estimate(&state).unwrap();
        assert_eq!(gravity.source, Source::Base);
        assert!(gravity.accelerometers.is_some_and(|spread| spread > AGREE));
    }

    #[test]
    fn the_states_own_value_is_compensated_and_a_declaration_that_disagrees_is_refused() {
        let of = |shown| RobotState { o_ddp_o: shown, ..RobotState::default() };
        let (upright, wall) = ([0.0, 0.0, -9.81], [9.81, 0.0, 0.0]);
        for commanded in [false, true] {
            let known =
                |shown, declared| compensated(&of(shown), declared, commanded).map_err(|error| error.to_string());
            assert_eq!(known(upright, None), Ok(upright));
            assert_eq!(known(wall, None), Ok(wall));
            // The declaration is held against the state, and the state's own value is what counts.
            assert_eq!(known(upright, Some([0.3, 0.0, -9.8])), Ok(upright));
            for (shown, declared) in
                [(upright, wall), (wall, upright), (upright, [0.0, 0.0, 9.81]), (upright, [0.6, 0.0, -9.8])]
            {
                let text = known(shown, Some(declared)).unwrap_err();
                assert!(text.contains("compensates") && text.contains("O_ddP_O"), "{text}");
            }
            // A state without a gravity.
            assert_eq!(known([0.0; 3], Some(wall)), Ok(wall));
            assert_eq!(known([f64::NAN; 3], None).is_err(), commanded);
            assert_eq!(known([0.0; 3], None).is_err(), commanded);
        }
        assert_eq!(compensated(&of([0.0; 3]), None, false).unwrap(), upright);
    }

    #[test]
    fn a_moving_arm_gives_no_estimate() {
        let mut state = rest(Mounting::WALL, 0.0);
        let mut estimate = Estimate::default();
        (0..STATES - 1).for_each(|_| estimate.add(&state));
        assert_eq!(estimate.gravity(), None);
        state.dq[3] = 0.5;
        estimate.add(&state);
        state.dq[3] = 0.0;
        estimate.add(&state);
        assert_eq!((estimate.gravity(), estimate.states), (None, 1));
        state.o_ddp_o = [0.0; 3];
        assert_eq!(super::tests::estimate(&state), None);
    }
}
