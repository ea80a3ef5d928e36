//! Payload: a body on a link that nobody declared, from some moment on.

use super::{Effect, check_range};
use crate::backend::sim::spatial::Inertia;
use crate::backend::sim::truth::{Inside, Truth, check_body, symmetric};
use crate::input::BadInput;
use serde::Deserialize;

/// A rigid body fixed to a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Link it is fixed to, counted from 1; the last one where absent.
    pub link: Option<usize>,
    /// Mass \[kg\].
    pub mass: f64,
    /// Centre of mass in the link's frame \[m\].
    pub com: [f64; 3],
    /// Inertia about the centre of mass, in the link frame's axes, `[Ixx Ixy Ixz Iyy Iyz Izz]`; a point where absent \[kg m2\].
    #[serde(default)]
    pub inertia: [f64; 6],
    /// Time at which it is picked up \[s\].
    #[serde(default)]
    pub from: f64,
}

pub(super) struct Payload {
    link: usize,
    inertia: Inertia,
    from: f64,
}

impl Config {
    pub(super) fn check(&self, file: &str, place: &str, truth: &Truth) -> Result<(), BadInput> {
        let n = truth.joints();
        if let Some(link) = self.link.filter(|link| !(1..=n).contains(link)) {
            return Err(BadInput::new(file, format!("{place}, link"), link, format!("1 to {n}")));
        }
        check_body(file, place, self.mass, &self.com, &self.inertia, Inside::MayBeZero)?;
        check_range(file, place, "from", self.from, 0.0, 1e9)
    }

    pub(super) fn build(&self, truth: &Truth) -> Payload {
        Payload {
            link: self.link.unwrap_or(truth.joints()) - 1,
            inertia: Inertia::rigid(self.mass, self.com.into(), symmetric(&self.inertia)),
            from: self.from,
        }
    }
}

impl Effect for Payload {
    fn inertia(&self, t: f64) -> Option<(usize, Inertia)> {
        (t >= self.from).then_some((self.link, self.inertia))
    }
}
