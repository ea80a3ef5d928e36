//! Work shared among threads, its result independent of their number.

use super::super::ExciteError;
use super::super::search::{Progress, SearchControl};
use super::Found;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard};

/// The threads of one search, and what they tell about it.
pub(super) struct Crew<'a> {
    watch: &'a SearchControl<'a>,
    told: Mutex<Progress>,
}

impl<'a> Crew<'a> {
    /// A search of so many steps.
    pub fn new(watch: &'a SearchControl<'a>, steps: usize) -> Crew<'a> {
        Crew { watch, told: Mutex::new(Progress { done: 0, of: steps, best: f64::INFINITY }) }
    }

    /// `work(0), .., work(count - 1)` on all threads, in this order; each is `weight` steps of the search. When the search is to stop,
    /// what has not begun is left out, except the first: every search ends with something.
    pub fn map<T: Send>(&self, count: usize, weight: usize, work: impl Fn(usize) -> T + Sync) -> Vec<T> {
        let next = AtomicUsize::new(0);
        let done: Mutex<Vec<(usize, T)>> = Mutex::new(Vec::with_capacity(count));
        std::thread::scope(|scope| {
            for _ in 0..self.watch.threads.clamp(1, count.max(1)) {
                scope.spawn(|| {
                    loop {
                        let index = next.fetch_add(1, Ordering::Relaxed);
                        if index >= count || (index > 0 && (self.watch.stop)()) {
                            break;
                        }
                        let result = work(index);
                        open(&done).push((index, result));
                        let mut told = open(&self.told);
                        told.done += weight;
                        (self.watch.progress)(*told);
                    }
                });
            }
        });
        let mut done = done.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
        done.sort_by_key(|(index, _)| *index);
        done.into_iter().map(|(_, result)| result).collect()
    }

    /// Notes a finished motion for those who watch.
    pub fn told(&self, found: Result<Found, ExciteError>) -> Result<Found, ExciteError> {
        if let Ok(found) = &found {
            let mut told = open(&self.told);
            told.best = told.best.min(found.cost.exp());
        }
        found
    }
}

/// A panic on another thread ends the scope anyway; until then its data is as good as ever.
fn open<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
