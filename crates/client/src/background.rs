//! A thread that lives as long as its owner.

use crate::error::Error;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::sync_channel;
use std::thread::JoinHandle;
use std::time::Duration;

/// A thread of ordinary priority that repeats a step until it is dropped.
pub(crate) struct Background {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Background {
    /// Starts the thread. `open` runs on it first, and returns what the caller gets and the step; then the step is repeated every `interval`,
    /// and once more at the end. Returns when `open` has.
    ///
    /// # Errors
    /// That of `open`; [`Error::Thread`].
    pub fn start<T: Send + 'static, S: FnMut()>(
        name: &str,
        interval: Duration,
        open: impl FnOnce() -> Result<(T, S), Error> + Send + 'static,
    ) -> Result<(T, Background), Error> {
        let stop = Arc::new(AtomicBool::new(false));
        let flag = Arc::clone(&stop);
        let (give, opened) = sync_channel(1);
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || {
            let mut step = match open() {
                Ok((value, step)) => {
                    if give.send(Ok(value)).is_err() {
                        return;
                    }
                    step
                }
                Err(error) => {
                    // Nobody waits where the caller has ended.
                    let _ = give.send(Err(error));
                    return;
                }
            };
            while !flag.load(Ordering::Relaxed) {
                step();
                std::thread::sleep(interval);
            }
            step();
        });
        let thread = thread.map_err(|error| Error::Thread(error.to_string()))?;
        let value = opened.recv().map_err(|_| Error::Thread(format!("{name} has ended")))??;
        Ok((value, Background { stop, thread: Some(thread) }))
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // A thread that panicked has ended as well.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}
