//! Place of an effect in a truth file, and the checks that all effects share. An error names file, place, value and what was expected.

use crate::truth::Truth;
use plumbline_core::BadInput;

/// An effect's place in a truth file.
pub(crate) struct Place<'a> {
    pub file: &'a str,
    /// `effect 2`.
    pub name: &'a str,
    /// The arm that has it.
    pub truth: &'a Truth,
    /// When it begins \[s\].
    pub from: f64,
}

impl Place<'_> {
    /// An error of `key`.
    pub fn wrong(&self, key: &str, value: impl ToString, expected: impl Into<String>) -> BadInput {
        BadInput::new(self.file, format!("{}, {key}", self.name), value, expected)
    }

    /// A number that lies in `[low, high]`.
    pub fn range(&self, key: &str, value: f64, low: f64, high: f64) -> Result<(), BadInput> {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.wrong(key, value, format!("{low} to {high}")))
    }

    /// A joint of the arm, counted from 1.
    pub fn joint(&self, joint: usize) -> Result<(), BadInput> {
        self.one_of_the_joints("joint", joint)
    }

    /// A joint of the arm under `key`, other than `joint`.
    pub fn other(&self, key: &str, other: usize, joint: usize) -> Result<(), BadInput> {
        self.one_of_the_joints(key, other)?;
        if other == joint {
            return Err(self.wrong(key, other, format!("another joint than {joint}")));
        }
        Ok(())
    }

    /// A joint of the arm under any key, counted from 1.
    pub fn one_of_the_joints(&self, key: &str, joint: usize) -> Result<(), BadInput> {
        let n = self.truth.joints();
        if (1..=n).contains(&joint) {
            return Ok(());
        }
        Err(self.wrong(key, joint, format!("1 to {n}")))
    }

    /// A vector of finite numbers.
    pub fn finite(&self, key: &str, vector: &[f64]) -> Result<(), BadInput> {
        if vector.iter().all(|value| value.is_finite()) {
            return Ok(());
        }
        Err(self.wrong(key, format!("{vector:?}"), "finite numbers"))
    }
}
