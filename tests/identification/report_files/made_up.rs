//! The report of a job as it could have been, with figures that no job made.

use plumbline::config::job::Pace;
use plumbline::report::figures::{Bin, DurationFigure, FrictionFigure, PlanFigure, TorqueFigure};
use plumbline::report::*;
use plumbline::store::ModelFile;
use plumbline_core::{Distribution, LoopStatistics, Workspace};
use plumbline_ipc::{Link, Session, StreamCounters};
use plumbline_model::{Mounting, Robot};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

pub const FLOOR: [f64; 7] = [0.15, 0.15, 0.15, 0.15, 0.06, 0.06, 0.06];

/// The report of a job as it could have been, with Table III as its result.
pub fn report() -> Report {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    let mut model =
        ModelFile::load(&path, |robot| Ok(Robot::load(robot, None)?.chain)).unwrap().model.parameters().to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for parameter in &mut model {
        parameter.std = Some(10f64.powf(rng.random_range(-4.5..-2.0)));
    }
    let run = |index: usize, mounting: Mounting, rng: &mut ChaCha8Rng| {
        let rms: Vec<f64> = FLOOR.iter().map(|floor| floor * rng.random_range(1.0..1.08)).collect();
        Validation {
            run: format!("{mounting}-{index}.csv"),
            rms_filtered: rms.iter().map(|rms| rms / 10.0).collect(),
            served_rms: Some(rms.iter().map(|rms| rms * 1.02).collect()),
            rms_raw: rms,
            mounting: mounting.into(),
        }
    };
    let mut validate: Vec<_> = (1..=5).map(|index| run(index, Mounting::WALL, &mut rng)).collect();
    validate.extend((1..=5).map(|index| run(index, Mounting::UPRIGHT, &mut rng)));
    let condition = |definition: &str, with_friction, without_friction| Condition {
        definition: definition.into(),
        with_friction,
        without_friction,
    };
    let mut provenance = serde_json::Map::new();
    provenance.insert("plumbline".into(), "0.1.0".into());
    provenance.insert("dataset".into(), "3f5a".repeat(16).into());
    provenance.insert("source".into(), "/home/me/job.toml".into());
    provenance.insert("command".into(), "plumbline run job.toml".into());
    Report {
        checks: Vec::new(),
        robot: "panda".into(),
        mounting: Mounting::WALL.into(),
        base: Base::new("GBS", &model).with_intervals(&[Some(0.01); 59]),
        identify: Fit {
            rms_raw: FLOOR.map(|floor| floor * 1.01).to_vec(),
            rms_filtered: FLOOR.map(|floor| floor / 30.0).to_vec(),
        },
        validate,
        band: Band::Raw,
        counter_experiment: Some(counter_experiment()),
        noise_floor: FLOOR.to_vec(),
        diagnosis: None,
        rounds: Vec::new(),
        identifiability: Identifiability::default(),
        consistency: None,
        conditions: vec![
            condition("raw", 131.4, 122.8),
            condition("column-equilibrated", 34.2, 31.9),
            condition("noise-weighted", 148.0, 139.5),
        ],
        motions: ["identify-wall", "validate-wall-1"]
            .map(|motion| MotionUsage {
                motion: motion.into(),
                range: vec![0.4; 7],
                speed: vec![0.875; 7],
                search: None,
            })
            .to_vec(),
        estimator: None,
        gravity: None,
        control_loop: Some(LoopReport {
            pace: Pace::WallClock,
            cycles: 131_072,
            late: Some(3),
            sessions: ["wall", "upright"].map(session).to_vec(),
            ..LoopReport::default()
        }),
        guest: None,
        ipc: Some(ipc(131_072, 131_072)),
        provenance,
        notes: Vec::new(),
    }
}

/// The vertical set that misses two parameters of joint 1.
pub fn counter_experiment() -> CounterExperiment {
    let mut forced = FLOOR.to_vec();
    forced[0] = 0.225;
    CounterExperiment {
        identified_in: Mounting::UPRIGHT.into(),
        kind: "VBS".into(),
        count: 57,
        refused_in: Mounting::WALL.into(),
        refusal: "the VBS model of panda lacks lxR1 and lyR1".into(),
        forced_rms: forced,
        general_rms: FLOOR.to_vec(),
    }
}

