//! Facts of a recording as text for a terminal.

use super::facts::{Facts, JointPeak, Weight};
use super::replay::ReplayResult;
use super::timing::Timing;
use plumbline_core::{LoopStatistics, PERIOD_S};
use std::fmt::Write;

pub fn text(facts: &Facts) -> String {
    let mut out = String::new();
    // Writing to a string can't fail.
    let _ = put(&mut out, facts);
    out
}

fn put(out: &mut String, facts: &Facts) -> std::fmt::Result {
    writeln!(out, "{}", facts.headline())?;
    writeln!(out, "  {}", facts.reason)?;
    if let Some(crossing) = &facts.first_limit {
        writeln!(out, "  first limit exceeded: {} ({:.3} s before the end)", crossing.text, crossing.before)?;
    }
    if let Some(stop) = &facts.stop {
        let rest = if stop.at_rest { "at rest after" } else { "not yet at rest after" };
        let (speed, travelled) = (stop.speed, stop.travelled);
        writeln!(
            out,
            "  controlled stop: from {:.3} rad/s (joint {}), {rest} {:.3} s and {:.4} rad (joint {})",
            speed.0, speed.1, stop.seconds, travelled.0, travelled.1
        )?;
    }
    writeln!(out, "\nNext")?;
    for (number, step) in facts.next.iter().enumerate() {
        writeln!(out, "  {}. {step}", number + 1)?;
    }
    writeln!(out, "\nEvents (seconds before the end, cycle, phase)")?;
    for line in &facts.timeline {
        let mark = if line.weight == Weight::Bad { '!' } else { ' ' };
        writeln!(out, "{mark} {:>8.3}  {:>8}  {:<10}  {}", -line.before, line.cycle, line.phase, line.text)?;
    }
    worst(out, "\nLargest tracking error", "rad", &facts.tracking)?;
    worst(out, "\nLargest measured torque", "Nm", &facts.torque)?;
    timing(out, &facts.timing)?;
    if let Some(replay) = &facts.replay {
        writeln!(out, "\nReplay\n  {}", replay_words(replay))?;
    }
    for gap in &facts.gaps {
        writeln!(out, "\nnote: {gap}")?;
    }
    writeln!(out, "\n{}", provenance(facts))
}

fn worst(out: &mut String, title: &str, unit: &str, joints: &[JointPeak]) -> std::fmt::Result {
    writeln!(out, "{title} (share of the limit, seconds before the end)")?;
    for one in joints {
        let JointPeak { joint, worst, before, limit, share } = one;
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
        writeln!(out, "  simulated time: no periods")?;
    }
    for (name, [p50, p99, _, max]) in timing.times() {
        writeln!(out, "  {name:<9} p50 {p50:.1}  p99 {p99:.1}  max {max:.1} us")?;
    }
    for outlier in &timing.outliers {
        writeln!(out, "  {:>8.3}  {:>8}  {}", -outlier.before, outlier.cycle, outlier.text)?;
    }
    if timing.more > 0 {
        writeln!(out, "  and {} earlier ones", timing.more)?;
    }
    Ok(())
}

pub(super) fn replay_words(replay: &ReplayResult) -> String {
    let ReplayResult { first, compared, different, torque_different, .. } = replay;
    let from = if replay.from_the_start { "from the loop's start" } else { "from the middle" };
    let mut words = format!("{compared} cycles from {first} on, {from}: ");
    if replay.is_identical() {
        words += "every command is bitwise identical";
        if let Some(end) = &replay.end {
            let _ = write!(words, ", and the loop ended as recorded: {end}");
        }
        return words;
    }
    if *different > 0 {
        let first = replay.first_difference.as_deref().unwrap_or_default();
        let _ = write!(words, "{different} commands differ, first {first}");
    } else {
        words += "every position is bitwise identical";
    }
    if *torque_different > 0 {
        let last = replay.last_torque_difference.unwrap_or_default();
        let _ = write!(
            words,
            "; the torque differs in {torque_different} cycles, last in {last} (a model with memory starts without it)"
        );
    }
    if !replay.same_events {
        words += "; the events differ";
    }
    if replay.same_end == Some(false) {
        let _ = write!(words, "; the end differs: {}", replay.end.as_deref().unwrap_or_default());
    }
    words
}

pub(super) fn provenance(facts: &Facts) -> String {
    let model = facts.model.as_ref().map_or("no model served".to_string(), |model| format!("model {model}"));
    format!(
        "{}, mounting {}, {model}; job {}; recorded {} by plumbline {}",
        facts.robot, facts.mounting, facts.job, facts.recorded, facts.plumbline
    )
}
