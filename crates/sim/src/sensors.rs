//! Noise, quantisation, faults and loss between the arm and its states.

use super::commands::TICK_S;
use super::effect::Reading;
use super::truth::{JointTruth, Truth};
use plumbline_core::{JointVec, MAX_JOINTS};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// White and coloured noise, and steps, on every channel.
pub(super) struct Sensors {
    joints: Vec<JointTruth>,
    rng: ChaCha8Rng,
    coloured: Coloured,
}

/// `x <- decay x + sqrt(1 - decay^2) std w` with white `w`: noise behind a low-pass of first order, at its standard deviation from the start.
struct Coloured {
    decay: f64,
    x: JointVec,
    rng: ChaCha8Rng,
}

impl Sensors {
    pub fn new(truth: &Truth, seed: u64) -> Sensors {
        let decay = (-TAU * truth.torque_noise_corner * TICK_S).exp();
        let mut coloured = Coloured { decay, x: [0.0; MAX_JOINTS], rng: stream(seed, 2) };
        for (x, joint) in coloured.x.iter_mut().zip(&truth.joints) {
            *x = joint.torque_noise_coloured * coloured.rng.sample::<f64, _>(StandardNormal);
        }
        Sensors { joints: truth.joints.clone(), rng: stream(seed, 0), coloured }
    }

    pub fn add_noise(&mut self, reading: &mut Reading) {
        let Coloured { decay, x, rng } = &mut self.coloured;
        for (j, joint) in self.joints.iter().enumerate().filter(|(_, joint)| joint.torque_noise_coloured > 0.0) {
            let fresh = joint.torque_noise_coloured * rng.sample::<f64, _>(StandardNormal);
            x[j] = *decay * x[j] + (1.0 - *decay * *decay).sqrt() * fresh;
            reading.tau[j] += x[j];
        }
        for (j, joint) in self.joints.iter().enumerate() {
            let mut noise = |deviation: f64| deviation * self.rng.sample::<f64, _>(StandardNormal);
            reading.q[j] = step(reading.q[j] + noise(joint.position_noise), joint.position_quantum);
            reading.dq[j] += noise(joint.velocity_noise);
            reading.tau[j] = step(reading.tau[j] + noise(joint.torque_noise), joint.torque_quantum);
        }
    }
}

/// An independent random stream per purpose.
fn stream(seed: u64, purpose: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(purpose);
    rng
}

fn step(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}

/// Sensor faults: dead torque sensors, outliers of the torque, and repeated states.
pub(super) struct Faults {
    joints: usize,
    outlier_probability: f64,
    outlier_size: f64,
    repeat_probability: f64,
    /// Joints from 0.
    dead: Vec<usize>,
    last: Option<(Reading, f64)>,
    rng: ChaCha8Rng,
}

impl Faults {
    pub fn new(truth: &Truth, seed: u64) -> Faults {
        Faults {
            joints: truth.joints(),
            outlier_probability: truth.outlier_probability,
            outlier_size: truth.outlier_size,
            repeat_probability: truth.repeat_probability,
            dead: truth.dead_torque_sensors.iter().map(|joint| joint - 1).collect(),
            last: None,
            rng: stream(seed, 3),
        }
    }

    /// `time` is the state's time stamp \[s\].
    pub fn apply(&mut self, reading: &mut Reading, time: &mut f64) {
        if self.outlier_probability > 0.0 {
            for tau in &mut reading.tau[..self.joints] {
                if self.rng.random::<f64>() < self.outlier_probability {
                    *tau += if self.rng.random() { self.outlier_size } else { -self.outlier_size };
                }
            }
        }
        for &joint in &self.dead {
            reading.tau[joint] = 0.0;
        }
        if self.repeat_probability > 0.0 {
            let again = self.rng.random::<f64>() < self.repeat_probability;
            match self.last {
                Some(last) if again => (*reading, *time) = last,
                _ => self.last = Some((*reading, *time)),
            }
        }
    }
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
        Losses { probability: truth.drop_probability, burst: truth.drop_burst, left: 0, rng: stream(seed, 1) }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::two_joints::truth;

