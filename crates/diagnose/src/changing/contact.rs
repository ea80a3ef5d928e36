//! Whether an event is a contact: a force at one point of a link, or a wrench on it, that moves all joints by the Jacobian.
//!
//!   tau = -J_l(q)' w(t)
//!
//! is what the actuators hold against a wrench `w` on the arm. `w` is continuous and piecewise linear (hat functions); `J_l` is that of a
//! point of link `l`. The event is a contact when this explains nearly all of it, and a Jacobian of the wrong pose does not: six numbers
//! explain much of seven torques whatever they are.
//! Source: Haddadin, De Luca and Albu-Schaeffer, Robot collisions: a survey on detection, isolation, and identification, T-RO 2017.

use super::record::Record;
use super::transient::Event;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Vector3};
use plumbline_model::{Chain, JointKind, Placement};

/// Time between knots \[s\].
const KNOT_SPACING_S: f64 = 0.1;
/// Largest number of knots.
const MAX_KNOTS: usize = 24;
/// Samples per knot.
const KNOT_SAMPLES: usize = 5;
/// Time before and after the event that is fitted too \[s\].
const MARGIN_S: f64 = 0.15;
/// Smallest share of an event's energy that a contact explains.
const MIN_EXPLAINED_RATIO: f64 = 0.9;
/// Smallest difference between that share and the share with a wrong pose.
const MIN_POSE_GAIN_RATIO: f64 = 0.05;
/// Explanations that differ by less are as good.
const SAME_LINK_RATIO: f64 = 0.02;
/// Rounds between force and point.
const MAX_ROUNDS: usize = 200;
/// Poses of the control, as shares of the period that they are away.
const SHIFTED_PERIOD_RATIOS: [f64; 3] = [0.25, 0.5, 0.75];
/// A point is at most so far from its link's frame \[m\].
const MAX_LEVER_M: f64 = 1.0;

/// A contact in one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// Name of the run.
    pub run: String,
    /// Begin, since the first sample of the run \[s\].
    pub from: f64,
    /// End \[s\].
    pub to: f64,
    /// Periods that it is in, from 0.
    pub periods: Vec<usize>,
    /// Link that is touched, from 0; it may be any link further out when their joints hardly feel it.
    pub link: usize,
    /// Where, in the link's frame \[m\]: along the line of a force that keeps its direction the nearest point to the frame. Nothing when
    /// a moment acts too.
    pub point: Option<Vector3<f64>>,
    /// Mean force on the arm in the base frame while it is more than half of its largest \[N\].
    pub force: Vector3<f64>,
    /// Its standard deviation \[N\].
    pub force_std: Vector3<f64>,
    /// Largest force \[N\].
    pub peak: f64,
    /// Mean moment on the arm about the origin of the link's frame, in the base frame \[Nm\].
    pub moment: Vector3<f64>,
    /// Share of the event's energy that it explains, beyond the noise.
    pub explained: f64,
    /// The same with wrong poses.
    pub control: f64,
}

/// Torques of an event, and where the arm was.
struct Data<'a> {
    chain: &'a Chain,
    /// Rows of the record.
    rows: Vec<usize>,
    /// What the wrench does, the opposite of the torques, over their noise, samples x n.
    tau: DMatrix<f64>,
    scale: &'a [f64],
    /// Weight of each knot at each sample: first knot, its weight; the next one has the rest.
    hats: Vec<(usize, f64)>,
    knots: usize,
}

/// A wrench of `width` components per knot that was fitted.
struct Wrench {
    width: usize,
    theta: DVector<f64>,
    factor: Cholesky<f64, Dyn>,
    rss: f64,
    parameters: f64,
}

/// What acts on a link.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Act {
    /// A force at a point of its frame.
    Force(Vector3<f64>),
    /// Force and moment at its origin.
    Wrench,
}

