use super::super::check::Checked;
use super::super::fixture::*;
use super::super::models::Models;
use super::*;
use plumbline_core::Record;
use plumbline_model::Mounting;
use plumbline_model::term::Sample;
use plumbline_rt::{Event, StopReason};

#[test]
fn a_programme_is_started_once_and_a_request_to_quit_ends_the_daemon() {
    let (mut state, _place) = new_state();
    assert!(!state.must_quit() && !state.is_over() && !state.must_leave());
    assert_eq!(ask(&mut state, Request::Start {}), Response::Accepted {});
    assert!(state.programme.start && state.must_leave() && !state.must_quit() && !state.is_over());
    for progress in [Progress::Driving, Progress::AwaitingModel, Progress::Done, Progress::Stopped] {
        state.programme.progress = progress;
        let reason = refusal(ask(&mut state, Request::Start {}));
        assert!(reason.contains("started before"), "{reason}");
        assert!(!state.must_leave(), "the connection of the programme goes on");
        assert_eq!(state.is_over(), progress == Progress::Stopped);
    }
    state.programme.progress = Progress::Driving;
    assert_eq!(ask(&mut state, Request::Quit {}), Response::Accepted {});
    assert!(state.must_quit() && state.is_over() && state.must_leave());
    assert_eq!(state.stops.cause, None);
}

#[test]
fn a_permission_lifts_a_stop_where_the_arm_rests_and_not_while_it_brakes() {
    let (mut state, _place) = new_state();
    let controls = waiting(&state);
    let resume = |state: &mut DaemonState, controls: &Controls| {
        state.answer(Request::Resume {}, &Served::default(), Some(controls))
    };
    state.stops.barred = true;
    assert_eq!(resume(&mut state, &controls), Response::Accepted {});
    assert!(!state.stops.barred && !controls.is_waiting());
    let reason = refusal(resume(&mut state, &controls));
    assert!(reason.contains("nothing waits"), "{reason}");
    let reason = refusal(ask(&mut state, Request::Resume {}));
    assert!(reason.contains("nothing waits"), "{reason}");

    // A stop that the loop has not begun, and one that it has not ended.
    let running = Controls::default();
    state.stop(Some(&running));
    let reason = refusal(resume(&mut state, &running));
    assert!(reason.contains("being braked") && state.stops.barred, "{reason}");
    state.take_event(&Event::Stopped);
    assert!(state.stops.barred && !state.stops.braking);
    state.take_event(&Event::Stopping { motion: 1, reason: StopReason::Requested });
    assert!(state.stops.barred && state.stops.braking);
    state.take_event(&Event::Started { motion: 2 });
    assert!(state.stops.braking, "only the rest ends a stop");
    state.stops.cause = Some("asked for twice".into());
    state.take_event(&Event::Resumed);
    assert_eq!((state.stops.barred, state.stops.braking, state.stops.cause.take()), (false, false, None));
}

#[test]
fn a_pause_brakes_as_a_stop_does_and_only_a_permission_ends_it() {
    let (mut state, _place) = new_state();
    let order = |state: &mut DaemonState, request, controls: &Controls| {
        state.answer(request, &Served::default(), Some(controls))
    };
    let running = Controls::default();
    for progress in [Progress::Idle, Progress::Done, Progress::Stopped] {
        state.programme.progress = progress;
        let reason = refusal(order(&mut state, Request::Pause {}, &running));
        assert!(reason.contains("nothing is being driven") && !running.stop_requested(), "{reason}");
    }
    state.programme.progress = Progress::Driving;
    assert_eq!(order(&mut state, Request::Pause {}, &running), Response::Accepted {});
    assert!(running.stop_requested() && state.stops.barred && state.is_over() && !state.must_leave());
    state.take_event(&Event::Stopping { motion: 1, reason: StopReason::Requested });
    let reason = refusal(order(&mut state, Request::Resume {}, &running));
    assert!(reason.contains("being braked"), "{reason}");
    state.take_event(&Event::Stopped);
    assert_eq!(state.programme.progress, Progress::Paused);
    // No loop runs any more.
    assert_eq!(ask(&mut state, Request::Resume {}), Response::Accepted {});
    assert!(state.must_leave() && state.is_paused() && !state.is_over());
    assert_eq!(state.programme.progress, Progress::Driving);
}

