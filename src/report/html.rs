//! `report.html`: values formatted for the template. minijinja escapes all text except the plots' SVG.

use super::loop_tables::{durations, durations_of, links, refusals, sessions};
use super::summary::{self, Group, against_floor, digits, groups, mean};
use super::{
    Band, Figures, GravityReport, LoopReport, Report, RunGravity, arm, diagnosis, model_plots, plot, provenance,
};
use minijinja::{AutoEscape, Environment, Value, context};
use std::io;

const TEMPLATE: &str = include_str!("report.html");
pub(super) const CSS: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

pub(super) fn render(report: &Report, figures: &Figures) -> io::Result<String> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_undefined_behavior(minijinja::UndefinedBehavior::SemiStrict);
    environment.add_template("report", TEMPLATE).map_err(io::Error::other)?;
    for (name, text) in diagnosis::TEMPLATES {
        environment.add_template(name, text).map_err(io::Error::other)?;
    }
    let template = environment.get_template("report").map_err(io::Error::other)?;
    let parameters_of = &report.base.parameters;
    let page = context! {
        report => Value::from(minijinja::value::Serde(report)),
        css => safe(CSS.to_string()),
        script => safe(SCRIPT.to_string()),
        origin => origin(report),
        diagnosis => report.diagnosis.as_ref().map(|of| diagnosis::context(of, &figures.diagnosis)),
        notices => notices(report),
        verdicts => verdicts(report),
        band => summary::band(report),
        checks => checks(report),
        conditions => conditions(report),
        groups => tables(report),
        identify => fit(report),
        joints => report.identify.rms_raw.len(),
        counter => counter(report),
        parameters => parameters(report),
        counts => summary::counts(&report.base),
        motions => motions(report),
        searches => searches(report),
        runs => runs(figures),
        plan => plan(figures),
        friction => friction(figures),
        forest => forest(report),
        weak => parameters_of.iter().filter(|own| model_plots::is_weak(own)).count(),
        weak_percent => format!("{:.0}", 100.0 * model_plots::WEAK),
        correlation => filled(model_plots::correlation(&figures.correlation, parameters_of)),
        least_correlation => model_plots::LEAST_CORRELATION,
        correlated => model_plots::most_correlated(&figures.correlation, parameters_of)
            .map(|(one, other, value)| (one, other, format!("{value:.2}"))),
        histograms => histograms(figures),
        gravity => report.gravity.as_ref().map(gravity),
        guest => report.guest.as_ref().map(summary::guest),
        control_loop => report.control_loop.as_ref().map(summary::control_loop),
        refusals => refusals(report),
        fast => report.control_loop.as_ref().is_some_and(LoopReport::is_fast),
        sessions => sessions(report),
        links => links(report),
        durations => durations(report),
        durations_plot => safe(plot::quantiles(&durations_of(report))),
        provenance => report.provenance.iter().map(|(key, value)| (key.clone(), plain(value))).collect::<Vec<_>>(),
    };
    template.render(page).map_err(io::Error::other)
}

pub(super) fn safe(svg: String) -> Value {
    Value::from_safe_string(svg)
}

fn plain(value: &serde_json::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_string)
}

fn number(value: f64) -> String {
    format!("{value:.3}")
}

fn cells(values: &[f64]) -> Vec<String> {
    values.iter().copied().map(number).collect()
}

fn name(file: &str) -> &str {
    crate::dataset::stem(file)
}

fn filled(svg: String) -> Option<Value> {
    (!svg.is_empty()).then(|| safe(svg))
}

/// Where the report comes from, for its head.
fn origin(report: &Report) -> Vec<(&'static str, String)> {
    let keys = [
        ("date", "date"),
        ("plumbline", "plumbline"),
        ("dataset", "dataset, begin of its SHA-256"),
        (provenance::SOURCE, "from"),
        (provenance::COMMAND, "command"),
    ];
    let shown = |key: &str, text: String| if key == "dataset" { text.chars().take(16).collect() } else { text };
    keys.iter().filter_map(|(key, name)| Some((*name, shown(key, plain(report.provenance.get(*key)?))))).collect()
}

