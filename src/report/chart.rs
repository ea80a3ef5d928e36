//! Small charts as SVG text whose colours are those of the page. Plots of long curves are drawn by plotters, in `plot`.

use std::fmt::Write;

/// Width of the picture, in its own units; text is 12 of them high.
pub const WIDTH: f64 = 460.0;
const LEFT: f64 = 56.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 38.0;

/// Smallest distance of two numbers on an axis, as a share of it.
const MIN_TICK_SHARE: f64 = 0.09;

/// How values become places on an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scale {
    Linear,
    /// Values are positive.
    Log,
    /// Linear within this distance of zero, logarithmic beyond.
    Symmetric(f64),
}

impl Scale {
    fn of(self, value: f64) -> f64 {
        match self {
            Scale::Linear => value,
            Scale::Log => value.max(f64::MIN_POSITIVE).ln(),
            Scale::Symmetric(linear) => (value / linear).asinh(),
        }
    }
}

/// An axis: its name with the unit, its ends, its scale.
#[derive(Clone, Debug)]
pub struct Axis {
    pub name: String,
    pub low: f64,
    pub high: f64,
    pub scale: Scale,
}

impl Axis {
    /// An axis that holds all values, with some room; `None` without a finite value.
    pub fn around(name: &str, values: impl IntoIterator<Item = f64>, scale: Scale) -> Option<Axis> {
        let usable = |value: &f64| value.is_finite() && (scale != Scale::Log || *value > 0.0);
        let values = values.into_iter().filter(usable);
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), value| (low.min(value), high.max(value)));
        if low > high {
            return None;
        }
        let (low, high) = match scale {
            Scale::Log => (low / 1.15, high * 1.15),
            Scale::Symmetric(_) => (1.3 * low.min(0.0), 1.3 * high.max(0.0)),
            Scale::Linear => {
                let room = (0.06 * (high - low)).max(1e-9 + 1e-6 * high.abs());
                (low - room, high + room)
            }
        };
        Some(Axis { name: name.into(), low, high, scale })
    }

    /// Share of the axis below a value.
    fn share(&self, value: f64) -> f64 {
        let [at, low, high] = [value, self.low, self.high].map(|value| self.scale.of(value));
        if high == low { 0.5 } else { (at - low) / (high - low) }
    }

    fn ticks(&self) -> Vec<f64> {
        let linear = || {
            let raw = (self.high - self.low) / 5.0;
            let power = 10f64.powf(raw.log10().floor());
            let step = [1.0, 2.0, 5.0, 10.0].map(|k| k * power).into_iter().find(|step| *step >= raw).unwrap_or(raw);
            let first = (self.low / step).ceil() as i64;
            let last = (self.high / step).floor() as i64;
            (first..=last).map(|k| k as f64 * step).collect()
        };
        match self.scale {
            Scale::Linear => linear(),
            Scale::Log => {
                let decades = || (self.low.log10().floor() as i32)..=(self.high.log10().ceil() as i32);
                let within = |value: &f64| (self.low..=self.high).contains(value);
                let whole: Vec<f64> = decades().map(|k| 10f64.powi(k)).filter(within).collect();
                if whole.len() > 1 {
                    return whole;
                }
                let digits = |k: i32| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(k));
                let some: Vec<f64> = decades().flat_map(digits).filter(within).collect();
                // One number is no scale.
                if some.len() > 1 { some } else { linear() }
            }
            Scale::Symmetric(linear) => {
                let first = linear.log10().ceil() as i32;
                let decades: Vec<f64> = (first..=first + 12).map(|k| 10f64.powi(k)).collect();
                let within = |value: &f64| (self.low..=self.high).contains(value);
                let every =
                    decades.iter().filter(|value| **value <= self.high.max(-self.low)).count().div_ceil(3).max(1);
                let decades = decades.into_iter().rev().skip_while(|value| *value > self.high.max(-self.low));
                let kept: Vec<f64> = decades.step_by(every).collect();
                let both = kept.iter().flat_map(|value| [-value, *value]);
                // A number beside zero that would touch it is left out.
                let apart = |value: &f64| (self.share(*value) - self.share(0.0)).abs() > MIN_TICK_SHARE;
                both.filter(apart).chain([0.0]).filter(within).collect()
            }
        }
    }
}

