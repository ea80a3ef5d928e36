//! The whole way: base fit, selection, veto by unseen data, adequacy, verdict.

use super::Settings;
use super::curves;
use super::delivery::Delivery;
use super::detectable;
use super::evidence::{Evidence, Trial};
use super::fallback::{self, Unexplained};
use super::fit::{LEAST, Problem, group};
use super::gates;
use super::library::{Candidate, library, repeatable};
use super::outcome::{Confirmation, Effect, Estimate, Fitted, JointFacts, Outcome, Verdict};
use super::parts;
use super::select::{Search, Selected, Step};
use super::state::{State, every};
use super::unseen::{Unseen, columns_of};
use nalgebra::DVector;
use plumbline_identify::solve::identify_with;
use plumbline_identify::{EstimateError, Experiment, solve};
use plumbline_model::Structure;
use plumbline_model::term::effect;
use plumbline_model::term::effect::Ground;

/// What is diagnosed.
pub struct Input<'a> {
    /// The plain model.
    pub structure: &'a Structure,
    /// Runs to identify from.
    pub identify: &'a [Trial<'a>],
    /// Runs that a finding has to hold on before it is believed; not fitted.
    pub veto: &'a [Trial<'a>],
    /// Runs that nothing is decided with but whether a joint is explained; not fitted.
    pub judge: &'a [Trial<'a>],
    /// How parameters are identified.
    pub options: &'a solve::Options,
}

impl<'a> Input<'a> {
    /// Runs that the model was not fitted to, where there are any.
    pub(super) fn unseen(&self) -> &'a [Trial<'a>] {
        [self.judge, self.veto].into_iter().find(|runs| !runs.is_empty()).unwrap_or(self.identify)
    }
}

/// What a joint's effects have to explain of what was unmodelled there, to be called an explanation.
const EXPLAINED: f64 = 0.9;
/// Times the noise of the mean period that an explanation may leave.
const LEFT_OVER: f64 = 2.5;
/// Share of what is left over that has to follow some variables to be called unexplained, where the noise is not known.
const FOLLOWS: f64 = 0.25;
/// Lack of fit from which on a residual is unexplained that follows no variable.
const FLAT: f64 = 2.0;
/// Times that the load is computed anew with the parameters of the model with effects,
const GROUNDS: usize = 8;
/// and twice the gain in log likelihood from which on it is worth another time.
const GROUND_GAIN: f64 = 4.0;
/// What is unmodelled counts from this share of the noise of the mean period on.
pub(super) const THRESHOLD: f64 = 0.75;

