//! Watcher of the samples: records as they are published, without a promise that all arrive.

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::error::IpcError;
use super::messages::SampleMessage;
use super::robot::RobotId;
use super::services::{self, ServiceNode, transport};
use plumbline_core::Record;

/// A display of the samples. The daemon does not know it: it is no follower, so neither its absence nor its end is a loss that stops an arm.
/// Records that it reads too late are lost to it. Not `Send`.
pub struct SampleWatcher {
    robot: RobotId,
    // Drop order: port, service, node.
    subscriber: Subscriber<ipc::Service, [SampleMessage], ()>,
    _service: services::Samples,
    _node: ServiceNode,
}

impl SampleWatcher {
    /// Connects to the daemon of `robot`, waiting up to `timeout` for it to appear.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(robot: &RobotId, timeout: Duration) -> Result<SampleWatcher, IpcError> {
        let start = Instant::now();
        let node = services::joining_node()?;
        let service = services::join_samples(&node, robot, timeout)?;
        while service.dynamic_config().number_of_publishers() == 0 {
            if start.elapsed() >= timeout {
                return Err(services::no_daemon(robot, timeout));
            }
            thread::sleep(Duration::from_millis(1));
        }
        let name = services::samples_name(robot);
        let subscriber = services::retry_until(&name, timeout.saturating_sub(start.elapsed()), || {
            Ok(service.subscriber_builder().create())
        })?;
        Ok(SampleWatcher { robot: robot.clone(), subscriber, _service: service, _node: node })
    }

    /// Calls `take` with every record that has arrived since the last call, in order; invalid ones are left out.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed.
    pub fn take(&mut self, mut take: impl FnMut(&Record)) -> Result<(), IpcError> {
        let failed = |error| transport("reading", &services::samples_name(&self.robot), error);
        while let Some(batch) = self.subscriber.receive().map_err(failed)? {
            batch.payload().iter().filter_map(|sample| sample.record().ok()).for_each(|record| take(&record));
        }
        Ok(())
    }
}
