//! A dataset's runs as MCAP: the numbers come back bit by bit; truncated, damaged and foreign files are refused by name.

use super::dataset_form::made_up;
use plumbline::dataset::{Dataset, Run};
use plumbline::import::{self, Wanted};
use plumbline_model::Mounting;
use std::fs;
use std::path::Path;

/// The made-up dataset with its runs as MCAP, and numbers that text formats lose.
fn as_mcap(samples: usize, n: usize) -> Dataset {
    let mut set = made_up(samples, n);
    set.runs[1].start = 100.0;
    for run in &mut set.runs {
        run.data.name = run.data.name.replace(".csv", ".mcap");
        run.data.q[(0, 0)] = -0.0;
        run.data.q[(1, 0)] = f64::MIN_POSITIVE / 8.0;
        run.data.q[(2, 0)] = f64::MAX;
        run.data.t[3] = f64::from_bits(run.data.t[3].to_bits() + 1);
        run.extra.push(("a name, \"with\" signs [Nm]".into(), vec![0.1 + 0.2; samples]));
    }
    set
}

fn bits<'v>(values: impl IntoIterator<Item = &'v f64>) -> Vec<u64> {
    values.into_iter().map(|value| value.to_bits()).collect()
}

fn assert_same(read: &Run, written: &Run) {
    let (a, b) = (&read.data, &written.data);
    assert_eq!((bits(&a.t), bits(&a.q), bits(&a.tau)), (bits(&b.t), bits(&b.q), bits(&b.tau)));
    assert_eq!(a.dq.as_ref().map(bits), b.dq.as_ref().map(bits));
    assert_eq!((a.q.shape(), a.tau.shape()), (b.q.shape(), b.tau.shape()));
    let named = |run: &Run| run.extra.iter().map(|(name, values)| (name.clone(), bits(values))).collect::<Vec<_>>();
    assert_eq!(named(read), named(written));
}

#[test]
fn what_is_written_reads_back_bit_by_bit() {
    let room = tempfile::tempdir().unwrap();
    // More than one chunk.
    let written = as_mcap(5_000, 7);
    let dir = room.path().join("set");
    written.write(&dir).unwrap();
    let read = Dataset::read(&dir).unwrap();
    read.runs.iter().zip(&written.runs).for_each(|(read, written)| assert_same(read, written));
    assert_eq!(read.content_hash(), written.content_hash());
    // Both formats in one dataset.
    let mut mixed = written.clone();
    mixed.runs[1].data.name = "b.csv".into();
    mixed.runs[1].extra.pop();
    mixed.write(&dir).unwrap();
    let read = Dataset::read(&dir).unwrap();
    read.runs.iter().zip(&mixed.runs).for_each(|(read, written)| assert_same(read, written));
    // A run without torques, and with negative times, of which viewers see 0.
    let mut still = written.runs[0].clone();
    still.data.tau = still.data.tau.remove_columns(0, 7);
    still.data.t.iter_mut().for_each(|t| *t -= 100.0);
    let alone = Dataset { runs: vec![still.clone()], ..written };
    alone.write(&dir).unwrap();
    assert_same(&Run::read(&dir.join("a.mcap"), Mounting::WALL).unwrap(), &still);
    let refused = Dataset::read(&dir).unwrap_err().to_string();
    assert!(refused.contains("a.mcap: columns: got no column `tau1`"), "{refused}");
}

#[test]
fn other_programs_read_the_joint_states() {
    let room = tempfile::tempdir().unwrap();
    let written = as_mcap(40, 7);
    written.write(room.path()).unwrap();
    let (run, wanted) = (&written.runs[0].data, Wanted { joints: 7, ..Wanted::default() });
    let read = import::read(&room.path().join("a.mcap"), &wanted).unwrap();
    assert_eq!((bits(&read.q), bits(&read.tau)), (bits(&run.q), bits(&run.tau)));
    assert_eq!(read.dq.as_ref().map(bits), run.dq.as_ref().map(bits));
}

/// The run in a file of these bytes, or what reading says.
fn read(dir: &Path, bytes: &[u8]) -> Result<Run, String> {
    fs::write(dir.join("a.mcap"), bytes).unwrap();
    Run::read(&dir.join("a.mcap"), Mounting::WALL).map_err(|bad| bad.to_string())
}

/// A change of a run.
type Change = fn(&mut Run);

#[test]
fn values_that_a_csv_file_may_not_have_are_refused_here_too() {
    let room = tempfile::tempdir().unwrap();
    let cases: [(Change, &str); 6] = [
        (|run| run.data.tau[(4, 1)] = f64::NAN, "a.mcap: sample 4, column tau2: got NaN, expected a finite number"),
        (|run| run.extra[0].1[7] = f64::INFINITY, "a.mcap: sample 7, column tau_cmd1: got inf"),
        (|run| run.data.t[6] = 0.0015, "a.mcap: sample 6, column t: got 0.0015, expected a time not before 0.005 s"),
        (|run| run.data.t.fill(1.0), "a.mcap: column t: got 1 s in every row"),
        (|run| run.extra[0].0 = "q_d1".into(), "a.mcap: columns: got no column `q_d2`"),
        (|run| run.extra[0].0 = "q1".into(), "a.mcap: columns, column 8: got `q1`, expected a unique column name"),
    ];
    for (change, expected) in cases {
        let mut set = as_mcap(40, 2);
        change(&mut set.runs[0]);
        set.write(room.path()).unwrap();
        let message = Dataset::read(room.path()).expect_err("a refusal").to_string();
        assert!(message.contains(expected), "`{message}` does not say `{expected}`");
    }
    let mut short = as_mcap(9, 2);
    short.runs.truncate(1);
    short.write(room.path()).unwrap();
    let message = Dataset::read(room.path()).unwrap_err().to_string();
    assert!(message.contains("a.mcap: messages: got 9 samples, expected at least 10 samples"), "{message}");
}

#[test]
fn truncated_damaged_and_foreign_files_are_refused_by_name() {
    let room = tempfile::tempdir().unwrap();
    let dir = room.path();
    let written = as_mcap(3_000, 2);
    written.write(dir).unwrap();
    let whole = fs::read(dir.join("a.mcap")).unwrap();
    assert_same(&read(dir, &whole).unwrap(), &written.runs[0]);
    for cut in (0..whole.len()).step_by(whole.len() / 47).chain(whole.len() - 40..whole.len()) {
        let message = read(dir, &whole[..cut]).expect_err("a refusal");
        assert!(message.contains("a.mcap: ") && message.contains("expected"), "{message}");
    }
    // A flipped bit is found, or in a part that no number depends on.
    let mut found = 0;
    for at in (0..whole.len()).step_by(whole.len() / 97) {
        let mut rotten = whole.clone();
        rotten[at] ^= 1 << (at % 8);
        match read(dir, &rotten) {
            Err(message) => {
                found += 1;
                assert!(message.contains("a.mcap: "), "{message}");
            }
            Ok(run) => assert_same(&run, &written.runs[0]),
        }
    }
    assert!(found > 50, "{found}");
    for (bytes, says) in [
        (&b""[..], "byte 0: got an empty file, expected an MCAP file"),
        (b"t,q1,tau1\n0,0,0\n", "byte 0: got 74 2c 71 31 2c 74 61 75, expected an MCAP file"),
        (&[0xff; 4096], "byte 0: got ff ff ff ff ff ff ff ff"),
    ] {
        let message = read(dir, bytes).expect_err("a refusal");
        assert!(message.contains(&format!("a.mcap: {says}")), "{message}");
    }
}
