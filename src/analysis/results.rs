//! Results of a job: identifies, validates, and writes model, dataset and report.

use crate::analysis::collector::Recorded;
use crate::analysis::diagnosis::{self, Diagnosed, Question};
use crate::analysis::drawn::{self, Durations};
use crate::analysis::excitation::Excitation;
use crate::analysis::next;
use crate::analysis::pipeline::{self, Identified, Judged};
use crate::config::job::{Diagnosis, Job};
use crate::dataset::columns::SERVED_TORQUES;
use crate::dataset::{self, Dataset, Run};
use crate::failure::Failure;
use crate::process::progress;
use crate::report::figures::Figures;
use crate::report::{
    Base, Consistency, CounterExperiment, EstimatorFacts, Fit, GravityReport, Identifiability, IpcReport, LoopReport,
    MotionUsage, Report, Round, Validation, provenance,
};
use crate::setup::planner::Planner;
use crate::setup::programme::{Motion, Planned, Programme, Role, arm_limits, is_reached};
use crate::store::{ModelFile, Provenance, Validated, save_plan, uncertainty_of};
use plumbline_core::{Record, threads};
use plumbline_diagnose::errors::Of;
use plumbline_excite::{Fourier, Search};
use plumbline_identify::Settings;
use plumbline_identify::solve::Outcome;
use plumbline_ipc::{Status, StreamCounters};
use plumbline_model::{Mounting, Robot};
use std::path::{Path, PathBuf};

/// Recorded motions of a job, and the identified model.
pub struct Results {
    job: Job,
    robot: Robot,
    settings: Settings,
    out: PathBuf,
    plan: Option<Planned>,
    motions: Vec<MotionUsage>,
    recorded: Vec<Recorded>,
    /// Begin of the first of them on the arm's clock \[s\].
    clock: Option<f64>,
    model: Option<Identified>,
    /// Number of the motion after which the model of an arm that plumbline does not drive is identified.
    last_unplanned: Option<u32>,
    notes: Vec<String>,
    /// The rounds before this one.
    rounds: Vec<Round>,
    /// The command that the report names.
    command: Option<String>,
    durations: Durations,
}

impl Results {
    pub fn new(job: &Job, robot: &Robot, programme: &Programme, out: &Path) -> Results {
        let identify = || programme.motions().filter(|motion| motion.role == Role::Identify);
        Results {
            job: job.clone(),
            robot: robot.clone(),
            settings: job.settings(),
            out: out.to_path_buf(),
            plan: identify().find_map(|motion| motion.planned().cloned()),
            last_unplanned: identify().filter(|motion| motion.planned().is_none()).last().map(|motion| motion.number),
            motions: programme.motions().filter_map(usage).collect(),
            recorded: Vec::new(),
            clock: None,
            model: None,
            notes: Vec::new(),
            rounds: Vec::new(),
            command: None,
            durations: Durations::default(),
        }
    }

    /// Counts the loop's durations.
    pub fn time(&mut self, record: &Record) {
        self.durations.add(record);
    }

    /// The command that the results are of.
    pub fn made_by(&mut self, command: &str) {
        self.command = Some(command.to_string());
    }

    /// Goes on from the results of the round before: its runs are identified from and judged by, too.
    pub fn go_on_from(&mut self, dir: &Path) -> Result<(), Failure> {
        let report = Report::read(dir)?;
        let diagnosis = report.diagnosis.unwrap_or_default();
        self.rounds = report.rounds;
        self.rounds.push(Round::of(&diagnosis));
        for run in Dataset::read(&dir.join("dataset"))?.runs {
            let role = match run.role {
                dataset::Role::Identify => Role::Identify,
                dataset::Role::Validate => Role::Validate,
            };
            self.recorded.push(Recorded { number: 0, role, run, complete: true, ends: true });
        }
        Ok(())
    }

    pub fn joints(&self) -> usize {
        self.robot.chain.len()
    }

    /// Whether the job measures the direction of gravity.
    pub fn has_inclinometer(&self) -> bool {
        self.job.inclinometer.is_some()
    }

    /// The mounting of the first motion that was recorded.
    pub fn first_mounting(&self) -> Option<Mounting> {
        self.recorded.first().map(|recorded| recorded.run.data.mounting)
    }

