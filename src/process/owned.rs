//! Ownership of the files that a process reads. Files that set the arm's limits must be root's (`--root-owned`), and so are the plans and models that a job names then;
//! a model that is served and a plan that the process itself has left, which become torque and motion, are root's or the process's own user's.

use crate::failure::Failure;
use plumbline_core::BadInput;
use std::fs::{File, Metadata, OpenOptions};
use std::io::Read;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

/// Mode bits by which others than the owner can write.
const WRITABLE: u32 = 0o022;
const GROUP_WRITABLE: u32 = 0o020;
/// Names in such a folder can be taken away or replaced by their owners alone, as in `/tmp`.
const STICKY: u32 = 0o1000;

/// Refuses a file that sets limits where another user could change it: the file and its folder have to belong to root and to be closed
/// to writing by others. The services require this with `--root-owned`; elsewhere the files are the user's own.
pub fn trusted(file: &Path) -> Result<(), Failure> {
    for path in [file, folder_of(file)] {
        let found = std::fs::metadata(path)
            .map_err(|error| BadInput::new(file.display().to_string(), "file", error, "a file that can be read"))?;
        if let Some(wrong) = distrusted(found.uid(), found.mode()) {
            let value = format!("{} that {wrong}", path.display());
            let expected = "a file and a folder that belong to root and that nobody else can write to, as it sets the arm's limits";
            return Err(BadInput::new(file.display().to_string(), "file", value, expected).into());
        }
    }
    Ok(())
}

/// What is wrong with the owner or the mode of a file that sets limits.
fn distrusted(owner: u32, mode: u32) -> Option<String> {
    match (owner, mode & WRITABLE) {
        (0, 0) => None,
        (0, _) => Some(format!("others can write to (mode {:o})", mode & 0o7777)),
        (owner, _) => Some(format!("belongs to user {owner}")),
    }
}

/// Refuses plans in `out` of an earlier run or another user: they become motions. Root's and this process's own user's are
/// taken, as with [`read_model`].
pub fn plans(out: &Path) -> Result<(), BadInput> {
    let dir = out.join("plans");
    let Ok(entries) = std::fs::read_dir(&dir) else { return Ok(()) };
    let plans = entries.filter_map(|entry| Some(entry.ok()?.path()));
    plans
        .filter(|path| path.extension().is_some_and(|end| end == "toml"))
        .try_for_each(|path| open_own(&path, "plan").map(drop))
}

/// Text of a model file that only root and this process's user can have written or replaced. The process's own
/// group counts as the user: where a user has a group to himself, as on Debian and its kin, new files are open to it.
/// Errors: a file that can't be read; one of another user, or that others can write to, by its owner and mode.
pub fn read_model(path: &Path) -> Result<String, BadInput> {
    let mut text = String::new();
    open_own(path, "model")?
        .read_to_string(&mut text)
        .map_err(|error| BadInput::new(path.display().to_string(), "file", error, "a readable model file"))?;
    Ok(text)
}

/// Opens a file of a `kind` that becomes torque or motion.
fn open_own(path: &Path, kind: &str) -> Result<File, BadInput> {
    let file = path.display().to_string();
    let own = (rustix::process::geteuid().as_raw(), rustix::process::getegid().as_raw());
    let unreadable = |error: std::io::Error| BadInput::new(&file, "file", error, format!("a readable {kind} file"));
    // A pipe in its place must not be waited for.
    let opened = OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK).open(path).map_err(unreadable)?;
    // The owner of what is read, whatever becomes of its name meanwhile.
    let found = opened.metadata().map_err(unreadable)?;
    if !found.is_file() {
        return Err(BadInput::new(&file, "file", "no regular file", format!("a {kind} file")));
    }
    let folder = folder_of(path);
    let around = std::fs::metadata(folder).map_err(unreadable)?;
    let wrong = forgeable(own, &found).map(|wrong| (path, wrong)).or_else(|| {
        let sheltered = around.mode() & STICKY != 0 && [0, own.0].contains(&around.uid());
        forgeable(own, &around).filter(|_| !sheltered).map(|wrong| (folder, wrong))
    });
    if let Some((what, wrong)) = wrong {
        let value = format!("{} {wrong}", what.display());
        let expected = format!(
            "a {kind} file, in a folder, of root's or of user {}'s, this process's own, and neither open to writing by others: \
             `chown` and `chmod go-w` after a look at what stands in it",
            own.0
        );
        return Err(BadInput::new(&file, "file", value, expected));
    }
    Ok(opened)
}

