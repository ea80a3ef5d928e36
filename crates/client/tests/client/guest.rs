//! States of a controller, published and received.

use crate::models::assert_no_allocation;
use plumbline_client::{Error, Fault, Guest};
use plumbline_ipc::{GuestDelivery, GuestReceiver};
use plumbline_testkit::memory::*;
use std::time::Duration;

#[test]
fn states_arrive_in_order_and_lost_ones_are_counted_on_both_sides() {
    let robot = robot("guest");
    let mut receiver = GuestReceiver::open(&robot).unwrap();
    let mut guest = Guest::open(robot.as_str(), 7).unwrap();
    assert!(receiver.is_published());
    let state = |k: u32| [f64::from(k); 7];
    let mut samples = Vec::new();
    let mut started = 0;
    let mut receive = |receiver: &mut GuestReceiver, samples: &mut Vec<_>| {
        for delivery in receiver.receive().unwrap() {
            match delivery {
                GuestDelivery::Samples(some) => samples.extend(some),
                GuestDelivery::Started { .. } => started += 1,
                GuestDelivery::Lost { .. } => {}
            }
        }
    };
    let mut published = Ok(());
    for k in 0..500 {
        let q = state(k);
        assert_no_allocation(|| published = guest.publish(&q, &q, &q, &q));
        published.unwrap();
        std::thread::sleep(Duration::from_micros(300));
        receive(&mut receiver, &mut samples);
    }
    wait_for("the last sample", || {
        receive(&mut receiver, &mut samples);
        samples.len() == 500
    });
    for (k, sample) in samples.iter().enumerate() {
        assert_eq!((sample.seq, sample.n), (k as u64, 7));
        let expected: [f64; 8] = std::array::from_fn(|j| if j < 7 { k as f64 } else { 0.0 });
        assert_eq!([sample.q, sample.dq, sample.tau, sample.q_d], [expected; 4]);
    }
    assert!(samples.windows(2).all(|pair| pair[0].stamp_ns < pair[1].stamp_ns));
    assert_eq!((guest.lost(), receiver.lost(), receiver.rejected()), (0, 0, 0));

    // A bad sample is a gap; so is what finds no room.
    let q = state(1);
    let nan = [f64::NAN; 7];
    assert_eq!(guest.publish(&q, &nan, &q, &q), Err(Fault::NotFinite));
    assert_eq!(guest.publish(&q[..6], &q, &q, &q), Err(Fault::Length { expected: 7, found: 6 }));
    let mut lost = 2;
    for _ in 0..100_000 {
        lost += u64::from(guest.publish(&q, &q, &q, &q) == Err(Fault::QueueFull));
    }
    assert!(lost > 2, "the queue was never full");
    wait_for("room", || guest.publish(&q, &q, &q, &q).inspect_err(|_| lost += 1).is_ok());
    wait_for("the gaps", || {
        receive(&mut receiver, &mut samples);
        receiver.lost() >= lost
    });
    assert_eq!(guest.lost(), lost);

    let second = Guest::open(robot.as_str(), 7).err();
    assert_eq!(second, Some(Error::SecondPublisher { robot: robot.to_string() }));
    drop(guest);
    assert!(!receiver.is_published());
    // The next one starts from 0 again.
    samples.clear();
    let mut guest = Guest::open(robot.as_str(), 7).unwrap();
    guest.publish(&q, &q, &q, &q).unwrap();
    wait_for("the next publisher", || {
        receive(&mut receiver, &mut samples);
        samples.last().is_some_and(|sample| sample.seq == 0)
    });
    assert_eq!(started, 2);
    assert!(matches!(Guest::open(robot.as_str(), 9), Err(Error::Input(_))));
}
