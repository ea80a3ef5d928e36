//! Damaged files of every kind that plumbline reads: refused by name or read, never a panic. `hil/fuzz-files` goes on for as long as one likes.

use plumbline_testkit::fuzz::files::{Bench, Files, TARGETS, Tally, case};

const CASES: u64 = 4_000;

#[test]
fn damaged_files_are_refused_by_name_or_read() {
    let files = Files::shipped();
    let folder = tempfile::Builder::new().prefix("fuzz").tempdir().unwrap();
    let bench = Bench { files: &files, folder: folder.path() };
    let mut tally = Tally::default();
    for number in 0..CASES {
        if let Err(why) = case(&bench, 1, number, &mut tally) {
            panic!("{why}");
        }
    }
    for (index, target) in TARGETS.iter().enumerate() {
        // Both happen often enough for the cases to mean something.
        assert!(tally.read[index] > 30 && tally.refused[index] > 30, "{target}: {tally:?}");
    }
}
