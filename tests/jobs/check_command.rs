//! Recorded data is checked before it is fitted: a campaign of mistakes of which none is silent, real logs without a warning, and words for people.

use nalgebra::DMatrix;
use plumbline::checks;
use plumbline::dataset::{Dataset, Role, Run};
use plumbline_core::{parallel, threads};
use plumbline_identify::check::{Finding, State};
use plumbline_model::{Mounting, Robot};
use plumbline_testkit::job::*;
use plumbline_testkit::logs;
use plumbline_testkit::scene::Scene;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::PathBuf;
use std::sync::LazyLock;

/// Every so many samples of the arm: 125 Hz.
const EVERY: usize = 8;

static SCENE: LazyLock<Scene> = LazyLock::new(Scene::panda_on_the_wall);

/// A recording of the simulated Panda on the wall with measured velocities, to identify from; with `unseen` a second one to validate with.
fn clean(unseen: bool, periodic: bool) -> Dataset {
    let run = |file: &str, role: Role, seed: u64| {
        let mut run = SCENE.dataset_run(file, role, (2, seed), EVERY, periodic);
        let samples = SCENE.motion.samples();
        let dq = DMatrix::from_fn(run.samples(), run.joints(), |k, j| SCENE.motion.dq[(k * EVERY % samples, j)]);
        run.data.dq = Some(dq);
        run
    };
    let mut runs = vec![run("a.csv", Role::Identify, 11)];
    if unseen {
        runs.push(run("b.csv", Role::Validate, 12));
    }
    Dataset {
        name: "campaign".into(),
        robot: "panda".into(),
        mounting: SCENE.mounting,
        source: toml::Table::new(),
        runs,
    }
}

fn findings(dataset: &Dataset) -> Vec<Finding> {
    checks::findings(dataset, &Robot::load(&dataset.robot, None).unwrap())
}

fn not_passed(dataset: &Dataset) -> Vec<Finding> {
    findings(dataset).into_iter().filter(|finding| finding.state > State::Pass).collect()
}

#[test]
fn a_recording_without_mistakes_passes() {
    for periodic in [false, true] {
        let dataset = clean(true, periodic);
        assert_eq!(not_passed(&dataset), [], "periodic: {periodic}");
        let names: Vec<String> = findings(&dataset).into_iter().map(|finding| finding.check).collect();
        for check in [
            "time", "position", "speed", "velocity", "torque", "channel", "mounting", "lag", "order", "sign", "power",
            "fit", "unseen",
        ] {
            assert!(names.iter().any(|name| name == check), "no `{check}` in {names:?}");
        }
        assert_eq!(names.iter().any(|name| name == "period"), periodic);
    }
}

type Spoil = Box<dyn Fn(&mut Dataset) + Sync>;

/// A mistake, the checks one of which must tell it, and whether the data must be refused.
struct Kind {
    name: String,
    checks: &'static [&'static str],
    spoil: Spoil,
}

fn kind(name: impl Into<String>, checks: &'static [&'static str], spoil: impl Fn(&mut Run) + Sync + 'static) -> Kind {
    let spoil: Spoil = Box::new(move |dataset| dataset.runs.iter_mut().for_each(&spoil));
    Kind { name: name.into(), checks, spoil }
}

fn scale(values: &mut DMatrix<f64>, j: usize, factor: f64) {
    values.column_mut(j).scale_mut(factor);
}

/// The torques as they were `seconds` before; the end that is missing repeats.
fn late(run: &mut Run, seconds: f64) {
    let shift = (seconds / (run.data.t[1] - run.data.t[0])).round() as isize;
    let (rows, tau) = (run.samples() as isize, run.data.tau.clone());
    run.data.tau =
        DMatrix::from_fn(run.samples(), run.joints(), |k, j| tau[((k as isize - shift).rem_euclid(rows) as usize, j)]);
}

