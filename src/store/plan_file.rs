//! `plan.toml`: an excitation that anyone can rebuild the motion from.

use crate::atomic;
use plumbline_core::{BadInput, from_toml};
use plumbline_excite::plan::Plan;
use std::path::Path;

/// Text of a plan file; reading it gives the same plan bit by bit.
///
/// # Errors
/// None for a plan of finite numbers.
pub fn plan_text(plan: &Plan) -> std::io::Result<String> {
    let text = toml::to_string(plan).map_err(std::io::Error::other)?;
    Ok(format!("# Excitation of one period: paper eq. 12 with q0, a, b. Angles in rad, times in s.\n{text}"))
}

/// Writes a plan aside, then renames it.
pub fn save_plan(plan: &Plan, path: &Path) -> std::io::Result<()> {
    atomic::write_file(path, plan_text(plan)?.as_bytes())
}

/// Reads a plan from text; `file` is only named in errors.
///
/// # Errors
/// An unknown or missing key, a number that is not finite, amplitudes that don't fit the joints and harmonics.
pub fn parse_plan(file: &str, text: &str) -> Result<Plan, BadInput> {
    let plan: Plan = from_toml(file, text)?;
    for (key, value) in [("rho", plan.rho), ("phi", plan.phi)] {
        if !value.is_finite() {
            return Err(BadInput::new(file, format!("key `{key}`"), value, "an angle in rad"));
        }
    }
    if !(plan.period.is_finite() && plan.period > 0.0) {
        return Err(BadInput::new(file, "key `period`", plan.period, "a period in s, above 0"));
    }
    let expected =
        "one start position per joint and, in a and b, one row per joint with one finite amplitude per harmonic";
    plan.fourier().map_err(|error| BadInput::new(file, "keys `q0`, `a`, `b`", error, expected))?;
    Ok(plan)
}

/// Reads a plan file.
pub fn load_plan(path: &Path) -> Result<Plan, BadInput> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|error| BadInput::new(&file, "file", error, "a readable plan file"))?;
    parse_plan(&file, &text)
}