/// The contact that explains an event; `None` when none does. `x` are the deviations from the median, `scale` their noise.
pub(super) fn contact(
    chain: &Chain,
    record: &Record,
    x: &DMatrix<f64>,
    scale: &[f64],
    event: &Event,
) -> Option<Contact> {
    let data = Data::of(chain, record, x, scale, event);
    let pose = |away: usize| data.pose(record, away);
    let frames = pose(0);
    let mut tried: Vec<(f64, usize, Act, Wrench)> = Vec::new();
    for link in 0..chain.len() {
        let force = data.force(&frames, link);
        let wrench = data.fit(&frames, link, Act::Wrench).map(|fitted| (Act::Wrench, fitted));
        let both = [force, wrench].into_iter().flatten();
        tried.extend(both.map(|(act, fitted)| (data.explained(&fitted), link, act, fitted)));
    }
    // What explains as much with fewer numbers: the arm gives way a little and so has torques of its own, which a full wrench would take up.
    let most = tried.iter().map(|one| one.0).fold(0.0, f64::max);
    let near = tried.into_iter().filter(|one| one.0 >= most - SAME_LINK_RATIO);
    let order = |a: &(f64, usize, Act, Wrench), b: &(f64, usize, Act, Wrench)| {
        a.3.parameters.total_cmp(&b.3.parameters).then(b.0.total_cmp(&a.0))
    };
    let (explained, link, act, fitted) = near.min_by(order)?;
    let wrong = |share: &f64| {
        let frames = pose((share * record.samples as f64) as usize);
        data.fit(&frames, link, act).map_or(0.0, |fitted| data.explained(&fitted))
    };
    let mut wrong: Vec<f64> = SHIFTED_PERIOD_RATIOS.iter().map(wrong).collect();
    let control = super::record::median(&mut wrong);
    let accepted = explained >= MIN_EXPLAINED_RATIO && explained - control >= MIN_POSE_GAIN_RATIO;
    accepted.then(|| data.report(record, event, &frames, link, act, &fitted, [explained, control]))
}

