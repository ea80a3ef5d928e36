//! Random motions of a Panda on a wall: they keep every limit, and say what is wrong with a start pose.

use plumbline::config::robot::Robot;
use plumbline::excite::ExciteError;
use plumbline::excite::criterion::{evaluate, raw_condition, sampled};
use plumbline::excite::limits::{Bounds, Margins};
use plumbline::excite::nominal::Nominal;
use plumbline::excite::plan::Plan;
use plumbline::excite::search::{Problem, Search, random, verdict};
use plumbline::joint::{Limits, Workspace};
use plumbline::model::base::Reduction;
use plumbline::model::chain::Chain;
use plumbline::model::gravity::Mounting;
use plumbline::model::structure::Structure;

const START: [f64; 7] = [0.0, -0.4, 0.0, -1.9, 0.0, 1.9, 0.0];

fn panda() -> Chain {
    Robot::load("panda", None).expect("a shipped robot").chain
}

fn limits() -> Limits {
    Limits {
        q_min: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973, 0.0],
        q_max: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973, 0.0],
        dq: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61, 0.0],
        ddq: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0, 0.0],
        jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0, 0.0],
        tau: [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0, 0.0],
        dtau: [1000.0; 8],
    }
}

fn workspace() -> Workspace {
    Workspace { box_min: [-0.9, -0.9, -0.05], box_max: [0.9, 0.9, 1.25], base_radius: 0.3 }
}

struct Arm {
    structure: Structure,
    limits: Limits,
    workspace: Workspace,
    sigma: [f64; 7],
}

impl Arm {
    fn new() -> Arm {
        let chain = panda();
        let reduction = Reduction::any_mounting(&chain);
        let structure = Structure::of(chain, reduction, &["friction"]).unwrap();
        assert_eq!(structure.columns().len(), 59);
        let sigma = [0.1, 0.1, 0.1, 0.1, 0.05, 0.05, 0.05];
        Arm { structure, limits: limits(), workspace: workspace(), sigma }
    }

    fn problem<'a>(&'a self, q0: Option<&'a [f64]>) -> Problem<'a> {
        let (limits, workspace) = (&self.limits, Some(&self.workspace));
        Problem {
            robot: "panda",
            structure: &self.structure,
            mounting: Mounting::WALL,
            bounds: Bounds { workspace, ..Bounds::new(self.structure.chain(), limits, Margins::default()) },
            nominal: None,
            sigma: &self.sigma,
            q0,
        }
    }
}

fn short() -> Search {
    Search { samples: 60, seed: 5, ..Search::default() }
}

#[test]
fn torque_limits_are_kept_with_a_nominal_model() {
    let arm = Arm::new();
    // Rotors alone: 3 kg m2 times the acceleration in every joint.
    let nominal = Nominal { links: vec![[0.0; 10]; 7], rotor: [3.0; 8], ..Nominal::default() };
    let mut problem = arm.problem(Some(&START));
    problem.bounds.margins.torque = 0.02;
    let free = random(&problem, &short(), 1.0).unwrap();
    problem.nominal = Some(&nominal);
    let check = |plan: &Plan| verdict(&problem, &plan.fourier().unwrap()).is_feasible();
    assert!(!check(&free));
    let held = random(&problem, &short(), 1.0).unwrap();
    assert!(check(&held));
    assert!(free.constraints.tau.is_none() && held.constraints.tau.is_some());
}

#[test]
fn random_motions_are_feasible_and_differ() {
    let arm = Arm::new();
    let problem = arm.problem(None);
    let mut plans: Vec<Plan> = Vec::new();
    for seed in 0..5 {
        let plan = random(&problem, &Search { seed, ..Search::default() }, 0.6).unwrap();
        assert!(verdict(&problem, &plan.fourier().unwrap()).is_feasible());
        assert!(plans.iter().all(|other| other.a != plan.a));
        plans.push(plan);
    }
}

#[test]
fn the_fast_criterion_is_the_raw_condition_number() {
    let arm = Arm::new();
    let problem = arm.problem(Some(&START));
    for seed in 0..4 {
        let plan = random(&problem, &Search { seed, ..Search::default() }, 0.9).unwrap();
        let motion = sampled(&plan.fourier().unwrap(), &Mounting::WALL.gravity(), 150);
        let exact = evaluate(&arm.structure, &motion, &arm.sigma).raw;
        let fast = raw_condition(&arm.structure, &motion);
        assert!((fast / exact - 1.0).abs() < 1e-6, "{fast} {exact}");
    }
    // Upright, two of the generalized parameters are not excited at all.
    let plan = random(&problem, &Search::default(), 0.9).unwrap();
    let motion = sampled(&plan.fourier().unwrap(), &Mounting::UPRIGHT.gravity(), 150);
    assert_eq!(raw_condition(&arm.structure, &motion), f64::INFINITY);
    assert!(evaluate(&arm.structure, &motion, &arm.sigma).equilibrated > 1e12);
}

#[test]
fn an_infeasible_start_pose_is_named() {
    let arm = Arm::new();
    let mut high = START;
    high[3] = 0.1;
    let error = random(&arm.problem(Some(&high)), &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::StartJoint { joint: 4, .. }), "{error}");
    assert!(error.to_string().contains("joint 4 at 0.1 rad"), "{error}");

    // Stretched straight up, out of the top of the box.
    let stretched = [0.0, 0.0, 0.0, -0.13, 0.0, 1.6, 0.0];
    let mut low = Arm::new();
    low.workspace.box_max[2] = 0.8;
    let error = random(&low.problem(Some(&stretched)), &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::StartWorkspace { .. }), "{error}");
    assert!(error.to_string().contains("end effector z"), "{error}");

    low.workspace = Workspace { box_min: [2.0; 3], box_max: [3.0; 3], base_radius: 0.0 };
    assert!(matches!(random(&low.problem(None), &short(), 0.5), Err(ExciteError::NoStart { .. })));
    low.limits.ddq[1] = 0.0;
    let error = random(&low.problem(None), &short(), 0.5).unwrap_err();
    assert_eq!(error, ExciteError::NoRoom { joint: 2, what: "acceleration" });
}

#[test]
fn a_plan_survives_its_file() {
    let arm = Arm::new();
    let plan = random(&arm.problem(None), &short(), 0.5).unwrap();
    let text = toml::to_string(&plan).unwrap();
    let back: Plan = plumbline::input::from_toml("plan.toml", &text).unwrap();
    assert_eq!(plan, back);
    assert_eq!(plan.fourier().unwrap(), back.fourier().unwrap());
    let mut short = back;
    short.a[2].pop();
    assert!(matches!(short.fourier(), Err(ExciteError::Shape { .. })));
}
