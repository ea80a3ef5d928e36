//! `plumbline diagnose` on recordings in which something changes from period to period, the real binary on a dataset in its folder form.

use nalgebra::Vector3;
use plumbline::dataset::{Dataset, Role, Run};
use plumbline::report::Report;
use plumbline::report::diagnosis::{Stratum, Verdict};
use plumbline_model::{G, Mounting, Robot};
use plumbline_testkit::job::plumbline;
use plumbline_testkit::scene::DT;
use plumbline_testkit::scene::lab::{Noise, of_force, period, plans, window};
use plumbline_testkit::sim::{arm, arm_with};
use std::path::Path;

const PERIODS: usize = 6;

/// Two runs to identify from and one to judge by; `added` puts more into the torques of the first two: run, time, positions, torques.
fn write(dir: &Path, seed: u64, added: impl Fn(usize, f64, &[f64], &mut [f64])) {
    let arm = arm("sim-panda");
    let chain = Robot::load("panda", None).unwrap().chain;
    let mut runs = Vec::new();
    let [identify, validate] = plans();
    let plans = identify.iter().take(2).map(|plan| (Role::Identify, plan));
    for (k, (role, plan)) in plans.chain([(Role::Validate, &validate[0])]).enumerate() {
        let name = format!("run-{k}.csv");
        let one = period(&chain, &arm, plan, Mounting::WALL, &name);
        let mut run = one.record(&arm, PERIODS, Noise { coloured: 0.05 }, seed + k as u64);
        if role == Role::Identify {
            for row in 0..run.tau.nrows() {
                let q: Vec<f64> = one.q.row(row % one.q.nrows()).iter().copied().collect();
                let mut tau = vec![0.0; q.len()];
                added(k, row as f64 * DT, &q, &mut tau);
                tau.iter().enumerate().for_each(|(j, tau)| run.tau[(row, j)] += tau);
            }
        }
        runs.push(Run::new(plumbline_identify::Run { name, ..run }, role));
    }
    store(dir, runs);
}

fn store(dir: &Path, runs: Vec<Run>) {
    let source = toml::Table::new();
    let dataset = Dataset { name: "test".into(), robot: "panda".into(), mounting: Mounting::WALL, source, runs };
    dataset.write(dir).unwrap();
}

