//! From two slopes to the direction of gravity in the base frame.
//!
//! A two-axis inclinometer measures how far its x and y axes stand out of the horizontal plane. With `u` the unit vector that points up,
//! in the sensor's own frame,
//!
//! ```text
//! against the horizon:   u = [sin a, sin b, s sqrt(1 - sin^2 a - sin^2 b)]
//! projected:             u ~ s [tan a, tan b, 1]
//! ```
//!
//! `a` is the longitudinal, `b` the lateral slope. The sign `s` (whether its z axis points up or down) can't be measured: a sensor that
//! hangs shows the same slopes as one that stands. The declared mounting decides it, and a declaration that lies too close to the
//! horizontal for that is refused. Gravity is `-g R u` with the sensor's axes `R` in the base frame.

use nalgebra::{Matrix3, Matrix3x2, Vector2, Vector3};
use plumbline_core::symmetric_eigen;
use plumbline_model::{G, Mounting};

/// What the angles of a two-axis sensor mean; the data sheet says it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Slopes {
    /// Each axis against the horizontal plane, `asin` of its share of gravity ("perpendicular", "pitch and roll").
    #[default]
    Horizon,
    /// `atan2` of the axis' share of gravity over the z axis' ("projected").
    Projected,
}

/// How the sensor sits on the base, and how good it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seat {
    axes: Matrix3<f64>,
    /// Taken off the slopes before anything else \[rad\].
    pub zero: [f64; 2],
    /// What the slopes mean.
    pub slopes: Slopes,
    /// Largest slope that the sensor measures \[rad\].
    pub range: f64,
    /// Standard deviation of a slope's error that does not average out \[rad\].
    pub accuracy: f64,
}

/// A seat that no sensor can have, or that can't see the declared mounting.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SeatError {
    /// The axes are not unit vectors at right angles.
    #[error("the sensor's x and z axes ({x:?} and {z:?}) are not two unit vectors at right angles")]
    Axes {
        /// The x axis.
        x: [f64; 3],
        /// The z axis.
        z: [f64; 3],
    },
    /// In the declared mounting the sensor would stand too steep.
    #[error(
        "in the declared mounting the sensor's slopes would be {:.1} and {:.1} deg, its range is {:.0} deg and its z axis must be \
         within that of the vertical", .slopes[0].to_degrees(), .slopes[1].to_degrees(), .range.to_degrees()
    )]
    Blind {
        /// The slopes it would show \[rad\].
        slopes: [f64; 2],
        /// Its range \[rad\].
        range: f64,
    },
}

/// A direction of gravity and how well it is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Attitude {
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Covariance of its direction, a unit vector \[rad2\].
    pub covariance: Matrix3<f64>,
}

impl Seat {
    /// A seat with the sensor's x and z axes given in the base frame.
    ///
    /// # Errors
    /// Axes that are no unit vectors (to 1 per mille) or not at right angles (to 1 mrad).
    pub fn new(x: [f64; 3], z: [f64; 3]) -> Result<Seat, SeatError> {
        let (right, up) = (Vector3::from(x), Vector3::from(z));
        let unit = |axis: &Vector3<f64>| (axis.norm() - 1.0).abs() < 1e-3;
        if !(unit(&right) && unit(&up) && right.dot(&up).abs() < 1e-3) {
            return Err(SeatError::Axes { x, z });
        }
        let up = up.normalize();
        let right = (right - up * up.dot(&right)).normalize();
        let axes = Matrix3::from_columns(&[right, up.cross(&right), up]);
        Ok(Seat { axes, zero: [0.0; 2], slopes: Slopes::Horizon, range: 80f64.to_radians(), accuracy: 1e-3 })
    }

    /// The slopes that the sensor shows in a mounting, its zeros included \[rad\]: the inverse of [`Seat::attitude`].
    pub fn expected(&self, mounting: &Mounting) -> [f64; 2] {
        let up = self.axes.transpose() * -mounting.gravity() / G;
        let raw = match self.slopes {
            Slopes::Horizon => [up.x.clamp(-1.0, 1.0).asin(), up.y.clamp(-1.0, 1.0).asin()],
            Slopes::Projected => [(up.x / up.z).atan(), (up.y / up.z).atan()],
        };
        [raw[0] + self.zero[0], raw[1] + self.zero[1]]
    }

