//! Weighted fits, and how much likelihood a candidate brings.
//!
//! Rows are divided by their noise, so a complete model leaves a mean square of one in every joint and band. A missing effect
//! shows as an over-dispersion `phi = max(1, (RSS + v) / (n + v))` of that joint and band, and the profile log likelihood (Whittle's, with
//! `phi` put in its best place, and a prior as of `v` = 10 rows of nothing but noise) is
//!
//!   L = -1/2 sum_g [ (n_g + v) ln phi_g + (RSS_g + v) / phi_g ].
//!
//! `phi` is estimated again with every candidate: estimated before it, an offset would explain itself away. Without repeats the noise
//! has no known scale, `v` is 0 and `phi` is near `RSS / n`.

use super::evidence::{BAND_EDGES_HZ, Evidence, LOW_BANDS};
use super::moments::{GroupedCross, GroupedMoments, Moments};
use nalgebra::{DMatrix, DVector};
use plumbline_core::{parallel, symmetric_eigen, threads};
use std::ops::Range;

/// Directions of the equilibrated normal equations below this share of the largest are treated as undetermined.
const RANK_RATIO: f64 = 1e-11;
/// Rows that the whole joint counts for in each of its bands, where the noise is not known.
const POOLED_ROWS: f64 = 30.0;
/// Rows of nothing but noise that each band of a joint is taken to have besides its own, where the noise is known: a prior of its
/// over-dispersion. A band of few rows could explain what one effect did to it by over-dispersion otherwise.
const ROWS_OF_NOISE: f64 = 10.0;
/// Rounds of weights.
const MAX_WEIGHT_ROUNDS: usize = 12;
/// Change of their logarithm at which they have settled.
const SETTLED_LOG_RATIO: f64 = 0.02;
/// Fewer folds do not tell how they disagree.
pub(super) const MIN_FOLDS: usize = 3;

/// A Gaussian prior of the parameters: minus twice the log likelihood is `theta' precision theta`.
#[derive(Clone, Debug)]
pub struct Prior {
    /// Precision of the first parameters; the others are free.
    pub precision: DMatrix<f64>,
}

/// A model fitted to all folds.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Parameters.
    pub theta: DVector<f64>,
    /// Inverse of the weighted normal equations, the parameters' covariance.
    pub h: DMatrix<f64>,
    /// Over-dispersion used as weight of each group, joint by joint, then band by band; `h` belongs to these weights.
    pub weights: Vec<f64>,
    /// Over-dispersion of each group from its residual, to which the weights converged.
    pub phi: Vec<f64>,
    /// Squared residual of each group.
    pub rss: Vec<f64>,
    /// Log likelihood, with what the prior adds.
    pub likelihood: f64,
    /// What it was fitted to.
    pub sums: GroupedMoments,
    /// `M'(r - M theta)` of each group that has rows.
    slopes: Vec<Option<DVector<f64>>>,
}

/// What a candidate does to a fit.
#[derive(Clone, Debug)]
pub struct Gain {
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Its parameters.
    pub gamma: DVector<f64>,
    /// Change of the other parameters.
    pub shift: DVector<f64>,
    /// Share of its fitted torque that the other columns cannot represent, 0 to 1.
    pub independence: f64,
    /// Squared residual of each group with it.
    pub rss: Vec<f64>,
    /// By how much the weighed squared residual falls in the joints that were not looked at, where it was told to look at some.
    pub elsewhere: f64,
}

/// Group of a cell.
pub fn group(joint: usize, band: usize) -> usize {
    joint * BAND_EDGES_HZ.len() + band
}

/// A fit without the sums that it came from.
pub(super) struct Estimate {
    theta: DVector<f64>,
    h: DMatrix<f64>,
    weights: Vec<f64>,
    phi: Vec<f64>,
    /// See [`Fit::rss`].
    pub rss: Vec<f64>,
    likelihood: f64,
}

