//! The report: the promised schema, everything inside one HTML file, text from files escaped.

use plumbline::config::robot::Robot;
use plumbline::joint::Workspace;
use plumbline::model::gravity::Mounting;
use plumbline::report::figures::{Bin, PlanFigure, TorqueFigure};
use plumbline::report::*;
use plumbline::store::ModelFile;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

const FLOOR: [f64; 7] = [0.15, 0.15, 0.15, 0.15, 0.06, 0.06, 0.06];

/// The report of a job as it could have been, with Table III as its result.
fn report() -> Report {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    let mut model =
        ModelFile::load(&path, |robot| Ok(Robot::load(robot, None)?.chain)).unwrap().model.parameters().to_vec();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for parameter in &mut model {
        parameter.std = Some(10f64.powf(rng.random_range(-4.5..-2.0)));
    }
    let run = |index: usize, mounting: Mounting, rng: &mut ChaCha8Rng| Validation {
        run: format!("{mounting}-{index}"),
        rms: FLOOR.iter().map(|floor| floor * rng.random_range(1.0..1.08)).collect(),
        mounting: mounting.into(),
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
    Report {
        robot: "panda".into(),
        mounting: Mounting::WALL.into(),
        base: Base::new("GBS", &model),
        identify: Fit { rms: FLOOR.map(|floor| floor / 3.0).to_vec() },
        validate,
        noise_floor: FLOOR.to_vec(),
        identifiability: Identifiability::default(),
        conditions: vec![
            condition("raw", 131.4, 122.8),
            condition("column-equilibrated", 34.2, 31.9),
            condition("noise-weighted", 148.0, 139.5),
        ],
        cycle: Some(LoopFacts {
            pace: "wall-clock".into(),
            cycles: 131_072,
            late: 3,
            wake_us: Some(Quantiles { p50: 28.0, p99: 69.0, p999: 337.0, max: 8871.0 }),
            work_us: Some(Quantiles { p50: 6.1, p99: 14.0, p999: 31.0, max: 402.0 }),
            realtime: vec!["SCHED_FIFO 80 granted; memory locked; the kernel is not PREEMPT_RT".into()],
            ..LoopFacts::default()
        }),
        ipc: Some(IpcFacts { sent: 131_072, received: 131_072, replayed: 12, missed: 0 }),
        provenance,
        notes: Vec::new(),
    }
}

fn figures(samples: usize) -> Figures {
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
        noise: FLOOR.to_vec(),
    };
    let mut from = 1.0;
    let mut bins = Vec::new();
    while from < 10_000.0 {
        let to = from * 1.25;
        let log = (from / 28.0_f64).log10();
        bins.push(Bin { from, to, count: (60_000.0 * (-6.0 * log * log).exp() + 2.0) as u64 });
        from = to;
    }
    Figures {
        runs: vec![
            run("Identification, wall: average of 10 periods"),
            run("Validation wall-1"),
            run("Validation upright-1"),
        ],
        plan: Some(PlanFigure {
            t: t.clone(),
            q: (0..7).map(|j| t.iter().map(|&t| wave(j, t)).collect()).collect(),
            end_effector: t
                .iter()
                .map(|&t| [0.5 + 0.1 * wave(1, t), 0.3 * wave(2, t), 0.5 + 0.2 * wave(3, t)])
                .collect(),
            workspace: Some(Workspace { box_min: [-0.2, -0.9, 0.0], box_max: [0.9, 0.9, 1.2], base_radius: 0.25 }),
        }),
        wake: bins.clone(),
        work: bins,
    }
}

