//! One case from the arm to the judgement: simulated, recorded, diagnosed without a word about the truth, then compared with it.

use super::case::{Case, Injected};
use crate::scene::DT;
use crate::scene::lab::{self, Noise, Period};
use nalgebra::{DMatrix, DVector};
use plumbline_core::transposed_product;
use plumbline_diagnose::{
    Columns, Effect, Evidence, Input, Outcome, Residual, Settings, Trial, Verdict, diagnose, inverse, mean_square,
};
use plumbline_excite::Plan;
use plumbline_identify::{Experiment, solve};
use plumbline_model::term::effect::{Site, Spec, family};
use plumbline_model::{Chain, Reduction, Structure};
use plumbline_sim::Truth;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;
use std::time::Instant;

const PERIODS: usize = 10;
/// First-order noise besides the white noise of the arm's file \[Nm\].
const COLOURED: f64 = 0.05;
/// RMS of the repeatable background in each joint \[Nm\].
const BACKGROUND: f64 = 0.05;

pub struct Judged {
    /// For each injected effect: what re-identification leaves of all that was injected, in the joint where it shows most, over the noise
    /// floor there.
    pub ratio: f64,
    pub verdict: Verdict,
    pub found: Vec<Spec>,
    /// Those found but not delivered, and the rivals of all.
    pub others: Vec<Spec>,
    /// For each injected effect, whether an effect of the model is it.
    pub right: Vec<bool>,
    pub listed: Vec<bool>,
    pub extra: usize,
    /// RMS of the worst joint's residual over the floor of the judge run, before and after.
    pub held_out: [f64; 2],
    /// What the diagnosis says about the joint of a foreign effect, where it calls it unexplained.
    pub fallback: Option<Residual>,
    pub seconds: f64,
}

pub struct Bench {
    pub chain: Chain,
    pub base: Truth,
    pub identify: Vec<Plan>,
    pub validate: Vec<Plan>,
}

impl Bench {
    #[allow(clippy::new_without_default)]
    pub fn new() -> Bench {
        let base = crate::sim::arm("sim-panda");
        let chain = plumbline_model::Robot::load("panda", None).expect("a shipped robot").chain;
        let [identify, validate] = lab::plans();
        Bench { chain, base, identify, validate }
    }

    /// Simulation, identification and diagnosis; `threads` applies to the diagnosis only.
    pub fn judge(&self, case: &Case, threads: usize) -> Judged {
        let truth = Truth::parse("case", &case.truth).unwrap_or_else(|error| panic!("{error}\n{}", case.truth));
        let plans = self.identify[..case.trajectories].iter().chain(&self.validate);
        let mut periods: Vec<Period> =
            plans.map(|plan| lab::period(&self.chain, &truth, plan, case.mounting, &plan.seed.to_string())).collect();
        if let Some(seed) = case.background {
            add_background(&mut periods, seed);
        }
        let experiments: Vec<Experiment> = (0..periods.len())
            .map(|k| {
                let seed = case.noise.wrapping_add(k as u64);
                let run = periods[k].record(&truth, PERIODS, Noise { coloured: COLOURED }, seed);
                Experiment::prepare(&run, &plumbline_identify::Settings::default()).expect("an even, periodic run")
            })
            .collect();
        let trials = Trial::in_turn(&experiments);
        let reduction = Reduction::in_mounting(&self.chain, &case.mounting);
        let structure = Structure::of(self.chain.clone(), reduction, &["friction"]).expect("a shipped term");
        let (identify, rest) = trials.split_at(case.trajectories);
        let (veto, judge) = rest.split_at(1);
        let settings = Settings { threads, ..Settings::default() };
        let input =
            Input { structure: &structure, identify, veto, judge, options: &solve::Options::default(), came: &[] };
        let start = Instant::now();
        let outcome = diagnose(&input, &settings, &|_| ()).expect("exciting motions");
        let seconds = start.elapsed().as_secs_f64();

        let evidence = Evidence::of(&self.chain, identify, settings.band);
        let foreign = case.effects.iter().find(|one| one.family == "foreign").map(|one| one.site.joints()[0]);
        let fallback = outcome.residuals.iter().find(|one| Some(one.joint) == foreign).cloned();
        let ratio = unabsorbed(&evidence, &structure, identify, &periods);
        let held_out = [&outcome.before, &outcome.after]
            .map(|model| worst(&self.chain, &model.structure, &model.identification.beta, judge, &settings));
        judged(case, &outcome, Judgement { ratio, held_out, fallback, seconds })
    }
}

