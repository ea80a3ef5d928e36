//! How often a diagnosis is right: `cargo bench --bench diagnosis -- cases=100 seed=1 what=single`.
//!
//! Every case is a separate arm (masses, centres of mass, friction) with no undeclared effect, one or several, simulated
//! along four trajectories to identify from and two to validate with, ten periods of ten seconds each, with the noise of
//! `config/arms/sim-panda.toml` and 0.05 Nm of coloured noise. The diagnosis has the recordings only; its outcome is compared with the
//! truth afterwards.
//!
//! | argument | meaning | default |
//! |---|---|---|
//! | `what=` | `single`, `none`, `three`, `foreign`, `background`, `one-trajectory`, `upright`, several with commas, or `all` | `all` |
//! | `cases=` | cases of each part | 20 |
//! | `seed=` | of everything | 1 |
//! | `case=` | this case alone, with its truth file; needs one `what` | |
//! | `threads=` | cases at a time | 1 |
//! | `seconds=` | no case of a part begins later | |
//!
//! A line per case goes to stderr, the tables to stdout. The figures are in docs/results/diagnosis.md.

mod tally;

use plumbline_testkit::diagnosis::case::{Case, What};
use plumbline_testkit::diagnosis::trial::{Bench, Judged};
use std::sync::Mutex;
use std::time::Instant;
use tally::Tally;

struct Options {
    what: Vec<What>,
    cases: usize,
    seed: u64,
    case: Option<usize>,
    threads: usize,
    seconds: Option<usize>,
}

fn options() -> Result<Options, String> {
    let mut options = Options { what: What::ALL.to_vec(), cases: 20, seed: 1, case: None, threads: 1, seconds: None };
    for argument in std::env::args().skip(1).filter(|argument| !argument.starts_with("--")) {
        let (key, value) = argument.split_once('=').ok_or(format!("{argument}: expected key=value"))?;
        let number = || value.parse::<usize>().map_err(|_| format!("{key}={value}: expected a whole number"));
        match key {
            "what" if value == "all" => options.what = What::ALL.to_vec(),
            "what" => {
                let known = What::ALL.map(What::id).join(", ");
                let of = |id: &str| What::ALL.into_iter().find(|what| what.id() == id);
                let each = value.split(',').map(|id| of(id).ok_or(format!("what={id}: expected {known}, or all")));
                options.what = each.collect::<Result<_, _>>()?;
            }
            "cases" => options.cases = number()?,
            "seed" => options.seed = number()? as u64,
            "case" => options.case = Some(number()?),
            "threads" => options.threads = number()?.max(1),
            "seconds" => options.seconds = Some(number()?),
            _ => return Err(format!("{key}: expected what, cases, seed, case, threads or seconds")),
        }
    }
    if options.case.is_some() && options.what.len() != 1 {
        return Err("case: needs one what".to_string());
    }
    Ok(options)
}

fn main() {
    let options = options().unwrap_or_else(|error| {
        eprintln!("{error}");
        std::process::exit(2);
    });
    let bench = Bench::new();
    for &what in &options.what {
        let start = Instant::now();
        let numbers: Vec<usize> = options.case.map_or((0..options.cases).collect(), |case| vec![case]);
        let next = Mutex::new(numbers.iter());
        let done: Mutex<Vec<(Case, Judged)>> = Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            for _ in 0..options.threads {
                scope.spawn(|| {
                    let late = || options.seconds.is_some_and(|most| start.elapsed().as_secs() >= most as u64);
                    while let Some(&number) = { next.lock().expect("no panic").next().filter(|_| !late()) } {
                        let case = Case::draw(&bench.base, &bench.identify, what, options.seed, number);
                        if options.case.is_some() {
                            println!("{}", case.truth);
                        }
                        let judged = bench.judge(&case, if options.case.is_some() { 2 } else { 1 });
                        eprintln!("{}", tally::line(&case, &judged));
                        done.lock().expect("no panic").push((case, judged));
                    }
                });
            }
        });
        let mut done = done.into_inner().expect("no panic");
        done.sort_by_key(|(case, _)| case.number);
        print!("{}", Tally { what, seed: options.seed, cases: &done });
        eprintln!("{}: {:.0} s", what.id(), start.elapsed().as_secs_f64());
    }
}
