//! The paper's Table III, shipped as a model file, predicts another lab's Panda to a few tenths of a Nm.

use nalgebra::DMatrix;
use plumbline::dataset::{Dataset, Run};
use plumbline::store::ModelFile;
use plumbline_core::JointVec;
use plumbline_model::term::Motion;
use plumbline_model::{BaseKind, Mounting, Robot};
use std::path::{Path, PathBuf};

fn table3() -> ModelFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    ModelFile::load(&path, |robot| Ok(Robot::load(robot, None)?.chain)).unwrap_or_else(|bad| panic!("{bad}"))
}

/// Zero-phase Gaussian smoothing with standard deviation `sigma` in samples; the ends see the samples that there are.
fn smooth(signal: &[f64], sigma: f64) -> Vec<f64> {
    let reach = (4.0 * sigma) as usize;
    let kernel: Vec<f64> = (0..=reach).map(|k| (-0.5 * (k as f64 / sigma).powi(2)).exp()).collect();
    (0..signal.len())
        .map(|k| {
            let near = k.saturating_sub(reach)..(k + reach + 1).min(signal.len());
            let weight = |i: usize| kernel[i.abs_diff(k)];
            near.clone().map(|i| weight(i) * signal[i]).sum::<f64>() / near.map(weight).sum::<f64>()
        })
        .collect()
}

/// Linear interpolation onto an even 1 ms grid.
fn even(run: &Run, column: &[f64]) -> Vec<f64> {
    let (first, last) = (run.data.t[0], run.data.t[run.data.t.len() - 1]);
    let mut k = 0;
    (0..((last - first) / 1e-3) as usize)
        .map(|step| {
            let t = first + step as f64 * 1e-3;
            while run.data.t[k + 1] <= t {
                k += 1;
            }
            let share = (t - run.data.t[k]) / (run.data.t[k + 1] - run.data.t[k]);
            column[k] + share * (column[k + 1] - column[k])
        })
        .collect()
}

fn central(signal: &[f64]) -> Vec<f64> {
    let last = signal.len() - 1;
    (0..=last).map(|k| (signal[(k + 1).min(last)] - signal[k.saturating_sub(1)]) / 2e-3).collect()
}

/// Sum over samples of the squared error of each joint, and their number; half a second of both ends is left out.
///
/// Torque and model pass the same filter (about 9 Hz), the positions a narrower one (about 4 Hz) before their derivatives.
fn errors(model: &ModelFile, run: &Run) -> (JointVec, f64) {
    let columns = |block: &DMatrix<f64>| -> Vec<Vec<f64>> {
        block.column_iter().map(|column| even(run, column.clone_owned().as_slice())).collect()
    };
    let q: Vec<_> = columns(&run.data.q).iter().map(|q| smooth(q, 33.0)).collect();
    let dq: Vec<_> = q.iter().map(|q| central(q)).collect();
    let ddq: Vec<_> = dq.iter().map(|dq| central(dq)).collect();
    let tau = columns(&run.data.tau);
    let samples = q[0].len();
    let block = |from: &[Vec<f64>]| DMatrix::from_fn(samples, 7, |k, j| from[j][k]);
    let gravity = run.data.mounting.gravity();
    let motion =
        Motion { dt: 1e-3, q: block(&q), dq: block(&dq), ddq: block(&ddq), gravity, periodic: false, start: 0.0 };
    let modelled = model.model.predict(&motion);
    let mut squares = JointVec::default();
    for j in 0..7 {
        let error: Vec<f64> = (0..samples).map(|k| tau[j][k] - modelled[(k, j)]).collect();
        squares[j] = smooth(&error, 15.0)[500..samples - 500].iter().map(|error| error * error).sum();
    }
    (squares, (samples - 1000) as f64)
}

#[test]
fn the_papers_table_predicts_the_panda_of_another_laboratory() {
    let shared = std::env::var_os("PLUMBLINE_SHARED")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let data = shared.join("data/panda-gaz2019");
    if !data.exists() {
        eprintln!(
            "SKIPPED the_papers_table_predicts_the_panda_of_another_laboratory: no measured data at {}",
            data.display()
        );
        return;
    }
    let set = Dataset::read(&data).unwrap();
    let model = table3();
    let (mut squares, mut samples) = (JointVec::default(), 0.0);
    for run in &set.runs {
        let (more, count) = errors(&model, run);
        squares.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        samples += count;
    }
    let expected = [0.36, 0.85, 0.26, 0.43, 0.10, 0.27, 0.07];
    for j in 0..7 {
        let rms = (squares[j] / samples).sqrt();
        println!("joint {}: {rms:.3} Nm", j + 1);
        assert!((rms - expected[j]).abs() < 0.03, "joint {}: {rms} Nm, expected {} Nm", j + 1, expected[j]);
    }
}

#[test]
fn the_shipped_table_is_complete_and_round_trips() {
    let file = table3();
    assert_eq!((file.model.parameters().len(), file.model.kind()), (59, BaseKind::Gbs));
    assert_eq!(file.model.mountings(), [Mounting::WALL]);
    assert!(file.model.parameters().iter().all(|parameter| parameter.std.is_none()));
    // The shipped text is what the program writes itself, under a comment of its own and without the seal of an identified model.
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    let body = |text: &str| text.lines().skip_while(|line| line.starts_with(['#', 'c'])).collect::<Vec<_>>().join("\n");
    assert_eq!(body(&std::fs::read_to_string(path).unwrap()), body(&file.to_toml()));
}