pub fn ipc(sent: u64, received: u64) -> IpcReport {
    IpcReport { sent, counters: StreamCounters { received, ..StreamCounters::default() } }
}

pub fn session(name: &str) -> Session {
    let times = |p50_ns: u64| Distribution {
        count: 65_536,
        p50_ns,
        p99_ns: 3 * p50_ns,
        p999_ns: 12 * p50_ns,
        max_ns: 300 * p50_ns,
    };
    let statistics = LoopStatistics {
        elapsed: 65_537,
        cycles: 65_536,
        lost: 1,
        longest_lost: 1,
        late: Some(3),
        wake_up: times(28_000),
        execution: times(6_100),
        period: times(1_000_000),
        ..LoopStatistics::default()
    };
    Session {
        name: name.into(),
        statistics,
        allocations: Some(0),
        bridge: times(600_000),
        refusals: vec!["CPU 1 is not isolated".into()],
        end: "ended on request, at rest".into(),
        link: Some(Link {
            robot: "FR3, version 10".into(),
            states: 65_536,
            lost: 1,
            success: Some([0.97, 0.999]),
            turnaround: times(61_000),
            gravity: Some([0.0, 0.0, -9.81]),
            fault: Some("joint_velocity_violation: a joint was too fast".into()),
            ..Link::default()
        }),
    }
}

pub fn figures(samples: usize) -> Figures {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let t: Vec<f64> = (0..samples).map(|k| k as f64 * 10.0 / samples as f64).collect();
    let wave = |j: usize, t: f64| {
        let w = 0.2 * std::f64::consts::PI * t;
        (1..=5).map(|k| ((k as f64) * w * (1.0 + 0.1 * j as f64) + (j * k) as f64).sin() / k as f64).sum::<f64>()
    };
    let scale = [20.0, 40.0, 20.0, 18.0, 3.0, 3.0, 1.0];
    let modelled: Vec<Vec<f64>> = (0..7).map(|j| t.iter().map(|&t| scale[j] * wave(j, t)).collect()).collect();
    let mut noisy = |j: usize| modelled[j].iter().map(|tau| tau + FLOOR[j] * rng.random_range(-1.7..1.7)).collect();
    let measured: Vec<Vec<f64>> = (0..7).map(&mut noisy).collect();
    let run = |title: &str| TorqueFigure {
        title: title.into(),
        t: t.clone(),
        measured: measured.clone(),
        modelled: modelled.clone(),
        raw: Vec::new(),
        noise: FLOOR.to_vec(),
    };
    Figures {
        runs: vec![
            run("Identification, wall: average of 10 periods"),
            run("Validation wall-1"),
            run("Validation upright-1"),
        ],
        plan: Some(PlanFigure {
            poses: vec![vec![[0.0; 3], [0.0, 0.0, 0.3], [0.4, 0.1, 0.5]]; 10],
            limits: vec![[-2.0, 2.0]; 7],
            t: t.clone(),
            q: (0..7).map(|j| t.iter().map(|&t| wave(j, t)).collect()).collect(),
            end_effector: t
                .iter()
                .map(|&t| [0.5 + 0.1 * wave(1, t), 0.3 * wave(2, t), 0.5 + 0.2 * wave(3, t)])
                .collect(),
            workspace: Some(Workspace { box_min: [-0.2, -0.9, 0.0], box_max: [0.9, 0.9, 1.2], base_radius: 0.25 }),
        }),
        friction: vec![FrictionFigure {
            joint: 1,
            velocity: (-4..=4).map(|k| bin(0.1 * f64::from(k))).collect(),
            displacement: (1..=9).map(|k| bin(1e-3 * f64::from(k))).collect(),
        }],
        correlation: (0..59)
            .map(|c| (0..59).map(|d| if c == d { 1.0 } else { 0.9 - 0.03 * d as f64 }).collect())
            .collect(),
        durations: vec![DurationFigure {
            title: "wake-up latency".into(),
            edges: vec![1.0, 2.0, 4.0],
            counts: vec![9, 1],
        }],
        ..Figures::default()
    }
}

pub fn bin(x: f64) -> Bin {
    Bin { x, measured: x.signum(), deviation: 0.1, modelled: 0.9 * x.signum() }
}