fn friction(figures: &Figures) -> Vec<Value> {
    let joint = |of: &super::figures::FrictionFigure| {
        context! { velocity => safe(model_plots::friction(of)), displacement => safe(model_plots::hysteresis(of)) }
    };
    figures.friction.iter().map(joint).collect()
}

fn forest(report: &Report) -> Vec<Value> {
    let plots = model_plots::forest(&report.base.parameters);
    plots.into_iter().map(|(unit, plot)| context! { unit, plot => safe(plot) }).collect()
}

fn histograms(figures: &Figures) -> Vec<Value> {
    let plot =
        |of: &super::figures::DurationFigure| context! { title => &of.title, plot => safe(model_plots::durations(of)) };
    figures.durations.iter().map(plot).collect()
}

/// Rows of the data's checks.
fn checks(report: &Report) -> Vec<Value> {
    let row = |of: &plumbline_identify::check::Finding| {
        let (state, check, run, place, unit) = (of.state, &of.check, name(&of.run), &of.place, &of.unit);
        let state = Value::from(minijinja::value::Serde(state));
        context! { state, check, run, place, value => number(of.value), limit => number(of.limit), unit }
    };
    report.checks.iter().map(row).collect()
}

/// Warnings about the validity of the results.
fn notices(report: &Report) -> Vec<String> {
    let mut notices = report.notes.clone();
    if report.noise_floor.is_empty() && !report.validate.is_empty() {
        notices.push(
            "No motion of this data repeats, so the noise of its torques is unknown: how much of the errors below is noise and how \
             much the model lacks can't be told apart."
                .into(),
        );
    }
    let identifiability = &report.identifiability;
    if !identifiability.not_identifiable.is_empty() {
        notices.push(format!("Not identifiable from this data: {}.", identifiability.not_identifiable.join(", ")));
    }
    if !identifiability.untrusted_runs.is_empty() {
        let names: Vec<&str> = identifiability.untrusted_runs.iter().map(|file| name(file)).collect();
        notices.push(format!("The model is not valid in these runs, so they are not evaluated: {}.", names.join(", ")));
    }
    notices
}

/// Key figures of the first screen: value, unit, description, rating.
fn verdicts(report: &Report) -> Vec<Value> {
    let tile = |value: String, unit: &str, what: String, good: Option<bool>| {
        let class = good.map_or("", |good| if good { "good" } else { "bad" });
        context! { value, unit, what, class }
    };
    let mut tiles = Vec::new();
    if report.base.count > 0 {
        let what = match report.base.effects {
            0 => format!("{} of {}", report.base.kind, report.robot),
            effects => format!("{} of {}, and {effects} of effects", report.base.kind, report.robot),
        };
        tiles.push(tile(report.base.count.to_string(), "base parameters", what, None));
    }
    if let Some(first) = report.conditions.first() {
        tiles.push(tile(digits(first.with_friction), "", format!("condition number, {}", first.definition), None));
    }
    let after = summary::band(report);
    for group in groups(report) {
        let mut what = format!("mean RMS {}", group.mounting);
        if after.is_empty() {
            what.extend(against_floor(report, &group.raw()).map(|text| format!(", {text}")));
        } else {
            what += &format!(", {after}");
        }
        tiles.push(tile(number(mean(&group.per_joint())), "Nm", what, None));
    }
    if let Some(ipc) = &report.ipc {
        let lost = ipc.sent.abs_diff(ipc.counters.received);
        tiles.push(tile(lost.to_string(), "lost", format!("samples of {}", ipc.sent), Some(lost == 0)));
    }
    tiles
}

fn conditions(report: &Report) -> Vec<Value> {
    let meaning = |definition: &str| match definition {
        "raw" => "singular values of the base regressor as it is, in its units",
        "column-equilibrated" => "every column scaled to length one",
        "noise-weighted" => "every row divided by the noise of its joint, as the estimator weighs it",
        _ => "",
    };
    let row = |c: &super::Condition| {
        let (with, without) = (digits(c.with_friction), digits(c.without_friction));
        context! { name => &c.definition, with, without, meaning => meaning(&c.definition) }
    };
    report.conditions.iter().map(row).collect()
}

