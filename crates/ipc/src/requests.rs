//! Requests that wait for the daemon's answer: every client has its turn, and the long ones hold up nobody.

use std::collections::VecDeque;

use iceoryx2::active_request::ActiveRequest;
use iceoryx2::identifiers::UniqueClientId;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::server::Server as RequestServer;
use iceoryx2::prelude::*;

use super::command::{self, Envelope, MAX_REQUEST_BYTES, MAX_RESPONSE_BYTES, Request, Response, Served};
use super::services::now_ns;

/// Time after which one call takes up no further request \[ns\].
const TIME_PER_CALL_NS: u64 = 500_000;
/// A longer request takes too long to read: it is heavy, whatever it says \[bytes\].
const LIGHT_BYTES: usize = 4096;
/// Requests held at a time. A client has two at most; of those that disconnect, iceoryx2 keeps 128 connections with requests that are held.
const MAX_HELD: usize = 64;

type Active = ActiveRequest<ipc::Service, [u8], (), [u8], ()>;
pub(super) type Port = RequestServer<ipc::Service, [u8], (), [u8], ()>;

/// Names a heavy request until it is answered.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Ticket(u64);

/// A request, as it is handed to whoever answers it.
pub enum IncomingRequest<'a> {
    /// To be answered at once.
    Light(Request),
    /// The bytes of one that takes long to read or to check: [`read`] does the former. To be answered later, by its ticket.
    Heavy(Ticket, &'a [u8]),
}

/// Reads the bytes of a request for the daemon of this `epoch`.
///
/// # Errors
/// The answer to one that can't be read, or is meant for another start of the daemon.
pub fn read(bytes: &[u8], epoch: u64) -> Result<Request, Response> {
    let refused = |reason: String| Response::Refused { reason };
    let envelope: Envelope =
        command::decode("request", bytes, MAX_REQUEST_BYTES).map_err(|error| refused(error.to_string()))?;
    match envelope.epoch {
        Some(meant) if meant != epoch => Err(refused(format!(
            "this is start {epoch} of a daemon (process {}), and the request is for start {meant}",
            std::process::id()
        ))),
        _ => Ok(envelope.request),
    }
}

struct PendingRequest {
    ticket: Ticket,
    active: Active,
}

/// The command service's requests.
pub(super) struct Requests {
    /// In the order of arrival.
    waiting: VecDeque<PendingRequest>,
    /// Handed over and not answered.
    under_way: Vec<PendingRequest>,
    next: u64,
    // The requests go before their port.
    port: Port,
}

/// An order that was answered. A question is none.
#[derive(Debug)]
pub(super) struct Order {
    /// As [`Request::order`].
    pub name: &'static str,
    /// The client's port.
    pub client: UniqueClientId,
    /// Why it was refused, if it was.
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

/// What one [`Requests::serve`] has done.
#[derive(Debug, Default)]
pub(super) struct Outcome {
    pub handled: usize,
    pub garbled: u64,
    /// Orders among the requests that were answered.
    pub orders: Vec<Order>,
    /// What shared memory refused to do.
    pub trouble: Vec<String>,
}

impl Requests {
    pub(super) fn of(port: Port) -> Requests {
        Requests { waiting: VecDeque::with_capacity(MAX_HELD), under_way: Vec::new(), next: 0, port }
    }

    /// Takes in what has arrived from every client before anything is answered: `receive` begins with the first client each time, so that one
    /// that always has a request outstanding would otherwise be the only one that is served.
    pub(super) fn take_in(&mut self) -> Result<(), String> {
        while self.waiting.len() + self.under_way.len() < MAX_HELD {
            match self.port.receive() {
                Ok(Some(active)) => {
                    self.next += 1;
                    self.waiting.push_back(PendingRequest { ticket: Ticket(self.next), active });
                }
                // Every client that has sent something has as many under way as it may.
                Ok(None) | Err(ReceiveError::ExceedsMaxBorrows) => break,
                Err(trouble) => return Err(trouble.to_string()),
            }
        }
        Ok(())
    }

    /// Whether there is anything to answer.
    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Answers what was taken in through `answer`, the oldest first, for a bounded time; hands over heavy ones as long as there is `room` for them.
    pub(super) fn serve(
        &mut self,
        epoch: u64,
        served: &Served,
        mut room: usize,
        mut answer: impl FnMut(IncomingRequest, &Served) -> Option<Response>,
    ) -> Outcome {
        let mut outcome = Outcome::default();
        let begin = now_ns();
        let mut no_room = VecDeque::new();
        while let Some(held) = self.waiting.pop_front() {
            if now_ns().saturating_sub(begin) > TIME_PER_CALL_NS {
                self.waiting.push_front(held);
                break;
            }
            let bytes = held.active.payload();
            let asked = match bytes.len() {
                0..=LIGHT_BYTES => read(bytes, epoch).map(|request| match request.is_heavy() {
                    true => IncomingRequest::Heavy(held.ticket, bytes),
                    false => IncomingRequest::Light(request),
                }),
                _ => Ok(IncomingRequest::Heavy(held.ticket, bytes)),
            };
            let order = match &asked {
                Ok(IncomingRequest::Light(request)) => request.order(),
                // It is read elsewhere, and named with its answer.
                Ok(IncomingRequest::Heavy(..)) | Err(_) => None,
            };
            let response = match asked {
                // Whoever has gone waits for nothing: those that stay get the place.
                Ok(IncomingRequest::Heavy(..)) if !held.active.is_connected() => continue,
                Ok(IncomingRequest::Heavy(..)) if room == 0 => {
                    no_room.push_back(held);
                    continue;
                }
                Ok(asked) => {
                    room -= usize::from(matches!(asked, IncomingRequest::Heavy(..)));
                    outcome.handled += 1;
                    answer(asked, served)
                }
                Err(refused) => {
                    outcome.garbled += 1;
                    Some(refused)
                }
            };
            match response {
                Some(response) => {
                    outcome.orders.extend(order.map(|name| Order::answered(name, &held.active, &response)));
                    outcome.trouble.extend(send(&held.active, &response).err());
                }
                None => self.under_way.push(held),
            }
        }
        // They came before those that were not looked at.
        no_room.into_iter().rev().for_each(|held| self.waiting.push_front(held));
        outcome
    }

    /// Answers a heavy request of this [`Request::order`]: the order, if it is one, and what shared memory refused to do, if anything. `None` for
    /// a ticket that is not waiting.
    pub(super) fn answer(
        &mut self,
        ticket: Ticket,
        order: Option<&'static str>,
        response: &Response,
    ) -> Option<(Option<Order>, Result<(), String>)> {
        let index = self.under_way.iter().position(|held| held.ticket == ticket)?;
        let held = self.under_way.swap_remove(index);
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
