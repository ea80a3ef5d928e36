//! The folder of recordings: their names, and how many are kept.

use crate::recording::Recording;
use std::io;
use std::path::PathBuf;

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
        if let Err(error) = self.prune() {
            tracing::warn!("older recordings could not be removed: {error}");
        }
        Ok(path)
    }

    fn prefix(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '_' };
        format!("flight-{}-", self.id.chars().map(plain).collect::<String>())
    }

    fn prune(&self) -> io::Result<()> {
        let mut mine = Vec::new();
        for entry in std::fs::read_dir(&self.dir)? {
            let entry = entry?;
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.starts_with(&self.prefix()) && name.ends_with(".mcap") {
                mine.push((entry.metadata()?.modified()?, entry.path()));
            }
        }
        mine.sort();
        let surplus = mine.len().saturating_sub(self.keep);
        for (_, path) in mine.iter().take(surplus) {
            std::fs::remove_file(path)?;
            // Its page, where somebody has made one.
            let _ = std::fs::remove_file(path.with_extension("html"));
        }
        Ok(())
    }
}
