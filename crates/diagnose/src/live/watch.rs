//! The detector: whether the served model still predicts the torques.
//!
//! It takes one short stretch of samples after the other: the mean square `m` of measured minus modelled torque in the band, joint by joint,
//! relative to `u^2`, that of the motion that the model was identified from. For noise, `nu m / u^2` has about a chi-square distribution with `nu` degrees
//! of freedom, which the stretches of that motion tell by their scatter and their correlation. The cumulative sum of the log likelihood ratios of a
//! doubled error,
//!
//!   S <- max(0, S + nu/2 (m/u^2 (1 - 1/r^2) - ln r^2)),   r = 2,
//!
//! is an alarm at `S > h`. The mean time between false alarms of one joint is at least `e^h` stretches (Page, Biometrika 41, 1954; Lorden, Annals of
//! Mathematical Statistics 42, 1971); `h` is set for one in [`FALSE_ALARM_S`]. The same sum of the reverse ratio says that the model holds again.

use super::{LOST_RATIO, STRETCH_S, stretches, worst};
use plumbline_identify::Experiment;
use plumbline_model::TorqueModel;

/// Time between two false alarms, on average, at least \[s\].
const FALSE_ALARM_S: f64 = 10.0 * 3600.0;
/// Mean square on a motion that was not identified from, as a ratio to that of the identification: errors of the parameters show there.
const UNSEEN_RATIO: f64 = 1.3;
/// Mean square that becomes usual on the motions that are watched, at most, as a ratio to that of the identification.
const MAX_USUAL_RATIO: f64 = 4.0;
/// Stretches that the identification counts for beside those that are watched.
const IDENTIFIED_STRETCHES: f64 = 10.0;
/// Degrees of freedom of a stretch: at least, and at most 2 B T of a band of 5 Hz.
const FREEDOM: (f64, f64) = (1.0, 10.0 * STRETCH_S);
/// Share of the estimated degrees of freedom that is relied on: some tens of stretches tell them to a fifth.
const RELIED_ON: f64 = 0.75;

/// Error in the band, per joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Floor {
    /// RMS on the motion that the model was identified from \[Nm\].
    pub usual: Vec<f64>,
    /// Degrees of freedom of the mean square of a stretch.
    pub freedom: Vec<f64>,
    /// RMS of a stretch that is an alarm by itself \[Nm\].
    pub limit: Vec<f64>,
}

/// A change of the watch's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum News {
    /// The model does not hold any more.
    Lost {
        /// Start of the first bad stretch \[s\].
        since: f64,
        /// Joint whose error is farthest above the usual one, from 0.
        joint: usize,
        /// Its RMS \[Nm\].
        rms: f64,
        /// What it usually is \[Nm\].
        floor: f64,
    },
    /// It holds again.
    Holds {
        /// Start of the first good stretch \[s\].
        since: f64,
    },
}

/// Detector over consecutive stretches.
#[derive(Clone, Debug)]
pub struct Watch {
    floor: Floor,
    /// RMS on the motion that the model was identified from, per joint \[Nm\].
    identified: Vec<f64>,
    /// Stretches that a model held on, and their sums of squares per joint \[Nm2\].
    held: (f64, Vec<f64>),
    /// For the other state than the present one.
    sums: Sums,
    /// Since when the model does not hold \[s\].
    lost: Option<f64>,
    /// What is usual while nothing explains that, and its sums until another change shows above it.
    beside: Option<(Floor, Option<Sums>)>,
}

/// Sum of each joint, and the start of the first stretch that it has summed \[s\].
type Sums = Vec<(f64, f64)>;

impl Floor {
    /// Of the motion that the model was identified from, prepared like those that will be watched.
    pub fn of(model: &TorqueModel, experiment: &Experiment) -> Floor {
        Floor::from_stretches(&stretches(model, experiment))
    }

