//! Capsules around triangles: the volumes of links for self-collision, from the meshes of a robot description.

use nalgebra::{Matrix3, Vector3};
use plumbline_core::symmetric_eigen;
use std::f64::consts::PI;

type V3 = Vector3<f64>;
type Triangle = [V3; 3];

/// A part is divided where that takes this share of its volume away.
const MIN_GAIN: f64 = 0.25;
/// Places along an axis where a part may be divided, as shares of its extent.
const CUTS: [f64; 5] = [0.2, 0.35, 0.5, 0.65, 0.8];
/// Rounds in which the axis of a capsule is turned, by half the angle each.
const TURNS: i32 = 6;
/// Angle of the first of them \[rad\].
const FIRST_TURN: f64 = 0.2;
/// Added to radii, against rounding \[m\].
const ROUNDING: f64 = 1e-9;

/// A segment with a radius.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Enclosing {
    /// Ends of the segment \[m\].
    pub ends: [Vector3<f64>; 2],
    /// Radius \[m\].
    pub radius: f64,
}

impl Enclosing {
    /// Volume \[m3\].
    pub fn volume(&self) -> f64 {
        let [a, b] = self.ends;
        PI * self.radius * self.radius * ((b - a).norm() + 4.0 / 3.0 * self.radius)
    }
}

/// At most `most` capsules that hold every point of the triangles; a triangle may be a point or a line.
///
/// One capsule has the smallest circle around the points' projection along its axis. The part whose division by a plane saves most volume is
/// divided, as long as that is a quarter of it. Empty without triangles.
pub fn enclosing(triangles: &[Triangle], most: usize) -> Vec<Enclosing> {
    if triangles.is_empty() {
        return Vec::new();
    }
    let mut parts = vec![(fit(triangles), triangles.to_vec())];
    while parts.len() < most {
        let divided = parts.iter().enumerate().filter_map(|(k, (whole, part))| {
            let [one, other] = divided(part)?;
            let fitted = [fit(&one), fit(&other)];
            let gain = whole.volume() - fitted[0].volume() - fitted[1].volume();
            (gain > MIN_GAIN * whole.volume()).then_some((k, gain, [(fitted[0], one), (fitted[1], other)]))
        });
        let Some((k, _, [one, other])) = divided.max_by(|a, b| a.1.total_cmp(&b.1)) else { break };
        parts[k] = one;
        parts.push(other);
    }
    parts.into_iter().map(|(capsule, _)| capsule).collect()
}

/// The capsule of the smallest volume that a search over axes finds.
fn fit(triangles: &[Triangle]) -> Enclosing {
    let points: Vec<V3> = triangles.iter().flatten().copied().collect();
    let principal = principal(&points);
    let axes = principal.column_iter().map(|axis| axis.into_owned()).chain([V3::x(), V3::y(), V3::z()]);
    let fitted = axes.map(|axis| (along(&points, &axis), axis));
    let Some((mut best, mut axis)) = fitted.min_by(|a, b| a.0.volume().total_cmp(&b.0.volume())) else {
        return Enclosing { ends: [V3::zeros(); 2], radius: 0.0 };
    };
    for turn in 0..TURNS {
        let angle = FIRST_TURN * 0.5f64.powi(turn);
        let [u, v] = across(&axis);
        for side in [u, -u, v, -v] {
            let turned = (axis + angle * side).normalize();
            let other = along(&points, &turned);
            if other.volume() < best.volume() {
                (best, axis) = (other, turned);
            }
        }
    }
    best
}

/// The capsule along an axis, a unit vector.
fn along(points: &[V3], axis: &V3) -> Enclosing {
    let [u, v] = across(axis);
    let flat: Vec<[f64; 2]> = points.iter().map(|point| [point.dot(&u), point.dot(&v)]).collect();
    let centre = centre(&hull(flat));
    let through = centre[0] * u + centre[1] * v;
    let aside = |point: &V3| (point - point.dot(axis) * axis - through).norm();
    let radius = points.iter().map(aside).fold(0.0, f64::max) + ROUNDING;
    // A point at `t` along the axis is inside where the segment comes within `room` of `t`.
    let (mut first, mut last) = (f64::INFINITY, f64::NEG_INFINITY);
    for point in points {
        let (t, room) = (point.dot(axis), (radius * radius - aside(point).powi(2)).max(0.0).sqrt());
        (first, last) = (first.min(t + room), last.max(t - room));
    }
    let (from, to) = if first > last { (0.5 * (first + last), 0.5 * (first + last)) } else { (first, last) };
    Enclosing { ends: [through + from * axis, through + to * axis], radius }
}

