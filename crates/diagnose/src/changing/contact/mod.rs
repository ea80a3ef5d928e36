//! Whether an event is a contact: a force at one point of a link, or a wrench on it, that moves all joints by the Jacobian.
//!
//!   tau = -J_l(q)' w(t)
//!
//! is what the actuators hold against a wrench `w` on the arm; `J_l` is that of a point of link `l`. The event is a contact when this explains
//! nearly all that a course of its own in each joint does, and better for its number of parameters than these and than a base that moves.
//! Source: Haddadin, De Luca and Albu-Schaeffer, Robot collisions: a survey on detection, isolation, and identification, T-RO 2017.

mod course;
mod noise;
mod push;
mod rivals;

pub(super) use noise::Noise;

use super::EVENT_MARGIN_S;
use super::base_motion::gravity_columns;
use super::record::{Record, blocks};
use super::transient::{self, Event};
use crate::select::MAX_RIVAL_SCORE_GAP;
use course::{Course, Normal, SETTLED_RATIO, Torques};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline_model::term::effect::OperatingPoint;
use plumbline_model::{Chain, JointKind, Placement};
use rivals::Rivals;

/// Smallest difference of a contact's score to that of what is no contact, by what other periods are. Noise alone reaches 3.
pub(super) const MIN_GAP: f64 = 12.0;
/// Time between the knots of a contact's course \[s\].
const KNOT_SPACING_S: f64 = 0.1;
/// Largest number of knots.
const MAX_KNOTS: usize = 24;
/// Torques are averaged over this time \[s\]: where friction reverses, periods differ faster than a contact does.
const BLOCK_S: f64 = 0.05;
/// Largest number of means in an event; over a longer one more of the torques are averaged.
const MAX_BLOCKS: usize = 96;
/// What a course with a knot every tenth of a second lacks of a push that begins at once, as a share of the RMS torque of a joint: noise of its own in each
/// block.
const COURSE_ERROR_RATIO: f64 = 0.1;
/// Median deviations from the median energy that make a second stand out as what may be a contact.
const MIN_ENERGY_DEVIATIONS: f64 = 10.0;
/// Time before and after the event that is fitted too \[s\].
pub(super) const MARGIN_S: f64 = 0.15;
/// Smallest share that a contact explains of what courses of torque in each joint do.
const MIN_EXPLAINED_RATIO: f64 = 0.9;
/// Largest energy of what swings faster than a course, as a share of what courses explain: a push stirs up less than itself.
const MAX_STIRRED_RATIO: f64 = 0.5;
/// So many deviations of the noise's squares are not counted as unexplained.
const NOISE_DEVIATIONS: f64 = 2.0;
/// Explanations that differ by less are as good.
const SAME_LINK_RATIO: f64 = 0.02;
/// Largest number of rounds between course and point.
const MAX_ROUNDS: usize = 200;
/// Smallest force of a contact at its peak \[N\]: a ribbon that hangs down has more.
const MIN_PEAK_N: f64 = 0.2;
/// Where a search for the point starts beside the frame's origin: so far along each of its axes \[m\].
const START_LEVER_M: f64 = 0.1;
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
    /// Share that it explains, within the noise, of what a course of torque of its own in each joint does.
    pub explained: f64,
    /// By how much its score is better than that of what is no contact.
    pub gap: f64,
    /// Whether it is there when the run begins, and when it ends.
    pub at_ends: [bool; 2],
    /// Times of the torques, since the first sample of the run \[s\].
    times: Vec<f64>,
    /// What it adds to the torques at these times, blocks x n \[Nm\].
    tau: DMatrix<f64>,
}

impl Contact {
    /// What it adds to the torque of a joint at a time \[s\] of its run \[Nm\].
    pub fn torque(&self, joint: usize, t: f64) -> f64 {
        let next = self.times.partition_point(|time| *time <= t);
        if next == 0 || next == self.times.len() {
            return 0.0;
        }
        let share = (t - self.times[next - 1]) / (self.times[next] - self.times[next - 1]);
        (1.0 - share) * self.tau[(next - 1, joint)] + share * self.tau[(next, joint)]
    }
}

/// Torques of an event, and where the arm was.
struct Data<'a> {
    chain: &'a Chain,
    torques: Torques,
    /// Sum of squares that the noise makes of the torques, their number.
    independent: f64,
    /// Row of the record in the middle of each block.
    rows: Vec<usize>,
    /// Frames of all links at each block.
    frames: Vec<Vec<Placement>>,
    /// Numbers of a course of its own in each joint.
    numbers: f64,
    /// What these courses leave.
    left: f64,
}

