//! Live watch of the estimator: monitors the residual of the served model, detects changes and proposes a new model.

use crate::analysis::pipeline;
use crate::config::job::{Adopt, Job};
use crate::dataset::Run;
use crate::failure::Failure;
use crate::report::diagnosis::Effect;
use crate::store::{ModelFile, Provenance, model_identity};
use plumbline_core::{Phase, Record, Validity, threads};
use plumbline_diagnose::live;
use plumbline_diagnose::live::{END_MARGIN_S, Floor, Found, News, Remedy, STRETCH_S, Watch};
use plumbline_diagnose::reference::Change;
use plumbline_identify::{Experiment, Settings};

use plumbline_ipc::{Proposal, Status};
use plumbline_model::{Mounting, Robot, TorqueModel};
use serde::Serialize;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::thread::JoinHandle;

/// Time between records \[s\].
const SAMPLE_PERIOD_S: f64 = 1e-3;
/// Length of the identification motion from which the usual error is computed \[s\].
const CALIBRATION_S: f64 = 20.0;
/// Largest speed of a joint at rest \[rad/s\].
const REST_SPEED: f64 = 0.01;
const MAX_LOGGED_STRETCHES: usize = 10_000;

/// A model for the daemon, with the reason.
pub struct OfferedModel {
    pub toml: String,
    pub proposal: Proposal,
}

/// Content of `live.json`.
#[derive(Default, Serialize)]
struct Log {
    /// Usual error at the identification, and alarm threshold, per joint \[Nm\].
    usual: Vec<f64>,
    limit: Vec<f64>,
    events: Vec<Event>,
    stretches: VecDeque<Stretch>,
}

/// An event, with the time of the arm \[s\].
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
enum Event {
    /// The error exceeds the alarm threshold.
    Lost {
        t: f64,
        since: f64,
        joint: usize,
        rms: f64,
        usual: f64,
    },
    /// The error is below the threshold again.
    Holds {
        t: f64,
        since: f64,
    },
    Proposed {
        t: f64,
        model: String,
        what: String,
        effects: Vec<Effect>,
        before: Vec<f64>,
        after: Vec<f64>,
    },
    /// No change was found that lowers the error.
    Unexplained {
        t: f64,
        tried: usize,
        rms: Vec<f64>,
    },
    Served {
        t: f64,
        model: String,
    },
    Rejected {
        t: f64,
    },
}

/// Errors over a stretch, per joint \[Nm\]: of the model along the measured motion after the low-pass, and of the torque that was
/// served, raw.
#[derive(Serialize)]
struct Stretch {
    start: f64,
    end: f64,
    model: String,
    rms: Vec<f64>,
    served_rms: Vec<f64>,
}

struct Search {
    /// Start of the search, and start of the alarm \[s\].
    t: f64,
    since: f64,
    model: u64,
    found: JoinHandle<Found>,
}

pub struct Live {
    adopt: Adopt,
    window: f64,
    joints: usize,
    robot: Robot,
    settings: Settings,
    mounting: Mounting,
    out: PathBuf,
    noise_floor: Vec<f64>,
    /// Models by identity: the identified one and those that were proposed.
    models: Vec<(u64, TorqueModel)>,
    watch: Option<Watch>,
    /// Identity of the model that the records in the buffer were served with.
    serving: u64,
    /// Samples of one motion without a gap.
    buffer: VecDeque<Record>,
    samples_since_stretch: usize,
    /// Earliest time of the next search \[s\].
    not_before: f64,
    /// Whether searches block, as in simulated time, which would otherwise run ahead.
    wait_for_search: bool,
    searching: Option<Search>,
    /// Identity of the model that was proposed to the daemon.
    proposed: Option<u64>,
    log: Log,
    notes: Vec<String>,
}

