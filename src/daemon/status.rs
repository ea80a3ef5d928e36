//! The status message.

use super::state::{DaemonState, ProgrammeState};
use plumbline_core::LoopStatistics;
use plumbline_ipc::{GuestStatus, Mounting as MountingMessage, Served, Status, now_ns};
use plumbline_model::Mounting;
use plumbline_rt::Controls;

impl ProgrammeState {
    /// Time that the motions still take, in sample `tick` of `motion` \[s\].
    fn left(&self, motion: u32, tick: u64) -> Option<f64> {
        let open = self.motions.iter().filter(|(number, _)| !self.ended.contains(number));
        let left =
            |(number, ticks): &(u32, u64)| if *number == motion { ticks.saturating_sub(tick + 1) } else { *ticks };
        (!self.motions.is_empty()).then(|| open.map(left).sum::<u64>() as f64 * 1e-3)
    }
}

impl DaemonState {
    /// The status of the daemon; `controls` are the running loop's, where one runs.
    pub fn status(&self, served: &Served, controls: Option<&Controls>) -> Status {
        let last = &self.history.last;
        let place = self.mounting.to_string();
        let gravity = self.gravity.served();
        let Mounting { rho, phi } = Mounting::along(&gravity);
        let sum = |count: fn(&LoopStatistics) -> u64| {
            self.history.sessions.iter().map(|session| count(&session.statistics)).sum()
        };
        let mut status = Status {
            robot: self.setup.robot.name.clone(),
            process: std::process::id(),
            joints: self.setup.robot.chain.len(),
            phase: last.phase,
            motion: last.motion,
            cycles: sum(|of| of.cycles),
            lost: sum(|of| of.lost),
            late: sum(|of| of.late.unwrap_or(0)),
            dropped_records: sum(|of| of.dropped_records),
            model: self.models.served_id(),
            doubt: self.models.why_doubted().cloned(),
            without_model: self.programme.without_model.clone(),
            offered: self.models.offer(),
            mounting: Some(MountingMessage { rho, phi, gravity: gravity.into() }),
            gravity: Some(self.gravity.message(now_ns())),
            progress: self.programme.progress,
            driven: self.programme.driven,
            stopped: self.stops.stopped.clone(),
            degraded: self.history.degraded.clone(),
            job: self.name_of(last.motion).map_or_else(|| place.clone(), |name| format!("{place}: {name}")),
            left: self.programme.left(last.motion, last.tick),
            sessions: self.history.sessions.clone(),
            guest: self.history.guest.clone(),
            served: served.clone(),
        };
        if let Some(GuestStatus { counts, .. }) = &self.history.guest {
            status.cycles += counts.received - counts.other_joints - counts.other_rate;
            status.lost += counts.lost;
            status.late += counts.late;
        }
        if let Some(controls) = controls {
            status.cycles += controls.cycles();
            status.lost += controls.lost();
            status.late += controls.late();
            status.dropped_records += controls.dropped_records();
        }
        status
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixture::*;
    use super::*;
    use plumbline_ipc::Session;

    #[test]
    fn the_time_left_is_that_of_motions_that_have_not_ended() {
        let mut programme = ProgrammeState::default();
        assert_eq!(programme.left(0, 0), None);
        programme.motions = vec![(1, 1000), (2, 3000), (3, 500)];
        assert_eq!(programme.left(0, 0), Some(4.5));
        programme.ended = vec![1];
        assert_eq!(programme.left(2, 999), Some(2.5));
        programme.ended = vec![1, 2, 3];
        assert_eq!(programme.left(3, 499), Some(0.0));
    }

    #[test]
    fn the_status_sums_up_every_connection_and_the_running_loop() {
        let (mut state, _place) = new_state();
        state.setup.names = vec![(1, "approach".into()), (2, "excitation".into())];
        state.history.last.motion = 2;
        let model = offered(&mut state, MODEL.into());
        let counts =
            LoopStatistics { cycles: 1000, lost: 100, late: Some(10), dropped_records: 20, ..Default::default() };
        let session = Session { statistics: counts, ..Session::default() };
        state.history.sessions = vec![session; 2];
        let (mut cycle, handles) = real_time_loop(state.setup.robot.limits);
        let outcome = cycle.run();
        let controls = &handles.controls;
        let running = [controls.cycles(), controls.lost(), controls.late(), controls.dropped_records()];
        assert_eq!((running[0], running[1], running[3]), (5, 2, 3), "{:?}", outcome.end);
        assert!(running[2] > 0);
        for (controls, more) in [(None, [0; 4]), (Some(&**controls), running)] {
            let status = state.status(&Served::default(), controls);
            let counts = [status.cycles, status.lost, status.late, status.dropped_records];
            assert_eq!(counts, [2000 + more[0], 200 + more[1], 20 + more[2], 40 + more[3]]);
            assert_eq!((status.joints, status.model, status.motion), (7, model, 2));
            assert!(status.job.ends_with(": excitation"), "{}", status.job);
        }
        state.history.last.motion = 3;
        assert_eq!(state.status(&Served::default(), None).job, "upright");
    }
}
