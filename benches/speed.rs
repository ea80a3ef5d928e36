//! Torque, regressor, stack and solve, and streaming against their peers, in one run on one core.
//!
//!     cargo bench --bench speed
//!
//! Figures of one call are the least of several repeats; figures of 10,000 samples and of an hour are CPU time, for ours and the peers
//! alike, because it depends least on other work of the machine. The peers are built
//! by `benches/peers/run.sh`; what can't be had is SKIPPED loudly. docs/results/speed.md says what the figures mean.

use nalgebra::{DMatrix, DVector, Vector3};
use plumbline::store::ModelFile;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_identify::streaming::gram::Gram;
use plumbline_identify::streaming::solve::solve;
use plumbline_identify::streaming::{Settings, Streaming};
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{
    Evaluator, Mounting, Reduction, Robot, SampleRegressor, Structure, TorqueModel, regressor, rnea,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

const SAMPLES: usize = 64;
const N: usize = 7;
const ROWS: usize = 10_000;

/// Least time per call \[ns\].
fn least(repeats: usize, calls: usize, mut call: impl FnMut(usize)) -> f64 {
    let one = |call: &mut dyn FnMut(usize)| {
        let start = Instant::now();
        (0..calls).for_each(&mut *call);
        start.elapsed().as_nanos() as f64 / calls as f64
    };
    (0..repeats).map(|_| one(&mut call)).fold(f64::INFINITY, f64::min)
}

fn samples(rng: &mut ChaCha8Rng, count: usize) -> Vec<Sample> {
    let mut vector = |span: f64| {
        let mut padded = JointVec::default();
        padded[..N].iter_mut().for_each(|value| *value = rng.random_range(-span..span));
        padded
    };
    (0..count).map(|_| Sample { q: vector(2.5), dq: vector(2.0), ddq: vector(5.0) }).collect()
}

/// Figures of the peers by what they are of; empty where there are none.
fn peers() -> BTreeMap<String, Vec<(String, f64)>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found: BTreeMap<String, Vec<(String, f64)>> = BTreeMap::new();
    // An environment of its own: its Pinocchio is another one than the tests'.
    let made = Command::new(root.join("hil/peers/venv.sh"))
        .args(["--in", "bench", "casadi", "pin==3.*", "cmeel-eigen", "mujoco"])
        .output();
    let python = match made {
        Ok(made) if made.status.success() => String::from_utf8_lossy(&made.stdout).trim().to_string(),
        Ok(made) => {
            eprintln!("SKIPPED all peers: {}", String::from_utf8_lossy(&made.stderr).trim());
            return found;
        }
        Err(error) => {
            eprintln!("SKIPPED all peers: {error}");
            return found;
        }
    };
    let run = Command::new(root.join("benches/peers/run.sh")).arg(python).arg(root.join("target/peers/bench")).output();
    let Ok(run) = run else {
        eprintln!("SKIPPED all peers: benches/peers/run.sh does not run");
        return found;
    };
    eprint!("{}", String::from_utf8_lossy(&run.stderr));
    for line in String::from_utf8_lossy(&run.stdout).lines() {
        if let [what, who, time] = line.split('\t').collect::<Vec<_>>()[..]
            && let Ok(time) = time.parse()
        {
            found.entry(what.into()).or_default().push((who.into(), time));
        }
    }
    found
}

struct Table(BTreeMap<String, Vec<(String, f64)>>);

impl Table {
    /// One figure \[ns\], with the peers' figures of the same thing.
    fn row(&self, what: &str, ns: f64, peers: &str) {
        let unit = |ns: f64| if ns < 1e5 { format!("{ns:.0} ns") } else { format!("{:.2} ms", ns * 1e-6) };
        println!("{what:<58} {:>10}", unit(ns));
        for (who, time) in self.0.get(peers).into_iter().flatten() {
            println!("    {who:<54} {:>10}   {:.2} x ours", unit(*time), time / ns);
        }
    }
}

