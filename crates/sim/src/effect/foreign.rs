//! Effects that the model's catalogue lacks, to test what a diagnosis reports of unknown effects.
//!
//! Each takes a torque `size f` \[Nm\] of `joint`; q and dq are those of the joints named in the table, g(x) = exp(-x^2).
//!
//! | form | f |
//! |---|---|
//! | `windowed-sine` | `sin(order q_first) g((q_second - middle) / width)` |
//! | `bump` | `g((q_first - middle) / width) g((dq_second - speed) / spread)` |
//! | `region` | `(1 + tanh((q_first - middle) / width)) / 2`: a step of torque over another joint's position |
//! | `product` | `tanh(q_first / width) dq_second` |
//! | `beat` | `sin(4 pi x) sin(pi x)^2`, `x = t / every - floor(t / every)`: a function of time, the same in every period |

use super::*;
use std::f64::consts::PI;

/// Form of the effect. Joints count from 1.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "form", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Config {
    /// A ripple near one position of another joint.
    WindowedSine {
        /// Joint of the torque.
        joint: usize,
        /// Height \[Nm\].
        size: f64,
        /// Joint of the ripple.
        first: usize,
        /// Waves in a turn.
        order: f64,
        /// Joint of the window.
        second: usize,
        /// Middle of the window \[rad\].
        middle: f64,
        /// Width of the window \[rad\].
        width: f64,
    },
    /// A local torque in the plane of one joint's position and another's velocity.
    Bump {
        /// Joint of the torque.
        joint: usize,
        /// Height \[Nm\].
        size: f64,
        /// Joint of the position.
        first: usize,
        /// Position of the top \[rad\].
        middle: f64,
        /// Width in position \[rad\].
        width: f64,
        /// Joint of the velocity.
        second: usize,
        /// Velocity of the top \[rad/s\].
        speed: f64,
        /// Width in velocity \[rad/s\].
        spread: f64,
    },
    /// A step of torque over a joint's position.
    Region {
        /// Joint of the torque.
        joint: usize,
        /// Height \[Nm\].
        size: f64,
        /// Joint of the place.
        first: usize,
        /// Place of the step \[rad\].
        middle: f64,
        /// Width of the step \[rad\].
        width: f64,
    },
    /// Viscous friction whose sign depends on another joint's position.
    Product {
        /// Joint of the torque.
        joint: usize,
        /// Drag \[Nms/rad\].
        size: f64,
        /// Joint of the position.
        first: usize,
        /// Width of the turn \[rad\].
        width: f64,
        /// Joint of the velocity.
        second: usize,
    },
    /// A function of time.
    Beat {
        /// Joint of the torque.
        joint: usize,
        /// Height \[Nm\].
        size: f64,
        /// Period \[s\].
        every: f64,
    },
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        let (joint, size) = self.what();
        place.joint(joint)?;
        place.range("size", size, -100.0, 100.0)?;
        let joints = |first, second| {
            place.one_of_the_joints("first", first)?;
            place.one_of_the_joints("second", second)
        };
        let window = |middle, width| {
            place.range("middle", middle, -100.0, 100.0)?;
            place.range("width", width, 1e-2, 100.0)
        };
        match *self {
            Config::WindowedSine { first, order, second, middle, width, .. } => {
                joints(first, second)?;
                place.range("order", order, 0.1, 200.0)?;
                window(middle, width)
            }
            Config::Bump { first, middle, width, second, speed, spread, .. } => {
                joints(first, second)?;
                window(middle, width)?;
                place.range("speed", speed, -100.0, 100.0)?;
                place.range("spread", spread, 1e-2, 100.0)
            }
            Config::Region { first, middle, width, .. } => {
                place.one_of_the_joints("first", first)?;
                window(middle, width)
            }
            Config::Product { first, width, second, .. } => {
                joints(first, second)?;
                window(0.0, width)
            }
            Config::Beat { every, .. } => place.range("every", every, 0.1, 1e6),
        }
    }
}

impl Config {
    /// Joint of the torque, counted from 1, and size.
    fn what(&self) -> (usize, f64) {
        match *self {
            Config::WindowedSine { joint, size, .. }
            | Config::Bump { joint, size, .. }
            | Config::Region { joint, size, .. }
            | Config::Product { joint, size, .. }
            | Config::Beat { joint, size, .. } => (joint, size),
        }
    }

    /// `f` of the table.
    fn shape(&self, at: &At) -> f64 {
        let (q, dq) = (|joint: usize| at.q[joint - 1], |joint: usize| at.dq[joint - 1]);
        let g = |x: f64| (-x * x).exp();
        match *self {
            Config::WindowedSine { first, order, second, middle, width, .. } => {
                (order * q(first)).sin() * g((q(second) - middle) / width)
            }
            Config::Bump { first, middle, width, second, speed, spread, .. } => {
                g((q(first) - middle) / width) * g((dq(second) - speed) / spread)
            }
            Config::Region { first, middle, width, .. } => 0.5 * (1.0 + ((q(first) - middle) / width).tanh()),
            Config::Product { first, width, second, .. } => (q(first) / width).tanh() * dq(second),
            Config::Beat { every, .. } => {
                let x = (at.t / every).fract();
                (4.0 * PI * x).sin() * (PI * x).sin().powi(2)
            }
        }
    }
}

impl Effect for Config {
    fn repeats(&self, period: f64) -> bool {
        match *self {
            Config::Beat { every, .. } => {
                let times = period / every;
                times >= 0.5 && (times - times.round()).abs() < 1e-9 * times
            }
            _ => true,
        }
    }

    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let (joint, size) = self.what();
        tau[joint - 1] -= size * self.shape(at);
    }
}
