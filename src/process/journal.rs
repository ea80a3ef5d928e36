//! Where log lines go: standard error for people, the journal with its fields under systemd.
//!
//! A process that drives an arm, or serves one that does, hands its lines to a thread of their own: a reader that stalls (a full pipe, Ctrl-S, a
//! stalled journal) costs lines, which are counted, and nothing else.
//!
//! In the journal, every line of a robot's processes carries `PLUMBLINE_ROBOT`, and lines about the arm carry `PLUMBLINE_EVENT`, so that
//! `journalctl PLUMBLINE_EVENT=stopping` finds every stop. On standard error these fields are left out.

use crate::process::outbox::Outbox;
use std::fmt::{Debug, Display};
use std::io::{self, IsTerminal, Write};
use std::os::unix::fs::MetadataExt;
use std::os::unix::net::UnixDatagram;
use std::sync::OnceLock;
use std::time::Duration;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::fmt::format::debug_fn;
use tracing_subscriber::layer::Context;
use tracing_subscriber::prelude::*;
use tracing_subscriber::{EnvFilter, Layer, fmt};

const FIELD: &str = "plumbline_";
const LINES: usize = 4096;
/// How long the last lines of a process may take.
const FLUSH: Duration = Duration::from_secs(1);
/// The journal's socket, which takes a line as one datagram.
const JOURNAL: &str = "/run/systemd/journal/socket";
/// The most of a line that the journal gets; a datagram holds some 200 KiB \[bytes\].
const LONGEST: usize = 64 << 10;
/// The journal's priorities: `LOG_ERR`, `LOG_WARNING`.
const ERROR: u8 = 3;
const WARNING: u8 = 4;

/// What lines are written to, in the form that goes with it.
struct Lines {
    outbox: Outbox<Vec<u8>>,
    journal: bool,
}

static LINES_OUT: OnceLock<Lines> = OnceLock::new();
static ROBOT: OnceLock<String> = OnceLock::new();

/// What is logged without `PLUMBLINE_LOG` by a process that makes no report of its own.
pub const FILTER: &str = "warn,plumbline=info";
/// Variable with another filter, such as `plumbline=debug`.
pub const FILTER_VARIABLE: &str = "PLUMBLINE_LOG";

/// Starts logging through `filter`, or through that of [`FILTER_VARIABLE`]. `serves` is true for a process that an arm depends on.
pub fn start(serves: bool, filter: &str) {
    let filter = EnvFilter::try_from_env(FILTER_VARIABLE).unwrap_or_else(|_| EnvFilter::new(filter));
    let registry = tracing_subscriber::registry().with(filter);
    if let Some(socket) = journal_socket()
        && open(true, move |bytes| drop(socket.send_to(&bytes, JOURNAL)))
    {
        registry.with(ToJournal).init();
    } else {
        // Colours are for people; a log file gets plain text.
        let colours = io::stderr().is_terminal();
        let words = debug_fn(|to, field, value| match field.name() {
            "message" => write!(to, "{value:?}"),
            name if name.starts_with(FIELD) => Ok(()),
            name => write!(to, " {name}={value:?}"),
        });
        // A closed standard error is no failure of the job: reporting it there would panic.
        let lines = fmt::layer().with_target(false).with_ansi(colours).fmt_fields(words).log_internal_errors(false);
        if serves && open(false, |bytes| drop(io::stderr().write_all(&bytes))) {
            registry.with(lines.with_writer(|| ToOutbox)).init();
        } else {
            registry.with(lines.with_writer(io::stderr)).init();
        }
    }
    if LINES_OUT.get().is_some() {
        std::panic::set_hook(Box::new(|panic| {
            let thread = std::thread::current();
            tracing::error!("thread `{}` {panic}", thread.name().unwrap_or("unnamed"));
            if thread.name() == Some("main") {
                flush();
            }
        }));
    }
}

/// Starts the thread that writes lines; whether it could be started.
fn open(journal: bool, mut write: impl FnMut(Vec<u8>) + Send + 'static) -> bool {
    let outbox = Outbox::start("plumbline-log", LINES, move |dropped, line: Vec<u8>| {
        if dropped > 0 {
            let words = format!("{dropped} lines of the log were dropped here: they were not read in time");
            write(plain(journal, WARNING, &words));
        }
        write(line);
    });
    outbox.is_ok_and(|outbox| LINES_OUT.set(Lines { outbox, journal }).is_ok())
}

/// Every line from now on is about this robot. Only the journal has a place for that.
pub fn about(robot: &str) {
    let _ = ROBOT.set(robot.to_string());
}