fn noise(run: &mut Run, j: usize) {
    let mut rng = ChaCha8Rng::seed_from_u64(j as u64);
    run.data.tau.column_mut(j).iter_mut().for_each(|tau| *tau = 0.3 * rng.sample::<f64, _>(StandardNormal));
}

fn kinds() -> Vec<Kind> {
    const DEG: f64 = 180.0 / PI;
    let q: &[&str] = &["position", "velocity", "speed", "order", "sign", "fit"];
    let mut kinds = vec![
        kind("everything in degrees", &["position"], |run| {
            run.data.q *= DEG;
            run.data.dq.iter_mut().for_each(|dq| *dq *= DEG);
        }),
        kind("positions in degrees", &["position"], |run| run.data.q *= DEG),
        kind("velocities in degrees", &["velocity"], |run| run.data.dq.iter_mut().for_each(|dq| *dq *= DEG)),
        kind("velocities of the other sign", &["velocity"], |run| run.data.dq.iter_mut().for_each(|dq| *dq *= -1.0)),
        kind("one velocity of the other sign", &["velocity"], |run| scale(run.data.dq.as_mut().unwrap(), 4, -1.0)),
        kind("velocities swapped", &["velocity"], |run| run.data.dq.as_mut().unwrap().swap_columns(1, 4)),
        kind("one velocity dead", &["velocity"], |run| scale(run.data.dq.as_mut().unwrap(), 2, 0.0)),
        kind("torques in mNm", &["torque"], |run| run.data.tau *= 1000.0),
        kind("torques in kNm", &["torque"], |run| run.data.tau *= 1e-3),
        kind("torques of the other sign", &["power"], |run| run.data.tau *= -1.0),
        kind("t in ms", &["time"], |run| run.data.t.iter_mut().for_each(|t| *t *= 1e3)),
        kind("t in us", &["time"], |run| run.data.t.iter_mut().for_each(|t| *t *= 1e6)),
        kind("t in ns", &["time"], |run| run.data.t.iter_mut().for_each(|t| *t *= 1e9)),
        kind("t in minutes", &["speed"], |run| run.data.t.iter_mut().for_each(|t| *t /= 60.0)),
        kind("t of half the rate", &["velocity"], |run| run.data.t.iter_mut().for_each(|t| *t *= 2.0)),
        kind("t of twice the rate", &["velocity"], |run| run.data.t.iter_mut().for_each(|t| *t *= 0.5)),
        kind("every joint's torque is the next one's", &["order", "fit", "torque", "robot"], |run| {
            let tau = run.data.tau.clone();
            run.data.tau = DMatrix::from_fn(tau.nrows(), 7, |k, j| tau[(k, (j + 1) % 7)]);
        }),
    ];
    for j in 0..7 {
        kinds.push(kind(format!("q{} in degrees", j + 1), q, move |run| scale(&mut run.data.q, j, DEG)));
        kinds.push(kind(format!("tau{} of the other sign", j + 1), &["sign"], move |run| {
            scale(&mut run.data.tau, j, -1.0)
        }));
        kinds.push(kind(format!("tau{} in mNm", j + 1), &["torque"], move |run| scale(&mut run.data.tau, j, 1000.0)));
        kinds.push(kind(format!("q{} of the other sign", j + 1), q, move |run| scale(&mut run.data.q, j, -1.0)));
    }
    for (a, b) in [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 6), (0, 3), (1, 5)] {
        let (one, other) = (a + 1, b + 1);
        kinds.push(kind(format!("tau{one} and tau{other} swapped"), &["order", "torque"], move |run| {
            run.data.tau.swap_columns(a, b)
        }));
        kinds.push(kind(format!("q{one} and q{other} swapped"), q, move |run| run.data.q.swap_columns(a, b)));
    }
    for j in [1, 3, 6] {
        kinds.push(kind(format!("tau{} is noise", j + 1), &["fit", "order"], move |run| noise(run, j)));
        kinds.push(kind(format!("tau{} stops", j + 1), &["channel"], move |run| {
            let (from, rows) = (run.samples() / 2, run.samples() - run.samples() / 2);
            run.data.tau.view_mut((from, j), (rows, 1)).fill(0.7);
        }));
        kinds.push(kind(format!("tau{} is a copy", j + 1), &["channel"], move |run| {
            let copy = run.data.tau.column(0).into_owned();
            run.data.tau.set_column(j, &copy);
        }));
    }
    let mountings = [
        ("upright", Mounting::UPRIGHT),
        ("ceiling", Mounting::CEILING),
        ("the other wall", Mounting { rho: FRAC_PI_2, phi: PI }),
        ("turned on the wall", Mounting { rho: FRAC_PI_2, phi: FRAC_PI_2 }),
        ("turned the other way", Mounting { rho: FRAC_PI_2, phi: -FRAC_PI_2 }),
        ("a table that leans by 30 deg", Mounting { rho: FRAC_PI_2 + PI / 6.0, phi: 0.0 }),
    ];
    for (name, mounting) in mountings {
        kinds.push(kind(format!("mounting: {name}"), &["mounting"], move |run| run.data.mounting = mounting));
    }
    for lag in [0.1, 0.05, -0.1, 0.2] {
        kinds.push(kind(format!("torque {:.0} ms late", 1e3 * lag), &["lag", "power"], move |run| late(run, lag)));
    }
    for factor in [0.5, 0.9, 0.98, 1.002, 1.1, 1.37] {
        kinds.push(kind(format!("period times {factor}"), &["period"], move |run| {
            run.data.period = Some(factor * SCENE.period)
        }));
    }
    let of_dataset =
        |name: &str, checks, spoil: fn(&mut Dataset)| Kind { name: name.into(), checks, spoil: Box::new(spoil) };
    kinds.push(of_dataset("a Panda's data on a KUKA", &["position", "torque", "robot", "fit"], |dataset| {
        dataset.robot = "kuka-lwr4p".into()
    }));
    kinds.push(of_dataset("an unseen run with other torques", &["unseen"], |dataset| {
        *dataset = clean(true, false);
        dataset.runs[1].data.tau *= 1.4;
    }));
    kinds.push(of_dataset("an unseen run in another mounting", &["mounting", "unseen"], |dataset| {
        *dataset = clean(true, false);
        dataset.runs[1].data.mounting = Mounting::UPRIGHT;
    }));
    kinds
}

