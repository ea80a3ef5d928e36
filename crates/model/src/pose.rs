//! A pose to begin from, and pairs of links that cannot be kept apart.

use super::chain::{Chain, JointKind, Placement};
use super::robot::Robot;
use super::shape::{Shape, nearest};
use nalgebra::Matrix3xX;
use plumbline_core::symmetric_eigen;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::PI;

/// Random poses that are looked at.
const POSES: usize = 600;
/// Links nearer than this touch: motions are planned with a centimetre between them \[m\].
const ROOM: f64 = 0.015;
/// Pairs of links that touch in this share of them are not compared: their volumes overlap by construction.
const ALWAYS: f64 = 0.9;

impl Robot {
    /// A pose \[rad\] (n) with room around every joint and for the end effector in every direction, in whole degrees (m: centimetres), without
    /// contact of the links, inside the workspace and above the plane of the base where there is such a pose.
    ///
    /// The best of random poses by the product of the smallest singular value of the end effector's Jacobian and the smallest share of a joint's
    /// range to its nearer end.
    pub fn pose(&self) -> Vec<f64> {
        let n = self.chain.len();
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut best: Option<((bool, bool, f64), Vec<f64>)> = None;
        for _ in 0..POSES {
            let q: Vec<f64> = (0..n)
                .map(|j| {
                    let (low, high) = self.range(j);
                    let step = match self.chain.joints()[j].kind {
                        JointKind::Revolute => PI / 180.0,
                        JointKind::Prismatic => 1e-2,
                    };
                    let q = (rng.random_range(low..=high) / step).round() * step;
                    q.clamp(self.limits.q_min[j], self.limits.q_max[j]) + 0.0
                })
                .collect();
            let room = (0..n).map(|j| {
                let (low, high) = self.range(j);
                ((q[j] - low).min(high - q[j]) / (high - low)).max(0.0)
            });
            let value = room.fold(0.5, f64::min) * dexterity(&self.chain, &q);
            let clear = !touches(&self.shape, &self.chain, &q) && self.workspace_holds(&q);
            let found = (clear, self.is_above(&q), value);
            if best.as_ref().is_none_or(|(before, _)| found > *before) {
                best = Some((found, q));
            }
        }
        best.map_or_else(|| vec![0.0; n], |(_, q)| q)
    }

    /// Middle part of a joint's range, at most a half turn to either side of its middle.
    fn range(&self, joint: usize) -> (f64, f64) {
        let (low, high) = (self.limits.q_min[joint], self.limits.q_max[joint]);
        let (middle, half) = (0.5 * (low + high), (0.5 * (high - low)).min(0.75 * PI));
        (middle - half, middle + half)
    }

    /// Whether all frames and volumes but the base's lie above the plane of the base.
    fn is_above(&self, q: &[f64]) -> bool {
        let mut frame = Placement::identity();
        let mut frames = self.chain.joints().iter().zip(q).map(|(joint, &q)| {
            frame = frame.then(&joint.placement(q));
            frame.origin.z
        });
        let placed = self.shape.placed(&self.chain, q);
        let mut volumes = self.shape.capsules().iter().zip(&placed).filter(|(capsule, _)| capsule.link > 1);
        frames.all(|z| z >= 0.0)
            && self.chain.end_effector(q).z >= 0.0
            && volumes.all(|(capsule, ends)| ends[0].z.min(ends[1].z) >= capsule.radius)
    }

    fn workspace_holds(&self, q: &[f64]) -> bool {
        let (at, space) = (self.chain.end_effector(q), &self.workspace);
        (0..3).all(|axis| (space.box_min[axis]..=space.box_max[axis]).contains(&at[axis]))
            && at.norm() >= space.base_radius
    }

    /// Pairs of links whose volumes overlap in nearly every pose: neighbours in effect, which no motion can keep apart.
    pub fn overlapping(&self) -> Vec<[usize; 2]> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut touching = std::collections::BTreeMap::new();
        for _ in 0..POSES {
            let q: Vec<f64> =
                (0..self.chain.len()).map(|j| rng.random_range(self.limits.q_min[j]..=self.limits.q_max[j])).collect();
            let mut here: Vec<[usize; 2]> = contacts(&self.shape, &self.chain, &q).collect();
            here.sort_unstable();
            here.dedup();
            for pair in here {
                *touching.entry(pair).or_insert(0) += 1;
            }
        }
        touching
            .into_iter()
            .filter(|(_, count)| f64::from(*count) > ALWAYS * POSES as f64)
            .map(|(pair, _)| pair)
            .collect()
    }
}

fn touches(shape: &Shape, chain: &Chain, q: &[f64]) -> bool {
    contacts(shape, chain, q).next().is_some()
}

/// Pairs of links that touch at a pose, once per pair of capsules.
fn contacts<'s>(shape: &'s Shape, chain: &Chain, q: &[f64]) -> impl Iterator<Item = [usize; 2]> + 's {
    let placed = shape.placed(chain, q);
    let capsules = shape.capsules();
    shape.pairs().iter().filter_map(move |&(i, j)| {
        let apart = nearest(&placed[i], &placed[j]).between.norm() - capsules[i].radius - capsules[j].radius;
        let links = [capsules[i].link, capsules[j].link];
        (apart < ROOM).then(|| [links[0].min(links[1]), links[0].max(links[1])])
    })
}

/// Smallest singular value of the end effector's translational Jacobian \[m/rad\]; of its columns where there are fewer than three.
fn dexterity(chain: &Chain, q: &[f64]) -> f64 {
    const STEP: f64 = 1e-5;
    let at = chain.end_effector(q);
    let columns: Vec<_> = (0..q.len())
        .map(|j| {
            let mut moved = q.to_vec();
            moved[j] += STEP;
            (chain.end_effector(&moved) - at) / STEP
        })
        .collect();
    let jacobian = Matrix3xX::from_columns(&columns);
    let Some(eigen) = symmetric_eigen(&jacobian * jacobian.transpose()) else { return 0.0 };
    let mut squares: Vec<f64> = eigen.eigenvalues.iter().map(|value| value.max(0.0)).collect();
    squares.sort_by(|a, b| b.total_cmp(a));
    squares[q.len().min(3) - 1].sqrt()
}
