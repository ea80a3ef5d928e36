//! One motion in every form gives one run; what can't be understood is refused by name.

use super::*;
use crate::recording::cdr::Encoder;
use crate::recording::foreign::{Compression, mcap_of};
use std::io::Write;

const N: usize = 2;

fn wanted() -> Wanted {
    Wanted { joints: N, ..Wanted::default() }
}

/// Time, position, velocity and torque of one sample.
type Row = (f64, [f64; N], [f64; N], [f64; N]);

/// Time \[s\], position, velocity, effort of 40 samples, one of which is missing.
fn samples() -> Vec<Row> {
    let one = |k: usize| {
        let t = k as f64 * 0.008;
        (t, [t.sin(), -t], [t.cos(), -1.0], [3.0 + t, 0.5 * t])
    };
    (0..41).filter(|k| *k != 20).map(one).collect()
}

fn check(found: &Imported, stamp: f64) {
    assert_eq!(found.t.len(), 40);
    for (k, (t, q, dq, tau)) in samples().into_iter().enumerate() {
        assert!((found.t[k] - t).abs() < stamp, "{k}: {} {t}", found.t[k]);
        for j in 0..N {
            assert_eq!(found.q[(k, j)], q[j]);
            assert_eq!(found.dq.as_ref().unwrap()[(k, j)], dq[j]);
            assert_eq!(found.tau[(k, j)], tau[j]);
        }
    }
    let sampling = found.notes.iter().find(|note| note.contains("gaps")).unwrap();
    assert!(sampling.starts_with("40 samples in 0.320 s, 125.0 Hz"), "{sampling}");
    assert!(sampling.contains("1 gaps with 1 samples missing"), "{sampling}");
}

fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    (folder, path)
}

fn refused(name: &str, bytes: &[u8], wanted: &Wanted) -> String {
    let (_folder, path) = file(name, bytes);
    read(&path, wanted).unwrap_err().to_string()
}

/// As UR's RTDE client writes it, with a column that is no number.
fn csv(time: impl Fn(f64) -> String) -> String {
    let mut text = "timestamp,mode,actual_q_0,actual_q_1,actual_qd_0,actual_qd_1,effort0,effort1\n".to_string();
    for (t, q, dq, tau) in samples() {
        text += &format!("{},run,{:?},{:?},{:?},{:?},{:?},{:?}\n", time(t), q[0], q[1], dq[0], dq[1], tau[0], tau[1]);
    }
    text
}

#[test]
fn a_csv_file_is_understood_by_its_names() {
    let (_folder, path) = file("log.csv", csv(|t| format!("{t:?}")).as_bytes());
    check(&read(&path, &wanted()).unwrap(), 1e-12);
    let (_folder, path) =
        file("log.csv", csv(|t| format!("{}", 1_700_000_000_000_000_000_u64 + (t * 1e9) as u64)).as_bytes());
    // Nanoseconds since 1970 in double precision: a quarter of a microsecond.
    check(&read(&path, &wanted()).unwrap(), 1e-6);
    let milliseconds = Wanted { time_unit: Some(1e-3), degrees: true, gain: Some(vec![-1.0, 10.0]), ..wanted() };
    let (_folder, path) = file("log.csv", csv(|t| format!("{}", 1e3 * t)).as_bytes());
    let found = read(&path, &milliseconds).unwrap();
    let (t, q, _, tau) = samples()[7];
    assert!((found.t[7] - t).abs() < 1e-12);
    assert!((found.q[(7, 0)] - q[0].to_radians()).abs() < 1e-15);
    assert_eq!([found.tau[(7, 0)], found.tau[(7, 1)]], [-tau[0], 10.0 * tau[1]]);
}

