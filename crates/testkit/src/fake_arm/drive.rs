//! Runs the loop on a fake arm, on the test's own thread, and looks at what was commanded by a route of its own.

use super::{Calls, Disturbance, FakeArm};
use plumbline_core::{
    FeedForward, JointVec, Kinematics, Limits, MAX_JOINTS, Phase, Record, Reference, Setpoint, Torque,
};
use plumbline_rt::Rights;
use plumbline_rt::cycle::Outcome;
use plumbline_rt::recorder::ring;
use plumbline_rt::{CycleSettings, Event, GuardSettings, Handles, Order, OrderKind, TimedEvent, cycle};
use std::sync::{Arc, Mutex};

/// The Panda's limits (FCI documentation), with joint 8 unused.
pub fn panda_limits() -> Limits {
    Limits {
        q_min: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973, 0.0],
        q_max: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973, 0.0],
        dq: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61, 0.0],
        ddq: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0, 0.0],
        jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0, 0.0],
        tau: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0, 0.0],
        dtau: [1000.0, 1000.0, 1000.0, 1000.0, 1000.0, 1000.0, 1000.0, 0.0],
    }
}

/// A pose well inside the limits.
pub const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];

pub fn settings() -> CycleSettings {
    let guard = GuardSettings { limits: panda_limits(), envelope: None, workspace: None, tracking: [0.1; MAX_JOINTS] };
    CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) }
}

/// A sine on every joint, faded in and out, at rest at both ends.
pub struct Wave {
    pub q0: JointVec,
    pub amplitude: JointVec,
    pub frequency: f64,
    pub ticks: u64,
}

impl Wave {
    /// A second and a half of smooth motion of all seven joints.
    pub fn gentle() -> Wave {
        Wave { q0: READY, amplitude: [0.1, 0.08, -0.12, 0.1, 0.15, -0.2, 0.2, 0.0], frequency: 0.8, ticks: 1501 }
    }
}

impl Reference for Wave {
    fn ticks(&self) -> u64 {
        self.ticks
    }

    /// `q0 + A sin^4(pi x) sin(w t)`, `x` from 0 to 1: the fade and two of its derivatives vanish at the ends.
    fn at(&self, tick: u64) -> Setpoint {
        let length = (self.ticks - 1) as f64 * 1e-3;
        let t = tick as f64 * 1e-3;
        let p = std::f64::consts::PI / length;
        let (s, c) = (p * t).sin_cos();
        let fade = [s.powi(4), 4.0 * p * s.powi(3) * c, 4.0 * p * p * (3.0 * s * s * c * c - s.powi(4))];
        let w = 2.0 * std::f64::consts::PI * self.frequency;
        let (sw, cw) = (w * t).sin_cos();
        let wave = [sw, w * cw, -w * w * sw];
        let mut out = Setpoint { q: self.q0, ..Setpoint::default() };
        for j in 0..MAX_JOINTS {
            let a = self.amplitude[j];
            out.q[j] += a * fade[0] * wave[0];
            out.dq[j] = a * (fade[1] * wave[0] + fade[0] * wave[1]);
            out.ddq[j] = a * (fade[2] * wave[0] + 2.0 * fade[1] * wave[1] + fade[0] * wave[2]);
        }
        out
    }
}

pub struct Shape<F>(pub u64, pub F);

impl<F: Fn(u64) -> Setpoint + Send> Reference for Shape<F> {
    fn ticks(&self) -> u64 {
        self.0
    }

    fn at(&self, tick: u64) -> Setpoint {
        self.1(tick)
    }
}

/// A model with a torque of any function of the setpoint.
pub struct Model<F>(pub u64, pub F);

impl<F: FnMut(&Setpoint) -> JointVec + Send> FeedForward for Model<F> {
    fn id(&self) -> u64 {
        self.0
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        Torque(self.1(desired))
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        Torque(*q)
    }
}

pub struct Tool<F>(pub F);

impl<F: Fn(&JointVec) -> [f64; 3] + Send> Kinematics for Tool<F> {
    fn end_effector(&self, q: &JointVec) -> [f64; 3] {
        self.0(q)
    }
}

pub fn move_to(motion: u32, target: JointVec) -> Order {
    Order { motion, kind: OrderKind::MoveTo { target, phase: Phase::Approach } }
}

pub fn follow(motion: u32, reference: impl Reference + 'static) -> Order {
    Order { motion, kind: OrderKind::Follow(Box::new(reference)) }
}

pub fn dwell(motion: u32, ticks: u64) -> Order {
    Order { motion, kind: OrderKind::Dwell { ticks } }
}

/// A job for the loop: orders up front, models up front, and the outside at scripted reads.
pub struct Job {
    pub arm: FakeArm,
    pub settings: CycleSettings,
    pub kinematics: Option<Box<dyn Kinematics>>,
    pub orders: Vec<Order>,
    pub models: Vec<Box<dyn FeedForward>>,
    pub sink: usize,
    outside: Vec<(u64, Outside)>,
    quit_at: u64,
}

/// Something the outside does with the loop's handles.
type Outside = Box<dyn FnMut(&mut Handles) + Send>;

pub struct Run {
    pub outcome: Outcome,
    pub records: Vec<Record>,
    pub events: Vec<Event>,
    pub timed: Vec<TimedEvent>,
    pub calls: Arc<Calls>,
}

