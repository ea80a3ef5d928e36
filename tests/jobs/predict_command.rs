//! `plumbline predict`: the torques in its file belong to the time stamps beside them.

use nalgebra::DMatrix;
use plumbline::dataset::{self, Dataset, Role};
use plumbline::store::ModelFile;
use plumbline_model::term::Motion;
use plumbline_model::{Mounting, Robot};
use plumbline_testkit::job::*;
use plumbline_testkit::scene::lab::{self, Noise, Period};
use plumbline_testkit::{logs, sim};
use rand::{Rng, SeedableRng};
use std::fmt::Write;
use std::path::{Path, PathBuf};

const MODEL: &str = "config/models/panda-paper-table3.toml";
const JOINTS: usize = 7;

struct Row {
    t: f64,
    tau: [f64; JOINTS],
    at_end: bool,
}

/// Rows that `plumbline predict` writes for a motion, and the raw errors that the program prints.
fn predict(place: &Place, run: &Path, more: &[&str]) -> (Vec<Row>, Option<Vec<f64>>) {
    let out = place.path().join("tau.csv");
    let done = Done::of(plumbline().args(["predict", MODEL]).arg(run).arg("--out").arg(&out).args(more)).expect_code(0);
    let printed = done.out.split("raw ").nth(1).map(|rest| {
        let values = rest.split(" |").next().unwrap();
        values.split(' ').map(|value| value.parse().unwrap()).collect()
    });
    (rows(&out), printed)
}

fn rows(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("t,tau1,tau2,tau3,tau4,tau5,tau6,tau7,at_end"));
    let row = |line: &str| {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        assert!(cells.iter().all(|cell| cell.is_finite()), "{line}");
        Row { t: cells[0], tau: cells[1..=JOINTS].try_into().unwrap(), at_end: cells[JOINTS + 1] == 1.0 }
    };
    lines.map(row).collect()
}

/// Position, velocity and acceleration of a joint: two sines, at most 1.3 Hz.
fn motion(joint: usize, t: f64) -> [f64; 3] {
    let middle = [0.1, -0.3, 0.2, -1.9, 0.1, 1.8, 0.3][joint];
    let each = [(0.25, 0.31 + 0.07 * joint as f64, 0.4), (0.05, 0.9 + 0.06 * joint as f64, 1.1)];
    each.iter().enumerate().fold([middle, 0.0, 0.0], |[q, dq, ddq], (k, (height, frequency, phase))| {
        let w = std::f64::consts::TAU * frequency;
        let (sin, cos) = (w * t + phase + (joint + k) as f64).sin_cos();
        [q + height * sin, dq + height * w * cos, ddq - height * w * w * sin]
    })
}

/// Writes the positions at these times, without velocities and torques; gives the true torques.
fn recorded(path: &PathBuf, t: &[f64]) -> DMatrix<f64> {
    let mut text = String::from("t,q1,q2,q3,q4,q5,q6,q7\n");
    for &t in t {
        let q: Vec<String> = (0..JOINTS).map(|j| motion(j, t)[0].to_string()).collect();
        writeln!(text, "{t},{}", q.join(",")).unwrap();
    }
    std::fs::write(path, text).unwrap();
    let file = ModelFile::load(Path::new(MODEL), |name| Ok(Robot::load(name, None)?.chain)).unwrap();
    let of = |what: usize| DMatrix::from_fn(t.len(), JOINTS, |k, j| motion(j, t[k])[what]);
    // Its terms have no memory: the time between the samples is of no importance.
    let (gravity, periodic) = (Mounting::WALL.gravity(), false);
    file.model.predict(&Motion { dt: 1e-3, q: of(0), dq: of(1), ddq: of(2), gravity, periodic, start: 0.0 })
}

