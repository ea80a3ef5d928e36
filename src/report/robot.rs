//! A robot on one page: kinematics, limits, base parameters and a picture.

use crate::setup::friction_structure;
use plumbline_model::{JointKind, Mounting, Placement, Reduction, Robot};
use std::fmt::Write;

/// Tables of a robot as text for the terminal.
pub fn text(robot: &Robot) -> String {
    let mut text = format!("{}: {}\n{}\n", robot.name, robot.full_name, robot.source.trim());
    let _ = writeln!(
        text,
        "\nkinematics (modified DH; a, d in m, angles in degrees)\n  joint  kind            a      alpha          d      theta"
    );
    for (j, joint) in robot.chain.joints().iter().enumerate() {
        let kind = match joint.kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        };
        let _ = writeln!(
            text,
            "  {:>5}  {kind:<9} {:>9.5} {:>10.4} {:>10.5} {:>10.4}",
            j + 1,
            joint.a,
            joint.alpha.to_degrees(),
            joint.d,
            joint.theta.to_degrees()
        );
    }
    if robot.base != Placement::identity() {
        let _ = writeln!(text, "  base frame in the URDF's root: {}", place(&robot.base));
    }
    let _ = writeln!(text, "  flange in frame {}: {}", robot.chain.len(), place(robot.chain.flange()));
    let _ = writeln!(text, "\nlimits\n  joint    q-min    q-max       dq      ddq     jerk      tau     dtau");
    let limits = &robot.limits;
    for j in 0..robot.chain.len() {
        let row = [
            limits.q_min[j],
            limits.q_max[j],
            limits.dq[j],
            limits.ddq[j],
            limits.jerk[j],
            limits.tau[j],
            limits.dtau[j],
        ];
        let _ = writeln!(text, "  {:>5} {}", j + 1, row.map(|value| format!("{:>8}", short(value))).join(" "));
    }
    let _ = writeln!(text, "  rad, rad/s, rad/s2, rad/s3, Nm, Nm/s (m and N for a prismatic joint)");
    for line in unchecked(robot) {
        let _ = writeln!(text, "  {line}");
    }
    let (general, vertical) = counts(robot);
    let _ = writeln!(
        text,
        "\nbase parameters: {general} with friction, valid in any mounting; {vertical} are identified with gravity along axis 1"
    );
    for column in friction_structure(robot, &Mounting::WALL).columns() {
        let expression =
            if column.expression == column.name { String::new() } else { format!(" = {}", column.expression) };
        let _ = writeln!(text, "  {:<9} [{}]{expression}", column.symbol, column.unit);
    }
    text
}

/// What motions of a robot are not checked for, one line each.
pub fn unchecked(robot: &Robot) -> Vec<String> {
    let mut lines = Vec::new();
    if robot.shape.is_empty() {
        lines.push("self-collision is not checked: the robot file has no [[capsule]]".to_string());
    }
    if !robot.has_workspace {
        lines.push("floor and walls are not checked: the robot file has no [workspace]".to_string());
    }
    lines
}

/// Parameters of rigid body and friction in any mounting, and with gravity along axis 1.
fn counts(robot: &Robot) -> (usize, usize) {
    let friction = friction_structure(robot, &Mounting::WALL).columns().len()
        - Reduction::in_mounting(&robot.chain, &Mounting::WALL).len();
    (
        Reduction::any_mounting(&robot.chain).len() + friction,
        Reduction::in_mounting(&robot.chain, &Mounting::UPRIGHT).len() + friction,
    )
}

fn place(placement: &Placement) -> String {
    let [x, y, z] = <[f64; 3]>::from(placement.origin);
    let [roll, pitch, yaw] = crate::store::export::rpy(&placement.rotation).map(|angle| angle.to_degrees() + 0.0);
    format!("xyz {x:.5} {y:.5} {z:.5} m, rpy {roll:.3} {pitch:.3} {yaw:.3} deg")
}

