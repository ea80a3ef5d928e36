//! From the loop to the estimator and to a torque client, beside bare iceoryx2 with the same payload and the same wake-up in the same run:
//! `cargo bench --bench ipc_latency [-- --quick]`.
//!
//! A thread takes the place of the loop: one record per millisecond into the ring. The bridge takes it from there as the daemon's does, and
//! publishes samples and feed-forward. What the bridge adds by waking up (state read to record taken) is measured by itself, "the bridge's
//! wake-up"; the rest (record taken to value in the reader's hands) is held against a bare publisher and subscriber of messages of the same
//! size, sent by a thread with the same wake-up. All readers pause for [`POLL`] on
//! average between two looks.

use hdrhistogram::Histogram;
use iceoryx2::prelude::*;
use plumbline_core::{PERIOD_NS, Record, Sink};
use plumbline_ipc::{
    Delivery, FeedForwardClient, FeedForwardMessage, FeedForwardSettings, RobotId, SampleMessage, SampleStream, Server,
    ServerSettings, StreamSettings,
};
use plumbline_rt::os::{now_ns, sleep_until};
use plumbline_rt::recorder::{Drain, RingSink, ring};
use std::num::NonZeroU64;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Mean pause of every reader between two polls.
const POLL: Duration = Duration::from_micros(20);
/// Goal: largest ratio to the bare latency.
const GOAL: f64 = 1.2;
/// Delay between the due time of a record and the bridge's poll for it, as in the daemon \[ns\].
const BEHIND_NS: u64 = 20_000;
/// Room for the times at which the bridge took its last records.
const TIMES: usize = 1 << 16;

type Spread = Histogram<u64>;

fn spread() -> Spread {
    Histogram::new_with_bounds(1, 10_000_000_000, 3).expect("constant bounds")
}

struct Shared {
    stop: AtomicBool,
    /// When the bridge took record number `k`, at `k % TIMES` \[ns\].
    taken: Vec<AtomicU64>,
    /// The same for the record of which feed-forward value `k` was made.
    valued: Vec<AtomicU64>,
}

impl Shared {
    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }
}

/// Time since the bridge took the record of this number \[ns\].
fn since(times: &[AtomicU64], number: u64) -> u64 {
    now_ns().saturating_sub(times[number as usize % TIMES].load(Ordering::Acquire)).max(1)
}

fn times() -> Vec<AtomicU64> {
    (0..TIMES).map(|_| AtomicU64::new(0)).collect()
}

/// Makes this thread's sleeps as long as they are asked to be; where a reader's pauses begin.
fn first_turn() -> u64 {
    // Without this the kernel adds 50 us to every pause of an ordinary thread.
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).expect("a thread may set its own slack");
    1
}

/// A pause of half to one and a half of [`POLL`], never the same twice: readers at a fixed pace would keep whatever distance to their sender they
/// happened to begin with, and measure that.
fn pause(turn: &mut u64) {
    *turn = turn.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    let share = (*turn >> 33) as f64 / (1_u64 << 31) as f64;
    std::thread::sleep(POLL.mul_f64(0.5 + share));
}

/// One record per millisecond, stamped when its state would have been read.
fn stand_in_for_the_loop(shared: &Shared, mut sink: RingSink) {
    let mut deadline = now_ns();
    for number in 0.. {
        deadline += PERIOD_NS;
        sleep_until(deadline);
        if shared.stopped() {
            return;
        }
        let record = Record { cycle: number, stamp_ns: now_ns(), model: 1, ..Record::default() };
        assert!(sink.put(&record), "the ring is full");
    }
}

