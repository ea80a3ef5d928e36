//! The story for a terminal.

use super::replay::Replayed;
use super::story::{Joint, Story};
use super::timing::Timing;
use plumbline_core::{LoopStatistics, PERIOD_S};
use std::fmt::Write;

/// The story in lines of plain text.
pub fn text(story: &Story) -> String {
    let mut out = String::new();
    // Writing to a string can't fail.
    let _ = put(&mut out, story);
    out
}

fn put(out: &mut String, story: &Story) -> std::fmt::Result {
    writeln!(out, "{}", story.headline())?;
    writeln!(out, "  {}", story.reason)?;
    if let Some(crossing) = &story.first_limit {
        writeln!(out, "  first limit crossed: {} ({:.3} s before the end)", crossing.text, crossing.before)?;
    }
    if let Some(stop) = &story.stop {
        let rest = if stop.at_rest { "at rest after" } else { "not yet at rest after" };
        let (speed, travelled) = (stop.speed, stop.travelled);
        writeln!(
            out,
            "  controlled stop: from {:.3} rad/s (joint {}), {rest} {:.3} s and {:.4} rad (joint {})",
            speed.0, speed.1, stop.seconds, travelled.0, travelled.1
        )?;
    }
    writeln!(out, "\nNext")?;
    for (number, step) in story.next.iter().enumerate() {
        writeln!(out, "  {}. {step}", number + 1)?;
    }
    writeln!(out, "\nWhat happened (seconds before the end, cycle, phase)")?;
    for line in &story.timeline {
        let mark = if line.weight == "bad" { '!' } else { ' ' };
        writeln!(out, "{mark} {:>8.3}  {:>8}  {:<10}  {}", -line.before, line.cycle, line.phase, line.text)?;
    }
    worst(out, "\nFarthest from its command", "rad", &story.tracking)?;
    worst(out, "\nLargest measured torque", "Nm", &story.torque)?;
    timing(out, &story.timing)?;
    if let Some(replay) = &story.replay {
        writeln!(out, "\nReplay\n  {}", replay_words(replay))?;
    }
    for gap in &story.gaps {
        writeln!(out, "\nnote: {gap}")?;
    }
    writeln!(out, "\n{}", provenance(story))
}

fn worst(out: &mut String, title: &str, unit: &str, joints: &[Joint]) -> std::fmt::Result {
    writeln!(out, "{title} (share of the limit, seconds before the end)")?;
    for one in joints {
        let Joint { joint, worst, before, limit, share } = one;
        let mark = if *share > 1.0 { '!' } else { ' ' };
        let percent = 100.0 * share;
        writeln!(out, "{mark} joint {joint}  {worst:>9.4} of {limit:.4} {unit}  {percent:>5.1} %  {:>8.3}", -before)?;
    }
    Ok(())
}

fn timing(out: &mut String, timing: &Timing) -> std::fmt::Result {
    writeln!(out, "\nTiming")?;
    let LoopStatistics { elapsed, cycles, lost, longest_lost, late, .. } = timing.statistics;
    let (seconds, late) = (elapsed as f64 * PERIOD_S, late.map_or(String::new(), |late| format!(", {late} late")));
    writeln!(out, "  {cycles} cycles in {seconds:.3} s, {lost} states lost (at most {longest_lost} in a row){late}")?;
    if timing.statistics.late.is_none() {
        writeln!(out, "  simulated time, as fast as possible: its periods mean nothing")?;
    }
    for (name, [p50, p99, _, max]) in timing.times() {
        writeln!(out, "  {name:<9} p50 {p50:.1}  p99 {p99:.1}  max {max:.1} us")?;
    }
    for outlier in &timing.outliers {
        writeln!(out, "  {:>8.3}  {:>8}  {}", -outlier.before, outlier.cycle, outlier.text)?;
    }
    if timing.more > 0 {
        writeln!(out, "  and {} more before these", timing.more)?;
    }
    Ok(())
}

/// The outcome of a replay in one sentence.
pub(super) fn replay_words(replay: &Replayed) -> String {
    let Replayed { first, compared, different, torque_different, .. } = replay;
    let from = if replay.from_the_start { "from the loop's start" } else { "from the middle" };
    let mut words = format!("{compared} cycles from {first} on, {from}: ");
    if replay.is_identical() {
        words += "every command came out bit for bit";
        if let Some(end) = &replay.end {
            let _ = write!(words, ", and the loop ended as it had: {end}");
        }
        return words;
    }
    if *different > 0 {
        let first = replay.first_difference.as_deref().unwrap_or_default();
        let _ = write!(words, "{different} commands came out otherwise, first {first}");
    } else {
        words += "every position came out bit for bit";
    }
    if *torque_different > 0 {
        let last = replay.last_torque_difference.unwrap_or_default();
        let _ = write!(
            words,
            "; the torque was another in {torque_different} cycles, last in {last} (a model with memory begins without it)"
        );
    }
    if !replay.same_events {
        words += "; the events differ";
    }
    if replay.same_end == Some(false) {
        let _ = write!(words, "; it ended otherwise: {}", replay.end.as_deref().unwrap_or_default());
    }
    words
}

/// Where the recording comes from, in one line.
pub(super) fn provenance(story: &Story) -> String {
    let model = story.model.as_ref().map_or("no model served".to_string(), |model| format!("model {model}"));
    format!(
        "{}, mounting {}, {model}; job {}; recorded {} by plumbline {}",
        story.robot, story.mounting, story.job, story.recorded, story.plumbline
    )
}
