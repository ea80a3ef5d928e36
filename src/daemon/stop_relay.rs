//! Relays stops to the running loop on a thread of its own, independent of the bridge thread.

use plumbline_ipc::{StopListener, StopOrder};
use plumbline_rt::Controls;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Pause after a stop: many stops must not use up the kernel's budget for real-time threads.
const PAUSE: Duration = Duration::from_millis(1);

/// The thread that receives stops, from the bridge thread's side.
pub struct StopRelay {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    last_turns: u64,
}

#[derive(Default)]
struct Shared {
    ended: AtomicBool,
    turns: AtomicU64,
    /// There is an order that the bridge thread has not taken yet.
    pending: AtomicBool,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    controls: Option<Arc<Controls>>,
    order: Option<StopOrder>,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Brakes the running loop, and leaves the order for the bridge thread.
    fn stop(&self, order: StopOrder) {
        let mut state = self.state();
        if let Some(controls) = &state.controls {
            controls.stop();
        }
        state.order = Some(order);
        self.pending.store(true, Ordering::Release);
    }
}

impl StopRelay {
    /// Starts the thread; `prepare` runs on it first.
    pub fn start(mut listener: StopListener, prepare: impl FnOnce() + Send + 'static) -> std::io::Result<StopRelay> {
        StopRelay::listening(move |carry_out| listener.listen(carry_out), prepare)
    }

    fn listening(
        mut listen: impl FnMut(&mut dyn FnMut(StopOrder)) -> std::io::Result<()> + Send + 'static,
        prepare: impl FnOnce() + Send + 'static,
    ) -> std::io::Result<StopRelay> {
        let shared = Arc::new(Shared::default());
        let own = Arc::clone(&shared);
        let thread = std::thread::Builder::new().name("plumbline-stop".into()).spawn(move || {
            prepare();
            let mut failed = false;
            while !own.ended.load(Ordering::Relaxed) {
                let mut taken = false;
                let listened = listen(&mut |order| {
                    own.stop(order);
                    taken = true;
                });
                match listened {
                    // No turn is counted where nothing can be read: the loop's heartbeat ends with it.
                    Err(error) if !taken => {
                        if !std::mem::replace(&mut failed, true) {
                            tracing::error!("stops can't be read from their socket: {error}");
                        }
                        std::thread::sleep(PAUSE);
                    }
                    _ => {
                        failed = false;
                        own.turns.fetch_add(1, Ordering::Relaxed);
                    }
                }
                if taken {
                    std::thread::sleep(PAUSE);
                }
            }
        })?;
        Ok(StopRelay { shared, thread: Some(thread), last_turns: 0 })
    }

    /// From here on stops go to the loop of these controls, directly; `None` where none runs.
    pub fn connect(&self, controls: Option<Arc<Controls>>) {
        self.shared.state().controls = controls;
    }

    /// The latest stop since the last call; the bridge thread calls it first in every turn. Where the thread has polled its socket meanwhile, the
    /// running loop gets a heartbeat: it can be stopped.
    pub fn attend(&mut self, controls: Option<&Controls>) -> Option<StopOrder> {
        if self.has_listened()
            && let Some(controls) = controls
        {
            controls.heartbeat();
        }
        self.take()
    }

    /// The latest stop since the last call.
    fn take(&self) -> Option<StopOrder> {
        if !self.shared.pending.swap(false, Ordering::AcqRel) {
            return None;
        }
        self.shared.state().order.take()
    }

    /// Whether the thread has polled its socket since the last call: it does so 20 times a second.
    fn has_listened(&mut self) -> bool {
        let turns = self.shared.turns.load(Ordering::Relaxed);
        std::mem::replace(&mut self.last_turns, turns) != turns
    }
}

impl Drop for StopRelay {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_ipc::{Lock, RobotId};

    const ORDER: StopOrder = StopOrder { process: 7, user: 8 };

    fn silent() -> StopRelay {
        StopRelay { shared: Arc::default(), thread: None, last_turns: 0 }
    }

