//! The diagnosis in the report: the promised keys, the words of every verdict, the page with much, little and odd content.

use plumbline::report::diagnosis::*;
use plumbline::report::*;

const FLOOR: [f64; 7] = [0.150, 0.151, 0.150, 0.149, 0.061, 0.060, 0.059];

fn parameter(name: &str, value: f64, std: f64, unit: &str) -> EffectParameter {
    EffectParameter { name: name.into(), value, std: Some(std), unit: unit.into() }
}

/// Presliding in a joint as a diagnosis would hand it over.
fn presliding(joint: usize) -> Effect {
    let fp = format!("fp{joint}");
    Effect {
        id: "presliding".into(),
        joints: vec![joint],
        label: String::new(),
        parameters: Parameters(vec![parameter("delta", 2.137e-3, 9.8e-5, "rad"), parameter(&fp, 0.1603, 0.0123, "Nm")]),
        evidence: Some(412.3),
        delta_log_likelihood: Some(221.4),
        penalty: Some(30.5),
        folds: Folds { positive: 4, informative: 4 },
        idf: Some(0.83),
        torque_rms: Some(0.141),
        explained_share: Some(0.97),
        adequacy: Some(0.96),
        alternatives: Vec::new(),
        alternatives_detail: Vec::new(),
        confirmed: true,
        stratum: Occurrence::Repeatable,
        in_model: true,
        equation: "tau_j = fp_j z, dz/dq_j = (1 - sign(dq_j) z) / delta".into(),
        physics: "After a reversal the contacts of gears, bearings and seals bend before they slide.".into(),
    }
}

/// Errors whose intervals reach 2 % to both sides.
fn errors(rms: &[f64]) -> Errors {
    let interval = |rms: &f64| [rms - 0.02 * rms.abs(), rms + 0.02 * rms.abs()];
    Errors { validate_rms: rms.to_vec(), intervals: rms.iter().map(interval).collect() }
}

/// One effect in joint 4 that is fully explained.
fn diagnosed() -> Diagnosis {
    let mut before = FLOOR;
    (before[3], before[2]) = (0.3201, 0.1712);
    let after = FLOOR.map(|floor| 1.01 * floor);
    let change: Vec<f64> = after.iter().zip(&before).map(|(after, before)| after - before).collect();
    let joint = |j: usize| JointFacts {
        noise: Some(FLOOR[j]),
        floor_of_mean: Some(FLOOR[j] / 7.0),
        lack_of_fit: BeforeAfter { before: Some(if j == 3 { 60.0 } else { 1.1 }), after: Some(1.05) },
        unmodelled: BeforeAfter { before: Some(if j == 3 { 0.28 } else { 0.005 }), after: Some(0.004) },
        threshold: Some(0.7 * FLOOR[j] / 7.0),
        adequacy: (j == 3).then_some(0.96),
    };
    let step = |action, what: &str, unmodelled, score| Step { action, what: what.into(), unmodelled, score };
    let score = |label: &str, score, chosen, equivalent| Score { label: label.into(), score, chosen, equivalent };
    let least = |unit: &str| MinimumDetectable {
        torque_rms: FLOOR.iter().map(|floor| floor / 9.0).collect(),
        parameter: FLOOR.iter().map(|floor| floor / 8.0).collect(),
        name: "fp".into(),
        unit: unit.into(),
    };
    Diagnosis {
        verdict: Verdict::Diagnosed,
        confirmation: "confirmed across trajectories".into(),
        effects: vec![presliding(4)],
        before: errors(&before),
        after: errors(&after),
        change: Some(errors(&change)),
        band: Band::Raw,
        held_out_runs: vec!["validate-1.csv".into(), "validate-2.csv".into()],
        noise_floor: FLOOR.to_vec(),
        unexplained: Vec::new(),
        minimum_detectable: [("presliding".to_string(), least("Nm")), ("rotor-inertia".to_string(), least("kg m2"))]
            .into(),
        not_identifiable: vec![NotIdentifiable {
            effect: "rotor-inertia".into(),
            joints: vec![1],
            why: "Lzz1 absorbs it".into(),
        }],
        quality: Quality {
            outliers: Some(12),
            repeated_stamps: Some(0),
            quantum: vec![0.0357; 7],
            ..Quality::default()
        },
        joints: (0..7).map(joint).collect(),
        path: vec![
            step(Action::Start, "rigid body, friction", Some(0.281), None),
            step(Action::Added, "presliding in joint 4", Some(0.012), Some(412.3)),
        ],
        scores: vec![
            score("presliding in joint 4", 412.3, true, false),
            score("stribeck in joint 4", 241.0, false, false),
            score("delay", -8.0, false, false),
        ],
        changes: Vec::new(),
        notes: Vec::new(),
    }
}

