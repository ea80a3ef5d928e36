//! Values of a monitored daemon: the last status and record, residuals, external torque, latencies, events.

use crate::analysis::external::ONE_CONTACT_S;
use nalgebra::Vector3;
use plumbline_core::{Histogram, JointVec, Limits, Record, Validity};
use plumbline_identify::external::{External, ExternalObserver, ObserverSettings};
use plumbline_ipc::{ModelHeader, ModelMessage, Progress, Status};
use plumbline_model::Robot;
use plumbline_model_file::{ModelFile, models};
use std::collections::VecDeque;
use std::time::Instant;

/// Lines of events that are kept.
const EVENTS: usize = 100;
/// Share of a new sample in the mean square of a residual: a time constant of half a second at 1 kHz.
const NEW_SHARE: f64 = 1.0 / 500.0;
/// Bins of latencies: a third of a decade each, from 1 us on.
pub const BINS: usize = 16;
const BINS_PER_DECADE: f64 = 3.0;

/// A daemon as its clients see it.
pub struct Watched {
    pub status: Option<Status>,
    /// Whether a daemon runs.
    pub runs: bool,
    pub last: Record,
    pub limits: Option<Limits>,
    /// Noise floor of the served model, per joint \[Nm\]; empty where it is not known.
    pub floor: Vec<f64>,
    /// External torque by the served model; `None` where the model has no spectrum of its residual.
    pub external: Option<External>,
    observer: Option<ExternalObserver>,
    /// Time of the last contact on the arm's clock \[s\].
    contact: f64,
    /// Header of the served model.
    model: ModelHeader,
    /// Time of the first header with its identity and gravity, `CLOCK_BOOTTIME` \[ns\].
    served_since: u64,
    /// Mean square of measured torque minus served torque, per joint \[Nm^2\].
    square: JointVec,
    /// Wake-up latencies; execution times of an arm without a deadline.
    pub latencies: [u64; BINS],
    /// Wake-up latencies of an arm with deadlines, and execution times \[ns\].
    pub wake_up: Histogram,
    pub execution: Histogram,
    pub events: VecDeque<String>,
    start: Instant,
}

impl Default for Watched {
    fn default() -> Watched {
        Watched {
            status: None,
            runs: true,
            last: Record::default(),
            limits: None,
            floor: Vec::new(),
            external: None,
            observer: None,
            contact: f64::NEG_INFINITY,
            model: ModelHeader::default(),
            served_since: 0,
            square: JointVec::default(),
            latencies: [0; BINS],
            wake_up: Histogram::default(),
            execution: Histogram::default(),
            events: VecDeque::new(),
            start: Instant::now(),
        }
    }
}

impl Watched {
    /// Adds an event with its time.
    pub fn note(&mut self, event: impl std::fmt::Display) {
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(format!("{:7.1} s  {event}", self.start.elapsed().as_secs_f64()));
    }

    /// The daemon does not answer any more.
    pub fn gone(&mut self) {
        if std::mem::replace(&mut self.runs, false) {
            self.note("the daemon has ended");
        }
    }

    /// Takes a status, and notes what has changed since the last one.
    pub fn status(&mut self, new: Status) {
        if !std::mem::replace(&mut self.runs, true) {
            self.note("a daemon runs again");
        }
        if self.limits.is_none() {
            self.limits = Robot::load(&new.robot, None).ok().map(|robot| robot.limits);
        }
        let Some(old) = self.status.replace(new.clone()) else { return };
        let mut changes: Vec<String> = Vec::new();
        if old.job != new.job || old.progress != new.progress {
            changes.push(format!("{}: {}", progress(new.progress), new.job));
        }
        if old.model != new.model {
            changes.push(format!("model {:016x} is served", new.model));
        }
        if old.stopped != new.stopped {
            changes.extend(new.stopped.as_ref().map(|why| format!("stopped: {why}")));
        }
        if old.doubt != new.doubt {
            changes.push(
                new.doubt.as_ref().map_or("the torque is trusted again".into(), |why| format!("doubtful: {why}")),
            );
        }
        if old.without_model != new.without_model {
            changes.extend(new.without_model.as_ref().map(|why| format!("no model is served: {why}")));
        }
        if old.offered != new.offered {
            changes.extend(new.offered.as_ref().map(|offered| format!("proposed: {}", offered.proposal.what)));
        }
        if new.lost > old.lost {
            changes.push(format!("{} states lost", new.lost - old.lost));
        }
        changes.into_iter().for_each(|change| self.note(change));
    }

