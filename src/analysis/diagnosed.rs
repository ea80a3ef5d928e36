//! A diagnosis from recorded runs, and what the report says of it: shared by `diagnose` and the estimator.

use crate::analysis::changed::{alternatives, joints, label, steps};
use crate::analysis::changing::Looked;
use crate::analysis::pipeline::{self, Identified};
use crate::dataset::Run;
use crate::failure::Failure;
use crate::process::progress;
use crate::report::figures::{DiagnosisFigures, EffectFigure, MapFigure, PeriodFigure, SpectrumFigure};
use crate::report::{Band, diagnosis as told};
use plumbline_core::{parallel, threads};

use plumbline_diagnose::errors::{Compared, Of};
use plumbline_diagnose::{Confirmation, Effect, Fitted, Input, Outcome, Trial, Unexplained, Verdict, diagnose, errors};
use plumbline_identify::{Experiment, Modelled, Settings, solve};
use plumbline_model::term::effect::{Spec, Stratum};
use plumbline_model::{Robot, Structure, TorqueModel};

/// Candidates that the report lists.
const LISTED: usize = 10;

/// What is diagnosed and how.
pub struct Question<'a> {
    /// The arm.
    pub robot: &'a Robot,
    /// The plain model.
    pub structure: &'a Structure,
    /// Runs to identify from.
    pub identify: &'a [&'a Run],
    /// Runs that nothing is fitted to.
    pub unseen: &'a [&'a Run],
    /// How runs are made ready.
    pub settings: &'a Settings,
    /// How parameters are identified.
    pub options: &'a solve::Options,
    /// How the diagnosis is done.
    pub diagnosis: &'a plumbline_diagnose::Settings,
    /// What the errors before and after are taken of.
    pub of: Of,
}

/// A diagnosis and what follows from it.
pub struct Diagnosed {
    /// The model with what was found; the plain one where nothing was.
    pub after: Identified,
    /// What the report says.
    pub block: told::Diagnosis,
    /// What it draws.
    pub figures: DiagnosisFigures,
}

/// Diagnoses runs of one arm, with a progress bar.
pub fn run(question: &Question) -> Result<Diagnosed, Failure> {
    pipeline::check_channels(question.identify)?;
    let bar = progress::bar("diagnosing");
    bar.at(0.02, "preparing");
    let looked = Looked::at(question)?;
    let identify = &looked.experiments;
    let unseen = pipeline::experiments(question.unseen, question.settings)?;
    let (identify_trials, unseen_trials) = (trials(identify, question.identify), trials(&unseen, question.unseen));
    // One run to hold the findings against, the others to measure them on; a single one measures.
    let (veto, judge) = unseen_trials.split_at(usize::from(unseen_trials.len() > 1));
    let input =
        Input { structure: question.structure, identify: &identify_trials, veto, judge, options: question.options };
    bar.at(0.1, "looking for effects");
    let share = std::cell::Cell::new(0.2);
    let settings = plumbline_diagnose::Settings { judged_by: question.of, ..question.diagnosis.clone() };
    let outcome = diagnose(&input, &settings, &|step| {
        share.set(share.get() + 0.15 * (0.9 - share.get()));
        bar.at(share.get(), step.item.spec.family);
    })
    .map_err(Failure::job)?;
    bar.at(0.92, "judging");
    let identified = |fitted: &Fitted| {
        let (structure, identification) = (fitted.structure.clone(), fitted.identification.clone());
        pipeline::identified(question.robot, question.identify, structure, identification)
    };
    let (before, after) = (identified(&outcome.before)?, identified(&outcome.after)?);
    let measured = &unseen[veto.len()..];
    let along = |model: &TorqueModel, experiment: &Experiment| Modelled::of(experiment, |motion| model.predict(motion));
    let both = |experiment: &Experiment| (along(&before.model, experiment), along(&after.model, experiment));
    let modelled = parallel(measured, threads(), both);
    let pairs: Vec<_> =
        measured.iter().zip(modelled).map(|(experiment, (before, after))| (experiment, before, after)).collect();
    let compared = errors::compare(&pairs, question.of).unwrap_or_default();
    bar.done();
    let names = question.unseen[veto.len()..].iter().map(|run| run.data.name.clone()).collect();
    let mut block = block(&outcome, &compared, names);
    block.band = match question.of {
        Of::Raw => Band::Raw,
        Of::Filtered => Band::Filtered { cutoff: question.settings.torque_cutoff },
    };
    if let Some(run) = question.unseen[..veto.len()].first() {
        block.notes.push(format!("findings were held against {}, which no figure here is measured on", run.data.name));
    }
    if question.of == Of::Raw && block.noise_floor.is_empty() {
        // Unseen runs that do not repeat: the noise is that of the runs that do.
        block.noise_floor = outcome.after.identification.rms.noise_floor.clone().unwrap_or_default();
    }
    looked.tell(&mut block, &outcome.joints, question.diagnosis.least_floor, question.diagnosis.threshold);
    let figures = figures(&outcome);
    Ok(Diagnosed { after, block, figures })
}

