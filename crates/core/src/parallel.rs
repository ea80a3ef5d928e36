//! The same work on many things, on all processors.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Threads that long work may use: all that the machine has.
pub fn threads() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// `work` on every item, on `threads` threads; the results in the order of the items.
///
/// # Panics
/// Where `work` does.
pub fn parallel<T: Sync, R: Send>(items: &[T], threads: usize, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let threads = threads.clamp(1, items.len().max(1));
    if threads == 1 {
        return items.iter().map(work).collect();
    }
    // Items cost what they cost, and threads are held up by others: whoever is done takes the next.
    let (work, next) = (&work, &AtomicUsize::new(0));
    let share = || -> Vec<(usize, R)> {
        let mine = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)));
        mine.map_while(|index| Some((index, work(items.get(index)?)))).collect()
    };
    let mut done: Vec<(usize, R)> = thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(share)).collect();
        let join =
            |one: thread::ScopedJoinHandle<_>| one.join().unwrap_or_else(|cause| std::panic::resume_unwind(cause));
        running.into_iter().flat_map(join).collect()
    });
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keeps_the_order_whatever_the_number_of_threads() {
        let items: Vec<usize> = (0..23).collect();
        let squares: Vec<usize> = items.iter().map(|k| k * k).collect();
        for count in [0, 1, 2, 5, 23, 100] {
            assert_eq!(parallel(&items, count, |k| k * k), squares);
        }
        assert!(parallel(&[] as &[usize], 4, |k| *k).is_empty());
    }

    #[test]
    #[should_panic(expected = "this one")]
    fn passes_a_panic_on() {
        parallel(&[1, 2, 3], 2, |k| assert!(*k != 2, "this one"));
    }
}
