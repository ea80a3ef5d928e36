//! Plots of a recording as inline SVG over the seconds before its end.
//!
//! As in the report, colours are fixed placeholders that the page's style sheet maps to a light and a dark theme.

use super::facts::{Facts, Weight, phase_name, tracking_error};
use super::timing::TimeBase;
use crate::recording::Recording;
use plotters::prelude::*;
use plumbline_core::{Phase, Record};

const MEASURED: RGBColor = RGBColor(1, 1, 1);
const DESIRED: RGBColor = RGBColor(2, 2, 2);
const GRID: RGBColor = RGBColor(5, 5, 5);
const LIMIT: RGBColor = RGBColor(10, 10, 10);
const MARKER: RGBColor = RGBColor(9, 9, 9);
/// The first of one colour per joint.
const FIRST_JOINT_COLOUR: RGBColor = RGBColor(11, 0, 0);
const TEXT: (&str, i32) = ("sans-serif", 17);
/// Number of intervals of a decimated curve; each contributes its lowest and highest value.
const MAX_POINTS: usize = 700;

type Points = Vec<(f64, f64)>;

struct Frame<'f> {
    y_name: &'f str,
    lines: Vec<(Points, RGBColor, u32)>,
    bounds: Vec<f64>,
    /// Times of vertical markers \[s\].
    marks: Vec<f64>,
    size: (u32, u32),
    min_y_range: Option<(f64, f64)>,
}

/// Decimates a curve to the extremes of each interval, which keeps all peaks.
fn decimate(points: Points) -> Points {
    let stretch = points.len().div_ceil(MAX_POINTS);
    if stretch < 2 {
        return points;
    }
    let mut out = Vec::with_capacity(2 * MAX_POINTS + 2);
    for part in points.chunks(stretch) {
        let low = part.iter().copied().min_by(|a, b| a.1.total_cmp(&b.1));
        let high = part.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1));
        let (Some(low), Some(high)) = (low, high) else { continue };
        let (first, second) = if low.0 <= high.0 { (low, high) } else { (high, low) };
        out.extend([first, second]);
    }
    out
}

fn draw(frame: Frame) -> String {
    let all = || frame.lines.iter().flat_map(|(points, _, _)| points);
    let finite = |range: (f64, f64), value: f64| {
        if value.is_finite() { (range.0.min(value), range.1.max(value)) } else { range }
    };
    let x = all().map(|point| point.0).fold((f64::MAX, f64::MIN), finite);
    let mut y = all().map(|point| point.1).chain(frame.bounds.iter().copied()).fold((f64::MAX, f64::MIN), finite);
    if let Some((low, high)) = frame.min_y_range {
        y = finite(finite(y, low), high);
    }
    if x.0 >= x.1 || y.0 > y.1 {
        return String::new();
    }
    let padding = ((y.1 - y.0) * 0.05).max(1e-9);
    let mut text = String::new();
    let drawn = (|| -> Result<(), DrawingAreaErrorKind<std::io::Error>> {
        let area = SVGBackend::with_string(&mut text, frame.size).into_drawing_area();
        let mut chart = ChartBuilder::on(&area)
            .margin(6)
            .set_label_area_size(LabelAreaPosition::Left, 84)
            .set_label_area_size(LabelAreaPosition::Bottom, 48)
            .build_cartesian_2d(x.0..x.1, (y.0 - padding)..(y.1 + padding))?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
        mesh.axis_desc_style(TEXT).label_style(TEXT).y_labels(5).x_labels(8);
        mesh.x_label_formatter(&tick).y_label_formatter(&tick);
        mesh.x_desc("seconds before the end").y_desc(frame.y_name).draw()?;
        for &at in &frame.marks {
            chart.draw_series(LineSeries::new([(at, y.0 - padding), (at, y.1 + padding)], MARKER.stroke_width(1)))?;
        }
        for &bound in &frame.bounds {
            chart.draw_series(LineSeries::new([(x.0, bound), (x.1, bound)], LIMIT.stroke_width(1)))?;
        }
        for (points, colour, width) in &frame.lines {
            let points = points.iter().copied().filter(|point| point.1.is_finite());
            chart.draw_series(LineSeries::new(points, colour.stroke_width(*width)))?;
        }
        area.present()
    })();
    if drawn.is_ok() { text } else { String::new() }
}

