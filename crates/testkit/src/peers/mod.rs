//! The Python environment in which programs of other origin are tested against this one.

#[cfg(feature = "identify")]
pub mod nearest;

use std::process::Command;

/// The interpreter of the peers' environment, which is made when it is missing. `None` when it can't be had and need not.
pub fn interpreter() -> Option<String> {
    interpreter_with(&[])
}

/// The same with further packages, as pip's requirements.
pub fn interpreter_with(requirements: &[&str]) -> Option<String> {
    made_by(requirements)
}

/// The interpreter of an environment by itself, for packages that don't get along with the others.
pub fn interpreter_in(name: &str, requirements: &[&str]) -> Option<String> {
    made_by(&[&["--in", name], requirements].concat())
}

fn made_by(arguments: &[&str]) -> Option<String> {
    let script = crate::path("hil/peers/venv.sh");
    let made = Command::new(script).args(arguments).output().expect("bash runs");
    if made.status.success() {
        return Some(String::from_utf8(made.stdout).unwrap().trim().to_string());
    }
    let why = String::from_utf8_lossy(&made.stderr).trim().to_string();
    assert!(std::env::var("PLUMBLINE_REQUIRE_PEERS").is_err(), "no Python peers: {why}");
    eprintln!("SKIPPED: no Python environment for peers could be made: {why}");
    None
}
