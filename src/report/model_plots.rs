//! Plots of a model: its parameters, their correlation, friction, the use of limits, durations of the loop.

use super::ParameterFacts;
use super::chart::{Axis, Chart, Scale, escaped};
use super::figures::{Bin, DurationFigure, FrictionFigure, PlanFigure};
use super::summary::digits;
use plumbline_excite::{Criterion, PlanSearch};
use std::fmt::Write;

/// From this share of its value on, a standard deviation marks a parameter as weak.
pub const WEAK: f64 = 0.3;

/// Whether data says little of a parameter: its interval holds zero, or its standard deviation is large against it.
pub fn is_weak(of: &ParameterFacts) -> bool {
    let holds_zero = of.interval_95.is_some_and(|[low, high]| low <= 0.0 && high >= 0.0);
    holds_zero || of.std.is_some_and(|std| std > WEAK * of.value.abs())
}

/// Units in the order of their first parameter.
fn units(parameters: &[ParameterFacts]) -> Vec<&str> {
    let mut units: Vec<&str> = Vec::new();
    for own in parameters {
        if !units.contains(&own.unit.as_str()) {
            units.push(&own.unit);
        }
    }
    units
}

/// Parameters with their 95 % intervals, one picture per unit: unit and picture.
pub fn forest(parameters: &[ParameterFacts]) -> Vec<(String, String)> {
    let picture = |unit: &str| {
        let own: Vec<&ParameterFacts> = parameters.iter().filter(|own| own.unit == unit).collect();
        let known = |own: &&&ParameterFacts| own.interval_95.is_some();
        let half = |own: &ParameterFacts| own.interval_95.map_or(f64::NAN, |[low, high]| 0.5 * (high - low));
        let mut halves: Vec<f64> = own.iter().filter(known).map(|own| half(own)).filter(|half| *half > 0.0).collect();
        halves.sort_by(f64::total_cmp);
        // The narrow half of the intervals shows as dots, the wide one as bars.
        let linear = halves.get(halves.len() / 2).copied()?;
        let ends = own.iter().flat_map(|own| own.interval_95.unwrap_or([own.value; 2]));
        let unit_name = if unit == "1" || unit.is_empty() { "value".to_string() } else { format!("value / {unit}") };
        let axis = Axis::around(&unit_name, ends, Scale::Symmetric(linear))?;
        let names: Vec<(String, String)> =
            own.iter().map(|own| (own.symbol.clone(), format!("{} = {}", own.name, own.expression))).collect();
        let mut chart = Chart::rows(axis, &names, 110.0, 17.0);
        chart.line("z", [(0.0, 0.0), (0.0, own.len() as f64)]);
        for (k, own) in own.iter().enumerate() {
            let (y, class) = (k as f64 + 0.5, if is_weak(own) { "w" } else { "m" });
            let interval = own.interval_95.map_or(String::new(), |[low, high]| {
                chart.line(class, [(low, y), (high, y)]);
                format!(", 95 %: {} to {}", digits(low), digits(high))
            });
            let weak = if is_weak(own) { ", weak" } else { "" };
            let about = format!("{}: {} {unit}{interval}{weak}", own.name, digits(own.value));
            chart.dot(&format!("{class}d"), own.value, y, &about);
        }
        Some((unit.to_string(), chart.svg()))
    };
    units(parameters).into_iter().filter_map(picture).collect()
}

/// Size of a correlation from which on it is drawn.
pub const LEAST_CORRELATION: f64 = 0.1;
/// Sizes from which on a correlation has a stronger shade.
const SHADES: [f64; 5] = [LEAST_CORRELATION, 0.3, 0.5, 0.7, 0.9];

