//! Identity of a robot in service names and lock files.

use std::fmt;

use plumbline_core::BadInput;

/// Identity of a robot: 1 to 64 characters of `a-z 0-9 - _ .`, valid in service names and file names alike.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct RobotId(String);

impl RobotId {
    /// Parses `text`; `file` and `place` appear in the error only.
    pub fn parse(file: &str, place: &str, text: &str) -> Result<RobotId, BadInput> {
        let allowed = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || "-_.".contains(c);
        if (1..=64).contains(&text.len()) && text.chars().all(allowed) {
            return Ok(RobotId(text.to_string()));
        }
        Err(BadInput::new(file, place, format!("`{text}`"), "1 to 64 characters of a-z, 0-9, `-`, `_` and `.`"))
    }

    /// The identity as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for RobotId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_accepted_and_paths_rejected() {
        for good in ["panda", "sim-panda.wall_2", "a", &"x".repeat(64)] {
            assert_eq!(RobotId::parse("f", "robot", good).unwrap().as_str(), good);
        }
        for bad in ["", "Panda", "a/b", "a b", "\u{e4}", "a\0", &"x".repeat(65)] {
            let error = RobotId::parse("f.toml", "robot", bad).unwrap_err();
            assert_eq!(error.file, "f.toml");
            assert!(error.value.contains(bad));
        }
    }
}