pub fn trials<'a>(experiments: &'a [Experiment], runs: &[&Run]) -> Vec<Trial<'a>> {
    experiments.iter().zip(runs).map(|(experiment, run)| Trial { experiment, session: run.session }).collect()
}

fn errors_of(errors: &errors::Errors) -> told::Errors {
    told::Errors { validate_rms: errors.rms.clone(), intervals: errors.interval.clone() }
}

/// The block `diagnosis` of the report.
fn block(outcome: &Outcome, compared: &Compared, held_out_runs: Vec<String>) -> told::Diagnosis {
    let trajectories = |count: usize| format!("confirmed across {count} trajectories");
    let confirmation = match outcome.confirmation {
        Confirmation::Full { trajectories: count } => trajectories(count),
        Confirmation::OneTrajectory => "one trajectory".into(),
        Confirmation::NoRepeats { .. } => "no repeats".into(),
    };
    let mut notes = Vec::new();
    match outcome.confirmation {
        Confirmation::OneTrajectory => {
            notes.push("one trajectory: no finding could be confirmed on another, each is \"unconfirmed\"".into());
        }
        Confirmation::NoRepeats { blocks } => notes.push(format!(
            "the motions do not repeat, so the noise is not known and nothing can be said to be at its floor; {blocks} blocks of the runs \
             stood in for trajectories"
        )),
        Confirmation::Full { .. } => {}
    }
    for effect in &outcome.effects {
        if let Some(why) = &effect.withheld {
            let name = label(effect.spec.family, effect.spec.site);
            notes.push(format!("{name} was found and is not in the delivered model: {why}"));
        }
    }
    let full = matches!(outcome.confirmation, Confirmation::Full { .. });
    told::Diagnosis {
        verdict: verdict(outcome.verdict),
        confirmation,
        effects: outcome.effects.iter().map(|effect| effect_of(effect, full)).collect(),
        before: errors_of(&compared.before),
        after: errors_of(&compared.after),
        change: Some(errors_of(&compared.change)),
        held_out_runs,
        noise_floor: compared.floor.clone().unwrap_or_default(),
        unexplained: outcome.unexplained.iter().map(|one| unexplained(one, outcome)).collect(),
        minimum_detectable: detectable(outcome),
        not_identifiable: hidden(outcome),
        joints: joint_facts(outcome),
        path: path(outcome),
        scores: scores(outcome),
        notes,
        ..told::Diagnosis::default()
    }
}

fn verdict(verdict: Verdict) -> told::Verdict {
    match verdict {
        Verdict::NothingSignificant => told::Verdict::NothingSignificant,
        Verdict::Diagnosed => told::Verdict::Diagnosed,
        Verdict::Ambiguous => told::Verdict::Ambiguous,
        Verdict::Partly => told::Verdict::Partly,
        Verdict::Unexplained => told::Verdict::Unexplained,
    }
}

