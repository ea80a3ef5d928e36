//! The loop as a whole on a perfect arm: order of motions, models, stops, lost states, faults, and not one allocation.

use plumbline_core::{Backend, Command, Fault, JointVec, PERIOD_NS, Phase, Reference, Setpoint, State, Validity};
use plumbline_rt::cycle::End;
use plumbline_rt::os::{now_ns, sleep_until};
use plumbline_rt::recorder::ring;
use plumbline_rt::{CycleSettings, Event, SetupError, StopReason, cycle};
use plumbline_testkit::fake_arm::drive::{Job, Model, READY, Run, Shape, Wave, dwell, follow, move_to, panda_limits};
use plumbline_testkit::fake_arm::{Disturbance, FakeArm};

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

const AWAY: JointVec = [0.4, -0.3, -0.5, -1.9, 0.6, 1.2, 0.1, 0.0];

fn started_at(q0: JointVec) -> Wave {
    Wave { q0, ..Wave::gentle() }
}

#[test]
fn a_whole_job_runs_in_order_inside_the_limits_and_allocates_nothing() {
    let run = Job::new(9_000)
        .order(move_to(1, AWAY))
        .order(follow(2, started_at(AWAY)))
        .order(dwell(3, 100))
        .order(follow(4, started_at(AWAY)))
        .order(move_to(5, READY))
        .model(Model(7, |d: &Setpoint| d.q.map(|q| 2.0 * q)))
        .outside(1_800, |handles| {
            assert!(handles.models.serve(Box::new(Model(8, |d: &Setpoint| d.q.map(|q| -3.0 * q)))).is_ok());
        })
        .run();
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    assert_eq!(run.outcome.end, End::Quit);
    assert_eq!((run.outcome.stops, run.outcome.summary.cycles), (0, 9_001));
    assert_eq!(run.records.len(), 9_001, "hold cycles are recorded too");
    use Event::{Ended, Serving, Started};
    let expected = [Serving { model: 7 }, Started { motion: 1 }, Ended { motion: 1 }, Started { motion: 2 }];
    assert_eq!(run.events[..4], expected);
    let motions: Vec<Event> = run.events.iter().copied().filter(|e| !matches!(e, Serving { .. })).collect();
    let expected: Vec<Event> = (1..=5).flat_map(|motion| [Started { motion }, Ended { motion }]).collect();
    assert_eq!(motions, expected);

    // Every sample of the reference, once, in order, and exactly as it was given.
    for motion in [2, 4] {
        let excited: Vec<_> = run.records.iter().filter(|r| r.motion == motion && r.phase == Phase::Excite).collect();
        assert_eq!(excited.len() as u64, started_at(AWAY).ticks());
        for (tick, record) in excited.iter().enumerate() {
            assert_eq!(record.tick, tick as u64);
            assert_eq!(record.command.desired, started_at(AWAY).at(record.tick));
        }
    }
    assert_eq!(run.records.iter().filter(|r| r.motion == 3 && r.tick > 0).count(), 99);
    assert_eq!(run.records.last().unwrap().command.desired, Setpoint { q: READY, ..Setpoint::default() });
    // In the rest after a motion the number of its last sample stays.
    let rested: Vec<u64> = run.records.iter().rev().take_while(|r| r.phase == Phase::Hold).map(|r| r.tick).collect();
    let last_tick = run.records[run.records.len() - 1 - rested.len()].tick;
    assert!(rested.len() > 100 && rested.iter().all(|&tick| tick == last_tick), "{last_tick}");
    assert_eq!(run.outcome.flight, run.records[run.records.len() - 200..]);
}

#[test]
fn a_model_is_exact_after_its_hand_over_and_an_old_one_is_freed_outside() {
    let run = Job::new(3_000)
        .order(follow(1, Wave::gentle()))
        .outside(400, |h| assert!(h.models.serve(Box::new(Model(1, |d: &Setpoint| d.q.map(|q| 4.0 * q)))).is_ok()))
        .outside(900, |h| assert!(h.models.serve(Box::new(Model(2, |d: &Setpoint| d.dq.map(|v| -5.0 * v)))).is_ok()))
        .outside(2_000, |h| assert!(h.models.serve(Box::new(Model(3, |_: &Setpoint| [0.0; 8]))).is_ok()))
        .outside(2_500, |h| {
            assert_eq!(h.free_retired(), 2, "model 1 and the finished reference; model 2 is in reserve")
        })
        .run();
    run.assert_sound();
    assert_eq!(run.outcome.stops, 0);
    let mut cycles_with = [0; 4];
    for record in &run.records {
        cycles_with[record.model as usize] += 1;
        let desired = &record.command.desired;
        let expected = match record.model {
            1 => desired.q.map(|q| 4.0 * q),
            2 => desired.dq.map(|v| -5.0 * v),
            _ => JointVec::default(),
        };
        assert!(record.command.tau_ff.0 == expected || record.validity == Validity::HandOver, "{record:?}");
    }
    assert_eq!(cycles_with, [400, 500, 1_100, 1_001]);
    assert!(run.records.iter().filter(|record| record.validity == Validity::HandOver).count() < 100);
}