fn columns(evidence: &Evidence, structure: &Structure, trials: &[Trial]) -> Columns {
    Columns { m: evidence.regressor(structure, trials), r: evidence.torques(trials) }
}

/// RMS of the residual of the worst joint over its noise, on runs that the model was not fitted to.
fn worst(chain: &Chain, structure: &Structure, beta: &[f64], trials: &[Trial], settings: &Settings) -> f64 {
    let evidence = Evidence::of(chain, trials, settings.band);
    let columns = columns(&evidence, structure, trials);
    let beta = DVector::from_column_slice(beta);
    let ratio = |joint: usize| {
        let residual = &columns.r[joint] - &columns.m[joint] * &beta;
        mean_square(&evidence, joint, &residual).sqrt() / evidence.floor(joint).expect("repeats")
    };
    (0..chain.len()).map(ratio).fold(0.0, f64::max)
}

/// What the plain model leaves of the torques without noise, weighted least squares over the identification runs: RMS of the joint where it is
/// largest against the noise of the mean period, over that noise.
fn unabsorbed(evidence: &Evidence, structure: &Structure, trials: &[Trial], periods: &[Period]) -> f64 {
    let m = evidence.regressor(structure, trials);
    let clean = |joint: usize| {
        let of = |(k, period): (usize, &Period)| {
            let step = (evidence.motion(k).dt / DT).round() as usize;
            let samples = period.tau.nrows() / step;
            DMatrix::from_fn(samples, 1, |row, _| period.tau[(row * step + step / 2, joint)])
        };
        let samples: Vec<DMatrix<f64>> = periods[..trials.len()].iter().enumerate().map(of).collect();
        evidence.project(joint, &samples).column(0).into_owned()
    };
    let r: Vec<DVector<f64>> = (0..m.len()).map(clean).collect();
    let width = m[0].ncols();
    let (mut g, mut b) = (DMatrix::zeros(width, width), DVector::zeros(width));
    for (m, r) in m.iter().zip(&r) {
        g += transposed_product(m, m);
        b += m.tr_mul(r);
    }
    let theta = inverse(&g) * b;
    let ratio = |joint: usize| {
        let left = &r[joint] - &m[joint] * &theta;
        mean_square(evidence, joint, &left).sqrt() / evidence.floor(joint).expect("repeats")
    };
    (0..m.len()).map(ratio).fold(0.0, f64::max)
}

/// A mixture of small torques that no single effect explains, functions of the joint state, of the same RMS in every joint.
fn add_background(periods: &mut [Period], seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let n = periods[0].q.ncols();
    for joint in 0..n {
        let mut parts = Vec::new();
        for _ in 0..4 {
            let (first, second) = (rng.random_range(0..n), rng.random_range(0..n));
            let order: f64 = rng.random_range(1.0..8.0);
            let (phase, height): (f64, f64) = (rng.random_range(0.0..TAU), rng.sample(StandardNormal));
            let (kind, middle): (usize, f64) = (rng.random_range(0..3), rng.random_range(-1.5..1.5));
            parts.push((first, second, order, phase, height, kind, middle));
        }
        let value = |q: &DMatrix<f64>, k: usize| -> f64 {
            let samples = q.nrows();
            let of =
                |&(first, second, order, phase, height, kind, middle): &(usize, usize, f64, f64, f64, usize, f64)| {
                    let wave = (order * q[(k, first)] + phase).sin();
                    let speed =
                        (q[((k + 1) % samples, second)] - q[((k + samples - 1) % samples, second)]) / (2.0 * DT);
                    height
                        * match kind {
                            0 => wave,
                            1 => wave * (speed / 0.2).tanh(),
                            _ => wave * (-((q[(k, second)] - middle) / 0.7).powi(2)).exp(),
                        }
                };
            parts.iter().map(of).sum()
        };
        let added: Vec<Vec<f64>> =
            periods.iter().map(|period| (0..period.q.nrows()).map(|k| value(&period.q, k)).collect()).collect();
        let count = added.iter().map(Vec::len).sum::<usize>() as f64;
        let mean = added.iter().flatten().sum::<f64>() / count;
        let square = added.iter().flatten().map(|x| (x - mean).powi(2)).sum::<f64>() / count;
        let scale = BACKGROUND / square.sqrt().max(1e-9);
        for (period, added) in periods.iter_mut().zip(&added) {
            for (k, value) in added.iter().enumerate() {
                period.tau[(k, joint)] += scale * value;
            }
        }
    }
}