fn report(diagnosis: Diagnosis) -> Report {
    Report { robot: "panda".into(), noise_floor: FLOOR.to_vec(), diagnosis: Some(diagnosis), ..Report::default() }
}

/// The lines of the summary that speak of the diagnosis.
fn said(diagnosis: Diagnosis) -> Vec<String> {
    report(diagnosis).summary().into_iter().skip(1).filter(|line| !line.starts_with("noise floor")).collect()
}

/// The joint that has 0.11 Nm of unknown origin.
fn unexplained() -> Unexplained {
    Unexplained {
        joint: 2,
        rms: Some(0.1101),
        floor: Some(0.02),
        depends_on: vec!["q2".into(), "dq4".into()],
        r2: Some(0.823),
        deciding_experiment: "sweep joint 2 slowly while joint 4 rests".into(),
        note: String::new(),
    }
}

#[test]
fn the_json_has_the_keys_of_the_design_and_reads_back() {
    let mut diagnosis = diagnosed();
    diagnosis.effects[0].alternatives = vec!["stribeck".into()];
    diagnosis.unexplained = vec![unexplained()];
    let report = report(diagnosis);
    let text = report.to_json().unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let block = &json["diagnosis"];
    assert_eq!(block["verdict"], "diagnosed");
    let effect = &block["effects"][0];
    assert_eq!((&effect["id"], &effect["joints"]), (&"presliding".into(), &serde_json::json!([4])));
    assert_eq!(effect["parameters"], serde_json::json!({ "delta": 2.137e-3, "fp4": 0.1603 }));
    assert_eq!(effect["std"], serde_json::json!({ "delta": 9.8e-5, "fp4": 0.0123 }));
    assert_eq!(effect["units"], serde_json::json!({ "delta": "rad", "fp4": "Nm" }));
    assert_eq!((&effect["evidence"], &effect["explained_share"]), (&412.3.into(), &0.97.into()));
    assert_eq!(effect["alternatives"], serde_json::json!(["stribeck"]));
    assert_eq!(block["before"]["validate_rms"][3], 0.3201);
    assert_eq!(block["after"]["validate_rms"].as_array().unwrap().len(), 7);
    assert_eq!(block["noise_floor"][0], 0.150);
    let open = &block["unexplained"][0];
    assert_eq!((&open["joint"], &open["rms"]), (&2.into(), &0.1101.into()));
    assert_eq!(open["depends_on"], serde_json::json!(["q2", "dq4"]));
    assert!(open["deciding_experiment"].as_str().unwrap().starts_with("sweep"));
    assert_eq!(block["minimum_detectable"]["presliding"]["unit"], "Nm");
    assert_eq!(serde_json::from_str::<Report>(&text).unwrap(), report);
}

#[test]
fn the_bare_schema_of_the_design_is_enough_to_read() {
    let text = r#"{ "verdict": "nothing-significant",
        "effects": [{ "id": "payload", "joints": [], "parameters": { "mass": 0.73 }, "std": {}, "evidence": null, "alternatives": [],
                      "explained_share": null }],
        "before": { "validate_rms": [0.1, null] }, "after": { "validate_rms": [] }, "noise_floor": [null, 0.1],
        "unexplained": [{ "joint": 1, "rms": 0.1, "depends_on": [], "deciding_experiment": "" }], "minimum_detectable": {} }"#;
    let read: Diagnosis = serde_json::from_str(text).unwrap();
    assert_eq!(read.verdict, Verdict::NothingSignificant);
    assert_eq!((read.effects[0].parameters.0[0].value, read.effects[0].parameters.0[0].std), (0.73, None));
    assert!(read.before.validate_rms[1].is_nan() && read.noise_floor[0].is_nan());
    assert!(serde_json::from_str::<Diagnosis>(&text.replace("nothing-significant", "fine")).is_err());
}

