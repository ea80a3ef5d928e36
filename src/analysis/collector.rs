//! Sorts the daemon's records into runs, one per motion of the programme.

use crate::dataset::{self, Run};
use crate::setup::programme::{Motion, Programme, Role};
use nalgebra::DMatrix;
use plumbline_core::{JointVec, Phase, Record};

#[derive(Clone, Debug)]
pub struct Recorded {
    pub number: u32,
    pub role: Role,
    /// The samples after the lead-in; the served torque is in the further columns `tau_ff1` to `tau_ffn`.
    pub run: Run,
    /// Whether the recording is complete but for states that the arm lost: no record before the first one, after the last one, or
    /// in between was dropped by the daemon.
    pub complete: bool,
}

/// Collects records until a motion is complete.
pub struct Collector {
    joints: usize,
    motions: Vec<Motion>,
    present: Option<Present>,
    /// Records before the next one are missing.
    gap: bool,
}

struct Present {
    motion: Motion,
    records: Vec<Record>,
    broken: bool,
}

impl Present {
    /// Whether `record` belongs to the same motion. A repetition of a motion starts again at its first tick.
    fn goes_on(&self, record: &Record) -> bool {
        let forward = self.records.last().is_none_or(|last| last.tick < record.tick);
        record.phase == Phase::Excite && record.motion == self.motion.number && forward
    }
}

impl Collector {
    pub fn new(programme: &Programme, joints: usize) -> Collector {
        // Motions of the live watch are not collected: they have no bounded length.
        let recorded = programme.motions().filter(|motion| motion.role != Role::Live);
        Collector { joints, motions: recorded.cloned().collect(), present: None, gap: false }
    }

    /// Processes a record; returns the motion that ends with it.
    pub fn take(&mut self, record: &Record) -> Option<Recorded> {
        let gap = std::mem::take(&mut self.gap);
        let ended = self.present.take_if(|present| !present.goes_on(record));
        if record.phase == Phase::Excite {
            if self.present.is_none() {
                let motion = self.motions.iter().find(|motion| motion.number == record.motion);
                self.present = motion.map(|motion| Present {
                    motion: motion.clone(),
                    records: Vec::with_capacity(motion.ticks()),
                    // The missing records may be the start of the motion.
                    broken: gap && record.tick > 0,
                });
            }
            if let Some(present) = &mut self.present {
                present.records.push(*record);
            }
        }
        ended.map(|present| self.recorded(&present))
    }

    /// Reports missing records before the next one; returns the name of the motion that is incomplete because of them.
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
        // On the arm's clock.
        let start = kept.first().map_or(0.0, |record| record.state.time);
        let run = Run { extra, start, ..Run::new(data, role) };
        // The last sample of a motion is one tick after its last period.
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

    /// Whether the motion is complete after the given records.
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
        // A lost state is not a missing record.
        feed(&mut collector, Phase::Excite, 0..5);
        feed(&mut collector, Phase::Excite, 6..TICKS);
        assert!(complete(&mut collector));
    }

    #[test]
    fn records_that_were_given_up_make_their_motion_incomplete_and_no_other() {
        let mut collector = collector();
        // Missing start.
        assert_eq!(collector.missed(), None);
        feed(&mut collector, Phase::Excite, 12..TICKS);
        assert!(!complete(&mut collector));
        // Missing middle.
        feed(&mut collector, Phase::Excite, 0..12);
        assert_eq!(collector.missed(), Some("identify-wall"));
        feed(&mut collector, Phase::Excite, 14..TICKS);
        assert!(!complete(&mut collector));
        // Missing records before the first one.
        collector.missed();
        feed(&mut collector, Phase::Excite, 0..TICKS);
        assert!(complete(&mut collector));
        // Missing end before a repetition of the motion.
        feed(&mut collector, Phase::Excite, 0..20);
        collector.missed();
        assert!(!feed(&mut collector, Phase::Excite, 0..TICKS).unwrap().complete);
        assert!(complete(&mut collector));
    }
}
