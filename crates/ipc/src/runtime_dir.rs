//! Runtime directory of the daemon's lock and iceoryx2's files: owned by one user and writable by no other.
//!
//! iceoryx2's default is `/tmp/iceoryx2`, which any user may create and own first. Plumbline uses one directory per user. A path that is not a
//! directory of that user, or is writable by others, is rejected with a reason.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Environment variable that sets the runtime directory.
pub const VARIABLE: &str = "PLUMBLINE_RUNTIME_DIR";
/// Runtime directory of the systemd service, created by systemd-tmpfiles.
const SERVICE_DIRECTORY: &str = "/run/plumbline";
/// Directory of POSIX shared memory on Linux.
pub(super) const SHARED_MEMORY: &str = "/dev/shm";
/// File suffix of the one iceoryx2 segment that is open to every user.
const GLOBAL_SEGMENT_SUFFIX: &str = ".global_mgmt";

/// Why the runtime directory or shared memory can't be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum RuntimeDirError {
    /// Owned by another user, or writable by others.
    #[error("{} {what}; expected a directory of user {uid} that no other user can write to: remove it, or set {VARIABLE}", path.display())]
    Foreign { path: PathBuf, what: String, uid: u32 },
    /// It could not be created or inspected.
    #[error("{}: {reason}", path.display())]
    Io { path: PathBuf, reason: String },
}

/// Runtime directory of this process's user, created if missing, and always checked.
///
/// In order of precedence: `$PLUMBLINE_RUNTIME_DIR`; `/run/plumbline` where it belongs to this user; `plumbline` in `$XDG_RUNTIME_DIR` where
/// that belongs to this user; `plumbline-UID` in the temporary directory.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] for a path that another user could have prepared, [`RuntimeDirError::Io`].
pub fn directory() -> Result<PathBuf, RuntimeDirError> {
    let uid = user();
    let path = chosen(uid);
    secure(&path, uid)?;
    Ok(path)
}

/// Owner of the service's runtime directory, where it differs from this process's user.
pub fn other_serving_user() -> Option<u32> {
    let owner = fs::symlink_metadata(SERVICE_DIRECTORY).ok()?.uid();
    (owner != user()).then_some(owner)
}

pub(super) fn user() -> u32 {
    rustix::process::geteuid().as_raw()
}

fn chosen(uid: u32) -> PathBuf {
    let owned = |path: &Path| fs::symlink_metadata(path).is_ok_and(|found| found.is_dir() && found.uid() == uid);
    let named = |variable| std::env::var_os(variable).filter(|value| !value.is_empty()).map(PathBuf::from);
    if let Some(path) = named(VARIABLE) {
        return path;
    }
    let service = PathBuf::from(SERVICE_DIRECTORY);
    if owned(&service) {
        return service;
    }
    match named("XDG_RUNTIME_DIR") {
        Some(runtime) if owned(&runtime) => runtime.join("plumbline"),
        _ => std::env::temp_dir().join(format!("plumbline-{uid}")),
    }
}

/// Creates `path` if it is missing, and rejects it unless it is a directory of `uid` that no other user can write to.
fn secure(path: &Path, uid: u32) -> Result<(), RuntimeDirError> {
    let failed = |error: io::Error| RuntimeDirError::Io { path: path.to_path_buf(), reason: error.to_string() };
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(failed(error)),
        _ => {}
    }
    // Not `metadata`: a symbolic link must not be followed.
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

/// Checks that no file with this user's prefix in shared memory belongs to another user.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] with the first such file.
pub(super) fn check_no_foreign_files() -> Result<(), RuntimeDirError> {
    check_owners(Path::new(SHARED_MEMORY), user())
}

fn check_owners(shared_memory: &Path, uid: u32) -> Result<(), RuntimeDirError> {
    files_with_prefix(shared_memory, uid).into_iter().try_for_each(|(path, found)| check_owner(path, &found, uid))
}

/// An error unless `path` is a regular file of `uid`.
fn check_owner(path: PathBuf, found: &fs::Metadata, uid: u32) -> Result<(), RuntimeDirError> {
    if found.uid() == uid && found.is_file() {
        return Ok(());
    }
    let what = format!("belongs to user {} and has plumbline's prefix", found.uid());
    Err(RuntimeDirError::Foreign { path, what, uid })
}

/// Checks that every mapped segment with this user's prefix belongs to this user. A running daemon's files can't be replaced; after its end
/// another user could create files of the same names and wait for a client.
///
/// # Errors
/// [`RuntimeDirError::Foreign`] with the first segment of another user.
pub(super) fn check_mapped_owner() -> Result<(), RuntimeDirError> {
    let maps = PathBuf::from("/proc/self/maps");
    let text =
        fs::read_to_string(&maps).map_err(|error| RuntimeDirError::Io { path: maps, reason: error.to_string() })?;
    let uid = user();
    for path in mapped(&text, &format!("{SHARED_MEMORY}/{}", prefix(uid))) {
        // A segment that no longer exists was removed by its owner.
        if let Ok(found) = fs::symlink_metadata(path) {
            check_owner(PathBuf::from(path), &found, uid)?;
        }
    }
    Ok(())
}