fn short(value: f64) -> String {
    if value.abs() >= 1000.0 {
        format!("{value:.0}")
    } else {
        format!("{value:.4}").trim_end_matches('0').trim_end_matches('.').to_string()
    }
}

/// The page: picture and tables, without scripts and other files.
pub fn html(robot: &Robot) -> String {
    let escaped = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let pose = robot.pose();
    let shown: Vec<String> = pose
        .iter()
        .zip(robot.chain.joints())
        .map(|(q, joint)| match joint.kind {
            JointKind::Revolute => format!("{:.0} deg", q.to_degrees() + 0.0),
            JointKind::Prismatic => format!("{q:.2} m"),
        })
        .collect();
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{0}</title>\n<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:70rem;\
         margin:2rem auto;padding:0 1rem;color:#1b1b1b;background:#fff}}pre{{overflow-x:auto;font-size:13px}}svg{{width:100%;height:auto}}</style>\
         </head>\n<body><h1>{0}</h1>\n<p>At {1}. Frames: z (joint axis) blue, x red. Grid 0.1 m.</p>\n{2}\n<pre>{3}</pre></body></html>\n",
        escaped(&robot.name),
        shown.join(", "),
        drawing(robot, &pose),
        escaped(&text(robot))
    )
}

/// Width of a view \[px\] and the space around it.
const VIEW: f64 = 380.0;
const GAP: f64 = 24.0;
/// Colours of links, base first.
const COLOURS: [&str; 9] =
    ["#8a8f98", "#4c78a8", "#f2a541", "#59a14f", "#e15759", "#76b7b2", "#b07aa1", "#9c755f", "#edc948"];

/// Three views of the arm at a pose as SVG: from -y, from +x and from above.
pub fn drawing(robot: &Robot, q: &[f64]) -> String {
    let mut frames = vec![Placement::identity()];
    for (joint, &q) in robot.chain.joints().iter().zip(q) {
        let last = frames[frames.len() - 1];
        frames.push(last.then(&joint.placement(q)));
    }
    let flange = frames[frames.len() - 1].then(robot.chain.flange());
    let placed = robot.shape.placed(&robot.chain, q);
    let radii: Vec<f64> = robot.shape.capsules().iter().map(|capsule| capsule.radius).collect();
    // The same scale and centre in all views.
    let mut low = frames[0].origin;
    let mut high = low;
    let mut reach = |at: &nalgebra::Vector3<f64>, r: f64| {
        low = low.inf(&at.add_scalar(-r));
        high = high.sup(&at.add_scalar(r));
    };
    frames.iter().chain([&flange]).for_each(|frame| reach(&frame.origin, 0.05));
    placed.iter().zip(&radii).for_each(|(ends, radius)| ends.iter().for_each(|end| reach(end, *radius)));
    let (middle, size) = (0.5 * (low + high), (high - low).max().max(0.1) * 1.05);
    let scale = VIEW / size;

    let width = 3.0 * VIEW + 4.0 * GAP;
    let height = VIEW + 2.0 * GAP;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" font-size=\"13\">\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    // Right, up and towards the reader, each an axis of the base frame and its sign.
    let views = [
        ("x", (0, 1.0), "z", (2, 1.0), (1, -1.0)),
        ("y", (1, 1.0), "z", (2, 1.0), (0, 1.0)),
        ("x", (0, 1.0), "y", (1, 1.0), (2, 1.0)),
    ];
    for (k, (right, (r, _), up, (u, _), (depth, sign))) in views.into_iter().enumerate() {
        let left = GAP + k as f64 * (VIEW + GAP);
        let x = |at: &nalgebra::Vector3<f64>| left + 0.5 * VIEW + (at[r] - middle[r]) * scale;
        let y = |at: &nalgebra::Vector3<f64>| GAP + 0.5 * VIEW - (at[u] - middle[u]) * scale;
        let _ = writeln!(svg, "<g stroke=\"#e6e8eb\" stroke-width=\"1\">");
        let lines = |axis: usize| {
            let (from, to) = (
                ((middle[axis] - 0.5 * size) * 10.0).ceil() as i32,
                ((middle[axis] + 0.5 * size) * 10.0).floor() as i32,
            );
            from..=to
        };
        for line in lines(r) {
            let at = left + 0.5 * VIEW + (f64::from(line) * 0.1 - middle[r]) * scale;
            let _ = writeln!(svg, "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"{GAP}\" y2=\"{:.1}\"/>", GAP + VIEW);
        }
        for line in lines(u) {
            let at = GAP + 0.5 * VIEW - (f64::from(line) * 0.1 - middle[u]) * scale;
            let _ = writeln!(svg, "<line x1=\"{left:.1}\" x2=\"{:.1}\" y1=\"{at:.1}\" y2=\"{at:.1}\"/>", left + VIEW);
        }
        svg.push_str("</g>\n");
        // The farthest volumes first.
        let mut order: Vec<usize> = (0..placed.len()).collect();
        let near = |i: usize| sign * (placed[i][0][depth] + placed[i][1][depth]);
        order.sort_by(|a, b| near(*a).total_cmp(&near(*b)));
        for i in order {
            let colour = COLOURS[robot.shape.capsules()[i].link % COLOURS.len()];
            stroke(
                &mut svg,
                [x(&placed[i][0]), y(&placed[i][0])],
                [x(&placed[i][1]), y(&placed[i][1])],
                (colour, 2.0 * radii[i] * scale, 0.55),
            );
        }
        let origins: Vec<_> = frames.iter().chain([&flange]).map(|frame| frame.origin).collect();
        for pair in origins.windows(2) {
            stroke(&mut svg, [x(&pair[0]), y(&pair[0])], [x(&pair[1]), y(&pair[1])], ("#1b1b1b", 2.5, 1.0));
        }
        for frame in frames.iter().chain([&flange]) {
            for (axis, colour) in [(0, "#d62728"), (2, "#1f4fd6")] {
                let tip = frame.origin + frame.rotation.column(axis) * (0.06 * size);
                stroke(&mut svg, [x(&frame.origin), y(&frame.origin)], [x(&tip), y(&tip)], (colour, 2.0, 1.0));
            }
        }
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\">{right} &#8594;</text><text x=\"{:.1}\" y=\"{:.1}\">{up} &#8593;</text>",
            left + VIEW - 28.0,
            GAP + VIEW + 16.0,
            left,
            GAP - 8.0
        );
    }
    svg.push_str("</svg>");
    svg
}