/// A number on an axis.
fn label(value: f64) -> String {
    match value.abs() {
        0.0 => "0".into(),
        size if !(1e-3..1e5).contains(&size) => format!("{value:.0e}"),
        _ => format!("{}", (value * 1e6).round() / 1e6),
    }
}

/// Text inside SVG.
pub fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A chart under construction.
pub struct Chart {
    x: Axis,
    y: Axis,
    height: f64,
    left: f64,
    body: String,
}

impl Chart {
    /// A chart with numbered axes and a grid.
    pub fn new(x: Axis, y: Axis, height: f64) -> Chart {
        let mut chart = Chart { x, y, height, left: LEFT, body: String::new() };
        chart.grid(true);
        for value in chart.y.ticks() {
            let (y, text) = (chart.y(value), label(value));
            let (left, right) = (chart.left, WIDTH - RIGHT);
            let _ = write!(
                chart.body,
                r#"<path class="g" d="M{left} {y:.1}H{right}"/><text x="{:.0}" y="{:.1}" text-anchor="end">{text}</text>"#,
                left - 6.0,
                y + 4.0
            );
        }
        let (name, middle) = (escaped(&chart.y.name), TOP + 0.5 * (chart.height - TOP - BOTTOM));
        let _ = write!(
            chart.body,
            r#"<text transform="translate(13 {middle:.0}) rotate(-90)" text-anchor="middle">{name}</text>"#
        );
        chart
    }

    /// A chart whose rows have names; row `k` is at `k + 0.5` from the top.
    pub fn rows(x: Axis, names: &[(String, String)], left: f64, row: f64) -> Chart {
        let count = names.len() as f64;
        let y = Axis { name: String::new(), low: count, high: 0.0, scale: Scale::Linear };
        let mut chart = Chart { x, y, height: TOP + BOTTOM + row * count, left, body: String::new() };
        chart.grid(false);
        for (k, (name, about)) in names.iter().enumerate() {
            let y = chart.y(k as f64 + 0.5) + 4.0;
            let (name, about) = (escaped(name), escaped(about));
            let _ = write!(
                chart.body,
                r#"<text x="{:.0}" y="{y:.1}" text-anchor="end">{name}<title>{about}</title></text>"#,
                left - 8.0
            );
        }
        chart
    }

