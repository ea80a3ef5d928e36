//! Live watch of the estimator: monitors the residual of the served model, detects changes and proposes a new model.

mod changes;
mod log;
#[cfg(test)]
mod replay;

use self::changes::{Change, Search};
use self::log::{Event, Log, Stretch};
use crate::analysis::collector::{MAX_GAP_S, states};
use crate::analysis::pipeline::{self, Identified};
use crate::config::job::{Adopt, Job};
use crate::dataset::Run;
use crate::failure::Failure;
use crate::store::model_identity;
use nalgebra::DMatrix;
use plumbline_core::{Phase, Record, Validity};
use plumbline_diagnose::live::{self, END_MARGIN_S, Floor, News, STRETCH_S, Watch, onset};
use plumbline_identify::{Experiment, Settings};
use plumbline_ipc::{Proposal, Status};
use plumbline_model::{Mounting, Robot, TorqueModel};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Length of the identification motion from which the usual error is computed \[s\].
const CALIBRATION_S: f64 = 60.0;
/// Time around a change that takes no part in a search: the low-pass spreads it, and its begin is known to a tenth of a second \[s\].
const CHANGE_MARGIN_S: f64 = 0.3;
/// Time before an alarm in which the begin of the change is looked for \[s\].
const ONSET_WINDOW_S: f64 = 2.0;
/// Samples since a change are used up to this time \[s\].
const REFINED_S: f64 = 60.0;
/// Largest speed of a joint at rest \[rad/s\].
const REST_SPEED: f64 = 0.01;
const MAX_LOGGED_STRETCHES: usize = 10_000;

/// A model for the daemon, with the reason.
pub struct OfferedModel {
    pub toml: String,
    pub proposal: Proposal,
}

/// Whether a model holds.
pub struct Verdict {
    pub model: u64,
    /// How the measured torques contradict it, if they do.
    pub doubt: Option<String>,
}

/// A model that was identified or proposed.
struct Known {
    id: u64,
    model: TorqueModel,
    toml: String,
    /// How well the changes in it are known.
    deviations: Vec<TorqueModel>,
}

pub struct Live {
    adopt: Adopt,
    window: f64,
    /// Time between records \[s\].
    period: f64,
    joints: usize,
    robot: Robot,
    settings: Settings,
    mounting: Mounting,
    out: PathBuf,
    noise_floor: Vec<f64>,
    /// Covariance of the identified parameters, which every model has.
    covariance: DMatrix<f64>,
    /// The identified model and those that were proposed.
    models: Vec<Known>,
    watch: Option<Watch>,
    /// Identity of the model that the records in the buffer were served with.
    serving: u64,
    /// Samples of one motion without a gap.
    buffer: VecDeque<Record>,
    samples_since_stretch: usize,
    /// The change that is looked for, and refined once it was found.
    change: Option<Change>,
    /// When what nothing explains came \[s\].
    unexplained: Option<f64>,
    /// Whether a proposal was rejected since the model was lost.
    silent: bool,
    /// Whether searches block, as in simulated time, which would otherwise run ahead.
    wait_for_search: bool,
    searching: Option<Search>,
    /// Identity of the model that was proposed to the daemon, and when the change came that it is for \[s\].
    proposed: Option<(u64, f64)>,
    /// What the daemon is to be told about its model.
    verdict: Option<Verdict>,
    log: Log,
    /// Events that are in `live.json`.
    written_events: usize,
    notes: Vec<String>,
}

