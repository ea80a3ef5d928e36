//! Each limit of the guard is crossed: the command is not sent, and the arm comes to rest inside the limits.

use plumbline_core::{JointVec, MAX_JOINTS, Phase, Record, Reference, Setpoint, SpeedEnvelope, Validity, Workspace};
use plumbline_rt::cycle::End;
use plumbline_rt::{Event, Limit, StopReason, Violation};
use plumbline_testkit::fake_arm::drive::{Job, Model, READY, Run, Shape, Tool, Wave, follow, move_to, panda_limits};
use plumbline_testkit::fake_arm::{Disturbance, FakeArm};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// Forward kinematics of a test.
type Forward = fn(&JointVec) -> [f64; 3];
/// A disturbance, made anew for every run.
type Scripted = fn() -> Disturbance;

/// The run was stopped by the guard, for this reason, inside every limit, and rests.
fn assert_guarded(run: &Run, limit: Limit, joint: usize) -> Violation {
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    let Some(StopReason::Guard(violation)) = run.outcome.last_stop else { panic!("{:?}", run.outcome.last_stop) };
    assert_eq!((violation.limit, violation.joint), (limit, joint), "{violation}");
    assert_eq!((run.outcome.end, run.outcome.stops), (End::Quit, 1));
    let last = run.records.last().unwrap();
    assert_eq!(last.phase, Phase::Stopped);
    assert_eq!((last.command.desired.dq, last.command.desired.ddq), Default::default());
    violation
}

/// Joint `j` moves along `f`, given as position offset, velocity, acceleration over time; the others rest.
fn along(j: usize, ticks: u64, f: impl Fn(f64) -> [f64; 3] + Send + 'static) -> Shape<impl Fn(u64) -> Setpoint + Send> {
    Shape(ticks, move |tick| {
        let [q, dq, ddq] = f(tick as f64 * 1e-3);
        let mut out = Setpoint { q: READY, ..Setpoint::default() };
        (out.q[j], out.dq[j], out.ddq[j]) = (READY[j] + q, dq, ddq);
        out
    })
}

/// Ramps the acceleration to `ddq` within 10 ms and holds it: runs into a velocity limit or a position limit.
fn push_on(ddq: f64, top: f64) -> impl Fn(f64) -> [f64; 3] + Send {
    let ramp = 0.01;
    let slope = ddq / ramp;
    let until = ramp + (top.abs() - 0.5 * ddq.abs() * ramp) / ddq.abs();
    let phase = move |t: f64, s: [f64; 3], jerk: f64| {
        let [q, v, a] = s;
        [q + v * t + 0.5 * a * t * t + jerk * t * t * t / 6.0, v + a * t + 0.5 * jerk * t * t, a + jerk * t]
    };
    move |t| {
        let first = phase(t.min(ramp), [0.0; 3], slope);
        let second = phase((t - ramp).clamp(0.0, until - ramp), first, 0.0);
        let third = phase((t - until).clamp(0.0, ramp), second, -slope);
        phase((t - until - ramp).max(0.0), third, 0.0)
    }
}

#[test]
fn velocity_is_limited_ahead_of_time() {
    // Without the look ahead the brake itself, which takes the acceleration back first, would cross the limit.
    let run = Job::new(3_000).order(follow(1, along(0, 2_000, push_on(14.0, 2.4)))).run();
    let violation = assert_guarded(&run, Limit::VelocityAhead, 0);
    assert!(violation.value > 2.175 && violation.value < 2.25, "{violation}");
    let shares = run.shares(&panda_limits(), 7);
    assert!(shares[1] > 0.98, "stopped no earlier than needed: {shares:?}");
}

#[test]
fn position_is_limited_ahead_of_time_at_both_ends() {
    for (sign, bound) in [(1.0, 1.7628), (-1.0, -1.7628)] {
        let run = Job::new(5_000).order(follow(1, along(1, 4_000, push_on(7.0 * sign, 1.2)))).run();
        let violation = assert_guarded(&run, Limit::StoppingPosition, 1);
        assert_eq!(violation.bound, bound);
        let rest = run.records.last().unwrap().command.desired.q[1];
        assert!((rest - bound).abs() < 0.01, "came to rest at {rest}, next to the limit");
    }
}

