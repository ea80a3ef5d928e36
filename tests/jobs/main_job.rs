//! The main job, in a short form: one command identifies the arm on the wall, serves the model, and predicts both mountings.

use plumbline::report::Report;
use plumbline::report::diagnosis::Verdict;
use plumbline::store::ModelFile;
use plumbline_identify::solve::student_975;
use plumbline_model::Robot;
use plumbline_testkit::job::*;
use plumbline_testkit::sim::arm;
use std::path::Path;

/// The shipped job with short periods, but with everything in it: unseen motions in both mountings, the counter-experiment, the dataset.
const JOB: [&str; 4] =
    ["excitation.period=4 s", "excitation.periods=5", "excitation.starts=4", "validation.trajectories=2"];

/// Mean RMS over joints and runs of one mounting.
fn validation_rms(report: &Report, mounting: &str) -> f64 {
    let runs: Vec<f64> =
        report.validate.iter().filter(|run| run.mounting.name == mounting).map(|run| mean(&run.rms_raw)).collect();
    assert_eq!(runs.len(), 2, "{mounting}");
    mean(&runs)
}

/// The torques that `plumbline predict` writes for a run of the dataset, and what it says about their errors.
fn predict(place: &Place, run: &str) -> (Vec<Vec<f64>>, Vec<f64>) {
    let out = place.path().join("tau.csv");
    let mut command = plumbline();
    command.arg("predict").arg(place.out().join("model.toml")).arg(place.out().join("dataset").join(run));
    let done = Done::of(command.arg("--out").arg(&out)).expect_code(0);
    let line = done.out.lines().find(|line| line.contains("raw")).unwrap_or_else(|| panic!("{}", done.output()));
    let raw = line.split("raw ").nth(1).unwrap().split(" |").next().unwrap();
    (csv(&out), raw.split(' ').map(|value| value.parse().unwrap()).collect())
}

/// Rows of a CSV file of numbers; the header's columns are named `t`, then one `tau` per joint, then `at_end`, then the interval of each joint.
fn csv(path: &Path) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let interval: String = (1..=7).map(|j| format!(",tau{j}_low,tau{j}_high")).collect();
    assert_eq!(lines.next().unwrap(), format!("t,tau1,tau2,tau3,tau4,tau5,tau6,tau7,at_end{interval}"));
    lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap()).collect()).collect()
}

#[test]
fn one_command_identifies_serves_and_validates() {
    let place = Place::new("main");
    let done = place.run(&JOB).expect_code(0);
    let report = place.report();
    says_what_it_promises(&done, &place);
    finds_the_truth(&report);
    finds_no_effect_where_there_is_none(&report);
    served_what_it_identified(&report);
    fails_without_the_two(&report);
    leaves_files_that_work(&place, &report);
    assert!(anyone_with(&place.id).is_empty(), "a process lingers");
}

/// The last lines: parameters, condition, RMS of both mountings against the noise, cycles, samples, where the report lies.
fn says_what_it_promises(done: &Done, place: &Place) {
    let lines: Vec<&str> = done.out.lines().collect();
    assert_eq!(
        lines[0],
        "panda, mounting wall: 59 base parameters (GBS: 45 rigid body, 14 friction)",
        "{}",
        done.output()
    );
    for begin in
        ["condition number: raw ", "noise floor [Nm]: ", "RMS wall [Nm], 2 unseen runs: ", "RMS upright [Nm], 2 "]
    {
        assert!(lines.iter().any(|line| line.starts_with(begin)), "no `{begin}` in {}", done.output());
    }
    let cycles = lines
        .iter()
        .find(|line| line.starts_with("loop (simulated time, as fast as possible): "))
        .unwrap_or_else(|| panic!("{}", done.output()));
    assert!(cycles.contains(" cycles, 0 lost, 0 allocations"), "{cycles}");
    let samples =
        lines.iter().find(|line| line.starts_with("samples: ")).unwrap_or_else(|| panic!("{}", done.output()));
    assert!(samples.ends_with("none missing"), "{samples}");
    assert_eq!(lines.last().unwrap(), &format!("report: {}", place.out().join("report.html").display()));
    // Nobody watches: neither a progress bar nor colours.
    assert!(!done.err.contains('\x1b') && !done.out.contains('\x1b'), "{}", done.output());
}

fn finds_the_truth(report: &Report) {
    assert_eq!((report.robot.as_str(), report.mounting.name.as_str()), ("panda", "wall"));
    assert_eq!((report.base.kind.as_str(), report.base.count, report.base.parameters.len()), ("GBS", 59, 59));
    assert!(report.identifiability.not_identifiable.is_empty());
    let arm = arm("sim-panda");
    let z = z_scores(report, &true_parameters(&arm));
    for (name, z) in &z {
        assert!(z.abs() < 4.0, "{name} is {z:.2} of its standard deviations off the truth");
    }
    // Nor are the standard deviations larger than the errors ask for.
    let mean_square = mean(&z.iter().map(|(_, z)| z * z).collect::<Vec<_>>());
    assert!((0.4..2.0).contains(&mean_square), "mean squared error {mean_square} variances");

    let noise = torque_noise(&arm);
    for (found, noise) in report.noise_floor.iter().zip(&noise) {
        assert!((found / noise - 1.0).abs() < 0.05, "noise floor {found}, truth {noise}");
    }
    for mounting in ["wall", "upright"] {
        let ratio = validation_rms(report, mounting) / mean(&noise);
        assert!((0.9..1.1).contains(&ratio), "mean validation RMS {mounting}: {ratio} of the simulated noise");
    }
}