    /// Takes a message of the served model.
    pub fn model(&mut self, message: &ModelMessage) {
        let ModelMessage { header, text } = message;
        let of = |header: &ModelHeader| (header.model, header.gravity);
        if of(&std::mem::replace(&mut self.model, *header)) == of(header) {
            return;
        }
        self.served_since = header.stamp_ns;
        (self.floor, self.observer, self.external) = (Vec::new(), None, None);
        if header.model == 0 {
            return;
        }
        match models::parse("the served model", text, None) {
            Ok((file, robot)) => {
                self.limits = Some(robot.limits);
                self.observe(file, header.gravity);
            }
            Err(error) => self.note(error),
        }
    }

    /// Header of the served model and the time since when it is served, `CLOCK_BOOTTIME` \[ns\]; `None` where none is.
    pub fn served(&self) -> Option<(&ModelHeader, u64)> {
        (self.model.model != 0).then_some((&self.model, self.served_since))
    }

    /// Takes the noise floor of a model and its observer under `gravity` \[m/s2\].
    fn observe(&mut self, file: ModelFile, gravity: [f64; 3]) {
        let ModelFile { model, uncertainty, noise_floor, .. } = file;
        self.floor = noise_floor;
        let usual = ObserverSettings::default();
        self.observer = uncertainty
            .and_then(|uncertainty| ExternalObserver::new(&model, &uncertainty, &Vector3::from(gravity), usual).ok());
    }

    pub fn record(&mut self, record: &Record) {
        self.observe_external(record);
        let served = record.model != 0 && matches!(record.validity, Validity::Valid | Validity::Doubtful);
        for ((square, measured), served_torque) in
            self.square.iter_mut().zip(&record.state.tau).zip(&record.command.tau_ff.0)
        {
            let error = if served { measured - served_torque } else { 0.0 };
            *square += NEW_SHARE * (error * error - *square);
        }
        if record.wake_ns > 0 {
            self.wake_up.add(record.wake_ns);
        }
        self.execution.add(record.work_ns);
        let ns = if record.wake_ns > 0 { record.wake_ns } else { record.work_ns };
        let bin = ((ns as f64 / 1e3).max(1.0).log10() * BINS_PER_DECADE) as usize;
        self.latencies[bin.min(BINS - 1)] += 1;
        self.last = *record;
    }

    fn observe_external(&mut self, record: &Record) {
        let Some(observer) = &mut self.observer else { return };
        let state = &record.state;
        if state.seq != self.last.state.seq.wrapping_add(1) {
            // The filter starts again after missing samples. Its own settings are valid.
            let _ = observer.configure(*observer.settings());
        }
        let external = observer.next(&state.q, &state.dq, &state.tau);
        self.external = Some(external);
        if !external.contact {
            return;
        }
        let before = std::mem::replace(&mut self.contact, state.time);
        if !(0.0..ONE_CONTACT_S).contains(&(state.time - before)) {
            let beyond = (0..self.joints()).filter(|&j| external.tau[j].abs() > external.threshold[j]);
            let of =
                |j: usize| format!("joint {} {:.2} Nm (above {:.2})", j + 1, external.tau[j], external.threshold[j]);
            let joints = beyond.map(of).collect::<Vec<_>>().join(", ");
            self.note(format!("contact: {joints}"));
        }
    }

    /// RMS of measured minus served torque over the last half second \[Nm\].
    pub fn residual(&self, joint: usize) -> f64 {
        self.square[joint].sqrt()
    }

    pub fn joints(&self) -> usize {
        self.status.as_ref().map_or(0, |status| status.joints).min(self.last.state.q.len())
    }
}

/// The progress of a job in a word.
pub fn progress(progress: Progress) -> &'static str {
    match progress {
        Progress::Idle => "not started",
        Progress::Driving => "driving",
        Progress::AwaitingModel => "waits for a model",
        Progress::Paused => "paused",
        Progress::Done => "done",
        Progress::Stopped => "stopped",
    }
}

