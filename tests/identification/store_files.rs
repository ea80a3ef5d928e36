//! Model and plan files: bit-exact round trips, and every wrong number refused by name.

use nalgebra::{DMatrix, Vector3};
use plumbline::store::*;
use plumbline_core::BadInput;
use plumbline_excite::{Constraints, Criterion, Margins, Plan, PlanSearch, PlanUsage, parse_plan, plan_text};
use plumbline_identify::external::ResidualSpectrum;
use plumbline_identify::{Spread, TorqueUncertainty};
use plumbline_model::term::Sample;
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::{BaseKind, Chain, Conditions, Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_testkit::bodies::with_effects;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

fn chain_of(robot: &str) -> Result<Chain, BadInput> {
    Ok(Robot::load(robot, None)?.chain)
}

fn made_up(kind: BaseKind) -> ModelFile {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let chain = chain_of("panda").unwrap();
    let reduction = Reduction::of_kind(&chain, kind);
    let structure = Structure::of(chain, reduction, &["friction", "torque-offset", "rotor-inertia"]).unwrap();
    let draw =
        |_| (rng.random_range(-1.0..1.0_f64) * 10f64.powi(rng.random_range(-7..2)), Some(rng.random_range(0.0..0.1)));
    let values: Vec<_> = (0..structure.columns().len()).map(draw).collect();
    let mounting = if kind == BaseKind::Gbs { Mounting { rho: 1.1, phi: -0.3 } } else { Mounting::UPRIGHT };
    let model = TorqueModel::new("panda", structure, vec![mounting], &values).unwrap();
    ModelFile {
        uncertainty: Some(uncertainty(&model, &mut rng)),
        model,
        noise_floor: vec![0.1 + 0.2; 7],
        validation: vec![Validated { run: "a \"b\" \\ c".into(), rho: 0.1, phi: 0.2, rms: vec![1.0 / 3.0; 7] }],
        consistent: None,
        provenance: Provenance {
            dataset: Some("ab".repeat(32)),
            date: Some("2026-01-01".into()),
            ..Provenance::default()
        },
    }
}

/// Random correlations with the standard deviations of the model.
fn uncertainty(model: &TorqueModel, rng: &mut ChaCha8Rng) -> TorqueUncertainty {
    let std: Vec<f64> = model.parameters().iter().map(|own| own.std.unwrap()).collect();
    let p = std.len();
    let factor = DMatrix::<f64>::from_fn(p, p, |_, _| rng.random_range(-1.0..1.0));
    let product = &factor * factor.transpose();
    let covariance = DMatrix::from_fn(p, p, |c, d| {
        let (c, d) = (c.max(d), c.min(d));
        let scale = (product[(c, c)] * product[(d, d)]).sqrt();
        if c == d { std[c] * std[c] } else { std[c] * std[d] * product[(c, d)] / scale }
    });
    let mut freedom: Vec<f64> = (0..p).map(|_| rng.random_range(3.0..300.0)).collect();
    freedom[4] = f64::INFINITY;
    let residual_std = (0..7).map(|_| rng.random_range(0.1..0.3)).collect();
    let bands = ResidualSpectrum::bands(1000.0).count();
    let power = (0..7).map(|_| (0..bands).map(|_| rng.random_range(0.0..1e-3)).collect()).collect();
    let residual_spectrum = Some(ResidualSpectrum { rate: 1000.0, power });
    let parameters = Spread { covariance, freedom };
    TorqueUncertainty { parameters, residual_std, residual_freedom: 1234.5, residual_spectrum }
}

fn parse(text: &str) -> Result<ModelFile, String> {
    ModelFile::parse("model.toml", text, chain_of).map_err(|bad| bad.to_string())
}

#[test]
fn a_model_file_round_trips_bitwise() {
    for kind in [BaseKind::Gbs, BaseKind::Vbs] {
        let written = made_up(kind);
        let read = parse(&written.to_toml()).unwrap();
        assert_eq!(read.model.parameters(), written.model.parameters());
        assert_eq!(
            (read.model.robot(), read.model.kind(), read.model.mountings()),
            ("panda", kind, written.model.mountings())
        );
        assert_eq!(read.noise_floor, written.noise_floor);
        assert_eq!((&read.validation, &read.provenance), (&written.validation, &written.provenance));
        assert_eq!(read.to_toml(), written.to_toml());
        let [read_too, written_too] = [&read, &written].map(|file| file.uncertainty.as_ref().unwrap());
        assert_eq!(read_too.parameters.covariance, written_too.parameters.covariance);
        assert_eq!(read_too.parameters.freedom, written_too.parameters.freedom);
        assert_eq!(read_too.residual_std, written_too.residual_std);
        assert_eq!(read_too.residual_freedom, written_too.residual_freedom);
        assert_eq!(read_too.residual_spectrum, written_too.residual_spectrum);
        // The second route: the same torque, not only the same numbers.
        let gravity = Vector3::new(1.0, -2.0, 9.0);
        let sample = Sample { q: [0.3; 8], dq: [-0.7; 8], ddq: [2.0; 8] };
        let torque = |file: &ModelFile| file.model.evaluator(&gravity).torque(&sample);
        assert_eq!(torque(&read), torque(&written));
    }
}

/// A learned term names its second joint and its domain; without them it would be another function.
#[test]
fn a_learned_term_round_trips_and_is_refused_without_its_joints() {
    let plain = made_up(BaseKind::Gbs).model;
    let settings = vec![0.1, 1.2, -0.3, 1.0 / 3.0];
    let spec = Spec { family: "empirical", form: "q-dq", site: Site::Function { row: 2, of: [4, 1] }, settings };
    let model = with_effects(&plain, std::slice::from_ref(&spec), |_, c| (c as f64).sin());
    let file = ModelFile { model, uncertainty: None, ..made_up(BaseKind::Gbs) };
    let text = file.to_toml();
    let read = parse(&text).unwrap();
    assert_eq!(read.model.terms().last().unwrap().0.spec(), Some(spec));
    assert_eq!((read.model.parameters(), read.to_toml()), (file.model.parameters(), text.clone()));
    let sample = Sample { q: [0.3; 8], dq: [-0.2; 8], ddq: [2.0; 8] };
    let torque = |model: &TorqueModel| model.evaluator(&Vector3::new(1.0, -2.0, 9.0)).torque(&sample).0;
    assert_eq!(torque(&read.model), torque(&file.model));
    assert_ne!(torque(&file.model)[2], torque(&plain)[2]);
    let unsealed: String =
        text.lines().filter(|line| !line.starts_with("content = ")).map(|line| format!("{line}\n")).collect();
    for (line, instead) in [
        ("cause = 5\n", ""),
        ("cause = 5\n", "cause = 8\n"),
        ("reach = 1.2", "reach = 0.0"),
        ("other = 2", "third = 2"),
    ] {
        assert!(unsealed.contains(line), "{line}");
        let refused = parse(&unsealed.replacen(line, instead, 1)).unwrap_err();
        assert!(refused.starts_with("model.toml"), "{refused}");
    }
}

#[test]
fn every_wrong_model_is_refused_by_name() {
    let text = made_up(BaseKind::Gbs).to_toml();
    let spoil = |from: &str, to: &str| {
        assert!(text.contains(from), "no `{from}` in\n{text}");
        parse(&text.replacen(from, to, 1)).expect_err("a refusal")
    };
    let line = |name: &str| text.lines().find(|line| line.contains(&format!("name = \"{name}\""))).unwrap().to_string();
    let value = |name: &str| {
        let line = line(name);
        line.split(", ").find(|part| part.starts_with("value")).unwrap().to_string()
    };
    let cases = [
        (spoil("format = 1", "format = 2"), "key `format`: got 2, expected 1, the format of this program"),
        (spoil("format = 1", "formt = 1"), "formt"),
        (spoil("\"GBS\"", "\"VBS\""), "[[term]]: got term `rigid-body`"),
        (spoil("\"GBS\"", "\"gbs\""), "key `kind`: got `\"gbs\"`"),
        (spoil("\"panda\"", "\"pandu\""), "pandu"),
        (spoil("\"panda\"", "\"ur10\""), "key `noise-floor`: got 7 values, expected 6"),
        (spoil(&line("Lxx2"), ""), "base parameter `Lxx2` is missing"),
        (spoil(&line("fv3"), &line("fv2")), "two columns `fv2`"),
        (spoil("name = \"fv3\"", "name = \"fw3\""), "no column `fw3`"),
        (spoil("id = \"friction\"", "id = \"frcition\""), "no term `frcition`"),
        (spoil(&value("Lxx2"), "value = nan"), "key `value of Lxx2`: got NaN, expected a finite number"),
        (spoil(&value("fc1"), "value = inf"), "key `value of fc1`: got inf"),
        (spoil("std = 0.", "std = -0."), "expected a standard deviation, 0 or more"),
        (spoil("unit = \"kg m\"", "unit = \"g m\""), "got `g m`, expected kg m"),
        (spoil("noise-floor = [", "noise-floor = [0.1, "), "key `noise-floor`: got 8 values, expected 7"),
        (spoil("rms = [", "rms = [0.1, "), "key `validation[0].rms`: got 8 values, expected 7"),
        (spoil("\nrho = 1.1", "\nrho = nan"), "key `mounting[0]`: got NaN"),
        (spoil("[provenance]", "[provenance]\nauthor = \"me\""), "key `provenance.author`"),
        (spoil("[provenance]", "provenance"), "line "),
    ];
    for (message, expected) in cases {
        assert!(message.starts_with("model.toml: ") || message.contains("pandu"), "{message}");
        assert!(message.contains(expected), "`{message}` does not say `{expected}`");
    }
}

/// A text without the line of its hash, as a table.
fn table(text: &str) -> toml::Table {
    let mut table: toml::Table = toml::from_str(text).unwrap();
    table.remove("content").unwrap();
    table
}

fn block(table: &mut toml::Table) -> &mut toml::Table {
    table["uncertainty"].as_table_mut().unwrap()
}

fn list(value: &mut toml::Value) -> &mut Vec<toml::Value> {
    value.as_array_mut().unwrap()
}

#[test]
fn a_model_without_uncertainty_is_read() {
    let file = made_up(BaseKind::Gbs);
    let text = ModelFile { uncertainty: None, ..file.clone() }.to_toml();
    assert!(!text.contains("uncertainty") && text.len() < file.to_toml().len() / 2);
    let read = parse(&text).unwrap();
    assert!(read.uncertainty.is_none());
    assert_eq!(read.model.parameters(), file.model.parameters());
    assert_eq!(read.to_toml(), text);
}

#[test]
fn the_covariance_is_in_the_order_of_the_file() {
    let file = made_up(BaseKind::Gbs);
    let mut reordered = table(&file.to_toml());
    // The parameters of the friction, the second term, in reverse.
    let first = file.model.terms()[0].1.len();
    let count = file.model.terms()[1].1.len();
    let mut order: Vec<usize> = (0..file.model.parameters().len()).collect();
    order[first..first + count].reverse();
    list(&mut list(&mut reordered["term"])[1]["parameters"]).reverse();
    let parsed = |table: &toml::Table| parse(&toml::to_string(table).unwrap());
    assert!(parsed(&reordered).unwrap_err().contains("the square of its std"), "rows of other parameters");
    let block = block(&mut reordered);
    let freedom = block["freedom"].as_array().unwrap().clone();
    block["freedom"] = order.iter().map(|&c| freedom[c].clone()).collect::<Vec<_>>().into();
    let own = &file.uncertainty.as_ref().unwrap().parameters;
    let row = |c: usize| (0..=c).map(|d| own.covariance[(order[c], order[d])].into()).collect::<Vec<toml::Value>>();
    block["covariance"] = (0..order.len()).map(row).collect::<Vec<_>>().into();
    let read = parsed(&reordered).unwrap().uncertainty.unwrap();
    assert_eq!((read.parameters.covariance, read.parameters.freedom), (own.covariance.clone(), own.freedom.clone()));
}

#[test]
fn every_wrong_uncertainty_is_refused_by_name() {
    let text = made_up(BaseKind::Gbs).to_toml();
    let spoil = |spoil: &dyn Fn(&mut toml::Table)| {
        let mut table = table(&text);
        spoil(block(&mut table));
        parse(&toml::to_string(&table).unwrap()).map(|_| ()).expect_err("a refusal")
    };
    let entry = |row: usize, column: usize, value: f64| {
        spoil(&|block| list(&mut list(&mut block["covariance"])[row])[column] = value.into())
    };
    // Three parameters cannot be pairwise opposed.
    let opposed = spoil(&|block| {
        let rows = list(&mut block["covariance"]);
        let mut entry = |row: usize, column: usize| list(&mut rows[row])[column].as_float().unwrap();
        let std = [0, 1, 2].map(|c| entry(c, c).sqrt());
        for (row, column) in [(1, 0), (2, 0), (2, 1)] {
            list(&mut rows[row])[column] = (-0.9 * std[row] * std[column]).into();
        }
    });
    let cases = [
        (spoil(&|block| list(&mut block["residual-std"]).truncate(6)), "key `residual-std`: got 6 values, expected 7"),
        (spoil(&|block| list(&mut block["residual-std"])[2] = (-0.1).into()), "key `residual-std[2]`: got -0.1"),
        (spoil(&|block| block["residual-rate"] = 0.5.into()), "key `residual-rate`: got 0.5, expected a sampling rate"),
        (
            spoil(&|block| drop(block.remove("residual-rate"))),
            "key `residual-rate`: got no value, expected a value, as `residual-spectrum` has one",
        ),
        (
            spoil(&|block| list(&mut block["residual-spectrum"]).truncate(6)),
            "key `residual-spectrum`: got 6 rows, expected 7",
        ),
        (
            spoil(&|block| list(&mut list(&mut block["residual-spectrum"])[3]).truncate(2)),
            "key `residual-spectrum[3]`: got 2 values, expected 23",
        ),
        (
            spoil(&|block| list(&mut list(&mut block["residual-spectrum"])[0])[5] = (-1e-9).into()),
            "key `residual-spectrum[0][5]`: got -0.000000001, expected a power",
        ),
        (
            spoil(&|block| block["residual-freedom"] = 0.0.into()),
            "key `residual-freedom`: got 0, expected degrees of freedom, 1 or more",
        ),
        (spoil(&|block| list(&mut block["freedom"]).push(1.0.into())), "key `freedom`: got 72 values, expected 71"),
        (spoil(&|block| list(&mut block["freedom"])[3] = f64::NAN.into()), "key `freedom[3]`: got NaN"),
        (spoil(&|block| list(&mut block["covariance"]).truncate(70)), "key `covariance`: got 70 rows, expected 71"),
        (
            spoil(&|block| list(&mut list(&mut block["covariance"])[2]).truncate(2)),
            "key `covariance[2]`: got 2 values, expected 3, the parameters up to ly1",
        ),
        (entry(2, 0, f64::NAN), "key `covariance of ly1 and Lzz1`: got NaN, expected a finite number"),
        (entry(2, 2, -1e-9), "key `covariance of ly1 and ly1`: got -0.000000001, expected a variance"),
        (entry(2, 2, 0.5), "key `covariance of ly1 and ly1`: got 0.5, expected "),
        (entry(2, 1, 0.5), "key `covariance of ly1 and lx1`: got 0.5, expected at most "),
        (opposed, "expected a positive semi-definite matrix"),
        (spoil(&|block| drop(block.remove("freedom"))), "missing field `freedom`"),
        (spoil(&|block| drop(block.insert("mean".into(), 1.0.into()))), "mean"),
    ];
    for (message, expected) in cases {
        assert!(message.starts_with("model.toml: ") && message.contains("uncertainty"), "{message}");
        assert!(message.contains(expected), "`{message}` does not say `{expected}`");
    }
}

#[test]
fn an_edited_or_truncated_model_is_refused() {
    let text = made_up(BaseKind::Gbs).to_toml();
    let seal = text.lines().nth(1).unwrap().to_string();
    assert!(seal.starts_with("content = \"sha256:") && seal.len() == 19 + 64, "{seal}");
    parse(&text).unwrap();
    // A thousandth of one parameter; a comment; one more line.
    let line = text.lines().find(|line| line.contains("name = \"Lxx2\"")).unwrap();
    let value = line.split("value = ").nth(1).unwrap().split(',').next().unwrap();
    let worse = format!("value = {:?}", value.parse::<f64>().unwrap() * 1.001);
    let edits = [
        text.replacen(&format!("value = {value}"), &worse, 1),
        text.replacen("# Parameters", "# My parameters", 1),
        format!("{text}\n"),
    ];
    for edited in &edits {
        assert_ne!(*edited, text);
        let message = parse(edited).unwrap_err();
        assert!(
            message.starts_with("model.toml: key `content`: got \"sha256:") && message.contains("edited or truncated"),
            "{message}"
        );
        // Whoever means it takes the seal off.
        parse(&edited.replacen(&format!("{seal}\n"), "", 1)).unwrap();
    }
    // Cut anywhere, it is refused: by its seal where the rest is a whole model.
    for end in (0..text.len()).filter(|&end| text.is_char_boundary(end)).step_by(7) {
        let cut = &text[..end];
        if cut.contains(&seal) {
            assert!(parse(cut).is_err(), "cut after {end} bytes of {}", text.len());
        }
    }
    let provenance = text.find("[provenance]").unwrap();
    assert!(parse(&text[..provenance]).unwrap_err().contains("truncated"));
}

#[test]
fn an_identity_follows_the_text_and_is_never_zero() {
    let text = made_up(BaseKind::Gbs).to_toml();
    assert_eq!(model_identity(&text), model_identity(&text.clone()));
    assert_ne!(model_identity(&text), model_identity(&text.replacen("0.", "1.", 1)));
    assert_ne!(model_identity(""), 0);
}

fn plan() -> Plan {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let mut rows = || (0..3).map(|_| (0..5).map(|_| rng.random_range(-0.3..0.3)).collect()).collect::<Vec<Vec<f64>>>();
    Plan {
        robot: "panda".into(),
        rho: 1.1,
        phi: 0.1 + 0.2,
        period: 10.0,
        harmonics: 5,
        seed: 7,
        q0: vec![0.1, 0.2, 0.3],
        a: rows(),
        b: rows(),
        conditions: Conditions {
            raw: 130.5,
            equilibrated: 30.0,
            weighted: 140.0,
            raw_rigid: 120.0,
            equilibrated_rigid: 28.0,
            weighted_rigid: f64::INFINITY,
        },
        constraints: Constraints {
            q_min: vec![-1.0; 3],
            q_max: vec![1.0; 3],
            dq: vec![2.0; 3],
            ddq: vec![5.0; 3],
            jerk: vec![500.0; 3],
            tau: None,
            dtau: None,
            box_min: Some([-0.5; 3]),
            box_max: Some([0.5; 3]),
            base_radius: Some(0.2),
            links_in_box: true,
            margins: Margins::default(),
        },
        usage: Some(PlanUsage { range: vec![0.5, 0.1, 0.987], speed: vec![1.0, 0.0, 0.123] }),
        search: Some(PlanSearch {
            criterion: Criterion::Raw,
            evaluations: vec![1200, 4000, u64::from(u32::MAX)],
            best: vec![150.25, 130.5, 130.5],
        }),
    }
}

#[test]
fn a_plan_file_round_trips_bitwise() {
    let room = tempfile::tempdir().unwrap();
    let path = room.path().join("plan.toml");
    save_plan(&plan(), &path).unwrap();
    assert_eq!(load_plan(&path).unwrap(), plan());
}

#[test]
fn every_wrong_plan_is_refused() {
    let text = plan_text(&plan()).unwrap();
    let cases = [
        ("harmonics = 5", "harmonics = 4", "keys `q0`, `a`, `b`"),
        ("period = 10.0", "period = -1.0", "key `period`: got -1"),
        ("rho = 1.1", "rho = inf", "key `rho`: got inf, expected an angle in rad"),
        ("q0 = [0.1, ", "q0 = [", "keys `q0`, `a`, `b`"),
        ("q0 = [0.1, ", "q0 = [nan, ", "not a finite"),
        ("seed = 7", "sed = 7", "unknown field `sed`"),
        ("seed = 7", "seed = \"x\"", "key `seed`"),
    ];
    for (from, to, expected) in cases {
        assert!(text.contains(from), "no `{from}` in\n{text}");
        let message = parse_plan("plan.toml", &text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(
            message.starts_with("plan.toml: ") && message.contains(expected),
            "`{message}` does not say `{expected}`"
        );
    }
}