fn effect_of(effect: &Effect, full: bool) -> told::Effect {
    let family = effect.spec.family().ok();
    let form = family.and_then(|family| family.form(effect.spec.form));
    let estimate = |one: &plumbline_diagnose::Estimate| told::EffectParameter {
        name: one.name.clone(),
        value: one.value,
        std: one.std,
        unit: one.unit.into(),
    };
    let (alternatives, alternatives_detail) = alternatives(effect.spec.family, &effect.rivals);
    told::Effect {
        id: effect.spec.family.into(),
        joints: joints(effect.spec.site),
        parameters: told::Parameters(effect.settings.iter().chain(&effect.parameters).map(estimate).collect()),
        evidence: Some(effect.score),
        delta_log_likelihood: Some(0.5 * effect.evidence),
        penalty: Some(effect.penalty),
        folds: told::Folds { positive: effect.folds.positive, informative: effect.folds.informative },
        idf: Some(effect.independence),
        torque_rms: effect.relevance.rms.iter().copied().reduce(f64::max),
        explained_share: Some(effect.relevance.share[effect.relevance.joint].max(0.0)),
        adequacy: effect.adequacy,
        alternatives,
        alternatives_detail,
        confirmed: full && effect.folds.confirm() == Some(true),
        stratum: match family.map(|family| family.stratum) {
            Some(Stratum::Changing) => told::Occurrence::Changing,
            Some(Stratum::Reference) => told::Occurrence::Reference,
            _ => told::Occurrence::Repeatable,
        },
        since_session: effect.since,
        in_model: effect.in_model,
        equation: form.map_or(String::new(), |form| form.equation.into()),
        physics: family.map_or(String::new(), |family| family.physics.into()),
        ..told::Effect::default()
    }
}

fn unexplained(one: &Unexplained, outcome: &Outcome) -> told::Unexplained {
    told::Unexplained {
        joint: one.joint + 1,
        rms: Some(one.unmodelled),
        floor: outcome.joints[one.joint].floor,
        depends_on: one.depends_on.iter().map(|variable| variable.to_string()).collect(),
        r2: Some(one.r2()).filter(|r2| r2.is_finite()),
        deciding_experiment: one.experiments.first().cloned().unwrap_or_default(),
        note: one.findings.join(" "),
    }
}

fn detectable(outcome: &Outcome) -> std::collections::BTreeMap<String, told::MinimumDetectable> {
    let n = outcome.joints.len();
    let of = |one: &plumbline_diagnose::Detectable| {
        let (mut torque, mut parameter) = (vec![f64::NAN; n], vec![f64::NAN; n]);
        for &(joint, rms, value) in &one.sites {
            // Of several sites in one joint the one that shows best.
            if torque[joint].is_nan() || rms < torque[joint] {
                (torque[joint], parameter[joint]) = (rms, value);
            }
        }
        let unit = one.unit.to_string();
        let least = told::MinimumDetectable { torque_rms: torque, parameter, unit, ..Default::default() };
        (one.family.to_string(), least)
    };
    outcome.detectable.iter().map(of).collect()
}

fn hidden(outcome: &Outcome) -> Vec<told::NotIdentifiable> {
    let of = |one: &plumbline_diagnose::Hidden| told::NotIdentifiable {
        effect: one.spec.family.into(),
        joints: joints(one.spec.site),
        why: format!(
            "the base parameters take over all but {:.1e} of it; the torques in these mountings do not change",
            one.independence
        ),
    };
    outcome.hidden.iter().map(of).collect()
}

fn joint_facts(outcome: &Outcome) -> Vec<told::JointFacts> {
    let fact = |facts: &plumbline_diagnose::JointFacts| {
        let both = |pair: Option<[f64; 2]>| told::BeforeAfter {
            before: pair.map(|pair| pair[0]),
            after: pair.map(|pair| pair[1]),
        };
        told::JointFacts {
            floor_of_mean: facts.floor,
            lack_of_fit: both(facts.lack_of_fit),
            unmodelled: both(Some(facts.unmodelled)),
            threshold: Some(facts.threshold).filter(|_| facts.floor.is_some()),
            adequacy: facts.adequacy,
            left_out: both(facts.left_out),
            ..told::JointFacts::default()
        }
    };
    outcome.joints.iter().map(fact).collect()
}

