//! Torques of the arm at rest, as the loop's records bring them.

use plumbline_core::{JointVec, MAX_JOINTS, Phase, Record};
use plumbline_identify::Pose;

/// Records at the beginning of a rest in which the arm settles.
const SETTLE_RECORDS: u32 = 100;
const FIRST_MEAN_RECORDS: u32 = 200;
/// Records after which a long rest is averaged anew.
const MEAN_RECORDS: u32 = 1000;
/// Poses that are kept, the latest ones.
const MAX_POSES: usize = 8;
/// Distance below which two rests are one pose \[rad\].
const SAME_POSE_RAD: f64 = 1e-3;
/// Movement beyond which an arm that is commanded to hold is guided by hand \[rad\].
const MAX_SWAY_RAD: f64 = 5e-3;

/// A pose at rest and its number since the start.
#[derive(Clone, Copy, Debug)]
struct Numbered {
    number: u64,
    pose: Pose,
}

#[derive(Clone, Debug, Default)]
pub struct RestPoses {
    at: Option<JointVec>,
    count: u32,
    /// Its position after it had settled \[rad\].
    stood: JointVec,
    q: JointVec,
    tau: JointVec,
    poses: Vec<Numbered>,
    completed: u64,
}

impl RestPoses {
    pub fn take(&mut self, record: &Record) -> bool {
        let desired = &record.command.desired;
        let resting = matches!(record.phase, Phase::Hold | Phase::Stopped) && desired.dq.iter().all(|&dq| dq == 0.0);
        if !resting || self.at.is_none_or(|at| at != desired.q) {
            self.measure_from(0);
            self.at = resting.then_some(desired.q);
            return false;
        }
        self.count += 1;
        if self.count <= SETTLE_RECORDS {
            return false;
        }
        if self.count == SETTLE_RECORDS + 1 {
            self.stood = record.state.q;
        }
        if self.stood.iter().zip(&record.state.q).any(|(stood, q)| (stood - q).abs() > MAX_SWAY_RAD) {
            self.measure_from(0);
            return false;
        }
        for j in 0..MAX_JOINTS {
            self.q[j] += record.state.q[j];
            self.tau[j] += record.state.tau[j];
        }
        let measured = self.count - SETTLE_RECORDS;
        // A first mean soon, then one of every second.
        let complete = measured == FIRST_MEAN_RECORDS || measured == MEAN_RECORDS;
        if complete {
            self.complete(f64::from(measured));
        }
        if measured == MEAN_RECORDS {
            self.measure_from(SETTLE_RECORDS);
        }
        complete
    }

