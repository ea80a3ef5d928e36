//! Gains that whiten equations frequency by frequency.

use crate::signal::spectral::Spectral;

/// Gains by frequency of the rows of one experiment.
#[derive(Clone, Debug)]
pub struct Gains {
    /// Rows of the experiment, N.
    pub samples: usize,
    /// Gain of every frequency, per joint.
    pub joints: Vec<Vec<f64>>,
}

/// Multiplies the spectra of signals by gains. `x` has the rows of all experiments, joint by joint.
pub fn filter(x: &mut [f64], gains: &[Gains]) {
    let joints = gains.first().map_or(0, |gains| gains.joints.len());
    let per_joint = x.len() / joints.max(1);
    let mut before = 0;
    for Gains { samples, joints } in gains {
        let spectral = Spectral::new(*samples, 1.0);
        for (joint, gains) in joints.iter().enumerate() {
            let own = &mut x[joint * per_joint + before..][..*samples];
            if own.iter().all(|value| *value == 0.0) {
                continue;
            }
            let mut spectrum = spectral.transform(own);
            spectrum.iter_mut().zip(gains).for_each(|(value, gain)| *value *= gain);
            own.copy_from_slice(&spectral.signal(spectrum));
        }
        before += samples;
    }
}
