//! Models on runs that they were not fitted to.

use super::evidence::{Cell, Evidence, Trial};
use super::fit::{Problem, group, inverse};
use super::moments::Columns;
use super::outcome::Fitted;
use super::rows::Rows;
use super::state::{State, mean_square};
use nalgebra::{DMatrix, DVector};
use plumbline_model::Structure;
use plumbline_model::term::effect::OperatingPoint;
use std::ops::Range;

/// Smallest unmodelled RMS that counts, in units of the noise of the mean period.
pub(super) const THRESHOLD_FLOOR_RATIO: f64 = 0.75;

/// Standard deviations by which too little is taken: 95 % on one side.
const DEVIATIONS: f64 = 1.645;

/// Columns of a structure and torques of runs.
pub fn columns_of(evidence: &Evidence, structure: &Structure, trials: &[Trial]) -> Columns {
    Columns { m: evidence.regressor(structure, trials), r: evidence.torques(trials) }
}

fn repeats(trials: &[Trial]) -> bool {
    trials.iter().all(|trial| trial.experiment.scatter.is_some())
}

/// What the identified runs tell of a model's parameters.
#[derive(Clone, Copy)]
pub struct Known<'a> {
    /// Estimate.
    pub theta: &'a DVector<f64>,
    /// Its information, the inverse of its covariance; zero in directions that are not determined.
    pub information: &'a DMatrix<f64>,
    /// Over-dispersion of each joint and band.
    pub phi: &'a [f64],
}

/// Torques and columns of a state on other runs than those it was fitted to.
pub struct Unseen<'a> {
    /// The runs.
    pub evidence: &'a Evidence,
    columns: Columns,
    /// Whether the motion of each run repeats.
    repeats: bool,
}

