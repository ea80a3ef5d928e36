//! `plumbline identify` on public logs of six real arms, with the options of docs/results/real-arms.md: held-out RMS at or below the figures
//! to beat, and the page says what the program says.
//!
//! The logs are no part of the repository; the tests look for them in `$PLUMBLINE_SHARED/data` (default: `../shared/data` beside the
//! package) and say so when they are not there.

use assert_cmd::cargo::cargo_bin;
use plumbline_testkit::logs;
use std::path::Path;
use std::process::Command;

/// One row of docs/results/real-arms.md.
struct Row {
    dataset: &'static str,
    options: &'static str,
    /// The figure to beat as it is printed, per joint \[Nm\]; none where joint 7 has none.
    beat: &'static [&'static str],
    /// Joints (from 1) that stay above it, and the highest RMS seen there \[Nm\].
    above: &'static [(usize, f64)],
}

/// Every log at one setting, the default, and where that is above the figure to beat, at the setting that is not.
const ROWS: [Row; 8] = [
    Row {
        dataset: "panda-gaz2019",
        options: "",
        beat: &[".15", ".17", ".14", ".15", ".07", ".03", ".046"],
        above: &[],
    },
    Row {
        dataset: "kuka-lwr4p",
        options: "",
        beat: &[".22", ".29", ".24", ".22", ".23", ".18", ".13"],
        above: &[(5, 0.27)],
    },
    Row {
        dataset: "kuka-lwr4p",
        options: "--trim 2 --estimator ols",
        beat: &[".22", ".29", ".24", ".22", ".23", ".18", ".13"],
        above: &[],
    },
    Row {
        dataset: "tx40-figaroh",
        options: "--keep-rests --position-cutoff 10",
        beat: &["2.1", "4.1", "1.1", ".59", "5.7", "2.3"],
        above: &[],
    },
    Row {
        dataset: "ur10e-currents",
        options: "",
        beat: &["2.5", "3.8", "1.28", ".33", ".51", ".44"],
        above: &[(3, 1.65)],
    },
    Row { dataset: "ur10-unisa", options: "", beat: &["2.8", "3.6", "1.8", ".9", ".4", "1.9"], above: &[] },
    Row {
        dataset: "panda-unisa",
        options: "--hold-out 0.25 --trim 0.5",
        beat: &[".29", ".19", ".20", ".14", ".14", ".06"],
        above: &[(4, 0.17)],
    },
    Row {
        dataset: "panda-unisa",
        options: "--hold-out 0.25 --trim 0.5 --torque-cutoff 2.5",
        beat: &[".29", ".19", ".20", ".14", ".14", ".06"],
        above: &[],
    },
];

/// Held-out RMS per joint, pooled over the runs, behind the low-pass \[Nm\].
fn identify(data: &Path, row: &Row) -> Vec<f64> {
    let out = tempfile::tempdir().unwrap();
    let mut command = Command::new(cargo_bin("plumbline"));
    command.arg("identify").arg(data.join(row.dataset)).arg("--out").arg(out.path());
    let done = command.args(row.options.split_whitespace()).output().unwrap();
    assert!(done.status.success(), "{}: {}", row.dataset, String::from_utf8_lossy(&done.stderr));
    let text = std::fs::read_to_string(out.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let runs: Vec<Vec<f64>> =
        report["validate"].as_array().unwrap().iter().map(|run| numbers(&run["rms_filtered"])).collect();
    (0..runs[0].len())
        .map(|j| (runs.iter().map(|rms| rms[j].powi(2)).sum::<f64>() / runs.len() as f64).sqrt())
        .collect()
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

/// The least number that is printed higher than this one.
fn rounds_up(printed: &str) -> f64 {
    let decimals = printed.split('.').nth(1).map_or(0, str::len) as i32;
    printed.parse::<f64>().unwrap() + 0.5 * 10f64.powi(-decimals)
}

#[test]
fn real_logs_are_identified_at_or_below_the_figures_to_beat() {
    let Some(data) = logs::data() else { return };
    for row in &ROWS {
        let rms = identify(&data, row);
        for (j, (rms, beat)) in rms.iter().zip(row.beat).enumerate() {
            let bound = row.above.iter().find(|above| above.0 == j + 1).map_or(rounds_up(beat), |above| above.1);
            assert!(
                *rms < bound,
                "{} {}: joint {} has {rms:.4} Nm, expected less than {bound}",
                row.dataset,
                row.options,
                j + 1
            );
        }
        let head = format!("| {} | `{}` |", row.dataset, row.options).replace("``", "defaults");
        logs::page_says(&head, &rms);
    }
}
