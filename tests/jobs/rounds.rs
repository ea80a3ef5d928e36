//! A job that asks again: what its diagnosis leaves open decides the motion of the next round.

use plumbline::config::job::Job;
use plumbline::dataset::Dataset;
use plumbline::report::Report;
use plumbline::report::diagnosis::{OpenKind, Verdict};
use plumbline::store::load_plan;
use plumbline_testkit::job::*;
use std::path::{Path, PathBuf};

/// Motion of each joint about the job's start \[rad\].
const REACH: f64 = 0.35;

/// A plan of a small motion: that of a robot whose joints have little range.
fn small_plan(place: &Place) -> PathBuf {
    let job = Job::load(Path::new(WALL), &[]).unwrap();
    let mut start = [job.backend.start.clone().unwrap(), job.backend.start.unwrap()].map(Vec::into_iter);
    let robot = std::fs::read_to_string("config/robots/panda.toml").unwrap();
    let narrow = |line: &str| match line.split_once(" = ").map(|(key, _)| key) {
        Some("q-min") => format!("q-min = {}", start[0].next().unwrap() - REACH),
        Some("q-max") => format!("q-max = {}", start[1].next().unwrap() + REACH),
        _ => line.to_string(),
    };
    let text: Vec<String> = robot.lines().map(narrow).collect();
    let (file, plan) = (place.path().join("narrow.toml"), place.path().join("small.toml"));
    std::fs::write(&file, text.join("\n")).unwrap();
    let mut command = plumbline();
    command.arg("plan").arg("--robot").arg(file).arg("--out").arg(&plan);
    command.args(["--mounting", "wall", "--period", "5", "--starts", "2", "--rounds", "0"]);
    Done::of(command).expect_code(0);
    plan
}

/// The overrides of a job on an arm with this effect that begins with the small motion.
fn sets(place: &Place, effect: &str) -> Vec<String> {
    let arm = place.path().join("arm.toml");
    let plain = std::fs::read_to_string("config/arms/sim-panda.toml").unwrap();
    std::fs::write(&arm, format!("{plain}\n[[effect]]\n{effect}\n")).unwrap();
    let plan = format!("excitation.plan={}", small_plan(place).display());
    let fixed = [
        "excitation.periods=6",
        "validation.trajectories=0",
        "validation.counter-experiment=false",
        "diagnosis.rounds=2",
    ];
    let own = [plan, format!("backend.arm={}", arm.display())];
    fixed.map(String::from).into_iter().chain(own).collect()
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn rivals_are_told_apart_by_the_motion_that_is_planned_for_them() {
    let place = Place::new("rounds");
    let sets = sets(&place, "id = \"position-ripple\"\njoint = 3\norder = 1\nsine = 0.3");
    let sets: Vec<&str> = sets.iter().map(String::as_str).collect();
    let done = place.run(&sets).expect_code(0);
    let first = Report::read(&place.out().join("round-1")).unwrap();
    let asked = first.diagnosis.unwrap();
    assert!(asked.verdict == Verdict::Ambiguous && asked.effects.len() == 1, "{asked:#?}");
    let [question] = &asked.open[..] else { panic!("{:?}", asked.open) };
    let expected = question.expected.unwrap();
    assert!(question.kind == OpenKind::Rivals && expected > question.wanted, "{question:?}");
    assert!(["spring in joint 3", "position-ripple in joint 3"].iter().all(|one| question.question.contains(one)));

    let last = place.report();
    let found = last.diagnosis.unwrap();
    assert!(found.verdict == Verdict::Diagnosed && found.open.is_empty(), "{found:#?}");
    let [effect] = &found.effects[..] else { panic!("{:#?}", found.effects) };
    assert!(effect.id == "position-ripple" && effect.joints == [3] && effect.alternatives.is_empty(), "{effect:#?}");
    let size = effect.parameters.0.iter().find(|parameter| parameter.name.ends_with("_sin")).unwrap();
    assert!((size.value - 0.3).abs() < 4.0 * size.std.unwrap(), "{size:?}");
    assert!(last.rounds.len() == 1 && last.rounds[0].open == asked.open, "{:?}", last.rounds);
    for text in ["round 1: ", "open: ", "expected with the planned motion"] {
        assert!(done.out.contains(text), "{}", done.output());
    }

    // The second round drove the planned motion alone, and is diagnosed with the first.
    let planned = load_plan(&place.out().join("round-1/next.toml")).unwrap();
    let driven = load_plan(&place.out().join("plans/identify-wall.toml")).unwrap();
    assert!(driven.a == planned.a && driven.q0 == planned.q0);
    let names = |dir: &Path| {
        Dataset::read(&dir.join("dataset")).unwrap().runs.into_iter().map(|run| run.data.name).collect::<Vec<_>>()
    };
    assert_eq!(names(&place.out().join("round-1")), ["identify-wall.csv"]);
    assert_eq!(names(&place.out()), ["identify-wall.csv", "identify-wall-round-2.csv"]);
    assert!(!place.out().join("next.toml").exists() && !place.out().join("round-2").exists());

    // The same from the recorded data of the first round; of both rounds nothing is open.
    let next = |dataset: &Path, out: &Path| {
        let mut command = plumbline();
        command.arg("next").arg(dataset).arg("--out").arg(out).args(["--verbose", "--force", "--period", "5"]);
        Done::of(command).expect_code(0)
    };
    let out = place.path().join("next");
    let open = next(&place.out().join("round-1/dataset"), &out);
    let planned = open.out.contains("expected with the planned motion") && load_plan(&out.join("next.toml")).is_ok();
    assert!(planned, "{}", open.output());
    let none = next(&place.out().join("dataset"), &out);
    assert!(none.out.contains("nothing is left open") && !out.join("next.toml").exists(), "{}", none.output());
}

#[test]
fn rounds_need_the_recorded_runs() {
    let place = Place::new("rounds-dataset");
    for (sets, key) in [
        (["diagnosis.rounds=2", "output.dataset=false"], "diagnosis.rounds"),
        (["diagnosis.rounds=11", "output.dataset=true"], "diagnosis.rounds"),
        (["diagnosis.until=0", "output.dataset=true"], "diagnosis.until"),
    ] {
        let done = place.run(&sets).expect_code(2);
        assert!(done.err.contains(key), "{}", done.output());
    }
}
