//! A running daemon as its clients see it: status, samples and served model.
//!
//! All that is computed from them is computed in the client's process.

mod exposition;
pub mod watched;

pub use exposition::exposition;
pub use watched::Watched;

use plumbline_ipc::{Client, IpcError, ModelClient, Request, Response, RobotId, SampleWatcher};
use std::time::Duration;

/// Timeout of a response.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(2);
/// Wait for a daemon that does not run, in one call.
const CONNECTION_TIMEOUT: Duration = Duration::from_millis(50);

/// Client of one daemon, reconnected to a daemon that was started again. Not `Send`.
pub struct Monitor {
    id: RobotId,
    client: Option<Client>,
    samples: Option<SampleWatcher>,
    model: Option<ModelClient>,
    pub watched: Watched,
}

impl Monitor {
    /// A monitor of the daemon of `id`; [`Monitor::query`] connects it.
    pub fn new(id: RobotId) -> Monitor {
        Monitor { id, client: None, samples: None, model: None, watched: Watched::default() }
    }

    /// Connects as an operator, waiting up to `timeout` for a daemon.
    ///
    /// # Errors
    /// As [`Client::connect_operator`].
    pub fn connect(&mut self, timeout: Duration) -> Result<(), IpcError> {
        self.client = Some(Client::connect_operator(&self.id, timeout)?);
        Ok(())
    }

    pub fn id(&self) -> &RobotId {
        &self.id
    }

    /// Requests the status, and connects what is not connected; whether the daemon has responded.
    pub fn query(&mut self) -> bool {
        if self.client.is_none() {
            let _ = self.connect(CONNECTION_TIMEOUT);
        }
        let answer = self.send(&Request::Status {});
        let responded = matches!(answer, Some(Ok(Response::Status(_))));
        match answer {
            Some(Ok(Response::Status(status))) => self.watched.status(*status),
            Some(Err(IpcError::NoDaemon { .. })) | None => {
                (self.client, self.samples, self.model) = (None, None, None);
                self.watched.gone();
            }
            Some(Ok(_) | Err(_)) => {}
        }
        if self.client.is_some() && self.samples.is_none() {
            self.samples = SampleWatcher::connect(&self.id, CONNECTION_TIMEOUT).ok();
            self.model = ModelClient::connect(&self.id, CONNECTION_TIMEOUT).ok();
        }
        responded
    }

    /// Takes models and samples that have arrived.
    pub fn read(&mut self) {
        let watched = &mut self.watched;
        if let Some(Ok(Some(message))) = self.model.as_mut().map(ModelClient::receive) {
            watched.model(&message);
        }
        if let Some(samples) = &mut self.samples
            && samples.take(|record| watched.record(record)).is_err()
        {
            self.samples = None;
        }
    }

    /// The response to a request; `None` without a connection.
    pub fn send(&mut self, request: &Request) -> Option<Result<Response, IpcError>> {
        self.client.as_mut().map(|client| client.send(request, RESPONSE_TIMEOUT))
    }
}
