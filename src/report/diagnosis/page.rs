//! What the templates of a diagnosis show, formatted.

use super::errors;
use super::rows::{self, Bar, Kind, Pair};
use super::words::{self, fixed, quantity};
use super::{Action, BeforeAfter, Changes, Confirmation, Diagnosis, Effect, Errors, Stratum, Verdict, plots};
use crate::report::html::safe;
use crate::report::summary::{band_of, digits};
use minijinja::{Value, context};
use plumbline_diagnose::figures::Curves;
use plumbline_diagnose::outcome::places;

/// Templates by name: the box of the first screen, and the section that follows.
pub(in crate::report) const TEMPLATES: [(&str, &str); 3] = [
    ("diagnosis-first", include_str!("first.html")),
    ("diagnosis-section", include_str!("section.html")),
    ("diagnosis-effects", include_str!("effects.html")),
];

const DRAWN: usize = 10;

pub(in crate::report) fn context(of: &Diagnosis, figures: &Curves) -> Value {
    let grown = errors::grown(of);
    let errors = rows::pairs(&of.before, Some(&of.after).filter(|_| grown), &of.noise_floor);
    let plotted = |svg: String| (!svg.is_empty()).then(|| safe(svg));
    let band = band_of(&of.band);
    let rms = if band.is_empty() { "RMS / Nm".to_string() } else { format!("RMS / Nm, {band}") };
    // What repeats shows a lack that noise hides in the errors of single runs.
    let filled = |svg: String| (!svg.is_empty()).then_some(svg);
    let errors_plot = filled(rows::dumbbells(&errors, &rms));
    let floor = (!of.noise_floor.is_empty()).then_some("noise floor");
    let unmodelled = filled(rows::dumbbells(&unmodelled(of, grown), "unmodelled RMS of the mean period / Nm"));
    let (hero, hero_caption, hero_limit, second) = match unmodelled {
        Some(plot) => {
            (Some(plot), "Torque that every period repeats and the model lacks", Some("counts from here"), errors_plot)
        }
        None => (errors_plot, "Errors on held-out runs", floor, None),
    };
    context! {
        verdict => of.verdict.to_string(),
        tone => tone(of.verdict),
        // Many effects need the width of the page.
        wide => of.effects.len() > 2,
        headline => words::headline(of),
        sentences => words::sentences(of),
        lead => errors::lead(of).map(arrow),
        error => errors::error_of_runs(of).map(arrow),
        effects => effects(&of.effects, of.confirmation),
        changes => of.changes.iter().map(|changes| self::changes(changes, of.confirmation)).collect::<Vec<_>>(),
        grown,
        changing => of.effects.iter().any(|effect| effect.stratum == Stratum::Changing),
        rms => &rms,
        intervals => !of.before.intervals.is_empty(),
        floors => !of.noise_floor.is_empty(),
        runs => of.held_out_runs.len(),
        hero => hero.map(safe),
        hero_caption,
        hero_limit,
        second_plot => second.map(safe),
        joints => joints(of, grown),
        notes => &of.notes,
        confirmation => of.confirmation.map(|confirmation| confirmation.to_string()),
        periods => periods(figures),
        against => against(&figures.effects),
        spectra => spectra(figures),
        scores => plotted(scores(of)),
        equivalent => of.scores.iter().take(DRAWN).any(|score| score.equivalent),
        path => plotted(path(of)),
        open => words::open(of).collect::<Vec<_>>(),
        unexplained => of.unexplained.iter().map(words::unexplained).collect::<Vec<_>>(),
        empirical => of.empirical.iter().map(|term| arrow(words::empirical(term))).collect::<Vec<_>>(),
        dependences => against(&figures.dependences),
        maps => maps(figures),
        detectable => detectable(of),
        arm => (1..=widest(of)).collect::<Vec<_>>(),
        absorbed => absorbed(of),
        quality => quality(of),
    }
}

fn tone(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::NothingSignificant | Verdict::Diagnosed => "good",
        Verdict::NotDetermined | Verdict::Ambiguous | Verdict::Partly => "warn",
        Verdict::Unexplained => "bad",
    }
}

/// What stands between before and after, as print has it.
fn arrow(line: String) -> String {
    line.replace("->", "\u{2192}")
}

fn or_dash(value: Option<f64>) -> String {
    value.map_or("-".into(), digits)
}

fn or_fixed(value: Option<f64>) -> String {
    value.map_or("-".into(), fixed)
}

fn percent(share: Option<f64>) -> String {
    share.filter(|share| share.is_finite()).map_or("-".into(), |share| format!("{:.0} %", 100.0 * share))
}

