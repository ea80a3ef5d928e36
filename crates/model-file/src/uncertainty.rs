//! The `[uncertainty]` block of `model.toml`: covariance of the parameters and residual of the identification.

use nalgebra::DMatrix;
use plumbline_core::{BadInput, symmetric_eigen};
use plumbline_identify::external::ResidualSpectrum;
use plumbline_identify::solve::Identification;
use plumbline_identify::{Spread, TorqueUncertainty};
use plumbline_model::{Parameter, TorqueModel};
use serde::Deserialize;

/// Tolerance between a variance and the square of the standard deviation beside the value, as a ratio.
const SAME: f64 = 1e-6;
/// Largest negative eigenvalue of the correlation matrix that rounding explains, as a ratio of the largest eigenvalue.
const ROUNDING: f64 = 1e-9;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct Raw {
    residual_std: Vec<f64>,
    residual_freedom: f64,
    freedom: Vec<f64>,
    covariance: Vec<Vec<f64>>,
    /// Both are absent in files of earlier versions.
    residual_rate: Option<f64>,
    residual_spectrum: Option<Vec<Vec<f64>>>,
}

/// Largest sampling rate of a recording \[Hz\].
const MAX_RATE: f64 = 1e6;

/// What is wrong with a block: key, found, expected.
type Wrong = (String, String, String);

/// Uncertainty of the model with an identification's parameters and the spectrum of its residual ([`residual_spectrum`](plumbline_identify::external::residual_spectrum));
/// `None`, with a warning, where a model file with it would be refused.
pub fn uncertainty_of(
    identification: &Identification,
    model: &TorqueModel,
    residual_spectrum: Option<ResidualSpectrum>,
) -> Option<TorqueUncertainty> {
    let found = TorqueUncertainty { residual_spectrum, ..TorqueUncertainty::of(identification) };
    match check(&found, model) {
        Ok(()) => Some(found),
        Err((key, value, expected)) => {
            tracing::warn!("the model file gets no uncertainty: {key} is {value}, expected {expected}");
            None
        }
    }
}

fn check(found: &TorqueUncertainty, model: &TorqueModel) -> Result<(), Wrong> {
    let wrong = |key: String, found: String, expected: &str| Err((key, found, expected.to_string()));
    let (n, parameters) = (model.structure().chain().len(), model.parameters());
    let Spread { covariance, freedom } = &found.parameters;
    if found.residual_std.len() != n {
        let found = format!("{} values", found.residual_std.len());
        return wrong("residual-std".into(), found, &format!("{n}, one per joint"));
    }
    if let Some(j) = found.residual_std.iter().position(|std| !(std.is_finite() && *std >= 0.0)) {
        return wrong(format!("residual-std[{j}]"), found.residual_std[j].to_string(), "a torque in Nm, 0 or more");
    }
    let a_freedom = "degrees of freedom, 1 or more";
    if !(found.residual_freedom.is_finite() && found.residual_freedom >= 1.0) {
        return wrong("residual-freedom".into(), found.residual_freedom.to_string(), a_freedom);
    }
    if let Some(spectrum) = &found.residual_spectrum {
        check_spectrum(spectrum, n)?;
    }
    if freedom.len() != parameters.len() {
        let found = format!("{} values", freedom.len());
        return wrong("freedom".into(), found, &format!("{}, one per parameter", parameters.len()));
    }
    // Of an eliminated parameter they are infinite.
    if let Some(c) = freedom.iter().position(|freedom| freedom.is_nan() || *freedom < 1.0) {
        return wrong(format!("freedom[{c}]"), freedom[c].to_string(), a_freedom);
    }
    for (c, Parameter { column, std, .. }) in parameters.iter().enumerate() {
        let name = &column.name;
        for d in 0..=c {
            let value = covariance[(c, d)];
            if !value.is_finite() {
                let other = &parameters[d].column.name;
                return wrong(format!("covariance of {name} and {other}"), value.to_string(), "a finite number");
            }
        }
        let variance = covariance[(c, c)];
        let key = || format!("covariance of {name} and {name}");
        if variance < 0.0 {
            return wrong(key(), variance.to_string(), "a variance, 0 or more");
        }
        if let Some(std) = std
            && (variance - std * std).abs() > SAME * std * std
        {
            return wrong(key(), variance.to_string(), &format!("{}, the square of its std", std * std));
        }
    }
    let scale: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
    let correlation = DMatrix::from_fn(scale.len(), scale.len(), |c, d| match covariance[(c, d)] {
        0.0 => 0.0,
        value => value / scale[c] / scale[d],
    });
    // Also what a variance of 0 gives: infinity.
    if let Some(at) = correlation.iter().position(|value| value.abs() > 1.0 + ROUNDING) {
        let (c, d) = (at % scale.len(), at / scale.len());
        let (first, second) = (&parameters[c.max(d)].column.name, &parameters[c.min(d)].column.name);
        let expected = format!("at most {:?}, the product of their standard deviations", scale[c] * scale[d]);
        return wrong(format!("covariance of {first} and {second}"), covariance[(c, d)].to_string(), &expected);
    }
    let eigenvalues = symmetric_eigen(correlation).map(|eigen| eigen.eigenvalues);
    let (least, largest) = eigenvalues.map_or((f64::NEG_INFINITY, 0.0), |values| (values.min(), values.max()));
    if least < -ROUNDING * largest.max(0.0) {
        let found = format!("a matrix whose correlations have the eigenvalue {least:e}");
        return wrong("covariance".into(), found, "a positive semi-definite matrix");
    }
    Ok(())
}

