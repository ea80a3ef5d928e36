//! Payload: an undeclared body on a link, picked up at `from`.

use super::*;
use crate::truth::{Inside, Truth, check_body, symmetric};

/// A rigid body fixed to a link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
}

struct Payload {
    link: usize,
    inertia: Inertia,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        self.link.map_or(Ok(()), |link| place.one_of_the_joints("link", link))?;
        check_body(place.file, place.name, self.mass, &self.com, &self.inertia, Inside::MayBeZero)
    }

    fn build(&self, truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(Payload {
            link: self.link.unwrap_or(truth.joints()) - 1,
            inertia: Inertia::rigid(self.mass, self.com.into(), symmetric(&self.inertia)),
        })
    }
}

impl Effect for Payload {
    fn inertia(&self, _t: f64) -> Option<(usize, Inertia)> {
        Some((self.link, self.inertia))
    }
}