/// A `.npy` file of version 1.
fn npy(shape: &str, fortran: bool, values: &[f64]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let mut header = format!("{{'descr': '<f8', 'fortran_order': {order}, 'shape': ({shape}), }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    bytes
}

fn npz(arrays: &[(&str, Vec<u8>)], deflated: bool) -> Vec<u8> {
    let method = if deflated { zip::CompressionMethod::Deflated } else { zip::CompressionMethod::Stored };
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, data) in arrays {
        let options = zip::write::SimpleFileOptions::default().compression_method(method);
        archive.start_file(format!("{name}.npy"), options).unwrap();
        archive.write_all(data).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

#[test]
fn an_npz_archive_is_understood_in_both_orders_compressed_or_not() {
    let all = samples();
    let time: Vec<f64> = all.iter().map(|(t, ..)| *t).collect();
    let rows = |of: fn(&Row) -> [f64; N]| all.iter().flat_map(of).collect::<Vec<f64>>();
    let columns: Vec<f64> = (0..N).flat_map(|j| all.iter().map(move |(_, _, dq, _)| dq[j])).collect();
    let arrays = [
        ("time", npy("40,", false, &time)),
        ("q", npy("40, 2", false, &rows(|(_, q, ..)| *q))),
        ("dq", npy("40, 2", true, &columns)),
        ("tau_J", npy("40, 2", false, &rows(|(.., tau)| *tau))),
        ("pictures", npy("1, 2, 2", false, &[0.0; 4])),
    ];
    for deflated in [false, true] {
        let (_folder, path) = file("log.npz", &npz(&arrays, deflated));
        check(&read(&path, &wanted()).unwrap(), 1e-12);
    }
    let message = refused("log.npz", &npz(&arrays[..2], false), &wanted());
    assert!(message.contains("torques") && message.contains("`time`, `q`"), "{message}");
    let short = [("time", npy("40,", false, &time[..30]))];
    let message = refused("log.npz", &npz(&short, false), &wanted());
    assert!(message.contains("array `time`") && message.contains("as many as the shape says"), "{message}");
    assert!(refused("log.npz", b"no archive", &wanted()).contains("zip archive"));
}

/// Joint states in another order than the arm's, a finger among them.
fn message((t, q, dq, tau): Row, stamped: bool) -> Vec<u8> {
    let nanoseconds = 5_000_000_000 + (t * 1e9).round() as u64;
    let mut cdr = Encoder::default();
    let (sec, nanosec) = if stamped { (nanoseconds / 1_000_000_000, nanoseconds % 1_000_000_000) } else { (0, 0) };
    cdr.i32(sec as i32).u32(nanosec as u32).string("base");
    cdr.strings(&["panda_finger_joint1".into(), "panda_joint2".into(), "panda_joint1".into()]);
    cdr.f64s(&[0.04, q[1], q[0]]).f64s(&[0.0, dq[1], dq[0]]).f64s(&[0.0, tau[1], tau[0]]);
    cdr.finish()
}

/// Recorded two milliseconds after the stamp.
fn logged(t: f64) -> u64 {
    5_002_000_000 + (t * 1e9).round() as u64
}

fn mcap(compression: Option<Compression>) -> Vec<u8> {
    let messages: Vec<_> = samples().into_iter().map(|sample| (logged(sample.0), message(sample, true))).collect();
    mcap_of(compression, &messages)
}

#[test]
fn joint_states_of_an_mcap_file_are_put_in_the_arms_order() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let bytes = mcap(compression);
        let (_folder, path) = file("bag.mcap", &bytes);
        let found = read(&path, &wanted()).unwrap();
        check(&found, 1e-9);
        assert_eq!(found.notes[0], "topic /joint_states, 40 messages, joints panda_joint1 panda_joint2");
        assert_eq!(found.notes[1], "left out: panda_finger_joint1");
        assert!(found.notes[2].contains("recorded 2.00 ms later"), "{}", found.notes[2]);
    }
    let bytes = mcap(None);
    let message = refused("bag.mcap", &bytes[..bytes.len() / 2], &wanted());
    assert!(message.contains("complete MCAP file"), "{message}");
    let message = refused("bag.mcap", &bytes, &Wanted { topic: Some("/states".into()), ..wanted() });
    assert!(message.contains("--topic") && message.contains("`/joint_states`"), "{message}");
    let message = refused("bag.mcap", &bytes, &Wanted { joints: 6, ..wanted() });
    assert!(message.contains("--joint-names") && message.contains("panda_joint2, panda_joint1"), "{message}");
    let named = Wanted { names: Some(vec!["panda_joint2".into(), "elbow".into()]), ..wanted() };
    assert!(refused("bag.mcap", &bytes, &named).contains("joint `elbow`"));
}

fn database(path: &Path, stamped: bool) {
    let base = rusqlite::Connection::open(path).unwrap();
    base.execute_batch(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL);
         CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL);
         INSERT INTO topics VALUES(1, '/rosout', 'rcl_interfaces/msg/Log', 'cdr');
         INSERT INTO topics VALUES(2, '/joint_states', 'sensor_msgs/msg/JointState', 'cdr');",
    )
    .unwrap();
    for sample in samples() {
        let row = (2, logged(sample.0) as i64, message(sample, stamped));
        base.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(?1, ?2, ?3)", row).unwrap();
    }
}

#[test]
fn joint_states_of_a_rosbag2_database_are_read_with_and_without_stamps() {
    for stamped in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bag.db3");
        database(&path, stamped);
        let found = read(&path, &wanted()).unwrap();
        check(&found, 1e-9);
        assert_eq!(found.notes[2].contains("have no stamps"), !stamped, "{}", found.notes[2]);
    }
    assert!(
        refused("bag.db3", b"no database, but long enough to be read as one", &wanted()).contains("rosbag2 database")
    );
    assert!(refused("bag.bag", b"", &wanted()).contains("`.bag`"));
}

#[test]
fn garbage_in_a_table_is_refused_by_line_and_name() {
    let message =
        refused("log.csv", csv(|t| if t > 0.1 { "later".into() } else { format!("{t}") }).as_bytes(), &wanted());
    assert!(message.contains("line 15, column `timestamp`: got `later`"), "{message}");
    let message = refused("log.csv", csv(|t| format!("{}", -t)).as_bytes(), &wanted());
    assert!(message.contains("does not run backwards"), "{message}");
    let message = refused("log.csv", csv(|t| format!("{t}")).as_bytes(), &Wanted { joints: 3, ..wanted() });
    assert!(message.contains("`actual_q_0`, `actual_q_1`") && message.contains("3 columns of positions"), "{message}");
    assert!(refused("log.csv", b"a,b\n1,2\n", &wanted()).contains("the file has `a`, `b`"));
}