#[test]
fn what_is_not_a_number_becomes_null_and_comes_back() {
    let mut diagnosis = diagnosed();
    diagnosis.before.validate_rms[0] = f64::NAN;
    diagnosis.before.intervals[0] = [f64::NAN, f64::INFINITY];
    diagnosis.noise_floor[6] = f64::NAN;
    diagnosis.scores[2].score = f64::NAN;
    diagnosis.effects[0].parameters.0[0].value = f64::NAN;
    diagnosis.effects[0].evidence = Some(f64::NAN);
    let text = report(diagnosis).to_json().unwrap();
    let back: Report = serde_json::from_str(&text).unwrap();
    let back = back.diagnosis.unwrap();
    assert!(back.before.validate_rms[0].is_nan() && back.before.intervals[0].iter().all(|end| end.is_nan()));
    assert!(back.noise_floor[6].is_nan() && back.scores[2].score.is_nan());
    assert!(back.effects[0].parameters.0[0].value.is_nan() && back.effects[0].evidence.is_none());
    let lines = said(back);
    assert!(lines[0].contains("(delta -, fp4 0.160 +- 0.012 Nm)"), "{}", lines[0]);
    assert!(lines.iter().any(|line| line.starts_with("RMS before [Nm]: -  0.151 [0.148 0.154]")), "{lines:#?}");
    assert!(!lines.join(" ").contains("NaN"));
}

#[test]
fn one_effect_stands_in_the_first_line() {
    let lines = said(diagnosed());
    assert_eq!(
        lines[0],
        "diagnosis: presliding in joint 4 (delta 2.14 +- 0.10 mrad, fp4 0.160 +- 0.012 Nm), confirmed in 4 of 4 trajectories"
    );
    assert_eq!(lines[1], "error on unseen runs, worst joint (4): 0.320 -> 0.150 Nm (noise floor 0.149)");
    assert!(lines[2].starts_with("RMS before [Nm]: 0.150 [0.147 0.153]  0.151 "), "{}", lines[2]);
    assert!(lines[3].starts_with("RMS after [Nm]: 0.152 [0.148 0.155]  "), "{}", lines[3]);
    assert!(
        lines[4].starts_with("RMS change [Nm]: 0.002 ") && lines[4].contains("-0.170 [-0.173 -0.166]"),
        "{}",
        lines[4]
    );
    assert_eq!(lines.len(), 5);
    let mut filtered = diagnosed();
    filtered.band = Band::Filtered { cutoff: 4.0 };
    assert!(said(filtered)[1].starts_with("error on unseen runs after a 4 Hz zero-phase low-pass, worst joint (4): "));
}

#[test]
fn several_effects_stand_one_below_the_other() {
    let mut diagnosis = diagnosed();
    let offset = Effect {
        id: "torque-offset".into(),
        joints: vec![1],
        parameters: Parameters(vec![parameter("offset1", 0.31, 0.004, "Nm")]),
        folds: Folds::default(),
        confirmed: false,
        ..presliding(1)
    };
    let coupling = Effect { id: "transmission-coupling".into(), joints: vec![6, 5], in_model: false, ..presliding(6) };
    diagnosis.effects.extend([offset, coupling]);
    diagnosis.confirmation = "one trajectory".into();
    let lines = said(diagnosis);
    assert_eq!(lines[0], "diagnosis: 3 effects explain the residual");
    assert!(lines[1].starts_with("- presliding in joint 4 (delta 2.1"), "{}", lines[1]);
    assert_eq!(lines[2], "- torque offset in joint 1 (offset1 0.310 +- 0.004 Nm), unconfirmed (one trajectory)");
    assert!(
        lines[3].starts_with("- transmission coupling in joints 6 and 5 (")
            && lines[3].ends_with("; not added to the model")
    );
}

#[test]
fn nothing_is_a_number() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::NothingSignificant;
    diagnosis.effects.clear();
    diagnosis.change = None;
    diagnosis.after = diagnosis.before.clone();
    diagnosis.minimum_detectable.get_mut("rotor-inertia").unwrap().torque_rms[2] = 0.0412;
    diagnosis.minimum_detectable.get_mut("rotor-inertia").unwrap().torque_rms[0] = f64::NAN;
    let lines = said(diagnosis.clone());
    assert_eq!(
        lines[0],
        "diagnosis: nothing significant: a known effect of 0.0412 Nm RMS or more would have been seen in any joint, unless the base \
         parameters absorb it (hardest to see: rotor inertia in joint 3)"
    );
    assert_eq!(lines[1], "error on unseen runs, worst joint (4): 0.320 Nm (noise floor 0.149)");
    assert!(lines[2].starts_with("RMS [Nm]: 0.150 [") && lines.len() == 3, "{lines:#?}");

    diagnosis.minimum_detectable.clear();
    assert!(said(diagnosis)[0].ends_with("how small an effect would have been seen is not known"));
}

