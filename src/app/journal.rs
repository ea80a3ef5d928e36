//! Where log lines go: standard error for people, the journal with its fields under systemd.
//!
//! In the journal, every line of a robot's processes carries `PLUMBLINE_ROBOT`, and lines about the arm carry `PLUMBLINE_EVENT`, so that
//! `journalctl PLUMBLINE_EVENT=stopping` finds every stop. On standard error these fields are left out: the sentence says it all.

use std::io::IsTerminal;
use std::os::unix::fs::MetadataExt;
use tracing_subscriber::fmt::format::debug_fn;
use tracing_subscriber::prelude::*;
use tracing_subscriber::{EnvFilter, fmt};

/// Fields that are for programs begin like this.
const FIELD: &str = "plumbline_";

/// Starts logging; `PLUMBLINE_LOG` takes a tracing filter such as `plumbline=debug`.
pub fn start() {
    let filter = EnvFilter::try_from_env("PLUMBLINE_LOG").unwrap_or_else(|_| EnvFilter::new("warn,plumbline=info"));
    let registry = tracing_subscriber::registry().with(filter);
    if journal_listens()
        && let Ok(journal) = tracing_journald::layer()
    {
        registry.with(journal.with_field_prefix(None).with_syslog_identifier("plumbline".into())).init();
        return;
    }
    // Colours are for people; a log file gets plain text.
    let colours = std::io::stderr().is_terminal();
    let words = debug_fn(|to, field, value| match field.name() {
        "message" => write!(to, "{value:?}"),
        name if name.starts_with(FIELD) => Ok(()),
        name => write!(to, " {name}={value:?}"),
    });
    let lines = fmt::layer().with_writer(std::io::stderr).with_target(false).with_ansi(colours).fmt_fields(words);
    registry.with(lines).init();
}

/// Every line until the guard is dropped is about this robot. Only the journal has a place for that.
pub fn about(robot: &str) -> Option<tracing::span::EnteredSpan> {
    journal_listens().then(|| tracing::info_span!("robot", plumbline_robot = robot).entered())
}

/// Whether standard error is the journal's stream, which systemd names as `DEVICE:INODE`.
fn journal_listens() -> bool {
    let Ok(stream) = std::env::var("JOURNAL_STREAM") else { return false };
    let Ok(own) = std::fs::metadata("/proc/self/fd/2") else { return false };
    stream == format!("{}:{}", own.dev(), own.ino())
}