impl Job {
    /// The Panda at its ready pose; quits at read `quit_at`, in motion or not.
    pub fn new(quit_at: u64) -> Job {
        Job::on(FakeArm::new(7, READY), quit_at)
    }

    pub fn on(arm: FakeArm, quit_at: u64) -> Job {
        let (orders, models, outside) = (Vec::new(), Vec::new(), Vec::new());
        Job { arm, settings: settings(), kinematics: None, orders, models, sink: 40_000, outside, quit_at }
    }

    pub fn order(mut self, order: Order) -> Job {
        self.orders.push(order);
        self
    }

    pub fn model(mut self, model: impl FeedForward + 'static) -> Job {
        self.models.push(Box::new(model));
        self
    }

    pub fn disturb(mut self, read: u64, disturbance: Disturbance) -> Job {
        self.arm = self.arm.at(read, disturbance);
        self
    }

    pub fn outside(mut self, read: u64, act: impl FnMut(&mut Handles) + Send + 'static) -> Job {
        self.outside.push((read, Box::new(act)));
        self
    }

    pub fn run(self) -> Run {
        let (sink, mut drain) = ring(self.sink);
        let calls = Arc::clone(&self.arm.calls);
        // The handles are shared with the calls that the arm makes in its reads; the lock is never contended.
        let shared: Arc<Mutex<Option<Handles>>> = Arc::default();
        let mut arm = self.arm.at(self.quit_at, call(&shared, |handles| handles.controls.quit()));
        for (read, mut act) in self.outside {
            arm = arm.at(read, call(&shared, move |handles| act(handles)));
        }
        let (mut cycle, mut handles) = cycle::new(arm, sink, self.kinematics, self.settings).unwrap();
        for order in self.orders {
            assert!(handles.orders.give(order).is_ok());
        }
        for model in self.models {
            assert!(handles.models.serve(model).is_ok());
        }
        *shared.lock().unwrap() = Some(handles);
        let outcome = cycle.run();
        drop(cycle);
        let mut handles = shared.lock().unwrap().take().unwrap();
        let mut records = Vec::new();
        drain.take_into(&mut records, usize::MAX);
        let timed: Vec<TimedEvent> = std::iter::from_fn(|| handles.events.pop().ok()).collect();
        let events = timed.iter().map(|timed| timed.event).collect();
        handles.free_retired();
        Run { outcome, records, events, timed, calls }
    }
}

fn call(shared: &Arc<Mutex<Option<Handles>>>, mut act: impl FnMut(&mut Handles) + Send + 'static) -> Disturbance {
    let shared = Arc::clone(shared);
    // The outside may allocate: on a real machine it is another thread.
    Disturbance::Call(Box::new(move || assert_no_alloc::permit_alloc(|| act(shared.lock().unwrap().as_mut().unwrap()))))
}

impl Run {
    /// Largest share of the limits that the commanded positions used, `[position, velocity, acceleration, jerk]`: derivatives by Newton's
    /// divided differences over the arm's own counter.
    pub fn shares(&self, limits: &Limits, joints: usize) -> [f64; 4] {
        let mut shares = [0.0_f64; 4];
        for j in 0..joints {
            let points: Vec<(f64, f64)> =
                self.records.iter().map(|r| (r.state.seq as f64 * 1e-3, r.command.desired.q[j])).collect();
            let (middle, half) = (0.5 * (limits.q_max[j] + limits.q_min[j]), 0.5 * (limits.q_max[j] - limits.q_min[j]));
            for (_, q) in &points {
                shares[0] = shares[0].max((q - middle).abs() / half);
            }
            for (order, limit, factorial) in [(1, limits.dq[j], 1.0), (2, limits.ddq[j], 2.0), (3, limits.jerk[j], 6.0)]
            {
                for window in points.windows(order + 1) {
                    shares[order] = shares[order].max(factorial * divided(window).abs() / limit);
                }
            }
        }
        shares
    }

    /// Nothing that was commanded crossed a limit.
    pub fn assert_inside(&self, limits: &Limits, joints: usize) {
        let shares = self.shares(limits, joints);
        assert!(shares.iter().all(|share| *share <= 1.0 + 1e-5), "shares of the limits {shares:?}");
    }

    /// The arm rests where it was left, and every cycle of the arm is accounted for.
    pub fn assert_sound(&self) {
        let summary = &self.outcome.summary;
        assert_eq!(summary.elapsed, summary.cycles + summary.lost);
        let (reads, writes, stops, after) = self.calls.get();
        assert!(
            stops > 0 && after == 0 && writes <= reads,
            "{reads} reads, {writes} writes, {stops} stops, {after} after"
        );
        assert_eq!(self.outcome.allocations, Some(0));
        let cycles: Vec<u64> = self.records.iter().map(|r| r.cycle).collect();
        assert!(cycles.windows(2).all(|pair| pair[1] == pair[0] + 1), "records without gaps");
    }

    pub fn phases(&self) -> Vec<Phase> {
        let mut phases: Vec<Phase> = self.records.iter().map(|r| r.phase).collect();
        phases.dedup();
        phases
    }
}

fn divided(points: &[(f64, f64)]) -> f64 {
    match points {
        [(_, q)] => *q,
        [(first, _), .., (last, _)] => (divided(&points[1..]) - divided(&points[..points.len() - 1])) / (last - first),
        [] => 0.0,
    }
}
