//! Plots with one row per joint, candidate or step.

use super::Errors;
use super::words::fixed;
use crate::report::plot::{AFTER, Area, BEFORE, Drawn, EDGE, GRID, LIMIT, RAW, TEXT, svg, tick};
use crate::report::summary::digits;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;

/// Height of a row in the units of the picture.
const ROW: u32 = 36;
const LETTERS: usize = 50;
/// From this ratio between the largest and the smallest on, an axis is logarithmic.
const WIDE: f64 = 40.0;

/// A joint in a plot of figures before and after.
#[derive(Clone, Debug, Default)]
pub(super) struct Pair {
    /// Joint, from 1.
    pub joint: usize,
    pub before: Option<f64>,
    pub after: Option<f64>,
    /// 95 % intervals of both.
    pub intervals: [Option<[f64; 2]>; 2],
    pub limit: Option<f64>,
}

/// Pairs of errors; without `after` where the model did not change.
pub(super) fn pairs(before: &Errors, after: Option<&Errors>, floor: &[f64]) -> Vec<Pair> {
    let rms = |errors: Option<&Errors>, j: usize| errors.and_then(|errors| errors.validate_rms.get(j).copied());
    let interval = |errors: Option<&Errors>, j: usize| errors.and_then(|errors| errors.intervals.get(j).copied());
    let pair = |j: usize| Pair {
        joint: j + 1,
        before: rms(Some(before), j),
        after: rms(after, j),
        intervals: [interval(Some(before), j), interval(after, j)],
        limit: floor.get(j).copied(),
    };
    (0..before.validate_rms.len()).map(pair).collect()
}

/// One row per joint: before and after as dots with their intervals, a line between, and a mark at the limit.
pub(super) fn dumbbells(pairs: &[Pair], x_name: &str) -> String {
    let of = |pair: &Pair| [pair.before, pair.after, pair.limit];
    let ends = |pair: &Pair| pair.intervals.into_iter().flatten().flatten().map(Some).collect::<Vec<_>>();
    let all = pairs.iter().flat_map(|pair| of(pair).into_iter().chain(ends(pair)));
    let all: Vec<f64> = all.flatten().filter(|value| value.is_finite() && *value > 0.0).collect();
    let (Some(low), Some(high)) = (all.iter().copied().reduce(f64::min), all.iter().copied().reduce(f64::max)) else {
        return String::new();
    };
    let picture = (620, 62 + ROW * pairs.len() as u32);
    if high / low > WIDE {
        // What is not positive has no place on this axis; it stands at the left end.
        svg(picture, |area| dumbbell_rows(&area, (low / 1.3..high * 1.3).log_scale(), low / 1.3, pairs, x_name))
    } else {
        svg(picture, |area| dumbbell_rows(&area, 0.0..high * 1.05, 0.0, pairs, x_name))
    }
}

fn dumbbell_rows<X>(area: &Area, x: X, least: f64, pairs: &[Pair], x_name: &str) -> Drawn
where
    X: AsRangedCoord<Value = f64>,
    X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let count = pairs.len();
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_right(24)
        .set_label_area_size(LabelAreaPosition::Left, 70)
        .set_label_area_size(LabelAreaPosition::Bottom, 50)
        .build_cartesian_2d(x, 0.0..count as f64)?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
    mesh.axis_desc_style(TEXT).label_style(TEXT).x_label_formatter(&tick).x_desc(x_name).disable_y_mesh();
    mesh.x_labels(6).y_labels(0).draw()?;
    let known = |value: Option<f64>| value.filter(|value| value.is_finite()).map(|value| value.max(least));
    for (k, pair) in pairs.iter().enumerate() {
        let y = (count - 1 - k) as f64 + 0.5;
        let (before, after) = (known(pair.before), known(pair.after));
        if let (Some(before), Some(after)) = (before, after) {
            chart.draw_series(LineSeries::new([(before, y), (after, y)], RAW.stroke_width(3)))?;
        }
        for (value, interval, colour) in [(before, pair.intervals[0], BEFORE), (after, pair.intervals[1], AFTER)] {
            let Some(value) = value else { continue };
            if let Some([low, high]) = interval.filter(|ends| ends.iter().all(|end| end.is_finite())) {
                let (low, high) = (low.max(least), high.max(least));
                chart.draw_series(LineSeries::new([(low, y), (high, y)], colour.stroke_width(2)))?;
                let stop = |x: f64| PathElement::new([(x, y - 0.12), (x, y + 0.12)], colour.stroke_width(2));
                chart.draw_series([stop(low), stop(high)])?;
            }
            chart.draw_series([Circle::new((value, y), 6, colour.filled())])?;
        }
        if let Some(limit) = known(pair.limit) {
            chart.draw_series([PathElement::new([(limit, y - 0.34), (limit, y + 0.34)], LIMIT.stroke_width(3))])?;
        }
        let (_, row) = chart.backend_coord(&(least, y));
        area.draw(&Text::new(format!("joint {}", pair.joint), (8, row - 7), TEXT))?;
    }
    area.present()
}

