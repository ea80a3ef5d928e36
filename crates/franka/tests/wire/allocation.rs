//! Neither direction of any message allocates.

use std::hint::black_box;

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use plumbline_franka::wire::*;

use plumbline_testkit::fuzz::draw::Draws;

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

#[test]
fn no_message_allocates() {
    let words: Vec<u64> = (1..400_u64).map(|k| k.wrapping_mul(0x9e37_79b9_7f4a_7c15)).collect();
    let before = violation_count();
    for protocol in Protocol::ALL {
        let draws = &mut Draws::new(&words);
        let (state, command) = (draws.state(protocol), draws.command(protocol));
        let (mut states, mut commands, mut tcp) = ([0; MAX_STATE], [0; MAX_COMMAND], [0; MAX_REQUEST]);
        assert_no_alloc(|| {
            let length = state.encode(protocol, &mut states);
            assert_eq!(RobotState::decode(protocol, &states[..length]), Ok(state));
            black_box(RobotState::decode(protocol, &states[..length - 1])).unwrap_err();
            let length = command.encode(protocol, &mut commands);
            assert_eq!(RobotCommand::decode(protocol, &commands[..length]), Ok(command));
            black_box(RobotCommand::decode(protocol, &commands[..length - 1])).unwrap_err();
        });
        for kind in CommandKind::ALL.into_iter().filter(|kind| kind.number(protocol).is_some()) {
            let (request, response) = (draws.request(protocol, kind), draws.response(protocol, kind, "<robot/>"));
            assert_no_alloc(|| {
                let length = request.encode(protocol, 1, &mut tcp).unwrap();
                assert_eq!(Request::decode(protocol, kind, &tcp[HEADER_BYTES..length]), Ok(request));
                let length = response.encode(protocol, 1, &mut tcp).unwrap();
                assert_eq!(Response::decode(protocol, kind, &tcp[HEADER_BYTES..length]), Ok(response));
            });
        }
    }
    assert_eq!(violation_count(), before);
    assert_no_alloc(|| drop(black_box(vec![0_u8; 10])));
    assert!(violation_count() > before, "the guard is off");
}