impl Data<'_> {
    fn of<'a>(chain: &'a Chain, record: &Record, x: &DMatrix<f64>, scale: &'a [f64], event: &Event) -> Data<'a> {
        let margin = (MARGIN_S / record.dt).round() as usize;
        let (first, last) = (event.first.saturating_sub(margin), (event.last + margin).min(x.nrows()));
        let seconds = (last - first) as f64 * record.dt;
        let pieces = ((seconds / KNOT_SPACING_S).round() as usize).clamp(1, MAX_KNOTS - 1);
        let step = ((last - first) / (pieces * KNOT_SAMPLES)).max(1);
        let rows: Vec<usize> = (first..last).step_by(step).collect();
        let hat = |row: &usize| {
            let place = (row - first) as f64 / (last - first).max(1) as f64 * pieces as f64;
            let knot = (place as usize).min(pieces - 1);
            (knot, 1.0 - (place - knot as f64))
        };
        Data {
            chain,
            tau: DMatrix::from_fn(rows.len(), chain.len(), |k, j| -x[(rows[k], j)] / scale[j]),
            hats: rows.iter().map(hat).collect(),
            rows,
            scale,
            knots: pieces + 1,
        }
    }

    /// Frames of all links at every sample, with the pose of so many samples later in the period.
    fn pose(&self, record: &Record, away: usize) -> Vec<Vec<Placement>> {
        let frames = |row: &usize| {
            let mut placement = Placement::identity();
            let at = (row + away) % record.samples;
            let next = |(j, joint): (usize, &plumbline_model::Joint)| {
                placement = placement.then(&joint.placement(record.motion.q[(at, j)]));
                placement
            };
            self.chain.joints().iter().enumerate().map(next).collect()
        };
        self.rows.iter().map(frames).collect()
    }

    /// Rows of `J'` of a joint for force and moment at a point in the base frame; nothing beyond the link.
    fn transposed(&self, frames: &[Placement], link: usize, joint: usize, point: Vector3<f64>) -> [Vector3<f64>; 2] {
        if joint > link {
            return [Vector3::zeros(); 2];
        }
        let axis: Vector3<f64> = frames[joint].rotation.column(2).into();
        match self.chain.joints()[joint].kind {
            JointKind::Revolute => [axis.cross(&(point - frames[joint].origin)), axis],
            JointKind::Prismatic => [axis, Vector3::zeros()],
        }
    }

    /// Least squares of a force or a wrench with its knots.
    fn fit(&self, frames: &[Vec<Placement>], link: usize, act: Act) -> Option<Wrench> {
        let width = if act == Act::Wrench { 6 } else { 3 };
        let size = width * self.knots;
        let (mut g, mut b) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut row = DVector::zeros(2 * width);
        for (k, frames) in frames.iter().enumerate() {
            let point = self.point(&frames[link], act);
            let (knot, weight) = self.hats[k];
            for j in 0..=link {
                let [force, moment] = self.transposed(frames, link, j, point);
                for c in 0..width {
                    let value = if c < 3 { force[c] } else { moment[c - 3] } / self.scale[j];
                    (row[c], row[width + c]) = (weight * value, (1.0 - weight) * value);
                }
                let at = knot * width;
                g.view_mut((at, at), (2 * width, 2 * width)).ger(1.0, &row, &row, 1.0);
                b.rows_mut(at, 2 * width).axpy(self.tau[(k, j)], &row, 1.0);
            }
        }
        // A wrench that few joints feel is as small as it can be.
        let scale = g.diagonal().max();
        for k in 0..size {
            g[(k, k)] += 1e-9 * scale;
        }
        let factor = g.cholesky()?;
        let theta = factor.solve(&b);
        let rss = (self.tau.norm_squared() - b.dot(&theta)).max(0.0);
        let parameters = (width.min(link + 1) * self.knots) as f64 + if width == 3 { 3.0 } else { 0.0 };
        Some(Wrench { width, theta, factor, rss, parameters })
    }

    /// A force at the point of a link where it fits best: in turn the force for a point, and the point for a force.
    fn force(&self, frames: &[Vec<Placement>], link: usize) -> Option<(Act, Wrench)> {
        // From the frame's origin, or where the moments of a full wrench say; taking turns creeps, and a good start saves most of it.
        let at = |point| self.fit(frames, link, Act::Force(point)).map(|fitted| (Act::Force(point), fitted));
        let of_wrench = self.fit(frames, link, Act::Wrench).and_then(|wrench| self.lever(frames, link, &wrench));
        let starts = [Some(Vector3::zeros()), of_wrench].into_iter().flatten().filter_map(at);
        let (mut act, mut fitted) = starts.min_by(|a, b| a.1.rss.total_cmp(&b.1.rss))?;
        for _ in 0..MAX_ROUNDS {
            let Some(point) = self.best_point(frames, link, &fitted) else { break };
            let next = Act::Force(point);
            let Some(better) = self.fit(frames, link, next).filter(|better| better.rss < fitted.rss) else { break };
            let settled = fitted.rss - better.rss < 1e-5 * better.rss;
            (act, fitted) = (next, better);
            if settled {
                break;
            }
        }
        Some((act, fitted))
    }

    /// The point of a link, in its frame, about which a wrench has the least moment.
    fn lever(&self, frames: &[Vec<Placement>], link: usize, wrench: &Wrench) -> Option<Vector3<f64>> {
        let (mut g, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (k, frames) in frames.iter().enumerate() {
            // m = R p x f = -[f] R p.
            let (force, moment) = (self.at(wrench, k, 0), self.at(wrench, k, 1));
            let rows = -force.cross_matrix() * frames[link].rotation;
            g += rows.transpose() * rows;
            b += rows.transpose() * moment;
        }
        nearest(&g, &b)
    }

    /// The point of a link, in its frame, for which the moments of a known force fit best: `m = (R p) x f`.
    fn best_point(&self, frames: &[Vec<Placement>], link: usize, fitted: &Wrench) -> Option<Vector3<f64>> {
        let (mut g, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (k, frames) in frames.iter().enumerate() {
            let force = self.at(fitted, k, 0);
            let frame = &frames[link];
            for j in 0..=link {
                let [linear, angular] = self.transposed(frames, link, j, frame.origin);
                let rest = self.tau[(k, j)] - linear.dot(&force) / self.scale[j];
                // z . (R p x f) = p . R' (f x z).
                let row = frame.rotation.transpose() * force.cross(&angular) / self.scale[j];
                g += row * row.transpose();
                b += row * rest;
            }
        }
        nearest(&g, &b)
    }

    fn point(&self, frame: &Placement, act: Act) -> Vector3<f64> {
        match act {
            Act::Force(point) => frame.origin + frame.rotation * point,
            Act::Wrench => frame.origin,
        }
    }

    /// Force (`part` 0) or moment (`part` 1) at a sample.
    fn at(&self, fitted: &Wrench, sample: usize, part: usize) -> Vector3<f64> {
        if part * 3 >= fitted.width {
            return Vector3::zeros();
        }
        let (knot, weight) = self.hats[sample];
        let of = |knot: usize| fitted.theta.fixed_rows::<3>(knot * fitted.width + 3 * part).into_owned();
        of(knot) * weight + of(knot + 1) * (1.0 - weight)
    }

    /// Share of the squares beyond the noise.
    fn explained(&self, fitted: &Wrench) -> f64 {
        let count = self.tau.len() as f64;
        let before = self.tau.norm_squared() - count;
        let after = fitted.rss - (count - fitted.parameters).max(0.0);
        if before <= 0.0 { 0.0 } else { (1.0 - after.max(0.0) / before).clamp(0.0, 1.0) }
    }

    #[allow(clippy::too_many_arguments)]
    fn report(
        &self,
        record: &Record,
        event: &Event,
        frames: &[Vec<Placement>],
        link: usize,
        act: Act,
        fitted: &Wrench,
        [explained, control]: [f64; 2],
    ) -> Contact {
        let sizes: Vec<f64> = (0..self.rows.len()).map(|k| self.at(fitted, k, 0).norm()).collect();
        let peak = sizes.iter().copied().fold(0.0, f64::max);
        let strong: Vec<usize> = (0..sizes.len()).filter(|&k| sizes[k] > 0.5 * peak).collect();
        let share = 1.0 / strong.len().max(1) as f64;
        let (mut force, mut moment, mut force_std) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for &k in &strong {
            let now = self.at(fitted, k, 0);
            force += now * share;
            let arm = self.point(&frames[k][link], act) - frames[k][link].origin;
            moment += (self.at(fitted, k, 1) + arm.cross(&now)) * share;
        }
        for c in 0..3 {
            let mut weights = DVector::zeros(fitted.theta.len());
            for &k in &strong {
                let (knot, weight) = self.hats[k];
                weights[knot * fitted.width + c] += share * weight;
                weights[(knot + 1) * fitted.width + c] += share * (1.0 - weight);
            }
            force_std[c] = fitted.factor.solve(&weights).dot(&weights).sqrt();
        }
        let mut periods: Vec<usize> =
            (event.first..event.last).map(|row| record.repeats.periods[row / record.samples]).collect();
        periods.dedup();
        Contact {
            run: record.experiment.name.clone(),
            from: record.time(event.first),
            to: record.time(event.last - 1) + record.dt,
            periods,
            link,
            point: if let Act::Force(point) = act { Some(point) } else { None },
            force,
            force_std,
            peak,
            moment,
            explained,
            control,
        }
    }
}

/// The point that solves `g p = b` and is near the frame along what that leaves open: along the force nothing tells where it acts.
fn nearest(g: &Matrix3<f64>, b: &Vector3<f64>) -> Option<Vector3<f64>> {
    let least = 1e-4 * g.diagonal().max();
    let point = (g + Matrix3::identity() * least).try_inverse()? * b;
    Some(if point.norm() > MAX_LEVER_M { point * (MAX_LEVER_M / point.norm()) } else { point })
}
