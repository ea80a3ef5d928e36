//! Shared memory from the clients' view: samples complete and in order, the latest feed-forward value, responses to requests.

use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::time::Duration;

use plumbline_ipc::{
    Client, Delivery, FeedForwardClient, FeedForwardMessage, FeedForwardSettings, FollowerEvent, IpcError, Lock,
    MAX_REQUEST_BYTES, Presence, Request, Response, SampleStream, SampleWatcher, Server, ServerSettings, Status,
    StreamSettings,
};
use plumbline_testkit::memory::*;
use plumbline_testkit::wait::wait_for;
use rand::{Rng, RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn settings() -> StreamSettings {
    StreamSettings::default()
}

#[test]
fn a_follower_with_pauses_receives_every_record_once_and_in_order() {
    const TOTAL: u64 = 60_000;
    let robot = robot("pauses");
    let (go, started) = mpsc::channel::<u64>();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut next = 0;
        while next < TOTAL {
            server.poll(|_, _| unreachable!());
            // As many as the test asks for, at its pace; then all others at once.
            let Ok(most) = started.try_recv() else { continue };
            let mut left = most.min(TOTAL - next);
            while left > 0 {
                let count = random.random_range(1..100).min(left);
                server.publish(&(next..next + count).map(record).collect::<Vec<_>>());
                (next, left) = (next + count, left - count);
                server.poll(|_, _| unreachable!());
                if random.random_range(0..20) == 0 {
                    std::thread::sleep(Duration::from_millis(1));
                }
            }
        }
        poll_until(server, stop);
        server.served()
    });
    let mut stream = SampleStream::connect(&robot, settings(), TIMEOUT).unwrap();
    // A follower that keeps up receives them from the stream: one batch at a time until it has, for its thread may stand still for long.
    while stream.counters().replayed == stream.position() {
        assert!(stream.position() < TOTAL / 2, "every record was replayed");
        go.send(50).unwrap();
        let end = stream.position() + 50;
        assert!(read_until(&mut stream, end, || ()).is_empty());
    }
    go.send(TOTAL).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    // Pauses of 60 ms: more records than the buffer's capacity are published.
    let missed = read_until(&mut stream, TOTAL, || {
        if random.random_range(0..10) == 0 {
            std::thread::sleep(Duration::from_millis(60));
        }
    });
    let counters = stream.counters();
    assert!(missed.is_empty());
    assert_eq!((counters.received, counters.missed, counters.restarts), (TOTAL, 0, 0));
    assert!(counters.gaps > 0 && counters.replayed > 0 && counters.replayed < TOTAL, "{counters:?}");

    let epoch = stream.epoch();
    drop(stream);
    std::thread::sleep(Duration::from_millis(50));
    let served = daemon.stop();
    assert_eq!((served.published, served.acknowledged, served.epoch), (TOTAL, TOTAL, epoch));
    assert_eq!((served.given_up_unacknowledged, served.unsent_batches, served.trouble), (0, 0, None));
    assert!(served.followers.is_empty());
}

#[test]
fn a_watcher_reads_samples_and_is_no_follower() {
    let robot = robot("watcher");
    let (go, started) = mpsc::channel::<()>();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        started.recv().unwrap();
        server.publish(&(0..50).map(record).collect::<Vec<_>>());
        poll_until(server, stop);
        server.served()
    });
    let mut watcher = SampleWatcher::connect(&robot, TIMEOUT).unwrap();
    go.send(()).unwrap();
    let mut records = Vec::new();
    wait_for("the samples", || {
        watcher.take(|record| records.push(*record)).unwrap();
        (records.len() >= 50).then_some(())
    });
    assert_eq!(records.len(), 50);
    (0..50).for_each(|cycle| assert_is_record(&records[cycle as usize], cycle));
    drop(watcher);
    let served = daemon.stop();
    assert_eq!((served.published, served.acknowledged, served.trouble), (50, 0, None));
    assert!(served.followers.is_empty());
}

