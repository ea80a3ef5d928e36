//! Checks against the equations of motion: what is declared, and each common mistake, fitted and compared.
//!
//! Score of a fit: `S = sum_j ln sigma_j` with the RMS residual `sigma_j` of every joint, which orders hypotheses as their likelihoods with unknown
//! noise do. Swapped, shifted or mirrored torques have the same noise, so that their scores compare. The gain of a hypothesis is the fall of `S`.
//! A mistake is reported where it gains in every quarter of the run, and the hypothesis with the largest gain alone: each of them explains a part
//! of what another one causes.

use super::equations::{Equations, Fit, MAX_LAG_S, Prepared, System, structure};
use super::{Finding, State, deviation, physics, torque_unit};
use crate::Run;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{parallel, threads};
use plumbline_model::term::Motion;
use plumbline_model::{G, Mounting, Robot, Structure};

/// Fall of the score that a mistake causes: the product of the joints' residuals halves.
const MIN_GAIN: f64 = std::f64::consts::LN_2;
/// Fall from which on data is refused: the product falls to a tenth.
const FAIL_GAIN: f64 = std::f64::consts::LN_10;
/// Least angle between the fitted and the declared direction of gravity that is refused \[rad\]; smaller tilts are effects that a diagnosis finds.
const MAX_TILT: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Least such angle that is reported \[rad\].
const WARN_TILT: f64 = 8.0 * std::f64::consts::PI / 180.0;
/// Lag below which inertia and friction keep their values: a tenth of a radian of phase at 1 Hz \[s\].
const WARN_LAG_S: f64 = 0.016;
/// Lag from which on data is refused: 0.3 rad at 1 Hz \[s\].
const FAIL_LAG_S: f64 = 0.05;
/// Standard deviations below zero of an inertia or a power that must be positive.
const MIN_DEVIATIONS: f64 = 4.0;
/// Ratio of the residuals of two swapped columns to what they leave as declared.
const MAX_SWAPPED_RATIO: f64 = 0.8;
/// Share of a torque's deviation that a fit leaves, from which on torque and motion have little in common: the fit explains less than 36 % of the
/// variance. A joint that hardly moves leaves as much, so that this alone refuses nothing.
const WARN_LEFT_RATIO: f64 = 0.8;
/// Ratio of the error on an unseen run to that of the fit.
const WARN_UNSEEN_RATIO: f64 = 5.0;
const FAIL_UNSEEN_RATIO: f64 = 20.0;
/// Parts of a run in each of which a hypothesis must gain.
const PARTS: usize = 4;
/// Least equations per parameter.
const MIN_ROWS_RATIO: usize = 3;

/// Another reading of the same data.
struct Alternative {
    check: &'static str,
    place: String,
    joint: Option<usize>,
    gain: f64,
    /// Whether it gains in every part of the run.
    everywhere: bool,
    /// Angle, lag; zero where the alternative has no size.
    size: f64,
    state: State,
    unit: &'static str,
    words: String,
    sigma: Vec<f64>,
}

/// A run with its equations as declared.
struct Declared<'a> {
    run: &'a Run,
    prepared: Prepared,
    motion: Motion,
    equations: Equations,
    system: System,
    tau: DMatrix<f64>,
    fit: Fit,
}

/// Checks runs against the equations of motion of `robot`, those to `identify` from and those to `validate` with. `known` are the arms that the data
/// may be of instead. Runs too short for the equations have no findings.
///
/// | check | compares |
/// |---|---|
/// | `mounting` | the declared direction of gravity with the one that fits best |
/// | `lag` | the torques with themselves up to 0.3 s earlier and later |
/// | `order` | columns of torques and positions with two of them swapped |
/// | `sign` | signs of the columns; inertia and dissipated power, which are positive |
/// | `robot` | the declared robot with others of as many joints |
/// | `fit` | what the fit leaves with the torque's deviation |
/// | `unseen` | the error on runs to validate with, to that of the fit and of its parameters |
pub fn dynamics(robot: &Robot, known: &[Robot], identify: &[&Run], validate: &[&Run]) -> Vec<Finding> {
    let Some(structure) = structure(robot) else { return Vec::new() };
    let runs: Vec<&Run> = identify.iter().chain(validate).copied().collect();
    let declared = parallel(&runs, threads(), |run| declare(&structure, run));
    let mut findings: Vec<Finding> =
        parallel(&declared, threads(), |of| of.as_ref().map_or(Vec::new(), |of| one_run(robot, known, &structure, of)))
            .into_iter()
            .flatten()
            .collect();
    let (seen, unseen) = declared.split_at(identify.len());
    let seen: Vec<&Declared> = seen.iter().flatten().collect();
    findings.extend(unseen.iter().flatten().flat_map(|of| generalises(robot, &seen, of)));
    findings
}

