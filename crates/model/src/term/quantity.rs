//! Quantities that are reported for an effect: its parameters, and derived ones.

use crate::gravity::Mounting;
use crate::parameter::Parameter;
use nalgebra::DMatrix;

/// A number with its standard deviation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Quantity {
    /// Name.
    pub name: String,
    /// Value, in `unit`.
    pub value: f64,
    /// Standard deviation where the data determines one, in `unit`.
    pub std: Option<f64>,
    /// Unit.
    pub unit: String,
}

impl Quantity {
    /// A number without a standard deviation.
    pub fn new(name: impl Into<String>, value: f64, unit: impl Into<String>) -> Quantity {
        Quantity { name: name.into(), value, std: None, unit: unit.into() }
    }
}

/// Inputs of an effect's reported quantities.
#[derive(Clone, Copy, Debug)]
pub struct Results<'a> {
    /// Its linear parameters; a parameter that the data does not determine has no standard deviation.
    pub parameters: &'a [Parameter],
    /// Their covariance in the determined directions.
    pub covariance: &'a DMatrix<f64>,
    /// Undetermined directions, orthonormal columns, one row per parameter.
    pub undetermined: &'a DMatrix<f64>,
    /// Parameters of the model without the effect.
    pub stored: &'a [Parameter],
    /// Declared mounting.
    pub declared: Option<&'a Mounting>,
}

/// The parameters themselves.
pub(super) fn own(results: &Results) -> Vec<Quantity> {
    let quantity = |own: &Parameter| {
        let (name, unit) = (own.column.name.clone(), own.column.unit.into());
        Quantity { name, value: own.value, std: own.std, unit }
    };
    results.parameters.iter().map(quantity).collect()
}