/// Axis label without rounding noise.
fn tick(value: &f64) -> String {
    let rounded = (value * 1e6).round() / 1e6;
    if rounded == 0.0 { "0".to_string() } else { format!("{rounded}") }
}

/// Index of the joint to plot: that of the first exceeded limit, else that of the largest tracking error.
pub(super) fn focus(facts: &Facts) -> usize {
    let axis = |limit: &str| matches!(limit, "end-effector-box" | "base-sphere");
    let crossed = facts.first_limit.as_ref().filter(|crossing| !axis(&crossing.limit)).map(|crossing| crossing.joint);
    let farthest = || facts.tracking.iter().max_by(|a, b| a.share.total_cmp(&b.share)).map(|joint| joint.joint);
    let joint = crossed.or_else(farthest).unwrap_or(1);
    joint.saturating_sub(1).min(facts.tracking.len().saturating_sub(1))
}

fn curve(recording: &Recording, value: impl Fn(&Record) -> f64) -> Points {
    let time = TimeBase::of(recording);
    decimate(recording.records.iter().map(|record| (-time.before_end(record.state.seq), value(record))).collect())
}

fn colour(j: usize) -> RGBColor {
    RGBColor(FIRST_JOINT_COLOUR.0 + j as u8, 0, 0)
}

fn stops(recording: &Recording) -> Vec<f64> {
    let time = TimeBase::of(recording);
    let stopping = |timed: &&plumbline_rt::TimedEvent| matches!(timed.event, plumbline_rt::Event::Stopping { .. });
    recording.events.iter().filter(stopping).map(|timed| -time.before_end(timed.seq)).collect()
}

