//! The report: the promised schema, everything inside one HTML file, text from files escaped.

mod made_up;

use made_up::*;
use plumbline::config::job::Pace;
use plumbline::report::figures::{PlanFigure, TorqueFigure};
use plumbline::report::table::{MAX_LINES, WIDTH};
use plumbline::report::*;
use plumbline_core::Distribution;
use plumbline_ipc::{Gravity, MotionGravity};
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::{Mounting, Reduction, Robot, Structure, TorqueModel};
use std::path::PathBuf;

#[test]
fn the_table_fits_a_terminal_whatever_is_in_the_report() {
    let fits = |report: &Report| {
        let lines = report.table().lines;
        let wide = lines.iter().find(|line| line.chars().count() > WIDTH);
        assert!(lines.len() <= MAX_LINES && wide.is_none(), "{lines:#?}");
        lines
    };
    let mut report = report();
    let lines = fits(&report);
    assert!(lines[0].starts_with("panda, wall: 59 base parameters (GBS)"), "{lines:#?}");
    let row = |lines: &[String], name: &str| lines.iter().find(|line| line.starts_with(name)).cloned();
    let floor = row(&lines, "noise floor").unwrap();
    assert_eq!(floor.split_whitespace().nth(2), Some("0.150"), "{floor}");
    assert!(row(&lines, "wall, 5 unseen runs").is_some() && row(&lines, "VBS 57").is_some(), "{lines:#?}");
    // More mountings than there are lines, long names, large torques, odd numbers.
    let run = report.validate[0].clone();
    for k in 0..12 {
        let mut other = run.clone();
        other.mounting.name = format!("rho = {k} deg, phi = 123.456 deg, a long name");
        report.validate.push(other);
    }
    report.noise_floor = vec![123_456.0, 1234.5, 99.999, 9.9996, 0.0, f64::NAN, -0.0001];
    let lines = fits(&report);
    assert!(lines.iter().any(|line| line.ends_with("more rows with --verbose")), "{lines:#?}");
    let floor = row(&lines, "noise floor").unwrap();
    assert!(floor.contains(" 1e5") && floor.contains(" 1234 100.0 10.00 0.000     -"), "{floor}");
    report.robot = "r".repeat(200);
    report.identifiability.not_identifiable = vec!["Lxx1".into(); 3];
    assert!(fits(&report).iter().any(|line| line.contains("3 parameters not identifiable")));
    fits(&Report::default());
}