#[test]
fn no_mistake_of_the_campaign_is_silent() {
    let (kinds, clean) = (kinds(), clean(false, false));
    assert!(kinds.len() >= 60, "{} kinds", kinds.len());
    let outcomes = parallel(&kinds, threads(), |kind| {
        let mut dataset = clean.clone();
        (kind.spoil)(&mut dataset);
        not_passed(&dataset)
    });
    let mut silent = Vec::new();
    for (kind, found) in kinds.iter().zip(&outcomes) {
        let told: Vec<String> = found.iter().map(|of| format!("{:?} {} {}", of.state, of.check, of.place)).collect();
        println!("{}: {}", kind.name, told.join(", "));
        if !found.iter().any(|of| kind.checks.contains(&of.check.as_str())) {
            silent.push(format!("{}: {told:?}", kind.name));
        }
    }
    assert!(silent.is_empty(), "{silent:#?}");
}

#[test]
fn an_unseen_run_that_reaches_farther_than_what_the_first_determines_is_no_mistake() {
    let of_seconds = |seconds: usize, spoil: fn(&mut Run)| {
        let mut dataset = clean(true, false);
        dataset.runs[0].data = dataset.runs[0].data.part(0, seconds * 1000 / EVERY);
        spoil(&mut dataset.runs[1]);
        let mut found = findings(&dataset).into_iter().filter(|finding| finding.check == "unseen");
        found.next().unwrap()
    };
    let finding = of_seconds(3, |_| {});
    assert_eq!(finding.state, State::Pass, "{finding:?}");
    let finding = of_seconds(6, |run| run.data.tau *= -1.0);
    assert!(finding.state > State::Pass, "{finding:?}");
}

