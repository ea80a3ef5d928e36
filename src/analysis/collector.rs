//! Sorts the daemon's records into runs, one per motion of the programme.

use crate::dataset::columns::{DESIRED_POSITIONS, JointColumns, SERVED_TORQUES};
use crate::dataset::{self, Run};
use crate::setup::programme::{Motion, Programme, Role};
use nalgebra::DMatrix;
use plumbline_core::{JointVec, Phase, Record};

#[derive(Clone, Debug)]
pub struct Recorded {
    pub number: u32,
    pub role: Role,
    /// The samples after the lead-in, named after the motion; the served torque is in the further columns `tau_ff1` to `tau_ffn`.
    pub run: Run,
    /// Whether the recording is complete but for states that the arm lost: no record before the first one, after the last one, or
    /// in between was dropped by the daemon.
    pub complete: bool,
    /// Whether its motion has ended with it: a motion that plumbline does not drive is divided where states are missing.
    pub ends: bool,
}

/// Longest gap inside a run of a motion that plumbline does not drive \[s\]. What is longer is no part of the regression either.
pub const MAX_GAP_S: f64 = 0.02;
/// Shortest such run that is kept \[s\]: shorter ones are little more than the ends that the filters take.
pub const MIN_RUN_S: f64 = 2.0;

/// Number of states in a time, `period` \[s\] apart.
pub fn states(seconds: f64, period: f64) -> u64 {
    (seconds / period).round() as u64
}

/// Collects records until a motion is complete.
pub struct Collector {
    joints: usize,
    motions: Vec<Motion>,
    present: Option<Present>,
    /// Runs that the present motion has been divided into so far.
    parts: usize,
    /// Records before the next one are missing.
    gap: bool,
}

struct Present {
    motion: Motion,
    records: Vec<Record>,
    broken: bool,
    /// Number of this run among those of its motion, from 1.
    part: usize,
}

impl Present {
    /// Whether `record` belongs to the same motion. A repetition of a motion starts again at its first tick.
    fn goes_on(&self, record: &Record) -> bool {
        let forward = self.records.last().is_none_or(|last| last.tick < record.tick);
        let is_same = record.phase == Phase::Excite && record.motion == self.motion.number && forward;
        is_same && (self.motion.planned().is_some() || !self.is_after_gap(record))
    }

    /// Whether too many states are missing before `record`.
    fn is_after_gap(&self, record: &Record) -> bool {
        let longest = states(MAX_GAP_S, self.motion.sample_period());
        self.records.last().is_some_and(|last| record.state.seq > last.state.seq.saturating_add(longest))
    }

    /// Whether every sample of a motion that plumbline does not drive is there.
    fn is_over(&self) -> bool {
        let ticks = self.motion.ticks() as u64;
        self.motion.planned().is_none() && self.records.last().is_some_and(|last| last.tick + 1 >= ticks)
    }
}

impl Collector {
    pub fn new(programme: &Programme, joints: usize) -> Collector {
        // Motions of the live watch are not collected: they have no bounded length.
        let recorded = programme.motions().filter(|motion| motion.role != Role::Live);
        Collector { joints, motions: recorded.cloned().collect(), present: None, parts: 0, gap: false }
    }

    /// Processes a record; returns the motion that ends with it.
    pub fn take(&mut self, record: &Record) -> Option<Recorded> {
        let gap = std::mem::take(&mut self.gap);
        let ended = self.present.take_if(|present| !present.goes_on(record));
        let divided = |own: &Present| record.phase == Phase::Excite && record.motion == own.motion.number;
        let ends = !ended.as_ref().is_some_and(divided);
        if self.present.is_none() && ends {
            self.parts = 0;
        }
        if record.phase == Phase::Excite {
            if self.present.is_none() {
                let motion = self.motions.iter().find(|motion| motion.number == record.motion);
                self.parts += 1;
                self.present = motion.map(|motion| Present {
                    motion: motion.clone(),
                    records: Vec::with_capacity(motion.ticks()),
                    // The missing records may be the start of the motion.
                    broken: gap && record.tick > 0,
                    part: self.parts,
                });
            }
            if let Some(present) = &mut self.present {
                present.records.push(*record);
            }
        }
        let over = ended.is_none() && self.present.as_ref().is_some_and(Present::is_over);
        let ended = if over { self.present.take() } else { ended };
        ended.map(|present| self.recorded(&present, ends))
    }

    /// The run under way of a motion that plumbline does not drive, when nothing more is recorded.
    pub fn close(&mut self) -> Option<Recorded> {
        let present = self.present.take_if(|present| present.motion.planned().is_none())?;
        Some(self.recorded(&present, true))
    }

    /// Reports missing records before the next one; returns the name of the motion that is incomplete because of them.
    pub fn missed(&mut self) -> Option<&str> {
        self.gap = true;
        let present = self.present.as_mut()?;
        present.broken = true;
        Some(&present.motion.name)
    }

