//! Segments of shared memory whose maker was killed between making the file and giving it a size.
//!
//! iceoryx2 0.10 opens a segment that is not finished again and again, each time after a millisecond, until it is finished, gone, or a time has
//! passed. Of an empty one it does not look at the time (`open_impl` in iceoryx2-cal's `posix_shared_memory.rs`), so that every process of root that
//! comes across it waits for ever: the next daemon, before it is up, and one that serves, when it looks for its clients. Other users are spared: they
//! may not open a file of mode 0200. Here a thread of root's processes removes such a file, and whoever waits goes on.

use std::fs::Metadata;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::Path;
use std::sync::Once;
use std::time::{Duration, SystemTime};

use super::place;

/// Mode of a segment that is being made.
const UNFINISHED: u32 = 0o200;
/// iceoryx2 itself gives up on whoever takes longer (`creation_timeout`).
const LONGEST: Duration = Duration::from_millis(500);
/// Pause between two looks.
const LOOK: Duration = Duration::from_millis(100);

/// Begins to look after such files, once in a process. To be called before anything asks for priority.
pub(super) fn look_after() {
    static ONCE: Once = Once::new();
    if place::user() != 0 {
        return;
    }
    ONCE.call_once(|| {
        let thread = std::thread::Builder::new().name("plumbline-sweep".into()).spawn(|| {
            loop {
                sweep(Path::new(place::SHARED_MEMORY), place::user(), SystemTime::now());
                std::thread::sleep(LOOK);
            }
        });
        if let Err(error) = thread {
            tracing::warn!("nobody looks after shared memory that a killed process has left half made: {error}");
        }
    });
}

/// Removes the half-made files of a user; how many there were.
fn sweep(shared_memory: &Path, uid: u32, now: SystemTime) -> usize {
    let given_up = |found: &Metadata| {
        let age = found.modified().ok().and_then(|made| now.duration_since(made).ok());
        let empty = found.is_file() && found.len() == 0 && found.permissions().mode() & 0o777 == UNFINISHED;
        empty && found.uid() == uid && age.is_some_and(|age| age > LONGEST)
    };
    let files = place::ours_by_name(shared_memory, uid).into_iter().filter(|(_, found)| given_up(found));
    files.filter(|(path, _)| std::fs::remove_file(path).is_ok()).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, Permissions};

    #[test]
    fn empty_unfinished_and_old_all_three() {
        let memory = tempfile::tempdir().unwrap();
        let uid = place::user();
        let make = |name: &str, size: u64, mode: u32| {
            let path = memory.path().join(format!("{}{name}", place::prefix(uid)));
            File::create(&path).unwrap().set_len(size).unwrap();
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            path
        };
        let half_made = make("a.connection", 0, UNFINISHED);
        let others = [make("b.connection", 0, 0o600), make("c.connection", 4096, UNFINISHED)];
        let now = SystemTime::now();
        assert_eq!(sweep(memory.path(), uid, now), 0, "somebody may be at it");
        assert_eq!(sweep(memory.path(), uid, now + 2 * LONGEST), 1);
        assert!(!half_made.exists() && others.iter().all(|path| path.exists()));
        assert_eq!(sweep(memory.path(), uid + 1, now + 2 * LONGEST), 0);
    }
}
