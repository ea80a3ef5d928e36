//! The C interface, compiled by the machine's C and C++ compilers: SKIPPED loudly where there is none.

use plumbline_client::Model;
use plumbline_core::Validity;
use plumbline_ipc::{FeedForwardMessage, GuestDelivery, GuestReceiver, ModelClient, ModelHeader, ServerSettings};
use plumbline_model::{Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_model_file::{ModelFile, Provenance, model_identity};
use plumbline_testkit::arms::{chain, draw};
use plumbline_testkit::memory::*;
use plumbline_testkit::other_layout::{Other, OtherDaemon};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::LazyLock;

const WALL: [f64; 3] = [9.81, 0.0, 0.0];
const HERE: &str = env!("CARGO_MANIFEST_DIR");
const WARNINGS: [&str; 5] = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"];

/// The program `cbindgen` is no dependency: its licence (MPL-2.0) is not a permissive one.
#[test]
fn the_header_is_what_cbindgen_makes() {
    let here = Path::new(HERE);
    let made = Command::new("cbindgen")
        .arg("--config")
        .arg(here.join("cbindgen.toml"))
        .arg("--crate")
        .arg("plumbline-client-c")
        .arg(here)
        .output();
    let made = match made {
        Ok(made) => made,
        Err(error) => return eprintln!("SKIPPED: cbindgen (cargo install --locked cbindgen): {error}"),
    };
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    // Escapes of the documentation's brackets are none in C.
    let made = String::from_utf8(made.stdout).unwrap().replace("\\[", "[").replace("\\]", "]");
    let path = here.join("include/plumbline.h");
    if std::env::var_os("PLUMBLINE_WRITE_DOCS").is_some() {
        std::fs::write(&path, &made).unwrap();
    }
    assert_eq!(std::fs::read_to_string(&path).unwrap(), made, "PLUMBLINE_WRITE_DOCS=1 writes it anew");
}

/// Without cbindgen: every function and code of the source is in the header, and no other.
#[test]
fn the_header_has_every_function_and_code() {
    let names = |text: &str, sign: &str| {
        let words = text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_').filter(|word| word.starts_with(sign));
        words.map(str::to_string).collect::<std::collections::BTreeSet<_>>()
    };
    let read = |file: &str| std::fs::read_to_string(Path::new(HERE).join(file)).unwrap();
    let code = |text: String| {
        let lines = text.lines().filter(|line| !line.trim_start().starts_with("//"));
        lines.map(|line| format!("{line}\n")).collect::<String>()
    };
    let files = std::fs::read_dir(Path::new(HERE).join("src")).unwrap();
    let source = code(files.map(|file| std::fs::read_to_string(file.unwrap().path()).unwrap()).collect());
    let header = code(read("include/plumbline.h"));
    let mut known = names(&source, "plumbline_");
    // The crate that it wraps.
    known.remove("plumbline_client");
    assert_eq!(names(&header, "plumbline_"), known);
    let mut codes = names(&header, "PLUMBLINE_");
    codes.remove("PLUMBLINE_H");
    assert_eq!(codes, names(&source, "PLUMBLINE_"));
}

/// Folder of the library: that of this test, or the one above.
fn library() -> PathBuf {
    let own = std::env::current_exe().unwrap();
    let folders = own.ancestors().skip(1).take(2).find(|folder| folder.join("libplumbline_c.so").exists());
    folders.expect("libplumbline_c.so is built with this test").to_path_buf()
}

/// The installed library; the folder is a temporary one.
static INSTALLED: LazyLock<tempfile::TempDir> = LazyLock::new(|| {
    let folder = tempfile::tempdir().unwrap();
    let script = Path::new(HERE).join("install.sh");
    succeed(Command::new(script).arg("--library").arg(library()).arg(folder.path()));
    folder
});

/// What a command prints; it succeeds.
#[track_caller]
fn succeed(command: &mut Command) -> String {
    let done = command.output().unwrap();
    assert!(done.status.success(), "{command:?}: {}", String::from_utf8_lossy(&done.stderr));
    String::from_utf8(done.stdout).unwrap()
}

/// Whether a program can be run; says SKIPPED where it can't.
fn found(program: &str) -> bool {
    let found = Command::new(program).arg("--version").output();
    if let Err(error) = &found {
        eprintln!("SKIPPED: {program}: {error}");
    }
    found.is_ok()
}

/// Compiles a program; `None` where the compiler is missing.
fn compile(compiler: &str, standard: &str, source: &Path, more: &[&str], out: PathBuf) -> Option<PathBuf> {
    if !found(compiler) {
        return None;
    }
    let (include, library) = (INSTALLED.path().join("include"), INSTALLED.path().join("lib"));
    let mut command = Command::new(compiler);
    command.arg(format!("-std={standard}")).args(WARNINGS).args(more).arg("-I").arg(include);
    command.arg(source).arg("-L").arg(&library).arg(format!("-Wl,-rpath,{}", library.display()));
    succeed(command.args(["-lplumbline", "-lm", "-o"]).arg(&out));
    Some(out)
}

fn c(source: &Path, out: PathBuf) -> Option<PathBuf> {
    compile("gcc", "c99", source, &[], out)
}

fn cpp(source: &Path, more: &[&str], out: PathBuf) -> Option<PathBuf> {
    compile("g++", "c++17", source, more, out)
}

/// Text of a random model of `robot`.
fn text(robot: &str) -> String {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let chain = chain(robot);
    let terms = ["friction", "torque-offset", "rotor-inertia"];
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &terms).unwrap();
    let values: Vec<_> =
        draw(&mut rng, structure.columns().len(), 1.0).into_iter().map(|value| (value, None)).collect();
    let model = TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap();
    let (noise_floor, validation, provenance) = (Vec::new(), Vec::new(), Provenance::default());
    ModelFile { model, noise_floor, validation, uncertainty: None, consistent: None, provenance }.to_toml()
}

