//! Reproduces the paper's tables and figures in simulation: `cargo run --release --example paper`.
//!
//! Writes the tables into docs/paper.md, between its markers, and the figures into docs/figures. `cargo test --test identification paper::` holds the
//! same results, and that the page says what the program says.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let page = docs.join("paper.md");
    let text = fill(&std::fs::read_to_string(&page)?, &plumbline_testkit::paper::tables::all());
    std::fs::write(&page, text)?;
    std::fs::create_dir_all(docs.join("figures"))?;
    for (name, svg) in plumbline_testkit::paper::figures::all() {
        std::fs::write(docs.join("figures").join(name), svg)?;
    }
    println!("wrote {} and its figures", page.display());
    Ok(())
}

/// The page with every block between `<!-- NAME -->` and `<!-- end -->` replaced.
fn fill(page: &str, blocks: &[(&str, String)]) -> String {
    let mut text = page.to_string();
    for (name, content) in blocks {
        let open = format!("<!-- {name} -->\n");
        let Some(start) = text.find(&open).map(|at| at + open.len()) else { continue };
        let Some(length) = text[start..].find("<!-- end -->") else { continue };
        text.replace_range(start..start + length, content);
    }
    text
}