fn effects(effects: &[Effect], confirmation: Option<Confirmation>) -> Vec<Value> {
    let row = |effect: &Effect| {
        let parameters: Vec<_> =
            effect.parameters.0.iter().map(|p| context! { name => &p.name, value => quantity(p, "\u{b1}") }).collect();
        let rivals: Vec<_> = effect
            .alternatives_detail
            .iter()
            .map(|other| {
                let name = words::placed(&other.id, &other.joints);
                context! { name, gap => or_dash(other.score_gap), experiment => &other.deciding_experiment }
            })
            .collect();
        let bare = effect.alternatives.iter().filter(|_| rivals.is_empty());
        context! {
            id => &effect.id,
            name => words::name(effect),
            parameters,
            confirmed => words::confirmed(effect, confirmation),
            explained => percent(effect.explained_share),
            adequacy => percent(effect.adequacy),
            evidence => or_dash(effect.evidence),
            gain => or_dash(effect.delta_log_likelihood.map(|gain| 2.0 * gain)),
            penalty => or_dash(effect.penalty),
            folds => format!("{} of {}", effect.folds.positive, effect.folds.informative),
            idf => or_dash(effect.idf),
            torque => or_fixed(effect.torque_rms),
            stratum => match effect.stratum {
                Stratum::Repeatable => "repeatable",
                Stratum::Changing => "changing",
                Stratum::Reference => "since reference",
                Stratum::Remainder => "empirical",
            },
            in_model => effect.in_model,
            left => words::left(effect),
            alternatives => bare.map(|id| words::placed(id, &[])).collect::<Vec<_>>(),
            rivals,
            equation => &effect.equation,
            physics => &effect.physics,
        }
    };
    effects.iter().map(row).collect()
}

fn changes(of: &Changes, confirmation: Option<Confirmation>) -> Value {
    let none = Errors::default();
    let (before, after) = (of.before.as_ref().unwrap_or(&none), of.after.as_ref());
    let plot = rows::dumbbells(&rows::pairs(before, after, &[]), "RMS / Nm");
    context! {
        since => &of.since,
        session => &of.session,
        effects => effects(&of.effects, confirmation),
        note => &of.note,
        helped => words::helped(of).map(arrow),
        plot => (!plot.is_empty()).then(|| safe(plot)),
    }
}

/// Rows of the table of joints; `None` where there is nothing in it.
fn joints(of: &Diagnosis, grown: bool) -> Vec<Value> {
    let count = of.before.validate_rms.len().max(of.joints.len());
    let error = |errors: Option<&Errors>, j: usize| {
        let Some(rms) = errors.and_then(|errors| errors.validate_rms.get(j)) else { return "-".to_string() };
        match errors.and_then(|errors| errors.intervals.get(j)) {
            Some([low, high]) if low.is_finite() && high.is_finite() => {
                format!("{} [{}, {}]", fixed(*rms), fixed(*low), fixed(*high))
            }
            _ => fixed(*rms),
        }
    };
    let row = |j: usize| {
        let facts = of.joints.get(j).copied().unwrap_or_default();
        let two = |of: BeforeAfter, text: fn(Option<f64>) -> String| match of.after.filter(|_| grown) {
            Some(after) => format!("{} \u{2192} {}", text(of.before), text(Some(after))),
            None => text(of.before),
        };
        context! {
            joint => j + 1,
            before => error(Some(&of.before), j),
            after => error(Some(&of.after).filter(|_| grown), j),
            change => error(of.change.as_ref().filter(|_| grown), j),
            floor => or_fixed(of.noise_floor.get(j).copied()),
            lack => two(facts.lack_of_fit, or_dash),
            unmodelled => two(facts.unmodelled, or_fixed),
            threshold => or_fixed(facts.threshold),
            adequacy => percent(facts.adequacy),
        }
    };
    (0..count).map(row).collect()
}

fn unmodelled(of: &Diagnosis, grown: bool) -> Vec<Pair> {
    let pair = |(j, facts): (usize, &super::JointFacts)| Pair {
        joint: j + 1,
        before: facts.unmodelled.before,
        after: facts.unmodelled.after.filter(|_| grown),
        limit: facts.threshold,
        ..Pair::default()
    };
    of.joints.iter().enumerate().map(pair).collect()
}

fn scores(of: &Diagnosis) -> String {
    let kind = |score: &super::Score| match (score.chosen, score.equivalent) {
        (true, _) => Kind::Chosen,
        (_, true) => Kind::Equivalent,
        _ => Kind::Plain,
    };
    let bar = |score: &super::Score| Bar { label: score.label.clone(), value: score.score, kind: kind(score) };
    rows::bars(&of.scores.iter().take(DRAWN).map(bar).collect::<Vec<_>>(), false)
}

fn path(of: &Diagnosis) -> String {
    let sign = |action: Action| match action {
        Action::Start => "",
        Action::Added => "+ ",
        Action::Removed => "\u{2212} ",
    };
    let bar = |step: &super::Step| Bar {
        label: format!("{}{}", sign(step.action), step.what),
        value: step.unmodelled.unwrap_or(f64::NAN),
        kind: Kind::Plain,
    };
    rows::bars(&of.path.iter().map(bar).collect::<Vec<_>>(), true)
}

