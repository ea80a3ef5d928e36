//! The errors before and after that a report states, computed once more from the dataset's files by another route: the mean period and its
//! derivatives by plain Fourier sums, torques as `Y beta` of the model files. The report takes them from the evaluator of the loop.
//!
//! What the report states of a dataset: root mean square of measured minus modelled torque of the mean period, behind the torque low-pass,
//! over the unseen runs without the first (that one decides on findings). The motion is the mean one less what the encoders' noise explains.

use nalgebra::{DMatrix, DVector};
use plumbline::dataset::{Dataset, Role, Run};
use plumbline::report::Report;
use plumbline::store::ModelFile;
use plumbline_model::Robot;
use plumbline_model::term::Motion;
use plumbline_testkit::job::*;
use plumbline_testkit::scene;
use plumbline_testkit::scene::lab::{Noise, period, plans};
use plumbline_testkit::sim::arm_with;
use std::f64::consts::{PI, TAU};
use std::path::Path;

/// Every so many-th millisecond is recorded.
const EVERY: usize = 4;
const DT: f64 = EVERY as f64 * scene::DT;
const PERIODS: usize = 3;
const POSITION_CUTOFF: f64 = 40.0;
const TORQUE_CUTOFF: f64 = 5.0;
const ORDER: i32 = 8;

/// Gain of a digital Butterworth low-pass, forward and backward.
fn gain(f: f64, cutoff: f64) -> f64 {
    1.0 / (1.0 + ((PI * f * DT).tan() / (PI * cutoff * DT).tan()).powi(2 * ORDER))
}

/// `sum_k x_k cos(2 pi m k / n)` and the same with the sine, for each `m` that the low-pass lets pass.
fn fourier_sums(x: &[f64], cutoff: f64) -> Vec<(f64, f64)> {
    let n = x.len();
    let table: Vec<(f64, f64)> = (0..n).map(|k| (TAU * k as f64 / n as f64).sin_cos()).collect();
    let passes = |m: &usize| gain(*m as f64 / (n as f64 * DT), cutoff) >= 1e-12;
    let sums = |m: usize| {
        x.iter().enumerate().fold((0.0, 0.0), |(a, b), (k, x)| {
            let (sin, cos) = table[m * k % n];
            (a + x * cos, b + x * sin)
        })
    };
    (0..n / 2).take_while(passes).map(sums).collect()
}

/// A periodic signal of `n` samples with these [`fourier_sums`] behind the low-pass, with its first two derivatives: `[x, dx, ddx]`.
fn low_passed(sums: &[(f64, f64)], n: usize, cutoff: f64) -> [Vec<f64>; 3] {
    let table: Vec<(f64, f64)> = (0..n).map(|k| (TAU * k as f64 / n as f64).sin_cos()).collect();
    let mut out = [vec![0.0; n], vec![0.0; n], vec![0.0; n]];
    for (m, (a, b)) in sums.iter().enumerate() {
        let f = m as f64 / (n as f64 * DT);
        let scale = gain(f, cutoff) * if m == 0 { 1.0 } else { 2.0 } / n as f64;
        let (a, b, w) = (scale * a, scale * b, TAU * f);
        for k in 0..n {
            let (sin, cos) = table[m * k % n];
            out[0][k] += a * cos + b * sin;
            out[1][k] += w * (b * cos - a * sin);
            out[2][k] -= w * w * (a * cos + b * sin);
        }
    }
    out
}

/// The periods of every column of a run's file: `t, q1..q7, tau1..tau7`.
fn periods(file: &Path, samples: usize) -> Vec<[Vec<f64>; PERIODS]> {
    let text = std::fs::read_to_string(file).unwrap();
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), PERIODS * samples);
    let period = |column: usize, p: usize| rows[p * samples..][..samples].iter().map(|row| row[column]).collect();
    (0..rows[0].len()).map(|column| std::array::from_fn(|p| period(column, p))).collect()
}

fn mean(periods: &[Vec<f64>; PERIODS]) -> Vec<f64> {
    let sample = |k: usize| periods.iter().map(|period| period[k]).sum::<f64>() / PERIODS as f64;
    (0..periods[0].len()).map(sample).collect()
}

/// Sums of a joint's mean position less what the noise explains, `max(0, 1 - N_m / S_m)` of each (Wiener's filter): `S_m` is the power of the mean
/// and `N_m` a third of that of the deviations, which have two degrees of freedom, averaged over four frequencies on each side.
fn motion_sums(periods: &[Vec<f64>; PERIODS]) -> Vec<(f64, f64)> {
    let mean = mean(periods);
    let power = |sums: &[(f64, f64)]| sums.iter().map(|(a, b)| a * a + b * b).collect::<Vec<f64>>();
    let deviation = |period: &Vec<f64>| period.iter().zip(&mean).map(|(x, mean)| x - mean).collect::<Vec<f64>>();
    let deviations = periods.each_ref().map(|period| power(&fourier_sums(&deviation(period), POSITION_CUTOFF)));
    let mut sums = fourier_sums(&mean, POSITION_CUTOFF);
    let powers = power(&sums);
    for (m, (a, b)) in sums.iter_mut().enumerate().skip(1) {
        let around = m.saturating_sub(4).max(1)..(m + 5).min(powers.len());
        let of_mean: f64 = powers[around.clone()].iter().sum();
        let of_noise: f64 = deviations.iter().flat_map(|one| &one[around.clone()]).sum::<f64>() / 2.0 / PERIODS as f64;
        let share = f64::max(0.0, 1.0 - of_noise / of_mean);
        (*a, *b) = (share * *a, share * *b);
    }
    sums
}