impl Live {
    /// A live watch, which starts with the first model; `None` if disabled.
    pub fn new(job: &Job, robot: &Robot, out: &Path) -> Option<Live> {
        job.live.watch.then(|| Live {
            adopt: job.live.adopt,
            window: job.live.window,
            joints: robot.chain.len(),
            robot: robot.clone(),
            settings: Settings { rest: Some(REST_SPEED), ..job.settings() },
            mounting: job.mounting,
            out: out.to_path_buf(),
            noise_floor: Vec::new(),
            models: Vec::new(),
            watch: None,
            serving: 0,
            buffer: VecDeque::new(),
            samples_since_stretch: 0,
            not_before: 0.0,
            wait_for_search: job.backend.is_fast(),
            searching: None,
            proposed: None,
            log: Log::default(),
            notes: Vec::new(),
        })
    }

    /// Stores the model identified from `run`, and its usual error.
    pub fn identified(
        &mut self,
        model: &TorqueModel,
        noise_floor: &[f64],
        text: &str,
        run: &Run,
    ) -> Result<(), Failure> {
        let samples = run.samples().min((CALIBRATION_S / SAMPLE_PERIOD_S) as usize);
        let part = plumbline_identify::Run { period: None, ..run.data.part(0, samples) };
        let floor = Floor::of(model, &pipeline::experiment(&part, &self.settings)?);
        (self.log.usual, self.log.limit) = (floor.usual.clone(), floor.limit.clone());
        self.noise_floor = noise_floor.to_vec();
        self.models = vec![(model_identity(text), model.clone())];
        self.watch = Some(Watch::new(floor));
        Ok(())
    }

    /// Processes a record; returns a model to propose, if there is one.
    pub fn update(&mut self, record: &Record) -> Result<Option<OfferedModel>, Failure> {
        let known = self.models.iter().any(|(id, _)| *id == record.model);
        if record.phase != Phase::Excite || !known {
            self.clear();
            return Ok(None);
        }
        if self.serving != record.model {
            self.handle_served_model(record);
        }
        if self.buffer.back().is_some_and(|before| before.motion != record.motion) {
            self.clear();
        }
        self.buffer.push_back(*record);
        self.samples_since_stretch += 1;
        if self.buffer.len() > samples(self.window + 4.0 * STRETCH_S) {
            self.buffer.pop_front();
        }
        let needed = samples(STRETCH_S + 2.0 * END_MARGIN_S) + 2 * self.edge();
        if self.samples_since_stretch < samples(STRETCH_S) || self.buffer.len() < needed {
            return Ok(None);
        }
        self.samples_since_stretch = 0;
        self.evaluate_stretch(needed);
        self.search()
    }

    /// Clears the buffer after missing samples.
    pub fn clear(&mut self) {
        self.buffer.clear();
        self.samples_since_stretch = 0;
    }

    /// Processes the daemon's status: a proposal that is neither pending nor served was rejected.
    pub fn process_status(&mut self, status: &Status) {
        let Some(proposed) = self.proposed else { return };
        if status.offered.is_none() && status.model != proposed {
            tracing::info!("the proposed model was rejected; the watch is silent until the served one holds again");
            let t = self.now();
            self.log.events.push(Event::Rejected { t });
            (self.proposed, self.not_before) = (None, f64::INFINITY);
        }
    }

    /// Writes `live.json` and returns notes for the report.
    pub fn finish(&mut self) -> Result<Vec<String>, Failure> {
        self.write()?;
        Ok(std::mem::take(&mut self.notes))
    }

