//! The dataset's folder form: what is written reads back, bad descriptions are refused, the measured logs load.

use nalgebra::DMatrix;
use plumbline::dataset::columns::{self, JointColumns};
use plumbline::dataset::{Dataset, Role, Run};
use plumbline_model::Mounting;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fs;
use std::path::{Path, PathBuf};

pub(super) fn made_up(samples: usize, n: usize) -> Dataset {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut block =
        || DMatrix::from_fn(samples, n, |_, _| rng.random_range(-1.0..1.0_f64) * 10f64.powi(rng.random_range(-9..9)));
    let mut run = |file: &str, role| Run {
        data: plumbline_identify::Run {
            name: file.to_string(),
            t: (0..samples).map(|k| k as f64 * 1e-3).collect(),
            q: block(),
            dq: Some(block()),
            tau: block(),
            mounting: Mounting::WALL,
            period: Some(0.01),
        },
        role,
        note: "seeded, with \"quotes\"".to_string(),
        session: 1,
        start: 0.0,
        extra: vec![("tau_cmd1".to_string(), block().column(0).iter().copied().collect())],
    };
    let mut runs = vec![run("a.csv", Role::Identify), run("b.csv", Role::Validate)];
    runs[1].data.mounting = Mounting::UPRIGHT;
    runs[1].session = 2;
    runs[1].start = 3.5;
    runs[1].data.period = None;
    runs[1].data.dq = None;
    let source = "origin = \"a seed\"".parse().unwrap();
    Dataset { name: "made-up".into(), robot: "panda".into(), mounting: Mounting::WALL, source, runs }
}

#[test]
fn what_is_written_reads_back_bit_by_bit() {
    let room = tempfile::tempdir().unwrap();
    let dir = room.path().join("set");
    let written = made_up(40, 7);
    written.write(&dir).unwrap();
    let read = Dataset::read(&dir).unwrap();
    assert_eq!((&read.name, &read.robot, &read.source), (&written.name, &written.robot, &written.source));
    assert_eq!(read.runs.len(), 2);
    for (a, b) in read.runs.iter().zip(&written.runs) {
        assert_eq!(
            (&a.data.name, a.role, &a.note, a.data.period, a.session, a.start),
            (&b.data.name, b.role, &b.note, b.data.period, b.session, b.start)
        );
        assert_eq!(a.data.mounting, b.data.mounting);
        assert_eq!(
            (&a.data.t, &a.data.q, &a.data.dq, &a.data.tau, &a.extra),
            (&b.data.t, &b.data.q, &b.data.dq, &b.data.tau, &b.extra)
        );
    }
    assert_eq!(read.content_hash(), written.content_hash());
    assert_eq!(read.content_hash().len(), 64);
    assert_eq!(read.runs[0].extra("tau_cmd1").unwrap().len(), 40);
}

/// Both runs were read at 1 kHz and sent every 1.02 ms: the one with a period keeps its stamps.
#[test]
fn rows_that_were_read_faster_than_sent_get_the_times_of_the_sender() {
    let mut set = made_up(600, 2);
    for run in &mut set.runs {
        for k in 0..600 {
            let sent = ((k as f64 * 1e-3 + 1e-9) / 1.02e-3).floor() * 1.02e-3;
            run.data.q.row_mut(k).fill((3.0 * sent).sin());
            run.data.tau.row_mut(k).fill((1e5 * sent).sin());
            run.data.dq = None;
            run.extra.clear();
        }
    }
    let room = tempfile::tempdir().unwrap();
    set.write(&room.path().join("set")).unwrap();
    let read = Dataset::read(&room.path().join("set")).unwrap();
    assert_eq!(read.runs[0].data.t, set.runs[0].data.t);
    let sent = &read.runs[1].data.t;
    assert!(sent.len() == 600 && (sent[3] - sent[2] - 1.02e-3).abs() < 2e-6, "{}", sent[3] - sent[2]);
    assert_eq!(&Run::read(&room.path().join("set/b.csv"), Mounting::UPRIGHT).unwrap().data.t, sent);
    // Once it has them, they stay.
    read.write(&room.path().join("again")).unwrap();
    assert_eq!(&Dataset::read(&room.path().join("again")).unwrap().runs[1].data.t, sent);
}

#[test]
fn the_hash_follows_the_content_alone() {
    let base = made_up(20, 2);
    let mut renamed = base.clone();
    renamed.name = "other".into();
    renamed.runs[0].note.clear();
    assert_eq!(renamed.content_hash(), base.content_hash());
    let changes: [fn(&mut Dataset); 5] = [
        |set| set.runs[0].data.tau[(3, 1)] += 1e-9,
        |set| set.runs[1].data.mounting = Mounting::CEILING,
        |set| set.runs[0].role = Role::Validate,
        |set| set.runs[0].data.dq = None,
        |set| set.runs.swap(0, 1),
    ];
    for change in changes {
        let mut changed = base.clone();
        change(&mut changed);
        assert_ne!(changed.content_hash(), base.content_hash());
    }
}