/// Rows below a table of runs: mean and reference values per joint.
fn extra_columns(report: &Report, group: &Group) -> Vec<(&'static str, Vec<f64>)> {
    let mut columns = Vec::new();
    if report.band != Band::Raw {
        columns.push(("raw mean", group.raw()));
    }
    columns.push(("noise floor", report.noise_floor.clone()));
    columns.push(("served", group.served()));
    columns.retain(|(_, values)| !values.is_empty());
    columns
}

/// One table per mounting as the paper's Tables IV and V: a row per joint, a column per run.
fn tables(report: &Report) -> Vec<Value> {
    let table = |group: &Group| {
        let average = group.per_joint();
        let extra = extra_columns(report, group);
        let row = |j: usize| {
            let of = |values: &[f64]| values.get(j).map_or(String::new(), |value| number(*value));
            let cells: Vec<_> = group.runs.iter().map(|run| of(run.rms(&group.band))).collect();
            let extra: Vec<_> = extra.iter().map(|(_, values)| of(values)).collect();
            context! { joint => j + 1, cells, mean => number(average[j]), extra }
        };
        let names: Vec<&str> = group.runs.iter().map(|run| name(&run.run)).collect();
        context! {
            mounting => group.mounting,
            runs => headings(&names),
            names => names.iter().map(|name| name.to_string()).collect::<Vec<_>>(),
            extra => extra.iter().map(|(name, _)| *name).collect::<Vec<_>>(),
            rows => (0..average.len()).map(row).collect::<Vec<_>>(),
            means => group.runs.iter().map(|run| number(mean(run.rms(&group.band)))).collect::<Vec<_>>(),
            mean => number(mean(&average)),
            extra_means => extra.iter().map(|(_, values)| number(mean(values))).collect::<Vec<_>>(),
        }
    };
    groups(report).iter().map(table).collect()
}

/// Column headings: `traj1`, `traj2` where the names of runs differ in a final number alone, else the names.
fn headings(names: &[&str]) -> Vec<String> {
    let parts: Option<Vec<(&str, &str)>> = names.iter().map(|name| name.rsplit_once('-')).collect();
    match parts {
        Some(parts) if parts.iter().all(|(stem, last)| *stem == parts[0].0 && last.parse::<u32>().is_ok()) => {
            parts.iter().map(|(_, last)| format!("traj{last}")).collect()
        }
        _ => names.iter().map(|name| name.to_string()).collect(),
    }
}

fn fit(report: &Report) -> Vec<Value> {
    let after = summary::band(report);
    let fit = &report.identify;
    let judged = if after.is_empty() { "RMS / Nm".to_string() } else { format!("RMS / Nm, {after}") };
    let mut rows = vec![(judged, fit.rms(&report.band))];
    match report.band {
        Band::Raw => rows.push(("RMS / Nm, filtered mean period".to_string(), &fit.rms_filtered)),
        Band::Filtered { .. } => rows.push(("RMS / Nm, raw samples".to_string(), &fit.rms_raw)),
    }
    rows.push(("noise floor / Nm, raw samples".to_string(), &report.noise_floor));
    let row =
        |(what, values): (String, &Vec<f64>)| context! { what, cells => cells(values), mean => number(mean(values)) };
    rows.into_iter().filter(|(_, values)| !values.is_empty()).map(row).collect()
}

fn counter(report: &Report) -> Option<Value> {
    let of = report.counter_experiment.as_ref()?;
    let change = |(forced, general): (&f64, &f64)| {
        let percent = 100.0 * (forced - general) / general;
        if percent.abs() < 0.05 { "0.0 %".to_string() } else { format!("{percent:+.1} %") }
    };
    Some(context! {
        sentence => summary::counter(of),
        refusal => &of.refusal,
        place => &of.refused_in.name,
        forced_name => format!("{} of {} parameters, forced", of.kind, of.count),
        general_name => format!("{} of {} parameters", report.base.kind, report.base.count),
        forced => cells(&of.forced_rms),
        general => cells(&of.general_rms),
        changes => of.forced_rms.iter().zip(&of.general_rms).map(change).collect::<Vec<_>>(),
    })
}

