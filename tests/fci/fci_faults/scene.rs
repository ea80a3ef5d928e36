//! A case while it runs: waits for its moment, lets it go wrong, and sees the daemon to its end.

use super::case::{Case, When};
use plumbline_core::Phase;
use plumbline_ipc::{Client, Progress, Request, Response, RobotId, Status};
use plumbline_testkit::emulator::limits::JOINTS;
use plumbline_testkit::emulator::{Emulator, OperatorAction};
use plumbline_testkit::job::{Place, Running};
use std::time::{Duration, Instant};

/// Longest time that a case may take.
const MOST: Duration = Duration::from_secs(240);
const ANSWER: Duration = Duration::from_secs(2);

pub struct Scene<'a> {
    pub case: &'a Case,
    pub emulator: Emulator,
    pub place: Place,
    pub daemon: Running,
    pub client: Option<Client>,
    pub status: Option<Box<Status>>,
    pub injected_at: Option<u64>,
    pub moved: bool,
    pub begun: Instant,
}

impl Scene<'_> {
    /// Asks the daemon, where it answers.
    fn ask(&mut self, request: &Request) -> Option<Response> {
        if self.client.is_none() {
            let id = RobotId::parse("test", "id", &self.place.id).unwrap();
            self.client = Client::connect(&id, Duration::from_millis(20)).ok();
        }
        let answer = self.client.as_mut()?.send(request, ANSWER).ok();
        if answer.is_none() {
            self.client = None;
        }
        answer
    }

    fn look(&mut self) -> Option<&Status> {
        if let Some(Response::Status(status)) = self.ask(&Request::Status {}) {
            self.status = Some(status);
            return self.status.as_deref();
        }
        None
    }

    /// Waits until `condition`, or the daemon's end; whether the condition came.
    fn wait(&mut self, mut condition: impl FnMut(&mut Self) -> bool) -> bool {
        while self.daemon.runs() && self.begun.elapsed() < MOST {
            if condition(self) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        false
    }

    /// Fastest joint by the desired velocity \[rad/s\].
    fn speed(&self) -> f64 {
        self.emulator.snapshot().state.dq_d.iter().fold(0.0, |most: f64, dq| most.max(dq.abs()))
    }

    fn inject(&mut self) {
        let state = self.emulator.snapshot().state;
        self.injected_at = Some(state.message_id);
        self.moved = state.dq_d != [0.0; JOINTS];
        self.case.inject(&self.emulator);
    }

    /// Plays the case until the daemon ends; whether everything was driven.
    pub fn play(&mut self) -> bool {
        if self.case.when == When::Connect && self.case.is_reset() {
            self.wait(|scene| scene.emulator.snapshot().connected);
            self.inject();
        }
        self.wait(|scene| scene.look().is_some() && scene.emulator.snapshot().connected);
        if self.case.when == When::Serve {
            std::thread::sleep(Duration::from_millis(300));
            self.inject();
            // Long enough for every fault of the campaign to be over and for the daemon to get over it.
            let until = Instant::now() + Duration::from_millis(1500);
            self.wait(|_| Instant::now() > until);
            self.emulator.operate(OperatorAction::Release);
            let until = Instant::now() + Duration::from_millis(300);
            self.wait(|scene| scene.look().is_some() && Instant::now() > until);
            self.ask(&Request::Quit {});
            self.wait(|_| false);
            return false;
        }
        self.wait(|scene| {
            matches!(scene.ask(&Request::Start {}), Some(Response::Accepted {} | Response::Refused { .. }))
        });
        match self.case.when {
            When::Connect => {
                self.wait(|scene| scene.speed() > 0.02);
                self.emulator.heal();
            }
            When::Approach => {
                self.wait(|scene| scene.speed() > 0.1);
                let from = Instant::now() + Duration::from_millis(400);
                if self.wait(|scene| Instant::now() > from && scene.speed() > 0.1) {
                    self.inject();
                }
            }
            When::Excite | When::Stop => {
                self.wait(|scene| scene.look().is_some_and(|status| status.phase == Phase::Excite));
                let from = Instant::now() + Duration::from_millis(700);
                if self.wait(|scene| Instant::now() > from && scene.speed() > 0.3) {
                    if self.case.when == When::Stop {
                        self.ask(&Request::Quit {});
                    }
                    self.inject();
                }
            }
            When::Serve => {}
        }
        let over = [Progress::Done, Progress::Stopped];
        let ended = self.wait(|scene| {
            // Seldom: a status costs the bridge thread time.
            std::thread::sleep(Duration::from_millis(20));
            scene.look().is_some_and(|status| over.contains(&status.progress))
        });
        let done = self.status.as_ref().is_some_and(|status| status.progress == Progress::Done);
        if ended {
            // The connection that holds the arm afterwards is part of the job.
            std::thread::sleep(Duration::from_millis(100));
            self.look();
            self.ask(&Request::Quit {});
            self.wait(|_| false);
        }
        done
    }
}