/// Follows the recipe "Add a dataset column" of CONTRIBUTING.md with a quantity that is made up.
#[test]
fn a_quantity_per_joint_is_written_read_and_hashed_where_it_identifies() {
    const MADE_UP: JointColumns =
        JointColumns { stem: "temp", unit: "K", purpose: "a made-up temperature", identifies: false };
    let column = |stem: &str, joint: usize, factor: f64| {
        (format!("{stem}{joint}"), (0..20).map(|k| factor * k as f64 + joint as f64).collect::<Vec<f64>>())
    };
    let with = |stem: &str, factor: f64| {
        let mut set = made_up(20, 2);
        set.runs[0].extra = vec![column(stem, 1, factor), column(stem, 2, factor)];
        set
    };
    let room = tempfile::tempdir().unwrap();
    for known in [&MADE_UP, &columns::DESIRED_POSITIONS, &columns::SERVED_TORQUES] {
        let set = with(known.stem, 0.5);
        set.write(&room.path().join(known.stem)).unwrap();
        let read = Dataset::read(&room.path().join(known.stem)).unwrap();
        let values = known.of(&read.runs[0]).expect("the columns are there");
        assert_eq!((values.shape(), values[(4, 1)]), ((20, 2), 4.0), "{}", known.stem);
        assert!(known.of(&read.runs[1]).is_none());
        let same = with(known.stem, 0.6).content_hash() == set.content_hash();
        assert_eq!(same, !known.identifies, "{}", known.stem);
    }
    // Of one joint alone, or of a joint that the arm does not have.
    for (joints, says) in [(vec![1], "no column `q_d2`"), (vec![1, 2, 3], "column `q_d3`")] {
        let mut set = made_up(20, 2);
        set.runs[0].extra = joints.into_iter().map(|joint| column("q_d", joint, 0.5)).collect();
        let dir = room.path().join(says.replace('`', ""));
        set.write(&dir).unwrap();
        let message = Dataset::read(&dir).expect_err("a refusal").to_string();
        assert!(message.contains("a.csv") && message.contains(says), "{message}");
    }
}

#[test]
fn writing_replaces_a_dataset_and_nothing_else() {
    let room = tempfile::tempdir().unwrap();
    let dir = room.path().join("set");
    made_up(40, 3).write(&dir).unwrap();
    let mut fewer = made_up(20, 2);
    fewer.runs.truncate(1);
    fewer.write(&dir).unwrap();
    assert_eq!(Dataset::read(&dir).unwrap().joints(), 2);
    assert!(!dir.join("b.csv").exists());
    let other = room.path().join("thesis");
    fs::create_dir(&other).unwrap();
    fs::write(other.join("chapter1.tex"), "years of work").unwrap();
    let refused = fewer.write(&other).unwrap_err().to_string();
    assert!(refused.contains("thesis") && refused.contains("not a dataset"), "{refused}");
    assert!(other.join("chapter1.tex").exists());
}

/// Writes the made-up dataset, spoils one file, and returns what reading says.
fn refusal(file: &str, from: &str, to: &str) -> String {
    let room = tempfile::tempdir().unwrap();
    let dir = room.path().join("set");
    made_up(40, 2).write(&dir).unwrap();
    let text = fs::read_to_string(dir.join(file)).unwrap();
    assert!(text.contains(from), "`{from}` not in\n{text}");
    fs::write(dir.join(file), text.replacen(from, to, 1)).unwrap();
    Dataset::read(&dir).expect_err("a refusal").to_string()
}

