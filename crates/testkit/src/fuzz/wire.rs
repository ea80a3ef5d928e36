//! Good packets damaged at random, and what has to hold for whatever a decoder makes of them.
//!
//! A case is given by a seed and a number alone. `examples/fuzz_wire.rs` runs the same cases for as long as one likes.

use plumbline_franka::wire::layout::Scalar;
use plumbline_franka::wire::*;
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::fuzz::draw::{Draws, WORDS};

pub const TARGETS: [&str; 4] = ["states", "commands", "requests", "responses"];

/// How many packets of each kind were decoded, and how many refused.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub decoded: [u64; 4],
    pub refused: [u64; 4],
}

/// Runs one case; `Err` says what does not hold. A decoder that panics does so here.
pub fn case(seed: u64, number: u64, tally: &mut Tally) -> Result<(), String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let mut words = [0_u64; WORDS];
    let fresh = random.random_range(1..=WORDS);
    words.iter_mut().take(fresh).for_each(|word| *word = random.next_u64());
    let draws = &mut Draws::new(&words[..fresh]);

    let target = random.random_range(0..TARGETS.len());
    let written = draws.protocol();
    // Now and then read by a peer of another version.
    let read = if random.random_ratio(1, 8) { draws.protocol() } else { written };
    let mut packet = good(target, written, draws);
    for _ in 0..random.random_range(0..4) {
        damage(&mut packet, &mut random);
    }
    let decoded = match target {
        0 => state(read, &packet),
        1 => command(read, &packet),
        2 => request(read, &packet),
        _ => response(read, &packet),
    };
    match decoded {
        Ok(true) => tally.decoded[target] += 1,
        Ok(false) => tally.refused[target] += 1,
        Err(why) => return Err(format!("seed {seed}, case {number}, {} at {read}: {why}", TARGETS[target])),
    }
    Ok(())
}

fn good(target: usize, protocol: Protocol, draws: &mut Draws) -> Vec<u8> {
    match target {
        0 => {
            let mut out = [0; MAX_STATE];
            let length = draws.state(protocol).encode(protocol, &mut out);
            out[..length].to_vec()
        }
        1 => {
            let mut out = [0; MAX_COMMAND];
            let length = draws.command(protocol).encode(protocol, &mut out);
            out[..length].to_vec()
        }
        2 => {
            let mut out = [0; MAX_REQUEST];
            let kind = draws.kind(protocol);
            let length = draws.request(protocol, kind).encode(protocol, draws.id(), &mut out).unwrap();
            out[..length].to_vec()
        }
        _ => {
            let kind = draws.kind(protocol);
            let response = draws.response(protocol, kind, "<robot name=\"arm\"><link name=\"base\"/></robot> éß€𝄞");
            let mut out = vec![0; response.bytes()];
            response.encode(protocol, draws.id(), &mut out).unwrap();
            out
        }
    }
}

/// One act of damage, from a single bit to a packet of noise.
fn damage(packet: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    let length = packet.len();
    if length == 0 {
        packet.extend(random.random::<[u8; 2]>());
        return;
    }
    let at = random.random_range(0..length);
    let until = random.random_range(at..=length.min(at + 64));
    match random.random_range(0..10) {
        0 | 1 => packet[at] ^= 1 << random.random_range(0..8),
        2 => packet[at] = [0, 1, 2, 7, 0x7f, 0x80, 0xff][random.random_range(0..7)],
        3 => packet[at..until].fill(random.random()),
        4 => random.fill_bytes(&mut packet[at..until]),
        5 => packet.truncate(at),
        6 => packet.extend((0..random.random_range(1..40)).map(|_| random.random::<u8>())),
        7 => drop(packet.drain(at..until)),
        8 => {
            // The head of a TCP message: command, number of the call, or size.
            let word = 4 * random.random_range(0..3);
            let value =
                [random.random_range(0..16_u32), 12, 13, 428, u32::MAX, random.random()][random.random_range(0..6)];
            packet.iter_mut().skip(word).zip(value.to_le_bytes()).for_each(|(to, from)| *to = from);
        }
        _ => {
            packet.resize(random.random_range(0..3000), 0);
            random.fill_bytes(packet);
        }
    }
}

