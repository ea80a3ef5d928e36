//! What differs from period to period: drifts, what comes at once, a base that moves, contacts, and single samples that are off.
//!
//! The motion repeats, so the parameters of the model have no part in the deviations of the periods from their mean, and what is found
//! here needs no fit of them. [`changing`] also says which stretches of which runs should be left out of the mean
//! ([`plumbline_identify::Settings::leave_out`]), and what the noise is like without the drifts.

mod base_motion;
mod coming;
mod contact;
mod courses;
mod drift;
mod effects;
mod events;
mod fitted;
mod once;
mod outlier;
mod record;
mod step;
mod transient;

pub use base_motion::BaseMotion;
pub use contact::Contact;
pub(super) use courses::WARMING_TIME_CONSTANTS_S;
pub use drift::{Course, Drift, Drifting, Shared};
pub(super) use effects::AT_THE_END;
pub use outlier::Hygiene;
pub use step::Step;
pub use transient::Transient;

use super::evidence::Trial;
use super::outcome::Acts;
use super::span::Span;
use courses::{Courses, Deviations};
use events::Events;
use nalgebra::{DMatrix, DVector};
use plumbline_core::{parallel, threads};
use plumbline_identify::{ExcludedSpan, Experiment, Scatter};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{OperatingPoint, Spec};
use record::Record;
use transient::Event;

/// Time before and after an event that is left out too \[s\].
const EVENT_MARGIN_S: f64 = 0.2;
/// Largest distance of begins that are tried between the earliest and the latest at which something may have come \[s\]: a load in a quarter of a second in which
/// there was none makes the begin less likely than one far off.
const BEGINS_APART_S: f64 = 0.25;
/// Most of them before the latest.
const MAX_EARLIER_BEGINS: usize = 16;

/// Smallest number of periods in which an event may be something else than a contact. Two have no majority. The median of three is one of them, so
/// that the scale of deviations is too small and noise is flagged as events.
pub const LEAST_PERIODS: usize = 4;

/// A run keeps everything where more than this share of it would be left out: what fills half of it did not happen once.
const MAX_LEFT_OUT_RATIO: f64 = 0.5;

/// Most times that courses are fitted again without what is masked beside them.
const MAX_ROUNDS: usize = 3;

/// What differs from period to period.
#[derive(Clone, Debug, Default)]
pub struct Changing {
    /// Drifts, in the order in which they were found.
    pub drifts: Vec<Drift>,
    /// What comes within a run, in the order in which it was found.
    pub steps: Vec<Step>,
    /// Lines of a base that moves, run by run.
    pub base_motions: Vec<BaseMotion>,
    /// Contacts.
    pub contacts: Vec<Contact>,
    /// Events that are no contacts.
    pub transients: Vec<Transient>,
    /// Single samples, run by run.
    pub hygiene: Vec<Hygiene>,
    /// Names of the runs that repeat often enough.
    pub runs: Vec<String>,
    /// Names of the runs without repeats, where only base motions are sought.
    pub once: Vec<String>,
    /// Names of runs that keep everything, because too much would be left out.
    pub spared: Vec<String>,
    /// Stretches to be left out of the mean.
    pub leave_out: Vec<ExcludedSpan>,
    /// Scatter of each trial's torques without the drifts and the events; `None` without repeats.
    pub scatter: Vec<Option<Scatter>>,
}

impl Changing {
    /// What came within one of these runs, each with two parts of the recording: to its run's end, and to the end of the recording. Where one period alone
    /// tells of the time in which it came, several begins are tried.
    pub fn came(&self, trials: &[Trial]) -> Vec<(Spec, Span)> {
        let last = trials.iter().map(|trial| trial.start).fold(f64::NEG_INFINITY, f64::max);
        let of = |step: &Step| {
            let run = trials.iter().find(|trial| trial.experiment.name == step.run)?;
            let earlier = ((step.time - step.earliest) / BEGINS_APART_S).ceil().min(MAX_EARLIER_BEGINS as f64) as usize;
            let spans = |place: usize| {
                let share = place as f64 / earlier.max(1) as f64;
                let from = run.start + step.time - share * (step.time - step.earliest);
                let to_its_end = Span { to: run.end(), ..Span::since(from) };
                // At the end of the last run both are the same.
                [Some(Span::since(from)), Some(to_its_end).filter(|_| run.start < last)]
            };
            let spans: Vec<Span> = (0..=earlier).flat_map(spans).flatten().collect();
            let spec = step.spec.clone();
            Some(spans.into_iter().map(move |span| (spec.clone(), span)))
        };
        self.steps.iter().filter_map(of).flatten().collect()
    }

