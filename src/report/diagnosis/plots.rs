//! Plots of a diagnosis over time, a variable, or frequency. Those with one row per joint or candidate are in `rows`.

use crate::report::figures::thin;
use crate::report::plot::{AFTER, Area, BAND, BEFORE, Drawn, EDGE, GRID, LIMIT, TEXT, span, svg, tick, time_span};
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use plumbline_diagnose::figures::{EffectFigure, MapFigure, PeriodFigure, SpectrumFigure};

type Framed<'a, 'd, X, Y> = ChartContext<
    'a,
    SVGBackend<'d>,
    Cartesian2d<<X as AsRangedCoord>::CoordDescType, <Y as AsRangedCoord>::CoordDescType>,
>;

/// Chart, axes and grid as all plots have them.
fn framed<'a, 'd, X, Y>(
    area: &'a Area<'d>,
    x: X,
    y: Y,
    names: [&str; 2],
    ticks: [usize; 2],
) -> Result<Framed<'a, 'd, X, Y>, DrawingAreaErrorKind<std::io::Error>>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    let mut chart = ChartBuilder::on(area)
        .margin(6)
        .margin_right(16)
        .set_label_area_size(LabelAreaPosition::Left, 86)
        .set_label_area_size(LabelAreaPosition::Bottom, if names[0].is_empty() { 28 } else { 50 })
        .build_cartesian_2d(x, y)?;
    let mut mesh = chart.configure_mesh();
    mesh.light_line_style(TRANSPARENT).bold_line_style(GRID.stroke_width(1)).axis_style(GRID.stroke_width(1));
    mesh.axis_desc_style(TEXT).label_style(TEXT).x_labels(ticks[0]).y_labels(ticks[1]);
    mesh.x_label_formatter(&tick).y_label_formatter(&number).x_desc(names[0]).y_desc(names[1]).draw()?;
    Ok(chart)
}

/// Axis numbers that may be tiny; what rounding leaves of zero is zero.
fn number(value: &f64) -> String {
    match value.abs() {
        size if size < 1e-14 => "0".into(),
        size if size < 1e-3 => format!("{value:.0e}"),
        _ => tick(value),
    }
}

fn finite(points: impl IntoIterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    points.into_iter().filter(|(x, y)| x.is_finite() && y.is_finite()).collect()
}

fn thinned(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let (x, y): (Vec<f64>, Vec<f64>) = points.into_iter().unzip();
    thin(&x, &y)
}

/// Mean period of a residual without and with the effects, before the band that noise leaves.
pub(super) fn period(figure: &PeriodFigure) -> String {
    let t = time_span(&figure.t);
    let twice = |k: usize| 2.0 * figure.deviation.get(k).or(figure.deviation.first()).copied().unwrap_or(0.0);
    let upper = finite(thin(&figure.t, &(0..figure.t.len()).map(twice).collect::<Vec<_>>()));
    let lower: Vec<(f64, f64)> = upper.iter().map(|(t, y)| (*t, -y)).collect();
    let curves = [(&figure.before, BEFORE, 2), (&figure.after, AFTER, 2)];
    let curves = curves.map(|(y, colour, width)| (finite(thin(&figure.t, y)), colour, width));
    if curves.iter().all(|(points, ..)| points.is_empty()) {
        return String::new();
    }
    let all = curves.iter().flat_map(|(points, ..)| points).chain(&upper).chain(&lower);
    let (low, high) = span(&all.map(|(_, y)| *y).collect::<Vec<_>>());
    svg((820, 300), |area| {
        let mut chart = framed(&area, t.0..t.1, low..high, ["t / s", "mean residual / Nm"], [8, 6])?;
        let band = upper.iter().chain(lower.iter().rev()).copied().collect::<Vec<_>>();
        if !figure.deviation.is_empty() {
            chart.draw_series([Polygon::new(band, BAND.filled())])?;
        }
        for (points, colour, width) in curves {
            chart.draw_series(LineSeries::new(points, colour.stroke_width(width)))?;
        }
        // Over the curves, which hide the band.
        if !figure.deviation.is_empty() {
            for edge in [upper, lower] {
                chart.draw_series(LineSeries::new(edge, EDGE.stroke_width(2)))?;
            }
        }
        area.present()
    })
}

