//! Columns of a table by their names.

use super::{Imported, Wanted};
use nalgebra::DMatrix;
use plumbline_core::BadInput;

/// A named column, or a two-dimensional array with one column per joint.
pub(super) struct Named {
    pub name: String,
    /// N x 1, or N x n.
    pub values: DMatrix<f64>,
}

/// Names that are understood, in small letters without separators.
const TIME: [&str; 6] = ["t", "time", "times", "timestamp", "timestamps", "stamp"];
const POSITION: [&str; 9] =
    ["q", "pos", "position", "positions", "jointposition", "jointpositions", "actualq", "stateq", "qmeasured"];
const VELOCITY: [&str; 11] = [
    "dq",
    "qd",
    "qdot",
    "vel",
    "velocity",
    "velocities",
    "jointvelocity",
    "jointvelocities",
    "actualqd",
    "statedq",
    "dqmeasured",
];
const TORQUE: [&str; 11] = [
    "tau",
    "effort",
    "efforts",
    "torque",
    "torques",
    "jointtorque",
    "jointtorques",
    "tauj",
    "statetauj",
    "actualtorque",
    "taumeasured",
];
/// A time above this is one since 1970, in seconds.
const EPOCH_S: f64 = 1e8;

/// Reads a CSV file with a header.
pub(super) fn csv(file: &str, bytes: &[u8], wanted: &Wanted) -> Result<Imported, BadInput> {
    let bytes = crate::dataset::csv::text_of(file, bytes)?;
    let mut reader = ::csv::ReaderBuilder::new().trim(::csv::Trim::All).from_reader(bytes);
    let bad_header = |error: ::csv::Error| BadInput::new(file, "line 1", error, "a header row of column names");
    let header: Vec<String> = reader.headers().map_err(bad_header)?.iter().map(String::from).collect();
    // Only columns that are used have to be numbers.
    let used: Vec<usize> = (0..header.len()).filter(|&c| Kind::of(&header[c]).is_some()).collect();
    let mut columns = vec![Vec::new(); used.len()];
    for (row, record) in reader.records().enumerate() {
        let line = row + 2;
        let record = record
            .map_err(|error| BadInput::new(file, format!("line {line}"), error, "as many cells as the header"))?;
        for (column, &c) in columns.iter_mut().zip(&used) {
            let cell = record.get(c).unwrap_or_default();
            let value = cell.parse::<f64>().map_err(|_| {
                BadInput::new(file, format!("line {line}, column `{}`", header[c]), format!("`{cell}`"), "a number")
            })?;
            column.push(value);
        }
    }
    let named = used
        .iter()
        .zip(columns)
        .map(|(&c, column)| Named { name: header[c].clone(), values: DMatrix::from_vec(column.len(), 1, column) });
    understood(file, named.collect(), &header, wanted)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Time,
    Position,
    Velocity,
    Torque,
}

impl Kind {
    /// Kind of a column, and its number where it has one: `actual_q_0`, `tau_J[3]`, `q1`.
    fn of(name: &str) -> Option<(Kind, Option<usize>)> {
        let plain: String = name.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_lowercase();
        let stem = plain.trim_end_matches(|c: char| c.is_ascii_digit());
        let number = plain[stem.len()..].parse().ok();
        let kinds = [
            (Kind::Time, &TIME[..]),
            (Kind::Position, &POSITION[..]),
            (Kind::Velocity, &VELOCITY[..]),
            (Kind::Torque, &TORQUE[..]),
        ];
        kinds.into_iter().find(|(_, names)| names.contains(&stem)).map(|(kind, _)| (kind, number))
    }
}

