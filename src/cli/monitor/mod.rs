//! `plumbline monitor`: the live view of a running daemon.

mod view;

use crate::failure::Failure;
use crate::monitor::Monitor;
use clap::Args;
use plumbline_ipc::{Request, Response, RobotId};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Options of `plumbline monitor`.
#[derive(Args)]
pub struct Options {
    /// Robot that the daemon drives
    #[arg(long, default_value = "panda")]
    robot: String,
}

/// Wait for the daemon at the start.
const TIMEOUT: Duration = Duration::from_secs(2);
/// Interval of the display.
const FRAME: Duration = Duration::from_millis(100);
/// Interval of the status queries.
const STATUS: Duration = Duration::from_millis(300);

/// What a key asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Action {
    Leave,
    /// At once: a stop is never asked about.
    Stop,
    /// At once, too: it brakes as a stop does.
    Pause,
    /// After a confirmation, because the arm moves or its torque changes.
    Ask(Order),
    Reject,
    Confirm,
    Dismiss,
    None,
}

/// Orders that need a confirmation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    Start,
    Resume,
    Adopt,
}

impl Order {
    fn request(self) -> Request {
        match self {
            Order::Start => Request::Start {},
            Order::Resume => Request::Resume {},
            Order::Adopt => Request::Adopt {},
        }
    }

    /// What the confirmation asks.
    fn question(self) -> &'static str {
        match self {
            Order::Start => "START the job? The arm moves.",
            Order::Resume => "RESUME after the stop or pause? The arm may move.",
            Order::Adopt => "ADOPT the proposed model? The torque changes.",
        }
    }
}

/// The action of a key, where a question is `asked` or not.
fn action(key: KeyCode, modifiers: KeyModifiers, asked: bool) -> Action {
    let control = modifiers.contains(KeyModifiers::CONTROL);
    match (key, asked) {
        // A stop works whatever is on the screen.
        (KeyCode::Char(' ' | 's'), _) if !control => Action::Stop,
        (KeyCode::Char('p'), _) if !control => Action::Pause,
        (KeyCode::Char('c'), _) if control => Action::Leave,
        (KeyCode::Char('y'), true) => Action::Confirm,
        (_, true) => Action::Dismiss,
        (KeyCode::Char('q') | KeyCode::Esc, _) => Action::Leave,
        (KeyCode::Char('g'), _) => Action::Ask(Order::Start),
        (KeyCode::Char('r'), _) => Action::Ask(Order::Resume),
        (KeyCode::Char('a'), _) => Action::Ask(Order::Adopt),
        (KeyCode::Char('x'), _) => Action::Reject,
        _ => Action::None,
    }
}

/// Shows the daemon until the person leaves. Leaving does nothing to the arm.
pub fn run(options: Options) -> Result<(), Failure> {
    let id = RobotId::parse("command line", "--robot", &options.robot)?;
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        return Err(Failure::job(
            "standard input and output are no terminal; `plumbline command status` and `plumbline torque` print lines",
        ));
    }
    // Before the screen is taken: a missing daemon is named in plain text.
    let mut monitor = Monitor::new(id);
    monitor.connect(TIMEOUT).map_err(crate::cli::unreachable)?;
    let mut terminal = ratatui::try_init().map_err(|error| Failure::job(format!("terminal: {error}")))?;
    let ended = Screen { monitor, asked: None }.follow(&mut terminal);
    ratatui::restore();
    ended
}

struct Screen {
    monitor: Monitor,
    asked: Option<Order>,
}

impl Screen {
    fn follow(mut self, terminal: &mut DefaultTerminal) -> Result<(), Failure> {
        let mut last: Option<Instant> = None;
        loop {
            if last.is_none_or(|last| last.elapsed() >= STATUS) {
                last = Some(Instant::now());
                self.monitor.query();
            }
            self.monitor.read();
            let (watched, asked) = (&self.monitor.watched, self.asked);
            terminal
                .draw(|frame| view::draw(frame, watched, asked.map(Order::question)))
                .map_err(|error| Failure::job(format!("terminal: {error}")))?;
            if !event::poll(FRAME).map_err(Failure::job)? {
                continue;
            }
            let Event::Key(key) = event::read().map_err(Failure::job)? else { continue };
            if key.kind != KeyEventKind::Press {
                continue;
            }
            match action(key.code, key.modifiers, self.asked.is_some()) {
                Action::Leave => return Ok(()),
                Action::Stop => self.stop(),
                Action::Pause => self.pause(),
                Action::Ask(order) => self.asked = Some(order),
                Action::Reject => drop(self.send(&Request::Reject {})),
                Action::Confirm => {
                    if let Some(order) = self.asked.take() {
                        self.send(&order.request());
                    }
                }
                Action::Dismiss => self.asked = None,
                Action::None => {}
            }
        }
    }

    fn stop(&mut self) {
        self.asked = None;
        let said = match plumbline_ipc::stop(self.monitor.id()) {
            Ok(taken) => format!("stop: the daemon (process {}) has received it", taken.process),
            Err(error) => format!("STOP FAILED: {error}"),
        };
        self.monitor.watched.note(said);
    }

    fn pause(&mut self) {
        self.asked = None;
        if !self.send(&Request::Pause {}) {
            self.monitor.watched.note("NOT PAUSED; SPACE stops the arm");
        }
    }

    /// Sends a request and notes the response; whether it was accepted.
    fn send(&mut self, request: &Request) -> bool {
        let order = request.order().unwrap_or("status");
        let response = self.monitor.send(request);
        let accepted = matches!(&response, Some(Ok(response)) if !matches!(response, Response::Refused { .. }));
        let said = match response {
            Some(Ok(Response::Refused { reason })) => format!("{order} refused: {reason}"),
            Some(Ok(_)) => format!("{order} accepted"),
            Some(Err(error)) => format!("{order} failed: {error}"),
            None => format!("{order} failed: no daemon"),
        };
        self.monitor.watched.note(said);
        accepted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_the_arm_is_asked_about_and_a_stop_never_is() {
        let key = |c: char, asked| action(KeyCode::Char(c), KeyModifiers::NONE, asked);
        for (c, order) in [('g', Order::Start), ('r', Order::Resume), ('a', Order::Adopt)] {
            assert_eq!(key(c, false), Action::Ask(order));
            // A second press of the same key does not confirm.
            assert_eq!(key(c, true), Action::Dismiss);
        }
        for asked in [false, true] {
            assert_eq!(
                (key(' ', asked), key('s', asked), key('p', asked)),
                (Action::Stop, Action::Stop, Action::Pause)
            );
        }
        assert_eq!((key('y', false), key('y', true), key('n', true)), (Action::None, Action::Confirm, Action::Dismiss));
        assert_eq!((key('q', false), key('q', true)), (Action::Leave, Action::Dismiss));
    }
}