impl Live {
    /// A live watch, which starts with the first model; `None` if disabled.
    pub fn new(job: &Job, robot: &Robot, out: &Path) -> Option<Live> {
        job.live.watch.then(|| Live {
            adopt: job.live.adopt,
            window: job.live.window,
            period: job.backend.sample_period(),
            joints: robot.chain.len(),
            robot: robot.clone(),
            settings: Settings { rest: Some(REST_SPEED), ..job.settings() },
            mounting: job.mounting,
            out: out.to_path_buf(),
            noise_floor: Vec::new(),
            covariance: DMatrix::zeros(0, 0),
            models: Vec::new(),
            watch: None,
            serving: 0,
            buffer: VecDeque::new(),
            samples_since_stretch: 0,
            change: None,
            unexplained: None,
            silent: false,
            wait_for_search: job.backend.is_fast(),
            searching: None,
            proposed: None,
            verdict: None,
            log: Log::default(),
            written_events: 0,
            notes: Vec::new(),
        })
    }

    /// Stores the model identified from `run`, and its usual error.
    pub fn identified(&mut self, identified: &Identified, text: &str, run: &Run) -> Result<(), Failure> {
        let Identified { model, identification, .. } = identified;
        let samples = run.samples().min(self.samples(CALIBRATION_S));
        let part = plumbline_identify::Run { period: None, ..run.data.part(0, samples) };
        let floor = Floor::of(model, &pipeline::experiment(&part, &self.settings)?);
        (self.log.usual, self.log.limit) = (floor.usual.clone(), floor.limit.clone());
        self.noise_floor = identification.rms.noise_floor.clone().unwrap_or_default();
        self.covariance = identification.covariance.clone();
        self.models =
            vec![Known { id: model_identity(text), model: model.clone(), toml: text.into(), deviations: Vec::new() }];
        self.watch = Some(Watch::new(floor));
        Ok(())
    }

    /// Processes a record; returns a model to propose, if there is one.
    pub fn update(&mut self, record: &Record) -> Result<Option<OfferedModel>, Failure> {
        let known = self.models.iter().any(|known| known.id == record.model);
        if record.phase != Phase::Excite || !known {
            self.clear();
            return Ok(None);
        }
        if self.serving != record.model {
            self.handle_served_model(record);
        }
        let longest = self.samples(MAX_GAP_S) as u64;
        let is_apart = |before: &Record| {
            before.motion != record.motion || record.state.seq > before.state.seq.saturating_add(longest)
        };
        if self.buffer.back().is_some_and(is_apart) {
            self.clear();
        }
        self.buffer.push_back(*record);
        self.samples_since_stretch += 1;
        if self.buffer.len() > self.samples(self.window.max(REFINED_S) + ONSET_WINDOW_S + 4.0 * STRETCH_S) {
            self.buffer.pop_front();
        }
        let needed = self.samples(STRETCH_S + 2.0 * END_MARGIN_S) + 2 * self.edge();
        if self.samples_since_stretch < self.samples(STRETCH_S) || self.buffer.len() < needed {
            return Ok(None);
        }
        self.samples_since_stretch = 0;
        self.evaluate_stretch(needed);
        let offer = self.search()?;
        // An arm that plumbline does not drive is watched without an end.
        if self.log.events.len() > self.written_events {
            self.write()?;
        }
        Ok(offer)
    }

    /// What is new about the served model.
    pub fn verdict(&mut self) -> Option<Verdict> {
        self.verdict.take()
    }

    /// Clears the buffer after missing samples.
    pub fn clear(&mut self) {
        self.buffer.clear();
        self.samples_since_stretch = 0;
    }

    /// Processes the daemon's status: a proposal that is neither pending nor served was rejected.
    pub fn process_status(&mut self, status: &Status) {
        let Some((proposed, _)) = self.proposed else { return };
        if status.offered.is_none() && status.model != proposed {
            tracing::info!("the proposed model was rejected; the watch is silent until the served one holds again");
            let t = self.now();
            self.log.events.push(Event::Rejected { t });
            (self.proposed, self.change, self.silent) = (None, None, true);
        }
    }

    /// Writes `live.json` and returns notes for the report.
    pub fn finish(&mut self) -> Result<Vec<String>, Failure> {
        self.write()?;
        Ok(std::mem::take(&mut self.notes))
    }