#[test]
fn the_json_has_the_promised_shape_and_reads_back() {
    let report = report();
    let text = report.to_json().unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["robot"], "panda");
    assert_eq!((&json["base"]["kind"], &json["base"]["count"]), (&"GBS".into(), &59.into()));
    for key in ["name", "symbol", "expression", "value", "std", "unit"] {
        assert!(!json["base"]["parameters"][58][key].is_null(), "{key}");
    }
    assert_eq!(json["base"]["parameters"].as_array().unwrap().len(), 59);
    assert_eq!(json["identify"]["rms"].as_array().unwrap().len(), 7);
    assert_eq!(json["validate"][9]["run"], "upright-5");
    assert_eq!(json["validate"][9]["rms"].as_array().unwrap().len(), 7);
    assert_eq!(json["noise_floor"][0], 0.15);
    assert!(
        json["identifiability"]["not_identifiable"].is_array() && json["identifiability"]["untrusted_runs"].is_array()
    );
    assert!(json.get("diagnosis").is_none());
    assert_eq!(json["loop"]["wake_us"]["p99"], 69.0);
    assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
}

#[test]
fn the_summary_says_what_the_job_promises() {
    let mut report = report();
    let said = report.summary().join("\n");
    let lines = [
        "59 parameters (GBS)",
        "raw 131 (rigid body alone 123)",
        "RMS wall [Nm], 5 unseen runs: ",
        "RMS upright [Nm], 5 unseen runs: ",
        "of the noise floor",
        "131072 cycles, 3 late, 0 lost",
        "131072 sent, 131072 received, none missing",
    ];
    for expected in lines {
        assert!(said.contains(expected), "no `{expected}` in\n{said}");
    }
    report.ipc = Some(IpcFacts { sent: 10, received: 9, ..IpcFacts::default() });
    report.identifiability.untrusted_runs = vec!["wall.csv".into()];
    let said = report.summary().join("\n");
    assert!(said.contains("10 sent, 9 received, NOT EQUAL") && said.contains("can't vouch for: wall.csv"), "{said}");
}

#[test]
fn the_page_is_one_file_of_bearable_size() {
    let room = tempfile::tempdir().unwrap();
    let dir = std::env::var_os("PLUMBLINE_SHOW").map_or(room.path().to_path_buf(), PathBuf::from);
    report().write(&dir, &figures(60_000)).unwrap();
    let page = std::fs::read_to_string(dir.join("report.html")).unwrap();
    assert!(dir.join("report.json").exists());
    assert!(page.len() < 2_500_000, "{} bytes", page.len());
    assert!(!page.contains("src=") && !page.contains("href=") && !page.contains("@import"), "something is loaded");
    // Seven joints in each of three runs, positions, two views of the path, two histograms.
    assert_eq!(page.matches("<svg ").count(), 3 * 7 + 3 + 2);
    assert!(!page.contains("NaN") && !page.contains("Infinity"));
    for expected in ["LxxR2", "Lzz1 + Lyy2", "Joint 7", "column-equilibrated", "131072", "noise floor"] {
        assert!(page.contains(expected), "no {expected}");
    }
}

#[test]
fn text_from_files_is_escaped() {
    let evil = "<script>alert('x')</script>";
    let mut report = report();
    report.robot = evil.into();
    report.validate[0].run = evil.into();
    report.base.parameters[0].expression = evil.into();
    report.notes = vec![evil.into()];
    report.provenance.insert(evil.into(), evil.into());
    report.cycle.as_mut().unwrap().realtime = vec![evil.into()];
    let mut figures = figures(100);
    figures.runs[0].title = evil.into();
    let page = report.to_html(&figures).unwrap();
    assert!(!page.contains("<script"), "unescaped");
    assert!(page.matches("&lt;script&gt;").count() >= 7);
}

#[test]
fn a_bare_report_is_a_page_too() {
    let page = Report { robot: "panda".into(), ..Report::default() }.to_html(&Figures::default()).unwrap();
    assert!(page.contains("panda") && !page.contains("<svg "));
    let one =
        TorqueFigure { t: vec![0.0], measured: vec![vec![f64::NAN]], modelled: vec![vec![0.0]], ..Default::default() };
    let figures = Figures { runs: vec![one], plan: Some(PlanFigure::default()), ..Figures::default() };
    assert!(Report::default().to_html(&figures).unwrap().contains("Joint 1"));
}
