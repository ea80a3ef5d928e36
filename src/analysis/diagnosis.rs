//! A diagnosis from recorded runs: shared by `diagnose` and the estimator.

use crate::analysis::SAME_MOUNTING;
use crate::analysis::pipeline::{self, Identified};
use crate::dataset::Run;
use crate::failure::Failure;
use crate::process::progress::{self, Bar};
use nalgebra::DMatrix;
use plumbline_diagnose::changing::{Changing, add_once, changing, cleaned, until_the_end, without_base_motions};
use plumbline_diagnose::errors::Of;
use plumbline_diagnose::figures::Curves;
use plumbline_diagnose::outcome::{Acts, Changes, Disagreement};
use plumbline_diagnose::reference;
use plumbline_diagnose::{Diagnosis, Effect, Input, OpenQuestions, Progress, Trial, Verdict, diagnose};
use plumbline_identify::solve::{self, ols, stack::Stack};
use plumbline_identify::{ExcludedSpan, Experiment, Settings};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::OperatingPoint;
use plumbline_model::{Mounting, Robot, Structure, TorqueModel};
use std::borrow::Cow;
use std::slice;
use std::sync::atomic::{AtomicUsize, Ordering};

pub struct Question<'a> {
    pub robot: &'a Robot,
    pub structure: &'a Structure,
    pub identify: &'a [&'a Run],
    pub unseen: &'a [&'a Run],
    pub settings: &'a Settings,
    pub options: &'a solve::Options,
    pub diagnosis: &'a plumbline_diagnose::Settings,
    /// What the errors before and after are taken of.
    pub of: Of,
}

pub struct Diagnosed {
    /// The model with the effects that hold; the plain one where none does.
    pub after: Identified,
    pub block: Diagnosis,
    pub figures: Curves,
    pub open: OpenQuestions,
    /// Unseen runs that differ for no cause that was found.
    pub unnamed: usize,
    /// Torque of what acts in a part of the recording in each run that was identified from, N x n \[Nm\]; empty where nothing does.
    acting: Vec<DMatrix<f64>>,
}

/// Unseen runs that decide which findings are delivered; the others measure. A single one does both.
pub fn deciding(unseen: usize) -> usize {
    (unseen / 2).max(1).min(unseen)
}

/// Diagnoses runs of one arm in their parts, with a progress bar.
pub fn run(question: &Question) -> Result<Diagnosed, Failure> {
    pipeline::check_channels(question.identify)?;
    let bar = progress::bar("diagnosing");
    bar.busy("preparing the runs");
    let first = prepared(question, None)?;
    let contacts = first.variation.contacts.len();
    let repeats = first.identify.iter().any(|experiment| experiment.scatter.is_some());
    let found = diagnosed(question, first, &bar)?;
    // Without repeats the noise is not known, and there is none to prepare again.
    let left = if repeats { found.block.unexplained.len() } else { 0 };
    let has_more = !found.acting.is_empty() || found.block.effects.iter().any(|effect| effect.in_model);
    if contacts + left == 0 || !has_more {
        return Ok(found);
    }
    // What a contact was found by may be an effect that the plain model lacks. And the noise of the positions makes more of a model that has it.
    let again = prepared(question, Some(&found))?;
    match contacts.checked_sub(again.variation.contacts.len()) {
        Some(1..) => diagnosed(question, again, &bar),
        Some(0) if left > 0 => {
            let again = diagnosed(question, again, &bar)?;
            Ok(if again.block.unexplained.len() < left { again } else { found })
        }
        _ => Ok(found),
    }
}