#[test]
fn an_allocation_in_a_model_is_counted() {
    let run = Job::new(50).model(Model(1, |d: &Setpoint| std::hint::black_box(d.q.to_vec()).try_into().unwrap())).run();
    // One allocation and one release in each of 51 cycles.
    assert_eq!(run.outcome.allocations, Some(102));
}

/// A controlled stop ends at rest, remains there, and keeps every limit.
fn assert_stopped(run: &Run, reason: StopReason) {
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    assert_eq!((run.outcome.stops, run.outcome.last_stop, run.outcome.end), (1, Some(reason), End::Quit));
    assert_eq!(run.records.last().unwrap().phase, Phase::Stopped);
    let rest = run.records.last().unwrap().command.desired;
    assert_eq!((rest.dq, rest.ddq), Default::default());
    let resting = run.records.iter().filter(|r| r.phase == Phase::Stopped);
    assert!(resting.clone().count() > 10 && resting.into_iter().all(|r| r.command.desired == rest));
}

#[test]
fn a_stop_in_any_phase_ends_at_rest_and_smoothly() {
    for (read, phase) in [(10, Phase::Hold), (300, Phase::Approach), (2_600, Phase::Excite)] {
        let run = Job::new(6_000)
            .order(dwell(1, 100))
            .order(move_to(2, AWAY))
            .order(follow(3, started_at(AWAY)))
            .order(move_to(4, READY))
            .outside(read, |h| h.controls.stop())
            .run();
        assert_stopped(&run, StopReason::Requested);
        assert_eq!(run.records[read as usize - 1].phase, phase, "read {read}");
        assert_eq!(run.phases().last_chunk::<3>(), Some(&[phase, Phase::Stop, Phase::Stopped]));
        assert!(run.outcome.summary.discarded_orders >= 1, "what was queued does not run");
        assert!(!run.events.contains(&Event::Started { motion: 4 }));
    }
}

#[test]
fn nothing_moves_before_an_operator_resumes_and_only_what_was_ordered_since() {
    let run = Job::new(4_000)
        .order(move_to(1, AWAY))
        .order(move_to(2, READY))
        .outside(200, |h| h.controls.stop())
        .outside(201, |h| assert!(!h.controls.resume(), "no permission while it brakes"))
        .outside(600, |h| assert!(h.orders.give(move_to(3, AWAY)).is_ok(), "ordered without permission"))
        .outside(1_000, |h| {
            assert!(h.controls.is_waiting());
            assert!(h.orders.give(move_to(4, AWAY)).is_ok());
            assert!(h.controls.resume());
            assert!(h.orders.give(move_to(5, READY)).is_ok());
        })
        .run();
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    assert_eq!(run.outcome.summary.discarded_orders, 3);
    let discarded: Vec<u32> = run
        .events
        .iter()
        .filter_map(|event| if let Event::Discarded { motion } = event { Some(*motion) } else { None })
        .collect();
    assert_eq!(discarded, [2, 3, 4]);
    let motions: Vec<&Event> = run.events.iter().filter(|e| !matches!(e, Event::Discarded { .. })).collect();
    let stopping = Event::Stopping { motion: 1, reason: StopReason::Requested };
    let expected = [
        Event::Started { motion: 1 },
        stopping,
        Event::Stopped,
        Event::Resumed,
        Event::Started { motion: 5 },
        Event::Ended { motion: 5 },
    ];
    assert_eq!(motions, expected.iter().collect::<Vec<_>>());
    assert_eq!(run.records.last().unwrap().command.desired.q, READY);
}

#[test]
fn quitting_in_mid_motion_stops_first() {
    let run = Job::new(700).order(move_to(1, AWAY)).run();
    run.assert_sound();
    run.assert_inside(&panda_limits(), 7);
    assert_eq!((run.outcome.end, run.outcome.last_stop), (End::Quit, Some(StopReason::Quit)));
    let last = run.records.last().unwrap().command.desired;
    assert_eq!((last.dq, last.ddq), Default::default());
    assert_ne!(last.q, AWAY);
}

