//! Random motions: limits, excitation, and errors of infeasible start poses.

use plumbline_core::{Limits, Workspace};
use plumbline_excite::{
    Bounds, ExciteError, MAX_CONDITION, MIN_USAGE, Margins, Nominal, Plan, Problem, Search, SearchControl, least_usage,
    optimise, random_plan, usage, verify_with_guard,
};
use plumbline_model::{Chain, Mounting, Reduction, Robot, Structure};

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
fn torque_limits_are_satisfied_with_a_nominal_model() {
    let arm = Arm::new();
    // Rotors alone: 3 kg m2 times the acceleration in every joint.
    let nominal = Nominal { links: vec![[0.0; 10]; 7], rotor: [3.0; 8], ..Nominal::default() };
    let mut problem = arm.problem(Some(&START));
    problem.bounds.margins.torque = 0.5;
    let free = random_plan(&problem, &short(), 1.0).unwrap();
    problem.nominal = Some(&nominal);
    let check = |plan: &Plan| verify_with_guard(&problem, &plan.fourier().unwrap()).is_feasible();
    assert!(!check(&free));
    let held = random_plan(&problem, &short(), 1.0).unwrap();
    assert!(check(&held));
    assert!(free.constraints.tau.is_none() && held.constraints.tau.is_some());
}

#[test]
fn random_motions_are_feasible_and_differ() {
    let arm = Arm::new();
    let problem = arm.problem(None);
    let mut plans: Vec<Plan> = Vec::new();
    for seed in 0..5 {
        let plan = random_plan(&problem, &Search { seed, ..Search::default() }, 0.6).unwrap();
        assert!(verify_with_guard(&problem, &plan.fourier().unwrap()).is_feasible());
        assert!(plans.iter().all(|other| other.a != plan.a));
        plans.push(plan);
    }
}

/// For any shipped robot, mounting and seed every joint moves and every limit is satisfied.
#[test]
fn random_motions_move_every_joint_of_every_shipped_robot() {
    let mountings = [Mounting::UPRIGHT, Mounting::WALL, Mounting::CEILING, Mounting { rho: 1.0, phi: 0.4 }];
    for name in Robot::names() {
        let robot = Robot::load(name, None).unwrap();
        let n = robot.chain.len();
        let reduction = Reduction::any_mounting(&robot.chain);
        let structure = Structure::of(robot.chain.clone(), reduction, &["friction"]).unwrap();
        let bounds = Bounds {
            workspace: Some(&robot.workspace),
            shape: Some(&robot.shape),
            envelope: robot.envelope.as_ref(),
            ..Bounds::new(&robot.chain, &robot.limits, Margins::default())
        };
        for seed in 0..12 {
            let problem = Problem {
                robot: name,
                structure: &structure,
                mounting: mountings[seed % mountings.len()],
                bounds: Bounds { links_in_box: seed % 3 == 2, ..bounds },
                nominal: None,
                sigma: &[0.1; 7][..n],
                q0: None,
            };
            let search = Search { seed: seed as u64, ..Search::default() };
            let plan =
                random_plan(&problem, &search, 0.7).unwrap_or_else(|error| panic!("{name}, seed {seed}: {error}"));
            let fourier = plan.fourier().unwrap();
            assert!(verify_with_guard(&problem, &fourier).is_feasible(), "{name}, seed {seed}");
            let usage = usage(&problem.bounds, &fourier);
            let (joint, least) = least_usage(&usage).unwrap();
            assert!(least.largest() >= MIN_USAGE, "{name}, seed {seed}, joint {}: {least:?}", joint + 1);
            let reported = plan.usage.unwrap();
            assert_eq!((reported.range.len(), reported.speed.len()), (n, n));
            assert!(
                (reported.range[joint] - least.range).abs() < 1e-3
                    && (reported.speed[joint] - least.speed).abs() < 1e-3
            );
        }
    }
}