    /// From the RMS of stretches, per joint \[Nm\].
    pub fn from_stretches(stretches: &[Vec<f64>]) -> Floor {
        let (count, joints) = (stretches.len().max(1) as f64, stretches.first().map_or(0, Vec::len));
        let square = |joint: usize| stretches.iter().map(|rms| rms[joint].powi(2)).sum::<f64>() / count;
        let square: Vec<f64> = (0..joints).map(square).collect();
        let freedom = freedom(stretches, &square);
        let usual: Vec<f64> = square.iter().map(|square| square.sqrt()).collect();
        let limit = |(usual, freedom): (&f64, &f64)| {
            let (gain, cost) = (1.0 - LOST_RATIO.powi(-2), 2.0 * LOST_RATIO.ln());
            usual * (UNSEEN_RATIO * (2.0 * threshold(joints) / freedom + cost) / gain).sqrt()
        };
        let limit = usual.iter().zip(&freedom).map(limit).collect();
        Floor { usual, freedom, limit }
    }

    /// Another usual RMS of a joint \[Nm\], to which its limit is proportional.
    fn set_usual(&mut self, joint: usize, usual: f64) {
        self.limit[joint] *= usual / self.usual[joint].max(f64::MIN_POSITIVE);
        self.usual[joint] = usual;
    }

    /// How well a model with so many numbers of its own explains stretches with these RMS: their log likelihood if the error is as usual, less half of the
    /// logarithm of their degrees of freedom for each number.
    pub(super) fn fit(&self, stretches: &[Vec<f64>], numbers: usize) -> f64 {
        let joints = || self.usual.iter().zip(&self.freedom).enumerate();
        let of_joint = |rms: &[f64], (joint, (usual, freedom)): (usize, (&f64, &f64))| {
            0.5 * freedom * (rms[joint] / usual.max(f64::MIN_POSITIVE)).powi(2) / UNSEEN_RATIO
        };
        let lost: f64 = stretches.iter().flat_map(|rms| joints().map(|joint| of_joint(rms, joint))).sum();
        let freedom = stretches.len() as f64 * self.freedom.iter().sum::<f64>();
        -lost - 0.5 * numbers as f64 * freedom.max(1.0).ln()
    }

    /// Log likelihood ratio of a doubled error in a stretch with this RMS.
    fn ratio(&self, joint: usize, rms: f64) -> f64 {
        let square = (rms / self.usual[joint].max(f64::MIN_POSITIVE)).powi(2) / UNSEEN_RATIO;
        0.5 * self.freedom[joint] * (square * (1.0 - LOST_RATIO.powi(-2)) - 2.0 * LOST_RATIO.ln())
    }
}

/// Degrees of freedom of the mean square of a stretch, per joint, for sums over stretches; `square` is the mean of that.
fn freedom(stretches: &[Vec<f64>], square: &[f64]) -> Vec<f64> {
    let apart = |k: usize, joint: usize| stretches[k][joint].powi(2) / square[joint] - 1.0;
    let covariance = |lag: usize, joint: usize| {
        let products = (lag..stretches.len()).map(|k| apart(k, joint) * apart(k - lag, joint));
        products.sum::<f64>() / stretches.len() as f64
    };
    let variances: Vec<f64> = (0..square.len()).map(|joint| covariance(0, joint).max(f64::MIN_POSITIVE)).collect();
    let of_all = |of: &dyn Fn(usize) -> f64| (0..square.len()).map(of).sum::<f64>() / square.len() as f64;
    // In slow noise a stretch is like the one before, and their sums vary more.
    let correlation = of_all(&|joint| covariance(1, joint) / variances[joint]).max(0.0);
    let own = |variance: &f64| (RELIED_ON * 2.0 / (variance * (1.0 + 2.0 * correlation))).clamp(FREEDOM.0, FREEDOM.1);
    let own: Vec<f64> = variances.iter().map(own).collect();
    // Some tens of stretches tell little of one joint, and the others have noise of the same kind: halfway between.
    let all = of_all(&|joint| own[joint].ln()).exp();
    own.iter().map(|own| (own * all).sqrt()).collect()
}

/// Sum of log likelihood ratios that is an alarm.
fn threshold(joints: usize) -> f64 {
    (joints.max(1) as f64 * FALSE_ALARM_S / STRETCH_S).ln()
}