/// Diagnoses a set of runs of one arm. `progress` hears of every step.
///
/// # Errors
/// As [`identify_with`].
pub fn diagnose(input: &Input, settings: &Settings, progress: &dyn Fn(&Step)) -> Result<Outcome, EstimateError> {
    let structure = input.structure;
    let experiments: Vec<Experiment> = input.identify.iter().map(|trial| trial.experiment.clone()).collect();
    let before = identify_with(structure, &experiments, input.options)?;
    let evidence = Evidence::of(structure.chain(), input.identify, settings.band);
    let columns = columns_of(&evidence, structure, input.identify);
    let base = State::base(&Problem { evidence: &evidence, prior: None }, columns);
    // Columns that follow the load need parameters; the plain model's are near enough to begin with.
    let ground = structure.ground(base.fit.theta.as_slice());
    let candidates = library(&evidence, &ground, &repeatable(), None, settings.threads);
    let problem = Problem { evidence: &evidence, prior: None };
    let search = Search { problem, ground: &ground, library: &candidates, settings };
    let seeds = seeds(&search, &base);
    let mut draft = search.forward(base.clone(), &seeds, progress);
    let settled = settled(structure, &search, &mut draft.state);
    let ground = settled.as_ref().unwrap_or(&ground);
    let search = search.upon(ground);
    let selected = search.finish(draft, progress);
    let selected = vetoed(&search, selected, input, settings);

    let unseen = Evidence::of(structure.chain(), input.unseen(), settings.band);
    let (lacks, adequacy) = {
        let model = Unseen::of(&unseen, structure, input.unseen(), &selected.state, ground);
        let lacks = model.lacks(&base.fit.theta);
        let adequacy = model.explained(&lacks, &selected.state.fit.theta);
        (lacks, adequacy)
    };
    let delivery =
        Delivery { input, unseen: &unseen, experiments: &experiments, before: &before, seeds: &seeds, settings };
    let full = matches!(confirmation(&evidence), Confirmation::Full { .. });
    let confirmed: Vec<bool> = selected.found.iter().map(|found| full && found.folds.confirm() == Some(true)).collect();
    let (after, withheld) = delivery.of(&selected, &lacks, &adequacy, &confirmed)?;
    let kept: Vec<bool> = withheld.iter().map(Option::is_none).collect();
    let mut effects = effects_of(&search, &selected, &kept, &adequacy, &after);
    for effect in &mut effects {
        let index = selected.state.items.iter().position(|item| item.spec == effect.spec);
        effect.withheld = index.and_then(|index| withheld[index].clone());
    }
    // What the delivered model leaves over.
    let left = if kept.iter().any(|kept| *kept) { &selected.state } else { &base };
    let left_out = (evidence.folds().len() > 1).then(|| gates::left_out(&search.problem, &base, left));
    let facts = |joint: usize| {
        let left_out = left_out.as_ref().map(|errors| errors[joint]);
        JointFacts { left_out, adequacy: adequacy[joint], ..facts(&evidence, settings, joint, &base, left) }
    };
    let joints: Vec<JointFacts> = (0..evidence.joints()).map(facts).collect();
    let unexplained = unexplained(&evidence, left, settings, &joints, &adequacy);
    let verdict = verdict(&effects, &unexplained);
    let curves = curves::of(&search, &base, left, &unexplained);
    let (detectable, hidden) = detectable::of(&search, &base);
    Ok(Outcome {
        verdict,
        confirmation: confirmation(&evidence),
        effects,
        joints,
        before: Fitted { structure: structure.clone(), identification: before },
        after,
        detectable,
        hidden,
        unexplained,
        curves,
        path: selected.path,
        ranking: selected.first.iter().map(|one| (one.item.spec.clone(), one.score)).collect(),
    })
}

/// Effects that follow the load were found upon the parameters of the plain model, which their lack has bent: brings them upon those of the model with
/// the effects, until the likelihood has settled. The ground that they stand on then; `None` where the old one is as good.
fn settled(structure: &Structure, search: &Search, state: &mut State) -> Option<Ground> {
    let mut settled = None;
    for _ in 0..GROUNDS {
        let ground = structure.ground(state.fit.theta.as_slice());
        let Some(moved) = search.upon(&ground).upon_ground(state) else { break };
        let gain = 2.0 * (moved.fit.likelihood - state.fit.likelihood);
        if gain <= 0.0 {
            break;
        }
        (*state, settled) = (moved, Some(ground));
        if gain < GROUND_GAIN {
            break;
        }
    }
    settled
}

/// Every torque sensor has an offset. Where nothing tells the noise, the model starts with all of them, and they have to hold: left to
/// the search, a spring or another joint's load would take the place of one that it had not yet found.
fn seeds(search: &Search, base: &State) -> Vec<Candidate> {
    if search.problem.evidence.repeats() {
        return Vec::new();
    }
    let offset = |item: &&Candidate| {
        item.spec.family().is_ok_and(|family| family.rare.in_every_arm)
            && base.try_in(&search.problem, item).is_some_and(|tried| tried.independence > LEAST)
    };
    search.library.iter().filter(offset).cloned().collect()
}

fn confirmation(evidence: &Evidence) -> Confirmation {
    match (evidence.repeats(), evidence.folds().len()) {
        (true, 1) => Confirmation::OneTrajectory,
        (true, trajectories) => Confirmation::Full { trajectories },
        (false, blocks) => Confirmation::NoRepeats { blocks },
    }
}