#[test]
fn a_stop_for_another_reason_ends_a_pause() {
    let pause = || {
        let (mut state, place) = new_state();
        state.programme.progress = Progress::Driving;
        assert_eq!(
            state.answer(Request::Pause {}, &Served::default(), Some(&Controls::default())),
            Response::Accepted {}
        );
        (state, place)
    };
    let (mut state, _place) = pause();
    state.take_event(&Event::Stopping { motion: 1, reason: StopReason::LostStates { lost: 20 } });
    assert_eq!(state.programme.progress, Progress::Stopped);
    let (mut state, _place) = pause();
    state.take_stop(plumbline_ipc::StopOrder { process: 7, user: 8 }, None);
    assert_eq!(state.programme.progress, Progress::Stopped);
    // Resumed, and stopped before the rest is driven.
    let (mut state, _place) = pause();
    state.stops.braking = false;
    assert_eq!(ask(&mut state, Request::Resume {}), Response::Accepted {});
    assert_eq!(ask(&mut state, Request::Stop {}), Response::Accepted {});
    assert!(!state.is_paused() && !state.must_leave());
    assert_eq!(state.programme.progress, Progress::Stopped);
}

#[test]
fn a_recording_on_demand_needs_a_loop() {
    let (mut state, _place) = new_state();
    let reason = refusal(ask(&mut state, Request::Record {}));
    assert!(reason.contains("not connected"), "{reason}");
    let reason = refusal(state.answer(Request::Record {}, &Served::default(), Some(&Controls::default())));
    assert!(reason.contains("recorder.span"), "{reason}");
}

#[test]
fn a_model_is_held_against_the_torques_at_rest_before_it_is_served() {
    let (mut state, _place) = new_state();
    // Declared upright; the arm hangs on a wall.
    state.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    rest(&mut state, &Mounting::WALL);
    let reason = refusal(ask(&mut state, offer()));
    assert!(reason.contains("torques at rest"), "{reason}");
    assert!(state.models.served().is_none());

    state.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    rest(&mut state, &Mounting::UPRIGHT);
    assert!(matches!(ask(&mut state, offer()), Response::ModelAccepted { .. }));
}

#[test]
fn a_model_that_does_not_hold_any_more_when_its_check_is_done_is_refused() {
    let (mut state, _place) = new_state();
    let request = Request::OfferModel { toml: MODEL.replace("robot = \"panda\"", "robot = \"ur10\"") };
    let reason = refusal(ask(&mut state, request));
    assert!(reason.contains("ur10") && reason.contains("panda"), "{reason}");
    let Checked::Offered(model) = Checked::of(&state.setup.robot, &state.mounting, offer()) else { panic!() };
    assert!(state.admit("offered model", &model).is_ok());
}

#[test]
fn a_model_that_lacks_parameters_of_the_mounting_is_neither_offered_nor_handed_over() {
    let (mut state, _place) = new_state();
    let file = std::path::Path::new("vertical.toml");
    let model = state.accept_text(file, &vertical()).unwrap();
    assert_eq!(state.models.served().map(|served| served.id), Some(model));
    assert!(state.models.for_loop(&Mounting::UPRIGHT).is_some() && state.models.for_loop(&Mounting::WALL).is_none());
    // Checked upright; the arm hangs on a wall when it is to be served.
    let upright = Mounting::UPRIGHT;
    let Checked::Offered(checked) = Checked::of(&state.setup.robot, &upright, Request::OfferModel { toml: vertical() })
    else {
        panic!()
    };
    state.mounting = Mounting::WALL;
    let reason = refusal(state.conclude(Checked::Offered(checked), &Served::default(), None));
    assert!(reason.contains("holds in the present mounting"), "{reason}");
    let Checked::Refused(response) =
        Checked::of(&state.setup.robot, &state.mounting, Request::OfferModel { toml: vertical() })
    else {
        panic!()
    };
    assert!(refusal(response).contains("holds in the present mounting"));
    // One that was held while the arm stood upright, too; it stays held.
    (state.mounting, state.models) = (upright, Models::default());
    assert!(matches!(proposed(&mut state, vertical()), Response::ModelHeld { .. }));
    state.mounting = Mounting::WALL;
    for _ in 0..2 {
        let reason = refusal(ask(&mut state, Request::Adopt {}));
        assert!(reason.contains("wall"), "{reason}");
        assert!(state.models.served().is_none());
    }
    state.mounting = upright;
    assert_eq!(ask(&mut state, Request::Adopt {}), Response::ModelAccepted { model });
}

