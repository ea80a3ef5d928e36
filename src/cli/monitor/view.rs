//! The screen of the live view: 80 columns and 24 lines are enough.

use crate::monitor::watched::{BINS, Watched, bin_name, progress};
use plumbline_ipc::{Progress, Status};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, Clear, Paragraph};

/// Width of a bar.
const BAR: usize = 10;
/// Share of a limit from which on a value is marked.
const NEAR: f64 = 0.9;
/// Ratio of a residual to the noise floor from which on it is marked.
const FAR_FROM_FLOOR: f64 = 2.0;

/// Draws everything; `question` waits for a confirmation.
pub fn draw(frame: &mut Frame, of: &Watched, question: Option<&str>) {
    let joints = of.joints() as u16;
    let rows = [
        Constraint::Length(3),
        Constraint::Length(joints + 1),
        Constraint::Length(5),
        Constraint::Min(3),
        Constraint::Length(1),
    ];
    let [head, table, latencies, log, keys] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(Paragraph::new(heading(of)), head);
    frame.render_widget(Paragraph::new(joint_rows(of)), table);
    frame.render_widget(Paragraph::new(histogram(of)), latencies);
    let lines = usize::from(log.height.saturating_sub(1));
    let events = of.events.iter().skip(of.events.len().saturating_sub(lines)).map(|event| Line::raw(event.as_str()));
    let events = std::iter::once(Line::raw("log").dim()).chain(events);
    frame.render_widget(Paragraph::new(events.collect::<Vec<_>>()), log);
    frame.render_widget(
        Line::raw("SPACE stop  p pause  g start  r resume  a adopt  x reject  q leave (arm goes on)").dim(),
        keys,
    );
    if let Some(question) = question {
        ask(frame, question);
    }
}

fn ask(frame: &mut Frame, question: &str) {
    let area = frame.area();
    let (width, height) = (58.min(area.width), 4.min(area.height));
    let place = Rect { x: (area.width - width) / 2, y: (area.height - height) / 2, width, height };
    let lines = vec![Line::raw(question).bold(), Line::raw("y: yes   any other key: no   SPACE: stop")];
    frame.render_widget(Clear, place);
    frame.render_widget(
        Paragraph::new(lines).centered().block(Block::bordered().border_style(Style::new().fg(Color::Yellow))),
        place,
    );
}

fn heading(of: &Watched) -> Vec<Line<'_>> {
    let Some(status) = &of.status else { return vec![Line::raw("waits for the daemon")] };
    let colour = match (of.runs, status.progress) {
        (false, _) | (_, Progress::Stopped) => Color::Red,
        (_, Progress::Driving) => Color::Green,
        (_, Progress::AwaitingModel | Progress::Paused) => Color::Yellow,
        _ => Color::Reset,
    };
    let state = if of.runs { progress(status.progress) } else { "NO DAEMON" };
    let left = status
        .left
        .filter(|_| status.progress == Progress::Driving)
        .map_or(String::new(), |left| format!(", {left:.0} s left"));
    let first = Line::from(vec![
        Span::raw(format!("{}  ", status.robot)).bold(),
        Span::styled(state.to_uppercase(), Style::new().fg(colour).add_modifier(Modifier::BOLD)),
        Span::raw(format!("  {:?}, {}, t = {:.1} s{left}", status.phase, status.job, of.last.state.time)),
    ]);
    let model = match (status.model, &status.doubt) {
        (0, _) => Span::raw("no model"),
        (model, None) => Span::raw(format!("model {model:016x}")),
        (model, Some(_)) => Span::raw(format!("model {model:016x} DOUBTFUL")).yellow(),
    };
    let counters = format!(
        "   {} cycles, {} lost, {} late, {} dropped",
        status.cycles, status.lost, status.late, status.dropped_records
    );
    let second = Line::from(vec![model, Span::raw(counters)]);
    vec![first, second, remark(status)]
}

/// The most urgent thing that an operator should know.
fn remark(status: &Status) -> Line<'_> {
    if let Some(offered) = &status.offered {
        return Line::raw(format!("proposed: {} (a adopt, x reject)", offered.proposal.what)).yellow();
    }
    if status.progress == Progress::Paused {
        return Line::raw("paused: r drives the interrupted motion from its start, then the rest").yellow();
    }
    let stopped = status.stopped.as_ref().map(|why| format!("stopped: {why}"));
    let degraded = status.degraded.first().map(|why| format!("degraded, not real-time: {why}"));
    let unserved = status.without_model.as_ref().map(|why| format!("no model is served: {why}"));
    stopped.or(degraded).or(unserved).map_or(Line::raw(""), |text| Line::raw(text).red())
}

