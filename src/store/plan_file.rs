//! `plan.toml`: a plan of an excitation.

use crate::atomic;
use plumbline_core::BadInput;
use plumbline_excite::{Plan, parse_plan, plan_text};
use std::path::Path;

pub fn save_plan(plan: &Plan, path: &Path) -> std::io::Result<()> {
    atomic::write_file(path, plan_text(plan).map_err(std::io::Error::other)?.as_bytes())
}

pub fn load_plan(path: &Path) -> Result<Plan, BadInput> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|error| BadInput::new(&file, "file", error, "a readable plan file"))?;
    parse_plan(&file, &text)
}
