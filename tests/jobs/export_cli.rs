//! `plumbline export` as people call it: what it writes, says and refuses.

use nalgebra::DVector;
use plumbline::store::export::{Arm, urdf};
use plumbline::store::{ModelFile, Provenance};
use plumbline_identify::consistency::Nearest;
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::{Body, Mounting, Reduction, Structure, TorqueModel};
use plumbline_testkit::arms::random_body;
use plumbline_testkit::bodies::{bodies, model, robot, with_effects};
use plumbline_testkit::job::{Done, plumbline};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::path::{Path, PathBuf};

const TABLE_3: &str = "config/models/panda-paper-table3.toml";

fn export(model: &Path, arguments: &[&str]) -> Done {
    Done::of(plumbline().arg("export").arg(model).args(arguments))
}

fn put(dir: &Path, name: &str, text: &str) -> PathBuf {
    std::fs::write(dir.join(name), text).unwrap();
    dir.join(name)
}

fn file(model: TorqueModel, consistent: Option<Nearest>) -> ModelFile {
    ModelFile {
        model,
        noise_floor: vec![],
        validation: vec![],
        uncertainty: None,
        consistent,
        provenance: Provenance::default(),
    }
}

#[test]
fn the_papers_table_in_every_format() {
    let room = tempfile::tempdir().unwrap();
    for (format, mark) in [("urdf", "</robot>"), ("mjcf", "</mujoco>"), ("c", "void panda_torque(")] {
        let out = room.path().join(format);
        let done = export(Path::new(TABLE_3), &["--format", format, "--out", out.to_str().unwrap()]).expect_code(0);
        let text = std::fs::read_to_string(&out).unwrap();
        assert!(text.contains(mark), "{text}");
        // What a format can't hold stands on the console and in the file.
        if format == "c" {
            assert!(text.contains(" - 0.0162*dq[1]"), "the C function has the friction as it is");
        } else {
            let note = "fv2 = -0.0162 is negative";
            assert!(done.out.contains(note) && text.contains(note), "{}", done.output());
            for part in ["physically consistent: no", "Lzz1 by +", "no standard deviations"] {
                assert!(done.out.contains(part), "{part}: {}", done.output());
            }
        }
    }
    assert_eq!(std::fs::read_dir(room.path()).unwrap().count(), 3);
}

#[test]
fn results_in_every_format_by_one_command() {
    let room = tempfile::tempdir().unwrap();
    let results = room.path().join("results");
    std::fs::create_dir(&results).unwrap();
    let shipped = std::fs::read_to_string(Path::new(plumbline_testkit::ROOT).join(TABLE_3)).unwrap();
    put(&results, "model.toml", &shipped);
    let out = room.path().join("exported");
    let done = export(&results, &["--out", out.to_str().unwrap()]).expect_code(0);
    for (name, mark) in [("panda.urdf", "</robot>"), ("panda.xml", "</mujoco>"), ("panda.c", "void panda_torque(")] {
        assert!(
            std::fs::read_to_string(out.join(name)).unwrap().contains(mark) && done.out.contains(name),
            "{}",
            done.output()
        );
    }
    let file = put(room.path(), "file", "");
    let done = export(&results, &["--out", file.to_str().unwrap()]).expect_code(2);
    assert!(done.err.contains("--format") && done.err.contains("folder"), "{}", done.err);
}

#[test]
fn a_model_file_with_bodies_exports_those() {
    let room = tempfile::tempdir().unwrap();
    let robot = robot("panda");
    let own = model(&robot, &["friction", "torque-offset"], 8);
    let found = bodies(&own);
    let path = put(room.path(), "model.toml", &file(own.clone(), Some(found.clone())).to_toml());
    let out = room.path().join("arm.urdf");
    let arguments = ["--format", "urdf", "--out", out.to_str().unwrap()];
    let done = export(&path, &arguments).expect_code(0);
    assert!(done.out.contains("physically consistent: yes"), "{}", done.output());
    assert!(done.out.contains("torque offsets are left out"), "{}", done.output());
    let text = std::fs::read_to_string(&out).unwrap();
    for link in &found.links {
        assert!(text.contains(&format!("<mass value=\"{:?}\"/>", Body::of(link).mass)), "{text}");
    }

    // The bodies of a URDF are taken where the torques leave the choice: the true ones come back whole.
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let truth: Vec<_> = (0..7).map(|_| random_body(&mut rng)).collect();
    let arm =
        Arm { model: &own, bodies: &Nearest { links: truth.clone(), ..found }, limits: &robot.limits, left_out: None };
    let prior = put(room.path(), "cad.urdf", &urdf::write(&arm).text);
    let mut with_prior = arguments.to_vec();
    with_prior.extend(["--prior", prior.to_str().unwrap()]);
    export(&path, &with_prior).expect_code(0);
    let text = std::fs::read_to_string(&out).unwrap();
    let masses: Vec<f64> =
        text.split("<mass value=\"").skip(1).map(|rest| rest.split('"').next().unwrap().parse().unwrap()).collect();
    for (mass, body) in masses.iter().zip(&truth) {
        assert!((mass - body[9]).abs() < 1e-6, "{masses:?}");
    }

    // Into that URDF: only the inertials change.
    let into = ["--format", "urdf", "--out", out.to_str().unwrap(), "--into", prior.to_str().unwrap()];
    export(&path, &into).expect_code(0);
    let spliced = std::fs::read_to_string(&out).unwrap();
    assert!(spliced.contains("<joint name=\"joint7\"") && spliced.contains("Inertials by plumbline"));
}