    pub fn take(&mut self, mut recorded: Recorded) {
        let name = &mut recorded.run.data.name;
        if !self.rounds.is_empty() {
            name.push_str(&format!("-round-{}", self.rounds.len() + 1));
        }
        name.push_str(self.job.output.dataset_format.ending());
        // A daemon that was started again may have another clock, as that of a further round has.
        let end = self.recorded.last().map_or(0.0, |last| last.run.end());
        let began = recorded.run.start;
        let first = *self.clock.get_or_insert(began - end);
        recorded.run.start = f64::max(began - first, end);
        tracing::info!(
            "{} was recorded: {} samples, the first at {began:.3} s of the arm's clock",
            recorded.run.data.name,
            recorded.run.samples()
        );
        self.recorded.push(recorded);
    }

    /// Identifies the model from the identification motions and writes `model.toml`; returns the text to offer to the daemon.
    ///
    /// The motion of an arm that plumbline does not drive cannot be had again: where it does not identify a model, its dataset is kept.
    pub fn identify(&mut self) -> Result<String, Failure> {
        let runs = self.runs(Role::Identify);
        let identified = match self.identified_from(&runs) {
            Err(failure) if self.last_unplanned.is_some() => {
                let dir = self.out.join("dataset");
                self.dataset().write(&dir).map_err(Failure::job)?;
                tracing::error!(
                    "no model is identified from what was recorded; the recording is kept in {}",
                    dir.display()
                );
                return Err(failure);
            }
            identified => identified?,
        };
        if self.last_unplanned.is_some() {
            let excitation = self.excitation(&identified);
            let words = excitation.words(&self.plan_command());
            if excitation.is_poor() { tracing::warn!("{words}") } else { tracing::info!("{words}") }
        }
        let file = self.model_file(&identified, Vec::new(), None);
        let text = file.to_toml();
        crate::atomic::write_result(&self.out.join("model.toml"), text.as_bytes())?;
        self.model = Some(identified);
        Ok(text)
    }

    /// Whether a model is identified after the motion with this number: after each one that plumbline drives, after the last one that it does
    /// not.
    pub fn identifies_after(&self, recorded: &Recorded) -> bool {
        let is_last = self.last_unplanned.is_none_or(|last| recorded.ends && recorded.number == last);
        recorded.role == Role::Identify && is_last
    }

    /// Whether runs of an arm that plumbline does not drive have no model yet, because the recording was ended before the last of them.
    pub fn awaits_model(&self) -> bool {
        self.last_unplanned.is_some() && self.model.is_none() && !self.runs(Role::Identify).is_empty()
    }

    /// The model and the first run that it was identified from.
    pub fn identified(&self) -> Option<(&Identified, &Run)> {
        self.model.as_ref().zip(self.runs(Role::Identify).first().copied())
    }

    pub fn note(&mut self, note: String) {
        self.notes.push(note);
    }

