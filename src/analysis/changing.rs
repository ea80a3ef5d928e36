//! What differs from period to period, looked for before a diagnosis and told beside its findings.

use crate::analysis::diagnosed::{Question, trials};
use crate::analysis::pipeline;
use crate::failure::Failure;
use crate::report::diagnosis::{Diagnosis, Effect, EffectParameter, Folds, Occurrence, Parameters, Verdict, places};
use plumbline_diagnose::JointFacts;
use plumbline_diagnose::changing::{
    BaseMotion, Changing, Contact, Course, Drift, Drifting, LEAST_PERIODS, changing, cleaned,
};
use plumbline_identify::solve::ols;
use plumbline_identify::solve::stack::Stack;
use plumbline_identify::{ExcludedSpan, Experiment, Settings};
use plumbline_model::Structure;
use plumbline_model::term::effect::{Ground, family};
use plumbline_model::term::{base_motion, contact};

/// A run of which more would be left out keeps everything: what fills half of it is not what happened once.
const MOST_LEFT_OUT: f64 = 0.5;
/// Lines of several runs that are nearer than this are one \[Hz\]. A line of a 100 s recording is known to about a hundredth of it.
const SAME_LINE: f64 = 0.03;

/// Runs made ready for a diagnosis, and what differs between their periods.
pub struct Looked {
    /// The runs, without what happened once, and with the noise of what is left.
    pub experiments: Vec<Experiment>,
    found: Changing,
    /// Names of all runs that repeat often enough.
    runs: Vec<String>,
    /// Names of runs that keep everything.
    spared: Vec<String>,
}

impl Looked {
    /// At the runs that are identified from.
    pub fn at(question: &Question) -> Result<Looked, Failure> {
        let settings = Settings { keep_periods: true, ..question.settings.clone() };
        let mut experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
        let enough = |experiment: &&Experiment| {
            experiment.repeats.as_ref().is_some_and(|repeats| repeats.periods.len() >= LEAST_PERIODS)
        };
        let repeating = experiments.iter().filter(enough);
        let runs: Vec<String> = repeating.map(|experiment| experiment.name.clone()).collect();
        let (mut found, mut spared) = (Changing::default(), Vec::new());
        if !runs.is_empty() {
            let ground = known(question.structure, &experiments)?;
            found = changing(&ground, &trials(&experiments, question.identify));
            spared = spare(&mut found.leave_out, &experiments);
        }
        if !found.leave_out.is_empty() {
            let leave_out = settings.leave_out.iter().chain(&found.leave_out).cloned().collect();
            let settings = Settings { leave_out, ..settings };
            experiments = pipeline::for_estimator(question.identify, &settings, question.options)?;
        }
        // Drifts and events would pass for noise; single samples that are off hardly count there.
        if !(found.drifts.is_empty()
            && found.base_motions.is_empty()
            && found.contacts.is_empty()
            && found.transients.is_empty())
        {
            cleaned(&mut experiments, &found);
        }
        if !question.options.estimator.needs_periods() {
            experiments.iter_mut().for_each(|experiment| experiment.repeats = None);
        }
        Ok(Looked { experiments, found, runs, spared })
    }

    /// Adds it to what the report says. `joints` has the noise of the mean periods, of which an effect that matters reaches the share
    /// `least`, or `threshold` \[Nm\] where that is given.
    pub fn tell(&self, block: &mut Diagnosis, joints: &[JointFacts], least: f64, threshold: Option<f64>) {
        let found = &self.found;
        let matters = |rms: &[f64]| {
            let enough = |(rms, facts): (&f64, &JointFacts)| match threshold.or(facts.floor.map(|floor| least * floor))
            {
                Some(least) => *rms >= least,
                None => true,
            };
            rms.iter().zip(joints).any(enough)
        };
        let lines = lines(&found.base_motions);
        let significant = !found.contacts.is_empty()
            || found.drifts.iter().any(|drift| matters(&drift.rms))
            || lines.iter().any(|(line, _)| matters(&line.rms));
        block.verdict = match (block.verdict, significant) {
            (Verdict::NothingSignificant, true) => Verdict::Diagnosed,
            (Verdict::Unexplained, true) => Verdict::Partly,
            (verdict, _) => verdict,
        };
        block.effects.extend(found.drifts.iter().map(|drift| self.drift(drift)));
        block.effects.extend(lines.iter().map(|(line, count)| self.base_motion(line, *count)));
        block.effects.extend(found.contacts.iter().map(touched));
        block.notes.extend(self.notes());
        self.quality(block);
    }

