//! Replays of whole jobs, stops, faults and altered recordings.

use super::*;
use plumbline::postmortem::facts::Facts;

#[test]
fn a_whole_job_with_models_and_lost_states() {
    let arm = FakeArm::new(JOINTS, READY)
        .at(500, Disturbance::Lose(3))
        .at(4_000, Disturbance::Lose(9))
        .at(4_003, Disturbance::Lose(1));
    let swap: Action = |handles| assert!(handles.models.serve(model(2)).is_ok());
    let of = run_loop(arm, 12_000, whole_job(), vec![1], (Vec::new(), vec![2]), vec![(3_900, swap)]);
    assert_eq!((of.run.outcome.end, of.run.outcome.stops), (End::Quit, 0));
    assert!(of.run.records.iter().any(|r| r.phase == Phase::Excite && r.model == 2));
    assert_replays_identically(&of);
}

#[test]
fn guard_stop_resume_and_another_motion() {
    // A push on joint 2 makes a guard stop; after a resume there is another motion.
    let arm = FakeArm::new(JOINTS, READY).at(4_500, Disturbance::Push(1, -0.11));
    let resume: Action = |handles| assert!(handles.controls.resume());
    let give: Action = |handles| {
        assert!(handles.orders.give(order(&move_to(9, READY))).is_ok());
    };
    let later = (vec![move_to(9, READY)], Vec::new());
    let of = run_loop(arm, 9_000, whole_job(), vec![3], later, vec![(5_500, resume), (5_600, give)]);
    let stops = of.run.events.iter().filter(|e| matches!(e, Event::Stopping { reason: StopReason::Guard(_), .. }));
    assert_eq!((stops.count(), of.run.outcome.end), (1, End::Quit));
    assert!(of.run.events.contains(&Event::Started { motion: 9 }) && of.run.events.contains(&Event::Resumed));
    assert_replays_identically(&of);
}

#[test]
fn first_limit_is_that_of_the_last_stop() {
    // A push on joint 2, a resume, and a push on joint 5.
    let arm = FakeArm::new(JOINTS, READY).at(4_500, Disturbance::Push(1, -0.11)).at(6_200, Disturbance::Push(4, 0.12));
    let resume: Action = |handles| assert!(handles.controls.resume());
    let give: Action = |handles| assert!(handles.orders.give(order(&move_to(9, READY))).is_ok());
    let later = (vec![move_to(9, READY)], Vec::new());
    let of = run_loop(arm, 9_000, whole_job(), vec![3], later, vec![(5_500, resume), (5_600, give)]);
    let stops: Vec<u64> =
        of.run.timed.iter().filter(|t| matches!(t.event, Event::Stopping { .. })).map(|t| t.cycle).collect();
    assert_eq!(stops.len(), 2, "{:?}", of.run.timed);
    let facts = |last: u64| {
        let mut recording = recording(&of, 4_000, None);
        recording.records.retain(|record| record.cycle <= last);
        recording.events.retain(|timed| timed.cycle <= last);
        Facts::of("two", &recording, None)
    };
    let (first, second) = (facts(stops[0] + 300).first_limit, facts(u64::MAX).first_limit);
    assert_eq!((first.map(|limit| limit.joint), second.map(|limit| limit.joint)), (Some(2), Some(5)));
    // No limit between the resume and the second stop.
    assert_eq!(facts(stops[1] - 1).first_limit, None);
}

#[test]
fn states_lost_in_every_motion() {
    for read in [300, 3_000, 4_200] {
        let arm = FakeArm::new(JOINTS, READY).at(read, Disturbance::Lose(14));
        let of = run_loop(arm, 7_000, whole_job(), vec![4], no_inputs(), Vec::new());
        let lost = StopReason::LostStates { lost: 14 };
        assert_eq!((of.run.outcome.last_stop, of.run.outcome.end), (Some(lost), End::Quit));
        assert_replays_identically(&of);
    }
}

