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

/// Figures that a faster or busier machine changes, and a small difference of two errors, which scatters by a sixth of itself: of these lines, what
/// follows the word.
const SCATTERED: [(&str, &str); 2] = [("loop (simulated time", "execution"), ("counter-experiment", "most")];

/// The first indented block after a heading, without its indentation.
fn block(text: &str, heading: &str) -> Vec<String> {
    let lines = text.lines().skip_while(|line| *line != heading).skip_while(|line| !line.starts_with("    "));
    lines.take_while(|line| line.starts_with("    ")).map(|line| line[4..].to_string()).collect()
}

/// A word as what stands before its number, the number, its decimals, and what stands after it.
fn parts(word: &str) -> Option<(&str, f64, usize, &str)> {
    let of_number = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let begin = word.find(of_number)?;
    let end = word[begin..].find(|c| !of_number(c)).map_or(word.len(), |length| begin + length);
    let number = &word[begin..end];
    let decimals = number.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    Some((&word[..begin], number.parse().ok()?, decimals, &word[end..]))
}

/// Whether two numbers, of which the first is shown with so many decimals, are the same figure of two runs of one job. Simulated time runs on
/// between motions for as long as the processes take, so the noise of two runs differs. Small counts must be equal.
fn near(one: f64, other: f64, decimals: usize) -> bool {
    let (apart, size) = ((one - other).abs(), one.abs().max(other.abs()));
    match decimals {
        0 if size < 100.0 => apart == 0.0,
        0 => apart <= 0.1 * size,
        // What an effect leaves of the torque that repeats is next to nothing, and its last digit is noise.
        _ => apart <= (0.1 * size).max(5.01 * 10f64.powi(-(decimals as i32))),
    }
}

/// The same words, and numbers that are [`near`]. [`SCATTERED`] figures are numbers in both.
fn says_the_same(shown: &str, printed: &str) -> bool {
    let (one, other): (Vec<&str>, Vec<&str>) = (shown.split(' ').collect(), printed.split(' ').collect());
    let scattered = SCATTERED.iter().find(|(begin, _)| shown.starts_with(begin)).map(|(_, word)| *word);
    let from = scattered.and_then(|word| one.iter().position(|other| *other == word)).unwrap_or(one.len());
    one.len() == other.len()
        && one.iter().zip(&other).enumerate().all(|(index, (one, other))| {
            one == other
                || parts(one).zip(parts(other)).is_some_and(|(one, other)| {
                    let near = index > from || near(one.1, other.1, one.2.min(other.2));
                    (one.0, one.3) == (other.0, other.3) && near
                })
        })
}

const PAGES: [&str; 8] = [
    "README.md",
    "docs/guide/simulation.md",
    "docs/guide/franka.md",
    "docs/guide/your-data.md",
    "docs/guide/your-arm.md",
    "docs/guide/diagnosis.md",
    "docs/guide/service.md",
    "docs/guide/controller.md",
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
                // The examples of `plumbline-client` include the page.
                "rust,no_run" if name == "docs/guide/controller.md" => {}
                "sh" | "toml" | "text" | "nft" | "ini" | "cmake" | "python" => {}
                "console" => assert!(content.starts_with("# "), "{name}: say why this is not run:\n{content}"),
                other => panic!("{name}: a block is marked `{other}`"),
            }
        }
    }
}

/// Runs the blocks that are marked `sh` of pages that a reader follows in this order, in one folder: the folder, and what the commands print.
fn run(pages: &[&str]) -> (TempDir, String) {
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
    (folder, String::from_utf8(output.stdout).unwrap())
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn the_pages_on_one_recording_run_in_their_order() {
    let (folder, output) = run(&["docs/guide/simulation.md", "docs/guide/your-data.md", "docs/guide/diagnosis.md"]);
    // The first command is the job whose output the page shows.
    let shown = block(&page::read("docs/guide/simulation.md"), "## What you see");
    assert!(shown.len() > 10, "{shown:?}");
    let printed: Vec<&str> = output.lines().take(shown.len()).collect();
    let same = shown.iter().zip(&printed).all(|(one, other)| says_the_same(one, other));
    let block: String = printed.iter().map(|line| format!("    {line}\n")).collect();
    assert!(same, "docs/guide/simulation.md, `What you see`, shows other lines than the program prints:\n{block}");
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
#[ignore = "hil/long-tests/run.sh"]
fn your_own_arm_runs() {
    run(&["docs/guide/your-arm.md"]);
}

#[test]
fn different_words_and_numbers_are_detected() {
    let shown = "RMS wall [Nm], 5 unseen runs: 0.152 [0.151 0.152]";
    assert!(says_the_same(shown, shown) && says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.153 [0.151 0.151]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.184 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 6 unseen runs: 0.152 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS roof [Nm], 5 unseen runs: 0.152 [0.151 0.152]"));
    assert!(!says_the_same(shown, "RMS wall [Nm], 5 unseen runs: 0.152 [0.151 0.152"));
    let cycles =
        "loop (simulated time, as fast as possible): 799820 cycles, 0 lost, execution p50 0.736 p99 3.78 max 5212 us";
    assert!(says_the_same(cycles, &cycles.replace("5212", "1.2").replace("0.736", "20").replace("799820", "790000")));
    assert!(!says_the_same(cycles, &cycles.replace("0 lost", "1 lost")));
    let forced =
        "counter-experiment: forced, its RMS there is 0.206 Nm in joint 1 and changes by at most 3.85 % in the others";
    assert!(
        says_the_same(forced, &forced.replace("3.85", "4.45"))
            && !says_the_same(forced, &forced.replace("0.206", "0.306"))
    );
}
