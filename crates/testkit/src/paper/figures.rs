//! The figures of docs/results/paper.md as SVG.

use super::experiment::{self, Figure, Validation};
use plotters::prelude::*;
use plumbline_identify::Settings;

const SIZE: (u32, u32) = (900, 520);
const TRUE: RGBColor = RGBColor(120, 120, 120);
const HORIZONTAL: RGBColor = RGBColor(31, 119, 180);
const VERTICAL: RGBColor = RGBColor(214, 39, 40);
const PATH: RGBColor = RGBColor(31, 119, 180);
const LIMIT: RGBColor = RGBColor(214, 39, 40);

type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

pub fn all() -> Vec<(&'static str, String)> {
    let two = experiment::two_dof();
    let mut all = vec![("paper-fig6-workspace.svg", svg((1000, 322), fig_6))];
    for (name, figure) in ["paper-fig3-vertical.svg", "paper-fig4-horizontal.svg"].into_iter().zip(&two.figures) {
        all.push((name, svg(SIZE, |area| torques(area, figure))));
    }
    let panda = experiment::panda(&Settings::paper());
    for (name, run) in ["paper-fig7-wall.svg", "paper-fig8-upright.svg"].into_iter().zip(&panda.shown) {
        all.push((name, svg((900, 1190), |area| validation(area, run))));
    }
    all
}

fn svg(size: (u32, u32), draw: impl FnOnce(DrawingArea<SVGBackend, plotters::coord::Shift>) -> Drawn) -> String {
    let mut text = String::new();
    draw(SVGBackend::with_string(&mut text, size).into_drawing_area()).expect("finite data");
    text
}

/// Figs. 3 and 4: one panel per joint, the true torque behind those of both models.
fn torques(area: DrawingArea<SVGBackend, plotters::coord::Shift>, figure: &Figure) -> Drawn {
    area.fill(&WHITE)?;
    for (j, panel) in area.split_evenly((2, 1)).iter().enumerate() {
        let columns = figure.tau.each_ref().map(|tau| tau.column(j).iter().copied().collect::<Vec<f64>>());
        let most = columns.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs())) * 1.15;
        let caption = format!(
            "{} robot, joint {}: RMS error of the H-BAM model {:.1} Nm, of the V-BAM model {:.1} Nm",
            figure.mounting,
            j + 1,
            figure.rms[0][j],
            figure.rms[1][j]
        );
        let mut chart = ChartBuilder::on(panel)
            .caption(caption, ("sans-serif", 16))
            .margin(8)
            .x_label_area_size(if j == 1 { 32 } else { 16 })
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..*figure.t.last().expect("samples"), -most..most)?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(WHITE).y_desc("torque [Nm]").y_labels(5);
        if j == 1 {
            mesh.x_desc("t [s]");
        }
        mesh.draw()?;
        let lines = [("simulated", TRUE, 5), ("H-BAM model", HORIZONTAL, 2), ("V-BAM model", VERTICAL, 1)];
        for ((name, colour, width), values) in lines.into_iter().zip(&columns) {
            let points = figure.t.iter().copied().zip(values.iter().copied()).step_by(10);
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(width)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(width)));
        }
        if j == 0 {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::LowerRight)
                .border_style(TRUE)
                .background_style(WHITE.mix(0.9))
                .draw()?;
        }
    }
    area.present()
}

/// Samples between two points of a drawn curve of Figs. 7 and 8.
const STEP: usize = 20;

/// Figs. 7 and 8: one panel per joint, the measured torque behind the estimated one.
fn validation(area: DrawingArea<SVGBackend, plotters::coord::Shift>, run: &Validation) -> Drawn {
    area.fill(&WHITE)?;
    let joints = run.rms.len();
    for (j, panel) in area.split_evenly((joints, 1)).iter().enumerate() {
        let columns = [&run.measured, &run.estimated].map(|tau| tau.column(j).iter().copied().collect::<Vec<f64>>());
        let (low, high) = columns.iter().flatten().fold((f64::MAX, f64::MIN), |(l, h), &x| (l.min(x), h.max(x)));
        let room = 0.1 * (high - low);
        let last = j + 1 == joints;
        let mut chart = ChartBuilder::on(panel)
            .caption(format!("{} robot, joint {}: RMS {:.2} Nm", run.mounting, j + 1, run.rms[j]), ("sans-serif", 15))
            .margin(6)
            .x_label_area_size(if last { 32 } else { 16 })
            .y_label_area_size(56)
            .build_cartesian_2d(0.0..*run.t.last().expect("samples"), low - room..high + room)?;
        let mut mesh = chart.configure_mesh();
        mesh.light_line_style(WHITE).y_desc("torque [Nm]").y_labels(4);
        if last {
            mesh.x_desc("t [s]");
        }
        mesh.draw()?;
        for ((name, colour, width), values) in
            [("measured", TRUE, 2), ("estimated", HORIZONTAL, 2)].into_iter().zip(&columns)
        {
            let points = run.t.iter().copied().zip(values.iter().copied()).step_by(STEP);
            chart
                .draw_series(LineSeries::new(points, colour.stroke_width(width)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], colour.stroke_width(width)));
        }
        if j == 0 {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::LowerRight)
                .border_style(TRUE)
                .background_style(WHITE.mix(0.9))
                .draw()?;
        }
    }
    area.present()
}

/// Fig. 6: the end effector's way from three sides, with the box and the sphere of eq. 14.
fn fig_6(area: DrawingArea<SVGBackend, plotters::coord::Shift>) -> Drawn {
    let (path, space) = experiment::workspace();
    area.fill(&WHITE)?;
    for (panel, (i, j)) in area.split_evenly((1, 3)).iter().zip([(0, 1), (0, 2), (1, 2)]) {
        let names = ["x [m]", "y [m]", "z [m]"];
        let mut chart = ChartBuilder::on(panel)
            .margin(8)
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d(-1.1..1.1, if j == 2 { -0.6..1.6 } else { -1.1..1.1 })?;
        chart
            .configure_mesh()
            .light_line_style(WHITE)
            .x_desc(names[i])
            .y_desc(names[j])
            .x_labels(6)
            .y_labels(6)
            .draw()?;
        let corners = [(space.box_min[i], space.box_min[j]), (space.box_max[i], space.box_max[j])];
        chart.draw_series([Rectangle::new(corners, LIMIT.stroke_width(2))])?;
        let circle = (0..=90).map(|k| {
            let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 90.0).sin_cos();
            (space.base_radius * cos, space.base_radius * sin)
        });
        chart.draw_series(LineSeries::new(circle, LIMIT.stroke_width(1)))?;
        chart.draw_series(LineSeries::new(path.iter().map(|at| (at[i], at[j])), PATH.stroke_width(2)))?;
    }
    area.present()
}