fn stroke(svg: &mut String, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], (colour, width, opacity): (&str, f64, f64)) {
    // A line without length draws nothing in some viewers.
    let x2 = if (x2 - x1).hypot(y2 - y1) < 0.01 { x2 + 0.01 } else { x2 };
    let _ = writeln!(
        svg,
        "<line x1=\"{x1:.2}\" y1=\"{y1:.2}\" x2=\"{x2:.2}\" y2=\"{y2:.2}\" stroke=\"{colour}\" stroke-width=\"{width:.2}\" stroke-opacity=\"{opacity}\" \
         stroke-linecap=\"round\"/>"
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_robot_has_a_page() {
        for name in Robot::names() {
            let robot = Robot::load(name, None).unwrap();
            let page = html(&robot);
            assert!(!page.contains("NaN") && !page.contains("inf"), "{name}");
            let capsules = robot.shape.capsules().len();
            assert!(page.matches("stroke-opacity=\"0.55\"").count() == 3 * capsules, "{name}");
            let pose = robot.pose();
            let turns = robot.limits.q_min.iter().zip(&robot.limits.q_max);
            assert!(pose.iter().zip(turns).all(|(q, (low, high))| (low..=high).contains(&q)), "{name}: {pose:?}");
        }
        let panda = text(&Robot::load("panda", None).unwrap());
        assert!(panda.contains("base parameters: 59 with friction, valid in any mounting; 57 are"), "{panda}");
        assert!(panda.contains("= Lxx2 - Lyy2 + Lyy3 + 0.632 lz3"), "{panda}");
    }
}
