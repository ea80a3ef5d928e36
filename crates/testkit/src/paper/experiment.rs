//! The paper's experiments as functions: what `cargo run --example paper` shows and `cargo test --test identification paper::` holds.
//!
//! Torques of the arms that are identified come from Newton-Euler with the true parameters, never from the regressor that identifies.

use nalgebra::{DMatrix, Vector3};
use plumbline::store::{ModelFile, load_plan};
use plumbline_excite::Fourier;
use plumbline_identify::solve::{Identification, identify};
use plumbline_identify::{Experiment, Run, Settings, validate_parameters};
use plumbline_model::{BaseKind, Chain, LinkParameters, Mounting, Reduction, Robot, Structure, rnea};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::path::PathBuf;

/// Sampling of the paper \[s\].
const DT: f64 = 1e-3;
const PERIOD: f64 = 10.0;
const HARMONICS: usize = 5;
/// Encoder noise of the simulated Panda \[rad\].
const POSITION_NOISE: f64 = 1e-5;

/// Mean over the five trajectories of the paper's Tables IV (on the wall) and V (upright), per joint \[Nm\].
pub const TABLE_4_MEAN: [f64; 7] = [0.288, 0.260, 0.274, 0.120, 0.154, 0.118, 0.058];
/// See [`TABLE_4_MEAN`].
pub const TABLE_5_MEAN: [f64; 7] = [0.276, 0.376, 0.166, 0.134, 0.170, 0.114, 0.064];

fn shipped(file: &str) -> PathBuf {
    crate::path("config").join(file)
}

fn chain(robot: &str) -> Chain {
    Robot::load(robot, None).expect("a shipped robot").chain
}

fn structure(chain: &Chain, kind: BaseKind, terms: &[&str]) -> Structure {
    Structure::of(chain.clone(), Reduction::of_kind(chain, kind), terms).expect("known terms")
}

/// A row of Table I: symbol, expression in the GBS, expression in the VBS (`None` where it has no such parameter).
pub struct Regrouping {
    pub symbol: String,
    pub generalized: String,
    pub vertical: Option<String>,
}

/// Table I for the Panda: all 59 parameters, friction included.
pub fn table_1() -> Vec<Regrouping> {
    let chain = chain("panda");
    let vertical = structure(&chain, BaseKind::Vbs, &["friction"]);
    let same = |name: &str| vertical.columns().iter().find(|column| column.name == name);
    let all = structure(&chain, BaseKind::Gbs, &["friction"]);
    let row = |column: &plumbline_model::term::Column| Regrouping {
        symbol: column.symbol.clone(),
        generalized: column.expression.clone(),
        vertical: same(&column.name).map(|column| column.expression.clone()),
    };
    all.columns().iter().map(row).collect()
}

/// An arm that follows every reference exactly: standard or base parameters in the slots of their names, and friction.
struct Arm {
    chain: Chain,
    links: Vec<LinkParameters>,
    friction: Vec<[f64; 2]>,
}

impl Arm {
    fn torque(&self, gravity: &Vector3<f64>, q: &[f64], dq: &[f64], ddq: &[f64], tau: &mut [f64]) {
        rnea(&self.chain, &self.links, gravity, q, dq, ddq, tau);
        for (j, [fv, fc]) in self.friction.iter().enumerate() {
            tau[j] += fv * dq[j] + fc * (100.0 * dq[j]).tanh();
        }
    }

    /// `periods` of a motion at 1 kHz; white noise of `tau_noise` per joint on the torques, and encoder noise, where there is any.
    fn drive(&self, motion: &Fourier, periods: usize, mounting: Mounting, tau_noise: &[f64], seed: u64) -> Run {
        let (n, gravity) = (self.chain.len(), mounting.gravity());
        let samples = (motion.period / DT).round() as usize;
        let rows = periods * samples;
        let (mut q, mut tau) = (DMatrix::zeros(rows, n), DMatrix::zeros(rows, n));
        let mut row = vec![0.0; n];
        for k in 0..samples {
            let points: Vec<_> = (0..n).map(|j| motion.at(j, k as f64 * DT)).collect();
            let of = |f: fn(&plumbline_excite::Point) -> f64| points.iter().map(f).collect::<Vec<_>>();
            self.torque(&gravity, &of(|p| p.q), &of(|p| p.dq), &of(|p| p.ddq), &mut row);
            for p in 0..periods {
                for j in 0..n {
                    (q[(p * samples + k, j)], tau[(p * samples + k, j)]) = (points[j].q, row[j]);
                }
            }
        }
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        for (j, noise) in tau_noise.iter().enumerate() {
            for k in 0..rows {
                tau[(k, j)] += noise * normal();
                q[(k, j)] += POSITION_NOISE * normal();
            }
        }
        let t = (0..rows).map(|k| k as f64 * DT).collect();
        Run { name: format!("seed {seed}"), t, q, dq: None, tau, mounting, period: Some(motion.period) }
    }
}