    /// Validates the model and writes all results. `sent` is the number of samples of the whole programme.
    pub fn finish(&mut self, status: &Status, sent: u64, counters: &StreamCounters) -> Result<(), Failure> {
        let Some(identified) = self.model.take() else {
            return Err(Failure::job("the programme has ended, but no identification motion was recorded"));
        };
        let dataset = self.dataset();
        let plain = identified;
        let mut diagnosed = self.diagnose(&plain)?;
        if let Some(diagnosed) = &mut diagnosed {
            self.plan_next(diagnosed)?;
        }
        // From here on the model contains the accepted effects.
        let identified = diagnosed.as_ref().map_or(&plain, |diagnosed| &diagnosed.after);
        let judged = pipeline::judge_all(&identified.model, &self.runs(Role::Validate), &self.settings)?;
        let counter = self.counter_experiment(&judged)?;
        let validated = judged.iter().map(|(run, judged)| Validated {
            run: run.data.name.clone(),
            rho: run.data.mounting.rho,
            phi: run.data.mounting.phi,
            rms: judged.rms.raw.clone(),
        });
        let model = self.model_file(identified, validated.collect(), Some(dataset.content_hash()));
        crate::atomic::write_result(&self.out.join("model.toml"), model.to_toml().as_bytes())?;
        if diagnosed.as_ref().is_some_and(|diagnosed| diagnosed.block.grows()) {
            // The served model.
            let served = self.model_file(&plain, Vec::new(), Some(dataset.content_hash()));
            crate::atomic::write_result(&self.out.join("model-plain.toml"), served.to_toml().as_bytes())?;
        }
        if let Some((_, vertical)) = &counter {
            crate::atomic::write_result(&self.out.join("model-vertical.toml"), vertical.to_toml().as_bytes())?;
        }
        let mut report = report_of(identified, self.job.mounting, &model.provenance);
        report.provenance.insert(provenance::SOURCE.into(), provenance::source(&self.job.file).into());
        if let Some(command) = &self.command {
            report.provenance.insert(provenance::COMMAND.into(), command.clone().into());
        }
        report.validate = judged.iter().map(|(run, judged)| validation(run, judged)).collect();
        report.consistency = model.consistent.as_ref().map(|found| Consistency::of_model(&model.model, found));
        report.counter_experiment = counter.map(|(facts, _)| facts);
        report.gravity = status.gravity.as_ref().and_then(|gravity| {
            let runs = self.recorded.iter().map(|own| (own.number, own.run.data.name.as_str(), own.run.data.mounting));
            GravityReport::new(gravity, self.job.mounting, runs)
        });
        report.motions = self.motions.clone();
        report.rounds = self.rounds.clone();
        match &status.guest {
            Some(guest) => {
                report.guest = Some(guest.counts);
                let excitation = self.excitation(&plain);
                report.notes.push(excitation.words(&self.plan_command()));
                report.identifiability.weakly_determined = excitation.weak;
            }
            None => report.control_loop = Some(LoopReport::new(status, !self.job.backend.is_fast())),
        }
        report.ipc = Some(IpcReport { sent, counters: *counters });
        report.notes.extend(self.notes.iter().cloned());
        let mut figures = self.figures(identified, judged)?;
        if let Some(diagnosed) = diagnosed {
            report.diagnosis = Some(diagnosed.block);
            figures.diagnosis = diagnosed.figures;
        }
        report.write(&self.out, &figures).map_err(Failure::job)?;
        // The largest of the results comes last: a full disk does not cost the others.
        if self.job.output.dataset {
            progress::bar("writing").busy("the dataset");
            dataset.write(&self.out.join("dataset")).map_err(Failure::job)?;
        }
        Ok(())
    }

    /// What a motion that was not planned excites.
    fn excitation(&self, of: &Identified) -> Excitation {
        let gravity = self.job.mounting.gravity();
        Excitation::of(&of.identification, of.model.structure(), &self.robot.limits, gravity)
    }

    /// The command that plans a motion for the job's arm.
    fn plan_command(&self) -> String {
        let Mounting { rho, phi } = self.job.mounting;
        let name = self.job.mounting.to_string();
        let mounting = match name.contains(' ') {
            true => format!("\"{:.3} deg,{:.3} deg\"", rho.to_degrees(), phi.to_degrees()),
            false => name,
        };
        format!(
            "`plumbline plan --robot {} --mounting {mounting} --out plan.toml` plans one that determines all",
            self.job.robot
        )
    }

    /// Diagnosis, if enabled: found on the identification set, evaluated on the validation set.
    fn diagnose(&self, identified: &Identified) -> Result<Option<Diagnosed>, Failure> {
        if !self.job.diagnosis.enabled {
            return Ok(None);
        }
        let (identify, unseen) = (self.runs(Role::Identify), self.runs(Role::Validate));
        let unseen: Vec<&Run> =
            unseen.into_iter().filter(|run| identified.model.valid_in(&run.data.mounting).is_ok()).collect();
        let Diagnosis { band, threshold, until, .. } = self.job.diagnosis;
        let settings = plumbline_diagnose::Settings {
            band,
            threshold,
            until,
            threads: threads(),
            ..plumbline_diagnose::Settings::default()
        };
        let question = Question {
            robot: &self.robot,
            structure: identified.model.structure(),
            identify: &identify,
            unseen: &unseen,
            settings: &self.settings,
            options: &self.job.solver(),
            diagnosis: &settings,
            of: Of::Raw,
        };
        diagnosis::run(&question).map(Some)
    }

