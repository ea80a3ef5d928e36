//! Residuals as people look at them: over time, over frequency, over the variable of an effect.

use super::evidence::Evidence;
use super::fallback::{Map, Residual};
use super::figures::{Curves, EffectFigure, MapFigure, PeriodFigure, SpectrumFigure};
use super::select::Search;
use super::state::State;
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{OperatingPoint, PlotOver};

/// Joints that are drawn at most.
const MAX_JOINTS_DRAWN: usize = 4;
/// Trajectories that are drawn at most.
const MAX_TRAJECTORIES_DRAWN: usize = 2;
/// Bins of a variable.
const BIN_COUNT: usize = 30;

/// Of the plain model and of what is delivered.
pub fn of(search: &Search, before: &State, after: &State, residuals: &[Residual]) -> Curves {
    let evidence = search.problem.evidence;
    let mut joints: Vec<usize> = Vec::new();
    let touched = after.items.iter().flat_map(|item| item.spec.site.joints().into_iter().take(1));
    for joint in touched.chain(residuals.iter().map(|one| one.joint)) {
        if !joints.contains(&joint) && joints.len() < MAX_JOINTS_DRAWN {
            joints.push(joint);
        }
    }
    if joints.is_empty() {
        // Where nothing was found, the joint that comes nearest to it.
        let lack = |joint: usize| before.residual(joint).norm_squared();
        joints.extend((0..evidence.joints()).max_by(|&a, &b| lack(a).total_cmp(&lack(b))));
    }
    Curves {
        periods: joints.iter().flat_map(|&joint| periods(evidence, joint, before, after)).collect(),
        spectra: joints.iter().map(|&joint| spectrum(evidence, joint, before, after)).collect(),
        effects: (0..after.items.len()).filter_map(|item| effect(search, after, item)).collect(),
        dependences: residuals.iter().filter_map(dependence).collect(),
        maps: residuals.iter().filter_map(|one| map(one.joint, one.map.as_ref()?)).collect(),
    }
}

/// Coefficients of one fold in Nm.
fn in_fold(evidence: &Evidence, joint: usize, rows: &DVector<f64>, fold: usize) -> Vec<f64> {
    let range = evidence.folds()[fold].rows.clone();
    rows.rows(range.start, range.len())
        .iter()
        .zip(&evidence.sigma(joint)[range])
        .map(|(row, sigma)| row * sigma)
        .collect()
}

fn periods(evidence: &Evidence, joint: usize, before: &State, after: &State) -> Vec<PeriodFigure> {
    let (was, is) = (before.residual(joint), after.residual(joint));
    let one = |fold: usize| {
        let own = &evidence.folds()[fold];
        let motion = evidence.motion(own.experiment);
        let t = evidence.thinned(fold).map(|k| motion.start + k as f64 * motion.dt).collect();
        let signal = |rows: &DVector<f64>| evidence.signal(fold, &in_fold(evidence, joint, rows, fold));
        let deviation = evidence.floor(joint).into_iter().collect();
        let (before, after) = (signal(&was), signal(&is));
        PeriodFigure { joint: joint + 1, trajectory: own.name.clone(), t, before, after, deviation }
    };
    (0..evidence.folds().len().min(MAX_TRAJECTORIES_DRAWN)).map(one).collect()
}

fn spectrum(evidence: &Evidence, joint: usize, before: &State, after: &State) -> SpectrumFigure {
    let (was, is) = (before.residual(joint), after.residual(joint));
    let mut lines: Vec<[f64; 5]> = Vec::new();
    for (index, fold) in evidence.folds().iter().enumerate() {
        let (was, is) = (in_fold(evidence, joint, &was, index), in_fold(evidence, joint, &is, index));
        let sigma = &evidence.sigma(joint)[fold.rows.clone()];
        let dt = evidence.motion(fold.experiment).dt * evidence.thinned(index).len() as f64 / fold.samples.len() as f64;
        for (k, &f) in fold.frequencies.iter().enumerate() {
            // Squared coefficients are the power of one sample: a density, one-sided, is twice that times the time between samples.
            let density = 2.0 * dt;
            lines.push([f, density * was[k].powi(2), density * is[k].powi(2), density * sigma[k].powi(2), 1.0]);
        }
    }
    lines.sort_by(|a, b| a[0].total_cmp(&b[0]));
    // Bins of a twentieth of an octave and more, so that scatter does not hide the level.
    let mut merged: Vec<[f64; 5]> = Vec::new();
    let mut edge = 0.0;
    for line in lines {
        match merged.last_mut() {
            Some(last) if line[0] < edge => last.iter_mut().zip(line).for_each(|(sum, value)| *sum += value),
            _ => {
                edge = (1.1 * line[0]).max(line[0] + 0.05);
                merged.push(line);
            }
        }
    }
    let mean = |which: usize| merged.iter().map(|line| line[which] / line[4]).collect::<Vec<f64>>();
    let noise = if evidence.repeats() { mean(3) } else { Vec::new() };
    SpectrumFigure { joint: joint + 1, f: mean(0), before: mean(1), after: mean(2), noise }
}

