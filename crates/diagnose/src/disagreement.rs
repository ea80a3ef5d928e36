//! Unseen runs that a model predicts worse than its own runs: something differs between them.
//!
//! One model for all runs is an assumption. A tool that was picked up, a base that was tilted or a sensor that was zeroed between two runs breaks
//! it, and the runs that were identified from cannot show that.

use super::errors::Of;
use super::evidence::{BAND_EDGES_HZ, Evidence, LOW_BANDS, Trial};
use super::outcome::{Disagreement, Fitted};
use super::state::{mean_square_below, unmodelled_below};
use super::unseen::Unseen;
use nalgebra::DVector;
use plumbline_identify::validate_parameters;
use plumbline_model::Chain;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Smallest ratio of an unseen run's RMS to the expected one for the run to differ,
const MIN_RMS_RATIO: f64 = 2.0;
/// and where the model has effects: their forms are approximations, which leave a rest on other motions.
const MIN_RMS_RATIO_WITH_EFFECTS: f64 = 2.5;
/// Share of what effects change in a run that their forms may leave there below 4 Hz.
const MAX_REST_OF_EFFECTS: f64 = 0.2;
/// Probability that noise alone lets any joint of any run differ.
const FALSE_ALARM_PROBABILITY: f64 = 1e-3;

/// Largest ratio of an unseen run's reported error to the reported noise floor beside which nothing is significant.
const MAX_FLOORS_OF_NOTHING: f64 = 2.0;

/// Errors of the parameters to expect, in their standard deviations.
const PARAMETER_DEVIATIONS: f64 = 1.5;

/// Unseen runs with a joint whose residual exceeds its limit, the worst joint of each run, in the order of the runs.
pub struct Disagreements {
    /// Beyond what the errors of the parameters explain.
    pub different: Vec<Disagreement>,
    /// No more than they explain; expected is the RMS without them.
    pub undetermined: Vec<Disagreement>,
}

/// Frequencies below which an unseen run is compared.
struct Look {
    bands: usize,
    /// Least ratio of its RMS to the expected one for the run to differ.
    least: f64,
    /// Share of what the effects do there that their forms may leave.
    rest: f64,
}

const WITHOUT_EFFECTS: [Look; 1] = [Look { bands: LOW_BANDS, least: MIN_RMS_RATIO, rest: 0.0 }];
const WITH_EFFECTS: [Look; 2] = [
    Look { bands: BAND_EDGES_HZ.len(), least: MIN_RMS_RATIO_WITH_EFFECTS, rest: 0.0 },
    Look { bands: LOW_BANDS, least: MIN_RMS_RATIO_WITH_EFFECTS, rest: MAX_REST_OF_EFFECTS },
];

