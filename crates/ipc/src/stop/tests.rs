use super::send::stop_in;
use super::*;
use crate::RobotId;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

fn robot() -> RobotId {
    RobotId::parse("test", "robot", "panda").unwrap()
}

/// Serialises the tests: a signal reaches every listener of this process.
static SERIAL: Mutex<()> = Mutex::new(());

fn serial() -> MutexGuard<'static, ()> {
    SERIAL.lock().unwrap_or_else(PoisonError::into_inner)
}

struct ListenerThread {
    received: Arc<AtomicU64>,
    process: Arc<AtomicU64>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl ListenerThread {
    fn start(mut listener: StopListener) -> ListenerThread {
        let (received, process): (Arc<AtomicU64>, Arc<AtomicU64>) = Default::default();
        let ended = Arc::new(AtomicBool::new(false));
        let (count, from, end) = (received.clone(), process.clone(), ended.clone());
        let thread = std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                let carried_out = listener.listen(|order| {
                    from.store(order.process.into(), Ordering::Relaxed);
                    count.fetch_add(1, Ordering::Relaxed);
                });
                carried_out.unwrap();
            }
        });
        ListenerThread { received, process, ended, thread: Some(thread) }
    }

    fn received(&self) -> u64 {
        self.received.load(Ordering::Relaxed)
    }
}

impl Drop for ListenerThread {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

#[test]
fn a_stop_over_the_socket_is_acknowledged_to_its_sender() {
    let _serial = serial();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = ListenerThread::start(StopListener::open(&lock).unwrap());
    assert_eq!(listening.received(), 0, "opening the listener sends no stop");
    let before = now_ns();
    let taken = stop_in(place.path(), &robot()).unwrap();
    assert_eq!((taken.process, &taken.way), (std::process::id(), &StopPath::Socket));
    assert!((before..=now_ns()).contains(&taken.at_ns), "{taken:?}");
    assert_eq!(listening.received(), 1);
    // Every non-empty datagram is a stop; an empty one is not.
    let other = UnixDatagram::unbound().unwrap();
    let socket = socket_beside(lock.path());
    other.send_to(b"", &socket).unwrap();
    other.send_to(b"{\"request\":\"stop\"} and more than fits", &socket).unwrap();
    stop_in(place.path(), &robot()).unwrap();
    assert_eq!(listening.received(), 3);
}

#[test]
fn the_sender_is_identified_by_the_kernel_s_credentials() {
    let _serial = serial();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = ListenerThread::start(StopListener::open(&lock).unwrap());
    let script = "import socket,sys; socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto(b'x', sys.argv[1])";
    let sender = std::process::Command::new("python3").args(["-c", script]).arg(socket_beside(lock.path())).spawn();
    let Ok(mut sender) = sender else { return eprintln!("SKIPPED: there is no python3") };
    let process = u64::from(sender.id());
    assert!(sender.wait().unwrap().success());
    let start = std::time::Instant::now();
    while listening.received() == 0 {
        assert!(start.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(listening.process.load(Ordering::Relaxed), process);
}

#[test]
fn a_stop_falls_back_to_the_signal_without_a_socket() {
    let _serial = serial();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = ListenerThread::start(StopListener::open(&lock).unwrap());
    std::fs::remove_file(socket_beside(lock.path())).unwrap();
    let taken = stop_in(place.path(), &robot()).unwrap();
    assert!(matches!(&taken.way, StopPath::Signal { because } if because.contains("No such file")), "{taken:?}");
    assert!(listening.received() >= 1);
}

#[test]
fn only_the_holder_of_the_lock_is_signalled() {
    let _serial = serial();
    let place = tempfile::tempdir().unwrap();
    assert!(matches!(stop_in(place.path(), &robot()), Err(StopError::NoDaemon { .. })));
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let path = lock.path().to_path_buf();
    // A running process without the lock: SIGUSR2 would end it.
    let mut bystander = std::process::Command::new("sleep").arg("60").spawn().unwrap();
    let refused = holder::Holder::verified(&path, bystander.id()).unwrap_err();
    assert!(refused.reason.contains("does not hold the lock"), "{refused:?}");
    // The lock is released, its file still names the process.
    drop(lock);
    std::fs::write(&path, format!("process {}\n", bystander.id())).unwrap();
    let error = stop_in(place.path(), &robot()).unwrap_err();
    assert!(
        matches!(&error, StopError::NoDaemon { reason, .. } if reason.contains("does not hold the lock")),
        "{error}"
    );
    assert!(bystander.try_wait().unwrap().is_none(), "the bystander was signalled");
    // An inherited lock is held by every process that has its file open.
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let passed_on = lock.pass_on().unwrap();
    let mut inheritor = std::process::Command::new("sleep").arg("60").spawn().unwrap();
    drop(passed_on);
    let refused = holder::Holder::verified(&path, inheritor.id()).unwrap_err();
    assert!(refused.reason.contains("holds the lock and serves no robot yet"), "{refused:?}");
    for child in [&mut bystander, &mut inheritor] {
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