    fn drift(&self, drift: &Drift) -> Effect {
        let joints = match drift.what {
            Drifting::Offset(joint) | Drifting::Friction(joint) => vec![joint + 1],
            Drifting::AllFriction => Vec::new(),
        };
        let form = match drift.course {
            Course::Linear => "linear",
            Course::Saturating { .. } => "exponential",
        };
        let mut parameters = Vec::new();
        for (set, (values, std)) in drift.values.iter().zip(&drift.std).enumerate() {
            for ((name, unit), (value, std)) in drift.what.parameters().iter().zip(values.iter().zip(std)) {
                let unit = if drift.course == Course::Linear { format!("{unit}/min") } else { unit.to_string() };
                let name = match self.runs.get(set).filter(|_| !drift.common) {
                    Some(run) => format!("{name} in {run}"),
                    None => name.to_string(),
                };
                parameters.push(EffectParameter { name, value: *value, std: Some(*std), unit });
            }
        }
        if let Course::Saturating { time } = drift.course {
            parameters.push(number("T", time, "s"));
        }
        Effect {
            joints,
            parameters: Parameters(parameters),
            evidence: Some(drift.score),
            delta_log_likelihood: Some(0.5 * drift.evidence),
            penalty: Some(drift.evidence - drift.score),
            torque_rms: drift.rms.iter().copied().reduce(f64::max),
            explained_share: Some(drift.explained),
            // One set of parameters for all runs is what more than one of them says.
            confirmed: drift.common && self.runs.len() > 1,
            ..changing_effect(drift.what.family(), form)
        }
    }

    fn base_motion(&self, line: &BaseMotion, count: usize) -> Effect {
        let [x, y, z]: [f64; 3] = line.direction.into();
        let amplitude = EffectParameter { std: Some(line.std), ..number("amplitude", line.amplitude, "m/s2") };
        let direction = [("direction_x", x), ("direction_y", y), ("direction_z", z)];
        let direction = direction.map(|(name, share)| number(name, share, "1"));
        let parameters = [number("f", line.frequency, "Hz"), amplitude].into_iter().chain(direction);
        Effect {
            label: format!("base motion at {:.2} Hz", line.frequency),
            parameters: Parameters(parameters.collect()),
            folds: Folds { positive: count, informative: self.runs.len() },
            torque_rms: line.rms.iter().copied().reduce(f64::max),
            explained_share: Some(line.explained),
            confirmed: count > 1,
            ..changing_effect(base_motion::ID, "")
        }
    }

    fn notes(&self) -> Vec<String> {
        let found = &self.found;
        let mut notes = Vec::new();
        if !found.drifts.is_empty() {
            notes.push("the parameters are those of the recordings' mean: what drifts is not in the model".into());
        }
        let mut events: Vec<(&str, f64, f64, String)> = Vec::new();
        for one in &found.contacts {
            events.push((&one.run, one.from, one.to, format!(": contact on link {}", one.link + 1)));
        }
        for one in &found.transients {
            let joints: Vec<usize> = one.joints.iter().map(|joint| joint + 1).collect();
            events.push((&one.run, one.from, one.to, format!(", {}: unexplained transient", places(&joints))));
        }
        events.sort_by(|a, b| a.0.cmp(b.0).then(a.1.total_cmp(&b.1)));
        for (run, from, to, what) in events {
            let left_out = if self.spared.iter().any(|spared| spared == run) { "not left out" } else { "left out" };
            notes.push(format!("run {run}, {from:.2} to {to:.2} s{what}, {left_out}"));
        }
        for one in &found.hygiene {
            let (torques, positions): (usize, usize) = (one.torques.iter().sum(), one.positions.iter().sum());
            let of = |count: usize, what: &str| (count > 0).then(|| format!("{count} of the {what}"));
            let counts: Vec<String> =
                [of(torques, "torques"), of(positions, "positions")].into_iter().flatten().collect();
            if !counts.is_empty() {
                let left_out = if self.spared.contains(&one.run) { "not left out" } else { "left out" };
                let counts = counts.join(" and ");
                notes.push(format!("run {}: single samples that stand out, {counts}, {left_out}", one.run));
            }
        }
        notes.extend(self.spared.iter().map(|run| {
            format!(
                "run {run}: more than half of it would have to be left out, so nothing of it is; its mean has all of it"
            )
        }));
        notes
    }

