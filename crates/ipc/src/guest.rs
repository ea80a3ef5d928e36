//! States of an arm that another program controls: published by its controller, received by the daemon.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use serde::{Deserialize, Serialize};

use super::error::IpcError;
use super::messages::{GuestMessage, LAYOUT, MessageError};
use super::robot::RobotId;
use super::services::{self, MAX_BATCH_RECORDS, SERVER_TIMEOUT, ServiceNode, retry_until, transport};

/// Publisher of the states of one arm. Not `Send`. No call is for a real-time thread: sending allocates and maps memory.
pub struct GuestPublisher {
    epoch: u64,
    publisher: Publisher<ipc::Service, [GuestMessage], ()>,
    _service: services::Guest,
    _node: ServiceNode,
}

impl GuestPublisher {
    /// Opens the service of `robot` after cleaning up the resources of killed processes. Needs no daemon.
    ///
    /// # Errors
    /// [`IpcError::Full`] when another process publishes for this arm, [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn open(robot: &RobotId) -> Result<GuestPublisher, IpcError> {
        let node = services::joining_node()?;
        node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
        let service = services::open_guest(&node, robot)?;
        let publisher = retry_until(&services::guest_name(robot), SERVER_TIMEOUT, || {
            let builder = service.publisher_builder().initial_max_slice_len(MAX_BATCH_RECORDS);
            Ok(builder.max_loaned_samples(1).backpressure_strategy(BackpressureStrategy::DiscardData).create())
        })?;
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let epoch = since.map_or(1, |since| since.as_nanos() as u64).max(1);
        Ok(GuestPublisher { epoch, publisher, _service: service, _node: node })
    }

    /// Sends samples with this publisher's epoch. A receiver without room for them loses them.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed.
    pub fn send(&mut self, samples: &[GuestMessage]) -> Result<(), IpcError> {
        for batch in samples.chunks(MAX_BATCH_RECORDS) {
            let failed = |error: String| transport("sending to", "guest", error);
            let memory = self.publisher.loan_slice_uninit(batch.len()).map_err(|error| failed(error.to_string()))?;
            let filled = memory.write_from_fn(|i| GuestMessage { layout: LAYOUT, epoch: self.epoch, ..batch[i] });
            filled.send().map_err(|error| failed(error.to_string()))?;
        }
        Ok(())
    }
}

/// What a [`GuestReceiver`] has received.
#[derive(Clone, Debug, PartialEq)]
pub enum GuestDelivery {
    /// Samples in the order of their numbers.
    Samples(Vec<GuestMessage>),
    /// Samples `from..to` were lost: the publisher had no room for them, or this receiver read too late.
    Lost {
        /// First number.
        from: u64,
        /// Number of the next sample.
        to: u64,
    },
    /// Another publisher, or the same program started anew: numbers start again.
    Started {
        /// Its epoch.
        epoch: u64,
    },
}

/// Counters of the states of an arm that another program controls. The receiver fills the first six, the daemon the others.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GuestCounts {
    /// States received in the order of their numbers.
    pub received: u64,
    /// Numbers that were missing at the receiver.
    pub lost: u64,
    /// States received a second time in a row, not used.
    pub doubled: u64,
    /// States older than the last one, or of an earlier publisher; not used. Their numbers were counted as lost before.
    pub out_of_order: u64,
    /// States with a number that is not finite, not used.
    pub not_finite: u64,
    /// States of another layout, or with a number of joints that no arm has; not used.
    pub malformed: u64,
    /// Received states with another number of joints than the robot, not used.
    pub other_joints: u64,
    /// Received states of a publisher whose rate is not that of the job, not used.
    pub other_rate: u64,
    /// States published more than half a period after they were due.
    pub late: u64,
    /// Interruptions of more than 20 ms between two states of one publisher: a run is divided there.
    pub pauses: u64,
    /// Publishers that have started.
    pub publishers: u64,
}

/// Receiver of the states of one arm. Not `Send`.
pub struct GuestReceiver {
    epoch: u64,
    next: u64,
    counts: GuestCounts,
    subscriber: Subscriber<ipc::Service, [GuestMessage], ()>,
    service: services::Guest,
    node: ServiceNode,
}

impl GuestReceiver {
    /// Opens the service of `robot`. Needs no publisher.
    ///
    /// # Errors
    /// [`IpcError::Full`] when another process receives, [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn open(robot: &RobotId) -> Result<GuestReceiver, IpcError> {
        let node = services::serving_node()?;
        node.blocking_cleanup_dead_nodes(Duration::from_secs(1));
        let service = services::open_guest(&node, robot)?;
        let subscriber =
            retry_until(&services::guest_name(robot), SERVER_TIMEOUT, || Ok(service.subscriber_builder().create()))?;
        Ok(GuestReceiver { epoch: 0, next: 0, counts: GuestCounts::default(), subscriber, service, node })
    }

    /// All that has arrived since the last call. Numbers are counted from the first sample that this receiver gets; those of a publisher that
    /// starts later, from 0.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed.
    pub fn receive(&mut self) -> Result<Vec<GuestDelivery>, IpcError> {
        let mut deliveries = Vec::new();
        while let Some(batch) = self.subscriber.receive().map_err(|error| transport("reading", "guest", error))? {
            batch.payload().iter().for_each(|sample| self.take(sample, &mut deliveries));
        }
        Ok(deliveries)
    }

    fn take(&mut self, sample: &GuestMessage, deliveries: &mut Vec<GuestDelivery>) {
        if matches!(sample.check(), Err(error) if !matches!(error, MessageError::NotFinite { .. })) {
            self.counts.malformed += 1;
            return;
        }
        let is_same = sample.epoch == self.epoch;
        if sample.epoch < self.epoch || (is_same && sample.seq < self.next) {
            let doubled = is_same && sample.seq + 1 == self.next;
            *(if doubled { &mut self.counts.doubled } else { &mut self.counts.out_of_order }) += 1;
            return;
        }
        if !is_same {
            // What was sent before this receiver opened is no loss.
            let first = if self.epoch == 0 { sample.seq } else { 0 };
            (self.epoch, self.next) = (sample.epoch, first);
            self.counts.publishers += 1;
            deliveries.push(GuestDelivery::Started { epoch: sample.epoch });
        }
        if sample.seq > self.next {
            self.counts.lost += sample.seq - self.next;
            deliveries.push(GuestDelivery::Lost { from: self.next, to: sample.seq });
        }
        self.next = sample.seq.saturating_add(1);
        if sample.check().is_err() {
            self.counts.not_finite += 1;
            return;
        }
        self.counts.received += 1;
        match deliveries.last_mut() {
            Some(GuestDelivery::Samples(samples)) => samples.push(*sample),
            _ => deliveries.push(GuestDelivery::Samples(vec![*sample])),
        }
    }

    /// Samples lost so far.
    pub fn lost(&self) -> u64 {
        self.counts.lost
    }

    /// Samples rejected so far: malformed, with a number that is not finite, doubled or out of order.
    pub fn rejected(&self) -> u64 {
        let GuestCounts { doubled, out_of_order, not_finite, malformed, .. } = self.counts;
        doubled + out_of_order + not_finite + malformed
    }

    /// Counters by name.
    pub fn counts(&self) -> &GuestCounts {
        &self.counts
    }

    /// Whether a publisher's process runs. Reads files.
    pub fn is_published(&self) -> bool {
        let mut running = false;
        self.service.dynamic_config().list_publishers(|details| {
            running |= services::runs(&self.node, details.node_id);
            CallbackProgression::Continue
        });
        running
    }
}