#[test]
fn late_and_paused_followers_receive_every_record() {
    let robot = robot("late");
    let (more, wanted) = mpsc::channel::<u64>();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let mut next = 0;
        while !stop.load(Ordering::Relaxed) {
            if let Ok(count) = wanted.try_recv() {
                let records: Vec<_> = (next..next + count).map(record).collect();
                server.publish(&records);
                next += count;
            }
            server.poll(|_, _| unreachable!());
            std::thread::sleep(Duration::from_micros(200));
        }
        (server.served(), std::iter::from_fn(|| server.take_follower_event()).collect::<Vec<_>>())
    });
    more.send(10_000).unwrap();
    let mut late = SampleStream::connect(&robot, settings(), TIMEOUT).unwrap();
    assert!(read_until(&mut late, 10_000, || ()).is_empty());

    // More than the buffer's capacity and nothing after it: the loss at the end is detected without a later batch.
    more.send(20_000).unwrap();
    std::thread::sleep(Duration::from_millis(300));
    assert!(read_until(&mut late, 30_000, || ()).is_empty());

    // A second one from the middle on.
    let mut middle = SampleStream::connect(&robot, StreamSettings { from: 29_000, ..settings() }, TIMEOUT).unwrap();
    assert!(read_until(&mut middle, 30_000, || ()).is_empty());
    assert_eq!(middle.counters().received, 1000);

    drop((late, middle));
    std::thread::sleep(Duration::from_millis(50));
    let (served, news) = daemon.stop();
    assert_eq!((served.published, served.acknowledged), (30_000, 30_000));
    let left = |news: &&FollowerEvent| matches!(news, FollowerEvent::Left { acknowledged: 30_000, .. });
    assert_eq!(news.iter().filter(left).count(), 2, "{news:?}");
}

#[test]
fn discarded_records_are_counted_and_reported_as_missed() {
    let robot = robot("given-up");
    let daemon = Daemon::start(&robot, ServerSettings { retain: 2048, ..Default::default() }, |server, stop| {
        server.publish(&(0..20_000).map(record).collect::<Vec<_>>());
        poll_until(server, stop);
        server.served()
    });
    let mut stream = SampleStream::connect(&robot, settings(), TIMEOUT).unwrap();
    let missed = read_until(&mut stream, 20_000, || ());
    let counters = stream.counters();
    let served = daemon.stop();
    assert_eq!(missed, [(0, served.first_retained)]);
    assert_eq!(counters.missed, served.first_retained);
    assert_eq!(counters.received + counters.missed, 20_000);
    assert!(counters.received >= 2048);
    assert_eq!(served.given_up_unacknowledged, served.first_retained);
}

#[test]
fn clients_that_never_read_do_not_affect_the_others() {
    const TOTAL: u64 = 20_000;
    let robot = robot("never-read");
    let (go, started) = mpsc::channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        started.recv().unwrap();
        for cycle in 0..TOTAL {
            let record = record(cycle);
            server.publish(&[record]);
            server.feed_forward(FeedForwardMessage::new(&record, 7, [0.0; 3], [0.0; 3]));
            if cycle % 8 == 0 {
                server.poll(|_, _| unreachable!());
            }
        }
        poll_until(server, stop);
        server.served()
    });
    // Two followers and 24 feed-forward clients that are connected and idle.
    let idle: Vec<_> = (0..2).map(|_| SampleStream::connect(&robot, settings(), TIMEOUT).unwrap()).collect();
    let connect = || FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();
    let mut clients: Vec<_> = (0..24).map(|_| connect()).collect();
    let mut reader = SampleStream::connect(&robot, settings(), TIMEOUT).unwrap();
    go.send(()).unwrap();
    assert!(read_until(&mut reader, TOTAL, || ()).is_empty());

    // A late read gets the latest value, not the first.
    for client in &mut clients {
        wait_for("the last value", || client.latest().unwrap().is_some_and(|value| value.message.sequence == TOTAL));
    }
    drop(idle);
    let served = daemon.stop();
    assert_eq!((served.published, served.feed_forward, served.unsent_batches), (TOTAL, TOTAL, 0));
    assert_eq!(served.trouble, None);
}

