//! Removal of incomplete shared-memory segments: their creator was killed between creating the file and setting its size.
//!
//! iceoryx2 0.10 retries to open an incomplete segment every millisecond until it is complete, removed, or a timeout has passed. For an empty
//! segment the timeout is not checked (`open_impl` in iceoryx2-cal's `posix_shared_memory.rs`). A process of root that opens it blocks for ever: the
//! next daemon at its start, or a running daemon that connects to clients. Other users are not affected: they may not open a file of mode 0200.
//! A thread of root's processes removes such files, which unblocks the waiting processes.

use std::fs::Metadata;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::sync::Once;
use std::time::{Duration, SystemTime};

use super::runtime_dir;

const INCOMPLETE_MODE: u32 = 0o200;
/// Minimum age before removal where a process at an end of the connection is dead.
const DEAD_PEER_TIMEOUT: Duration = Duration::from_millis(100);
/// Minimum age before removal where the processes run: ten times iceoryx2's `creation_timeout`.
const LIVE_PEER_TIMEOUT: Duration = Duration::from_secs(5);
const SWEEP_INTERVAL: Duration = Duration::from_millis(50);

/// Starts the sweeper thread, once in a process. To be called before the process raises its scheduling priority.
pub(super) fn start_sweeper() {
    static ONCE: Once = Once::new();
    if runtime_dir::user() != 0 {
        return;
    }
    ONCE.call_once(|| {
        let thread = std::thread::Builder::new().name("plumbline-sweep".into()).spawn(|| {
            loop {
                sweep(Path::new(runtime_dir::SHARED_MEMORY), runtime_dir::user(), SystemTime::now());
                std::thread::sleep(SWEEP_INTERVAL);
            }
        });
        if let Err(error) = thread {
            tracing::warn!("incomplete shared-memory segments of killed processes are not removed: {error}");
        }
    });
}

/// Removes the incomplete segments of a user; returns their number.
fn sweep(shared_memory: &Path, uid: u32, now: SystemTime) -> usize {
    let abandoned = |path: &Path, found: &Metadata| {
        let age = found.modified().ok().and_then(|made| now.duration_since(made).ok());
        let empty = found.is_file() && found.len() == 0 && found.permissions().mode() & 0o777 == INCOMPLETE_MODE;
        let timeout = || if ends(path).any(|pid| !runs(pid)) { DEAD_PEER_TIMEOUT } else { LIVE_PEER_TIMEOUT };
        empty && found.uid() == uid && age.is_some_and(|age| age > timeout())
    };
    let files =
        runtime_dir::files_with_prefix(shared_memory, uid).into_iter().filter(|(path, found)| abandoned(path, found));
    files.filter(|(path, _)| std::fs::remove_file(path).is_ok()).count()
}

/// Processes at the ends of a connection, by the identities in its file name `PREFIX_ID_ID.connection`. Empty for other files.
fn ends(path: &Path) -> impl Iterator<Item = u32> {
    let name = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".connection")).unwrap_or_default();
    name.rsplit('_').take(2).filter_map(|id| Some(process(id.parse().ok()?)))
}

/// Process that created a port or a node: bits 64 to 95 of its identity.
pub(super) fn process(id: u128) -> u32 {
    (id >> 64) as u32
}

fn runs(pid: u32) -> bool {
    Path::new("/proc").join(pid.to_string()).exists()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, Permissions};

    #[test]
    fn only_files_that_are_empty_incomplete_and_old_are_removed() {
        let memory = tempfile::tempdir().unwrap();
        let uid = runtime_dir::user();
        let make = |name: &str, size: u64, mode: u32| {
            let path = memory.path().join(format!("{}{name}", runtime_dir::prefix(uid)));
            File::create(&path).unwrap().set_len(size).unwrap();
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            path
        };
        let id = |pid: u32| (u128::from(pid) << 64) + (7 << 96) + 1234;
        // No process has the highest number.
        let (own, dead) = (id(std::process::id()), id(u32::MAX));
        let with_dead_peer = make(&format!("0a_{own}_{dead}.connection"), 0, INCOMPLETE_MODE);
        let with_live_peers = make(&format!("0a_{own}_{own}.connection"), 0, INCOMPLETE_MODE);
        let others = [
            make(&format!("0b_{dead}_{dead}.connection"), 0, 0o600),
            make(&format!("0c_{dead}_{dead}.connection"), 4096, INCOMPLETE_MODE),
        ];
        let now = SystemTime::now();
        assert_eq!(sweep(memory.path(), uid + 1, now + 2 * LIVE_PEER_TIMEOUT), 0);
        assert_eq!(sweep(memory.path(), uid, now), 0, "the segment may still be in creation");
        assert_eq!(sweep(memory.path(), uid, now + 2 * DEAD_PEER_TIMEOUT), 1);
        assert!(!with_dead_peer.exists() && with_live_peers.exists());
        assert_eq!(sweep(memory.path(), uid, now + 2 * LIVE_PEER_TIMEOUT), 1);
        assert!(!with_live_peers.exists() && others.iter().all(|path| path.exists()));
    }
}