/// Whether an effect is the injected one: the same family at the same place; friction between two joints takes torque of both, so either of
/// the two is right.
pub fn same(spec: &Spec, truth: &Injected) -> bool {
    let place = match (spec.site, truth.site) {
        (Site::Pair { row, cause }, Site::Pair { row: own_row, cause: own_cause }) => {
            let turned = spec.family == "transmission-coupling" && truth.text.contains("ratio");
            (row, cause) == (own_row, own_cause) || turned && (cause, row) == (own_row, own_cause)
        }
        (site, own) => site == own,
    };
    spec.family == truth.family && place
}

/// Whether an effect is a part of what was injected: LuGre friction that breaks away above its Coulomb friction is Stribeck's as well.
fn part_of(spec: &Spec, truth: &Injected) -> bool {
    let weakens = truth.family == "presliding" && truth.text.contains("breakaway");
    weakens && spec.family == "stribeck" && spec.site == truth.site
}

struct Judgement {
    ratio: f64,
    held_out: [f64; 2],
    fallback: Option<Residual>,
    seconds: f64,
}

/// An effect by its names in files, without its settings; joints count from 1.
fn named(id: &str, form: &str, joints: &[usize]) -> Spec {
    let family = family(id).expect("an effect of the catalogue");
    let site = match *joints {
        [] => Site::Arm,
        [joint] => Site::Joint(joint - 1),
        [row, cause, ..] => Site::Pair { row: row - 1, cause: cause - 1 },
    };
    Spec { family: family.id, form: family.form(form).map_or("", |form| form.name), site, settings: Vec::new() }
}

fn judged(case: &Case, outcome: &Outcome, part: Judgement) -> Judged {
    let effects = &outcome.diagnosis.effects;
    let (kept, left): (Vec<&Effect>, Vec<&Effect>) = effects.iter().partition(|effect| effect.in_model);
    let own = |effect: &&Effect| named(&effect.id, &effect.form, &effect.joints);
    let rivals = |effects: &[&Effect]| -> Vec<Spec> {
        let all = effects.iter().flat_map(|effect| &effect.alternatives_detail);
        all.map(|rival| named(&rival.id, "", &rival.joints)).collect()
    };
    let found: Vec<Spec> = kept.iter().map(own).collect();
    let mut others = rivals(&kept);
    others.extend(left.iter().map(own));
    others.extend(rivals(&left));
    let right: Vec<bool> = case.effects.iter().map(|truth| found.iter().any(|spec| same(spec, truth))).collect();
    let listed = case.effects.iter().zip(&right);
    let listed = listed.map(|(truth, right)| *right || others.iter().any(|spec| same(spec, truth))).collect();
    let injected = |spec: &&Spec| case.effects.iter().any(|truth| same(spec, truth) || part_of(spec, truth));
    let extra = found.iter().filter(|spec| !injected(spec)).count();
    Judged {
        ratio: part.ratio,
        verdict: outcome.diagnosis.verdict,
        found,
        others,
        right,
        listed,
        extra,
        held_out: part.held_out,
        fallback: part.fallback,
        seconds: part.seconds,
    }
}
