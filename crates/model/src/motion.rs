//! Inputs of a regressor: a whole motion, or one sample.

use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;

/// A motion on an even time grid, with all inputs of a regressor.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Time between samples \[s\].
    pub dt: f64,
    /// Joint positions, N x n \[rad\].
    pub q: DMatrix<f64>,
    /// Joint velocities, N x n \[rad/s\].
    pub dq: DMatrix<f64>,
    /// Joint accelerations, N x n \[rad/s2\].
    pub ddq: DMatrix<f64>,
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Whether the motion repeats, so that the sample before the first is the last one.
    pub periodic: bool,
    /// Time of the first sample since the start of the recording \[s\].
    pub start: f64,
}

impl Motion {
    /// Number of samples, N.
    pub fn samples(&self) -> usize {
        self.q.nrows()
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.q.ncols()
    }

    /// One of its samples. An arm has at most [`MAX_JOINTS`](plumbline_core::MAX_JOINTS) joints.
    pub fn sample(&self, k: usize) -> Sample {
        let mut sample = Sample::default();
        for j in 0..self.joints() {
            (sample.q[j], sample.dq[j], sample.ddq[j]) = (self.q[(k, j)], self.dq[(k, j)], self.ddq[(k, j)]);
        }
        sample
    }
}

/// One sample of a [`Motion`], desired or measured.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sample {
    /// Position \[rad\].
    pub q: JointVec,
    /// Velocity \[rad/s\].
    pub dq: JointVec,
    /// Acceleration \[rad/s2\].
    pub ddq: JointVec,
}
