//! Plots as inline SVG.
//!
//! Colours are placeholders: the page's style sheet maps each fixed tint to a colour of the light and the
//! dark theme (`report.html`, "plot colours").

use super::figures::{PlanFigure, TorqueFigure, thin};
use plotters::coord::Shift;
use plotters::prelude::*;

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
pub(super) type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

const MEASURED: RGBColor = RGBColor(1, 1, 1);
const MODELLED: RGBColor = RGBColor(2, 2, 2);
const RESIDUAL: RGBColor = RGBColor(3, 3, 3);
pub(super) const BAND: RGBColor = RGBColor(4, 4, 4);
/// Edges of the noise band, over the curve that hides the band itself; bars of quantiles.
pub(super) const EDGE: RGBColor = RGBColor(6, 6, 6);
/// Raw measured torque, behind the filtered one.
pub(super) const RAW: RGBColor = RGBColor(7, 7, 7);
pub(super) const BEFORE: RGBColor = RGBColor(8, 8, 8);
pub(super) const AFTER: RGBColor = RGBColor(9, 9, 9);
/// Reference lines: noise floors, thresholds.
pub(super) const LIMIT: RGBColor = RGBColor(10, 10, 10);
/// Axes and grid.
pub(super) const GRID: RGBColor = RGBColor(5, 5, 5);
/// The first of one colour per joint.
const JOINT: RGBColor = RGBColor(11, 0, 0);

pub(super) const TEXT: (&str, i32) = ("sans-serif", 18);

/// Draws an SVG of the given size; empty on an error, which finite data does not cause.
pub(super) fn svg(size: (u32, u32), draw: impl FnOnce(Area) -> Drawn) -> String {
    let mut text = String::new();
    match draw(SVGBackend::with_string(&mut text, size).into_drawing_area()) {
        Ok(()) => text,
        Err(_) => String::new(),
    }
}

/// Lowest and highest value with padding; never empty.
pub(super) fn span<'v>(values: impl IntoIterator<Item = &'v f64>) -> (f64, f64) {
    let finite = values.into_iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
    if low > high {
        return (-1.0, 1.0);
    }
    let air = ((high - low) * 0.06).max(high.abs() * 1e-6).max(1e-9);
    (low - air, high + air)
}

/// Both ends of a time axis; never empty.
pub(super) fn time_span(t: &[f64]) -> (f64, f64) {
    match (t.first(), t.last()) {
        (Some(&first), Some(&last)) if last > first => (first, last),
        _ => (0.0, 1.0),
    }
}

/// Axis label without trailing zeros.
pub(super) fn tick(value: &f64) -> String {
    let rounded = (value * 1e4).round() / 1e4 + 0.0;
    format!("{rounded}")
}

/// A curve: its points, colour and width.
type Line = (Vec<(f64, f64)>, RGBColor, u32);

struct Curves<'l> {
    t: (f64, f64),
    y: (f64, f64),
    y_name: &'l str,
    /// Empty where another chart below names the axis.
    x_name: &'l str,
    y_ticks: usize,
    /// Half the width of a band around zero.
    band: Option<f64>,
    lines: &'l [Line],
}

fn curves(area: &Area, of: Curves) -> Drawn {
    let Curves { t: (t0, t1), y: (low, high), y_name, x_name, y_ticks, band, lines } = of;
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        // Half of the last number of each axis.
        .margin_top(12)
        .margin_right(16)
        .set_label_area_size(LabelAreaPosition::Left, 78)
        .set_label_area_size(LabelAreaPosition::Bottom, if x_name.is_empty() { 28 } else { 50 })
        .build_cartesian_2d(t0..t1, low..high)?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
    mesh.axis_desc_style(TEXT)
        .label_style(TEXT)
        .x_labels(8)
        .y_labels(y_ticks)
        .x_label_formatter(&tick)
        .y_label_formatter(&tick);
    mesh.y_desc(y_name).x_desc(x_name).draw()?;
    if let Some(half) = band {
        let corners = [(t0, (-half).max(low)), (t1, half.min(high))];
        chart.draw_series([Rectangle::new(corners, BAND.filled())])?;
    }
    for (points, colour, width) in lines {
        chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(*width)))?;
    }
    for edge in band.iter().flat_map(|half| [-half, *half]) {
        chart.draw_series(LineSeries::new([(t0, edge), (t1, edge)], EDGE.stroke_width(2)))?;
    }
    Ok(())
}

/// Joint `j` of a run: measured and modelled torque above, residual and noise band below.
pub(super) fn torque(figure: &TorqueFigure, j: usize) -> String {
    let (Some(measured), Some(modelled)) = (figure.measured.get(j), figure.modelled.get(j)) else {
        return String::new();
    };
    let residual: Vec<f64> = measured.iter().zip(modelled).map(|(measured, modelled)| measured - modelled).collect();
    let t = time_span(&figure.t);
    let noise = figure.noise.get(j).map(|noise| 2.0 * noise);
    let far = residual.iter().fold(noise.unwrap_or(0.0), |far, value| far.max(value.abs())).max(1e-9) * 1.1;
    svg((820, 430), |area| {
        let (above, below) = area.split_vertically(250);
        let raw = figure.raw.get(j).map_or(&[][..], Vec::as_slice);
        let mut lines = vec![(thin(&figure.t, measured), MEASURED, 4), (thin(&figure.t, modelled), MODELLED, 2)];
        if !raw.is_empty() {
            lines.insert(0, (thin(&figure.t, raw), RAW, 1));
        }
        let y = span(measured.iter().chain(modelled).chain(raw));
        let torque = Curves { t, y, y_name: "torque / Nm", x_name: "", y_ticks: 6, band: None, lines: &lines };
        curves(&above, torque)?;
        let left = [(thin(&figure.t, &residual), RESIDUAL, 1)];
        let (y, y_name) = ((-far, far), "residual / Nm");
        curves(&below, Curves { t, y, y_name, x_name: "t / s", y_ticks: 5, band: noise, lines: &left })?;
        area.present()
    })
}