/// What a program prints.
fn run(program: &Path, arguments: &[&str], input: &[u8]) -> Vec<u8> {
    let mut command = Command::new(program);
    let mut child =
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    let done = std::thread::scope(|scope| {
        scope.spawn(move || stdin.write_all(input).unwrap());
        child.wait_with_output().unwrap()
    });
    let errors = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success(), "{} {arguments:?}: {}\n{errors}", program.display(), done.status);
    done.stdout
}

fn numbers(printed: &[u8]) -> Vec<f64> {
    String::from_utf8_lossy(printed).lines().map(|line| line.parse().unwrap()).collect()
}

#[test]
fn c_and_cpp_agree_with_rust_to_the_last_bit_on_every_shipped_arm() {
    let folder = tempfile::tempdir().unwrap();
    let sources = Path::new(HERE).join("tests/c");
    let of_c = c(&sources.join("agree.c"), folder.path().join("agree-c"));
    for robot in Robot::names() {
        let path = folder.path().join(format!("{robot}.toml"));
        std::fs::write(&path, text(robot)).unwrap();
        let file = path.to_str().unwrap();
        let mut model = Model::load(&path, WALL).unwrap();
        let n = model.joints().unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (mut states, mut expected) = (Vec::new(), Vec::new());
        let mut tau = vec![0.0; n];
        for _ in 0..10_000 {
            let [q, dq, ddq] = [3.0, 2.0, 5.0].map(|span| draw(&mut rng, n, span));
            model.torque(&q, &dq, &ddq, None, &mut tau).unwrap();
            states.extend([q, dq, ddq].concat().into_iter().flat_map(f64::to_ne_bytes));
            expected.extend(tau.iter().copied().flat_map(f64::to_ne_bytes));
        }
        if let Some(program) = &of_c {
            assert!(run(program, &[file, &n.to_string()], &states) == expected, "C, {robot}");
        }
        let joints = format!("-DJOINTS={n}");
        if let Some(program) = cpp(&sources.join("agree.cpp"), &[&joints], folder.path().join(format!("cpp-{robot}"))) {
            assert!(run(&program, &[file], &states) == expected, "C++, {robot}");
        }
    }
}