fn main() {
    // `cargo bench` and `cargo test --benches` pass flags of the standard harness; under the latter there is nothing to do.
    if std::env::args().any(|arg| arg == "--test") {
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let gravity = Mounting::WALL.gravity();
    let chain_of = |name: &str| Robot::load(name, None).map(|robot| robot.chain);
    let model = ModelFile::load(&root.join("config/models/panda-paper-table3.toml"), chain_of).expect("shipped").model;
    if std::env::args().any(|arg| arg == "--stream") {
        // Alone, for its memory.
        return stream(&model, &gravity);
    }
    let table = Table(peers());
    let panda = model.structure().chain().clone();
    let reduction = Reduction::any_mounting(&panda);
    let rigid = Structure::of(panda.clone(), reduction, &[]).expect("known terms");
    let base = rigid.columns().len();

    println!(
        "Panda, 7 joints, parameters of the paper's Table III loaded at run time; one call: least of the repeats; longer work: CPU time"
    );
    let points = samples(&mut rng, SAMPLES);
    let values: Vec<_> = model.beta()[..base].iter().map(|&value| (value, None)).collect();
    let mut bare =
        TorqueModel::new("panda", rigid.clone(), Vec::new(), &values).expect("its columns").evaluator(&gravity);
    let mut whole = model.evaluator(&gravity);
    let torque = |evaluator: &mut Evaluator| {
        least(300, 2000, |k| {
            black_box(evaluator.torque(black_box(&points[k % SAMPLES])));
        })
    };
    table.row("torque, rigid body", torque(&mut bare), "torque-rigid");
    table.row("torque, whole model (with friction)", torque(&mut whole), "torque-whole");
    let links = vec![[0.1; 10]; N];
    let plain = least(50, 500, |k| {
        let (s, mut tau) = (black_box(&points[k % SAMPLES]), JointVec::default());
        rnea(&panda, &links, &gravity, &s.q, &s.dq, &s.ddq, &mut tau);
        black_box(tau);
    });
    table.row("torque, rigid body, plain recursion", plain, "");
    let whole_ns = torque(&mut whole);
    for (form, of, settings) in [("q", [3, 3], vec![0.0, 2.5]), ("dq-dq", [2, 3], vec![0.0, 2.0, 0.0, 2.0])] {
        let spec = Spec { family: "empirical", form, site: Site::Function { row: 3, of }, settings };
        let term = spec.build(&model.structure().operating_point(&model.beta())).expect("its site and settings");
        let mut values: Vec<_> = model.beta().iter().map(|&value| (value, None)).collect();
        values.extend(term.columns().iter().map(|_| (0.1, None)));
        let structure = model.structure().clone().with(vec![term]).expect("its own columns");
        let mut learned =
            TorqueModel::new("panda", structure, Vec::new(), &values).expect("its columns").evaluator(&gravity);
        let what = if of[0] == of[1] { "one position" } else { "two velocities" };
        table.row(&format!("    more with an empirical term of {what}"), torque(&mut learned) - whole_ns, "");
    }

    let mut rows = SampleRegressor::new(&rigid, &gravity).expect("one sample at a time");
    let time = least(300, 1000, |k| {
        black_box(rows.at(black_box(&points[k % SAMPLES])));
    });
    table.row(&format!("regressor 7 x {base}"), time, "regressor-45");
    let mut rows = SampleRegressor::new(model.structure(), &gravity).expect("one sample at a time");
    let columns = rows.len();
    let time = least(300, 1000, |k| {
        black_box(rows.at(black_box(&points[k % SAMPLES])));
    });
    table.row(&format!("regressor 7 x {columns} (with friction)"), time, "regressor-70");
    let mut standard = DMatrix::zeros(N, 10 * N);
    let time = least(50, 200, |k| {
        let s = &points[k % SAMPLES];
        regressor(&panda, &gravity, &s.q, &s.dq, &s.ddq, &mut standard);
        black_box(&mut standard);
    });
    table.row("regressor 7 x 70, plain route", time, "");

    stack(&table, &mut rng, &model, &gravity);
    stream(&model, &gravity);
}

/// 10,000 samples: rows and normal equations, their solution, and its error.
fn stack(table: &Table, rng: &mut ChaCha8Rng, model: &TorqueModel, gravity: &Vector3<f64>) {
    let structure = model.structure();
    let points = samples(rng, ROWS);
    let take = |of: fn(&Sample) -> &JointVec| DMatrix::from_fn(ROWS, N, |k, j| of(&points[k])[j]);
    let (q, dq, ddq) = (take(|s| &s.q), take(|s| &s.dq), take(|s| &s.ddq));
    let motion = Motion { dt: 1e-3, q, dq, ddq, gravity: *gravity, periodic: false, start: 0.0 };
    let sigma = [0.1; N];
    let tau = model.predict(&motion).map(|tau| tau + 0.1 * rng.random_range(-1.7..1.7));
    let active: Vec<Vec<usize>> = (0..N)
        .map(|j| {
            let mut own: Vec<usize> = Vec::new();
            for (c, column) in structure.columns().iter().enumerate() {
                let rigid = c < structure.reduction().len();
                if (rigid && column.joint > j) || column.joint == j + 1 {
                    own.push(c);
                }
            }
            own
        })
        .collect();
    let mut rows = SampleRegressor::new(structure, gravity).expect("one sample at a time");
    let mut gram = Gram::new(structure.columns().len(), active.clone(), 1.0);
    let gathered = mean_cpu(100, || {
        gram = Gram::new(structure.columns().len(), active.clone(), 1.0);
        for (k, point) in points.iter().enumerate() {
            let torque: [f64; MAX_JOINTS] = std::array::from_fn(|j| if j < N { tau[(k, j)] } else { 0.0 });
            gram.add(rows.at(point), &torque);
        }
        black_box(gram.normal_equations(&sigma));
    });
    let mut first = None;
    let solved = mean_cpu(1000, || {
        let (m, b) = gram.normal_equations(&sigma);
        first = solve(&m, &b);
    });
    let first = first.expect("finite");
    table.row("stack 10,000 x 7 rows into normal equations", gathered, "stack-10000");
    table.row("solve them", solved, "solve-10000");
    let both: f64 = ["stack-10000", "solve-10000"].iter().filter_map(|what| table.0.get(*what)).map(|of| of[0].1).sum();
    println!("{:<58} {:>7.2} ms   (peer {:.2} ms)", "    together", (gathered + solved) * 1e-6, both * 1e-6);
    let dense = mean_cpu(20, || {
        black_box(structure.regressor(&motion));
    });
    table.row("the whole regressor, 70,000 x 59 in memory", dense, "");

    // The reference: singular values of all rows, equilibrated.
    let mut w = structure.regressor(&motion) / sigma[0];
    let norms: Vec<f64> = w.column_iter().map(|column| column.norm()).collect();
    w.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let qr = w.qr();
    let mut right = DVector::from_column_slice(tau.as_slice()) / sigma[0];
    qr.q_tr_mul(&mut right);
    let svd = qr.unpack_r().svd(true, true);
    let exact = svd.solve(&right.rows(0, norms.len()).into_owned(), 0.0).expect("both sides");
    let worst = |beta: &DVector<f64>| {
        let error = |c: usize| (beta[c] - exact[c] / norms[c]).abs() / first.inverse[(c, c)].sqrt();
        (0..norms.len()).map(error).fold(0.0, f64::max)
    };
    println!(
        "    against QR and singular values: {:.1e} standard deviations; condition of W {:.0}",
        worst(&first.beta),
        first.condition.sqrt()
    );
}

/// One hour at 1 kHz, generated on the fly.
fn stream(model: &TorqueModel, gravity: &Vector3<f64>) {
    const HOUR: usize = 3_600_000;
    let alone = Instant::now();
    let mut source = Source::new(model, gravity);
    let mut sum = 0.0;
    for _ in 0..HOUR {
        sum += source.next().1[0];
    }
    black_box(sum);
    let alone = alone.elapsed().as_secs_f64();
    let (start, cpu) = (Instant::now(), cpu_seconds());
    let mut source = Source::new(model, gravity);
    let mut streaming =
        Streaming::new(model.structure(), gravity, 1000.0, &Settings::default()).expect("shipped model");
    for k in 0..HOUR {
        let (q, tau) = source.next();
        streaming.push(&q, &tau).expect("finite");
        // One solution a minute.
        if k % 60_000 == 59_999 {
            black_box(streaming.estimate().expect("a minute is enough"));
        }
    }
    let (time, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    let estimate = streaming.estimate().expect("an hour is enough");
    let errors = model
        .beta()
        .iter()
        .zip(&estimate.beta)
        .zip(&estimate.std)
        .map(|((truth, found), std)| (found - truth) / std.unwrap_or(f64::NAN))
        .collect::<Vec<_>>();
    let rms = (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt();
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))
        .map_or("unknown".to_string(), |kb| kb.trim().to_string());
    println!("streaming, one hour at 1 kHz, estimate every minute           {time:>6.2} s ({cpu:.2} s of CPU time)");
    println!(
        "    of which {alone:.2} s make the samples; with them {:.0} ns of CPU time a sample",
        cpu * 1e9 / HOUR as f64
    );
    println!("    {} rows a joint; errors {rms:.2} standard deviations (rms)", streaming.rows());
    println!("    peak memory of this process: {peak} (with `-- --stream` that is the estimator's alone)");
}

/// CPU time of this thread so far \[s\]: on a machine with other work the clock on the wall says more than the work needs.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/schedstat").unwrap_or_default();
    stat.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()).map_or(f64::NAN, |ns| ns * 1e-9)
}