fn periods(figures: &Curves) -> Vec<Value> {
    let plot = |figure: &plumbline_diagnose::figures::PeriodFigure| {
        let svg = plots::period(figure);
        let trajectory = &figure.trajectory;
        (!svg.is_empty()).then(|| context! { joint => figure.joint, trajectory, plot => safe(svg) })
    };
    figures.periods.iter().filter_map(plot).collect()
}

fn against(figures: &[plumbline_diagnose::figures::EffectFigure]) -> Vec<Value> {
    let plot = |figure: &plumbline_diagnose::figures::EffectFigure| {
        let svg = plots::effect(figure);
        (!svg.is_empty()).then(|| context! { joint => figure.joint, title => &figure.title, plot => safe(svg) })
    };
    figures.iter().filter_map(plot).collect()
}

fn spectra(figures: &Curves) -> Vec<Value> {
    let plot = |figure: &plumbline_diagnose::figures::SpectrumFigure| {
        let svg = plots::spectrum(figure);
        (!svg.is_empty()).then(|| context! { joint => figure.joint, plot => safe(svg) })
    };
    figures.spectra.iter().filter_map(plot).collect()
}

fn maps(figures: &Curves) -> Vec<Value> {
    let plot = |figure: &plumbline_diagnose::figures::MapFigure| {
        let svg = plots::map(figure);
        let most = digits(plots::most(figure));
        (!svg.is_empty()).then(|| context! { title => &figure.title, most, plot => safe(svg) })
    };
    figures.maps.iter().filter_map(plot).collect()
}

/// Joints of the table of what would have been seen.
fn widest(of: &Diagnosis) -> usize {
    of.minimum_detectable.values().map(|least| least.torque_rms.len().max(least.parameter.len())).max().unwrap_or(0)
}

/// Two rows per effect: torque, and parameter where one is known.
fn detectable(of: &Diagnosis) -> Vec<Value> {
    let width = widest(of);
    let cells = |values: &[f64]| (0..width).map(|j| or_dash(values.get(j).copied())).collect::<Vec<_>>();
    let mut rows = Vec::new();
    for (id, least) in &of.minimum_detectable {
        rows.push(context! { id, what => "torque RMS / Nm", cells => cells(&least.torque_rms) });
        if !least.parameter.is_empty() {
            let unit = if least.unit.is_empty() { String::new() } else { format!(" / {}", least.unit) };
            rows.push(context! { id => "", what => format!("{}{unit}", least.name), cells => cells(&least.parameter) });
        }
    }
    rows
}

/// Effects with the places where the same absorbs them.
fn absorbed(of: &Diagnosis) -> Vec<Value> {
    let mut groups: Vec<(&str, &str, Vec<String>)> = Vec::new();
    for one in &of.not_identifiable {
        let place = places(&one.joints);
        match groups.iter_mut().find(|(effect, why, _)| (*effect, *why) == (&one.effect, &one.why)) {
            Some((.., places)) => places.push(place),
            None => groups.push((&one.effect, &one.why, vec![place])),
        }
    }
    let row = |(effect, why, places): (&str, &str, Vec<String>)| {
        let places: Vec<String> = places.into_iter().filter(|place| !place.is_empty()).collect();
        let name = words::plain(effect);
        context! { name, places => places.join(", "), why }
    };
    groups.into_iter().map(row).collect()
}

/// What was found wrong with the data, one line each; what was looked for and not found stays out.
fn quality(of: &Diagnosis) -> Vec<String> {
    let quality = &of.quality;
    let counted =
        |count: Option<u64>, text: &str| count.filter(|count| *count > 0).map(|count| format!("{count} {text}"));
    let per_joint = |values: Vec<String>| values.join(", ");
    let mut lines: Vec<String> = [
        counted(quality.outliers, "samples stand out and don't repeat; they are masked"),
        counted(quality.repeated_stamps, "rows repeat the time stamp of the row before"),
    ]
    .into_iter()
    .flatten()
    .collect();
    lines.extend(quality.longest_gap.map(|gap| format!("longest step between time stamps: {} ms", digits(1e3 * gap))));
    if quality.saturated.iter().any(|count| *count > 0) {
        let counts = quality.saturated.iter().map(u64::to_string).collect();
        lines.push(format!("samples at the limit of the torque sensor, per joint: {}", per_joint(counts)));
    }
    if quality.quantum.iter().any(|step| *step > 0.0) {
        let steps = quality.quantum.iter().map(|step| digits(*step)).collect();
        lines.push(format!("smallest step of the measured torque per joint: {} Nm", per_joint(steps)));
    }
    lines.extend(quality.notes.iter().cloned());
    lines
}