/// Takes records and publishes them; the spread of its own wake-up.
fn bridge(shared: &Shared, robot: &RobotId, mut drain: Drain) -> Spread {
    let mut server = Server::open(robot, ServerSettings::default()).expect("a robot of this program's own");
    let mut wake_up = spread();
    let mut records = Vec::with_capacity(512);
    let (mut last_ns, mut values) = (now_ns(), 0_usize);
    while !shared.stopped() {
        records.clear();
        if drain.take_into(&mut records, 512) == 0 {
            let (now, due) = (now_ns(), last_ns + PERIOD_NS + BEHIND_NS);
            sleep_until(if due > now { due } else { now + 50_000 });
            continue;
        }
        let now = now_ns();
        for record in &records {
            wake_up.saturating_record(now.saturating_sub(record.stamp_ns).max(1));
            shared.taken[record.cycle as usize % TIMES].store(now, Ordering::Release);
        }
        let last = records[records.len() - 1];
        last_ns = last.stamp_ns;
        values += 1;
        shared.valued[values % TIMES].store(now, Ordering::Release);
        server.feed_forward(FeedForwardMessage::new(&last, 7, [0.0; 3], [0.0; 3]));
        server.publish(&records);
        server.poll(|_, _| unreachable!("nobody sends commands"));
    }
    wake_up
}

/// A torque client: latency from record taken to value received, and from state read to value received.
fn torque_client(shared: &Shared, robot: &RobotId) -> (Spread, Spread) {
    let mut client =
        FeedForwardClient::connect(robot, FeedForwardSettings::default(), Duration::from_secs(20)).expect("the bridge");
    let (mut published, mut whole) = (spread(), spread());
    let mut turn = first_turn();
    let mut seen = 0;
    while !shared.stopped() {
        if let Some(latest) = client.latest().expect("shared memory").filter(|latest| latest.message.sequence > seen) {
            // Published before this reader connected: not a latency of the transport.
            if seen > 0 {
                whole.saturating_record(plumbline_ipc::boot_ns().saturating_sub(latest.message.stamp_ns).max(1));
                published.saturating_record(since(&shared.valued, latest.message.sequence));
            }
            seen = latest.message.sequence;
        }
        pause(&mut turn);
    }
    (published, whole)
}

/// The estimator's end: the same two spreads.
fn estimator(shared: &Shared, robot: &RobotId) -> (Spread, Spread) {
    let mut stream =
        SampleStream::connect(robot, StreamSettings::default(), Duration::from_secs(20)).expect("the bridge");
    let (mut published, mut whole) = (spread(), spread());
    let mut turn = first_turn();
    while !shared.stopped() {
        // Does not wait inside: each reader here pauses by itself.
        if let Delivery::Records { records, .. } = stream.next(Duration::ZERO).expect("shared memory") {
            // Published before this reader connected: not a latency of the transport.
            for record in records.iter().filter(|_| records.len() < 4) {
                published.saturating_record(since(&shared.taken, record.cycle));
                whole.saturating_record(now_ns().saturating_sub(record.stamp_ns).max(1));
            }
        }
        pause(&mut turn);
    }
    (published, whole)
}

/// Bare iceoryx2: a publisher that wakes up as the bridge does, and a subscriber that polls as all readers do.
fn bare<T: Copy + Default + std::fmt::Debug + ZeroCopySend + 'static>(
    shared: &Arc<Shared>,
    name: &str,
    stamp: fn(&mut T) -> &mut u64,
) -> std::thread::JoinHandle<Spread> {
    let (shared, name) = (Arc::clone(shared), name.to_string());
    std::thread::spawn(move || {
        let service = |node: &Node<ipc::Service>| {
            let name = name.as_str().try_into().expect("a service's name");
            let builder = node.service_builder(&name).publish_subscribe::<T>();
            builder
                .subscriber_max_buffer_size(4)
                .enable_safe_overflow(true)
                .open_or_create()
                .expect("a service of its own")
        };
        let node = || {
            NodeBuilder::new()
                .signal_handling_mode(SignalHandlingMode::Disabled)
                .create::<ipc::Service>()
                .expect("a node")
        };
        std::thread::scope(|scope| {
            scope.spawn(|| {
                let node = node();
                let service = service(&node);
                let publisher = service.publisher_builder().create().expect("a publisher");
                let mut deadline = now_ns();
                while !shared.stopped() {
                    deadline += PERIOD_NS;
                    sleep_until(deadline + BEHIND_NS);
                    let mut message = T::default();
                    *stamp(&mut message) = now_ns();
                    publisher.send_copy(message).expect("room");
                }
            });
            let node = node();
            let service = service(&node);
            let subscriber = service.subscriber_builder().buffer_size(4).create().expect("a subscriber");
            let mut latency = spread();
            let mut turn = first_turn();
            while !shared.stopped() {
                while let Some(sample) = subscriber.receive().expect("shared memory") {
                    let mut message = *sample.payload();
                    latency.saturating_record(now_ns().saturating_sub(*stamp(&mut message)).max(1));
                }
                pause(&mut turn);
            }
            latency
        })
    })
}

