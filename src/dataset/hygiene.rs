//! Quality of a recording: repeats, gaps, resolution.

use super::Run;
use nalgebra::DVectorView;
use plumbline_identify::signal::polled::repeats;

/// Repeats, gaps and resolution of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Hygiene {
    pub samples: usize,
    /// Median time between samples that differ in time \[s\].
    pub dt: f64,
    /// Samples with the same time as the one before.
    pub repeated_times: usize,
    /// Samples in which every position and torque equals the one before: the recorder was faster than the arm.
    pub repeated_rows: usize,
    /// Steps in time longer than 1.5 `dt`.
    pub gaps: usize,
    /// Longest step in time \[s\].
    pub longest_gap: f64,
    /// Step in which each joint's position is quantised \[rad\], `None` where no step is visible.
    pub q_quantum: Vec<Option<f64>>,
    /// Step in which each joint's torque is quantised \[Nm\], `None` where no step is visible.
    pub tau_quantum: Vec<Option<f64>>,
}

impl Hygiene {
    pub(super) fn of(run: &Run) -> Hygiene {
        let steps: Vec<f64> = run.data.t.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let mut moving: Vec<f64> = steps.iter().copied().filter(|&step| step > 0.0).collect();
        moving.sort_by(f64::total_cmp);
        let dt = moving.get(moving.len() / 2).copied().unwrap_or(0.0);
        Hygiene {
            samples: run.samples(),
            dt,
            repeated_times: steps.len() - moving.len(),
            repeated_rows: repeats(&run.data.q, &run.data.tau).len(),
            gaps: moving.iter().filter(|&&step| step > 1.5 * dt).count(),
            longest_gap: moving.last().copied().unwrap_or(0.0),
            q_quantum: run.data.q.column_iter().map(quantum).collect(),
            tau_quantum: run.data.tau.column_iter().map(quantum).collect(),
        }
    }
}

/// Share of steps between neighbouring values that must be whole multiples of the quantum.
const MIN_MULTIPLE_RATIO: f64 = 0.95;

/// The step of a quantised signal: neighbouring values, once sorted, lie a whole number of steps apart.
fn quantum(column: DVectorView<f64>) -> Option<f64> {
    let mut values: Vec<f64> = column.iter().copied().collect();
    values.sort_by(f64::total_cmp);
    let range = values.last()? - values.first()?;
    let mut steps: Vec<f64> =
        values.windows(2).map(|pair| pair[1] - pair[0]).filter(|&step| step > 1e-9 * range).collect();
    steps.sort_by(f64::total_cmp);
    // Needs five steps. The mean of the lowest tenth averages rounding errors.
    let lowest = steps.get(..(steps.len() / 10).max(1)).filter(|_| steps.len() >= 5)?;
    let quantum = lowest.iter().sum::<f64>() / lowest.len() as f64;
    let whole = |step: f64| (step / quantum - (step / quantum).round()).abs() < 0.05;
    let share = steps.iter().filter(|&&step| whole(step)).count() as f64 / steps.len() as f64;
    (share >= MIN_MULTIPLE_RATIO).then_some(quantum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;
    use rand::{Rng, SeedableRng};

    #[test]
    fn quantisation_is_detected() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let smooth = DVector::from_fn(2000, |_, _| rng.random_range(-30.0..30.0_f64));
        assert_eq!(quantum((&smooth).into()), None);
        let coarse = smooth.map(|value| (value / 0.07).round() * 0.07);
        let found = quantum((&coarse).into()).expect("a step of 0.07");
        assert!((found - 0.07).abs() < 1e-9, "{found}");
        assert_eq!(quantum((&DVector::from_element(100, 4.0)).into()), None);
    }
}