    fn recorded(&self, present: &Present, ends: bool) -> Recorded {
        let Present { motion, records, broken, part } = present;
        let planned = motion.planned();
        let lead_in = planned.map_or(0, |planned| (planned.lead_in * planned.period_ticks()) as u64);
        let kept: Vec<&Record> = records.iter().filter(|record| record.tick >= lead_in).collect();
        let matrix =
            |of: fn(&Record) -> &JointVec| DMatrix::from_fn(kept.len(), self.joints, |row, j| of(kept[row])[j]);
        let mut extra = Vec::new();
        let mut columns = |of: &JointColumns, value: fn(&Record, usize) -> f64| {
            for j in 0..self.joints {
                extra.push((format!("{}{}", of.stem, j + 1), kept.iter().map(|record| value(record, j)).collect()));
            }
        };
        if planned.is_none() {
            columns(&DESIRED_POSITIONS, |record, j| record.state.q_d[j]);
        } else if kept.iter().any(|record| record.model != 0) {
            columns(&SERVED_TORQUES, |record, j| record.command.tau_ff.0[j]);
        }
        let first = kept.first().map_or(0, |record| record.state.seq);
        let time = |record: &Record| {
            let count = if planned.is_some() { record.tick } else { record.state.seq - first };
            count as f64 * motion.sample_period()
        };
        let name = match part {
            1 => motion.name.clone(),
            part => format!("{}-part-{part}", motion.name),
        };
        let data = plumbline_identify::Run {
            name,
            t: kept.iter().map(|record| time(record)).collect(),
            q: matrix(|record| &record.state.q),
            dq: Some(matrix(|record| &record.state.dq)),
            tau: matrix(|record| &record.state.tau),
            mounting: motion.mounting,
            period: planned.map(|planned| planned.plan.period),
        };
        let role = match motion.role {
            Role::Identify | Role::Counter => dataset::Role::Identify,
            Role::Validate | Role::Live => dataset::Role::Validate,
        };
        // On the arm's clock.
        let start = kept.first().map_or(0.0, |record| record.state.time);
        let run = Run { extra, start, ..Run::new(data, role) };
        // The last sample of a motion is one tick after its last period.
        let complete = match planned {
            Some(_) => !broken && records.last().is_some_and(|record| record.tick + 1 >= motion.ticks() as u64),
            None => records.len() as u64 >= states(MIN_RUN_S, motion.sample_period()),
        };
        Recorded { number: motion.number, role: motion.role, run, complete, ends }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::programme::{Course, Planned};
    use crate::store::load_plan;
    use plumbline_core::PERIOD_S;
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
            course: Course::Planned(Box::new(Planned {
                fourier: crate::setup::planner::motion(&plan).unwrap(),
                plan,
                periods: 2,
                lead_in: 1,
            })),
        };
        Collector { joints: 2, motions: vec![motion], present: None, parts: 0, gap: false }
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

    /// Runs of two listened motions with 5000 and 3000 samples, and whether each is complete and the last of its motion.
    fn listened(records: impl Iterator<Item = (u32, u64, u64)>) -> Vec<(String, usize, bool, bool)> {
        let motion = |number: u32, ticks| Motion {
            number,
            name: format!("identify-{number}"),
            role: Role::Identify,
            mounting: Mounting::WALL,
            course: Course::Unplanned { ticks, period: PERIOD_S },
        };
        let motions = vec![motion(1, 5000), motion(2, 3000)];
        let mut collector = Collector { joints: 2, motions, present: None, parts: 0, gap: false };
        let mut runs = Vec::new();
        for (motion, tick, seq) in records {
            let mut record = Record { phase: Phase::Excite, motion, tick, ..Record::default() };
            record.state.seq = seq;
            runs.extend(collector.take(&record));
        }
        runs.extend(collector.close());
        runs.into_iter().map(|one| (one.run.data.name.clone(), one.run.samples(), one.complete, one.ends)).collect()
    }

    #[test]
    fn an_unplanned_motion_is_divided_where_states_are_missing_and_loses_nothing() {
        let named = |name: &str, samples, complete, ends| (name.to_string(), samples, complete, ends);
        let whole = (0..5000).map(|k| (1, k, 100 + k)).chain((0..3000).map(|k| (2, k, 5100 + k)));
        assert_eq!(listened(whole), [named("identify-1", 5000, true, true), named("identify-2", 3000, true, true)]);
        // A long gap after 2500 samples, a short one of three states, and the end of the recording in the second motion.
        let gaps = (0..2500).map(|k| (1, k, k)).chain((2500..4000).map(|k| (1, k, k + 900)));
        let gaps = gaps.chain((4003..5000).map(|k| (1, k, k + 900))).chain((0..700).map(|k| (2, k, 5900 + k)));
        assert_eq!(
            listened(gaps),
            [
                named("identify-1", 2500, true, false),
                named("identify-1-part-2", 2497, true, true),
                named("identify-2", 700, false, true),
            ]
        );
    }
}
