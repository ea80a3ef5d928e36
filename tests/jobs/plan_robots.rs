//! `plumbline plan` finds a feasible motion for every robot that ships with it.

use plumbline::store::load_plan;
use plumbline_excite::{Bounds, Margins, verify};
use plumbline_model::Robot;
use plumbline_testkit::job::*;

#[test]
fn every_shipped_robot_gets_a_feasible_plan() {
    let mut robots: Vec<String> = std::fs::read_dir("config/robots")
        .unwrap()
        .map(|entry| entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_string())
        .collect();
    robots.sort();
    assert!(robots.len() >= 7, "{robots:?}");
    let place = Place::new("plans");
    for name in robots {
        let out = place.path().join(format!("{name}.toml"));
        let mut command = plumbline();
        command
            .args(["plan", "--robot", &name, "--mounting", "wall", "--starts", "1", "--rounds", "0", "--out"])
            .arg(&out);
        let done = Done::of(command).expect_code(0);
        assert!(done.out.contains("condition raw "), "{}", done.output());

        // Held to the limits once more, from the file alone.
        let (plan, robot) = (load_plan(&out).unwrap(), Robot::load(&name, None).unwrap());
        assert_eq!((plan.robot.as_str(), plan.period, plan.harmonics), (name.as_str(), 10.0, 5));
        let bounds = Bounds {
            workspace: Some(&robot.workspace),
            shape: Some(&robot.shape),
            envelope: robot.envelope.as_ref(),
            ..Bounds::new(&robot.chain, &robot.limits, Margins::default())
        };
        let verdict = verify(&bounds, &plan.fourier().unwrap(), None);
        assert!(verdict.violations().next().is_none(), "{name}: {}", verdict.violations().next().unwrap());
        for condition in [plan.conditions.raw, plan.conditions.equilibrated, plan.conditions.weighted] {
            assert!((1.0..1e6).contains(&condition), "{name}: {condition}");
        }
    }
}
