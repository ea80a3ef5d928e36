//! Queue of requests: heavy ones wait without delaying the others, and every response reaches its own client.

use std::sync::atomic::Ordering;
use std::sync::mpsc;
use std::thread;
use std::time::Duration;

use plumbline_ipc::{Client, IncomingRequest, IpcError, Response, ServerSettings};
use plumbline_testkit::memory::*;

/// Length from which a request is heavy whatever it contains \[bytes\].
const HEAVY: usize = 4097;

#[test]
fn heavy_requests_wait_for_room_delay_no_light_one_and_get_their_own_responses() {
    let robot = robot("heavy");
    let (full, is_full) = mpsc::channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let (mut held, mut light, mut most) = (Vec::new(), 0, 0);
        while !stop.load(Ordering::Relaxed) {
            server.serve(2 - held.len(), |asked, _| match asked {
                IncomingRequest::Light(_) => {
                    light += 1;
                    Some(Response::Accepted {})
                }
                IncomingRequest::Heavy(ticket, bytes) => {
                    held.push((ticket, bytes.len() as u64));
                    None
                }
            });
            if held.len() == 2 && most < 2 {
                full.send(()).unwrap();
            }
            most = most.max(held.len());
            // The youngest first, once a light request has passed the one that waits.
            if light > 0
                && let Some((ticket, model)) = held.pop()
            {
                server.answer(ticket, None, &Response::ModelAccepted { model });
            }
            thread::sleep(Duration::from_millis(1));
        }
        (light, most)
    });
    let mut operator = Client::connect(&robot, TIMEOUT).unwrap();
    thread::scope(|scope| {
        for length in HEAVY..HEAVY + 3 {
            let robot = &robot;
            scope.spawn(move || {
                let mut client = Client::connect(robot, TIMEOUT).unwrap();
                let response = client.send_bytes(&vec![b'x'; length], TIMEOUT).unwrap();
                assert_eq!(response, Response::ModelAccepted { model: length as u64 });
            });
        }
        is_full.recv().unwrap();
        // The third is queued by then; a later one only makes it easier.
        thread::sleep(Duration::from_millis(100));
        let stop = plumbline_ipc::Request::Stop {};
        assert_eq!(operator.send(&stop, TIMEOUT).unwrap(), Response::Accepted {});
    });
    assert_eq!(daemon.stop(), (1, 2));
}

#[test]
fn a_heavy_request_of_a_client_that_has_left_is_dropped() {
    let robot = robot("left");
    let (go, may_start) = mpsc::channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let (mut lengths, mut room) = (Vec::new(), 0);
        while !stop.load(Ordering::Relaxed) {
            room += may_start.try_iter().count();
            server.serve(room, |asked, _| match asked {
                IncomingRequest::Light(_) => Some(Response::Accepted {}),
                IncomingRequest::Heavy(_, bytes) => {
                    lengths.push(bytes.len());
                    Some(Response::Accepted {})
                }
            });
            thread::sleep(Duration::from_millis(1));
        }
        lengths
    });
    let mut leaving = Client::connect(&robot, TIMEOUT).unwrap();
    let mut staying = Client::connect(&robot, TIMEOUT).unwrap();
    let error = leaving.send_bytes(&[b'x'; HEAVY], Duration::from_millis(20)).unwrap_err();
    assert!(matches!(error, IpcError::NoAnswer { .. }), "{error}");
    drop(leaving);
    go.send(()).unwrap();
    assert_eq!(staying.send_bytes(&[b'x'; HEAVY + 1], TIMEOUT).unwrap(), Response::Accepted {});
    assert_eq!(daemon.stop(), [HEAVY + 1]);
}

#[test]
fn a_request_is_heavy_by_its_length_from_4097_bytes_on() {
    let robot = robot("length");
    let daemon = Daemon::start(&robot, ServerSettings::default(), |server, stop| {
        while !stop.load(Ordering::Relaxed) {
            server.serve(1, |asked, _| {
                let model = u64::from(matches!(asked, IncomingRequest::Heavy(..)));
                Some(Response::ModelAccepted { model })
            });
            thread::sleep(Duration::from_millis(1));
        }
    });
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    for (length, model) in [(20, 0), (2049, 0), (HEAVY - 1, 0), (HEAVY, 1)] {
        let mut request = br#"{"request":"stop"}"#.to_vec();
        request.resize(length, b' ');
        assert_eq!(client.send_bytes(&request, TIMEOUT).unwrap(), Response::ModelAccepted { model }, "{length}");
    }
    daemon.stop();
}

#[test]
fn once_half_a_millisecond_has_passed_the_remaining_requests_wait_for_the_next_turn() {
    let robot = robot("budget");
    let (go, may_start) = mpsc::channel();
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        may_start.recv().unwrap();
        let mut most = 0;
        while !stop.load(Ordering::Relaxed) {
            let handled = server.serve(0, |_, _| {
                thread::sleep(Duration::from_micros(600));
                Some(Response::Accepted {})
            });
            most = most.max(handled);
        }
        most
    });
    thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                let mut client = Client::connect(&robot, TIMEOUT).unwrap();
                let stop = plumbline_ipc::Request::Stop {};
                assert_eq!(client.send(&stop, TIMEOUT).unwrap(), Response::Accepted {});
            });
        }
        // All are queued by then; later ones only make it easier.
        thread::sleep(Duration::from_millis(50));
        go.send(()).unwrap();
    });
    assert_eq!(daemon.stop(), 1);
}