#[test]
fn lost_states_cost_samples_but_no_time() {
    let lose = [(300, 1), (500, 4), (501, 1), (900, 10)];
    let mut job = Job::new(3_000).order(follow(1, Wave::gentle()));
    for (read, count) in lose {
        job = job.disturb(read, Disturbance::Lose(count));
    }
    let run = job.run();
    run.assert_sound();
    assert_eq!(run.outcome.stops, 0);
    let summary = &run.outcome.summary;
    assert_eq!((summary.lost, summary.longest_lost, summary.cycles), (16, 10, 3_001));
    // A sample's tick is the arm's clock since the start, lost states or not.
    let start = run.records[0].state.seq;
    for record in run.records.iter().filter(|r| r.phase == Phase::Excite) {
        assert_eq!(record.tick, record.state.seq - start);
        assert_eq!(record.command.desired, Wave::gentle().at(record.tick));
    }
    assert_eq!(run.records.iter().filter(|r| r.phase == Phase::Excite).count(), 1_501 - 16);
}

#[test]
fn too_many_lost_states_stop_the_motion() {
    let run = Job::new(3_000).order(follow(1, Wave::gentle())).disturb(700, Disturbance::Lose(11)).run();
    assert_stopped(&run, StopReason::LostStates { lost: 11 });
}

#[test]
fn an_arm_at_rest_holds_however_many_states_are_lost_and_its_next_motion_starts() {
    let run = Job::new(3_000)
        .order(dwell(1, 100))
        .disturb(300, Disturbance::Lose(400))
        .outside(500, |h| assert!(h.orders.give(follow(2, Wave::gentle())).is_ok()))
        .run();
    run.assert_sound();
    assert_eq!((run.outcome.stops, run.outcome.summary.longest_lost), (0, 400));
    assert_eq!(run.events.last(), Some(&Event::Ended { motion: 2 }));
}

#[test]
fn a_reference_that_starts_elsewhere_is_refused() {
    let run = Job::new(200).order(follow(1, started_at(AWAY))).run();
    assert_stopped(&run, StopReason::NotAtStart { motion: 1, joint: 0, distance: 0.4 });
    assert!(run.records.iter().all(|r| r.command.desired.q == READY));
}

#[test]
fn a_reference_that_starts_two_microradians_away_is_refused() {
    // The guard would take it: 2e-6 rad in a millisecond are 2000 rad/s3 and less than any limit.
    let mut near = READY;
    near[3] += 2e-6;
    let run = Job::new(300).order(follow(1, started_at(near))).run();
    let Some(StopReason::NotAtStart { motion: 1, joint: 3, distance }) = run.outcome.last_stop else {
        panic!("{:?}", run.outcome.last_stop)
    };
    assert!((distance - 2e-6).abs() < 1e-12, "{distance}");
    near[3] = READY[3] + 0.5e-6;
    let run = Job::new(2_000).order(follow(1, started_at(near))).run();
    assert_eq!(run.outcome.stops, 0);
}

#[test]
fn the_arm_is_stopped_by_a_loop_that_ends_one_that_panics_and_one_that_never_ran() {
    let made = || {
        let arm = FakeArm::new(7, READY);
        let seen = std::sync::Arc::clone(&arm.calls);
        let (cycle, handles) =
            cycle::new(arm, ring(100).0, None, plumbline_testkit::fake_arm::drive::settings()).unwrap();
        (cycle, handles, seen)
    };
    let stops = |seen: &plumbline_testkit::fake_arm::Calls| seen.get().2;
    let (mut ending, handles, seen) = made();
    handles.controls.quit();
    assert_eq!((ending.run().end, stops(&seen)), (End::Quit, 1));
    drop(ending);

    let (mut panicking, mut handles, seen) = made();
    let model = Model(1, |_: &Setpoint| -> JointVec { panic!("a model that panics") });
    assert!(handles.models.serve(Box::new(model)).is_ok());
    let run = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| drop(panicking.run())));
    assert!(run.is_err() && stops(&seen) == 0);
    assert!(panicking.after_panic().1.is_some() && stops(&seen) == 1);
    drop(panicking);

    let (unused, _handles, seen) = made();
    drop(unused);
    assert_eq!(stops(&seen), 1);
}