#[test]
fn requested_stop_and_quit_during_a_motion() {
    let stop: Action = |handles| handles.controls.stop();
    for (read, quit) in [(200, 2_000), (3_950, 5_000), (9_000, 4_400)] {
        let of = run_loop(FakeArm::new(JOINTS, READY), quit, whole_job(), Vec::new(), no_inputs(), vec![(read, stop)]);
        assert_eq!((of.run.outcome.stops, of.run.outcome.end), (1, End::Quit));
        assert_replays_identically(&of);
    }
}

#[test]
fn model_withdrawn_and_replaced_by_a_new_one() {
    let good: Action = |handles| assert!(handles.models.serve(model(5)).is_ok());
    let of =
        run_loop(FakeArm::new(JOINTS, READY), 4_000, whole_job(), vec![66], (Vec::new(), vec![5]), vec![(2_500, good)]);
    assert!(of.run.events.contains(&Event::Distrusted { model: 66, instead: 0 }), "{:?}", of.run.events);
    assert!(of.run.events.contains(&Event::Serving { model: 5 }));
    assert_replays_identically(&of);
}

#[test]
fn model_withdrawn_and_replaced_by_the_previous_one() {
    let of = run_loop(FakeArm::new(JOINTS, READY), 4_000, whole_job(), vec![4, 66], no_inputs(), Vec::new());
    assert!(of.run.events.contains(&Event::Distrusted { model: 66, instead: 4 }), "{:?}", of.run.events);
    assert_eq!(of.run.records.last().map(|record| record.model), Some(4));
    assert_replays_identically(&of);
}

#[test]
fn orders_that_can_not_start() {
    let mut far = AWAY;
    far[3] = 0.5;
    let cases =
        [vec![move_to(1, far)], vec![move_to(1, AWAY), follow(1, READY, 1)], vec![move_to(1, AWAY), move_to(1, far)]];
    for orders in cases {
        let of = run_loop(FakeArm::new(JOINTS, READY), 8_000, orders, Vec::new(), no_inputs(), Vec::new());
        assert_eq!((of.run.outcome.stops, of.run.outcome.end), (1, End::Quit), "{:?}", of.run.events);
        assert_replays_identically(&of);
    }
}

#[test]
fn faults_of_the_arm_and_states_that_end_the_loop() {
    let ends: [fn() -> Disturbance; 6] = [
        || Disturbance::ReadFault(Fault::Reflex { code: 25 }),
        || Disturbance::ReadFault(Fault::Disconnected),
        || Disturbance::ReadFault(Fault::Silent { waited_ms: 20 }),
        || Disturbance::WriteFault(Fault::Refused { code: 2 }),
        || Disturbance::Repeat,
        || Disturbance::NanPosition(2),
    ];
    for (case, disturbance) in ends.iter().enumerate() {
        // The last fault occurs during a stop, so no controlled stop is possible.
        let arm = FakeArm::new(JOINTS, READY).at(4_520, disturbance());
        let arm = if case == 5 { arm.at(4_500, Disturbance::Push(1, 0.12)) } else { arm };
        let of = run_loop(arm, 9_000, whole_job(), vec![6], no_inputs(), Vec::new());
        assert_ne!(of.run.outcome.end, End::Quit);
        assert_eq!(of.run.outcome.unanswered.is_some(), case >= 4, "{:?}", of.run.outcome.end);
        assert_replays_identically(&of);
        if case == 5 {
            let replayed = replay_of(&recording(&of, 2_000, None)).unwrap();
            assert_eq!(replayed.end, Some(of.run.outcome.end.to_string()));
            assert!(replayed.end.unwrap().contains("not a finite number"));
        }
    }
}