fn diagnosed(question: &Question, prepared: Prepared, bar: &Bar) -> Result<Diagnosed, Failure> {
    let Prepared { identify, variation, unseen, starts } = prepared;
    let mut notes: Vec<String> = identify.iter().chain(&unseen).filter_map(pipeline::settled).collect();
    notes.extend(starts.into_iter().map(|ExcludedSpan { run, from, to }| {
        format!("run {run}, {from:.2} to {to:.2} s: left out, for the motion of other runs does not repeat so early")
    }));
    let (identify, unseen) = (trials(&identify, question.identify), trials(&unseen, question.unseen));
    let (veto, judge) = unseen.split_at(deciding(unseen.len()));
    let input = Input {
        structure: question.structure,
        identify: &identify,
        veto,
        judge,
        options: question.options,
        came: &variation.came(&identify),
    };
    bar.busy("building candidates");
    let watch = search_on(bar);
    let torque_limits = question.robot.limits.tau[..question.robot.chain.len()].to_vec();
    let settings = plumbline_diagnose::Settings { judged_by: question.of, torque_limits, ..question.diagnosis.clone() };
    let outcome = diagnose(&input, &settings, &watch).map_err(Failure::job)?;
    bar.busy("comparing runs");
    let (structure, identification) = (outcome.after.structure, outcome.after.identification);
    let after = pipeline::identified(question.robot, question.identify, structure, identification, question.settings)?;
    let mut block = outcome.diagnosis;
    block.band = question.of.band(question.settings.torque_cutoff);
    block.notes.extend(notes);
    variation.add_to(&mut block, question.diagnosis.least_floor, question.diagnosis.threshold);
    let acting = outcome.identified.iter().zip(&identify).map(|(without, with)| &with.experiment.tau - &without.tau);
    let acting = acting.collect();
    // What acts in them, too, is known.
    let unseen = if outcome.unseen.is_empty() { unseen } else { trials(&outcome.unseen, question.unseen) };
    let unnamed = question.name_disagreements(&after, &identify, &unseen, &mut block);
    Ok(Diagnosed { after, block, figures: outcome.curves, open: outcome.open, unnamed, acting })
}

/// Shows a search on a bar: each comparison of candidates from 0 to 1, with its number, because nobody knows how many comparisons a search takes.
pub fn search_on(bar: &Bar) -> impl Fn(Progress) + Sync + '_ {
    let comparisons = AtomicUsize::new(0);
    move |progress| match progress {
        Progress::Step(_) => {}
        Progress::Candidates { done, of } => {
            // The first of a comparison.
            let before = comparisons.fetch_add(usize::from(done == 1), Ordering::Relaxed);
            let number = before + usize::from(done == 1);
            if done == of {
                bar.busy("testing what was found");
            } else {
                bar.at(done as f64 / of as f64, &format!("comparison {number}: {done} of {of} candidates"));
            }
        }
    }
}

