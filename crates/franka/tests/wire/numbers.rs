//! Numbers of commands, statuses and modes, and whole messages, against bytes written out by hand.

use std::collections::HashSet;

use plumbline_franka::wire::*;

fn request(request: Request, protocol: Protocol, id: u32) -> Vec<u8> {
    let mut out = [0; MAX_REQUEST];
    let length = request.encode(protocol, id, &mut out).unwrap();
    out[..length].to_vec()
}

fn response(response: Response, protocol: Protocol, id: u32) -> Vec<u8> {
    let mut out = [0; MAX_FIXED_RESPONSE];
    let length = response.encode(protocol, id, &mut out).unwrap();
    assert_eq!(length, response.bytes());
    out[..length].to_vec()
}

#[test]
fn commands_have_the_numbers_of_their_version() {
    let numbers = |protocol| CommandKind::ALL.map(|kind| kind.number(protocol).map_or(-1, i64::from));
    assert_eq!(numbers(Protocol::V5), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, -1]);
    assert_eq!(numbers(Protocol::V9), [0, 1, 2, -1, 3, 4, 5, 6, 7, 8, 9, -1, 10, 11, 12]);
    assert_eq!(numbers(Protocol::V10), [0, 1, 2, -1, 3, 4, 5, 6, 7, 8, 9, -1, 10, -1, 11]);
    for (protocol, first_unknown) in [(Protocol::V5, 14), (Protocol::V9, 13), (Protocol::V10, 12)] {
        let unknown = WireError::Command { found: first_unknown, version: protocol.number() };
        assert_eq!(CommandKind::from_number(protocol, first_unknown), Err(unknown));
    }
}

#[test]
fn requests_have_the_sizes_of_their_version() {
    let sizes = |protocol| CommandKind::ALL.map(|kind| kind.request_bytes(protocol));
    assert_eq!(sizes(Protocol::V5), [4, 56, 0, 4, 416, 56, 48, 7, 128, 128, 104, 40, 0, 2, 0]);
    assert_eq!(sizes(Protocol::V9), sizes(Protocol::V5));
    assert_eq!(sizes(Protocol::V10), [4, 113, 0, 4, 416, 56, 48, 7, 128, 128, 104, 40, 0, 2, 0]);
    assert_eq!(Protocol::ALL.map(Protocol::move_bytes), [68, 68, 125]);
}

#[test]
fn statuses_have_the_numbers_of_their_version() {
    macro_rules! codes {
        ($status:ident, $old:expr, $new:expr) => {
            let codes =
                |protocol| $status::ALL.iter().map(|s| s.code(protocol).map_or(-1, i32::from)).collect::<Vec<_>>();
            assert_eq!(codes(Protocol::V5), $old, stringify!($status));
            assert_eq!(codes(Protocol::V9), $new, stringify!($status));
            assert_eq!(codes(Protocol::V10), $new, stringify!($status));
            for protocol in Protocol::ALL {
                for status in $status::ALL {
                    if let Some(code) = status.code(protocol) {
                        assert_eq!($status::from_code(protocol, code), Some(*status));
                    }
                }
                let end = codes(protocol).into_iter().max().unwrap() + 1;
                assert_eq!($status::from_code(protocol, u8::try_from(end).unwrap()), None);
            }
            let words: HashSet<String> = $status::ALL.iter().map(ToString::to_string).collect();
            assert_eq!(words.len(), $status::ALL.len());
        };
    }
    codes!(ConnectStatus, [0, 1], [0, 1]);
    codes!(MoveStatus, [0, 1, 2, -1, -1, 3, 4, 5, 6, 7, 8, 9], [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]);
    codes!(StopStatus, [0, 1, -1, 2, 3, 4], [0, 1, 2, 3, 4, 5]);
    codes!(RecoveryStatus, [0, 1, -1, 2, 3, 4, 5], [0, 1, 2, 3, 4, 5, 6]);
    codes!(SetterStatus, [0, 1, 2, -1], [0, 1, 2, 3]);
    codes!(LoadModelStatus, [0, 1], [0, 1]);
    codes!(RobotModelStatus, [-1, -1, -1], [0, 1, 2]);
}

#[test]
fn modes_of_a_state_and_of_a_request_differ_in_their_numbers() {
    use MotionGeneratorMode as Shown;
    assert_eq!(Shown::ALL.iter().map(|mode| mode.code()).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    let asked = MoveGenerator::ALL.iter().map(|mode| (mode.code(), mode.shown().code()));
    assert_eq!(asked.collect::<Vec<_>>(), [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)]);
    let asked = MoveController::ALL.iter().map(|mode| (mode.code(), mode.shown().code()));
    assert_eq!(asked.collect::<Vec<_>>(), [(0, 0), (1, 1), (2, 2)]);
    assert_eq!(ControllerMode::from_code(3), Some(ControllerMode::Other));
    assert_eq!(RobotMode::ALL.iter().map(|mode| mode.code()).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5, 6]);
    assert_eq!(RobotMode::from_code(4), Some(RobotMode::Reflex));
    assert_eq!(MoveGenerator::torque_only(Protocol::V5), MoveGenerator::JointVelocity);
    assert_eq!(MoveGenerator::torque_only(Protocol::V9), MoveGenerator::None);
    assert_eq!(Shown::None.shown_at(Protocol::V5), Shown::JointVelocity);
    assert_eq!(Shown::None.shown_at(Protocol::V10), Shown::None);
}