    /// Writes the plan of the next round, where there is to be one and something is left open.
    fn plan_next(&self, diagnosed: &mut Diagnosed) -> Result<(), Failure> {
        if self.job.diagnosis.rounds == 0 || diagnosed.open.questions().len() == 0 {
            return Ok(());
        }
        let arm = arm_limits(&self.out)?;
        let planner = Planner::of(&self.job, &self.robot, arm.as_ref())?;
        let usable = |fourier: &Fourier| is_reached(&planner, &fourier.q0);
        let (plan, questions) = planner.next(&self.job.mounting, |problem, search| {
            // A motion that the job names may have another period than one that it plans.
            let period = self.runs(Role::Identify).first().and_then(|run| run.data.period).unwrap_or(search.period);
            let search = Search { period, starts: next::STARTS, rounds: next::ROUNDS, ..search.clone() };
            next::next(&diagnosed.open, problem, &search, self.job.excitation.periods, &usable, &|| false)
        })?;
        diagnosed.block.open = questions;
        let Some(plan) = plan else {
            let note = "no motion within the limits of this job is expected to answer what is open; no further round is driven";
            diagnosed.block.notes.push(note.into());
            return Ok(());
        };
        save_plan(&plan, &self.out.join(next::FILE)).map_err(Failure::job)
    }

    fn runs(&self, role: Role) -> Vec<&Run> {
        self.recorded.iter().filter(|recorded| recorded.role == role).map(|recorded| &recorded.run).collect()
    }

    fn identified_from(&self, runs: &[&Run]) -> Result<Identified, Failure> {
        let terms = pipeline::plain_terms(&self.robot);
        pipeline::identify(&self.robot, runs, &terms, &self.settings, &self.job.solver())
    }

    /// Errors of the vertical base set in another mounting.
    fn counter_experiment(&self, judged: &[(&Run, Judged)]) -> Result<Option<(CounterExperiment, ModelFile)>, Failure> {
        let runs = self.runs(Role::Counter);
        let Some(first) = runs.first() else { return Ok(None) };
        let vertical = self.identified_from(&runs)?;
        let Err(refused) = vertical.model.valid_in(&self.job.mounting) else { return Ok(None) };
        let here: Vec<&(&Run, Judged)> =
            judged.iter().filter(|(run, _)| run.data.mounting == self.job.mounting).collect();
        let mut forced = vec![0.0; self.joints()];
        let mut general = forced.clone();
        for (run, judged) in &here {
            let wrong = pipeline::judge(&vertical.model, run, &self.settings)?;
            for j in 0..self.joints() {
                forced[j] += wrong.rms.raw[j] / here.len() as f64;
                general[j] += judged.rms.raw[j] / here.len() as f64;
            }
        }
        let facts = CounterExperiment {
            identified_in: first.data.mounting.into(),
            kind: vertical.model.kind().to_string(),
            count: vertical.model.parameters().len(),
            refused_in: self.job.mounting.into(),
            refusal: refused.to_string(),
            forced_rms: forced,
            general_rms: general,
        };
        Ok(Some((facts, self.model_file(&vertical, Vec::new(), None))))
    }

    fn model_file(&self, identified: &Identified, validation: Vec<Validated>, hash: Option<String>) -> ModelFile {
        ModelFile {
            model: identified.model.clone(),
            noise_floor: identified.identification.rms.noise_floor.clone().unwrap_or_default(),
            validation,
            uncertainty: uncertainty_of(
                &identified.identification,
                &identified.model,
                identified.residual_spectrum.clone(),
            ),
            consistent: pipeline::real_bodies(identified),
            provenance: crate::analysis::provenance(&self.robot, hash),
        }
    }

