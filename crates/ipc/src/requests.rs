//! Queue of received requests: clients are served in turn, and heavy requests do not delay the others.

use std::collections::VecDeque;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::identifiers::UniqueClientId;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::server::Server as RequestServer;
use iceoryx2::prelude::*;

use super::command::{self, Envelope, MAX_REQUEST_BYTES, MAX_RESPONSE_BYTES, Request, Response, Served};
use super::services::now_ns;

/// Time budget of one [`Requests::serve`]: no further request is started after it \[ns\].
const TIME_BUDGET_NS: u64 = 500_000;
/// Maximum length of a light request \[bytes\]: a longer one takes too long to parse and counts as heavy.
const MAX_LIGHT_BYTES: usize = 4096;
/// Maximum queued requests. A client has at most two; iceoryx2 keeps up to 128 disconnected clients with queued requests.
const MAX_QUEUED: usize = 64;

type Active = ActiveRequest<ipc::Service, [u8], (), [u8], ()>;
pub(super) type Port = RequestServer<ipc::Service, [u8], (), [u8], ()>;

/// Identifies a heavy request until its response is sent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ticket(u64);

/// Received request.
pub enum IncomingRequest<'a> {
    /// Response expected at once.
    Light(Request),
    /// Bytes of a request that takes long to parse ([`read`]) or to check. The response is sent later, by its ticket.
    Heavy(Ticket, &'a [u8]),
}

/// Parses a request to the daemon of this `epoch`.
///
/// # Errors
/// The response to a request that can't be parsed, or that is bound to another epoch.
pub fn read(bytes: &[u8], epoch: u64) -> Result<Request, Response> {
    let refused = |reason: String| Response::Refused { reason };
    let envelope: Envelope =
        command::decode("request", bytes, MAX_REQUEST_BYTES).map_err(|error| refused(error.to_string()))?;
    match envelope.epoch {
        Some(expected) if expected != epoch => Err(refused(format!(
            "this is start {epoch} of a daemon (process {}), and the request is for start {expected}",
            std::process::id()
        ))),
        _ => Ok(envelope.request),
    }
}

struct PendingRequest {
    ticket: Ticket,
    active: Active,
}

pub(super) struct Requests {
    /// In the order of arrival.
    waiting: VecDeque<PendingRequest>,
    /// Heavy requests in process.
    in_process: Vec<PendingRequest>,
    next: u64,
    // Drop order: requests before their port.
    port: Port,
}

/// Order with a sent response. A status request is not an order.
#[derive(Debug)]
pub(super) struct Order {
    /// Name by [`Request::order`].
    pub name: &'static str,
    /// The client's port.
    pub client: UniqueClientId,
    /// Reason of a refusal.
    pub refused: Option<String>,
}

impl Order {
    fn answered(name: &'static str, active: &Active, response: &Response) -> Order {
        let refused = match response {
            Response::Refused { reason } => Some(reason.clone()),
            _ => None,
        };
        Order { name, client: active.origin(), refused }
    }
}

/// Result of one [`Requests::serve`].
#[derive(Debug, Default)]
pub(super) struct Outcome {
    pub handled: usize,
    pub malformed: u64,
    /// Orders among the requests with a sent response.
    pub orders: Vec<Order>,
    /// Errors of shared memory.
    pub errors: Vec<String>,
}

impl Requests {
    pub(super) fn new(port: Port) -> Requests {
        Requests { waiting: VecDeque::with_capacity(MAX_QUEUED), in_process: Vec::new(), next: 0, port }
    }

    /// Queues the received requests of every client. The port's `receive` starts with the first client each time: served directly, a client that
    /// always has a pending request would starve the others.
    pub(super) fn receive(&mut self) -> Result<(), String> {
        while self.waiting.len() + self.in_process.len() < MAX_QUEUED {
            match self.port.receive() {
                Ok(Some(active)) => {
                    self.next += 1;
                    self.waiting.push_back(PendingRequest { ticket: Ticket(self.next), active });
                }
                // Every client with requests has reached its limit of active ones.
                Ok(None) | Err(ReceiveError::ExceedsMaxBorrows) => break,
                Err(error) => return Err(error.to_string()),
            }
        }
        Ok(())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Responds to queued requests through `answer`, the oldest first, within the time budget. Passes on up to `max_heavy` heavy ones.
    pub(super) fn serve(
        &mut self,
        epoch: u64,
        served: &Served,
        mut max_heavy: usize,
        mut answer: impl FnMut(IncomingRequest, &Served) -> Option<Response>,
    ) -> Outcome {
        let mut outcome = Outcome::default();
        let begin = now_ns();
        let mut deferred = VecDeque::new();
        while let Some(held) = self.waiting.pop_front() {
            if now_ns().saturating_sub(begin) > TIME_BUDGET_NS {
                self.waiting.push_front(held);
                break;
            }
            let bytes = held.active.payload();
            let asked = match bytes.len() {
                0..=MAX_LIGHT_BYTES => read(bytes, epoch).map(|request| match request.is_heavy() {
                    true => IncomingRequest::Heavy(held.ticket, bytes),
                    false => IncomingRequest::Light(request),
                }),
                _ => Ok(IncomingRequest::Heavy(held.ticket, bytes)),
            };
            let order = match &asked {
                Ok(IncomingRequest::Light(request)) => request.order(),
                // Parsed elsewhere; its order is given with its response.
                Ok(IncomingRequest::Heavy(..)) | Err(_) => None,
            };
            let response = match asked {
                // A disconnected client expects no response: its request is dropped.
                Ok(IncomingRequest::Heavy(..)) if !held.active.is_connected() => continue,
                Ok(IncomingRequest::Heavy(..)) if max_heavy == 0 => {
                    deferred.push_back(held);
                    continue;
                }
                Ok(asked) => {
                    max_heavy -= usize::from(matches!(asked, IncomingRequest::Heavy(..)));
                    outcome.handled += 1;
                    answer(asked, served)
                }
                Err(refused) => {
                    outcome.malformed += 1;
                    Some(refused)
                }
            };
            match response {
                Some(response) => {
                    outcome.orders.extend(order.map(|name| Order::answered(name, &held.active, &response)));
                    outcome.errors.extend(send(&held.active, &response).err());
                }
                None => self.in_process.push(held),
            }
        }
        // Deferred requests are older than the remaining ones.
        deferred.into_iter().rev().for_each(|held| self.waiting.push_front(held));
        outcome
    }

    /// Sends the response to a heavy request with this [`Request::order`]. Returns the order, if it is one, and the result of sending. `None` for
    /// an unknown ticket.
    pub(super) fn answer(
        &mut self,
        ticket: Ticket,
        order: Option<&'static str>,
        response: &Response,
    ) -> Option<(Option<Order>, Result<(), String>)> {
        let index = self.in_process.iter().position(|held| held.ticket == ticket)?;
        let held = self.in_process.swap_remove(index);
        let order = order.map(|name| Order::answered(name, &held.active, response));
        Some((order, send(&held.active, response)))
    }
}

fn send(active: &Active, response: &Response) -> Result<(), String> {
    let bytes = command::encode("answer", response, MAX_RESPONSE_BYTES).or_else(|error| {
        command::encode("answer", &Response::Refused { reason: error.to_string() }, MAX_RESPONSE_BYTES)
    });
    let bytes = bytes.map_err(|error| error.to_string())?;
    let memory = active.loan_slice_uninit(bytes.len()).map_err(|error| error.to_string())?;
    memory.write_from_slice(&bytes).send().map_err(|error| error.to_string())
}