#[test]
fn connect_is_what_libfranka_sends() {
    let connect = Request::Connect(Connect { version: 10, udp_port: 0x1234 });
    for protocol in Protocol::ALL {
        assert_eq!(request(connect, protocol, 3), [0, 0, 0, 0, 3, 0, 0, 0, 16, 0, 0, 0, 10, 0, 0x34, 0x12]);
        let answer = Response::Connect(Connected { status: ConnectStatus::IncompatibleVersion, version: 5 });
        assert_eq!(response(answer, protocol, 3), [0, 0, 0, 0, 3, 0, 0, 0, 15, 0, 0, 0, 1, 5, 0]);
    }
    assert_eq!(Connect::decode(&[10, 0, 0x34, 0x12]), Ok(Connect { version: 10, udp_port: 0x1234 }));
    let connected = Connected { status: ConnectStatus::Success, version: 9 };
    assert_eq!(Connected::decode(&[0, 9, 0, 0xee]), Ok(connected));
}

#[test]
fn a_torque_motion_is_what_libfranka_sends() {
    let deviations: Vec<u8> =
        [10.0, 3.12, std::f64::consts::TAU].repeat(2).into_iter().flat_map(f64::to_le_bytes).collect();
    for (protocol, generator, tail) in [(Protocol::V5, 1, 0), (Protocol::V9, 4, 0), (Protocol::V10, 4, 57)] {
        let torque = MoveGenerator::torque_only(protocol);
        let bytes = request(Request::Move(Move::new(MoveController::External, torque)), protocol, 258);
        let size = 68 + tail;
        let head = [1, 0, 0, 0, 2, 1, 0, 0, size as u8, 0, 0, 0, 2, 0, 0, 0, generator, 0, 0, 0];
        assert_eq!(bytes, [&head[..], &deviations, &vec![0; tail]].concat(), "{protocol}");
    }
}

#[test]
fn an_answer_is_a_header_and_a_status() {
    let reflex = Response::Move(MoveStatus::ReflexAborted);
    assert_eq!(response(reflex, Protocol::V5, 9), [1, 0, 0, 0, 9, 0, 0, 0, 13, 0, 0, 0, 6]);
    assert_eq!(response(reflex, Protocol::V10, 9), [1, 0, 0, 0, 9, 0, 0, 0, 13, 0, 0, 0, 8]);
    let load = Response::Setter(CommandKind::SetLoad, SetterStatus::InvalidArgument);
    assert_eq!(response(load, Protocol::V5, 0), [10, 0, 0, 0, 0, 0, 0, 0, 13, 0, 0, 0, 2]);
    assert_eq!(response(load, Protocol::V9, 0), [9, 0, 0, 0, 0, 0, 0, 0, 13, 0, 0, 0, 2]);
    let model = Response::GetRobotModel { status: RobotModelStatus::Success, urdf: "<robot/>" };
    let mut out = [0; 64];
    let length = model.encode(Protocol::V10, 1, &mut out).unwrap();
    assert_eq!(&out[..length], b"\x0b\0\0\0\x01\0\0\0\x15\0\0\0\0<robot/>");
    let wall = CartesianLimit { status: SetterStatus::Success, size: [1.0; 3], frame: [0.0; 16], active: true };
    assert_eq!(response(Response::GetCartesianLimit(wall), Protocol::V5, 0).len(), 166);
}

#[test]
fn errors_have_the_names_and_numbers_of_libfranka() {
    for (number, name) in [
        (0, "joint_position_limits_violation"),
        (6, "joint_reflex"),
        (11, "joint_position_motion_generator_start_pose_invalid"),
        (14, "joint_motion_generator_velocity_discontinuity"),
        (24, "start_elbow_sign_inconsistent"),
        (25, "communication_constraints_violation"),
        (32, "controller_torque_discontinuity"),
        (34, "tau_J_range_violation"),
        (36, "joint_move_in_wrong_direction"),
        (40, "base_acceleration_invalid_reading"),
    ] {
        assert_eq!(ErrorBit::from_index(number).map(ErrorBit::name), Some(name));
    }
    assert_eq!(ErrorBit::from_index(41), None);
    assert_eq!(ErrorBit::ALL.map(ErrorBit::name).into_iter().collect::<HashSet<_>>().len(), ERROR_BITS);

    let mut errors = Errors::NONE;
    assert!(errors.is_empty());
    assert_eq!(errors.to_string(), "none");
    errors.set(ErrorBit::TauJRangeViolation);
    errors.set(ErrorBit::JointReflex);
    assert_eq!(errors.to_string(), "joint_reflex, tau_J_range_violation");
    assert_eq!(errors, errors.iter().collect());
    assert_eq!((errors.bits(), errors.len()), (1 << 6 | 1 << 34, 2));
    errors.clear(ErrorBit::JointReflex);
    assert!(!errors.contains(ErrorBit::JointReflex));
    assert_eq!(errors, Errors::NONE.with(ErrorBit::TauJRangeViolation));
    assert_eq!(Errors::from_bits(1 << 41), None);
}

#[test]
fn every_version_up_to_10_has_a_robot() {
    assert_eq!(Protocol::ALL.map(Protocol::number), [5, 9, 10]);
    for version in 0..=12 {
        assert_eq!(images_of(version).is_some(), (3..=10).contains(&version));
        let spoken = Protocol::from_number(version);
        assert_eq!(spoken.is_some(), [5, 9, 10].contains(&version));
        assert!(spoken.is_none_or(|protocol| Some(protocol.images()) == images_of(version)));
    }
    assert!(images_of(10).unwrap().starts_with("FR3 with system image 5.9.0"));
}
