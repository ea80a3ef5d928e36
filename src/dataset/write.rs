//! Writing a dataset as a folder.

use super::manifest::{FILE, GravityAngles, Manifest, RunEntry, TorqueUnit};
use super::{Dataset, Run};
use crate::atomic;
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

/// One run: `t, q1..qn, dq1..dqn, tau1..taun`, then the further columns.
fn write_run(run: &Run, path: &Path) -> io::Result<()> {
    let n = run.joints();
    let mut header = vec!["t".to_string()];
    let mut columns: Vec<&[f64]> = vec![&run.data.t];
    let mut blocks = vec![("q", &run.data.q)];
    blocks.extend(run.data.dq.as_ref().map(|dq| ("dq", dq)));
    blocks.push(("tau", &run.data.tau));
    for (stem, block) in blocks {
        header.extend((1..=n).map(|joint| format!("{stem}{joint}")));
        columns.extend(block.as_slice().chunks_exact(run.samples()));
    }
    for (name, values) in &run.extra {
        header.push(name.clone());
        columns.push(values);
    }
    let mut file = BufWriter::with_capacity(1 << 16, File::create(path)?);
    writeln!(file, "{}", header.join(","))?;
    for row in 0..run.samples() {
        for (index, column) in columns.iter().enumerate() {
            if index > 0 {
                file.write_all(b",")?;
            }
            // The shortest text that reads back as the same number, with an exponent where that is shorter.
            write!(file, "{:?}", column[row])?;
        }
        file.write_all(b"\n")?;
    }
    file.flush()
}
