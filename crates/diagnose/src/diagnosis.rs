//! The whole way: base fit, selection, veto by unseen data, adequacy, verdict.

use super::acting::{self, Acting};
use super::changing::AT_THE_END;
use super::curves;
use super::delivery::{self, Delivery};
use super::detectable;
use super::deviations::Deviations;
use super::disagreement::{Disagreements, above_floor, disagreements};
use super::empirical::{Learned, Learning};
use super::errors::Of;
use super::evidence::{Evidence, Trial};
use super::fallback::{self, Residual};
use super::figures::Curves;
use super::fit::{MIN_INDEPENDENCE_RATIO, Problem};
use super::found::{Watch, steps};
use super::gates;
use super::input::{Input, RULES, Settings};
use super::library::{Candidate, library, repeatable};
use super::open::{OpenQuestions, Question};
use super::outcome::{
    self, Acts, BeforeAfter, Confirmation, Diagnosis, Disagreement, Effect, Fitted, JointFacts, Parameters, Quantity,
    Score, Verdict,
};
use super::parts::{self, Named};
use super::proposals::Scored;
use super::reference;
use super::select::{MAX_LISTED_SCORES, Search, Selected};
use super::span::Span;
use super::state::State;
use super::unseen::{THRESHOLD_FLOOR_RATIO, Unseen, columns_of};
use super::veto::{Deciding, end_where_refuted, vetoed, without_first_terms};
use plumbline_identify::solve::Equations;
use plumbline_identify::{EstimateError, Experiment};
use plumbline_model::term::effect;
use plumbline_model::term::effect::{OperatingPoint, Spec};
use plumbline_model::{Parameter, Structure};
use std::borrow::Cow;

/// What a diagnosis ends with.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// What was found, as it stands in files.
    pub diagnosis: Diagnosis,
    /// The model without effects.
    pub before: Fitted,
    /// The model with those that hold and learned terms; as before where there is none.
    pub after: Fitted,
    /// Residuals of joints in which something is left that no effect explains.
    pub residuals: Vec<Residual>,
    /// Curves for people to look at.
    pub curves: Curves,
    /// What the recorded runs leave open.
    pub open: OpenQuestions,
    /// The runs that were identified from without what acts in a part of the recording; empty where nothing does.
    pub identified: Vec<Experiment>,
    /// The unseen ones, alike.
    pub unseen: Vec<Experiment>,
}

/// Largest number of relinearisations.
const MAX_RELINEARISATIONS: usize = 8;
/// Smallest gain, twice the log likelihood, for another relinearisation.
const MIN_RELINEARISATION_GAIN: f64 = 4.0;

