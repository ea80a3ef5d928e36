//! A progress bar on a terminal; nothing otherwise.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

const STEPS: u64 = 1000;

pub struct Bar(ProgressBar);

/// A bar with a title; nothing is drawn when standard error is not a terminal.
pub fn bar(title: &'static str) -> Bar {
    let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
    let style =
        ProgressStyle::with_template("{prefix:12} {wide_bar} {percent:>3} %  {msg}").expect("constant template");
    bar.set_style(style);
    bar.set_prefix(title);
    Bar(bar)
}

impl Bar {
    /// How far it is, from 0 to 1, and with what.
    pub fn at(&self, share: f64, message: &str) {
        self.0.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
        if self.0.message() != message {
            self.0.set_message(message.to_string());
        }
    }

    pub fn done(self) {
        self.0.finish_and_clear();
    }
}
