//! Synthetic evidence: a two-joint arm that swings in a vertical plane, with any torque added to that of its model.

use nalgebra::{DMatrix, DVector};
use plumbline_diagnose::{Columns, Evidence, Problem, Search, Settings, Span, State, Trial, library};
use plumbline_identify::{Experiment, Run};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{Family, Spec};
use plumbline_model::{Chain, Joint, JointKind, Mounting, Placement, Reduction, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// Sampling time \[s\].
pub const DT: f64 = 4e-3;
/// Period of a motion that repeats \[s\].
pub const PERIOD: f64 = 2.0;
/// Recorded periods.
pub const PERIODS: usize = 4;
/// Standard deviation of the noise of one torque sample \[Nm\].
pub const NOISE: f64 = 0.1;
/// Rows of one trajectory and joint: the mean, and sine and cosine of every multiple of 0.5 Hz up to 16 Hz.
pub const ROWS: usize = 65;
/// Noise of the mean period up to 16 Hz \[Nm\]: white noise, of which that band holds 65 of 500 rows.
pub const FLOOR: f64 = 0.1 * 0.5 * 0.360_555;

/// One instant of a trajectory.
pub struct At {
    /// The trajectory, from 0.
    pub trajectory: usize,
    /// Its sample, from 0.
    pub k: usize,
    /// Time since its begin, or that of its period \[s\].
    pub t: f64,
    /// Time since the begin of its first period \[s\].
    pub elapsed: f64,
    /// Positions \[rad\].
    pub q: [f64; 2],
    /// Velocities \[rad/s\].
    pub dq: [f64; 2],
}

/// Trajectories of the arm, prepared.
pub struct Recorded {
    pub structure: Structure,
    pub experiments: Vec<Experiment>,
}

/// Two links of 0.5 m whose axes are horizontal on a wall.
pub fn structure() -> Structure {
    let joint = |a| Joint { kind: JointKind::Revolute, a, alpha: 0.0, d: 0.0, theta: 0.0 };
    let chain = Chain::modified(vec![joint(0.0), joint(0.5)], Placement::identity());
    let reduction = Reduction::in_mounting(&chain, &Mounting::WALL);
    Structure::of(chain, reduction, &["friction"]).unwrap()
}

/// Sums of sines: the frequencies are multiples of the period's, or of their own where the motion does not repeat.
fn motion(seed: u64, seconds: f64, repeats: bool, reach: f64) -> Motion {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let samples = (seconds / DT).round() as usize;
    let zeros = || DMatrix::zeros(samples, 2);
    let (mut q, mut dq, mut ddq) = (zeros(), zeros(), zeros());
    for j in 0..2 {
        for harmonic in 1..=4 {
            let frequency = if repeats { f64::from(harmonic) / PERIOD } else { rng.random_range(0.1..1.5) };
            let (height, phase) = (reach * rng.random_range(0.1..0.3), TAU * rng.random::<f64>());
            for k in 0..samples {
                let w = TAU * frequency;
                let angle = w * k as f64 * DT + phase;
                q[(k, j)] += height * angle.sin();
                dq[(k, j)] += height * w * angle.cos();
                ddq[(k, j)] -= height * w * w * angle.sin();
            }
        }
    }
    Motion { dt: DT, q, dq, ddq, gravity: Mounting::WALL.gravity(), periodic: repeats, start: 0.0 }
}

/// True parameters of the model.
pub fn truth(structure: &Structure) -> DVector<f64> {
    let link = |lzz: f64, lx: f64, m: f64| [0.0, 0.0, 0.0, 0.0, 0.0, lzz, lx, 0.1 * lx, 0.0, m];
    let delta = DVector::from_vec([link(0.5, 0.8, 3.0), link(0.2, 0.4, 2.0)].concat());
    let base = structure.reduction().base_of(&delta);
    let friction = [0.4, 0.3, 0.6, 0.5];
    let all: Vec<f64> = base.iter().copied().chain(friction).collect();
    assert_eq!(all.len(), structure.columns().len());
    DVector::from_vec(all)
}

/// `count` trajectories of a motion that repeats, of a seed each, with white noise and `added` torque.
pub fn recorded(count: usize, seed: u64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    along(&motions(count, seed), seed, added)
}

/// The motions of [`recorded`].
fn motions(count: usize, seed: u64) -> Vec<Motion> {
    (0..count).map(|k| motion(100 * seed + k as u64, PERIOD, true, 1.0)).collect()
}

/// [`recorded`] with an effect more, whose torque has an RMS of `size` \[Nm\] in the joint where it is largest; a negative size turns its sign.
pub fn with_effect(count: usize, seed: u64, spec: &Spec, size: f64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    along_with(&motions(count, seed), seed, spec, size, added)
}

/// [`with_effect`] of four trajectories where the noise of each joint is that many times the usual one.
pub fn with_effect_in_noise(seed: u64, spec: &Spec, size: f64, noise: [f64; 2]) -> Recorded {
    let motions = motions(4, seed);
    let effect = effect_of(&motions, spec, size);
    along_in_noise(&motions, seed, noise, effect)
}

/// [`once`] with an effect more.
pub fn once_with_effect(seconds: f64, seed: u64, spec: &Spec, size: f64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    along_with(&[motion(100 * seed, seconds, false, 1.0)], seed, spec, size, added)
}

fn along_with(motions: &[Motion], seed: u64, spec: &Spec, size: f64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    let effect = effect_of(motions, spec, size);
    along(motions, seed, |at| {
        let (own, more) = (effect(at), added(at));
        [own[0] + more[0], own[1] + more[1]]
    })
}

/// The torque of an effect along motions, of an RMS of `size` \[Nm\] in the joint where it is largest.
fn effect_of(motions: &[Motion], spec: &Spec, size: f64) -> impl Fn(&At) -> [f64; 2] + use<> {
    let structure = structure();
    let term = spec.build(&structure.operating_point(truth(&structure).as_slice())).unwrap();
    let column = |motion: &Motion| {
        let mut y = DMatrix::zeros(2 * motion.samples(), term.columns().len());
        term.fill(structure.chain(), motion, &mut y, 0);
        y.column(0).into_owned()
    };
    let columns: Vec<DVector<f64>> = motions.iter().map(column).collect();
    let rms = |j: usize| {
        let one = |column: &DVector<f64>| column.rows(j * column.len() / 2, column.len() / 2).norm_squared();
        (columns.iter().map(one).sum::<f64>() / (columns.len() * columns[0].len() / 2) as f64).sqrt()
    };
    let scale = size / rms(0).max(rms(1));
    move |at| {
        let column = &columns[at.trajectory];
        [0, 1].map(|j| scale * column[j * column.len() / 2 + at.k])
    }
}

/// The same with the positions of each trajectory scaled.
pub fn scaled(reach: &[f64], seed: u64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    let motions: Vec<Motion> =
        reach.iter().enumerate().map(|(k, reach)| motion(100 * seed + k as u64, PERIOD, true, *reach)).collect();
    along(&motions, seed, added)
}

/// One motion of `seconds` that does not repeat.
pub fn once(seconds: f64, seed: u64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    along(&[motion(100 * seed, seconds, false, 1.0)], seed, added)
}

fn along(motions: &[Motion], seed: u64, added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    along_in_noise(motions, seed, [1.0; 2], added)
}

fn along_in_noise(motions: &[Motion], seed: u64, noise: [f64; 2], added: impl Fn(&At) -> [f64; 2]) -> Recorded {
    let structure = structure();
    let truth = truth(&structure);
    let prepared = |(trajectory, motion): (usize, &Motion)| {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(1 + trajectory as u64);
        let samples = motion.samples();
        let model = structure.regressor(motion) * &truth;
        let rows = if motion.periodic { PERIODS * samples } else { samples };
        let q = DMatrix::from_fn(rows, 2, |row, j| motion.q[(row % samples, j)]);
        let mut tau = DMatrix::zeros(rows, 2);
        for row in 0..rows {
            let k = row % samples;
            let [q, dq] = [&motion.q, &motion.dq].map(|of| [of[(k, 0)], of[(k, 1)]]);
            let at = At { trajectory, k, t: k as f64 * DT, elapsed: row as f64 * DT, q, dq };
            let more = added(&at);
            for j in 0..2 {
                tau[(row, j)] =
                    model[j * samples + k] + more[j] + noise[j] * NOISE * rng.sample::<f64, _>(StandardNormal);
            }
        }
        let run = Run {
            name: format!("trajectory {}", trajectory + 1),
            t: (0..rows).map(|row| row as f64 * DT).collect(),
            q,
            dq: None,
            tau,
            mounting: Mounting::WALL,
            period: motion.periodic.then_some(PERIOD),
        };
        Experiment::prepare(&run, &plumbline_identify::Settings::default()).unwrap()
    };
    let experiments = motions.iter().enumerate().map(prepared).collect();
    Recorded { structure, experiments }
}

impl Recorded {
    /// As what a diagnosis takes.
    pub fn trials(&self) -> Vec<Trial<'_>> {
        Trial::in_turn(&self.experiments)
    }

    /// The plain model fitted to it, and a search among these families.
    pub fn search<T>(
        &self,
        families: &[&'static Family],
        settings: &Settings,
        look: impl FnOnce(&Search, &State) -> T,
    ) -> T {
        let trials = self.trials();
        let evidence = Evidence::of(self.structure.chain(), &trials, settings.band);
        let columns = Columns { m: evidence.regressor(&self.structure, &trials), r: evidence.torques(&trials) };
        let problem = Problem { evidence: &evidence, prior: None };
        let base = State::base(&problem, columns);
        let operating_point = self.structure.operating_point(base.fit.theta.as_slice());
        let library = library(&evidence, &operating_point, families, Span::ALL, 1);
        let search = Search {
            problem,
            operating_point: &operating_point,
            library: &library,
            settings,
            deciding: None,
            came: &[],
        };
        look(&search, &base)
    }
}