#[test]
fn a_vertical_model_states_its_mounting() {
    let room = tempfile::tempdir().unwrap();
    let chain = robot("panda").chain;
    let structure = Structure::of(chain.clone(), Reduction::in_mounting(&chain, &Mounting::UPRIGHT), &[]).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let delta = DVector::from_iterator(70, (0..7).flat_map(|_| random_body(&mut rng)));
    let values: Vec<_> = structure.reduction().base_of(&delta).iter().map(|value| (*value, None)).collect();
    let model = TorqueModel::new("panda", structure, vec![Mounting::UPRIGHT], &values).unwrap();
    let path = put(room.path(), "vertical.toml", &file(model, None).to_toml());
    for format in ["urdf", "mjcf", "c"] {
        let out = room.path().join("out");
        let arguments = ["--format", format, "--out", out.to_str().unwrap(), "--vertical"];
        let done = export(&path, &arguments[..4]).expect_code(2);
        assert!(done.err.contains("vertical.toml") && done.err.contains("lxR1") && done.err.contains("--vertical"));
        assert!(!out.exists());
        let done = export(&path, &arguments).expect_code(0);
        assert!(done.out.contains("VERTICAL ONLY"), "{}", done.output());
        assert!(std::fs::read_to_string(&out).unwrap().contains("VERTICAL ONLY"));
        std::fs::remove_file(&out).unwrap();
    }
}

#[test]
fn what_cannot_be_used_is_refused_by_name() {
    let room = tempfile::tempdir().unwrap();
    let out = room.path().join("out");
    let refused = |model: &Path, arguments: &[&str], parts: &[&str]| {
        let mut all = arguments.to_vec();
        all.extend(["--out", out.to_str().unwrap()]);
        let done = export(model, &all).expect_code(2);
        for part in parts {
            assert!(done.err.contains(part), "`{part}` is not in: {}", done.err);
        }
        assert!(!out.exists());
    };
    let table = Path::new(TABLE_3);
    let missing = room.path().join("missing.urdf");
    let missing = missing.to_str().unwrap();
    refused(table, &["--format", "sdf"], &["sdf", "urdf", "mjcf"]);
    refused(&room.path().join("no.toml"), &["--format", "c"], &["no.toml", "readable"]);
    refused(table, &["--format", "c", "--prior", missing], &["--prior", "--format c"]);
    refused(table, &["--format", "mjcf", "--into", missing], &["--into", "--format mjcf"]);
    refused(table, &["--format", "urdf", "--into", missing], &["missing.urdf", "readable"]);
    refused(table, &["--format", "urdf", "--prior", missing], &["missing.urdf", "readable"]);
    let broken = put(room.path(), "broken.urdf", "<robot name=\"x\">\n<link name=>");
    refused(table, &["--format", "urdf", "--prior", broken.to_str().unwrap()], &["broken.urdf", "line 2", "XML"]);
    let empty = put(room.path(), "empty.urdf", "<robot name=\"x\"><link name=\"a\"/></robot>");
    refused(table, &["--format", "urdf", "--into", empty.to_str().unwrap()], &["empty.urdf", "0 movable joints"]);

    // A prior with a body that can't be.
    let robot = robot("panda");
    let own = model(&robot, &[], 8);
    let found = bodies(&own);
    let good = urdf::write(&Arm { model: &own, bodies: &found, limits: &robot.limits, left_out: None }).text;
    let mass = format!("<mass value=\"{:?}\"/>", Body::of(&found.links[2]).mass);
    assert!(good.contains(&mass));
    let wrong = put(room.path(), "wrong.urdf", &good.replace(&mass, "<mass value=\"-1.0\"/>"));
    refused(table, &["--format", "urdf", "--prior", wrong.to_str().unwrap()], &["wrong.urdf", "link `link3`", "mass"]);
    let words = put(room.path(), "words.urdf", &good.replace(&mass, "<mass value=\"heavy\"/>"));
    refused(table, &["--format", "urdf", "--prior", words.to_str().unwrap()], &["words.urdf", "link3", "heavy"]);

    // Bodies in a model file that do not have its parameters, or can't be.
    let text = file(own.clone(), Some(found.clone())).to_toml();
    let parameter = format!("value = {:?}", own.beta()[3]);
    assert!(text.contains(&parameter));
    let edited = put(room.path(), "edited.toml", &text.replace(&parameter, "value = 0.123"));
    refused(&edited, &["--format", "urdf"], &["edited.toml", "[consistent]", "Lxx2", "0.123"]);
    let link = format!("{:?}", found.links[4]);
    let flat =
        put(room.path(), "flat.toml", &text.replace(&link, "[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]"));
    refused(&flat, &["--format", "urdf"], &["flat.toml", "links[4]", "body"]);
}

