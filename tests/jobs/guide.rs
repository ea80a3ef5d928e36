//! The commands of README.md and of the guide run as they are shown.
//!
//! A block marked `sh` is run: all of a page in one shell and one folder of its own, which has the program in its PATH and `config` beside it. A
//! block marked `console` needs hardware, root, a build, or minutes; its first line says which. Other blocks hold no commands.

use plumbline_testkit::job::program;
use plumbline_testkit::page;
use std::fs::Permissions;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};
use tempfile::TempDir;

const PAGES: [&str; 7] = [
    "README.md",
    "docs/guide/simulation.md",
    "docs/guide/franka.md",
    "docs/guide/your-data.md",
    "docs/guide/your-arm.md",
    "docs/guide/diagnosis.md",
    "docs/guide/service.md",
];

fn blocks(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        if let Some(language) = line.strip_prefix("```") {
            let content = lines.by_ref().take_while(|line| *line != "```").map(|line| format!("{line}\n")).collect();
            found.push((language.to_string(), content));
        }
    }
    found
}

#[test]
fn every_block_has_a_known_language() {
    let guide = Path::new(plumbline_testkit::ROOT).join("docs/guide");
    for entry in std::fs::read_dir(guide).unwrap() {
        let name = format!("docs/guide/{}", entry.unwrap().file_name().display());
        assert!(PAGES.contains(&name.as_str()), "{name} is in no test");
    }
    for name in PAGES {
        for (language, content) in blocks(&page::read(name)) {
            match language.as_str() {
                "sh" | "toml" | "text" | "nft" | "ini" => {}
                "console" => assert!(content.starts_with("# "), "{name}: say why this is not run:\n{content}"),
                other => panic!("{name}: a block is marked `{other}`"),
            }
        }
    }
}

/// Runs the blocks that are marked `sh` of pages that a reader follows in this order, in one folder.
fn run(pages: &[&str]) -> TempDir {
    let mut script = String::new();
    for name in pages {
        let before = script.len();
        script.extend(
            blocks(&page::read(name)).into_iter().filter(|(language, _)| language == "sh").map(|(_, text)| text),
        );
        assert!(script.len() > before, "{name} has no command to run");
    }
    let folder = tempfile::tempdir().unwrap();
    symlink(Path::new(plumbline_testkit::ROOT).join("config"), folder.path().join("config")).unwrap();
    // Shared memory and locks of its own: robots have the names that people give them.
    let runtime = folder.path().join("run");
    std::fs::create_dir(&runtime).unwrap();
    std::fs::set_permissions(&runtime, Permissions::from_mode(0o700)).unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    let output = Command::new("sh")
        .args(["-euxc", &script])
        .current_dir(folder.path())
        .env("PATH", format!("{}:{path}", program().parent().unwrap().display()))
        .env("PLUMBLINE_RUNTIME_DIR", &runtime)
        .env_remove("PLUMBLINE_LOG")
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{pages:?}: {}\n{message}", output.status);
    folder
}

#[test]
fn the_pages_on_one_recording_run_in_their_order() {
    let folder = run(&["docs/guide/simulation.md", "docs/guide/your-data.md", "docs/guide/diagnosis.md"]);
    // The figure on these pages is taken from a report.
    let figure = folder.path().join("figure.svg");
    let made = Command::new(Path::new(plumbline_testkit::ROOT).join("docs/figures/from_report.py"))
        .arg(folder.path().join("short/report.html"))
        .arg("presliding in joint 4")
        .arg(&figure)
        .status();
    assert!(made.unwrap().success() && std::fs::read_to_string(figure).unwrap().contains("</svg>"));
}

#[test]
fn your_own_arm_runs() {
    run(&["docs/guide/your-arm.md"]);
}
