//! Worker threads of a search; results do not depend on their number.

use super::super::ExciteError;
use super::super::search::{Progress, SearchControl};
use super::Found;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};

/// Worker threads of one search and their progress.
pub(super) struct Workers<'a> {
    control: &'a SearchControl<'a>,
    progress: Mutex<Progress>,
}

impl<'a> Workers<'a> {
    /// Workers of a search with `steps` steps.
    pub fn new(control: &'a SearchControl<'a>, steps: usize) -> Workers<'a> {
        Workers { control, progress: Mutex::new(Progress { done: 0, of: steps, best: f64::INFINITY }) }
    }

    /// Results of `work(0), .., work(count - 1)` in this order, computed on all threads; each is `weight` steps of the search. After a
    /// cancellation only the running and the first ones are computed: every search has a result.
    pub fn map<T: Send>(&self, count: usize, weight: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let next = AtomicUsize::new(0);
        let done: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(count));
        std::thread::scope(|scope| {
            for _ in 0..self.control.threads.clamp(1, count.max(1)) {
                scope.spawn(|| {
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        if index >= count || (index > 0 && (self.control.stop)()) {
                            break;
                        }
                        let result = work(index);
                        lock(&done).push((index, result));
                        let mut progress = lock(&self.progress);
                        progress.done += weight;
                        (self.control.progress)(*progress);
                    }
                });
            }
        });
        let mut done = done.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        done.sort_by_key(|(index, _)| *index);
        done.into_iter().map(|(_, result)| result).collect()
    }

    /// Updates the best criterion by a finished motion.
    pub fn report(&self, found: Result<Found, ExciteError>) -> Result<Found, ExciteError> {
        if let Ok(found) = &found {
            let mut progress = lock(&self.progress);
            progress.best = progress.best.min(found.cost.exp());
        }
        found
    }
}

/// Locks a mutex, also after a panic of another thread, which ends the scope anyway.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
