//! Bad bytes are refused with what was expected and found, and what a version lacks can't be sent.

use plumbline_franka::wire::*;

#[test]
fn packets_of_another_length_are_refused() {
    for protocol in Protocol::ALL {
        let packet = [0; MAX_STATE + 1];
        for found in (0..=packet.len()).filter(|found| *found != protocol.state_bytes()) {
            let refused = WireError::Length { what: "a robot state", expected: protocol.state_bytes(), found };
            assert_eq!(RobotState::decode(protocol, &packet[..found]), Err(refused));
        }
        for found in (0..=packet.len()).filter(|found| *found != protocol.command_bytes()) {
            let refused = WireError::Length { what: "a robot command", expected: protocol.command_bytes(), found };
            assert_eq!(RobotCommand::decode(protocol, &packet[..found]), Err(refused));
        }
        for kind in CommandKind::ALL {
            let expected = kind.request_bytes(protocol);
            for found in (0..500).filter(|found| *found != expected) {
                let refused = match kind.number(protocol) {
                    Some(_) => WireError::Length { what: kind.name(), expected, found },
                    None => WireError::Absent { what: kind.name(), version: protocol.number() },
                };
                assert_eq!(Request::decode(protocol, kind, &packet[..found]), Err(refused));
            }
        }
    }
}

fn state_with(protocol: Protocol, offset: usize, byte: u8) -> Result<RobotState, WireError> {
    let mut out = [0; MAX_STATE];
    let length = RobotState::default().encode(protocol, &mut out);
    out[offset] = byte;
    RobotState::decode(protocol, &out[..length])
}

#[test]
fn every_mode_and_error_of_a_state_is_checked() {
    for protocol in Protocol::ALL {
        let modes = if protocol == Protocol::V10 { 1288 } else { 2280 };
        let most_generator = if protocol == Protocol::V5 { 4 } else { 5 };
        for (what, offset, most) in [
            ("motion_generator_mode", modes, most_generator),
            ("controller_mode", modes + 1, 3),
            ("robot_mode", modes + 84, 6),
        ] {
            for byte in 0..=255 {
                let decoded = state_with(protocol, offset, byte);
                let found = u32::from(byte);
                match found <= most {
                    true => assert!(decoded.is_ok(), "{what} {byte} at {protocol}"),
                    false => assert_eq!(decoded, Err(WireError::Value { what, most, found })),
                }
            }
        }
        for index in 0..ERROR_BITS {
            let bit = ErrorBit::ALL[index];
            assert!(state_with(protocol, modes + 2 + index, 1).unwrap().errors.contains(bit));
            let refused = WireError::Flag { what: "errors", index, found: 2 };
            assert_eq!(state_with(protocol, modes + 2 + index, 2), Err(refused));
            assert!(state_with(protocol, modes + 43 + index, 1).unwrap().reflex_reason.contains(bit));
            let refused = WireError::Flag { what: "reflex_reason", index, found: 255 };
            assert_eq!(state_with(protocol, modes + 43 + index, 255), Err(refused));
        }
    }
}

#[test]
fn every_flag_of_a_command_is_checked() {
    for (what, offset) in [("valid_elbow", 312), ("motion_generation_finished", 313), ("torque_command_finished", 370)]
    {
        let mut packet = [0; 371];
        packet[offset] = 2;
        let refused = WireError::Flag { what, index: 0, found: 2 };
        assert_eq!(RobotCommand::decode(Protocol::V10, &packet), Err(refused));
    }
}

#[test]
fn every_number_of_a_request_is_checked() {
    let decode = |protocol, kind: CommandKind, at: usize, byte| {
        let mut payload = vec![0; kind.request_bytes(protocol)];
        payload[at] = byte;
        Request::decode(protocol, kind, &payload)
    };
    let value = |what, most, found| Err(WireError::Value { what, most, found });
    let (controller, generator) = ("the controller of Move", "the motion generator of Move");
    for (protocol, most) in [(Protocol::V5, 3), (Protocol::V9, 4), (Protocol::V10, 4)] {
        assert_eq!(decode(protocol, CommandKind::Move, 0, 3), value(controller, 2, 3));
        assert_eq!(decode(protocol, CommandKind::Move, 3, 1), value(controller, 2, 1 << 24));
        assert!(decode(protocol, CommandKind::Move, 4, most as u8).is_ok());
        assert_eq!(decode(protocol, CommandKind::Move, 4, most as u8 + 1), value(generator, most, most + 1));
    }
    let refused = Err(WireError::Flag { what: "use_async", index: 0, found: 2 });
    assert_eq!(decode(Protocol::V10, CommandKind::Move, 56, 2), refused);
    let refused = Err(WireError::Flag { what: "guiding_mode", index: 5, found: 9 });
    assert_eq!(decode(Protocol::V9, CommandKind::SetGuidingMode, 5, 9), refused);
    let refused = Err(WireError::Flag { what: "nullspace", index: 0, found: 9 });
    assert_eq!(decode(Protocol::V9, CommandKind::SetGuidingMode, 6, 9), refused);
    let library = CommandKind::LoadModelLibrary;
    assert_eq!(decode(Protocol::V5, library, 0, 4), value("the architecture of LoadModelLibrary", 3, 4));
    assert_eq!(decode(Protocol::V5, library, 1, 2), value("the system of LoadModelLibrary", 1, 2));
}

