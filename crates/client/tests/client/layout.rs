//! A daemon of another version.

use plumbline_client::{Error, Expected, FeedForwardClient, FeedForwardSettings, Follower, Guest, IpcError, Model};
use plumbline_testkit::memory::*;
use plumbline_testkit::other_layout::{Other, OtherDaemon};
use std::time::Duration;

const SHORT: Duration = Duration::from_millis(200);

fn is_incompatible(error: Option<Error>) -> bool {
    matches!(error, Some(Error::Ipc(IpcError::Incompatible { .. })))
}

#[test]
fn messages_of_other_types_are_refused_by_name() {
    let robot = robot("other-types");
    let _daemon = OtherDaemon::start(&robot, Other::Types);
    let name = robot.as_str();
    assert!(is_incompatible(Model::follow(name, Expected::default(), SHORT).err()));
    assert!(is_incompatible(Guest::open(name, 7).err()));
    let client = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), SHORT);
    assert!(is_incompatible(client.err().map(Error::from)));
}

#[test]
fn a_model_with_another_number_of_the_layout_is_refused_by_name() {
    let robot = robot("other-number");
    let _daemon = OtherDaemon::start(&robot, Other::Number);
    let (mut follower, mut model) = Follower::connect(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    let error = wait_for("an error", || follower.poll().err());
    assert!(error.to_string().contains("its layout is 2, this version reads 1"), "{error}");
    assert!(is_incompatible(Some(error)));
    assert_eq!(model.status().model, 0);

    // The library's own thread keeps the error.
    let model = Model::follow(robot.as_str(), Expected::default(), TIMEOUT).unwrap();
    wait_for("an error", || model.trouble());
    for _ in 0..5 {
        assert!(is_incompatible(model.trouble()), "{:?}", model.trouble());
        std::thread::sleep(Duration::from_millis(10));
    }
}
