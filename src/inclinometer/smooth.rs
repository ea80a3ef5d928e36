//! Slopes made calm: low-pass, noise, rest, jumps.
//!
//! A first-order low-pass with time constant `T`, exact for the time that has really passed between two frames:
//! `y += (1 - exp(-dt / T)) (x - y)`. What the frames scatter around it says how noisy the sensor is; a base that moves, or shakes, shows
//! in the same difference. An inclinometer can't tell an acceleration from a tilt, so while the base moves its angles are only good to
//! what they deviate.

/// Settings of the smoothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SmoothSettings {
    /// Time constant \[s\].
    pub time_constant: f64,
    /// Largest step from one frame to the next that a base can make \[rad\].
    pub jump: f64,
    /// Deviation from the low-pass up to which the base counts as at rest \[rad\].
    pub still: f64,
}

impl Default for SmoothSettings {
    /// 0.5 s; 5 deg; 0.5 deg.
    fn default() -> SmoothSettings {
        SmoothSettings { time_constant: 0.5, jump: 5f64.to_radians(), still: 0.5f64.to_radians() }
    }
}

/// How calm it must have been after a jump, and how long from the first frame on, in time constants.
const CALM: f64 = 3.0;

/// What the slopes are, calm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calm {
    /// Slopes \[rad\].
    pub slopes: [f64; 2],
    /// Standard deviation of their random part \[rad\].
    pub std: [f64; 2],
    /// The base has been at rest for three time constants.
    pub still: bool,
}

/// A low-pass over both slopes.
#[derive(Clone, Debug)]
pub struct Smoother {
    settings: SmoothSettings,
    last: Option<(u64, [f64; 2])>,
    calm: [f64; 2],
    variance: [f64; 2],
    /// When the slopes were taken in afresh, and since when the base has been at rest \[ns\].
    since: u64,
    still_since: u64,
    settled: bool,
}

impl Smoother {
    /// A low-pass that has seen nothing.
    pub fn new(settings: SmoothSettings) -> Smoother {
        let (last, calm, variance) = (None, [0.0; 2], [0.0; 2]);
        Smoother { settings, last, calm, variance, since: 0, still_since: 0, settled: false }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        *self = Smoother::new(self.settings);
    }

    /// Takes in the slopes \[rad\] of a frame that came at `now` \[ns\]. `Ok(None)` while there are too few of them.
    ///
    /// # Errors
    /// The step from the frame before where it is too large \[rad\]; the slopes start afresh from this frame.
    pub fn take(&mut self, now: u64, slopes: [f64; 2]) -> Result<Option<Calm>, f64> {
        let Some((before, last)) = self.last.replace((now, slopes)) else {
            (self.calm, self.variance) = (slopes, [0.0; 2]);
            (self.since, self.still_since, self.settled) = (now, now, false);
            return Ok(None);
        };
        let by = (0..2).map(|axis| (slopes[axis] - last[axis]).abs()).fold(0.0, f64::max);
        if by.is_nan() || by > self.settings.jump {
            self.reset();
            self.last = Some((now, slopes));
            (self.calm, self.since, self.still_since) = (slopes, now, now);
            return Err(by);
        }
        let dt = now.saturating_sub(before) as f64 * 1e-9;
        let share = 1.0 - (-dt / self.settings.time_constant).exp();
        let mut deviation = 0f64;
        for ((slope, calm), variance) in slopes.iter().zip(&mut self.calm).zip(&mut self.variance) {
            let rest = slope - *calm;
            *calm += share * rest;
            *variance += share * (rest * rest - *variance);
            deviation = deviation.max(rest.abs());
        }
        if deviation > self.settings.still {
            self.still_since = now;
        }
        let passed = |since: u64| now.saturating_sub(since) as f64 * 1e-9 >= CALM * self.settings.time_constant;
        self.settled |= passed(self.since);
        // The low-pass leaves `share / (2 - share)` of white noise's variance.
        let left = share / (2.0 - share);
        let still = passed(self.still_since);
        // While the base moves, the low-pass lags behind: then what it deviates is what is not known.
        let std = self.variance.map(|variance| (variance * if still { left } else { 1.0 }).sqrt());
        Ok(self.settled.then_some(Calm { slopes: self.calm, std, still }))
    }
}