/// Phases over time as a strip, with markers at faults.
pub(super) fn strip(facts: &Facts, recording: &Recording) -> String {
    let time = TimeBase::of(recording);
    let (Some(first), Some(last)) = (recording.records.first(), recording.records.last()) else { return String::new() };
    let (from, to) = (-time.before_end(first.state.seq), -time.before_end(last.state.seq));
    if from >= to {
        return String::new();
    }
    let (width, left) = (1100.0, 20.0);
    let x = |at: f64| left + (at - from) / (0.0 - from) * width;
    let mut text = String::from(r#"<svg viewBox="0 0 1140 96" role="img" aria-label="phases over time">"#);
    let mut part = |start: f64, end: f64, phase: Phase| {
        let (a, b) = (x(start), x(end));
        let (class, name) = (phase as u32, phase_name(phase));
        text +=
            &format!(r#"<rect class="phase{class}" x="{a:.1}" y="26" width="{:.1}" height="30"/>"#, (b - a).max(1.0));
        if b - a > 9.0 * name.len() as f64 {
            text += &format!(r#"<text class="in" x="{:.1}" y="46" text-anchor="middle">{name}</text>"#, 0.5 * (a + b));
        }
    };
    let mut start = first;
    for record in &recording.records {
        if record.phase != start.phase {
            part(-time.before_end(start.state.seq), -time.before_end(record.state.seq), start.phase);
            start = record;
        }
    }
    part(-time.before_end(start.state.seq), to, start.phase);
    for line in facts.timeline.iter().filter(|line| line.weight == Weight::Bad) {
        let at = x(-line.before);
        text +=
            &format!(r#"<path class="mark" d="M{at:.1} 14 V62"/><circle class="mark" cx="{at:.1}" cy="14" r="5"/>"#);
    }
    // About ten labels for any span.
    let decade = 10f64.powf((-from / 10.0).log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|part| part * decade).into_iter().find(|step| -from / step <= 12.0);
    let step = step.unwrap_or(-from);
    for k in 0..=((-from / step) as i32).clamp(0, 12) {
        let at = -step * f64::from(k);
        text += &format!(r#"<text x="{:.1}" y="82" text-anchor="middle">{}</text>"#, x(at), tick(&at));
    }
    text + "</svg>"
}

pub(super) fn position(recording: &Recording, j: usize) -> String {
    draw(Frame {
        y_name: "q / rad",
        lines: vec![
            (curve(recording, |record| record.command.desired.q[j]), DESIRED, 3),
            (curve(recording, |record| record.state.q[j]), MEASURED, 1),
        ],
        bounds: Vec::new(),
        marks: stops(recording),
        size: (820, 330),
        min_y_range: None,
    })
}

/// Desired and measured velocity of one joint around the last stop, or the end.
pub(super) fn around_the_stop(facts: &Facts, recording: &Recording, j: usize) -> String {
    let (began, lasted) = facts.stop.as_ref().map_or((0.0, 0.0), |stop| (stop.before, stop.seconds));
    let time = TimeBase::of(recording);
    let (from, to) = (began + 0.25_f64.max(lasted), began - lasted - 0.1);
    let within = |record: &&Record| (to..=from).contains(&time.before_end(record.state.seq));
    let part: Vec<&Record> = recording.records.iter().filter(within).collect();
    let points = |value: &dyn Fn(&Record) -> f64| -> Points {
        decimate(part.iter().map(|record| (-time.before_end(record.state.seq), value(record))).collect())
    };
    draw(Frame {
        y_name: "dq / rad/s",
        lines: vec![
            (points(&|record| record.command.desired.dq[j]), DESIRED, 3),
            (points(&|record| record.state.dq[j]), MEASURED, 1),
        ],
        bounds: Vec::new(),
        marks: stops(recording).into_iter().filter(|at| (to..=from).contains(&-at)).collect(),
        size: (820, 330),
        min_y_range: None,
    })
}

/// Tracking error of every joint as a share of the tolerance.
pub(super) fn tracking(recording: &Recording) -> String {
    let (time, tolerance) = (TimeBase::of(recording), recording.about.settings.tracking());
    let line = |j: usize| {
        let pairs = recording.records.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1);
        let share = |pair: &[Record]| tracking_error(&pair[0], &pair[1], j) / tolerance[j];
        (decimate(pairs.map(|pair| (-time.before_end(pair[1].state.seq), share(pair))).collect()), colour(j), 1)
    };
    draw(Frame {
        y_name: "share of tolerance",
        lines: (0..recording.about.joints).map(line).collect(),
        bounds: vec![-1.0, 1.0],
        marks: stops(recording),
        size: (820, 330),
        min_y_range: None,
    })
}

/// Measured torque of every joint as a share of its limit.
pub(super) fn torque(recording: &Recording) -> String {
    let limits = recording.about.settings.limits();
    draw(Frame {
        y_name: "share of limit",
        lines: (0..recording.about.joints)
            .map(|j| (curve(recording, |record| record.state.tau[j] / limits.tau[j]), colour(j), 1))
            .collect(),
        bounds: vec![-1.0, 1.0],
        marks: stops(recording),
        size: (820, 330),
        min_y_range: None,
    })
}

/// Period and execution time in ms; in simulated time, the period in cycles of the arm.
pub(super) fn timing(recording: &Recording) -> String {
    let time = TimeBase::of(recording);
    let simulated = super::replay::is_simulated(recording);
    let pairs = || recording.records.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1);
    let period = |pair: &[Record]| {
        if simulated {
            pair[1].state.seq.saturating_sub(pair[0].state.seq) as f64
        } else {
            pair[1].stamp_ns.saturating_sub(pair[0].stamp_ns) as f64 / 1e6
        }
    };
    let at = |record: &Record| -time.before_end(record.state.seq);
    let mut lines = vec![(decimate(pairs().map(|pair| (at(&pair[1]), period(pair))).collect()), MEASURED, 1)];
    if !simulated {
        // A record holds the execution time of the previous cycle.
        lines.push((decimate(pairs().map(|pair| (at(&pair[0]), pair[1].work_ns as f64 / 1e6)).collect()), DESIRED, 1));
    }
    let y_name = if simulated { "arm's cycles" } else { "ms" };
    draw(Frame {
        y_name,
        lines,
        bounds: vec![1.0],
        marks: stops(recording),
        size: (820, 330),
        min_y_range: Some((0.0, 2.0)),
    })
}