/// The report, what was printed, and the page.
fn diagnosed(dir: &Path) -> (Report, String, String) {
    let path = |name: &str| dir.join(name).display().to_string();
    let output = plumbline().args(["diagnose", "--verbose", &path("data"), "--out", &path("out")]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let read = |name: &str| std::fs::read_to_string(dir.join("out").join(name)).unwrap();
    let report = serde_json::from_str(&read("report.json")).unwrap();
    (report, String::from_utf8(output.stdout).unwrap(), read("report.html"))
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_drift_and_a_contact_are_reported_and_kept_out_of_the_model() {
    let place = tempfile::tempdir().unwrap();
    let chain = Robot::load("panda", None).unwrap().chain;
    let force = Vector3::new(4.0, -7.0, 5.0);
    write(&place.path().join("data"), 7, |run, t, q, tau| {
        // About zero, so that the mean period has no offset of its own.
        tau[3] += 0.4 * (t - 30.0) / 60.0;
        if run == 1 && (34.2..35.0).contains(&t) {
            let push = of_force(&chain, q, 5, Vector3::new(0.05, -0.04, 0.02), force * window(t, 34.2, 35.0));
            push.iter().zip(tau).for_each(|(own, tau)| *tau += own);
        }
    });
    let (report, printed, page) = diagnosed(place.path());
    let found = report.diagnosis.unwrap();
    let ids: Vec<&str> = found.effects.iter().map(|effect| effect.id.as_str()).collect();
    assert_eq!(
        (ids.as_slice(), found.verdict),
        (["offset-drift", "contact"].as_slice(), Verdict::Diagnosed),
        "{printed}"
    );
    assert!(found.effects.iter().all(|effect| effect.stratum == Stratum::Changing && !effect.in_model), "{found:#?}");
    assert!(found.unexplained.is_empty(), "{printed}");
    let [drift, contact] = &found.effects[..] else { panic!("{printed}") };
    let of = |effect: &plumbline::report::diagnosis::Effect, name: &str| {
        let own = effect.parameters.0.iter().find(|own| own.name == name);
        own.unwrap_or_else(|| panic!("{name}: {effect:?}")).clone()
    };
    let slope = of(drift, "offset");
    assert!(drift.joints == [4] && slope.unit == "Nm/min", "{drift:?}");
    assert!((slope.value - 0.4).abs() < 3.0 * slope.std.unwrap() && slope.std.unwrap() < 0.05, "{slope:?}");
    assert!(contact.joints == [6] && contact.label.contains("run-1.csv"), "{contact:?}");
    assert!((of(contact, "from").value - 34.2).abs() < 0.2 && (of(contact, "to").value - 35.0).abs() < 0.2);
    for (axis, force) in ["force_x", "force_y", "force_z"].iter().zip(force.iter()) {
        assert!((of(contact, axis).value - force).abs() < 0.2 * 9.5, "{contact:?}");
    }
    // Nothing of it reaches the parameters, and the noise is that of a recording without it.
    assert_eq!(report.base.parameters.len(), 59);
    let plain = tempfile::tempdir().unwrap();
    write(&plain.path().join("data"), 7, |_, _, _, _| {});
    let (without, nothing, _) = diagnosed(plain.path());
    let none = without.diagnosis.unwrap();
    assert!(none.verdict == Verdict::NothingSignificant && none.effects.is_empty(), "{nothing}");
    assert!(!none.notes.iter().any(|note| note.contains("transient") || note.contains("contact")), "{nothing}");
    for (j, (with, without)) in found.joints.iter().zip(&none.joints).enumerate() {
        let ratio = with.floor_of_mean.unwrap() / without.floor_of_mean.unwrap();
        assert!((ratio - 1.0).abs() < 0.05, "joint {}: {ratio}", j + 1);
    }
    for (with, without) in report.base.parameters.iter().zip(&without.base.parameters) {
        let apart = (with.value - without.value).abs();
        assert!(apart < 3.0 * without.std.unwrap(), "{with:?} {without:?}");
    }

    assert!(printed.contains("diagnosis: 2 effects found"), "{printed}");
    assert!(printed.contains("offset drift in joint 4 (offset 0.4"), "{printed}");
    assert_eq!(printed.matches("changes from period to period; not in the model").count(), 2, "{printed}");
    let note = found.notes.iter().find(|note| note.contains("contact on link 6"));
    assert!(note.is_some_and(|note| note.starts_with("run run-1.csv, 34.") && note.ends_with("left out")), "{printed}");
    assert!(page.contains("contact on link 6 in run-1.csv") && page.contains(">not in the model<"));
    assert!(!page.contains("not added to the model") && nothing.contains("diagnosis: nothing significant"));
}

/// Of this mass, with its centre 0.1 m in front of the flange, picked up at this time of the second run \[s\].
const MASS: f64 = 0.4;
const PICKED_UP: f64 = 13.37;

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_payload_that_is_picked_up_within_a_run_is_weighed_and_taken_off() {
    let place = tempfile::tempdir().unwrap();
    let chain = Robot::load("panda", None).unwrap().chain;
    let loaded = format!(
        "[[effect]]\nid = \"payload\"\nmass = {MASS}\ncom = [0.0, 0.0, 0.1]\ninertia = [1e-3, 0.0, 0.0, 1e-3, 0.0, 1e-3]\n"
    );
    let arms = [arm("sim-panda"), arm_with("sim-panda", &loaded)];
    let [identify, validate] = plans();
    let plans = [(Role::Identify, &identify[0]), (Role::Identify, &identify[1]), (Role::Validate, &validate[0])];
    let mut runs = Vec::new();
    for (k, (role, plan)) in plans.into_iter().enumerate() {
        let name = format!("run-{k}.csv");
        let [mut run, with] = arms.each_ref().map(|arm| {
            period(&chain, arm, plan, Mounting::WALL, &name).record(arm, 2, Noise { coloured: 0.05 }, 40 + k as u64)
        });
        // It stays for the run after. The joints give way within a fifth of a second.
        let picked_up = [f64::INFINITY, PICKED_UP, -1.0][k];
        for (row, t) in run.t.iter().enumerate() {
            let share = ((t - picked_up) / 0.2 + 0.5).clamp(0.0, 1.0);
            for (own, with) in [(&mut run.q, &with.q), (&mut run.tau, &with.tau)] {
                let moved = own.row(row) * (1.0 - share) + with.row(row) * share;
                own.row_mut(row).copy_from(&moved);
            }
        }
        runs.push(Run::new(plumbline_identify::Run { name, ..run }, role));
    }
    store(&place.path().join("data"), runs);
    let (report, printed, _) = diagnosed(place.path());
    println!("{printed}");
    let found = report.diagnosis.unwrap();
    assert_eq!(found.verdict, Verdict::Diagnosed, "{printed}");
    let [payload] = &found.effects[..] else { panic!("{printed}") };
    let acts = payload.acts.as_ref().unwrap();
    assert!(payload.id == "payload" && !payload.in_model && acts.run == "run-1.csv" && acts.to_end_of_recording);
    assert!((acts.from - PICKED_UP).abs() < 0.1, "{acts:?}");
    let mass = payload.parameters.0.iter().find(|own| own.name == "mass").unwrap();
    assert!((mass.value - MASS).abs() < 3.0 * mass.std.unwrap() && mass.std.unwrap() < 0.02, "{mass:?}");
    // The model is that of the arm without it, which no unseen run shows; with it, the unseen run is predicted.
    let change = found.change.as_ref().unwrap();
    let [x, y, z] = ["com_x", "com_y", "com_z"].map(|name| {
        let own = payload.parameters.0.iter().find(|own| own.name == name).unwrap();
        (own.value, own.std.unwrap())
    });
    for ((value, std), truth) in [(x, 0.0), (y, 0.0), (z, 0.1)] {
        assert!((value - truth).abs() < 3.0 * std && std < 0.01, "{value} +- {std}, true {truth}");
    }
    // The last joint feels nothing but the centre of mass, which two periods determine to some millimetres.
    let centre = MASS * G * f64::max(x.1, y.1);
    for (joint, (before, [low, _])) in found.before.validate_rms.iter().zip(&change.intervals).enumerate() {
        let most = if joint == 6 { before.hypot(centre) - before } else { 0.05 * before };
        assert!(*low < most, "joint {} is worse by its whole interval: {printed}", joint + 1);
    }
    let worst = |rms: &[f64]| rms.iter().copied().fold(0.0, f64::max);
    assert!(worst(&found.after.validate_rms) < 0.25 * worst(&found.before.validate_rms), "{printed}");
    let named = format!("payload since 13.4 s of run-1.csv (mass {:.3} +- {:.3} kg", mass.value, mass.std.unwrap());
    assert!(printed.contains(&named), "no `{named}`: {printed}");
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn what_an_unseen_run_alone_has_hides_no_effect() {
    let place = tempfile::tempdir().unwrap();
    let chain = Robot::load("panda", None).unwrap().chain;
    let arm = arm_with("sim-panda", "[[effect]]\nid = \"presliding\"\njoint = 4\ndelta = 0.002\n");
    let tilt = 1.5_f64.to_radians();
    let tilted = Mounting { rho: Mounting::WALL.rho + tilt, ..Mounting::WALL };
    let [identify, validate] = plans();
    let [first, second] = [&identify[0], &identify[1]].map(|plan| (Role::Identify, plan, Mounting::WALL));
    let mut runs = Vec::new();
    for (k, (role, plan, mounting)) in [first, second, (Role::Validate, &validate[0], tilted)].into_iter().enumerate() {
        let name = format!("run-{k}.csv");
        let one = period(&chain, &arm, plan, mounting, &name);
        let run = one.record(&arm, PERIODS, Noise { coloured: 0.05 }, 50 + k as u64);
        runs.push(Run::new(plumbline_identify::Run { name, mounting: Mounting::WALL, ..run }, role));
    }
    store(&place.path().join("data"), runs);
    let (report, printed, _) = diagnosed(place.path());
    println!("{printed}");
    let found = report.diagnosis.unwrap();
    assert_eq!(found.verdict, Verdict::Diagnosed, "{printed}");
    let [presliding, mounting] = &found.effects[..] else { panic!("{printed}") };
    assert!(
        (presliding.id.as_str(), presliding.in_model) == ("presliding", true) && presliding.joints == [4],
        "{printed}"
    );
    assert!(mounting.id == "mounting" && printed.contains("- mounting in run-2.csv ("), "{printed}");
    for (own, name, truth) in [(presliding, "delta", 0.002), (mounting, "tilt", tilt)] {
        let found = own.parameters.0.iter().find(|own| own.name == name).unwrap();
        assert!((found.value - truth).abs() < 3.0 * found.std.unwrap(), "{found:?}");
    }
    // The tilt takes 25 times what joint 4 has of the presliding there.
    assert!(found.after.validate_rms[3] > 10.0 * found.noise_floor[3], "{printed}");
}

/// What came while the arm was identified, and acts in an unseen run, too, is known there, and no other difference of that run is explained by it again.
#[test]
#[ignore = "hil/long-tests/run.sh"]
fn what_differs_in_an_unseen_run_is_named_beside_what_came_before() {
    let place = tempfile::tempdir().unwrap();
    let chain = Robot::load("panda", None).unwrap().chain;
    let before = arm_with("sim-panda", "");
    let mut arm = before.clone();
    arm.joints[1].fc += 0.3;
    let [identify, validate] = plans();
    let motions = [&identify[0], &identify[1], &validate[0], &validate[1]];
    let mut runs = Vec::new();
    for (k, plan) in motions.into_iter().enumerate() {
        let name = format!("run-{k}.csv");
        let own = if k == 0 { &before } else { &arm };
        let one = period(&chain, own, plan, Mounting::WALL, &name);
        let mut run = one.record(own, 4, Noise { coloured: 0.05 }, 70 + k as u64);
        if k == 2 {
            run.tau.column_mut(4).add_scalar_mut(0.3);
        }
        let role = if k < 2 { Role::Identify } else { Role::Validate };
        runs.push(Run::new(plumbline_identify::Run { name, ..run }, role));
    }
    store(&place.path().join("data"), runs);
    let (report, printed, _) = diagnosed(place.path());
    let found = report.diagnosis.unwrap();
    let [friction, offset] = &found.effects[..] else { panic!("{printed}") };
    assert_eq!((friction.id.as_str(), &friction.joints[..]), ("friction-change", &[2][..]), "{printed}");
    assert_eq!((offset.id.as_str(), &offset.joints[..]), ("torque-offset", &[5][..]), "{printed}");
    assert_eq!(friction.acts.as_ref().unwrap().run, "run-1.csv", "{printed}");
    // A weak spring about another place contains an offset: it is no rival.
    assert!(offset.label.ends_with("in run-2.csv") && offset.alternatives.is_empty(), "{printed}");
    assert_eq!(found.verdict, Verdict::Diagnosed, "{printed}");
}