#[test]
fn a_fault_in_any_phase_stops_the_arm_at_once() {
    let faults =
        [Fault::Silent { waited_ms: 20 }, Fault::Reflex { code: 25 }, Fault::Refused { code: 3 }, Fault::Disconnected];
    // Reads 50: hold, 800: approach, 2600: excitation, 5000: rest after a stop, 4105: braking.
    for (k, read) in [50, 800, 2_600, 4_105, 5_000].into_iter().enumerate() {
        for writing in [false, true] {
            let fault = faults[k % faults.len()];
            let disturbance = if writing { Disturbance::WriteFault(fault) } else { Disturbance::ReadFault(fault) };
            let run = Job::new(9_000)
                .order(dwell(1, 100))
                .order(move_to(2, AWAY))
                .order(follow(3, started_at(AWAY)))
                .order(move_to(4, READY))
                .outside(4_100, |h| h.controls.stop())
                .disturb(read, disturbance)
                .run();
            run.assert_sound();
            assert_eq!(run.outcome.end, End::Fault(fault));
            let (reads, writes, ..) = run.calls.get();
            assert_eq!((reads, writes), (read + 1, read + u64::from(writing)));
            assert_eq!(run.outcome.flight.last(), run.records.last());
        }
    }
}

#[test]
fn a_counter_that_does_not_go_forward_ends_the_loop() {
    let run = Job::new(500).disturb(100, Disturbance::Repeat).run();
    run.assert_sound();
    assert_eq!(run.outcome.end, End::Clock { last: 1_100, seq: 1_100 });
}

#[test]
fn records_dropped_at_a_full_sink_are_counted_and_the_motion_continues() {
    let mut job = Job::new(2_000).order(follow(1, Wave::gentle()));
    job.sink = 500;
    let run = job.run();
    run.assert_sound();
    assert_eq!(run.records.len(), 500);
    assert_eq!(run.outcome.summary.dropped_records, 2_001 - 500);
    assert!(run.events.contains(&Event::Ended { motion: 1 }));
    assert_eq!(run.outcome.flight.last().unwrap().cycle, 2_000);
}

#[test]
fn a_full_retired_ring_makes_orders_wait_and_never_blocks() {
    // The ring of retired boxes holds queue + 16; none is freed for 400 reads.
    let short = || Shape(3, |_| Setpoint { q: READY, ..Setpoint::default() });
    let mut job = Job::new(1_000).outside(400, |h| assert!(h.free_retired() >= 64));
    for motion in 1..=64 {
        job = job.order(follow(motion, short()));
    }
    job = job.outside(390, move |h| while h.orders.give(follow(99, short())).is_ok() {});
    let run = job.run();
    assert_eq!(run.outcome.summary.cycles, 1_001);
    assert_eq!(run.outcome.stops, 0);
    let ended = run.events.iter().filter(|e| matches!(e, Event::Ended { .. })).count();
    assert!((64 + 16..=128).contains(&ended), "{ended} motions ended");
    assert_eq!(run.outcome.allocations, Some(0), "a box that finds no room is kept, not freed");
}

#[test]
fn a_full_retired_ring_makes_models_wait_and_never_blocks() {
    // A model every other read; none is freed until read 600.
    let mut job = Job::new(1_000);
    for read in (0..600).step_by(2) {
        job = job.outside(read, move |h| drop(h.models.serve(Box::new(Model(read + 1, |_: &Setpoint| [1.0; 8])))));
    }
    let run = job
        .outside(600, |h| assert!(h.free_retired() >= 64))
        .outside(700, |h| assert!(h.models.serve(Box::new(Model(1_000, |_: &Setpoint| [1.0; 8]))).is_ok()))
        .run();
    run.assert_sound();
    assert_eq!(run.outcome.stops, 0);
    let serving = |record: &plumbline_core::Record| record.model;
    let [before, after] = [599, 999].map(|cycle| serving(&run.records[cycle]));
    assert!((64..300).contains(&before) && after == 1_000, "{before}, {after}");
}

#[test]
fn joints_that_the_arm_does_not_have_stay_at_zero() {
    let noisy = |tick| {
        let mut out = Wave::gentle().at(tick);
        (out.q[2], out.dq[5], out.ddq[7]) = (f64::NAN, f64::NAN, f64::INFINITY);
        out
    };
    let mut target = AWAY;
    target[4] = f64::NAN;
    let run = Job::on(FakeArm::new(2, READY), 5_000)
        .model(Model(1, |d: &Setpoint| [d.q[0], d.q[1], f64::NAN, 1.0, 1.0, 1.0, 1.0, 1.0]))
        .order(follow(1, Shape(1_501, noisy)))
        .order(move_to(2, target))
        .outside(2_000, |h| h.controls.stop())
        .run();
    run.assert_sound();
    run.assert_inside(&panda_limits(), 2);
    for record in &run.records {
        let d = &record.command.desired;
        for v in [d.q, d.dq, d.ddq, record.command.tau_ff.0] {
            assert_eq!(v[2..], [0.0; 6]);
        }
    }
    assert_eq!(run.phases(), [Phase::Excite, Phase::Approach, Phase::Stop, Phase::Stopped]);
}

