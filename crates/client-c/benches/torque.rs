//! One torque through the C interface against the Rust call, in turns on one core.
//!
//!     cargo bench -p plumbline-client-c
//!
//! Each figure is the least of many passes over 1,000 random states of a Panda. docs/results/speed.md quotes the ratio.

use plumbline_client::Model;
use plumbline_testkit::arms::draw;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

const N: usize = 7;
const STATES: usize = 1000;
const REPEATS: usize = 200;
const ROUNDS: usize = 15;

fn main() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    let model = plumbline_testkit::path("config/models/panda-paper-table3.toml");
    let own = std::env::current_exe().unwrap();
    let built = own.ancestors().find(|path| path.join("libplumbline_c.so").exists()).expect("the library is built");
    let install = Command::new(here.join("install.sh")).arg("--library").arg(built).arg(file("")).status();
    assert!(install.unwrap().success());
    let library = file("lib");
    let mut gcc = Command::new("gcc");
    gcc.args(["-O2", "-o"]).arg(file("torque")).arg(here.join("benches/torque.c")).arg("-I").arg(file("include"));
    gcc.arg("-L").arg(&library).arg("-lplumbline").arg(format!("-Wl,-rpath,{}", library.display()));
    match gcc.status() {
        Ok(done) => assert!(done.success()),
        Err(error) => return eprintln!("SKIPPED: gcc: {error}"),
    }

    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let states: Vec<[Vec<f64>; 3]> = (0..STATES).map(|_| [2.5, 2.0, 5.0].map(|span| draw(&mut rng, N, span))).collect();
    let bytes: Vec<u8> = states.iter().flatten().flatten().copied().flat_map(f64::to_ne_bytes).collect();
    std::fs::write(file("states"), bytes).unwrap();
    let mut evaluated = Model::load(&model, [9.81, 0.0, 0.0]).unwrap();
    let mut rust = || {
        let pass = |model: &mut Model| {
            let (start, mut tau) = (Instant::now(), [0.0; N]);
            for [q, dq, ddq] in &states {
                model.torque(black_box(q), dq, ddq, None, &mut tau).unwrap();
                black_box(&tau);
            }
            start.elapsed().as_nanos() as f64 / STATES as f64
        };
        (0..REPEATS).map(|_| pass(&mut evaluated)).fold(f64::INFINITY, f64::min)
    };
    let c = || {
        let mut program = Command::new(file("torque"));
        let done = program.arg(&model).arg(file("states")).arg(REPEATS.to_string()).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let printed = String::from_utf8(done.stdout).unwrap();
        printed.split_whitespace().next().unwrap().parse::<f64>().unwrap()
    };
    let rounds: Vec<(f64, f64)> = (0..ROUNDS).map(|_| (rust(), c())).collect();
    let least = |of: fn(&(f64, f64)) -> f64| rounds.iter().map(of).fold(f64::INFINITY, f64::min);
    let (rust, c) = (least(|round| round.0), least(|round| round.1));
    println!("one torque of a Panda: Rust {rust:.1} ns, C {c:.1} ns, ratio {:.3}", c / rust);
}
