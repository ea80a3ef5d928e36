//! Public logs of real arms, which are not part of the repository.

use std::path::PathBuf;

/// The folder `$PLUMBLINE_SHARED/data` (default: `../shared/data` beside the package); says so when it is not there.
pub fn data() -> Option<PathBuf> {
    let root = std::env::var_os("PLUMBLINE_SHARED").map_or_else(|| crate::path("../shared"), PathBuf::from);
    let data = root.join("data");
    if data.is_dir() {
        return Some(data);
    }
    eprintln!("SKIPPED: no measured data in {}", data.display());
    None
}

/// Asserts that the line of docs/results/real-arms.md that begins with `head` has these figures, one per joint.
///
/// The last digit depends on the processor: the tolerance is 0.002 and half a percent.
#[allow(dead_code, reason = "not every program of tests compares with the page")]
pub fn page_says(head: &str, figures: &[f64]) {
    let shown: Vec<String> = figures.iter().map(|figure| format!("{figure:.3}")).collect();
    println!("{head} {} |", shown.join(" | "));
    let page = crate::page::read("docs/results/real-arms.md");
    let line = page.lines().find_map(|line| line.strip_prefix(head));
    let line = line.unwrap_or_else(|| panic!("docs/results/real-arms.md lacks a line that begins with\n{head}"));
    let printed: Vec<f64> = line.split('|').map_while(|cell| cell.trim().parse().ok()).collect();
    let near = |(printed, figure): (&f64, &f64)| (printed - figure).abs() <= 0.002 + 0.005 * printed;
    let agrees = printed.len() == figures.len() && printed.iter().zip(figures).all(near);
    assert!(agrees, "docs/results/real-arms.md has {printed:?} after\n{head}");
}