fn declare<'a>(structure: &Structure, run: &'a Run) -> Option<Declared<'a>> {
    let prepared = Prepared::of(run).ok()?;
    if prepared.len() * run.joints() < MIN_ROWS_RATIO * structure.columns().len() {
        return None;
    }
    let motion = prepared.motion();
    let equations = prepared.equations(structure, &motion);
    let system = equations.towards(&run.mounting.gravity());
    let tau = prepared.torques(0.0);
    let fit = system.fit(&tau)?;
    Some(Declared { run, prepared, motion, equations, system, tau, fit })
}

impl Declared<'_> {
    fn alternative(&self, check: &'static str, place: impl Into<String>, fit: &Fit) -> Alternative {
        Alternative {
            check,
            place: place.into(),
            joint: None,
            gain: self.fit.score() - fit.score(),
            everywhere: self.gains_everywhere(fit),
            size: 0.0,
            state: State::Fail,
            unit: "",
            words: String::new(),
            sigma: fit.sigma.clone(),
        }
    }

    fn gains_everywhere(&self, fit: &Fit) -> bool {
        let rows = self.fit.residual.nrows() / PARTS;
        (0..PARTS).all(|part| {
            let score = |fit: &Fit| -> f64 {
                let residual = fit.residual.rows(part * rows, rows);
                residual.column_iter().zip(&fit.sigma).map(|(column, sigma)| column.norm().max(1e-3 * sigma).ln()).sum()
            };
            score(fit) < score(&self.fit)
        })
    }
}

fn one_run(robot: &Robot, known: &[Robot], structure: &Structure, of: &Declared) -> Vec<Finding> {
    let mut alternatives = vec![mounting(of), lag(of)];
    alternatives.extend(order(of));
    alternatives.extend(signs(of));
    // Positions are looked at where the torques leave something to explain: each needs the equations anew.
    if left(of).iter().any(|share| *share > 0.1) {
        alternatives.extend(positions(structure, of));
        alternatives.extend(other_robots(robot, known, of));
    }
    let largest = |check: &str| {
        let own = alternatives.iter().filter(|one| one.check == check);
        own.max_by(|a, b| a.gain.total_cmp(&b.gain))
    };
    let guilty = alternatives
        .iter()
        .filter(|one| one.state > State::Pass && one.everywhere && one.gain > least_gain(one.check))
        .max_by(|a, b| a.gain.total_cmp(&b.gain));
    let mut findings = Vec::new();
    for check in ["mounting", "lag", "order", "sign", "robot"] {
        let chosen = guilty.filter(|one| one.check == check).or_else(|| largest(check));
        let Some(one) = chosen else { continue };
        let finding =
            Finding { joint: one.joint.map(|j| j + 1), ..Finding::new(check, &of.run.name, one.place.clone()) };
        let (value, limit) =
            if one.unit.is_empty() { (one.gain, least_gain(check)) } else { (one.size, limit_of(check)) };
        let finding = finding.measured(value, limit, one.unit);
        let is_guilty = guilty.is_some_and(|guilty| std::ptr::eq(guilty, one));
        findings.push(if is_guilty {
            finding.state(state_of(one)).says(found(robot, of, one), one.words.clone())
        } else {
            finding
        });
    }
    let explained = guilty.is_some();
    findings.extend(positive(structure, of, explained));
    findings.push(unexplained(robot, of, explained));
    findings
}

/// Columns are swapped or are not: a smaller gain is that of a model that lacks something, such as the friction of a light last joint.
fn least_gain(check: &str) -> f64 {
    if check == "order" { FAIL_GAIN } else { MIN_GAIN }
}

fn limit_of(check: &str) -> f64 {
    if check == "lag" { WARN_LAG_S } else { WARN_TILT }
}

fn state_of(one: &Alternative) -> State {
    if one.gain > FAIL_GAIN { one.state } else { State::Warn }
}

/// Residuals as shares of the torques' deviations, n.
fn left(of: &Declared) -> Vec<f64> {
    let share = |(j, sigma): (usize, &f64)| sigma / deviation(of.tau.column(j).as_slice()).max(f64::MIN_POSITIVE);
    of.fit.sigma.iter().enumerate().map(share).collect()
}

