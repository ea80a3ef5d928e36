//! Division of runs into identification set and validation set.

use crate::analysis::SAME_MOUNTING;
use crate::dataset::{Dataset, Role, Run};
use crate::failure::Failure;
use plumbline_core::BadInput;

/// Ratio of every run's samples that validate, in a dataset without validation runs.
pub const HOLD_OUT: f64 = 0.4;

/// Fewest periods of a part that is identified from, in a run that is divided.
const MIN_PERIODS: f64 = 2.0;

/// Identification set and validation set.
pub struct Split {
    pub identify: Vec<Run>,
    pub validate: Vec<Run>,
    pub notes: Vec<String>,
}

/// Runs by their roles, taken out of the dataset. A dataset without validation runs is validated with the last part of its runs, or with its last runs where
/// they have too few periods to divide. What validates is not used to identify.
pub fn split(dataset: &mut Dataset, hold_out: f64) -> Result<Split, Failure> {
    let runs = std::mem::take(&mut dataset.runs).into_iter();
    let (identify, validate): (Vec<Run>, Vec<Run>) = runs.partition(|run| run.role == Role::Identify);
    let mut notes = Vec::new();
    let Some(first) = identify.first() else {
        let file = format!("dataset {}", dataset.name);
        return Err(BadInput::new(file, "[[run]] role", "no run", "at least one run with role = \"identify\"").into());
    };
    if let Some(other) = identify.iter().find(|run| run.data.mounting.angle_to(&first.data.mounting) > SAME_MOUNTING) {
        notes.push(format!(
            "the parameters are identified from several mountings at once: {} and {}",
            first.data.mounting, other.data.mounting
        ));
    }
    if !validate.is_empty() {
        return Ok(Split { identify, validate, notes });
    }
    // Parts of too few periods have no noise to compare with, and no unseen motion.
    let few = |run: &Run| {
        let periods = run.data.periods() as f64;
        (1.0 - hold_out) * periods < MIN_PERIODS || hold_out * periods < 1.0
    };
    let few = identify.iter().any(|run| run.data.period.is_some() && few(run));
    if few && identify.len() > 1 {
        let mut identify = identify;
        let kept = identify.len() - ((identify.len() as f64 * hold_out) as usize).max(1);
        let validate = identify.split_off(kept);
        let names: Vec<&str> = validate.iter().map(|run| run.data.name.as_str()).collect();
        notes.push(format!(
            "the dataset has no validation run, and its runs have too few periods to divide: {} were kept out of the identification and validate it",
            names.join(", ")
        ));
        return Ok(Split { identify, validate, notes });
    }
    notes.push(format!(
        "the dataset has no validation run: the last {:.0} % of each run were kept out of the identification and validate it",
        100.0 * hold_out
    ));
    let parts = identify.iter().map(|run| cut(run, 1.0 - hold_out));
    let (head, tail) = parts.map(|(head, tail)| (whole_periods(head), whole_periods(tail))).unzip();
    Ok(Split { identify: head, validate: tail, notes })
}

/// Runs to find the changes in, and runs to judge them by: those of each role, or the first and the last part of every run.
pub fn find_and_judge(runs: &[&Run], notes: &mut Vec<String>) -> (Vec<Run>, Vec<Run>) {
    let with = |role: Role| runs.iter().filter(|run| run.role == role).map(|run| (*run).clone()).collect::<Vec<Run>>();
    let (identify, validate) = (with(Role::Identify), with(Role::Validate));
    if runs.is_empty() || !(identify.is_empty() || validate.is_empty()) {
        return (identify, validate);
    }
    let share = 100.0 * HOLD_OUT;
    notes.push(format!(
        "the dataset has runs of one role: the last {share:.0} % of each judge what was found in the rest"
    ));
    let parts = runs.iter().map(|run| {
        let (first, last) = cut(run, 1.0 - HOLD_OUT);
        (whole_periods(first), whole_periods(last))
    });
    parts.unzip()
}

/// A part of a run, as one that does not repeat if it is shorter than the period.
fn whole_periods(mut part: Run) -> Run {
    part.data.period = part.data.period.filter(|_| part.data.periods() > 0);
    part
}

/// Both parts of a run, cut at a share of its samples.
fn cut(run: &Run, share: f64) -> (Run, Run) {
    let at = (run.samples() as f64 * share) as usize;
    let part = |from: usize, count: usize, name: &str| Run {
        data: plumbline_identify::Run {
            name: format!("{} ({name} part)", run.data.name),
            ..run.data.part(from, count)
        },
        note: run.note.clone(),
        start: run.start + run.data.t[from] - run.data.t[0],
        extra: run.extra.iter().map(|(name, values)| (name.clone(), values[from..from + count].to_vec())).collect(),
        ..*run
    };
    (part(0, at, "first"), part(at, run.samples() - at, "last"))
}

#[cfg(test)]
mod tests {
    use super::{HOLD_OUT, Split, split};
    use crate::dataset::{Dataset, Role, Run};
    use nalgebra::DMatrix;
    use plumbline_model::Mounting;

    /// Runs without validation, each of a number of periods of a second at 100 Hz: names and periods of both sets, and the note.
    fn parts(runs: &[usize]) -> ([Vec<(String, usize)>; 2], String) {
        let run = |(k, periods): (usize, &usize)| {
            let samples = 100 * periods;
            let data = plumbline_identify::Run {
                name: format!("run {k}"),
                t: (0..samples).map(|sample| sample as f64 / 100.0).collect(),
                q: DMatrix::zeros(samples, 7),
                dq: None,
                tau: DMatrix::zeros(samples, 7),
                mounting: Mounting::WALL,
                period: Some(1.0),
            };
            Run::new(data, Role::Identify)
        };
        let runs = runs.iter().enumerate().map(run).collect();
        let (name, robot, source) = ("test".into(), "panda".into(), toml::Table::new());
        let mut dataset = Dataset { name, robot, mounting: Mounting::WALL, source, runs };
        let Split { identify, validate, notes } = split(&mut dataset, HOLD_OUT).unwrap();
        let periods = |runs: Vec<Run>| runs.iter().map(|run| (run.data.name.clone(), run.data.periods())).collect();
        ([identify, validate].map(periods), notes.join("; "))
    }

    #[test]
    fn runs_of_many_periods_are_divided_and_of_few_kept_whole() {
        let named = |parts: &[(&str, usize)]| parts.iter().map(|(name, n)| (name.to_string(), *n)).collect::<Vec<_>>();
        let ([identify, validate], note) = parts(&[5, 5]);
        assert_eq!(identify, named(&[("run 0 (first part)", 3), ("run 1 (first part)", 3)]));
        assert_eq!(validate, named(&[("run 0 (last part)", 2), ("run 1 (last part)", 2)]));
        assert!(note.contains("last 40 % of each run"), "{note}");
        for periods in [1, 2, 3] {
            let ([identify, validate], note) = parts(&[periods; 5]);
            assert_eq!(identify, named(&[("run 0", periods), ("run 1", periods), ("run 2", periods)]));
            assert_eq!(validate, named(&[("run 3", periods), ("run 4", periods)]));
            assert!(note.contains("run 3, run 4 were kept out"), "{note}");
        }
        // One run alone is divided, whatever its periods: its parts do not repeat.
        let ([identify, validate], _) = parts(&[2]);
        assert_eq!((identify, validate), (named(&[("run 0 (first part)", 1)]), named(&[("run 0 (last part)", 0)])));
    }
}
