//! What the loop's guard holds the commands of a connected arm against.

use super::RobotLimits;
use plumbline_core::{JointVec, Limits, SpeedEnvelope};

/// The limits of the loop's guard: those of the job, and inside them those that the adapter holds commands to. With `share`, the
/// session's [`limits_share`](super::super::Settings::limits_share), for joint j:
///
/// ```text
/// q_min = max(job, robot)            q_max = min(job, robot)
/// dq    = min(job, share * robot)    ddq, jerk likewise
/// tau   = min(job, robot)            dtau likewise
/// ```
///
/// The robot's are those of [`Info::limits`](super::super::Info::limits): served by the arm that is connected, else the table of its version. The
/// adapter multiplies
/// velocity, acceleration and jerk by the share, so a stop that the loop plans inside these limits goes through it as it is; a stop
/// planned with more would be stretched, and the arm go farther than the guard has reckoned with. Positions are not multiplied. Torque and
/// its rate are the whole ones, because the guard holds them against torques with gravity in them, measured and fed forward; the adapter's
/// share is of the torques that it commands, without gravity. Joints that the robot does not have stay as the job has them.
///
/// What depends on position is [`guard_envelope`].
pub fn guard_limits(robot: &RobotLimits, job: &Limits, limits_share: f64) -> Limits {
    robot.within(job, limits_share)
}

/// The position-dependent speed limit of the loop's guard, where the job's robot or the connected one has such a limit:
/// inside the job's, and inside `share` times the robot's, as the adapter multiplies it. As
///
/// ```text
/// share * min(dq, sqrt(2 dec room) - offset) = min(share * dq, sqrt(2 (share^2 dec) room) - share * offset)
/// ```
///
/// this is an envelope of its own; of two envelopes it takes the larger offset and the smaller deceleration, which lies below both. It
/// reckons with the ends of the limits it is used with, those of [`guard_limits`], which lie inside both ranges.
pub fn guard_envelope(robot: &RobotLimits, job: Option<&SpeedEnvelope>, limits_share: f64) -> Option<SpeedEnvelope> {
    robot.envelope_within(job, limits_share)
}

impl RobotLimits {
    fn within(&self, job: &Limits, share: f64) -> Limits {
        let mut limits = *job;
        larger(&mut limits.q_min, &self.q_min);
        smaller(&mut limits.q_max, &self.q_max);
        smaller(&mut limits.dq, &self.dq.map(|dq| share * dq));
        smaller(&mut limits.ddq, &self.ddq.map(|ddq| share * ddq));
        smaller(&mut limits.jerk, &self.jerk.map(|jerk| share * jerk));
        smaller(&mut limits.tau, &self.tau);
        smaller(&mut limits.dtau, &self.dtau);
        limits
    }

    fn envelope_within(&self, job: Option<&SpeedEnvelope>, share: f64) -> Option<SpeedEnvelope> {
        let none = SpeedEnvelope { offset: JointVec::default(), deceleration: JointVec::default() };
        let mut envelope = job.copied().unwrap_or(none);
        for j in 0..self.dq_dec.len() {
            let (offset, dec) = (share * self.dq_offset[j], share * share * self.dq_dec[j]);
            // A deceleration of 0 is a joint without an envelope.
            if dec == 0.0 {
                continue;
            }
            if envelope.deceleration[j] == 0.0 {
                (envelope.offset[j], envelope.deceleration[j]) = (offset, dec);
            } else {
                envelope.offset[j] = envelope.offset[j].max(offset);
                envelope.deceleration[j] = envelope.deceleration[j].min(dec);
            }
        }
        envelope.deceleration.iter().any(|dec| *dec != 0.0).then_some(envelope)
    }
}

fn smaller(limits: &mut JointVec, robot: &[f64; 7]) {
    limits.iter_mut().zip(robot).for_each(|(limit, robot)| *limit = limit.min(*robot));
}

fn larger(limits: &mut JointVec, robot: &[f64; 7]) {
    limits.iter_mut().zip(robot).for_each(|(limit, robot)| *limit = limit.max(*robot));
}

#[cfg(test)]
mod tests {
    use super::super::{fr3, fr3_before_5_9, panda};

    #[test]
    fn a_job_with_the_robots_own_limits_gets_the_adapters_share_of_them() {
        for robot in [panda(), fr3(), fr3_before_5_9()] {
            for share in [0.98, 0.5, 1.0] {
                let (job, _) = robot.for_guard();
                let limits = robot.within(&job, share);
                assert_eq!((limits.q_min, limits.q_max), (job.q_min, job.q_max));
                assert_eq!((limits.tau, limits.dtau), (job.tau, job.dtau));
                for j in 0..7 {
                    assert_eq!(limits.dq[j], share * robot.dq[j]);
                    assert_eq!((limits.ddq[j], limits.jerk[j]), (share * robot.ddq[j], share * robot.jerk[j]));
                }
            }
        }
        // In numbers: joint 2 of a Panda, and any of an FR3.
        let half = panda().within(&panda().for_guard().0, 0.5);
        assert_eq!((half.dq[1], half.ddq[1], half.jerk[1], half.tau[1]), (1.0875, 3.75, 1875.0, 87.0));
        let half = fr3().within(&fr3().for_guard().0, 0.5);
        assert_eq!((half.dq[1], half.ddq[1], half.jerk[1], half.dtau[1]), (1.31, 5.0, 2500.0, 1000.0));
    }

    #[test]
    fn of_job_and_robot_the_stricter_one_counts_joint_by_joint() {
        // A job planned for a Panda on an FR3 of an early image.
        let (mut job, _) = panda().for_guard();
        (job.ddq[0], job.q_max[7], job.dq[7]) = (2.0, 0.4, 0.3);
        let robot = fr3_before_5_9();
        let limits = robot.within(&job, 0.5);
        // What the job has stricter, times nothing.
        assert_eq!(limits.ddq[0], 2.0);
        // Of joint 6 the Panda's lower end lies outside of the FR3's, its upper one inside.
        assert_eq!((limits.q_min[5], limits.q_max[5]), (0.5445, 3.7525));
        assert_eq!((limits.dq[0], limits.dq[4], limits.jerk[6]), (0.5 * 2.62, 2.61, 2500.0));
        assert_eq!((limits.q_max[7], limits.dq[7]), (0.4, 0.3), "a joint that this robot does not have");
        // Twice is the same as once, and the other way round nothing gets wider.
        assert_eq!(robot.within(&limits, 0.5), limits);
        assert_eq!(limits.tau, job.tau);
    }

    #[test]
    fn the_envelope_lies_below_the_jobs_and_below_the_adapters_share() {
        let (_, job) = fr3_before_5_9().for_guard();
        for (robot, job) in [(fr3(), None), (fr3(), job), (fr3_before_5_9(), job), (panda(), job)] {
            for share in [0.98, 0.5] {
                let (own, _) = robot.for_guard();
                let limits = robot.within(&own, share);
                let envelope = robot.envelope_within(job.as_ref(), share).unwrap();
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
        let envelope = fr3().envelope_within(None, 0.5).unwrap();
        let q = fr3().q_max[0] - 0.1;
        let adapters = 0.5 * fr3().velocities(0, q).unwrap().1;
        assert!((envelope.at(0, 0.1, 0.5 * fr3().dq[0]).0 - adapters).abs() < 1e-12);
        assert_eq!(panda().envelope_within(None, 0.98), None);
    }
}