    /// The runs up to the first in which something came, without what did; none where nothing came, or in two periods, where such a model would make it a
    /// contact in one of them.
    pub fn before_steps(&self, trials: &[Trial]) -> Vec<Experiment> {
        if self.steps.iter().any(|step| step.periods.len() <= once::MAX_PERIODS) {
            return Vec::new();
        }
        let steps_of = |trial: &Trial| {
            let own = self.steps.iter().filter(|step| step.run == trial.experiment.name);
            own.filter_map(|step| step.of_mean(trial.experiment)).collect::<Vec<_>>()
        };
        let has = |trial: &&Trial| self.steps.iter().any(|step| step.run == trial.experiment.name);
        let first = trials.iter().filter(has).map(|trial| trial.start).reduce(f64::min);
        let without = |trial: &Trial| {
            let mut experiment = trial.experiment.clone();
            steps_of(trial).iter().for_each(|torque| experiment.take_off(torque));
            experiment
        };
        trials.iter().filter(|trial| first.is_some_and(|first| trial.start <= first)).map(without).collect()
    }

    /// Whether nothing was found.
    pub fn is_empty(&self) -> bool {
        self.drifts.is_empty()
            && self.steps.is_empty()
            && self.base_motions.is_empty()
            && self.contacts.is_empty()
            && self.transients.is_empty()
            && self.leave_out.is_empty()
    }
}

/// Analyses the deviations of runs that were prepared with [`plumbline_identify::Settings::keep_periods`].
///
/// The operating point's friction has `[fv, fc]` of each joint (\[Nms/rad\], \[Nm\]); without it, friction drifts are sought joint by joint alone. `predict`
/// gives the torques of the plain model along a motion. Runs without repeats have no part in it but for their hygiene.
pub fn changing(
    operating_point: &OperatingPoint,
    trials: &[Trial],
    predict: impl Fn(&Motion) -> DMatrix<f64> + Sync,
) -> Changing {
    let mut found = Changing::default();
    let first = Trial::begin_of(trials);
    let mut records: Vec<Record> =
        trials.iter().filter_map(|trial| Record::of(trial.experiment, trial.start - first)).collect();
    // A contact would be taken for steps of friction and offset.
    let mut events = parallel(&records, threads(), |record| events::passing(record, operating_point, EVENT_MARGIN_S));
    let mut touched = once::contacts_of(trials, operating_point, &[], &predict);
    let mut never = without_contacts(&records, &touched);
    let (mut courses, mut passing) = courses_without(&events, &never, &mut records, operating_point);
    // And what came is no contact where no other period has it yet.
    if !touched.is_empty() && !courses.steps.is_empty() {
        let left = once::contacts_of(trials, operating_point, &courses.steps, &predict);
        if left.len() < touched.len() {
            touched = left;
            never = without_contacts(&records, &touched);
            (courses, passing) = courses_without(&events, &never, &mut records, operating_point);
        }
    }
    for (contact, left_out) in touched {
        found.contacts.push(contact);
        found.leave_out.extend(left_out);
    }
    // An arm gives way under a tool that is picked up: that is no contact but a part of the step, which is sought once more in all of its samples.
    let own =
        |event: &Event, record: &Record| courses.steps.iter().any(|step| step.has(event, record, 2.0 * EVENT_MARGIN_S));
    let mut given = 0;
    for (record, events) in records.iter().zip(&mut events) {
        given += events.extract_if(.., |event| own(event, record)).count();
    }
    if given > 0 {
        (courses, passing) = courses_without(&events, &never, &mut records, operating_point);
    }
    // What was fitted to an event goes where the event is masked, and what else an unknown course made an event comes back.
    for _ in 0..MAX_ROUNDS {
        if !mask(&mut records, &passing, operating_point, &courses) {
            break;
        }
        courses = Deviations::of(&records, operating_point).courses(&courses.steps);
    }
    let torques = records.iter().enumerate().map(|(run, record)| courses.torque(run, record, operating_point));
    let torques: Vec<DMatrix<f64>> = torques.collect();
    let mut masks = Vec::new();
    for (record, course) in records.iter().zip(&torques) {
        let left = &record.tau - course;
        let rest = record.centred_all(left.clone());
        let (lines, shaken) = base_motion::base_motions(record, &operating_point.load, &rest);
        let left = left - shaken;
        found.base_motions.extend(lines);
        if record.periods() <= once::MAX_PERIODS {
            masks.push(record.masked.clone());
            continue;
        }
        let events = Events::of(record, operating_point, &left, false);
        let masked = events.mask(record, EVENT_MARGIN_S);
        let events = events.without_those_of(&courses.steps, record, EVENT_MARGIN_S);
        found.contacts.extend(events.contacts.into_iter().map(|(_, contact)| contact));
        found.transients.extend(events.others.into_iter().map(|(_, transient)| transient));
        found.leave_out.extend(left_out(record, &masked));
        masks.push(masked);
    }
    found.base_motions = base_motion::plausible(&found.base_motions, records.len());
    let mut of_run = 0;
    let mut looks = Vec::new();
    for trial in trials {
        let record = records.get(of_run).filter(|record| std::ptr::eq(record.experiment, trial.experiment));
        match record {
            Some(record) => {
                let full: Vec<bool> = masks[of_run].iter().flat_map(|&masked| vec![masked; record.step]).collect();
                let lines = lines_of(&found, record.experiment, operating_point);
                let masked = record.without(&masks[of_run]);
                found.scatter.push(Some(scatter(record, &torques[of_run], lines.as_ref(), &masked)));
                of_run += 1;
                looks.push((trial.experiment, full));
            }
            None => {
                found.scatter.push(None);
                looks.push((trial.experiment, Vec::new()));
            }
        }
    }
    for (hygiene, spoiled) in parallel(&looks, threads(), |(experiment, full)| outlier::hygiene(experiment, full)) {
        found.leave_out.extend(spoiled);
        found.hygiene.push(hygiene);
    }
    for record in &records {
        found.leave_out.extend(around_steps(record, &courses.steps));
    }
    found.leave_out = merged(found.leave_out);
    (found.drifts, found.steps) = (courses.drifts, courses.steps);
    found.runs = records.iter().map(|record| record.experiment.name.clone()).collect();
    let lost =
        |run: &str| -> f64 { found.leave_out.iter().filter(|one| one.run == run).map(|one| one.to - one.from).sum() };
    let seconds = |record: &Record| record.tau.nrows() as f64 * record.dt;
    let too_much = records.iter().filter(|record| lost(&record.experiment.name) > MAX_LEFT_OUT_RATIO * seconds(record));
    found.spared = too_much.map(|record| record.experiment.name.clone()).collect();
    found.leave_out.retain(|one| !found.spared.contains(&one.run));
    found
}

