//! The folder that holds the daemon's lock and iceoryx2's names: it belongs to one user, and nobody else may write there.
//!
//! iceoryx2's own default is `/tmp/iceoryx2`, which whoever comes first may make and own. Here every user has a folder that others
//! can't have prepared: what is not a plain directory of one's own, closed to others, is refused with a reason and never used.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Names the folder explicitly, where none of the usual places fits.
pub const VARIABLE: &str = "PLUMBLINE_RUNTIME_DIR";
/// The service's folder, made by systemd-tmpfiles.
const SERVICE: &str = "/run/plumbline";
/// Where POSIX shared memory appears as files on Linux.
pub(super) const SHARED_MEMORY: &str = "/dev/shm";
/// How iceoryx2 names the one segment that it opens to every user.
const GLOBAL: &str = ".global_mgmt";

/// Why the folder can't be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RuntimeDirError {
    /// Somebody else made it, or opened it to others.
    #[error("{} {what}; expected a directory of user {uid} that nobody else can write to: remove it, or set {VARIABLE}", path.display())]
    Foreign {
        /// The folder, or the file in the way.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// The user that this program runs as.
        uid: u32,
    },
    /// It could not be made or looked at.
    #[error("{}: {reason}", path.display())]
    Io {
        /// The folder.
        path: PathBuf,
        /// What the operating system says.
        reason: String,
    },
}

/// The folder of this process's user, made if it is missing and checked in any case.
///
/// In this order: `$PLUMBLINE_RUNTIME_DIR`; `/run/plumbline` where it belongs to this user; `plumbline` in `$XDG_RUNTIME_DIR` where
/// that belongs to this user; `plumbline-UID` in the temporary directory.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] for anything that another user could have prepared, [`RuntimeDirError::Io`].
pub fn directory() -> Result<PathBuf, RuntimeDirError> {
    let uid = user();
    let path = chosen(uid);
    secure(&path, uid)?;
    Ok(path)
}

/// The user that serves robots on this machine, where it is another than this process's.
pub fn other_serving_user() -> Option<u32> {
    let owner = fs::symlink_metadata(SERVICE).ok()?.uid();
    (owner != user()).then_some(owner)
}

/// The effective user of this process.
pub(super) fn user() -> u32 {
    rustix::process::geteuid().as_raw()
}

fn chosen(uid: u32) -> PathBuf {
    let ours = |path: &Path| fs::symlink_metadata(path).is_ok_and(|found| found.is_dir() && found.uid() == uid);
    let named = |variable| std::env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(path) = named(VARIABLE) {
        return path;
    }
    let service = PathBuf::from(SERVICE);
    if ours(&service) {
        return service;
    }
    match named("XDG_RUNTIME_DIR") {
        Some(runtime) if ours(&runtime) => runtime.join("plumbline"),
        _ => std::env::temp_dir().join(format!("plumbline-{uid}")),
    }
}

/// Makes `path` if it is missing, and refuses it unless it is a directory of `uid` that others can't write to.
fn secure(path: &Path, uid: u32) -> Result<(), RuntimeDirError> {
    let failed = |error: io::Error| RuntimeDirError::Io { path: path.to_path_buf(), reason: error.to_string() };
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(failed(error)),
        _ => {}
    }
    // Not `metadata`: a link that somebody laid here must not be followed.
    let found = fs::symlink_metadata(path).map_err(failed)?;
    let foreign = |what: String| Err(RuntimeDirError::Foreign { path: path.to_path_buf(), what, uid });
    if !found.is_dir() {
        return foreign("is not a directory".into());
    }
    if found.uid() != uid {
        return foreign(format!("belongs to user {}", found.uid()));
    }
    if found.mode() & 0o022 != 0 {
        return foreign(format!("can be written to by others (mode {:o})", found.mode() & 0o7777));
    }
    Ok(())
}

/// Whether nobody has laid files of our names into shared memory.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] names the first one.
pub(super) fn no_squatters() -> Result<(), RuntimeDirError> {
    squatters(Path::new(SHARED_MEMORY), user())
}

