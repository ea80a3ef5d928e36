//! A daemon of another version: its messages have another layout. It serves through iceoryx2 itself, where plumbline's daemon does.

use iceoryx2::port::update_connections::UpdateConnections;
use iceoryx2::prelude::*;
use plumbline_ipc::{LAYOUT, ModelHeader, RobotId, runtime_dir};
use std::fmt::Debug;
use std::os::unix::fs::MetadataExt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread::JoinHandle;
use std::time::Duration;

/// Defines messages with the names of plumbline's and one number.
macro_rules! other_messages {
    ($($name:ident: $type_name:literal,)+) => {$(
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, ZeroCopySend)]
        #[type_name($type_name)]
        struct $name {
            only: u64,
        }
    )+};
}

other_messages! {
    OtherFeedForward: "plumbline::FeedForwardMessage",
    OtherHeader: "plumbline::ModelHeader",
    OtherGuest: "plumbline::GuestMessage",
}

/// What is different.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Other {
    /// The sizes of the types, which iceoryx2 compares.
    Types,
    /// The number in the header of the model, with types of the same size.
    Number,
}

/// Serves until it is dropped.
pub struct OtherDaemon {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl OtherDaemon {
    /// Returns when its services exist.
    pub fn start(robot: &RobotId, other: Other) -> OtherDaemon {
        let (stop, robot) = (Arc::new(AtomicBool::new(false)), robot.to_string());
        let flag = Arc::clone(&stop);
        let (ready, wait) = channel();
        let thread = std::thread::spawn(move || match other {
            Other::Types => serve_types(&robot, || ready.send(()).is_ok(), &flag),
            Other::Number => serve_number(&robot, || ready.send(()).is_ok(), &flag),
        });
        wait.recv().expect("its services exist");
        OtherDaemon { stop, thread: Some(thread) }
    }
}

impl Drop for OtherDaemon {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        let ended = self.thread.take().map(JoinHandle::join);
        assert!(std::thread::panicking() || !matches!(ended, Some(Err(_))), "the other daemon panicked");
    }
}

/// A node in this user's runtime directory, under this user's prefix.
fn node() -> Node<ipc::Service> {
    let folder = runtime_dir::directory().unwrap().join("iceoryx2");
    let uid = std::fs::metadata("/proc/self").unwrap().uid();
    let mut config = Config::default();
    config.global.set_root_path(&Path::new(folder.to_str().unwrap().as_bytes()).unwrap());
    config.global.prefix = FileName::new(format!("plumbline_{uid}_").as_bytes()).unwrap();
    let builder = NodeBuilder::new().config(&config).signal_handling_mode(SignalHandlingMode::Disabled);
    builder.create::<ipc::Service>().unwrap()
}

fn name(robot: &str, service: &str) -> ServiceName {
    format!("plumbline/{robot}/{service}").as_str().try_into().unwrap()
}

fn serve_types(robot: &str, ready: impl FnOnce() -> bool, stop: &AtomicBool) {
    fn port<T: Debug>(made: Result<T, impl Debug>) -> T {
        made.unwrap()
    }
    let node = node();
    let service = |of: &str| node.service_builder(&name(robot, of));
    let feed_forward = port(service("feed-forward").publish_subscribe::<OtherFeedForward>().create());
    let model = port(service("model").publish_subscribe::<[u8]>().user_header::<OtherHeader>().create());
    let _guest = port(service("guest").publish_subscribe::<[OtherGuest]>().create());
    let _publishers = (port(feed_forward.publisher_builder().create()), port(model.publisher_builder().create()));
    assert!(ready());
    while !stop.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn serve_number(robot: &str, ready: impl FnOnce() -> bool, stop: &AtomicBool) {
    let node = node();
    let service = node.service_builder(&name(robot, "model")).publish_subscribe::<[u8]>().user_header::<ModelHeader>();
    let service = service.history_size(1).subscriber_max_buffer_size(1).enable_safe_overflow(true).create().unwrap();
    let publisher = service.publisher_builder().initial_max_slice_len(16).create().unwrap();
    let mut memory = publisher.loan_slice_uninit(3).unwrap();
    let header = ModelHeader { layout: LAYOUT + 1, model: 7, sequence: 1, ..ModelHeader::default() };
    *memory.user_header_mut() = header;
    memory.write_from_slice(b"any").send().unwrap();
    assert!(ready());
    while !stop.load(Ordering::Relaxed) {
        publisher.update_connections().unwrap();
        std::thread::sleep(Duration::from_millis(1));
    }
}