#[test]
fn what_a_version_lacks_is_not_sent() {
    let absent = |what, version| Err(WireError::Absent { what, version });
    let encode = |request: Request, protocol| request.encode(protocol, 0, &mut [0; MAX_REQUEST]);
    assert_eq!(encode(Request::GetRobotModel, Protocol::V5), absent("GetRobotModel", 5));
    assert_eq!(encode(Request::GetCartesianLimit(0), Protocol::V9), absent("GetCartesianLimit", 9));
    let target = LibraryTarget { architecture: Architecture::X64, system: System::Linux };
    assert_eq!(encode(Request::LoadModelLibrary(target), Protocol::V10), absent("LoadModelLibrary", 10));
    let mut motion = Move::new(MoveController::External, MoveGenerator::None);
    assert_eq!(encode(Request::Move(motion), Protocol::V5), absent("a motion without motion generator", 5));
    motion.use_async = true;
    assert_eq!(encode(Request::Move(motion), Protocol::V9), absent("an asynchronous motion", 9));
    assert_eq!(encode(Request::Move(motion), Protocol::V10), Ok(125));

    let out = &mut [0; MAX_FIXED_RESPONSE];
    let safety = Response::Move(MoveStatus::RejectedSafetyFunction);
    assert_eq!(safety.encode(Protocol::V5, 0, out), absent("this status of Move", 5));
    assert_eq!(safety.encode(Protocol::V9, 0, out), Ok(13));
    let kind = CommandKind::Move;
    let odd = Response::Setter(kind, SetterStatus::Success);
    assert_eq!(odd.encode(Protocol::V9, 0, out), Err(WireError::NotASetter { kind }));
    let model = Response::GetRobotModel { status: RobotModelStatus::Success, urdf: "<robot/>" };
    for found in 0..21 {
        assert_eq!(model.encode(Protocol::V9, 0, &mut out[..found]), Err(WireError::Buffer { found }));
    }
    assert_eq!(model.encode(Protocol::V9, 0, &mut out[..21]), Ok(21));
}

#[test]
fn answers_are_checked() {
    let decode = Response::decode;
    let most = WireError::Value { what: "the status of Move", most: 9, found: 10 };
    assert_eq!(decode(Protocol::V5, CommandKind::Move, &[10]), Err(most));
    assert_eq!(decode(Protocol::V9, CommandKind::Move, &[10]), Ok(Response::Move(MoveStatus::InputErrorAborted)));
    let short = WireError::Short { what: "the answer to Connect", least: 3, found: 2 };
    assert_eq!(decode(Protocol::V9, CommandKind::Connect, &[0, 9]), Err(short));
    let text = decode(Protocol::V9, CommandKind::GetRobotModel, b"\0<a>\xff</a>");
    assert_eq!(text, Err(WireError::NotText { valid: 3 }));
    let mut wall = [0; 154];
    wall[153] = 3;
    let flag = WireError::Flag { what: "object_activation", index: 0, found: 3 };
    assert_eq!(decode(Protocol::V5, CommandKind::GetCartesianLimit, &wall), Err(flag));
}

#[test]
fn headers_are_bounded() {
    let header = |size: u32| Header { command: 1, command_id: 2, size };
    for (size, most, good) in
        [(11, 428, false), (12, 428, true), (428, 428, true), (429, 428, false), (u32::MAX, MAX_MESSAGE, false)]
    {
        let decoded = Header::decode(&header(size).encode(), most);
        let refused = WireError::Size { least: 12, most, found: size };
        assert_eq!(decoded, if good { Ok(header(size)) } else { Err(refused) });
    }
    assert_eq!(header(12).payload_bytes(), 0);
    assert_eq!(header(428).payload_bytes(), 416);
}

#[test]
fn errors_say_what_was_expected_and_found() {
    let text = RobotState::decode(Protocol::V10, &[0; 2373]).unwrap_err().to_string();
    assert_eq!(text, "a robot state has 2373 bytes instead of 1377");
    let text = state_with(Protocol::V5, 2281, 9).unwrap_err().to_string();
    assert_eq!(text, "controller_mode is 9, expected 0 to 3");
    let text = CommandKind::from_number(Protocol::V10, 40).unwrap_err().to_string();
    assert_eq!(text, "command number 40 does not exist in protocol version 10");
}
