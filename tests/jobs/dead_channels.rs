//! Sensors that measure nothing: the program ends in bounded time and names the channel.

use plumbline::dataset::{Dataset, Role, Run};
use plumbline::store::{ModelFile, Provenance};
use plumbline_ipc::Progress;
use plumbline_model::{Reduction, Structure, TorqueModel};
use plumbline_testkit::job::*;
use plumbline_testkit::scene::Scene;
use std::path::{Path, PathBuf};
use std::time::Duration;

fn run(scene: &Scene, file: &str, role: Role, periodic: bool) -> Run {
    scene.dataset_run(file, role, (3, 7), 4, periodic)
}

/// A dataset of two runs to identify from and one to validate with, the second changed by `spoil`.
fn dataset(scene: &Scene, folder: PathBuf, periodic: bool, spoil: impl Fn(&mut Run, usize)) -> PathBuf {
    let roles = [("a.csv", Role::Identify), ("b.csv", Role::Identify), ("c.csv", Role::Validate)];
    let mut runs = roles.map(|(file, role)| run(scene, file, role, periodic));
    runs.iter_mut().enumerate().for_each(|(index, run)| spoil(run, index));
    let (name, robot) = ("dead".into(), "panda".into());
    let dataset = Dataset { name, robot, mounting: scene.mounting, source: toml::Table::new(), runs: runs.to_vec() };
    dataset.write(&folder).unwrap();
    folder
}

fn model(scene: &Scene, path: &Path) {
    let chain = scene.structure.chain().clone();
    let structure =
        Structure::of(chain.clone(), Reduction::in_mounting(&chain, &scene.mounting), &["friction"]).unwrap();
    let values: Vec<(f64, Option<f64>)> = scene.beta.iter().map(|&value| (value, Some(1e-3))).collect();
    let model = TorqueModel::new("panda", structure, vec![scene.mounting], &values).unwrap();
    let (noise_floor, validation, provenance) = (Vec::new(), Vec::new(), Provenance::default());
    let file = ModelFile { model, noise_floor, validation, uncertainty: None, consistent: None, provenance };
    std::fs::write(path, file.to_toml()).unwrap();
}

#[test]
fn a_constant_channel_is_named() {
    let scene = Scene::panda_on_the_wall();
    let place = Place::new("dead-channels");
    let stored = place.path().join("model.toml");
    model(&scene, &stored);
    type Spoil = fn(&mut Run, usize);
    let cases: [(&str, Spoil, &[&str]); 5] = [
        ("all torques zero", |run, _| run.data.tau.fill(0.0), &["a.csv", "column tau1", "got 0 in all", "joint 1"]),
        (
            "one torque zero in one run",
            |run, index| {
                if index == 1 {
                    run.data.tau.column_mut(2).fill(0.0)
                }
            },
            &["b.csv", "column tau3", "got 0 in all", "torque sensor of joint 3"],
        ),
        (
            "one torque constant",
            |run, _| run.data.tau.column_mut(3).fill(1.5),
            &["a.csv", "column tau4", "got 1.5 in all", "torque sensor of joint 4"],
        ),
        (
            "one position constant",
            |run, _| run.data.q.column_mut(1).fill(-0.25),
            &["a.csv", "column q2", "got -0.25 in all", "encoder of joint 2"],
        ),
        ("all positions constant", |run, _| run.data.q.fill(0.5), &["a.csv", "column q1", "got 0.5 in all", "joint 1"]),
    ];
    for (name, spoil, parts) in cases {
        for periodic in [true, false] {
            let data = dataset(&scene, place.path().join(format!("{name} {periodic}")), periodic, spoil);
            let mut commands = vec![["identify", "--terms", "friction"], ["diagnose", "--terms", "friction"]];
            if name.contains("torque") {
                commands.push(["compare", "--threshold", "0.01"]);
            }
            for [command, option, value] in commands {
                let mut program = plumbline();
                program.arg(command);
                if command == "compare" {
                    program.arg(&stored);
                }
                program.arg(&data).arg("--out").arg(place.out()).args([option, value]);
                let done = Done::of(program).expect_code(2);
                for part in parts {
                    assert!(done.err.contains(part), "{name}, {command}: no `{part}` in {}", done.output());
                }
                assert!(!place.out().exists());
            }
        }
    }
    // A joint that stands in one run and moves in another is no fault, nor is an unseen run of an arm at rest.
    let standing = |run: &mut Run, index: usize| {
        if index == 1 {
            run.data.q.column_mut(6).fill(0.5)
        }
    };
    let data = dataset(&scene, place.path().join("standing"), true, standing);
    Done::of(plumbline().arg("identify").arg(&data).arg("--out").arg(place.out()).args(["--terms", "friction"]))
        .expect_code(0);
}

/// The shipped arm with more keys in its file.
fn arm(place: &Place, keys: &str) -> String {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/arms/sim-panda.toml");
    let path = place.path().join("arm.toml");
    std::fs::write(&path, format!("{keys}\n{}", std::fs::read_to_string(shipped).unwrap())).unwrap();
    format!("backend.arm={}", path.display())
}

#[test]
fn a_job_of_an_arm_with_dead_torque_sensors_ends() {
    for (sensors, column) in [("[1, 2, 3, 4, 5, 6, 7]", "tau1"), ("[5]", "tau5")] {
        let place = Place::new("dead-sensors");
        let arm = arm(&place, &format!("dead-torque-sensors = {sensors}"));
        let done = place.run(&short(&[&arm])).expect_code(1);
        for part in ["identify-wall", &format!("column {column}"), "got 0 in all", "torque sensor of joint"] {
            assert!(done.err.contains(part), "no `{part}` in {}", done.output());
        }
        assert!(anyone_with(&place.id).is_empty());
    }
}

#[test]
fn an_arm_without_a_model_is_stopped() {
    let place = Place::new("no-model");
    let sets = short(&["safety.model-timeout=2 s"]);
    let daemon = place.daemon(&sets);
    // No estimator.
    place.command("start").expect_code(0);
    wait_for("the wait for a model", || place.status().filter(|now| now.progress == Progress::AwaitingModel));
    let status = wait_for("the stop", || place.status().filter(|now| now.progress == Progress::Stopped));
    let why = status.stopped.unwrap();
    assert!(why.contains("no model within 2 s (safety.model-timeout)"), "{why}");
    // Simulated time does not run on at full speed.
    let mut last = None;
    wait_for("the end of simulated time", || {
        std::thread::sleep(Duration::from_millis(100));
        let now = place.status()?.cycles;
        (last.replace(now) == Some(now)).then_some(())
    });
    let done = place.quit(daemon);
    assert!(done.err.contains("the arm is being stopped: the estimator gave no model"), "{}", done.output());
}

#[test]
fn a_run_ends_although_its_estimator_hangs() {
    let place = Place::new("endless-estimator");
    let run = Running::start(place.job("run", &short(&["safety.model-timeout=1 s", "excitation.periods=8"])));
    let estimator = wait_for("the estimator", || children(run.pid(), "estimator").first().copied());
    wait_for("the motion", || (place.status()?.cycles > 1_000).then_some(()));
    signal(estimator, "STOP");
    let done = run.end().expect_code(1);
    for part in ["the arm was stopped", "no model within 1 s", "did not end by itself"] {
        assert!(done.err.contains(part), "no `{part}` in {}", done.output());
    }
    wait_for("the end of every process", || anyone_with(&place.id).is_empty().then_some(()));
}
