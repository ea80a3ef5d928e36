//! Torques in which a line is sought, and its normal equations there.

use super::super::record::{Record, median};
use super::{BAND_HZ, BaseMotion, Fitted, MIN_EXPLAINED_RATIO, MIN_KNOWN_GAIN, NEIGHBOURS_HZ, SMOOTHING_RATIO};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline_core::symmetric_eigen;
use plumbline_identify::Experiment;
use plumbline_identify::signal::spectral::Spectral;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Power of each joint's noise over frequency, of a single sample \[Nm2\].
struct Noise {
    power: DMatrix<f64>,
    width: f64,
}

impl Noise {
    /// Of centred periods of so many samples below each other, or of one course.
    fn of(x: &DMatrix<f64>, samples: usize, dt: f64) -> Noise {
        let spectral = Spectral::new(samples, dt);
        let mut power = DMatrix::zeros(spectral.bins(), x.ncols());
        let freedom = (x.nrows() / samples - 1).max(1);
        let scale = 1.0 / (samples * freedom) as f64;
        for (joint, column) in x.column_iter().enumerate() {
            for period in column.as_slice().chunks(samples) {
                for (bin, value) in spectral.transform(period).iter().enumerate() {
                    power[(bin, joint)] += scale * value.norm_sqr();
                }
            }
        }
        Noise { power, width: spectral.frequency(1) }
    }

    fn at(&self, joint: usize, frequency: f64) -> f64 {
        let low = (frequency / SMOOTHING_RATIO / self.width).round() as usize;
        let high =
            ((frequency * SMOOTHING_RATIO / self.width).round() as usize).max(low + 1).min(self.power.nrows() - 1);
        let low = low.min(high);
        let mut values: Vec<f64> = (low..=high).map(|bin| self.power[(bin, joint)]).collect();
        // The median, so that a line does not hide itself.
        median(&mut values).max(1e-12)
    }
}

/// Inverse on the directions in which the arm feels a base motion at all.
fn weak_inverse(a: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(eigen) = symmetric_eigen(*a) else { return Matrix3::zeros() };
    let least = 1e-6 * eigen.eigenvalues.max();
    let values = eigen.eigenvalues.map(|value| if value > least { 1.0 / value } else { 0.0 });
    eigen.eigenvectors * Matrix3::from_diagonal(&values) * eigen.eigenvectors.transpose()
}

/// Torques in which a line is sought.
pub(super) struct Part<'a> {
    rows: Rows<'a>,
    /// Gravity columns of one period on the grid, N x 3 for each joint.
    gravity: Vec<DMatrix<f64>>,
    /// Rows x n \[Nm\].
    pub(super) torque: DMatrix<f64>,
    noise: Noise,
    /// Samples of the full rate in one of the grid.
    step: usize,
    /// Time between samples of the grid \[s\].
    dt: f64,
}

/// What the rows of a part are.
pub(super) enum Rows<'a> {
    /// The centred deviations of the periods, P N.
    Deviations(&'a Record<'a>),
    /// The mean over the periods, or the only course, N. What the model lacks counts as noise there.
    Mean(&'a Experiment),
}

