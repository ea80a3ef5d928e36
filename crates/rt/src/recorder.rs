//! Where records go: a lock-free ring to the bridge thread, and a flight recorder of the last cycles.

use plumbline_core::{Record, Sink};
use rtrb::{Consumer, Producer, RingBuffer};

/// A ring for `capacity` records: the loop's end and the bridge thread's end.
pub fn ring(capacity: usize) -> (RingSink, Drain) {
    let (producer, consumer) = RingBuffer::new(capacity.max(1));
    (RingSink { producer }, Drain { consumer })
}

/// The loop's end of a record ring. A full ring loses the newest record; the loop counts it.
pub struct RingSink {
    producer: Producer<Record>,
}

impl Sink for RingSink {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn put(&mut self, record: &Record) -> bool {
        self.producer.push(*record).is_ok()
    }
}

/// The bridge thread's end of a record ring.
pub struct Drain {
    consumer: Consumer<Record>,
}

impl Drain {
    /// The oldest record that has not been taken.
    pub fn pop(&mut self) -> Option<Record> {
        self.consumer.pop().ok()
    }

    /// Appends up to `most` records to `out`, oldest first; the number appended.
    pub fn take_into(&mut self, out: &mut Vec<Record>, most: usize) -> usize {
        let count = self.consumer.slots().min(most);
        out.extend((0..count).map_while(|_| self.consumer.pop().ok()));
        count
    }

    /// Records waiting.
    pub fn waiting(&self) -> usize {
        self.consumer.slots()
    }

    /// Whether the loop's end was dropped: no more records follow.
    pub fn is_over(&self) -> bool {
        self.consumer.is_abandoned() && self.consumer.is_empty()
    }
}

/// The last cycles before the end, kept whatever happens to the sink; it travels with the loop's outcome.
pub(super) struct Flight {
    records: Vec<Record>,
    next: usize,
}

impl Flight {
    /// Room for `depth` records, allocated here.
    pub fn new(depth: usize) -> Flight {
        Flight { records: Vec::with_capacity(depth.max(1)), next: 0 }
    }

    /// Replaces the oldest record.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn keep(&mut self, record: &Record) {
        if self.records.len() < self.records.capacity() {
            self.records.push(*record);
        } else if let Some(slot) = self.records.get_mut(self.next) {
            *slot = *record;
            self.next = (self.next + 1) % self.records.len();
        }
    }

    /// The kept records, oldest first.
    pub fn in_order(&self) -> Vec<Record> {
        let (newer, older) = self.records.split_at(self.next.min(self.records.len()));
        older.iter().chain(newer).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cycle: u64) -> Record {
        Record { cycle, ..Record::default() }
    }

    #[test]
    fn a_full_ring_refuses_and_keeps_the_order() {
        let (mut sink, mut drain) = ring(3);
        let kept: Vec<bool> = (0..5).map(|k| sink.put(&record(k))).collect();
        assert_eq!(kept, [true, true, true, false, false]);
        let mut out = Vec::new();
        assert_eq!(drain.take_into(&mut out, 2), 2);
        assert!(!drain.is_over());
        drop(sink);
        assert_eq!(drain.take_into(&mut out, 9), 1);
        assert_eq!(out.iter().map(|r| r.cycle).collect::<Vec<_>>(), [0, 1, 2]);
        assert!(drain.is_over());
    }

    #[test]
    fn the_flight_recorder_keeps_the_last_cycles_in_order() {
        for (count, expected) in [(2, vec![0, 1]), (4, vec![0, 1, 2, 3]), (11, vec![7, 8, 9, 10])] {
            let mut flight = Flight::new(4);
            (0..count).for_each(|k| flight.keep(&record(k)));
            assert_eq!(flight.in_order().iter().map(|r| r.cycle).collect::<Vec<_>>(), expected);
        }
    }
}