fn path(outcome: &Outcome) -> Vec<told::Step> {
    let total: f64 = outcome.joints.iter().map(|joint| joint.unmodelled[0].powi(2)).sum();
    steps("the plain model", total.sqrt(), &outcome.path)
}

fn scores(outcome: &Outcome) -> Vec<told::Score> {
    let same = |a: &Spec, b: &Spec| (a.family, a.site) == (b.family, b.site);
    let chosen = |spec: &Spec| outcome.effects.iter().any(|effect| same(&effect.spec, spec));
    let rival = |spec: &Spec| {
        outcome.effects.iter().flat_map(|effect| &effect.rivals).any(|rival| same(&rival.item.spec, spec))
    };
    let score = |(spec, score): &(Spec, f64)| told::Score {
        label: label(spec.family, spec.site),
        score: *score,
        chosen: chosen(spec),
        equivalent: rival(spec),
    };
    outcome.ranking.iter().take(LISTED).map(score).collect()
}

fn figures(outcome: &Outcome) -> DiagnosisFigures {
    let period = |one: &plumbline_diagnose::Period| PeriodFigure {
        joint: one.joint + 1,
        trajectory: one.run.clone(),
        t: one.t.clone(),
        before: one.before.clone(),
        after: one.after.clone(),
        deviation: one.floor.into_iter().collect(),
    };
    let spectrum = |one: &plumbline_diagnose::Spectrum| SpectrumFigure {
        joint: one.joint + 1,
        f: one.f.clone(),
        before: one.before.clone(),
        after: one.after.clone(),
        noise: one.noise.clone(),
    };
    let effect = |one: &plumbline_diagnose::EffectCurve| EffectFigure {
        title: label(one.spec.family, one.spec.site),
        variable: one.variable.clone(),
        joint: one.joint + 1,
        x: one.x.clone(),
        mean: one.mean.clone(),
        deviation: one.error.clone(),
        fitted: one.x.iter().copied().zip(one.fitted.iter().copied()).collect(),
    };
    let dependence = |one: &Unexplained| {
        let variable = one.singles.first()?.variables[0];
        Some(EffectFigure {
            title: format!("joint {}, unexplained", one.joint + 1),
            variable: format!("{variable} / {}", variable.unit()),
            joint: one.joint + 1,
            x: one.dependence.iter().map(|bin| bin.at).collect(),
            mean: one.dependence.iter().map(|bin| bin.mean).collect(),
            deviation: one.dependence.iter().map(|bin| bin.error).collect(),
            fitted: Vec::new(),
        })
    };
    let map = |one: &Unexplained| {
        let map = one.map.as_ref()?;
        let name = |which: usize| format!("{} / {}", map.variables[which], map.variables[which].unit());
        Some(MapFigure {
            title: format!("joint {}, unexplained", one.joint + 1),
            x_name: name(0),
            y_name: name(1),
            x: edges(&map.x),
            y: edges(&map.y),
            mean: (0..map.y.len())
                .map(|k| (0..map.x.len()).map(|i| map.mean[i * map.y.len() + k].unwrap_or(f64::NAN)).collect())
                .collect(),
        })
    };
    DiagnosisFigures {
        periods: outcome.curves.periods.iter().map(period).collect(),
        effects: outcome.curves.effects.iter().map(effect).collect(),
        spectra: outcome.curves.spectra.iter().map(spectrum).collect(),
        dependences: outcome.unexplained.iter().filter_map(dependence).collect(),
        maps: outcome.unexplained.iter().filter_map(map).collect(),
    }
}

/// Edges of tiles that have these middles.
fn edges(middles: &[f64]) -> Vec<f64> {
    let (Some(first), Some(last)) = (middles.first(), middles.last()) else { return Vec::new() };
    let half = (last - first) / (2.0 * (middles.len() - 1).max(1) as f64);
    let inner = middles.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
    [first - half].into_iter().chain(inner).chain([last + half]).collect()
}