    #[test]
    fn a_stop_reaches_the_loop_while_the_bridge_thread_does_nothing() {
        let line = silent();
        let controls = Arc::new(Controls::default());
        line.connect(Some(Arc::clone(&controls)));
        line.shared.stop(ORDER);
        assert!(controls.stop_requested());
        // The bridge thread learns of it once.
        assert_eq!((line.take(), line.take()), (Some(ORDER), None));
        // One between two loops is left for the bridge thread.
        let ended = Arc::new(Controls::default());
        line.connect(Some(Arc::clone(&ended)));
        line.connect(None);
        line.shared.stop(ORDER);
        assert!(!ended.stop_requested());
        assert_eq!(line.take(), Some(ORDER));
    }

    #[test]
    fn without_polls_of_the_socket_there_is_no_heartbeat() {
        let controls = Controls::default();
        let mut line = silent();
        (0..3).for_each(|_| assert_eq!(line.attend(Some(&controls)), None));
        assert_eq!(controls.heartbeats(), 0, "nobody listens");
        let place = tempfile::tempdir().unwrap();
        let lock = Lock::take_in(place.path(), &RobotId::parse("test", "robot", "panda").unwrap()).unwrap();
        let mut line = StopRelay::start(StopListener::open(&lock).unwrap(), || ()).unwrap();
        let start = std::time::Instant::now();
        while controls.heartbeats() < 3 {
            assert!(start.elapsed() < Duration::from_secs(20));
            line.attend(Some(&controls));
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn every_stop_that_is_read_reaches_the_loop_and_a_flood_of_them_is_slowed_down() {
        const FLOOD: u64 = 50;
        let prepared = Arc::new(AtomicBool::new(false));
        let calls = Arc::new(AtomicU64::new(0));
        let (own, counted) = (Arc::clone(&prepared), Arc::clone(&calls));
        let (end, ended) = std::sync::mpsc::channel::<()>();
        // The last stop is read, and the count of stops in the lock file then fails: it is a stop all the same.
        let listen = move |carry_out: &mut dyn FnMut(StopOrder)| {
            let call = counted.fetch_add(1, Ordering::Relaxed) + 1;
            if call > FLOOD {
                let _ = ended.recv();
                return Ok(());
            }
            carry_out(StopOrder { process: call as u32, user: 8 });
            if call == FLOOD { Err(std::io::Error::other("no count")) } else { Ok(()) }
        };
        let controls = Arc::new(Controls::default());
        let start = std::time::Instant::now();
        let line = StopRelay::listening(listen, move || own.store(true, Ordering::Relaxed)).unwrap();
        line.connect(Some(Arc::clone(&controls)));
        while calls.load(Ordering::Relaxed) <= FLOOD {
            assert!(start.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(start.elapsed() >= PAUSE * FLOOD as u32);
        assert_eq!(line.shared.turns.load(Ordering::Relaxed), FLOOD);
        assert!(prepared.load(Ordering::Relaxed) && controls.stop_requested());
        assert_eq!((line.take(), line.take()), (Some(StopOrder { process: FLOOD as u32, user: 8 }), None));
        drop(end);
        drop(line);
        assert_eq!(Arc::strong_count(&calls), 1, "the thread has ended");
    }

    #[test]
    fn where_stops_can_not_be_read_no_turn_is_counted_and_the_log_says_so_once() {
        use super::super::logged::Lines;
        let calls = Arc::new(AtomicU64::new(0));
        let own = Arc::clone(&calls);
        // Ten failures, five turns in which nothing comes, one more failure.
        let listen = move |_: &mut dyn FnMut(StopOrder)| match own.fetch_add(1, Ordering::Relaxed) {
            0..10 | 15 => Err(std::io::Error::other("no socket")),
            10..15 => Ok(()),
            _ => {
                std::thread::sleep(Duration::from_secs(1));
                Ok(())
            }
        };
        let lines = Lines::default();
        let subscriber = lines.subscriber();
        let start = std::time::Instant::now();
        // For as long as the thread lives.
        let line =
            StopRelay::listening(listen, || std::mem::forget(tracing::subscriber::set_default(subscriber))).unwrap();
        while calls.load(Ordering::Relaxed) < 17 {
            assert!(start.elapsed() < Duration::from_secs(20));
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(line.shared.turns.load(Ordering::Relaxed), 5);
        assert!(start.elapsed() >= PAUSE * 11, "a pause after each failure");
        assert_eq!(lines.text().matches("can't be read").count(), 2, "{}", lines.text());
    }
}
