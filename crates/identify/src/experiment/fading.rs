//! Derivatives of a mean whose weights change with time.

use super::MAX_NYQUIST_RATIO;
use crate::differentiate::Differentiator;
use crate::signal::SignalError;
use crate::signal::butterworth::Butterworth;
use crate::signal::difference;
use nalgebra::DMatrix;
use plumbline_model::term::Motion;

/// Deviations between periods are smoothed with this cut-off before they are differentiated \[Hz\]: what two periods have in common cancels, and what
/// they differ by dies away slowly.
const CUTOFF_HZ: f64 = 10.0;

/// Where periods fade out of the mean and in, it is no motion that the arm did: its derivatives are not the means of the periods' own,
///
///   (sum_p w_p q_p)'  = sum_p w_p q_p'  + sum_p w_p' q_p
///   (sum_p w_p q_p)'' = sum_p w_p q_p'' + sum_p (w_p'' q_p + 2 w_p' q_p')
///
/// and the torques are the means of the periods' own. Half a milliradian that two periods still differ by makes 6 mrad/s2 where one fades out.
#[derive(Clone, Debug)]
pub(super) struct Fading {
    /// The last sum of the first line, N x n \[rad/s\].
    dq: DMatrix<f64>,
    /// That of the second \[rad/s2\].
    ddq: DMatrix<f64>,
}

impl Fading {
    /// Of periods of so many samples one after the other, with the weights of their rows, P N; `None` where no weight changes.
    ///
    /// # Errors
    /// An invalid order.
    pub fn of(
        q: &DMatrix<f64>,
        weights: &[f64],
        samples: usize,
        order: usize,
        dt: f64,
    ) -> Result<Option<Fading>, SignalError> {
        if weights.windows(2).all(|pair| pair[0] == pair[1]) {
            return Ok(None);
        }
        let rate = 1.0 / dt;
        let filter = Butterworth::new(order, CUTOFF_HZ.min(MAX_NYQUIST_RATIO * rate / 2.0), rate)?;
        // The end of the record adjoins its start, as the weights do.
        let [slopes, bends] = difference::derivatives(weights, dt, true);
        let joints = q.ncols();
        let mut fading = Fading { dq: DMatrix::zeros(samples, joints), ddq: DMatrix::zeros(samples, joints) };
        // Weights sum to one at every sample: what is the same in all periods adds nothing, and beside the last one, which has settled, the others are smooth.
        let last = q.nrows() - samples;
        let apart = DMatrix::from_fn(q.nrows(), joints, |row, j| q[(row, j)] - q[(last + row % samples, j)]);
        for j in 0..joints {
            let apart = filter.zero_phase(apart.column(j).as_slice());
            let [speed, _] = difference::derivatives(&apart, dt, false);
            for row in 0..apart.len() {
                fading.dq[(row % samples, j)] += slopes[row] * apart[row];
                fading.ddq[(row % samples, j)] += bends[row] * apart[row] + 2.0 * slopes[row] * speed[row];
            }
        }
        Ok(Some(fading))
    }

    /// Takes it off the derivatives of the mean positions, with the low-pass that these have.
    pub fn take_off(&self, motion: &mut Motion, of: &Differentiator) {
        motion.dq -= of.low_pass(&self.dq);
        motion.ddq -= of.low_pass(&self.ddq);
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{inertia, kept_periods, run};
    use super::super::{Experiment, PI};
    use nalgebra::DMatrix;

    /// The torque of a mean period's inertia is the mean torque, also where a period that has not died away fades in.
    #[test]
    fn a_period_that_fades_in_is_no_acceleration() {
        let mut run = run(Some(2.0), 6.0);
        for (k, t) in run.t.clone().into_iter().enumerate() {
            for j in 0..2 {
                let (w, start) = (PI * (j + 1) as f64, 3e-3 * (-t / 0.5).exp());
                run.q[(k, j)] = (w * t).sin() + start;
                run.tau[(k, j)] = 2.0 * (start / 0.25 - w * w * (w * t).sin());
            }
        }
        let settings = crate::Settings {
            leave_out: vec![crate::ExcludedSpan { run: "test".into(), from: 0.0, to: 0.6 }],
            ..kept_periods()
        };
        let experiment = Experiment::prepare(&run, &settings).unwrap();
        assert!(experiment.timeline.weights[500] == 0.0 && experiment.timeline.weights[1500] > 0.3);
        let error = |motion| {
            let error = inertia(motion) - &experiment.tau;
            experiment.filter(&DMatrix::from_column_slice(error.len(), 1, error.as_slice())).amax()
        };
        let of_mean = experiment.differentiator.motion(&experiment.q, 0);
        // What is left is what of the fading is taken for noise of the positions.
        let [own, of_mean] = [error(&experiment.motion), error(&of_mean)];
        assert!(own < 4e-3 && own < 0.5 * of_mean, "{own} Nm, {of_mean} Nm without");
        // Every period's own motion has no part in that.
        let own = experiment.own_motion().unwrap();
        let row = 1300;
        let truth = 3e-3 * (-1.3f64 / 0.5).exp() / 0.25 - PI * PI * (PI * 1.3).sin();
        assert!((own.ddq[(row, 0)] - truth).abs() < 2e-3, "{} of {truth}", own.ddq[(row, 0)]);
    }

    #[test]
    fn periods_fade_at_low_sampling_rates_too() {
        let mut slow = run(Some(2.0), 6.0);
        let rows: Vec<usize> = (0..slow.t.len()).step_by(50).collect();
        slow.t = rows.iter().map(|&row| slow.t[row]).collect();
        (slow.q, slow.tau) = (slow.q.select_rows(&rows), slow.tau.select_rows(&rows));
        let leave_out = vec![crate::ExcludedSpan { run: "test".into(), from: 0.0, to: 0.6 }];
        let experiment = Experiment::prepare(&slow, &crate::Settings { leave_out, ..kept_periods() }).unwrap();
        assert!(experiment.timeline.weights[5] == 0.0 && experiment.fading.is_some());
    }
}