/// By whom something could have been made or changed besides root and `own`, a user and its group, for an error; `None` where by no one else.
fn forgeable(own: (u32, u32), found: &Metadata) -> Option<String> {
    judged(own, (found.uid(), found.gid()), found.mode())
}

fn judged(own: (u32, u32), (owner, group): (u32, u32), mode: u32) -> Option<String> {
    let found = format!("(owner {owner}, group {group}, mode {:o})", mode & 0o7777);
    let others = mode & if group == own.1 { WRITABLE & !GROUP_WRITABLE } else { WRITABLE };
    match (owner == 0 || owner == own.0, others) {
        (true, 0) => None,
        (true, _) => Some(format!("that others can write to {found}")),
        (false, _) => Some(format!("that belongs to user {owner} {found}")),
    }
}

fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{Permissions, set_permissions, write};
    use std::os::unix::fs::{PermissionsExt, symlink};

    #[test]
    fn files_that_set_limits_belong_to_root() {
        assert_eq!(distrusted(0, 0o100_644), None);
        assert_eq!(distrusted(0, 0o40_755), None);
        assert!(distrusted(0, 0o100_664).unwrap().contains("mode 664"));
        assert!(distrusted(0, 0o100_646).is_some());
        assert!(distrusted(1000, 0o100_600).unwrap().contains("user 1000"));
    }

    #[test]
    fn a_model_is_of_root_or_of_ones_own_and_closed_to_others() {
        let own = (998, 990);
        for owner in [0, 998] {
            assert_eq!(judged(own, (owner, 0), 0o100_644), None);
            assert_eq!(
                judged(own, (owner, 0), 0o100_666).unwrap(),
                format!("that others can write to (owner {owner}, group 0, mode 666)")
            );
            // A group to oneself.
            assert_eq!(judged(own, (owner, 990), 0o100_664), None);
            assert!(judged(own, (owner, 991), 0o100_664).is_some());
            assert!(judged(own, (owner, 990), 0o100_602).is_some());
        }
        let foreign = judged(own, (1001, 990), 0o100_600).unwrap();
        assert_eq!(foreign, "that belongs to user 1001 (owner 1001, group 990, mode 600)");
        // Root takes none of a user's.
        assert!(judged((0, 0), (998, 990), 0o100_600).is_some());
    }

    /// A folder of the test's own with a model file of this mode in it.
    fn laid(file: u32, folder: u32) -> (tempfile::TempDir, std::path::PathBuf) {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("model.toml");
        write(&path, "text").unwrap();
        set_permissions(&path, Permissions::from_mode(file)).unwrap();
        set_permissions(place.path(), Permissions::from_mode(folder)).unwrap();
        (place, path)
    }

    #[test]
    fn what_others_can_write_or_replace_is_not_read_and_the_error_says_why() {
        let (_place, path) = laid(0o600, 0o700);
        assert_eq!(read_model(&path).unwrap(), "text");
        // As in /tmp, where users can't remove each other's names.
        let (_place, path) = laid(0o600, 0o1777);
        assert_eq!(read_model(&path).unwrap(), "text");
        let own = (rustix::process::geteuid().as_raw(), rustix::process::getegid().as_raw());
        for (file, folder, named, mode) in [(0o666, 0o700, "model.toml", "666"), (0o640, 0o707, "", "707")] {
            let (place, path) = laid(file, folder);
            let error = read_model(&path).unwrap_err().to_string();
            let what = place.path().join(named);
            let wrong = format!("that others can write to (owner {}, group {}, mode {mode})", own.0, own.1);
            assert!(error.contains(wrong.as_str()) && error.contains(path.to_str().unwrap()), "{error}");
            assert!(error.contains(what.to_str().unwrap().trim_end_matches('/')), "{error}");
        }
    }

    #[test]
    fn it_is_the_file_behind_a_link_that_counts_and_a_pipe_is_not_waited_for() {
        let (place, path) = laid(0o606, 0o700);
        let link = place.path().join("link.toml");
        symlink(&path, &link).unwrap();
        assert!(read_model(&link).unwrap_err().to_string().contains("mode 606"));
        let pipe = place.path().join("pipe.toml");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(read_model(&pipe).unwrap_err().to_string().contains("no regular file"));
    }
}
