//! `plumbline diagnose` on public logs of real arms, with the options of docs/results/real-arms.md: the held-out errors of the joints that the
//! model lacked something in fall below these bounds, and the page says what the program says.
//!
//! The logs are no part of the repository; the tests look for them in `$PLUMBLINE_SHARED/data` (default: `../shared/data` beside the
//! package) and say so when they are not there. One log is diagnosed always; the others take minutes:
//! `cargo test --test identification diagnose_real_logs -- --ignored --nocapture`.

use assert_cmd::cargo::cargo_bin;
use plumbline_testkit::logs;
use std::path::Path;
use std::process::Command;

struct Row {
    dataset: &'static str,
    options: &'static str,
    /// Joints (from 1) and the held-out RMS that they may have afterwards \[Nm\].
    most: &'static [(usize, f64)],
    /// Joints (from 1) and the same as a share of what it was before.
    share: &'static [(usize, f64)],
    /// What no joint's held-out RMS may grow by, as a share: what repeats of these arms leave open is more.
    worse: f64,
}

const QUICK: Row = Row {
    dataset: "tx40-figaroh",
    options: "--torque-cutoff 10",
    most: &[(5, 1.1), (6, 1.1)],
    share: &[(5, 0.2), (6, 0.4)],
    worse: 0.0,
};

const OTHERS: [Row; 8] = [
    Row { dataset: "panda-gaz2019", options: "", most: &[(7, 0.025)], share: &[(6, 0.4), (7, 0.7)], worse: 0.0 },
    Row {
        dataset: "panda-gaz2019",
        options: "--velocities derived --torque-cutoff 6 --band 6",
        most: &[(7, 0.025)],
        share: &[(6, 0.4), (7, 0.5)],
        worse: 0.0,
    },
    Row { dataset: "kuka-lwr4p", options: "", most: &[(6, 0.10), (7, 0.06)], share: &[(5, 0.4)], worse: 0.04 },
    Row { dataset: "kuka-lwr4p", options: "--band 4", most: &[(6, 0.10), (7, 0.06)], share: &[(5, 0.4)], worse: 0.04 },
    Row {
        dataset: "ur10e-currents",
        options: "",
        most: &[],
        share: &[(2, 0.6), (3, 0.7), (4, 0.7), (5, 0.6), (6, 0.8)],
        worse: 0.0,
    },
    Row { dataset: "ur10-unisa", options: "", most: &[], share: &[(1, 0.6), (2, 0.5), (4, 0.6)], worse: 0.0 },
    Row {
        dataset: "fr3-teleop",
        options: "",
        most: &[(2, 0.12), (7, 0.03)],
        share: &[(1, 0.4), (2, 0.7), (4, 0.6), (7, 0.2)],
        worse: 0.0,
    },
    Row { dataset: "kr300", options: "", most: &[], share: &[(1, 0.5), (3, 0.5), (4, 0.6), (6, 0.8)], worse: 0.0 },
];

fn diagnose(dataset: &Path, options: &str) -> serde_json::Value {
    let out = tempfile::tempdir().unwrap();
    let mut command = Command::new(cargo_bin("plumbline"));
    command.arg("diagnose").arg(dataset).arg("--out").arg(out.path());
    let done = command.args(options.split_whitespace()).output().unwrap();
    assert!(done.status.success(), "{}: {}", dataset.display(), String::from_utf8_lossy(&done.stderr));
    let text = std::fs::read_to_string(out.path().join("report.json")).unwrap();
    let mut report: serde_json::Value = serde_json::from_str(&text).unwrap();
    report["diagnosis"].take()
}

fn rms(of: &serde_json::Value) -> Vec<f64> {
    of["validate_rms"].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// Bounds and the page's lines of one row.
fn check(data: &Path, row: &Row) {
    let diagnosis = diagnose(&data.join(row.dataset), row.options);
    let (before, after) = (rms(&diagnosis["before"]), rms(&diagnosis["after"]));
    for (when, rms) in [("before", &before), ("after", &after)] {
        let head = format!("| {} | `{}` | {when} |", row.dataset, row.options).replace("``", "defaults");
        logs::page_says(&head, rms);
    }
    let joint = |joint: usize| (before[joint - 1], after[joint - 1]);
    for &(j, most) in row.most {
        assert!(joint(j).1 <= most, "{}: joint {j} keeps {:.4} Nm of at most {most}", row.dataset, joint(j).1);
    }
    for &(j, share) in row.share {
        let (before, after) = joint(j);
        assert!(after <= share * before, "{}: joint {j} goes from {before:.4} to {after:.4} Nm", row.dataset);
    }
    for (j, (before, after)) in before.iter().zip(&after).enumerate() {
        assert!(*after <= (1.0 + row.worse) * before, "{}: joint {} is worse: {before} {after}", row.dataset, j + 1);
    }
    // Nothing is known of the noise, and the report says so.
    assert_eq!(diagnosis["confirmation"], "no repeats");
    assert!(diagnosis["effects"].as_array().unwrap().iter().all(|effect| effect["confirmed"] == false));
}

#[test]
fn a_wrist_whose_joints_share_a_motor_is_found_in_a_real_log() {
    let Some(data) = logs::data() else { return };
    check(&data, &QUICK);
}

#[test]
#[ignore = "takes minutes"]
fn real_logs_are_predicted_better_with_the_found_effects() {
    let Some(data) = logs::data() else { return };
    OTHERS.iter().for_each(|row| check(&data, row));
}

#[test]
#[ignore = "takes a minute"]
fn currents_read_as_torques_are_a_gain_of_a_joint_and_no_function_of_the_position() {
    let Some(data) = logs::data() else { return };
    let copy = tempfile::tempdir().unwrap();
    for entry in std::fs::read_dir(data.join("ur10e-currents")).unwrap() {
        let entry = entry.unwrap();
        let text = std::fs::read_to_string(entry.path()).unwrap();
        let unscaled =
            |line: &str| if line.starts_with("gain") { "gain = [1, 1, 1, 1, 1, 1]" } else { line }.to_string();
        let text = match entry.file_name().to_str() {
            Some("dataset.toml") => text.lines().map(unscaled).collect::<Vec<_>>().join("\n"),
            _ => text,
        };
        std::fs::write(copy.path().join(entry.file_name()), text).unwrap();
    }
    let diagnosis = diagnose(copy.path(), "");
    let ids: Vec<&str> =
        diagnosis["effects"].as_array().unwrap().iter().map(|effect| effect["id"].as_str().unwrap()).collect();
    assert!(ids.contains(&"torque-gain"), "{ids:?}");
    assert!(!ids.iter().any(|id| id.starts_with("position") || *id == "spring"), "{ids:?}");
}