/// One row per joint under a heading.
fn joint_rows(of: &Watched) -> Vec<Line<'static>> {
    let head = format!(
        "{:>9} {:BAR$}{:>6}{:>9}{:>7}{:>9}{:>10}{:>7}{:>9}",
        "q / deg", "range", "dq", "tau / Nm", "limit", "served", "residual", "floor", "external"
    );
    let mut rows = vec![Line::raw(head).dim()];
    for j in 0..of.joints() {
        let state = &of.last.state;
        let (q, dq, tau) = (state.q[j], state.dq[j], state.tau[j]);
        let (place, speed, load) = match &of.limits {
            Some(limits) => {
                let range = (limits.q_max[j] - limits.q_min[j]).max(f64::MIN_POSITIVE);
                ((q - limits.q_min[j]) / range, dq.abs() / limits.dq[j], tau.abs() / limits.tau[j])
            }
            None => (f64::NAN, f64::NAN, f64::NAN),
        };
        let marked = |near: bool, text: String| if near { Span::raw(text).yellow().bold() } else { Span::raw(text) };
        let at_end = !(1.0 - NEAR..=NEAR).contains(&place) && place.is_finite();
        let served =
            if of.last.model != 0 { format!("{:7.2}", of.last.command.tau_ff.0[j]) } else { format!("{:>7}", "-") };
        let (residual, floor) = (of.residual(j), of.floor.get(j).copied());
        let far = floor.is_some_and(|floor| of.last.model != 0 && residual > FAR_FROM_FLOOR * floor);
        let external = of.external.filter(|external| external.settled);
        let contact = external.is_some_and(|external| external.tau[j].abs() > external.threshold[j]);
        let residual = if of.last.model != 0 { format!("{residual:9.3}") } else { format!("{:>9}", "-") };
        rows.push(Line::from(vec![
            Span::raw(format!("{} ", j + 1)),
            Span::raw(format!("{:7.1} ", q.to_degrees())),
            marked(at_end, bar(place)),
            marked(speed > NEAR, format!(" {}", percent(speed))),
            Span::raw(format!("  {tau:7.2}")),
            marked(load > NEAR, format!("  {}", percent(load))),
            Span::raw(format!("  {served}")),
            marked(far, format!(" {residual}")),
            Span::raw(floor.map_or(format!("{:>7}", "-"), |floor| format!("{floor:7.3}"))),
            marked(contact, external.map_or(format!("{:>9}", "-"), |external| format!("{:9.2}", external.tau[j]))),
        ]));
    }
    rows
}

/// A place from 0 to 1 as a mark on a line.
fn bar(place: f64) -> String {
    let inside = BAR - 2;
    let at = (place.clamp(0.0, 1.0) * (inside - 1) as f64).round();
    let mark = |k: usize| if place.is_finite() && k == at as usize { '#' } else { '-' };
    format!("[{}]", (0..inside).map(mark).collect::<String>())
}

fn percent(share: f64) -> String {
    if share.is_finite() { format!("{:4.0}%", 100.0 * share.min(9.99)) } else { "    -".into() }
}

