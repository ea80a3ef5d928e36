//! Drifts and steps: what tells the periods of a run apart and is no event.
//!
//! Both show in the deviations of the periods from their mean, the mean over the periods being taken off both sides. The base parameters
//! have no part in them. Deviations are judged as spectra of whole runs: in each joint and band noise has one variance, which is
//! estimated with the course (profile likelihood), for noise at the lowest frequencies is stronger than that of single samples.
//! Score, at least [`MIN_SCORE`]: twice the gain in log likelihood, less `k ln n` for `k` parameters and `2 ln N` for `N` candidates.

mod begin;

use super::coming::{self, Coming};
use super::drift::{Along, Course, Drift, Drifting, Shared};
use super::fitted::{self, Fitted, Moments};
use super::record::Record;
use super::step::{self, Step};
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::effect::OperatingPoint;

/// Upper edges of the bands \[Hz\].
const BAND_EDGES_HZ: [f64; 8] = [0.3, 0.55, 1.05, 2.0, 4.0, 8.0, 16.0, f64::INFINITY];
/// Highest frequency that counts \[Hz\].
const MAX_FREQUENCY_HZ: f64 = 16.0;
/// Time constants that the search starts from \[s\]; it stays between the first and the last. What warms a sensor or a whole arm is large;
const SLOW_TIME_CONSTANTS_S: [f64; 5] = [60.0, 100.0, 170.0, 290.0, 500.0];
/// the grease of one joint is warmed by its own friction.
pub const WARMING_TIME_CONSTANTS_S: [f64; 6] = [15.0, 30.0, 60.0, 120.0, 240.0, 500.0];
/// Least score: within a band slow noise is stronger at its lowest frequencies, where drifts and steps are.
const MIN_SCORE: f64 = 10.0;
/// Least ratio of what a drift with own parameters in each run does in the run in which it does least to that in which it does most: below it the
/// runs do not have the same drift.
const MIN_RUN_RATIO: f64 = 0.25;
/// Evaluations of the search for a time constant.
const MAX_EVALUATIONS: usize = 8;

/// Coefficients of deviations, one vector per run, for one joint.
type Rows = Vec<Vec<f64>>;

/// What is under test.
#[derive(Clone, Copy, Debug, PartialEq)]
enum What {
    Drift(Drifting, Course),
    /// The index of what comes, and the row of its run at which it does.
    Step(usize, usize),
}

/// A drift or a step under test.
#[derive(Clone)]
struct Trial {
    what: What,
    /// Number of parameters of one set.
    width: usize,
    /// What the runs share of it.
    shared: Shared,
    /// Columns of each joint that it touches: joint, then run, then column; none in a run that it does not touch.
    columns: Vec<(usize, Vec<Vec<Vec<f64>>>)>,
    /// How a drift goes along each run.
    along: Vec<Along>,
}

impl Trial {
    /// Whether all runs have the same parameters.
    fn common(&self) -> bool {
        self.shared != Shared::Nothing
    }
}

/// What differs between the periods and is no event.
#[derive(Clone, Debug, Default)]
pub(super) struct Courses {
    /// Drifts, in the order in which they were found.
    pub drifts: Vec<Drift>,
    /// Steps, alike.
    pub steps: Vec<Step>,
}

impl Courses {
    /// What they do to a run, the `run`-th of all, P N x n at its grid \[Nm\]; the mean over the periods is not taken off.
    pub fn torque(&self, run: usize, record: &Record, operating_point: &OperatingPoint) -> DMatrix<f64> {
        let mut tau = DMatrix::zeros(record.tau.nrows(), record.joints());
        for drift in &self.drifts {
            let values = &drift.values[if drift.shared == Shared::Nothing { run } else { 0 }];
            tau += drift.what.torque(&drift.along[run], values, record, operating_point);
        }
        for step in self.steps.iter().filter(|step| step.run == record.experiment.name) {
            tau += &step.torque;
        }
        tau
    }
}

/// The runs, and what their deviations are in the band.
pub(super) struct Deviations<'a> {
    records: &'a [Record<'a>],
    operating_point: &'a OperatingPoint,
    /// Band of each coefficient, run by run.
    bands: Vec<Vec<usize>>,
    /// Independent numbers in a coefficient of each joint, run by run.
    freedom: Vec<Vec<f64>>,
    /// Independent numbers in the coefficients of a joint.
    count: f64,
    /// Per joint.
    rows: Vec<Rows>,
}

