//! The arm in three dimensions: a picture that stands for itself, and the data with which `arm.js` turns and moves it.

use super::figures::PlanFigure;
use serde_json::json;
use std::fmt::Write;

/// Side of the picture, in its own units.
const SIDE: f64 = 440.0;
/// First view: angle about the vertical axis, and above the horizon \[rad\].
const VIEW: [f64; 2] = [-0.9, 0.4];
/// Points of the path that are drawn.
const POINTS: usize = 250;

/// The page's part: a picture with its data; `None` without poses.
pub fn arm(plan: &PlanFigure) -> Option<String> {
    let pose = plan.poses.first()?;
    let thin = |points: &[[f64; 3]]| -> Vec<[f64; 3]> {
        points.iter().step_by(points.len().div_ceil(POINTS).max(1)).copied().collect()
    };
    let path = thin(&plan.end_effector);
    let mut corners: Vec<[f64; 3]> = plan.poses.iter().flatten().chain(&path).copied().collect();
    let (space_box, sphere) = match &plan.workspace {
        Some(space) => {
            corners.extend([space.box_min, space.box_max]);
            (json!([space.box_min, space.box_max]), space.base_radius)
        }
        None => (json!(null), 0.0),
    };
    let end = |of: fn(f64, f64) -> f64, start: f64, axis: usize| corners.iter().map(|at| at[axis]).fold(start, of);
    let low = [0, 1, 2].map(|axis| end(f64::min, f64::MAX, axis));
    let high = [0, 1, 2].map(|axis| end(f64::max, f64::MIN, axis));
    let middle = [0, 1, 2].map(|axis| 0.5 * (low[axis] + high[axis]));
    let radius =
        [0, 1, 2].map(|axis| 0.5 * (high[axis] - low[axis])).iter().map(|half| half * half).sum::<f64>().sqrt();
    let scale = 0.5 * SIDE / radius.max(1e-6);
    let round = |at: &[f64; 3]| at.map(|value| (value * 1e4).round() / 1e4);
    let poses: Vec<Vec<[f64; 3]>> = plan.poses.iter().map(|pose| pose.iter().map(round).collect()).collect();
    let data = json!({
        "side": SIDE, "scale": scale, "middle": middle, "view": VIEW, "poses": poses,
        "path": path.iter().map(round).collect::<Vec<_>>(), "box": space_box, "sphere": sphere,
        "period": plan.t.last().copied().unwrap_or(1.0),
    });
    let line = |points: &[[f64; 3]]| {
        let mut text = String::new();
        for at in points {
            let (x, y) = projected(at, &middle, scale);
            let _ = write!(text, "{}{x:.1} {y:.1}", if text.is_empty() { "M" } else { "L" });
        }
        text
    };
    let edges = plan.workspace.as_ref().map_or(String::new(), |space| {
        let corner =
            |k: usize| [0, 1, 2].map(|axis| if k >> axis & 1 == 0 { space.box_min[axis] } else { space.box_max[axis] });
        let pairs = (0..8).flat_map(|k| [0, 1, 2].map(|axis| (k, k | 1 << axis))).filter(|(a, b)| a != b);
        pairs.map(|(a, b)| line(&[corner(a), corner(b)])).collect()
    });
    let circle = |axes: [usize; 2]| -> String {
        let points: Vec<[f64; 3]> = (0..=48)
            .map(|k| {
                let angle = std::f64::consts::TAU * f64::from(k) / 48.0;
                let mut at = [0.0; 3];
                (at[axes[0]], at[axes[1]]) = (sphere * angle.cos(), sphere * angle.sin());
                at
            })
            .collect();
        line(&points)
    };
    let circles = if sphere > 0.0 { circle([0, 1]) + &circle([0, 2]) + &circle([1, 2]) } else { String::new() };
    let joints: String = pose
        .iter()
        .map(|at| {
            let (x, y) = projected(at, &middle, scale);
            format!(r#"<circle class="joint" cx="{x:.1}" cy="{y:.1}" r="4"/>"#)
        })
        .collect();
    let (path, links) = (line(&path), line(pose));
    // The text of a script ends at `</`, which no number has.
    Some(format!(
        r#"<svg id="arm" class="chart" viewBox="0 0 {SIDE} {SIDE}" role="img"><path class="space" d="{edges}"/><path class="sphere" d="{circles}"/><path class="way" d="{path}"/><path class="links" d="{links}"/>{joints}</svg><script type="application/json" id="arm-data">{data}</script>"#
    ))
}

/// Place of a point in the picture: turned about the vertical axis, seen from above the horizon, without perspective.
fn projected(at: &[f64; 3], middle: &[f64; 3], scale: f64) -> (f64, f64) {
    let [turn, above] = VIEW;
    let [x, y, z] = [0, 1, 2].map(|axis| at[axis] - middle[axis]);
    let right = x * turn.cos() - y * turn.sin();
    let away = x * turn.sin() + y * turn.cos();
    let up = z * above.cos() + away * above.sin();
    (SIDE / 2.0 + scale * right, SIDE / 2.0 - scale * up)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_picture_holds_everything_and_its_data_is_json() {
        let poses = vec![vec![[0.0; 3], [0.0, 0.0, 0.3], [0.5, 0.2, 0.6]]; 3];
        let workspace =
            plumbline_core::Workspace { box_min: [-0.3, -0.8, 0.0], box_max: [0.8, 0.8, 1.1], base_radius: 0.3 };
        let plan = PlanFigure {
            poses,
            t: vec![0.0, 1.0],
            end_effector: vec![[0.5, 0.2, 0.6]; 4],
            workspace: Some(workspace),
            ..PlanFigure::default()
        };
        let page = arm(&plan).unwrap();
        let data = page.split(r#"id="arm-data">"#).nth(1).unwrap().strip_suffix("</script>").unwrap();
        let data: serde_json::Value = serde_json::from_str(data).unwrap();
        assert_eq!((data["poses"].as_array().unwrap().len(), &data["sphere"]), (3, &json!(0.3)));
        let numbers = page
            .split("<script")
            .next()
            .unwrap()
            .split(['M', 'L', ' ', '"'])
            .filter_map(|word| word.parse::<f64>().ok());
        assert!(numbers.collect::<Vec<_>>().iter().all(|place| (0.0..=SIDE).contains(place)), "{page}");
        assert!(arm(&PlanFigure::default()).is_none());
    }
}