impl Estimate {
    fn into_fit(self, sums: GroupedMoments) -> Fit {
        let Estimate { theta, h, weights, phi, rss, likelihood } = self;
        let slope = |(g, b): &(DMatrix<f64>, DVector<f64>)| b - g * &theta;
        let slopes = sums.groups.iter().map(|own| own.as_ref().map(slope)).collect();
        Fit { theta, h, weights, phi, rss, likelihood, sums, slopes }
    }
}

/// A model, its data and how its noise is known.
#[derive(Clone, Copy)]
pub struct Problem<'a> {
    /// The evidence.
    pub evidence: &'a Evidence,
    /// What is known of the parameters.
    pub prior: Option<&'a Prior>,
}

impl Problem<'_> {
    fn groups(&self) -> usize {
        self.evidence.joints() * BAND_EDGES_HZ.len()
    }

    /// Over-dispersion of groups.
    ///
    /// Without repeats it is drawn towards that of the whole joint: a band of few rows could be fitted to the last bit otherwise, and
    /// then would weigh more than all others.
    fn phi(&self, rss: &[f64], sums: &GroupedMoments) -> Vec<f64> {
        let GroupedMoments { count, most, .. } = sums;
        if self.evidence.repeats() {
            let of = |(rss, count): (&f64, &f64)| ((rss + ROWS_OF_NOISE) / (count + ROWS_OF_NOISE)).max(1.0);
            return rss.iter().zip(count).map(of).zip(most).map(|(phi, most)| phi.min(*most)).collect();
        }
        let mut phi = Vec::with_capacity(rss.len());
        for (rss, count) in rss.chunks(BAND_EDGES_HZ.len()).zip(count.chunks(BAND_EDGES_HZ.len())) {
            let mean = rss.iter().sum::<f64>() / count.iter().sum::<f64>().max(1.0);
            let drawn = |(rss, count): (&f64, &f64)| ((rss + POOLED_ROWS * mean) / (count + POOLED_ROWS)).max(1e-12);
            phi.extend(rss.iter().zip(count).map(drawn));
        }
        phi
    }

    /// What the prior adds to the log likelihood: `-1/2 theta' precision theta`.
    fn of_prior(&self, theta: &DVector<f64>) -> f64 {
        let Some(prior) = self.prior else { return 0.0 };
        let known = theta.rows(0, prior.precision.nrows());
        -0.5 * (&prior.precision * known).dot(&known)
    }

    /// What the prior adds to normal equations.
    fn add_prior(&self, g: &mut DMatrix<f64>) {
        if let Some(prior) = self.prior {
            let known = prior.precision.nrows();
            let mut block = g.view_mut((0, 0), (known, known));
            block += &prior.precision;
        }
    }

    /// Profile log likelihood of squared residuals, without what the prior adds.
    pub fn likelihood(&self, rss: &[f64], sums: &GroupedMoments) -> f64 {
        let (phi, count) = (self.phi(rss, sums), &sums.count);
        let known = if self.evidence.repeats() { ROWS_OF_NOISE } else { 0.0 };
        let group = |((rss, count), phi): ((&f64, &f64), &f64)| (count + known) * phi.ln() + (rss + known) / phi;
        -0.5 * rss.iter().zip(count).zip(&phi).map(group).sum::<f64>()
    }

    /// Fits a model. The weights settle from `phi` on, and where the noise is known once more from that of the noise alone: a model
    /// that lacked much has no weight left where it did, and settles there although it lacks nothing any more. The likelier fit is taken.
    pub fn fit(&self, sums: GroupedMoments, phi: Option<&[f64]>) -> Fit {
        let ones = vec![1.0; self.groups()];
        let mut best = self.settled(&sums, phi.unwrap_or(&ones));
        if phi.is_some() && self.evidence.repeats() {
            let afresh = self.settled(&sums, &ones);
            if afresh.likelihood > best.likelihood {
                best = afresh;
            }
        }
        best.into_fit(sums)
    }

    /// The fit of a model with one more candidate.
    pub fn fit_with(&self, fit: &Fit, cross: &GroupedCross) -> Fit {
        self.fit(fit.sums.with(cross), Some(&fit.phi))
    }

    /// The fit of a model without some of its columns.
    pub fn fit_without(&self, fit: &Fit, gone: Range<usize>) -> Fit {
        self.fit(fit.sums.without(gone), Some(&fit.phi))
    }

    fn settled(&self, sums: &GroupedMoments, phi: &[f64]) -> Estimate {
        let mut fit = self.estimate(sums, phi);
        for _ in 1..MAX_WEIGHT_ROUNDS {
            let settled = |(new, old): (&f64, &f64)| (new / old).ln().abs() < SETTLED_LOG_RATIO;
            if fit.phi.iter().zip(&fit.weights).all(settled) {
                break;
            }
            fit = self.estimate(sums, &fit.phi);
        }
        fit
    }

    /// One fit with given weights.
    pub fn weighted(&self, sums: GroupedMoments, phi: &[f64]) -> Fit {
        self.estimate(&sums, phi).into_fit(sums)
    }

    /// The same model with the weight of its quietest band in all bands of a joint. A joint in which the model lacks much has no weight of its own, and
    /// may be the only one that tells a candidate from the other columns.
    pub fn quiet(&self, fit: &Fit) -> Fit {
        let least = |bands: &[f64]| vec![bands.iter().copied().fold(f64::INFINITY, f64::min); bands.len()];
        let phi: Vec<f64> = fit.weights.chunks(BAND_EDGES_HZ.len()).flat_map(least).collect();
        self.weighted(fit.sums.clone(), &phi)
    }

    /// One fit with given weights, without its sums.
    pub(super) fn estimate(&self, sums: &GroupedMoments, phi: &[f64]) -> Estimate {
        let p = sums.width;
        let (mut g, mut b) = (DMatrix::zeros(p, p), DVector::zeros(p));
        for (own, phi) in sums.groups.iter().zip(phi) {
            if let Some((own_g, own_b)) = own {
                g.zip_apply(own_g, |sum, own| *sum += own / phi);
                b.axpy(1.0 / phi, own_b, 1.0);
            }
        }
        self.add_prior(&mut g);
        let h = inverse(&g);
        let theta = &h * b;
        let mut rss = sums.r2.clone();
        for (rss, own) in rss.iter_mut().zip(&sums.groups) {
            if let Some((own_g, own_b)) = own {
                let fitted = own_g * &theta;
                *rss = (*rss - 2.0 * theta.dot(own_b) + fitted.dot(&theta)).max(0.0);
            }
        }
        let weights = phi.to_vec();
        let phi = self.phi(&rss, sums);
        let likelihood = self.likelihood(&rss, sums) + self.of_prior(&theta);
        Estimate { theta, h, weights, phi, rss, likelihood }
    }

    /// Normal equations of each fold under given weights, and its weighed square of the torques.
    fn of_folds(&self, moments: &Moments, phi: &[f64]) -> Vec<(DMatrix<f64>, DVector<f64>, f64)> {
        let p = moments.width;
        let mut folds = vec![(DMatrix::zeros(p, p), DVector::zeros(p), 0.0); self.evidence.folds().len()];
        for (cell, own) in self.evidence.cells().iter().zip(&moments.cells) {
            let weight = 1.0 / phi[group(cell.joint, cell.band)];
            let (g, b, r2) = &mut folds[cell.fold];
            g.zip_apply(&own.g, |sum, own| *sum += weight * own);
            b.axpy(weight, &own.b, 1.0);
            *r2 += weight * own.r2;
        }
        folds
    }

    /// Normal equations of all folds together, with what the prior adds, and the weighed square of the torques.
    fn of_all(&self, folds: &[(DMatrix<f64>, DVector<f64>, f64)], width: usize) -> (DMatrix<f64>, DVector<f64>, f64) {
        let (mut g, mut b, mut r2) = (DMatrix::zeros(width, width), DVector::zeros(width), 0.0);
        self.add_prior(&mut g);
        for (own_g, own_b, own_r2) in folds {
            g += own_g;
            b += own_b;
            r2 += own_r2;
        }
        (g, b, r2)
    }

    /// Parameters that all folds but one determine, under given weights, for each fold in turn.
    pub fn left_out(&self, moments: &Moments, phi: &[f64]) -> Vec<DVector<f64>> {
        let folds = self.of_folds(moments, phi);
        let (g, b, _) = self.of_all(&folds, moments.width);
        parallel(&folds, threads(), |(own_g, own_b, _)| inverse(&(&g - own_g)) * (&b - own_b))
    }

    /// Covariance of a fit's parameters by how the folds disagree about them, zero where fewer than three tell it: `F / (F - 1) sum_f e_f e_f'` with
    /// `e_f = H (b_f - G_f theta)`, what the fold's normal equations move the estimate by (White, Econometrica 48, 1980). Blocks of one run that follow each other
    /// count together, with Bartlett's weight of one lag.
    pub fn spread_of_folds(&self, moments: &Moments, fit: &Fit) -> DMatrix<f64> {
        let mut spread = DMatrix::zeros(moments.width, moments.width);
        let folds = self.of_folds(moments, &fit.weights);
        if folds.len() < MIN_FOLDS {
            return spread;
        }
        let moved: Vec<DVector<f64>> = folds.iter().map(|(g, b, _)| &fit.h * (b - g * &fit.theta)).collect();
        let run = |fold: usize| self.evidence.folds()[fold].experiment;
        for (fold, own) in moved.iter().enumerate() {
            spread.ger(1.0, own, own, 1.0);
            if fold > 0 && !self.evidence.repeats() && run(fold) == run(fold - 1) {
                spread.ger(0.5, own, &moved[fold - 1], 1.0);
                spread.ger(0.5, &moved[fold - 1], own, 1.0);
            }
        }
        spread * (folds.len() as f64 / (folds.len() - 1) as f64)
    }

    /// How little each fold is expected of the others, under given weights: minus twice the log of its predictive density but for a constant,
    /// the increase of the least weighed squared residual by the fold. Parameters that the other folds do not determine cost nothing in it, as
    /// they would in the error of parameters that are fitted without the fold.
    pub fn surprise(&self, moments: &Moments, phi: &[f64]) -> Vec<f64> {
        let folds = self.of_folds(moments, phi);
        let (g, b, r2) = self.of_all(&folds, moments.width);
        // Errors of the inverse are squared in this form, and are not in `r2 - theta . b`.
        let least = |g: &DMatrix<f64>, b: &DVector<f64>, r2: f64| {
            let theta = inverse(g) * b;
            r2 - 2.0 * theta.dot(b) + (g * &theta).dot(&theta)
        };
        let all = least(&g, &b, r2);
        let surprise = |(own_g, own_b, own_r2): &(_, _, _)| all - least(&(&g - own_g), &(&b - own_b), r2 - own_r2);
        parallel(&folds, threads(), surprise)
    }

    /// The weighted normal equations of all folds, with what the prior adds: the inverse of a fit's `h` where they have full rank.
    pub fn information(&self, moments: &Moments, phi: &[f64]) -> DMatrix<f64> {
        let mut g = DMatrix::zeros(moments.width, moments.width);
        for (cell, own) in self.evidence.cells().iter().zip(&moments.cells) {
            let weight = 1.0 / phi[group(cell.joint, cell.band)];
            g.zip_apply(&own.g, |sum, own| *sum += weight * own);
        }
        self.add_prior(&mut g);
        g
    }

    /// What a candidate would bring to a fit of all folds, with the weights of that fit. With `joints`, the other joints are taken as if nothing
    /// changed there, which is quicker.
    pub fn gain(&self, fit: &Fit, cross: &GroupedCross, joints: Option<&[usize]>) -> Option<Gain> {
        let (p, l) = (fit.theta.len(), cross.width);
        let (mut a, mut c, mut d) = (DMatrix::zeros(p, l), DMatrix::zeros(l, l), DVector::zeros(l));
        for (group, own) in &cross.groups {
            let weight = 1.0 / fit.weights[*group];
            a.zip_apply(&own.a, |sum, own| *sum += weight * own);
            c.zip_apply(&own.c, |sum, own| *sum += weight * own);
            d.axpy(weight, &own.d, 1.0);
        }
        let ha = &fit.h * &a;
        let alone = &c - a.tr_mul(&ha);
        let slope = d - a.tr_mul(&fit.theta);
        let gamma = inverse_of_least(&alone, &c, least_independence(cross.exact))? * &slope;
        let shift = -(ha * &gamma);
        let whole = (&c * &gamma).dot(&gamma);
        let independence = (&alone * &gamma).dot(&gamma) / whole.max(f64::MIN_POSITIVE);
        let rss = self.changed(fit, cross, joints, &gamma, &shift);
        let likelihood = self.likelihood(&rss, &fit.sums) + self.of_prior(&(&fit.theta + &shift));
        let evidence = 2.0 * (likelihood - fit.likelihood);
        let falls = fit.rss.iter().zip(&rss).zip(&fit.weights).map(|((before, after), phi)| (before - after) / phi);
        let elsewhere = slope.dot(&gamma) - falls.sum::<f64>();
        Some(Gain { evidence, gamma, shift, independence, rss, elsewhere })
    }

    /// Share of a candidate's first column that the other columns cannot represent.
    pub fn own_share(&self, fit: &Fit, cross: &GroupedCross) -> Option<f64> {
        let mut a = DVector::zeros(fit.theta.len());
        let mut c = 0.0;
        for (group, own) in &cross.groups {
            let weight = 1.0 / fit.weights[*group];
            a.axpy(weight, &own.a.column(0), 1.0);
            c += weight * own.c[(0, 0)];
        }
        (c > 0.0).then(|| ((c - (&fit.h * &a).dot(&a)) / c).clamp(0.0, 1.0))
    }

    /// Squared residuals after the parameters moved by `shift` and the candidate came in with `gamma`.
    fn changed(
        &self,
        fit: &Fit,
        cross: &GroupedCross,
        joints: Option<&[usize]>,
        gamma: &DVector<f64>,
        shift: &DVector<f64>,
    ) -> Vec<f64> {
        let mut rss = fit.rss.clone();
        for (at, (own, slope)) in fit.sums.groups.iter().zip(&fit.slopes).enumerate() {
            let counts = joints.is_none_or(|joints| joints.contains(&(at / BAND_EDGES_HZ.len())));
            if let Some(((g, _), slope)) = own.as_ref().zip(slope.as_ref()).filter(|_| counts) {
                rss[at] += (g * shift).dot(shift) - 2.0 * slope.dot(shift);
            }
        }
        let theta = &fit.theta + shift;
        for (group, own) in &cross.groups {
            rss[*group] += (&own.c * gamma).dot(gamma) - 2.0 * (own.d.dot(gamma) - own.a.tr_mul(&theta).dot(gamma));
        }
        rss.iter_mut().for_each(|value| *value = value.max(0.0));
        rss
    }

    /// Squared residual of each joint in one fold under parameters that were fitted elsewhere: weighed by `phi`, as it is, and in the low bands alone.
    pub fn of_fold(&self, moments: &Moments, theta: &DVector<f64>, fold: usize, phi: &[f64]) -> Vec<[f64; 3]> {
        let mut errors = vec![[0.0; 3]; self.evidence.joints()];
        for (cell, own) in self.evidence.cells().iter().zip(&moments.cells).filter(|(cell, _)| cell.fold == fold) {
            let rss = (own.r2 - 2.0 * theta.dot(&own.b) + (&own.g * theta).dot(theta)).max(0.0);
            errors[cell.joint][0] += rss / phi[group(cell.joint, cell.band)];
            errors[cell.joint][1] += rss;
            errors[cell.joint][2] += if cell.band < LOW_BANDS { rss } else { 0.0 };
        }
        errors
    }
}