/// What acts on a link.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Act {
    /// A force at a point of its frame that keeps its direction in the base frame.
    Push(Vector3<f64>),
    /// Any force at a point of its frame.
    Force(Vector3<f64>),
    /// Force and moment at its origin.
    Wrench,
}

/// An explanation that was fitted.
struct Fitted {
    link: usize,
    act: Act,
    course: Course,
    parameters: f64,
    explained: f64,
}

/// Rows of a block.
fn block(record: &Record) -> usize {
    ((BLOCK_S / record.dt).round() as usize).clamp(1, record.tau.nrows())
}

/// What may be a contact beside the events that are known: it stands out less, and is one only where a contact explains it.
pub(super) fn candidates(record: &Record, x: &DMatrix<f64>, known: &[Event]) -> Vec<Event> {
    let length = block(record);
    let dt = length as f64 * record.dt;
    let events = transient::events(&blocks(x, length), dt, MIN_ENERGY_DEVIATIONS);
    let of_rows = |event: Event| Event { first: event.first * length, last: event.last * length, ..event };
    let meets = |event: &Event, other: &Event| event.first < other.last && other.first < event.last;
    let apart = |event: &Event| !known.iter().any(|other| meets(event, other));
    events.into_iter().map(of_rows).filter(apart).collect()
}

/// Deviations in which a contact may show, zero where [`Record::hides`].
pub(super) fn visible(record: &Record, x: &DMatrix<f64>) -> DMatrix<f64> {
    let shown = |row: usize, joint: usize| if record.hides(row, joint) { 0.0 } else { x[(row, joint)] };
    DMatrix::from_fn(x.nrows(), x.ncols(), shown)
}

/// The contact that explains an event by this difference of its score to that of what is no contact at `least`; `None` when none does. `x` are deviations
/// from what the torques would be without it.
pub(super) fn contact(
    operating_point: &OperatingPoint,
    record: &Record,
    x: &DMatrix<f64>,
    noise: &Noise,
    event: &Event,
    least: f64,
) -> Option<Contact> {
    let (data, rivals) = Data::beside_rivals(operating_point, record, x, noise, event);
    let mut tried: Vec<Fitted> = (0..data.chain.len()).flat_map(|link| data.tried(link)).collect();
    let most = tried.iter().map(|one| one.explained).fold(0.0, f64::max);
    tried.retain(|one| one.explained >= MIN_EXPLAINED_RATIO);
    // What explains as much with fewer numbers: the arm gives way a little and so has torques of its own, which a full wrench would take up. Of links the
    // innermost: what touches one further out shows in its joints, too.
    let far = |one: &Fitted| one.explained < most - SAME_LINK_RATIO;
    let smallest = |like: &Fitted| {
        let alike = tried.iter().filter(|one| one.act.rank() == like.act.rank() && !far(one));
        alike.map(|one| one.course.rss).fold(f64::INFINITY, f64::min)
    };
    let place =
        |one: &Fitted| (far(one), one.act.rank(), one.course.rss > smallest(one) + MAX_RIVAL_SCORE_GAP, one.link);
    let places: Vec<_> = tried.iter().map(place).collect();
    let mut ordered: Vec<_> = places.into_iter().zip(tried).collect();
    ordered.sort_by_key(|(place, _)| *place);
    let reported = |(_, one)| {
        let gap = data.gap(&rivals, &one);
        (gap >= least).then(|| data.report(record, event, &one, gap)).flatten()
    };
    ordered.into_iter().find_map(reported)
}

/// Largest difference of a contact's score to that of what is no contact, whatever else happens in the event.
pub(super) fn largest_gap(
    operating_point: &OperatingPoint,
    record: &Record,
    x: &DMatrix<f64>,
    noise: &Noise,
    event: &Event,
) -> f64 {
    let (data, rivals) = Data::beside_rivals(operating_point, record, x, noise, event);
    let acts = (0..data.chain.len()).flat_map(|link| data.acts(link, data.fit(link, Act::Wrench)));
    acts.map(|one| data.gap(&rivals, &one)).fold(f64::NEG_INFINITY, f64::max)
}