/// Takes out every effect without which the unseen runs are predicted no worse.
fn vetoed(search: &Search, mut selected: Selected, input: &Input, settings: &Settings) -> Selected {
    if input.veto.is_empty() || selected.state.items.is_empty() {
        return selected;
    }
    let evidence = Evidence::of(input.structure.chain(), input.veto, settings.band);
    let mut item = 0;
    while item < selected.state.items.len() {
        let state = &selected.state;
        let unseen = Unseen::of(&evidence, input.structure, input.veto, state, search.ground);
        let rest = state.without(&search.problem, item);
        // The parameters without it, at their places among the columns with it.
        let gone = state.range(item);
        let theta = rest.fit.theta.clone().insert_rows(gone.start, gone.len(), 0.0);
        let error = |theta: &DVector<f64>| -> f64 {
            let weighed = |joint: usize| {
                let phi = &state.fit.phi[group(joint, 0)..group(joint + 1, 0)];
                let scale = phi.iter().sum::<f64>() / phi.len() as f64;
                unseen.residual(joint, theta).norm_squared() / scale
            };
            (0..unseen.evidence.joints()).map(weighed).sum()
        };
        if error(&theta) > error(&state.fit.theta) {
            item += 1;
            continue;
        }
        let gone = state.items[item].clone();
        let unmodelled =
            (0..search.problem.evidence.joints()).map(|joint| rest.unmodelled(search.problem.evidence, joint));
        let score = selected.found[item].score;
        selected.path.push(Step { item: gone, added: false, score, unmodelled: unmodelled.sum() });
        selected.found.remove(item);
        selected.state = rest;
        item = 0;
    }
    selected
}

fn effects_of(
    search: &Search,
    selected: &Selected,
    kept: &[bool],
    adequacy: &[Option<f64>],
    after: &Fitted,
) -> Vec<Effect> {
    let state = &selected.state;
    let mut effects = Vec::new();
    for (index, (item, found)) in state.items.iter().zip(&selected.found).enumerate() {
        let names = item.spec.build(search.ground).map(|term| term.columns()).unwrap_or_default();
        let fitted = |k: usize| {
            let at = state.range(index).start + k;
            (state.fit.theta[at], Some(state.fit.h[(at, at)].max(0.0).sqrt()))
        };
        let delivered = |name: &str| {
            let at = after.structure.columns().iter().position(|column| column.name == name)?;
            Some((after.identification.beta[at], after.identification.std[at]))
        };
        let estimate = |(k, column): (usize, &plumbline_model::term::Column)| {
            let (value, std) = delivered(&column.name).filter(|_| kept[index]).unwrap_or_else(|| fitted(k));
            Estimate { name: column.name.clone(), value, std, unit: column.unit }
        };
        effects.push(Effect {
            spec: item.spec.clone(),
            since: item.since,
            parameters: names.iter().enumerate().map(estimate).collect(),
            settings: settings_of(search, state, index),
            evidence: found.evidence,
            penalty: found.penalty,
            score: found.score,
            folds: found.folds,
            relevance: found.relevance.clone(),
            independence: found.independence,
            adequacy: adequacy[found.relevance.joint],
            rivals: found.rivals.clone(),
            in_model: kept[index],
            withheld: None,
        });
    }
    let friction = |joint: usize| {
        let name = format!("fc{}", joint + 1);
        let at = after.structure.columns().iter().position(|column| column.name == name)?;
        Some(after.identification.beta[at])
    };
    parts::together(effects, friction)
}