/// A residual against the variable of an effect: bins with twice their deviation, and the fitted curve.
pub(super) fn effect(figure: &EffectFigure) -> String {
    let bins: Vec<(f64, f64, f64)> = figure
        .x
        .iter()
        .zip(&figure.mean)
        .enumerate()
        .map(|(k, (x, mean))| (*x, *mean, figure.deviation.get(k).filter(|s| s.is_finite()).map_or(0.0, |s| 2.0 * s)))
        .filter(|(x, mean, _)| x.is_finite() && mean.is_finite())
        .collect();
    let fitted = thinned(finite(figure.fitted.iter().copied()));
    let edge = |sign: f64| {
        let points = figure.fitted.iter().zip(&figure.fitted_deviation);
        thinned(finite(points.map(|((x, torque), deviation)| (*x, torque + sign * 2.0 * deviation))))
    };
    let (above, below) = (edge(1.0), edge(-1.0));
    if bins.is_empty() && fitted.is_empty() {
        return String::new();
    }
    let x: Vec<f64> = bins.iter().map(|bin| bin.0).chain(fitted.iter().map(|point| point.0)).collect();
    let y = bins.iter().flat_map(|(_, mean, twice)| [mean - twice, mean + twice]);
    let y = y.chain([&fitted, &above, &below].into_iter().flatten().map(|point| point.1));
    let ((left, right), (low, high)) = (span(&x), span(&y.collect::<Vec<_>>()));
    svg((820, 320), |area| {
        let mut chart = framed(&area, left..right, low..high, [&figure.variable, "residual / Nm"], [8, 6])?;
        let bars = bins
            .iter()
            .map(|&(x, mean, twice)| PathElement::new([(x, mean - twice), (x, mean + twice)], EDGE.stroke_width(2)));
        let band: Vec<(f64, f64)> = above.iter().chain(below.iter().rev()).copied().collect();
        chart.draw_series((band.len() > 2).then(|| Polygon::new(band, BAND.filled())))?;
        chart.draw_series(bars)?;
        chart.draw_series(bins.iter().map(|&(x, mean, _)| Circle::new((x, mean), 4, BEFORE.filled())))?;
        chart.draw_series(LineSeries::new(fitted, AFTER.stroke_width(2)))?;
        area.present()
    })
}

/// Power density of a residual and of its noise above, the first over the second below: one where nothing but noise is left.
pub(super) fn spectrum(figure: &SpectrumFigure) -> String {
    // A logarithm wants positive numbers.
    let drawn = |y: &[f64]| {
        let points = figure.f.iter().copied().zip(y.iter().copied());
        thinned(finite(points.filter(|(_, y)| *y > 0.0)))
    };
    let over = |y: &[f64]| drawn(&y.iter().zip(&figure.noise).map(|(y, noise)| y / noise).collect::<Vec<_>>());
    let density = [(drawn(&figure.before), BEFORE), (drawn(&figure.after), AFTER), (drawn(&figure.noise), LIMIT)];
    let whitened = [(over(&figure.before), BEFORE), (over(&figure.after), AFTER)];
    let f = time_span(&figure.f);
    let one = [(vec![(f.0, 1.0), (f.1, 1.0)], LIMIT)];
    if density.iter().all(|(points, _)| points.is_empty()) {
        return String::new();
    }
    let panel = |area: &Area, curves: &[&(Vec<(f64, f64)>, RGBColor)], names: [&str; 2]| -> Drawn {
        let all = curves.iter().flat_map(|(points, _)| points).map(|(_, y)| *y);
        let (low, high) = all.fold((f64::MAX, f64::MIN), |(low, high), y| (low.min(y), high.max(y)));
        let y = (low / 1.6..high * 1.6).log_scale();
        let mut chart = framed(area, f.0..f.1, y, names, [8, 5])?;
        for (points, colour) in curves {
            chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
        }
        Ok(())
    };
    svg((820, 430), |area| {
        if whitened.iter().all(|(points, _)| points.is_empty()) {
            panel(&area, &density.iter().collect::<Vec<_>>(), ["f / Hz", "Nm^2/Hz"])?;
            return area.present();
        }
        let (above, below) = area.split_vertically(220);
        panel(&above, &density.iter().collect::<Vec<_>>(), ["", "Nm^2/Hz"])?;
        panel(&below, &whitened.iter().chain(&one).collect::<Vec<_>>(), ["f / Hz", "over noise"])?;
        area.present()
    })
}

/// Largest size of a map's cells \[Nm\]; zero where it has none.
pub(super) fn most(figure: &MapFigure) -> f64 {
    figure.mean.iter().flatten().filter(|mean| mean.is_finite()).fold(0.0, |most, mean| most.max(mean.abs()))
}

/// A residual over two variables: the larger, the stronger the colour, which tells the sign.
pub(super) fn map(figure: &MapFigure) -> String {
    let most = most(figure);
    let ordered = |edges: &[f64]| edges.len() > 1 && edges.windows(2).all(|pair| pair[0] < pair[1]);
    if !(most > 0.0 && ordered(&figure.x) && ordered(&figure.y)) {
        return String::new();
    }
    let ends = |edges: &[f64]| edges[0]..edges[edges.len() - 1];
    svg((820, 480), |area| {
        let mut chart = framed(&area, ends(&figure.x), ends(&figure.y), [&figure.x_name, &figure.y_name], [8, 7])?;
        let rows = figure.y.windows(2).zip(&figure.mean);
        let cells = rows.flat_map(|(y, row)| figure.x.windows(2).zip(row).map(move |(x, mean)| (x, y, *mean)));
        let drawn = cells.filter(|(.., mean)| mean.is_finite()).map(|(x, y, mean)| {
            let colour = if mean > 0.0 { BEFORE } else { AFTER };
            Rectangle::new([(x[0], y[0]), (x[1], y[1])], colour.mix((mean / most).abs()).filled())
        });
        chart.draw_series(drawn)?;
        area.present()
    })
}
