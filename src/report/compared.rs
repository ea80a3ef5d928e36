//! Two reports side by side: verdicts, errors, parameters with the significance of their difference.

use super::chart::{Axis, Chart, Scale};
use super::diagnosis;
use super::html::{CSS, safe};
use super::summary::{counts, digits, groups, mean};
use super::{ParameterFacts, Report, provenance};
use minijinja::{AutoEscape, Environment, Value, context};
use serde::Serialize;
use std::io;

const TEMPLATE: &str = include_str!("compared.html");

/// From so many standard deviations of the difference on, a parameter counts as changed.
pub const CHANGED_DEVIATIONS: f64 = 3.0;

/// Two reports with their names.
pub struct Compared {
    names: [String; 2],
    reports: [Report; 2],
    parameters: Vec<Difference>,
}

/// A parameter in both reports.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    pub name: String,
    pub unit: String,
    /// Values, in `unit`.
    pub values: [f64; 2],
    /// Standard deviations where known, in `unit`.
    pub std: [Option<f64>; 2],
    /// Difference in standard deviations of the difference of two independent estimates; `None` where one is unknown.
    pub deviations: Option<f64>,
    #[serde(skip)]
    symbol: String,
}

impl Difference {
    fn of(one: &ParameterFacts, other: &ParameterFacts) -> Difference {
        let spread = one.std.zip(other.std).map(|(a, b)| a.hypot(b)).filter(|spread| *spread > 0.0);
        Difference {
            name: one.name.clone(),
            unit: one.unit.clone(),
            values: [one.value, other.value],
            std: [one.std, other.std],
            deviations: spread.map(|spread| (other.value - one.value) / spread),
            symbol: one.symbol.clone(),
        }
    }

    fn size(&self) -> f64 {
        self.deviations.map_or(0.0, f64::abs)
    }

    fn is_changed(&self) -> bool {
        self.size() > CHANGED_DEVIATIONS
    }
}

impl Compared {
    pub fn of([(before, one), (after, other)]: [(String, Report); 2]) -> Compared {
        let find =
            |own: &ParameterFacts| other.base.parameters.iter().find(|p| (&p.name, &p.unit) == (&own.name, &own.unit));
        let both = one.base.parameters.iter().filter_map(|own| Some(Difference::of(own, find(own)?)));
        let parameters = both.collect();
        Compared { names: [before, after], reports: [one, other], parameters }
    }

    /// Parameters that one report alone has.
    fn alone(&self, index: usize) -> Vec<&ParameterFacts> {
        let known =
            |own: &&ParameterFacts| self.parameters.iter().any(|both| both.name == own.name && both.unit == own.unit);
        self.reports[index].base.parameters.iter().filter(|own| !known(own)).collect()
    }

    /// Parameters in the order of their difference, the largest first.
    fn ordered(&self) -> Vec<&Difference> {
        let mut all: Vec<&Difference> = self.parameters.iter().collect();
        all.sort_by(|a, b| b.size().total_cmp(&a.size()));
        all
    }

    fn changed(&self) -> usize {
        self.parameters.iter().filter(|own| own.is_changed()).count()
    }

    /// What differs, for programs.
    pub fn facts(&self) -> serde_json::Value {
        let names = |index: usize| self.alone(index).iter().map(|own| own.name.clone()).collect::<Vec<_>>();
        serde_json::json!({
            "reports": self.names,
            "verdicts": self.reports.each_ref().map(verdict),
            "errors": self.errors().iter().map(|(row, values)| serde_json::json!({ "of": row, "rms": values })).collect::<Vec<_>>(),
            "parameters": self.ordered(),
            "changed": self.changed(),
            "alone": [names(0), names(1)],
        })
    }

    /// What differs, in a few lines.
    pub fn summary(&self) -> Vec<String> {
        let mut lines: Vec<String> = [0, 1]
            .map(|k| format!("{}: {}, {}", self.names[k], verdict(&self.reports[k]), counts(&self.reports[k].base)))
            .into();
        for (row, [one, other]) in self.errors() {
            lines.push(format!("mean RMS / Nm, {row}: {:.3} -> {:.3}", mean(&one), mean(&other)));
        }
        let (changed, all) = (self.changed(), self.parameters.len());
        lines.push(format!(
            "{changed} of {all} parameters differ by more than {CHANGED_DEVIATIONS} standard deviations"
        ));
        let most = self.ordered().into_iter().filter(|own| own.is_changed()).take(5);
        lines.extend(most.map(|own| {
            let [one, other] = own.values.map(digits);
            format!(
                "  {}: {one} -> {other} {} ({:+.1} deviations)",
                own.name,
                own.unit,
                own.deviations.unwrap_or(f64::NAN)
            )
        }));
        lines
    }