fn check_spectrum(spectrum: &ResidualSpectrum, n: usize) -> Result<(), Wrong> {
    let wrong = |key: String, found: String, expected: &str| Err((key, found, expected.to_string()));
    let ResidualSpectrum { rate, power } = spectrum;
    if !(*rate >= 1.0 && *rate <= MAX_RATE) {
        return wrong("residual-rate".into(), rate.to_string(), "a sampling rate, 1 to 1e6 Hz");
    }
    if power.len() != n {
        return wrong("residual-spectrum".into(), format!("{} rows", power.len()), &format!("{n}, one per joint"));
    }
    let bands = ResidualSpectrum::bands(*rate).count();
    for (j, power) in power.iter().enumerate() {
        if power.len() != bands {
            let expected = format!("{bands}, one per band up to half the residual-rate");
            return wrong(format!("residual-spectrum[{j}]"), format!("{} values", power.len()), &expected);
        }
        if let Some(band) = power.iter().position(|value| !(value.is_finite() && *value >= 0.0)) {
            let key = format!("residual-spectrum[{j}][{band}]");
            return wrong(key, power[band].to_string(), "a power in Nm^2, 0 or more");
        }
    }
    Ok(())
}

/// Writes the block with `line`.
pub(super) fn write(line: &mut impl FnMut(std::fmt::Arguments), model: &TorqueModel, found: &TorqueUncertainty) {
    let Spread { covariance, freedom } = &found.parameters;
    line(format_args!("\n[uncertainty] # parameters in the order of this file"));
    line(format_args!("residual-std = {:?} # one raw torque sample, Nm", found.residual_std));
    line(format_args!("residual-freedom = {:?}", found.residual_freedom));
    if let Some(ResidualSpectrum { rate, power }) = &found.residual_spectrum {
        line(format_args!("residual-rate = {rate:?} # Hz"));
        line(format_args!(
            "residual-spectrum = [ # per joint, Nm^2: 0 to 0.25 Hz, then half octaves up to half the rate"
        ));
        power.iter().for_each(|power| line(format_args!("  {power:?},")));
        line(format_args!("]"));
    }
    line(format_args!("freedom = {freedom:?} # of the variance of each parameter"));
    line(format_args!("covariance = [ # lower triangle; the diagonal is the square of each std"));
    for (c, parameter) in model.parameters().iter().enumerate() {
        let row: Vec<f64> = (0..=c).map(|d| covariance[(c, d)]).collect();
        line(format_args!("  {row:?}, # {}", parameter.column.name));
    }
    line(format_args!("]"));
}

impl Raw {
    /// The block of `model`; `names` are the parameters in the order of the file.
    /// Errors: wrong counts, numbers that are not finite, a matrix that is not positive semi-definite, variances that are not the squares of the model's
    /// standard deviations.
    pub(super) fn check(&self, file: &str, names: &[&str], model: &TorqueModel) -> Result<TorqueUncertainty, BadInput> {
        let bad =
            |(key, found, expected): Wrong| BadInput::new(file, format!("[uncertainty], key `{key}`"), found, expected);
        let missing =
            |key: &str, other: &str| bad((key.into(), "no value".into(), format!("a value, as `{other}` has one")));
        let p = names.len();
        if self.covariance.len() != p {
            let found = format!("{} rows", self.covariance.len());
            return Err(bad(("covariance".into(), found, format!("{p}, one per parameter"))));
        }
        if let Some(c) = (0..p).find(|&c| self.covariance[c].len() != c + 1) {
            let found = format!("{} values", self.covariance[c].len());
            let expected = format!("{}, the parameters up to {}", c + 1, names[c]);
            return Err(bad((format!("covariance[{c}]"), found, expected)));
        }
        if self.freedom.len() != p {
            let found = format!("{} values", self.freedom.len());
            return Err(bad(("freedom".into(), found, format!("{p}, one per parameter"))));
        }
        // The model's order need not be that of the file.
        let place = |parameter: &Parameter| names.iter().position(|name| *name == parameter.column.name);
        let Some(places) = model.parameters().iter().map(place).collect::<Option<Vec<usize>>>() else {
            let found = format!("{p} parameters in the file");
            return Err(bad(("covariance".into(), found, "every parameter of the model".into())));
        };
        let covariance = DMatrix::from_fn(places.len(), places.len(), |c, d| {
            let (row, column) = (places[c].max(places[d]), places[c].min(places[d]));
            self.covariance[row][column]
        });
        let residual_spectrum = match (&self.residual_rate, &self.residual_spectrum) {
            (Some(rate), Some(power)) => Some(ResidualSpectrum { rate: *rate, power: power.clone() }),
            (None, None) => None,
            (Some(_), None) => return Err(missing("residual-spectrum", "residual-rate")),
            (None, Some(_)) => return Err(missing("residual-rate", "residual-spectrum")),
        };
        let found = TorqueUncertainty {
            parameters: Spread { covariance, freedom: places.iter().map(|&place| self.freedom[place]).collect() },
            residual_std: self.residual_std.clone(),
            residual_freedom: self.residual_freedom,
            residual_spectrum,
        };
        check(&found, model).map_err(bad)?;
        Ok(found)
    }
}