fn row(what: &str, of: &Spread) {
    let us = |quantile| of.value_at_quantile(quantile) as f64 / 1e3;
    println!(
        "{what:<44} {:>7} p50 {:>7.1} p99 {:>8.1} p99.9 {:>8.1} max {:>8.1} us",
        of.len(),
        us(0.5),
        us(0.99),
        us(0.999),
        of.max() as f64 / 1e3
    );
}

fn verdict(what: &str, ours: &Spread, bare: &Spread) {
    let ratio = |quantile| ours.value_at_quantile(quantile) as f64 / bare.value_at_quantile(quantile) as f64;
    let held = if ratio(0.5) <= GOAL { "held" } else { "NOT HELD" };
    println!("{what}: {:.2} of bare iceoryx2 at p50 ({:.2} at p99); goal {GOAL}: {held}", ratio(0.5), ratio(0.99));
}

fn main() {
    let seconds = if std::env::args().any(|arg| arg == "--quick") { 2 } else { 30 };
    let robot = RobotId::parse("bench", "robot", &format!("bench-{}", std::process::id())).expect("a name");
    let shared = Arc::new(Shared { stop: AtomicBool::new(false), taken: times(), valued: times() });
    let (sink, drain) = ring(8192);
    let (wake_up, client, follower, bare_samples, bare_values) = std::thread::scope(|scope| {
        let bridging = scope.spawn(|| bridge(&shared, &robot, drain));
        let following = scope.spawn(|| estimator(&shared, &robot));
        let torque = scope.spawn(|| torque_client(&shared, &robot));
        let name = |what: &str| format!("plumbline-bench-{}/{what}", std::process::id());
        let samples = bare::<SampleMessage>(&shared, &name("samples"), |message| &mut message.stamp_ns);
        let values = bare::<FeedForwardMessage>(&shared, &name("values"), |message| &mut message.stamp_ns);
        scope.spawn(|| stand_in_for_the_loop(&shared, sink));
        std::thread::sleep(Duration::from_secs(seconds));
        shared.stop.store(true, Ordering::Release);
        let bare = |thread: std::thread::JoinHandle<Spread>| thread.join().expect("a bare pair");
        (
            bridging.join().expect("the bridge"),
            torque.join().expect("the client"),
            following.join().expect("the estimator's end"),
            bare(samples),
            bare(values),
        )
    });
    println!("1 kHz for {seconds} s, ordinary priority, readers poll every {} us", POLL.as_micros());
    row("the bridge's wake-up (state read to taken)", &wake_up);
    row("samples: taken to estimator", &follower.0);
    row("samples: bare iceoryx2", &bare_samples);
    row("feed-forward: taken to client", &client.0);
    row("feed-forward: bare iceoryx2", &bare_values);
    row("whole way of a sample", &follower.1);
    row("whole way of a feed-forward value", &client.1);
    verdict("samples", &follower.0, &bare_samples);
    verdict("feed-forward", &client.0, &bare_values);
}