impl Watch {
    /// Before the first stretch.
    pub fn new(floor: Floor) -> Watch {
        let joints = floor.usual.len();
        let identified = floor.usual.clone();
        Watch {
            floor,
            identified,
            held: (0.0, vec![0.0; joints]),
            sums: vec![(0.0, 0.0); joints],
            lost: None,
            beside: None,
        }
    }

    /// What is usual: on the motions that are watched it may be more than on the one that the model was identified from.
    pub fn usual(&self) -> &Floor {
        &self.floor
    }

    /// The same, and more while nothing explains an error.
    pub fn floor(&self) -> &Floor {
        self.beside.as_ref().map_or(&self.floor, |(floor, _)| floor)
    }

    /// [`Watch::look`] under a model of which something is known to these standard deviations only \[Nm\].
    pub fn look_within(&mut self, start: f64, rms: &[f64], spread: &[f64]) -> Option<News> {
        let share = |joint: usize| self.floor.usual[joint] / self.floor.usual[joint].hypot(spread[joint]);
        let rms: Vec<f64> = (0..rms.len()).map(|joint| rms[joint] * share(joint)).collect();
        self.look(start, &rms)
    }

    /// Takes a stretch that begins at `start` \[s\] with its RMS per joint in the band \[Nm\]; returns a change of state, or another alarm beside an error
    /// that nothing explains.
    pub fn look(&mut self, start: f64, rms: &[f64]) -> Option<News> {
        let sign = if self.lost.is_some() { -1.0 } else { 1.0 };
        add(&mut self.sums, &self.floor, sign, start, rms);
        let over = threshold(self.sums.len());
        if self.lost.is_some() {
            // Every joint has to hold.
            if self.sums.iter().all(|(sum, _)| *sum > over) {
                let since = self.sums.iter().map(|(_, since)| *since).fold(f64::NEG_INFINITY, f64::max);
                self.reset();
                return Some(News::Holds { since });
            }
            let (floor, watched) = self.beside.as_mut()?;
            let sums = watched.as_mut()?;
            add(sums, floor, 1.0, start, rms);
            let news = alarm(sums, floor, rms);
            // Once, until that is explained or not.
            news.iter().for_each(|_| *watched = None);
            return news;
        }
        let news = alarm(&self.sums, &self.floor, rms);
        match news {
            Some(News::Lost { since, .. }) => {
                self.reset();
                self.lost = Some(since);
            }
            _ => self.hold(rms),
        }
        news
    }

    /// Nothing explains the error since the model was lost, which has this RMS per joint \[Nm\]: another change is looked for beside it.
    pub fn set_unexplained(&mut self, rms: &[f64]) {
        if self.lost.is_none() {
            return;
        }
        let mut floor = self.floor.clone();
        for (joint, rms) in rms.iter().enumerate() {
            let usual = rms.max(floor.usual[joint]);
            floor.set_usual(joint, usual);
        }
        self.beside = Some((floor, Some(vec![(0.0, 0.0); self.sums.len()])));
    }

    /// Another change than the unexplained one has been found: under the model with it, that one is still there.
    pub fn look_beside_again(&mut self) {
        self.sums.fill((0.0, 0.0));
        let anew = vec![(0.0, 0.0); self.sums.len()];
        self.beside.iter_mut().for_each(|(_, sums)| *sums = Some(anew.clone()));
    }

    /// Counts a stretch without an alarm. What is usual is bounded: an error that grows by and by is an alarm in the end.
    fn hold(&mut self, rms: &[f64]) {
        let (count, sums) = &mut self.held;
        *count += 1.0;
        for (joint, sum) in sums.iter_mut().enumerate() {
            let identified = self.identified[joint].powi(2);
            *sum += rms[joint].powi(2).min(MAX_USUAL_RATIO * identified);
            let mean = (*sum + IDENTIFIED_STRETCHES * identified) / (*count + IDENTIFIED_STRETCHES);
            self.floor.set_usual(joint, mean.max(identified).sqrt());
        }
    }