#[test]
fn bodies_in_a_model_file_round_trip_bitwise() {
    let chain = robot("panda").chain;
    let exact = model(&robot("panda"), &["friction"], 3);
    // The same arm with an inertia that nothing has.
    let mut values: Vec<_> = exact.parameters().iter().map(|own| (own.value, own.std)).collect();
    let lzz7 = exact.parameters().iter().position(|own| own.column.name == "Lzz7").unwrap();
    values[lzz7].0 = -0.01;
    let moved = TorqueModel::new("panda", exact.structure().clone(), vec![Mounting::WALL], &values).unwrap();
    for (model, reproduced) in [(exact, true), (moved, false)] {
        let found = bodies(&model);
        assert_eq!(found.exact, reproduced);
        let written = file(model, Some(found.clone())).to_toml();
        let read = ModelFile::parse("model.toml", &written, |_| Ok(chain.clone())).unwrap();
        assert_eq!(read.consistent.as_ref(), Some(&Nearest { iterations: 0, ..found }));
        assert_eq!(read.to_toml(), written);
    }
}

#[test]
fn effects_without_a_place_are_named_and_a_payload_is_part_of_the_last_link() {
    let room = tempfile::tempdir().unwrap();
    let plain = model(&robot("panda"), &["friction"], 12);
    let spec = |family, site, settings| Spec { family, form: "", site, settings };
    let load = random_body(&mut ChaCha8Rng::seed_from_u64(13));
    let specs = [
        spec("payload", Site::Arm, vec![]),
        spec("asymmetric-viscous", Site::Joint(1), vec![]),
        spec("presliding", Site::Joint(4), vec![0.004]),
    ];
    let full = with_effects(&plain, &specs, |index, c| if index == 0 { load[c] } else { 0.4 });
    let path = put(room.path(), "effects.toml", &file(full.clone(), None).to_toml());
    let out = room.path().join("out");
    for (format, lost, held, friction) in [
        ("c", vec![], "asymmetric-viscous", "tanh(100.0*dq[4])"),
        ("urdf", vec!["asymmetric-viscous"], "payload", "friction=\"FC\""),
        ("mjcf", vec!["asymmetric-viscous"], "payload", "frictionloss=\"FC\""),
    ] {
        let done = export(&path, &["--format", format, "--out", out.to_str().unwrap()]).expect_code(0);
        let text = std::fs::read_to_string(&out).unwrap();
        let mut notes: Vec<String> = lost.iter().map(|id| format!("effect `{id}` is left out")).collect();
        notes.push("effect `presliding` is held as the Coulomb friction that it is in sliding".into());
        for note in notes {
            assert!(done.out.contains(&note) && text.contains(&note), "{note}: {}", done.output());
        }
        assert!(!done.out.contains(&format!("`{held}`")), "{}", done.output());
        // Coulomb friction and presliding of joint 5 together.
        let fc = plain.parameters().iter().find(|own| own.column.name == "fc5").unwrap().value;
        assert!(text.contains(&friction.replace("FC", &format!("{:?}", fc + 0.4))), "{fc}: {text}");
        std::fs::remove_file(&out).unwrap();
    }

    // The last link is heavier by the load, and no other.
    let mass = |model: TorqueModel| {
        let path = put(room.path(), "one.toml", &file(model, None).to_toml());
        export(&path, &["--format", "urdf", "--out", out.to_str().unwrap()]).expect_code(0);
        let text = std::fs::read_to_string(&out).unwrap();
        let value = |part: &str| part.split('"').next().unwrap().parse().unwrap();
        text.split("<mass value=\"").skip(1).map(value).collect::<Vec<f64>>()
    };
    let loaded = with_effects(&plain, &specs[..1], |_, c| load[c]);
    let (before, after) = (mass(plain.clone()), mass(loaded));
    assert_eq!(before.len(), 7);
    for (j, (before, after)) in before.iter().zip(&after).enumerate() {
        let more = if j == 6 { load[9] } else { 0.0 };
        assert!((after - before - more).abs() < 1e-9, "link {}: {before} {after}", j + 1);
    }
    // A load that takes more than there is.
    let hollow = with_effects(&plain, &specs[..1], |_, c| -1e3 * load[c]);
    let path = put(room.path(), "hollow.toml", &file(hollow, None).to_toml());
    std::fs::remove_file(&out).unwrap();
    let done = export(&path, &["--format", "mjcf", "--out", out.to_str().unwrap()]).expect_code(0);
    let (note, text) = ("the payload is left out", std::fs::read_to_string(&out).unwrap());
    assert!(done.out.contains(note) && text.contains(note), "{}", done.output());
}
