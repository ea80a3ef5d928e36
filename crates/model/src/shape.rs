//! Volumes of an arm's links as capsules, and the distances between them.

use crate::chain::{Chain, Placement};
use nalgebra::Vector3;
use plumbline_core::MAX_JOINTS;
use serde::{Deserialize, Serialize};

type V3 = Vector3<f64>;

/// A segment with a radius, fixed to a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Capsule {
    /// Link that it is fixed to, from 1; 0 is the base.
    pub link: usize,
    /// One end of the segment in the link's frame \[m\].
    pub from: [f64; 3],
    /// The other end; the same point makes a sphere \[m\].
    pub to: [f64; 3],
    /// Radius \[m\].
    pub radius: f64,
}

/// Capsules of an arm, and the pairs whose distance is checked.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shape {
    capsules: Vec<Capsule>,
    pairs: Vec<(usize, usize)>,
}

/// First link that the box of the workspace applies to, where it applies to links. The base and the two links of the shoulder are at
/// the mounting place and reach no farther than the beginning of link 3.
pub const FIRST_BOXED: usize = 3;

impl Shape {
    /// Capsules of any number of links. Neighbouring links and the pairs of `exempt` (link numbers in either order) are not checked.
    pub fn new(capsules: Vec<Capsule>, exempt: &[[usize; 2]]) -> Shape {
        let mut pairs = Vec::new();
        for (i, one) in capsules.iter().enumerate() {
            for (j, other) in capsules.iter().enumerate().skip(i + 1) {
                let (low, high) = (one.link.min(other.link), one.link.max(other.link));
                if high > low + 1 && !exempt.contains(&[low, high]) && !exempt.contains(&[high, low]) {
                    pairs.push((i, j));
                }
            }
        }
        Shape { capsules, pairs }
    }

    /// The capsules, in the order given.
    pub fn capsules(&self) -> &[Capsule] {
        &self.capsules
    }

    /// Pairs of indices of capsules whose distance is checked.
    pub fn pairs(&self) -> &[(usize, usize)] {
        &self.pairs
    }

    /// Ends of every capsule's segment in the base frame at a pose \[m\]. Panics when a capsule's link is not the chain's.
    pub fn placed(&self, chain: &Chain, q: &[f64]) -> Vec<[V3; 2]> {
        let mut frames = [Placement::identity(); MAX_JOINTS + 1];
        for (i, (joint, &q)) in chain.joints().iter().zip(q).enumerate() {
            frames[i + 1] = frames[i].then(&joint.placement(q));
        }
        let place = |capsule: &Capsule| {
            assert!(capsule.link <= chain.len(), "a capsule on link {} of {}", capsule.link, chain.len());
            let frame = &frames[capsule.link];
            [capsule.from, capsule.to].map(|end| frame.rotation * V3::from(end) + frame.origin)
        };
        self.capsules.iter().map(place).collect()
    }

    /// Whether there is no capsule.
    pub fn is_empty(&self) -> bool {
        self.capsules.is_empty()
    }
}

/// Nearest points of two segments.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Share of the way along the first segment, 0 to 1.
    pub s: f64,
    /// Share of the way along the second segment, 0 to 1.
    pub t: f64,
    /// From the point on the first segment to the point on the second \[m\].
    pub between: V3,
}

/// The nearest points of the segments `p` and `q`, each from its first to its second end, points included.
///
/// Ericson, "Real-Time Collision Detection", 2005, section 5.1.9.
pub fn nearest(p: &[V3; 2], q: &[V3; 2]) -> Nearest {
    let (d1, d2, r) = (p[1] - p[0], q[1] - q[0], p[0] - q[0]);
    let (a, e, f) = (d1.norm_squared(), d2.norm_squared(), d2.dot(&r));
    let c = d1.dot(&r);
    const POINT: f64 = 1e-18;
    let (s, t) = if a <= POINT && e <= POINT {
        (0.0, 0.0)
    } else if a <= POINT {
        (0.0, (f / e).clamp(0.0, 1.0))
    } else if e <= POINT {
        ((-c / a).clamp(0.0, 1.0), 0.0)
    } else {
        let b = d1.dot(&d2);
        let denominator = a * e - b * b;
        // Parallel segments: any point of the first will do.
        let s = if denominator > 1e-12 * a * e { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.5 };
        let t = (b * s + f) / e;
        if t < 0.0 {
            ((-c / a).clamp(0.0, 1.0), 0.0)
        } else if t > 1.0 {
            (((b - c) / a).clamp(0.0, 1.0), 1.0)
        } else {
            (s, t)
        }
    };
    Nearest { s, t, between: q[0] + d2 * t - p[0] - d1 * s }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn capsule(link: usize) -> Capsule {
        Capsule { link, from: [0.0; 3], to: [0.0, 0.0, 0.1], radius: 0.05 }
    }

    /// No two points of a fine raster on both segments are nearer, and the stated points have the stated distance.
    #[test]
    fn no_points_are_nearer_than_the_nearest() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for case in 0..400 {
            let mut point =
                || V3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
            let (mut p, mut q) = ([point(), point()], [point(), point()]);
            match case % 5 {
                1 => q[1] = q[0] + (p[1] - p[0]) * 0.7,
                2 => p[1] = p[0],
                3 => q[1] = q[0],
                4 => (p[1], q[1]) = (p[0], q[0]),
                _ => {}
            }
            let found = nearest(&p, &q);
            let at = |ends: &[V3; 2], share: f64| ends[0] + (ends[1] - ends[0]) * share;
            assert!((at(&q, found.t) - at(&p, found.s) - found.between).norm() < 1e-12);
            for i in 0..=40 {
                for k in 0..=40 {
                    let distance = (at(&q, f64::from(k) / 40.0) - at(&p, f64::from(i) / 40.0)).norm();
                    assert!(distance >= found.between.norm() - 1e-12, "case {case}");
                }
            }
        }
    }

    #[test]
    fn neighbours_and_exempted_links_are_not_compared() {
        let shape = Shape::new((0..4).chain([3]).map(capsule).collect(), &[[3, 1]]);
        assert_eq!(shape.pairs(), [(0, 2), (0, 3), (0, 4)]);
        assert_eq!(Shape::new((0..4).map(capsule).collect(), &[]).pairs(), [(0, 2), (0, 3), (1, 3)]);
    }
}
