//! Point-to-point motions and the controlled stop, both time-optimal under velocity, acceleration and jerk limits (ruckig).
//!
//! Planning takes place inside a cycle: it takes microseconds and does not allocate for valid input, which is therefore checked first.

use plumbline_core::{JointVec, Limits, MAX_JOINTS, PERIOD_S, Setpoint};
use rsruckig::brake::stop_distance_third_order;
use rsruckig::prelude::{
    ControlInterface, InputParameter, Profile, Ruckig, RuckigResult, Synchronization, ThrowErrorHandler, Trajectory,
};
use rsruckig::util::integrate;

/// Shares of the joint limits that the loop's own motions use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MoveFactors {
    /// Share of the velocity limit in a point-to-point motion.
    pub velocity: f64,
    /// Share of the acceleration limit in a point-to-point motion.
    pub acceleration: f64,
    /// Share of the jerk limit in a point-to-point motion.
    pub jerk: f64,
    /// Share of the acceleration and jerk limits that the controlled stop uses; the rest is the guard's margin.
    pub brake: f64,
}

impl Default for MoveFactors {
    /// Slow motions and a fast stop. Jerk times inertia is a torque rate: a Panda allows 1000 Nm/s, and 1500 rad/s3 on its first joint
    /// would need twice that.
    fn default() -> MoveFactors {
        MoveFactors { velocity: 0.2, acceleration: 0.1, jerk: 0.01, brake: 0.95 }
    }
}

/// No motion from here to there, or a state that no stop can start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("ruckig found no motion")]
pub struct NoMotion;

/// Plans one motion at a time and gives its samples. Unused joints remain at zero.
pub struct Planner {
    joints: usize,
    limits: Limits,
    factors: MoveFactors,
    otg: Ruckig<MAX_JOINTS, ThrowErrorHandler>,
    input: InputParameter<MAX_JOINTS>,
    trajectory: Trajectory<MAX_JOINTS>,
    last_tick: u64,
    end: JointVec,
}

impl Planner {
    /// Allocates everything. `limits` hold finite positive numbers for the first `joints` joints.
    pub fn new(joints: usize, limits: Limits, factors: MoveFactors) -> Planner {
        let joints = joints.min(MAX_JOINTS);
        let mut input = InputParameter::new(None);
        for j in 0..MAX_JOINTS {
            input.enabled[j] = j < joints;
            // Valid values for unused joints; the others are set with every plan.
            (input.max_velocity[j], input.max_acceleration[j], input.max_jerk[j]) = (1.0, 1.0, 1.0);
        }
        Planner {
            joints,
            limits,
            factors,
            otg: Ruckig::new(None, PERIOD_S),
            input,
            trajectory: Trajectory::new(None),
            last_tick: 0,
            end: JointVec::default(),
        }
    }

    /// Plans the motion from the rest at `from.q` to the rest at `target` \[rad\]; all joints start and end together.
    pub fn move_to(&mut self, from: &Setpoint, target: &JointVec) -> Result<(), NoMotion> {
        let MoveFactors { velocity, acceleration, jerk, .. } = self.factors;
        self.input.control_interface = ControlInterface::Position;
        self.input.synchronization = Synchronization::Time;
        for (j, &q) in target.iter().enumerate().take(self.joints) {
            self.input.target_position[j] = q;
        }
        self.plan(from, velocity, acceleration, jerk)?;
        // Ruckig reaches the target to rounding; the last sample is the target itself.
        self.end = *target;
        self.mask_end();
        Ok(())
    }

    /// Plans the stop from the moving setpoint `from`: each joint independently, as fast as its acceleration and jerk limits
    /// allow, so that it travels the shortest distance.
    pub fn stop(&mut self, from: &Setpoint) -> Result<(), NoMotion> {
        let brake = self.factors.brake;
        self.input.control_interface = ControlInterface::Velocity;
        self.input.synchronization = Synchronization::None;
        for j in 0..self.joints {
            self.input.target_position[j] = 0.0;
        }
        self.plan(from, 1.0, brake, brake)?;
        self.end = self.evaluate(self.trajectory.get_duration()).q;
        Ok(())
    }