fn squatters(shared_memory: &Path, uid: u32) -> Result<(), RuntimeDirError> {
    ours_by_name(shared_memory, uid).into_iter().try_for_each(|(path, found)| genuine(path, &found, uid))
}

fn genuine(path: PathBuf, found: &fs::Metadata, uid: u32) -> Result<(), RuntimeDirError> {
    if found.uid() == uid && found.is_file() {
        return Ok(());
    }
    let what = format!("belongs to user {} and has a name of ours", found.uid());
    Err(RuntimeDirError::Foreign { path, what, uid })
}

/// Whether the shared memory that this process has opened by our names is this user's. While a daemon runs nobody can put another file
/// in the place of its own; after its end a stranger could, and wait there for a client.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] names the first segment that is somebody else's.
pub(super) fn only_ours_mapped() -> Result<(), RuntimeDirError> {
    let maps = PathBuf::from("/proc/self/maps");
    let text =
        fs::read_to_string(&maps).map_err(|error| RuntimeDirError::Io { path: maps, reason: error.to_string() })?;
    let uid = user();
    for path in mapped(&text, &format!("{SHARED_MEMORY}/{}", prefix(uid))) {
        // One that is gone by now was removed by its owner.
        if let Ok(found) = fs::symlink_metadata(path) {
            genuine(PathBuf::from(path), &found, uid)?;
        }
    }
    Ok(())
}

/// Gives every segment that this process has mapped by our names its memory now. A file in `/dev/shm` gets it page by page as it is written
/// to, and where none is left then, the kernel ends the writer (SIGBUS).
///
/// # Errors
/// [`RuntimeDirError::Io`] names the first segment that there is no room for.
pub(super) fn reserve_mapped() -> Result<(), RuntimeDirError> {
    let maps = PathBuf::from("/proc/self/maps");
    let text =
        fs::read_to_string(&maps).map_err(|error| RuntimeDirError::Io { path: maps, reason: error.to_string() })?;
    let start = format!("{SHARED_MEMORY}/{}", prefix(user()));
    let mut paths: Vec<&str> = mapped(&text, &start).collect();
    paths.dedup();
    for path in paths {
        // One that is gone by now, or that this user may only read, is not written to from here.
        let Ok(file) = fs::OpenOptions::new().read(true).write(true).open(path) else { continue };
        let length = file.metadata().map_or(0, |found| found.len());
        if length > 0 {
            let reserved = rustix::fs::fallocate(&file, rustix::fs::FallocateFlags::empty(), 0, length);
            reserved.map_err(|error| RuntimeDirError::Io {
                path: path.into(),
                reason: format!("{length} bytes: {error}"),
            })?;
        }
    }
    Ok(())
}

/// Least room in shared memory that a new client may need \[bytes\].
const ROOM: u64 = 4 << 20;

/// What this machine has run out of, of all that a connection needs.
pub(super) fn shortage() -> Option<String> {
    if let Err(error) = rustix::io::fcntl_dupfd_cloexec(std::io::stderr(), 0) {
        return Some(format!("no file descriptor is left ({error})"));
    }
    no_room()
}

/// Where shared memory is as good as full, in words.
pub(super) fn no_room() -> Option<String> {
    let found = rustix::fs::statvfs(SHARED_MEMORY).ok()?;
    let free = found.f_bavail.saturating_mul(found.f_frsize);
    (free < ROOM).then(|| format!("{SHARED_MEMORY} is full ({free} bytes free)"))
}

/// Files in the text of `/proc/PID/maps` whose paths begin with `start`.
fn mapped<'t>(maps: &'t str, start: &'t str) -> impl Iterator<Item = &'t str> {
    let paths = maps.lines().filter_map(|line| line.find('/').map(|at| &line[at..]));
    paths.filter(move |path| path.starts_with(start))
}

