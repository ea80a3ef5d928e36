//! The folder of recordings: their names, and how many are kept.

use crate::recording::Recording;
use std::io;
use std::path::{Path, PathBuf};

/// The form of the time in a name, with a 0 for every digit: `20261122T011721Z-`.
const STAMP: &str = "00000000T000000Z-";

/// Where recordings go.
pub(super) struct Folder {
    pub dir: PathBuf,
    pub id: String,
    pub keep: usize,
}

impl Folder {
    /// Writes a recording and removes the oldest ones.
    pub fn put(&self, recording: &Recording, kind: &str) -> io::Result<PathBuf> {
        let stamp: String = recording.about.recorded.chars().filter(char::is_ascii_alphanumeric).collect();
        let name = |more: &str| self.dir.join(format!("{}{stamp}-{kind}{more}.mcap", self.prefix()));
        let taken = (2..).map(|count| name(&format!("-{count}")));
        let path = std::iter::once(name("")).chain(taken).find(|path| !path.exists()).unwrap_or_else(|| name(""));
        recording.write(&path)?;
        if let Err(error) = self.prune(&path) {
            tracing::warn!("older recordings could not be removed: {error}");
        }
        Ok(path)
    }

    fn prefix(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' };
        format!("flight-{}-", self.id.chars().map(plain).collect::<String>())
    }

    /// Removes the oldest recordings of this robot beyond those that are kept. The `fresh` one is kept whatever the clock says: after it was
    /// set back, the newest file has the oldest time.
    fn prune(&self, fresh: &Path) -> io::Result<()> {
        let mut others = Vec::new();
        for entry in std::fs::read_dir(&self.dir)? {
            let entry = entry?;
            if entry.path() != fresh && self.is_mine(&entry.file_name().to_string_lossy()) {
                others.push((entry.metadata()?.modified()?, entry.path()));
            }
        }
        others.sort();
        let surplus = (others.len() + 1).saturating_sub(self.keep);
        for (_, path) in others.iter().take(surplus) {
            std::fs::remove_file(path)?;
            // Its page, where somebody has made one.
            let _ = std::fs::remove_file(path.with_extension("html"));
        }
        Ok(())
    }

    /// Whether a file is a recording of this robot, `panda`, and not of another one that is called `panda-left`.
    fn is_mine(&self, name: &str) -> bool {
        let Some(rest) = name.strip_prefix(&self.prefix()).filter(|rest| rest.ends_with(".mcap")) else { return false };
        let stamp: String = rest.chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
        stamp.starts_with(STAMP)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::time::{Duration, SystemTime};

    fn folder(dir: &Path, keep: usize) -> Folder {
        Folder { dir: dir.to_path_buf(), id: "panda".into(), keep }
    }

    /// A file that was written so many hours ago.
    fn laid(dir: &Path, name: &str, hours: u64) -> PathBuf {
        let path = dir.join(name);
        let file = File::create(&path).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(3600 * hours)).unwrap();
        path
    }

    #[test]
    fn another_robot_s_recordings_are_none_of_this_one_s() {
        let dir = tempfile::tempdir().unwrap();
        let others = [
            laid(dir.path(), "flight-panda-left-20261122T011721Z-guard.mcap", 9),
            laid(dir.path(), "flight-panda-2-20261122T011721Z-guard.mcap", 9),
            laid(dir.path(), "flight-panda-20261122T011721Z-guard.html", 9),
            laid(dir.path(), "flight-panda-notes.mcap", 9),
        ];
        let old = laid(dir.path(), "flight-panda-20261122T011721Z-guard.mcap", 2);
        let fresh = laid(dir.path(), "flight-panda-20261122T031721Z-guard-2.mcap", 0);
        folder(dir.path(), 2).prune(&fresh).unwrap();
        assert!(old.exists());
        folder(dir.path(), 1).prune(&fresh).unwrap();
        assert!(!old.exists() && fresh.exists());
        // The page of the recording that went goes with it.
        assert!(others.iter().all(|path| path.exists() != path.ends_with("flight-panda-20261122T011721Z-guard.html")));
    }

    #[test]
    fn the_recording_just_written_stays_after_the_clock_was_set_back() {
        let dir = tempfile::tempdir().unwrap();
        let newer = laid(dir.path(), "flight-panda-20261122T041721Z-guard.mcap", 1);
        let oldest = laid(dir.path(), "flight-panda-20261122T031721Z-guard.mcap", 2);
        let fresh = laid(dir.path(), "flight-panda-20261121T031721Z-guard.mcap", 24);
        folder(dir.path(), 2).prune(&fresh).unwrap();
        assert!(fresh.exists() && newer.exists() && !oldest.exists());
    }
}
