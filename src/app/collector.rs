//! Sorts the daemon's records into runs, one per motion of the programme.

use super::programme::{Motion, Programme, Role};
use crate::dataset::{self, Run};
use crate::joint::{JointVec, Phase, Record};
use nalgebra::DMatrix;

/// A motion that was driven, and what was recorded of it.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Its number in the programme.
    pub number: u32,
    /// What it was for.
    pub role: Role,
    /// The samples after the lead-in; the served torque is in the further columns `tau_ff1` to `tau_ffn`.
    pub run: Run,
    /// Whether every sample of the motion is there, states that the arm lost apart.
    pub complete: bool,
}

/// Collects records until a motion is complete.
pub struct Collector {
    joints: usize,
    motions: Vec<Motion>,
    present: Option<(Motion, Vec<Record>)>,
}

impl Collector {
    /// A collector for an arm of `joints` joints.
    pub fn new(programme: &Programme, joints: usize) -> Collector {
        // A live motion may last for days; the watch has a window of its own.
        let recorded = programme.motions().filter(|motion| motion.role != Role::Live);
        Collector { joints, motions: recorded.cloned().collect(), present: None }
    }

    /// Takes the next record; gives the motion that it ends.
    pub fn take(&mut self, record: &Record) -> Option<Recorded> {
        let of_present = |(motion, _): &(Motion, Vec<Record>)| motion.number == record.motion;
        let excited = record.phase == Phase::Excite;
        let ended = self.present.take_if(|present| !excited || !of_present(present));
        if excited {
            if self.present.is_none() {
                let motion = self.motions.iter().find(|motion| motion.number == record.motion);
                self.present = motion.map(|motion| (motion.clone(), Vec::with_capacity(motion.ticks())));
            }
            if let Some((_, records)) = &mut self.present {
                records.push(*record);
            }
        }
        ended.map(|(motion, records)| self.recorded(&motion, &records))
    }

    fn recorded(&self, motion: &Motion, records: &[Record]) -> Recorded {
        let lead_in = (motion.lead_in * motion.period_ticks()) as u64;
        let kept: Vec<&Record> = records.iter().filter(|record| record.tick >= lead_in).collect();
        let matrix =
            |of: fn(&Record) -> &JointVec| DMatrix::from_fn(kept.len(), self.joints, |row, j| of(kept[row])[j]);
        let mut extra = Vec::new();
        if kept.iter().any(|record| record.model != 0) {
            for j in 0..self.joints {
                let column = kept.iter().map(|record| record.command.tau_ff.0[j]).collect();
                extra.push((format!("tau_ff{}", j + 1), column));
            }
        }
        let run = Run {
            file: format!("{}.csv", motion.name),
            role: match motion.role {
                Role::Identify | Role::Counter => dataset::Role::Identify,
                Role::Validate | Role::Live => dataset::Role::Validate,
            },
            note: String::new(),
            period: Some(motion.plan.period),
            session: 1,
            mounting: motion.mounting,
            t: kept.iter().map(|record| record.tick as f64 * 1e-3).collect(),
            q: matrix(|record| &record.state.q),
            dq: Some(matrix(|record| &record.state.dq)),
            tau: matrix(|record| &record.state.tau),
            extra,
        };
        // The last sample of a motion is one tick behind its last period.
        let complete = records.last().is_some_and(|record| record.tick + 1 >= motion.ticks() as u64);
        Recorded { number: motion.number, role: motion.role, run, complete }
    }
}
