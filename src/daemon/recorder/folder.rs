//! The folder of recordings: their names, and how many are kept.

use crate::recording::Recording;
use crate::recording::about::ReasonKind;
use std::io;
use std::path::{Path, PathBuf};

/// The form of the time in a name, with a 0 for every digit: `20261122T011721Z-`.
const STAMP: &str = "00000000T000000Z-";

pub(super) struct Folder {
    pub dir: PathBuf,
    pub id: String,
    pub keep: usize,
    pub keep_on_demand: usize,
}

impl Folder {
    /// Writes a recording and removes the oldest ones.
    pub fn put(&self, recording: &Recording) -> io::Result<PathBuf> {
        let kind = recording.about.reason.kind;
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

    /// Removes the oldest recordings of this robot and of the `fresh` one's sort beyond those that are kept: on demand ones never remove what a
    /// fault has left. The `fresh` one is kept whatever the clock: after the clock was
    /// set back, the newest file has the oldest time.
    fn prune(&self, fresh: &Path) -> io::Result<()> {
        let name = ReasonKind::OnDemand.to_string();
        let on_demand = |path: &Path| self.kind(path).is_some_and(|kind| kind.starts_with(&name));
        let alike = on_demand(fresh);
        let keep = if alike { self.keep_on_demand } else { self.keep };
        let mut others = Vec::new();
        for entry in std::fs::read_dir(&self.dir)? {
            let entry = entry?;
            let path = entry.path();
            if path != fresh && self.kind(&path).is_some() && on_demand(&path) == alike {
                others.push((entry.metadata()?.modified()?, path));
            }
        }
        others.sort();
        let surplus = (others.len() + 1).saturating_sub(keep);
        for (_, path) in others.iter().take(surplus) {
            std::fs::remove_file(path)?;
            // Its page, where there is one.
            let _ = std::fs::remove_file(path.with_extension("html"));
        }
        Ok(())
    }

    /// The part of a recording's name after its time, `guard-2`, where it is one of this robot, `panda`, and not of another one that is
    /// called `panda-left`.
    fn kind<'p>(&self, path: &'p Path) -> Option<&'p str> {
        let name = path.file_name()?.to_str()?;
        let rest = name.strip_prefix(&self.prefix())?.strip_suffix(".mcap")?;
        let stamp: String = rest.chars().map(|c| if c.is_ascii_digit() { '0' } else { c }).collect();
        stamp.starts_with(STAMP).then(|| &rest[STAMP.len()..])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::time::{Duration, SystemTime};

    fn folder(dir: &Path, keep: usize) -> Folder {
        Folder { dir: dir.to_path_buf(), id: "panda".into(), keep, keep_on_demand: 2 }
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
    fn recordings_on_demand_never_remove_what_a_fault_has_left() {
        let dir = tempfile::tempdir().unwrap();
        let fault = laid(dir.path(), "flight-panda-20261122T011721Z-guard.mcap", 9);
        let asked: Vec<PathBuf> = (0..5)
            .map(|k| {
                let fresh = laid(dir.path(), &format!("flight-panda-20261122T02172{k}Z-on-demand.mcap"), 8 - k);
                folder(dir.path(), 1).prune(&fresh).unwrap();
                fresh
            })
            .collect();
        assert!(fault.exists());
        assert_eq!(asked.iter().filter(|path| path.exists()).count(), 2);
        // And the other way round.
        let fresh = laid(dir.path(), "flight-panda-20261122T031721Z-signal.mcap", 0);
        folder(dir.path(), 1).prune(&fresh).unwrap();
        assert!(!fault.exists() && fresh.exists());
        assert_eq!(asked.iter().filter(|path| path.exists()).count(), 2);
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
