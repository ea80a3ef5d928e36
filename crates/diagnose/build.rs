//! Hash of the sources that a verdict depends on, so that a figure can name the rules it was made with.

use std::fs;
use std::path::{Path, PathBuf};

/// Sources beside those of this crate: the estimate and the effects' columns. They are absent where this crate stands alone.
const ALSO: [&str; 2] = ["../identify/src", "../model/src"];

fn main() {
    let own = PathBuf::from(std::env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets it"));
    let mut files = Vec::new();
    for folder in ["src"].into_iter().chain(ALSO) {
        println!("cargo::rerun-if-changed={folder}");
        sources(&own.join(folder), &mut files);
    }
    files.sort();
    let texts = files.iter().filter_map(|file| fs::read_to_string(file).ok());
    println!("cargo::rustc-env=PLUMBLINE_RULES={:016x}", texts.fold(FNV_OFFSET, |hash, text| hashed(hash, &text)));
}

/// Rust files below a folder, without those of tests.
fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    for path in fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()) {
        if path.is_dir() {
            sources(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") && !path.ends_with("tests.rs") {
            files.push(path);
        }
    }
}

const FNV_OFFSET: u64 = 0xcbf2_9ce4_8422_2325;
const FNV_PRIME: u64 = 0x0100_0000_01b3;

/// FNV-1a of the lines that are no comments.
fn hashed(hash: u64, text: &str) -> u64 {
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//"));
    lines.flat_map(str::bytes).fold(hash, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(FNV_PRIME))
}