/// The division by a plane across a principal axis, or an axis of the frame, after which rough volumes of the parts are smallest.
fn divided(triangles: &[Triangle]) -> Option<[Vec<Triangle>; 2]> {
    let points: Vec<V3> = triangles.iter().flatten().copied().collect();
    let principal = principal(&points);
    let axes = principal.column_iter().map(|axis| axis.into_owned()).chain([V3::x(), V3::y(), V3::z()]);
    let mut best: Option<(f64, [Vec<Triangle>; 2])> = None;
    for axis in axes {
        let reach = points.iter().map(|point| point.dot(&axis));
        let (low, high) = reach.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
        for cut in CUTS {
            let halves = cut_at(triangles, &axis, low + cut * (high - low));
            if halves.iter().all(|half| !half.is_empty()) {
                let size = halves.iter().map(|half| rough(half)).sum();
                if best.as_ref().is_none_or(|(least, _)| size < *least) {
                    best = Some((size, halves));
                }
            }
        }
    }
    best.map(|(_, halves)| halves)
}

/// Volume of a capsule around the smaller of two boxes: along the frame's axes and along the principal ones.
fn rough(triangles: &[Triangle]) -> f64 {
    let points: Vec<V3> = triangles.iter().flatten().copied().collect();
    let around = |axes: &Matrix3<f64>| {
        let mut sides = [0.0; 3];
        for (side, axis) in sides.iter_mut().zip(axes.column_iter()) {
            let reach = points.iter().map(|point| point.dot(&axis));
            let (low, high) =
                reach.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
            *side = high - low;
        }
        sides.sort_by(f64::total_cmp);
        let radius = 0.5 * sides[0].hypot(sides[1]);
        PI * radius * radius * ((sides[2] - 2.0 * radius).max(0.0) + 4.0 / 3.0 * radius)
    };
    around(&Matrix3::identity()).min(around(&principal(&points)))
}

/// Triangles below and above the plane at `at` along `axis`; those that it crosses are divided.
fn cut_at(triangles: &[Triangle], axis: &V3, at: f64) -> [Vec<Triangle>; 2] {
    let mut halves = [Vec::new(), Vec::new()];
    for triangle in triangles {
        let heights = triangle.map(|point| point.dot(axis) - at);
        for (half, side) in halves.iter_mut().zip([-1.0, 1.0]) {
            let mut polygon: Vec<V3> = Vec::with_capacity(4);
            for k in 0..3 {
                let (here, next) = (side * heights[k], side * heights[(k + 1) % 3]);
                if here >= 0.0 {
                    polygon.push(triangle[k]);
                }
                if (here > 0.0) != (next > 0.0) && here != next {
                    polygon.push(triangle[k] + (triangle[(k + 1) % 3] - triangle[k]) * (here / (here - next)));
                }
            }
            half.extend((1..polygon.len().saturating_sub(1)).map(|k| [polygon[0], polygon[k], polygon[k + 1]]));
        }
    }
    halves
}

/// Principal axes of a cloud of points as columns.
fn principal(points: &[V3]) -> Matrix3<f64> {
    let mean = points.iter().sum::<V3>() / points.len().max(1) as f64;
    let scatter: Matrix3<f64> = points.iter().map(|point| (point - mean) * (point - mean).transpose()).sum();
    symmetric_eigen(scatter).map_or_else(Matrix3::identity, |eigen| eigen.eigenvectors)
}

/// Two unit vectors across a unit vector, and across each other.
fn across(axis: &V3) -> [V3; 2] {
    let other = if axis.x.abs() < 0.6 { V3::x() } else { V3::y() };
    let u = axis.cross(&other).normalize();
    [u, axis.cross(&u)]
}

/// Corners of the convex hull in order (Andrew's monotone chain).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    if points.len() < 3 {
        return points;
    }
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let mut corners: Vec<[f64; 2]> = Vec::new();
    let mut chain = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let begin = corners.len();
        for point in points {
            while corners.len() >= begin + 2
                && turn(corners[corners.len() - 2], corners[corners.len() - 1], point) <= 0.0
            {
                corners.pop();
            }
            corners.push(point);
        }
        corners.pop();
    };
    chain(&mut points.iter().copied());
    chain(&mut points.iter().rev().copied());
    corners
}

