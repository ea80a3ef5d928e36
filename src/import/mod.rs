//! Recordings of other programs as runs of a dataset: CSV, npz, and joint states of ROS 2 in MCAP files and rosbag2 databases.
//!
//! | file | what |
//! |---|---|
//! | `table` | columns by their names: CSV, npz |
//! | `npz` | arrays of NumPy |
//! | `states` | `sensor_msgs/msg/JointState` from MCAP and rosbag2 |

mod npz;
mod states;
mod table;

use nalgebra::DMatrix;
use plumbline_core::BadInput;
use std::path::Path;

/// How files are to be understood.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Joints of the robot.
    pub joints: usize,
    /// Names of the joints in the messages, base first; found where absent.
    pub names: Option<Vec<String>>,
    /// Topic of the joint states; the only one where absent.
    pub topic: Option<String>,
    /// Seconds per unit of a table's time; found where absent.
    pub time_unit: Option<f64>,
    /// Whether positions and velocities are in degrees.
    pub degrees: bool,
    /// Nm per unit of torque, one per joint.
    pub gain: Option<Vec<f64>>,
}

/// Samples of a file.
#[derive(Clone, Debug)]
pub struct Imported {
    /// From the first sample on \[s\].
    pub t: Vec<f64>,
    /// N x n \[rad\].
    pub q: DMatrix<f64>,
    /// N x n \[rad/s\].
    pub dq: Option<DMatrix<f64>>,
    /// N x n \[Nm\].
    pub tau: DMatrix<f64>,
    /// What was understood, line by line.
    pub notes: Vec<String>,
}

/// Least number of samples of a run.
const LEAST_SAMPLES: usize = 16;
/// A step beyond this multiple of the median one is a gap.
const GAP_RATIO: f64 = 1.5;

/// Reads a file by its name's ending: `.csv`, `.npz`, `.mcap`, `.db3`.
///
/// # Errors
/// A file that can't be read or has no joint positions and torques; with what was found.
pub fn read(path: &Path, wanted: &Wanted) -> Result<Imported, BadInput> {
    let file = path.display().to_string();
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
    let mut found = match ending.as_str() {
        "csv" => table::csv(&file, &bytes(path)?, wanted)?,
        "npz" => npz::read(&file, &bytes(path)?, wanted)?,
        "mcap" => states::mcap(&file, &bytes(path)?, wanted)?,
        "db3" => states::database(path, wanted)?,
        other => return Err(BadInput::new(file, "file name", format!("`.{other}`"), ".csv, .npz, .mcap or .db3")),
    };
    found.finish(&file, wanted)?;
    Ok(found)
}

fn bytes(path: &Path) -> Result<Vec<u8>, BadInput> {
    std::fs::read(path).map_err(|error| BadInput::new(path.display().to_string(), "file", error, "a readable file"))
}

impl Imported {
    /// Units, order in time, and notes on the sampling.
    fn finish(&mut self, file: &str, wanted: &Wanted) -> Result<(), BadInput> {
        let n = wanted.joints;
        let samples = self.t.len();
        if samples < LEAST_SAMPLES {
            let expected = format!("at least {LEAST_SAMPLES}");
            return Err(BadInput::new(file, "samples", samples.to_string(), expected));
        }
        let all = [("position", Some(&self.q)), ("velocity", self.dq.as_ref()), ("torque", Some(&self.tau))];
        for (what, values) in all.into_iter().filter_map(|(what, values)| values.map(|values| (what, values))) {
            if values.ncols() != n {
                let expected = format!("{n}, the joints of the robot");
                return Err(BadInput::new(file, what, format!("{} joints", values.ncols()), expected));
            }
            if let Some(at) = values.iter().position(|value| !value.is_finite()) {
                let (row, joint) = (at % samples, at / samples + 1);
                let place = format!("sample {}, {what} of joint {joint}", row + 1);
                return Err(BadInput::new(file, place, values[(row, joint - 1)], "a finite number"));
            }
        }
        if wanted.degrees {
            self.q *= 1f64.to_radians();
            self.dq.iter_mut().for_each(|dq| *dq *= 1f64.to_radians());
        }
        for (j, gain) in wanted.gain.iter().flatten().enumerate() {
            self.tau.column_mut(j).scale_mut(*gain);
        }
        let start = self.t[0];
        self.t.iter_mut().for_each(|t| *t -= start);
        if let Some(k) = (1..samples).find(|&k| self.t[k].is_nan() || self.t[k] < self.t[k - 1]) {
            let found = format!("{} s after {} s", self.t[k], self.t[k - 1]);
            return Err(BadInput::new(
                file,
                format!("sample {}, time", k + 1),
                found,
                "time that does not run backwards",
            ));
        }
        self.describe();
        Ok(())
    }

    fn describe(&mut self) {
        let mut steps: Vec<f64> = self.t.windows(2).map(|two| two[1] - two[0]).collect();
        let repeated = steps.iter().filter(|step| **step <= 0.0).count();
        steps.retain(|step| *step > 0.0);
        steps.sort_by(f64::total_cmp);
        let median = steps.get(steps.len() / 2).copied().unwrap_or(f64::NAN);
        let gaps = steps.iter().filter(|step| **step > GAP_RATIO * median);
        let (count, missing) =
            gaps.fold((0, 0.0), |(count, missing), step| (count + 1, missing + (step / median).round() - 1.0));
        self.notes.push(format!(
            "{} samples in {:.3} s, {:.1} Hz (median step {:.3} ms, longest {:.3} ms), {count} gaps with {missing:.0} samples missing, {repeated} repeated stamps",
            self.t.len(),
            self.t.last().copied().unwrap_or_default(),
            1.0 / median,
            1e3 * median,
            1e3 * steps.last().copied().unwrap_or(f64::NAN),
        ));
        let range = |values: &DMatrix<f64>| {
            let each = values.column_iter().map(|column| format!("{:.2}..{:.2}", column.min(), column.max()));
            each.collect::<Vec<_>>().join(" ")
        };
        self.notes.push(format!("position [rad]: {}", range(&self.q)));
        self.notes.push(match &self.dq {
            Some(dq) => format!("velocity [rad/s]: {}", range(dq)),
            None => "no velocities: they are derived from the positions".into(),
        });
        self.notes.push(format!("torque [Nm]: {}", range(&self.tau)));
    }
}

#[cfg(test)]
mod tests;