/// RMS of some rows' errors, worst joint \[Nm\].
fn worst(rows: &[Row], truth: &DMatrix<f64>, counted: impl Fn(&Row) -> bool) -> f64 {
    let error = |j: usize| {
        let own = rows.iter().enumerate().filter(|(_, row)| counted(row));
        let squares: Vec<f64> = own.map(|(k, row)| (row.tau[j] - truth[(k, j)]).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    (0..JOINTS).map(error).fold(0.0, f64::max)
}

#[test]
fn every_time_stamp_has_its_own_torque() {
    let place = Place::new("predict-time");
    let run = place.path().join("run.csv");
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    // Recordings that begin at 0 and elsewhere, at an even and at an uneven pace, with samples missing.
    for (name, start, dt, jitter, missing) in [
        ("even", 0.0, 0.001, 0.0, 0.0),
        ("even, later", 731.25, 0.001, 0.0, 0.0),
        ("uneven", 12.5, 0.002, 0.3, 0.0),
        ("slow, uneven, with gaps", 3.0, 0.005, 0.3, 0.05),
    ] {
        let mut t = Vec::new();
        for k in 0..(8.0 / dt) as usize {
            let time = start + (k as f64 + jitter * rng.random_range(-1.0..1.0)) * dt;
            if !rng.random_bool(missing) {
                t.push(time);
            }
        }
        let truth = recorded(&run, &t);
        let (rows, _) = predict(&place, &run, &["--mounting", "wall"]);
        assert_eq!(rows.iter().map(|row| row.t).collect::<Vec<_>>(), t, "{name}");
        let (inside, ends) = (worst(&rows, &truth, |row| !row.at_end), worst(&rows, &truth, |row| row.at_end));
        // What 0.05 s too early would be.
        let early = DMatrix::from_fn(t.len(), JOINTS, |k, j| truth[(k.saturating_sub((0.05 / dt) as usize), j)]);
        let shifted = worst(&rows, &early, |row| !row.at_end);
        println!("{name}: {inside:.4} Nm inside, {ends:.4} at the ends, {shifted:.4} where the truth is 0.05 s late");
        assert!(inside < 0.06 && ends < 0.5 && shifted > 5.0 * inside, "{name}: {inside} {ends} {shifted}");
        // The marked samples are those within 0.05 s of an end.
        for row in &rows {
            let end = (row.t - t[0]).min(t[t.len() - 1] - row.t);
            assert!((end - 0.05).abs() < 2.0 * dt || row.at_end == (end < 0.05), "{name}: {end} {}", row.at_end);
        }
    }
}

#[test]
fn the_file_has_the_errors_that_the_program_prints() {
    let Some(data) = logs::data() else { return };
    let place = Place::new("predict-file");
    let path = data.join("panda-gaz2019/excitation_b.csv");
    let (rows, printed) = predict(&place, &path, &[]);
    let printed = printed.unwrap();
    let run = plumbline::dataset::Run::read(&path, Mounting::UPRIGHT).unwrap();
    assert_eq!(rows.len(), run.samples());
    for (j, printed) in printed.iter().enumerate() {
        let inside = || rows.iter().enumerate().filter(|(_, row)| !row.at_end);
        let square: f64 = inside().map(|(k, row)| (row.tau[j] - run.data.tau[(k, j)]).powi(2)).sum();
        let of_file = (square / inside().count() as f64).sqrt();
        println!("joint {}: {of_file:.3} Nm in the file, {printed} printed", j + 1);
        // The program counts samples of the even grid, the file those of the recording.
        assert!((of_file - printed).abs() < 0.01 * printed + 0.002, "joint {}: {of_file} {printed}", j + 1);
    }
}

/// Rows of a CSV file as columns by name.
fn columns(path: &Path) -> std::collections::BTreeMap<String, Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut columns = vec![Vec::new(); names.len()];
    for line in lines {
        let cells = line.split(',').map(|cell| cell.parse().unwrap());
        columns.iter_mut().zip(cells).for_each(|(column, cell): (&mut Vec<f64>, f64)| column.push(cell));
    }
    names.into_iter().map(str::to_string).zip(columns).collect()
}

/// One run of a dataset: every second sample of a recording.
fn thinned(period: &Period, truth: &plumbline_sim::Truth, periods: usize, noise: Noise, seed: u64) -> dataset::Run {
    let run = period.record(truth, periods, noise, seed);
    let rows: Vec<usize> = (0..run.t.len()).step_by(2).collect();
    let data = plumbline_identify::Run {
        name: format!("{}.csv", run.name),
        t: rows.iter().map(|&k| run.t[k]).collect(),
        q: run.q.select_rows(&rows),
        tau: run.tau.select_rows(&rows),
        ..run
    };
    dataset::Run::new(data, if period.name.starts_with('v') { Role::Validate } else { Role::Identify })
}

/// Identifies a model from two motions of a simulated arm, predicts an unseen third one, and gives the share of its measured torques in the interval, per
/// joint, from the file.
fn coverage_on_unseen_motion(place: &Place, motions: &[Period; 3], noise: Noise, seed: u64) -> Vec<f64> {
    let truth = sim::arm("sim-panda");
    let run = |(k, (motion, periods)): (usize, (&Period, usize))| {
        thinned(motion, &truth, periods, noise, 10 * seed + k as u64)
    };
    let runs: Vec<dataset::Run> = motions.iter().zip([3, 3, 1]).enumerate().map(run).collect();
    let measured = runs[2].data.clone();
    let (source, mounting) = (toml::Table::new(), Mounting::WALL);
    let folder = place.path().join("dataset");
    Dataset { name: "intervals".into(), robot: "panda".into(), mounting, source, runs }.write(&folder).unwrap();
    let (model, out) = (place.path().join("model"), place.path().join("tau.csv"));
    Done::of(plumbline().arg("identify").arg(&folder).arg("--out").arg(&model)).expect_code(0);
    let mut predict = plumbline();
    predict.arg("predict").arg(model.join("model.toml")).arg(folder.join(&measured.name)).arg("--out").arg(&out);
    let done = Done::of(predict).expect_code(0);

    let file = columns(&out);
    let of = |name: String| &file[&name];
    let counted: Vec<usize> = (0..measured.t.len()).filter(|&k| of("at_end".into())[k] == 0.0).collect();
    let share = |j: usize| {
        let (tau, low, high) =
            (of(format!("tau{}", j + 1)), of(format!("tau{}_low", j + 1)), of(format!("tau{}_high", j + 1)));
        assert!(counted.iter().all(|&k| (0.5 * (low[k] + high[k]) - tau[k]).abs() < 1e-9 && low[k] < high[k]));
        counted.iter().filter(|&&k| (low[k]..=high[k]).contains(&measured.tau[(k, j)])).count() as f64
            / counted.len() as f64
    };
    let coverage: Vec<f64> = (0..JOINTS).map(share).collect();
    let printed = done.out.split("prediction interval [%]: ").nth(1).expect("a line").lines().next().unwrap();
    let expected: Vec<String> = coverage.iter().map(|share| format!("{:.1}", 100.0 * share)).collect();
    assert_eq!(printed, expected.join(" "));
    coverage
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn prediction_intervals_hold_the_torques_of_unseen_motion() {
    let place = Place::new("predict-intervals");
    let (truth, chain) = (sim::arm("sim-panda"), sim::panda());
    let [identify, validate] = lab::plans();
    let plans = [("identify-1", &identify[0]), ("identify-2", &identify[1]), ("validate-1", &validate[0])];
    let motions = plans.map(|(name, plan)| lab::period(&chain, &truth, plan, Mounting::WALL, name));
    for seed in 0..4 {
        let coverage = coverage_on_unseen_motion(&place, &motions, Noise::default(), seed);
        println!("white noise, seed {seed}: {coverage:.3?}");
        assert!(coverage.iter().all(|share| (0.93..0.97).contains(share)), "seed {seed}: {coverage:?}");
    }
    let mut all = Vec::new();
    for seed in 0..4 {
        let coverage = coverage_on_unseen_motion(&place, &motions, Noise { coloured: 0.15 }, seed);
        println!("with coloured noise, seed {seed}: {coverage:.3?}");
        all.extend(coverage);
    }
    println!("with coloured noise: {:.3} of all", mean(&all));
    // Half of the noise's variance and more has a correlation time of 0.3 s: 10 s of it are some 17 independent values, so the share scatters by about 0.02.
    assert!((0.935..0.965).contains(&mean(&all)) && all.iter().all(|share| *share > 0.88), "{all:?}");
}

#[test]
fn a_model_without_uncertainty_gets_no_interval() {
    let place = Place::new("predict-no-interval");
    let run = place.path().join("run.csv");
    recorded(&run, &(0..2000).map(|k| 0.001 * k as f64).collect::<Vec<_>>());
    let out = place.path().join("tau.csv");
    let done = Done::of(plumbline().args(["predict", MODEL]).arg(&run).arg("--out").arg(&out)).expect_code(0);
    assert!(!done.out.contains("interval"), "{}", done.out);
    assert!(!columns(&out).keys().any(|name| name.contains("_low") || name.contains("_high")));
}