#[test]
fn a_proposed_model_is_served_when_a_person_adopts_it_or_the_job_says_so() {
    let (mut state, _place) = new_state();
    let first = offered(&mut state, another(1));
    let Response::ModelHeld { model: second } = proposed(&mut state, another(2)) else { panic!() };
    let status = state.status(&Served::default(), None);
    assert_eq!((status.model, status.offered.map(|held| held.model)), (first, Some(second)));
    assert_eq!(ask(&mut state, Request::Reject {}), Response::Accepted {});
    assert!(refusal(ask(&mut state, Request::Adopt {})).contains("no model was proposed"));
    assert!(refusal(ask(&mut state, Request::Reject {})).contains("no model was proposed"));
    proposed(&mut state, another(2));
    assert_eq!(ask(&mut state, Request::Adopt {}), Response::ModelAccepted { model: second });
    assert_eq!(state.models.served().map(|served| served.id), Some(second));
    // An offered model takes the place of the served one: what was proposed in place of that is no proposal any more.
    proposed(&mut state, another(3));
    offered(&mut state, another(4));
    assert!(state.models.offer().is_none());
    proposed(&mut state, another(3));
    state.setup.job.live.adopt = Adopt::Auto;
    let Response::ModelAccepted { model } = proposed(&mut state, another(5)) else { panic!() };
    assert_eq!(state.models.served().map(|served| served.id), Some(model));
    assert!(state.models.offer().is_none());
}

#[test]
fn the_served_model_is_doubted_until_it_holds_again_or_another_is_served() {
    let (mut state, _place) = new_state();
    let doubt = |state: &mut DaemonState, model: u64, why: Option<&str>| {
        ask(state, Request::Doubt { model, why: why.map(String::from) })
    };
    assert!(refusal(doubt(&mut state, 0, Some("joint 3"))).contains("is not served"));
    let first = offered(&mut state, another(1));
    assert!(refusal(doubt(&mut state, first + 1, Some("joint 3"))).contains("is not served"));
    assert_eq!((state.models.doubted(), state.status(&Served::default(), None).doubt), (0, None));
    assert_eq!(doubt(&mut state, first, Some("joint 3")), Response::Accepted {});
    assert_eq!((state.models.doubted(), state.status(&Served::default(), None).doubt), (first, Some("joint 3".into())));
    // What was proposed for a change that has gone again is no proposal any more.
    proposed(&mut state, another(2));
    assert!(state.models.offer().is_some());
    assert_eq!(doubt(&mut state, first, None), Response::Accepted {});
    assert_eq!((state.models.doubted(), state.models.offer().is_none()), (0, true));
    doubt(&mut state, first, Some("joint 3"));
    offered(&mut state, another(3));
    assert_eq!((state.models.doubted(), state.status(&Served::default(), None).doubt), (0, None));
}

#[test]
fn what_the_arm_measured_last_refuses_a_model_unless_the_trusted_one_is_as_wrong() {
    // 12 Nm in joint 2 that no model explains.
    let measured = |state: &mut DaemonState| {
        let model = check(&state.setup.robot, &state.mounting, "test", MODEL).unwrap().model;
        let q = [0.1, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
        let mut record = Record::default();
        record.state.q = q;
        record.state.tau = model.evaluator(&state.mounting.gravity()).torque(&Sample { q, ..Sample::default() }).0;
        record.state.tau[1] += 12.0;
        state.models.recent.take(&[record]);
    };
    let (mut state, _place) = new_state();
    measured(&mut state);
    state.programme.progress = Progress::AwaitingModel;
    assert!(refusal(proposed(&mut state, another(1))).contains("joint 2"));
    assert_eq!(state.programme.progress, Progress::AwaitingModel);
    let why = refusal(ask(&mut state, offer()));
    assert!(why.contains("joint 2"));
    // The rest of the job does not wait for another one.
    let status = state.status(&Served::default(), None);
    assert_eq!((status.without_model, status.progress), (Some(why), Progress::Driving));
    state.models.recent.clear();
    let model = offered(&mut state, MODEL.into());
    assert_eq!(state.programme.without_model, None);
    measured(&mut state);
    // Another one is no worse than the served one.
    let second = offered(&mut state, another(1));
    assert_ne!(model, second);
    state.take_event(&Event::Distrusted { model: second, instead: 0 });
    assert!(refusal(ask(&mut state, Request::OfferModel { toml: another(2) })).contains("joint 2"));
}
