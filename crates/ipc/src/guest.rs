//! States of an arm that another program controls: published by its controller, received by the daemon.

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::error::IpcError;
use super::messages::{GuestMessage, LAYOUT};
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

/// Receiver of the states of one arm. Not `Send`.
pub struct GuestReceiver {
    epoch: u64,
    next: u64,
    lost: u64,
    rejected: u64,
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
        Ok(GuestReceiver { epoch: 0, next: 0, lost: 0, rejected: 0, subscriber, service, node })
    }

    /// All that has arrived since the last call. A publisher's numbers start at 0: what it sent before this receiver opened is reported as
    /// lost, too.
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
        let is_late = sample.epoch == self.epoch && sample.seq < self.next;
        if sample.check().is_err() || sample.epoch < self.epoch || is_late {
            self.rejected += 1;
            return;
        }
        if sample.epoch != self.epoch {
            (self.epoch, self.next) = (sample.epoch, 0);
            deliveries.push(GuestDelivery::Started { epoch: sample.epoch });
        }
        if sample.seq > self.next {
            self.lost += sample.seq - self.next;
            deliveries.push(GuestDelivery::Lost { from: self.next, to: sample.seq });
        }
        self.next = sample.seq.saturating_add(1);
        match deliveries.last_mut() {
            Some(GuestDelivery::Samples(samples)) => samples.push(*sample),
            _ => deliveries.push(GuestDelivery::Samples(vec![*sample])),
        }
    }

    /// Samples lost so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Samples rejected so far: of another layout, with a number that is not finite, or out of order.
    pub fn rejected(&self) -> u64 {
        self.rejected
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