    fn dataset(&self) -> Dataset {
        let name = self.job.file.file_stem().map_or("job".into(), |stem| stem.to_string_lossy().into_owned());
        let mut source = toml::Table::new();
        source.insert("program".into(), format!("plumbline {}", env!("CARGO_PKG_VERSION")).into());
        let arm = if self.last_unplanned.is_some() { "controlled by another program" } else { "simulated" };
        source.insert("arm".into(), arm.into());
        Dataset {
            name,
            robot: self.robot_of_dataset(),
            mounting: self.job.mounting,
            source,
            runs: self
                .recorded
                .iter()
                .filter(|recorded| !matches!(recorded.role, Role::Counter | Role::Live))
                .map(|recorded| recorded.run.clone())
                .collect(),
        }
    }

    /// A shipped robot's name; the path of a description, which the job may name relative to its own folder, as an absolute one.
    fn robot_of_dataset(&self) -> String {
        let name = &self.job.robot;
        if !name.ends_with(".toml") {
            return name.clone();
        }
        let path = self.job.dir().join(name);
        std::path::absolute(&path).unwrap_or(path).display().to_string()
    }

    /// The identification and the first unseen motion of every mounting.
    fn figures(&self, identified: &Identified, judged: Vec<(&Run, Judged)>) -> Result<Figures, Failure> {
        let mut figures = Figures::default();
        for run in self.runs(Role::Identify) {
            figures.runs.push(pipeline::judge(&identified.model, run, &self.settings)?.figure);
        }
        let mut shown = Vec::new();
        for (run, judged) in judged {
            if !shown.contains(&run.data.mounting) {
                shown.push(run.data.mounting);
                let title = format!("{} (unseen, {})", judged.figure.title, run.data.mounting);
                figures.runs.push(crate::report::figures::TorqueFigure { title, ..judged.figure });
            }
        }
        let workspace = self.job.workspace(&self.robot.workspace);
        figures.plan = self.plan.as_ref().map(|planned| drawn::plan(&self.robot, workspace, &planned.fourier));
        if let Some(run) = self.runs(Role::Identify).first() {
            figures.friction = drawn::friction(&identified.model, run, &self.settings)?;
        }
        figures.correlation = drawn::correlation(&identified.identification);
        figures.durations = self.durations.figures();
        Ok(figures)
    }
}

/// Use of the joints' limits by a motion and the course of its search, from its plan.
fn usage(motion: &Motion) -> Option<MotionUsage> {
    MotionUsage::of(&motion.name, &motion.planned()?.plan)
}

/// One row of the paper's Tables IV and V.
fn validation(run: &Run, judged: &Judged) -> Validation {
    Validation {
        run: run.data.name.clone(),
        rms_raw: judged.rms.raw.clone(),
        rms_filtered: judged.rms.filtered.clone(),
        served_rms: SERVED_TORQUES.of(run).map(|served| {
            let error = &run.data.tau - served;
            error.column_iter().map(|column| column.norm() / (run.samples() as f64).sqrt()).collect()
        }),
        mounting: run.data.mounting.into(),
    }
}

/// The report of an identification, before anything was validated.
pub fn report_of(identified: &Identified, mounting: Mounting, provenance: &Provenance) -> Report {
    let identification = &identified.identification;
    let mut facts = serde_json::Map::new();
    for (name, value) in
        [("dataset", &provenance.dataset), ("plumbline", &provenance.plumbline), ("date", &provenance.date)]
    {
        if let Some(value) = value {
            facts.insert(name.into(), value.clone().into());
        }
    }
    Report {
        robot: identified.model.robot().to_string(),
        mounting: mounting.into(),
        base: Base::of(&identified.model).with_intervals(&identification.interval_95()),
        identify: Fit { rms_raw: identification.rms.raw.clone(), rms_filtered: identification.rms.filtered.clone() },
        noise_floor: identification.rms.noise_floor.clone().unwrap_or_default(),
        identifiability: Identifiability {
            not_identifiable: identification.undetermined.iter().map(|one| one.name.clone()).collect(),
            weakly_determined: Vec::new(),
            untrusted_runs: Vec::new(),
        },
        conditions: crate::analysis::conditions_facts(&identification.conditions),
        estimator: Some(EstimatorFacts {
            name: identification.estimator.id().to_string(),
            rounds: identification.rounds,
            settled: identification.outcome == Outcome::Settled,
            restricted: identification.dropped.iter().map(|one| one.name.clone()).collect(),
        }),
        provenance: facts,
        ..Report::default()
    }
}
