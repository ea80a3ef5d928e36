//! The page of a diagnosis with much, little, odd and no content.

use super::*;
use plumbline::report::figures::{Curves, EffectFigure, MapFigure, PeriodFigure, SpectrumFigure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Curves as a diagnosis hands them over: presliding in joint 4, and something over q2 and dq4 in joint 2.
fn figures() -> Curves {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let t: Vec<f64> = (0..2500).map(|k| k as f64 * 0.004).collect();
    let dahl = |t: f64| (3.0 * (1.3 * t).sin() + 5.0 * (2.1 * t + 0.4).sin()).tanh() * 0.16;
    let mut noise = |size: f64| size * rng.random_range(-1.7..1.7);
    let before: Vec<f64> = t.iter().map(|t| dahl(*t) + noise(0.02)).collect();
    let after: Vec<f64> = t.iter().map(|_| noise(0.02)).collect();
    let period = PeriodFigure { joint: 4, trajectory: "identify-1".into(), t, before, after, deviation: vec![0.02] };
    let x: Vec<f64> = (0..30).map(|k| k as f64 * 0.4).collect();
    let curve = |x: f64| 0.16 * (1.0 - 2.0 * (-x / 2.1).exp());
    let effect = EffectFigure {
        title: "presliding in joint 4".into(),
        variable: "displacement since the last reversal / mrad".into(),
        joint: 4,
        mean: x.iter().map(|x| curve(*x) + noise(0.004)).collect(),
        deviation: vec![0.004; 30],
        fitted: (0..200).map(|k| (k as f64 * 0.058, curve(k as f64 * 0.058))).collect(),
        fitted_deviation: Vec::new(),
        x,
    };
    let f: Vec<f64> = (1..400).map(|k| k as f64 * 0.05).collect();
    let floor: Vec<f64> = f.iter().map(|f| 2e-5 * (1.0 + 3.0 / (1.0 + f * f))).collect();
    let spectrum = SpectrumFigure {
        joint: 4,
        before: f.iter().zip(&floor).map(|(f, noise)| noise * (1.0 + 400.0 / (1.0 + f.powi(3)))).collect(),
        after: floor.iter().enumerate().map(|(k, noise)| noise * (1.0 + 0.5 * (k as f64).sin())).collect(),
        noise: floor,
        f,
    };
    let edges = |half: f64| (0..=8).map(|k| half * (k as f64 / 4.0 - 1.0)).collect::<Vec<_>>();
    let cell = |i: usize, k: usize| {
        if (i, k) == (0, 0) { f64::NAN } else { 0.11 * (0.8 * i as f64).sin() * (k as f64 - 3.5) / 3.5 }
    };
    let map = MapFigure {
        title: "joint 2, unexplained".into(),
        x_name: "q2 / rad".into(),
        y_name: "dq4 / (rad/s)".into(),
        x: edges(1.6),
        y: edges(2.0),
        mean: (0..8).map(|k| (0..8).map(|i| cell(i, k)).collect()).collect(),
    };
    let alone = EffectFigure {
        title: "q2".into(),
        variable: "q2 / rad".into(),
        joint: 2,
        fitted: Vec::new(),
        ..effect.clone()
    };
    Curves {
        periods: vec![period],
        effects: vec![effect],
        spectra: vec![spectrum],
        dependences: vec![alone],
        maps: vec![map],
    }
}

/// The page of a diagnosis; `PLUMBLINE_SHOW=FOLDER` keeps it for somebody to look at.
fn page(name: &str, report: &Report, diagnosis: Curves) -> String {
    let page = report.to_html(&Figures { diagnosis, ..Figures::default() }).unwrap();
    if let Some(dir) = std::env::var_os("PLUMBLINE_SHOW") {
        std::fs::write(std::path::Path::new(&dir).join(format!("{name}.html")), &page).unwrap();
    }
    for odd in ["NaN", "inf ", "Infinity", "src=", "href="] {
        assert!(!page.contains(odd), "{odd} in {name}");
    }
    page
}

/// Five effects, one of them of the whole arm, two with rivals.
fn five() -> Diagnosis {
    let mut diagnosis = diagnosed();
    let rival = |id: &str, joint: usize| Alternative {
        id: id.into(),
        joints: vec![joint],
        score_gap: Some(4.2),
        deciding_experiment:
            "move the joint at constant speeds of 0.02 to 0.3 rad/s, both ways, and rest for a second between them"
                .into(),
    };
    let effect = |id: &str, joints: &[usize], parameters: Vec<Quantity>| Effect {
        id: id.into(),
        joints: joints.to_vec(),
        parameters: Parameters(parameters),
        physics: "The bridge of the torque sensor has a zero of its own.".into(),
        equation: "tau_j = c_j".into(),
        ..presliding(1)
    };
    let mut gear = effect(
        "position-dependent-friction",
        &[6],
        vec![
            parameter("order", 100.0, 0.2, ""),
            parameter("sin6", 0.041, 0.003, "Nm"),
            parameter("cos6", -0.022, 0.003, "Nm"),
        ],
    );
    gear.alternatives = vec!["load-dependent-friction".into()];
    gear.alternatives_detail = vec![rival("load-dependent-friction", 6)];
    let mut offset = effect("torque-offset", &[1], vec![parameter("offset1", 0.31, 0.004, "Nm")]);
    offset.alternatives = vec!["asymmetric-coulomb".into()];
    offset.confirmed = false;
    offset.folds = Folds { positive: 0, informative: 0 };
    let delay = effect("delay", &[], vec![parameter("delay", 0.00213, 0.00004, "s")]);
    let mut coupling = effect("transmission-coupling", &[6, 5], vec![parameter("coupling6_5", 0.05, 0.02, "Nm")]);
    coupling.in_model = false;
    diagnosis.effects.extend([gear, offset, delay, coupling]);
    diagnosis.verdict = Verdict::Ambiguous;
    diagnosis.confirmation = Some(Confirmation::NoRepeats);
    diagnosis.scores[1].equivalent = true;
    diagnosis.scores.extend((0..12).map(|k| Score {
        label: format!("position-dependent-friction of a high order in joint {k}"),
        score: -20.0 * f64::from(k),
        ..Score::default()
    }));
    diagnosis.path.push(Step {
        action: Action::Removed,
        what: "position-dependent-friction in joint 6".into(),
        unmodelled: Some(0.02),
        score: None,
    });
    diagnosis.quality.notes = vec!["the torque of joint 3 lags by a sample in validate-2.csv".into()];
    diagnosis.notes = vec!["The log has no temperatures, so warm-up is judged by the clock.".into()];
    diagnosis
}

#[test]
fn the_first_screen_has_the_finding_and_its_improvement() {
    let mut diagnosis = diagnosed();
    let absorbed = NotIdentifiable { joints: vec![2], ..diagnosis.not_identifiable[0].clone() };
    diagnosis.not_identifiable.push(absorbed);
    let page = page("one-effect", &report(diagnosis), figures());
    let (first, rest) = page.split_once("</section>").unwrap();
    assert!(first.contains("<span>Diagnosed</span>: presliding in joint 4</h2>"));
    assert!(
        first.contains("0.320 \u{2192} 0.150 Nm (noise floor 0.149)")
            && first.contains("delta = 2.14 \u{b1} 0.10 mrad")
    );
    assert!(first.contains("confirmed in 4 of 4 trajectories") && first.contains("97 %"));
    // Seven joints before and after, drawn once; the style sheet names either colour too.
    assert_eq!(first.matches("<svg ").count(), 1);
    assert_eq!((first.matches("fill=\"#080808\"").count(), first.matches("fill=\"#090909\"").count()), (8, 8));
    // Scores, path, unmodelled; period, effect, spectrum; dependence, map.
    assert_eq!(rest.matches("<svg ").count(), 8);
    for expected in [
        "What would have been seen",
        "rotor inertia in joint 1, joint 2: Lzz1 absorbs it",
        "kg m2",
        "12 samples stand out",
    ] {
        assert!(rest.contains(expected), "no {expected}");
    }
    // The lines of the summary stand in the box instead of being repeated.
    assert!(!page.contains("RMS before [Nm]"));
}

#[test]
fn pages_of_much_little_and_odd_content() {
    let many = page("five-effects", &report(five()), figures());
    assert!(many.contains("<span>Ambiguous</span>: 5 effects</h2>") && many.contains("not added to the model"));
    assert!(many.contains("or load dependent friction in joint 6") && many.contains("unconfirmed (no repeats)"));
    assert!(many.contains("position-dependent-friction of a high order in j"));
    assert_eq!(many.matches("constant speeds of 0.02").count(), 1);

    let mut nothing = diagnosed();
    nothing.verdict = Verdict::NothingSignificant;
    (nothing.effects, nothing.change) = (Vec::new(), None);
    let none = page("nothing", &report(nothing), Curves::default());
    assert!(none.contains("<span>Nothing significant</span></h2>") && none.contains("would have been seen, unless"));
    let first = none.split("</section>").next().unwrap();
    assert!(first.contains("the model as it is") && first.matches("fill=\"#090909\"").count() == 1);

    let mut open = five();
    open.verdict = Verdict::Partly;
    open.unexplained = vec![unexplained()];
    let open = page("partly", &report(open), figures());
    assert!(open.contains("<span>Partly explained</span>: 5 effects, 1 joint unexplained"));
    assert!(open.contains("joint 2 has 0.110 Nm beyond its noise") && open.contains("orange up to 0.110 Nm"));

    let mut asked = five();
    let question = "presliding in joint 4, or stribeck in joint 4".to_string();
    let open = Open { question, kind: OpenKind::Rivals, now: 5.1, wanted: 24.0, expected: None };
    asked.open = vec![open.clone()];
    assert!(!page("open", &report(asked.clone()), figures()).contains("<h3>Open</h3>"));
    asked.open = vec![Open { expected: Some(61.0), ..open }];
    let sentence = "presliding in joint 4, or stribeck in joint 4: score difference 5.10, expected with the planned motion 61.0 (24.0 answers it)";
    let asked = Report { rounds: vec![Round::of(&asked)], ..report(asked) };
    assert!(asked.in_words().iter().any(|line| *line == format!("open: {sentence}")), "{:#?}", asked.in_words());
    assert!(asked.in_words().iter().any(|line| line.starts_with("round 1: ambiguous: ")
        && line.contains("; RMS on unseen runs [Nm]: ")
        && line.ends_with(&format!("; open: {sentence}"))));
    assert!(page("asked", &asked, figures()).contains(&format!("<li>{sentence}.</li>")));

    let mut lost = diagnosed();
    (lost.verdict, lost.effects, lost.unexplained) = (Verdict::Unexplained, Vec::new(), vec![unexplained()]);
    lost.empirical = vec![learned()];
    let mut curves = figures();
    let plain = page("unexplained", &report(lost.clone()), curves.clone());
    curves.effects[0].fitted_deviation = vec![0.02; curves.effects[0].fitted.len()];
    let lost = page("learned", &report(lost), curves);
    assert!(lost.contains("<h3>Empirical</h3>") && lost.contains("<li>an empirical term on q4 takes 63 %"));
    let polygons = |page: &str| page.matches("<polygon").count();
    assert_eq!(polygons(&lost), polygons(&plain) + 1, "the band of the curve");
    assert!(lost.contains("<span>Unexplained</span>: a residual in joint 2</h2>") && lost.contains("verdict bad"));

    let payload = Effect { id: "payload".into(), joints: vec![7], ..presliding(7) };
    let changes = Changes {
        since: "wall.toml".into(),
        effects: vec![payload],
        before: Some(errors(&[0.5, 0.9, 0.4, 0.6, 0.1, 0.2, 0.1])),
        after: Some(errors(&FLOOR)),
        note: "Link 7 and the payload are one body.".into(),
        ..Changes::default()
    };
    let bare = Diagnosis { verdict: Verdict::Diagnosed, changes: vec![changes], ..Diagnosis::default() };
    let changed = page("payload", &report(bare), Curves::default());
    assert!(changed.contains("payload in joint 7</h2>") && changed.contains("since wall.toml"));
    assert!(
        changed.contains("worst joint (2): 0.900 \u{2192} 0.151 Nm with the changes")
            && changed.contains("the earlier model<i")
    );
}

#[test]
fn pages_of_one_joint_and_of_an_empty_report() {
    let mut one = diagnosed();
    one.effects = vec![presliding(1)];
    for list in [&mut one.before, &mut one.after] {
        list.validate_rms.truncate(1);
        list.intervals.truncate(1);
    }
    (one.change, one.noise_floor) = (None, vec![0.15]);
    one.joints.truncate(1);
    one.minimum_detectable.clear();
    let one = page("one-joint", &report(one), figures());
    assert!(one.contains("joint 1") && !one.contains("What would have been seen"));

    let bare = page("bare", &report(Diagnosis::default()), Curves::default());
    assert!(
        bare.contains("<span>Unexplained</span></h2>")
            && !bare.contains("<svg ")
            && bare.contains("<h2>Diagnosis</h2>")
    );
    let without = page("without", &Report { robot: "panda".into(), ..Report::default() }, figures());
    assert!(!without.contains("class=\"verdict") && !without.contains("<svg "));
}

#[test]
fn what_is_missing_is_a_dash_and_what_can_not_be_drawn_is_left_out() {
    let mut diagnosis = diagnosed();
    let effect = &mut diagnosis.effects[0];
    (effect.evidence, effect.idf, effect.explained_share, effect.torque_rms) = (None, Some(f64::NAN), None, None);
    effect.parameters.0[0] = Quantity { value: f64::NAN, ..effect.parameters.0[0].clone() };
    diagnosis.before.validate_rms[6] = f64::NAN;
    diagnosis.before.intervals.clear();
    diagnosis.after.intervals[0] = [f64::NAN, 0.2];
    diagnosis.after.validate_rms[5] = 0.0;
    diagnosis.noise_floor[6] = f64::INFINITY;
    diagnosis.joints[2] = JointFacts::default();
    diagnosis.joints.truncate(5);
    diagnosis.minimum_detectable.get_mut("presliding").unwrap().torque_rms[3] = f64::INFINITY;
    diagnosis.path[1].unmodelled = None;
    let mut drawn = figures();
    drawn.periods[0].before[17] = f64::NAN;
    drawn.periods[0].deviation = Vec::new();
    drawn.effects[0].mean[3] = f64::NAN;
    drawn.effects[0].deviation.truncate(5);
    drawn.spectra[0].before[0] = 0.0;
    drawn.spectra[0].noise.clear();
    drawn.maps[0].mean.truncate(3);
    drawn.maps.push(MapFigure { mean: vec![vec![f64::NAN]], ..drawn.maps[0].clone() });
    drawn.dependences.push(EffectFigure::default());
    drawn.periods.push(PeriodFigure::default());
    drawn.spectra.push(SpectrumFigure::default());
    // As long as a caller may be.
    drawn.spectra[0].f = (0..200_000).map(f64::from).collect();
    drawn.spectra[0].after = vec![1e-4; 200_000];
    drawn.effects[0].fitted = (0..200_000).map(|k| (f64::from(k % 1000), 0.1)).collect();
    let page = page("gaps", &report(diagnosis), drawn);
    assert!(page.contains("delta = -") && page.contains("<td>-</td>"));
    assert_eq!(page.matches("<svg ").count(), 1 + 8);
    assert!(page.len() < 300_000, "{} bytes", page.len());
}

#[test]
fn text_from_files_is_escaped() {
    let evil = || "<script>alert('x')</script>".to_string();
    let mut diagnosis = five();
    let effect = &mut diagnosis.effects[0];
    (effect.id, effect.label, effect.physics, effect.equation) = (evil(), evil(), evil(), evil());
    (effect.parameters.0[0].name, effect.parameters.0[0].unit) = (evil(), evil());
    effect.alternatives_detail =
        vec![Alternative { id: evil(), deciding_experiment: evil(), ..Alternative::default() }];
    effect.alternatives = vec![evil()];
    (diagnosis.notes, diagnosis.quality.notes) = (vec![evil()], vec![evil()]);
    diagnosis.unexplained =
        vec![Unexplained { depends_on: vec![evil()], deciding_experiment: evil(), note: evil(), ..unexplained() }];
    diagnosis.not_identifiable = vec![NotIdentifiable { effect: evil(), joints: vec![1], why: evil() }];
    let least = MinimumDetectable { name: evil(), unit: evil(), torque_rms: vec![0.1], parameter: vec![0.1] };
    diagnosis.minimum_detectable.insert(evil(), least);
    (diagnosis.scores[0].label, diagnosis.path[0].what) = (evil(), evil());
    diagnosis.changes = vec![Changes { since: evil(), session: evil(), note: evil(), ..Changes::default() }];
    let mut drawn = figures();
    (drawn.periods[0].trajectory, drawn.maps[0].title, drawn.maps[0].x_name) = (evil(), evil(), evil());
    (drawn.effects[0].title, drawn.effects[0].variable) = (evil(), evil());
    let page = page("evil", &report(diagnosis), drawn);
    assert!(!page.contains("<script>alert"), "unescaped");
    assert!(page.matches("&lt;script&gt;").count() >= 20, "{}", page.matches("&lt;script&gt;").count());
}
