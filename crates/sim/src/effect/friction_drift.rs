//! Friction drift: the lubricant warms up and thins.
//!
//!   tau_f = (1 + share g(t)) (fv dq + fc tanh(100 dq)),   g(t) = 1 - exp(-(t - from) / time), or (t - from) / time.
//!
//! The joint's declared friction law changes; effects that add to it, or replace its Coulomb part, stay as they are.
//! Source: Simoni, Beschi, Legnani and Visioli, Friction modeling with temperature effects for industrial robot manipulators, IROS 2015.

use super::trend::check_time;
use super::*;

/// Scales the friction of one joint, or of all.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1; all of them where absent.
    pub joint: Option<usize>,
    /// Change of the friction, relative to the declared one: -0.3 is what a warm joint has less.
    pub share: f64,
    /// Time constant, or the time in which a linear drift does it \[s\].
    pub time: f64,
    /// Course.
    #[serde(default)]
    pub trend: Trend,
}

struct FrictionDrift {
    config: Config,
    from: f64,
    friction: Friction,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        self.joint.map_or(Ok(()), |joint| place.joint(joint))?;
        place.range("share", self.share, -1.0, 10.0)?;
        check_time(place, self.time)
    }

    fn build(&self, truth: &Truth, from: f64) -> Box<dyn Effect> {
        Box::new(FrictionDrift { config: *self, from, friction: Friction::new(truth, |j| truth.replaces_coulomb(j)) })
    }
}

impl Effect for FrictionDrift {
    fn repeats(&self, _period: f64) -> bool {
        false
    }

    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let course = self.config.trend.at(at.t - self.from, self.config.time);
        // A linear drift ends where no friction is left.
        let share = (self.config.share * course).max(-1.0);
        for j in (0..at.n).filter(|j| self.config.joint.is_none_or(|joint| joint == j + 1)) {
            tau[j] -= share * self.friction.at(j, at.dq[j]);
        }
    }
}