#[test]
fn rivals_stand_beside_the_effect_with_what_decides() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::Ambiguous;
    diagnosis.effects[0].alternatives = vec!["stribeck".into(), "delay".into()];
    let lines = said(diagnosis.clone());
    assert!(lines[0].starts_with("diagnosis: ambiguous: presliding in joint 4 ("), "{}", lines[0]);
    assert!(lines[0].ends_with("trajectories; or stribeck, or delay"), "{}", lines[0]);
    let rival = |id: &str, joints: &[usize], gap| Alternative {
        id: id.into(),
        joints: joints.to_vec(),
        score_gap: gap,
        deciding_experiment: "move joint 4 at constant speeds of 0.02 to 0.3 rad/s".into(),
    };
    diagnosis.effects[0].alternatives_detail = vec![rival("stribeck", &[4], Some(3.21)), rival("delay", &[], None)];
    let line = said(diagnosis).remove(0);
    assert!(
        line.ends_with(
            "; or stribeck in joint 4 (score 3.21 lower), or delay; to decide: move joint 4 at constant speeds of 0.02 to 0.3 rad/s"
        ),
        "{line}"
    );
}

#[test]
fn what_stays_unexplained_is_said_with_what_it_depends_on() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::Unexplained;
    diagnosis.effects.clear();
    diagnosis.unexplained = vec![unexplained()];
    let lines = said(diagnosis.clone());
    assert_eq!(
        lines[0],
        "diagnosis: unexplained: joint 2 has 0.110 Nm beyond its noise that depends on q2 and dq4 (R2 0.82); to decide: sweep joint 2 \
         slowly while joint 4 rests"
    );
    let open = Unexplained { joint: 5, note: "line at 7.3 Hz".into(), ..Unexplained::default() };
    diagnosis.unexplained.push(open);
    let lines = said(diagnosis.clone());
    assert_eq!(lines[0], "diagnosis: unexplained: 2 joints unexplained");
    assert_eq!(lines[2], "- joint 5 has a residual beyond its noise for which no dependence was found; line at 7.3 Hz");
    diagnosis.unexplained.clear();
    assert_eq!(said(diagnosis)[0], "diagnosis: unexplained");
}

#[test]
fn partly_explained_names_both_sides() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::Partly;
    diagnosis.unexplained = vec![unexplained()];
    diagnosis.after.validate_rms[1] = 0.19;
    let lines = said(diagnosis);
    assert_eq!(lines[0], "diagnosis: partly explained: 1 effect, 1 joint unexplained");
    assert!(lines[1].starts_with("- presliding in joint 4") && lines[2].starts_with("- joint 2 has 0.110 Nm"));
    assert_eq!(
        lines[3],
        "error on unseen runs, worst joint (4): 0.320 -> 0.150 Nm (noise floor 0.149); worst now (2): 0.190 (noise floor 0.151)"
    );
}

#[test]
fn an_effect_that_is_not_added_leaves_the_error_as_it_was() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::Unexplained;
    diagnosis.effects[0].in_model = false;
    diagnosis.effects[0].folds = Folds { positive: 1, informative: 4 };
    diagnosis.effects[0].confirmed = false;
    let lines = said(diagnosis);
    assert!(lines[0].ends_with("unconfirmed (held in 1 of 4 trajectories); not added to the model"), "{}", lines[0]);
    assert_eq!(
        lines[1],
        "error on unseen runs, worst joint (4): 0.320 Nm (noise floor 0.149); no effect was added to the model"
    );
}

#[test]
fn changes_say_since_when() {
    let payload = Effect {
        id: "payload".into(),
        joints: vec![7],
        parameters: Parameters(vec![parameter("mass", 0.7312, 0.0041, "kg"), parameter("com_x", 0.0123, 0.0008, "m")]),
        stratum: Occurrence::Reference,
        in_model: false,
        ..presliding(7)
    };
    let changes = |effects| Changes { since: "wall.toml".into(), effects, ..Changes::default() };
    let mut diagnosis =
        Diagnosis { verdict: Verdict::Diagnosed, changes: vec![changes(vec![payload])], ..Diagnosis::default() };
    assert_eq!(
        said(diagnosis.clone()),
        [
            "diagnosis: since wall.toml: payload in joint 7 (mass 0.731 +- 0.004 kg, com_x 12.3 +- 0.8 mm), confirmed in 4 of 4 trajectories"
        ]
    );
    diagnosis.verdict = Verdict::NothingSignificant;
    diagnosis.changes = vec![changes(Vec::new())];
    let lines = said(diagnosis);
    assert!(lines[0].starts_with("diagnosis: nothing significant") && lines[1] == "- since wall.toml: nothing changed");
}

#[test]
fn a_report_without_a_diagnosis_says_nothing_of_it() {
    let bare = Report { robot: "panda".into(), ..Report::default() };
    assert!(!bare.summary().join("\n").contains("diagnosis"));
    assert!(!bare.to_json().unwrap().contains("diagnosis"));
}