impl<'a> Unseen<'a> {
    /// With the columns of a state.
    pub fn of(
        evidence: &'a Evidence,
        structure: &Structure,
        trials: &[Trial],
        state: &State,
        operating_point: &OperatingPoint,
    ) -> Unseen<'a> {
        let mut columns = columns_of(evidence, structure, trials);
        for item in &state.items {
            if let Ok(term) = item.spec.build(operating_point) {
                columns.push(&evidence.columns(&*term, item.span));
            }
        }
        Unseen { evidence, columns, repeats: repeats(trials) }
    }

    /// With the columns of a whole model.
    pub fn of_model(evidence: &'a Evidence, fitted: &Fitted, trials: &[Trial]) -> Unseen<'a> {
        Unseen { evidence, columns: columns_of(evidence, &fitted.structure, trials), repeats: repeats(trials) }
    }

    /// With the columns of one more effect.
    pub fn with(&self, rows: &Rows) -> Unseen<'a> {
        let mut columns = self.columns.clone();
        columns.push(rows);
        Unseen { columns, ..*self }
    }

    /// Without some of its columns.
    pub fn without(&self, gone: Range<usize>) -> Unseen<'a> {
        Unseen { columns: self.columns.without(gone), ..*self }
    }

    /// Parameters by the identified runs and these together, and minus twice the log of the density that the identified runs predict for these, but
    /// for a constant: with `W` the inverse of the over-dispersion and `I` the information,
    ///
    ///   min_theta (r - M theta)' W (r - M theta) + (theta - theta_known)' I (theta - theta_known).
    ///
    /// What the identified runs leave undetermined costs nothing in it. In the error under the known parameters it may be larger than what
    /// tells one model from another.
    pub fn update(&self, known: Known) -> (DVector<f64>, f64) {
        let p = known.theta.len();
        let (mut g, mut b, mut square) = (known.information.clone(), DVector::zeros(p), 0.0);
        for cell in self.evidence.cells() {
            let weight = 1.0 / known.phi[group(cell.joint, cell.band)];
            let m = self.columns.m[cell.joint].view((cell.rows.start, 0), (cell.rows.len(), p));
            let r = self.columns.r[cell.joint].rows(cell.rows.start, cell.rows.len()) - m * known.theta;
            g.gemm_tr(weight, &m, &m, 1.0);
            b.gemv_tr(weight, &m, &r, 1.0);
            square += weight * r.norm_squared();
        }
        let shift = inverse(&g) * &b;
        // Errors of the inverse are squared in this form.
        (known.theta + &shift, square - 2.0 * shift.dot(&b) + (g * &shift).dot(&shift))
    }

    /// [`Unseen::update`] of a state that was fitted to the problem's runs, with this over-dispersion.
    pub fn update_of(&self, problem: &Problem, state: &State, phi: &[f64]) -> (DVector<f64>, f64) {
        let information = problem.information(state.moments(problem.evidence), phi);
        self.update(Known { theta: &state.fit.theta, information: &information, phi })
    }

    /// Residual of a joint, divided by the noise there.
    pub fn residual(&self, joint: usize, theta: &DVector<f64>) -> DVector<f64> {
        &self.columns.r[joint] - self.columns.m[joint].columns(0, theta.len()) * theta
    }

    /// The same of every joint.
    pub fn residual_of_each(&self, theta: &DVector<f64>) -> Vec<DVector<f64>> {
        (0..self.evidence.joints()).map(|joint| self.residual(joint, theta)).collect()
    }

    /// Fall of the squared error of all joints from the parameters `before` to `after`, in units of the noise: of the over-dispersion `phi` where
    /// these runs repeat, of the lesser error itself where they do not.
    pub fn gain(&self, phi: &[f64], before: &DVector<f64>, after: &DVector<f64>) -> f64 {
        let fall = |joint: usize| {
            let [before, after] = [before, after].map(|theta| self.residual(joint, theta).norm_squared());
            let phi = &phi[group(joint, 0)..group(joint + 1, 0)];
            let scale = match self.evidence.repeats() {
                true => phi.iter().sum::<f64>() / phi.len() as f64,
                false => before.min(after) / self.evidence.per_joint() as f64,
            };
            (before - after) / scale.max(f64::MIN_POSITIVE)
        };
        (0..self.evidence.joints()).map(fall).sum()
    }

    /// Mean square of the torque that errors of the parameters with this covariance cause in a joint, in the lowest `bands` \[Nm2\].
    pub fn variance(&self, joint: usize, covariance: &DMatrix<f64>, bands: usize) -> f64 {
        let columns = self.columns.m[joint].columns(0, covariance.ncols());
        let mut spread = columns * covariance;
        spread.component_mul_assign(&columns);
        let sigma = self.evidence.sigma(joint);
        let square = |row: usize| spread.row(row).sum().max(0.0) * sigma[row] * sigma[row];
        self.evidence.rows_below(joint, bands).map(square).sum::<f64>() / self.evidence.samples()
    }

    /// Residuals of every joint under the known parameters, and under those of the identified runs and these together.
    pub fn residuals(&self, known: Known) -> Residuals {
        self.residuals_under(known.theta, &self.update(known).0)
    }

    /// The same of a state that was fitted to the problem's runs, with this over-dispersion.
    pub fn residuals_of(&self, problem: &Problem, state: &State, phi: &[f64]) -> Residuals {
        self.residuals_under(&state.fit.theta, &self.update_of(problem, state, phi).0)
    }

    fn residuals_under(&self, known: &DVector<f64>, updated: &DVector<f64>) -> Residuals {
        Residuals { known: self.residual_of_each(known), updated: self.residual_of_each(updated) }
    }

    /// Mean square of a residual above that of the noise, over that of the noise; nothing where that is not known.
    fn lack(&self, joint: usize, residual: &DVector<f64>) -> Option<f64> {
        let floor = self.evidence.floor(joint)?.powi(2);
        Some((mean_square(self.evidence, joint, residual) - floor).max(0.0) / floor)
    }

    /// The lack of a joint that counts.
    fn counting_lack(&self, joint: usize, residual: &DVector<f64>) -> Option<f64> {
        self.lack(joint, residual).filter(counts)
    }

    /// Share of one model's unmodelled power that another one removes, per joint; `None` where nothing was unmodelled or the noise is unknown.
    pub fn explained(&self, before: &Residuals, after: &Residuals) -> Vec<Option<f64>> {
        let share = |joint: usize| {
            let lack = self.counting_lack(joint, &before.updated[joint])?;
            Some(1.0 - self.lack(joint, &after.updated[joint])? / lack)
        };
        (0..self.evidence.joints()).map(share).collect()
    }

    /// What one model takes from another one's residuals, per joint; `None` where either the residual or what should be taken is too small, or the runs do
    /// not repeat.
    pub fn taken(&self, before: &Residuals, after: &Residuals) -> Vec<Option<Taken>> {
        let of_joint = |joint: usize| {
            let lack = self.counting_lack(joint, &before.updated[joint]).filter(|_| self.repeats)?;
            let floor = self.evidence.floor(joint)?;
            let right =
                mean_square(self.evidence, joint, &(&before.known[joint] - &after.known[joint])) / floor.powi(2);
            if !counts(&right) {
                return None;
            }
            let (fall, std) = self.fall(joint, &before.updated[joint], &after.updated[joint]);
            Some(Taken { right: right.min(lack), fall: fall / floor.powi(2), std: std / floor.powi(2) })
        };
        (0..self.evidence.joints()).map(of_joint).collect()
    }

    /// Fall of the mean square from one residual of a joint to another one, and its standard deviation where all of that is there \[Nm2\].
    ///
    /// With the residual `r` and its change `c` it is `2 c'r - c'c`, whose variance is `4 sum_b c_b'c_b s_b^2`: `s_b^2` is the mean square in each band of what
    /// of `r` is no multiple of `c`, noise and what else these runs have.
    fn fall(&self, joint: usize, before: &DVector<f64>, after: &DVector<f64>) -> (f64, f64) {
        let sigma = DVector::from_column_slice(self.evidence.sigma(joint));
        let [before, change] = [before.component_mul(&sigma), (before - after).component_mul(&sigma)];
        let square = change.norm_squared();
        let multiple = change.dot(&before) / square.max(f64::MIN_POSITIVE);
        let noise = &before - multiple * &change;
        let spread = |cell: &Cell| {
            let [change, noise] = [&change, &noise].map(|of| of.rows_range(cell.rows.clone()).norm_squared());
            change * noise / cell.rows.len() as f64
        };
        let variance: f64 = self.evidence.cells().iter().filter(|cell| cell.joint == joint).map(spread).sum();
        let samples = self.evidence.samples();
        ((2.0 * multiple - 1.0) * square / samples, 2.0 * variance.sqrt() / samples)
    }
}

/// Whether a mean square, over that of the noise, is as large as what counts.
fn counts(power: &f64) -> bool {
    *power > THRESHOLD_FLOOR_RATIO * THRESHOLD_FLOOR_RATIO
}

/// Residuals of a model, divided by the noise, per joint.
pub struct Residuals {
    /// Under the parameters that the identified runs give.
    pub known: Vec<DVector<f64>>,
    /// Under those of all runs.
    pub updated: Vec<DVector<f64>>,
}

/// What one model takes from another one's residual in a joint of runs that neither was fitted to: mean squares over that of the noise.
#[derive(Clone, Copy, Debug)]
pub struct Taken {
    /// What should fall: the change of the torque by what the identified runs tell, no more than the other model lacks.
    pub right: f64,
    /// What falls.
    pub fall: f64,
    /// Standard deviation of that.
    pub std: f64,
}

impl Taken {
    /// Share that falls of what should, if it is less than `least` beyond the noise.
    pub fn falls_short(self, least: f64) -> Option<f64> {
        (self.fall + DEVIATIONS * self.std < least * self.right).then_some(self.fall / self.right)
    }
}

#[cfg(test)]
mod tests;