    /// Index of the last sample, at which the arm rests.
    pub fn last_tick(&self) -> u64 {
        self.last_tick
    }

    /// Sample `tick`, `tick` ms after the start; past the end the arm rests.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn at(&self, tick: u64) -> Setpoint {
        if tick >= self.last_tick {
            return Setpoint { q: self.end, ..Setpoint::default() };
        }
        self.evaluate(tick as f64 * PERIOD_S)
    }

    fn plan(&mut self, from: &Setpoint, velocity: f64, acceleration: f64, jerk: f64) -> Result<(), NoMotion> {
        for j in 0..self.joints {
            self.input.current_position[j] = from.q[j];
            self.input.current_velocity[j] = from.dq[j];
            self.input.current_acceleration[j] = from.ddq[j];
            self.input.max_velocity[j] = velocity * self.limits.dq[j];
            self.input.max_acceleration[j] = acceleration * self.limits.ddq[j];
            self.input.max_jerk[j] = jerk * self.limits.jerk[j];
            // For non-finite numbers ruckig formats an error, which allocates, and may panic.
            let numbers = [from.q[j], from.dq[j], from.ddq[j], self.input.target_position[j]];
            if !numbers.iter().all(|x| x.is_finite()) {
                return Err(NoMotion);
            }
        }
        match self.otg.calculate(&self.input, &mut self.trajectory) {
            Ok(RuckigResult::Working | RuckigResult::Finished) => {}
            _ => return Err(NoMotion),
        }
        let duration = self.trajectory.get_duration();
        if !duration.is_finite() {
            return Err(NoMotion);
        }
        self.last_tick = (duration / PERIOD_S).ceil() as u64;
        Ok(())
    }

    /// The planned motion `time` \[s\] after its start. Replaces ruckig's evaluation, for which the compiler can't prove that indices are in range.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn evaluate(&self, time: f64) -> Setpoint {
        let mut out = Setpoint::default();
        let Some(profiles) = self.trajectory.profiles.first() else { return out };
        let joints = out.q.iter_mut().zip(&mut out.dq).zip(&mut out.ddq);
        for (((q, dq), ddq), profile) in joints.zip(profiles.iter()).take(self.joints) {
            (*q, *dq, *ddq) = sample(profile, time);
        }
        out
    }

    fn mask_end(&mut self) {
        for j in self.joints..MAX_JOINTS {
            self.end[j] = 0.0;
        }
    }
}

/// Position, velocity and acceleration of one joint `time` \[s\] after the start of its profile: up to two pieces that bring it inside its limits
/// (ruckig's own brake), up to seven pieces of constant jerk, and the rest after them.
fn sample(profile: &Profile, time: f64) -> (f64, f64, f64) {
    let (brake, mut t) = (&profile.brake, time);
    if t < brake.duration {
        let [first, _] = brake.t;
        let k = usize::from(t >= first);
        t -= if k > 0 { first } else { 0.0 };
        return integrate(t, brake.p[k], brake.v[k], brake.a[k], brake.j[k]);
    }
    t -= brake.duration.max(0.0);
    let ends = &profile.t_sum;
    match ends.iter().position(|end| *end > t) {
        Some(k) => {
            let begin = k.checked_sub(1).map_or(0.0, |before| ends[before]);
            integrate(t - begin, profile.p[k], profile.v[k], profile.a[k], profile.j[k])
        }
        None => integrate(t - ends[6], profile.p[7], profile.v[7], profile.a[7], 0.0),
    }
}

/// How far a joint travels up and down from here when it stops with `ddq` and `jerk`, both without a sign \[rad\].
pub fn stop_distances(dq_now: f64, ddq_now: f64, ddq: f64, jerk: f64) -> (f64, f64) {
    (stop_distance_third_order(dq_now, ddq_now, ddq, jerk), stop_distance_third_order(-dq_now, -ddq_now, ddq, jerk))
}