fn state(protocol: Protocol, packet: &[u8]) -> Result<bool, String> {
    let Ok(state) = RobotState::decode(protocol, packet) else { return Ok(false) };
    let mut again = [0; MAX_STATE];
    let length = state.encode(protocol, &mut again);
    if packet.len() != protocol.state_bytes() || length != packet.len() {
        return Err(format!("{} bytes became {length}", packet.len()));
    }
    for slot in protocol.state_layout() {
        let (before, after) = (&packet[slot.offset..slot.end()], &again[slot.offset..slot.end()]);
        // What is not a number in single precision may change its payload on the way.
        let nan = |bytes: &[u8; 4]| f32::from_le_bytes(*bytes).is_nan();
        let same = match slot.scalar {
            Scalar::F32 => {
                let (before, after) = (before.as_chunks().0, after.as_chunks().0);
                before.iter().zip(after).all(|(a, b)| a == b || nan(a) && nan(b))
            }
            _ => before == after,
        };
        if !same {
            return Err(format!("{} was {before:?} and became {after:?}", slot.name));
        }
    }
    Ok(true)
}

fn command(protocol: Protocol, packet: &[u8]) -> Result<bool, String> {
    let Ok(command) = RobotCommand::decode(protocol, packet) else { return Ok(false) };
    let mut again = [0; MAX_COMMAND];
    let length = command.encode(protocol, &mut again);
    if packet == &again[..length] { Ok(true) } else { Err(format!("{command:?} has other bytes")) }
}

/// Header and payload, as they are cut out of a stream.
fn cut(packet: &[u8], most: u32) -> Option<(Header, &[u8])> {
    let (head, rest) = packet.split_first_chunk()?;
    let header = Header::decode(head, most).ok()?;
    assert_eq!(&header.encode(), head);
    assert!((HEADER_BYTES as u32..=most).contains(&header.size));
    Some((header, rest.get(..header.payload_bytes())?))
}

fn request(protocol: Protocol, packet: &[u8]) -> Result<bool, String> {
    let Some((header, payload)) = cut(packet, MAX_REQUEST as u32) else { return Ok(false) };
    let early = Connect::decode(payload);
    let Ok(kind) = CommandKind::from_number(protocol, header.command) else { return Ok(false) };
    let Ok(request) = Request::decode(protocol, kind, payload) else { return Ok(false) };
    if let Request::Connect(connect) = request
        && early != Ok(connect)
    {
        return Err(format!("{connect:?} was {early:?} before the version was known"));
    }
    let mut again = [0; MAX_REQUEST];
    let length = request.encode(protocol, header.command_id, &mut again).map_err(|error| error.to_string())?;
    if again[..length] == packet[..HEADER_BYTES + payload.len()] {
        Ok(true)
    } else {
        Err(format!("{request:?} has other bytes"))
    }
}

fn response(protocol: Protocol, packet: &[u8]) -> Result<bool, String> {
    let Some((header, payload)) = cut(packet, MAX_MESSAGE) else { return Ok(false) };
    let early = Connected::decode(payload);
    let Ok(kind) = CommandKind::from_number(protocol, header.command) else { return Ok(false) };
    let Ok(response) = Response::decode(protocol, kind, payload) else { return Ok(false) };
    if let Response::Connect(connected) = response
        && early != Ok(connected)
    {
        return Err(format!("{connected:?} was {early:?} before the version was known"));
    }
    let mut again = vec![0; response.bytes()];
    let length = response.encode(protocol, header.command_id, &mut again).map_err(|error| error.to_string())?;
    // Longer answers are taken, so the payload may go on behind what was understood.
    if length == again.len() && payload.starts_with(&again[HEADER_BYTES..]) {
        Ok(true)
    } else {
        Err(format!("{response:?} has other bytes"))
    }
}
