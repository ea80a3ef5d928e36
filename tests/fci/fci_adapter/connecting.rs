//! Connections that can't be made, each refused with its cause and the next step.

use super::*;

fn refusal(fake: &Fake, protocol: Protocol) -> (ConnectError, String) {
    let error = connect(&settings(fake, protocol)).expect_err("it must not connect");
    let text = error.to_string();
    (error, text)
}

#[test]
fn another_version_is_taken_up_or_named_with_its_image() {
    // An FR3 of version 9 where 10 was guessed.
    let fake = Fake::start(Protocol::V9, healthy);
    assert_eq!(open(&fake, Protocol::V9).1.info.protocol, Protocol::V9);
    for (speaks, says) in [
        (7, "5.5.0"),
        (3, "Panda with system image 1.3"),
        (11, "newer than any"),
        (6, "Update the robot's system image to 5.9.0"),
    ] {
        let fake = Fake::start(Protocol::V10, move |world| world.speaks = speaks);
        let (error, text) = refusal(&fake, Protocol::V10);
        assert!(matches!(error, ConnectError::Version { robot, .. } if robot == speaks), "{text}");
        assert!(text.contains(says) && text.contains("libfranka"), "{text}");
    }
    // A Panda where an FR3 is expected.
    let fake = Fake::start(Protocol::V5, healthy);
    let (error, text) = refusal(&fake, Protocol::V10);
    assert!(matches!(error, ConnectError::Robot { .. }) && text.contains("expect a FR3"), "{text}");
}

#[test]
fn states_that_never_arrive_point_to_the_firewall() {
    for (protocol, says) in [(Protocol::V5, "fragments"), (Protocol::V10, "firewall")] {
        let fake = Fake::start(protocol, |world| world.sends = false);
        let (error, text) = refusal(&fake, protocol);
        assert!(matches!(error, ConnectError::NoStates { .. }) && text.contains(says), "{text}");
    }
}

#[test]
fn nobody_at_the_address_is_said_with_a_hint() {
    let nobody = Settings::new("127.3.9.200".parse().unwrap(), RobotKind::Panda);
    let text = connect(&nobody).err().unwrap().to_string();
    assert!(text.contains("127.3.9.200") && text.contains("activate FCI"), "{text}");
    // Reserved for documentation: in no subnet of any machine.
    let elsewhere = Settings {
        connect_timeout: Duration::from_millis(300),
        ..Settings::new("192.0.2.17".parse().unwrap(), RobotKind::Panda)
    };
    match connect(&elsewhere) {
        Err(ConnectError::Unreachable { hint, .. }) => assert!(hint.contains("subnet"), "{hint}"),
        // A machine whose network answers for every address gets as far as the protocol.
        Err(other) => assert!(matches!(other, ConnectError::NoAnswer { .. } | ConnectError::Closed { .. }), "{other}"),
        Ok(_) => panic!("there is no arm at 192.0.2.17"),
    }
}

#[test]
fn modes_are_answered_with_the_operators_next_step() {
    let modes = [
        (RobotMode::UserStopped, "user stop"),
        (RobotMode::Guiding, "guided by hand"),
        (RobotMode::Other, "unlock the joints"),
        (RobotMode::Reflex, "allow the recovery"),
        (RobotMode::Move, "Another motion"),
    ];
    for (mode, says) in modes {
        let fake = Fake::start(Protocol::V10, move |world| world.state.robot_mode = mode);
        let (error, text) = refusal(&fake, Protocol::V10);
        assert!(
            matches!(error, ConnectError::Mode { mode: found, .. } if found == mode) && text.contains(says),
            "{text}"
        );
        assert!(fake.with(|world| world.requests.is_empty()), "nothing was set");
    }
}

#[test]
fn a_reflex_whose_errors_have_cleared_is_named_and_recovered_by_its_mode() {
    let reasons = Errors::NONE.with(ErrorBit::JointReflex);
    let mut done = false;
    let fake = Fake::start(Protocol::V5, move |world| {
        if !done {
            world.end(RobotMode::Reflex, reasons, None);
            // The arm stands: errors are gone, the mode stays.
            world.state.errors = Errors::NONE;
            done = true;
        }
    });
    let (_, text) = refusal(&fake, Protocol::V5);
    assert!(text.contains("joint_reflex") && text.contains("recovery"), "{text}");
    assert!(fake.with(|world| !world.requests.contains(&Request::AutomaticErrorRecovery)), "not by itself");
    recover(&settings(&fake, Protocol::V5)).unwrap();
    assert!(fake.with(|world| world.requests.contains(&Request::AutomaticErrorRecovery)));
    let (mut arm, _) = open(&fake, Protocol::V5);
    drive(&mut arm, 50).unwrap();
    // There is nothing to recover from now, and a user stop is not for a program to recover from.
    arm.stop();
    drop(arm);
    recover(&settings(&fake, Protocol::V5)).unwrap();
    fake.with(|world| world.state.robot_mode = RobotMode::UserStopped);
    assert!(matches!(recover(&settings(&fake, Protocol::V5)), Err(ConnectError::Mode { .. })));
    assert_eq!(
        fake.with(|world| world.requests.iter().filter(|request| **request == Request::AutomaticErrorRecovery).count()),
        1
    );
}

#[test]
fn another_program_at_the_address_is_told_by_what_it_says() {
    let [.., high, low] = std::process::id().to_be_bytes();
    let address = std::net::IpAddr::from([127, 5, high, low.max(1)]);
    let listener = std::net::TcpListener::bind((address, 1337)).unwrap();
    let server = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        std::io::Write::write_all(&mut stream, b"SSH-2.0-OpenSSH_9.2p1\r\n").unwrap();
        // Until the other end goes.
        let _ = std::io::Read::read_to_end(&mut stream, &mut Vec::new());
    });
    let error = connect(&Settings::new(address, RobotKind::Fr3)).expect_err("no control unit");
    assert!(matches!(error, ConnectError::NoMessage { .. }), "{error:?}");
    let words = error.to_string();
    assert!(words.contains("53 53 48") && words.contains("`SSH-2.0-Open`") && words.contains("1337"), "{words}");
    server.join().unwrap();
}

#[test]
fn settings_that_make_no_sense_never_reach_the_arm() {
    let fake = Fake::start(Protocol::V10, healthy);
    let bad = Settings { limits_share: 1.5, ..settings(&fake, Protocol::V10) };
    assert!(connect(&bad).err().unwrap().to_string().contains("limits-share is 1.5"));
    let mut bad = settings(&fake, Protocol::V10);
    bad.collision.upper_force_nominal[2] = f64::NAN;
    assert!(connect(&bad).err().unwrap().to_string().contains("upper-force-nominal is NaN"));
    assert!(fake.with(|world| world.requests.is_empty()));
}