#[test]
fn the_examples_run_and_print_the_models_torque() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.toml");
    let text = text("panda");
    std::fs::write(&path, &text).unwrap();
    let file = path.to_str().unwrap();
    let example = |name: &str| plumbline_testkit::path(format!("examples/clients/{name}"));
    let zero = [0.0; 7];
    let torque = |gravity, q: f64, dq: f64, ddq: f64| {
        let mut tau = [0.0; 7];
        Model::load(&path, gravity).unwrap().torque(&[q; 7], &[dq; 7], &[ddq; 7], None, &mut tau).unwrap();
        tau
    };
    let upright = [0.0, 0.0, -9.81];
    if let Some(program) = c(&example("c/torque_loop.c"), folder.path().join("loop")) {
        let (w, t) = (2.0, 1e-3 * 999.0);
        let (sin, cos) = (f64::sin(w * t), f64::cos(w * t));
        let expected = torque(upright, 0.1 * sin, 0.1 * w * cos, -0.1 * w * w * sin);
        let printed = numbers(&run(&program, &[file], &[]));
        assert!(printed.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{printed:?} {expected:?}");
    }
    if let Some(program) = cpp(&example("cpp/callback.cpp"), &[], folder.path().join("callback")) {
        let mut q = 0.0;
        while q < 0.1 {
            q += 0.001;
        }
        let mut vendor = [0.0; 7];
        Model::load(&path, upright).unwrap().gravity(&[q; 7], &mut vendor).unwrap();
        let expected: Vec<f64> =
            torque(WALL, q, 0.0, 0.0).iter().zip(vendor).map(|(tau, vendor)| tau - vendor).collect();
        let printed = numbers(&run(&program, &[file], &[]));
        assert!(printed.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-12), "{printed:?} {expected:?}");
    }
    if let Some(program) = cpp(&example("cpp/update.cpp"), &[], folder.path().join("update")) {
        let robot = robot("update");
        let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
            let (model, validity) = (model_identity(&text), Validity::Valid as u32);
            server.model(ModelHeader { model, validity, gravity: WALL, ..ModelHeader::default() }, &text);
            poll_until(server, stop);
        });
        let mut receiver = GuestReceiver::open(&robot).unwrap();
        // The program starts after the model was published.
        let mut client = ModelClient::connect(&robot, TIMEOUT).unwrap();
        wait_for("the model", || client.receive().unwrap().is_some_and(|message| message.header.model != 0));
        let mut samples = Vec::new();
        let printed = std::thread::scope(|scope| {
            let running = scope.spawn(|| numbers(&run(&program, &[robot.as_str()], &[])));
            wait_for("every state", || {
                for delivery in receiver.receive().unwrap() {
                    if let GuestDelivery::Samples(some) = delivery {
                        samples.extend(some);
                    }
                }
                samples.len() == 100 || running.is_finished()
            });
            running.join().unwrap()
        });
        assert_eq!(printed, torque(WALL, 0.001 * 99.0, 0.0, 0.0));
        assert_eq!((samples.len(), receiver.lost()), (100, 0));
        assert_eq!(samples[99].q[..7], [0.001 * 99.0; 7]);
        assert_eq!(samples[0].tau[..7], zero);
        daemon.stop();
    }
}

/// Text of a file of packaging.
fn packaging(file: &str) -> String {
    std::fs::read_to_string(Path::new(HERE).join("packaging").join(file)).unwrap()
}

#[test]
fn an_example_is_built_against_the_installed_library_with_pkg_config_and_with_cmake() {
    assert!(packaging("plumbline.pc").contains(concat!("Version: ", env!("CARGO_PKG_VERSION"), "\n")));
    let version = concat!("set(PACKAGE_VERSION \"", env!("CARGO_PKG_VERSION"), "\")");
    assert!(packaging("plumblineConfigVersion.cmake").contains(version));
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.toml");
    std::fs::write(&model, text("panda")).unwrap();
    let (prefix, source) = (INSTALLED.path(), plumbline_testkit::path("examples/clients/c/torque_loop.c"));
    let prints = |program: &Path| numbers(&run(program, &[model.to_str().unwrap()], &[]));
    let mut printed = Vec::new();
    if found("pkg-config") && found("gcc") {
        for (name, kind) in [("shared", &[][..]), ("static", &["--static"][..])] {
            let mut flags = Command::new("pkg-config");
            flags.env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig")).args(kind);
            let mut flags = succeed(flags.args(["--cflags", "--libs", "plumbline"]));
            if name == "static" {
                flags = flags.replace("-lplumbline", "-l:libplumbline.a");
            }
            let program = folder.path().join(name);
            let mut gcc = Command::new("gcc");
            succeed(gcc.arg(&source).args(flags.split_whitespace()).args(["-lm", "-o"]).arg(&program));
            let mut needed = Command::new("readelf");
            let needed = succeed(needed.arg("-d").arg(&program));
            assert_eq!(needed.contains("[libplumbline.so.0]"), name == "shared", "{needed}");
            if name == "shared" {
                // The loader's folder, as for an installed program.
                let mut command = Command::new(&program);
                let done = succeed(command.arg(&model).env("LD_LIBRARY_PATH", prefix.join("lib")));
                printed.push(numbers(done.as_bytes()));
            } else {
                printed.push(prints(&program));
            }
        }
    }
    if found("cmake") && found("gcc") {
        let lists = format!(
            "cmake_minimum_required(VERSION 3.13)\nproject(test C)\nfind_package(plumbline 0.1 REQUIRED)\n\
             add_executable(shared {0})\ntarget_link_libraries(shared plumbline::plumbline m)\n\
             add_executable(static {0})\ntarget_link_libraries(static plumbline::static)\n",
            source.display()
        );
        std::fs::write(folder.path().join("CMakeLists.txt"), lists).unwrap();
        let build = folder.path().join("build");
        let mut cmake = Command::new("cmake");
        let prefix = format!("-DCMAKE_PREFIX_PATH={}", prefix.display());
        succeed(cmake.arg("-S").arg(folder.path()).arg("-B").arg(&build).arg(prefix));
        succeed(Command::new("cmake").arg("--build").arg(&build));
        printed.extend(["shared", "static"].map(|name| prints(&build.join(name))));
    }
    let different = printed.iter().find(|other| **other != printed[0]);
    assert!(different.is_none() && printed.first().is_none_or(|first| first.len() == 7), "{printed:?}");
}

