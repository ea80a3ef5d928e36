//! Writing a dataset as a folder.

use super::manifest::{FILE, GravityAngles, Manifest, RunEntry, TorqueUnit};
use super::{Dataset, Format, Run};
use crate::atomic;
use crate::recording::run::RunTable;
use nalgebra::DMatrix;
use plumbline_model::Mounting;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::Path;

pub(super) fn write(dataset: &Dataset, dir: &Path) -> io::Result<()> {
    if let Ok(mut entries) = fs::read_dir(dir)
        && entries.next().is_some()
        && !dir.join(FILE).exists()
    {
        let text = format!("{}: is a folder with content that is not a dataset; it is not changed", dir.display());
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, text));
    }
    let manifest = toml::to_string(&describe(dataset)).map_err(io::Error::other)?;
    atomic::write_folder(dir, |aside| {
        fs::write(aside.join(FILE), manifest)?;
        dataset.runs.iter().try_for_each(|run| write_run(run, &aside.join(&run.data.name)))
    })
}

fn describe(dataset: &Dataset) -> Manifest {
    let angles = |mounting: Mounting| GravityAngles { rho: mounting.rho, phi: mounting.phi };
    let entry = |(index, run): (usize, &Run)| RunEntry {
        file: run.data.name.clone(),
        role: run.role,
        note: run.note.clone(),
        period: run.data.period,
        session: run.session,
        start: dataset.pause_before(index).then_some(run.start),
        mounting: (run.data.mounting != dataset.mounting).then(|| angles(run.data.mounting)),
    };
    Manifest {
        name: dataset.name.clone(),
        robot: dataset.robot.clone(),
        source: dataset.source.clone(),
        mounting: angles(dataset.mounting),
        torque: TorqueUnit::default(),
        runs: dataset.runs.iter().enumerate().map(entry).collect(),
    }
}

/// One run, in the format that its name says.
fn write_run(run: &Run, path: &Path) -> io::Result<()> {
    let table = RunTable {
        t: run.data.t.as_slice(),
        position: columns(&run.data.q),
        velocity: run.data.dq.as_ref().map_or(Vec::new(), columns),
        effort: columns(&run.data.tau),
        further: run.extra.iter().map(|(name, values)| (name.clone(), values.as_slice())).collect(),
    };
    let mut file = BufWriter::with_capacity(1 << 16, File::create(path)?);
    match Format::of(&run.data.name) {
        Format::Csv => write_csv(table, &mut file)?,
        Format::Mcap => table.write(&mut file)?,
    }
    file.flush()
}

/// The columns of a matrix, which lie behind each other.
fn columns(block: &DMatrix<f64>) -> Vec<&[f64]> {
    block.as_slice().chunks_exact(block.nrows().max(1)).collect()
}

/// A header row, then one row per sample.
fn write_csv(table: RunTable<&[f64]>, file: &mut impl Write) -> io::Result<()> {
    let samples = table.t.len();
    let (header, columns) = table.named();
    writeln!(file, "{}", header.join(","))?;
    for row in 0..samples {
        for (index, column) in columns.iter().enumerate() {
            if index > 0 {
                file.write_all(b",")?;
            }
            // The shortest text that reads back as the same number, with an exponent where that is shorter.
            write!(file, "{:?}", column[row])?;
        }
        file.write_all(b"\n")?;
    }
    Ok(())
}