#[test]
fn speed_falls_towards_the_ends_of_a_range_where_the_arm_has_it_so() {
    let envelope = SpeedEnvelope { offset: [0.2; MAX_JOINTS], deceleration: [2.0; MAX_JOINTS] };
    for sign in [1.0, -1.0] {
        // 1.2 rad/s is inside joint 2's limit, and under the envelope until some (1.2 + 0.2)^2 / 4 = 0.49 rad before the end.
        let mut job = Job::new(5_000).order(follow(1, along(1, 4_000, push_on(7.0 * sign, 1.2))));
        job.settings.guard.envelope = Some(envelope);
        let run = job.run();
        let violation = assert_guarded(&run, Limit::VelocityAhead, 1);
        assert!(violation.value * sign > 1.1 && violation.bound.abs() < 1.3, "{violation}");
        let (q_min, q_max) = (panda_limits().q_min[1], panda_limits().q_max[1]);
        for record in &run.records {
            let (q, dq) = (record.command.desired.q[1], record.command.desired.dq[1]);
            let room = if dq > 0.0 { q_max - q } else { q - q_min };
            let bound = envelope.at(1, room, panda_limits().dq[1]).0;
            assert!(dq.abs() <= bound, "{dq} rad/s at {q} rad, {bound} rad/s allowed");
        }
        let rest = run.records.last().unwrap().command.desired.q[1];
        assert!(rest > q_min + 0.2 && rest < q_max - 0.2, "came to rest at {rest}");
    }
}

#[test]
fn a_stop_stays_under_an_envelope_that_falls_faster_than_it_brakes() {
    // As joints 5 and 7 of a Research 3: 17 rad/s2, where joint 2 of the Panda brakes with 7.1.
    let envelope = SpeedEnvelope { offset: [0.46; MAX_JOINTS], deceleration: [17.0; MAX_JOINTS] };
    let (q_min, q_max, most) = (panda_limits().q_min[1], panda_limits().q_max[1], panda_limits().dq[1]);
    // The largest share of what the arm allows where it is.
    let nearest = |run: &Run| {
        let share = |record: &Record| {
            let (q, dq) = (record.command.desired.q[1], record.command.desired.dq[1]);
            let room = if dq > 0.0 { q_max - q } else { q - q_min };
            if dq == 0.0 { 0.0 } else { dq.abs() / envelope.at(1, room, most).0 }
        };
        run.records.iter().map(share).fold(0.0, f64::max)
    };
    for (sign, top) in [(1.0, 1.2), (-1.0, 1.2), (1.0, 2.0), (-1.0, 2.0)] {
        let job = || Job::new(5_000).order(follow(1, along(1, 4_000, push_on(7.0 * sign, top))));
        let mut guarded = job();
        guarded.settings.guard.envelope = Some(envelope);
        let run = guarded.run();
        assert_guarded(&run, Limit::VelocityAhead, 1);
        let share = nearest(&run);
        assert!(share > 0.5 && share <= 1.0, "{share} of what is allowed");
        // A stop for the position limit begins too late for the envelope.
        let run = job().run();
        assert_guarded(&run, Limit::StoppingPosition, 1);
        assert!(nearest(&run) > 1.5, "{} of what is allowed", nearest(&run));
    }
}

#[test]
fn acceleration_and_jerk_are_limited() {
    let run = Job::new(1_000).order(follow(1, along(3, 900, push_on(13.0, 1.5)))).run();
    assert_guarded(&run, Limit::Acceleration, 3);
    // 7 rad/s2 in 10 ms is 700 rad/s3.
    for (jerk, limited) in [(750.0, false), (650.0, true)] {
        let mut job = Job::new(500).order(follow(1, along(1, 900, push_on(7.0, 0.5))));
        job.settings.guard.limits.jerk[1] = jerk;
        let run = job.run();
        if limited {
            let violation = assert_guarded(&run, Limit::Jerk, 1);
            assert!((violation.value - 700.0).abs() < 1.0, "{violation}");
        } else {
            assert_eq!(run.outcome.last_stop, Some(StopReason::Quit));
        }
    }
}

