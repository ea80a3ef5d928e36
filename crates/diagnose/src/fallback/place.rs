//! Where a residual is: in which trajectory and second, at which frequencies, and over which values of a variable.

use super::variable::{Course, Variable};
use crate::evidence::Evidence;
use nalgebra::DVector;

/// Length of a window \[s\].
const WINDOW_S: f64 = 1.0;
/// A line is so many times the median power of its neighbours.
const MIN_LINE_POWER_RATIO: f64 = 12.0;
/// Neighbours of a bin on either side.
const NEIGHBOUR_BINS: usize = 12;
/// Share of the residual's square that a line has at least.
const MIN_LINE_SHARE_RATIO: f64 = 0.01;
/// Values of a variable that are told apart.
const BIN_COUNT: usize = 24;
/// The same of each of two.
const TILE_COUNT: usize = 12;

/// A second of one trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Name of the run.
    pub run: String,
    /// Begin, since the start of the period or of the run \[s\].
    pub from: f64,
    /// Length \[s\].
    pub seconds: f64,
    /// Share of the residual's square of all trajectories.
    pub share: f64,
    /// RMS in it \[Nm\].
    pub rms: f64,
}

/// A frequency that stands out.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Name of the run.
    pub run: String,
    /// Where \[Hz\].
    pub frequency: f64,
    /// Amplitude \[Nm\].
    pub amplitude: f64,
    /// Power over the median of the bins around it.
    pub ratio: f64,
}

/// The mean residual where a variable has one of its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dependence {
    /// Middle of the values.
    pub at: f64,
    /// Mean residual \[Nm\].
    pub mean: f64,
    /// Its standard error \[Nm\].
    pub error: f64,
}

/// Mean residual over two variables.
#[derive(Clone, Debug, PartialEq)]
pub struct Map {
    /// The variables, first along `x`.
    pub variables: [Variable; 2],
    /// Middles of the tiles along the first.
    pub x: Vec<f64>,
    /// Middles of the tiles along the second.
    pub y: Vec<f64>,
    /// Mean residual \[Nm\], `y` within `x`; nothing where the arm was not.
    pub mean: Vec<Option<f64>>,
}

/// The residual of a joint as a signal, fold by fold \[Nm\].
pub struct Signals<'a> {
    evidence: &'a Evidence,
    coefficients: Vec<Vec<f64>>,
    signals: Vec<Vec<f64>>,
}

