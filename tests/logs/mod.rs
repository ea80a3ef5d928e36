//! Public logs of real arms, which are no part of the repository.

use std::path::PathBuf;

/// The folder `$PLUMBLINE_SHARED/data` (default: `../shared/data` beside the package); says so when it is not there.
pub fn data() -> Option<PathBuf> {
    let root = std::env::var_os("PLUMBLINE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared"), PathBuf::from);
    let data = root.join("data");
    if data.is_dir() {
        return Some(data);
    }
    eprintln!("SKIPPED: no measured data in {}", data.display());
    None
}
