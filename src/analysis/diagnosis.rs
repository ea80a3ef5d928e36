//! A diagnosis from recorded runs: shared by `diagnose` and the estimator.

use crate::analysis::SAME_MOUNTING;
use crate::analysis::pipeline::{self, Identified};
use crate::dataset::Run;
use crate::failure::Failure;
use crate::process::progress::{self, Bar};
use plumbline_diagnose::changing::{Changing, add_once, changing, cleaned, until_the_end, without_base_motions};
use plumbline_diagnose::errors::Of;
use plumbline_diagnose::figures::Curves;
use plumbline_diagnose::outcome::Changes;
use plumbline_diagnose::reference;
use plumbline_diagnose::{Diagnosis, Effect, Input, OpenQuestions, Progress, Trial, Verdict, diagnose};
use plumbline_identify::solve::{self, ols, stack::Stack};
use plumbline_identify::{ExcludedSpan, Experiment, Settings};
use plumbline_model::term::Motion;
use plumbline_model::{Robot, Structure, TorqueModel};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Periods from which on a motion counts as repeating when runs are exchanged.
const MIN_PERIODS: usize = 2;
/// Effects that are rather believed than one thing without a name.
const NAMELESS_CAUSES: usize = 2;
/// Runs to identify from of which one may become an unseen one.
const MIN_IDENTIFIED: usize = 2;

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
}

/// Diagnoses runs of one arm. An unseen run that differs from those identified from may have changed, or shows what they do not excite: it is identified
/// from, too, where that explains more with less. Returns the runs that were identified from and the unseen ones.
pub fn run_exchanging<'a>(question: &Question<'a>) -> Result<(Diagnosed, Vec<&'a Run>, Vec<&'a Run>), Failure> {
    let first = run(question)?;
    let second = exchanged(question, &first.block).and_then(|(identify, unseen)| {
        let second = run(&Question { identify: &identify, unseen: &unseen, ..*question }).ok()?;
        let better = !second.block.effects.is_empty() && causes(&second.block) < causes(&first.block);
        better.then_some((second, identify, unseen))
    });
    let Some((mut second, identify, unseen)) = second else {
        return Ok((first, question.identify.to_vec(), question.unseen.to_vec()));
    };
    let names = |runs: &[&Run]| runs.iter().map(|run| run.data.name.as_str()).collect::<Vec<_>>().join(", ");
    let known = |run: &&Run| question.identify.iter().any(|own| std::ptr::eq(*own, *run));
    let moved: Vec<&Run> = identify.iter().copied().filter(|run| !known(run)).collect();
    second.block.notes.push(format!(
        "identified from {}, too, for it differs from the others; unseen: {}",
        names(&moved),
        names(&unseen)
    ));
    Ok((second, identify, unseen))
}

/// Causes that a verdict needs: one for each effect, and more than one for each joint or run in which something is left without a name.
fn causes(block: &Diagnosis) -> usize {
    let nameless = block.unexplained.len() + block.disagreements.len() - block.changes.len();
    block.effects.len() + NAMELESS_CAUSES * nameless
}

/// Runs to identify from and unseen ones, where those that decide on findings and differ are identified from. If no other is unseen, the last run that
/// was identified from takes their place. `None` where none differs that is comparable with the identified ones.
fn exchanged<'a>(question: &Question<'a>, block: &Diagnosis) -> Option<(Vec<&'a Run>, Vec<&'a Run>)> {
    let first = question.identify.first()?;
    let repeats = |run: &Run| run.data.periods() >= MIN_PERIODS;
    let comparable =
        |run: &Run| run.data.mounting.angle_to(&first.data.mounting) < SAME_MOUNTING && repeats(run) == repeats(first);
    let differs = |run: &Run| block.disagreements.iter().any(|one| one.run == run.data.name);
    let (deciding, measuring) = question.unseen.split_at(deciding(question.unseen.len()));
    let (moved, mut unseen): (Vec<&Run>, Vec<&Run>) = deciding.iter().partition(|run| differs(run) && comparable(run));
    if moved.is_empty() {
        return None;
    }
    unseen.extend(measuring);
    let mut identify = question.identify.to_vec();
    if unseen.is_empty() {
        unseen.extend(identify.pop().filter(|_| question.identify.len() >= MIN_IDENTIFIED));
    }
    identify.extend(moved);
    (!unseen.is_empty()).then_some((identify, unseen))
}

/// Unseen runs that decide which findings are delivered; the others measure. A single one does both.
fn deciding(unseen: usize) -> usize {
    (unseen / 2).max(1).min(unseen)
}

