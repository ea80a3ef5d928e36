//! The rings between the loop and the rest of the program, as `plumbline_rt::order` uses them.
//!
//! What goes through them is a [`Thing`]: loom reports whoever touches it without having seen what its maker wrote.

use loom::cell::UnsafeCell;
use loom::thread;
use rtrb::{Consumer, Producer, RingBuffer};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Something that one side makes and the other side uses.
struct Thing {
    number: UnsafeCell<u32>,
    /// Not loom's: it counts, and hands nothing over.
    dropped: Arc<AtomicU32>,
}

impl Thing {
    fn new(number: u32, dropped: &Arc<AtomicU32>) -> Box<Thing> {
        Box::new(Thing { number: UnsafeCell::new(number), dropped: dropped.clone() })
    }

    fn number(&self) -> u32 {
        self.number.with(|number| unsafe { *number })
    }

    /// As the loop uses a model: it keeps state of its own.
    fn work(&self) {
        self.number.with_mut(|number| unsafe { *number += 10 });
    }
}

impl Drop for Thing {
    fn drop(&mut self) {
        self.number.with_mut(|number| unsafe { *number = u32::MAX });
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn records_arrive_whole_and_in_order_and_what_finds_no_room_is_given_back() {
    loom::model(|| {
        let dropped = Arc::new(AtomicU32::new(0));
        let (mut give, mut take) = RingBuffer::new(2);
        let counter = dropped.clone();
        let maker = thread::spawn(move || (1..=3).filter(|&k| give.push(Thing::new(k, &counter)).is_ok()).collect::<Vec<u32>>());
        let mut taken = Vec::new();
        for _ in 0..2 {
            taken.extend(take.pop().ok().map(|thing: Box<Thing>| thing.number()));
        }
        let given = maker.join().unwrap();
        taken.extend(std::iter::from_fn(|| take.pop().ok()).map(|thing| thing.number()));
        assert_eq!(taken, given);
        assert!(given.len() >= 2, "there is room for two");
        assert_eq!(dropped.load(Ordering::Relaxed), 3);
    });
}

/// The loop's end: the model in use, and the two rings.
struct Loop {
    models: Consumer<Box<Thing>>,
    retired: Producer<Box<Thing>>,
    model: Option<Box<Thing>>,
}

impl Loop {
    /// As `Cycle::take_model`, then a cycle's work.
    fn cycle(&mut self) {
        if !self.retired.is_full()
            && let Ok(model) = self.models.pop()
            && let Some(old) = self.model.replace(model)
        {
            assert!(self.retired.push(old).is_ok(), "there was room");
        }
        self.model.iter().for_each(|model| model.work());
    }
}

#[test]
fn a_model_is_swapped_between_two_cycles_and_freed_outside_alone() {
    loom::model(|| {
        let dropped = Arc::new(AtomicU32::new(0));
        let (mut serve, models) = RingBuffer::new(2);
        let (retired, mut done_with) = RingBuffer::new(1);
        let mut own = Loop { models, retired, model: Some(Thing::new(1, &dropped)) };
        let watched = dropped.clone();
        let cycles = thread::spawn(move || {
            own.cycle();
            own.cycle();
            own
        });
        for number in [2, 3] {
            assert!(serve.push(Thing::new(number, &watched)).is_ok());
        }
        let freed: Vec<u32> = std::iter::from_fn(|| done_with.pop().ok()).map(|model: Box<Thing>| model.number() % 10).collect();
        assert_eq!(dropped.load(Ordering::Relaxed) as usize, freed.len(), "freed by somebody else");
        let mut own = cycles.join().unwrap();
        let freed: Vec<u32> = freed.into_iter().chain(done_with.pop().ok().map(|model| model.number() % 10)).collect();
        // One after the other, each exactly once; the newest of those that were taken is in use.
        assert_eq!(freed, [1, 2][..freed.len()]);
        let present = own.model.take().unwrap().number() % 10;
        assert_eq!(present as usize, freed.len() + 1);
        drop((own, serve, done_with));
        assert_eq!(dropped.load(Ordering::Relaxed), 3);
    });
}

#[test]
fn whoever_goes_first_what_is_left_in_a_ring_is_freed_once() {
    loom::model(|| {
        let dropped = Arc::new(AtomicU32::new(0));
        let (mut give, take) = RingBuffer::new(2);
        assert!(give.push(Thing::new(1, &dropped)).is_ok());
        let counter = dropped.clone();
        let maker = thread::spawn(move || {
            assert!(give.push(Thing::new(2, &counter)).is_ok());
            give.is_abandoned()
        });
        drop(take);
        maker.join().unwrap();
        assert_eq!(dropped.load(Ordering::Relaxed), 2);
    });
}
