use super::send::stop_in;
use super::*;
use crate::RobotId;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

fn robot() -> RobotId {
    RobotId::parse("test", "robot", "panda").unwrap()
}

/// One at a time: a signal reaches every listener of this process.
static ALONE: Mutex<()> = Mutex::new(());

fn alone() -> MutexGuard<'static, ()> {
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A daemon's end on a thread of its own.
struct Listening {
    heard: Arc<AtomicU64>,
    process: Arc<AtomicU64>,
    ended: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Listening {
    fn start(mut listener: StopListener) -> Listening {
        let (heard, process): (Arc<AtomicU64>, Arc<AtomicU64>) = Default::default();
        let ended = Arc::new(AtomicBool::new(false));
        let (count, from, end) = (heard.clone(), process.clone(), ended.clone());
        let thread = std::thread::spawn(move || {
            while !end.load(Ordering::Relaxed) {
                let carried_out = listener.listen(|order| {
                    from.store(order.process.into(), Ordering::Relaxed);
                    count.fetch_add(1, Ordering::Relaxed);
                });
                carried_out.unwrap();
            }
        });
        Listening { heard, process, ended, thread: Some(thread) }
    }

    fn heard(&self) -> u64 {
        self.heard.load(Ordering::Relaxed)
    }
}

impl Drop for Listening {
    fn drop(&mut self) {
        self.ended.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap();
    }
}

#[test]
fn a_stop_is_taken_by_the_socket_and_its_sender_is_told_so() {
    let _alone = alone();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = Listening::start(StopListener::open(&lock).unwrap());
    assert_eq!(listening.heard(), 0, "nothing that the opening sends is a stop");
    let before = now_ns();
    let taken = stop_in(place.path(), &robot()).unwrap();
    assert_eq!((taken.process, &taken.way), (std::process::id(), &StopPath::Socket));
    assert!((before..=now_ns()).contains(&taken.at_ns), "{taken:?}");
    assert_eq!(listening.heard(), 1);
    // Whatever a datagram holds, it is a stop; an empty one is none.
    let other = UnixDatagram::unbound().unwrap();
    let socket = socket_beside(lock.path());
    other.send_to(b"", &socket).unwrap();
    other.send_to(b"{\"request\":\"stop\"} and more than fits", &socket).unwrap();
    stop_in(place.path(), &robot()).unwrap();
    assert_eq!(listening.heard(), 3);
}

#[test]
fn the_sender_s_process_is_the_one_that_the_kernel_names() {
    let _alone = alone();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = Listening::start(StopListener::open(&lock).unwrap());
    let script = "import socket,sys; socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto(b'x', sys.argv[1])";
    let sender = std::process::Command::new("python3").args(["-c", script]).arg(socket_beside(lock.path())).spawn();
    let Ok(mut sender) = sender else { return eprintln!("SKIPPED: there is no python3") };
    let process = u64::from(sender.id());
    assert!(sender.wait().unwrap().success());
    let start = std::time::Instant::now();
    while listening.heard() == 0 {
        assert!(start.elapsed() < Duration::from_secs(20));
        std::thread::sleep(Duration::from_millis(1));
    }
    assert_eq!(listening.process.load(Ordering::Relaxed), process);
}

#[test]
fn a_signal_stops_where_the_socket_is_gone() {
    let _alone = alone();
    let place = tempfile::tempdir().unwrap();
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let listening = Listening::start(StopListener::open(&lock).unwrap());
    std::fs::remove_file(socket_beside(lock.path())).unwrap();
    let taken = stop_in(place.path(), &robot()).unwrap();
    assert!(matches!(&taken.way, StopPath::Signal { because } if because.contains("No such file")), "{taken:?}");
    assert!(listening.heard() >= 1);
}

#[test]
fn nothing_is_signalled_that_does_not_hold_the_lock() {
    let _alone = alone();
    let place = tempfile::tempdir().unwrap();
    assert!(matches!(stop_in(place.path(), &robot()), Err(StopError::NoDaemon { .. })));
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let path = lock.path().to_path_buf();
    // A process that lives and holds nothing: SIGUSR2 would end it.
    let mut bystander = std::process::Command::new("sleep").arg("60").spawn().unwrap();
    let refused = holder::Holder::verified(&path, bystander.id()).unwrap_err();
    assert!(refused.reason.contains("does not hold the lock"), "{refused:?}");
    // The lock is gone, its file still names the process.
    drop(lock);
    std::fs::write(&path, format!("process {}\n", bystander.id())).unwrap();
    let error = stop_in(place.path(), &robot()).unwrap_err();
    assert!(
        matches!(&error, StopError::NoDaemon { reason, .. } if reason.contains("does not hold the lock")),
        "{error}"
    );
    assert!(bystander.try_wait().unwrap().is_none(), "it was signalled");
    // A lock that was passed on is held by whoever has it open, also where another process had taken it.
    let lock = Lock::take_in(place.path(), &robot()).unwrap();
    let passed_on = lock.pass_on().unwrap();
    let mut heir = std::process::Command::new("sleep").arg("60").spawn().unwrap();
    drop(passed_on);
    let refused = holder::Holder::verified(&path, heir.id()).unwrap_err();
    assert!(refused.reason.contains("holds the lock and serves no robot yet"), "{refused:?}");
    for child in [&mut bystander, &mut heir] {
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