#[test]
fn an_acceleration_that_the_stated_one_hides_is_refused() {
    // 26 rad/s2 by the positions; stated are 14.9 and the velocity that goes with these.
    let jerk = 7000.0;
    let q = move |tick: u64| {
        let (t, ramp) = (tick as f64 * 1e-3, 26.0 / jerk);
        let (s, late) = (t.min(ramp), (t - ramp).max(0.0));
        jerk * s.powi(3) / 6.0 + 0.5 * jerk * ramp * ramp * late + 0.5 * 26.0 * late * late
    };
    let hidden = Shape(60, move |tick| {
        let mut out = Setpoint { q: READY, ..Setpoint::default() };
        let seen = (q(tick) - q(tick.saturating_sub(1))) / 1e-3;
        out.ddq[0] = (jerk * tick as f64 * 1e-3).min(14.9);
        (out.q[0], out.dq[0]) = (READY[0] + q(tick), if tick == 0 { 0.0 } else { seen + 0.5e-3 * out.ddq[0] });
        out
    });
    let run = Job::new(1_000).order(follow(1, hidden)).run();
    let violation = assert_guarded(&run, Limit::Acceleration, 0);
    assert!(violation.value > 15.0 && violation.value < 26.0, "{violation}");
}

#[test]
fn a_jump_is_never_sent() {
    for (what, size) in [(Limit::Velocity, 0.05), (Limit::Position, 4.0)] {
        let jump = Shape(1_501, move |tick| {
            let mut out = Wave::gentle().at(tick);
            out.q[6] += if tick >= 700 { size } else { 0.0 };
            out
        });
        let run = Job::new(3_000).order(follow(1, jump)).run();
        assert_guarded(&run, what, 6);
        let stopped_at = run.records.iter().position(|r| r.phase == Phase::Stop).unwrap();
        assert_eq!(stopped_at, 700, "the first wrong sample is not sent, the stop takes its place");
    }
}

#[test]
fn derivatives_that_contradict_the_positions_are_refused() {
    // The stop starts from the stated derivatives: if they lied, it would start with a jump.
    for (limit, spoil) in [
        (Limit::StatedVelocity, (|s: &mut Setpoint| s.dq[2] = 0.0) as fn(&mut Setpoint)),
        (Limit::StatedAcceleration, |s| {
            let lie = -9.5 * s.ddq[2].signum();
            s.dq[2] += 0.5e-3 * (lie - s.ddq[2]);
            s.ddq[2] = lie;
        }),
    ] {
        let liar = Shape(1_501, move |tick| {
            let mut out = Wave::gentle().at(tick);
            if tick >= 500 {
                spoil(&mut out);
            }
            out
        });
        let run = Job::new(3_000).order(follow(1, liar)).run();
        assert_guarded(&run, limit, 2);
    }
}

#[test]
fn numbers_that_are_not_finite_are_never_sent() {
    let spoils: [fn(&mut Setpoint); 3] = [|s| s.q[4] = f64::NAN, |s| s.dq[4] = f64::INFINITY, |s| s.ddq[4] = f64::NAN];
    for spoil in spoils {
        let broken = Shape(1_501, move |tick| {
            let mut out = Wave::gentle().at(tick);
            if tick >= 600 {
                spoil(&mut out);
            }
            out
        });
        let run = Job::new(3_000).order(follow(1, broken)).run();
        assert_eq!(run.outcome.stops, 1);
        let Some(StopReason::Guard(violation)) = run.outcome.last_stop else { panic!() };
        assert_eq!((violation.limit, violation.joint), (Limit::NotFinite, 4));
        run.assert_sound();
        run.assert_inside(&panda_limits(), 7);
        assert!(run.records.iter().all(|r| r.command.desired.q.iter().all(|q| q.is_finite())));
    }
}