/// The samples of columns or arrays with known names. `all` are the names of everything that the file has.
pub(super) fn understood(file: &str, named: Vec<Named>, all: &[String], wanted: &Wanted) -> Result<Imported, BadInput> {
    let have = || all.iter().take(40).map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    let of = |kind: Kind| -> Vec<(&Named, Option<usize>)> {
        let own = |named: &'_ Named| Kind::of(&named.name).filter(|(own, _)| *own == kind).map(|(_, number)| number);
        named.iter().filter_map(|named| own(named).map(|number| (named, number))).collect()
    };
    let mut notes = Vec::new();
    let mut take = |kind: Kind, what: &str, needed: bool| -> Result<Option<DMatrix<f64>>, BadInput> {
        let mut found = of(kind);
        if found.is_empty() && !needed {
            return Ok(None);
        }
        let wide = found.iter().position(|(named, _)| named.values.ncols() == wanted.joints && wanted.joints > 1);
        if let Some(wide) = wide {
            let (named, _) = found[wide];
            notes.push(format!("{what}: `{}`", named.name));
            return Ok(Some(named.values.clone()));
        }
        found.retain(|(named, _)| named.values.ncols() == 1);
        found.sort_by_key(|(_, number)| *number);
        if found.len() != wanted.joints {
            let listed = found.iter().map(|(named, _)| format!("`{}`", named.name)).collect::<Vec<_>>().join(", ");
            let expected = format!("{} columns of {what} such as q1, tau1; the file has {}", wanted.joints, have());
            return Err(BadInput::new(file, what, if listed.is_empty() { "none".into() } else { listed }, expected));
        }
        let numbers: Vec<Option<usize>> = found.iter().map(|(_, number)| *number).collect();
        let follow = numbers.windows(2).all(|two| matches!((two[0], two[1]), (Some(a), Some(b)) if b == a + 1));
        if !follow {
            let expected = "columns that are numbered without a gap";
            return Err(BadInput::new(file, what, format!("{numbers:?}"), expected));
        }
        let (first, last) = (&found[0].0.name, &found[found.len() - 1].0.name);
        notes.push(format!("{what}: `{first}` to `{last}`"));
        let rows = found[0].0.values.nrows();
        Ok(Some(DMatrix::from_fn(rows, found.len(), |k, j| found[j].0.values[(k, 0)])))
    };
    let q = take(Kind::Position, "positions", true)?;
    let dq = take(Kind::Velocity, "velocities", false)?;
    let tau = take(Kind::Torque, "torques", true)?;
    let time = of(Kind::Time);
    let [(time, _)] = time[..] else {
        let found = time.iter().map(|(named, _)| format!("`{}`", named.name)).collect::<Vec<_>>().join(", ");
        let expected = format!("one column of time such as t; the file has {}", have());
        return Err(BadInput::new(file, "time", if found.is_empty() { "none".into() } else { found }, expected));
    };
    let (Some(q), Some(tau)) = (q, tau) else {
        return Err(BadInput::new(file, "columns", "none", "positions and torques"));
    };
    for (what, rows) in [("positions", q.nrows()), ("torques", tau.nrows())]
        .into_iter()
        .chain(dq.as_ref().map(|dq| ("velocities", dq.nrows())))
    {
        if rows != time.values.nrows() {
            let expected = format!("{}, as the time has", time.values.nrows());
            return Err(BadInput::new(file, what, format!("{rows} rows"), expected));
        }
    }
    let latest = time.values.iter().copied().fold(0.0, f64::max);
    let (unit, why) = match wanted.time_unit {
        Some(unit) => (unit, "as given"),
        // Since 1970: seconds are 1e9, milliseconds 1e12, and so on.
        None if latest > EPOCH_S * 1e9 => (1e-9, "since 1970"),
        None if latest > EPOCH_S * 1e6 => (1e-6, "since 1970"),
        None if latest > EPOCH_S * 1e3 => (1e-3, "since 1970"),
        None => (1.0, "assumed; --time-unit"),
    };
    notes.push(format!("time: `{}` in units of {unit:?} s ({why})", time.name));
    // Differences of large numbers before the unit: nanoseconds since 1970 have no room for more.
    let first = time.values.iter().next().copied().unwrap_or_default();
    let t = time.values.iter().map(|value| (value - first) * unit).collect();
    Ok(Imported { t, q, dq, tau, notes })
}
