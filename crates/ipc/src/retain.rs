//! What the daemon keeps of its records, so that an estimator that was slow, restarted or came late misses nothing.

use std::collections::VecDeque;

use super::messages::SampleMessage;

/// Records per block of memory: 672 KiB.
const BLOCK: usize = 1024;

/// The newest records in order of `seq`, in blocks that are allocated once and used again.
///
/// When the bound is reached, the oldest block is given up: [`RetainedLog::first`] then says where the log begins.
#[derive(Debug)]
pub struct RetainedLog {
    blocks: VecDeque<Vec<SampleMessage>>,
    max_blocks: usize,
    first: u64,
    end: u64,
}

impl RetainedLog {
    /// An empty log for at least `max_records` records, rounded up to whole blocks of 1024 and at least two of them.
    pub fn new(max_records: usize) -> RetainedLog {
        RetainedLog { blocks: VecDeque::new(), max_blocks: max_records.div_ceil(BLOCK).max(1) + 1, first: 0, end: 0 }
    }

    /// Number of the oldest record held; records `0..first` have been given up.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// Number that the next record will get.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Keeps one record, whose number must be [`RetainedLog::end`].
    ///
    /// # Panics
    /// When the number is another one: the log would no longer be in order.
    pub fn push(&mut self, sample: SampleMessage) {
        assert_eq!(sample.seq, self.end, "records are kept in order");
        if self.blocks.back().is_none_or(|block| block.len() == BLOCK) {
            let block = self.next_block();
            self.blocks.push_back(block);
        }
        if let Some(block) = self.blocks.back_mut() {
            block.push(sample);
        }
        self.end += 1;
    }

    /// Record number `seq`, while it is held.
    pub fn get(&self, seq: u64) -> Option<&SampleMessage> {
        let index = usize::try_from(seq.checked_sub(self.first)?).ok()?;
        self.blocks.get(index / BLOCK)?.get(index % BLOCK)
    }

    /// A fresh block, or the oldest one emptied.
    fn next_block(&mut self) -> Vec<SampleMessage> {
        if self.blocks.len() < self.max_blocks {
            return Vec::with_capacity(BLOCK);
        }
        let mut oldest = self.blocks.pop_front().unwrap_or_default();
        self.first += oldest.len() as u64;
        oldest.clear();
        oldest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(seq: u64) -> SampleMessage {
        SampleMessage { seq, cycle: seq * 3, ..SampleMessage::default() }
    }

    #[test]
    fn keeps_the_newest_and_says_where_it_begins() {
        let mut log = RetainedLog::new(3000);
        assert!(log.get(0).is_none());
        for seq in 0..10_000 {
            log.push(sample(seq));
            assert_eq!(log.end(), seq + 1);
            assert!(log.end() - log.first() >= (seq + 1).min(3000));
            assert!(log.end() - log.first() <= 4096);
        }
        assert!(log.first() > 0);
        assert!(log.get(log.first() - 1).is_none());
        assert!(log.get(log.end()).is_none());
        assert!(log.get(u64::MAX).is_none());
        for seq in log.first()..log.end() {
            assert_eq!(log.get(seq), Some(&sample(seq)));
        }
    }

    #[test]
    #[should_panic(expected = "in order")]
    fn refuses_a_gap() {
        RetainedLog::new(10).push(sample(1));
    }
}