/// A random motion that starts and ends at rest, each joint scaled to use `share` of the range, speed and acceleration of the robot.
fn random_plan(robot: &Robot, share: f64, seed: u64) -> Fourier {
    let (n, limits) = (robot.chain.len(), &robot.limits);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let q0 = (0..n).map(|j| {
        let (middle, half) = (0.5 * (limits.q_min[j] + limits.q_max[j]), 0.5 * (limits.q_max[j] - limits.q_min[j]));
        middle + 0.3 * half * rng.random_range(-1.0..1.0)
    });
    let mut motion = Fourier::still(PERIOD, q0.collect(), HARMONICS).expect("a valid shape");
    for amplitudes in [&mut motion.a, &mut motion.b] {
        amplitudes.iter_mut().for_each(|value| *value = StandardNormal.sample(&mut rng));
    }
    motion.project();
    for j in 0..n {
        let mut used: f64 = 0.0;
        for k in 0..500 {
            let point = motion.at(j, k as f64 * PERIOD / 500.0);
            let away = point.q - motion.q0[j];
            let room = if away > 0.0 { limits.q_max[j] - motion.q0[j] } else { motion.q0[j] - limits.q_min[j] };
            used = used.max(away.abs() / room).max(point.dq.abs() / limits.dq[j]).max(point.ddq.abs() / limits.ddq[j]);
        }
        motion.scale_joint(j, share / used);
    }
    motion
}

/// The 2-DOF experiment: Table II, Figs. 3 and 4.
pub struct TwoDof {
    /// Parameters found from the robot with axis 1 horizontal (GBS): name, symbol, expression, value.
    pub horizontal: Vec<(String, String, String, f64)>,
    /// Parameters found from the robot with axis 1 vertical (VBS): name and value.
    pub vertical: Vec<(String, f64)>,
    /// Both models on both robots along one random trajectory.
    pub figures: Vec<Figure>,
    /// RMS error of the V-BAM model in joint 1 of the H-BAM robot along [`TRAJECTORIES`] random trajectories, in rising order \[Nm\].
    pub misses: Vec<f64>,
}

/// Random trajectories behind [`TwoDof::misses`].
pub const TRAJECTORIES: u64 = 50;

/// Torques of both models against the true ones (Fig. 3: vertical mounting, Fig. 4: horizontal).
pub struct Figure {
    pub mounting: &'static str,
    pub t: Vec<f64>,
    /// True torque, that of the H-BAM model, that of the V-BAM model; each N x n \[Nm\].
    pub tau: [DMatrix<f64>; 3],
    /// RMS error of the H-BAM and of the V-BAM model per joint \[Nm\].
    pub rms: [Vec<f64>; 2],
}

/// Identifies the paper's 2-DOF arm in both mountings, without friction and noise, and compares both models in both.
pub fn two_dof() -> TwoDof {
    let robot = Robot::load("paper-2dof", None).expect("a shipped robot");
    let truth = crate::sim::arm("sim-paper-2dof");
    let links = truth.link_parameters();
    let arm = Arm { chain: robot.chain.clone(), links, friction: vec![[0.0; 2]; 2] };
    let excitation = random_plan(&robot, 0.9, 1);
    let found = |kind: BaseKind, mounting: Mounting| -> (Structure, Identification) {
        let structure = structure(&robot.chain, kind, &[]);
        let run = arm.drive(&excitation, 1, mounting, &[], 0);
        let found = identify(&structure, &[prepare(&run, &Settings::default())]).expect("an exciting motion");
        (structure, found)
    };
    let (horizontal, h) = found(BaseKind::Gbs, Mounting::WALL);
    let (vertical, v) = found(BaseKind::Vbs, Mounting::UPRIGHT);

    let figure = |name: &'static str, mounting: Mounting, seed: u64| {
        let trajectory = random_plan(&robot, 0.9, seed);
        let experiment = prepare(&arm.drive(&trajectory, 1, mounting, &[], 0), &Settings::default());
        let of = |structure: &Structure, found: &Identification| structure.torques(&found.beta, &experiment.motion);
        let tau = [experiment.tau.clone(), of(&horizontal, &h), of(&vertical, &v)];
        let rms = [&tau[1], &tau[2]].map(|model| {
            let error = model - &tau[0];
            error.column_iter().map(|e| e.norm() / (e.len() as f64).sqrt()).collect()
        });
        let t = (0..experiment.motion.samples()).map(|k| k as f64 * DT).collect();
        Figure { mounting: name, t, tau, rms }
    };
    let figures = vec![figure("V-BAM", Mounting::UPRIGHT, 2), figure("H-BAM", Mounting::WALL, 2)];
    let mut misses: Vec<f64> =
        (2..2 + TRAJECTORIES).map(|seed| figure("H-BAM", Mounting::WALL, seed).rms[1][0]).collect();
    misses.sort_by(f64::total_cmp);
    let rows = h.columns.iter().zip(&h.beta);
    TwoDof {
        horizontal: rows.map(|(c, &b)| (c.name.clone(), c.symbol.clone(), c.expression.clone(), b)).collect(),
        vertical: v.columns.iter().map(|c| c.name.clone()).zip(v.beta.iter().copied()).collect(),
        figures,
        misses,
    }
}

