//! Nonlinear viscous friction: a lubricant that thins with shear, or churning that grows faster than speed. Adds one of
//!
//! | form | torque | size in |
//! |---|---|---|
//! | `sigmoid` | `size (S((dq + shift) / velocity) - S(shift / velocity))`, `S(x) = 1 / (1 + exp(-x))` | Nm |
//! | `cubic` | `size dq^3` | Nms3/rad3 |
//! | `quadratic` | `size dq abs(dq)` | Nms2/rad2 |
//!
//! Sources: the sigmoid is that of Gaz, Cognetti, Oliva, Robuffo Giordano and De Luca, Dynamic identification of the Franka Emika Panda
//! robot with retrieval of feasible parameters, RA-L 2019 (`phi_1 = size`, `phi_2 = 1 / velocity`, `phi_3 = shift`); the powers are in Bona and
//! Indri, Friction compensation in robotics: an overview, CDC 2005.

use super::*;

/// The shape of the friction over velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// A smooth step, which Coulomb and viscous friction do not describe.
    Sigmoid,
    /// The third power.
    Cubic,
    /// The second power, odd.
    Quadratic,
}

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Shape.
    pub form: Form,
    /// Coefficient, see the table.
    pub size: f64,
    /// Width of the sigmoid; other forms have none \[rad/s\].
    pub velocity: Option<f64>,
    /// Distance of the sigmoid's middle below zero velocity \[rad/s\].
    #[serde(default)]
    pub shift: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("size", self.size, 0.0, 100.0)?;
        match (self.form, self.velocity) {
            (Form::Sigmoid, None) => {
                return Err(place.wrong("velocity", "nothing", "the width of the sigmoid [rad/s]"));
            }
            (Form::Sigmoid, Some(velocity)) => place.range("velocity", velocity, 1e-3, 10.0)?,
            (_, Some(velocity)) => {
                return Err(place.wrong("velocity", velocity, "nothing: only a sigmoid has a width"));
            }
            (_, None) => {}
        }
        if self.form != Form::Sigmoid && self.shift != 0.0 {
            return Err(place.wrong("shift", self.shift, "nothing: only a sigmoid has a shift"));
        }
        place.range("shift", self.shift, -1.0, 1.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        let (dq, width) = (at.dq[j], self.velocity.unwrap_or(1.0));
        let sigmoid = |v: f64| 1.0 / (1.0 + (-v / width).exp());
        tau[j] -= self.size
            * match self.form {
                Form::Sigmoid => sigmoid(dq + self.shift) - sigmoid(self.shift),
                Form::Cubic => dq * dq * dq,
                Form::Quadratic => dq * dq.abs(),
            };
    }
}