/// Correlation of the parameters' errors as a matrix: blue for equal signs, orange for opposite ones.
pub fn correlation(matrix: &[Vec<f64>], parameters: &[ParameterFacts]) -> String {
    let p = matrix.len();
    if p < 2 || parameters.len() != p {
        return String::new();
    }
    const CELL: f64 = 10.0;
    const EDGE: f64 = 74.0;
    let mut cells: Vec<String> = vec![String::new(); 2 * SHADES.len()];
    for (row, values) in matrix.iter().enumerate() {
        for (column, value) in values.iter().enumerate().filter(|(column, _)| *column != row) {
            let Some(shade) = SHADES.iter().rposition(|least| value.abs() >= *least) else { continue };
            let class = 2 * shade + usize::from(*value < 0.0);
            let (x, y) = (EDGE + CELL * column as f64, EDGE + CELL * row as f64);
            let _ = write!(cells[class], "M{x} {y}h{CELL}v{CELL}h-{CELL}z");
        }
    }
    let mut body = String::new();
    let size = EDGE + CELL * p as f64;
    let _ = write!(body, r#"<rect class="frame" x="{EDGE}" y="{EDGE}" width="{0}" height="{0}"/>"#, size - EDGE);
    for (class, path) in cells.iter().enumerate().filter(|(_, path)| !path.is_empty()) {
        let (sign, opacity) = (["pos", "neg"][class % 2], (class / 2 + 1) as f64 / SHADES.len() as f64);
        let _ = write!(body, r#"<path class="{sign}" fill-opacity="{opacity:.1}" d="{path}"/>"#);
    }
    for (k, own) in parameters.iter().enumerate() {
        let (at, symbol) = (EDGE + CELL * (k as f64 + 0.5) + 3.0, escaped(&own.symbol));
        let edge = EDGE - 4.0;
        let _ = write!(body, r#"<text x="{edge}" y="{at:.0}" text-anchor="end">{symbol}</text>"#);
        let _ = write!(body, r#"<text transform="translate({at:.0} {edge}) rotate(-90)">{symbol}</text>"#);
    }
    format!(r#"<svg class="chart matrix" viewBox="0 0 {:.0} {:.0}" role="img">{body}</svg>"#, size + 4.0, size + 4.0)
}

/// The pair of parameters with the largest correlation.
pub fn most_correlated<'p>(matrix: &[Vec<f64>], parameters: &'p [ParameterFacts]) -> Option<(&'p str, &'p str, f64)> {
    let pairs = matrix
        .iter()
        .enumerate()
        .flat_map(|(row, values)| values[..row].iter().enumerate().map(move |(c, r)| (row, c, *r)));
    let (row, column, value) = pairs.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))?;
    Some((&parameters.get(column)?.symbol, &parameters.get(row)?.symbol, value))
}

fn bins(name: &str, bins: &[Bin], scale: Scale) -> String {
    let x = Axis::around(name, bins.iter().map(|bin| bin.x), scale);
    let ends = bins
        .iter()
        .flat_map(|bin| [bin.measured, bin.modelled, bin.measured + bin.deviation, bin.measured - bin.deviation]);
    let (Some(x), Some(y)) = (x, Axis::around("torque / Nm", ends, Scale::Linear)) else { return String::new() };
    let mut chart = Chart::new(x, y, 250.0);
    let spread = |bin: &Bin| (bin.x, bin.measured - bin.deviation, bin.measured + bin.deviation);
    chart.band("spread", &bins.iter().map(spread).collect::<Vec<_>>());
    chart.line("model", bins.iter().map(|bin| (bin.x, bin.modelled)));
    for bin in bins {
        let about =
            format!("{}: measured {}, modelled {} Nm", digits(bin.x), digits(bin.measured), digits(bin.modelled));
        chart.dot("md", bin.x, bin.measured, &about);
    }
    chart.svg()
}

/// Friction of a joint over its velocity.
pub fn friction(of: &FrictionFigure) -> String {
    bins(&format!("dq{} / (rad/s)", of.joint), &of.velocity, Scale::Linear)
}

/// Friction of a joint in the direction of motion, over the displacement since its last reversal.
pub fn hysteresis(of: &FrictionFigure) -> String {
    let milli: Vec<Bin> = of.displacement.iter().map(|bin| Bin { x: 1e3 * bin.x, ..*bin }).collect();
    bins(&format!("displacement of joint {} since its reversal / mrad", of.joint), &milli, Scale::Log)
}

/// The range of every joint, and what of it the motion uses.
pub fn limits(plan: &PlanFigure) -> String {
    let degrees = |rad: f64| rad.to_degrees();
    let ends = plan.limits.iter().flatten().map(|rad| degrees(*rad));
    let Some(x) = Axis::around("q / deg", ends, Scale::Linear) else { return String::new() };
    let names: Vec<(String, String)> = (1..=plan.limits.len()).map(|j| (format!("joint {j}"), String::new())).collect();
    let mut chart = Chart::rows(x, &names, 62.0, 26.0);
    for (j, ([low, high], q)) in plan.limits.iter().zip(&plan.q).enumerate() {
        let (y, [low, high]) = (j as f64, [degrees(*low), degrees(*high)]);
        let (least, most) = q.iter().fold((f64::MAX, f64::MIN), |(least, most), q| (least.min(*q), most.max(*q)));
        let (least, most) = (degrees(least), degrees(most));
        chart.bar("room", [low, high], [y + 0.2, y + 0.8], &format!("limits {low:.0} to {high:.0} deg"));
        chart.bar("used", [least, most], [y + 0.34, y + 0.66], &format!("motion {least:.0} to {most:.0} deg"));
    }
    chart.svg()
}

/// Evaluations per unit of the axis of [`search`].
const EVALUATIONS: f64 = 1e3;

/// The criterion of a search and its best value over the evaluations of the objective, as a staircase; empty for a search without a motion.
pub fn search(of: &PlanSearch) -> String {
    let name = match of.criterion {
        Criterion::Raw => "condition number",
        Criterion::RawRigid => "condition number, rigid body",
        Criterion::Equilibrated => "condition number, column-equilibrated",
        Criterion::Weighted => "condition number, noise-weighted",
        Criterion::LogDet => "exp(criterion log-det)",
    };
    let steps: Vec<(f64, f64)> =
        of.evaluations.iter().zip(&of.best).map(|(count, best)| (*count as f64 / EVALUATIONS, *best)).collect();
    let x = Axis::around("evaluations / 1000", [0.0].into_iter().chain(steps.iter().map(|(x, _)| *x)), Scale::Linear);
    let y = Axis::around(name, of.best.iter().copied(), Scale::Log);
    let (Some(x), Some(y)) = (x, y) else { return String::new() };
    let mut chart = Chart::new(Axis { low: 0.0, ..x }, y, 220.0);
    let corners = steps.windows(2).flat_map(|pair| [pair[0], (pair[1].0, pair[0].1)]);
    chart.line("m", corners.chain(steps.last().copied()));
    for (x, best) in &steps {
        chart.dot("md", *x, *best, &format!("{} after {:.0} evaluations", digits(*best), EVALUATIONS * x));
    }
    chart.svg()
}

/// Durations as bars, both axes logarithmic.
pub fn durations(of: &DurationFigure) -> String {
    let most = of.counts.iter().copied().max().unwrap_or(0) as f64;
    let x = Axis::around("duration / us", of.edges.iter().copied(), Scale::Log);
    let (Some(x), true) = (x, most > 0.0) else { return String::new() };
    let y = Axis { name: "cycles".into(), low: 0.5, high: 2.0 * most, scale: Scale::Log };
    let mut chart = Chart::new(x, y, 220.0);
    for (ends, count) in of.edges.windows(2).zip(&of.counts).filter(|(_, count)| **count > 0) {
        let about = format!("{} to {} us: {count} cycles", digits(ends[0]), digits(ends[1]));
        chart.bar("count", [ends[0], ends[1]], [0.5, *count as f64], &about);
    }
    chart.svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_search_is_a_staircase_down_to_its_last_motion() {
        let course =
            PlanSearch { criterion: Criterion::Raw, evaluations: vec![1000, 4000, 9000], best: vec![40.0, 20.0, 20.0] };
        let svg = search(&course);
        assert!(svg.contains(">evaluations / 1000<") && svg.contains(">condition number<"), "{svg}");
        assert!(svg.contains("20.0 after 4000 evaluations") && svg.matches("<circle").count() == 3, "{svg}");
        // Two steps: across at the old value, then down; the last one does not fall.
        let line = svg.split(r#"class="m" d="M"#).nth(1).unwrap().split('"').next().unwrap();
        let places: Vec<Vec<f64>> =
            line.split('L').map(|place| place.split(' ').map(|at| at.parse().unwrap()).collect()).collect();
        assert_eq!(places.len(), 5, "{line}");
        assert!(places[0][1] == places[1][1] && places[1][1] < places[2][1] && places[2][1] == places[4][1], "{line}");
        assert!(places.windows(2).all(|pair| pair[1][0] >= pair[0][0]), "{line}");
        assert!(search(&PlanSearch { evaluations: vec![], best: vec![], ..course }).is_empty());
    }
}