impl Data<'_> {
    fn beside_rivals<'a>(
        operating_point: &'a OperatingPoint,
        record: &Record,
        x: &DMatrix<f64>,
        noise: &Noise,
        event: &Event,
    ) -> (Data<'a>, Rivals) {
        let data = Data::of(&operating_point.chain, record, x, noise, event);
        let rivals = data.rivals(record, &gravity_columns(&record.motion, &operating_point.load));
        (Data { left: rivals.left(), ..data }, rivals)
    }

    fn of<'a>(chain: &'a Chain, record: &Record, x: &DMatrix<f64>, noise: &Noise, event: &Event) -> Data<'a> {
        let margin = (MARGIN_S / record.dt).round() as usize;
        let (first, last) = (event.first.saturating_sub(margin), (event.last + margin).min(x.nrows()));
        let seconds = (last - first) as f64 * record.dt;
        let pieces = ((seconds / KNOT_SPACING_S).round() as usize).clamp(1, MAX_KNOTS - 1);
        let length = block(record).max((last - first).div_ceil(MAX_BLOCKS)).min(last - first);
        let begins: Vec<usize> = (first..=last - length).step_by(length).collect();
        let middle = |begin: &usize| *begin as f64 + 0.5 * (length - 1) as f64;
        let hat = |begin: &usize| {
            let place = (middle(begin) - first as f64) / (last - first) as f64 * pieces as f64;
            let knot = (place as usize).min(pieces - 1);
            (knot, 1.0 - (place - knot as f64))
        };
        let visible = |joint: usize| {
            let shows = |k: &usize| !(begins[*k]..begins[*k] + length).any(|row| record.hides(row, joint));
            (0..begins.len()).filter(shows).collect::<Vec<usize>>()
        };
        let visible: Vec<Vec<usize>> = (0..chain.len()).map(visible).collect();
        let mean = |k: usize, j: usize| -x.view((begins[k], j), (length, 1)).sum() / length as f64;
        let tau = DMatrix::from_fn(begins.len(), chain.len(), mean);
        let weights = noise.of_blocks(length, &(first..last)).into_iter().zip(&visible).zip(tau.column_iter());
        let weights = weights.map(|((parts, visible), tau)| {
            let square: f64 = visible.iter().map(|block| tau[*block].powi(2)).sum();
            parts.weights(begins.len(), visible, COURSE_ERROR_RATIO.powi(2) * square / visible.len().max(1) as f64)
        });
        let weights = weights.collect();
        let rows: Vec<usize> = begins.iter().map(|begin| middle(begin) as usize).collect();
        let frames = |row: &usize| {
            let mut placement = Placement::identity();
            let next = |(j, joint): (usize, &plumbline_model::Joint)| {
                placement = placement.then(&joint.placement(record.motion.q[(row % record.samples, j)]));
                placement
            };
            chain.joints().iter().enumerate().map(next).collect()
        };
        Data {
            chain,
            torques: Torques { tau, weights, hats: begins.iter().map(hat).collect(), knots: pieces + 1 },
            frames: rows.iter().map(frames).collect(),
            rows,
            independent: visible.iter().map(Vec::len).sum::<usize>() as f64,
            numbers: visible.iter().map(|own| own.len().min(pieces + 1)).sum::<usize>() as f64,
            left: 0.0,
        }
    }

    /// What may act on a link.
    fn tried(&self, link: usize) -> Vec<Fitted> {
        let wrench = self.fit(link, Act::Wrench);
        // A force leaves no less than a wrench, and has at least as many parameters as one that keeps its direction.
        let limit = wrench.as_ref().map_or(1.0, |wrench| self.explained(wrench.course.rss, self.of_push(link)));
        if limit < MIN_EXPLAINED_RATIO { Vec::new() } else { self.acts(link, wrench) }
    }

    /// What may act on a link beside this wrench.
    fn acts(&self, link: usize, wrench: Option<Fitted>) -> Vec<Fitted> {
        // Taking turns creeps, and a good start saves most of it: the frame's origin, or where the moments of a full wrench say. At an origin on all axes
        // that move it no force shows.
        let mut starts = vec![Vector3::zeros()];
        starts.extend(wrench.as_ref().and_then(|wrench| self.lever(wrench)));
        starts.extend((0..3).map(|axis| Vector3::ith(axis, START_LEVER_M)));
        let force = self.at_best_point(link, &starts);
        starts.extend(force.as_ref().and_then(|force| force.act.point()));
        let of_start = |point: &Vector3<f64>| self.settled(&self.fit(link, Act::Push(*point))?);
        let push = starts.iter().filter_map(of_start).min_by(|a, b| a.course.rss.total_cmp(&b.course.rss));
        [push, force, wrench].into_iter().flatten().collect()
    }

    /// A force at the point of a link where it fits best: in turn the force for a point, and the point for a force.
    fn at_best_point(&self, link: usize, starts: &[Vector3<f64>]) -> Option<Fitted> {
        let fit = |point: &Vector3<f64>| self.fit(link, Act::Force(*point));
        let mut best = starts.iter().filter_map(fit).min_by(|a, b| a.course.rss.total_cmp(&b.course.rss))?;
        for _ in 0..MAX_ROUNDS {
            let better = self.best_point(&best).and_then(|point| fit(&point));
            let Some(better) = better.filter(|better| better.course.rss < best.course.rss) else { break };
            let settled = best.course.rss - better.course.rss < SETTLED_RATIO * better.course.rss;
            best = better;
            if settled {
                break;
            }
        }
        Some(best)
    }

    fn fit(&self, link: usize, act: Act) -> Option<Fitted> {
        let columns = self.columns(link, act);
        let free = self.torques.fit(&columns, false)?;
        // On few joints these are more than a course of torque in each: along a fast motion they would explain anything.
        let of_free = free.theta.len() as f64;
        let (course, parameters) = match act {
            Act::Push(_) => (self.torques.fit_direction(&columns, &free, false)?, self.of_push(link)),
            Act::Force(_) => (free, of_free + 3.0),
            Act::Wrench => (free, of_free),
        };
        let explained = self.explained(course.rss, parameters);
        Some(Fitted { link, act, course, parameters, explained })
    }

    /// Number of parameters of a force on a link that keeps its direction: its sizes, and as much of that direction and the point as the joints tell, which are
    /// ratios of their torques.
    fn of_push(&self, link: usize) -> f64 {
        (self.torques.knots + link.min(5)) as f64
    }

    /// Share of what courses of torque explain that is explained where this sum of squares is left, beyond the noise. What swings faster than a course is none
    /// of a contact, which may stir up some of it; nothing where that is much.
    fn explained(&self, rss: f64, parameters: f64) -> f64 {
        let dispersion = ((self.left + self.numbers) / self.independent).max(1.0);
        let by_courses = self.torques.squares() - self.left - dispersion * self.numbers;
        // As much less as the noise may be more.
        let noise = (self.numbers - parameters).max(0.0) + NOISE_DEVIATIONS * (2.0 * self.numbers).sqrt();
        let missing = (rss - self.left - dispersion * noise).max(0.0);
        let stirred = (self.left - self.independent).max(0.0);
        let tells = by_courses > 0.0 && stirred <= MAX_STIRRED_RATIO * by_courses;
        if tells { (1.0 - missing / by_courses).clamp(0.0, 1.0) } else { 0.0 }
    }

    /// Torques of all joints for the components of what acts: blocks x width each.
    fn columns(&self, link: usize, act: Act) -> Vec<DMatrix<f64>> {
        let width = if act == Act::Wrench { 6 } else { 3 };
        let of_joint = |joint: usize| {
            let mut columns = DMatrix::zeros(self.frames.len(), width);
            for (block, frames) in self.frames.iter().enumerate() {
                let [force, moment] = self.transposed(frames, link, joint, act.place(&frames[link]));
                for c in 0..width {
                    columns[(block, c)] = if c < 3 { force[c] } else { moment[c - 3] };
                }
            }
            columns
        };
        (0..self.chain.len()).map(of_joint).collect()
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

    /// The point of a link, in its frame, about which a wrench has the least moment.
    fn lever(&self, wrench: &Fitted) -> Option<Vector3<f64>> {
        let (mut g, mut b) = (Matrix3::zeros(), Vector3::zeros());
        for (block, frames) in self.frames.iter().enumerate() {
            // m = R p x f = -[f] R p.
            let [force, moment] = self.at(wrench, block);
            let rows = -force.cross_matrix() * frames[wrench.link].rotation;
            g += rows.transpose() * rows;
            b += rows.transpose() * moment;
        }
        nearest(&g, &b)
    }

    /// The point of a link, in its frame, for which the moments of a known force fit best: `m = (R p) x f`.
    fn best_point(&self, fitted: &Fitted) -> Option<Vector3<f64>> {
        let forces: Vec<Vector3<f64>> = (0..self.rows.len()).map(|block| self.at(fitted, block)[0]).collect();
        let mut normal = Normal::of(3);
        for joint in 0..=fitted.link {
            let (mut design, mut rest) = (DMatrix::zeros(forces.len(), 3), self.torques.tau.column(joint).into_owned());
            for (block, (frames, force)) in self.frames.iter().zip(&forces).enumerate() {
                let frame = &frames[fitted.link];
                let [linear, angular] = self.transposed(frames, fitted.link, joint, frame.origin);
                rest[block] -= linear.dot(force);
                // z . (R p x f) = p . R' (f x z).
                design.row_mut(block).copy_from(&(frame.rotation.transpose() * force.cross(&angular)).transpose());
            }
            normal.add(&design, &self.torques.weights[joint], &rest);
        }
        nearest(&normal.g.fixed_view::<3, 3>(0, 0).into_owned(), &normal.b.fixed_rows::<3>(0).into_owned())
    }

    /// Force and moment at a block.
    fn at(&self, fitted: &Fitted, block: usize) -> [Vector3<f64>; 2] {
        let value = fitted.course.at(&self.torques, block);
        let part =
            |from: usize| if from < value.len() { value.fixed_rows::<3>(from).into_owned() } else { Vector3::zeros() };
        [part(0), part(3)]
    }

    fn report(&self, record: &Record, event: &Event, fitted: &Fitted, gap: f64) -> Option<Contact> {
        let columns = self.columns(fitted.link, fitted.act);
        let errors = self.torques.errors(&columns, &fitted.course)?;
        let sizes: Vec<f64> = (0..self.rows.len()).map(|block| self.at(fitted, block)[0].norm()).collect();
        let peak = sizes.iter().copied().fold(0.0, f64::max);
        if peak < MIN_PEAK_N && fitted.act != Act::Wrench {
            return None;
        }
        let strong: Vec<usize> = (0..sizes.len()).filter(|&block| sizes[block] > 0.5 * peak).collect();
        let share = 1.0 / strong.len().max(1) as f64;
        let (mut force, mut moment, mut force_std) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for &block in &strong {
            let [now, about] = self.at(fitted, block);
            force += now * share;
            let frame = &self.frames[block][fitted.link];
            moment += (about + (fitted.act.place(frame) - frame.origin).cross(&now)) * share;
        }
        for c in 0..3 {
            let mut weights = DVector::zeros(fitted.course.theta.len());
            for &block in &strong {
                let (knot, weight) = self.torques.hats[block];
                weights[knot * fitted.course.width + c] += share * weight;
                weights[(knot + 1) * fitted.course.width + c] += share * (1.0 - weight);
            }
            force_std[c] = errors.std(&weights);
        }
        let ends = (2.0 * EVENT_MARGIN_S / record.dt) as usize;
        let mut periods: Vec<usize> =
            (event.first..event.last).map(|row| record.repeats.periods[row / record.samples]).collect();
        periods.dedup();
        let torque = |block: usize, joint: usize| {
            let course = fitted.course.at(&self.torques, block);
            -columns[joint].row(block).transpose().dot(&course)
        };
        Some(Contact {
            run: record.experiment.name.clone(),
            from: record.time(event.first),
            to: record.time(event.last - 1) + record.dt,
            periods,
            link: fitted.link,
            point: fitted.act.point(),
            force,
            force_std,
            peak,
            moment,
            explained: fitted.explained,
            gap,
            at_ends: [event.first <= ends, event.last + ends >= record.tau.nrows()],
            times: self.rows.iter().map(|&row| record.time(row)).collect(),
            tau: DMatrix::from_fn(self.rows.len(), self.chain.len(), torque),
        })
    }
}

impl Act {
    /// Acts with fewer numbers come first.
    fn rank(self) -> usize {
        match self {
            Act::Push(_) => 0,
            Act::Force(_) => 1,
            Act::Wrench => 2,
        }
    }

    /// Point in the link's frame; a wrench has none.
    fn point(self) -> Option<Vector3<f64>> {
        match self {
            Act::Push(point) | Act::Force(point) => Some(point),
            Act::Wrench => None,
        }
    }

    /// Where it acts in the base frame.
    fn place(self, frame: &Placement) -> Vector3<f64> {
        frame.origin + frame.rotation * self.point().unwrap_or_default()
    }
}

/// The point that solves `g p = b` and is near the frame along what that leaves open: along the force nothing tells where it acts.
fn nearest(g: &Matrix3<f64>, b: &Vector3<f64>) -> Option<Vector3<f64>> {
    let least = 1e-4 * g.diagonal().max();
    let point = (g + Matrix3::identity() * least).try_inverse()? * b;
    Some(if point.norm() > MAX_LEVER_M { point * (MAX_LEVER_M / point.norm()) } else { point })
}
