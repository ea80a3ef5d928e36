//! Division of runs into identification set and validation set.

use crate::analysis::SAME_MOUNTING;
use crate::dataset::{Dataset, Role, Run};
use crate::failure::Failure;
use plumbline_core::BadInput;

/// Ratio of every run's samples that validate, in a dataset without validation runs.
pub const HOLD_OUT: f64 = 0.4;

/// Identification set and validation set.
pub struct Split {
    pub identify: Vec<Run>,
    pub validate: Vec<Run>,
    pub notes: Vec<String>,
}

/// Runs by their roles, taken out of the dataset. A dataset without validation runs is validated with the last part of its runs, which then is not used to
/// identify.
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
    notes.push(format!(
        "the dataset has no validation run: the last {:.0} % of each run were kept out of the identification and validate it",
        100.0 * hold_out
    ));
    let (head, tail) = identify.iter().map(|run| cut(run, 1.0 - hold_out)).unzip();
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

/// Period of a part of a run; `None` if the part is shorter than the period.
fn whole_periods(mut part: Run) -> Run {
    let data = &mut part.data;
    let length = data.t.last().zip(data.t.first()).map_or(0.0, |(last, first)| last - first);
    data.period = data.period.filter(|period| *period <= length);
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
