//! Direction of gravity in the base frame from the two slopes of an inclinometer.
//!
//! A two-axis inclinometer measures the angles between its x and y axes and the horizontal plane. `u` is the unit vector that points
//! up, in the sensor frame:
//!
//! ```text
//! against the horizon:   u = [sin a, sin b, s sqrt(1 - sin^2 a - sin^2 b)]
//! projected:             u ~ s [tan a, tan b, 1]
//! ```
//!
//! `a` is the longitudinal, `b` the lateral slope. The sign `s` is 1 if the sensor's z axis points up and -1 if it points down. The
//! slopes do not contain it, so it is taken from the declared mounting. A declared mounting with the z axis too close to the horizontal
//! is refused. Gravity is `-g R u` with the sensor's axes `R` in the base frame.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};
use plumbline_core::symmetric_eigen;
use plumbline_model::{G, Mounting};
use serde::Deserialize;

/// Definition of the two slopes, given in the sensor's data sheet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SlopeConvention {
    /// Each axis against the horizontal plane, `asin` of its share of gravity ("perpendicular", "pitch and roll").
    #[default]
    Horizon,
    /// `atan2` of the axis' share of gravity over the z axis' ("projected").
    Projected,
}

/// Orientation of the sensor on the base, its slope definition and its accuracy.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Installation {
    axes: Matrix3<f64>,
    /// Zero offset, subtracted from the measured slopes \[rad\].
    pub zero: [f64; 2],
    pub slopes: SlopeConvention,
    /// Largest slope that the sensor measures \[rad\].
    pub range: f64,
    /// Standard deviation of a slope's error that does not average out \[rad\].
    pub accuracy: f64,
}

/// Invalid sensor axes, or a declared mounting outside the measuring range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum InstallationError {
    #[error("the sensor's x and z axes ({x:?} and {z:?}) are not two unit vectors at right angles")]
    Axes { x: [f64; 3], z: [f64; 3] },
    #[error(
        "in the declared mounting the sensor's slopes would be {:.1} and {:.1} deg, its range is {:.0} deg and its z axis must be \
         within that of the vertical", .slopes[0].to_degrees(), .slopes[1].to_degrees(), .range.to_degrees()
    )]
    OutOfRange { slopes: [f64; 2], range: f64 },
}

/// Measured direction of gravity with its covariance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Covariance of its direction, a unit vector \[rad2\].
    pub covariance: Matrix3<f64>,
}

impl Installation {
    /// Installation from the sensor's x and z axes in the base frame.
    /// Errors: axes that are no unit vectors (to 1 per mille) or not at right angles (to 1 mrad).
    pub fn new(x: [f64; 3], z: [f64; 3]) -> Result<Installation, InstallationError> {
        let (right, up) = (Vector3::from(x), Vector3::from(z));
        let unit = |axis: &Vector3<f64>| (axis.norm() - 1.0).abs() < 1e-3;
        if !(unit(&right) && unit(&up) && right.dot(&up).abs() < 1e-3) {
            return Err(InstallationError::Axes { x, z });
        }
        let up = up.normalize();
        let right = (right - up * up.dot(&right)).normalize();
        let axes = Matrix3::from_columns(&[right, up.cross(&right), up]);
        Ok(Installation {
            axes,
            zero: [0.0; 2],
            slopes: SlopeConvention::Horizon,
            range: 80f64.to_radians(),
            accuracy: 1e-3,
        })
    }

    /// Slopes in a mounting, zero offset included \[rad\]: the inverse of [`Installation::attitude`].
    pub fn expected(&self, mounting: &Mounting) -> [f64; 2] {
        let up = self.axes.transpose() * -mounting.gravity() / G;
        let raw = match self.slopes {
            SlopeConvention::Horizon => [up.x.clamp(-1.0, 1.0).asin(), up.y.clamp(-1.0, 1.0).asin()],
            SlopeConvention::Projected => [(up.x / up.z).atan(), (up.y / up.z).atan()],
        };
        [raw[0] + self.zero[0], raw[1] + self.zero[1]]
    }