/// Inverse of a symmetric matrix after its diagonal was made one, on the directions that it determines; none where it is not finite.
pub fn inverse(g: &DMatrix<f64>) -> DMatrix<f64> {
    let scale: Vec<f64> = g.diagonal().iter().map(|d| if *d > 0.0 { 1.0 / d.sqrt() } else { 0.0 }).collect();
    let scaled = DMatrix::from_fn(g.nrows(), g.ncols(), |i, k| g[(i, k)] * scale[i] * scale[k]);
    // The usual case has full rank.
    let well = scaled.clone().cholesky().filter(|factor| {
        let diagonal = factor.l_dirty().diagonal();
        diagonal.min() > RANK_RATIO.sqrt() * diagonal.max()
    });
    let inverse = match well {
        Some(factor) => factor.inverse(),
        None => {
            let Some(eigen) = symmetric_eigen(scaled) else { return DMatrix::zeros(g.nrows(), g.ncols()) };
            let least = RANK_RATIO * eigen.eigenvalues.max();
            let weighted = DMatrix::from_fn(g.nrows(), g.ncols(), |i, k| {
                let value = eigen.eigenvalues[k];
                if value > least { eigen.eigenvectors[(i, k)] / value } else { 0.0 }
            });
            weighted * eigen.eigenvectors.transpose()
        }
    };
    DMatrix::from_fn(g.nrows(), g.ncols(), |i, k| inverse[(i, k)] * scale[i] * scale[k])
}

