//! Shipped files damaged at random, and what has to hold whatever a reader makes of them: an answer or a refusal that names the file, never
//! a panic, and nothing that takes long.
//!
//! A case is given by a seed and a number alone. `examples/fuzz_files.rs` runs the same cases for as long as one likes.

use nalgebra::DMatrix;
use plumbline::config::job::Job;
use plumbline::dataset::{Dataset, Run};
use plumbline::store::ModelFile;
use plumbline::store::export::tree::Tree;
use plumbline::urdf::{Arm, Choice, Urdf};
use plumbline_core::BadInput;
use plumbline_excite::parse_plan;
use plumbline_franka::limits_from_urdf;
use plumbline_identify::{Spread, TorqueUncertainty};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot};
use plumbline_sim::Truth;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::time::{Duration, Instant};

pub const TARGETS: [&str; 8] = ["job", "robot", "arm", "plan", "model", "dataset", "csv", "urdf"];

/// A file of a few kilobytes that takes longer than this to read is a way to stop the program.
const LONGEST: Duration = Duration::from_secs(5);

/// How many files of each kind were read, and how many refused.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tally {
    pub read: [u64; TARGETS.len()],
    pub refused: [u64; TARGETS.len()],
}

/// File name extension of a target, and its shipped files.
pub struct Files {
    texts: [Vec<String>; TARGETS.len()],
    robot: Robot,
}

/// Where `dataset` and `csv` are put for their readers.
pub struct Bench<'a> {
    pub files: &'a Files,
    pub folder: &'a Path,
}

impl Files {
    pub fn shipped() -> Files {
        let root = Path::new(crate::ROOT);
        let all = |folder: &str| -> Vec<String> {
            let mut paths: Vec<_> =
                std::fs::read_dir(root.join(folder)).unwrap().map(|entry| entry.unwrap().path()).collect();
            paths.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
            paths.sort();
            paths.iter().map(|path| std::fs::read_to_string(path).unwrap()).collect()
        };
        let manifest = "robot = \"panda\"\nname = \"fuzz\"\nmounting = { rho = 1.5708, phi = 0.0 }\n\n[[run]]\nfile = \"run.csv\"\nrole = \"identify\"\n";
        let row = |k: usize| {
            let t = k as f64 * 0.05;
            let numbers = (0..21).map(|c| format!("{:.5}", (t * (1.0 + 0.1 * c as f64)).sin())).collect::<Vec<_>>();
            format!("{t:.3},{}\n", numbers.join(","))
        };
        let names = ["q", "dq", "tau"].iter().flat_map(|kind| (1..=7).map(move |j| format!("{kind}{j}")));
        let header = format!("t,{}\n", names.collect::<Vec<_>>().join(","));
        let csv = header + &(0..21).map(row).collect::<String>();
        let texts = [
            all("config"),
            all("config/robots"),
            all("config/arms"),
            all("config/plans"),
            with_uncertainty(all("config/models")),
            vec![manifest.to_string()],
            vec![csv],
            vec![urdf()],
        ];
        Files { texts, robot: Robot::load("panda", None).unwrap() }
    }
}

/// These models, and the first with an uncertainty; without its hash, which would refuse every change.
fn with_uncertainty(mut texts: Vec<String>) -> Vec<String> {
    let chain = |name: &str| Ok(Robot::load(name, None)?.chain);
    let mut model = ModelFile::parse("shipped model", &texts[0], chain).expect("a shipped model");
    let p = model.model.parameters().len();
    let covariance = DMatrix::from_fn(p, p, |c, d| if c == d { 1e-4 } else { 1e-6 });
    let parameters = Spread { covariance, freedom: vec![30.0; p] };
    let uncertainty =
        TorqueUncertainty { parameters, residual_std: vec![0.1; 7], residual_freedom: 5e3, residual_spectrum: None };
    model.uncertainty = Some(uncertainty);
    texts.push(
        model
            .to_toml()
            .lines()
            .filter(|line| !line.starts_with("content"))
            .map(|line| line.to_string() + "\n")
            .collect(),
    );
    texts
}