/// What the fit leaves as declared, at the joint to which the alternative matters most.
fn found(robot: &Robot, of: &Declared, one: &Alternative) -> String {
    let fall = |j: &usize| of.fit.sigma[*j] / one.sigma[*j];
    let j = (0..one.sigma.len()).max_by(|a, b| fall(a).total_cmp(&fall(b))).unwrap_or(0);
    let (as_declared, otherwise, unit) = (of.fit.sigma[j], one.sigma[j], torque_unit(robot, j));
    format!("a fit that leaves {as_declared:.3} {unit} at joint {}, and {otherwise:.3} {unit} otherwise", j + 1)
}

/// The direction of gravity that fits best: the six axes of the base, then a search about the best of them.
fn mounting(of: &Declared) -> Alternative {
    let declared = of.run.mounting.gravity() / G;
    let axes =
        [1.0, -1.0].into_iter().flat_map(|sign| [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| sign * axis));
    let fit = |u: &Vector3<f64>| Some((*u, of.equations.towards(u).fit(&of.tau)?));
    let better = |a: &(Vector3<f64>, Fit), b: &(Vector3<f64>, Fit)| a.1.score().total_cmp(&b.1.score());
    let start = std::iter::once(declared).chain(axes).filter_map(|u| fit(&u)).min_by(better);
    let Some(mut best) = start else { return of.alternative("mounting", "key `mounting`", &of.fit) };
    let mut turn: f64 = 0.35;
    while turn > 0.02 {
        let across = if best.0.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() };
        let one = best.0.cross(&across).normalize();
        let other = best.0.cross(&one);
        let around = [one, -one, other, -other].map(|side| best.0 * turn.cos() + side * turn.sin());
        match around.iter().filter_map(fit).min_by(better).filter(|next| better(next, &best).is_lt()) {
            Some(next) => best = next,
            None => turn *= 0.5,
        }
    }
    let fitted = Mounting::along(&best.0);
    let tilt = fitted.angle_to(&of.run.mounting);
    let nearest = [Mounting::UPRIGHT, Mounting::WALL, Mounting::CEILING]
        .into_iter()
        .find(|named| named.angle_to(&fitted) < WARN_TILT);
    let named = nearest.map_or(String::new(), |named| format!("{named}: "));
    let state = match tilt {
        tilt if tilt > MAX_TILT => State::Fail,
        tilt if tilt > WARN_TILT => State::Warn,
        _ => State::Pass,
    };
    let words = format!(
        "a mounting of which gravity fits the torques: {named}rho = {:.3}, phi = {:.3}, {:.0} deg from the declared one",
        fitted.rho,
        fitted.phi,
        tilt.to_degrees()
    );
    Alternative { size: tilt, state, unit: "rad", words, ..of.alternative("mounting", "key `mounting`", &best.1) }
}

/// The lag of all torques that fits best.
fn lag(of: &Declared) -> Alternative {
    let fit = |lag: f64| Some((lag, of.system.fit(&of.prepared.torques(lag))?));
    let near = |from: f64, to: f64, step: f64| {
        let steps = ((to - from) / step).round() as usize;
        let each = (0..=steps).filter_map(|k| fit(from + k as f64 * step));
        each.min_by(|a, b| a.1.score().total_cmp(&b.1.score()))
    };
    // A lag much shorter than a sample is below the resolution of the recording.
    let coarse = 0.02;
    let Some((at, _)) = near(-MAX_LAG_S, MAX_LAG_S, coarse) else {
        return of.alternative("lag", "columns t and tau", &of.fit);
    };
    let from = (at - coarse).max(-MAX_LAG_S);
    let Some((lag, best)) = near(from, (at + coarse).min(MAX_LAG_S), 0.004) else {
        return of.alternative("lag", "columns t and tau", &of.fit);
    };
    let resolution = of.prepared.dt();
    let state = match lag.abs() - resolution {
        beyond if beyond > FAIL_LAG_S => State::Fail,
        beyond if beyond > WARN_LAG_S => State::Warn,
        _ => State::Pass,
    };
    let side = if lag > 0.0 { "late" } else { "early" };
    let words = format!("torques of the same time as the positions (they fit {:.0} ms {side})", 1e3 * lag.abs());
    Alternative { size: lag.abs(), state, unit: "s", words, ..of.alternative("lag", "columns t and tau", &best) }
}

