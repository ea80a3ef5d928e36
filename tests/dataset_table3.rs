//! The paper's Table III, shipped as a model file, predicts another lab's Panda as PAPER-NOTES says it does.

use nalgebra::DMatrix;
use plumbline::dataset::{Dataset, Run};
use plumbline::joint::JointVec;
use plumbline::model::base::BaseKind;
use plumbline::model::chain::{Chain, Joint, JointKind, Placement};
use plumbline::model::gravity::Mounting;
use plumbline::model::term::Motion;
use plumbline::store::ModelFile;
use std::f64::consts::FRAC_PI_2;
use std::path::{Path, PathBuf};

fn panda() -> Chain {
    let a = [0.0, 0.0, 0.0, 0.0825, -0.0825, 0.0, 0.088];
    let alpha = [0.0, -1.0, 1.0, 1.0, -1.0, 1.0, 1.0];
    let d = [0.333, 0.0, 0.316, 0.0, 0.384, 0.0, 0.0];
    let row = |i: usize| Joint { kind: JointKind::Revolute, a: a[i], alpha: alpha[i] * FRAC_PI_2, d: d[i], theta: 0.0 };
    Chain::modified((0..7).map(row).collect(), Placement::identity())
}

fn table3() -> ModelFile {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    ModelFile::load(&path, |_| Ok(panda())).unwrap_or_else(|bad| panic!("{bad}"))
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
    let (first, last) = (run.t[0], run.t[run.t.len() - 1]);
    let mut k = 0;
    (0..((last - first) / 1e-3) as usize)
        .map(|step| {
            let t = first + step as f64 * 1e-3;
            while run.t[k + 1] <= t {
                k += 1;
            }
            let share = (t - run.t[k]) / (run.t[k + 1] - run.t[k]);
            column[k] + share * (column[k + 1] - column[k])
        })
        .collect()
}

fn central(signal: &[f64]) -> Vec<f64> {
    let last = signal.len() - 1;
    (0..=last).map(|k| (signal[(k + 1).min(last)] - signal[k.saturating_sub(1)]) / 2e-3).collect()
}

/// Mean squares of raw torque minus prediction, and of the torque itself, per joint, half a second of both ends left out.
fn errors(model: &ModelFile, run: &Run, sigma: f64) -> (JointVec, JointVec, JointVec, JointVec, f64) {
    let columns = |block: &DMatrix<f64>| -> Vec<Vec<f64>> {
        block.column_iter().map(|column| even(run, column.clone_owned().as_slice())).collect()
    };
    let q: Vec<_> = columns(&run.q).iter().map(|q| smooth(q, sigma)).collect();
    let dq: Vec<_> = q.iter().map(|q| central(q)).collect();
    let ddq: Vec<_> = dq.iter().map(|dq| central(dq)).collect();
    let tau = columns(&run.tau);
    let samples = q[0].len();
    let block = |from: &[Vec<f64>]| DMatrix::from_fn(samples, 7, |k, j| from[j][k]);
    let gravity = run.mounting.gravity();
    let motion = Motion { dt: 1e-3, q: block(&q), dq: block(&dq), ddq: block(&ddq), gravity, periodic: false };
    let modelled = model.model.predict(&motion);
    let (mut error, mut signal, mut m1, mut m2) = (JointVec::default(), JointVec::default(), JointVec::default(), JointVec::default());
    for k in 500..samples - 500 {
        for j in 0..7 {
            m1[j] += tau[j][k] - modelled[(k, j)]; m2[j] += tau[j][k];
            error[j] += (tau[j][k] - modelled[(k, j)]).powi(2);
            signal[j] += tau[j][k].powi(2);
        }
    }
    (error, signal, m1, m2, (samples - 1000) as f64)
}

#[test]
fn explore() {
    let shared = PathBuf::from("/work/shared");
    let set = Dataset::read(&shared.join("data/panda-gaz2019")).unwrap();
    let model = table3();
    for sigma in [5.0, 10.0, 20.0, 30.0, 45.0] {
        for which in [vec![0], vec![1], vec![0, 1]] {
            let (mut e, mut s, mut n) = ([0.0; 8], [0.0; 8], 0.0);
            let (mut m1, mut m2) = ([0.0; 8], [0.0; 8]);
            for &w in &which {
                let (a, b, x1, x2, c) = errors(&model, &set.runs[w], sigma);
                for j in 0..7 {
                    e[j] += a[j];
                    s[j] += b[j]; m1[j] += x1[j]; m2[j] += x2[j];
                }
                n += c;
            }
            let f = |x: [f64; 8]| x[..7].iter().map(|v| format!("{:.3}", (v / n).sqrt())).collect::<Vec<_>>().join(" ");
            let g = |x: [f64; 8], m: [f64; 8]| (0..7).map(|j| format!("{:.3}", (x[j] / n - (m[j] / n).powi(2)).sqrt())).collect::<Vec<_>>().join(" ");
            println!("std sigma {sigma} runs {which:?}: {} | {}", g(e, m1), g(s, m2));
            println!("sigma {sigma} runs {which:?}: {}   | {}", f(e), f(s));
        }
    }
}

#[test]
fn the_shipped_table_is_whole_and_reads_back() {
    let file = table3();
    assert_eq!((file.model.parameters().len(), file.model.kind()), (59, BaseKind::Gbs));
    assert_eq!(file.model.mountings(), [Mounting::WALL]);
    std::fs::write("/tmp/table3.toml", file.to_toml()).unwrap();
}