/// The rows of each record that are masked or have one of these contacts: the other period deviates there too, and all of that would look like something that
/// came.
fn without_contacts(records: &[Record], contacts: &[(Contact, Vec<ExcludedSpan>)]) -> Vec<Vec<bool>> {
    let of_run = |record: &Record| {
        let own = contacts.iter().filter(|(contact, _)| contact.run == record.experiment.name);
        own.fold(record.masked.clone(), |masked, (_, spans)| record::either(&masked, &record.rows_in(spans)))
    };
    records.iter().map(of_run).collect()
}

/// What differs between the periods where they don't have these events, and without samples that `never` count; and the rows of the events.
fn courses_without(
    events: &[Vec<Event>],
    never: &[Vec<bool>],
    records: &mut [Record],
    operating_point: &OperatingPoint,
) -> (Courses, Vec<Vec<bool>>) {
    let of_run = |((record, never), events): ((&mut Record, &Vec<bool>), &Vec<Event>)| {
        let rows = transient::mask(record, events, EVENT_MARGIN_S);
        record.mask(record::either(never, &rows));
        rows
    };
    let rows = records.iter_mut().zip(never).zip(events).map(of_run).collect();
    (Deviations::of(records, operating_point).courses(&[]), rows)
}

/// What drifts through the recording do to the mean period of each run, less what they do at the end of the last one, N x n \[Nm\]. Without it the
/// runs are those of the arm as it is at the end. `None` without such a drift.
pub fn until_the_end(
    found: &Changing,
    operating_point: &OperatingPoint,
    trials: &[Trial],
) -> Option<Vec<DMatrix<f64>>> {
    let drifts: Vec<&Drift> = found.drifts.iter().filter(|drift| drift.shared == Shared::Course).collect();
    if drifts.is_empty() {
        return None;
    }
    let of_run = |trial: &Trial| {
        let (samples, joints) = (trial.experiment.motion.samples(), trial.experiment.joints());
        let torque = |drift: &&Drift| drift.until_the_end(trial.experiment, operating_point);
        drifts.iter().map(torque).fold(DMatrix::zeros(samples, joints), |sum, torque| sum + torque)
    };
    Some(trials.iter().map(of_run).collect())
}