    /// Rows of errors per joint that both reports have \[Nm\].
    fn errors(&self) -> Vec<(String, [Vec<f64>; 2])> {
        let [one, other] = &self.reports;
        let mut rows = Vec::new();
        if one.noise_floor.len() == other.noise_floor.len() {
            rows.push(("noise floor, raw samples".to_string(), [one.noise_floor.clone(), other.noise_floor.clone()]));
        }
        // Errors of different bands are no pair.
        if one.band == other.band {
            rows.push(("fit".into(), [one, other].map(|report| report.identify.rms(&report.band).clone())));
            let (own, others) = (groups(one), groups(other));
            for group in &own {
                if let Some(same) = others.iter().find(|same| same.mounting == group.mounting) {
                    rows.push((format!("unseen runs, {}", group.mounting), [group.per_joint(), same.per_joint()]));
                }
            }
        }
        rows.retain(|(_, [one, other])| !one.is_empty() && one.len() == other.len());
        rows
    }

    /// The page, a self-contained file.
    pub fn to_html(&self) -> io::Result<String> {
        let mut environment = Environment::new();
        environment.set_auto_escape_callback(|_| AutoEscape::Html);
        environment.set_undefined_behavior(minijinja::UndefinedBehavior::SemiStrict);
        let head = |k: usize| {
            let report = &self.reports[k];
            let fact =
                |key: &str| report.provenance.get(key).and_then(|value| value.as_str()).unwrap_or("-").to_string();
            context! {
                name => &self.names[k], verdict => verdict(report), mounting => &report.mounting.name, date => fact("date"),
                counts => counts(&report.base), source => fact(provenance::SOURCE), command => fact(provenance::COMMAND),
                condition => report.conditions.first().map_or("-".to_string(), |of| digits(of.with_friction)),
            }
        };
        let error = |(row, [one, other]): (String, [Vec<f64>; 2])| {
            let cells = |values: &[f64]| {
                values.iter().chain([&mean(values)]).map(|value| format!("{value:.3}")).collect::<Vec<_>>()
            };
            let change = |(a, b): (&f64, &f64)| format!("{:+.1} %", 100.0 * (b - a) / a.abs().max(f64::MIN_POSITIVE));
            let means = (mean(&one), mean(&other));
            let changes: Vec<String> =
                one.iter().zip(&other).map(change).chain([change((&means.0, &means.1))]).collect();
            context! { row, one => cells(&one), other => cells(&other), changes }
        };
        let errors: Vec<Value> = self.errors().into_iter().map(error).collect();
        let joints = self.errors().first().map_or(0, |(_, [one, _])| one.len());
        let row = |own: &&Difference| {
            let text = |k: usize| match own.std[k] {
                Some(std) => format!("{} \u{b1} {}", digits(own.values[k]), digits(std)),
                None => digits(own.values[k]),
            };
            context! {
                symbol => &own.symbol, name => &own.name, unit => &own.unit, one => text(0), other => text(1),
                difference => digits(own.values[1] - own.values[0]),
                deviations => own.deviations.map_or("-".to_string(), |d| format!("{d:+.1}")), changed => own.is_changed(),
            }
        };
        let alone = |k: usize| self.alone(k).iter().map(|own| own.symbol.clone()).collect::<Vec<_>>().join(", ");
        let page = context! {
            css => safe(CSS.to_string()),
            robot => &self.reports[0].robot,
            heads => [head(0), head(1)],
            errors, joints,
            rows => self.ordered().iter().map(row).collect::<Vec<_>>(),
            changed => self.changed(),
            limit => CHANGED_DEVIATIONS,
            all => self.parameters.len(),
            alone => [alone(0), alone(1)],
            plots => self.plots(),
        };
        environment.render_named_str("compared", TEMPLATE, page).map_err(io::Error::other)
    }