/// Diagnoses a set of runs of one arm. `progress` is called at every step of the selection and with every candidate.
///
/// # Errors
/// As [`Equations::of`] and [`Equations::identify`].
pub fn diagnose(input: &Input, settings: &Settings, progress: &Watch) -> Result<Outcome, EstimateError> {
    let structure = input.structure;
    let experiments: Vec<Experiment> = input.identify.iter().map(|trial| trial.experiment.clone()).collect();
    // The plain model knows nothing of a drift; everything after it is about the arm without.
    let drifting: Vec<Experiment> = experiments.iter().filter_map(Experiment::as_recorded).collect();
    let drifts = drifting.len() == experiments.len();
    let recorded = if drifts { &drifting } else { &experiments };
    let equations = Equations::of(structure.clone(), recorded)?;
    let before = equations.identify(input.options)?;
    let with_drift = drifts.then(|| plain_facts(structure, &trials_of(recorded.iter(), input.identify), settings));
    let evidence = Evidence::of(structure.chain(), input.identify, settings.band);
    let columns = columns_of(&evidence, structure, input.identify);
    let problem = Problem { evidence: &evidence, prior: None };
    let base = State::base(&problem, columns);
    // Columns that depend on the load need parameters: first those of the plain model.
    let operating_point = evidence.operating_point(structure, base.fit.theta.as_slice());
    let mut candidates = library(&evidence, &operating_point, &repeatable(), Span::ALL, settings.threads);
    let in_no_model =
        |item: &Candidate| base.try_in(&problem, item).is_some_and(|tried| tried.independence > MIN_INDEPENDENCE_RATIO);
    let in_parts =
        acting::candidates(&evidence, &operating_point, input.identify, input.came, in_no_model, settings.threads);
    candidates.extend(in_parts);
    let unseen = Evidence::with_noise_of(structure.chain(), input.deciding(), input.identify, settings.band);
    let deciding = Deciding { evidence: &unseen, structure, trials: input.veto };
    // Where the noise is not known, nothing is proved.
    let deciding = Some(deciding).filter(|deciding| evidence.repeats() && !deciding.trials.is_empty());
    let (library, came) = (&candidates, input.came);
    let search = Search { problem, operating_point: &operating_point, library, settings, deciding, came };
    let seeds = seeds(&search, in_no_model);
    let mut draft = search.forward(base.clone(), &seeds, progress);
    let relinearised = relinearise(structure, &search, &mut draft.state);
    let operating_point = relinearised.as_ref().unwrap_or(&operating_point);
    let search = search.at(operating_point);
    let mut selected = search.finish(draft, progress);

    end_where_refuted(&search, &mut selected, &unseen, input);
    let selected = vetoed(&search, selected, input, &unseen);
    let facts_of = |state: &State| {
        (0..evidence.joints()).map(|joint| facts(&evidence, settings, joint, &base, state)).collect::<Vec<_>>()
    };
    let selected =
        without_first_terms(&search, selected, |state| screened(&evidence, state, settings, &facts_of(state)));
    let (before_effects, taken, adequacy) = {
        let model = Unseen::of(&unseen, structure, input.deciding(), &selected.state, operating_point);
        let left_by = |state: &State| model.residuals_of(&search.problem, state, &state.fit.phi);
        let (before, after) = (left_by(&base), left_by(&selected.state));
        let (taken, adequacy) = (model.taken(&before, &after), model.explained(&before, &after));
        (before, taken, adequacy)
    };
    let acting = Acting::of(structure.chain(), &selected.state, operating_point, input.identify);
    let taken_off = || acting.taken_off(input.identify).into_iter().map(Cow::into_owned).collect::<Vec<_>>();
    let without = (!acting.is_empty()).then(taken_off);
    let equations = match &without {
        None if !drifts => equations,
        _ => Equations::of(structure.clone(), without.as_ref().unwrap_or(&experiments))?,
    };
    let experiments = equations.experiments();
    let [veto, judge] = [input.veto, input.judge].map(|trials| acting.taken_off(trials));
    let identified = trials_of(experiments.iter(), input.identify);
    let [veto, judge] = [(&veto, input.veto), (&judge, input.judge)]
        .map(|(own, trials)| trials_of(own.iter().map(|one| &**one), trials));
    let unseen_without = if veto.is_empty() { &identified } else { &veto };
    let delivery = Delivery {
        input,
        unseen: &unseen,
        unseen_without,
        equations: &equations,
        acting: &acting,
        before: &before,
        seeds: &seeds,
        settings,
    };
    let full = matches!(confirmation(&evidence), Confirmation::Full { .. });
    let confirmed: Vec<bool> = selected.found.iter().map(|found| full && found.folds.confirm() == Some(true)).collect();
    let (after, withheld) = delivery.of(&selected, &before_effects, &taken, &confirmed)?;
    let kept: Vec<bool> = withheld.iter().map(Option::is_none).collect();
    let all = effects_of(input, &search, &selected, &withheld, &confirmed, &adequacy, &after);
    // What unseen runs do not show is no finding.
    let (hints, effects): (Vec<Effect>, Vec<Effect>) = all.into_iter().partition(|effect| effect.withheld.is_some());
    let left = &*delivered(&search.problem, &base, &selected.state, &kept);
    let left_out = (evidence.folds().len() > 1).then(|| gates::left_out(&search.problem, &base, left));
    let facts = |joint: usize| {
        let left_out = left_out.as_ref().map_or(BeforeAfter::default(), |errors| BeforeAfter::both(errors[joint]));
        let own = JointFacts { left_out, adequacy: adequacy[joint], ..facts(&evidence, settings, joint, &base, left) };
        with_drift.as_ref().map_or(own, |before| own.since(&before[joint]))
    };
    let joints: Vec<JointFacts> = (0..evidence.joints()).map(facts).collect();
    let screened = screened(&evidence, left, settings, &joints);
    let by_chance = |one: &Residual| !evidence.repeats() && fallback::may_be_chance(&evidence, left, one, settings);
    let unexplained = screened.iter().filter(|one| one.counts() && !by_chance(one));
    let residuals: Vec<Residual> = unexplained.cloned().collect();
    let mut curves = curves::of(&search, &base, left, &residuals);
    // With unknown noise a joint may be too quiet to be called unexplained and still follow a variable.
    let learning = Learning { delivery: &delivery, evidence: &evidence, identified: &identified };
    let Learned { model, terms: empirical, curves: learned, maps } =
        learning.of(&after, if evidence.repeats() { &residuals } else { &screened })?;
    curves.effects.extend(learned);
    curves.maps.extend(maps);
    let compared = delivery.compared(&model, input.measuring());
    let independences = detectable::independences(&search, &base);
    let others = [veto.clone(), judge.clone()].concat();
    let before = Fitted { structure: structure.clone(), identification: before.clone() };
    let plain = Some(&before).filter(|_| kept.contains(&true));
    let Disagreements { different, mut undetermined } =
        disagreements(structure.chain(), &evidence, &identified, &others, &after, plain, settings.band);
    if let Some(floor) =
        compared.as_ref().and_then(|compared| compared.floor.as_ref()).filter(|_| !effects.iter().any(Effect::counts))
    {
        let mut above = above_floor(&others, &after, floor, settings.judged_by);
        above.retain(|one| !different.iter().chain(&undetermined).any(|other| other.run == one.run));
        undetermined.extend(above);
    }
    let mut diagnosis = Diagnosis {
        verdict: verdict(&effects, residuals.is_empty() && different.is_empty(), undetermined.is_empty()),
        confirmation: Some(confirmation(&evidence)),
        held_out_runs: input.measuring().iter().map(|trial| trial.experiment.name.clone()).collect(),
        unexplained: residuals.iter().map(|one| one.unexplained(joints[one.joint].floor_of_mean)).collect(),
        minimum_detectable: detectable::minimum(&search, &independences),
        not_identifiable: detectable::not_identifiable(&independences),
        path: steps("the plain model", &joints, &selected.path),
        scores: scores(&selected, &effects, input.identify),
        notes: notes(&evidence, input, &hints, acting.any_slow(), &different, &undetermined),
        effects,
        hints,
        empirical,
        joints,
        disagreements: different,
        undetermined,
        rules: RULES.into(),
        ..Diagnosis::default()
    };
    let open = OpenQuestions::of(&search, structure, &selected, diagnosis.verdict, input.identify, settings);
    diagnosis.open = open.questions().map(Question::facts).collect();
    if let Some(compared) = compared {
        let worse = delivery::worse(&compared).map(|joint| delivery::words(&compared, joint));
        let note = |change| format!("unseen runs are predicted worse than by the plain model: {change}");
        diagnosis.notes.extend(worse.map(note));
        diagnosis.change = Some(compared.change.clone());
        diagnosis.set_errors(compared);
    }
    if settings.judged_by == Of::Raw && diagnosis.noise_floor.is_empty() {
        // Unseen runs that do not repeat: the noise is that of the runs that do.
        diagnosis.noise_floor = model.identification.rms.noise_floor.clone().unwrap_or_default();
    }
    let unseen = match acting.is_empty() {
        true => Vec::new(),
        false => others.iter().map(|trial| trial.experiment.clone()).collect(),
    };
    let identified = without.unwrap_or_default();
    Ok(Outcome { diagnosis, before, after: model, residuals, curves, open, identified, unseen })
}

