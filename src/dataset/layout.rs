//! Columns of a run by name, whatever the format of its file.

use super::{Format, Run};
use nalgebra::DMatrix;
use plumbline_core::{BadInput, MAX_JOINTS};
use plumbline_identify::signal::polled::{Sent, sent};

/// The columns of one file, torque still in the unit of the file.
#[derive(Debug)]
pub(super) struct Columns {
    pub t: Vec<f64>,
    pub q: DMatrix<f64>,
    pub dq: Option<DMatrix<f64>>,
    pub tau: DMatrix<f64>,
    pub extra: Vec<(String, Vec<f64>)>,
}

impl Columns {
    /// Gives the rows of a run the times at which the arm sent them, where the recorder was a little faster than the arm.
    pub fn take_times_of_sender(&mut self, run: &str) {
        let Some(Sent { t, step, repeats }) = sent(&self.t, &self.q, &self.tau) else { return };
        tracing::info!(
            "run {run}: {repeats} rows repeat the one before, for the arm sent one every {:.3} ms and was read more often; its times are even",
            1e3 * step
        );
        self.t = t;
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Torque {
    Required,
    /// Without them, `Columns::tau` has no columns.
    Optional,
}

/// Places of the quantities in a file's columns.
pub(super) struct Layout {
    t: usize,
    q: Vec<usize>,
    dq: Vec<usize>,
    tau: Vec<usize>,
    extra: Vec<usize>,
}

impl Layout {
    pub fn of(file: &str, header: &[String], torque: Torque, format: Format) -> Result<Layout, BadInput> {
        for (index, name) in header.iter().enumerate() {
            if name.is_empty() || header[..index].contains(name) {
                let place = format!("{}, column {}", format.header(), index + 1);
                return Err(BadInput::new(file, place, format!("`{name}`"), "a unique column name"));
            }
        }
        let place = |name: &str| header.iter().position(|other| other == name);
        let missing = |name: &str, why: &str| {
            BadInput::new(file, format.header(), format!("no column `{name}`"), format!("a column `{name}` {why}"))
        };
        let t = place("t").ok_or_else(|| missing("t", "with the time in s"))?;
        // The joints are those with a position; a gap in the numbering is a missing column, not a smaller robot.
        let highest = |stem: &str| header.iter().filter_map(|name| joint_of(name, stem)).max().unwrap_or(0);
        let n = highest("q").max(highest("dq")).max(highest("tau"));
        if n > MAX_JOINTS {
            let expected = format!("at most {MAX_JOINTS} joints");
            return Err(BadInput::new(file, format.header(), format!("columns for joint {n}"), expected));
        }
        let all = |stem: &str, why: &str| -> Result<Vec<usize>, BadInput> {
            (1..=n.max(1))
                .map(|joint| format!("{stem}{joint}"))
                .map(|name| place(&name).ok_or_else(|| missing(&name, why)))
                .collect()
        };
        let q = all("q", "with a joint position in rad")?;
        let none = torque == Torque::Optional && highest("tau") == 0;
        let tau = if none { Vec::new() } else { all("tau", "with a joint torque")? };
        let dq = if highest("dq") > 0 { all("dq", "like those of the other joints")? } else { Vec::new() };
        // A quantity that the program reads is there for all joints or for none.
        for known in super::columns::ALL.iter().filter(|known| highest(known.stem) > 0) {
            if highest(known.stem) > n {
                let (found, expected) = (highest(known.stem), format!("columns of {n} joints, as many as q has"));
                return Err(BadInput::new(file, format.header(), format!("column `{}{found}`", known.stem), expected));
            }
            all(known.stem, "like those of the other joints")?;
        }
        let extra = (0..header.len())
            .filter(|&column| column != t && ![&q, &dq, &tau].iter().any(|known| known.contains(&column)))
            .collect();
        Ok(Layout { t, q, dq, tau, extra })
    }

    /// The quantities of these columns, which are finite. Refuses less than [`Run::LEAST_SAMPLES`], and time that does not advance.
    pub fn take(
        self,
        file: &str,
        header: Vec<String>,
        columns: Vec<Vec<f64>>,
        format: Format,
    ) -> Result<Columns, BadInput> {
        let t = &columns[self.t];
        if t.len() < Run::LEAST_SAMPLES {
            let (found, expected) =
                (format!("{} samples", t.len()), format!("at least {} samples", Run::LEAST_SAMPLES));
            return Err(BadInput::new(file, format.body(), found, expected));
        }
        check_time(file, t, format)?;
        let matrix = |from: &[usize]| DMatrix::from_fn(t.len(), from.len(), |row, joint| columns[from[joint]][row]);
        Ok(Columns {
            q: matrix(&self.q),
            dq: (!self.dq.is_empty()).then(|| matrix(&self.dq)),
            tau: matrix(&self.tau),
            extra: self.extra.iter().map(|&column| (header[column].clone(), columns[column].clone())).collect(),
            t: t.clone(),
        })
    }
}

/// `3` for `tau3` and stem `tau`; `None` for `tau_cmd3`, `tau0` and `tau03`.
fn joint_of(name: &str, stem: &str) -> Option<usize> {
    let digits = name.strip_prefix(stem)?;
    if digits.starts_with('0') || !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    digits.parse().ok()
}

/// Time must not decrease, may repeat, and must advance at least once.
fn check_time(file: &str, t: &[f64], format: Format) -> Result<(), BadInput> {
    for (index, pair) in t.windows(2).enumerate() {
        if pair[1] < pair[0] {
            let expected = format!("a time not before {} s, that of the sample before", pair[0]);
            return Err(BadInput::new(file, format!("{}, column t", format.sample(index + 1)), pair[1], expected));
        }
    }
    if t[t.len() - 1] > t[0] {
        return Ok(());
    }
    Err(BadInput::new(file, "column t", format!("{} s in every row", t[0]), "time that advances"))
}
