//! The `[consistent]` block of `model.toml`: physically consistent bodies with the model's parameters, or the nearest ones.

use super::quoted;
use plumbline_core::BadInput;
use plumbline_identify::consistency::{Nearest, Weights, parameters_of};
use plumbline_model::{LinkParameters, TorqueModel, is_consistent};
use serde::Deserialize;

/// Tolerance between bodies and their parameters, as a ratio of the largest parameter.
const SAME: f64 = 1e-9;

#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct Raw {
    exact: bool,
    #[serde(default)]
    distance: f64,
    weights: RawWeights,
    links: Vec<LinkParameters>,
    rotors: Vec<f64>,
    #[serde(default)]
    parameters: Vec<RawParameter>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawWeights {
    Covariance,
    Deviations,
    Relative,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawParameter {
    name: String,
    value: f64,
    moved: f64,
}

/// Writes the block with `line`; all numbers are finite.
pub(super) fn write(line: &mut impl FnMut(std::fmt::Arguments), model: &TorqueModel, found: &Nearest) {
    let weights = match found.weights {
        Weights::Covariance => "covariance",
        Weights::Deviations => "deviations",
        Weights::Relative => "relative",
    };
    line(format_args!("\n[consistent] # bodies with these parameters, or the nearest that there are"));
    line(format_args!("exact = {}\ndistance = {:?} # standard deviations", found.exact, found.distance));
    line(format_args!("weights = \"{weights}\""));
    line(format_args!("links = [ # Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m, inertia about the link frame's origin"));
    for link in &found.links {
        line(format_args!("  {link:?},"));
    }
    line(format_args!("]\nrotors = {:?} # kg m2", found.rotors));
    if found.exact {
        return;
    }
    line(format_args!("parameters = [ # what these have, and how far that moved, in standard deviations"));
    for ((column, value), moved) in model.structure().columns().iter().zip(&found.beta).zip(&found.moved) {
        let name = quoted(&column.name);
        line(format_args!("  {{ name = {name}, value = {value:?}, moved = {moved:?} }},"));
    }
    line(format_args!("]"));
}

impl Raw {
    /// The block of `model`.
    /// Errors: Non-finite numbers, wrong counts, inconsistent bodies, and bodies that do not have the parameters.
    pub(super) fn check(&self, file: &str, model: &TorqueModel) -> Result<Nearest, BadInput> {
        let bad = |key: &str, value: String, expected: &str| {
            Err(BadInput::new(file, format!("[consistent], key `{key}`"), value, expected))
        };
        let structure = model.structure();
        let n = structure.chain().len();
        if self.links.len() != n || self.rotors.len() != n {
            let found = format!("{} links and {} rotors", self.links.len(), self.rotors.len());
            return bad("links", found, &format!("{n} of each"));
        }
        if let Some(i) = self.links.iter().position(|link| !is_consistent(link)) {
            return bad(&format!("links[{i}]"), format!("{:?}", self.links[i]), "parameters that a body can have");
        }
        if let Some(j) = self.rotors.iter().position(|rotor| !(rotor.is_finite() && *rotor >= 0.0)) {
            return bad(&format!("rotors[{j}]"), self.rotors[j].to_string(), "0 or more");
        }
        if !(self.distance.is_finite() && self.distance >= 0.0) {
            return bad("distance", self.distance.to_string(), "0 or more");
        }
        let mut beta = model.beta();
        let mut moved = vec![0.0; beta.len()];
        if !self.exact {
            for (c, column) in structure.columns().iter().enumerate() {
                let Some(own) = self.parameters.iter().find(|own| own.name == column.name) else {
                    return bad(
                        "parameters",
                        format!("no {}", column.name),
                        "a value for every parameter of the model",
                    );
                };
                if !(own.value.is_finite() && own.moved.is_finite()) {
                    return bad("parameters", format!("{} = {}", own.name, own.value), "finite numbers");
                }
                (beta[c], moved[c]) = (own.value, own.moved);
            }
        }
        let size = beta.iter().fold(0.0, |size: f64, value| size.max(value.abs()));
        for (c, value) in parameters_of(structure, &self.links, &self.rotors) {
            if (value - beta[c]).abs() > SAME * size {
                let name = &structure.columns()[c].name;
                return bad("links", format!("{name} = {value}"), &format!("bodies with {name} = {}", beta[c]));
            }
        }
        let weights = match self.weights {
            RawWeights::Covariance => Weights::Covariance,
            RawWeights::Deviations => Weights::Deviations,
            RawWeights::Relative => Weights::Relative,
        };
        let (links, rotors) = (self.links.clone(), self.rotors.clone());
        Ok(Nearest { links, rotors, beta, exact: self.exact, distance: self.distance, moved, weights, iterations: 0 })
    }
}