/// Inverse of the Schur complement `alone` of a candidate's normal equations `c`, on its directions with an independence above the `least`; `None` without any.
fn inverse_of_least(alone: &DMatrix<f64>, c: &DMatrix<f64>, least: f64) -> Option<DMatrix<f64>> {
    let l = c.nrows();
    let scale: Vec<f64> = c.diagonal().iter().map(|d| if *d > 0.0 { 1.0 / d.sqrt() } else { 0.0 }).collect();
    let scaled = DMatrix::from_fn(l, l, |i, k| alone[(i, k)] * scale[i] * scale[k]);
    let eigen = symmetric_eigen(scaled)?;
    let weighted = DMatrix::from_fn(l, l, |i, k| {
        let value = eigen.eigenvalues[k];
        if value > least { eigen.eigenvectors[(i, k)] / value } else { 0.0 }
    });
    let inverse = weighted * eigen.eigenvectors.transpose();
    let found = eigen.eigenvalues.iter().any(|value| *value > least);
    found.then(|| DMatrix::from_fn(l, l, |i, k| inverse[(i, k)] * scale[i] * scale[k]))
}

/// Smallest share of a candidate's square that the other columns may leave in an identifiable direction.
pub const MIN_INDEPENDENCE_RATIO: f64 = 1e-3;
/// The same of columns that are [exact](super::rows::Rows::exact).
const MIN_INDEPENDENCE_RATIO_OF_EXACT: f64 = 1e-4;

/// The one or the other.
pub const fn least_independence(exact: bool) -> f64 {
    if exact { MIN_INDEPENDENCE_RATIO_OF_EXACT } else { MIN_INDEPENDENCE_RATIO }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_exact_columns_a_ten_thousandth_has_to_be_independent_of_others_a_thousandth() {
        let whole = DMatrix::from_diagonal_element(1, 1, 8.0);
        let found = |exact: bool, share: f64| inverse_of_least(&(share * &whole), &whole, least_independence(exact));
        assert!(found(false, 0.9e-3).is_none() && found(true, 0.9e-4).is_none());
        for (exact, share) in [(false, 1.1e-3), (true, 1.1e-4)] {
            assert!((found(exact, share).unwrap()[(0, 0)] * 8.0 * share - 1.0).abs() < 1e-12);
        }
    }
}