/// Lower end of a bin of latencies, as text.
pub fn bin_name(bin: usize) -> String {
    let us = 10f64.powf(bin as f64 / BINS_PER_DECADE);
    if us < 999.0 { format!("{us:.0}us") } else { format!("{:.0}ms", us / 1e3) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::{PERIOD_S, Torque};
    use plumbline_identify::external::ResidualSpectrum;
    use plumbline_identify::{Spread, TorqueUncertainty};
    use plumbline_model::Mounting;
    use plumbline_model::term::Sample;

    const MODEL: &str = include_str!("../../config/models/panda-paper-table3.toml");

    fn message(model: u64, gravity: Vector3<f64>) -> ModelMessage {
        let header = ModelHeader { model, gravity: gravity.into(), ..ModelHeader::default() };
        ModelMessage { header, text: if model == 0 { String::new() } else { MODEL.into() } }
    }

    /// A model with white noise of `std` \[Nm\] and exact parameters.
    fn with_noise(std: f64) -> ModelFile {
        let file = models::parse("test", MODEL, None).unwrap().0;
        let bands = ResidualSpectrum::bands(1000.0).map(|[low, high]| std * std * (high - low) / 500.0);
        let power = vec![bands.collect(); 7];
        let uncertainty = TorqueUncertainty {
            parameters: Spread::zero(file.model.parameters().len()),
            residual_std: vec![std; 7],
            residual_freedom: 1e9,
            residual_spectrum: Some(ResidualSpectrum { rate: 1000.0, power }),
        };
        ModelFile { uncertainty: Some(uncertainty), ..file }
    }

    #[test]
    fn a_push_is_the_external_torque_and_one_contact() {
        let gravity = Mounting::WALL.gravity();
        let (file, mut watched) = (with_noise(0.2), Watched::default());
        watched.status(Status { robot: "panda".into(), joints: 7, ..Status::default() });
        let mut torque = file.model.evaluator(&gravity);
        watched.observe(file, gravity.into());
        let q = [0.1, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5, 0.0];
        let Torque(rest) = torque.torque(&Sample { q, ..Sample::default() });
        let mut seq = 0;
        let mut take = |watched: &mut Watched, count: u64, skipped: u64, push: f64| {
            seq += skipped;
            for _ in 0..count {
                seq += 1;
                let mut record = Record::default();
                (record.state.seq, record.state.time) = (seq, seq as f64 * PERIOD_S);
                (record.state.q, record.state.tau) = (q, rest);
                record.state.tau[2] += push;
                watched.record(&record);
            }
            watched.external.unwrap()
        };
        let free = take(&mut watched, 1000, 0, 0.0);
        assert!(free.settled && !free.contact && free.tau.iter().all(|tau| tau.abs() < 1e-6), "{free:?}");
        let pushed = take(&mut watched, 1000, 0, 5.0);
        assert!(pushed.contact && (pushed.tau[2] - 5.0).abs() < 1e-3 && pushed.tau[1].abs() < 1e-6, "{pushed:?}");
        let notes = || watched.events.iter().filter(|event| event.contains("contact: joint 3 ")).count();
        assert_eq!(notes(), 1, "{:?}", watched.events);
        // After missing samples the filter starts again: nothing is flagged until it has settled.
        let after = take(&mut watched, 1, 40, 5.0);
        assert!(!after.settled && !after.contact, "{after:?}");
    }

    #[test]
    fn floor_and_limits_are_those_of_the_served_model() {
        let mut watched = Watched::default();
        watched.model(&message(7, Mounting::WALL.gravity()));
        assert!(watched.limits.is_some() && watched.events.is_empty(), "{:?}", watched.events);
        // The file has no spectrum of its residual.
        watched.record(&Record::default());
        assert!(watched.external.is_none());
        watched.floor = vec![0.1; 7];
        watched.model(&message(0, Vector3::zeros()));
        assert!(watched.floor.is_empty());
        watched.model(&ModelMessage { text: "nothing".into(), ..message(8, Vector3::zeros()) });
        assert!(watched.events.iter().any(|event| event.contains("the served model")), "{:?}", watched.events);
    }
}