/// Centre of the smallest circle around points (Welzl's algorithm in its iterative form).
fn centre(points: &[[f64; 2]]) -> [f64; 2] {
    let apart = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let outside = |point: [f64; 2], (centre, radius): ([f64; 2], f64)| apart(point, centre) > radius * (1.0 + 1e-12);
    let Some(&first) = points.first() else { return [0.0; 2] };
    let mut circle = (first, 0.0);
    for i in 1..points.len() {
        if !outside(points[i], circle) {
            continue;
        }
        circle = (points[i], 0.0);
        for j in 0..i {
            if !outside(points[j], circle) {
                continue;
            }
            circle = on_two(points[i], points[j]);
            for k in 0..j {
                if outside(points[k], circle) {
                    circle = on_three(points[i], points[j], points[k]).unwrap_or(circle);
                }
            }
        }
    }
    circle.0
}

fn on_two(a: [f64; 2], b: [f64; 2]) -> ([f64; 2], f64) {
    ([0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])], 0.5 * (a[0] - b[0]).hypot(a[1] - b[1]))
}

/// `None` for points on a line.
fn on_three(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Option<([f64; 2], f64)> {
    let ([bx, by], [cx, cy]) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
    let twice = 2.0 * (bx * cy - by * cx);
    if twice.abs() < 1e-18 {
        return None;
    }
    let (bb, cc) = (bx * bx + by * by, cx * cx + cy * cy);
    let (x, y) = ((cy * bb - by * cc) / twice, (bx * cc - cx * bb) / twice);
    Some(([a[0] + x, a[1] + y], x.hypot(y)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Triangles of a box.
    fn block(centre: V3, size: V3) -> Vec<Triangle> {
        let corner = |k: usize| {
            let sign = |bit: usize| if k >> bit & 1 == 1 { 0.5 } else { -0.5 };
            centre + V3::new(sign(0) * size.x, sign(1) * size.y, sign(2) * size.z)
        };
        let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        faces.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).map(|face| face.map(corner)).collect()
    }

    fn inside(capsules: &[Enclosing], point: &V3) -> bool {
        capsules.iter().any(|capsule| {
            let found = crate::nearest(&capsule.ends, &[*point; 2]);
            found.between.norm() <= capsule.radius + 1e-9
        })
    }

    #[test]
    fn every_point_of_random_triangles_is_inside() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for case in 0..60 {
            let scale = [1.0, 0.01, 3.0][case % 3];
            let mut point = || {
                V3::new(rng.random_range(-0.3..0.3), rng.random_range(-0.1..0.1), scale * rng.random_range(-0.2..0.2))
            };
            let triangles: Vec<Triangle> = (0..30).map(|_| [point(), point(), point()]).collect();
            let capsules = enclosing(&triangles, 1 + case % 3);
            assert!((1..=1 + case % 3).contains(&capsules.len()));
            for [a, b, c] in &triangles {
                for (u, v) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.3, 0.3), (0.5, 0.5), (0.1, 0.7)] {
                    assert!(inside(&capsules, &(a + u * (b - a) + v * (c - a))), "case {case}");
                }
            }
        }
    }

    #[test]
    fn a_bar_and_a_ball_are_found_again() {
        let bar = enclosing(&block(V3::new(0.1, 0.2, 0.3), V3::new(0.06, 0.5, 0.08)), 1)[0];
        assert!((bar.radius - 0.05).abs() < 1e-6, "{bar:?}");
        assert!(bar.ends.iter().all(|end| (end.x - 0.1).abs() < 1e-6 && (end.z - 0.3).abs() < 1e-6), "{bar:?}");
        assert!((bar.ends[1].y - bar.ends[0].y).abs() > 0.49, "{bar:?}");
        let ball: Vec<Triangle> = (0..400)
            .map(|k| {
                let (height, turn) = (1.0 - 2.0 * (f64::from(k) + 0.5) / 400.0, 2.4 * f64::from(k));
                let ring = (1.0 - height * height).sqrt();
                [0.2 * V3::new(ring * turn.cos(), ring * turn.sin(), height) + V3::x(); 3]
            })
            .collect();
        let ball = enclosing(&ball, 3);
        assert!(ball.len() == 1 && (ball[0].radius - 0.2).abs() < 2e-3, "{ball:?}");
    }

    /// An elbow is a bar and a bar, not the ball around it.
    #[test]
    fn an_elbow_is_divided() {
        let mut elbow = block(V3::new(0.0, 0.0, 0.25), V3::new(0.1, 0.1, 0.5));
        elbow.extend(block(V3::new(0.2, 0.0, 0.45), V3::new(0.4, 0.1, 0.1)));
        let (one, two) = (enclosing(&elbow, 1), enclosing(&elbow, 2));
        let volume = |capsules: &[Enclosing]| capsules.iter().map(Enclosing::volume).sum::<f64>();
        assert!(two.len() == 2 && volume(&two) < 0.4 * volume(&one), "{} {}", volume(&one), volume(&two));
        assert!(enclosing(&[], 3).is_empty());
    }
}