#[test]
fn replay_starts_after_a_gap_and_detects_altered_data() {
    let of = run_loop(FakeArm::new(JOINTS, READY), 5_000, whole_job(), vec![1], no_inputs(), Vec::new());
    let with_gap = recording(&of, 1_000, Some(4_100));
    let replayed = replay_of(&with_gap).unwrap();
    assert!(replayed.is_identical() && replayed.first == 4_104, "{replayed:?}");
    assert!(Facts::of("f", &with_gap, None).gaps[0].contains("4100"));

    // One bit of one command.
    let mut altered = recording(&of, 1_000, None);
    let q = &mut altered.records[2_000].command.desired.q[4];
    *q = f64::from_bits(q.to_bits() ^ 1);
    let replayed = replay_of(&altered).unwrap();
    assert_eq!((replayed.different, replayed.is_identical()), (1, false));
    assert!(replayed.first_difference.unwrap().contains("joint 5: desired position"));
    let mut altered = recording(&of, 1_000, None);
    altered.records[2_000].command.tau_ff.0[1] += 1e-12;
    assert_eq!(replay_of(&altered).unwrap().torque_different, 1);
    // Another order, a missing order, a missing model.
    let mut altered = recording(&of, 3_000, None);
    altered.about.orders[2] = follow(3, AWAY, 2);
    assert!(replay_of(&altered).unwrap().different > 500);
    // Without the order of the motion, the stop that ended it can still be replayed.
    altered.about.orders.truncate(2);
    let replayed = replay_of(&altered).unwrap();
    assert!(replayed.is_identical() && replayed.first > 4_900, "{replayed:?}");
    altered.about.under_way = Default::default();
    altered.events.retain(|timed| !matches!(timed.event, Event::Stopping { .. }));
    assert!(!replay_of(&altered).is_ok_and(|replayed| replayed.is_identical()));
    let mut altered = recording(&of, 3_000, None);
    altered.about.models.clear();
    assert!(matches!(replay_of(&altered), Err(ReplayError::Missing { .. })));
}

struct FullSink;

impl Sink for FullSink {
    fn put(&mut self, _: &Record) -> bool {
        false
    }
}

#[test]
fn a_panic_in_the_loop_stops_the_arm_and_is_replayed() {
    let arm = FakeArm::new(JOINTS, READY);
    let seen = std::sync::Arc::clone(&arm.calls);
    let mut settings = settings();
    settings.flight = 1_000;
    let (mut cycle, mut handles) = plumbline_rt::cycle::new(arm, FullSink, None, settings).unwrap();
    let faulty = || -> Box<dyn FeedForward> {
        let mut calls = 0;
        Box::new(Model(7, move |d: &Setpoint| {
            calls += 1;
            assert!(calls < 900, "a defect, on purpose");
            d.q
        }))
    };
    assert!(handles.models.serve(faulty()).is_ok());
    assert!(handles.orders.give(order(&move_to(1, AWAY))).is_ok());
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| cycle.run())).unwrap_err();
    let (flight, unanswered) = cycle.after_panic();
    assert!(seen.get().2 > 0, "the arm was stopped");
    assert_eq!((flight.len(), flight[898].cycle, unanswered.map(|state| state.seq)), (899, 898, Some(1900)));

    // The replay panics, too, and reports the panic as its end.
    let mut history = History::new(2_000, JOINTS, [0.1; MAX_JOINTS]);
    history.push_order(move_to(1, AWAY));
    history.push_model(RecordedModel { id: 7, gravity: [0.0, 0.0, -9.81], vendor: None });
    std::iter::from_fn(|| handles.events.pop().ok()).for_each(|timed| history.push_event(timed));
    let window = history.window(0, &flight);
    let about = about(&window, panicked(&panic_message(&*panic)), 0);
    let unanswered = unanswered.map(|state| Record { cycle: 899, state, ..Record::default() });
    let recording =
        Recording { about, records: window.records, unanswered, events: window.events, texts: Vec::new(), cut: None };
    let replayed = replay(&recording, ReplayInputs { kinematics: None, model: &mut |_| Ok(faulty()) }).unwrap();
    assert!(replayed.is_identical() && replayed.same_end == Some(true), "{replayed:?}");
    assert!(replayed.end.unwrap().ends_with("panicked: a defect, on purpose"));
}