/// A description as an FR3 serves it, in outline.
fn urdf() -> String {
    let parts: String = (1..=7)
        .map(|k| {
            format!(
                "<joint name=\"fr3_joint{k}\" type=\"revolute\"><origin rpy=\"1.57 0 0\" xyz=\"0 0 0.3\"/><parent link=\"l{}\"/><child link=\"l{k}\"/>\
                 <axis xyz=\"0 0 1\"/><limit lower=\"-2.{k}\" upper=\"1.{k}\" velocity=\"3.{k}\" effort=\"4{k}\"/><position_based_velocity_limits \
                 velocity_offset=\"0.{k}\" deceleration_limit=\"5.{k}\"/></joint>\n<link name=\"l{k}\"><inertial><origin xyz=\"0 0 0.1\"/><mass \
                 value=\"2.{k}\"/><inertia ixx=\"0.1\" ixy=\"0\" ixz=\"0\" iyy=\"0.1\" iyz=\"0\" izz=\"0.1\"/></inertial></link>\n",
                k - 1
            )
        })
        .collect();
    format!("<?xml version=\"1.0\"?>\n<robot name=\"fr3\">\n<link name=\"l0\"/>\n{parts}</robot>\n")
}

/// Runs one case; `Err` says what does not hold. A reader that panics does so here.
pub fn case(bench: &Bench, seed: u64, number: u64, tally: &mut Tally) -> Result<(), String> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(number);
    let target = random.random_range(0..TARGETS.len());
    let mut text = bench.files.texts[target].choose(&mut random).cloned().unwrap_or_default().into_bytes();
    for _ in 0..random.random_range(0..4) {
        damage(&mut text, &mut random);
    }
    let start = Instant::now();
    let outcome = read(bench, target, &text);
    let place = format!("seed {seed}, case {number}, {}", TARGETS[target]);
    if start.elapsed() > LONGEST {
        return Err(format!("{place}: took {:?}", start.elapsed()));
    }
    match outcome {
        Ok(()) => tally.read[target] += 1,
        Err(message) if message.trim().is_empty() || !message.contains("fuzz") => {
            return Err(format!("{place}: no file is named in `{message}`"));
        }
        Err(_) => tally.refused[target] += 1,
    }
    Ok(())
}

fn read(bench: &Bench, target: usize, bytes: &[u8]) -> Result<(), String> {
    let words = |bad: BadInput| bad.to_string();
    let file = "fuzz.toml";
    // Files that are no text are refused where they are read from disk: by the two that are.
    let text = String::from_utf8_lossy(bytes);
    match TARGETS[target] {
        "job" => Job::parse(Path::new(file), &text, &[]).map(drop).map_err(words),
        "robot" => Robot::parse(file, &text).map(drop).map_err(words),
        "arm" => Truth::parse(file, &text).map(drop).map_err(words),
        "plan" => {
            let plan = parse_plan(file, &text).map_err(words)?;
            // What was accepted can be driven: every sample is a number.
            let fourier = plan.fourier().map_err(|error| format!("{file}: {error}"))?;
            let point = fourier.at(0, 0.3 * fourier.period);
            if point.q.is_finite() { Ok(()) } else { Err(String::new()) }
        }
        "model" => {
            let chain = |name: &str| {
                let bad = || BadInput::new(file, "key `robot`", name, "panda");
                if name == "panda" { Ok(bench.files.robot.chain.clone()) } else { Err(bad()) }
            };
            let model = ModelFile::parse(file, &text, chain).map_err(words)?;
            // A model of numbers that are too large is for the guard to stop, not for the evaluator to fall over.
            model.model.evaluator(&Mounting::WALL.gravity()).torque(&Sample { q: [0.3; 8], ..Sample::default() });
            if let Some(uncertainty) = model.uncertainty {
                uncertainty.half_widths(&DMatrix::from_element(7, model.model.parameters().len(), 1.0));
            }
            Ok(())
        }
        "dataset" | "csv" => {
            let fresh = |name: &str, other: &[u8]| {
                std::fs::write(bench.folder.join(name), other).map_err(|error| error.to_string())
            };
            let whole = |target: usize| bench.files.texts[target].first().map_or(&b""[..], |text| text.as_bytes());
            let dataset = TARGETS[target] == "dataset";
            fresh("dataset.toml", if dataset { bytes } else { whole(5) })?;
            fresh("run.csv", if dataset { whole(6) } else { bytes })?;
            if !dataset {
                let _ = Run::read(&bench.folder.join("run.csv"), Mounting::UPRIGHT);
            }
            // The folder's own name has the word.
            Dataset::read(bench.folder).map(drop).map_err(words)
        }
        _ => {
            let named = |error: &dyn std::fmt::Display| format!("fuzz.urdf: {error}");
            let limits = limits_from_urdf(&text).map(drop).map_err(|error| named(&error));
            if let Ok(document) = roxmltree::Document::parse(&text) {
                let _ = Tree::of("fuzz.urdf", &document, &bench.files.robot);
                if let Ok(urdf) = Urdf::of("fuzz.urdf", &document) {
                    let _ = Arm::of(&urdf, &Choice::default()).map(|arm| arm.bodies(&urdf));
                }
            }
            limits
        }
    }
}

