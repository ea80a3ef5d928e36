//! Mounting: another mounting than declared. Gravity in the base frame is
//!
//!   R' a_g, with R the rotation of the base by the vector `tilt` from the declared mounting,
//!
//! or that of the angles `rho` and `phi` (paper eq. 3). The arm's controller uses the declared gravity.

use super::*;
use nalgebra::{Rotation3, Vector3};
use plumbline_model::Mounting;

/// Either `tilt`, or `rho` and `phi`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Rotation vector in the axes of the declared base frame \[rad\].
    pub tilt: Option<[f64; 3]>,
    /// True angle between base z axis and gravity \[rad\].
    pub rho: Option<f64>,
    /// True direction of gravity about the base z axis \[rad\].
    pub phi: Option<f64>,
}

enum ActualGravity {
    Rotated(Rotation3<f64>),
    Fixed(Vector3<f64>),
}

impl Config {
    fn actual(&self) -> Option<ActualGravity> {
        match (self.tilt, self.rho, self.phi) {
            (Some(tilt), None, None) => Some(ActualGravity::Rotated(Rotation3::new(Vector3::from(tilt)))),
            (None, Some(rho), Some(phi)) => Some(ActualGravity::Fixed(Mounting { rho, phi }.gravity())),
            _ => None,
        }
    }
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        let given = [self.tilt.map(|_| "tilt"), self.rho.map(|_| "rho"), self.phi.map(|_| "phi")];
        if self.actual().is_none() {
            let keys: Vec<&str> = given.into_iter().flatten().collect();
            return Err(place.wrong("keys", keys.join(", "), "`tilt`, or `rho` and `phi`"));
        }
        let tilt = self.tilt.unwrap_or_default();
        place.finite("tilt", &tilt)?;
        place.finite("rho and phi", &[self.rho.unwrap_or(0.0), self.phi.unwrap_or(0.0)])
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(self.actual().unwrap_or(ActualGravity::Rotated(Rotation3::identity())))
    }
}

impl Effect for ActualGravity {
    fn gravity(&self, _t: f64, gravity: &mut Vector3<f64>) {
        *gravity = match self {
            ActualGravity::Rotated(rotation) => rotation.inverse_transform_vector(gravity),
            ActualGravity::Fixed(actual) => *actual,
        };
    }
}