impl Question<'_> {
    /// Searches the runs that differ from the identified ones for what changed in them, as against a stored model: in all of them together, or else in
    /// each. Only what explains the difference is named, and nothing where the model lacks something in its own runs: changes would be named for that.
    /// Returns the number of runs that differ without a name.
    fn name_disagreements<'a>(
        &self,
        reference: &Identified,
        identified: &[Trial],
        unseen: &[Trial<'a>],
        block: &mut Diagnosis,
    ) -> usize {
        if !block.unexplained.is_empty() {
            return block.disagreements.len();
        }
        let differs = |(run, trial): (&&Run, &Trial<'a>)| {
            let by = block.disagreements.iter().find(|one| one.run == run.data.name)?.clone();
            let valid = reference.model.valid_in(&run.data.mounting).is_ok();
            valid.then_some(Differing { by, mounting: run.data.mounting, trial: *trial })
        };
        let differing: Vec<Differing> = self.unseen.iter().zip(unseen).filter_map(differs).collect();
        let cause = |differing: &[Differing]| self.cause(reference, identified, differing);
        let together = Some(&differing[..]).filter(|all| all.len() > 1).and_then(cause);
        let (explained, mut causes) = match together {
            Some(cause) => (differing.len(), vec![cause]),
            None => {
                let alone: Vec<Changes> = differing.iter().filter_map(|one| cause(slice::from_ref(one))).collect();
                (alone.len(), alone)
            }
        };
        for cause in &mut causes {
            block.take_what_goes_on(&mut cause.effects, &format!("in {}", cause.session));
            block.effects.extend_from_slice(&cause.effects);
        }
        block.changes.extend(causes.into_iter().filter(|cause| !cause.effects.is_empty()));
        let unnamed = block.disagreements.len() - explained;
        if unnamed == 0 && explained > 0 {
            block.verdict = Verdict::of_all(&block.effects);
        } else if explained > 0 && block.verdict == Verdict::Unexplained {
            block.verdict = Verdict::Partly;
        }
        unnamed
    }

    /// The fewest changes that explain what these runs differ by.
    fn cause(&self, of: &Identified, identified: &[Trial], differing: &[Differing]) -> Option<Changes> {
        let model = &of.model;
        let mounting = differing.first()?.mounting;
        if differing.iter().any(|run| run.mounting.angle_to(&mounting) >= SAME_MOUNTING) {
            return None;
        }
        let trials: Vec<Trial> = differing.iter().map(|run| run.trial).collect();
        // One of the runs may have all of what is left over.
        let most = (trials.len() as f64).sqrt();
        let explain = |changes: &reference::Changes| {
            let agrees = |Differing { by, .. }: &Differing| {
                changes.after.get(by.joint - 1).is_some_and(|rms| by.is_explained_at(most * rms))
            };
            !changes.effects.is_empty() && differing.iter().all(agrees)
        };
        for steps in 1..=self.diagnosis.steps {
            let settings = plumbline_diagnose::Settings { steps, ..self.diagnosis.clone() };
            let changes =
                reference::in_unseen(model, Some(&of.identification.covariance), identified, &trials, &settings);
            if explain(&changes) {
                let session = differing.iter().map(|run| run.by.run.as_str()).collect::<Vec<_>>().join(" and ");
                let effect = |change: &reference::Change| {
                    let effect = change.effect(model, Some(&mounting), false);
                    Effect { label: format!("{} in {session}", effect.place()), ..effect }
                };
                let (since, effects) =
                    ("the runs identified from".into(), changes.effects.iter().map(effect).collect());
                return Some(Changes { since, session, effects, ..Changes::default() });
            }
            if changes.effects.len() < steps {
                return None;
            }
        }
        None
    }
}

/// An unseen run that differs from those identified from.
struct Differing<'a> {
    by: Disagreement,
    mounting: Mounting,
    trial: Trial<'a>,
}

pub fn trials<'a>(experiments: &'a [Experiment], runs: &[&Run]) -> Vec<Trial<'a>> {
    let trial =
        |(experiment, run): (&'a Experiment, &&Run)| Trial { experiment, session: run.session, start: run.start };
    experiments.iter().zip(runs).map(trial).collect()
}

/// The runs of a question.
struct Prepared {
    /// Those to identify from without events that happened once, with the noise of the rest.
    identify: Vec<Experiment>,
    /// What differs between their periods.
    variation: Changing,
    /// The unseen ones.
    unseen: Vec<Experiment>,
    /// What is left out of these at their start.
    starts: Vec<ExcludedSpan>,
}