pub(super) fn positions(plan: &PlanFigure) -> String {
    let lines: Vec<Line> = plan.q.iter().enumerate().map(|(j, q)| (thin(&plan.t, q), joint_colour(j), 2)).collect();
    svg((1140, 440), |area| {
        let (t, y) = (time_span(&plan.t), span(plan.q.iter().flatten()));
        curves(&area, Curves { t, y, y_name: "q / rad", x_name: "t / s", y_ticks: 7, band: None, lines: &lines })?;
        area.present()
    })
}

fn joint_colour(j: usize) -> RGBColor {
    RGBColor(JOINT.0 + j as u8, 0, 0)
}

/// Path of the end effector seen along one axis of the base frame; `axes` are the two that are drawn.
pub(super) fn path(plan: &PlanFigure, axes: [usize; 2], names: [&str; 2]) -> String {
    let points: Vec<(f64, f64)> = plan.end_effector.iter().map(|point| (point[axes[0]], point[axes[1]])).collect();
    let points: Vec<_> = points.iter().step_by(points.len().div_ceil(1500).max(1)).copied().collect();
    let mut corners: Vec<(f64, f64)> = points.clone();
    if let Some(space) = &plan.workspace {
        corners.push((space.box_min[axes[0]], space.box_min[axes[1]]));
        corners.push((space.box_max[axes[0]], space.box_max[axes[1]]));
        corners.extend([-space.base_radius, space.base_radius].map(|radius| (radius, radius)));
    }
    // Equal scales on both axes.
    let (x, y) = (span(corners.iter().map(|(x, _)| x)), span(corners.iter().map(|(_, y)| y)));
    let half = 0.5 * (x.1 - x.0).max(y.1 - y.0);
    let around = |(low, high): (f64, f64)| (0.5 * (low + high) - half, 0.5 * (low + high) + half);
    let (x, y) = (around(x), around(y));
    svg((430, 410), |area| {
        let mut chart = ChartBuilder::on(&area)
            .margin(6)
            .set_label_area_size(LabelAreaPosition::Left, 78)
            .set_label_area_size(LabelAreaPosition::Bottom, 50)
            .build_cartesian_2d(x.0..x.1, y.0..y.1)?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
        mesh.axis_desc_style(TEXT)
            .label_style(TEXT)
            .x_labels(5)
            .y_labels(5)
            .x_label_formatter(&tick)
            .y_label_formatter(&tick);
        mesh.x_desc(names[0]).y_desc(names[1]).draw()?;
        if let Some(space) = &plan.workspace {
            let [a, b] = axes;
            let corners = [(space.box_min[a], space.box_min[b]), (space.box_max[a], space.box_max[b])];
            chart.draw_series([Rectangle::new(corners, MODELLED.stroke_width(1))])?;
            let circle = (0..=90).map(|k| f64::from(k) * std::f64::consts::PI / 45.0);
            let circle = circle.map(|angle| (space.base_radius * angle.cos(), space.base_radius * angle.sin()));
            chart.draw_series(LineSeries::new(circle, MODELLED.stroke_width(1)))?;
        }
        chart.draw_series(LineSeries::new(points, MEASURED.stroke_width(2)))?;
        area.present()
    })
}

/// Distributions of durations, one bar each on a logarithmic axis: from the median to the 99th percentile thick, on to the largest
/// thin, with a dot at p50, p99, p99.9 and the largest.
pub(super) fn quantiles(rows: &[(String, [f64; 4])]) -> String {
    // Resolution of the clock: a tenth of a microsecond.
    let at = |us: f64| us.max(0.1);
    let marks = |times: &[f64; 4]| times.map(at);
    let all: Vec<f64> = rows.iter().flat_map(|(_, q)| marks(q)).filter(|us| us.is_finite()).collect();
    let (Some(low), Some(high)) = (all.iter().copied().reduce(f64::min), all.iter().copied().reduce(f64::max)) else {
        return String::new();
    };
    let count = rows.len();
    svg((1140, 70 + 34 * count as u32), |area| {
        let mut chart = ChartBuilder::on(&area)
            .margin(6)
            .set_label_area_size(LabelAreaPosition::Left, 240)
            .set_label_area_size(LabelAreaPosition::Bottom, 54)
            .build_cartesian_2d((low / 1.5..high * 1.5).log_scale(), 0.0..count as f64)?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
        mesh.axis_desc_style(TEXT).label_style(TEXT).x_label_formatter(&tick).x_desc("us").disable_y_mesh();
        mesh.y_labels(0).draw()?;
        for (k, (name, q)) in rows.iter().enumerate() {
            let y = (count - 1 - k) as f64 + 0.5;
            let [p50, p99, _, max] = marks(q);
            chart.draw_series([Rectangle::new([(p50, y - 0.14), (p99, y + 0.14)], EDGE.filled())])?;
            chart.draw_series(LineSeries::new([(p50, y), (max, y)], EDGE.stroke_width(2)))?;
            chart.draw_series(marks(q).map(|us| Circle::new((us, y), 4, MEASURED.filled())))?;
            let (_, row) = chart.backend_coord(&(p50, y));
            area.draw(&Text::new(name.clone(), (8, row - 6), TEXT))?;
        }
        area.present()
    })
}
