//! Direction of gravity in the base frame.

use nalgebra::Vector3;

/// Standard gravity as the paper uses it \[m/s2\].
pub const G: f64 = 9.81;

/// Largest angle between gravity and axis 1 that counts as parallel, 1 degree \[rad\]. The component across the axis
/// (g sin 1 deg = 0.17 m/s2) is then too small to identify the two parameters that it excites.
pub const VERTICAL_TOLERANCE: f64 = std::f64::consts::PI / 180.0;

/// How the base is mounted, as the direction of the gravitational acceleration in the base frame (paper eq. 3).
///
/// `rho = pi` upright on a table, `pi/2` on a wall, `0` hanging from a ceiling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mounting {
    /// Polar angle between the base z axis and the gravitational acceleration \[rad\].
    pub rho: f64,
    /// Azimuth of the gravitational acceleration about the base z axis \[rad\].
    pub phi: f64,
}

impl Mounting {
    /// Upright on a table.
    pub const UPRIGHT: Mounting = Mounting { rho: std::f64::consts::PI, phi: 0.0 };
    /// On a wall, base x axis pointing down.
    pub const WALL: Mounting = Mounting { rho: std::f64::consts::FRAC_PI_2, phi: 0.0 };
    /// Hanging from a ceiling.
    pub const CEILING: Mounting = Mounting { rho: 0.0, phi: 0.0 };

    /// Of gravity along a vector of any length in the base frame; `phi` is 0 where gravity is parallel to axis 1.
    pub fn along(gravity: &Vector3<f64>) -> Mounting {
        let (x, y, z) = (gravity.x, gravity.y, gravity.z);
        let across = x.hypot(y);
        Mounting { rho: across.atan2(z), phi: if across <= 1e-9 * gravity.norm() { 0.0 } else { y.atan2(x) } }
    }

    /// Gravitational acceleration in the base frame, `a_g = g [sin rho cos phi, sin rho sin phi, cos rho]` (paper eq. 3) \[m/s2\].
    pub fn gravity(&self) -> Vector3<f64> {
        let (sin_rho, cos_rho) = self.rho.sin_cos();
        let (sin_phi, cos_phi) = self.phi.sin_cos();
        G * Vector3::new(sin_rho * cos_phi, sin_rho * sin_phi, cos_rho)
    }

    /// Whether gravity is parallel to axis 1 within `tolerance` \[rad\]: the mounting in which two parameters vanish.
    pub fn is_along_axis_1(&self, tolerance: f64) -> bool {
        self.rho.sin().abs() <= tolerance.sin()
    }

    /// Angle between the gravity directions of two mountings \[rad\].
    pub fn angle_to(&self, other: &Mounting) -> f64 {
        angle_between(&self.gravity(), &other.gravity())
    }
}

/// Angle between two vectors \[rad\].
pub fn angle_between(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b))
}

/// `upright`, `ceiling`, `wall` (base x axis down), or the two angles in rad.
impl std::fmt::Display for Mounting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let named = [(Mounting::UPRIGHT, "upright"), (Mounting::WALL, "wall"), (Mounting::CEILING, "ceiling")];
        match named.iter().find(|(mounting, _)| mounting.angle_to(self) < 1e-6) {
            Some((_, name)) => f.write_str(name),
            None => write!(f, "rho = {:.4} rad, phi = {:.4} rad", self.rho, self.phi),
        }
    }
}