/// Ends logging with the reason why the process fails, if it does: the last lines get some time to be read, and no more.
pub fn finish(failure: Option<&dyn Display>) {
    let words = failure.map(|failure| format!("plumbline: {failure}"));
    match (LINES_OUT.get(), words) {
        (Some(lines), words) => {
            words.map(|words| lines.outbox.offer(plain(lines.journal, ERROR, &words)));
            flush();
        }
        (None, Some(words)) => drop(writeln!(io::stderr(), "{words}")),
        (None, None) => {}
    }
}

fn flush() {
    LINES_OUT.get().map(|lines| lines.outbox.flush(FLUSH));
}

fn plain(journal: bool, priority: u8, words: &str) -> Vec<u8> {
    if !journal {
        return format!("{words}\n").into_bytes();
    }
    let mut entry = Entry::of(priority);
    entry.put("MESSAGE", words);
    entry.0
}

/// Where standard error is the journal's stream, which systemd names as `DEVICE:INODE`.
fn journal_socket() -> Option<UnixDatagram> {
    let stream = std::env::var("JOURNAL_STREAM").ok()?;
    let own = std::fs::metadata("/proc/self/fd/2").ok()?;
    if stream != format!("{}:{}", own.dev(), own.ino()) || !std::path::Path::new(JOURNAL).exists() {
        return None;
    }
    UnixDatagram::unbound().ok()
}

struct ToOutbox;

impl Write for ToOutbox {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        LINES_OUT.get().map(|lines| lines.outbox.offer(bytes.to_vec()));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Turns events into entries of the journal. The tracing-journald crate sends on the thread that logs, and a stalled journal would stall that thread.
struct ToJournal;

impl<S: Subscriber> Layer<S> for ToJournal {
    fn on_event(&self, event: &Event<'_>, _context: Context<'_, S>) {
        let about = event.metadata();
        let priority = match *about.level() {
            Level::ERROR => ERROR,
            Level::WARN => WARNING,
            Level::INFO => 5,
            Level::DEBUG => 6,
            Level::TRACE => 7,
        };
        let mut entry = Entry::of(priority);
        entry.put("TARGET", about.target());
        about.file().into_iter().for_each(|file| entry.put("CODE_FILE", file));
        about.line().into_iter().for_each(|line| entry.put("CODE_LINE", &line.to_string()));
        event.record(&mut entry);
        LINES_OUT.get().map(|lines| lines.outbox.offer(entry.0));
    }
}

/// An entry in the journal's native form: <https://systemd.io/JOURNAL_NATIVE_PROTOCOL/>.
struct Entry(Vec<u8>);

impl Entry {
    fn of(priority: u8) -> Entry {
        let mut entry = Entry(Vec::with_capacity(512));
        entry.put("PRIORITY", &priority.to_string());
        entry.put("SYSLOG_IDENTIFIER", "plumbline");
        ROBOT.get().into_iter().for_each(|robot| entry.put("PLUMBLINE_ROBOT", robot));
        entry
    }

    /// A field with its length, so that the value may hold line breaks. Its name is capitals, digits and underscores, the first a capital.
    fn put(&mut self, name: &str, value: &str) {
        let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_uppercase() } else { '_' };
        let name: String = name.chars().map(plain).skip_while(|c| !c.is_ascii_uppercase()).collect();
        let value = &value.as_bytes()[..value.len().min(LONGEST)];
        self.0.extend_from_slice(name.as_bytes());
        self.0.push(b'\n');
        self.0.extend_from_slice(&(value.len() as u64).to_le_bytes());
        self.0.extend_from_slice(value);
        self.0.push(b'\n');
    }
}

impl Visit for Entry {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.put(field.name(), &format!("{value:?}"));
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        self.put(field.name(), value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_entry_of_the_journal_has_each_field_with_its_length() {
        let mut entry = Entry(Vec::new());
        entry.put("message", "two\nlines");
        entry.put("_log.target", "a");
        assert_eq!(entry.0, b"MESSAGE\n\x09\0\0\0\0\0\0\0two\nlines\nLOG_TARGET\n\x01\0\0\0\0\0\0\0a\n");
        let mut entry = Entry(Vec::new());
        entry.put("MESSAGE", &"x".repeat(1 << 20));
        assert!(entry.0.len() < LONGEST + 64);
    }

    #[test]
    fn a_line_of_its_own_has_words_and_a_priority() {
        assert_eq!(plain(false, ERROR, "plumbline: it failed"), b"plumbline: it failed\n");
        let entry = String::from_utf8(plain(true, WARNING, "3 lines")).unwrap();
        assert!(entry.contains("PRIORITY\n\x01\0\0\0\0\0\0\x004\n") && entry.contains("3 lines"), "{entry:?}");
    }
}
