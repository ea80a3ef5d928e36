//! The limits that the loop's guard takes over from a connected arm.

use super::{RobotLimits, widen};
use plumbline_core::{ArmLimits, SpeedEnvelope};

impl RobotLimits {
    /// The limits that the adapter holds commands to, with `share` the session's [`limits_share`](super::super::Settings::limits_share):
    ///
    /// ```text
    /// q_min, q_max, tau, dtau: the robot's        dq, ddq, jerk: share times the robot's
    /// ```
    ///
    /// A stop that the loop plans inside these limits passes the adapter unchanged; one planned with more would be stretched, and the arm would
    /// travel farther than the guard has computed. Torque and its rate are not multiplied: the guard compares them with torques that include
    /// gravity; the adapter's share is of the torques that it commands, without gravity.
    ///
    /// The position-dependent speed limit is an envelope of its own:
    ///
    /// ```text
    /// share * min(dq, sqrt(2 dec room) - offset) = min(share * dq, sqrt(2 (share^2 dec) room) - share * offset)
    /// ```
    ///
    /// It ends at `q_min` and `q_max`, so where `dq_ends` lie outside it is the stricter one.
    pub fn for_guard(&self, share: f64) -> ArmLimits {
        let scaled = |values: &[f64; 7], factor: f64| widen(&values.map(|value| factor * value));
        let limits = plumbline_core::Limits {
            q_min: widen(&self.q_min),
            q_max: widen(&self.q_max),
            dq: scaled(&self.dq, share),
            ddq: scaled(&self.ddq, share),
            jerk: scaled(&self.jerk, share),
            tau: widen(&self.tau),
            dtau: widen(&self.dtau),
        };
        let envelope =
            SpeedEnvelope { offset: scaled(&self.dq_offset, share), deceleration: scaled(&self.dq_dec, share * share) };
        let envelope = self.dq_dec.iter().any(|dec| *dec != 0.0).then_some(envelope);
        ArmLimits { joints: self.dq.len(), limits, envelope }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{fr3, fr3_before_5_9, panda};
    use plumbline_core::Limits;

    fn own(robot: &super::RobotLimits) -> Limits {
        robot.for_guard(1.0).limits
    }

    #[test]
    fn a_job_with_the_robots_own_limits_gets_the_adapters_share_of_them() {
        for robot in [panda(), fr3(), fr3_before_5_9()] {
            for share in [0.98, 0.5, 1.0] {
                let job = own(&robot);
                let limits = robot.for_guard(share).within(&job);
                assert_eq!((limits.q_min, limits.q_max), (job.q_min, job.q_max));
                assert_eq!((limits.tau, limits.dtau), (job.tau, job.dtau));
                for j in 0..7 {
                    assert_eq!(limits.dq[j], share * robot.dq[j]);
                    assert_eq!((limits.ddq[j], limits.jerk[j]), (share * robot.ddq[j], share * robot.jerk[j]));
                }
            }
        }
        // In numbers: joint 2 of a Panda, and any of an FR3.
        let half = panda().for_guard(0.5).within(&own(&panda()));
        assert_eq!((half.dq[1], half.ddq[1], half.jerk[1], half.tau[1]), (1.0875, 3.75, 1875.0, 87.0));
        let half = fr3().for_guard(0.5).within(&own(&fr3()));
        assert_eq!((half.dq[1], half.ddq[1], half.jerk[1], half.dtau[1]), (1.31, 5.0, 2500.0, 1000.0));
    }

    #[test]
    fn of_job_and_robot_the_stricter_one_counts_joint_by_joint() {
        // A job planned for a Panda on an FR3 of an early image.
        let mut job = own(&panda());
        (job.ddq[0], job.q_max[7], job.dq[7]) = (2.0, 0.4, 0.3);
        let robot = fr3_before_5_9();
        let limits = robot.for_guard(0.5).within(&job);
        // What the job has stricter, times nothing.
        assert_eq!(limits.ddq[0], 2.0);
        // Of joint 6 the Panda's lower end lies outside of the FR3's, its upper one inside.
        assert_eq!((limits.q_min[5], limits.q_max[5]), (0.5445, 3.7525));
        assert_eq!((limits.dq[0], limits.dq[4], limits.jerk[6]), (0.5 * 2.62, 2.61, 2500.0));
        assert_eq!((limits.q_max[7], limits.dq[7]), (0.4, 0.3), "a joint that this robot does not have");
        // Twice is the same as once, and the other way round nothing gets wider.
        assert_eq!(robot.for_guard(0.5).within(&limits), limits);
        assert_eq!(limits.tau, job.tau);
    }

    #[test]
    fn the_envelope_lies_below_the_jobs_and_below_the_adapters_share() {
        let job = fr3_before_5_9().for_guard(1.0).envelope;
        for (robot, job) in [(fr3(), None), (fr3(), job), (fr3_before_5_9(), job), (panda(), job)] {
            for share in [0.98, 0.5] {
                let limits = robot.for_guard(share).within(&own(&robot));
                let envelope = robot.for_guard(share).envelope_within(job.as_ref()).unwrap();
                for (j, step) in (0..7).flat_map(|j| (0..=200).map(move |step| (j, step))) {
                    let q = limits.q_min[j] + (limits.q_max[j] - limits.q_min[j]) * f64::from(step) / 200.0;
                    let (up, down) = (limits.q_max[j] - q, q - limits.q_min[j]);
                    let (least, most) = robot.velocities(j, q).unwrap();
                    assert!(envelope.at(j, up, limits.dq[j]).0 <= share * most + 1e-12, "joint {j} at {q}");
                    assert!(-envelope.at(j, down, limits.dq[j]).0 >= share * least - 1e-12, "joint {j} at {q}");
                    let of_job = job.map_or(f64::MAX, |job| job.at(j, up, limits.dq[j]).0);
                    assert!(envelope.at(j, up, limits.dq[j]).0 <= of_job + 1e-12, "joint {j} at {q}");
                }
            }
        }
        // Alone it is exactly the adapter's, where the ends are the same.
        let envelope = fr3().for_guard(0.5).envelope_within(None).unwrap();
        let q = fr3().q_max[0] - 0.1;
        let adapters = 0.5 * fr3().velocities(0, q).unwrap().1;
        assert!((envelope.at(0, 0.1, 0.5 * fr3().dq[0]).0 - adapters).abs() < 1e-12);
        assert_eq!(panda().for_guard(0.98).envelope_within(None), None);
    }
}
