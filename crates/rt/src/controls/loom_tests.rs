//! Under every order in which two or three threads can see the atomics: `hil/loom/run.sh`.

use super::Controls;
use loom::sync::Arc;
use loom::sync::atomic::{AtomicU32, Ordering};
use loom::thread;
use plumbline_core::Phase;

/// Every order in which the threads of `body` can run.
fn always(body: impl Fn(&Arc<Controls>) + Sync + Send + 'static) {
    loom::model(move || body(&Arc::new(Controls::default())));
}

#[test]
fn a_stop_is_taken_exactly_once_and_never_lost() {
    always(|controls| {
        let outside = controls.clone();
        let operator = thread::spawn(move || outside.stop());
        let mut taken = u32::from(controls.take_stop()) + u32::from(controls.take_stop());
        operator.join().unwrap();
        taken += u32::from(controls.take_stop());
        assert_eq!(taken, 1);
        assert!(!controls.take_stop());
    });
}

#[test]
fn writes_before_a_stop_or_quit_are_visible_with_it() {
    always(|controls| {
        let reason = Arc::new(AtomicU32::new(0));
        let (outside, written) = (controls.clone(), reason.clone());
        let operator = thread::spawn(move || {
            written.store(7, Ordering::Relaxed);
            outside.stop();
            outside.quit();
        });
        if controls.wants_quit() {
            assert!(controls.take_stop(), "the stop came before the quit");
        }
        if controls.take_stop() {
            assert_eq!(reason.load(Ordering::Relaxed), 7);
        }
        operator.join().unwrap();
    });
}

#[test]
fn one_rest_gives_one_permission_to_any_number_of_operators() {
    always(|controls| {
        let before = controls.permission();
        controls.wait_for_permission();
        let operators: Vec<_> = (0..2)
            .map(|_| {
                let outside = controls.clone();
                thread::spawn(move || outside.resume())
            })
            .collect();
        let granted = operators.into_iter().map(|operator| operator.join().unwrap()).filter(|&granted| granted).count();
        assert_eq!(granted, 1);
        assert_eq!(controls.permission(), before + 1);
        assert!(!controls.is_waiting() && !controls.resume());
    });
}

#[test]
fn no_permission_before_the_rest() {
    always(|controls| {
        let outside = controls.clone();
        let operator = thread::spawn(move || outside.resume());
        // The loop brakes; then it rests.
        let before = controls.permission();
        assert_eq!(before, 0, "granted while the arm still moved");
        controls.wait_for_permission();
        let granted = operator.join().unwrap();
        assert_eq!(controls.permission(), u32::from(granted));
        assert_eq!(controls.is_waiting(), !granted);
    });
}

#[test]
fn an_order_given_after_a_permission_carries_it_and_one_given_before_does_not() {
    always(|controls| {
        let old = controls.permission();
        controls.wait_for_permission();
        let outside = controls.clone();
        // As `Orders::give` does: the permission is read when the order is given.
        let operator = thread::spawn(move || {
            let early = outside.permission();
            let granted = outside.resume();
            (early, granted, outside.permission())
        });
        // The loop sees the permission at some time, never half of it and never taken back.
        let (first, second) = (controls.permission(), controls.permission());
        assert!(first <= second && second <= old + 1);
        let (early, granted, late) = operator.join().unwrap();
        assert!(granted);
        // By the loop's rule an order runs only under the permission that it knows.
        assert_eq!((early, late, controls.permission()), (old, old + 1, old + 1));
    });
}

#[test]
fn the_published_state_is_always_one_of_the_loop() {
    always(|controls| {
        let outside = controls.clone();
        let looker = thread::spawn(move || (outside.phase(), outside.cycles(), outside.lost()));
        controls.show(Phase::Excite, 10, 1, 2, 3);
        let (phase, cycles, lost) = looker.join().unwrap();
        assert!(matches!(phase, Phase::Hold | Phase::Excite));
        assert!([0, 10].contains(&cycles) && [0, 1].contains(&lost));
        assert_eq!((controls.late(), controls.dropped_records()), (2, 3));
    });
}