    /// Begins a mean, as if the rest were `count` records old.
    fn measure_from(&mut self, count: u32) {
        (self.count, self.q, self.tau) = (count, [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    }

    fn complete(&mut self, measured: f64) {
        let pose = Pose { q: self.q.map(|sum| sum / measured), tau: self.tau.map(|sum| sum / measured) };
        let near = |own: &Numbered| own.pose.q.iter().zip(&pose.q).all(|(a, b)| (a - b).abs() < SAME_POSE_RAD);
        self.poses.retain(|own| !near(own));
        if self.poses.len() >= MAX_POSES {
            self.poses.remove(0);
        }
        self.completed += 1;
        self.poses.push(Numbered { number: self.completed, pose });
    }

    pub fn completed(&self) -> u64 {
        self.completed
    }

    /// The latest poses that were completed after the first `after`.
    pub fn since(&self, after: u64) -> Vec<Pose> {
        self.poses.iter().filter(|own| own.number > after).map(|own| own.pose).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::{Command, Setpoint, State};

    fn record(q: f64, tau: f64, phase: Phase) -> Record {
        let mut record = Record { phase, ..Record::default() };
        record.state = State { q: [q; MAX_JOINTS], tau: [tau; MAX_JOINTS], ..State::default() };
        record.command =
            Command { desired: Setpoint { q: [q; MAX_JOINTS], ..Setpoint::default() }, ..Command::default() };
        record
    }

    #[test]
    fn a_rest_gives_a_pose_after_the_arm_has_swung_out() {
        let mut rests = RestPoses::default();
        // The torque of the first records is the motion's.
        let tau = |k: u32| if k < 100 { 50.0 } else { 3.0 };
        let done: Vec<u32> = (0..2200).filter(|&k| rests.take(&record(0.5, tau(k), Phase::Hold))).collect();
        assert_eq!(done, [300, 1100, 1300, 2100], "a first mean soon, then the same of every second");
        let poses = rests.since(0);
        assert_eq!((poses.len(), poses[0].q[0]), (1, 0.5), "the same rest is one pose");
        assert!((poses[0].tau[3] - 3.0).abs() < 1e-9);
        assert!(rests.since(rests.completed()).is_empty());
    }

    #[test]
    fn an_arm_that_is_guided_by_hand_does_not_rest() {
        let mut rests = RestPoses::default();
        let guided = |k: u32| {
            let mut record = record(0.5, 1.0, Phase::Hold);
            record.state.q[2] += 5e-5 * f64::from(k);
            record
        };
        assert!(!(0..5000).any(|k| rests.take(&guided(k))));
        assert!((0..400).any(|_| rests.take(&guided(5000))), "it was let go");
        // 5 mrad are what an arm sways by.
        for (sway, rests_then) in [(4e-3, true), (6e-3, false), (-4e-3, true), (-6e-3, false)] {
            let mut rests = RestPoses::default();
            let swaying = |k: u32| {
                let mut record = record(0.5, 1.0, Phase::Hold);
                record.state.q[2] += if k.is_multiple_of(2) { sway } else { 0.0 };
                record
            };
            assert_eq!((0..400).any(|k| rests.take(&swaying(k))), rests_then, "{sway}");
        }
    }

    #[test]
    fn a_motion_begins_the_rest_anew() {
        for interrupted in [250, 50] {
            let mut rests = RestPoses::default();
            let mut moving = record(0.5, 90.0, Phase::Hold);
            // One joint alone.
            moving.command.desired.dq[3] = 0.1;
            let take = |rests: &mut RestPoses, count: u32| {
                (0..count).filter(|_| rests.take(&record(0.5, 3.0, Phase::Hold))).count()
            };
            assert_eq!(take(&mut rests, interrupted), 0);
            assert!(!(0..500).any(|_| rests.take(&moving)));
            assert_eq!((take(&mut rests, 300), take(&mut rests, 1)), (0, 1));
            assert!((rests.since(0)[0].tau[3] - 3.0).abs() < 1e-9);
        }
    }

    #[test]
    fn rests_closer_than_a_milliradian_are_one_pose() {
        for (apart, poses) in [(0.7e-3, 1), (-0.7e-3, 1), (1.4e-3, 2), (-1.4e-3, 2)] {
            let mut rests = RestPoses::default();
            for q in [0.5, 0.5 + apart] {
                (0..400).for_each(|_| {
                    rests.take(&record(q, 1.0, Phase::Hold));
                });
            }
            assert_eq!(rests.since(0).len(), poses, "{apart}");
        }
    }

    #[test]
    fn a_motion_is_no_rest_and_only_the_latest_poses_are_kept() {
        let mut rests = RestPoses::default();
        assert!(!(0..2000).any(|_| rests.take(&record(0.5, 1.0, Phase::Excite))));
        for pose in 0..12 {
            (0..400).for_each(|_| {
                rests.take(&record(f64::from(pose), 1.0, Phase::Hold));
            });
        }
        let poses = rests.since(0);
        assert_eq!((poses.len(), poses[0].q[0], poses[7].q[0]), (MAX_POSES, 4.0, 11.0));
        assert_eq!(rests.since(10).len(), 2);
    }
}