impl<'a> Part<'a> {
    pub(super) fn new(
        rows: Rows<'a>,
        gravity: Vec<DMatrix<f64>>,
        torque: DMatrix<f64>,
        step: usize,
        dt: f64,
    ) -> Part<'a> {
        let noise = Noise::of(&torque, gravity[0].nrows(), dt);
        Part { rows, gravity, torque, noise, step, dt }
    }

    /// Samples of a period on the grid.
    fn samples(&self) -> usize {
        self.gravity[0].nrows()
    }

    /// A signal in time: a period that was left out is nothing.
    fn unrolled(&self, x: &[f64]) -> Vec<f64> {
        let Rows::Deviations(record) = &self.rows else { return x.to_vec() };
        let periods = &record.repeats.periods;
        let mut out = vec![0.0; self.length()];
        for (period, values) in periods.iter().zip(x.chunks(record.samples)) {
            out[(period - periods[0]) * record.samples..][..record.samples].copy_from_slice(values);
        }
        out
    }

    /// Samples of [`Part::unrolled`].
    fn length(&self) -> usize {
        match &self.rows {
            Rows::Deviations(record) => match record.repeats.periods[..] {
                [first, .., last] => (last + 1 - first) * record.samples,
                _ => self.torque.nrows(),
            },
            Rows::Mean(_) => self.torque.nrows(),
        }
    }

    /// Resolution of a frequency \[Hz\].
    pub(super) fn width(&self) -> f64 {
        1.0 / (self.length() as f64 * self.dt)
    }

    /// Whether nothing of a frequency can be left: what repeats in every period is no deviation, and a harmonic of the motion tells nothing of the noise.
    fn hides(&self, frequency: f64) -> bool {
        let own = 1.0 / (self.samples() as f64 * self.dt);
        let away = (frequency / own - (frequency / own).round()).abs() * own;
        matches!(self.rows, Rows::Deviations(_)) && away < 0.5 * self.width()
    }

    /// Cosine and sine of a frequency at the rows.
    fn wave(&self, frequency: f64) -> [Vec<f64>; 2] {
        let angle = |t: f64| TAU * frequency * t;
        let means =
            |x: Vec<f64>| x.chunks_exact(self.step).map(|own| own.iter().sum::<f64>() / self.step as f64).collect();
        match &self.rows {
            Rows::Mean(experiment) => {
                let of = |function: fn(f64) -> f64| means(experiment.timeline.mean_of(|t| function(angle(t))));
                [of(f64::cos), of(f64::sin)]
            }
            Rows::Deviations(record) => {
                // Samples of the grid are means over a block.
                let half = PI * frequency * self.dt;
                let block = if self.step > 1 { half.sin() / half } else { 1.0 };
                let rows = 0..self.torque.nrows();
                let of = |function: fn(f64) -> f64| {
                    rows.clone().map(|row| block * function(angle(record.time(row)))).collect()
                };
                [of(f64::cos), of(f64::sin)]
            }
        }
    }

    /// A joint's columns times cosine, then times sine, rows x 6.
    fn columns(&self, joint: usize, wave: &[Vec<f64>; 2]) -> DMatrix<f64> {
        let gravity = &self.gravity[joint];
        DMatrix::from_fn(self.torque.nrows(), 6, |row, k| gravity[(row % gravity.nrows(), k % 3)] * wave[k / 3][row])
    }

    /// Torque of a line at the rows, rows x n, not centred \[Nm\].
    pub(super) fn of_line(&self, line: &BaseMotion) -> DMatrix<f64> {
        let theta = DVector::from_iterator(6, line.cosine.iter().chain(line.sine.iter()).copied());
        let wave = self.wave(line.frequency);
        let of_joint = |joint| self.columns(joint, &wave) * &theta;
        DMatrix::from_columns(&(0..self.gravity.len()).map(of_joint).collect::<Vec<DVector<f64>>>())
    }

    /// Subtracts a line; the noise is that of the rest then.
    pub(super) fn take_off(&mut self, line: &BaseMotion) {
        self.torque -= self.centred(self.of_line(line));
        self.noise = Noise::of(&self.torque, self.samples(), self.dt);
    }

    pub(super) fn centred(&self, x: DMatrix<f64>) -> DMatrix<f64> {
        match &self.rows {
            Rows::Deviations(record) => record.centred_all(x),
            Rows::Mean(_) => x,
        }
    }

    /// Power that three columns explain at each frequency of the band, in units of the noise.
    pub(super) fn spectrum(&self) -> Vec<(f64, f64)> {
        let spectral = Spectral::new(self.length(), self.dt);
        // Spectra of torque times column, and how strong the columns are.
        let mut spectra: Vec<[Vec<Complex<f64>>; 3]> = Vec::new();
        let mut strength: Vec<Matrix3<f64>> = Vec::new();
        for (x, gravity) in self.torque.column_iter().zip(&self.gravity) {
            let times = |c: usize| {
                let product = x.iter().enumerate().map(|(row, x)| x * gravity[(row % gravity.nrows(), c)]);
                spectral.transform(&self.unrolled(&product.collect::<Vec<f64>>()))
            };
            spectra.push([times(0), times(1), times(2)]);
            let square = gravity.tr_mul(gravity) * (self.torque.nrows() / gravity.nrows()) as f64 / 2.0;
            strength.push(square.fixed_view::<3, 3>(0, 0).into_owned());
        }
        let highest = BAND_HZ.1.min(0.4 / self.dt);
        let sought = |frequency: f64| (BAND_HZ.0..=highest).contains(&frequency) && !self.hides(frequency);
        let bins = (0..spectral.bins()).filter(|&bin| sought(spectral.frequency(bin)));
        bins.map(|bin| {
            let frequency = spectral.frequency(bin);
            let (mut b, mut a) = (Vector3::<Complex<f64>>::zeros(), Matrix3::zeros());
            for (joint, spectra) in spectra.iter().enumerate() {
                let weight = 1.0 / self.noise.at(joint, frequency);
                for (c, spectrum) in spectra.iter().enumerate() {
                    b[c] += spectrum[bin] * weight;
                }
                a += strength[joint] * weight;
            }
            let inverse = weak_inverse(&a);
            let part = |x: Vector3<f64>| x.dot(&(inverse * x));
            (frequency, part(b.map(|value| value.re)) + part(b.map(|value| value.im)))
        })
        .collect()
    }

    /// Adds the normal equations of some rows.
    pub(super) fn add_to(&self, normal: &mut Normal, frequency: f64, counts: impl Fn(usize) -> bool) {
        let mut wave = self.wave(frequency);
        for values in &mut wave {
            values.iter_mut().enumerate().filter(|(row, _)| !counts(*row)).for_each(|(_, value)| *value = 0.0);
        }
        for (joint, torque) in self.torque.column_iter().enumerate() {
            let weight = 1.0 / self.noise.at(joint, frequency);
            let x = self.centred(self.columns(joint, &wave));
            normal.g += x.tr_mul(&x) * weight;
            normal.b += x.tr_mul(&torque) * weight;
        }
    }

    /// Whether what is fitted to one half holds in the other, and the other way round. What the model lacks of a motion has lines, too, but none that
    /// goes on; the deviations have nothing of it.
    pub(super) fn goes_on(&self, frequency: f64) -> bool {
        if matches!(self.rows, Rows::Deviations(_)) {
            return true;
        }
        let rows = self.torque.nrows();
        let halves = [0..rows / 2, rows / 2..rows].map(|half| {
            let mut normal = Normal::default();
            self.add_to(&mut normal, frequency, |row| half.contains(&row));
            normal
        });
        let [Some(first), Some(second)] = halves.clone().map(Normal::solved) else { return false };
        let holds = |half: &Normal, own: &Fitted, other: &Fitted| {
            own.gain > MIN_KNOWN_GAIN && half.gain(&other.theta) > MIN_EXPLAINED_RATIO * own.gain
        };
        holds(&halves[0], &first, &second) && holds(&halves[1], &second, &first)
    }

    /// Share of the squares near a frequency, beyond the noise, that go with a torque: the arm's motion spreads a line over its harmonics.
    pub(super) fn explained(&self, frequency: f64, tau: &DMatrix<f64>) -> f64 {
        let length = self.length();
        let spectral = Spectral::new(length, self.dt);
        let near = |bin: &usize| (spectral.frequency(*bin) - frequency).abs() < NEIGHBOURS_HZ;
        let bins: Vec<usize> = (0..spectral.bins()).filter(near).collect();
        let (mut before, mut after) = (0.0, 0.0);
        for (joint, (own, tau)) in self.torque.column_iter().zip(tau.column_iter()).enumerate() {
            let noise = self.noise.at(joint, frequency);
            let square = |x: &[f64]| {
                let spectrum = spectral.transform(&self.unrolled(x));
                bins.iter().map(|&bin| spectrum[bin].norm_sqr() / (length as f64 * noise)).sum::<f64>()
                    - bins.len() as f64
            };
            (before, after) = (before + square(own.as_slice()), after + square((own - tau).as_slice()).max(0.0));
        }
        (1.0 - after / before.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
    }
}

/// Normal equations of the three columns times cosine and sine.
#[derive(Clone)]
pub(super) struct Normal {
    g: DMatrix<f64>,
    b: DVector<f64>,
}

impl Default for Normal {
    fn default() -> Normal {
        Normal { g: DMatrix::zeros(6, 6), b: DVector::zeros(6) }
    }
}

impl Normal {
    pub(super) fn solved(mut self) -> Option<Fitted> {
        let scale = self.g.diagonal().max();
        for k in 0..6 {
            self.g[(k, k)] += 1e-9 * scale;
        }
        let covariance = self.g.cholesky()?.inverse();
        let theta = &covariance * &self.b;
        Some(Fitted { gain: self.b.dot(&theta), theta, covariance })
    }

    /// Squares that go with other values, in units of the noise.
    fn gain(&self, theta: &DVector<f64>) -> f64 {
        2.0 * self.b.dot(theta) - (&self.g * theta).dot(theta)
    }
}