/// What happens once is sought in what the plain model leaves, or what is `known` already.
fn prepared(question: &Question, known: Option<&Diagnosed>) -> Result<Prepared, Failure> {
    let settings = Settings { keep_periods: true, without_ends: true, ..question.settings.clone() };
    let mut experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
    let starts = starts(&experiments, question.unseen);
    let leave_out = settings.leave_out.iter().chain(&starts).cloned().collect();
    let mut unseen = pipeline::experiments(question.unseen, &Settings { leave_out, ..settings.clone() })?;
    let repeat = |experiment: &Experiment| experiment.repeats.is_some();
    let mut found = Changing::default();
    let plain = identified(question.structure, &experiments)?;
    let mut operating_point = question.structure.operating_point(&plain.beta());
    let mut model = Cow::Borrowed(known.map_or(&plain, |known| &known.after.model));
    if experiments.iter().chain(&unseen).any(repeat) {
        experiments.iter_mut().chain(&mut unseen).for_each(|one| one.follow_own_motion(|motion| model.predict(motion)));
        let changed = |operating_point: &OperatingPoint, model: &TorqueModel, experiments: &[Experiment]| {
            changing(operating_point, &trials(experiments, question.identify), |motion| model.predict(motion))
        };
        found = changed(&operating_point, &model, &experiments);
        let without = found.before_steps(&trials(&experiments, question.identify));
        if !without.is_empty() && known.is_none() {
            // What came is in the model of all runs in part, and the arm gave way as it came: both are judged again by the arm as it was before.
            let before = identified(question.structure, &without)?;
            let difference = |motion: &Motion| before.predict(motion) - plain.predict(motion);
            experiments.iter_mut().for_each(|experiment| experiment.follow_own_motion(difference));
            operating_point = question.structure.operating_point(&before.beta());
            model = Cow::Owned(before);
            found = changed(&operating_point, &model, &experiments);
        }
        if !found.leave_out.is_empty() {
            let leave_out = settings.leave_out.iter().chain(&found.leave_out).cloned().collect();
            let settings = Settings { leave_out, ..settings };
            experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
            experiments.iter_mut().for_each(|one| one.follow_own_motion(|motion| model.predict(motion)));
        }
    }
    let predict = |motion: &Motion| model.predict(motion);
    let without = without_acting(&experiments, known.map_or(&[], |known| &known.acting));
    let effects = known.iter().flat_map(|known| &known.block.effects);
    let came: Vec<&Acts> = effects.filter_map(|effect| effect.acts.as_ref()).collect();
    add_once(&mut found, &trials(&without, question.identify), &operating_point, &came, predict);
    cleaned(&mut experiments, &found, &operating_point);
    without_base_motions(&mut unseen, &found, &operating_point, predict);
    let drifts = until_the_end(&found, &operating_point, &trials(&experiments, question.identify));
    experiments.iter_mut().zip(drifts.into_iter().flatten()).for_each(|(one, torque)| one.take_off_drift(torque));
    experiments.iter_mut().chain(&mut unseen).for_each(|experiment| experiment.add_resolution(predict));
    if !question.options.estimator.needs_periods() {
        experiments.iter_mut().chain(&mut unseen).for_each(|experiment| experiment.repeats = None);
    }
    Ok(Prepared { identify: experiments, variation: found, unseen, starts })
}

/// Runs of which those that do not repeat are without what acts in a part of the recording. In the others its deviations tell.
fn without_acting<'a>(experiments: &'a [Experiment], acting: &[DMatrix<f64>]) -> Cow<'a, [Experiment]> {
    let mut without = Cow::Borrowed(experiments);
    for (k, torque) in acting.iter().enumerate().filter(|(k, _)| experiments[*k].repeats.is_none()) {
        without.to_mut()[k].tau -= torque;
    }
    without
}

/// Starts of unseen runs that do not repeat, for as long as the motion of no identified one repeated: no controller follows there, and nothing is known of what a
/// gear or friction did before.
fn starts(identified: &[Experiment], unseen: &[&Run]) -> Vec<ExcludedSpan> {
    let to = identified.iter().map(|experiment| experiment.settling).reduce(f64::min).unwrap_or(0.0);
    let runs = unseen.iter().filter(|run| to > 0.0 && run.data.period.is_none());
    runs.map(|run| ExcludedSpan { run: run.data.name.clone(), from: 0.0, to }).collect()
}