fn prepare(run: &Run, settings: &Settings) -> Experiment {
    Experiment::prepare(run, settings).expect("an even, periodic run")
}

/// The Panda experiment: Table III as the truth, identified on the wall, validated in both mountings (Tables IV and V).
pub struct Panda {
    /// What was found: 59 parameters with their standard deviations.
    pub found: Identification,
    /// The true ones (Table III) in the same order.
    pub truth: Vec<f64>,
    /// RMS error per trajectory and joint on the wall \[Nm\].
    pub table_4: Vec<Vec<f64>>,
    /// RMS error per trajectory and joint upright \[Nm\].
    pub table_5: Vec<Vec<f64>>,
    /// Trajectory 3 on the wall and upright: Figs. 7 and 8.
    pub shown: Vec<Validation>,
}

/// Measured torques of a validation trajectory against those of the parameters that were found on the wall (Figs. 7 and 8).
pub struct Validation {
    pub mounting: &'static str,
    pub t: Vec<f64>,
    /// Raw measured torque, N x n \[Nm\].
    pub measured: DMatrix<f64>,
    /// Torque of the model, N x n \[Nm\].
    pub estimated: DMatrix<f64>,
    /// RMS of the difference per joint, as in the tables \[Nm\].
    pub rms: Vec<f64>,
}

/// The trajectory that Figs. 7 and 8 show.
const SHOWN: u64 = 3;

/// Identifies a Panda that has exactly the parameters of Table III on the wall, by the paper's processing, from 10 periods of an
/// optimised excitation. The torque noise is white, of the size of the mean of Table IV, and of Table V upright.
pub fn panda(settings: &Settings) -> Panda {
    let robot = Robot::load("panda", None).expect("a shipped robot");
    let table_3 = ModelFile::load(&shipped("models/panda-paper-table3.toml"), |_| Ok(robot.chain.clone()));
    let model = table_3.expect("the shipped table").model;
    let structure = structure(&robot.chain, BaseKind::Gbs, &["friction"]);
    let truth = model.beta();
    let rigid = structure.reduction().len();
    let mut links = vec![[0.0; 10]; robot.chain.len()];
    for (&slot, value) in structure.reduction().independent().iter().zip(&truth) {
        links[slot / 10][slot % 10] = *value;
    }
    let n = robot.chain.len();
    let friction = (0..n).map(|j| [truth[rigid + j], truth[rigid + n + j]]).collect();
    let arm = Arm { chain: robot.chain.clone(), links, friction };

    let plan = load_plan(&shipped("plans/panda-wall.toml")).expect("the shipped plan");
    let excitation = plan.fourier().expect("the shipped plan");
    let run = arm.drive(&excitation, 10, Mounting::WALL, &TABLE_4_MEAN, 1);
    let found = identify(&structure, &[prepare(&run, settings)]).expect("an exciting motion");
    let mut shown = Vec::new();
    let mut table = |name: &'static str, mounting: Mounting, noise: &[f64; 7]| -> Vec<Vec<f64>> {
        (1..=5)
            .map(|trajectory| {
                let run = arm.drive(&random_plan(&robot, 0.6, 100 + trajectory), 1, mounting, noise, 200 + trajectory);
                let experiment = prepare(&run, settings);
                let rms = validate_parameters(&experiment, &structure, &found.beta).raw;
                if trajectory == SHOWN {
                    let along = experiment.comparison_motion.as_ref().unwrap_or(&experiment.motion);
                    let t = (0..along.samples()).map(|k| k as f64 * DT).collect();
                    let estimated = structure.torques(&found.beta, along);
                    let measured = experiment.tau.clone();
                    shown.push(Validation { mounting: name, t, measured, estimated, rms: rms.clone() });
                }
                rms
            })
            .collect()
    };
    let table_4 = table("H-BAM", Mounting::WALL, &TABLE_4_MEAN);
    let table_5 = table("V-BAM", Mounting::UPRIGHT, &TABLE_5_MEAN);
    Panda { found, truth, table_4, table_5, shown }
}

/// Fig. 6: positions of the end effector along the shipped excitation of the Panda on the wall \[m\], and the box and sphere of
/// eq. 14.
pub fn workspace() -> (Vec<[f64; 3]>, plumbline_core::Workspace) {
    let robot = Robot::load("panda", None).expect("a shipped robot");
    let plan = load_plan(&shipped("plans/panda-wall.toml")).expect("the shipped plan");
    let motion = plan.fourier().expect("the shipped plan");
    let at = |k: usize| {
        let q: Vec<f64> = (0..motion.joints()).map(|j| motion.at(j, k as f64 * 0.01).q).collect();
        robot.chain.end_effector(&q).into()
    };
    ((0..=1000).map(at).collect(), robot.workspace)
}
