//! Sorts the daemon's records into runs, one per motion of the programme.

use crate::dataset::{self, Run};
use crate::setup::programme::{Motion, Programme, Role};
use nalgebra::DMatrix;
use plumbline_core::{JointVec, Phase, Record};

/// A motion that was driven, and what was recorded of it.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// Its number in the programme.
    pub number: u32,
    /// What it was for.
    pub role: Role,
    /// The samples after the lead-in; the served torque is in the further columns `tau_ff1` to `tau_ffn`.
    pub run: Run,
    /// Whether every sample of the motion is there, states that the arm lost apart: none before its first one, after its last one, or
    /// in between has been given up by the daemon.
    pub complete: bool,
}

/// Collects records until a motion is complete.
pub struct Collector {
    joints: usize,
    motions: Vec<Motion>,
    present: Option<Present>,
    /// Records before the next one are gone.
    gap: bool,
}

/// The motion that is being recorded.
struct Present {
    motion: Motion,
    records: Vec<Record>,
    /// Records of it are gone.
    broken: bool,
}

impl Present {
    /// Whether `record` goes on with it. The same motion driven once more begins at its first tick again.
    fn goes_on(&self, record: &Record) -> bool {
        let forward = self.records.last().is_none_or(|last| last.tick < record.tick);
        record.phase == Phase::Excite && record.motion == self.motion.number && forward
    }
}

impl Collector {
    /// A collector for an arm of `joints` joints.
    pub fn new(programme: &Programme, joints: usize) -> Collector {
        // A live motion may last for days; the watch has a window of its own.
        let recorded = programme.motions().filter(|motion| motion.role != Role::Live);
        Collector { joints, motions: recorded.cloned().collect(), present: None, gap: false }
    }

    /// Takes the next record; gives the motion that it ends.
    pub fn take(&mut self, record: &Record) -> Option<Recorded> {
        let gap = std::mem::take(&mut self.gap);
        let ended = self.present.take_if(|present| !present.goes_on(record));
        if record.phase == Phase::Excite {
            if self.present.is_none() {
                let motion = self.motions.iter().find(|motion| motion.number == record.motion);
                self.present = motion.map(|motion| Present {
                    motion: motion.clone(),
                    records: Vec::with_capacity(motion.ticks()),
                    // What is gone may have been its beginning.
                    broken: gap && record.tick > 0,
                });
            }
            if let Some(present) = &mut self.present {
                present.records.push(*record);
            }
        }
        ended.map(|present| self.recorded(&present))
    }

    /// Records are gone between the last one and the next; gives the name of the motion that is incomplete for it.
    pub fn missed(&mut self) -> Option<&str> {
        self.gap = true;
        let present = self.present.as_mut()?;
        present.broken = true;
        Some(&present.motion.name)
    }

    fn recorded(&self, Present { motion, records, broken }: &Present) -> Recorded {
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
        let data = plumbline_identify::Run {
            name: format!("{}.csv", motion.name),
            t: kept.iter().map(|record| record.tick as f64 * 1e-3).collect(),
            q: matrix(|record| &record.state.q),
            dq: Some(matrix(|record| &record.state.dq)),
            tau: matrix(|record| &record.state.tau),
            mounting: motion.mounting,
            period: Some(motion.plan.period),
        };
        let role = match motion.role {
            Role::Identify | Role::Counter => dataset::Role::Identify,
            Role::Validate | Role::Live => dataset::Role::Validate,
        };
        let run = Run { extra, ..Run::new(data, role) };
        // The last sample of a motion is one tick behind its last period.
        let complete = !broken && records.last().is_some_and(|record| record.tick + 1 >= motion.ticks() as u64);
        Recorded { number: motion.number, role: motion.role, run, complete }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::load_plan;
    use plumbline_model::Mounting;
    use std::path::Path;

    /// Ticks of the motion: two periods of 10 ms after one of lead-in.
    const TICKS: u64 = 30;

    fn collector() -> Collector {
        let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/plans/panda-wall.toml");
        let mut plan = load_plan(&shipped).unwrap();
        plan.period = 0.01;
        let motion = Motion {
            number: 3,
            name: "identify-wall".into(),
            role: Role::Identify,
            mounting: Mounting::WALL,
            fourier: crate::setup::planner::motion(&plan).unwrap(),
            plan,
            periods: 2,
            lead_in: 1,
        };
        Collector { joints: 2, motions: vec![motion], present: None, gap: false }
    }

    fn feed(collector: &mut Collector, phase: Phase, ticks: std::ops::Range<u64>) -> Option<Recorded> {
        let record = |tick| Record { phase, motion: 3, tick, ..Record::default() };
        ticks.filter_map(|tick| collector.take(&record(tick))).last()
    }

    /// Whether the motion is complete after what has been fed.
    fn complete(collector: &mut Collector) -> bool {
        feed(collector, Phase::Hold, 0..1).unwrap().complete
    }

    #[test]
    fn a_motion_is_complete_with_all_its_records_only() {
        let mut collector = collector();
        feed(&mut collector, Phase::Excite, 0..TICKS);
        assert!(complete(&mut collector));
        feed(&mut collector, Phase::Excite, 0..TICKS - 1);
        assert!(!complete(&mut collector));
        // A state that the arm lost is no record that the daemon gave up.
        feed(&mut collector, Phase::Excite, 0..5);
        feed(&mut collector, Phase::Excite, 6..TICKS);
        assert!(complete(&mut collector));
    }

    #[test]
    fn records_that_were_given_up_make_their_motion_incomplete_and_no_other() {
        let mut collector = collector();
        // Its beginning.
        assert_eq!(collector.missed(), None);
        feed(&mut collector, Phase::Excite, 12..TICKS);
        assert!(!complete(&mut collector));
        // Something within.
        feed(&mut collector, Phase::Excite, 0..12);
        assert_eq!(collector.missed(), Some("identify-wall"));
        feed(&mut collector, Phase::Excite, 14..TICKS);
        assert!(!complete(&mut collector));
        // All up to its first record.
        collector.missed();
        feed(&mut collector, Phase::Excite, 0..TICKS);
        assert!(complete(&mut collector));
        // Its end, and whatever was between it and the same motion once more.
        feed(&mut collector, Phase::Excite, 0..20);
        collector.missed();
        assert!(!feed(&mut collector, Phase::Excite, 0..TICKS).unwrap().complete);
        assert!(complete(&mut collector));
    }
}
