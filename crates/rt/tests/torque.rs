//! The served torque in the loop: hand-overs between models, models that break a limit, models that are withdrawn. Never a jump.

use plumbline_core::{Command, FeedForward, JointVec, MAX_JOINTS, Phase, Record, Setpoint, State, Torque, Validity};
use plumbline_rt::cycle::End;
use plumbline_rt::{Event, Guard, Handles, Limit, ModelTorques, StopReason, Torques, Violation};
use plumbline_testkit::fake_arm::drive::{Job, READY, Run, Wave, follow, panda_limits};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// The torque-rate limit per command \[Nm\], of which a hand-over uses half.
const STEP: f64 = 1.0;

/// A model of any two functions: the feed-forward, and what the arm adds.
struct Model<F, V>(u64, F, V);

impl<F, V> FeedForward for Model<F, V>
where
    F: FnMut(&Setpoint) -> JointVec + Send,
    V: FnMut(&JointVec) -> JointVec + Send,
{
    fn id(&self) -> u64 {
        self.0
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        Torque(self.1(desired))
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        Torque(self.2(q))
    }
}

/// `shoulder` Nm in joint 2 and a quarter of it for the arm's own controller, both with the position.
fn heavy(id: u64, shoulder: f64) -> Box<dyn FeedForward> {
    let at = move |share: f64, q: &JointVec| {
        let mut tau = JointVec::default();
        (tau[0], tau[1]) = (q[0], share * shoulder * (1.0 + 0.1 * (q[1] - READY[1])));
        tau
    };
    Box::new(Model(id, move |d: &Setpoint| at(1.0, &d.q), move |q: &JointVec| at(0.25, q)))
}

/// The same until `broken`, then `wrong` in joint 2.
fn breaking(id: u64, shoulder: f64, broken: Arc<AtomicBool>, wrong: f64) -> Box<dyn FeedForward> {
    let mut sound = heavy(id, shoulder);
    let torque = move |d: &Setpoint| {
        let mut tau = sound.torque(d).0;
        if broken.load(Ordering::Relaxed) {
            tau[1] = wrong;
        }
        tau
    };
    let mut sound = heavy(id, shoulder);
    Box::new(Model(id, torque, move |q: &JointVec| sound.vendor_torque(q).0))
}

/// At a read, `model` is handed over.
fn hand_over(model: Box<dyn FeedForward>) -> impl FnMut(&mut Handles) + Send {
    let mut model = Some(model);
    move |handles| assert!(handles.models.serve(model.take().unwrap()).is_ok())
}

fn torques(record: &Record) -> [JointVec; 2] {
    [record.command.tau_ff.0, record.command.tau_vendor.0]
}

/// From one command to the next neither torque changed by more than `most` in any joint, states lost or not.
#[track_caller]
fn assert_no_jump(records: &[Record], most: f64) {
    for pair in records.windows(2) {
        let [before, now] = [&pair[0], &pair[1]].map(torques);
        for (before, now) in before.iter().flatten().zip(now.iter().flatten()) {
            assert!(
                (now - before).abs() <= most * (1.0 + 1e-9),
                "{before} Nm, then {now} Nm in cycle {}",
                pair[1].cycle
            );
        }
    }
}

/// What stood behind the torque, in order, with its model.
fn validities(run: &Run) -> Vec<(u64, Validity)> {
    let mut found: Vec<(u64, Validity)> = run.records.iter().map(|record| (record.model, record.validity)).collect();
    found.dedup();
    found
}

#[test]
fn a_hand_over_during_a_motion_is_rate_limited_and_ends_at_the_new_models_torque() {
    use Validity::{HandOver, Valid};
    let run = Job::new(3_000)
        .order(follow(1, Wave { ticks: 2_501, ..Wave::gentle() }))
        .outside(0, hand_over(heavy(1, -12.0)))
        .outside(1_000, hand_over(heavy(2, 70.0)))
        .run();
    run.assert_sound();
    assert_eq!(run.outcome.stops, 0);
    // Before the first command there was no torque.
    assert_eq!(validities(&run), [(1, Valid), (2, HandOver), (2, Valid)]);
    assert_no_jump(&run.records, 0.5 * STEP);
    let hand_over = run.records.iter().filter(|record| record.validity == HandOver).count();
    // 82 Nm at 500 Nm/s.
    assert!((160..=170).contains(&hand_over), "{hand_over} cycles");
    let [mut first, mut second] = [heavy(1, -12.0), heavy(2, 70.0)];
    for record in run.records.iter().filter(|record| record.validity == Valid) {
        let (model, desired) = (if record.model == 1 { &mut first } else { &mut second }, &record.command.desired);
        assert_eq!(record.command.tau_ff, model.torque(desired));
        assert_eq!(record.command.tau_vendor, model.vendor_torque(&desired.q));
    }
}