#[test]
fn a_feed_forward_value_becomes_stale_and_the_end_of_the_daemon_is_detected() {
    let robot = robot("stale");
    let (value, values) = mpsc::channel::<FeedForwardMessage>();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        while !stop.load(Ordering::Relaxed) {
            if let Ok(message) = values.recv_timeout(Duration::from_millis(5)) {
                server.feed_forward(message);
            }
        }
        server.epoch()
    });
    // An hour: independent of the speed of the test machine.
    let hour = FeedForwardSettings { stale_after_ms: 3_600_000 };
    let mut client = FeedForwardClient::connect(&robot, hour, TIMEOUT).unwrap();
    let mut strict = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), TIMEOUT).unwrap();
    assert_eq!(client.latest().unwrap(), None);
    assert_eq!(client.daemon(), Presence::Running);

    for cycle in 1..=100 {
        let sent = FeedForwardMessage::new(&record(cycle), 7, [0.0, 9.81, 0.0], [0.0, 0.0, -9.81]);
        value.send(sent).unwrap();
        wait_for("the value", || client.latest().unwrap().is_some_and(|seen| seen.message.sequence == cycle));
        let seen = client.latest().unwrap().unwrap();
        let FeedForwardMessage { sequence, epoch, clock, .. } = seen.message;
        assert_eq!(seen.message, FeedForwardMessage { sequence, epoch, clock, ..sent });
        assert!(!seen.stale && seen.usable);
    }
    std::thread::sleep(Duration::from_millis(6));
    let old = strict.latest().unwrap().unwrap();
    assert!(old.stale && !old.usable && old.age_ns > 5_000_000);
    assert_eq!(old.message.sequence, 100);

    let last = client.latest().unwrap().unwrap();
    assert_eq!(daemon.stop(), last.message.epoch);
    assert_eq!(client.daemon(), Presence::Gone);

    // Values of the next daemon arrive without a reconnect.
    let next = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        server.feed_forward(FeedForwardMessage::new(&record(1), 7, [0.0; 3], [0.0; 3]));
        poll_until(server, stop);
        server.epoch()
    });
    wait_for("the next daemon", || {
        client.latest().unwrap().is_some_and(|seen| seen.message.epoch != last.message.epoch)
    });
    let first = client.latest().unwrap().unwrap().message;
    assert_eq!((first.sequence, first.epoch), (1, next.stop()));
    assert_eq!(client.rejected(), 0);
}

#[test]
fn requests_get_responses_and_malformed_ones_are_refused() {
    let robot = robot("commands");
    let model = "# rho \u{3c1}\n".repeat(60_000);
    let expected = model.clone();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let mut quit = false;
        while !(quit && stop.load(Ordering::Relaxed)) {
            server.poll(|request, served| match request {
                Request::Status {} => {
                    Response::Status(Box::new(Status { cycles: 5, served: served.clone(), ..Status::default() }))
                }
                Request::OfferModel { toml } if toml == expected => Response::ModelAccepted { model: 77 },
                Request::OfferModel { toml } => {
                    Response::Refused { reason: format!("{} bytes of another model", toml.len()) }
                }
                // Longer than the maximum response.
                Request::Resume {} => Response::Refused { reason: "x".repeat(1 << 20) },
                Request::Start {}
                | Request::Stop {}
                | Request::Pause {}
                | Request::Adopt {}
                | Request::Reject {}
                | Request::Record {} => Response::Accepted {},
                Request::ProposeModel { .. } | Request::Doubt { .. } => {
                    Response::Refused { reason: "not expected".into() }
                }
                Request::Quit {} => {
                    quit = true;
                    Response::Accepted {}
                }
            });
            std::thread::sleep(Duration::from_micros(200));
        }
        server.served()
    });
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    assert_eq!(client.send(&Request::Stop {}, TIMEOUT).unwrap(), Response::Accepted {});
    let offer = |toml: String| Request::OfferModel { toml };
    assert_eq!(client.send(&offer(model), TIMEOUT).unwrap(), Response::ModelAccepted { model: 77 });
    let refused = Response::Refused { reason: "3 bytes of another model".into() };
    assert_eq!(client.send(&offer("a=1".into()), TIMEOUT).unwrap(), refused);
    let error = client.send(&offer("x".repeat(MAX_REQUEST_BYTES)), TIMEOUT).unwrap_err();
    assert!(matches!(error, IpcError::TooLong { .. }), "{error}");
    let Response::Refused { reason } = client.send(&Request::Resume {}, TIMEOUT).unwrap() else { panic!() };
    assert!(reason.contains("the limit is"), "{reason}");

    // Random bytes of all lengths from several clients.
    let mut others: Vec<_> = (0..4).map(|_| Client::connect(&robot, TIMEOUT).unwrap()).collect();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    for round in 0..200 {
        let mut bytes = vec![0; random.random_range(1..5000)];
        random.fill_bytes(&mut bytes);
        let answer = others[round % 4].send_bytes(&bytes, TIMEOUT).unwrap();
        assert!(matches!(answer, Response::Refused { .. }), "{answer:?}");
    }
    let huge = vec![b'['; MAX_REQUEST_BYTES + 1];
    assert!(matches!(client.send_bytes(&huge, TIMEOUT).unwrap(), Response::Refused { .. }));
    let Response::Status(status) = client.send(&Request::Status {}, TIMEOUT).unwrap() else { panic!() };
    assert_eq!((status.cycles, status.served.garbled_requests), (5, 201));

    assert_eq!(client.send(&Request::Quit {}, TIMEOUT).unwrap(), Response::Accepted {});
    assert_eq!(daemon.stop().trouble, None);
    let error = client.send(&Request::Status {}, Duration::from_millis(20)).unwrap_err();
    assert!(matches!(error, IpcError::NoDaemon { .. }), "{error}");
}