    /// One picture per unit: both estimates of every parameter with their 95 % intervals.
    fn plots(&self) -> Vec<Value> {
        let mut units: Vec<&str> = Vec::new();
        for own in &self.parameters {
            if !units.contains(&own.unit.as_str()) {
                units.push(&own.unit);
            }
        }
        units.into_iter().filter_map(|unit| Some(context! { unit, plot => safe(self.plot(unit)?) })).collect()
    }

    fn plot(&self, unit: &str) -> Option<String> {
        let own: Vec<&Difference> = self.parameters.iter().filter(|own| own.unit == unit).collect();
        let half = |own: &Difference, k: usize| 1.96 * own.std[k].unwrap_or(0.0);
        let mut halves: Vec<f64> =
            own.iter().flat_map(|own| [half(own, 0), half(own, 1)]).filter(|half| *half > 0.0).collect();
        halves.sort_by(f64::total_cmp);
        let linear = halves.get(halves.len() / 2).copied()?;
        let ends = own
            .iter()
            .flat_map(|own| [0, 1].map(|k| [own.values[k] - half(own, k), own.values[k] + half(own, k)]))
            .flatten();
        let axis = Axis::around(&format!("value / {unit}"), ends, Scale::Symmetric(linear))?;
        let names: Vec<(String, String)> = own.iter().map(|own| (own.symbol.clone(), own.name.clone())).collect();
        let mut chart = Chart::rows(axis, &names, 110.0, 20.0);
        chart.line("z", [(0.0, 0.0), (0.0, own.len() as f64)]);
        for (row, own) in own.iter().enumerate() {
            for (k, class) in [(0, "b"), (1, "m")] {
                let (y, value, half) = (row as f64 + 0.34 + 0.32 * k as f64, own.values[k], half(own, k));
                chart.line(class, [(value - half, y), (value + half, y)]);
                chart.dot(&format!("{class}d"), value, y, &format!("{}: {} {unit}", self.names[k], digits(value)));
            }
        }
        Some(chart.svg())
    }
}

/// The verdict with what was found.
fn verdict(report: &Report) -> String {
    let Some(of) = &report.diagnosis else { return "no diagnosis".into() };
    let headline = diagnosis::headline(of);
    if headline.is_empty() { of.verdict.to_string() } else { format!("{}: {headline}", of.verdict) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(parameters: &[(&str, f64, Option<f64>)]) -> Report {
        let facts = |(name, value, std): &(&str, f64, Option<f64>)| ParameterFacts {
            name: name.to_string(),
            symbol: name.to_string(),
            value: *value,
            std: *std,
            unit: "Nm".into(),
            ..ParameterFacts::default()
        };
        let mut report = Report { robot: "panda".into(), noise_floor: vec![0.1, 0.2], ..Report::default() };
        report.base.parameters = parameters.iter().map(facts).collect();
        report
    }

    #[test]
    fn a_difference_is_judged_by_both_deviations() {
        let one = report(&[("fc1", 1.0, Some(0.03)), ("fc2", 2.0, Some(0.1)), ("fc3", 3.0, None), ("only", 1.0, None)]);
        let other =
            report(&[("fc2", 2.2, Some(0.1)), ("fc1", 1.2, Some(0.04)), ("fc3", 9.0, Some(0.1)), ("fp<4>", 1.0, None)]);
        let compared = Compared::of([("a".into(), one), ("b".into(), other)]);
        let facts = compared.facts();
        assert_eq!((&facts["changed"], &facts["parameters"][0]["name"]), (&1.into(), &"fc1".into()));
        assert!((facts["parameters"][0]["deviations"].as_f64().unwrap() - 4.0).abs() < 1e-9, "{facts}");
        assert_eq!(facts["alone"], serde_json::json!([["only"], ["fp<4>"]]));
        assert_eq!(facts["errors"][0]["rms"], serde_json::json!([[0.1, 0.2], [0.1, 0.2]]));
        assert!(compared.summary().iter().any(|line| line.contains("1 of 3 parameters")), "{:?}", compared.summary());
        let page = compared.to_html().unwrap();
        assert!(page.contains("fp&lt;4&gt;") && page.contains("+4.0") && !page.contains("<4>"), "{page}");
        assert!(!page.contains("src=\"http") && page.contains("</svg>"));
    }
}
