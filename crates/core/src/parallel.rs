//! Parallel map over a slice.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Number of threads for long computations: all processors of the machine.
pub fn threads() -> usize {
    thread::available_parallelism().map_or(1, usize::from)
}

/// Applies `work` to every item on `threads` threads. The results are in the order of the items.
///
/// # Panics
/// When `work` panics.
pub fn parallel<T: Sync, R: Send>(items: &[T], threads: usize, work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let threads = threads.clamp(1, items.len().max(1));
    if threads == 1 {
        return items.iter().map(work).collect();
    }
    // Items differ in cost: each thread takes the next item when it is free.
    let (work, next) = (&work, &AtomicUsize::new(0));
    let run = || -> Vec<(usize, R)> {
        let taken = std::iter::from_fn(|| Some(next.fetch_add(1, Ordering::Relaxed)));
        taken.map_while(|index| Some((index, work(items.get(index)?)))).collect()
    };
    let mut done: Vec<(usize, R)> = thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(run)).collect();
        let join = |thread: thread::ScopedJoinHandle<_>| {
            thread.join().unwrap_or_else(|cause| std::panic::resume_unwind(cause))
        };
        running.into_iter().flat_map(join).collect()
    });
    done.sort_unstable_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_in_order_for_any_number_of_threads() {
        let items: Vec<usize> = (0..23).collect();
        let squares: Vec<usize> = items.iter().map(|k| k * k).collect();
        for count in [0, 1, 2, 5, 23, 100] {
            assert_eq!(parallel(&items, count, |k| k * k), squares);
        }
        assert!(parallel(&[] as &[usize], 4, |k| *k).is_empty());
    }

    #[test]
    #[should_panic(expected = "this one")]
    fn a_panic_of_the_work_is_propagated() {
        parallel(&[1, 2, 3], 2, |k| assert!(*k != 2, "this one"));
    }
}
