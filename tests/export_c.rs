//! The C function computes what the model does, on any compiler that takes C99.

mod export_support;

use export_support::{ROBOTS, cases, model, robot};
use plumbline::store::export::c;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

fn cc(dir: &Path, arguments: &[&str]) -> std::process::Output {
    Command::new("cc").current_dir(dir).args(arguments).output().expect("a C compiler")
}

#[test]
fn the_c_function_computes_the_models_torque() {
    let room = tempfile::tempdir().unwrap();
    for (seed, name) in ROBOTS.iter().enumerate() {
        let model = model(&robot(name), &["friction", "torque-offset", "rotor-inertia"], 20 + seed as u64);
        let cases = cases(&model, 30);
        let exported = c::write(&model);
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
            &[
                "-std=c99",
                "-pedantic",
                "-Wall",
                "-Wextra",
                "-Werror",
                "-Wconversion",
                "-O2",
                "arm.c",
                "-o",
                "arm",
                "-lm",
            ],
        );
        assert!(built.status.success(), "{name}: {}", String::from_utf8_lossy(&built.stderr));
        let out = Command::new(room.path().join("arm")).output().unwrap();
        let text = String::from_utf8(out.stdout).unwrap();
        let theirs: Vec<f64> = text.split_whitespace().map(|word| word.parse().unwrap()).collect();
        let ours: Vec<f64> = cases.iter().flat_map(|case| case.tau.clone()).collect();
        assert_eq!(ours.len(), theirs.len());
        let size = ours.iter().fold(1.0, |size: f64, value| size.max(value.abs()));
        for (a, b) in ours.iter().zip(&theirs) {
            assert!((a - b).abs() < 1e-12 * size, "{name}: {a} {b}");
        }
    }
}

#[test]
fn names_are_names_in_c() {
    assert_eq!(c::function_name("kuka-lwr4p"), "kuka_lwr4p_torque");
    assert_eq!(c::function_name("7-axis Arm"), "arm_7_axis_arm_torque");
}
