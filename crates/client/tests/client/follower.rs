//! A served model that is followed, from a server in this process.

use crate::models::*;
use plumbline_client::{Change, Error, Expected, Fault, Follower, IpcError, Model};
use plumbline_core::Validity;
use plumbline_ipc::{ModelHeader, Server, ServerSettings};
use plumbline_testkit::memory::*;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

/// The header of a model on a wall.
fn header(model: u64, validity: Validity) -> ModelHeader {
    ModelHeader { model, validity: validity as u32, gravity: WALL, ..ModelHeader::default() }
}

/// Publishes what the test sends, until the flag is set.
fn publish(server: &mut Server, stop: &AtomicBool, models: &Receiver<(ModelHeader, String)>) {
    while !stop.load(Ordering::Relaxed) {
        server.poll(|_, _| unreachable!("nobody sends commands"));
        match models.recv_timeout(Duration::from_millis(1)) {
            Ok((header, text)) => server.model(header, &text),
            Err(_) => std::thread::sleep(Duration::from_millis(1)),
        }
    }
}

/// Polls until something has changed.
fn changes(follower: &mut Follower) -> Vec<Change> {
    wait_for("a change", || Some(follower.poll().unwrap()).filter(|changes| !changes.is_empty()))
}

/// Polls until something fails.
fn failure(follower: &mut Follower) -> Error {
    wait_for("an error", || follower.poll().err())
}

#[test]
fn a_served_model_is_followed_through_everything_that_a_daemon_does() {
    let robot = robot("follow");
    let start = |first: Option<(ModelHeader, String)>| {
        let (give, models) = channel();
        let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
            first.iter().for_each(|(header, text)| server.model(*header, text));
            publish(server, stop, &models);
            server.epoch()
        });
        (give, daemon)
    };
    let absent = Follower::connect(robot.as_str(), Expected::default(), Duration::ZERO).err();
    assert!(matches!(absent, Some(Error::Ipc(IpcError::NoDaemon { .. }))), "{absent:?}");
    assert!(matches!(Model::follow("No Robot", Expected::default(), TIMEOUT), Err(Error::Input(_))));

    let (give, daemon) = start(None);
    let expected = Expected { robot: Some("panda".into()), gravity: Some(WALL) };
    let (mut follower, mut model) = Follower::connect(robot.as_str(), expected, TIMEOUT).unwrap();
    let (zero, mut tau) = ([0.0; 7], [0.0; 7]);
    assert_eq!(model.torque(&zero, &zero, &zero, None, &mut tau), Err(Fault::NoModel));
    assert_eq!((model.status().model, model.status().validity), (0, Validity::None));

    let (text_1, id_1) = text("panda", 1);
    give.send((header(id_1, Validity::Valid), text_1.clone())).unwrap();
    assert_eq!(changes(&mut follower), [Change::Served { model: id_1 }]);
    let status = model.status();
    assert_eq!((status.model, status.validity), (id_1, Validity::Valid));
    assert!(status.age_ns < 60_000_000_000);
    model.torque(&zero, &zero, &zero, None, &mut tau).unwrap();

    // Doubted, withdrawn: the loop keeps it and its status tells.
    give.send((header(id_1, Validity::Doubtful), text_1.clone())).unwrap();
    assert_eq!(changes(&mut follower), [Change::Doubtful]);
    assert_eq!(model.status().validity, Validity::Doubtful);
    give.send((header(0, Validity::Withdrawn), String::new())).unwrap();
    assert_eq!(changes(&mut follower), [Change::Withdrawn]);
    assert_eq!((model.status().model, model.status().validity), (id_1, Validity::Withdrawn));

    // Refused by name; the loop keeps its model.
    let (other, other_id) = text("ur10", 2);
    let mut refused = |header: ModelHeader, text: &str| {
        give.send((header, text.into())).unwrap();
        let error = failure(&mut follower);
        assert_eq!(model.status().model, id_1, "{error}");
        error
    };
    let error = refused(header(other_id, Validity::Valid), &other);
    assert_eq!(error, Error::OtherRobot { expected: "panda".into(), found: "ur10".into() });
    let (text_2, id_2) = text("panda", 2);
    for gravity in [[0.0, 0.0, -9.81], [f64::NAN, 0.0, 0.0]] {
        let error = refused(ModelHeader { gravity, ..header(id_2, Validity::Valid) }, &text_2);
        assert!(matches!(&error, Error::OtherMounting(why) if why.contains("one degree")), "{error}");
    }
    let error = refused(header(id_2 ^ 1, Validity::Valid), &text_2);
    assert_eq!(error, Error::Damaged { model: id_2 ^ 1, found: id_2 });
    let nonsense = "x = [";
    let error = refused(header(plumbline_model_file::model_identity(nonsense), Validity::Valid), nonsense);
    assert!(matches!(error, Error::Input(_)), "{error}");

    // Gone, and back with another model.
    daemon.stop();
    assert_eq!(failure(&mut follower), Error::DaemonGone { robot: robot.to_string() });
    assert_eq!(model.torque(&zero, &zero, &zero, None, &mut tau), Ok(()));
    let (_give, daemon) = start(Some((header(id_2, Validity::Valid), text_2)));
    let mut seen = Vec::new();
    wait_for("the next daemon's model", || {
        seen.extend(follower.poll().unwrap_or_default());
        seen.contains(&Change::Served { model: id_2 })
    });
    assert_eq!(model.status().model, id_2);
    let epoch = daemon.stop();
    assert!(seen.contains(&Change::Restarted { epoch }), "{seen:?}");
}

