//! Truncated, damaged and foreign files.

use super::*;
use plumbline::postmortem::facts::Facts;
use plumbline::postmortem::{page, text};

/// A short recording with lost states, a guard stop and a fault.
fn small_recording() -> Vec<u8> {
    let arm = FakeArm::new(JOINTS, READY)
        .at(30, Disturbance::Lose(2))
        .at(60, Disturbance::Push(1, 0.2))
        .at(64, Disturbance::NanPosition(0));
    let of = run_loop(arm, 200, vec![move_to(1, AWAY)], vec![1], no_inputs(), Vec::new());
    assert!(matches!(of.run.outcome.end, End::Unsafe(_)), "{:?}", of.run.outcome.end);
    recording(&of, 50, None).to_bytes().unwrap()
}

fn read_and_analyse(bytes: &[u8], all: bool) -> bool {
    let Ok(recording) = Recording::parse("fuzz", bytes) else { return false };
    if all {
        let facts = Facts::of("fuzz", &recording, replay_of(&recording).ok());
        assert!(!text(&facts).is_empty() && page(&facts, &recording).is_ok());
    }
    true
}

#[test]
fn a_truncated_file_is_read_up_to_the_cut() {
    let of = run_loop(FakeArm::new(JOINTS, READY), 3_000, whole_job(), vec![1], no_inputs(), Vec::new());
    let bytes = recording(&of, 0, None).to_bytes().unwrap();
    let mut most = 0;
    for percent in [20, 40, 60, 80, 99] {
        let cut = &bytes[..bytes.len() * percent / 100];
        let part = Recording::parse("cut", cut).unwrap();
        assert!(part.cut.as_ref().is_some_and(|cut| cut.contains("byte") && cut.contains("record")), "{:?}", part.cut);
        let cycles = part.records.len();
        assert!(
            cycles >= most && cycles * 100 + 6_000 > 3_000 * percent.saturating_sub(8),
            "{percent} %: {cycles} cycles"
        );
        most = cycles;
        assert!(replay_of(&part).unwrap().is_identical());
        assert!(text(&Facts::of("cut", &part, None)).contains("cut short"));
    }
    // The checksum detects a flipped bit.
    let mut rotten = bytes.clone();
    let middle = rotten.len() / 2;
    rotten[middle] ^= 4;
    let part = Recording::parse("rot", &rotten).unwrap();
    assert!(part.cut.is_some_and(|cut| cut.to_lowercase().contains("crc")) && part.records.len() < 3_000);
}

/// Opcode, number of the first byte, and number of the byte behind each record from `at` up to `end`.
fn raw_records(bytes: &[u8], mut at: usize, end: usize) -> Vec<(u8, usize, usize)> {
    let mut found = Vec::new();
    while at + 9 < end {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((bytes[at], at, at + 9 + length));
        at += 9 + length;
    }
    found
}

/// The file without chunk checksums, which the format allows: changes are then not detected by checksum.
fn without_checksums(sound: &[u8]) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for (opcode, at, _) in raw_records(sound, 8, sound.len()) {
        // Of a chunk, after opcode and length: begin, end, size, checksum.
        if opcode == 0x06 {
            bytes[at + 9 + 24..at + 9 + 28].fill(0);
        }
    }
    assert_ne!(bytes, sound);
    bytes
}

#[test]
fn records_beyond_their_chunk_and_open_attachments_end_the_file() {
    let bytes = without_checksums(&small_recording());
    let all = Recording::parse("seed", &bytes).unwrap();
    let file = raw_records(&bytes, 8, bytes.len());
    let find = |opcode| *file.iter().find(|record| record.0 == opcode).unwrap();
    // A longer length in the last record of the first chunk.
    let (_, chunk, end) = find(0x06);
    let (_, last, whole) = *raw_records(&bytes, chunk + 9 + 40, end).last().unwrap();
    assert_eq!(whole, end);
    let mut longer = bytes.clone();
    longer[last + 1] = longer[last + 1].wrapping_add(20);
    let part = Recording::parse("longer", &longer).unwrap();
    let cut = part.cut.unwrap();
    assert!(cut.contains(&format!("byte {chunk}")) && cut.contains("beyond the end of its chunk"), "{cut}");
    assert!(part.records.len() < all.records.len());
    // An attachment that ends before its checksum.
    let (_, attachment, _) = find(0x09);
    let name = u32::from_le_bytes(bytes[attachment + 25..attachment + 29].try_into().unwrap()) as usize;
    let at = attachment + 29 + name;
    let media = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let header = at + 4 + media + 8 - (attachment + 9);
    for more in 0..4 {
        let mut short = bytes.clone();
        short[attachment + 1..attachment + 9].copy_from_slice(&((header + more) as u64).to_le_bytes());
        let error = Recording::parse("short", &short).unwrap_err().to_string();
        assert!(error.contains("about.json"), "{error}");
    }
}

