//! A planned motion sample by sample, for arms that plumbline does not drive.

use plumbline_excite::{Fourier, Point};
use std::fmt::Write;

/// Joint names of ROS drivers, by the robot's name; others are numbered.
const UR_JOINTS: [&str; 6] =
    ["shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"];

/// `periods` of a motion, `rate` samples a second \[Hz\], the end included. Starts and ends at rest at `q0`.
pub struct Trajectory<'a> {
    pub motion: &'a Fourier,
    pub rate: f64,
    pub periods: u32,
}

impl Trajectory<'_> {
    /// Times \[s\] with position, velocity and acceleration of every joint.
    fn samples(&self) -> impl Iterator<Item = (f64, Vec<Point>)> + '_ {
        let end = self.motion.period * f64::from(self.periods);
        // The last sample is the end itself, also where it is no multiple of the step.
        let count = (end * self.rate - 1e-6).ceil() as usize;
        (0..=count).map(move |k| {
            let t = (k as f64 / self.rate).min(end);
            (t, (0..self.motion.joints()).map(|j| self.motion.at(j, t)).collect())
        })
    }

    /// `t,q1..qn,dq1..dqn,ddq1..ddqn`, in s, rad, rad/s, rad/s2.
    pub fn csv(&self) -> String {
        let n = self.motion.joints();
        let mut text = String::from("t");
        for stem in ["q", "dq", "ddq"] {
            (1..=n).for_each(|j| text += &format!(",{stem}{j}"));
        }
        text.push('\n');
        for (t, points) in self.samples() {
            write!(text, "{t:?}").expect("a string takes everything");
            for of in [|point: &Point| point.q, |point: &Point| point.dq, |point: &Point| point.ddq] {
                points.iter().for_each(|point| write!(text, ",{:?}", of(point)).expect("a string takes everything"));
            }
            text.push('\n');
        }
        text
    }

    /// A `trajectory_msgs/msg/JointTrajectory` in YAML, as `ros2 topic pub` and `ros2 action send_goal` take it.
    pub fn ros(&self, names: &[String]) -> String {
        let list = |values: Vec<f64>| values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ");
        let mut text = format!("joint_names: [{}]\npoints:\n", names.join(", "));
        for (t, points) in self.samples() {
            let nanoseconds = (t * 1e9).round() as u64;
            let (sec, nanosec) = (nanoseconds / 1_000_000_000, nanoseconds % 1_000_000_000);
            let of = |what: fn(&Point) -> f64| list(points.iter().map(what).collect());
            let (q, dq, ddq) = (of(|point| point.q), of(|point| point.dq), of(|point| point.ddq));
            writeln!(text, "- positions: [{q}]\n  velocities: [{dq}]\n  accelerations: [{ddq}]\n  time_from_start: {{sec: {sec}, nanosec: {nanosec}}}")
                .expect("a string takes everything");
        }
        text
    }
}

/// Names of a robot's joints as its ROS driver has them: those of Universal Robots, else `panda_joint1`.
pub fn ros_names(robot: &str, joints: usize) -> Vec<String> {
    if robot.starts_with("ur") && joints == UR_JOINTS.len() {
        return UR_JOINTS.map(String::from).to_vec();
    }
    (1..=joints).map(|j| format!("{robot}_joint{j}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn motion() -> Fourier {
        let mut motion = Fourier::new(
            2.0,
            vec![0.3, -1.0],
            DMatrix::from_row_slice(2, 3, &[0.2, -0.1, 0.05, 0.3, 0.1, -0.2]),
            DMatrix::from_row_slice(2, 3, &[0.1, 0.2, -0.3, 0.0, 0.1, -0.1]),
        )
        .unwrap();
        motion.project();
        motion
    }

    /// Velocities and accelerations are the derivatives of the positions in the file; it starts and ends at rest.
    #[test]
    fn the_table_is_consistent_and_ends_at_rest() {
        let motion = motion();
        let text = Trajectory { motion: &motion, rate: 1000.0, periods: 2 }.csv();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("t,q1,q2,dq1,dq2,ddq1,ddq2"));
        let rows: Vec<Vec<f64>> =
            lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
        assert_eq!(rows.len(), 4001);
        for three in rows.windows(3) {
            let dt = three[1][0] - three[0][0];
            assert!((dt - 1e-3).abs() < 1e-9);
            for j in 1..=2 {
                let [before, now, after] = [three[0][j], three[1][j], three[2][j]];
                assert!(((after - before) / (2.0 * dt) - three[1][j + 2]).abs() < 1e-3);
                assert!(((after - 2.0 * now + before) / (dt * dt) - three[1][j + 4]).abs() < 2e-2);
            }
        }
        let end = rows.last().unwrap();
        assert_eq!(end[0], 4.0);
        for (row, q0) in [(&rows[0], &motion.q0), (end, &motion.q0)] {
            assert!((row[1] - q0[0]).abs() < 1e-12 && (row[2] - q0[1]).abs() < 1e-12);
            assert!(row[3..].iter().all(|value| value.abs() < 1e-9), "{row:?}");
        }
    }

    #[test]
    fn the_end_is_in_the_table_at_any_rate_and_ros_times_are_whole_nanoseconds() {
        let motion = motion();
        let trajectory = Trajectory { motion: &motion, rate: 30.0, periods: 1 };
        let names = ros_names("panda", 2);
        let text = trajectory.ros(&names);
        assert!(text.starts_with("joint_names: [panda_joint1, panda_joint2]\npoints:\n- positions: [0.3"), "{text}");
        assert_eq!(text.matches("time_from_start").count(), 61);
        assert!(text.contains("time_from_start: {sec: 0, nanosec: 33333333}"));
        assert!(text.trim_end().ends_with("time_from_start: {sec: 2, nanosec: 0}"));
        let uneven = Trajectory { motion: &motion, rate: 0.7, periods: 1 }.csv();
        assert_eq!(uneven.lines().last().unwrap().split(',').next(), Some("2.0"));
        assert_eq!(ros_names("ur10e", 6)[2], "elbow_joint");
    }
}