/// The fit of the delivered model, whose residual is what is left: `state` with those effects that are `kept`, `base` without any.
fn delivered<'a>(problem: &Problem, base: &'a State, state: &'a State, kept: &[bool]) -> Cow<'a, State> {
    if !kept.contains(&true) {
        return Cow::Borrowed(base);
    }
    let withheld = (0..kept.len()).rev().filter(|&item| !kept[item]);
    withheld.fold(Cow::Borrowed(state), |state, item| Cow::Owned(state.without(problem, item)))
}

/// Remarks on what the findings were tested on, and on effects that are not delivered.
fn notes(
    evidence: &Evidence,
    input: &Input,
    hints: &[Effect],
    slow: bool,
    disagreements: &[Disagreement],
    undetermined: &[Disagreement],
) -> Vec<String> {
    let mut notes = Vec::new();
    match confirmation(evidence) {
        Confirmation::OneTrajectory => {
            notes.push("one trajectory: no finding could be confirmed on another, each is \"unconfirmed\"".into());
        }
        Confirmation::NoRepeats => notes.push(format!(
            "the motions do not repeat, so the noise is not known and nothing can be said to be at its floor; {} blocks of the runs stood in for \
             trajectories",
            evidence.folds().len()
        )),
        Confirmation::Full { .. } => {}
    }
    if slow {
        notes.push(AT_THE_END.into());
    }
    for hint in hints {
        let why = hint.withheld.as_deref().unwrap_or_default();
        notes.push(format!("{} was found and is not in the delivered model: {why}", hint.place()));
    }
    notes.extend(disagreements.iter().map(|one| {
        let Disagreement { run, joint, rms, expected, .. } = one;
        format!(
            "run {run} differs from the runs that the model was identified from: {rms:.3} Nm in joint {joint}, expected {expected:.3} Nm"
        )
    }));
    notes.extend(undetermined.iter().map(|one| {
        let Disagreement { run, joint, rms, expected, .. } = one;
        format!(
            "run {run} has {rms:.3} Nm in joint {joint} where the noise and what the model lacks make {expected:.3} Nm; the errors of the parameters explain it, \
             or slow noise of few periods, so more periods or a motion that determines them better have to be recorded before more can be said"
        )
    }));
    let also = match input.judge {
        [] => "the errors shown here are of it too, for no other run is unseen",
        _ => "it is in no error shown here",
    };
    let decided = |trial: &Trial| format!("{} decided which findings are delivered; {also}", trial.experiment.name);
    notes.extend(input.veto.iter().map(decided));
    notes
}

