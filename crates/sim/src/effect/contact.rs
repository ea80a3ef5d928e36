//! Contact: an external wrench on a link for a limited time.
//!
//!   tau + J' w(t) moves the arm, w(t) = b(t) (force, moment) at `point` of `link`,
//!
//! where `b` rises from 0 to 1 within `edge` after `from`, and falls within `edge` before `to`, along half a cosine. With `every` the contact
//! repeats, as that with an obstacle in the way of a periodic motion.
//! Source: Haddadin, De Luca and Albu-Schaeffer, Robot collisions: a survey, T-RO 2017.

use super::*;
use std::f64::consts::PI;

/// A force of limited duration, first from `from` on.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Link that is touched, counted from 1; the last one where absent.
    pub link: Option<usize>,
    /// Where, in the link's frame \[m\].
    #[serde(default)]
    pub point: [f64; 3],
    /// Force on the arm, in the base frame \[N\].
    #[serde(default)]
    pub force: [f64; 3],
    /// Moment on the arm, in the base frame \[Nm\].
    #[serde(default)]
    pub moment: [f64; 3],
    /// End of the first contact \[s\].
    pub to: f64,
    /// Time of rise and fall \[s\].
    #[serde(default = "tenth")]
    pub edge: f64,
    /// Period of the contact; absent for a single one \[s\].
    pub every: Option<f64>,
}

struct Contact {
    config: Config,
    from: f64,
    wrench: External,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        self.link.map_or(Ok(()), |link| place.one_of_the_joints("link", link))?;
        place.finite("point", &self.point)?;
        place.finite("force", &self.force)?;
        place.finite("moment", &self.moment)?;
        // At least ten steps of the integration.
        place.range("edge", self.edge, 0.002, 1e3)?;
        let (length, least) = (self.to - place.from, 2.0 * self.edge);
        if !(self.to.is_finite() && length >= least) {
            return Err(place.wrong(
                "to",
                self.to,
                format!("at least two edges, {least} s, after `from`, {} s", place.from),
            ));
        }
        match self.every {
            Some(every) if !(every.is_finite() && every >= length) => {
                Err(place.wrong("every", every, format!("at least as long as the contact, {length} s")))
            }
            _ => Ok(()),
        }
    }

    fn build(&self, truth: &Truth, from: f64) -> Box<dyn Effect> {
        let link = self.link.unwrap_or(truth.joints()) - 1;
        let (point, force, moment) = (self.point.into(), self.force.into(), self.moment.into());
        Box::new(Contact { config: *self, from, wrench: External { link, point, force, moment } })
    }
}

impl Contact {
    /// Share of the force at time `t`.
    fn share(&self, t: f64) -> f64 {
        let since = t - self.from;
        let since = self.config.every.map_or(since, |every| since.rem_euclid(every));
        let left = self.config.to - self.from - since;
        let near = (since.min(left) / self.config.edge).clamp(0.0, 1.0);
        0.5 * (1.0 - (PI * near).cos())
    }
}

impl Effect for Contact {
    fn repeats(&self, period: f64) -> bool {
        let times = self.config.every.map_or(0.5, |every| period / every);
        times >= 0.5 && (times - times.round()).abs() < 1e-9 * times
    }

    fn wrench(&self, at: &At) -> Option<External> {
        let share = self.share(at.t);
        let scaled = |vector: Vector3<f64>| share * vector;
        (share > 0.0).then(|| External {
            force: scaled(self.wrench.force),
            moment: scaled(self.wrench.moment),
            ..self.wrench
        })
    }
}