/// The rigid bodies and the friction as a plain identification finds them. Weights matter little for the gravity columns, the shape of friction and
/// small deviations of the motion.
fn identified(structure: &Structure, experiments: &[Experiment]) -> Result<TorqueModel, Failure> {
    let stack = Stack::of(structure, experiments).map_err(Failure::job)?;
    let plain = ols::solve(&stack).map_err(Failure::job)?;
    let values: Vec<(f64, Option<f64>)> = plain.beta.iter().map(|value| (*value, None)).collect();
    TorqueModel::new("", structure.clone(), Vec::new(), &values).map_err(Failure::job)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Role;
    use nalgebra::DMatrix;

    /// Sines of all joints for 16 s; the first joint starts 10 mrad off, which decays within `decay` \[s\].
    fn sines(name: &str, joints: usize, decay: f64, period: Option<f64>) -> Run {
        let t: Vec<f64> = (0..16_000).map(|k| k as f64 * 1e-3).collect();
        let tick = |k: usize| ((k * k) as f64 * 0.618_034).fract() - 0.5;
        let q = DMatrix::from_fn(t.len(), joints, |k, j| {
            let start = if j == 0 && decay > 0.0 { 0.01 * (-t[k] / decay).exp() } else { 0.0 };
            (std::f64::consts::PI * (j + 1) as f64 * t[k]).sin() + 1e-5 * tick(k + 7 * j) + start
        });
        let tau = DMatrix::from_fn(t.len(), joints, |k, j| q[(k, j)] + tick(k + 3 * j));
        let data = plumbline_identify::Run { name: name.into(), t, q, dq: None, tau, mounting: Mounting::WALL, period };
        Run::new(data, if period.is_some() { Role::Identify } else { Role::Validate })
    }

    #[test]
    fn what_is_known_to_act_is_taken_off_runs_that_do_not_repeat() {
        let runs = [sines("repeats", 2, 0.0, Some(2.0)), sines("once", 2, 0.0, None)];
        let settings = Settings { keep_periods: true, ..Settings::default() };
        let experiments = pipeline::experiments(&runs.iter().collect::<Vec<_>>(), &settings).unwrap();
        let acting: Vec<_> = experiments.iter().map(|one| DMatrix::from_element(one.tau.nrows(), 2, 0.3)).collect();
        let off = |acting: &[_]| {
            let without = without_acting(&experiments, acting);
            let taken = experiments.iter().zip(&*without).map(|(with, without)| (&with.tau - &without.tau).mean());
            taken.map(|taken| (10.0 * taken).round() / 10.0).collect::<Vec<_>>()
        };
        assert_eq!([off(&acting), off(&[])], [[0.0, 0.3], [0.0, 0.0]]);
    }

    #[test]
    fn an_unseen_run_that_does_not_repeat_counts_from_where_the_identified_ones_repeat() {
        let robot = Robot::load("panda", None).unwrap();
        let structure = crate::setup::friction_structure(&robot, &Mounting::WALL);
        let n = robot.chain.len();
        let [soon, late] = [0.05, 0.1].map(|decay| sines("identified", n, decay, Some(2.0)));
        let (settled, unseen) = (sines("settled", n, 0.0, Some(2.0)), sines("unseen", n, 0.1, None));
        let left_out = |identify: &[&Run]| {
            let question = Question {
                robot: &robot,
                structure: &structure,
                identify,
                unseen: &[&unseen],
                settings: &Settings::default(),
                options: &solve::Options::default(),
                diagnosis: &plumbline_diagnose::Settings::default(),
                of: Of::Filtered,
            };
            let Prepared { identify: identified, unseen, .. } = prepared(&question, None).unwrap();
            let edge = unseen[0].motion.start;
            let out = unseen[0].resting().iter().take_while(|out| **out).count();
            let least = identified.iter().map(|one| one.settling).fold(f64::INFINITY, f64::min);
            (least, edge + out as f64 * unseen[0].motion.dt)
        };
        let (least, out) = left_out(&[&soon, &late]);
        assert!(least > 0.2 && (out - least).abs() < 2e-3, "{out} {least}");
        assert!(least < left_out(&[&late]).0, "of several runs the one that repeats first");
        // The end of every run that does not repeat: half a period of the low-pass, and what its accelerations lose.
        let (least, out) = left_out(&[&soon, &settled]);
        assert!(least == 0.0 && (out - 0.15).abs() < 2e-3, "{out} {least}");
    }
}