/// The horizontal axis of an effect's plot: its name, and its values along a motion.
fn axis(operating_point: &OperatingPoint, over: PlotOver, joint: usize, motion: &Motion) -> Option<(String, Vec<f64>)> {
    let column = |of: &DMatrix<f64>| of.column(joint).iter().copied().collect();
    let (name, unit, values) = match over {
        PlotOver::Position => ("q", "rad", column(&motion.q)),
        PlotOver::Velocity => ("dq", "rad/s", column(&motion.dq)),
        PlotOver::Acceleration => ("ddq", "rad/s2", column(&motion.ddq)),
        PlotOver::Load => ("tau_rb", "Nm", column(&operating_point.load.along(motion))),
        PlotOver::Time => {
            let times = (0..motion.samples()).map(|k| motion.start + k as f64 * motion.dt).collect();
            return Some(("t / s".into(), times));
        }
        PlotOver::Nothing => return None,
    };
    Some((format!("{name}{} / {unit}", joint + 1), values))
}

fn effect(search: &Search, state: &State, item: usize) -> Option<EffectFigure> {
    let evidence = search.problem.evidence;
    let spec = state.items[item].spec.clone();
    let joints = spec.site.joints();
    let (&joint, &cause) = (joints.first()?, joints.last()?);
    let part = state.items[item].rows.of(joint)?;
    let range = state.range(item);
    let fitted = &*part * state.fit.theta.rows(range.start, range.len());
    let without = state.residual(joint) + &fitted;
    let over = spec.form()?.plot_over;
    let mut variable = String::new();
    let mut values: Vec<Vec<f64>> = Vec::new();
    for experiment in 0..evidence.experiments() {
        let (name, own) = axis(search.operating_point, over, cause, evidence.motion(experiment))?;
        variable = name;
        values.push(own);
    }
    let mut points: Vec<[f64; 3]> = Vec::new();
    for (index, fold) in evidence.folds().iter().enumerate() {
        let residual = evidence.signal(index, &in_fold(evidence, joint, &without, index));
        let effect = evidence.signal(index, &in_fold(evidence, joint, &fitted, index));
        for ((k, residual), effect) in evidence.thinned(index).zip(residual).zip(effect) {
            points.push([values[fold.experiment][k], residual, effect]);
        }
    }
    // Bins of equal numbers show what happens where the arm is often.
    points.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut figure = EffectFigure { title: spec.to_string(), variable, joint: joint + 1, ..EffectFigure::default() };
    for bin in points.chunks(points.len().div_ceil(BIN_COUNT).max(1)) {
        let count = bin.len() as f64;
        let mean = |which: usize| bin.iter().map(|point| point[which]).sum::<f64>() / count;
        let level = mean(1);
        let variance = bin.iter().map(|point| (point[1] - level).powi(2)).sum::<f64>() / count;
        figure.x.push(mean(0));
        figure.mean.push(level);
        // Neighbours in time are nearly the same sample: one in ten counts.
        figure.deviation.push((variance / (count / 10.0).max(1.0)).sqrt());
        figure.fitted.push((mean(0), mean(2)));
    }
    Some(figure)
}

/// A residual that no effect explains, over the variable that predicts it best.
fn dependence(residual: &Residual) -> Option<EffectFigure> {
    let variable = residual.singles.first()?.variables[0];
    Some(EffectFigure {
        title: format!("joint {}, unexplained", residual.joint + 1),
        variable: format!("{variable} / {}", variable.unit()),
        joint: residual.joint + 1,
        x: residual.dependence.iter().map(|bin| bin.at).collect(),
        mean: residual.dependence.iter().map(|bin| bin.mean).collect(),
        deviation: residual.dependence.iter().map(|bin| bin.error).collect(),
        ..EffectFigure::default()
    })
}

/// A residual that no effect explains, over the two variables that predict it best.
fn map(joint: usize, map: &Map) -> Option<MapFigure> {
    let name = |which: usize| format!("{} / {}", map.variables[which], map.variables[which].unit());
    let mean = |k: usize| (0..map.x.len()).map(move |i| map.mean[i * map.y.len() + k].unwrap_or(f64::NAN));
    Some(MapFigure {
        title: format!("joint {}, unexplained", joint + 1),
        x_name: name(0),
        y_name: name(1),
        x: edges(&map.x)?,
        y: edges(&map.y)?,
        mean: (0..map.y.len()).map(|k| mean(k).collect()).collect(),
    })
}

/// Edges of tiles that have these middles; `None` without tiles.
pub fn edges(middles: &[f64]) -> Option<Vec<f64>> {
    let (first, last) = (middles.first()?, middles.last()?);
    let half = (last - first) / (2.0 * (middles.len() - 1).max(1) as f64);
    let inner = middles.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
    Some([first - half].into_iter().chain(inner).chain([last + half]).collect())
}