#[test]
fn a_real_log_has_no_finding() {
    let Some(data) = logs::data() else { return };
    let mut logs: Vec<PathBuf> = std::fs::read_dir(data).unwrap().map(|entry| entry.unwrap().path()).collect();
    logs.retain(|path| path.join("dataset.toml").is_file());
    assert!(logs.len() >= 8, "{logs:?}");
    let mut told = Vec::new();
    for log in logs {
        let dataset = Dataset::read(&log).unwrap();
        let robot = Robot::load(&dataset.robot, Some(&log)).unwrap();
        let found = checks::findings(&dataset, &robot);
        assert!(found.len() > 10, "{}: {found:#?}", log.display());
        told.extend(found.into_iter().filter(|finding| finding.state > State::Pass).map(|of| (log.clone(), of)));
    }
    assert!(told.is_empty(), "{told:#?}");
}

const DATASET: &str = "name = \"small\"\nrobot = \"panda\"\nmounting = { rho = 1.5707963267948966, phi = 0.0 }\n\n[[run]]\nfile = \"a.csv\"\nrole = \"identify\"\n";

/// The words of `plumbline check` on a folder with this file, which must be refused.
#[track_caller]
fn refusal(place: &Place, name: &str, bytes: &[u8]) -> String {
    refusal_of(place, name, "a.csv", bytes)
}

#[track_caller]
fn refusal_of(place: &Place, name: &str, file: &str, bytes: &[u8]) -> String {
    let folder = place.path().join(name);
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("dataset.toml"), DATASET.replace("a.csv", file)).unwrap();
    std::fs::write(folder.join(file), bytes).unwrap();
    let done = Done::of(plumbline().arg("check").arg(&folder)).expect_code(2);
    assert!(done.err.contains(file) && done.err.contains(", expected "), "{name}: {}", done.output());
    done.err
}

#[test]
fn a_file_of_another_form_is_refused_in_words() {
    let place = Place::new("check-files");
    let folder = place.path().join("good");
    clean(false, false).write(&folder).unwrap();
    let text = std::fs::read_to_string(folder.join("a.csv")).unwrap();
    let utf16: Vec<u8> = [0xff, 0xfe].into_iter().chain(text.encode_utf16().flat_map(u16::to_le_bytes)).collect();
    let body = text.split_once('\n').unwrap().1;
    let cases: [(&str, Vec<u8>, &str); 7] = [
        ("empty", Vec::new(), "an empty file"),
        ("semicolons", text.replace(',', ";").into(), "columns separated by semicolons"),
        ("tabs", text.replace(',', "\t").into(), "columns separated by tabs"),
        ("blanks", text.replace(',', " ").into(), "columns separated by blanks"),
        ("utf16", utf16, "UTF-16"),
        ("no-header", body.as_bytes().to_vec(), "no header"),
        ("milliseconds", in_milliseconds(&text).into(), "is t in milliseconds?"),
    ];
    for (name, bytes, words) in cases {
        let said = refusal(&place, name, &bytes);
        assert!(said.contains(words), "{name}: {said}");
    }
    // A mark of UTF-8 before the header is no other form.
    let marked = [b"\xef\xbb\xbf".as_slice(), text.as_bytes()].concat();
    std::fs::write(folder.join("a.csv"), marked).unwrap();
    let done = Done::of(plumbline().arg("check").arg(&folder)).expect_code(0);
    assert!(done.out.contains("0 warned, 0 failed"), "{}", done.output());
}