#[test]
fn a_controller_that_starts_later_gets_the_model_that_is_served() {
    let robot = robot("late");
    let (text, id) = text("panda", 1);
    let (published, known) = channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        server.model(header(id, Validity::Valid), &text);
        published.send(()).unwrap();
        poll_until(server, stop);
    });
    known.recv().unwrap();
    // The first one that connects, one beside it, and one after it has gone.
    let (mut first, _model) = Follower::connect(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    assert_eq!(changes(&mut first), [Change::Served { model: id }]);
    let (mut second, _model) = Follower::connect(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    assert_eq!(changes(&mut second), [Change::Served { model: id }]);
    drop(first);
    let mut model = Model::follow(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    assert_eq!(model.joints(), Ok(7));
    daemon.stop();
}

#[test]
fn every_answer_beside_a_thousand_new_models_is_of_one_of_them() {
    const SWAPS: usize = 1000;
    // Made ready faster than a larger one.
    const ROBOT: &str = "paper-2dof";
    let robot = robot("swap");
    let both = [1, 2].map(|seed| text(ROBOT, seed));
    let (give, models) = channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| publish(server, stop, &models));
    let expected = Expected::default();
    let (mut follower, mut model) = Follower::connect(robot.as_str(), expected, TIMEOUT).unwrap();
    let [q, dq, ddq] = points(2, 1).remove(0);
    // The two answers, from models that nobody replaces.
    let answers = [1, 2].map(|seed| {
        let sample = plumbline_model::term::Sample {
            q: std::array::from_fn(|j| q.get(j).copied().unwrap_or_default()),
            dq: std::array::from_fn(|j| dq.get(j).copied().unwrap_or_default()),
            ddq: std::array::from_fn(|j| ddq.get(j).copied().unwrap_or_default()),
        };
        let mut tau = [0.0; 2];
        tau.copy_from_slice(&crate::models::model(ROBOT, seed, &[]).evaluator(&WALL.into()).torque(&sample).0[..2]);
        tau
    });
    assert_ne!(answers[0], answers[1]);
    give.send((header(both[0].1, Validity::Valid), both[0].0.clone())).unwrap();
    assert_eq!(changes(&mut follower), [Change::Served { model: both[0].1 }]);

    let ended = AtomicBool::new(false);
    let (calls, seen) = std::thread::scope(|scope| {
        let caller = scope.spawn(|| {
            let (mut calls, mut seen, mut last) = (0_u64, 0_usize, None);
            let mut tau = [0.0; 2];
            while !ended.load(Ordering::Relaxed) {
                let mut outcome = Ok(());
                assert_no_allocation(|| {
                    for _ in 0..100 {
                        outcome = outcome.and(model.torque(&q, &dq, &ddq, None, &mut tau));
                        let which = answers.iter().position(|answer| *answer == tau);
                        seen += usize::from(which != last);
                        (last, calls) = (which, calls + 1);
                        if which.is_none() {
                            outcome = Err(Fault::NoModel);
                        }
                    }
                });
                assert_eq!(outcome, Ok(()), "an answer of neither model: {tau:?}");
            }
            (calls, seen)
        });
        for swap in 1..=SWAPS {
            let (text, id) = &both[swap % 2];
            give.send((header(*id, Validity::Valid), text.clone())).unwrap();
            assert_eq!(changes(&mut follower), [Change::Served { model: *id }]);
        }
        ended.store(true, Ordering::Relaxed);
        caller.join().unwrap()
    });
    daemon.stop();
    println!("{calls} calls, {seen} changes of the answer seen by the caller");
    assert!(seen > SWAPS / 10, "{seen} changes in {calls} calls");
}

#[test]
fn a_model_with_a_thread_of_its_own_follows_until_it_is_dropped() {
    let robot = robot("thread");
    let (text_1, id_1) = text("panda", 1);
    let (text_2, id_2) = text("panda", 2);
    let (give, models) = channel();
    give.send((header(id_1, Validity::Valid), text_1)).unwrap();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| publish(server, stop, &models));
    let mut model = Model::follow(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    assert_eq!((model.status().model, model.joints(), model.trouble()), (id_1, Ok(7), None));
    give.send((header(id_2, Validity::Valid), text_2)).unwrap();
    wait_for("the next model", || model.status().model == id_2);
    daemon.stop();
    wait_for("the daemon's end", || matches!(model.trouble(), Some(Error::DaemonGone { .. })));
    assert!(model.status().age_ns > 0);
}