impl Signals<'_> {
    /// Of rows that are divided by the noise.
    pub fn of<'a>(evidence: &'a Evidence, joint: usize, rows: &DVector<f64>) -> Signals<'a> {
        let raw: Vec<f64> = rows.iter().zip(evidence.sigma(joint)).map(|(row, sigma)| row * sigma).collect();
        let coefficients: Vec<Vec<f64>> = evidence.folds().iter().map(|fold| raw[fold.rows.clone()].to_vec()).collect();
        let signals = coefficients.iter().enumerate().map(|(fold, rows)| evidence.signal(fold, rows)).collect();
        Signals { evidence, coefficients, signals }
    }

    fn dt(&self, fold: usize) -> f64 {
        self.evidence.motion(self.evidence.folds()[fold].experiment).dt
    }

    /// Every second.
    pub fn windows(&self) -> Vec<Window> {
        let total: f64 = self.signals.iter().flatten().map(|value| value * value).sum();
        let mut windows = Vec::new();
        for (fold, signal) in self.signals.iter().enumerate() {
            let dt = self.dt(fold);
            let count = (signal.len() as f64 * dt / WINDOW_S).round().max(1.0) as usize;
            let start = self.evidence.thinned(fold).start;
            let motion = self.evidence.motion(self.evidence.folds()[fold].experiment);
            for window in 0..count {
                let (first, last) = (window * signal.len() / count, (window + 1) * signal.len() / count);
                let square: f64 = signal[first..last].iter().map(|value| value * value).sum();
                windows.push(Window {
                    run: self.evidence.folds()[fold].name.clone(),
                    // A sample stands in the middle of its step.
                    from: (motion.start + ((start + first) as f64 - 0.5) * dt).max(0.0),
                    seconds: (last - first) as f64 * dt,
                    share: square / total.max(f64::MIN_POSITIVE),
                    rms: (square / (last - first).max(1) as f64).sqrt(),
                });
            }
        }
        windows
    }

    /// Frequencies that stand out from their neighbours, the strongest first.
    pub fn lines(&self) -> Vec<Line> {
        let mut lines = Vec::new();
        for (fold, rows) in self.evidence.folds().iter().zip(&self.coefficients) {
            // Sine and cosine of one frequency together; a cosine transform has one row for each.
            let mut bins: Vec<(f64, f64)> = Vec::new();
            for (frequency, value) in fold.frequencies.iter().zip(rows) {
                match bins.last_mut() {
                    Some((last, power)) if last == frequency => *power += value * value,
                    _ => bins.push((*frequency, value * value)),
                }
            }
            let total: f64 = bins.iter().map(|(_, power)| power).sum();
            for (k, &(frequency, power)) in bins.iter().enumerate().skip(1) {
                let around = k.saturating_sub(NEIGHBOUR_BINS).max(1)..(k + NEIGHBOUR_BINS + 1).min(bins.len());
                let others: Vec<f64> = around.filter(|&other| other != k).map(|other| bins[other].1).collect();
                let ratio = power / median(others).max(f64::MIN_POSITIVE);
                if ratio > MIN_LINE_POWER_RATIO && power > MIN_LINE_SHARE_RATIO * total {
                    let amplitude = (2.0 * power / fold.samples.len() as f64).sqrt();
                    lines.push(Line { run: fold.name.clone(), frequency, amplitude, ratio });
                }
            }
        }
        lines.sort_by(|a, b| b.ratio.total_cmp(&a.ratio));
        lines
    }

    /// Value of the variable and residual, sample by sample.
    fn pairs<'a>(&'a self, course: &'a Course) -> impl Iterator<Item = (f64, f64)> + 'a {
        self.signals.iter().enumerate().flat_map(move |(fold, signal)| {
            let values = &course.values[self.evidence.folds()[fold].experiment][self.evidence.thinned(fold)];
            values.iter().copied().zip(signal.iter().copied())
        })
    }

    /// Mean residual over the values of a variable; values that were hardly met are left out.
    pub fn dependence(&self, course: &Course) -> Vec<Dependence> {
        let mut sums = [(0.0, 0.0, 0.0); BIN_COUNT];
        for (value, residual) in self.pairs(course) {
            let sum = &mut sums[place(value, course.range, BIN_COUNT)];
            *sum = (sum.0 + 1.0, sum.1 + residual, sum.2 + residual * residual);
        }
        // Samples in the band are not independent: two for each period of its highest frequency are.
        let highest = self.evidence.folds().iter().filter_map(|fold| fold.frequencies.last().copied());
        let independent = (2.0 * highest.fold(0.0, f64::max) * self.dt(0)).min(1.0);
        let point = |(bin, &(count, sum, square)): (usize, &(f64, f64, f64))| {
            let effective = count * independent;
            (effective > 2.0).then(|| {
                let mean = sum / count;
                let variance = (square / count - mean * mean).max(0.0);
                Dependence { at: middle(bin, course.range, BIN_COUNT), mean, error: (variance / effective).sqrt() }
            })
        };
        sums.iter().enumerate().filter_map(point).collect()
    }

    /// Mean residual over the values of two.
    pub fn map(&self, first: &Course, second: &Course) -> Map {
        let mut sums = vec![(0.0, 0.0); TILE_COUNT * TILE_COUNT];
        for ((x, residual), (y, _)) in self.pairs(first).zip(self.pairs(second)) {
            let sum = &mut sums[place(x, first.range, TILE_COUNT) * TILE_COUNT + place(y, second.range, TILE_COUNT)];
            *sum = (sum.0 + 1.0, sum.1 + residual);
        }
        Map {
            variables: [first.variable, second.variable],
            x: (0..TILE_COUNT).map(|tile| middle(tile, first.range, TILE_COUNT)).collect(),
            y: (0..TILE_COUNT).map(|tile| middle(tile, second.range, TILE_COUNT)).collect(),
            mean: sums.iter().map(|(count, sum)| (*count > 0.0).then(|| sum / count)).collect(),
        }
    }
}

fn place(value: f64, range: (f64, f64), of: usize) -> usize {
    let share = (value - range.0) / (range.1 - range.0);
    ((share * of as f64).max(0.0) as usize).min(of - 1)
}

fn middle(bin: usize, range: (f64, f64), of: usize) -> f64 {
    range.0 + (bin as f64 + 0.5) / of as f64 * (range.1 - range.0)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