/// Nonlinear parameters with standard deviations from the curvature of the likelihood about them.
fn settings_of(search: &Search, state: &State, index: usize) -> Vec<Estimate> {
    let item = &state.items[index];
    let Some(form) = item.spec.family().ok().and_then(|family| family.form(item.spec.form)) else { return Vec::new() };
    let rest = state.without(&search.problem, index);
    let likelihood = |which: usize, share: f64| {
        let mut moved = item.spec.clone();
        let setting = &form.settings[which];
        moved.settings[which] = setting.at(share).clamp(setting.low, setting.high);
        let moved = super::library::Candidate::of(search.problem.evidence, search.ground, moved, item.since)?;
        let cross = rest.columns.cross(search.problem.evidence, &moved.rows);
        Some(search.problem.gain(&rest.fit, &cross, &every, None)?.evidence)
    };
    let estimate = |(which, setting): (usize, &effect::Setting)| {
        let value = item.spec.settings[which];
        let share = setting.share(value);
        let h = 0.25 * setting.spacing();
        let std = (|| {
            let (low, high) = ((share - h).max(0.0), (share + h).min(1.0));
            let middle = 0.5 * (low + high);
            let bend = likelihood(which, low)? - 2.0 * likelihood(which, middle)? + likelihood(which, high)?;
            let step = 0.5 * (high - low);
            // The evidence is twice the log likelihood: 1 / variance is minus half of its second derivative.
            let variance = -2.0 * step * step / bend;
            let slope = (setting.at((share + 1e-4).min(1.0)) - setting.at((share - 1e-4).max(0.0))) / 2e-4;
            (variance > 0.0).then(|| variance.sqrt() * slope.abs())
        })();
        Estimate { name: setting.name.to_string(), value, std, unit: setting.unit }
    };
    form.settings.iter().enumerate().map(estimate).collect()
}

fn facts(evidence: &Evidence, settings: &Settings, joint: usize, base: &State, after: &State) -> JointFacts {
    let floor = evidence.floor(joint);
    let ratio = |state: &State| state.residual(joint).norm_squared() / evidence.per_joint() as f64;
    JointFacts {
        floor,
        rms: [base, after].map(|state| state.mean_square(evidence, joint).sqrt()),
        unmodelled: [base, after].map(|state| state.unmodelled(evidence, joint).sqrt()),
        lack_of_fit: floor.map(|_| [base, after].map(ratio)),
        threshold: settings.threshold.unwrap_or(THRESHOLD * floor.unwrap_or(0.0)),
        ..JointFacts::default()
    }
}

/// Joints in which the model lacks something that no effect explains. Where the noise is not known, those in which what is left over
/// follows some variables.
fn unexplained(
    evidence: &Evidence,
    state: &State,
    settings: &Settings,
    joints: &[JointFacts],
    adequacy: &[Option<f64>],
) -> Vec<Unexplained> {
    let mut found = Vec::new();
    for (joint, facts) in joints.iter().enumerate() {
        // A share of much may still leave more than noise can be.
        let little = facts.floor.is_some_and(|floor| facts.unmodelled[1] <= LEFT_OVER * floor);
        let explained = little && adequacy[joint].is_some_and(|share| share >= EXPLAINED);
        if evidence.repeats() && (explained || !facts.lacking(1)) {
            continue;
        }
        let one = fallback::unexplained(evidence, state, joint, settings);
        let counts = match facts.lack_of_fit {
            // The noise of the positions goes through the model into the mean, and the scatter of the torques knows nothing of it: so much may
            // be left over that follows no variable.
            Some([_, after]) => !one.flat() || after > FLAT,
            None => one.r2() > FOLLOWS,
        };
        if counts {
            found.push(one);
        }
    }
    found
}

fn verdict(effects: &[Effect], unexplained: &[Unexplained]) -> Verdict {
    let found = effects.iter().any(|effect| effect.in_model);
    let rivals = effects.iter().any(|effect| effect.in_model && !effect.rivals.is_empty());
    match (found, !unexplained.is_empty()) {
        (false, false) => Verdict::NothingSignificant,
        (false, true) => Verdict::Unexplained,
        (true, true) => Verdict::Partly,
        (true, false) if rivals => Verdict::Ambiguous,
        (true, false) => Verdict::Diagnosed,
    }
}
