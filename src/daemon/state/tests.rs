use super::super::check::check;
use super::super::fixture::*;
use super::super::logged::logged;
use super::*;
use plumbline_ipc::{Request, Response, StopOrder};
use plumbline_rt::{Limit, Violation};

#[test]
fn a_stop_bars_every_motion_until_an_operator_lifts_it() {
    for by_its_own_way in [true, false] {
        let (mut state, _place) = new_state();
        assert_eq!(ask(&mut state, Request::Start {}), Response::Accepted {});
        match by_its_own_way {
            true => state.take_stop(StopOrder { process: 7, user: 8 }, None),
            false => assert_eq!(ask(&mut state, Request::Stop {}), Response::Accepted {}),
        }
        // The start that was given before it is gone, too.
        assert!(state.stops.barred && !state.programme.start && state.is_over() && !state.must_leave());
        let reason = refusal(ask(&mut state, Request::Start {}));
        assert!(reason.contains("plumbline command resume"), "{reason}");
        assert_eq!(ask(&mut state, Request::Resume {}), Response::Accepted {});
        assert_eq!(ask(&mut state, Request::Start {}), Response::Accepted {});
    }
}

#[test]
fn a_stop_between_two_connections_ends_the_programme() {
    let (mut state, _place) = new_state();
    state.programme.progress = Progress::Driving;
    state.stop(None);
    assert_eq!((state.programme.progress, state.is_over()), (Progress::Stopped, true));
    // With a loop, the loop is told.
    let (mut state, _place) = new_state();
    state.programme.progress = Progress::Driving;
    let controls = Controls::default();
    state.stop(Some(&controls));
    assert!(controls.stop_requested() && state.stops.barred);
}

#[test]
fn the_first_reason_to_end_is_that_of_the_stop_and_each_is_logged_once() {
    let (mut state, _place) = new_state();
    assert_eq!(logged(|| state.announce_end()), "");
    state.end.ending.arrive(Cause::Signal(libc::SIGTERM));
    let first = logged(|| state.announce_end());
    assert!(first.contains("SIGTERM") && first.contains("brakes an arm that moves"), "{first}");
    assert!(state.must_quit() && state.must_leave() && state.is_over());
    assert_eq!(state.stops.cause.as_deref(), Some("signal SIGTERM arrived"));
    assert_eq!(logged(|| state.announce_end()), "");
    state.end.ending.arrive(Cause::Signal(libc::SIGINT));
    let second = logged(|| state.announce_end());
    assert!(second.contains("SIGINT") && second.contains("is ending already"), "{second}");
    assert_eq!(state.stops.cause.as_deref(), Some("signal SIGTERM arrived"), "the stop under way is that of the first");
    assert_eq!(logged(|| state.announce_end()), "");

    // `plumbline run` asks for the end first and then closes the pipe: no reason to tell.
    for asked in [true, false] {
        let (mut state, _place) = new_state();
        state.end.quit = asked;
        state.end.ending.arrive(Cause::ParentEnded);
        assert_eq!(logged(|| state.announce_end()).is_empty(), asked);
        assert_eq!(state.stops.cause.is_none(), asked);
    }
    let (mut state, _place) = new_state();
    state.end.quit = true;
    state.end.ending.arrive(Cause::Signal(libc::SIGTERM));
    assert!(logged(|| state.announce_end()).contains("SIGTERM"));
}

#[test]
fn a_stop_is_recorded_with_the_daemons_own_reason_where_it_asked_for_it() {
    let stops: [fn(&mut DaemonState, &Controls); 2] = [
        |state, controls| state.stop_because(Reason::new(ReasonKind::Mounting, "the base has turned"), Some(controls)),
        |state, controls| state.stop_because(Reason::new(ReasonKind::ModelTimeout, "no model came"), Some(controls)),
    ];
    for (stop, why) in stops.into_iter().zip(["the base has turned", "no model came"]) {
        let (mut state, _place) = new_state();
        let controls = Controls::default();
        stop(&mut state, &controls);
        assert!(controls.stop_requested() && state.stops.barred && state.stops.braking);
        state.take_event(&Event::Stopping { motion: 1, reason: StopReason::Requested });
        assert_eq!(state.stops.stopped.as_deref(), Some(why));
        // The next one has another reason.
        state.take_event(&Event::Stopping { motion: 1, reason: StopReason::Requested });
        assert_eq!(state.stops.stopped, Some(StopReason::Requested.to_string()));
        // A stop of the guard has its own, whatever the daemon was about to ask for.
        state.stops.cause = Some(why.into());
        let violation = Violation { limit: Limit::Tracking, joint: 2, value: 0.2, bound: 0.1 };
        state.take_event(&Event::Stopping { motion: 1, reason: StopReason::Guard(violation) });
        assert_eq!(state.stops.stopped, Some(StopReason::Guard(violation).to_string()));
    }
}

#[test]
fn a_stop_without_a_loop_ends_a_programme_that_was_begun_and_no_other() {
    for (progress, after) in [
        (Progress::Idle, Progress::Idle),
        (Progress::Driving, Progress::Stopped),
        (Progress::AwaitingModel, Progress::Stopped),
        (Progress::Done, Progress::Done),
    ] {
        let (mut state, _place) = new_state();
        (state.programme.progress, state.programme.start) = (progress, true);
        state.stop(None);
        assert_eq!((state.programme.progress, state.stops.barred, state.stops.braking), (after, true, false));
        assert_eq!(state.programme.start, progress != Progress::Idle);
    }
}

