//! Size of a dataset in each format, and the time that writing and reading it take: `cargo bench --bench dataset -- DATASET`.

use plumbline::dataset::{Dataset, Format, stem};
use std::path::Path;
use std::time::Instant;

/// Repeats of which the shortest counts.
const REPEATS: usize = 5;

fn main() {
    // Cargo adds `--bench`.
    let Some(folder) = std::env::args().skip(1).find(|argument| !argument.starts_with("--")) else {
        println!("cargo bench --bench dataset -- DATASET");
        return;
    };
    let mut dataset = Dataset::read(Path::new(&folder)).expect("a dataset");
    let samples: usize = dataset.runs.iter().map(|run| run.samples()).sum();
    println!("{} runs, {samples} samples of {} joints", dataset.runs.len(), dataset.joints());
    let hash = dataset.content_hash();
    for format in [Format::Csv, Format::Mcap] {
        for run in &mut dataset.runs {
            run.data.name = format!("{}{}", stem(&run.data.name), format.ending());
        }
        let room = tempfile::tempdir().expect("a temporary folder");
        let dir = room.path().join("dataset");
        let write = shortest(|| dataset.write(&dir).expect("a written dataset"));
        let mut read_hash = String::new();
        let read = shortest(|| read_hash = Dataset::read(&dir).expect("the same dataset").content_hash());
        assert_eq!(read_hash, hash);
        let files = std::fs::read_dir(&dir).expect("its files");
        let bytes: u64 = files.map(|file| file.and_then(|file| file.metadata()).map_or(0, |data| data.len())).sum();
        let each = bytes as f64 / samples as f64;
        println!(
            "{format:?}: {:.1} MB, {each:.0} bytes per sample; written in {write:.2} s, read in {read:.2} s",
            1e-6 * bytes as f64
        );
    }
}

/// Shortest time of several \[s\].
fn shortest(mut work: impl FnMut()) -> f64 {
    let once = |_| {
        let begin = Instant::now();
        work();
        begin.elapsed().as_secs_f64()
    };
    (0..REPEATS).map(once).fold(f64::INFINITY, f64::min)
}
