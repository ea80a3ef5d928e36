//! Position-dependent friction: a bearing that sits askew or a seal that is not round.
//!
//!   tau_f = (fc + sine sin(order q) + cosine cos(order q)) s(dq),   s(dq) = tanh(100 dq),
//!
//! whose first part every joint has. Source: Popovic and Goldenberg, Modeling of friction using spectral analysis, IEEE Transactions
//! on Robotics and Automation 1998.

use super::*;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Waves per turn.
    #[serde(default = "one")]
    pub order: f64,
    /// Amplitude of the sine \[Nm\].
    #[serde(default)]
    pub sine: f64,
    /// Amplitude of the cosine \[Nm\].
    #[serde(default)]
    pub cosine: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("order", self.order, 0.1, 200.0)?;
        // Friction must not drive the joint.
        let (fc, amplitude) = (place.truth.joints[self.joint - 1].fc, self.sine.hypot(self.cosine));
        if amplitude <= fc {
            return Ok(());
        }
        Err(place.wrong("sine and cosine", amplitude, format!("an amplitude of at most the joint's fc, {fc} Nm")))
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        let (sin, cos) = (self.order * at.q[j]).sin_cos();
        tau[j] -= (self.sine * sin + self.cosine * cos) * sign(at.dq[j]);
    }
}