/// Every pair of torque columns, swapped.
fn order(of: &Declared) -> Vec<Alternative> {
    let n = of.tau.ncols();
    let pairs = (0..n).flat_map(|a| (a + 1..n).map(move |b| (a, b)));
    let swapped = |(a, b): (usize, usize)| {
        let mut tau = of.tau.clone();
        tau.swap_columns(a, b);
        let mut fit = of.system.fit(&tau)?;
        let place = format!("columns tau{} and tau{}", a + 1, b + 1);
        fit.sigma.swap(a, b);
        fit.residual.swap_columns(a, b);
        let words = format!("the torques of joints {} and {} (are the two columns swapped?)", a + 1, b + 1);
        // Each of two swapped columns fits better in its own place; one alone may fit better where the model has more parameters.
        let both = [a, b].iter().all(|&j| fit.sigma[j] < MAX_SWAPPED_RATIO * of.fit.sigma[j]);
        let state = if both { State::Fail } else { State::Pass };
        Some(Alternative { state, words, ..of.alternative("order", place, &fit) })
    };
    pairs.filter_map(swapped).collect()
}

/// Every torque column with the other sign. All together fit as well as declared: [`positive`] tells them.
fn signs(of: &Declared) -> Vec<Alternative> {
    let flipped = |j: usize| {
        let mut tau = of.tau.clone();
        tau.column_mut(j).neg_mut();
        let fit = of.system.fit(&tau)?;
        let words =
            format!("a torque that drives joint {} in the direction of its positions (is its sign flipped?)", j + 1);
        // A column of the wrong sign leaves more at its own joint.
        let own = fit.sigma[j] < MAX_SWAPPED_RATIO * of.fit.sigma[j];
        let state = if own { State::Fail } else { State::Pass };
        Some(Alternative {
            state,
            joint: Some(j),
            words,
            ..of.alternative("sign", format!("column tau{}", j + 1), &fit)
        })
    };
    (0..of.tau.ncols()).filter_map(flipped).collect()
}

/// Positions with two columns swapped, one in degrees, one with the other sign.
fn positions(structure: &Structure, of: &Declared) -> Vec<Alternative> {
    let n = of.tau.ncols();
    let fit = |motion: Motion| of.prepared.system(structure, &motion).fit(&of.tau);
    let scaled = |j: usize, factor: f64| {
        let mut motion = of.motion.clone();
        for part in [&mut motion.q, &mut motion.dq, &mut motion.ddq] {
            part.column_mut(j).scale_mut(factor);
        }
        fit(motion)
    };
    let mut found = Vec::new();
    for j in 0..n {
        let place = format!("column q{}", j + 1);
        if let Some(fit) = scaled(j, -1.0) {
            let words = format!("positions of joint {} of this robot (is the sign flipped?)", j + 1);
            found.push(Alternative { joint: Some(j), words, ..of.alternative("sign", place.clone(), &fit) });
        }
        if let Some(fit) = scaled(j, std::f64::consts::PI / 180.0) {
            let words = format!("positions of joint {} in rad (are they in degrees?)", j + 1);
            found.push(Alternative { joint: Some(j), words, ..of.alternative("order", place, &fit) });
        }
        for other in j + 1..n {
            let mut motion = of.motion.clone();
            for part in [&mut motion.q, &mut motion.dq, &mut motion.ddq] {
                part.swap_columns(j, other);
            }
            if let Some(fit) = fit(motion) {
                let place = format!("columns q{} and q{}", j + 1, other + 1);
                let words =
                    format!("the positions of joints {} and {} (are the two columns swapped?)", j + 1, other + 1);
                found.push(Alternative { words, ..of.alternative("order", place, &fit) });
            }
        }
    }
    found
}

fn other_robots(robot: &Robot, known: &[Robot], of: &Declared) -> Vec<Alternative> {
    let others = known.iter().filter(|other| other.chain.len() == robot.chain.len() && other.name != robot.name);
    let fitted = |other: &Robot| {
        let structure = structure(other)?;
        let fit = of.prepared.system(&structure, &of.motion).fit(&of.tau)?;
        let words = format!("the data of {} (the kinematics of `{}` fit it better)", robot.full_name, other.name);
        Some(Alternative { words, ..of.alternative("robot", "key `robot`", &fit) })
    };
    others.filter_map(fitted).collect()
}