#[test]
fn the_torque_of_a_doubted_model_is_marked_until_it_is_trusted_or_another_serves() {
    use Validity::{Doubtful, HandOver, Valid};
    let run = Job::new(3_000)
        .order(follow(1, Wave { ticks: 2_501, ..Wave::gentle() }))
        .outside(0, hand_over(heavy(1, -12.0)))
        .outside(500, |handles| handles.controls.doubt(1))
        .outside(700, |handles| handles.controls.doubt(0))
        .outside(900, |handles| handles.controls.doubt(1))
        .outside(1_000, hand_over(heavy(2, 70.0)))
        .run();
    run.assert_sound();
    let expected = [(1, Valid), (1, Doubtful), (1, Valid), (1, Doubtful), (2, HandOver), (2, Valid)];
    assert_eq!(validities(&run), expected);
    // A mark and nothing else: the torque is the model's.
    let mut model = heavy(1, -12.0);
    for record in run.records.iter().filter(|record| record.validity == Doubtful) {
        assert_eq!(record.command.tau_ff, model.torque(&record.command.desired));
    }
}

#[test]
fn the_first_model_and_the_withdrawal_cause_no_jump() {
    use Validity::{HandOver, None, Valid, Withdrawn};
    let zero = |_: &Setpoint| JointVec::default();
    let run = Job::new(3_000)
        .order(follow(1, Wave::gentle()))
        .outside(300, hand_over(heavy(1, 40.0)))
        .outside(1_000, hand_over(Box::new(Model(0, zero, |_: &JointVec| JointVec::default()))))
        .outside(2_000, hand_over(heavy(2, -40.0)))
        .run();
    run.assert_sound();
    assert_eq!(validities(&run), [(0, None), (1, HandOver), (1, Valid), (0, Withdrawn), (2, HandOver), (2, Valid)]);
    assert_no_jump(&run.records, 0.5 * STEP);
    assert_eq!(torques(&run.records[1_990]), [JointVec::default(); 2], "withdrawn for a second");
}

#[test]
fn a_change_of_gravity_is_a_hand_over_of_the_same_model() {
    use Validity::{HandOver, Valid};
    let run = Job::new(2_000)
        .outside(0, hand_over(heavy(1, 40.0)))
        .outside(500, hand_over(heavy(1, 40.2)))
        .outside(1_000, hand_over(heavy(1, 44.0)))
        .run();
    run.assert_sound();
    // 0.2 Nm are one command's change.
    assert_eq!(validities(&run), [(1, Valid), (1, HandOver), (1, Valid)]);
    assert_no_jump(&run.records, 0.5 * STEP);
}

/// Runs a motion whose model 2 breaks at read `at`; model 1 served before it, where `with_reserve`.
fn broken_at(at: u64, wrong: f64, with_reserve: bool, stop_at: Option<u64>) -> Run {
    let broken = Arc::new(AtomicBool::new(false));
    let breaks = Arc::clone(&broken);
    let mut job = Job::new(4_000).order(follow(1, Wave { ticks: 2_501, ..Wave::gentle() }));
    if with_reserve {
        job = job.outside(0, hand_over(heavy(1, -12.0)));
    }
    job = job.outside(300, hand_over(breaking(2, 12.0, broken, wrong)));
    if let Some(read) = stop_at {
        job = job.outside(read, |handles| handles.controls.stop());
    }
    job.outside(at, move |_| breaks.store(true, Ordering::Relaxed)).run()
}