/// Runs that disagree with a model. Expected are the noise, what the model lacks in the runs it was identified from, and the errors of its parameters:
///
///   E = sqrt(noise^2 + lack^2 + 1.5^2 mean_k(m_k' C m_k) + rest^2)
///
/// below 4 Hz, for above that noise of coarse encoders hides what a run without any effect lacks. `m_k` is the row of sample k and `C` the covariance of the
/// parameters: the noise is an average over many samples, but all samples share the errors of the parameters, which are often larger than their standard
/// deviation. A run differs above `E max(2, sqrt(F))`, 2.5 with effects, with the quantile `F` of the F distribution for the degrees of freedom of the noise in
/// the run and in the identified ones: slow noise has few.
///
/// A model with effects has a `plain` one beside it. It is compared in the whole band with a rest of zero, and below 4 Hz with a fifth of what its effects change
/// there. `identified` are the runs that `fitted` was identified from, in `evidence`.
pub fn disagreements(
    chain: &Chain,
    evidence: &Evidence,
    identified: &[Trial],
    unseen: &[Trial],
    fitted: &Fitted,
    plain: Option<&Fitted>,
    band: f64,
) -> Disagreements {
    let looks: &[Look] = if plain.is_some() { &WITH_EFFECTS } else { &WITHOUT_EFFECTS };
    let beta = |of: &Fitted| DVector::from_column_slice(&of.identification.beta);
    let own = Unseen::of_model(evidence, fitted, identified).residual_of_each(&beta(fitted));
    let lack = |look: &Look| {
        own.iter().enumerate().map(|(joint, own)| unmodelled_below(evidence, joint, own, look.bands)).collect()
    };
    let lacks: Vec<Vec<f64>> = looks.iter().map(lack).collect();
    let mut found = Disagreements { different: Vec::new(), undetermined: Vec::new() };
    for trial in unseen {
        let trials = std::slice::from_ref(trial);
        let of_run = Evidence::of(chain, trials, band);
        if of_run.folds().is_empty() {
            continue;
        }
        let model = Unseen::of_model(&of_run, fitted, trials);
        let residual = model.residual_of_each(&beta(fitted));
        let of_plain = plain.map(|plain| Unseen::of_model(&of_run, plain, trials).residual_of_each(&beta(plain)));
        let periods = trial.experiment.averaged_periods();
        let joint = |deviations: f64, (Look { bands, least, rest }, lacks): (&Look, &Vec<f64>), joint: usize| {
            let noise = evidence.floor_of_periods_below(joint, *bands, periods).unwrap_or(0.0).powi(2);
            let parameters = model.variance(joint, &fitted.identification.covariance, *bands);
            let changed = |plain: &Vec<DVector<f64>>| {
                mean_square_below(&of_run, joint, &(&plain[joint] - &residual[joint]), *bands)
            };
            let effects = of_plain.as_ref().map_or(0.0, changed);
            let expected = (noise + lacks[joint] + deviations * deviations * parameters + rest * rest * effects).sqrt();
            let alone = FALSE_ALARM_PROBABILITY / (unseen.len() * of_run.joints()) as f64;
            let freedom = [of_run.rows_of_noise_below(joint, *bands), evidence.freedom_of_noise_below(joint, *bands)];
            let of_noise = || mean_square_ratio(alone, freedom[0], freedom[1]).sqrt();
            let ratio = if evidence.repeats() { of_noise() } else { 0.0 };
            Disagreement {
                run: trial.experiment.name.clone(),
                joint: joint + 1,
                rms: mean_square_below(&of_run, joint, &residual[joint], *bands).sqrt(),
                expected,
                limit: expected * ratio.max(*least),
            }
        };
        let worst = |deviations: f64| {
            let looks = looks.iter().zip(&lacks);
            let all = looks.flat_map(|look| (0..of_run.joints()).map(move |own| (look, own)));
            all.map(|(look, own)| joint(deviations, look, own))
                .max_by(|a, b| a.ratio().total_cmp(&b.ratio()))
                .filter(|worst| worst.ratio() > 1.0)
        };
        match worst(PARAMETER_DEVIATIONS) {
            Some(worst) => found.different.push(worst),
            None => found.undetermined.extend(worst(0.0)),
        }
    }
    found
}

/// Unseen runs whose reported error exceeds twice the noise `floor` that is reported beside it \[Nm\], the worst joint of each: noise floors of few periods and
/// the errors of the parameters let such a run agree, and the reader of the two figures sees one that does not.
pub fn above_floor(unseen: &[Trial], fitted: &Fitted, floor: &[f64], of: Of) -> Vec<Disagreement> {
    let worst = |trial: &Trial| {
        let rms = validate_parameters(trial.experiment, &fitted.structure, &fitted.identification.beta);
        let errors = if of == Of::Raw { rms.raw } else { rms.filtered };
        let of_joint = |(joint, (rms, &floor)): (usize, (f64, &f64))| Disagreement {
            run: trial.experiment.name.clone(),
            joint: joint + 1,
            rms,
            expected: floor,
            limit: MAX_FLOORS_OF_NOTHING * floor,
        };
        let all = errors.into_iter().zip(floor).enumerate().map(of_joint);
        all.max_by(|a, b| a.ratio().total_cmp(&b.ratio())).filter(|worst| worst.ratio() > 1.0)
    };
    unseen.iter().filter_map(worst).collect()
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
