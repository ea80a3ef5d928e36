//! What Cargo's dependencies and lints can't say about the sources.

use std::fs;
use std::path::{Path, PathBuf};

/// What has one home: the text that gives it away, and the path prefix that may hold it.
const HOMES: &[(&str, &str)] = &[
    ("unsafe {", "crates/rt/src/os.rs"),
    ("socketcan::", "src/inclinometer/socket.rs"),
    ("mcap::", "src/recording"),
    ("plotters::", "src/"),
    ("SymmetricEigen::", "crates/core/src/decomposition.rs"),
    (".symmetric_eigen", "crates/core/src/decomposition.rs"),
    ("SVD::", "crates/core/src/decomposition.rs"),
    (".svd(", "crates/core/src/decomposition.rs"),
    (".try_svd(", "crates/core/src/decomposition.rs"),
    (".singular_values()", "crates/core/src/decomposition.rs"),
];

/// Files outside `plumbline-rt` that run in the loop: the lint wall stands at their head, or at the head of the module whose folder they are in.
const REAL_TIME: &[&str] = &[
    "crates/client/src/evaluation.rs",
    "crates/client/src/guest.rs",
    "crates/client/src/model.rs",
    "crates/franka/src/cycle/arm.rs",
    "crates/franka/src/cycle/limiter.rs",
    "crates/franka/src/cycle/motion.rs",
    "crates/franka/src/cycle/reference.rs",
    "crates/franka/src/cycle/torque.rs",
    "crates/franka/src/cycle/transport.rs",
    "crates/franka/src/cycle/udp.rs",
    "crates/model/src/lib.rs",
    "crates/rt/src/lib.rs",
    "crates/sim/src/lib.rs",
];
const WALL: [&str; 4] = ["#![deny(", "clippy::disallowed_methods", "clippy::unwrap_used", "clippy::panic"];

/// Crates without input, output, clock or randomness of their own.
const PURE: &[&str] = &["crates/excite/", "crates/identify/", "crates/diagnose/", "crates/model/"];
const ROBOT_FILES: &str = "crates/model/src/robot.rs";
const IMPURE: &[&str] =
    &["std::fs", "std::io", "std::net", "std::time", "std::env", "std::process", "println!", "tracing"];

fn sources(dir: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Path from the root, and the code in front of the unit tests with comments removed, of all that is in the program.
fn product_code() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    sources(&root.join("src"), &mut files);
    for entry in fs::read_dir(root.join("crates")).unwrap() {
        let path = entry.unwrap().path();
        if path.file_name().is_some_and(|name| name != "testkit") {
            sources(&path.join("src"), &mut files);
        }
    }
    files
        .into_iter()
        .map(|path| {
            let name = path.strip_prefix(root).unwrap().to_string_lossy().into_owned();
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or("");
            let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
            (name, lines.collect::<Vec<_>>().join("\n"))
        })
        .collect()
}

/// Files of the program that may name a backend's crate: its settings, and the line that selects it.
const BACKENDS: &[&str] = &["src/config/job/", "src/setup/backend.rs"];

#[test]
fn a_backend_is_named_by_its_settings_and_in_one_line() {
    for (file, code) in product_code().iter().filter(|(file, _)| file.starts_with("src/")) {
        let names = ["plumbline_franka", "plumbline_sim"].into_iter().find(|name| code.contains(name));
        let allowed = BACKENDS.iter().any(|home| file.starts_with(home));
        assert!(names.is_none() || allowed, "{file} names {names:?}");
    }
}

#[test]
fn each_of_these_has_one_home() {
    for (file, code) in product_code() {
        for (sign, home) in HOMES {
            // The pointers of C callers.
            let is_of_c = *sign == "unsafe {" && file.starts_with("crates/client-c/src/");
            assert!(
                !code.contains(sign) || file.starts_with(home) || is_of_c,
                "{file} holds `{sign}`, whose home is {home}"
            );
        }
    }
}

#[test]
fn pure_crates_touch_nothing_outside() {
    for (file, code) in product_code() {
        if PURE.iter().any(|module| file.starts_with(module)) && file != ROBOT_FILES {
            for sign in IMPURE {
                assert!(!code.contains(sign), "{file} is pure but holds `{sign}`");
            }
        }
    }
}

#[test]
fn the_lint_wall_stands_around_the_loop() {
    let code = product_code();
    for file in REAL_TIME {
        let (_, text) = code.iter().find(|(name, _)| name == file).unwrap_or_else(|| panic!("{file} is gone"));
        let (folder, name) = file.rsplit_once('/').unwrap();
        let declared = format!("mod {};", name.trim_end_matches(".rs"));
        let module = code.iter().find(|(name, _)| *name == format!("{folder}/mod.rs"));
        let module = module.map(|(_, text)| text).filter(|text| text.contains(&declared));
        let holds = |text: &String| WALL.iter().all(|stone| text.contains(stone));
        assert!(holds(text) || module.is_some_and(holds), "{file} is outside the wall");
    }
}

/// The exceptions of `forbid(unsafe_code)`: `plumbline-rt` for its calls of the operating system, `plumbline-client-c` for the pointers of C.
#[test]
fn unsafe_code_is_forbidden_by_every_crate_but_two() {
    let with_unsafe = ["crates/rt/src/lib.rs", "crates/client-c/src/lib.rs"];
    let roots = product_code().into_iter().filter(|(file, _)| file.ends_with("src/lib.rs") || file == "src/main.rs");
    for (file, code) in roots {
        assert_eq!(code.contains("#![forbid(unsafe_code)]"), !with_unsafe.contains(&file.as_str()), "{file}");
    }
}
