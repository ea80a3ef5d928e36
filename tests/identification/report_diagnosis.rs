//! The diagnosis in the report: keys of the JSON, words of every verdict, and in `page` the HTML page.

mod page;

use plumbline::report::diagnosis::*;
use plumbline::report::*;
use plumbline_model::Mounting;

const FLOOR: [f64; 7] = [0.150, 0.151, 0.150, 0.149, 0.061, 0.060, 0.059];

fn parameter(name: &str, value: f64, std: f64, unit: &str) -> Quantity {
    Quantity { name: name.into(), value, std: Some(std), unit: unit.into() }
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
        stratum: Stratum::Repeatable,
        since_session: None,
        acts: None,
        withheld: None,
        form: String::new(),
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
        rms: BeforeAfter::default(),
        threshold: Some(0.7 * FLOOR[j] / 7.0),
        adequacy: (j == 3).then_some(0.96),
        left_out: BeforeAfter { before: Some(if j == 3 { 0.32 } else { 0.15 }), after: Some(0.15) },
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
        rules: plumbline_diagnose::RULES.into(),
        verdict: Verdict::Diagnosed,
        confirmation: Some(Confirmation::Full { trajectories: 3 }),
        effects: vec![presliding(4)],
        hints: Vec::new(),
        before: errors(&before),
        after: errors(&after),
        change: Some(errors(&change)),
        band: Band::Raw,
        held_out_runs: vec!["validate-1.csv".into(), "validate-2.csv".into()],
        noise_floor: FLOOR.to_vec(),
        unexplained: Vec::new(),
        empirical: Vec::new(),
        disagreements: Vec::new(),
        undetermined: Vec::new(),
        open: Vec::new(),
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

/// A learned term of the residual of joint 2, with a law that takes as much.
fn learned() -> Empirical {
    Empirical {
        joint: 2,
        variables: vec!["q4".into()],
        share: Some(0.63),
        rms: BeforeAfter::both([0.11, 0.07]),
        cap: Some(0.21),
        in_model: true,
        withheld: None,
        symbolic: Some(Symbolic {
            law: "a sin(3 q4 + phi)".into(),
            parameters: Parameters(vec![parameter("a", 0.152, 0.004, "Nm"), parameter("phi", 0.61, 0.03, "rad")]),
            share: Some(0.97),
        }),
    }
}

#[test]
fn a_learned_term_is_a_sentence_and_a_key_and_no_effect() {
    let withheld = Empirical { in_model: false, withheld: Some("it does harm".into()), symbolic: None, ..learned() };
    let mut diagnosis = Diagnosis { empirical: vec![learned(), withheld], ..diagnosed() };
    diagnosis.unexplained = vec![unexplained()];
    let lines = summary_of(diagnosis.clone());
    let expected = "- an empirical term on q4 takes 63 % of what is left in joint 2 where it was not fitted, at most 0.210 Nm in any state; \
                    RMS of joint 2 on unseen runs 0.110 -> 0.070 Nm; nearly as much takes a sin(3 q4 + phi) (a 0.152 +- 0.004 Nm, \
                    phi 0.61 +- 0.03 rad)";
    assert!(lines.iter().any(|line| line == expected), "{lines:#?}");
    assert!(lines.iter().any(|line| line.ends_with("; not added to the model: it does harm")), "{lines:#?}");
    assert!(lines[0].starts_with("diagnosis: ") && !lines[0].contains("empirical"), "{}", lines[0]);
    let value = serde_json::to_value(&diagnosis).unwrap();
    assert_eq!(value["empirical"][0]["symbolic"]["parameters"]["phi"], 0.61);
    assert_eq!(serde_json::from_value::<Diagnosis>(value).unwrap(), diagnosis);
}

fn report(diagnosis: Diagnosis) -> Report {
    let run = |index: usize| Validation {
        run: format!("validate-{index}.csv"),
        rms_raw: diagnosis.after.validate_rms.clone(),
        mounting: Mounting::WALL.into(),
        ..Validation::default()
    };
    Report {
        robot: "panda".into(),
        mounting: Mounting::WALL.into(),
        base: Base { kind: "GBS".into(), count: 59, ..Base::default() },
        identify: Fit { rms_raw: FLOOR.to_vec(), ..Fit::default() },
        validate: (1..=2).map(run).collect(),
        noise_floor: FLOOR.to_vec(),
        diagnosis: Some(diagnosis),
        ..Report::default()
    }
}

/// The lines of the summary that speak of the diagnosis.
fn summary_of(diagnosis: Diagnosis) -> Vec<String> {
    let lines = report(diagnosis).in_words();
    // Right after the line that names the robot, before everything else.
    assert!(lines[0].starts_with("panda, mounting wall: 59 base parameters"), "{}", lines[0]);
    let end = lines.iter().position(|line| line.starts_with("noise floor [Nm]: ")).unwrap();
    lines[1..end].to_vec()
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
fn the_json_has_the_specified_keys_and_round_trips() {
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
fn the_minimal_schema_is_readable() {
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
    let lines = summary_of(back);
    assert!(lines[0].contains("(delta -, fp4 0.160 +- 0.012 Nm)"), "{}", lines[0]);
    assert!(lines.iter().any(|line| line.starts_with("RMS before [Nm]: -  0.151 [0.148 0.154]")), "{lines:#?}");
    assert!(!lines.join(" ").contains("NaN"));
}

#[test]
fn one_effect_is_in_the_first_line() {
    let lines = summary_of(diagnosed());
    assert_eq!(
        lines[0],
        "diagnosis: presliding in joint 4 (delta 2.14 +- 0.10 mrad, fp4 0.160 +- 0.012 Nm), confirmed in 4 of 4 trajectories"
    );
    assert_eq!(
        lines[1],
        "error on unseen runs, worst joint (4): 0.320 -> 0.150 Nm (noise floor 0.149); unmodelled torque of the mean period 0.280 -> \
         0.004 Nm"
    );
    assert!(lines[2].starts_with("RMS before [Nm]: 0.150 [0.147 0.153]  0.151 "), "{}", lines[2]);
    assert!(lines[3].starts_with("RMS after [Nm]: 0.152 [0.148 0.155]  "), "{}", lines[3]);
    assert!(
        lines[4].starts_with("RMS change [Nm]: 0.002 ") && lines[4].contains("-0.170 [-0.173 -0.166]"),
        "{}",
        lines[4]
    );
    assert_eq!(lines.len(), 5);
    let mut without_repeats = diagnosed();
    without_repeats.joints[3].floor_of_mean = None;
    assert!(!summary_of(without_repeats)[1].contains("unmodelled"));
    let mut filtered = diagnosed();
    filtered.band = Band::Filtered { cutoff: 4.0 };
    let lines = summary_of(filtered);
    assert!(lines[2].starts_with("noise floor [Nm] after a 4 Hz zero-phase low-pass: 0.150  0.151"), "{}", lines[2]);
    assert!(lines[1].starts_with("error on unseen runs after a 4 Hz zero-phase low-pass, worst joint (4): "));
}

#[test]
fn non_numeric_values() {
    let mut diagnosis = diagnosed();
    diagnosis.verdict = Verdict::NothingSignificant;
    diagnosis.effects.clear();
    diagnosis.change = None;
    diagnosis.after = diagnosis.before.clone();
    diagnosis.minimum_detectable.get_mut("rotor-inertia").unwrap().torque_rms[2] = 0.0412;
    diagnosis.minimum_detectable.get_mut("rotor-inertia").unwrap().torque_rms[0] = f64::NAN;
    let lines = summary_of(diagnosis.clone());
    assert_eq!(
        lines[0],
        "diagnosis: nothing significant: any known effect of 0.0412 Nm RMS or more would have been seen, unless the base parameters \
         absorb it, half of them from 0.0166 Nm on (hardest to see: rotor inertia in joint 3)"
    );
    assert_eq!(lines[1], "error on unseen runs, worst joint (4): 0.320 Nm (noise floor 0.149)");
    assert!(lines[2].starts_with("RMS [Nm]: 0.150 [") && lines.len() == 3, "{lines:#?}");

    diagnosis.minimum_detectable.clear();
    assert!(summary_of(diagnosis)[0].ends_with("how small an effect would have been seen is not known"));
}
