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

use super::runtime_dir;
use super::services::process;

/// Mode of a segment that is being made.
const UNFINISHED: u32 = 0o200;
/// A connection of which one end is dead is of no use to the other.
const OF_THE_DEAD: Duration = Duration::from_millis(100);
/// Whoever lives and takes longer will not finish: iceoryx2 itself gives up on him ten times earlier (`creation_timeout`).
const LONGEST: Duration = Duration::from_secs(5);
/// Pause between two looks.
const LOOK: Duration = Duration::from_millis(50);

/// Begins to look after such files, once in a process. To be called before anything asks for priority.
pub(super) fn start_sweeper() {
    static ONCE: Once = Once::new();
    if runtime_dir::user() != 0 {
        return;
    }
    ONCE.call_once(|| {
        let thread = std::thread::Builder::new().name("plumbline-sweep".into()).spawn(|| {
            loop {
                sweep(Path::new(runtime_dir::SHARED_MEMORY), runtime_dir::user(), SystemTime::now());
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
    let given_up = |path: &Path, found: &Metadata| {
        let age = found.modified().ok().and_then(|made| now.duration_since(made).ok());
        let empty = found.is_file() && found.len() == 0 && found.permissions().mode() & 0o777 == UNFINISHED;
        let longest = || if ends(path).any(|pid| !runs(pid)) { OF_THE_DEAD } else { LONGEST };
        empty && found.uid() == uid && age.is_some_and(|age| age > longest())
    };
    let files = runtime_dir::ours_by_name(shared_memory, uid).into_iter().filter(|(path, found)| given_up(path, found));
    files.filter(|(path, _)| std::fs::remove_file(path).is_ok()).count()
}

/// Processes at the ends of a connection: the third 32 bits of the ids in its name, `PREFIX_ID_ID.connection`. None of other files.
fn ends(path: &Path) -> impl Iterator<Item = u32> {
    let name = path.file_name().and_then(|name| name.to_str()?.strip_suffix(".connection")).unwrap_or_default();
    name.rsplit('_').take(2).filter_map(|id| Some(process(id.parse().ok()?)))
}

fn runs(pid: u32) -> bool {
    Path::new("/proc").join(pid.to_string()).exists()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{File, Permissions};

    #[test]
    fn empty_unfinished_and_old_all_three() {
        let memory = tempfile::tempdir().unwrap();
        let uid = runtime_dir::user();
        let make = |name: &str, size: u64, mode: u32| {
            let path = memory.path().join(format!("{}{name}", runtime_dir::prefix(uid)));
            File::create(&path).unwrap().set_len(size).unwrap();
            std::fs::set_permissions(&path, Permissions::from_mode(mode)).unwrap();
            path
        };
        let id = |pid: u32| (u128::from(pid) << 64) + (7 << 96) + 1234;
        // No process has the largest number.
        let (own, dead) = (id(std::process::id()), id(u32::MAX));
        let of_the_dead = make(&format!("0a_{own}_{dead}.connection"), 0, UNFINISHED);
        let of_the_slow = make(&format!("0a_{own}_{own}.connection"), 0, UNFINISHED);
        let others = [
            make(&format!("0b_{dead}_{dead}.connection"), 0, 0o600),
            make(&format!("0c_{dead}_{dead}.connection"), 4096, UNFINISHED),
        ];
        let now = SystemTime::now();
        assert_eq!(sweep(memory.path(), uid + 1, now + 2 * LONGEST), 0);
        assert_eq!(sweep(memory.path(), uid, now), 0, "somebody may be at it");
        assert_eq!(sweep(memory.path(), uid, now + 2 * OF_THE_DEAD), 1);
        assert!(!of_the_dead.exists() && of_the_slow.exists());
        assert_eq!(sweep(memory.path(), uid, now + 2 * LONGEST), 1);
        assert!(!of_the_slow.exists() && others.iter().all(|path| path.exists()));
    }
}
