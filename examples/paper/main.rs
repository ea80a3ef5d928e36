//! Reproduces the paper's tables and figures in simulation: `cargo run --release --example paper`.
//!
//! Writes the tables into docs/results/paper.md, between its markers, and the figures into docs/figures. `cargo test --test identification paper::`
//! compares page and figures with the same results.

use plumbline_testkit::page;
use std::path::Path;

const PAGE: &str = "docs/results/paper.md";

fn main() -> std::io::Result<()> {
    let figures = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/figures");
    for (name, table) in plumbline_testkit::paper::tables::all() {
        page::write_block(PAGE, name, &table);
    }
    std::fs::create_dir_all(&figures)?;
    for (name, svg) in plumbline_testkit::paper::figures::all() {
        std::fs::write(figures.join(name), svg)?;
    }
    println!("wrote {PAGE} and its figures");
    Ok(())
}
