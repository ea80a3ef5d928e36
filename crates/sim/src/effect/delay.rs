//! Delay: the reported torque is older than the reported position.
//!
//!   tau_measured(t) = tau(t - delay), of all joints, or of one.
//!
//! Between the milliseconds the torque runs along the cubic through its four neighbours (Lagrange), so any fraction of a millisecond is
//! a delay. Before the beginning the torque was as at the beginning.

use super::*;

/// Longest delay \[s\].
const MAX_DELAY_S: f64 = 0.1;
/// Room for the longest delay and the neighbours.
const MAX_SAMPLES: usize = 128;
/// Time between two readings \[s\].
const SAMPLE_S: f64 = 1e-3;

/// Acts on the reading, after the effects listed before it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1; all of them where absent.
    pub joint: Option<usize>,
    /// Delay \[s\].
    pub delay: f64,
}

struct Delay {
    joint: Option<usize>,
    /// Age of the newest of the four neighbours, in readings.
    newest: usize,
    weights: [f64; 4],
    past: Box<[JointVec; MAX_SAMPLES]>,
    /// Index of the newest reading; `None` before the first.
    now: Option<usize>,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        self.joint.map_or(Ok(()), |joint| place.joint(joint))?;
        place.range("delay", self.delay, 0.0, MAX_DELAY_S)
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        let readings = self.delay / SAMPLE_S;
        // One neighbour on the younger side where there is one.
        let newest = (readings.floor() - 1.0).max(0.0);
        let x = readings - newest;
        let nodes = [0.0, 1.0, 2.0, 3.0];
        let weights = nodes.map(|node: f64| {
            let others = nodes.into_iter().filter(|other| *other != node);
            others.map(|other| (x - other) / (node - other)).product()
        });
        let past = Box::new([[0.0; MAX_JOINTS]; MAX_SAMPLES]);
        Box::new(Delay { joint: self.joint, newest: newest as usize, weights, past, now: None })
    }
}

impl Effect for Delay {
    fn sense(&mut self, at: &At, reading: &mut Reading) {
        let now = match self.now {
            None => {
                self.past.fill(reading.tau);
                0
            }
            Some(before) => (before + 1) % MAX_SAMPLES,
        };
        self.past[now] = reading.tau;
        self.now = Some(now);
        let old = |age: usize| &self.past[(now + MAX_SAMPLES - age) % MAX_SAMPLES];
        for j in (0..at.n).filter(|j| self.joint.is_none_or(|joint| joint == j + 1)) {
            reading.tau[j] = (0..4).map(|k| self.weights[k] * old(self.newest + k)[j]).sum();
        }
    }
}
