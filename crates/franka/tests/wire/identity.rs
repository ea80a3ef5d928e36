//! There and back: every message at every version is what it was.

use plumbline_franka::wire::*;
use proptest::prelude::*;

use plumbline_testkit::fuzz::draw::{Draws, WORDS};
use plumbline_testkit::fuzz::wire::{TARGETS, Tally, case};

fn words() -> impl Strategy<Value = Vec<u64>> {
    proptest::collection::vec(any::<u64>(), 1..WORDS)
}

fn cut(message: &[u8]) -> (Header, &[u8]) {
    let (head, payload) = message.split_first_chunk().unwrap();
    let header = Header::decode(head, MAX_MESSAGE).unwrap();
    assert_eq!(header.payload_bytes(), payload.len());
    (header, payload)
}

proptest! {
    #[test]
    fn states_survive(words in words()) {
        for protocol in Protocol::ALL {
            let state = Draws::new(&words).state(protocol);
            let mut out = [0xaa; MAX_STATE];
            let length = state.encode(protocol, &mut out);
            prop_assert_eq!(length, protocol.state_bytes());
            prop_assert!(out[length..].iter().all(|byte| *byte == 0xaa));
            prop_assert_eq!(RobotState::decode(protocol, &out[..length]), Ok(state));
        }
    }

    #[test]
    fn commands_survive(words in words()) {
        for protocol in Protocol::ALL {
            let command = Draws::new(&words).command(protocol);
            let mut out = [0xaa; MAX_COMMAND];
            let length = command.encode(protocol, &mut out);
            prop_assert_eq!(length, protocol.command_bytes());
            prop_assert!(out[length..].iter().all(|byte| *byte == 0xaa));
            prop_assert_eq!(RobotCommand::decode(protocol, &out[..length]), Ok(command));
        }
    }

    #[test]
    fn requests_survive(words in words()) {
        for protocol in Protocol::ALL {
            for kind in CommandKind::ALL.into_iter().filter(|kind| kind.number(protocol).is_some()) {
                let draws = &mut Draws::new(&words);
                let (request, id) = (draws.request(protocol, kind), draws.id());
                let mut out = [0; MAX_REQUEST];
                let length = request.encode(protocol, id, &mut out).unwrap();
                let (header, payload) = cut(&out[..length]);
                prop_assert_eq!(header.command_id, id);
                prop_assert_eq!(CommandKind::from_number(protocol, header.command), Ok(kind));
                prop_assert_eq!(payload.len(), kind.request_bytes(protocol));
                prop_assert_eq!(Request::decode(protocol, kind, payload), Ok(request));
            }
        }
    }

    #[test]
    fn responses_survive_also_with_a_tail(words in words(), text in ".{0,80}") {
        for protocol in Protocol::ALL {
            for kind in CommandKind::ALL.into_iter().filter(|kind| kind.number(protocol).is_some()) {
                let draws = &mut Draws::new(&words);
                let (response, id) = (draws.response(protocol, kind, &text), draws.id());
                let mut out = vec![0; response.bytes()];
                prop_assert_eq!(response.encode(protocol, id, &mut out), Ok(out.len()));
                let (header, payload) = cut(&out);
                prop_assert_eq!(header.command_id, id);
                prop_assert_eq!(CommandKind::from_number(protocol, header.command), Ok(kind));
                prop_assert_eq!(Response::decode(protocol, kind, payload), Ok(response));

                let open_ended = matches!(kind, CommandKind::LoadModelLibrary | CommandKind::GetRobotModel);
                if !open_ended {
                    let longer = [payload, &[7; 3]].concat();
                    prop_assert_eq!(Response::decode(protocol, kind, &longer), Ok(response));
                }
                let shortest = if open_ended { 1 } else { payload.len() };
                let short = Response::decode(protocol, kind, &payload[..shortest - 1]);
                prop_assert!(matches!(short, Err(WireError::Short { .. })), "{short:?}");
            }
        }
    }
}

#[test]
fn version_10_states_go_through_single_precision() {
    let state = RobotState { q: [0.1; 7], dq: [1e300; 7], m_ee: 1e-60, ..RobotState::default() };
    let mut out = [0; MAX_STATE];
    let length = state.encode(Protocol::V10, &mut out);
    let back = RobotState::decode(Protocol::V10, &out[..length]).unwrap();
    assert_eq!(back.q, [0.1_f32 as f64; 7]);
    assert_ne!(back.q, state.q);
    assert_eq!(back.dq, [f64::INFINITY; 7]);
    assert_eq!(back.m_ee, 0.0);
}

#[test]
fn numbers_that_are_none_come_through() {
    let mut command = RobotCommand { q_c: [f64::NAN; 7], ..RobotCommand::default() };
    command.tau_j_d[6] = f64::NEG_INFINITY;
    for protocol in Protocol::ALL {
        let mut out = [0; MAX_COMMAND];
        let length = command.encode(protocol, &mut out);
        let back = RobotCommand::decode(protocol, &out[..length]).unwrap();
        assert!(back.q_c.iter().all(|q| q.is_nan()));
        assert_eq!(back.tau_j_d, command.tau_j_d);
    }
}

#[test]
fn damaged_packets_are_refused_or_are_what_they_say() {
    let mut tally = Tally::default();
    for number in 0..400_000 {
        case(1, number, &mut tally).unwrap();
    }
    // The damage has to reach both sides of every decoder, or the test says nothing.
    for (index, target) in TARGETS.iter().enumerate() {
        assert!(tally.decoded[index] > 20_000, "{target}: {tally:?}");
        assert!(tally.refused[index] > 20_000, "{target}: {tally:?}");
    }
}