/// The best candidates for the plain model.
fn scores(selected: &Selected, effects: &[Effect], trials: &[Trial]) -> Vec<Score> {
    let joints = |spec: &Spec| outcome::joints(spec.site);
    // What begins at about the same time is the same.
    let begin = |acts: &Option<Acts>| acts.as_ref().map(|acts| acts.run.clone());
    let chosen = |spec: &Spec, acts: &Option<Acts>| {
        let same =
            |own: &Effect| own.id == spec.family && own.joints == joints(spec) && begin(&own.acts) == begin(acts);
        effects.iter().any(same)
    };
    let rival = |spec: &Spec| {
        let mut rivals = effects.iter().flat_map(|own| &own.alternatives_detail);
        rivals.any(|rival| rival.id == spec.family && rival.joints == joints(spec))
    };
    let score = |one: &Scored| {
        let (spec, acts) = (one.item.named(), acting::acts(one.item.span, trials));
        let label = acts.as_ref().map_or(spec.to_string(), |acts| format!("{spec} {acts}"));
        Score { label, score: one.score, chosen: chosen(&spec, &acts), equivalent: acts.is_none() && rival(&spec) }
    };
    selected.first.iter().take(MAX_LISTED_SCORES).map(score).collect()
}

/// Re-evaluates columns that depend on parameters at the new estimate until the likelihood converges. Returns the last operating point; `None` where
/// the likelihood does not rise.
fn relinearise(structure: &Structure, search: &Search, state: &mut State) -> Option<OperatingPoint> {
    let mut settled = None;
    for _ in 0..MAX_RELINEARISATIONS {
        let operating_point = search.problem.evidence.operating_point(structure, state.fit.theta.as_slice());
        let Some(moved) = search.at(&operating_point).relinearised(state) else { break };
        let gain = 2.0 * (moved.fit.likelihood - state.fit.likelihood);
        if gain <= 0.0 {
            break;
        }
        (*state, settled) = (moved, Some(operating_point));
        if gain < MIN_RELINEARISATION_GAIN {
            break;
        }
    }
    settled
}