#[test]
fn it_starts_at_the_arms_desired_position_unless_that_is_too_far_away() {
    let mut near = READY;
    near[1] += 0.01;
    let run = Job::on(FakeArm::new(7, READY).with_desired(near), 20).run();
    assert_eq!(run.records[0].command.desired.q, near);
    let run = Job::on(FakeArm::new(7, READY).with_desired([0.0; 8]), 20).run();
    assert_eq!(run.records[0].command.desired.q, READY);
}

/// The fake arm at the pace of the wall clock: a state is due every millisecond.
struct PacedArm {
    arm: FakeArm,
    deadline_ns: u64,
}

impl Backend for PacedArm {
    fn joints(&self) -> usize {
        self.arm.joints()
    }

    fn read(&mut self) -> Result<State, Fault> {
        self.deadline_ns += PERIOD_NS;
        sleep_until(self.deadline_ns);
        self.arm.read()
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.arm.write(command)
    }

    fn stop(&mut self) {
        self.arm.stop();
    }

    fn deadline_ns(&self) -> Option<u64> {
        Some(self.deadline_ns)
    }
}

#[test]
fn at_wall_clock_pace_every_deadline_is_met_or_counted() {
    let arm = PacedArm { arm: FakeArm::new(7, READY), deadline_ns: now_ns() };
    let (sink, mut drain) = ring(100_000);
    let (mut cycle, mut handles) = cycle::new(arm, sink, None, plumbline_testkit::fake_arm::drive::settings()).unwrap();
    assert!(handles.orders.give(dwell(1, 300)).is_ok());
    let start = now_ns();
    let outcome = std::thread::scope(|scope| {
        let looping = scope.spawn(|| cycle.run());
        while !handles.events.pop().is_ok_and(|timed| timed.event == Event::Ended { motion: 1 }) {
            std::thread::yield_now();
        }
        handles.controls.quit();
        looping.join().unwrap()
    });
    let summary = outcome.summary;
    assert_eq!((outcome.end, outcome.allocations, summary.lost), (End::Quit, Some(0), 0));
    // The arm's clock, the loop's count, the wall and the records agree.
    assert!(summary.cycles >= 301 && now_ns() - start >= (summary.cycles - 1) * PERIOD_NS);
    assert_eq!(
        (summary.wake_up.count, summary.execution.count, summary.period.count),
        (summary.cycles, summary.cycles, summary.cycles - 1)
    );
    let whole_run = now_ns() - start;
    let mut records = Vec::new();
    assert_eq!(drain.take_into(&mut records, usize::MAX) as u64, summary.cycles);
    assert!(records.iter().all(|record| record.work_ns < whole_run));
    assert_eq!(records.iter().map(|r| r.wake_ns).max(), Some(summary.wake_up.max_ns));
    assert!(records.windows(2).all(|pair| pair[1].stamp_ns > pair[0].stamp_ns && pair[1].work_ns > 0));
    assert!(drain.pop().is_none() && handles.controls.cycles() == summary.cycles);
}

#[test]
fn invalid_settings_are_refused() {
    let try_with = |change: fn(&mut CycleSettings)| {
        let mut settings = plumbline_testkit::fake_arm::drive::settings();
        change(&mut settings);
        cycle::new(FakeArm::new(7, READY), ring(8).0, None, settings).err()
    };
    assert_eq!(try_with(|_| {}), None);
    assert!(matches!(
        try_with(|s| s.guard.limits.jerk[3] = f64::NAN),
        Some(SetupError::Limit { name: "jerk", joint: 3, .. })
    ));
    assert!(matches!(try_with(|s| s.guard.limits.q_max[1] = -3.0), Some(SetupError::Limit { name: "q_max", .. })));
    assert!(matches!(try_with(|s| s.moves.velocity = 1.2), Some(SetupError::Factor { name: "velocity", .. })));
    let nine =
        cycle::new(FakeArm::new(9, READY), ring(8).0, None, plumbline_testkit::fake_arm::drive::settings()).err();
    assert_eq!(nine, Some(SetupError::Joints { joints: 9 }));
}