#[test]
fn bad_descriptions_are_refused_by_key_and_value() {
    let cases = [
        ("unit = \"Nm\"", "unit = \"A\"", "key `torque.gain`: got nothing, expected a gain in Nm/A per joint"),
        ("unit = \"Nm\"", "unit = \"A\"\ngain = [1.0]", "key `torque.gain`: got 1 values, expected 2, one per joint"),
        ("unit = \"Nm\"", "unit = \"A\"\ngain = [1.0, 0.0]", "key `torque.gain`: got 0"),
        ("unit = \"Nm\"", "gain = [1.0, 1.0]\nunit = \"Nm\"", "unit = \"A\""),
        ("unit = \"Nm\"", "unit = \"lbf\"", "key `torque.unit`: got `\"lbf\"`"),
        ("robot = ", "robt = ", "key `robt`"),
        ("role = \"identify\"", "role = \"fit\"", "key `run[0].role`: got `\"fit\"`"),
        ("file = \"b.csv\"", "file = \"c.csv\"", "c.csv: file: got "),
        ("file = \"b.csv\"", "file = \"a.csv\"", "key `run[1].file`: got a.csv"),
        ("file = \"b.csv\"", "file = \"../b.csv\"", "key `run[1].file`: got `../b.csv`"),
        ("session = 2", "session = 0", "key `run[1].session`: got 0"),
        ("start = 3.5", "start = 0.01", "key `run[1].start`: got 0.01, expected a time in s, 0.0"),
        ("start = 3.5", "start = inf", "key `run[1].start`: got inf"),
        ("period = 0.01", "period = 3.0", "key `run[0].period`: got 3"),
        ("phi = 0.0", "phi = 90.0", "key `mounting.phi`: got 90, expected an angle in rad"),
        ("phi = 0.0", "phi = nan", "key `mounting.phi`: got NaN"),
    ];
    for (from, to, expected) in cases {
        let message = refusal("dataset.toml", from, to);
        assert!(message.contains(expected), "`{message}` does not say `{expected}`");
    }
    assert!(refusal("b.csv", "t,q1,q2,tau1,tau2", "t,q1,q2,tau1,tau").contains("no column `tau2`"));
    assert!(refusal("a.csv", "\n0.004,", "\n0.0004,").contains("a.csv: line 6, column t: got 0.0004"));
    assert!(refusal("a.csv", "\n0.004,", "\n0.004,NaN,").contains("a.csv: line 6"));
    let none = Dataset::read(Path::new("no/such/set")).unwrap_err().to_string();
    assert!(none.starts_with("no/such/set/dataset.toml: file: got "), "{none}");
}

#[test]
fn runs_and_robot_agree_on_the_number_of_joints() {
    let room = tempfile::tempdir().unwrap();
    let (two, three) = (room.path().join("two"), room.path().join("three"));
    made_up(40, 2).write(&two).unwrap();
    made_up(40, 3).write(&three).unwrap();
    fs::copy(three.join("b.csv"), two.join("b.csv")).unwrap();
    let message = Dataset::read(&two).unwrap_err().to_string();
    assert!(message.contains("b.csv: line 1, columns q: got q1..q3, expected q1..q2"), "{message}");
    let set = Dataset::read(&three).unwrap();
    assert!(set.expect_joints(3).is_ok());
    assert!(
        set.expect_joints(7)
            .unwrap_err()
            .to_string()
            .contains("got q1..q3, expected q1..q7, the joints of robot `panda`")
    );
}

#[test]
fn hygiene_counts_inserted_faults() {
    let mut run = made_up(100, 2).runs.remove(0);
    run.data.t[10] = run.data.t[9];
    for k in 50..100 {
        run.data.t[k] += 0.02;
    }
    for joint in 0..2 {
        run.data.q[(31, joint)] = run.data.q[(30, joint)];
        run.data.tau[(31, joint)] = run.data.tau[(30, joint)];
    }
    let found = run.hygiene();
    // The sample after the repeated one is two steps away from it: that is a gap as well.
    assert_eq!((found.samples, found.repeated_times, found.repeated_rows, found.gaps), (100, 1, 1, 2));
    assert!((found.dt - 1e-3).abs() < 1e-12 && (found.longest_gap - 0.021).abs() < 1e-12);
}

#[test]
fn the_measured_logs_load() {
    let shared = std::env::var_os("PLUMBLINE_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let data = shared.join("data");
    if !data.exists() {
        eprintln!("SKIPPED the_measured_logs_load: no measured data at {}", data.display());
        return;
    }
    for (name, runs, joints) in [
        ("panda-gaz2019", 2, 7),
        ("kuka-lwr4p", 2, 7),
        ("tx40-figaroh", 1, 6),
        ("ur10-unisa", 1, 6),
        ("ur10e-currents", 5, 6),
        ("panda-unisa", 1, 7),
    ] {
        let set = Dataset::read(&data.join(name)).unwrap();
        assert_eq!((set.name.as_str(), set.runs.len(), set.joints()), (name, runs, joints));
        assert!(!set.source.is_empty());
        for run in &set.runs {
            let found = run.hygiene();
            assert!(found.dt > 5e-4 && found.dt < 0.1, "{name} {}: {found:?}", run.data.name);
            assert!(run.data.tau.iter().all(|tau| tau.abs() < 400.0));
        }
    }
    // Currents become torques: the UR10e carries itself with tens of Nm, not with tens of A.
    let currents = Dataset::read(&data.join("ur10e-currents")).unwrap();
    assert!(currents.runs[0].data.tau.column(1).amax() > 40.0);
}