/// A small box around the end effector: the error contains the joint and the limit that bounds it.
#[test]
fn the_error_of_a_frozen_joint_contains_the_limit_that_bounds_it() {
    let mut arm = Arm::new();
    let at: [f64; 3] = panda().end_effector(&START).into();
    arm.workspace = Workspace { box_min: at.map(|x| x - 0.03), box_max: at.map(|x| x + 0.03), base_radius: 0.0 };
    let error = random_plan(&arm.problem(Some(&START)), &short(), 0.7).unwrap_err();
    let ExciteError::Frozen { usage, limited_by, draws, .. } = &error else { panic!("{error}") };
    assert!(usage.largest() < MIN_USAGE && *draws > 1);
    assert!(limited_by.is_some_and(|peak| peak.joint.is_none()), "{error}");
    let words = error.to_string();
    assert!(words.contains("is frozen") && words.contains("a larger motion violates: end effector"), "{words}");
}

/// Speed limits near zero: the error contains the undetermined parameters.
#[test]
fn the_error_of_an_unexciting_motion_contains_the_undetermined_parameters() {
    let mut arm = Arm::new();
    arm.limits.dq = arm.limits.dq.map(|dq| dq.min(0.001));
    let search = Search { starts: 1, rounds: 0, ..Search::default() };
    let error = optimise(&arm.problem(None), &search, &[], &SearchControl::with_threads(2)).unwrap_err();
    let ExciteError::Unexcited { condition, parameters } = &error else { panic!("{error}") };
    assert!(*condition > MAX_CONDITION && !parameters.is_empty(), "{error}");
    let known = |name: &String| arm.structure.columns().iter().any(|column| column.name == *name);
    assert!(parameters.iter().all(known), "{error}");
    assert!(error.to_string().contains("does not determine"), "{error}");
}

#[test]
fn the_error_of_an_infeasible_start_pose_contains_the_violation() {
    let arm = Arm::new();
    let mut high = START;
    high[3] = 0.1;
    let error = random_plan(&arm.problem(Some(&high)), &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::StartJoint { joint: 4, .. }), "{error}");
    assert!(error.to_string().contains("joint 4 at 0.1 rad"), "{error}");

    // Stretched straight up, out of the top of the box.
    let stretched = [0.0, 0.0, 0.0, -0.13, 0.0, 1.6, 0.0];
    let mut low = Arm::new();
    low.workspace.box_max[2] = 0.8;
    let error = random_plan(&low.problem(Some(&stretched)), &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::StartWorkspace { .. }), "{error}");
    assert!(error.to_string().contains("end effector z"), "{error}");

    // A link outside the box is a violation only with `links_in_box`.
    let shape = Robot::load("panda", None).unwrap().shape;
    let at: [f64; 3] = panda().end_effector(&START).into();
    low.workspace = Workspace { box_min: at.map(|x| x - 0.03), box_max: at.map(|x| x + 0.03), base_radius: 0.0 };
    let mut problem = low.problem(Some(&START));
    (problem.bounds.shape, problem.bounds.links_in_box) = (Some(&shape), true);
    let error = random_plan(&problem, &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::StartPose { .. }), "{error}");
    assert!(
        error.to_string().starts_with("start pose: link ") && !error.to_string().contains("end effector"),
        "{error}"
    );
    problem.bounds.links_in_box = false;
    let error = random_plan(&problem, &short(), 0.5).unwrap_err();
    assert!(matches!(error, ExciteError::Frozen { .. }), "{error}");

    low.workspace = Workspace { box_min: [2.0; 3], box_max: [3.0; 3], base_radius: 0.0 };
    assert!(matches!(random_plan(&low.problem(None), &short(), 0.5), Err(ExciteError::NoStart { .. })));
    low.limits.ddq[1] = 0.0;
    let error = random_plan(&low.problem(None), &short(), 0.5).unwrap_err();
    assert_eq!(error, ExciteError::NoRoom { joint: 2, what: "acceleration" });
}