/// Inertia and dissipated power of every joint, which are positive for every arm.
fn positive(structure: &Structure, of: &Declared, explained: bool) -> Vec<Finding> {
    let inertias = physics::inertias(structure, &of.fit, &of.motion);
    let powers = physics::dissipated(structure, &of.fit, &of.motion);
    let mut findings = Vec::new();
    for (j, (inertia, power)) in inertias.iter().zip(&powers).enumerate() {
        let (of_inertia, of_power) = (inertia.deviations(), power.deviations());
        let state = match () {
            () if explained => State::Pass,
            () if of_inertia < -MIN_DEVIATIONS && of_power < -MIN_DEVIATIONS => State::Fail,
            () => State::Pass,
        };
        let found = format!(
            "an inertia of {:.3} +- {:.3} kg m2, friction that takes {:.3} +- {:.3} W",
            inertia.value, inertia.std, power.value, power.std
        );
        let expected = format!(
            "both positive at joint {0}, as of any arm (is the sign of tau{0} flipped, or tau{0} late?)",
            j + 1
        );
        let finding = Finding::new("power", &of.run.name, format!("column tau{}", j + 1)).of_joint(j);
        // A flipped sign makes both negative; what the model lacks may make one of them so.
        let value = -of_inertia.max(of_power);
        findings.push(finding.measured(value, MIN_DEVIATIONS, "").state(state).says(found, expected));
    }
    let mut shown = super::worst(findings);
    shown.iter_mut().filter(|finding| finding.state == State::Pass).for_each(|finding| {
        finding.found.clear();
        finding.expected.clear();
    });
    shown
}

/// The joint whose torque the fit explains least.
fn unexplained(robot: &Robot, of: &Declared, explained: bool) -> Finding {
    let shares = left(of);
    let j = (0..shares.len()).max_by(|a, b| shares[*a].total_cmp(&shares[*b])).unwrap_or(0);
    let finding = Finding::new("fit", &of.run.name, format!("column tau{}", j + 1)).of_joint(j).measured(
        shares[j],
        WARN_LEFT_RATIO,
        "",
    );
    let state = match shares[j] {
        _ if explained => State::Pass,
        share if share > WARN_LEFT_RATIO => State::Warn,
        _ => State::Pass,
    };
    if state == State::Pass {
        return finding;
    }
    let unit = torque_unit(robot, j);
    let found = format!(
        "a fit that leaves {:.3} {unit}, {:.0} % of the torque's deviation",
        of.fit.sigma[j],
        100.0 * shares[j]
    );
    let expected = format!(
        "a torque that follows the motion of joint {} of {} (is it another joint's, another robot's, or a dead channel?)",
        j + 1,
        robot.name
    );
    finding.state(state).says(found, expected)
}

/// The error of the runs to identify from, what the uncertainty of their parameters adds, and the error of an unseen run, with these parameters.
fn generalises(robot: &Robot, seen: &[&Declared], of: &Declared) -> Option<Finding> {
    let system = System::stacked(&seen.iter().map(|one| &one.system).collect::<Vec<_>>());
    let tau = super::equations::stack_rows(&seen.iter().map(|one| &one.tau).collect::<Vec<_>>());
    let fit = (!seen.is_empty()).then(|| system.fit(&tau)).flatten()?;
    let error = &of.tau - of.system.modelled(&fit.beta);
    let rms = |j: usize| super::root_mean_square(error.column(j).iter().copied());
    // What few seconds of a motion determine badly may be far off along another one.
    let expected = |j: usize| fit.sigma[j].hypot(MIN_DEVIATIONS * of.system.spread(j, &fit.covariance));
    let ratio = |j: usize| rms(j) / expected(j);
    let j = (0..fit.sigma.len()).max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))?;
    let finding = Finding::new("unseen", &of.run.name, format!("column tau{}", j + 1)).of_joint(j).measured(
        ratio(j),
        WARN_UNSEEN_RATIO,
        "",
    );
    let state = match ratio(j) {
        ratio if ratio > FAIL_UNSEEN_RATIO => State::Fail,
        ratio if ratio > WARN_UNSEEN_RATIO => State::Warn,
        _ => return Some(finding),
    };
    let unit = torque_unit(robot, j);
    let found =
        format!("an error of {:.3} {unit}, where the runs to identify from leave {:.3} {unit}", rms(j), fit.sigma[j]);
    let own = of.fit.sigma[j];
    let expected = format!(
        "a run of the same arm with the same tool (fitted alone it leaves {own:.3} {unit}: do period, mounting, tool or units of the runs differ?)"
    );
    Some(finding.state(state).says(found, expected))
}