    fn grid(&mut self, frame: bool) {
        let (top, bottom) = (TOP, self.height - BOTTOM);
        for value in self.x.ticks() {
            let x = self.x(value);
            let text = label(value);
            let _ = write!(
                self.body,
                r#"<path class="g" d="M{x:.1} {top}V{bottom}"/><text x="{x:.1}" y="{:.0}" text-anchor="middle">{text}</text>"#,
                bottom + 15.0
            );
        }
        if frame {
            let _ = write!(self.body, r#"<path class="g" d="M{} {bottom}H{}"/>"#, self.left, WIDTH - RIGHT);
        }
        let middle = 0.5 * (self.left + WIDTH - RIGHT);
        let name = escaped(&self.x.name);
        let _ =
            write!(self.body, r#"<text x="{middle:.0}" y="{:.0}" text-anchor="middle">{name}</text>"#, bottom + 32.0);
    }

    fn x(&self, value: f64) -> f64 {
        self.left + self.x.share(value).clamp(-0.02, 1.02) * (WIDTH - RIGHT - self.left)
    }

    fn y(&self, value: f64) -> f64 {
        self.height - BOTTOM - self.y.share(value).clamp(-0.02, 1.02) * (self.height - TOP - BOTTOM)
    }

    /// A curve of a class of the page's style sheet.
    pub fn line(&mut self, class: &str, points: impl IntoIterator<Item = (f64, f64)>) {
        let mut path = String::new();
        for (x, y) in points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()) {
            let _ = write!(path, "{}{:.1} {:.1}", if path.is_empty() { "M" } else { "L" }, self.x(x), self.y(y));
        }
        let _ = write!(self.body, r#"<path class="{class}" d="{path}"/>"#);
    }

    /// An area between two curves over the same places.
    pub fn band(&mut self, class: &str, points: &[(f64, f64, f64)]) {
        let mut path = String::new();
        let upper = points.iter().map(|(x, low, _)| (*x, *low));
        for (x, y) in upper.chain(points.iter().rev().map(|(x, _, high)| (*x, *high))) {
            let _ = write!(path, "{}{:.1} {:.1}", if path.is_empty() { "M" } else { "L" }, self.x(x), self.y(y));
        }
        let _ = write!(self.body, r#"<path class="{class}" d="{path}Z"/>"#);
    }

    /// A dot with a text that shows when it is pointed at.
    pub fn dot(&mut self, class: &str, x: f64, y: f64, about: &str) {
        if x.is_finite() && y.is_finite() {
            let (x, y, about) = (self.x(x), self.y(y), escaped(about));
            let title = if about.is_empty() { String::new() } else { format!("<title>{about}</title>") };
            let _ = write!(self.body, r#"<circle class="{class}" cx="{x:.1}" cy="{y:.1}" r="3">{title}</circle>"#);
        }
    }

    /// A bar between two corners.
    pub fn bar(&mut self, class: &str, [x0, x1]: [f64; 2], [y0, y1]: [f64; 2], about: &str) {
        let (x0, x1, y0, y1) = (self.x(x0), self.x(x1), self.y(y0), self.y(y1));
        let (x, y, width, height) = (x0.min(x1), y0.min(y1), (x1 - x0).abs(), (y1 - y0).abs());
        let about = escaped(about);
        let _ = write!(
            self.body,
            r#"<rect class="{class}" x="{x:.1}" y="{y:.1}" width="{width:.1}" height="{height:.1}"><title>{about}</title></rect>"#
        );
    }

    pub fn svg(self) -> String {
        let Chart { height, body, .. } = self;
        format!(r#"<svg class="chart" viewBox="0 0 {WIDTH} {height:.0}" role="img">{body}</svg>"#)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within_the_axis() {
        let ticks = |values: [f64; 2], scale| Axis::around("x", values, scale).unwrap().ticks();
        assert_eq!(ticks([-1.0, 1.1], Scale::Linear), [-1.0, -0.5, 0.0, 0.5, 1.0]);
        assert_eq!(ticks([0.2, 300.0], Scale::Log), [1.0, 10.0, 100.0]);
        assert_eq!(ticks([2.0, 9.0], Scale::Log), [2.0, 5.0, 10.0]);
        assert_eq!(ticks([3.0, 8.0], Scale::Log), [4.0, 6.0, 8.0]);
        assert_eq!(ticks([34.7, 35.6], Scale::Log), [35.0, 40.0]);
        let both = ticks([-2.0, 30.0], Scale::Symmetric(0.01));
        assert!(
            both.contains(&0.0) && both.iter().all(|tick| (-3.0..40.0).contains(tick)) && both.len() < 9,
            "{both:?}"
        );
        assert!(
            Axis::around("x", [f64::NAN], Scale::Linear).is_none() && Axis::around("x", [0.0], Scale::Log).is_none()
        );
    }

    #[test]
    fn text_is_escaped_and_nothing_leaves_the_picture() {
        let axis = |name| Axis::around(name, [0.0, 1.0], Scale::Linear).unwrap();
        let mut chart = Chart::new(axis("a < b"), axis("y"), 200.0);
        chart.line("a", [(0.0, 0.0), (5.0, -7.0), (f64::NAN, 1.0)]);
        let svg = chart.svg();
        assert!(svg.contains("a &lt; b") && !svg.contains("NaN"), "{svg}");
        let numbers =
            svg.split("d=\"M").last().unwrap().split(['L', ' ', '"']).map_while(|word| word.parse::<f64>().ok());
        assert!(numbers.collect::<Vec<_>>().iter().all(|place| (0.0..=WIDTH).contains(place)), "{svg}");
    }
}
