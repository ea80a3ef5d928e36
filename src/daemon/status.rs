//! The status message.

use super::state::DaemonState;
use plumbline_ipc::{Mounting as MountingMessage, Served, Session as SessionStatistics, Status, now_ns};
use plumbline_model::Mounting;
use plumbline_rt::Controls;

impl DaemonState {
    /// The status of the daemon; `controls` are the running loop's, where one runs.
    pub fn status(&self, served: &Served, controls: Option<&Controls>) -> Status {
        let last = &self.history.last;
        let place = self.mounting.to_string();
        let gravity = self.gravity.served();
        let Mounting { rho, phi } = Mounting::along(&gravity);
        let sum = |count: fn(&SessionStatistics) -> u64| self.history.sessions.iter().map(count).sum();
        let mut status = Status {
            robot: self.setup.robot.name.clone(),
            process: std::process::id(),
            joints: self.setup.robot.chain.len(),
            phase: last.phase,
            motion: last.motion,
            cycles: sum(|session| session.cycles),
            lost: sum(|session| session.lost),
            late: sum(|session| session.late),
            dropped: sum(|session| session.unrecorded),
            model: self.models.served_id(),
            offered: self.models.offer(),
            mounting: Some(MountingMessage { rho, phi, gravity: gravity.into() }),
            gravity: Some(self.gravity.message(now_ns())),
            progress: self.programme.progress,
            driven: self.programme.driven,
            stopped: self.stops.stopped.clone(),
            degraded: self.history.degraded.clone(),
            job: self.name_of(last.motion).map_or_else(|| place.clone(), |name| format!("{place}: {name}")),
            sessions: self.history.sessions.clone(),
            served: served.clone(),
        };
        if let Some(controls) = controls {
            status.cycles += controls.cycles();
            status.lost += controls.lost();
            status.late += controls.late();
            status.dropped += controls.unrecorded();
        }
        status
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::*;
    use super::*;

    #[test]
    fn the_status_sums_up_every_connection_and_the_running_loop() {
        let (mut state, _place) = new_state();
        state.setup.names = vec![(1, "approach".into()), (2, "excitation".into())];
        state.history.last.motion = 2;
        let model = offered(&mut state, MODEL.into());
        let session = SessionStatistics { cycles: 1000, lost: 100, late: 10, unrecorded: 20, ..Default::default() };
        state.history.sessions = vec![session; 2];
        let (mut cycle, handles) = real_time_loop(state.setup.robot.limits);
        let outcome = cycle.run();
        let controls = &handles.controls;
        let running = [controls.cycles(), controls.lost(), controls.late(), controls.unrecorded()];
        assert_eq!((running[0], running[1], running[3]), (5, 2, 3), "{:?}", outcome.end);
        assert!(running[2] > 0);
        for (controls, more) in [(None, [0; 4]), (Some(&**controls), running)] {
            let status = state.status(&Served::default(), controls);
            let counts = [status.cycles, status.lost, status.late, status.dropped];
            assert_eq!(counts, [2000 + more[0], 200 + more[1], 20 + more[2], 40 + more[3]]);
            assert_eq!((status.joints, status.model, status.motion), (7, model, 2));
            assert!(status.job.ends_with(": excitation"), "{}", status.job);
        }
        state.history.last.motion = 3;
        assert_eq!(state.status(&Served::default(), None).job, "upright");
    }
}