/// Readings of the inclinometer, angles in degrees.
fn gravity(of: &GravityReport) -> Value {
    let angle = |rad: f64| format!("{:.3}", rad.to_degrees());
    let row = |run: &RunGravity| {
        context! {
            run => name(&run.run),
            source => run.source(),
            rho => angle(run.used.rho),
            phi => angle(run.used.phi),
            tilt => angle(run.tilt),
            std => run.std.map_or("-".to_string(), angle),
        }
    };
    let status = &of.status;
    context! {
        sentence => of.sentence(),
        inclinometer => &status.inclinometer,
        on_loss => &status.on_loss,
        hand_overs => status.hand_overs,
        furthest => angle(status.furthest),
        runs => of.runs.iter().map(row).collect::<Vec<_>>(),
        events => &status.events,
        forgotten => status.forgotten,
    }
}

fn parameters(report: &Report) -> Vec<Value> {
    let row = |p: &super::ParameterFacts| {
        // Decimals that match the standard deviation.
        let decimals =
            p.std.filter(|std| *std > 0.0).map_or(4, |std| (1 - std.log10().floor() as i32).clamp(0, 9) as usize);
        let end = |k: usize| p.interval_95.map_or("-".to_string(), |ends| format!("{:.decimals$}", ends[k]));
        let relative = p.std.filter(|_| p.value != 0.0).map(|std| 100.0 * std / p.value.abs());
        context! {
            symbol => &p.symbol,
            weak => model_plots::is_weak(p),
            name => &p.name,
            value => format!("{:.decimals$}", p.value),
            std => p.std.map_or("-".to_string(), |std| format!("{std:.decimals$}")),
            from => end(0),
            to => end(1),
            relative => relative.map_or("-".to_string(), |percent| if percent < 1000.0 { digits(percent) } else { "> 1000".into() }),
            unit => &p.unit,
            expression => &p.expression,
        }
    };
    report.base.parameters.iter().map(row).collect()
}

fn runs(figures: &Figures) -> Vec<Value> {
    let run = |figure: &super::figures::TorqueFigure| {
        let plots: Vec<_> = (0..figure.measured.len()).map(|j| safe(plot::torque(figure, j))).collect();
        context! { title => &figure.title, plots, band => !figure.noise.is_empty(), raw => !figure.raw.is_empty() }
    };
    figures.runs.iter().map(run).collect()
}

fn plan(figures: &Figures) -> Option<Value> {
    let plan = figures.plan.as_ref()?;
    Some(context! {
        joints => plan.q.len(),
        arm => arm::arm(plan).map(safe),
        limits => safe(model_plots::limits(plan)),
        workspace => plan.workspace.is_some(),
        positions => safe(plot::positions(plan)),
        side => safe(plot::path(plan, [0, 2], ["x / m", "z / m"])),
        top => safe(plot::path(plan, [0, 1], ["x / m", "y / m"])),
    })
}

/// Name and course of every motion that was searched for.
fn searches(report: &Report) -> Vec<Value> {
    let drawn = |of: &super::MotionUsage| {
        let plot = filled(model_plots::search(of.search.as_ref()?))?;
        Some(context! { motion => &of.motion, plot })
    };
    report.motions.iter().filter_map(drawn).collect()
}

/// Use of each joint's range and speed by every motion in %.
fn motions(report: &Report) -> Vec<Value> {
    let cell = |(range, speed): (&f64, &f64)| format!("{:.0} / {:.0}", 100.0 * range, 100.0 * speed);
    let row = |of: &super::MotionUsage| {
        context! { name => &of.motion, cells => of.range.iter().zip(&of.speed).map(cell).collect::<Vec<_>>() }
    };
    report.motions.iter().map(row).collect()
}