/// Mean CPU time of something long enough to be interrupted \[ns\]. The system counts it in steps of a few ms: many repeats.
fn mean_cpu(repeats: usize, mut call: impl FnMut()) -> f64 {
    call();
    let start = cpu_seconds();
    (0..repeats).for_each(|_| call());
    (cpu_seconds() - start) * 1e9 / repeats as f64
}

/// Five sines a joint by rotation, and the torque that the model needs along them plus noise.
struct Source {
    /// Cosine, sine, and their turn in one sample; amplitude and angular frequency.
    phasors: Vec<[[f64; 6]; 5]>,
    evaluator: Evaluator,
    noise: u64,
}

impl Source {
    fn new(model: &TorqueModel, gravity: &Vector3<f64>) -> Source {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut phasor = || {
            let (a, w): (f64, f64) = (rng.random_range(0.1..0.4), rng.random_range(0.5..5.0));
            let (phase, turn): (f64, f64) = (rng.random_range(-3.0..3.0), w * 1e-3);
            [phase.cos(), phase.sin(), turn.cos(), turn.sin(), a, w]
        };
        let phasors = (0..N).map(|_| std::array::from_fn(|_| phasor())).collect();
        Source { phasors, evaluator: model.evaluator(gravity), noise: 88_172_645_463_325_252 }
    }

    fn next(&mut self) -> (JointVec, JointVec) {
        let mut sample = Sample::default();
        for (j, phasors) in self.phasors.iter_mut().enumerate() {
            for [cos, sin, turn_cos, turn_sin, a, w] in phasors {
                (*cos, *sin) = (*cos * *turn_cos - *sin * *turn_sin, *sin * *turn_cos + *cos * *turn_sin);
                sample.q[j] += *a * *sin;
                sample.dq[j] += *a * *w * *cos;
                sample.ddq[j] -= *a * *w * *w * *sin;
            }
        }
        let mut tau = self.evaluator.torque(&sample).0;
        for tau in &mut tau[..N] {
            self.noise ^= self.noise << 13;
            self.noise ^= self.noise >> 7;
            self.noise ^= self.noise << 17;
            *tau += 0.3 * ((self.noise >> 11) as f64 / (1u64 << 52) as f64 - 1.0);
        }
        (sample.q, tau)
    }
}
