//! A run from an MCAP file: one that a dataset was written to, or a recording of the flight recorder, of which it is the measured values with
//! the arm's time.

use super::layout::{Columns, Layout, Torque};
use super::{Format, Run, csv};
use crate::recording::{Recording, bytes_of, run::RunTable};
use nalgebra::DMatrix;
use plumbline_core::{BadInput, JointVec, PERIOD_S, Record};
use std::path::Path;

/// Reads a run from its file.
pub(super) fn read_run(path: &Path, torque: Torque) -> Result<Columns, BadInput> {
    match Format::of(&path.to_string_lossy()) {
        Format::Csv => csv::read(path, torque),
        Format::Mcap => {
            let file = path.display().to_string();
            let bytes = bytes_of(path)?;
            match RunTable::parse(&file, &bytes)? {
                Some(table) => of_table(&file, table, torque),
                None => of_recording(&file, &Recording::parse(&file, &bytes)?),
            }
        }
    }
}

fn of_table(file: &str, table: RunTable<Vec<f64>>, torque: Torque) -> Result<Columns, BadInput> {
    let (names, columns) = table.named();
    let layout = Layout::of(file, &names, torque, Format::Mcap)?;
    for (name, column) in names.iter().zip(&columns) {
        if let Some(at) = column.iter().position(|value| !value.is_finite()) {
            let place = format!("{}, column {name}", Format::Mcap.sample(at));
            return Err(BadInput::new(file, place, column[at], "a finite number"));
        }
    }
    layout.take(file, names, columns, Format::Mcap)
}

fn of_recording(file: &str, recording: &Recording) -> Result<Columns, BadInput> {
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