    fn write(&mut self) -> Result<(), Failure> {
        self.written_events = self.log.events.len();
        let text = serde_json::to_string_pretty(&self.log).map_err(Failure::job)? + "\n";
        crate::atomic::write_result(&self.out.join("live.json"), text.as_bytes())
    }

    fn now(&self) -> f64 {
        self.buffer.back().map_or(0.0, |record| record.state.time)
    }

    /// Maximum number of samples that the preparation removes at each end.
    fn edge(&self) -> usize {
        self.samples(0.5)
    }

    fn handle_served_model(&mut self, record: &Record) {
        let t = record.state.time;
        self.log.events.push(Event::Served { t, model: hex(record.model) });
        if self.serving != 0 {
            tracing::info!("from {t:.1} s on the loop serves model {:016x}", record.model);
            self.notes.push(format!("live: from {t:.1} s on the loop served model {:016x}", record.model));
        }
        let for_it = |change: &Change| self.proposed.is_some_and(|(_, since)| since == change.since);
        self.change = self.change.map(|change| {
            // Another change has come since the model was proposed.
            let before = if change.before != self.serving || for_it(&change) { change.before } else { record.model };
            Change { before, doubted: None, ..change }
        });
        self.serving = record.model;
        // What came on top of an unexplained error leaves that.
        let beside = self.proposed.zip(self.unexplained).is_some_and(|((_, since), before)| since > before);
        self.unexplained = self.unexplained.filter(|_| beside);
        self.proposed = None;
        self.silent = false;
        self.watch.iter_mut().for_each(if beside { Watch::look_beside_again } else { Watch::reset });
        let still = |since: f64| format!("since {since:.1} s there is an error that no known change explains");
        if let Some(since) = self.unexplained {
            self.verdict = Some(Verdict { model: record.model, doubt: Some(still(since)) });
        }
    }

    /// Evaluates the last stretch without filter transients.
    fn evaluate_stretch(&mut self, needed: usize) {
        let first = self.buffer.len() - needed;
        let Some(experiment) = self.prepared(first, self.buffer.len()) else { return };
        let Some(known) = self.models.iter().find(|known| known.id == self.serving) else { return };
        let residual = live::residual(&known.model, &experiment);
        let (count, ends) = (residual.nrows(), self.samples(END_MARGIN_S));
        let Some(start) = count.checked_sub(self.samples(STRETCH_S) + ends) else { return };
        let stretch = start..start + self.samples(STRETCH_S);
        let rms = live::rms(&residual, stretch.clone());
        let of_changes = live::spread(&known.deviations, &experiment, stretch.clone());
        let structure = self.models[0].model.structure();
        let of_parameters = live::parameter_spread(structure, &self.covariance, &experiment, stretch);
        let spread: Vec<f64> = of_changes.iter().zip(&of_parameters).map(|(one, other)| one.hypot(*other)).collect();
        // The preparation removes the same number at both ends.
        let cut = needed.saturating_sub(count) / 2;
        let begin = self.buffer[first].state.time + (cut + start) as f64 * self.period;
        let end = begin + STRETCH_S;
        let served_rms = self.served(begin, end);
        let model = hex(self.serving);
        self.log.stretches.push_back(Stretch { start: begin, end, model, rms: rms.clone(), served_rms });
        if self.log.stretches.len() > MAX_LOGGED_STRETCHES {
            self.log.stretches.pop_front();
        }
        let Some(news) = self.watch.as_mut().and_then(|watch| watch.look_within(begin, &rms, &spread)) else { return };
        match news {
            News::Lost { since, joint, floor, .. } => {
                let rms = rms[joint];
                let since = self.onset(since).unwrap_or(since);
                // Another change than the one that was found, if any; or that was found from too few samples.
                let refined = |change: &Change| change.before != self.serving;
                self.change = Some(match self.change.filter(refined) {
                    Some(change) => Change { doubted: Some(since), ..change },
                    None => Change::new(since, self.serving, self.window),
                });
                tracing::warn!(
                    "since {since:.1} s the served model does not hold: joint {} has an error of {rms:.3} Nm, usually {floor:.3}",
                    joint + 1
                );
                let doubt =
                    format!("since {since:.1} s joint {} has an error of {rms:.3} Nm, usually {floor:.3}", joint + 1);
                self.verdict = Some(Verdict { model: self.serving, doubt: Some(doubt) });
                self.log.events.push(Event::Lost { t: self.now(), since, joint: joint + 1, rms, usual: floor });
                self.notes.push(format!(
                    "live: since {since:.1} s the served model did not hold: {rms:.3} Nm in joint {}, usually {floor:.3}",
                    joint + 1
                ));
            }
            News::Holds { since } => {
                tracing::info!("since {since:.1} s the served model holds again");
                self.log.events.push(Event::Holds { t: self.now(), since });
                (self.change, self.proposed, self.silent, self.unexplained) = (None, None, false, None);
                self.verdict = Some(Verdict { model: self.serving, doubt: None });
            }
        }
    }

