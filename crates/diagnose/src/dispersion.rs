//! Bounds of the over-dispersion.

use super::evidence::BAND_EDGES_HZ;
use super::fit::{Problem, group};
use super::moments::GroupedMoments;

/// Largest over-dispersion of a joint and band in units of what least squares leave there: twice the torque.
const MAX_RATIO: f64 = 4.0;
/// Rounds in which least squares find the weights of the joints.
const ROUNDS: usize = 12;

impl Problem<'_> {
    /// With the over-dispersion bounded by four times what least squares leave, all bands of a joint with one weight: in the joint and band, or the joint's
    /// mean where that is more. A model that gave up the few rows of the low bands would fit those of the high ones better, and be wrong by tens of Nm where
    /// the arm moves. Without repeats there is no bound: bands are drawn towards their joint.
    pub fn bounded(&self, mut sums: GroupedMoments) -> GroupedMoments {
        if !self.evidence.repeats() {
            return sums;
        }
        let bands = BAND_EDGES_HZ.len();
        let mut noise = vec![0.0; sums.count.len()];
        for cell in self.evidence.cells() {
            let sigma = &self.evidence.sigma(cell.joint)[cell.rows.clone()];
            let at = group(cell.joint, cell.band);
            noise[at] += sigma.iter().map(|sigma| sigma * sigma).sum::<f64>() / sums.count[at];
        }
        // Mean square of what is left of each joint.
        let (mut square, mut rss) = (vec![1.0; self.evidence.joints()], Vec::new());
        for _ in 0..ROUNDS {
            let phi: Vec<f64> = noise.iter().enumerate().map(|(at, noise)| square[at / bands] / noise).collect();
            rss = self.estimate(&sums, &phi).rss;
            for (joint, square) in square.iter_mut().enumerate() {
                let own = group(joint, 0)..group(joint + 1, 0);
                let left: f64 = own.clone().map(|at| rss[at] * noise[at]).sum();
                *square = (left / sums.count[own].iter().sum::<f64>().max(1.0)).max(f64::MIN_POSITIVE);
            }
        }
        for (at, most) in sums.most.iter_mut().enumerate() {
            *most = (MAX_RATIO * (rss[at] / sums.count[at]).max(square[at / bands] / noise[at])).max(1.0);
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use crate::synthetic::recorded;
    use nalgebra::{DMatrix, DVector};

    #[test]
    fn a_band_may_lack_four_times_what_least_squares_leave_and_more_costs_its_square() {
        let recorded = recorded(4, 91, |at| [(3.0 * at.q[1]).sin(), 0.2 * (20.0 * at.q[0]).sin()]);
        recorded.search(&[], &Settings::default(), |search, base| {
            let (problem, sums) = (&search.problem, &base.fit.sums);
            let evidence = problem.evidence;
            // Each joint in Nm, its rows over what they have left.
            let in_nm = |joint: usize| {
                let sigma = DVector::from_column_slice(evidence.sigma(joint));
                let mut m = base.columns.m[joint].clone();
                m.column_iter_mut().for_each(|mut column| column.component_mul_assign(&sigma));
                (m, base.columns.r[joint].component_mul(&sigma))
            };
            let joints = [in_nm(0), in_nm(1)];
            let mut left = [1.0; 2];
            let mut rest = joints.clone().map(|(_, r)| r);
            for _ in 0..30 {
                let (mut g, mut b) = (DMatrix::zeros(sums.width, sums.width), DVector::zeros(sums.width));
                for ((m, r), left) in joints.iter().zip(left) {
                    g += m.tr_mul(m) / left;
                    b += m.tr_mul(r) / left;
                }
                let theta = g.try_inverse().unwrap() * b;
                rest = joints.clone().map(|(m, r)| r - m * &theta);
                left = [0, 1].map(|joint| rest[joint].norm_squared() / rest[joint].len() as f64);
            }
            for (joint, rest) in rest.iter().enumerate() {
                for (band, most) in sums.most[group(joint, 0)..][..6].iter().enumerate() {
                    let cells = evidence.cells().iter().filter(|cell| cell.joint == joint && cell.band == band);
                    let rows: Vec<usize> = cells.flat_map(|cell| cell.rows.clone()).collect();
                    let mean = |of: &dyn Fn(usize) -> f64| rows.iter().map(|&k| of(k)).sum::<f64>() / rows.len() as f64;
                    let square = |row: usize| evidence.sigma(joint)[row].powi(2);
                    let own = mean(&|row| rest[row].powi(2) / square(row));
                    let expected = 4.0 * own.max(left[joint] / mean(&square));
                    assert!((most / expected - 1.0).abs() < 0.1, "joint {joint}, band {band}: {most}, {expected}");
                    let (at, count) = (group(joint, band), sums.count[group(joint, band)]);
                    let likelihood = |times: f64| {
                        let mut rss = base.fit.rss.clone();
                        rss[at] = times * most * count;
                        problem.likelihood(&rss, sums)
                    };
                    let falls = likelihood(3.0) - likelihood(5.0);
                    assert!((falls / count - 1.0).abs() < 1e-9, "joint {joint}, band {band}: {falls} of {count}");
                }
            }
        });
    }
}
