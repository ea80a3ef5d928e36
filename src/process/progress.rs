//! Progress of long work: a bar on a terminal, lines for the process that has started this one, nothing otherwise.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use serde::{Deserialize, Serialize};
use std::io::{BufRead, BufReader, Read, Write as _};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

const STEPS: u64 = 1000;
/// Redraws of a bar whose work has no known share.
const TICK: Duration = Duration::from_millis(120);
/// Share of the work from which on its rate tells the time that is left.
const MIN_SHARE_FOR_RATE: f32 = 0.03;

/// Where progress goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// A bar on standard error, where that is a terminal.
    Terminal,
    /// One [`Stage`] per line on standard output, as JSON.
    Lines,
    Nowhere,
}

static TARGET: OnceLock<Target> = OnceLock::new();

/// Sends all progress of this process to `target`, once, before the first bar.
pub fn send_to(target: Target) {
    let _ = TARGET.set(target);
}

/// What a process is doing.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Stage {
    pub title: String,
    /// Share that is done; `None` where it is not known.
    pub share: Option<f64>,
    pub message: String,
}

/// Progress of one kind of work.
pub struct Bar {
    bar: ProgressBar,
    target: Target,
    /// What was shown last.
    shown: Mutex<Stage>,
}

/// Progress under a title.
pub fn bar(title: &str) -> Bar {
    let target = *TARGET.get_or_init(|| Target::Terminal);
    let draw = match target {
        Target::Terminal => ProgressDrawTarget::stderr(),
        Target::Lines | Target::Nowhere => ProgressDrawTarget::hidden(),
    };
    let bar = ProgressBar::with_draw_target(Some(STEPS), draw);
    bar.set_style(style("{prefix:11} {wide_bar} {percent:>3} %  {msg}{left}"));
    bar.set_prefix(title.to_string());
    let shown = Stage { title: title.into(), share: Some(0.0), message: String::new() };
    Bar { bar, target, shown: Mutex::new(shown) }
}

fn style(template: &str) -> ProgressStyle {
    let left = |state: &ProgressState, to: &mut dyn std::fmt::Write| {
        if state.fraction() > MIN_SHARE_FOR_RATE {
            let _ = write!(to, ", {:.0} s left", state.eta().as_secs_f64().ceil());
        }
    };
    ProgressStyle::with_template(template).expect("constant template").with_key("left", left)
}

impl Bar {
    /// How far the work is, from 0 to 1, and with what.
    pub fn at(&self, share: f64, message: &str) {
        self.show(Some(share.clamp(0.0, 1.0)), message);
    }

    /// Work whose share is not known.
    pub fn busy(&self, message: &str) {
        self.show(None, message);
    }

    fn show(&self, share: Option<f64>, message: &str) {
        let mut shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let step = |share: Option<f64>| share.map(|share| (share * STEPS as f64) as u64);
        let (known, moved) = (shown.share.is_some() != share.is_some(), step(shown.share) != step(share));
        let other = shown.message != message;
        if !moved && !other {
            return;
        }
        (shown.share, shown.message) = (share, message.to_string());
        match self.target {
            Target::Terminal => {
                if other {
                    self.bar.set_message(message.to_string());
                }
                step(share).into_iter().for_each(|step| self.bar.set_position(step));
                if known {
                    self.restyle(share.is_some());
                }
            }
            // A reader that has ended is no failure of the work.
            Target::Lines => drop(serde_json::to_string(&*shown).map(|line| writeln!(std::io::stdout(), "{line}"))),
            Target::Nowhere => {}
        }
    }

    fn restyle(&self, share: bool) {
        if share {
            self.bar.disable_steady_tick();
            self.bar.set_style(style("{prefix:11} {wide_bar} {percent:>3} %  {msg}{left}"));
            self.bar.reset_eta();
        } else {
            self.bar.set_style(style("{prefix:11} {spinner} {msg}, {elapsed}"));
            self.bar.enable_steady_tick(TICK);
        }
    }

    /// Prints a line of the log above the bar.
    pub fn log(&self, line: &str) {
        match self.bar.is_hidden() {
            // Standard error is no terminal; a closed one is no failure.
            true => drop(writeln!(std::io::stderr(), "{line}")),
            false => self.bar.println(line),
        }
    }

    pub fn done(self) {
        self.bar.finish_and_clear();
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

/// The latest stage of another process.
#[derive(Clone, Default)]
pub struct Stages(Arc<Mutex<Option<Stage>>>);

impl Stages {
    /// Reads the lines of a process with [`Target::Lines`] on a thread of their own, until they end.
    pub fn read(lines: impl Read + Send + 'static) -> Stages {
        let stages = Stages::default();
        let latest = stages.clone();
        let read = move || {
            for line in BufReader::new(lines).lines().map_while(Result::ok) {
                if let Ok(stage) = serde_json::from_str(&line) {
                    *latest.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(stage);
                }
            }
        };
        // Without a thread there is no progress to show; the pipe is closed, and its writer ignores that.
        let _ = std::thread::Builder::new().name("plumbline-stages".into()).spawn(read);
        stages
    }

    pub fn latest(&self) -> Option<Stage> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_latest_stage_of_another_process_is_read() {
        let stage = |share, message: &str| Stage { title: "diagnosing".into(), share, message: message.into() };
        let lines =
            [stage(Some(0.25), "5 of 20"), stage(None, "judging")].map(|one| serde_json::to_string(&one).unwrap());
        let stages = Stages::read(std::io::Cursor::new(format!("{}\nno stage\n{}\n", lines[0], lines[1])));
        while stages.latest() != Some(stage(None, "judging")) {
            std::thread::yield_now();
        }
    }
}
