//! A thread that passes items on to a reader that may stall: the log's standard error or journal, systemd's notification socket.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Pause between two polls in [`Outbox::flush`].
const PAUSE: Duration = Duration::from_millis(1);

/// The sending end: a queue of bounded length. What finds it full is dropped and counted; no call waits for the reader.
#[derive(Clone)]
pub struct Outbox<T> {
    /// With the number of items that were dropped right before it.
    queue: SyncSender<(u64, T)>,
    pending: Arc<AtomicUsize>,
    dropped: Arc<AtomicU64>,
}

impl<T: Send + 'static> Outbox<T> {
    /// Starts the thread, which calls `deliver` with each item and the number of items dropped right before it. It inherits the scheduling of its
    /// caller: call this before the priority of this thread goes up.
    pub fn start(name: &str, room: usize, mut deliver: impl FnMut(u64, T) + Send + 'static) -> io::Result<Outbox<T>> {
        let (queue, items) = sync_channel::<(u64, T)>(room);
        let pending = Arc::new(AtomicUsize::new(0));
        let delivered = Arc::clone(&pending);
        std::thread::Builder::new().name(name.into()).spawn(move || {
            for (dropped, item) in items {
                deliver(dropped, item);
                delivered.fetch_sub(1, Ordering::Release);
            }
        })?;
        Ok(Outbox { queue, pending, dropped: Arc::new(AtomicU64::new(0)) })
    }

    /// Queues an item; `false` where the queue is full and the item is dropped.
    pub fn offer(&self, item: T) -> bool {
        let before = self.dropped.swap(0, Ordering::AcqRel);
        self.pending.fetch_add(1, Ordering::AcqRel);
        let queued = self.queue.try_send((before, item)).is_ok();
        if !queued {
            self.pending.fetch_sub(1, Ordering::AcqRel);
            self.dropped.fetch_add(before + 1, Ordering::AcqRel);
        }
        queued
    }

    /// Waits until everything is delivered, for `limit` at most; whether it is.
    pub fn flush(&self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        while self.pending.load(Ordering::Acquire) > 0 {
            if Instant::now() >= deadline {
                return false;
            }
            std::thread::sleep(PAUSE);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Condvar, Mutex};

    /// A reader that takes nothing until it is opened.
    #[derive(Default)]
    struct Gate {
        open: Mutex<bool>,
        opened: Condvar,
    }

    #[test]
    fn a_reader_that_stalls_costs_items_and_no_time_and_the_next_item_says_how_many() {
        let gate = Arc::new(Gate::default());
        let taken = Arc::new(Mutex::new(Vec::new()));
        let (reader, list) = (Arc::clone(&gate), Arc::clone(&taken));
        let outbox = Outbox::start("test", 4, move |dropped, item: u32| {
            let open = reader.open.lock().unwrap();
            drop(reader.opened.wait_while(open, |open| !*open).unwrap());
            list.lock().unwrap().push((dropped, item));
        })
        .unwrap();
        let queued = (0..100).filter(|&item| outbox.offer(item)).count();
        // Four in the queue, and one taken by the reader if it was quick.
        assert!((4..=5).contains(&queued), "{queued}");
        assert!(!outbox.flush(Duration::ZERO));

        *gate.open.lock().unwrap() = true;
        gate.opened.notify_all();
        assert!(outbox.flush(Duration::from_secs(60)));
        assert!(outbox.offer(100));
        assert!(outbox.flush(Duration::from_secs(60)));
        let taken = taken.lock().unwrap();
        assert_eq!(taken.len(), queued + 1);
        assert_eq!(*taken.last().unwrap(), (100 - queued as u64, 100));
        assert_eq!(taken.iter().map(|(dropped, _)| dropped).sum::<u64>() + queued as u64, 100);
    }
}