/// Seconds in a number of the arm's cycles.
pub(super) fn seconds(cycles: u64) -> f64 {
    cycles as f64 * PERIOD_S
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_abs_diff_eq;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    const LIMITS: Limits = Limits {
        q_min: [-3.0; 8],
        q_max: [3.0; 8],
        dq: [2.0, 1.0, 3.0, 2.0, 2.0, 2.5, 2.0, 1.5],
        ddq: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0, 4.0],
        jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0, 50.0],
        tau: [50.0; 8],
        dtau: [1000.0; 8],
    };

    fn random(rng: &mut ChaCha8Rng, joints: usize, span: f64) -> JointVec {
        std::array::from_fn(|j| if j < joints { rng.random_range(-span..span) } else { 0.0 })
    }

    #[test]
    fn motions_end_exactly_at_the_target_inside_their_share_of_the_limits() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for case in 0..400 {
            let joints = 1 + case % MAX_JOINTS;
            let mut planner =
                Planner::new(joints, LIMITS, MoveFactors { velocity: 0.5, acceleration: 0.3, jerk: 0.1, brake: 0.9 });
            let from = Setpoint { q: random(&mut rng, joints, 2.0), ..Setpoint::default() };
            let target = random(&mut rng, joints, 2.0);
            planner.move_to(&from, &target).unwrap();
            assert_abs_diff_eq!(planner.at(0).q[..], from.q[..], epsilon = 1e-12);
            assert_eq!(planner.at(planner.last_tick()), Setpoint { q: target, ..Setpoint::default() });
            assert_eq!(planner.at(u64::MAX).q, target);
            let step = (planner.last_tick() / 50).max(1);
            for tick in (0..planner.last_tick()).step_by(step as usize) {
                let s = planner.at(tick);
                for (j, (&start, &end)) in from.q.iter().zip(&target).enumerate() {
                    assert!(s.dq[j].abs() <= 0.5 * LIMITS.dq[j] + 1e-9 && s.ddq[j].abs() <= 0.3 * LIMITS.ddq[j] + 1e-9);
                    let (low, high) = (start.min(end), start.max(end));
                    assert!(s.q[j] >= low - 1e-7 && s.q[j] <= high + 1e-7);
                }
            }
        }
    }

    #[test]
    fn joints_arrive_together_also_after_an_unsynchronised_stop() {
        let mut planner = Planner::new(3, LIMITS, MoveFactors::default());
        let mut moving = Setpoint::default();
        (moving.dq[0], moving.dq[1]) = (1.0, 0.1);
        planner.stop(&moving).unwrap();
        let early = planner.at(planner.last_tick() - 20);
        assert!(early.dq[0] > 1e-6 && early.dq[1].abs() < 1e-12, "{:?}", early.dq);
        planner.move_to(&Setpoint::default(), &[0.5, 0.05, -0.2, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let early = planner.at(planner.last_tick() - 20);
        assert!(early.dq[0] > 1e-6 && early.dq[1] > 1e-6 && early.dq[2] < -1e-6, "{:?}", early.dq);
    }

    #[test]
    fn a_stop_travels_the_distance_that_the_guard_computes() {
        // Two routes to the braking distance: the closed form that the guard uses, and the samples of the planned stop.
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut planner = Planner::new(MAX_JOINTS, LIMITS, MoveFactors::default());
        for _ in 0..400 {
            let mut from = Setpoint { q: random(&mut rng, 8, 2.0), ..Setpoint::default() };
            for j in 0..MAX_JOINTS {
                from.dq[j] = rng.random_range(-1.0..1.0) * LIMITS.dq[j];
                from.ddq[j] = rng.random_range(-0.94..0.94) * LIMITS.ddq[j];
            }
            planner.stop(&from).unwrap();
            let samples: Vec<Setpoint> = (0..=planner.last_tick()).map(|tick| planner.at(tick)).collect();
            let end = samples.last().unwrap();
            assert_eq!((end.dq, end.ddq), Default::default());
            for j in 0..MAX_JOINTS {
                let (up, down) = stop_distances(from.dq[j], from.ddq[j], 0.95 * LIMITS.ddq[j], 0.95 * LIMITS.jerk[j]);
                let highest = samples.iter().map(|s| s.q[j] - from.q[j]).fold(0.0, f64::max);
                let lowest = samples.iter().map(|s| s.q[j] - from.q[j]).fold(0.0, f64::min);
                assert_abs_diff_eq!(highest, up, epsilon = 1e-5);
                assert_abs_diff_eq!(-lowest, down, epsilon = 1e-5);
            }
        }
    }

    #[test]
    fn samples_are_those_of_ruckigs_own_evaluation() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        // By ruckig's own brake, of one piece or two.
        let mut corrected = [0; 2];
        for case in 0..400 {
            let mut planner = Planner::new(7, LIMITS, MoveFactors::default());
            let mut from = Setpoint { q: random(&mut rng, 7, 2.0), ..Setpoint::default() };
            if case % 4 == 1 {
                for j in 0..7 {
                    // Faster than a move may be: it begins with ruckig's own brake, of two pieces where the acceleration is too large, too.
                    from.dq[j] = rng.random_range(-1.0..1.0) * LIMITS.dq[j];
                    from.ddq[j] = rng.random_range(-0.3..0.3) * LIMITS.ddq[j];
                }
            }
            if case % 2 == 0 || case % 4 == 1 {
                planner.move_to(&from, &random(&mut rng, 7, 2.0)).unwrap();
            } else {
                for j in 0..7 {
                    from.dq[j] = rng.random_range(-1.0..1.0) * LIMITS.dq[j];
                    // Past what the stop may use, too: such a stop begins with ruckig's own brake.
                    from.ddq[j] = rng.random_range(-1.2..1.2) * LIMITS.ddq[j];
                }
                planner.stop(&from).unwrap();
            }
            for (pieces, count) in corrected.iter_mut().enumerate() {
                let so_long = |profile: &&Profile| profile.brake.t.iter().filter(|t| **t > 0.0).count() == pieces + 1;
                *count += planner.trajectory.profiles[0].iter().filter(so_long).count();
            }
            let end = planner.trajectory.get_duration();
            for time in (0..200).map(|_| rng.random_range(0.0..1.0) * end).chain([0.0, end, end + PERIOD_S]) {
                let own = planner.evaluate(time);
                let new = || rsruckig::prelude::DataArrayOrVec::<f64, MAX_JOINTS>::new(None, 0.0);
                let (mut q, mut dq, mut ddq) = (new(), new(), new());
                let to = (&mut Some(&mut q), &mut Some(&mut dq), &mut Some(&mut ddq));
                planner.trajectory.at_time(time, to.0, to.1, to.2, &mut None, &mut None);
                for j in 0..7 {
                    if time < end {
                        assert_eq!((own.q[j], own.dq[j], own.ddq[j]), (q[j], dq[j], ddq[j]), "{case}: {time} of {end}");
                    }
                    // Behind the end ruckig subtracts in another order.
                    assert_abs_diff_eq!(own.q[j], q[j], epsilon = 1e-14);
                }
            }
        }
        assert!(corrected.iter().all(|&count| count > 100), "{corrected:?}");
    }

    #[test]
    fn numbers_that_are_not_finite_never_reach_ruckig() {
        let mut planner = Planner::new(3, LIMITS, MoveFactors::default());
        let mut bad = Setpoint::default();
        bad.dq[2] = f64::NAN;
        assert_eq!(planner.stop(&bad), Err(NoMotion));
        let mut target = [0.5; 8];
        target[7] = f64::NAN;
        assert_eq!(planner.move_to(&Setpoint::default(), &target), Ok(()), "joint 8 takes no part");
        assert_eq!(planner.at(u64::MAX).q[2..5], [0.5, 0.0, 0.0]);
        target[0] = f64::INFINITY;
        assert_eq!(planner.move_to(&Setpoint::default(), &target), Err(NoMotion));
    }
}