#[test]
fn a_model_that_breaks_a_limit_is_replaced_by_the_one_before_it_or_by_zero() {
    use Validity::{HandOver, Valid, Withdrawn};
    for (wrong, limit) in [(f64::NAN, Limit::TorqueNotFinite), (90.0, Limit::Torque), (14.0, Limit::TorqueRate)] {
        for with_reserve in [true, false] {
            let run = broken_at(1_200, wrong, with_reserve, None);
            run.assert_sound();
            run.assert_inside(&panda_limits(), 7);
            let Some(StopReason::Guard(Violation { limit: found, joint: 1, .. })) = run.outcome.last_stop else {
                panic!("{:?}", run.outcome.last_stop)
            };
            assert_eq!((found, run.outcome.end), (limit, End::Quit));
            let instead = u64::from(with_reserve);
            assert!(run.events.contains(&Event::Distrusted { model: 2, instead }), "{:?}", run.events);
            // The brake may use the whole rate.
            assert_no_jump(&run.records, STEP);
            let end = validities(&run);
            if with_reserve {
                assert_eq!(end.last_chunk::<3>(), Some(&[(2, Valid), (1, HandOver), (1, Valid)]));
                assert_eq!(
                    run.records.last().unwrap().command.tau_ff,
                    heavy(1, -12.0).torque(&run.records.last().unwrap().command.desired)
                );
            } else {
                assert_eq!(end.last_chunk::<2>(), Some(&[(2, Valid), (0, Withdrawn)]));
                assert_eq!(torques(run.records.last().unwrap()), [JointVec::default(); 2]);
            }
        }
    }
}

#[test]
fn during_the_brake_the_torque_does_not_jump_either() {
    for wrong in [f64::NAN, f64::INFINITY, 90.0, -60.0] {
        for with_reserve in [true, false] {
            // The brake begins at read 1200, and takes longer than 5 ms.
            let run = broken_at(1_205, wrong, with_reserve, Some(1_200));
            run.assert_sound();
            assert_eq!((run.outcome.last_stop, run.outcome.end), (Some(StopReason::Requested), End::Quit));
            assert_eq!(run.records[1_205].phase, Phase::Stop);
            assert_no_jump(&run.records, STEP);
            // A torque within the limits is followed at the allowed rate, and the model remains.
            let leaves = wrong != -60.0;
            let instead = u64::from(with_reserve);
            assert_eq!(run.events.contains(&Event::Distrusted { model: 2, instead }), leaves, "{:?}", run.events);
            // In that cycle, before the sent torque reaches the limit.
            assert_eq!(run.records[1_205].model, if leaves { instead } else { 2 });
        }
    }
}

#[test]
fn the_torque_returns_to_zero_when_the_fallback_breaks_the_limit_too() {
    let broken = Arc::new(AtomicBool::new(false));
    let [first, second, breaks] = [(); 3].map(|()| Arc::clone(&broken));
    let run = Job::new(3_000)
        .order(follow(1, Wave { ticks: 2_501, ..Wave::gentle() }))
        .outside(0, hand_over(breaking(1, 12.0, first, f64::NAN)))
        .outside(300, hand_over(breaking(2, 20.0, second, f64::NAN)))
        .outside(1_000, move |_| breaks.store(true, Ordering::Relaxed))
        // Both have left over the ring; a third one serves again.
        .outside(2_000, |handles| assert!(handles.free_retired() >= 2))
        .outside(2_500, hand_over(heavy(3, 5.0)))
        .run();
    run.assert_sound();
    assert_eq!(run.outcome.end, End::Quit);
    let lost: Vec<&Event> = run.events.iter().filter(|event| matches!(event, Event::Distrusted { .. })).collect();
    assert_eq!(lost, [&Event::Distrusted { model: 2, instead: 1 }, &Event::Distrusted { model: 1, instead: 0 }]);
    assert_no_jump(&run.records, STEP);
    assert_eq!(torques(&run.records[2_490]), [JointVec::default(); 2]);
    assert_eq!(run.records.last().map(|record| (record.model, record.validity)), Some((3, Validity::Valid)));
}