#[test]
fn a_model_that_breaks_a_torque_limit_is_not_evaluated_again() {
    let limits = [
        (Limit::Torque, (|d: &Setpoint| 500.0 * (d.q[0] - READY[0])) as fn(&Setpoint) -> f64),
        (Limit::TorqueRate, |d| 7.0 * d.ddq[0] * if d.dq[0] > 0.1 { 1.0 } else { -1.0 }),
        (Limit::TorqueNotFinite, |d| if d.q[0] > 0.05 { f64::NAN } else { 1.0 }),
    ];
    let wave = || Wave { amplitude: [0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], ..Wave::gentle() };
    for (limit, torque) in limits {
        let run = Job::new(6_000)
            .order(follow(1, wave()))
            .model(Model(5, move |d: &Setpoint| [torque(d), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
            .outside(3_000, |h| {
                assert!(h.models.serve(Box::new(Model(6, |_: &Setpoint| [1.5; MAX_JOINTS]))).is_ok());
            })
            .run();
        assert_guarded(&run, limit, 0);
        assert!(run.events.contains(&Event::Distrusted { model: 5, instead: 0 }));
        let stopped_in = run.records.iter().find(|record| record.phase == Phase::Stop).unwrap().cycle;
        for record in run.records.iter().filter(|r| matches!(r.phase, Phase::Stop | Phase::Stopped)) {
            let (model, tau) = if record.cycle < 3_000 { (0, 0.0) } else { (6, 1.5) };
            assert_eq!(record.model, model);
            // 87 Nm at most, at 1 Nm per cycle.
            let under_way = record.cycle < stopped_in + 90 || record.validity == Validity::HandOver;
            assert!(under_way || record.command.tau_ff.0[0] == tau, "{record:?}");
        }
        let limits = panda_limits();
        assert!(run.records.iter().all(|r| r.command.tau_ff.0[0].abs() <= limits.tau[0]));
    }
}

#[test]
fn the_end_effector_stays_in_its_box_and_off_the_base() {
    let workspace = Workspace { box_min: [-0.5, -0.2, 0.1], box_max: [0.5, 0.2, 0.8], base_radius: 0.3 };
    // A tool that joint 1 moves along one axis.
    let cases: [(Limit, usize, Forward); 3] = [
        (Limit::EndEffectorBox, 1, |q| [0.4, 3.0 * q[0], 0.4]),
        (Limit::EndEffectorBox, 2, |q| [0.4, 0.0, 0.2 - 2.0 * q[0].abs()]),
        (Limit::BaseSphere, 0, |q| [0.4 - 2.0 * q[0].abs(), 0.0, 0.15]),
    ];
    let mut aside = READY;
    aside[0] = 0.3;
    for (case, (limit, axis, tool)) in cases.into_iter().chain(cases).enumerate() {
        // First by a motion that is followed, then by a point-to-point one.
        let wave = Wave { amplitude: [0.1; 8], ..Wave::gentle() };
        let mut job = Job::new(3_000).order(if case < 3 { follow(1, wave) } else { move_to(1, aside) });
        job.settings.guard.workspace = Some(workspace);
        job.kinematics = Some(Box::new(Tool(tool)));
        let run = job.run();
        assert_guarded(&run, limit, axis);
        // No command but the brake's own was outside.
        for record in run.records.iter().filter(|r| !matches!(r.phase, Phase::Stop | Phase::Stopped)) {
            let x = tool(&record.command.desired.q);
            assert!((0..3).all(|k| (workspace.box_min[k]..=workspace.box_max[k]).contains(&x[k])));
            assert!(x.iter().map(|c| c * c).sum::<f64>() >= 0.09);
        }
    }
}

#[test]
fn measured_limits_stop_the_arm_in_every_phase() {
    let away: JointVec = [0.4, -0.3, -0.5, -1.9, 0.6, 1.2, 0.1, 0.0];
    let tricks: [(Limit, usize, Scripted); 3] = [
        (Limit::Tracking, 3, || Disturbance::Push(3, -0.11)),
        (Limit::MeasuredTorque, 5, || Disturbance::Torque(5, 12.5)),
        (Limit::MeasuredNotFinite, 1, || Disturbance::NanPosition(1)),
    ];
    for (read, phase) in [(50, Phase::Hold), (700, Phase::Approach), (2_600, Phase::Excite)] {
        for (limit, joint, disturbance) in tricks {
            let run = Job::new(6_000)
                .order(plumbline_testkit::fake_arm::drive::dwell(1, 100))
                .order(move_to(2, away))
                .order(follow(3, Wave { q0: away, ..Wave::gentle() }))
                .model(Model(5, |_: &Setpoint| [1.0; MAX_JOINTS]))
                .disturb(read, disturbance())
                .run();
            assert_guarded(&run, limit, joint);
            // The model is not the cause and continues to serve.
            assert_eq!(run.records.last().map(|record| (record.model, record.validity)), Some((5, Validity::Valid)));
            assert_eq!(run.records[read as usize - 1].phase, phase);
            assert_eq!(run.records[read as usize].phase, Phase::Stop);
        }
    }
}

#[test]
fn a_second_violation_stops_the_arm_by_its_own_means() {
    // NaN in the state twice: the first starts the brake, the second ends it.
    let run = Job::new(3_000)
        .order(follow(1, Wave::gentle()))
        .disturb(600, Disturbance::NanPosition(0))
        .disturb(605, Disturbance::NanPosition(2))
        .run();
    run.assert_sound();
    let End::Unsafe(violation) = run.outcome.end else { panic!("{:?}", run.outcome.end) };
    assert_eq!((violation.limit, violation.joint), (Limit::MeasuredNotFinite, 2));
    assert_eq!(run.calls.get().1, 605, "nothing is written after it");

    // An arm that starts outside its limits can't even hold.
    let mut outside = READY;
    outside[3] = 0.3;
    let run = Job::on(FakeArm::new(7, outside), 100).run();
    assert!(matches!(run.outcome.end, End::Unsafe(Violation { limit: Limit::Position, joint: 3, .. })));
    assert_eq!(run.calls.get().1, 0);
}

#[test]
fn a_motion_to_a_target_outside_the_limits_is_refused() {
    for (q, limit) in [(-0.01, Limit::Position), (f64::NAN, Limit::Position)] {
        let mut target = READY;
        target[3] = q;
        let run = Job::new(200).order(move_to(1, target)).run();
        if q.is_finite() {
            assert!(run.records.iter().all(|r| r.phase != Phase::Approach));
        }
        assert_guarded(&run, limit, 3);
        assert!(run.records.iter().all(|r| r.command.desired.q == READY));
    }
}

/// Random waves, many beyond a limit, with random lost states and stops: no sent command crosses a limit, and the arm ends at rest.
#[test]
fn random_motions_never_cross_a_limit() {
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let mut stopped = 0;
    for case in 0..150 {
        let mut amplitude = [0.0; MAX_JOINTS];
        amplitude
            .iter_mut()
            .take(7)
            .for_each(|a| *a = rng.random_range(-1.0..1.0) * rng.random_range(0.0..1.0_f64).powi(2));
        let frequency = rng.random_range(0.3..1.5);
        let mut job = Job::new(3_500)
            .order(follow(1, Wave { q0: READY, amplitude, frequency, ticks: rng.random_range(1_500..3_000) }))
            .outside(rng.random_range(0..6_000), |h| h.controls.stop());
        let lossy = case % 3 == 0;
        for _ in 0..if lossy { 10 } else { 0 } {
            job = job.disturb(rng.random_range(1..3_000), Disturbance::Lose(rng.random_range(1..5)));
        }
        let run = job.run();
        run.assert_sound();
        run.assert_inside(&panda_limits(), 7);
        assert_eq!(run.outcome.end, End::Quit, "case {case}");
        let last = run.records.last().unwrap().command.desired;
        assert_eq!((last.dq, last.ddq), Default::default(), "case {case}");
        stopped += u32::from(matches!(run.outcome.last_stop, Some(StopReason::Guard(_))));
    }
    assert!((20..140).contains(&stopped), "{stopped} of 150 stopped by the guard: both kinds must be there");
}
