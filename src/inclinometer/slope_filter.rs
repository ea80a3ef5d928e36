//! Low-pass of the slopes with noise estimate, rest detection and jump detection.
//!
//! A first-order low-pass with time constant `T`, exact for the actual time `dt` between two frames:
//! `y += (1 - exp(-dt / T)) (x - y)`. The variance of `x - y` estimates the sensor noise at rest. A moving base makes `x - y` large. An
//! inclinometer does not separate acceleration from tilt, so during motion the whole variance of `x - y` is the uncertainty.

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlopeFilterSettings {
    /// Time constant \[s\].
    pub time_constant: f64,
    /// Largest plausible step between two frames \[rad\].
    pub jump: f64,
    /// Largest deviation from the low-pass of a base at rest \[rad\].
    pub still: f64,
}

impl Default for SlopeFilterSettings {
    /// 0.5 s; 5 deg; 0.5 deg.
    fn default() -> SlopeFilterSettings {
        SlopeFilterSettings { time_constant: 0.5, jump: 5f64.to_radians(), still: 0.5f64.to_radians() }
    }
}

/// Time until the output is valid after the first frame or a jump, and until the base counts as at rest, in time constants.
const SETTLING_TIME_CONSTANTS: f64 = 3.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilteredSlopes {
    /// Slopes \[rad\].
    pub slopes: [f64; 2],
    /// Standard deviation of their random part \[rad\].
    pub std: [f64; 2],
    /// Whether the base has been at rest for three time constants.
    pub still: bool,
}

#[derive(Clone, Debug)]
pub struct SlopeFilter {
    settings: SlopeFilterSettings,
    last: Option<(u64, [f64; 2])>,
    mean: [f64; 2],
    variance: [f64; 2],
    /// Start of the filter, and start of the current rest \[ns\].
    since: u64,
    still_since: u64,
    settled: bool,
}

impl SlopeFilter {
    pub fn new(settings: SlopeFilterSettings) -> SlopeFilter {
        let (last, mean, variance) = (None, [0.0; 2], [0.0; 2]);
        SlopeFilter { settings, last, mean, variance, since: 0, still_since: 0, settled: false }
    }

    pub fn reset(&mut self) {
        *self = SlopeFilter::new(self.settings);
    }

    /// Filters the slopes \[rad\] of a frame that arrived at `now` \[ns\]. `Ok(None)` until the filter has settled.
    /// Errors: a step from the previous frame above `jump` \[rad\]; the filter restarts from this frame.
    pub fn update(&mut self, now: u64, slopes: [f64; 2]) -> Result<Option<FilteredSlopes>, f64> {
        let Some((before, last)) = self.last.replace((now, slopes)) else {
            (self.mean, self.variance) = (slopes, [0.0; 2]);
            (self.since, self.still_since, self.settled) = (now, now, false);
            return Ok(None);
        };
        let step = (0..2).map(|axis| (slopes[axis] - last[axis]).abs()).fold(0.0, f64::max);
        if step.is_nan() || step > self.settings.jump {
            self.reset();
            self.last = Some((now, slopes));
            (self.mean, self.since, self.still_since) = (slopes, now, now);
            return Err(step);
        }
        let dt = now.saturating_sub(before) as f64 * 1e-9;
        let gain = 1.0 - (-dt / self.settings.time_constant).exp();
        let mut deviation = 0f64;
        for ((slope, mean), variance) in slopes.iter().zip(&mut self.mean).zip(&mut self.variance) {
            let residual = slope - *mean;
            *mean += gain * residual;
            *variance += gain * (residual * residual - *variance);
            deviation = deviation.max(residual.abs());
        }
        if deviation > self.settings.still {
            self.still_since = now;
        }
        let settling_time = SETTLING_TIME_CONSTANTS * self.settings.time_constant;
        let passed = |since: u64| now.saturating_sub(since) as f64 * 1e-9 >= settling_time;
        self.settled |= passed(self.since);
        // Ratio of output to input variance of the low-pass for white noise.
        let noise_ratio = gain / (2.0 - gain);
        let still = passed(self.still_since);
        // During motion the low-pass lags, and the whole deviation is uncertainty.
        let std = self.variance.map(|variance| (variance * if still { noise_ratio } else { 1.0 }).sqrt());
        Ok(self.settled.then_some(FilteredSlopes { slopes: self.mean, std, still }))
    }
}