    /// When the change came that an alarm since about `alarm` \[s\] is about.
    fn onset(&self, alarm: f64) -> Option<f64> {
        let first = self.buffer.partition_point(|record| record.state.time < alarm - ONSET_WINDOW_S);
        let experiment = self.prepared(first, self.buffer.len())?;
        let residual = live::residual(self.model(self.serving)?, &experiment);
        let cut = (self.buffer.len() - first).saturating_sub(residual.nrows()) / 2;
        // The low-pass has transients at both ends.
        let ends = self.samples(END_MARGIN_S).min(residual.nrows() / 3);
        let inside = residual.rows(ends, residual.nrows() - 2 * ends).into_owned();
        let at = onset(&inside, &self.watch.as_ref()?.floor().usual, self.samples(0.5 * STRETCH_S));
        Some(self.buffer[first + cut + ends + at].state.time)
    }

    fn model(&self, id: u64) -> Option<&TorqueModel> {
        self.models.iter().find(|known| known.id == id).map(|known| &known.model)
    }

    /// Samples of the buffer as one prepared motion; `None` if they are too few or mostly at rest.
    fn prepared(&self, first: usize, end: usize) -> Option<Experiment> {
        let records: Vec<Record> = self.buffer.range(first..end).copied().collect();
        let run = plumbline_identify::Run::from_records("live", &records, self.joints, self.mounting, None);
        let experiment = Experiment::prepare(&run, &self.settings).ok()?;
        let resting = experiment.resting().iter().filter(|rests| **rests).count();
        (2 * resting < experiment.resting().len()).then_some(experiment)
    }

    /// First sample of the buffer that a change at `since` \[s\] acts on, beyond its margin.
    fn after(&self, since: f64) -> usize {
        self.buffer.partition_point(|record| record.state.time < since + CHANGE_MARGIN_S)
    }

    /// Number of records in a time.
    fn samples(&self, seconds: f64) -> usize {
        states(seconds, self.period) as usize
    }

    /// RMS of measured minus served torque between two moments, per joint \[Nm\]; empty where no torque was served along the motion.
    fn served(&self, begin: f64, end: f64) -> Vec<f64> {
        let within = |r: &&Record| {
            (begin..end).contains(&r.state.time) && matches!(r.validity, Validity::Valid | Validity::Doubtful)
        };
        let chosen: Vec<&Record> = self.buffer.iter().filter(within).collect();
        if chosen.is_empty() {
            return Vec::new();
        }
        let square = |j: usize| chosen.iter().map(|r| (r.state.tau[j] - r.command.tau_ff.0[j]).powi(2)).sum::<f64>();
        (0..self.joints).map(|j| (square(j) / chosen.len().max(1) as f64).sqrt()).collect()
    }
}

fn hex(model: u64) -> String {
    format!("{model:016x}")
}

fn list(values: &[f64]) -> String {
    values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ")
}