/// Allocates the memory of every mapped segment with this user's prefix. A file in `/dev/shm` otherwise gets its pages on the first write,
/// and the kernel ends the writer (SIGBUS) when none is left.
///
/// # Errors
/// [`RuntimeDirError::Io`] with the first segment that memory is missing for.
pub(super) fn reserve_mapped() -> Result<(), RuntimeDirError> {
    let maps = PathBuf::from("/proc/self/maps");
    let text =
        fs::read_to_string(&maps).map_err(|error| RuntimeDirError::Io { path: maps, reason: error.to_string() })?;
    let start = format!("{SHARED_MEMORY}/{}", prefix(user()));
    let mut paths: Vec<&str> = mapped(&text, &start).collect();
    paths.dedup();
    for path in paths {
        // A removed or read-only segment is not written to by this process.
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

/// Free shared memory below which it counts as full: the need of a new client \[bytes\].
const MIN_FREE_BYTES: u64 = 4 << 20;

/// The exhausted resource that a connection needs, in words; `None` where none is exhausted.
pub(super) fn shortage() -> Option<String> {
    if let Err(error) = rustix::io::fcntl_dupfd_cloexec(std::io::stderr(), 0) {
        return Some(format!("no file descriptor is left ({error})"));
    }
    shared_memory_full()
}

/// Description of full shared memory; `None` where [`MIN_FREE_BYTES`] are free.
pub(super) fn shared_memory_full() -> Option<String> {
    let found = rustix::fs::statvfs(SHARED_MEMORY).ok()?;
    let free = found.f_bavail.saturating_mul(found.f_frsize);
    (free < MIN_FREE_BYTES).then(|| format!("{SHARED_MEMORY} is full ({free} bytes free)"))
}

/// Paths in the text of `/proc/PID/maps` that begin with `start`.
fn mapped<'t>(maps: &'t str, start: &'t str) -> impl Iterator<Item = &'t str> {
    let paths = maps.lines().filter_map(|line| line.find('/').map(|at| &line[at..]));
    paths.filter(move |path| path.starts_with(start))
}

/// Restricts the segment that iceoryx2 opens to every user to this user.
pub(super) fn restrict_global_segment() {
    let uid = user();
    for (path, found) in files_with_prefix(Path::new(SHARED_MEMORY), uid) {
        let global = path.to_string_lossy().ends_with(GLOBAL_SEGMENT_SUFFIX);
        if global && found.uid() == uid && found.mode() & 0o077 != 0 {
            // Another process of this user may have done it, or have ended.
            let _ = fs::set_permissions(&path, fs::Permissions::from_mode(0o600));
        }
    }
}

/// Prefix of this user's files in shared memory, distinct from those of other users and of other iceoryx2 programs.
pub(super) fn prefix(uid: u32) -> String {
    format!("plumbline_{uid}_")
}

/// Files in `shared_memory` with this user's prefix, with their metadata.
pub(super) fn files_with_prefix(shared_memory: &Path, uid: u32) -> Vec<(PathBuf, fs::Metadata)> {
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
    fn a_private_directory_is_created_and_reused() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("own");
        secure(&path, user()).unwrap();
        assert_eq!(fs::metadata(&path).unwrap().mode() & 0o777, 0o700);
        secure(&path, user()).unwrap();
    }

    #[test]
    fn a_path_that_another_user_could_have_prepared_is_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
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
    fn the_error_names_a_foreign_file_with_the_prefix() {
        let memory = tempfile::tempdir().unwrap();
        let (uid, other) = (user(), user() + 1);
        fs::write(memory.path().join("iox2_abc"), "").unwrap();
        fs::write(memory.path().join(format!("{}abc", prefix(uid))), "").unwrap();
        check_owners(memory.path(), uid).unwrap();
        // From the view of a process of the other user.
        fs::write(memory.path().join(format!("{}abc", prefix(other))), "").unwrap();
        let error = check_owners(memory.path(), other).unwrap_err().to_string();
        assert!(error.contains(&prefix(other)) && error.contains(&format!("belongs to user {uid}")), "{error}");
        symlink("/etc/passwd", memory.path().join(format!("{}link", prefix(uid)))).unwrap();
        assert!(check_owners(memory.path(), uid).is_err());
    }

    #[test]
    fn mapped_segments_are_found_by_their_prefix() {
        let maps = "7f00-7f01 rw-s 00000000 00:19 12 /dev/shm/plumbline_7_a.dynamic\n\
            7f01-7f02 r--p 00000000 08:01 13 /usr/lib/libc.so.6\n7f02-7f03 rw-p 00000000 00:00 0\n\
            7f03-7f04 rw-s 00000000 00:19 14 /dev/shm/plumbline_70_b.data\n";
        let found: Vec<_> = mapped(maps, "/dev/shm/plumbline_7_").collect();
        assert_eq!(found, ["/dev/shm/plumbline_7_a.dynamic"]);
        check_mapped_owner().unwrap();
    }
}
