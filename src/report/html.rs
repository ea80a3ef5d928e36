//! `report.html`: figures formatted here, laid out by the template. minijinja escapes every text; only our own SVG goes in as it is.

use super::summary::{digits, groups, mean};
use super::{Figures, Report, plot};
use minijinja::{AutoEscape, Environment, Value, context};
use std::io;

const TEMPLATE: &str = include_str!("report.html");

pub(super) fn render(report: &Report, figures: &Figures) -> io::Result<String> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.set_undefined_behavior(minijinja::UndefinedBehavior::SemiStrict);
    environment.add_template("report", TEMPLATE).map_err(io::Error::other)?;
    let template = environment.get_template("report").map_err(io::Error::other)?;
    let page = context! {
        report => Value::from(minijinja::value::Serde(report)),
        summary => report.summary(),
        verdicts => verdicts(report),
        joints => report.noise_floor.len().max(report.identify.rms.len()),
        conditions => conditions(report),
        groups => tables(report),
        identify => report.identify.rms.iter().map(|rms| format!("{rms:.3}")).collect::<Vec<_>>(),
        floor => report.noise_floor.iter().map(|noise| format!("{noise:.3}")).collect::<Vec<_>>(),
        parameters => parameters(report),
        runs => runs(figures),
        plan => plan(figures),
        wake => safe(plot::histogram(&figures.wake, "wake-up latency / us")),
        work => safe(plot::histogram(&figures.work, "work time / us")),
        quantiles => quantiles(report),
        provenance => report.provenance.iter().map(|(key, value)| (key.clone(), plain(value))).collect::<Vec<_>>(),
    };
    template.render(page).map_err(io::Error::other)
}

fn safe(svg: String) -> Value {
    Value::from_safe_string(svg)
}

fn plain(value: &serde_json::Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_string)
}

/// The large figures of the first screen: value, unit, what it is, and whether it is as it should be.
fn verdicts(report: &Report) -> Vec<Value> {
    let tile = |value: String, unit: &str, what: String, good: Option<bool>| {
        let class = good.map_or("", |good| if good { "good" } else { "bad" });
        context! { value, unit, what, class }
    };
    let mut tiles = vec![tile(
        report.base.count.to_string(),
        "parameters",
        format!("{} of {}", report.base.kind, report.robot),
        None,
    )];
    if let Some(first) = report.conditions.first() {
        tiles.push(tile(digits(first.with_friction), "", format!("condition number, {}", first.definition), None));
    }
    let floor = mean(&report.noise_floor);
    for group in groups(report) {
        let rms = mean(&group.per_joint());
        let what = if floor > 0.0 {
            format!("mean RMS {}, {:.2} of the noise floor", group.mounting, rms / floor)
        } else {
            format!("mean RMS {}", group.mounting)
        };
        tiles.push(tile(format!("{rms:.3}"), "Nm", what, None));
    }
    if let Some(ipc) = &report.ipc {
        let lost = ipc.sent.abs_diff(ipc.received);
        tiles.push(tile(lost.to_string(), "lost", format!("samples of {}", ipc.sent), Some(lost == 0)));
    }
    tiles
}

fn conditions(report: &Report) -> Vec<Value> {
    let row = |c: &super::Condition| {
        context! { name => &c.definition, with => digits(c.with_friction), without => digits(c.without_friction) }
    };
    report.conditions.iter().map(row).collect()
}

/// One table per mounting as the paper's Tables IV and V: a row per joint, a column per run.
fn tables(report: &Report) -> Vec<Value> {
    let number = |value: f64| format!("{value:.3}");
    let table = |group: super::summary::Group| {
        let average = group.per_joint();
        let row = |j: usize| {
            let cells: Vec<_> =
                group.runs.iter().map(|run| run.rms.get(j).map_or(String::new(), |rms| number(*rms))).collect();
            let floor = report.noise_floor.get(j).map_or(String::new(), |noise| number(*noise));
            context! { joint => j + 1, cells, mean => number(average[j]), floor }
        };
        context! {
            mounting => group.mounting,
            runs => group.runs.iter().map(|run| run.run.clone()).collect::<Vec<_>>(),
            rows => (0..average.len()).map(row).collect::<Vec<_>>(),
            means => group.runs.iter().map(|run| number(mean(&run.rms))).collect::<Vec<_>>(),
            mean => number(mean(&average)),
            floor => if report.noise_floor.is_empty() { String::new() } else { number(mean(&report.noise_floor)) },
        }
    };
    groups(report).into_iter().map(table).collect()
}

fn parameters(report: &Report) -> Vec<Value> {
    let row = |p: &super::ParameterFacts| {
        // As many decimals as the standard deviation has meaning.
        let decimals =
            p.std.filter(|std| *std > 0.0).map_or(4, |std| (1 - std.log10().floor() as i32).clamp(0, 9) as usize);
        let relative = p.std.filter(|_| p.value != 0.0).map(|std| 100.0 * std / p.value.abs());
        context! {
            symbol => &p.symbol,
            name => &p.name,
            value => format!("{:.decimals$}", p.value),
            std => p.std.map_or("-".to_string(), |std| format!("{std:.decimals$}")),
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
        context! { title => &figure.title, plots, band => !figure.noise.is_empty() }
    };
    figures.runs.iter().map(run).collect()
}

fn plan(figures: &Figures) -> Option<Value> {
    let plan = figures.plan.as_ref()?;
    Some(context! {
        joints => plan.q.len(),
        positions => safe(plot::positions(plan)),
        side => safe(plot::path(plan, [0, 2], ["x / m", "z / m"])),
        top => safe(plot::path(plan, [0, 1], ["x / m", "y / m"])),
    })
}

fn quantiles(report: &Report) -> Vec<Value> {
    let Some(cycle) = &report.cycle else { return Vec::new() };
    let row = |(what, q): (&str, Option<super::Quantiles>)| {
        let q = q?;
        Some(
            context! { what, p50 => digits(q.p50), p99 => digits(q.p99), p999 => digits(q.p999), max => digits(q.max) },
        )
    };
    [("wake-up latency", cycle.wake_us), ("work time", cycle.work_us)].into_iter().filter_map(row).collect()
}