#[test]
fn the_log_names_motions_and_says_whether_the_programme_goes_on() {
    let (mut state, _place) = new_state();
    state.setup.names = vec![(1, "approach".into()), (2, "excitation".into())];
    let message = logged(|| state.take_event(&Event::Started { motion: 2 }));
    assert!(message.contains("excitation has started") && !message.contains("approach"), "{message}");
    let message = logged(|| state.take_event(&Event::Ended { motion: 1 }));
    assert!(message.contains("approach has ended") && !message.contains("excitation"), "{message}");
    let message = logged(|| state.take_event(&Event::Stopped));
    assert!(message.contains("plumbline command resume"), "{message}");
    state.programme.progress = Progress::Stopped;
    let message = logged(|| state.take_event(&Event::Stopped));
    assert!(message.contains("plumbline command start") && !message.contains("resume"), "{message}");
}

#[test]
fn the_programme_goes_on_when_the_model_that_it_waits_for_is_there() {
    for (progress, after) in [
        (Progress::AwaitingModel, Progress::Driving),
        (Progress::Done, Progress::Done),
        (Progress::Idle, Progress::Idle),
    ] {
        let (mut state, _place) = new_state();
        state.programme.progress = progress;
        offered(&mut state, MODEL.into());
        assert_eq!(state.programme.progress, after);
    }
}

#[test]
fn the_loss_of_the_estimator_stops_an_arm_that_moves_where_the_job_says_so() {
    let (name, pid, acknowledged) = ("estimator".to_string(), 7, 5);
    let died = FollowerEvent::Died { name: name.clone(), pid, acknowledged };
    let left = FollowerEvent::Left { name: name.clone(), pid, acknowledged };
    let silent = FollowerEvent::Silent { name: name.clone(), pid, acknowledged, silent_ms: 9 };
    let joined = FollowerEvent::Joined { name, pid, from: 0 };
    let fast = JOB.replace("wall-clock", "fast");
    for (job, watch, waited_for) in
        [(JOB, true, false), (&fast, true, true), (&fast, false, false), (JOB, false, false)]
    {
        for (news, lost) in [(&died, true), (&left, true), (&silent, !waited_for), (&joined, false)] {
            for rule in [OnEstimatorLoss::Stop, OnEstimatorLoss::Finish] {
                for progress in [Progress::Driving, Progress::AwaitingModel, Progress::Idle] {
                    let (mut state, _place) = state_of(job);
                    (state.setup.job.live.watch, state.setup.job.safety.on_estimator_loss, state.programme.progress) =
                        (watch, rule, progress);
                    let controls = Controls::default();
                    let message = logged(|| state.news(news, Some(&controls)));
                    let stops = lost && rule == OnEstimatorLoss::Stop && progress == Progress::Driving;
                    assert_eq!(
                        (controls.stop_requested(), state.stops.barred),
                        (stops, stops),
                        "{news}, {rule:?}, {progress:?}"
                    );
                    assert_eq!(message.contains("the arm stops"), stops, "{message}");
                    let goes_on =
                        progress == Progress::Driving && !stops && !matches!(news, FollowerEvent::Joined { .. });
                    assert_eq!(message.contains("the arm goes on"), goes_on, "{message}");
                    let waits = progress == Progress::AwaitingModel && matches!(news, FollowerEvent::Died { .. });
                    assert_eq!(message.contains("the arm waits for a model"), waits, "{message}");
                }
            }
        }
    }
}

#[test]
fn the_flight_recorder_is_given_the_reason_of_every_stop_that_the_daemon_asks_for() {
    let (mut state, _place) = new_state();
    let mut remarks = state.recorder.remarks();
    let controls = Controls::default();
    state.stop_because(Reason::new(ReasonKind::Mounting, "the base has turned"), Some(&controls));
    assert_eq!(remarks(), ["mounting: the base has turned"]);
    state.stop_because(Reason::new(ReasonKind::ModelTimeout, "no model came"), Some(&controls));
    assert_eq!(remarks(), ["model-timeout: no model came"]);
    state.end.ending.arrive(Cause::Signal(libc::SIGTERM));
    state.announce_end();
    state.announce_end();
    assert_eq!(remarks(), ["signal: signal SIGTERM arrived"]);
    let news = FollowerEvent::Left { name: "estimator".into(), pid: 7, acknowledged: 5 };
    for (rule, count) in [(OnEstimatorLoss::Stop, 2), (OnEstimatorLoss::Finish, 1)] {
        (state.programme.progress, state.setup.job.safety.on_estimator_loss) = (Progress::Driving, rule);
        state.news(&news, Some(&controls));
        let found = remarks();
        assert!(found.len() == count && found[0].contains("estimator (process 7) left"), "{found:?}");
        assert!(found[1..].iter().all(|reason| reason.starts_with("estimator-lost: ")), "{found:?}");
    }
    // The torques at rest contradict the declared mounting.
    state.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    let model = check(&state.setup.robot, &state.mounting, "test", MODEL).unwrap();
    rest(&mut state, &Mounting::WALL);
    state.models.serve(model);
    assert!(remarks().is_empty());
    for _ in 0..2 {
        let served = state.model_for_loop(&Mounting::UPRIGHT);
        assert!(matches!(served, Some((_, Verdict::Refuse(_)))));
        // The angles of the same refusal change with every rest.
        rest(&mut state, &Mounting::CEILING);
    }
    let found = remarks();
    assert!(found.len() == 1 && found[0].contains("is not served"), "{found:?}");
}