#[test]
fn the_torque_of_the_daemons_motion_is_followed_in_c_and_cpp() {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot("feed-forward");
    let daemon = Daemon::start(&robot, ServerSettings::default(), move |server, stop| {
        let mut cycle = 0;
        while !stop.load(std::sync::atomic::Ordering::Relaxed) {
            let mut record = record(cycle);
            (record.model, record.command.tau_vendor.0) = (0x5c1f, [0.5; 8]);
            server.feed_forward(FeedForwardMessage::new(&record, 7, WALL, [0.0, 0.0, -9.81]));
            server.poll(|_, _| unreachable!("nobody sends commands"));
            cycle = (cycle + 1).min(300);
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    });
    let source = Path::new(HERE).join("tests/c/feed_forward.cpp");
    if let Some(program) = cpp(&source, &[], folder.path().join("feed-forward")) {
        let printed = numbers(&run(&program, &[robot.as_str(), "350"], &[]));
        let record = record(300);
        let (q_d, tau) = (record.command.desired.q[6], record.command.tau_ff.0[6]);
        let expected = [f64::from(0x5c1f), 7.0, 1.0, 2.0, 1.0, 1.0, q_d, tau, 0.5, 9.81, -9.81, 1.0];
        assert!(printed[0] >= 350.0);
        assert_eq!(printed[1..], expected);
    }
    let source = plumbline_testkit::path("examples/clients/c/torque_follow.c");
    if let Some(program) = compile("gcc", "gnu99", &source, &[], folder.path().join("follow")) {
        let printed = String::from_utf8(run(&program, &[robot.as_str(), "20"], &[])).unwrap();
        let sequences: Vec<u64> =
            printed.lines().map(|line| line.split_whitespace().nth(1).unwrap().parse().unwrap()).collect();
        assert!(sequences.len() == 20 && sequences.is_sorted_by(|a, b| a < b), "{printed}");
        assert!(printed.lines().all(|line| line.contains("model 0000000000005c1f  tau")), "{printed}");
    }
    daemon.stop();
}

#[test]
fn messages_of_another_layout_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = c(&Path::new(HERE).join("tests/c/layout.c"), folder.path().join("layout")) else { return };
    let prints = |other| {
        let robot = robot(&format!("layout-{other:?}").to_lowercase());
        let _daemon = OtherDaemon::start(&robot, other);
        String::from_utf8(run(&program, &[robot.as_str()], &[])).unwrap()
    };
    let types = prints(Other::Types);
    for what in ["follow", "feed-forward", "guest"] {
        let line =
            types.lines().find(|line| line.starts_with(&format!("{what} 22 "))).unwrap_or_else(|| panic!("{types}"));
        assert!(line.contains("exists with other types or sizes than this version of plumbline uses"), "{line}");
    }
    let number = prints(Other::Number);
    assert!(number.contains("trouble 22 ") && number.contains("its layout is 2, this version reads 1"), "{number}");
}