    /// An AR(1) process: its standard deviation as written, correlated by exp(-2 pi f t) over time t.
    #[test]
    fn coloured_noise_has_its_size_and_corner() {
        let truth = truth("torque-noise-corner = 2.0", "torque-noise-coloured = 0.05", "");
        let mut sensors = Sensors::new(&truth, 3);
        let noise: Vec<[f64; 2]> = (0..400_000)
            .map(|_| {
                let mut reading = Reading::default();
                sensors.add_noise(&mut reading);
                assert_eq!((reading.q, reading.dq), ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]));
                [reading.tau[0], reading.tau[1]]
            })
            .collect();
        let product = |lag: usize, a: usize, b: usize| {
            let pairs = noise.iter().zip(&noise[lag..]);
            pairs.map(|(x, y)| x[a] * y[b]).sum::<f64>() / (noise.len() - lag) as f64
        };
        let variance = product(0, 0, 0);
        assert!((variance.sqrt() / 0.05 - 1.0).abs() < 0.05, "{}", variance.sqrt());
        for lag in [20, 80] {
            let expected = (-TAU * 2.0 * lag as f64 * 1e-3).exp();
            assert!(
                (product(lag, 0, 0) / variance - expected).abs() < 0.06,
                "{lag} ms: {}",
                product(lag, 0, 0) / variance
            );
        }
        assert!(product(0, 0, 1).abs() < 0.1 * variance, "joints have noise of their own");
    }

    /// Coloured noise, outliers and repeats are drawn beside the white noise, which stays the same.
    #[test]
    fn sensor_faults_have_the_configured_frequency() {
        let white = "torque-noise = 0.1, velocity-noise = 0.01";
        let plain = truth("", white, "");
        let faulty = truth("outlier-probability = 0.01\noutlier-size = 5.0\nrepeat-probability = 0.06", white, "");
        let [mut a, mut b] = [&plain, &faulty].map(|truth| (Sensors::new(truth, 9), Faults::new(truth, 9)));
        let (mut outliers, mut repeats, mut last) = ([0, 0], 0, None);
        for k in 0..100_000 {
            let draw = |(sensors, faults): &mut (Sensors, Faults)| {
                let (mut reading, mut time) = (Reading::default(), k as f64);
                sensors.add_noise(&mut reading);
                faults.apply(&mut reading, &mut time);
                (reading.tau, reading.dq, time)
            };
            let (clean, spoilt) = (draw(&mut a), draw(&mut b));
            assert_eq!(clean.2, k as f64);
            if spoilt.2 != k as f64 {
                assert_eq!(Some(spoilt), last, "all of the state before, its time stamp too");
                repeats += 1;
                continue;
            }
            last = Some(spoilt);
            let off = spoilt.0[0] - clean.0[0];
            assert!(off == 0.0 || (off.abs() - 5.0).abs() < 1e-9, "{off}");
            assert_eq!((spoilt.1, spoilt.0[2]), (clean.1, 0.0));
            outliers[0] += usize::from(off > 0.0);
            outliers[1] += usize::from(off < 0.0);
        }
        assert!((5_500..6_500).contains(&repeats), "{repeats} repeats");
        // Outliers in repeated states are not counted.
        assert!(outliers.iter().all(|count| (400..550).contains(count)), "{outliers:?} outliers up and down");
    }

    #[test]
    fn an_invalid_sensor_fault_is_refused() {
        for (key, value) in [
            ("outlier-probability", "0.7"),
            ("repeat-probability", "-0.1"),
            ("outlier-size", "inf"),
            ("torque-noise-corner", "0.0"),
            ("dead-torque-sensors", "[2]"),
        ] {
            let text = "robot = 'none'
                link = [{ mass = 1.0, com = [0, 0, 0], inertia = [1, 0, 0, 1, 0, 1] }]
                joint = [{ stiffness = 1, damping = 1 }]";
            let error = Truth::parse("test", &format!("{key} = {value}\n{text}")).expect_err(key).to_string();
            assert!(error.starts_with(&format!("test: {key}: got ")), "{error}");
        }
    }

    #[test]
    fn a_dead_torque_sensor_reads_zero() {
        let mut faults =
            Faults::new(&truth("dead-torque-sensors = [2]\noutlier-probability = 0.5\noutlier-size = 5.0", "", ""), 9);
        for _ in 0..100 {
            let mut reading = Reading { tau: [3.0; MAX_JOINTS], ..Reading::default() };
            faults.apply(&mut reading, &mut 0.0);
            assert!(reading.tau[0] != 0.0 && reading.tau[1] == 0.0, "{:?}", reading.tau);
        }
    }
}