    /// Sign of the sensor's z axis in a mounting: 1 up, -1 down.
    /// Errors: a mounting in which the z axis is too close to the horizontal, or a slope is out of range.
    pub fn hemisphere(&self, declared: &Mounting) -> Result<f64, InstallationError> {
        let up = (self.axes.transpose() * -declared.gravity() / G).z;
        let slopes = self.expected(declared);
        let in_range = slopes.iter().all(|slope| slope.abs() <= self.range) && up.abs() >= self.range.cos();
        if in_range && up != 0.0 {
            Ok(up.signum())
        } else {
            Err(InstallationError::OutOfRange { slopes, range: self.range })
        }
    }

    /// Gravity from two slopes \[rad\] with independent standard deviations \[rad\]. `None` for slopes that no direction has, or out of
    /// range.
    pub fn attitude(&self, slopes: [f64; 2], std: [f64; 2], hemisphere: f64) -> Option<Attitude> {
        let [a, b] = [slopes[0] - self.zero[0], slopes[1] - self.zero[1]];
        if !slopes.iter().all(|slope| slope.abs() <= self.range) {
            return None;
        }
        let (up, jacobian) = match self.slopes {
            SlopeConvention::Horizon => horizon(a, b, hemisphere)?,
            SlopeConvention::Projected => projected(a, b, hemisphere)?,
        };
        let jacobian = self.axes * jacobian;
        let total = |random: f64| random.powi(2) + self.accuracy.powi(2);
        let variance = nalgebra::Matrix2::from_diagonal(&Vector2::new(total(std[0]), total(std[1])));
        Some(Attitude { gravity: -G * (self.axes * up), covariance: jacobian * variance * jacobian.transpose() })
    }
}

/// Up vector and its derivatives for slopes against the horizontal plane.
fn horizon(a: f64, b: f64, s: f64) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    let (x, y) = (a.sin(), b.sin());
    let z_squared = 1.0 - x * x - y * y;
    // Two perpendicular axes can't both be vertical.
    if z_squared.is_nan() || z_squared <= 1e-6 {
        return None;
    }
    let z = s * z_squared.sqrt();
    let jacobian = Matrix3x2::new(a.cos(), 0.0, 0.0, b.cos(), -x * a.cos() / z, -y * b.cos() / z);
    Some((Vector3::new(x, y, z), jacobian))
}

/// Up vector and its derivatives for projected slopes: `u = w / |w|`, `du = (1 - u u') dw / |w|`.
fn projected(a: f64, b: f64, s: f64) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    if !(a.cos() > 1e-3 && b.cos() > 1e-3) {
        return None;
    }
    let w = s * Vector3::new(a.tan(), b.tan(), 1.0);
    let length = w.norm();
    let up = w / length;
    let projector = Matrix3::identity() - up * up.transpose();
    let dw = s * Matrix3x2::new(a.cos().powi(-2), 0.0, 0.0, b.cos().powi(-2), 0.0, 0.0);
    Some((up, projector * dw / length))
}

impl Attitude {
    /// The mounting angles of paper eq. 3.
    pub fn mounting(&self) -> Mounting {
        Mounting::along(&self.gravity)
    }

    /// Standard deviation of the direction along its least certain axis \[rad\].
    pub fn std(&self) -> f64 {
        let eigen = symmetric_eigen(self.covariance);
        eigen.map_or(f64::INFINITY, |eigen| eigen.eigenvalues.max().max(0.0).sqrt())
    }

    /// Standard deviations of `rho` and `phi` \[rad\]. That of `phi` is at most pi: `phi` is undefined with gravity along axis 1.
    pub fn std_of_angles(&self) -> [f64; 2] {
        let Mounting { rho, phi } = self.mounting();
        let ((sin_rho, cos_rho), (sin_phi, cos_phi)) = (rho.sin_cos(), phi.sin_cos());
        let along_rho = Vector3::new(cos_rho * cos_phi, cos_rho * sin_phi, -sin_rho);
        let along_phi = Vector3::new(-sin_phi, cos_phi, 0.0);
        let std = |along: Vector3<f64>| (along.transpose() * self.covariance * along).x.max(0.0).sqrt();
        [std(along_rho), (std(along_phi) / sin_rho.abs().max(1e-12)).min(std::f64::consts::PI)]
    }
}
