//! Data of the plots; each curve is decimated to about 1500 points.

pub use plumbline_diagnose::figures::{Curves, EffectFigure, MapFigure, PeriodFigure, SpectrumFigure};

use plumbline_core::Workspace;

/// All curves of a report; absent ones are not drawn.
#[derive(Clone, Debug, Default)]
pub struct Figures {
    /// Torques per run, in the order of drawing. All joints of a run cost about 0.2 MB: hand over the identification and one run
    /// per mounting rather than everything.
    pub runs: Vec<TorqueFigure>,
    pub plan: Option<PlanFigure>,
    pub diagnosis: Curves,
    /// One per joint; empty where no friction is modelled.
    pub friction: Vec<FrictionFigure>,
    /// Correlation of the parameters' errors, p x p in the order of the report's parameters; empty where it is unknown.
    pub correlation: Vec<Vec<f64>>,
    /// Durations of the loop, the same bins for all of them.
    pub durations: Vec<DurationFigure>,
}

/// What a joint's measured torque has beyond its rigid bodies, in bins, and the same of the model.
#[derive(Clone, Debug, Default)]
pub struct FrictionFigure {
    /// Joint, from 1.
    pub joint: usize,
    /// Over the velocity \[rad/s\].
    pub velocity: Vec<Bin>,
    /// In the direction of motion, over the displacement since the last reversal \[rad\].
    pub displacement: Vec<Bin>,
}

/// Mean of the samples of a bin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bin {
    pub x: f64,
    /// Mean measured torque \[Nm\].
    pub measured: f64,
    /// Standard deviation of the samples in the bin \[Nm\].
    pub deviation: f64,
    /// Mean modelled torque of the same samples \[Nm\].
    pub modelled: f64,
}

/// How often a duration of the loop was how long.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DurationFigure {
    pub title: String,
    /// Lower ends of the bins and the upper end of the last one \[us\], from a logarithmic scale.
    pub edges: Vec<f64>,
    pub counts: Vec<u64>,
}

/// Measured and modelled torque along one run.
#[derive(Clone, Debug, Default)]
pub struct TorqueFigure {
    pub title: String,
    /// Time \[s\].
    pub t: Vec<f64>,
    /// Measured torque per joint, each as long as `t`, in the report's band \[Nm\].
    pub measured: Vec<Vec<f64>>,
    /// Modelled torque per joint in the same band \[Nm\].
    pub modelled: Vec<Vec<f64>>,
    /// Raw measured torque per joint, drawn behind the others \[Nm\]; empty where `measured` is raw.
    pub raw: Vec<Vec<f64>>,
    /// Standard deviation of the noise of `measured` per joint, drawn as a band of twice that \[Nm\]; may be empty.
    pub noise: Vec<f64>,
}

#[derive(Clone, Debug, Default)]
pub struct PlanFigure {
    /// Time \[s\].
    pub t: Vec<f64>,
    /// Position per joint, each as long as `t` \[rad\].
    pub q: Vec<Vec<f64>>,
    /// Position of the end effector in the base frame at `t` \[m\].
    pub end_effector: Vec<[f64; 3]>,
    /// The arm at some of these times: base, the origin of each link frame and the end effector, in the base frame \[m\].
    pub poses: Vec<Vec<[f64; 3]>>,
    /// Lowest and highest position of each joint \[rad\]; empty where unknown.
    pub limits: Vec<[f64; 2]>,
    pub workspace: Option<Workspace>,
}

pub const MOST_POINTS: usize = 1500;

/// Decimates a curve to the lowest and highest point of each interval, which keeps all peaks.
pub fn thin(t: &[f64], y: &[f64]) -> Vec<(f64, f64)> {
    let samples = t.len().min(y.len());
    if samples <= MOST_POINTS {
        return t.iter().copied().zip(y.iter().copied()).collect();
    }
    let stretch = samples.div_ceil(MOST_POINTS / 2);
    let mut points = Vec::with_capacity(MOST_POINTS);
    for first in (0..samples).step_by(stretch) {
        let range = first..(first + stretch).min(samples);
        let (mut low, mut high) = (first, first);
        for k in range {
            if y[k] < y[low] {
                low = k;
            }
            if y[k] > y[high] {
                high = k;
            }
        }
        points.push((t[low.min(high)], y[low.min(high)]));
        if low != high {
            points.push((t[low.max(high)], y[low.max(high)]));
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinning_keeps_every_peak_and_the_order() {
        let t: Vec<f64> = (0..100_000).map(|k| k as f64 * 1e-3).collect();
        let mut y: Vec<f64> = t.iter().map(|t| t.sin()).collect();
        (y[777], y[55_555]) = (50.0, -60.0);
        let points = thin(&t, &y);
        assert!(points.len() <= MOST_POINTS && points.len() > MOST_POINTS / 3);
        assert!(points.contains(&(0.777, 50.0)) && points.contains(&(t[55_555], -60.0)));
        assert!(points.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(thin(&t[..9], &y[..9]).len(), 9);
    }
}
