//! Noise of the rows, as repetitions tell it: of each, in a band, and of how many it is known.

use super::{BAND_EDGES_HZ, Cell, Evidence, Trial};
use crate::fold::Fold;
use plumbline_identify::{NoisePower, Scatter};

impl Evidence {
    /// RMS of the noise of a joint's mean periods in the band \[Nm\]; nothing without repeats.
    pub fn floor(&self, joint: usize) -> Option<f64> {
        self.floor_below(joint, BAND_EDGES_HZ.len())
    }

    /// The same in the lowest `bands` of [`BAND_EDGES_HZ`] alone.
    pub fn floor_below(&self, joint: usize, bands: usize) -> Option<f64> {
        self.noise_below(joint, bands, |own| own)
    }

    /// The same of the mean of so many `periods`, which leaves what every period repeats.
    pub fn floor_of_periods_below(&self, joint: usize, bands: usize, periods: f64) -> Option<f64> {
        self.noise_below(joint, bands, |_own| periods)
    }

    /// Noise of the mean of some periods, by the number that an experiment has.
    fn noise_below(&self, joint: usize, bands: usize, periods: impl Fn(f64) -> f64) -> Option<f64> {
        let power = |cell: &Cell| {
            let own = self.periods[self.folds[cell.fold].experiment];
            let ratio = own / periods(own);
            let rows = self.sigma[joint][cell.rows.clone()].iter().zip(&self.repeated[joint][cell.rows.clone()]);
            rows.map(|(sigma, repeated)| repeated + ratio * (sigma * sigma - repeated).max(0.0)).sum::<f64>()
        };
        let power: f64 = self.cells_below(joint, bands).map(power).sum();
        self.repeats.then(|| (power / self.samples()).sqrt())
    }

    /// Number of rows of equal noise whose mean square scatters as much as that of a joint's noise: `(sum s^2)^2 / sum s^4`. Where noise is slow only
    /// the lowest frequencies have a say.
    pub fn rows_of_noise_below(&self, joint: usize, bands: usize) -> f64 {
        self.freedom(joint, bands, |_periods| 1.0)
    }

    /// Degrees of freedom of a joint's noise as the scatter between periods tells it, by Satterthwaite.
    pub fn freedom_of_noise_below(&self, joint: usize, bands: usize) -> f64 {
        self.freedom(joint, bands, |periods| periods - 1.0)
    }

    /// Degrees of freedom of a sum of squares when each has those of its number of periods.
    fn freedom(&self, joint: usize, bands: usize, of_each: impl Fn(f64) -> f64) -> f64 {
        let (mut sum, mut variance) = (0.0, 0.0);
        for cell in self.cells_below(joint, bands) {
            let freedom = of_each(self.periods[self.folds[cell.fold].experiment]);
            for sigma in &self.sigma[joint][cell.rows.clone()] {
                sum += sigma.powi(2);
                variance += sigma.powi(4) / freedom;
            }
        }
        sum * sum / variance
    }
}

/// Standard deviation of the noise of each row of a joint, that of the mean period, and the variance in it that every period repeats; from all experiments
/// that are `known` together.
pub(super) fn of_rows(
    trials: &[Trial],
    known: &[Trial],
    folds: &[Fold],
    joint: usize,
    repeats: bool,
) -> (Vec<f64>, Vec<f64>) {
    let scatters: Vec<&Scatter> = known.iter().filter_map(|trial| trial.experiment.scatter.as_ref()).collect();
    let power = NoisePower::of(&scatters, joint);
    let of_row = |(fold, frequency): (&Fold, f64)| {
        if !repeats {
            return (1.0, 0.0);
        }
        let experiment = trials[fold.experiment].experiment;
        let [scattered, repeated] = power.at(frequency, experiment.motion.dt);
        let of_mean = scattered / experiment.averaged_periods() + repeated;
        // Torques that repeat to the last bit have no noise; a thousandth of a milli-newton-metre stands for it.
        (of_mean.sqrt().max(1e-6), repeated)
    };
    folds.iter().flat_map(|fold| fold.frequencies.iter().map(move |frequency| (fold, *frequency))).map(of_row).unzip()
}