#[test]
fn the_json_has_the_specified_schema_and_round_trips() {
    let report = report();
    let text = report.to_json().unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["robot"], "panda");
    assert_eq!((&json["base"]["kind"], &json["base"]["count"]), (&"GBS".into(), &59.into()));
    for key in ["name", "symbol", "expression", "value", "std", "unit"] {
        assert!(!json["base"]["parameters"][58][key].is_null(), "{key}");
    }
    assert_eq!(json["base"]["parameters"].as_array().unwrap().len(), 59);
    assert_eq!(json["identify"]["rms_filtered"].as_array().unwrap().len(), 7);
    assert_eq!(json["validate"][9]["run"], "upright-5.csv");
    assert_eq!(json["validate"][9]["rms_filtered"].as_array().unwrap().len(), 7);
    assert_eq!(json["noise_floor"][0], 0.15);
    assert!(
        json["identifiability"]["not_identifiable"].is_array() && json["identifiability"]["untrusted_runs"].is_array()
    );
    assert!(json.get("diagnosis").is_none());
    assert_eq!(json["loop"]["cycles"], 131_072);
    assert_eq!(json["band"]["kind"], "raw");
    assert_eq!(json["loop"]["sessions"][1]["wake_up"]["p50_ns"], 28_000);
    let mut keys = Vec::new();
    keys_of(&json, &mut keys);
    // `provenance` may hold any name that a caller gives; all of ours are words with underscores.
    let odd: Vec<_> = keys
        .iter()
        .filter(|key| key.chars().any(|c| !(c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')))
        .collect();
    assert!(odd.is_empty() && keys.len() > 100, "{odd:?}");
    assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
}

fn keys_of(json: &serde_json::Value, keys: &mut Vec<String>) {
    match json {
        serde_json::Value::Object(map) => map.iter().for_each(|(key, value)| {
            keys.push(key.clone());
            keys_of(value, keys);
        }),
        serde_json::Value::Array(values) => values.iter().for_each(|value| keys_of(value, keys)),
        _ => {}
    }
}

#[test]
fn a_session_in_simulated_time_has_no_late_cycles() {
    assert_eq!(Distribution::default().in_us(), None);

    let mut report = report();
    let mut fast = session("wall");
    let statistics = &mut fast.statistics;
    (statistics.late, statistics.wake_up, fast.allocations) = (None, Distribution::default(), None);
    let of = report.control_loop.as_mut().unwrap();
    (of.pace, of.late, of.sessions) = (Pace::Fast, None, vec![fast]);
    let message = report.in_words().join("\n");
    assert!(message.contains("as fast as possible") && message.contains("allocations not watched"), "{message}");
    let page = report.to_html(&Figures::default()).unwrap();
    assert!(!message.contains(" late") && !message.contains("wake-up") && !page.contains("wake-up, wall"), "{message}");
}

#[test]
fn filtered_errors_are_labelled_and_not_compared_with_a_raw_floor() {
    let mut report = report();
    report.band = Band::Filtered { cutoff: 4.0 };
    for run in &mut report.validate {
        run.served_rms = None;
    }
    let message = report.in_words().join("\n");
    let line = |start: &str| {
        message.lines().find(|line| line.starts_with(start)).unwrap_or_else(|| panic!("{start} in {message}"))
    };
    let filtered = line("RMS wall [Nm] after a 4 Hz zero-phase low-pass, 5 unseen runs: 0.01");
    assert!(!filtered.contains("noise floor"), "{filtered}");
    assert!(line("RMS wall [Nm], raw samples: 0.1").contains("of the noise floor"));
    let page = report.to_html(&Figures::default()).unwrap();
    assert!(page.contains("unseen motions, after a 4 Hz zero-phase low-pass") && page.contains(">raw mean</th>"));

    report.noise_floor.clear();
    let page = report.to_html(&Figures::default()).unwrap();
    assert!(
        report.in_words().join("\n").contains("noise floor: unknown")
            && page.contains("No motion of this data repeats")
    );
    assert!(!page.contains(">noise floor</th>"), "an empty column");
}

#[test]
fn the_counter_experiment_names_the_joints_that_fail() {
    let mut report = report();
    let sentence = |report: &Report| {
        report.in_words().into_iter().find(|line| line.starts_with("counter-experiment")).expect("it was done")
    };
    let message = sentence(&report);
    assert!(message.contains("57 parameters, identified upright) is refused in mounting wall"), "{message}");
    assert!(
        message.contains("is 0.225 Nm in joint 1 (generalized set 0.150) and changes by at most 0.00 % in the others"),
        "{message}"
    );
    report.counter_experiment.as_mut().unwrap().forced_rms[3] *= 0.5;
    let message = sentence(&report);
    assert!(message.contains("0.225 Nm in joint 1") && message.contains("0.075 Nm in joint 4"), "{message}");
    report.counter_experiment.as_mut().unwrap().forced_rms = FLOOR.map(|floor| floor * 1.02).to_vec();
    assert!(sentence(&report).contains("changes by at most 2.00 % in any joint"), "{}", sentence(&report));
}

/// An effect's parameters are none of the base set, on the console, in the file and on the page.
#[test]
fn the_parameters_of_effects_are_counted_apart() {
    let chain = Robot::load("panda", None).unwrap().chain;
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &["friction"]).unwrap();
    let values = |structure: &Structure| vec![(0.5, None); structure.columns().len()];
    let plain = TorqueModel::new("panda", structure.clone(), vec![], &values(&structure)).unwrap();
    let spec = Spec { family: "presliding", form: "", site: Site::Joint(4), settings: vec![0.002] };
    let term = spec.build(&plain.structure().operating_point(&plain.beta())).unwrap();
    let structure = structure.with(vec![term]).unwrap();
    let with_effect = TorqueModel::new("panda", structure.clone(), vec![], &values(&structure)).unwrap();
    let counts_of = |model: &TorqueModel| {
        let report = Report { base: Base::of(model), ..report() };
        let page = report.to_html(&Figures::default()).unwrap();
        (report.in_words()[0].clone(), report.base.count, report.base.effects, page)
    };
    let (line, count, effects, page) = counts_of(&plain);
    let counts = "59 base parameters (GBS: 45 rigid body, 14 friction)";
    assert_eq!((line, count, effects), (format!("panda, mounting wall: {counts}"), 59, 0));
    assert!(page.contains(counts) && page.contains("GBS of panda<"), "{page}");
    let (line, count, effects, page) = counts_of(&with_effect);
    assert_eq!((line, count, effects), (format!("panda, mounting wall: {counts}, and 1 of effects"), 59, 1));
    assert!(page.contains(&format!("{counts}, and 1 of effects")) && page.contains("GBS of panda, and 1 of effects"));
}

#[test]
fn the_summary_says_what_the_job_promises() {
    let mut report = report();
    let message = report.in_words().join("\n");
    let lines = [
        "59 base parameters (GBS)",
        "raw 131 (rigid body alone 123)",
        "2 motions, each uses per joint at least [%]: range 40 40 40 40 40 40 40, speed 88 88",
        "RMS wall [Nm], 5 unseen runs: ",
        "RMS upright [Nm], 5 unseen runs: ",
        "of the noise floor",
        "RMS wall [Nm], served feed-forward: ",
        "wake-up p50 28.0 p99 84.0 max 8400 us",
        "131072 cycles, 3 late, 0 lost",
        "131072 sent, 131072 received, none missing",
    ];
    for expected in lines {
        assert!(message.contains(expected), "no `{expected}` in\n{message}");
    }
    report.ipc = Some(ipc(10, 9));
    report.identifiability.untrusted_runs = vec!["wall.csv".into()];
    let message = report.in_words().join("\n");
    assert!(message.contains("10 sent, 9 received, NOT EQUAL") && message.contains("not valid: wall.csv"), "{message}");
}

#[test]
fn the_page_is_one_file_of_limited_size() {
    let room = tempfile::tempdir().unwrap();
    let dir = std::env::var_os("PLUMBLINE_SHOW").map_or(room.path().to_path_buf(), PathBuf::from);
    report().write(&dir, &figures(60_000)).unwrap();
    let page = std::fs::read_to_string(dir.join("report.html")).unwrap();
    assert!(dir.join("report.json").exists());
    assert!(page.len() < 2_000_000, "{} bytes", page.len());
    assert!(!page.contains("src=") && !page.contains("href=") && !page.contains("@import"), "something is loaded");
    // Seven joints in each of three runs, positions, arm and limits, the durations; two of friction, one histogram, the correlation, four
    // units.
    assert_eq!(page.matches("<svg ").count(), 3 * 7 + 3 + 1 + 2 + 1 + 1 + 4);
    let heads = page.matches("<th ").count() + page.matches("<th>").count();
    let explained = page.split("<th ").skip(1).filter(|head| head.split('>').next().unwrap().contains("title=\""));
    assert_eq!(explained.count(), heads, "a column without an explanation");
    for id in ["arm", "arm-data", "arm-play", "arm-time"] {
        assert_eq!(page.matches(&format!("id=\"{id}\"")).count(), 1, "{id}");
    }
    assert!(
        page.matches("plumbline run job.toml").count() == 2 && page.contains("job.toml</dd>"),
        "the page says where it is from"
    );
    assert!(!page.contains("NaN") && !page.contains("Infinity"));
    for expected in [
        "LxxR2",
        "Lzz1 + Lyy2",
        "Joint 7",
        "column-equilibrated",
        "131072",
        "noise floor",
        "traj5",
        "served",
        "longest loss",
    ] {
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
    report.counter_experiment.as_mut().unwrap().refusal = evil.into();
    report.control_loop.as_mut().unwrap().sessions[0].name = evil.into();
    report.provenance.insert(evil.into(), evil.into());
    report.control_loop.as_mut().unwrap().sessions[0].refusals = vec![evil.into()];
    let mut figures = figures(100);
    figures.runs[0].title = evil.into();
    let page = report.to_html(&figures).unwrap();
    assert!(!page.contains("<script>alert"), "unescaped");
    assert!(page.matches("&lt;script&gt;").count() >= 7);
}

#[test]
fn an_empty_report_is_a_valid_page() {
    let page = Report { robot: "panda".into(), ..Report::default() }.to_html(&Figures::default()).unwrap();
    assert!(page.contains("panda") && !page.contains("<svg "));
    let one =
        TorqueFigure { t: vec![0.0], measured: vec![vec![f64::NAN]], modelled: vec![vec![0.0]], ..Default::default() };
    let figures = Figures { runs: vec![one], plan: Some(PlanFigure::default()), ..Figures::default() };
    assert!(Report::default().to_html(&figures).unwrap().contains("Joint 1"));
}

#[test]
fn a_motion_that_excites_too_little_and_restricted_parameters_come_back_from_json() {
    let mut report = report();
    report.conditions[0].with_friction = f64::INFINITY;
    report.estimator = Some(EstimatorFacts {
        name: "huber".into(),
        rounds: 50,
        settled: false,
        restricted: vec!["Lxy3".into(), "Lyz2".into()],
    });
    let json = report.to_json().unwrap();
    assert!(json.contains("\"with_friction\": null"));
    let back: Report = serde_json::from_str(&json).unwrap();
    assert_eq!(back, report);
    let summary = back.in_words().join("\n");
    assert!(summary.contains("estimator: huber, whose weights did not converge"), "{summary}");
    assert!(summary.contains("restricted to zero because not significant in this data: Lxy3, Lyz2"), "{summary}");
}

/// What a daemon says whose inclinometer was lost once between two motions.
fn tilted() -> Gravity {
    Gravity {
        source: "held".into(),
        inclinometer: Some("no slopes from the inclinometer for 84 ms".into()),
        measured: Some([Mounting::WALL.rho + 0.02, Mounting::WALL.phi]),
        uncertainty: Some(0.0035),
        on_loss: Some("hold".into()),
        losses: 2,
        lost_s: 3.25,
        hand_overs: 12,
        furthest: 0.02,
        events: vec!["the inclinometer is lost: <no slopes>".into()],
        forgotten: 4,
        motions: vec![MotionGravity { motion: 1, rho: Mounting::WALL.rho + 0.01, phi: Mounting::WALL.phi, std: 0.003 }],
        ..Gravity::default()
    }
}

#[test]
fn what_the_inclinometer_did_stands_in_both_files() {
    let seen = Mounting { rho: Mounting::WALL.rho + 0.01, ..Mounting::WALL };
    let runs = [(1, "identify-1.csv", seen), (2, "wall-1.csv", Mounting::WALL)];
    let facts = GravityReport::new(&tilted(), Mounting::WALL, runs).unwrap();
    assert!((facts.tilt().unwrap() - 0.02).abs() < 1e-9 && (facts.runs[0].tilt - 0.01).abs() < 1e-9);
    assert_eq!((facts.runs[0].source(), facts.runs[0].std), ("measured", Some(0.003)));
    assert_eq!((facts.runs[1].source(), facts.runs[1].std), ("declared", None));
    let sentence = facts.sentence();
    for part in [
        "1.15 +- 0.20 deg off",
        "lost 2 times, for 3.2 s in all (on-loss = \"hold\")",
        "1 of 2 motions began without it",
    ] {
        assert!(sentence.contains(part), "{sentence}");
    }
    let report = Report { gravity: Some(facts), ..report() };
    let html = report.to_html(&figures(20)).unwrap();
    for part in ["Direction of gravity", "4 older events", "is lost: &lt;no slopes&gt;", "0.573", "0.172", "12 times"] {
        assert!(html.contains(part), "{part}");
    }
    let read: Report = serde_json::from_str(&report.to_json().unwrap()).unwrap();
    assert_eq!(read, report);
    assert!(report.in_words().iter().any(|line| line.starts_with("gravity: the inclinometer measured")));

    // A socket that plays the bus is named as what it is; without an inclinometer nothing is said of one.
    let simulated = GravityReport::new(&Gravity { simulated: true, ..tilted() }, Mounting::WALL, []).unwrap();
    assert!(simulated.sentence().starts_with("a SIMULATED inclinometer"));
    assert_eq!(GravityReport::new(&Gravity { inclinometer: None, ..tilted() }, Mounting::WALL, []), None);
}
