//! Floor 0: the same work on many things, on all processors.

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
    // Neighbours cost alike: dealt out one by one, every thread gets its share of the dear ones.
    let work = &work;
    let shares: Vec<Vec<R>> = thread::scope(|scope| {
        let share = |first: usize| scope.spawn(move || items[first..].iter().step_by(threads).map(work).collect());
        let running: Vec<_> = (0..threads).map(share).collect();
        let join =
            |one: thread::ScopedJoinHandle<Vec<R>>| one.join().unwrap_or_else(|cause| std::panic::resume_unwind(cause));
        running.into_iter().map(join).collect()
    });
    let mut shares: Vec<_> = shares.into_iter().map(Vec::into_iter).collect();
    (0..items.len()).filter_map(|index| shares[index % threads].next()).collect()
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
