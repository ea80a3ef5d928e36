//! The C function computes what the model does, on any compiler that takes C99.

use plumbline::store::export::c;
use plumbline_model::TorqueModel;
use plumbline_model::term::effect::{FAMILIES, Setting, Spec, Stratum};
use plumbline_testkit::bodies::{Case, ROBOTS, cases, model, robot, with_effects};
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

fn cc(dir: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new("cc").current_dir(dir).args(arguments).output().expect("a C compiler")
}

/// Compiles the C function of a model and compares its torques with the model's in 30 states.
fn computes_the_same(what: &str, model: &TorqueModel) {
    let room = tempfile::tempdir().unwrap();
    let cases = cases(model, 30);
    let exported = c::write(model);
    assert!(exported.notes.is_empty(), "{:?}", exported.notes);
    let function = c::function_name(model.robot());
    let n = cases[0].q.len();
    let list = |values: &[f64]| values.iter().map(|value| format!("{value:?}")).collect::<Vec<_>>().join(", ");
    let mut main = exported.text;
    write!(main, "#include <stdio.h>\nint main(void)\n{{\n    double tau[{n}];\n").unwrap();
    for case in &cases {
        let lists = [&case.q[..], &case.dq, &case.ddq, &case.gravity].map(|values| format!("{{{}}}", list(values)));
        let [q, dq, ddq, gravity] = lists;
        write!(
            main,
            "    {{ const double q[{n}] = {q}, dq[{n}] = {dq}, ddq[{n}] = {ddq}, g[3] = {gravity};\n      {function}(q, dq, ddq, g, \
             tau);\n      for (int j = 0; j < {n}; ++j) printf(\"%.17g \", tau[j]); }}\n"
        )
        .unwrap();
    }
    main += "    return 0;\n}\n";
    std::fs::write(room.path().join("arm.c"), main).unwrap();
    let built = cc(
        room.path(),
        &["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-O2", "arm.c", "-o", "arm", "-lm"],
    );
    assert!(built.status.success(), "{what}: {}", String::from_utf8_lossy(&built.stderr));
    let out = Command::new(room.path().join("arm")).output().unwrap();
    let text = String::from_utf8(out.stdout).unwrap();
    let theirs: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
    let ours: Vec<f64> = cases.iter().flat_map(|case| case.tau.clone()).collect();
    assert_eq!(ours.len(), theirs.len());
    let size = ours.iter().fold(1.0, |size: f64, value| size.max(value.abs()));
    for (a, b) in ours.iter().zip(&theirs) {
        assert!((a - b).abs() < 1e-12 * size, "{what}: {a} {b}");
    }
}

#[test]
fn the_c_function_computes_the_models_torque() {
    for (seed, name) in ROBOTS.iter().enumerate() {
        let model = model(&robot(name), &["friction", "torque-offset", "rotor-inertia"], 20 + seed as u64);
        computes_the_same(name, &model);
    }
}

/// Every form of every effect that the C function has a place for, in one model, and each for itself.
#[test]
fn the_c_function_has_the_effects_of_one_sample() {
    for (seed, name) in ["panda", "stanford"].into_iter().enumerate() {
        let robot = robot(name);
        let plain = model(&robot, &["friction"], 40 + seed as u64);
        let mut held = Vec::new();
        let mut unheld = Vec::new();
        for (index, family) in FAMILIES.iter().enumerate() {
            for form in family.forms {
                let sites = family.sites(form, robot.chain.len());
                let site = sites[(7 * index + form.name.len()) % sites.len()];
                // The states lie in the domain of a learned term, beside it and far from it.
                let within = |setting: &Setting| if setting.name.starts_with("middle") { 0.1 } else { 1.2 };
                let learned = family.stratum == Stratum::Remainder;
                let value = |setting: &Setting| if learned { within(setting) } else { setting.at(0.4) };
                let settings = form.settings.iter().map(value).collect();
                let spec = Spec { family: family.id, form: form.name, site, settings };
                let one = with_effects(&plain, std::slice::from_ref(&spec), |_, c| 0.3 - 0.2 * c as f64);
                if one.terms().last().unwrap().0.spec().is_none() {
                    // Offsets and rotors are the other test's.
                    continue;
                }
                let exported = c::write(&one);
                if exported.notes.is_empty() {
                    if learned {
                        let differs = |(one, plain): (&Case, &Case)| one.tau != plain.tau;
                        let count =
                            cases(&one, 30).iter().zip(&cases(&plain, 30)).filter(|pair| differs(*pair)).count();
                        assert!((2..30).contains(&count), "{spec:?}: in its domain in {count} of 30 states");
                    }
                    held.push(spec);
                } else {
                    let note = format!("effect `{}` is ", family.id);
                    assert!(exported.notes.iter().any(|found| found.contains(&note)), "{:?}", exported.notes);
                    assert!(exported.text.contains(&note));
                    unheld.push(family.id);
                }
            }
        }
        unheld.dedup();
        let expected = "friction-drift offset-drift presliding joint-elasticity mounting base-motion delay contact encoder-offset \
                        encoder-eccentricity backlash";
        assert_eq!(unheld, expected.split_whitespace().collect::<Vec<_>>());
        // Stiff in no direction: parameters of both signs.
        let all = with_effects(&plain, &held, |index, c| (1.7 * index as f64 + 0.9 * c as f64).sin());
        computes_the_same(name, &all);
    }
}

#[test]
fn robot_names_become_valid_c_identifiers() {
    assert_eq!(c::function_name("kuka-lwr4p"), "kuka_lwr4p_torque");
    assert_eq!(c::function_name("7-axis Arm"), "arm_7_axis_arm_torque");
}
