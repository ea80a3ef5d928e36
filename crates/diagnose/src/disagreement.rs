//! Unseen runs that a model predicts worse than its own runs: something differs between them.
//!
//! One model for all runs is an assumption. A tool that was picked up, a base that was tilted or a sensor that was zeroed between two runs breaks
//! it, and the runs that were identified from cannot show that.

use super::evidence::{BAND_EDGES_HZ, Evidence, LOW_BANDS, Trial};
use super::outcome::{Disagreement, Fitted};
use super::state::{mean_square_below, unmodelled_below};
use super::unseen::Unseen;
use nalgebra::DVector;
use plumbline_model::Chain;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Smallest ratio of an unseen run's RMS to the expected one for the run to differ,
const MIN_RMS_RATIO: f64 = 2.0;
/// and where the model has effects: their forms are approximations, which leave a rest on other motions.
const MIN_RMS_RATIO_WITH_EFFECTS: f64 = 2.5;
/// Probability that noise alone lets any joint of any run differ.
const FALSE_ALARM_PROBABILITY: f64 = 1e-3;

/// Errors of the parameters to expect, in their standard deviations.
const PARAMETER_DEVIATIONS: f64 = 1.5;

/// Unseen runs with a joint whose residual exceeds its limit, the worst joint of each run, in the order of the runs.
pub struct Disagreements {
    /// Beyond what the errors of the parameters explain.
    pub different: Vec<Disagreement>,
    /// No more than they explain; expected is the RMS without them.
    pub undetermined: Vec<Disagreement>,
}

/// Runs that disagree with a model. Expected are the noise, what the model lacks in the runs it was identified from, and the errors of its parameters:
///
///   E = sqrt(noise^2 + lack^2 + 1.5^2 mean_k(m_k' C m_k))
///
/// below 4 Hz, for above that noise of coarse encoders hides what a run without any effect lacks; of a model `with_effects` in the whole band. `m_k` is the
/// row of sample k and `C` the covariance of the parameters: the noise is an average over many samples, but all samples share the errors of the parameters,
/// which are often larger than their standard deviation. A run differs above `E max(2, sqrt(F))`, 2.5 with effects, with the quantile `F` of the F
/// distribution for the degrees of freedom of the noise in the run and in the identified ones: slow noise has few.
/// `identified` are the runs that `fitted` was identified from, in `evidence`.
pub fn disagreements(
    chain: &Chain,
    evidence: &Evidence,
    identified: &[Trial],
    unseen: &[Trial],
    fitted: &Fitted,
    band: f64,
    with_effects: bool,
) -> Disagreements {
    let (bands, least) = match with_effects {
        true => (BAND_EDGES_HZ.len(), MIN_RMS_RATIO_WITH_EFFECTS),
        false => (LOW_BANDS, MIN_RMS_RATIO),
    };
    let beta = DVector::from_column_slice(&fitted.identification.beta);
    let own = Unseen::of_model(evidence, fitted, identified);
    let lack = |joint: usize| unmodelled_below(evidence, joint, &own.residual(joint, &beta), bands);
    let lacks: Vec<f64> = (0..evidence.joints()).map(lack).collect();
    let freedom: Vec<f64> = (0..evidence.joints()).map(|joint| evidence.freedom_of_noise_below(joint, bands)).collect();
    let mut found = Disagreements { different: Vec::new(), undetermined: Vec::new() };
    for trial in unseen {
        let trials = std::slice::from_ref(trial);
        let of_run = Evidence::of(chain, trials, band);
        if of_run.folds().is_empty() {
            continue;
        }
        let model = Unseen::of_model(&of_run, fitted, trials);
        let periods = trial.experiment.averaged_periods() as f64;
        let noise = |joint: usize| evidence.floor_of_periods_below(joint, bands, periods).unwrap_or(0.0).powi(2);
        let noise: Vec<f64> = (0..of_run.joints()).map(noise).collect();
        let joint = |deviations: f64, joint: usize| {
            let square = mean_square_below(&of_run, joint, &model.residual(joint, &beta), bands);
            let parameters = model.variance(joint, &fitted.identification.covariance, bands);
            let expected = (noise[joint] + lacks[joint] + deviations * deviations * parameters).sqrt();
            let alone = FALSE_ALARM_PROBABILITY / (unseen.len() * of_run.joints()) as f64;
            let of_noise = || mean_square_ratio(alone, of_run.rows_of_noise_below(joint, bands), freedom[joint]).sqrt();
            let ratio = if evidence.repeats() { of_noise() } else { 0.0 };
            Disagreement {
                run: trial.experiment.name.clone(),
                joint: joint + 1,
                rms: square.sqrt(),
                expected,
                limit: expected * ratio.max(least),
            }
        };
        let worst = |deviations: f64| {
            let joints = (0..of_run.joints()).map(|own| joint(deviations, own));
            joints.max_by(|a, b| a.ratio().total_cmp(&b.ratio())).filter(|worst| worst.ratio() > 1.0)
        };
        match worst(PARAMETER_DEVIATIONS) {
            Some(worst) => found.different.push(worst),
            None => found.undetermined.extend(worst(0.0)),
        }
    }
    found
}

/// Ratio of two mean squares of the same noise with these degrees of freedom that is exceeded with a probability: quantile of the F distribution.
/// Without limit where either has none.
fn mean_square_ratio(probability: f64, first: f64, second: f64) -> f64 {
    FisherSnedecor::new(first, second).map_or(f64::INFINITY, |f| f.inverse_cdf(1.0 - probability))
}

#[cfg(test)]
mod tests {
    use super::mean_square_ratio;

    #[test]
    fn quantiles_agree_with_the_tables() {
        // NIST/SEMATECH e-Handbook of Statistical Methods, section 1.3.6.7.3, at 1 %.
        for (first, second, table) in [(1.0, 10.0, 10.044), (5.0, 20.0, 4.103), (10.0, 100.0, 2.503)] {
            let ratio = mean_square_ratio(0.01, first, second) / table;
            assert!((ratio - 1.0).abs() < 5e-4, "{first} {second}: {ratio} of {table}");
        }
        // Without periods to compare the noise has no freedom, and nothing can be said.
        assert_eq!(mean_square_ratio(0.01, 5.0, 0.0), f64::INFINITY);
    }
}