    /// Which way the sensor's z axis points in a mounting: 1 up, -1 down.
    ///
    /// # Errors
    /// A mounting in which it lies too close to the horizontal, or a slope is out of range.
    pub fn hemisphere(&self, declared: &Mounting) -> Result<f64, SeatError> {
        let up = (self.axes.transpose() * -declared.gravity() / G).z;
        let slopes = self.expected(declared);
        let seen = slopes.iter().all(|slope| slope.abs() <= self.range) && up.abs() >= self.range.cos();
        if seen && up != 0.0 { Ok(up.signum()) } else { Err(SeatError::Blind { slopes, range: self.range }) }
    }

    /// Gravity by two slopes \[rad\] with independent standard deviations \[rad\]. `None` where no direction has these slopes, or one of
    /// them is out of range.
    pub fn attitude(&self, slopes: [f64; 2], std: [f64; 2], hemisphere: f64) -> Option<Attitude> {
        let [a, b] = [slopes[0] - self.zero[0], slopes[1] - self.zero[1]];
        if !slopes.iter().all(|slope| slope.abs() <= self.range) {
            return None;
        }
        let (up, jacobian) = match self.slopes {
            Slopes::Horizon => horizon(a, b, hemisphere)?,
            Slopes::Projected => projected(a, b, hemisphere)?,
        };
        let jacobian = self.axes * jacobian;
        let spread = |own: f64| own.powi(2) + self.accuracy.powi(2);
        let variance = nalgebra::Matrix2::from_diagonal(&Vector2::new(spread(std[0]), spread(std[1])));
        Some(Attitude { gravity: -G * (self.axes * up), covariance: jacobian * variance * jacobian.transpose() })
    }
}

/// Up and its derivatives for slopes against the horizon.
fn horizon(a: f64, b: f64, s: f64) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    let (x, y) = (a.sin(), b.sin());
    let rest = 1.0 - x * x - y * y;
    // Two axes at right angles can't both stand on end.
    if rest.is_nan() || rest <= 1e-6 {
        return None;
    }
    let z = s * rest.sqrt();
    let jacobian = Matrix3x2::new(a.cos(), 0.0, 0.0, b.cos(), -x * a.cos() / z, -y * b.cos() / z);
    Some((Vector3::new(x, y, z), jacobian))
}

/// The same for projected slopes: `u = w / |w|`, `du = (1 - u u') dw / |w|`.
fn projected(a: f64, b: f64, s: f64) -> Option<(Vector3<f64>, Matrix3x2<f64>)> {
    if !(a.cos() > 1e-3 && b.cos() > 1e-3) {
        return None;
    }
    let steep = s * Vector3::new(a.tan(), b.tan(), 1.0);
    let length = steep.norm();
    let up = steep / length;
    let across = Matrix3::identity() - up * up.transpose();
    let slope = s * Matrix3x2::new(a.cos().powi(-2), 0.0, 0.0, b.cos().powi(-2), 0.0, 0.0);
    Some((up, across * slope / length))
}

impl Attitude {
    /// As angles of paper eq. 3.
    pub fn mounting(&self) -> Mounting {
        Mounting::along(&self.gravity)
    }

    /// Standard deviation of the direction: the larger one across it \[rad\].
    pub fn std(&self) -> f64 {
        let eigen = symmetric_eigen(self.covariance);
        eigen.map_or(f64::INFINITY, |eigen| eigen.eigenvalues.max().max(0.0).sqrt())
    }

    /// Standard deviations of `rho` and `phi` \[rad\]; that of `phi` is at most pi, for along axis 1 it means nothing.
    pub fn std_of_angles(&self) -> [f64; 2] {
        let Mounting { rho, phi } = self.mounting();
        let ((sin_rho, cos_rho), (sin_phi, cos_phi)) = (rho.sin_cos(), phi.sin_cos());
        let along_rho = Vector3::new(cos_rho * cos_phi, cos_rho * sin_phi, -sin_rho);
        let along_phi = Vector3::new(-sin_phi, cos_phi, 0.0);
        let std = |along: Vector3<f64>| (along.transpose() * self.covariance * along).x.max(0.0).sqrt();
        [std(along_rho), (std(along_phi) / sin_rho.abs().max(1e-12)).min(std::f64::consts::PI)]
    }
}