#[test]
fn a_stop_whose_own_torque_is_too_fast_is_driven_to_its_end_with_a_slower_one() {
    // 10 kg m2 under a jerk of 3750 rad/s3 are many times the rate limit.
    let mut limits = panda_limits();
    limits.tau = [1000.0; MAX_JOINTS];
    let inertia = |d: &Setpoint| d.ddq.map(|ddq| 10.0 * ddq);
    let mut job = Job::new(3_000)
        .order(follow(1, Wave { amplitude: [0.0, 0.05, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ticks: 2_501, ..Wave::gentle() }))
        .outside(0, hand_over(Box::new(Model(1, inertia, |_: &JointVec| JointVec::default()))))
        .outside(1_150, |handles| handles.controls.stop());
    job.settings.guard.limits = limits;
    let run = job.run();
    run.assert_sound();
    assert_eq!((run.outcome.last_stop, run.outcome.end), (Some(StopReason::Requested), End::Quit));
    assert!(!run.events.iter().any(|event| matches!(event, Event::Distrusted { .. })), "{:?}", run.events);
    assert_no_jump(&run.records, STEP);
    assert!(run.records.iter().any(|record| record.phase == Phase::Stop && record.validity == Validity::HandOver));
    assert_eq!(run.records.last().unwrap().validity, Validity::Valid);
}

#[test]
fn a_model_with_alternating_torque_is_rejected_during_its_hand_over() {
    let mut up = false;
    let zigzag = move |_: &Setpoint| {
        up = !up;
        [if up { 40.0 } else { -40.0 }; MAX_JOINTS].map(|tau: f64| tau.clamp(-11.0, 11.0))
    };
    let run = Job::new(1_000)
        .order(follow(1, Wave::gentle()))
        .outside(0, hand_over(heavy(1, 30.0)))
        .outside(300, hand_over(Box::new(Model(2, zigzag, |_: &JointVec| JointVec::default()))))
        .run();
    assert!(run.events.contains(&Event::Distrusted { model: 2, instead: 1 }), "{:?}", run.events);
    assert!(matches!(run.outcome.last_stop, Some(StopReason::Guard(Violation { limit: Limit::TorqueRate, .. }))));
    assert_no_jump(&run.records, STEP);
}

#[test]
fn the_arms_own_torque_has_the_same_limits() {
    type Wrong = fn(f64) -> f64;
    let cases: [(Limit, Wrong); 4] = [
        (Limit::TorqueNotFinite, |_| f64::NAN),
        (Limit::TorqueNotFinite, |_| f64::NEG_INFINITY),
        (Limit::Torque, |_| -87.1),
        (Limit::TorqueRate, |before| before + 1.01),
    ];
    for (limit, wrong) in cases {
        let broken = Arc::new(AtomicBool::new(false));
        let breaks = Arc::clone(&broken);
        let vendor = move |_: &JointVec| {
            let mut tau = [3.0; MAX_JOINTS];
            if broken.load(Ordering::Relaxed) {
                tau[2] = wrong(3.0);
            }
            tau
        };
        let run = Job::new(2_000)
            .order(follow(1, Wave::gentle()))
            .outside(0, hand_over(Box::new(Model(1, |_: &Setpoint| [1.0; MAX_JOINTS], vendor))))
            .outside(700, move |_| breaks.store(true, Ordering::Relaxed))
            .run();
        run.assert_sound();
        let Some(StopReason::Guard(violation)) = run.outcome.last_stop else { panic!("{:?}", run.outcome.last_stop) };
        assert_eq!((violation.limit, violation.joint), (limit, 2), "{violation}");
        assert!(run.events.contains(&Event::Distrusted { model: 1, instead: 0 }));
        assert_no_jump(&run.records, STEP);
    }
}

#[test]
fn the_guard_refuses_a_torque_that_jumps_in_motion_and_in_the_brake() {
    let torques = |tau: f64| Torques { tau_ff: Torque([tau; MAX_JOINTS]), tau_vendor: Torque([-tau; MAX_JOINTS]) };
    let command = |tau: f64| {
        let Torques { tau_ff, tau_vendor } = torques(tau);
        Command { desired: Setpoint { q: READY, ..Setpoint::default() }, tau_ff, tau_vendor, ..Command::default() }
    };
    let asked = |tau: f64| ModelTorques { now: torques(tau), before: None };
    let state = State { q: READY, ..State::default() };
    for (tau, allowed) in [(0.99, true), (1.01, false), (-1.01, false)] {
        let made = || {
            let mut guard = Guard::new(7, plumbline_testkit::fake_arm::drive::settings().guard, 0.9, None);
            guard.start(READY);
            assert_eq!(guard.check(1e-3, &command(0.0), &asked(0.0), &state), Ok(()));
            guard
        };
        let limit = |found: Result<(), Violation>| found.map_err(|violation| violation.limit);
        let expected = if allowed { Ok(()) } else { Err(Limit::TorqueRate) };
        assert_eq!(limit(made().check(1e-3, &command(tau), &asked(tau), &state)), expected, "{tau}");
        assert_eq!(limit(made().check_brake(1e-3, &command(tau), &asked(tau), Some(&state))), expected, "{tau}");
        // The arm's own torque is limited to the same rate.
        let vendor = Command { tau_ff: Torque::default(), ..command(tau) };
        assert_eq!(limit(made().check(1e-3, &vendor, &asked(0.0), &state)), expected, "{tau}");
    }
}