#[derive(Clone, Debug)]
pub(super) struct Bar {
    pub label: String,
    pub value: f64,
    pub kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Chosen,
    Equivalent,
    Plain,
}

fn shortened(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_string();
    }
    text.chars().take(most - 1).collect::<String>().trim_end().to_string() + "\u{2026}"
}

/// One bar per row with its number, and a bracket around those that can't be told apart.
pub(super) fn bars(bars: &[Bar], decimals: bool) -> String {
    let most = bars.iter().map(|bar| bar.value).filter(|value| value.is_finite()).fold(0.0, f64::max);
    let least = bars.iter().map(|bar| bar.value).filter(|value| value.is_finite()).fold(0.0, f64::min);
    if bars.is_empty() || most <= 0.0 && least >= 0.0 {
        return String::new();
    }
    // Candidates far below zero would leave no room for those above.
    let low = if most > 0.0 { least.max(-0.25 * most) } else { least };
    let reach = most - low;
    let range = low - if low < 0.0 { 0.02 * reach } else { 0.0 }..most + 0.2 * reach;
    let count = bars.len();
    svg((820, 16 + ROW * count as u32), |area| {
        let mut chart = ChartBuilder::on(&area)
            .margin(6)
            .margin_right(30)
            .set_label_area_size(LabelAreaPosition::Left, 420)
            .build_cartesian_2d(range, 0.0..count as f64)?;
        let middle = |k: usize| (count - 1 - k) as f64 + 0.5;
        chart.draw_series([PathElement::new([(0.0, 0.0), (0.0, count as f64)], EDGE.stroke_width(1))])?;
        for (k, bar) in bars.iter().enumerate() {
            let y = middle(k);
            let colour = match bar.kind {
                Kind::Chosen => AFTER,
                Kind::Equivalent => EDGE,
                Kind::Plain => RAW,
            };
            let value = if bar.value.is_finite() { bar.value.max(low) } else { 0.0 };
            chart.draw_series([Rectangle::new([(0.0, y - 0.3), (value, y + 0.3)], colour.filled())])?;
            let (end, row) = chart.backend_coord(&(value.max(0.0), y));
            let number = if decimals { fixed(bar.value) } else { digits(bar.value) };
            area.draw(&Text::new(number, (end + 8, row - 7), TEXT))?;
            area.draw(&Text::new(shortened(&bar.label, LETTERS), (8, row - 7), TEXT))?;
        }
        let members: Vec<usize> = (0..count).filter(|&k| bars[k].kind != Kind::Plain).collect();
        let alike = bars.iter().any(|bar| bar.kind == Kind::Equivalent);
        if let (true, Some(&first), Some(&last)) = (alike, members.first(), members.last()) {
            let row = |k: usize| chart.backend_coord(&(0.0, middle(k))).1;
            let spine = PathElement::new([(806, row(first)), (806, row(last))], LIMIT.stroke_width(2));
            area.draw(&spine)?;
            for k in members {
                area.draw(&PathElement::new([(796, row(k)), (806, row(k))], LIMIT.stroke_width(2)))?;
            }
        }
        area.present()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_labels_are_cut_at_letters() {
        assert_eq!(shortened("presliding", 10), "presliding");
        assert_eq!(shortened("\u{3b4}\u{3b4}\u{3b4}\u{3b4}", 3), "\u{3b4}\u{3b4}\u{2026}");
    }

    #[test]
    fn a_plot_of_nothing_is_no_plot() {
        let bar = |value| Bar { label: "delay".into(), value, kind: Kind::Plain };
        assert!(
            bars(&[], true).is_empty() && bars(&[bar(0.0)], true).is_empty() && bars(&[bar(f64::NAN)], true).is_empty()
        );
        assert!(dumbbells(&[Pair::default()], "Nm").is_empty());
        assert!(bars(&[bar(-3.0)], true).contains("-3.000"));
    }
}
