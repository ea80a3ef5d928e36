//! Derivatives of the sent positions, by backward divided differences at their times.
//!
//! A robot differentiates its commands in this way. The history is kept in `f64`: positions that an arm reports may be rounded to `f32`,
//! whose third difference is noise of hundreds of rad/s3.

use plumbline_core::JointVec;

/// The last three positions sent and the time between them.
#[derive(Clone, Copy, Debug)]
pub struct History {
    /// Newest first \[rad\].
    q: [JointVec; 3],
    /// `dt[k]` lies between `q[k]` and `q[k + 1]` \[s\].
    dt: [f64; 2],
}

/// Derivatives of one joint at a new sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Differences {
    /// Mean velocity since the last sample \[rad/s\].
    pub dq: f64,
    /// Mean acceleration over the last two intervals \[rad/s2\].
    pub ddq: f64,
    /// Mean jerk over the last three intervals \[rad/s3\].
    pub jerk: f64,
    /// Length of the last two intervals \[s\].
    pub span: f64,
}

impl History {
    /// An arm that has been resting at `q`, sampled every `dt`.
    pub fn at_rest(q: JointVec, dt: f64) -> History {
        History { q: [q; 3], dt: [dt; 2] }
    }

    /// The position sent last \[rad\].
    pub fn last(&self) -> &JointVec {
        &self.q[0]
    }

    /// Derivatives of joint `j` if `q` is sent `dt` after the last sample.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn differences(&self, j: usize, q: f64, dt: f64) -> Differences {
        let [q1, q2, q3] = [self.q[0][j], self.q[1][j], self.q[2][j]];
        let [dt1, dt2] = self.dt;
        let (v0, v1, v2) = ((q - q1) / dt, (q1 - q2) / dt1, (q2 - q3) / dt2);
        let (a0, a1) = (2.0 * (v0 - v1) / (dt + dt1), 2.0 * (v1 - v2) / (dt1 + dt2));
        Differences { dq: v0, ddq: a0, jerk: 3.0 * (a0 - a1) / (dt + dt1 + dt2), span: dt + dt1 }
    }

    /// Adds the sample that was sent.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn push(&mut self, q: JointVec, dt: f64) {
        self.q = [q, self.q[0], self.q[1]];
        self.dt = [dt, self.dt[0]];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn a_cubic_has_its_constant_jerk_at_any_spacing() {
        // q = 2 t^3 - t^2 + 0.5 t: jerk 12; divided differences of a cubic are exact at the mean of their times.
        let q = |t: f64| 2.0 * t.powi(3) - t * t + 0.5 * t;
        let times = [0.0, 0.001, 0.004, 0.005, 0.011, 0.012];
        let mut history = History::at_rest([0.0; 8], 0.001);
        for (k, pair) in times.windows(2).enumerate() {
            let (dt, t) = (pair[1] - pair[0], pair[1]);
            let d = history.differences(0, q(t), dt);
            if k >= 2 {
                assert_relative_eq!(d.jerk, 12.0, epsilon = 1e-4);
                let mean = (times[k - 1] + times[k] + t) / 3.0;
                assert_relative_eq!(d.ddq, 12.0 * mean - 2.0, epsilon = 1e-7);
                assert_relative_eq!(d.span, t - times[k - 1], epsilon = 1e-15);
            }
            history.push([q(t); 8], dt);
        }
    }
}