/// Closes the segment that iceoryx2 opens to everyone: only programs of this user have business there.
pub(super) fn close_to_others() {
    let uid = user();
    for (path, found) in ours_by_name(Path::new(SHARED_MEMORY), uid) {
        let global = path.to_string_lossy().ends_with(GLOBAL);
        if global && found.uid() == uid && found.mode() & 0o077 != 0 {
            // Another process of ours may have done it, or ended, meanwhile.
            let _ = fs::set_permissions(&path, fs::Permissions::from_mode(0o600));
        }
    }
}

/// How the names of this user's files in shared memory begin: told from those of other users and of other iceoryx2 programs.
pub(super) fn prefix(uid: u32) -> String {
    format!("plumbline_{uid}_")
}

/// Files in `shared_memory` whose names begin as this user's do.
pub(super) fn ours_by_name(shared_memory: &Path, uid: u32) -> Vec<(PathBuf, fs::Metadata)> {
    let start = prefix(uid);
    let Ok(entries) = fs::read_dir(shared_memory) else { return Vec::new() };
    let named = entries.filter_map(Result::ok).filter(|entry| entry.file_name().to_string_lossy().starts_with(&start));
    named.filter_map(|entry| Some((entry.path(), fs::symlink_metadata(entry.path()).ok()?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_folder_of_one_s_own_is_made_closed_and_taken_again() {
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("own");
        secure(&path, user()).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o700);
        secure(&path, user()).unwrap();
    }

    #[test]
    fn what_another_user_could_have_prepared_is_refused() {
        let place = tempfile::tempdir().unwrap();
        let path = |name: &str| place.path().join(name);
        let refusal = |name: &str, uid| secure(&path(name), uid).unwrap_err().to_string();

        fs::create_dir(path("target")).unwrap();
        symlink(path("target"), path("link")).unwrap();
        assert!(refusal("link", user()).contains("is not a directory"));
        fs::write(path("file"), "").unwrap();
        assert!(refusal("file", user()).contains("is not a directory"));
        fs::set_permissions(path("target"), fs::Permissions::from_mode(0o777)).unwrap();
        assert!(refusal("target", user()).contains("can be written to by others (mode 777)"));
        fs::set_permissions(path("target"), fs::Permissions::from_mode(0o700)).unwrap();
        assert!(refusal("target", user() + 1).contains(&format!("belongs to user {}", user())));
        assert!(matches!(secure(&path("no/such/parent"), user()), Err(RuntimeDirError::Io { .. })));
    }

    #[test]
    fn a_foreign_file_of_our_name_in_shared_memory_is_named() {
        let memory = tempfile::tempdir().unwrap();
        let (uid, other) = (user(), user() + 1);
        fs::write(memory.path().join("iox2_abc"), "").unwrap();
        fs::write(memory.path().join(format!("{}abc", prefix(uid))), "").unwrap();
        squatters(memory.path(), uid).unwrap();
        // As a process of the other user sees it.
        fs::write(memory.path().join(format!("{}abc", prefix(other))), "").unwrap();
        let error = squatters(memory.path(), other).unwrap_err().to_string();
        assert!(error.contains(&prefix(other)) && error.contains(&format!("belongs to user {uid}")), "{error}");
        symlink("/etc/passwd", memory.path().join(format!("{}link", prefix(uid)))).unwrap();
        assert!(squatters(memory.path(), uid).is_err());
    }

    #[test]
    fn segments_that_are_mapped_are_found_by_their_names() {
        let maps = "7f00-7f01 rw-s 00000000 00:19 12 /dev/shm/plumbline_7_a.dynamic\n\
            7f01-7f02 r--p 00000000 08:01 13 /usr/lib/libc.so.6\n7f02-7f03 rw-p 00000000 00:00 0\n\
            7f03-7f04 rw-s 00000000 00:19 14 /dev/shm/plumbline_70_b.data\n";
        let found: Vec<_> = mapped(maps, "/dev/shm/plumbline_7_").collect();
        assert_eq!(found, ["/dev/shm/plumbline_7_a.dynamic"]);
        only_ours_mapped().unwrap();
    }
}