    fn quality(&self, block: &mut Diagnosis) {
        let sum = |count: &dyn Fn(&plumbline_diagnose::changing::Hygiene) -> usize| -> u64 {
            self.found.hygiene.iter().map(|one| count(one) as u64).sum()
        };
        if self.found.hygiene.is_empty() {
            return;
        }
        let quality = &mut block.quality;
        quality.outliers = Some(sum(&|one| one.torques.iter().chain(&one.positions).sum()));
        quality.repeated_stamps = Some(sum(&|one| one.repeated_stamps));
        for (count, what) in [
            (sum(&|one| one.repeated_rows), "rows repeat the one before"),
            (sum(&|one| one.missing), "samples are missing"),
        ] {
            quality.notes.extend((count > 0).then(|| format!("{count} {what}")));
        }
    }
}

/// The rigid bodies and the friction as a plain identification finds them.
fn known(structure: &Structure, experiments: &[Experiment]) -> Result<Ground, Failure> {
    // Weights matter little for what the gravity columns and the shape of friction are.
    let stack = Stack::of(structure, experiments).map_err(Failure::job)?;
    let plain = ols::solve(&stack).map_err(Failure::job)?;
    Ok(structure.ground(plain.beta.as_slice()))
}

/// Takes the stretches of those runs off the list that would lose too much, and gives their names.
fn spare(leave_out: &mut Vec<ExcludedSpan>, experiments: &[Experiment]) -> Vec<String> {
    let seconds = |run: &str| {
        let of = experiments.iter().find(|experiment| experiment.name == run);
        of.and_then(|experiment| Some((experiment, experiment.repeats.as_ref()?)))
            .map_or(f64::INFINITY, |(experiment, repeats)| repeats.tau.nrows() as f64 * experiment.motion.dt)
    };
    let lost = |run: &str| leave_out.iter().filter(|one| one.run == run).map(|one| one.to - one.from).sum::<f64>();
    let names = experiments.iter().map(|experiment| &experiment.name);
    let spared: Vec<String> = names.filter(|run| lost(run) > MOST_LEFT_OUT * seconds(run)).cloned().collect();
    leave_out.retain(|one| !spared.contains(&one.run));
    spared
}

/// Lines by frequency: the strongest of each, and the number of runs that have it.
fn lines(found: &[BaseMotion]) -> Vec<(&BaseMotion, usize)> {
    let mut lines: Vec<(&BaseMotion, Vec<&str>)> = Vec::new();
    for one in found {
        match lines.iter_mut().find(|(line, _)| (line.frequency - one.frequency).abs() < SAME_LINE) {
            Some((line, runs)) => {
                if !runs.contains(&one.run.as_str()) {
                    runs.push(&one.run);
                }
                if one.amplitude > line.amplitude {
                    *line = one;
                }
            }
            None => lines.push((one, vec![&one.run])),
        }
    }
    lines.into_iter().map(|(line, runs)| (line, runs.len())).collect()
}

fn touched(one: &Contact) -> Effect {
    let mut parameters = vec![number("from", one.from, "s"), number("to", one.to, "s")];
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let std = Some(one.force_std[k]);
        parameters.push(EffectParameter { std, ..number(&format!("force_{axis}"), one.force[k], "N") });
    }
    if let Some(point) = one.point {
        let axes = ["x", "y", "z"].into_iter().zip(point.iter());
        parameters.extend(axes.map(|(axis, at)| number(&format!("point_{axis}"), *at, "m")));
    } else {
        let axes = ["x", "y", "z"].into_iter().zip(one.moment.iter());
        parameters.extend(axes.map(|(axis, moment)| number(&format!("moment_{axis}"), *moment, "Nm")));
    }
    Effect {
        joints: vec![one.link + 1],
        label: format!("contact on link {} in {}, {:.2} to {:.2} s", one.link + 1, one.run, one.from, one.to),
        parameters: Parameters(parameters),
        explained_share: Some(one.explained),
        ..changing_effect(contact::ID, "")
    }
}

fn number(name: &str, value: f64, unit: &str) -> EffectParameter {
    EffectParameter { name: name.into(), value, std: None, unit: unit.into() }
}

fn changing_effect(id: &'static str, form: &str) -> Effect {
    let family = family(id);
    Effect {
        id: id.into(),
        stratum: Occurrence::Changing,
        in_model: false,
        equation: family.and_then(|family| family.form(form)).map_or(String::new(), |form| form.equation.into()),
        physics: family.map_or(String::new(), |family| family.physics.into()),
        ..Effect::default()
    }
}