    /// Starts anew, under another model.
    pub fn reset(&mut self) {
        self.sums.fill((0.0, 0.0));
        (self.lost, self.beside) = (None, None);
    }
}

/// Adds the log likelihood ratios of a stretch.
fn add(sums: &mut Sums, floor: &Floor, sign: f64, start: f64, rms: &[f64]) {
    for (joint, (sum, since)) in sums.iter_mut().enumerate() {
        if *sum <= 0.0 {
            *since = start;
        }
        *sum = (*sum + sign * floor.ratio(joint, rms[joint])).max(0.0);
    }
}

/// The alarm of sums after a stretch, if they are one.
fn alarm(sums: &Sums, floor: &Floor, rms: &[f64]) -> Option<News> {
    let over = threshold(sums.len());
    let since = sums.iter().filter(|(sum, _)| *sum > over).map(|(_, since)| *since).min_by(f64::total_cmp)?;
    let worst = worst(rms, &floor.usual)?;
    Some(News::Lost { since, joint: worst, rms: rms[worst], floor: floor.usual[worst] })
}

/// Whether a model predicts a motion with the usual errors: a watch over it would not be alarmed, and errors of the last `seconds` are nearer to the usual
/// ones than to doubled ones. False where the motion has no stretch.
pub fn holds(model: &TorqueModel, experiment: &Experiment, floor: &Floor, seconds: f64) -> bool {
    let stretches = stretches(model, experiment);
    let mut watch = Watch::new(floor.clone());
    let mut quiet = |(k, rms): (usize, &Vec<f64>)| watch.look(k as f64 * STRETCH_S, rms).is_none();
    let last = &stretches[stretches.len().saturating_sub((seconds / STRETCH_S).ceil() as usize)..];
    let ratio = |joint: usize| last.iter().map(|rms| floor.ratio(joint, rms[joint])).sum::<f64>();
    !stretches.is_empty()
        && stretches.iter().enumerate().all(&mut quiet)
        && (0..floor.usual.len()).all(|joint| ratio(joint) <= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    const JOINTS: usize = 7;

    #[test]
    fn a_fit_pays_for_what_it_leaves_and_for_its_numbers() {
        let mut rng = ChaCha8Rng::seed_from_u64(61);
        let mut stretches = |count: usize| -> Vec<Vec<f64>> { (0..count).map(|_| stretch(&mut rng, 4, 0.1)).collect() };
        let (floor, own) = (Floor::from_stretches(&stretches(60)), stretches(40));
        let more: Vec<Vec<f64>> = own.iter().map(|rms| [&[1.5 * rms[0]], &rms[1..]].concat()).collect();
        let cost = floor.fit(&own, 1) - floor.fit(&own, 3);
        assert!((3.0..10.0).contains(&cost), "{cost}");
        // In one joint half as much again.
        let gap = floor.fit(&own, 1) - floor.fit(&more, 1);
        assert!((15.0..100.0).contains(&gap), "{gap}");
    }

    /// RMS of stretches of noise with `freedom` degrees of freedom and this size, per joint.
    fn stretch(rng: &mut ChaCha8Rng, freedom: usize, size: f64) -> Vec<f64> {
        let square =
            |_| (0..freedom).map(|_| rng.sample::<f64, _>(StandardNormal).powi(2)).sum::<f64>() / freedom as f64;
        (0..JOINTS).map(square).map(|square: f64| size * square.sqrt()).collect()
    }

    fn watch(rng: &mut ChaCha8Rng, freedom: usize) -> Watch {
        let seen: Vec<Vec<f64>> = (0..80).map(|_| stretch(rng, freedom, 0.02)).collect();
        Watch::new(Floor::from_stretches(&seen))
    }

    /// Stretches of slow noise: each has half of its mean square in common with the one before.
    fn slow(rng: &mut ChaCha8Rng, freedom: usize, size: f64) -> impl Iterator<Item = Vec<f64>> + '_ {
        let mut last = stretch(rng, freedom, size);
        std::iter::repeat_with(move || {
            let new = stretch(rng, freedom, size);
            let mean = |(new, last): (&f64, &f64)| (0.5 * (new * new + last * last)).sqrt();
            let mixed = new.iter().zip(&last).map(mean).collect();
            last = new;
            mixed
        })
    }

    #[test]
    fn degrees_of_freedom_are_those_of_sums_over_stretches() {
        let rng = &mut ChaCha8Rng::seed_from_u64(10);
        let within = |stretches: &[Vec<f64>], expected: f64| {
            let freedom = Floor::from_stretches(stretches).freedom;
            assert!(freedom.iter().all(|own| (own / expected - 1.0).abs() < 0.1), "{freedom:?}, not {expected}")
        };
        let white: Vec<Vec<f64>> = (0..2000).map(|_| stretch(rng, 3, 0.02)).collect();
        within(&white, RELIED_ON * 3.0);
        // Each has twice as many, and sums of them as many.
        let slow: Vec<Vec<f64>> = slow(rng, 3, 0.02).take(2000).collect();
        within(&slow, RELIED_ON * 3.0);
        // Few stretches of one joint, drawn to those of all.
        let scatter = |freedom: &[f64]| {
            let (least, most) = freedom.iter().fold((f64::MAX, 0.0f64), |(a, b), own| (a.min(*own), b.max(*own)));
            most / least
        };
        let few: Vec<Vec<f64>> = (0..30).map(|_| stretch(rng, 3, 0.02)).collect();
        assert!(scatter(&Floor::from_stretches(&few).freedom) < 1.8);
    }

    #[test]
    fn a_hundred_hours_of_noise_are_at_most_ten_alarms() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for freedom in [2, 5] {
            let mut alarms = 0;
            for _ in 0..20 {
                let mut watch = watch(&mut rng, freedom);
                // Errors of the parameters add a tenth.
                for k in 0..36_000 {
                    let rms = stretch(&mut rng, freedom, 0.022);
                    alarms += usize::from(
                        watch.look(k as f64 * STRETCH_S, &rms).is_some_and(|news| matches!(news, News::Lost { .. })),
                    );
                }
            }
            println!("{freedom} degrees of freedom: {alarms} alarms in 100 h");
            assert!(alarms <= 10, "{alarms} alarms in 100 h");
        }
    }

    #[test]
    fn a_hundred_hours_of_slow_noise_are_at_most_ten_alarms() {
        let rng = &mut ChaCha8Rng::seed_from_u64(11);
        let mut alarms = 0;
        for _ in 0..20 {
            // Identified from 24 s, as many recordings are.
            let seen: Vec<Vec<f64>> = slow(rng, 2, 0.02).take(48).collect();
            let mut watch = Watch::new(Floor::from_stretches(&seen));
            for (k, rms) in slow(rng, 2, 0.022).take(36_000).enumerate() {
                let news = watch.look(k as f64 * STRETCH_S, &rms);
                alarms += usize::from(news.is_some_and(|news| matches!(news, News::Lost { .. })));
            }
        }
        println!("{alarms} alarms in 100 h");
        assert!(alarms <= 10, "{alarms} alarms in 100 h");
    }

    #[test]
    fn a_large_error_is_an_alarm_at_once_and_a_doubled_one_in_seconds() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (size, stretches) in [(0.5, 1), (0.08, 4), (0.05, 24)] {
            for _ in 0..50 {
                let mut watch = watch(&mut rng, 5);
                (0..100).for_each(|k| assert_eq!(watch.look(k as f64 * 0.5, &stretch(&mut rng, 5, 0.02)), None));
                let mut needed = 0;
                let news = loop {
                    let mut rms = stretch(&mut rng, 5, 0.02);
                    rms[3] = stretch(&mut rng, 5, size)[3];
                    needed += 1;
                    if let Some(news) = watch.look(50.0 + 0.5 * (needed - 1) as f64, &rms) {
                        break news;
                    }
                    assert!(needed <= stretches, "{size}");
                };
                let News::Lost { since, joint, floor, .. } = news else { panic!("{news:?}") };
                assert!(needed <= stretches && joint == 3 && (floor - 0.02).abs() < 0.01, "{news:?} after {needed}");
                assert!((since - 50.0).abs() <= 0.5 * needed as f64 && watch.lost == Some(since), "{news:?}");
                // Reported once; it holds again after some seconds, and once.
                let mut again = 0;
                for k in 0..200 {
                    let rms = stretch(&mut rng, 5, if k < 40 { 0.1 } else { 0.02 });
                    match watch.look(100.0 + 0.5 * k as f64, &rms) {
                        Some(News::Holds { since }) => {
                            assert!(k >= 42 && since >= 119.0 && watch.lost.is_none(), "{k} {since}");
                            again += 1;
                        }
                        other => assert_eq!(other, None),
                    }
                }
                assert_eq!(again, 1);
            }
        }
    }

    #[test]
    fn another_model_starts_anew() {
        let mut watch = watch(&mut ChaCha8Rng::seed_from_u64(3), 5);
        assert!(watch.look(0.0, &[1.0; JOINTS]).is_some() && watch.lost.is_some());
        watch.reset();
        assert_eq!((watch.lost, watch.look(2.0, &[0.01; JOINTS])), (None, None));
    }

    #[test]
    fn an_error_within_what_is_known_is_no_alarm() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for (spread, alarms) in [(0.0, true), (0.06, false)] {
            let mut watch = watch(&mut rng, 5);
            let lost = (0..40).any(|k| {
                let rms = stretch(&mut rng, 5, 0.06);
                watch.look_within(k as f64 * STRETCH_S, &rms, &[spread; JOINTS]).is_some()
            });
            assert_eq!(lost, alarms, "known to {spread} Nm");
        }
    }

    #[test]
    fn an_error_that_was_always_there_is_usual_up_to_twice_the_identified_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut watch = watch(&mut rng, 5);
        let identified = watch.floor().usual[0];
        for k in 0..80 {
            assert_eq!(watch.look(k as f64 * STRETCH_S, &stretch(&mut rng, 5, 1.5 * identified)), None, "stretch {k}");
        }
        let usual = watch.usual().usual[0] / identified;
        assert!((1.3..1.6).contains(&usual), "{usual}");
        (0..1000).for_each(|_| watch.hold(&[1.0; JOINTS]));
        let usual = watch.usual().usual[0] / identified;
        assert!((1.9..=2.0).contains(&usual), "{usual}");
    }

    #[test]
    fn another_change_shows_beside_one_that_nothing_explains() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let mut watch = watch(&mut rng, 5);
        let mut look = |watch: &mut Watch, sizes: [f64; 2]| -> Vec<(usize, News)> {
            let news = |k: usize| {
                let mut rms = stretch(&mut rng, 5, 0.02);
                (rms[2], rms[4]) = (stretch(&mut rng, 5, sizes[0])[2], stretch(&mut rng, 5, sizes[1])[4]);
                watch.look(k as f64 * STRETCH_S, &rms).map(|news| (k, news))
            };
            (0..60).filter_map(news).collect()
        };
        assert!(matches!(look(&mut watch, [0.1, 0.02])[..], [(0..3, News::Lost { joint: 2, .. })]));
        // Nothing is new before it is known that nothing explains it.
        assert_eq!(look(&mut watch, [0.1, 0.3]), []);
        watch.set_unexplained(&[0.02, 0.02, 0.1, 0.02, 0.02, 0.02, 0.02]);
        assert_eq!(look(&mut watch, [0.1, 0.02]), []);
        let usual = (watch.usual().usual[2], watch.floor().usual[2]);
        assert!(usual.0 < 0.05 && usual.1 == 0.1, "{usual:?}");
        assert!(matches!(look(&mut watch, [0.1, 0.3])[..], [(0..3, News::Lost { joint: 4, .. })]));
        // The other change is in the model that is served now.
        watch.look_beside_again();
        assert_eq!(look(&mut watch, [0.1, 0.02]), []);
        assert!(matches!(look(&mut watch, [0.02, 0.02])[..], [(_, News::Holds { .. })]));
        assert_eq!((watch.lost, watch.floor() == watch.usual()), (None, true));
    }
}
