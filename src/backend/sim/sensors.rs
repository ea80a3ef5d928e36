//! Noise, quantisation and loss: what is between the arm and the one who reads it.

use super::effect::Reading;
use super::truth::{JointTruth, Truth};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// White noise and steps on every channel.
pub(super) struct Sensors {
    joints: Vec<JointTruth>,
    rng: ChaCha8Rng,
}

impl Sensors {
    pub fn new(truth: &Truth, seed: u64) -> Sensors {
        Sensors { joints: truth.joints.clone(), rng: ChaCha8Rng::seed_from_u64(seed) }
    }

    pub fn distort(&mut self, reading: &mut Reading) {
        for (j, joint) in self.joints.iter().enumerate() {
            let mut noise = |deviation: f64| deviation * self.rng.sample::<f64, _>(StandardNormal);
            reading.q[j] = step(reading.q[j] + noise(joint.position_noise), joint.position_quantum);
            reading.dq[j] += noise(joint.velocity_noise);
            reading.tau[j] = step(reading.tau[j] + noise(joint.torque_noise), joint.torque_quantum);
        }
    }
}

fn step(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}

/// Lost states, in bursts.
pub(super) struct Losses {
    probability: f64,
    burst: u32,
    left: u32,
    rng: ChaCha8Rng,
}

impl Losses {
    pub fn new(truth: &Truth, seed: u64) -> Losses {
        // Its own stream: losing states does not change the noise of those that arrive.
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1);
        Losses { probability: truth.drop_probability, burst: truth.drop_burst, left: 0, rng }
    }

    /// Whether the next state is lost.
    pub fn next(&mut self) -> bool {
        if self.left > 0 {
            self.left -= 1;
            return true;
        }
        let begins = self.rng.random::<f64>() < self.probability;
        if begins {
            self.left = self.burst - 1;
        }
        begins
    }
}
