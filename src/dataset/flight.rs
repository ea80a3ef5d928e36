//! A recording of the flight recorder as a run: measured values with the arm's time.

use super::Run;
use super::csv::{self, Columns, Torque};
use crate::recording::Recording;
use nalgebra::DMatrix;
use plumbline_core::{BadInput, JointVec, PERIOD_S, Record};
use std::path::Path;

/// Reads a recording of the flight recorder where the name ends in `.mcap`, else a CSV file.
pub(super) fn read_run(path: &Path, torque: Torque) -> Result<Columns, BadInput> {
    let is_recording = path.extension().is_some_and(|extension| extension == "mcap");
    if is_recording { read(path) } else { csv::read(path, torque) }
}

fn read(path: &Path) -> Result<Columns, BadInput> {
    let file = path.display().to_string();
    let recording = Recording::read(path)?;
    if let Some(cut) = &recording.cut {
        return Err(BadInput::new(file, "end of the file", cut, "a complete recording"));
    }
    let (records, n) = (&recording.records, recording.about.joints);
    if records.len() < Run::LEAST_SAMPLES {
        let (found, expected) = (format!("{} cycles", records.len()), format!("at least {}", Run::LEAST_SAMPLES));
        return Err(BadInput::new(file, "messages", found, expected));
    }
    let first = records.first().map_or(0, |record| record.state.seq);
    for pair in records.windows(2) {
        if pair[1].state.seq <= pair[0].state.seq {
            let place = format!("cycle {}, seq", pair[1].cycle);
            return Err(BadInput::new(file, place, pair[1].state.seq, format!("more than {}", pair[0].state.seq)));
        }
    }
    for record in records {
        for (name, values) in
            [("position", &record.state.q), ("velocity", &record.state.dq), ("effort", &record.state.tau)]
        {
            if let Some(value) = values[..n].iter().find(|value| !value.is_finite()) {
                let place = format!("cycle {}, {name}", record.cycle);
                return Err(BadInput::new(file, place, value, "a finite number"));
            }
        }
    }
    let matrix =
        |of: fn(&Record) -> &JointVec| DMatrix::from_fn(records.len(), n, |row, joint| of(&records[row])[joint]);
    Ok(Columns {
        t: records.iter().map(|record| (record.state.seq - first) as f64 * PERIOD_S).collect(),
        q: matrix(|record| &record.state.q),
        dq: Some(matrix(|record| &record.state.dq)),
        tau: matrix(|record| &record.state.tau),
        extra: Vec::new(),
    })
}