/// Seeded mutations of a recording; more with PLUMBLINE_FUZZ_CASES.
#[test]
fn mutated_files_cause_no_panic() {
    let cases: u64 = std::env::var("PLUMBLINE_FUZZ_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(20_000);
    let seeds = [small_recording(), without_checksums(&small_recording())];
    assert!(seeds.iter().all(|seed| read_and_analyse(seed, true)), "the seeds themselves are sound");
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut read = 0;
    for case in 0..cases {
        let seed = &seeds[(case / 5 % 2) as usize];
        let mut bytes = seed.clone();
        match case % 5 {
            0 => bytes.truncate(rng.random_range(0..=seed.len())),
            1 => {
                // A wrong length or opcode.
                let at = rng.random_range(0..bytes.len() - 8);
                let altered = [u64::MAX, 1 << 40, 1 << 31, 0, rng.random()][rng.random_range(0..5)];
                bytes[at..at + 8].copy_from_slice(&altered.to_le_bytes());
            }
            2 => {
                let (from, to) = (rng.random_range(0..bytes.len()), rng.random_range(0..bytes.len()));
                let count = rng.random_range(0..200).min(bytes.len() - from.max(to));
                bytes.copy_within(from..from + count, to);
            }
            3 => {
                let at = rng.random_range(0..bytes.len());
                bytes.drain(at..(at + rng.random_range(1..64)).min(seed.len()));
            }
            _ => {
                for _ in 0..rng.random_range(1..6) {
                    let at = rng.random_range(0..bytes.len());
                    bytes[at] = rng.random();
                }
            }
        }
        read += u64::from(read_and_analyse(&bytes, case % 1999 == 0));
    }
    // Many truncated and changed files are readable up to the damage.
    assert!(read > cases / 20, "only {read} of {cases} were read at all");
    // Random values in the fields, with matching checksums.
    let sound = Recording::parse("seed", &seeds[0]).unwrap();
    for _ in 0..(cases / 200).min(2_000) {
        let mut one = sound.clone();
        let place = rng.random_range(0..one.records.len());
        let record = &mut one.records[place];
        let any = f64::from_bits(rng.random());
        let number = [u64::MAX, u64::MAX - 1, 0, rng.random()][rng.random_range(0..4)];
        match rng.random_range(0..9) {
            0 => record.state.q[0] = any,
            1 => record.command.desired.q[1] = any,
            2 => record.state.seq = number,
            3 => record.cycle = number,
            4 => record.stamp_ns = number,
            5 => record.tick = number,
            6 => record.motion = number as u32,
            7 => one.about.motions = vec![(number as u32, "last".into())],
            _ => one.about.orders_before = number as u32,
        }
        if let Ok(bytes) = one.to_bytes() {
            read_and_analyse(&bytes, true);
        }
    }
}

#[test]
fn other_files_are_refused_with_the_expected_format() {
    let seed = small_recording();
    let cases: [(&[u8], &[&str]); 4] = [
        (b"", &["byte 0", "empty", "89 4d 43 41 50"]),
        (b"t,q1,tau1\n0,1,2\n", &["byte 0", "74 2c 71", "MCAP"]),
        (&seed[..8], &["about.json", "byte 8"]),
        (&seed[..300], &["about.json"]),
    ];
    for (bytes, parts) in cases {
        let error = Recording::parse("x.mcap", bytes).unwrap_err().to_string();
        assert!(error.starts_with("x.mcap: "), "{error}");
        for part in parts {
            assert!(error.contains(part), "no `{part}` in `{error}`");
        }
    }
}