/// Effects that every arm has. Where the noise is unknown, the selection starts with them: otherwise a spring or another joint's load would be
/// selected for an offset that is not yet in the model.
fn seeds(search: &Search, in_no_model: impl Fn(&Candidate) -> bool) -> Vec<Candidate> {
    if search.problem.evidence.repeats() {
        return Vec::new();
    }
    let offset = |item: &&Candidate| item.is_usual() && in_no_model(item);
    search.library.iter().filter(offset).cloned().collect()
}

/// Other experiments of the same runs.
fn trials_of<'a>(experiments: impl Iterator<Item = &'a Experiment>, trials: &[Trial]) -> Vec<Trial<'a>> {
    experiments.zip(trials).map(|(experiment, trial)| Trial { experiment, ..*trial }).collect()
}

fn confirmation(evidence: &Evidence) -> Confirmation {
    match (evidence.repeats(), evidence.folds().len()) {
        (true, 1) => Confirmation::OneTrajectory,
        (true, trajectories) => Confirmation::Full { trajectories },
        (false, _) => Confirmation::NoRepeats,
    }
}

fn effects_of(
    input: &Input,
    search: &Search,
    selected: &Selected,
    withheld: &[Option<String>],
    confirmed: &[bool],
    adequacy: &[Option<f64>],
    after: &Fitted,
) -> Vec<Effect> {
    let state = &selected.state;
    let deviations = Deviations::of(search, state);
    let columns = after.structure.columns().iter().zip(after.identification.values());
    let stored: Vec<Parameter> =
        columns.map(|(column, (value, std))| Parameter { column: column.clone(), value, std }).collect();
    let mut effects = Vec::new();
    for (index, (item, found)) in state.items.iter().zip(&selected.found).enumerate() {
        let in_model = withheld[index].is_none() && item.span.is_all();
        let names = item.spec.build(search.operating_point).map(|term| term.columns()).unwrap_or_default();
        let fitted = |k: usize| {
            let at = state.range(index).start + k;
            (state.fit.theta[at], Some(state.fit.h[(at, at)].max(0.0).sqrt()))
        };
        let delivered = |name: &str| {
            let at = after.structure.columns().iter().position(|column| column.name == name)?;
            Some((after.identification.beta[at], after.identification.std[at]))
        };
        let estimate = |(k, column): (usize, &plumbline_model::term::Column)| {
            let (value, std) = delivered(&column.name).filter(|_| in_model).unwrap_or_else(|| fitted(k));
            let std = std.map(|std| deviations.of_linear(state, state.range(index).start + k, std));
            Quantity { std, ..Quantity::new(&column.name, value, column.unit) }
        };
        let mut linear: Vec<Quantity> = names.iter().enumerate().map(estimate).collect();
        if !item.span.is_all() {
            linear = reference::change(search, state, index, found.clone()).quantities(&stored, None);
        }
        if item.span.is_slow() {
            // As a share of what it was the change is of no use: the model is that of the end.
            linear.truncate(names.len());
            linear.push(Quantity::new("T", item.span.rise, "s"));
        }
        let joint = found.relevance.joint;
        let effect = Effect {
            parameters: Parameters(settings_of(state, index, &deviations).into_iter().chain(linear).collect()),
            adequacy: adequacy[joint],
            explained_share: Some(found.relevance.share[joint].max(0.0)),
            confirmed: confirmed[index],
            in_model,
            withheld: withheld[index].clone(),
            acts: acting::acts(item.span, input.identify),
            ..found.effect(&item.named())
        };
        effects.push(Named { spec: item.spec.clone(), effect });
    }
    parts::together(effects)
}