fn finds_no_effect_where_there_is_none(report: &Report) {
    let found = report.diagnosis.as_ref().unwrap();
    assert!(found.verdict == Verdict::NothingSignificant && found.effects.is_empty(), "{found:#?}");
}

fn served_what_it_identified(report: &Report) {
    let (ipc, cycle) = (report.ipc.unwrap(), report.control_loop.as_ref().unwrap());
    assert!(ipc.sent > 60_000, "{ipc:?}");
    assert_eq!((ipc.sent, ipc.counters.missed), (ipc.counters.received, 0), "{ipc:?}");
    assert_eq!(ipc.sent, cycle.cycles);
    assert_eq!((cycle.lost, cycle.dropped_records, cycle.allocations(), cycle.late), (0, 0, Some(0), None));
    assert_eq!(cycle.sessions.len(), 2);
    for run in &report.validate {
        // Served along the desired motion, judged along the measured one: they differ by the tracking error of a fast motion.
        let served = run.served_rms.as_ref().unwrap_or_else(|| panic!("nothing was served in {}", run.run));
        for (j, (served, judged)) in served.iter().zip(&run.rms_raw).enumerate() {
            assert!(
                (0.9..2.0).contains(&(served / judged)),
                "{}, joint {}: served {served}, judged {judged}",
                run.run,
                j + 1
            );
        }
        assert!(
            (0.95..1.25).contains(&(mean(served) / mean(&run.rms_raw))),
            "{}: {served:?} {:?}",
            run.run,
            run.rms_raw
        );
    }
}

/// The counter-experiment: the usual set, identified upright, is refused on the wall, and forced it fails in joint 1 alone.
fn fails_without_the_two(report: &Report) {
    let counter = report.counter_experiment.as_ref().unwrap();
    assert_eq!((counter.kind.as_str(), counter.count), ("VBS", 57));
    assert_eq!((counter.identified_in.name.as_str(), counter.refused_in.name.as_str()), ("upright", "wall"));
    assert!(counter.refusal.contains("VBS") && counter.refusal.contains("wall"), "{}", counter.refusal);
    let ratio: Vec<f64> = counter.forced_rms.iter().zip(&counter.general_rms).map(|(f, g)| f / g).collect();
    assert!(ratio[0] > 1.5, "{ratio:?}");
    assert!(ratio[1..].iter().all(|ratio| (0.9..1.1).contains(ratio)), "{ratio:?}");
}

fn leaves_files_that_work(place: &Place, report: &Report) {
    let html = std::fs::read_to_string(place.out().join("report.html")).unwrap();
    assert!(html.contains("<svg") && html.trim_end().ends_with("</html>"));
    let searched: Vec<&str> =
        report.motions.iter().filter(|motion| motion.search.is_some()).map(|motion| motion.motion.as_str()).collect();
    assert!(searched.first() == Some(&"identify-wall") && html.contains("evaluations / 1000"), "{searched:?}");
    let file = ModelFile::load(&place.out().join("model.toml"), |name| Ok(Robot::load(name, None)?.chain)).unwrap();
    let uncertainty = file.uncertainty.as_ref().unwrap();
    for (c, (written, reported)) in file.model.parameters().iter().zip(&report.base.parameters).enumerate() {
        assert_eq!((&written.column.name, written.value, written.std), (&reported.name, reported.value, reported.std));
        let half = student_975(uncertainty.parameters.freedom[c]) * uncertainty.parameters.covariance[(c, c)].sqrt();
        let [low, high] = reported.interval_95.unwrap();
        let difference = (reported.value - half - low).abs().max((reported.value + half - high).abs());
        assert!(difference < 1e-9 * half, "{}: {low} {high}", reported.name);
    }

    // The model predicts a run of the dataset offline as well as the job said, on the wall and upright.
    for run in ["validate-wall-1.csv", "validate-upright-2.csv"] {
        let judged = report.validate.iter().find(|judged| judged.run == run).unwrap();
        let (torques, rms) = predict(place, run);
        assert!(torques.len() > 4000 && torques.iter().flatten().all(|value| value.is_finite()));
        for (offline, online) in rms.iter().zip(&judged.rms_raw) {
            assert!((offline / online - 1.0).abs() < 0.05, "{run}: offline {rms:?}, online {:?}", judged.rms_raw);
        }
    }

    // The dataset goes through the offline identification, and without offsets, at the job's cut-off, gives the very same numbers.
    let again = place.path().join("again");
    let identify = |more: &[&str]| -> Report {
        Done::of(plumbline().arg("identify").arg(place.out().join("dataset")).arg("--out").arg(&again).args(more))
            .expect_code(0);
        serde_json::from_str(&std::fs::read_to_string(again.join("report.json")).unwrap()).unwrap()
    };
    let offline = identify(&["--terms", "friction", "--torque-cutoff", "5"]);
    assert_eq!((offline.base.kind.as_str(), offline.base.count), ("GBS", 59));
    for (offline, online) in offline.base.parameters.iter().zip(&report.base.parameters) {
        let far = (offline.value - online.value).abs() / online.std.unwrap();
        assert!(offline.name == online.name && far < 1e-6, "{}: {far} standard deviations apart", online.name);
    }
    let usual = identify(&[]);
    let names: Vec<&str> = usual.base.parameters.iter().map(|parameter| parameter.name.as_str()).collect();
    assert_eq!(names[..59], report.base.parameters.iter().map(|parameter| parameter.name.as_str()).collect::<Vec<_>>());
    assert_eq!(usual.base.count, 59 + 7, "{names:?}");
}
