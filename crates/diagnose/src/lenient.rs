//! JSON has no NaN: a figure that could not be measured is `null` in the file and NaN in memory.

use serde::{Deserialize, Deserializer};

pub(crate) fn number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

pub(crate) fn numbers<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f64>, D::Error> {
    let values: Vec<Option<f64>> = Vec::deserialize(deserializer)?;
    Ok(values.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect())
}

pub(crate) fn intervals<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<[f64; 2]>, D::Error> {
    let values: Vec<Option<[Option<f64>; 2]>> = Vec::deserialize(deserializer)?;
    let interval = |ends: Option<[Option<f64>; 2]>| ends.unwrap_or_default().map(|end| end.unwrap_or(f64::NAN));
    Ok(values.into_iter().map(interval).collect())
}