/// Diagnoses runs of one arm in their parts, with a progress bar.
pub fn run(question: &Question) -> Result<Diagnosed, Failure> {
    pipeline::check_channels(question.identify)?;
    let bar = progress::bar("diagnosing");
    bar.busy("preparing the runs");
    let Prepared { identify, variation, unseen, starts } = prepared(question)?;
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
    let watch = search_on(&bar);
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
    // What acts in them, too, is known.
    let unseen = if outcome.unseen.is_empty() { unseen } else { trials(&outcome.unseen, question.unseen) };
    question.name_disagreements(&after.model, &identify, &unseen, &mut block);
    Ok(Diagnosed { after, block, figures: outcome.curves, open: outcome.open })
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
    /// Searches each run that differs from the identified ones for what changed in it, as against a stored model. Only what explains the difference is
    /// named, and nothing where the model lacks something in its own runs: changes would be named for that.
    fn name_disagreements(&self, model: &TorqueModel, identified: &[Trial], unseen: &[Trial], block: &mut Diagnosis) {
        if !block.unexplained.is_empty() {
            return;
        }
        let mut explained = 0;
        for (run, trial) in self.unseen.iter().zip(unseen) {
            let name = &run.data.name;
            let Some(disagreement) = block.disagreements.iter().find(|one| one.run == *name) else { continue };
            if model.valid_in(&run.data.mounting).is_err() {
                continue;
            }
            let changes = reference::in_unseen(model, identified, std::slice::from_ref(trial), self.diagnosis);
            let left_over = changes.after.get(disagreement.joint - 1);
            if changes.effects.is_empty() || !left_over.is_some_and(|rms| disagreement.is_explained_at(*rms)) {
                continue;
            }
            explained += 1;
            let effect = |change: &reference::Change| {
                let effect = change.effect(model, Some(&run.data.mounting), false);
                Effect { label: format!("{} in {name}", effect.place()), ..effect }
            };
            let effects: Vec<Effect> = changes.effects.iter().map(effect).collect();
            let (since, session) = ("the runs identified from".into(), name.clone());
            block.changes.push(Changes { since, session, effects: effects.clone(), ..Changes::default() });
            block.effects.extend(effects);
        }
        if explained == block.disagreements.len() && explained > 0 {
            block.verdict = Verdict::Diagnosed;
        } else if explained > 0 && block.verdict == Verdict::Unexplained {
            block.verdict = Verdict::Partly;
        }
    }
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

fn prepared(question: &Question) -> Result<Prepared, Failure> {
    let settings = Settings { keep_periods: true, ..question.settings.clone() };
    let mut experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
    let starts = starts(&experiments, question.unseen);
    let leave_out = settings.leave_out.iter().chain(&starts).cloned().collect();
    let mut unseen = pipeline::experiments(question.unseen, &Settings { leave_out, ..settings.clone() })?;
    let repeat = |experiment: &Experiment| experiment.repeats.is_some();
    let mut found = Changing::default();
    let mut plain = identified(question.structure, &experiments)?;
    if experiments.iter().chain(&unseen).any(repeat) {
        experiments.iter_mut().chain(&mut unseen).for_each(|one| one.follow_own_motion(|motion| plain.predict(motion)));
        found = changed(question, &plain, &experiments);
        let without = found.before_steps(&trials(&experiments, question.identify));
        if !without.is_empty() {
            // What came is in the model of all runs in part, and the arm gave way as it came: both are judged again by the arm as it was before.
            let before = identified(question.structure, &without)?;
            let difference = |motion: &Motion| before.predict(motion) - plain.predict(motion);
            experiments.iter_mut().for_each(|experiment| experiment.follow_own_motion(difference));
            plain = before;
            found = changed(question, &plain, &experiments);
        }
        if !found.leave_out.is_empty() {
            let leave_out = settings.leave_out.iter().chain(&found.leave_out).cloned().collect();
            let settings = Settings { leave_out, ..settings };
            experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
            experiments.iter_mut().for_each(|one| one.follow_own_motion(|motion| plain.predict(motion)));
        }
    }
    let operating_point = question.structure.operating_point(&plain.beta());
    let predict = |motion: &Motion| plain.predict(motion);
    add_once(&mut found, &trials(&experiments, question.identify), &operating_point, predict);
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

/// Starts of unseen runs that do not repeat, for as long as the motion of no identified one repeated: no controller follows there, and nothing is known of what a
/// gear or friction did before.
fn starts(identified: &[Experiment], unseen: &[&Run]) -> Vec<ExcludedSpan> {
    let to = identified.iter().map(|experiment| experiment.settling).reduce(f64::min).unwrap_or(0.0);
    let runs = unseen.iter().filter(|run| to > 0.0 && run.data.period.is_none());
    runs.map(|run| ExcludedSpan { run: run.data.name.clone(), from: 0.0, to }).collect()
}

/// What differs between the periods of runs that follow their own motion, by their plain model.
fn changed(question: &Question, plain: &TorqueModel, experiments: &[Experiment]) -> Changing {
    let operating_point = question.structure.operating_point(&plain.beta());
    changing(&operating_point, &trials(experiments, question.identify), |motion| plain.predict(motion))
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
    use plumbline_model::Mounting;

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
            let Prepared { identify: identified, unseen, .. } = prepared(&question).unwrap();
            let edge = unseen[0].motion.start;
            let out = unseen[0].resting().iter().take_while(|out| **out).count();
            let least = identified.iter().map(|one| one.settling).fold(f64::INFINITY, f64::min);
            (least, if out > 0 { edge + out as f64 * unseen[0].motion.dt } else { 0.0 })
        };
        let (least, out) = left_out(&[&soon, &late]);
        assert!(least > 0.2 && (out - least).abs() < 2e-3, "{out} {least}");
        assert!(least < left_out(&[&late]).0, "of several runs the one that repeats first");
        assert_eq!(left_out(&[&soon, &settled]), (0.0, 0.0));
    }
}
