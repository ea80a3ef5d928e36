//! A base that turns while the arm is excited: samples of such a motion belong to no mounting.

use crate::inclinometer::sensor::Reading;
use plumbline_model::angle_between;

/// Standard deviations of a reading beyond which a base has turned.
const SIGNIFICANT: f64 = 4.0;

#[derive(Clone, Copy, Debug, Default)]
pub struct BaseMotion {
    /// Number of the motion; 0 between two.
    pub motion: u32,
    /// Measured when it began; the first reading after that where the inclinometer was lost then.
    pub reading: Option<Reading>,
    pub reported: bool,
}

impl BaseMotion {
    /// By how much the base has turned beyond `still` and the uncertainty of both readings \[rad\].
    pub fn turned(&mut self, reading: Option<Reading>, still: f64) -> Option<f64> {
        let now = reading?;
        let first = *self.reading.get_or_insert(now);
        let by = angle_between(&first.attitude.gravity, &now.attitude.gravity);
        let allowed = still.max(SIGNIFICANT * first.attitude.std().hypot(now.attitude.std()));
        (by > allowed).then_some(by)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inclinometer::attitude::Attitude;
    use nalgebra::{Matrix3, Vector3};

    const STILL: f64 = 2e-3;

    /// A base tilted by `tilt` \[rad\].
    fn tilted(tilt: f64) -> Option<Reading> {
        let gravity = Vector3::new(tilt.sin(), 0.0, -tilt.cos()) * 9.80665;
        let attitude = Attitude { gravity, covariance: Matrix3::identity() * 1e-8 };
        Some(Reading { at: 0, attitude, raw: attitude, still: true })
    }

    #[test]
    fn a_turn_is_measured_from_the_first_reading_of_the_motion() {
        let mut base = BaseMotion { motion: 1, reading: tilted(0.0), reported: false };
        assert_eq!(base.turned(tilted(0.9 * STILL), STILL), None);
        assert_eq!(base.turned(None, STILL), None);
        let by = base.turned(tilted(1.5 * STILL), STILL).unwrap();
        assert!((by - 1.5 * STILL).abs() < 1e-9, "{by}");
    }

    #[test]
    fn a_motion_that_began_without_a_reading_is_compared_with_the_first_one_after() {
        let mut base = BaseMotion { motion: 1, reading: None, reported: false };
        assert_eq!(base.turned(None, STILL), None);
        assert_eq!(base.turned(tilted(0.1), STILL), None);
        assert!(base.turned(tilted(0.1 + 1.5 * STILL), STILL).is_some());
    }
}