/// RMS of each joint over these runs by the definition at the head of this file.
fn errors(
    model: &Path,
    files: &[std::path::PathBuf],
    mounting: &plumbline_model::Mounting,
    samples: usize,
) -> Vec<f64> {
    let file = ModelFile::load(model, |name| Ok(Robot::load(name, None)?.chain)).unwrap();
    let beta = DVector::from_vec(file.model.beta());
    let mut squares = [0.0; 7];
    for path in files {
        let columns = periods(path, samples);
        let zeros = || DMatrix::zeros(samples, 7);
        let gravity = mounting.gravity();
        let mut motion = Motion { dt: DT, q: zeros(), dq: zeros(), ddq: zeros(), gravity, periodic: true, start: 0.0 };
        for j in 0..7 {
            let [q, dq, ddq] = low_passed(&motion_sums(&columns[1 + j]), samples, POSITION_CUTOFF);
            motion.q.set_column(j, &DVector::from_vec(q));
            motion.dq.set_column(j, &DVector::from_vec(dq));
            motion.ddq.set_column(j, &DVector::from_vec(ddq));
        }
        let modelled = file.model.structure().regressor(&motion) * &beta;
        for (j, square) in squares.iter_mut().enumerate() {
            let measured = mean(&columns[8 + j]).into_iter();
            let residual: Vec<f64> = measured.enumerate().map(|(k, tau)| tau - modelled[j * samples + k]).collect();
            let filtered = &low_passed(&fourier_sums(&residual, TORQUE_CUTOFF), samples, TORQUE_CUTOFF)[0];
            *square += filtered.iter().map(|x| x * x).sum::<f64>();
        }
    }
    squares.iter().map(|square| (square / (files.len() * samples) as f64).sqrt()).collect()
}

/// Records motions of an arm with an offset that nobody declared, 0.3 Nm in joint 5, as a dataset in files.
fn record(folder: &Path) -> (Dataset, usize) {
    let truth = arm_with("sim-panda", "[[effect]]\nid = \"torque-offset\"\njoint = 5\noffset = 0.3\n");
    let chain = Robot::load("panda", None).unwrap().chain;
    let [identify, validate] = plans();
    let mounting = identify[0].mounting();
    let mut runs = Vec::new();
    let mut samples = 0;
    let third = identify[2].clone();
    let all = identify.into_iter().take(2).map(|plan| (plan, Role::Identify));
    // The first unseen run decides on findings, the errors are those of the two others.
    let all = all.chain(validate.into_iter().chain([third]).map(|plan| (plan, Role::Validate)));
    for (number, (plan, role)) in all.enumerate() {
        let period = period(&chain, &truth, &plan, mounting, "");
        let recorded = period.record(&truth, PERIODS, Noise { coloured: 0.02 }, 40 + number as u64);
        let rows: Vec<usize> = (0..recorded.t.len()).step_by(EVERY).collect();
        samples = period.q.nrows() / EVERY;
        let data = plumbline_identify::Run {
            name: format!("run-{}.csv", number + 1),
            t: rows.iter().map(|&k| recorded.t[k]).collect(),
            q: recorded.q.select_rows(&rows),
            tau: recorded.tau.select_rows(&rows),
            ..recorded
        };
        runs.push(Run::new(data, role));
    }
    let dataset =
        Dataset { name: "undeclared".into(), robot: "panda".into(), mounting, source: toml::Table::new(), runs };
    dataset.write(folder).unwrap();
    (dataset, samples)
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn the_errors_before_and_after_are_those_of_the_files() {
    let place = Place::new("held-out-errors");
    let data = place.path().join("data");
    let (dataset, samples) = record(&data);
    let run = |subcommand: &str, more: &[&str]| {
        let out = place.path().join(subcommand);
        Done::of(plumbline().arg(subcommand).arg(&data).arg("--out").arg(&out).args(more).args([
            "--position-cutoff",
            "40",
            "--torque-cutoff",
            "5",
        ]))
        .expect_code(0);
        out
    };
    let diagnosed = run("diagnose", &[]);
    // The plain model that the diagnosis starts from.
    let plain = run("identify", &["--terms", "friction"]);
    let text = std::fs::read_to_string(diagnosed.join("report.json")).unwrap();
    let report: Report = serde_json::from_str(&text).unwrap();
    let found = report.diagnosis.unwrap();
    assert_eq!(found.held_out_runs, ["run-4.csv", "run-5.csv"]);
    let files: Vec<_> = found.held_out_runs.iter().map(|name| data.join(name)).collect();
    let before = errors(&plain.join("model.toml"), &files, &dataset.mounting, samples);
    let after = errors(&diagnosed.join("model.toml"), &files, &dataset.mounting, samples);
    let change = found.change.unwrap();
    for j in 0..7 {
        let stated = (found.before.validate_rms[j], found.after.validate_rms[j]);
        println!("joint {}: stated {stated:?}, from the files {} {}", j + 1, before[j], after[j]);
        assert!((stated.0 / before[j] - 1.0).abs() < 1e-6, "joint {}: before {} {}", j + 1, stated.0, before[j]);
        assert!((stated.1 / after[j] - 1.0).abs() < 1e-6, "joint {}: after {} {}", j + 1, stated.1, after[j]);
        assert!((change.validate_rms[j] - (after[j] - before[j])).abs() < 1e-6 * before[j], "joint {}", j + 1);
    }
    // The two differ, so one can't stand for the other.
    assert!(after[4] < 0.5 * before[4], "{before:?} {after:?}");
}