/// Numbers and words outside the expected ranges.
const WORDS: [&str; 22] = [
    "0",
    "-1",
    "-0.0",
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-inf",
    "9223372036854775807",
    "9223372036854775808",
    "4294967296",
    "1000000",
    "\"\"",
    "\"../../../etc/passwd\"",
    "\"\\u0000\"",
    "\"ü€𝄞\"",
    "true",
    "[]",
    "{}",
    "1979-05-27",
    "\"-1 deg\"",
];

/// One of: a byte flipped, the end cut off, a line gone, doubled or moved, a number or a value replaced, something nested deeply or long.
fn damage(text: &mut Vec<u8>, random: &mut ChaCha8Rng) {
    if text.is_empty() {
        return;
    }
    let at = random.random_range(0..text.len());
    match random.random_range(0..9) {
        0 => text[at] ^= 1 << random.random_range(0..8),
        1 => text.truncate(at),
        2..=4 => {
            let mut lines: Vec<Vec<u8>> = text.split_inclusive(|byte| *byte == b'\n').map(<[u8]>::to_vec).collect();
            let (from, to) = (random.random_range(0..lines.len()), random.random_range(0..lines.len()));
            match random.random_range(0..3) {
                0 => drop(lines.remove(from)),
                1 => lines.insert(to, lines[from].clone()),
                _ => lines.swap(from, to),
            }
            *text = lines.concat();
        }
        5 | 6 => {
            // The number, or the value behind an equals sign, that comes next.
            let end = |from: usize, stop: fn(u8) -> bool| {
                text[from..].iter().position(|byte| stop(*byte)).map_or(text.len(), |k| from + k)
            };
            let number: fn(u8) -> bool = |byte| byte.is_ascii_digit();
            let (from, to) = if random.random_bool(0.5) {
                let from = end(at, number);
                (from, end(from, |byte| !(byte.is_ascii_digit() || b".eE+-".contains(&byte))))
            } else {
                let from = (end(at, |byte| byte == b'=') + 1).min(text.len());
                (from, end(from, |byte| byte == b'\n' || byte == b','))
            };
            let word = WORDS.choose(random).copied().unwrap_or_default();
            text.splice(from..to, word.bytes());
        }
        7 => {
            let deep = ["[", "{a=", "<a>", "\"", "-", "9"].choose(random).copied().unwrap_or_default();
            let times = random.random_range(1..3000);
            text.splice(at..at, deep.repeat(times).into_bytes());
        }
        _ => {
            let junk: Vec<u8> = (0..random.random_range(1..40)).map(|_| random.random()).collect();
            text.splice(at..at, junk);
        }
    }
}