    fn write(&self) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(&self.log).map_err(Failure::job)? + "\n";
        crate::atomic::write_result(&self.out.join("live.json"), text.as_bytes())
    }

    fn now(&self) -> f64 {
        self.buffer.back().map_or(0.0, |record| record.state.time)
    }

    /// Maximum number of samples that the preparation removes at each end.
    fn edge(&self) -> usize {
        samples(0.5)
    }

    fn handle_served_model(&mut self, record: &Record) {
        let t = record.state.time;
        self.log.events.push(Event::Served { t, model: hex(record.model) });
        if self.serving != 0 {
            tracing::info!("from {t:.1} s on the loop serves model {:016x}", record.model);
            self.notes.push(format!("live: from {t:.1} s on the loop served model {:016x}", record.model));
        }
        self.serving = record.model;
        self.proposed = None;
        self.not_before = t;
        self.watch.iter_mut().for_each(Watch::reset);
        self.clear();
    }

    /// Evaluates the last stretch without filter transients.
    fn evaluate_stretch(&mut self, needed: usize) {
        let first = self.buffer.len() - needed;
        let Some(experiment) = self.prepared(first, self.buffer.len()) else { return };
        let Some(model) = self.model() else { return };
        let residual = live::residual(model, &experiment);
        let (count, ends) = (residual.nrows(), samples(END_MARGIN_S));
        let Some(start) = count.checked_sub(samples(STRETCH_S) + ends) else { return };
        let rms = live::rms(&residual, start..start + samples(STRETCH_S));
        // The preparation removes the same number at both ends.
        let cut = needed.saturating_sub(count) / 2;
        let begin = self.buffer[first].state.time + (cut + start) as f64 * SAMPLE_PERIOD_S;
        let end = begin + STRETCH_S;
        let served_rms = self.served(begin, end);
        let model = hex(self.serving);
        self.log.stretches.push_back(Stretch { start: begin, end, model, rms: rms.clone(), served_rms });
        if self.log.stretches.len() > MAX_LOGGED_STRETCHES {
            self.log.stretches.pop_front();
        }
        let Some(news) = self.watch.as_mut().and_then(|watch| watch.look(begin, end, &rms)) else { return };
        match news {
            News::Lost { since, joint, rms, floor } => {
                tracing::warn!(
                    "since {since:.1} s the served model does not hold: joint {} has an error of {rms:.3} Nm, usually {floor:.3}",
                    joint + 1
                );
                self.log.events.push(Event::Lost { t: end, since, joint: joint + 1, rms, usual: floor });
                self.notes.push(format!(
                    "live: since {since:.1} s the served model did not hold: {rms:.3} Nm in joint {}, usually {floor:.3}",
                    joint + 1
                ));
            }
            News::Holds { since } => {
                tracing::info!("since {since:.1} s the served model holds again");
                self.log.events.push(Event::Holds { t: end, since });
                self.not_before = end;
            }
        }
    }

    /// Searches for a change once the alarm has lasted for the window.
    fn search(&mut self) -> Result<Option<OfferedModel>, Failure> {
        let Some(since) = self.watch.as_ref().and_then(Watch::lost_since) else { return Ok(None) };
        let now = self.now();
        if self.proposed.is_some() || self.searching.is_some() || now < self.not_before {
            return Ok(None);
        }
        // The change lies in the first stretch above the threshold.
        let after = self.buffer.partition_point(|record| record.state.time < since + STRETCH_S);
        if self.buffer.len() - after < samples(self.window) {
            return Ok(None);
        }
        let middle = after + live::divide(self.buffer.len() - after);
        let parts = (self.prepared(after, middle), self.prepared(middle, self.buffer.len()));
        let ((Some(find), Some(judge)), Some(model)) = (parts, self.model()) else { return Ok(None) };
        let threads = threads();
        let settings = plumbline_diagnose::Settings { threads, ..plumbline_diagnose::Settings::default() };
        let model = model.clone();
        // The search has its own thread: samples have to be acknowledged meanwhile.
        let found = std::thread::spawn(move || live::search(&model, &find, &judge, &settings));
        self.searching = Some(Search { t: now, since, model: self.serving, found });
        self.collect(self.wait_for_search)
    }

    /// Returns the result of an ended search; with `wait`, blocks until its end.
    pub fn collect(&mut self, wait: bool) -> Result<Option<OfferedModel>, Failure> {
        let Some(Search { t, since, model, found }) = self.searching.take_if(|one| wait || one.found.is_finished())
        else {
            return Ok(None);
        };
        let found = found.join().map_err(|_| Failure::job("the search for a change panicked"))?;
        if model != self.serving {
            return Ok(None);
        }
        let offer = match found {
            Found::Remedy(remedy) => Some(self.propose(t, since, *remedy)?),
            Found::Nothing { tried, before } => {
                tracing::warn!("no known change explains the error of {}", list(&before));
                self.log.events.push(Event::Unexplained { t, tried, rms: before });
                self.not_before = t + self.window;
                None
            }
        };
        self.write()?;
        Ok(offer)
    }

    fn propose(&mut self, t: f64, since: f64, remedy: Remedy) -> Result<OfferedModel, Failure> {
        let Remedy { changes, model, before, after } = remedy;
        let what = changes.iter().map(Change::line).collect::<Vec<_>>().join("; ");
        let source = format!("live, since {since:.1} s: {what}");
        let file = ModelFile {
            model,
            noise_floor: self.noise_floor.clone(),
            validation: Vec::new(),
            uncertainty: None,
            consistent: None,
            provenance: Provenance { source: Some(source), ..crate::analysis::provenance(&self.robot, None) },
        };
        let toml = file.to_toml();
        crate::atomic::write_result(&self.out.join("model-live.toml"), toml.as_bytes())?;
        let worst = (0..self.joints).max_by(|&a, &b| before[a].total_cmp(&before[b])).unwrap_or(0);
        let effects = self.effects(&changes);
        let id = model_identity(&toml);
        let asks = if self.adopt == Adopt::Ask { ", if adopted" } else { "" };
        self.notes.push(format!(
            "live: {what}; error in joint {} {:.3} -> {:.3} Nm with model {id:016x}{asks}",
            worst + 1,
            before[worst],
            after[worst]
        ));
        let (of_worst, left) = (before[worst], after[worst]);
        let model = hex(id);
        self.log.events.push(Event::Proposed { t, model, what: what.clone(), effects, before, after });
        self.models.push((id, file.model));
        self.proposed = Some(id);
        let proposal = Proposal { what, since, joint: worst + 1, before: of_worst, after: left };
        Ok(OfferedModel { toml, proposal })
    }

    fn effects(&self, changes: &[Change]) -> Vec<Effect> {
        let Some(model) = self.model() else { return Vec::new() };
        changes.iter().map(|change| change.effect(model, Some(&self.mounting), true)).collect()
    }

    fn model(&self) -> Option<&TorqueModel> {
        self.models.iter().find(|(id, _)| *id == self.serving).map(|(_, model)| model)
    }

    /// Samples of the buffer as one prepared motion; `None` if they are too few or mostly at rest.
    fn prepared(&self, first: usize, end: usize) -> Option<Experiment> {
        let records: Vec<Record> = self.buffer.range(first..end).copied().collect();
        let run = plumbline_identify::Run::from_records("live", &records, self.joints, self.mounting, None);
        let experiment = Experiment::prepare(&run, &self.settings).ok()?;
        let resting = experiment.resting().iter().filter(|rests| **rests).count();
        (2 * resting < experiment.resting().len()).then_some(experiment)
    }

    /// RMS of measured minus served torque between two moments, per joint \[Nm\].
    fn served(&self, begin: f64, end: f64) -> Vec<f64> {
        let within = |r: &&Record| (begin..end).contains(&r.state.time) && r.validity == Validity::Valid;
        let chosen: Vec<&Record> = self.buffer.iter().filter(within).collect();
        let square = |j: usize| chosen.iter().map(|r| (r.state.tau[j] - r.command.tau_ff.0[j]).powi(2)).sum::<f64>();
        (0..self.joints).map(|j| (square(j) / chosen.len().max(1) as f64).sqrt()).collect()
    }
}

fn samples(seconds: f64) -> usize {
    (seconds / SAMPLE_PERIOD_S).round() as usize
}

fn hex(model: u64) -> String {
    format!("{model:016x}")
}

fn list(values: &[f64]) -> String {
    values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ")
}