/// Masks the events that are left without the courses, and what passes; whether that changed anything.
fn mask(records: &mut [Record], passing: &[Vec<bool>], operating_point: &OperatingPoint, courses: &Courses) -> bool {
    let runs: Vec<usize> = (0..records.len()).collect();
    let masks = parallel(&runs, threads(), |&run| {
        let record = &records[run];
        if record.periods() < LEAST_PERIODS {
            return record.masked.clone();
        }
        let left = &record.tau - courses.torque(run, record, operating_point);
        let x = transient::robust(record, &left, true);
        let events = transient::events(&x, record.dt, transient::MIN_ENERGY_DEVIATIONS);
        record.without(&record::either(&transient::mask(record, &events, EVENT_MARGIN_S), &passing[run]))
    });
    let mut changed = false;
    for (record, masked) in records.iter_mut().zip(masks) {
        changed |= record.mask(masked);
    }
    changed
}

/// The begins of steps, and both ends of their run. With a step the arm ends the run elsewhere than it begins it, by as much as its controller gives way,
/// and the mean period must not jump there: it would be a blow in the accelerations.
fn around_steps(record: &Record, steps: &[Step]) -> Vec<ExcludedSpan> {
    let run = &record.experiment.name;
    let own: Vec<f64> = steps.iter().filter(|step| step.run == *run).map(|step| step.time).collect();
    let ends = [0.0, record.experiment.timeline.end()].into_iter().filter(|_| !own.is_empty());
    let span = |time: f64| ExcludedSpan { run: run.clone(), from: time - EVENT_MARGIN_S, to: time + EVENT_MARGIN_S };
    ends.chain(own.iter().copied()).map(span).collect()
}

/// Stretches that touch or overlap as one, in the order of runs and time.
fn merged(mut stretches: Vec<ExcludedSpan>) -> Vec<ExcludedSpan> {
    stretches.sort_by(|a, b| a.run.cmp(&b.run).then(a.from.total_cmp(&b.from)));
    let mut out: Vec<ExcludedSpan> = Vec::new();
    for one in stretches {
        match out.last_mut() {
            Some(last) if last.run == one.run && one.from <= last.to + 1e-9 => last.to = last.to.max(one.to),
            _ => out.push(one),
        }
    }
    out
}

/// Adds the base motions and contacts of runs without repeats, which show in what the plain model leaves of them. `predict` gives its torques along a motion.
/// Where something `came` is no contact: it is a part of what came, of which the model as it was before knows nothing.
pub fn add_once(
    found: &mut Changing,
    trials: &[Trial],
    operating_point: &OperatingPoint,
    came: &[&Acts],
    predict: impl Fn(&Motion) -> DMatrix<f64> + Sync,
) {
    let once: Vec<&Experiment> =
        trials.iter().map(|trial| trial.experiment).filter(|experiment| experiment.repeats.is_none()).collect();
    let of_run = |experiment: &&Experiment| {
        let left = &experiment.tau - predict(&experiment.motion);
        let lines = base_motion::base_motions_once(experiment, &operating_point.load, &left);
        let shaken = lines.iter().map(|line| line.of_mean(experiment, &operating_point.load));
        let left = shaken.fold(left, |left, torque| left - torque);
        let mut contacts = once::contacts_of_one_period(experiment, operating_point, left);
        contacts.retain(|contact| !came.iter().any(|acts| is_begin(contact, acts)));
        (lines, contacts)
    };
    for (lines, contacts) in parallel(&once, threads(), of_run) {
        found.base_motions.extend(lines);
        found.contacts.extend(contacts);
    }
    found.once.extend(once.iter().map(|experiment| experiment.name.clone()));
    found.base_motions = base_motion::plausible(&found.base_motions, trials.len());
}

/// Whether what acts in a part of the recording begins at a contact.
fn is_begin(contact: &Contact, acts: &Acts) -> bool {
    let around = contact.from - 2.0 * EVENT_MARGIN_S..=contact.to + 2.0 * EVENT_MARGIN_S;
    contact.run == acts.run && around.contains(&acts.from)
}

/// Takes the base motions of the identified runs off unseen runs that have them, too: they are no difference between the runs. `predict` gives the torques
/// of the plain model along a motion.
pub fn without_base_motions(
    unseen: &mut [Experiment],
    found: &Changing,
    operating_point: &OperatingPoint,
    predict: impl Fn(&Motion) -> DMatrix<f64>,
) {
    let lines = effects::lines(&found.base_motions);
    for experiment in unseen.iter_mut().filter(|_| !lines.is_empty()) {
        let plain = predict(&experiment.motion);
        for (line, _) in &lines {
            let left = &experiment.tau - &plain;
            let own = base_motion::known(experiment, &operating_point.load, &left, line.frequency);
            own.inspect(|own| take_off(experiment, own, operating_point));
        }
    }
}