impl Deviations<'_> {
    /// Of these runs.
    pub fn of<'a>(records: &'a [Record<'a>], operating_point: &'a OperatingPoint) -> Deviations<'a> {
        let joints = records.first().map_or(0, Record::joints);
        let bands: Vec<Vec<usize>> = records.iter().map(bands).collect();
        let rows = |joint| {
            records.iter().map(|record| record.coefficients(joint, &record.centred(joint), highest(record))).collect()
        };
        let freedom = |record: &Record| (0..joints).map(|joint| record.freedom(joint)).collect();
        let freedom: Vec<Vec<f64>> = records.iter().map(freedom).collect();
        let own = |(bands, freedom): (&Vec<usize>, &Vec<f64>)| bands.len() as f64 * freedom.first().unwrap_or(&0.0);
        let count = bands.iter().zip(&freedom).map(own).sum();
        Deviations { records, operating_point, bands, freedom, count, rows: (0..joints).map(rows).collect() }
    }

    /// Drifts and steps that pay for themselves. A step that was `known` before keeps its time where all of it is masked by now.
    pub fn courses(&self, known: &[Step]) -> Courses {
        if self.records.is_empty() {
            return Courses::default();
        }
        let drifts = self.candidates();
        let coming = coming::all(self.records, self.operating_point);
        // A step may come at every second.
        let seconds = |one: &Coming| self.records[one.run].tau.nrows() as f64 * self.records[one.run].dt;
        let count = drifts.len() + coming.iter().map(seconds).sum::<f64>() as usize;
        let mut taken: Vec<(Trial, Fitted, f64)> = Vec::new();
        let mut rest = self.rows.clone();
        // Each kind of drift once in each joint is the most there can be.
        for _ in 0..2 * self.rows.len() {
            let steps = self.steps(&coming, &taken, known);
            let open = |trial: &&Trial| !taken.iter().any(|(other, _, _)| excludes(&coming, other.what, trial.what));
            let scored = drifts.iter().chain(&steps).filter(open).filter_map(|trial| {
                let fitted = self.fit(trial, &rest)?;
                let score = self.score(trial, &fitted, count);
                self.in_every_run(trial, &fitted).then_some((trial, fitted, score))
            });
            let mut scored: Vec<_> = scored.collect();
            scored.sort_by(|a, b| b.2.total_cmp(&a.2));
            let shows =
                |one: &(&Trial, Fitted, f64)| one.2 <= MIN_SCORE || self.shows_along_mean(&coming, one.0, &rest, count);
            let Some((trial, fitted, score)) = scored.into_iter().find(shows) else { break };
            let best = self.refined((trial.clone(), fitted, score), &rest, count);
            let best = self.begun(&coming, best, &rest, count);
            if best.2 <= MIN_SCORE {
                break;
            }
            taken.push(best);
            // Each once more beside all others.
            for k in 0..taken.len() {
                rest = self.without(taken.iter().enumerate().filter(|(other, _)| *other != k).map(|(_, one)| one));
                if let Some(again) = self.tried(taken[k].0.clone(), &rest, count) {
                    taken[k] = again;
                }
            }
            taken.retain(|(_, _, score)| *score > MIN_SCORE);
            rest = self.without(taken.iter());
        }
        let mut found = Courses::default();
        for (trial, fitted, score) in taken {
            match trial.what {
                What::Drift(what, course) => found.drifts.push(self.report(&trial, (what, course), fitted, score)),
                What::Step(which, row) => found.steps.push(self.report_step(&coming[which], row, &fitted, score)),
            }
        }
        found
    }

    /// What comes, each at the time at which it explains most of what is left over beside `taken`.
    fn steps(&self, coming: &[Coming], taken: &[(Trial, Fitted, f64)], known: &[Step]) -> Vec<Trial> {
        let mut rest: Vec<Vec<Vec<f64>>> = Vec::new();
        for (run, record) in self.records.iter().enumerate() {
            let mut known = DMatrix::zeros(record.tau.nrows(), record.joints());
            for (trial, fitted, _) in taken {
                known += match trial.what {
                    What::Drift(what, _) => {
                        let values = self.values(trial, fitted, run);
                        what.torque(&trial.along[run], values, record, self.operating_point)
                    }
                    What::Step(which, row) if coming[which].run == run => {
                        coming[which].torque(record, row, fitted.theta.as_slice())
                    }
                    What::Step(..) => continue,
                };
            }
            let of_joint = |joint: usize| {
                let mut x: Vec<f64> = (record.tau.column(joint) - known.column(joint)).iter().copied().collect();
                record.centre(&mut x);
                x
            };
            rest.push((0..record.joints()).map(of_joint).collect());
        }
        let weight = |x: &Vec<f64>| x.len() as f64 / x.iter().map(|value| value * value).sum::<f64>().max(1e-12);
        let weights: Vec<Vec<f64>> = rest.iter().map(|run| run.iter().map(weight).collect()).collect();
        let rows = coming::times(coming, self.records, &rest, &weights);
        let trial = |(which, row): (usize, Option<usize>)| {
            let (one, row) = (&coming[which], row?);
            let record = &self.records[one.run];
            let before = known.iter().find(|step| one.is_of(step, record) && record.masked_between(row, step.row));
            let row = before.map_or(row, |step| step.row);
            Some(self.step((which, one), row, one.since(record, row)))
        };
        rows.into_iter().enumerate().filter_map(trial).collect()
    }

    /// What comes at a row, with these columns for each joint as signals of its run.
    fn step(&self, (which, coming): (usize, &Coming), row: usize, columns: Vec<(usize, Vec<Vec<f64>>)>) -> Trial {
        let of_joint = |(joint, columns): (usize, Vec<Vec<f64>>)| {
            let mut runs = vec![Vec::new(); self.records.len()];
            let record = &self.records[coming.run];
            let centred = |mut column: Vec<f64>| {
                record.centre(&mut column);
                record.coefficients(joint, &column, highest(record))
            };
            runs[coming.run] = columns.into_iter().map(centred).collect();
            (joint, runs)
        };
        let columns = columns.into_iter().map(of_joint).collect();
        let (what, shared) = (What::Step(which, row), Shared::Parameters);
        Trial { what, width: coming.width, shared, columns, along: Vec::new() }
    }

    /// Whether a step pays for itself by what it does along the mean motion alone. Along a run's own motion its columns have the noise of the motion that
    /// the deviations have, too: a body that comes where hardly a sample tells of its torque explains that noise for a second.
    fn shows_along_mean(&self, coming: &[Coming], trial: &Trial, rows: &[Rows], candidates: usize) -> bool {
        let What::Step(which, row) = trial.what else { return true };
        let one = &coming[which];
        let trial = self.step((which, one), row, one.since_along_mean(&self.records[one.run], row));
        self.tried(trial, rows, candidates).is_some_and(|(_, _, score)| score > MIN_SCORE)
    }

    /// Parameters of a drift in a run.
    fn values<'b>(&self, trial: &Trial, fitted: &'b Fitted, run: usize) -> &'b [f64] {
        let first = if trial.common() { 0 } else { run * trial.width };
        &fitted.theta.as_slice()[first..first + trial.width]
    }

    fn candidates(&self) -> Vec<Trial> {
        let joints = self.rows.len();
        let slow = SLOW_TIME_CONSTANTS_S.map(|time| Course::Saturating { time });
        let courses: Vec<Course> = [Course::Linear].into_iter().chain(slow).collect();
        let mut what: Vec<Drifting> = (0..joints).flat_map(|j| [Drifting::Offset(j), Drifting::Friction(j)]).collect();
        if self.operating_point.friction.len() == joints {
            what.push(Drifting::AllFriction);
        }
        let mut trials = Vec::new();
        for what in what {
            let warming = |joint| WARMING_TIME_CONSTANTS_S.map(|time| Course::Warming { joint, time });
            let own = match what {
                Drifting::Friction(joint) => warming(joint).to_vec(),
                Drifting::Offset(_) | Drifting::AllFriction => Vec::new(),
            };
            for &course in courses.iter().chain(&own) {
                let own = self.trial(what, course, Shared::Parameters);
                if self.records.len() > 1 {
                    // Warmth gives a joint the same friction in every run.
                    if !matches!(course, Course::Warming { .. }) {
                        trials.push(Trial { shared: Shared::Nothing, ..own.clone() });
                    }
                    // The deviations of a linear course are the same on both clocks.
                    if course != Course::Linear {
                        trials.push(self.trial(what, course, Shared::Course));
                    }
                }
                trials.push(own);
            }
        }
        trials
    }

    fn trial(&self, what: Drifting, course: Course, shared: Shared) -> Trial {
        let along = course.along(shared, self.records, self.operating_point);
        let columns = |joint: usize, (record, along): (&Record, &Along)| -> Vec<Vec<f64>> {
            let column = |shape: &Vec<f64>| {
                let at = |row: usize| shape[row % record.samples] * along.at_row(record, row);
                let mut x: Vec<f64> = (0..record.tau.nrows()).map(at).collect();
                record.centre(&mut x);
                record.coefficients(joint, &x, highest(record))
            };
            what.shapes(joint, &record.motion, self.operating_point).iter().map(column).collect()
        };
        let of_joint = |joint| (joint, self.records.iter().zip(&along).map(|run| columns(joint, run)).collect());
        let columns = what.joints(self.rows.len()).into_iter().map(of_joint).collect();
        Trial { what: What::Drift(what, course), width: what.parameters().len(), shared, columns, along }
    }

    /// A joint's moments with the columns of a trial, band by band.
    fn moments(&self, trial: &Trial, (joint, columns): &(usize, Vec<Vec<Vec<f64>>>), rows: &[Rows]) -> Vec<Moments> {
        let width = trial.width;
        let count = width * if trial.common() { 1 } else { self.records.len() };
        let mut moments = vec![Moments::new(count); BAND_EDGES_HZ.len()];
        for (run, own) in columns.iter().enumerate() {
            let first = if trial.common() { 0 } else { run * width };
            let freedom = self.freedom[run][*joint];
            let mut row = vec![0.0; own.len()];
            for (k, (&value, &band)) in rows[*joint][run].iter().zip(&self.bands[run]).enumerate() {
                row.iter_mut().zip(own).for_each(|(row, column)| *row = column[k]);
                moments[band].add(first, &row, value, freedom);
            }
        }
        moments
    }

    fn fit(&self, trial: &Trial, rows: &[Rows]) -> Option<Fitted> {
        let moments: Vec<_> = trial.columns.iter().map(|of_joint| self.moments(trial, of_joint, rows)).collect();
        fitted::fit(&moments)
    }

    /// Whether a drift with own parameters in each run is one: in all of them alike in sign and about as strong.
    fn in_every_run(&self, trial: &Trial, fitted: &Fitted) -> bool {
        if trial.common() {
            return true;
        }
        let [(_, columns)] = &trial.columns[..] else { return true };
        let strength = |(run, own): (usize, &Vec<Vec<f64>>)| {
            let values = self.values(trial, fitted, run);
            let at = |row: usize| own.iter().zip(values).map(|(column, value)| value * column[row]).sum::<f64>();
            let rows = own.first().map_or(0, Vec::len);
            let mean_square = (0..rows).map(|row| at(row).powi(2)).sum::<f64>() / rows.max(1) as f64;
            (values.first().copied().unwrap_or(0.0).signum(), mean_square.sqrt())
        };
        let of_runs: Vec<(f64, f64)> = columns.iter().enumerate().map(strength).collect();
        let alike = of_runs.windows(2).all(|pair| pair[0].0 == pair[1].0);
        let most = of_runs.iter().map(|run| run.1).fold(0.0, f64::max);
        alike && of_runs.iter().all(|run| run.1 >= MIN_RUN_RATIO * most)
    }

    fn score(&self, trial: &Trial, fitted: &Fitted, candidates: usize) -> f64 {
        let parameters = (fitted.theta.len() + trial.what.settings()) as f64;
        fitted.evidence - parameters * self.count.ln() - 2.0 * (candidates as f64).ln()
    }

    /// A trial with its fit and score.
    fn tried(&self, trial: Trial, rows: &[Rows], candidates: usize) -> Option<(Trial, Fitted, f64)> {
        let fitted = self.fit(&trial, rows)?;
        let score = self.score(&trial, &fitted, candidates);
        Some((trial, fitted, score))
    }

    /// The time constant where the likelihood is largest, near where it is.
    fn refined(&self, best: (Trial, Fitted, f64), rows: &[Rows], candidates: usize) -> (Trial, Fitted, f64) {
        let What::Drift(what, course) = best.0.what else { return best };
        let Some(time) = course.time() else { return best };
        let all: &[f64] = match course {
            Course::Warming { .. } => &WARMING_TIME_CONSTANTS_S,
            _ => &SLOW_TIME_CONSTANTS_S,
        };
        let limit = |time: f64| time.clamp(all[0], all[all.len() - 1]);
        let (mut low, mut high) = (limit(time / 2.0).ln(), limit(time * 2.0).ln());
        let mut best = best;
        let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
        let mut at = |log: f64| {
            let trial = self.trial(what, course.with_time(log.exp()), best.0.shared);
            let Some(tried) = self.tried(trial, rows, candidates) else { return f64::NEG_INFINITY };
            let score = tried.2;
            if score > best.2 {
                best = tried;
            }
            score
        };
        for _ in 0..MAX_EVALUATIONS / 2 {
            let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
            if at(left) > at(right) { high = right } else { low = left }
        }
        best
    }

    fn without<'b>(&self, taken: impl Iterator<Item = &'b (Trial, Fitted, f64)>) -> Vec<Rows> {
        let mut rest = self.rows.clone();
        for (trial, fitted, _) in taken {
            for (joint, columns) in &trial.columns {
                rest[*joint] = less(&rest[*joint], columns, &fitted.theta, trial.common());
            }
        }
        rest
    }

    fn report(&self, trial: &Trial, (what, course): (Drifting, Course), fitted: Fitted, score: f64) -> Drift {
        let std: Vec<f64> = fitted.covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
        let sets = |values: &[f64]| values.chunks(trial.width).map(<[f64]>::to_vec).collect();
        let (mut squares, mut rows) = (vec![0.0; self.rows.len()], 0);
        for (run, record) in self.records.iter().enumerate() {
            let tau = what.torque(&trial.along[run], self.values(trial, &fitted, run), record, self.operating_point);
            rows += tau.nrows();
            squares.iter_mut().zip(squares_about_mean(record, &tau)).for_each(|(sum, square)| *sum += square);
        }
        Drift {
            what,
            course,
            along: trial.along.clone(),
            shared: trial.shared,
            values: sets(fitted.theta.as_slice()),
            std: sets(&std),
            evidence: fitted.evidence,
            score,
            explained: fitted.explained,
            rms: squares.iter().map(|square| (square / rows.max(1) as f64).sqrt()).collect(),
        }
    }

    fn report_step(&self, coming: &Coming, row: usize, fitted: &Fitted, score: f64) -> Step {
        let record = &self.records[coming.run];
        let torque = coming.torque(record, row, fitted.theta.as_slice());
        let rms = |square: f64| (square / torque.nrows() as f64).sqrt();
        Step {
            run: record.experiment.name.clone(),
            time: record.time(row),
            earliest: record.time(begin::earliest(record, row)),
            row,
            spec: coming.spec.clone(),
            evidence: fitted.evidence,
            score,
            rms: squares_about_mean(record, &torque).into_iter().map(rms).collect(),
            by_own_motion: &torque - coming.torque_along_mean(record, row, fitted.theta.as_slice()),
            torque,
            periods: record.repeats.periods.clone(),
        }
    }
}

