//! Models that are offered or proposed, checked on a thread of their own: reading one takes milliseconds, and the bridge thread has none to spare.

use super::models::Accepted;
use crate::recording::about::panic_message;
use crate::store::{ModelFile, model_identity};
use plumbline_core::BadInput;
use plumbline_ipc::{Proposal, Request, Response, Ticket, read};
use plumbline_model::{Mounting, Robot};
use plumbline_model_file::models;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

/// Time between the beginnings of two checks: models come rarely, and more of them wait \[ns\].
const INTERVAL_NS: u64 = 100_000_000;

/// Checks a model's text: the right robot, a set that holds in this mounting.
pub fn check(robot: &Robot, mounting: &Mounting, file: &str, text: &str) -> Result<Accepted, BadInput> {
    let offered = models::of_robot(file, text, robot, "which this daemon drives")?;
    offered
        .model
        .valid_in(mounting)
        .map_err(|refused| BadInput::new(file, "key `kind`", refused, "a model that holds in the present mounting"))?;
    let ModelFile { model, noise_floor: noise, .. } = offered;
    Ok(Accepted { id: model_identity(text), text: text.to_string(), model, noise })
}

/// A request that was read, and its model checked.
pub enum Checked {
    Offered(Box<Accepted>),
    /// Serve this model in place of the present one, or hold it.
    Proposed(Box<Accepted>, Proposal),
    Other(Request),
    Refused(Response),
    Garbled(Response),
}

impl Checked {
    pub fn of(robot: &Robot, mounting: &Mounting, request: Request) -> Checked {
        let refused = |bad: BadInput| Checked::Refused(Response::Refused { reason: bad.to_string() });
        match request {
            Request::OfferModel { toml } => check(robot, mounting, "offered model", &toml)
                .map_or_else(refused, |model| Checked::Offered(Box::new(model))),
            Request::ProposeModel { toml, proposal } => check(robot, mounting, "proposed model", &toml)
                .map_or_else(refused, |model| Checked::Proposed(Box::new(model), proposal)),
            other => Checked::Other(other),
        }
    }
}

pub struct Answerable {
    pub ticket: Ticket,
    /// Its [`Request::order`]; `None` where it could not be read.
    pub order: Option<&'static str>,
    pub checked: Checked,
}

/// A request's bytes on their way to the thread.
struct Job {
    ticket: Ticket,
    bytes: Vec<u8>,
    mounting: Mounting,
}

/// The thread that checks, from the bridge thread's side: one request at a time.
pub struct Checker {
    jobs: SyncSender<Job>,
    checked: Receiver<Answerable>,
    busy: bool,
    next_ns: u64,
}

impl Checker {
    /// Starts the thread, at ordinary priority. `epoch` is the daemon's.
    pub fn start(robot: Robot, epoch: u64) -> std::io::Result<Checker> {
        let (jobs, to_check) = sync_channel::<Job>(1);
        let (done, checked) = sync_channel(1);
        std::thread::Builder::new().name("plumbline-check".into()).spawn(move || {
            for Job { ticket, bytes, mounting } in to_check {
                let mut order = None;
                let checked = catch_unwind(AssertUnwindSafe(|| {
                    read(&bytes, epoch).map_or_else(Checked::Garbled, |request| {
                        order = request.order();
                        Checked::of(&robot, &mounting, request)
                    })
                }));
                let checked = checked.unwrap_or_else(|panic| {
                    let reason = format!("the check of the request panicked: {}", panic_message(&*panic));
                    Checked::Refused(Response::Refused { reason })
                });
                if done.send(Answerable { ticket, order, checked }).is_err() {
                    return;
                }
            }
        })?;
        Ok(Checker { jobs, checked, busy: false, next_ns: 0 })
    }

    /// How many requests it takes now: one or none.
    pub fn room(&self, now_ns: u64) -> usize {
        usize::from(!self.busy && now_ns >= self.next_ns)
    }

    /// Gives it a request; there is [`room`](Checker::room).
    pub fn give(&mut self, ticket: Ticket, bytes: &[u8], mounting: Mounting, now_ns: u64) {
        self.busy = self.jobs.try_send(Job { ticket, bytes: bytes.to_vec(), mounting }).is_ok();
        self.next_ns = now_ns.saturating_add(INTERVAL_NS);
    }

    /// The request that is done with, if any.
    pub fn take(&mut self) -> Option<Answerable> {
        match self.checked.try_recv() {
            Ok(done) => {
                self.busy = false;
                Some(done)
            }
            Err(TryRecvError::Empty | TryRecvError::Disconnected) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::*;
    use super::*;
    use std::time::{Duration, Instant};

    /// A request of many bytes is read on the other thread, which answers it whatever it is.
    #[test]
    fn the_checking_thread_takes_one_request_at_a_time() {
        let (state, _place) = new_state();
        let (robot, mounting) = (state.setup.robot.clone(), state.mounting);
        let mut checker = Checker::start(robot, 5).unwrap();
        let bytes = |request: &Request| serde_json::to_vec(request).unwrap();
        let mut now = 1;
        let mut check = |bytes: &[u8]| {
            assert_eq!(checker.room(now), 1);
            checker.give(Ticket::default(), bytes, mounting, now);
            assert_eq!(checker.room(u64::MAX), 0, "it is busy");
            let start = Instant::now();
            let checked = loop {
                match checker.take() {
                    Some(Answerable { checked, .. }) => break checked,
                    None => assert!(start.elapsed() < Duration::from_secs(60)),
                }
                std::thread::sleep(Duration::from_millis(1));
            };
            assert_eq!(checker.room(now + 99_999_999), 0, "a flood of models waits");
            assert_eq!(checker.room(now + 100_000_000), 1);
            now += 1_000_000_000;
            checked
        };
        assert!(matches!(check(&bytes(&offer())), Checked::Offered(_)));
        assert!(matches!(check(&bytes(&Request::Status {})), Checked::Other(Request::Status {})));
        assert!(matches!(check(&[b'['; 60_000]), Checked::Garbled(_)));
        let nonsense = Request::OfferModel { toml: "x".into() };
        assert!(matches!(check(&bytes(&nonsense)), Checked::Refused(_)));
        let other_start = br#"{"epoch":6,"request":"status"}"#;
        assert!(
            matches!(check(other_start), Checked::Garbled(Response::Refused { reason }) if reason.contains("start 5"))
        );
    }
}
