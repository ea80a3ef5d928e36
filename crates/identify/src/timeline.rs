//! When samples were recorded.

/// When the samples of an experiment's grid were recorded, in the time since the first sample of the run.
#[derive(Clone, Debug)]
pub struct Timeline {
    /// Time between samples \[s\].
    pub(super) dt: f64,
    /// Samples of the grid, N.
    pub(super) samples: usize,
    /// Samples of the run before the first of the grid.
    pub(super) edge: usize,
    /// Indices of the periods that are in the mean, P; none without a period.
    pub(super) periods: Vec<usize>,
    /// Weights of their samples in the mean, P N.
    pub(super) weights: Vec<f64>,
}

impl Timeline {
    /// Mean of a function of time over the periods, for each sample of the grid, N; without a period the function.
    pub fn mean_of(&self, function: impl Fn(f64) -> f64) -> Vec<f64> {
        let at = |row: usize| function(row as f64 * self.dt);
        if self.periods.is_empty() {
            return (0..self.samples).map(|k| at(self.edge + k)).collect();
        }
        let mut mean = vec![0.0; self.samples];
        for (period, weights) in self.periods.iter().zip(self.weights.chunks(self.samples)) {
            for (k, weight) in weights.iter().enumerate() {
                mean[k] += weight * at(period * self.samples + k);
            }
        }
        mean
    }

    /// Time of a sample of the grid \[s\]; in the first of the periods that are in a mean.
    pub fn time(&self, k: usize) -> f64 {
        (self.periods.first().map_or(self.edge, |period| period * self.samples) + k) as f64 * self.dt
    }

    /// Time before the first sample of the grid where the run has no periods, 0 where it has \[s\].
    pub fn before_periods(&self) -> f64 {
        if self.periods.is_empty() { self.time(0) } else { 0.0 }
    }

    /// Time of the last sample \[s\].
    pub fn end(&self) -> f64 {
        let last = self.periods.last().map_or(self.edge, |period| period * self.samples) + self.samples;
        last as f64 * self.dt
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sample_of_the_mean_was_recorded_in_shares() {
        let share_between = |of: &Timeline, from: f64, to: f64| of.mean_of(|t| f64::from((from..to).contains(&t)));
        let mean = Timeline {
            dt: 0.5,
            samples: 4,
            edge: 0,
            periods: vec![1, 2],
            weights: [0.75, 0.5, 0.5, 0.5, 0.25, 0.5, 0.5, 0.5].to_vec(),
        };
        // The periods are from 2 to 4 s and from 4 to 6 s.
        assert_eq!(share_between(&mean, 3.0, f64::INFINITY), [0.25, 0.5, 1.0, 1.0]);
        assert_eq!(share_between(&mean, 4.5, 5.5), [0.0, 0.5, 0.5, 0.0]);
        assert_eq!(mean.end(), 6.0);
        assert_eq!(mean.mean_of(|t| t), [2.5, 3.5, 4.0, 4.5]);
        let once = Timeline { dt: 0.5, samples: 4, edge: 2, periods: Vec::new(), weights: Vec::new() };
        assert_eq!(share_between(&once, 1.5, 2.5), [0.0, 1.0, 1.0, 0.0]);
        assert_eq!(once.end(), 3.0);
    }
}