impl What {
    /// Number of nonlinear parameters.
    fn settings(self) -> usize {
        match self {
            What::Drift(_, course) => course.settings(),
            What::Step(..) => 1,
        }
    }
}

/// Whether both can't stand side by side.
fn excludes(coming: &[Coming], one: What, other: What) -> bool {
    match (one, other) {
        (What::Drift(one, _), What::Drift(other, _)) => one.excludes(other),
        // The same may come and go, at another time.
        (What::Step(one, row), What::Step(other, other_row)) => {
            let (one, other) = (&coming[one], &coming[other]);
            let same = one.run == other.run && one.spec.is_same_effect(&other.spec);
            same && row.abs_diff(other_row) < step::MIN_ROWS_APART
        }
        _ => false,
    }
}

/// Squares of a torque about its mean over the periods, per joint.
fn squares_about_mean(record: &Record, tau: &DMatrix<f64>) -> Vec<f64> {
    let square = |column: nalgebra::DVectorView<f64>| {
        let mut x: Vec<f64> = column.iter().copied().collect();
        record.centre(&mut x);
        x.iter().map(|value| value * value).sum()
    };
    tau.column_iter().map(square).collect()
}

/// Rows less the columns times their parameters.
fn less(rows: &Rows, columns: &[Vec<Vec<f64>>], theta: &DVector<f64>, common: bool) -> Rows {
    let mut rest = rows.clone();
    for (run, own) in columns.iter().enumerate() {
        let first = if common { 0 } else { run * own.len() };
        for (i, column) in own.iter().enumerate() {
            for (value, c) in rest[run].iter_mut().zip(column) {
                *value -= theta[first + i] * c;
            }
        }
    }
    rest
}

fn highest(record: &Record) -> f64 {
    MAX_FREQUENCY_HZ.min(0.4 / record.dt)
}

/// Band of each coefficient.
fn bands(record: &Record) -> Vec<usize> {
    let frequency = |row: usize| row as f64 / (2.0 * record.tau.nrows() as f64 * record.dt);
    let band =
        |row: usize| BAND_EDGES_HZ.iter().position(|edge| frequency(row) <= *edge).unwrap_or(BAND_EDGES_HZ.len() - 1);
    (0..record.coefficient_count(highest(record))).map(band).collect()
}