fn take_off(experiment: &mut Experiment, line: &BaseMotion, operating_point: &OperatingPoint) {
    let of_periods = line.of_periods(experiment, &operating_point.load);
    of_periods.inspect(|torque| experiment.take_off_deviations(torque));
    experiment.take_off(&line.of_mean(experiment, &operating_point.load));
}

/// What the lines of a run do to its periods, P N x n at its samples \[Nm\]; `None` where it has none.
fn lines_of(found: &Changing, experiment: &Experiment, operating_point: &OperatingPoint) -> Option<DMatrix<f64>> {
    let own = found.base_motions.iter().filter(|line| line.run == experiment.name);
    own.filter_map(|line| line.of_periods(experiment, &operating_point.load)).reduce(|sum, one| sum + one)
}

/// Takes base motions, contacts and steps off experiments, whose noise spectrum is that of [`Changing::scatter`] then. They may have fewer periods by
/// now than those that were looked at.
pub fn cleaned(experiments: &mut [Experiment], found: &Changing, operating_point: &OperatingPoint) {
    // Single samples that are off hardly count in the noise.
    if found.drifts.is_empty()
        && found.base_motions.is_empty()
        && found.contacts.is_empty()
        && found.transients.is_empty()
        && found.steps.is_empty()
    {
        return;
    }
    // Nothing is known of the scatter where no run repeats.
    let scatters = found.scatter.iter().map(Option::as_ref).chain(std::iter::repeat(None));
    for (experiment, scatter) in experiments.iter_mut().zip(scatters) {
        for line in &found.base_motions {
            if line.run == experiment.name {
                take_off(experiment, line, operating_point);
            }
        }
        // Where a contact is left out it has no part in the mean, and nothing is taken off.
        for contact in &found.contacts {
            if contact.run != experiment.name {
                continue;
            }
            let of_joint = |joint| DVector::from(experiment.timeline.mean_of(|t| contact.torque(joint, t)));
            let torque = DMatrix::from_columns(&(0..experiment.joints()).map(of_joint).collect::<Vec<_>>());
            experiment.take_off(&torque);
        }
        for step in &found.steps {
            if step.run != experiment.name {
                continue;
            }
            step.take_off_deviations(experiment);
            let torque = step.of_mean_by_own_motion(experiment);
            torque.inspect(|torque| experiment.take_off(torque));
        }
        if let (Some(own), Some(scatter)) = (&mut experiment.scatter, scatter) {
            *own = Scatter { periods: own.periods, averaged: own.averaged, ..scatter.clone() };
        }
    }
}

/// Stretches of masked rows in the run's own time.
fn left_out(record: &Record, masked: &[bool]) -> Vec<ExcludedSpan> {
    let mut found = Vec::new();
    for (period, rows) in record.repeats.periods.iter().zip(masked.chunks(record.samples)) {
        for (first, last) in record::stretches(rows) {
            let time = |row: usize| (period * record.samples + row) as f64 * record.dt;
            found.push(ExcludedSpan { run: record.experiment.name.clone(), from: time(first), to: time(last) });
        }
    }
    found
}

/// Scatter at the full rate without what is `known` on the grid, the `lines` at the full rate, and the masked rows of the grid.
fn scatter(record: &Record, known: &DMatrix<f64>, lines: Option<&DMatrix<f64>>, masked: &[bool]) -> Scatter {
    let (samples, step) = (record.experiment.motion.samples(), record.step);
    let rows = record.periods() * samples;
    let counted: Vec<bool> = (0..rows).map(|row| !masked[row / step]).collect();
    let mut deviations = DMatrix::from_fn(rows, record.joints(), |row, joint| {
        let line = lines.map_or(0.0, |lines| lines[(row, joint)]);
        record.repeats.tau[(row, joint)] - known[(row / step, joint)] - line
    });
    for mut x in deviations.column_iter_mut() {
        for k in 0..samples {
            let own = (k..rows).step_by(samples);
            let told = own.clone().filter(|row| counted[*row]);
            let (sum, count) = told.fold((0.0, 0.0), |(sum, count), row| (sum + x[row], count + 1.0));
            own.for_each(|row| x[row] = if counted[row] { x[row] - sum / f64::max(count, 1.0) } else { 0.0 });
        }
    }
    Scatter::of(&deviations, &counted, samples, record.experiment.motion.dt)
}