/// Nonlinear parameters of an effect.
fn settings_of(state: &State, index: usize, deviations: &Deviations) -> Vec<Quantity> {
    let item = &state.items[index];
    let Some(form) = item.spec.form() else { return Vec::new() };
    let estimate = |(which, (setting, value)): (usize, (&effect::Setting, &f64))| {
        let std = deviations.of_setting(state, index, which);
        Quantity { std, ..Quantity::new(setting.name, *value, setting.unit) }
    };
    form.settings.iter().zip(&item.spec.settings).enumerate().map(estimate).collect()
}

fn facts(evidence: &Evidence, settings: &Settings, joint: usize, base: &State, after: &State) -> JointFacts {
    let floor = evidence.floor(joint);
    let ratio = |state: &State| state.residual(joint).norm_squared() / evidence.per_joint() as f64;
    let both = |of: &dyn Fn(&State) -> f64| BeforeAfter::both([base, after].map(of));
    JointFacts {
        floor_of_mean: floor,
        rms: both(&|state| state.mean_square(evidence, joint).sqrt()),
        unmodelled: both(&|state| state.unmodelled(evidence, joint).sqrt()),
        lack_of_fit: floor.map_or(BeforeAfter::default(), |_| both(&ratio)),
        threshold: floor.map(|floor| settings.threshold.unwrap_or(THRESHOLD_FLOOR_RATIO * floor)),
        ..JointFacts::default()
    }
}

/// Facts about each joint under the plain model of these runs.
fn plain_facts(structure: &Structure, trials: &[Trial], settings: &Settings) -> Vec<JointFacts> {
    let evidence = Evidence::of(structure.chain(), trials, settings.band);
    let base = State::base(&Problem { evidence: &evidence, prior: None }, columns_of(&evidence, structure, trials));
    (0..evidence.joints()).map(|joint| facts(&evidence, settings, joint, &base, &base)).collect()
}

/// The residuals of joints in which the model lacks something that no effect explains; where the noise is not known, of all joints.
fn screened(evidence: &Evidence, state: &State, settings: &Settings, joints: &[JointFacts]) -> Vec<Residual> {
    let mut found = Vec::new();
    for (joint, facts) in joints.iter().enumerate() {
        if evidence.repeats() && (facts.is_explained() || !facts.lacking_after()) {
            continue;
        }
        found.push(fallback::unexplained(evidence, state, joint, settings));
    }
    found
}

fn verdict(effects: &[Effect], complete: bool, determined: bool) -> Verdict {
    let found = effects.iter().any(Effect::counts);
    match (found, !complete) {
        (false, false) if determined => Verdict::NothingSignificant,
        (false, false) => Verdict::NotDetermined,
        (false, true) => Verdict::Unexplained,
        (true, true) => Verdict::Partly,
        (true, false) => Verdict::of_all(effects.iter().filter(|effect| effect.counts())),
    }
}
