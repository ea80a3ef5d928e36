//! What `run` shows while it runs: one line per motion, and a bar below.

use crate::process::progress::{self, Bar, Stage, Stages};
use crate::setup::programme::{Motion, Programme};
use plumbline_core::PERIOD_S;
use plumbline_ipc::{Progress, Status};
use std::time::Instant;

/// Where a programme is.
pub struct Watch {
    /// Names and samples of the motions, in their order; numbers begin with 1.
    motions: Vec<(String, u64)>,
    /// Time between two samples \[s\].
    period: f64,
    /// Number of the last motion that has begun, and the loop's cycles at that time.
    begun: (usize, u64),
    /// Whether lines of motions are printed.
    lines: bool,
    start: Instant,
    /// Title of the bar, which is a new one for every kind of work.
    title: String,
    bar: Bar,
}

impl Watch {
    pub fn new(programme: &Programme, lines: bool) -> Watch {
        let motions = programme.motions().map(|motion| (motion.name.clone(), motion.ticks() as u64)).collect();
        let period = programme.motions().next().map_or(PERIOD_S, Motion::sample_period);
        let title = "driving".to_string();
        let bar = progress::bar(&title);
        Watch { motions, period, begun: (0, 0), lines, start: Instant::now(), title, bar }
    }

    /// Shows the daemon's `status`, and what the estimator does once everything is driven.
    pub fn show(&mut self, status: &Status, estimator: &Stages) {
        for number in self.begin(status) {
            self.line(number);
        }
        match (status.progress, estimator.latest()) {
            (Progress::Done | Progress::AwaitingModel, Some(Stage { title, share, message })) => {
                if self.title != title {
                    self.bar = progress::bar(&title);
                    self.title = title;
                }
                match share {
                    Some(share) => self.bar.at(share, &message),
                    None => self.bar.busy(&message),
                }
            }
            (Progress::Done, None) => {}
            _ => {
                if self.title != "driving" {
                    self.title = "driving".into();
                    self.bar = progress::bar(&self.title);
                }
                self.bar.at(self.share(status), &self.motion(status));
            }
        }
    }

    /// The motions that have begun since the last status. Short ones in simulated time may begin and end between two.
    fn begin(&mut self, status: &Status) -> std::ops::RangeInclusive<usize> {
        let (before, number) = (self.begun.0, status.motion as usize);
        // Ways to a motion have numbers above those of all motions.
        if (before + 1..=self.motions.len()).contains(&number) {
            self.begun = (number, status.cycles);
        }
        before + 1..=self.begun.0
    }

    /// Share of the samples of all motions that are driven.
    fn share(&self, status: &Status) -> f64 {
        let (number, cycles) = self.begun;
        let ticks = |motions: &[(String, u64)]| motions.iter().map(|(_, ticks)| ticks).sum::<u64>() as f64;
        let Some((_, own)) = number.checked_sub(1).and_then(|index| self.motions.get(index)) else { return 0.0 };
        let inside = status.cycles.saturating_sub(cycles).min(*own) as f64;
        (ticks(&self.motions[..number - 1]) + inside) / ticks(&self.motions).max(1.0)
    }

    fn motion(&self, status: &Status) -> String {
        if status.progress == Progress::Paused {
            return "paused until `plumbline command resume`".into();
        }
        let (number, of) = (self.begun.0, self.motions.len());
        match self.motions.get(number.wrapping_sub(1)) {
            Some((name, _)) => format!("{name}, {number} of {of}"),
            None => status.job.clone(),
        }
    }

    fn line(&self, number: usize) {
        let (name, ticks) = &self.motions[number - 1];
        if self.lines {
            let (at, of) = (self.start.elapsed().as_secs_f64(), self.motions.len());
            let seconds = *ticks as f64 * self.period;
            self.bar.log(&format!("{at:6.1} s  motion {number:>2} of {of}: {name}, {seconds:.0} s"));
        }
    }

    /// Ends with the lines of the motions that no status has shown.
    pub fn done(self) {
        for number in self.begun.0 + 1..=self.motions.len() {
            self.line(number);
        }
        self.bar.done();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn watch() -> Watch {
        let motions = [("identify", 3000), ("validate-1", 500), ("validate-2", 500)];
        Watch {
            motions: motions.map(|(name, ticks)| (name.to_string(), ticks)).to_vec(),
            period: PERIOD_S,
            begun: (0, 0),
            lines: false,
            start: Instant::now(),
            title: "driving".into(),
            bar: progress::bar("driving"),
        }
    }

    fn status(motion: u32, cycles: u64) -> Status {
        Status { motion, cycles, ..Status::default() }
    }

    #[test]
    fn every_motion_has_its_line_and_the_share_is_that_of_samples() {
        let mut watch = watch();
        let mut at = |motion, cycles| {
            let status = status(motion, cycles);
            let lines: Vec<usize> = watch.begin(&status).collect();
            (lines, watch.share(&status))
        };
        assert_eq!(at(0, 0), (vec![], 0.0));
        // On the way to the first motion.
        assert_eq!(at(1001, 900), (vec![], 0.0));
        assert_eq!(at(1, 1000), (vec![1], 0.0));
        assert_eq!(at(1, 2500), (vec![], 0.375));
        // At rest, for however long, it is not more than the motion.
        assert_eq!(at(1002, 90_000), (vec![], 0.75));
        assert_eq!(at(3, 91_000), (vec![2, 3], 0.875));
        assert_eq!(at(3, 99_000), (vec![], 1.0));
        // Driven again after an interruption: not a second line.
        assert_eq!(at(2, 99_500).0, Vec::<usize>::new());
    }
}