fn in_milliseconds(text: &str) -> String {
    let line = |(k, line): (usize, &str)| match line.split_once(',') {
        Some((t, rest)) if k > 0 => format!("{},{rest}\n", 1e3 * t.parse::<f64>().unwrap()),
        _ => format!("{line}\n"),
    };
    text.lines().enumerate().map(line).collect()
}

#[test]
fn the_same_checks_stand_before_a_fit_and_in_the_report() {
    let place = Place::new("check-before");
    let folder = place.path().join("data");
    let mut dataset = clean(true, false);
    dataset.write(&folder).unwrap();
    let on = |subcommand: &str, out: PathBuf| {
        let mut command = plumbline();
        command.arg(subcommand).arg(&folder).arg("--out").arg(out);
        Done::of(command)
    };
    on("identify", place.out()).expect_code(0);
    let report = place.report();
    assert!(report.checks.len() > 20 && report.checks.iter().all(|of| of.state == State::Pass), "{:?}", report.checks);

    let file = place.path().join("a-file");
    std::fs::write(&file, "mine").unwrap();
    for subcommand in ["identify", "diagnose"] {
        let refused = on(subcommand, file.clone()).expect_code(2);
        assert!(refused.err.contains("--out") && refused.err.contains("a-file"), "{}", refused.output());
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");

    // A motion of a Panda is none of a KUKA's, and a model of a Panda is none for it.
    let model = place.out().join("model.toml");
    let predict = |run: &PathBuf, more: &[&str]| {
        let out = place.path().join("torques.csv");
        Done::of(plumbline().arg("predict").arg(&model).arg(run).arg("--out").arg(out).args(more))
    };
    predict(&folder.join("b.csv"), &[]).expect_code(0);
    let other = place.path().join("kuka");
    dataset.robot = "kuka-lwr4p".into();
    dataset.write(&other).unwrap();
    let refused = predict(&other.join("b.csv"), &[]).expect_code(2);
    assert!(refused.err.contains("kuka-lwr4p") && refused.err.contains("--force"), "{}", refused.output());
    predict(&other.join("b.csv"), &["--force"]).expect_code(0);

    dataset.robot = "panda".into();
    dataset.runs.iter_mut().for_each(|run| run.data.q *= 180.0 / PI);
    dataset.write(&folder).unwrap();
    for subcommand in ["identify", "diagnose"] {
        let refused = on(subcommand, place.path().join("none")).expect_code(2);
        assert!(refused.err.contains("are the positions in degrees?"), "{}", refused.output());
    }
    let compared =
        Done::of(plumbline().arg("compare").arg(&model).arg(&folder).arg("--out").arg(place.path().join("none")));
    assert!(compared.expect_code(2).err.contains("are the positions in degrees?"));
    assert!(!place.path().join("none").exists());
}

#[test]
fn a_recording_that_is_no_mcap_file_or_a_part_of_one_is_refused_in_words() {
    let place = Place::new("check-mcap");
    let folder = place.path().join("good");
    let mut set = clean(false, false);
    set.runs.truncate(1);
    set.runs[0].data.name = "a.mcap".into();
    set.write(&folder).unwrap();
    let whole = std::fs::read(folder.join("a.mcap")).unwrap();
    let cases: [(&str, &[u8], &str); 3] = [
        ("empty", b"", "an empty file"),
        ("text", b"t,q1,tau1\n0,0,0\n", "an MCAP file"),
        ("truncated", &whole[..whole.len() / 2], "a.mcap"),
    ];
    for (name, bytes, words) in cases {
        let said = refusal_of(&place, name, "a.mcap", bytes);
        assert!(said.contains(words), "{name}: {said}");
        // The work on it refuses it alike, and leaves nothing behind.
        let out = place.path().join(format!("{name}-out"));
        let done =
            Done::of(plumbline().arg("identify").arg(place.path().join(name)).arg("--out").arg(&out)).expect_code(2);
        assert!(done.err.contains("a.mcap") && !out.join("model.toml").exists(), "{name}: {}", done.output());
    }
}
