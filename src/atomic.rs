//! Atomic writes of results: a temporary file is written and flushed, then renamed.

use crate::failure::Failure;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path` atomically: a reader gets the old or the new content, also after a power cut.
///
/// Missing parent folders are created. Errors contain the path.
pub fn write_file(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let parent = parent_of(path);
    fs::create_dir_all(&parent).map_err(|error| with_path(&parent, error))?;
    remove_stale(&parent, path);
    let temporary = temporary_of(path)?;
    let result = (|| {
        let mut file = File::create(&temporary)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&temporary, path)?;
        sync_folder(&parent)
    })();
    if result.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    result.map_err(|error| with_path(path, error))
}

/// [`write_file`] for a result of a command; an error is [`Failure::Job`].
pub fn write_result(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    write_file(path, bytes).map_err(Failure::job)
}

/// Removes a file; one that is not there is no error.
pub fn remove_file(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(with_path(path, error)),
        _ => Ok(()),
    }
}

/// Fills a temporary folder with `fill`, flushes its files, and replaces folder `path` with it.
///
/// If `fill` fails, `path` is unchanged and the temporary folder is removed. The caller checks that an old folder at `path` may be
/// deleted.
pub fn write_folder(path: &Path, fill: impl FnOnce(&Path) -> io::Result<()>) -> io::Result<()> {
    let parent = parent_of(path);
    fs::create_dir_all(&parent).map_err(|error| with_path(&parent, error))?;
    remove_stale(&parent, path);
    let temporary = temporary_of(path)?;
    let result = (|| {
        fs::create_dir(&temporary)?;
        fill(&temporary)?;
        for entry in fs::read_dir(&temporary)? {
            File::open(entry?.path())?.sync_all()?;
        }
        sync_folder(&temporary)?;
        replace_folder(&temporary, path)?;
        sync_folder(&parent)
    })();
    if result.is_err() {
        let _ = fs::remove_dir_all(&temporary);
    }
    result.map_err(|error| with_path(path, error))
}

/// Replaces folder `path` with folder `new`, in one step if the file system can exchange names.
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

/// Hidden temporary name in the same folder, unique per process and call. A rename can't cross file systems.
fn temporary_of(path: &Path) -> io::Result<PathBuf> {
    use std::sync::atomic::{AtomicU64, Ordering};
    static CALLS: AtomicU64 = AtomicU64::new(0);
    let name = path.file_name().ok_or_else(|| with_path(path, io::Error::other("has no file name")))?;
    let call = CALLS.fetch_add(1, Ordering::Relaxed);
    Ok(parent_of(path).join(format!(".{}.{}-{call}.aside", name.to_string_lossy(), std::process::id())))
}

/// Removes temporary files of ended processes that wrote `path`. Errors are ignored, because such files do no harm.
fn remove_stale(folder: &Path, path: &Path) {
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

fn with_path(path: &Path, error: io::Error) -> io::Error {
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
    fn a_file_is_replaced_without_leftovers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/er/model.toml");
        write_file(&path, b"old").unwrap();
        write_file(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(path.parent().unwrap()), ["model.toml"]);
    }

    #[test]
    fn a_failed_write_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("taken");
        fs::create_dir(&path).unwrap();
        let error = write_file(&path, b"x").unwrap_err();
        assert!(error.to_string().contains("taken"), "{error}");
        assert_eq!(names(folder.path()), ["taken"]);
    }

    #[test]
    fn temporary_files_of_ended_processes_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let (dead, alive) = ("2000000000", std::process::id());
        for name in
            [format!(".model.toml.{dead}-0.aside"), format!(".model.toml.{alive}-900.aside"), ".other.1-0.aside".into()]
        {
            fs::write(folder.path().join(name), "half").unwrap();
        }
        fs::create_dir(folder.path().join(format!(".model.toml.{dead}-1.old"))).unwrap();
        write_file(&folder.path().join("model.toml"), b"new").unwrap();
        assert_eq!(
            names(folder.path()),
            [format!(".model.toml.{alive}-900.aside"), ".other.1-0.aside".into(), "model.toml".into()]
        );
    }

    #[test]
    fn a_folder_is_replaced_as_a_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data");
        write_folder(&path, |to| fs::write(to.join("old.csv"), "1")).unwrap();
        write_folder(&path, |to| fs::write(to.join("new.csv"), "2")).unwrap();
        assert_eq!(names(&path), ["new.csv"]);
        assert_eq!(names(folder.path()), ["data"]);
    }

    #[test]
    fn a_failed_folder_keeps_the_old_one() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("data");
        write_folder(&path, |to| fs::write(to.join("old.csv"), "1")).unwrap();
        let failed = write_folder(&path, |to| {
            fs::write(to.join("half.csv"), "2")?;
            Err(io::Error::other("disk full"))
        });
        assert!(failed.unwrap_err().to_string().contains("disk full"));
        assert_eq!(names(&path), ["old.csv"]);
        assert_eq!(names(folder.path()), ["data"]);
    }
}