#[test]
fn a_request_bound_to_another_epoch_is_refused() {
    let robot = robot("bound");
    let daemon = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        let mut started = 0;
        while !stop.load(Ordering::Relaxed) {
            server.poll(|request, served| match request {
                Request::Status {} => {
                    Response::Status(Box::new(Status { served: served.clone(), ..Status::default() }))
                }
                _ => {
                    started += 1;
                    Response::Accepted {}
                }
            });
            std::thread::sleep(Duration::from_millis(1));
        }
        started
    });
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    let Response::Status(status) = client.send(&Request::Status {}, TIMEOUT).unwrap() else { panic!() };
    client.bind(status.served.epoch);
    assert_eq!(client.send(&Request::Start {}, TIMEOUT).unwrap(), Response::Accepted {});
    client.bind(status.served.epoch + 1);
    // Light and heavy.
    for request in [Request::Start {}, Request::OfferModel { toml: "x".repeat(20_000) }] {
        let Response::Refused { reason } = client.send(&request, TIMEOUT).unwrap() else { panic!() };
        assert!(reason.contains(&format!("this is start {}", status.served.epoch)), "{reason}");
    }
    assert_eq!(daemon.stop(), 1);
}

#[test]
fn no_daemon_a_busy_daemon_and_a_second_daemon_are_different_errors() {
    let robot = robot("absent");
    let absent = [
        Client::connect(&robot, Duration::ZERO).err().unwrap(),
        SampleStream::connect(&robot, settings(), Duration::ZERO).err().unwrap(),
        FeedForwardClient::connect(&robot, FeedForwardSettings::default(), Duration::from_millis(20)).err().unwrap(),
    ];
    for error in absent {
        assert!(matches!(error, IpcError::NoDaemon { .. }), "{error}");
    }

    let directory = tempfile::tempdir().unwrap();
    let _lock = Lock::take_in(directory.path(), &robot).unwrap();
    assert!(Lock::take_in(directory.path(), &robot).is_err());

    // Without the lock, shared memory refuses a second daemon. This daemon runs but never responds.
    let busy = Daemon::start(&robot, ServerSettings::default(), |_, stop| {
        wait_for("the end of the test", || stop.load(Ordering::Relaxed));
    });
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    for _ in 0..5 {
        let error = client.send(&Request::Status {}, Duration::from_millis(20)).unwrap_err();
        assert!(matches!(error, IpcError::NoAnswer { .. }), "{error}");
    }
    let hasty = StreamSettings { response_timeout: Duration::from_millis(20), heartbeat: Duration::ZERO, ..settings() };
    let mut stream = SampleStream::connect(&robot, hasty, TIMEOUT).unwrap();
    for _ in 0..5 {
        assert_eq!(stream.next(Duration::from_millis(40)).unwrap(), Delivery::Idle);
    }
    let error = Server::open(&robot, ServerSettings::default()).err().unwrap();
    assert!(matches!(error, IpcError::Full { .. }), "{error}");
    busy.stop();
    wait_for("the end of the daemon", || stream.next(Duration::from_millis(1)).unwrap() == Delivery::Gone);
}
