//! The wall between the floors: imports point to strictly lower floors only, and what only one module may use stays there.

use std::fs;
use std::path::{Path, PathBuf};

/// Top-level modules by floor; a module may import from its own tree and from lower floors.
const FLOORS: &[&[&str]] = &[
    &["joint", "input", "atomic", "parallel", "decomposition"],
    &["model", "rt"],
    &["excite", "estimate", "backend", "inclinometer", "ipc", "machine", "recording"],
    &["config", "diagnose", "store", "dataset", "report", "postmortem"],
    &["app"],
];

/// What has one home: the text that gives it away, and the path prefix that may hold it.
const HOMES: &[(&str, &str)] = &[
    ("iceoryx2", "ipc"),
    ("unsafe {", "rt/os.rs"),
    ("rsruckig", "rt"),
    ("socketcan::", "inclinometer/socket.rs"),
    ("mcap::", "recording"),
    ("SymmetricEigen::", "decomposition.rs"),
    (".symmetric_eigen", "decomposition.rs"),
    ("SVD::", "decomposition.rs"),
    (".svd(", "decomposition.rs"),
    (".try_svd(", "decomposition.rs"),
    (".singular_values()", "decomposition.rs"),
];

/// Files that run in the loop: the lint wall stands at their head, or at the head of the module that they belong to.
const HOT: &[&str] = &[
    "rt/mod.rs",
    "app/served.rs",
    "backend/franka/arm.rs",
    "backend/franka/halt.rs",
    "backend/franka/limiter.rs",
    "backend/franka/motion.rs",
    "backend/franka/reference.rs",
    "backend/franka/torque.rs",
    "backend/franka/udp.rs",
    "backend/sim/aba.rs",
    "backend/sim/commands.rs",
    "backend/sim/plant.rs",
    "backend/sim/sensors.rs",
];
const WALL: [&str; 4] = ["#![deny(", "clippy::disallowed_methods", "clippy::unwrap_used", "clippy::panic"];

/// Modules without input, output, clock or randomness of their own.
const PURE: &[&str] = &["model", "excite", "estimate", "diagnose"];
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

/// Path below `src`, and the code in front of the unit tests with comments removed.
fn product_code() -> Vec<(String, String)> {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&src, &mut files);
    files
        .into_iter()
        .map(|path| {
            let name = path.strip_prefix(&src).unwrap().to_string_lossy().into_owned();
            let text = fs::read_to_string(&path).unwrap();
            let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or("");
            let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
            (name, lines.collect::<Vec<_>>().join("\n"))
        })
        .collect()
}

fn floor_of(module: &str) -> Option<usize> {
    FLOORS.iter().position(|floor| floor.contains(&module))
}

/// Names that follow `crate::` in a piece of code, groups included.
fn imported(code: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let parts: Vec<&str> = match rest.strip_prefix('{') {
            Some(group) => group.split('}').next().unwrap_or("").split(',').collect(),
            None => vec![rest],
        };
        for part in parts {
            names.push(part.trim().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        }
    }
    names
}

#[test]
fn imports_point_to_lower_floors() {
    let mut wrong = Vec::new();
    for (file, code) in product_code() {
        let module = file.split('/').next().unwrap().trim_end_matches(".rs").to_string();
        if module == "lib" || module == "main" {
            continue;
        }
        let Some(floor) = floor_of(&module) else {
            wrong.push(format!("{file}: module `{module}` stands on no floor"));
            continue;
        };
        for name in imported(&code) {
            if let Some(other) = floor_of(&name)
                && name != module
                && other >= floor
            {
                wrong.push(format!("{file}: floor {floor} imports `{name}` of floor {other}"));
            }
        }
    }
    assert!(wrong.is_empty(), "\n{}", wrong.join("\n"));
}

#[test]
fn each_of_these_has_one_home() {
    for (file, code) in product_code() {
        for (sign, home) in HOMES {
            assert!(!code.contains(sign) || file.starts_with(home), "{file} holds `{sign}`, whose home is {home}");
        }
    }
}

#[test]
fn pure_modules_touch_nothing_outside() {
    for (file, code) in product_code() {
        if PURE.iter().any(|module| file.starts_with(module)) {
            for sign in IMPURE {
                assert!(!code.contains(sign), "{file} is pure but holds `{sign}`");
            }
        }
    }
}

#[test]
fn the_lint_wall_stands_around_the_loop() {
    let code = product_code();
    for hot in HOT {
        let (_, text) = code.iter().find(|(file, _)| file == hot).unwrap_or_else(|| panic!("{hot} is gone"));
        assert!(WALL.iter().all(|stone| text.contains(stone)), "{hot} is outside the wall");
    }
}

#[test]
fn the_wall_would_notice() {
    assert_eq!(imported("use crate::{joint::State, app::run};\nuse crate::rt::Backend;"), ["joint", "app", "rt"]);
    assert_eq!(floor_of("app"), Some(4));
    assert!(floor_of("joint") < floor_of("rt"));
}
