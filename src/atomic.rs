//! How results reach the disk: written aside, flushed, then renamed, so that no reader ever sees half a result.

use crate::failure::Failure;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path`: whoever opens it sees the old content or the new one, also after a power cut.
///
/// Missing parent folders are made. Errors carry the path.
pub fn write_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let parent = parent_of(path);
    fs::create_dir_all(&parent).map_err(|error| named(&parent, error))?;
    sweep(&parent, path);
    let aside = aside_of(path)?;
    let written = (|| {
        let mut file = File::create(&aside)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&aside, path)?;
        sync_folder(&parent)
    })();
    if written.is_err() {
        let _ = fs::remove_file(&aside);
    }
    written.map_err(|error| named(path, error))
}

/// [`write_file`] for a result of a command: a failure is one of the job.
pub fn write_result(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_file(path, bytes).map_err(Failure::job)
}

/// Fills a new folder beside `path` with `fill`, flushes its files, then puts it in `path`'s place; an older folder there goes.
///
/// When `fill` fails nothing at `path` has changed and the new folder is removed. The caller makes sure that the older
/// folder is one of its own making.
pub fn write_folder(path: &Path, fill: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let parent = parent_of(path);
    fs::create_dir_all(&parent).map_err(|error| named(&parent, error))?;
    sweep(&parent, path);
    let aside = aside_of(path)?;
    let written = (|| {
        fs::create_dir(&aside)?;
        fill(&aside)?;
        for entry in fs::read_dir(&aside)? {
            File::open(entry?.path())?.sync_all()?;
        }
        sync_folder(&aside)?;
        replace_folder(&aside, path)?;
        sync_folder(&parent)
    })();
    if written.is_err() {
        let _ = fs::remove_dir_all(&aside);
    }
    written.map_err(|error| named(path, error))
}

/// Puts folder `new` in the place of folder `path`, in one step where the file system can exchange two names.
fn replace_folder(new: &Path, path: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    if !path.exists() {
        return fs::rename(new, path);
    }
    if renameat_with(CWD, new, CWD, path, RenameFlags::EXCHANGE).is_ok() {
        return fs::remove_dir_all(new);
    }
    let old = new.with_extension("old");
    fs::rename(path, &old)?;
    if let Err(error) = fs::rename(new, path) {
        fs::rename(&old, path)?;
        return Err(error);
    }
    fs::remove_dir_all(old)
}

/// A hidden name in the same folder (a rename can't cross file systems), one per process and call.
fn aside_of(path: &Path) -> io::Result<PathBuf> {
    use std::sync::atomic::{AtomicU64, Ordering};
    static CALLS: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or_else(|| named(path, io::Error::other("has no file name")))?;
    let call = CALLS.fetch_add(1, Ordering::Relaxed);
    Ok(parent_of(path).join(format!(".{}.{}-{call}.aside", name.to_string_lossy(), std::process::id())))
}

/// Removes what processes that died in the midst of writing `path` have left in its folder. What can't be removed stays: it is in nobody's
/// way.
fn sweep(folder: &Path, path: &Path) {
    let Some(name) = path.file_name().map(|name| format!(".{}.", name.to_string_lossy())) else { return };
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let found = entry.file_name().to_string_lossy().into_owned();
        let writer = found.strip_prefix(&name).and_then(|rest| rest.split_once('-')).and_then(|(pid, rest)| {
            rest.split_once('.')
                .is_some_and(|(_, kind)| matches!(kind, "aside" | "old"))
                .then(|| pid.parse::<u32>().ok())?
        });
        if writer.is_some_and(|pid| !Path::new("/proc").join(pid.to_string()).exists()) {
            let _ = fs::remove_file(entry.path()).or_else(|_| fs::remove_dir_all(entry.path()));
        }
    }
}

fn parent_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if parent != Path::new("") => parent.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

fn named(path: &Path, error: io::Error) -> io::Error {
    let shown = path.display().to_string();
    let text = error.to_string();
    if text.contains(&shown) { error } else { io::Error::new(error.kind(), format!("{shown}: {text}")) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> =
            fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_and_leaves_nothing_behind() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("deep/er/model.toml");
        write_file(&path, b"old").unwrap();
        write_file(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(path.parent().unwrap()), ["model.toml"]);
    }

    #[test]
    fn a_file_that_cannot_be_placed_leaves_nothing_behind() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("taken");
        fs::create_dir(&path).unwrap();
        let error = write_file(&path, b"x").unwrap_err();
        assert!(error.to_string().contains("taken"), "{error}");
        assert_eq!(names(room.path()), ["taken"]);
    }

    #[test]
    fn what_the_dead_left_aside_goes_and_what_the_living_write_stays() {
        let room = tempfile::tempdir().unwrap();
        let (dead, alive) = ("2000000000", std::process::id());
        for name in
            [format!(".model.toml.{dead}-0.aside"), format!(".model.toml.{alive}-900.aside"), ".other.1-0.aside".into()]
        {
            fs::write(room.path().join(name), "half").unwrap();
        }
        fs::create_dir(room.path().join(format!(".model.toml.{dead}-1.old"))).unwrap();
        write_file(&room.path().join("model.toml"), b"new").unwrap();
        assert_eq!(
            names(room.path()),
            [format!(".model.toml.{alive}-900.aside"), ".other.1-0.aside".into(), "model.toml".into()]
        );
    }

    #[test]
    fn a_folder_is_replaced_whole() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("data");
        write_folder(&path, |to| fs::write(to.join("old.csv"), "1")).unwrap();
        write_folder(&path, |to| fs::write(to.join("new.csv"), "2")).unwrap();
        assert_eq!(names(&path), ["new.csv"]);
        assert_eq!(names(room.path()), ["data"]);
    }

    #[test]
    fn a_folder_whose_filling_fails_leaves_the_old_one() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("data");
        write_folder(&path, |to| fs::write(to.join("old.csv"), "1")).unwrap();
        let failed = write_folder(&path, |to| {
            fs::write(to.join("half.csv"), "2")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(names(&path), ["old.csv"]);
        assert_eq!(names(room.path()), ["data"]);
    }
}