/// Latencies as columns of three lines, the height by the logarithm of the count.
fn histogram(of: &Watched) -> Vec<Line<'static>> {
    const WIDTH: usize = 5;
    const LINES: usize = 3;
    const EIGHTHS: [char; 9] =
        [' ', '\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];
    let most = of.latencies.iter().copied().max().unwrap_or(0).max(1);
    let height = |count: u64| match count {
        0 => 0,
        // One count shows.
        _ => 1 + ((1.0 + count as f64).log10() / (1.0 + most as f64).log10() * (8 * LINES - 1) as f64) as usize,
    };
    let line = |level: usize| {
        let column = |count: &u64| {
            let eighths = height(*count).saturating_sub(8 * level).min(8);
            EIGHTHS[eighths].to_string().repeat(WIDTH - 1) + " "
        };
        Line::raw(of.latencies.iter().map(column).collect::<String>())
    };
    let what = if of.last.wake_ns > 0 { "wake-up latency" } else { "execution time" };
    let mut lines = vec![Line::raw(format!("{what}, cycles on a logarithmic scale")).dim()];
    lines.extend((0..LINES).rev().map(line));
    // Every second name: all would touch.
    let names = (0..BINS).step_by(2).map(|bin| format!("{:<1$}", bin_name(bin), 2 * WIDTH));
    lines.push(Line::raw(names.collect::<String>()).dim());
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::Record;
    use plumbline_ipc::{HeldModel, Proposal};
    use ratatui::Terminal;
    use ratatui::backend::TestBackend;

    fn screen(of: &Watched, question: Option<&str>, size: (u16, u16)) -> Vec<String> {
        let mut terminal = Terminal::new(TestBackend::new(size.0, size.1)).unwrap();
        terminal.draw(|frame| draw(frame, of, question)).unwrap();
        let buffer = terminal.backend().buffer();
        let row = |y: u16| (0..size.0).map(|x| buffer[(x, y)].symbol()).collect::<String>().trim_end().to_string();
        (0..size.1).map(row).collect()
    }

    fn status(progress: Progress) -> Status {
        Status {
            robot: "panda".into(),
            joints: 7,
            progress,
            model: 0x55bc,
            cycles: 1234,
            left: Some(42.4),
            job: "wall: identify".into(),
            ..Status::default()
        }
    }

    #[test]
    fn a_terminal_of_80_by_24_shows_every_joint_counters_latencies_and_the_log() {
        let mut of = Watched::default();
        of.floor = vec![0.15; 7];
        of.status(status(Progress::Idle));
        of.status(status(Progress::Driving));
        let mut record =
            Record { model: 0x55bc, wake_ns: 28_000, validity: plumbline_core::Validity::Valid, ..Record::default() };
        // Joint 2 at its upper limit with twenty times the noise, joint 4 near its lowest position.
        (record.state.q[1], record.state.tau[1], record.state.q[3]) = (1.76, 86.5, -3.0);
        (0..3000).for_each(|_| of.record(&record));
        record.wake_ns = 900_000;
        of.record(&record);
        let screen = screen(&of, None, (80, 24));
        let text = screen.join("\n");
        assert!(screen[0].contains("panda  DRIVING") && screen[0].contains("42 s left"), "{text}");
        assert!(screen[1].contains("model 00000000000055bc") && screen[1].contains("1234 cycles, 0 lost"), "{text}");
        let joint = |j: usize| &screen[3 + j];
        assert!(
            joint(2).contains("100.8 [-------#]") && joint(2).contains("86.50") && joint(2).contains(" 99%"),
            "{text}"
        );
        assert!(joint(2).contains("86.3") && joint(2).ends_with("0.150        -"), "{text}");
        assert!(joint(4).contains("-171.9 [#-------]"), "{text}");
        assert!(
            text.contains("wake-up latency")
                && text.contains("\u{2588}\u{2588}\u{2588}\u{2588}")
                && text.contains("22us"),
            "{text}"
        );
        assert!(screen.iter().any(|line| line.ends_with("driving: wall: identify")), "{text}");
        assert!(screen[23].starts_with("SPACE stop"), "{text}");
    }

    #[test]
    fn questions_ends_and_small_terminals_are_shown() {
        let mut of = Watched::default();
        assert!(screen(&of, None, (80, 24))[0].contains("waits for the daemon"));
        let proposal = Proposal { what: "payload of 0.731 kg".into(), ..Proposal::default() };
        of.status(Status { offered: Some(HeldModel { model: 1, proposal }), ..status(Progress::Driving) });
        let asked = screen(&of, Some("START the job? The arm moves."), (80, 24)).join("\n");
        assert!(asked.contains("START the job? The arm moves.") && asked.contains("y: yes"), "{asked}");
        assert!(asked.contains("proposed: payload of 0.731 kg"), "{asked}");
        of.gone();
        let gone = screen(&of, None, (80, 24)).join("\n");
        assert!(gone.contains("NO DAEMON") && gone.contains("the daemon has ended"), "{gone}");
        for size in [(1, 1), (20, 5), (200, 60)] {
            screen(&of, Some("?"), size);
        }
    }
}
