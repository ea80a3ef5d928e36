//! Log of retained records for replay to slow, late or restarted followers.

use std::collections::VecDeque;

use super::messages::SampleMessage;

/// Records per block of memory (680 KiB).
const BLOCK_RECORDS: usize = 1024;

/// Log of the newest records in order of `seq`, in reused blocks.
///
/// At its bound the oldest block is discarded; [`RetainedLog::first`] is the start of the log.
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
        RetainedLog {
            blocks: VecDeque::new(),
            max_blocks: max_records.div_ceil(BLOCK_RECORDS).max(1) + 1,
            first: 0,
            end: 0,
        }
    }

    /// Sequence number of the oldest retained record; records `0..first` are discarded.
    pub fn first(&self) -> u64 {
        self.first
    }

    /// Sequence number of the next record.
    pub fn end(&self) -> u64 {
        self.end
    }

    /// Appends one record, whose sequence number must be [`RetainedLog::end`].
    ///
    /// # Panics
    /// For another sequence number.
    pub fn push(&mut self, sample: SampleMessage) {
        assert_eq!(sample.seq, self.end, "records are appended in order");
        if self.blocks.back().is_none_or(|block| block.len() == BLOCK_RECORDS) {
            let block = self.next_block();
            self.blocks.push_back(block);
        }
        if let Some(block) = self.blocks.back_mut() {
            block.push(sample);
        }
        self.end += 1;
    }

    /// Record number `seq`; `None` when it is discarded or not yet appended.
    pub fn get(&self, seq: u64) -> Option<&SampleMessage> {
        let index = usize::try_from(seq.checked_sub(self.first)?).ok()?;
        self.blocks.get(index / BLOCK_RECORDS)?.get(index % BLOCK_RECORDS)
    }

    /// A new block, or the oldest one cleared.
    fn next_block(&mut self) -> Vec<SampleMessage> {
        if self.blocks.len() < self.max_blocks {
            return Vec::with_capacity(BLOCK_RECORDS);
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
    fn the_newest_records_are_retained_from_first_on() {
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
    fn a_gap_panics() {
        RetainedLog::new(10).push(sample(1));
    }
}
