//! Facts of a recording as a self-contained HTML file: event and next steps on the first screen, plots below.

use super::facts::{Facts, JointPeak};
use super::{plot, text};
use crate::recording::Recording;
use crate::recording::about::ReasonKind;
use minijinja::{AutoEscape, Environment, Value, context};
use plumbline_core::PERIOD_S;
use std::io;

const TEMPLATE: &str = include_str!("page.html");

/// The page's text.
pub fn page(facts: &Facts, recording: &Recording) -> io::Result<String> {
    let mut environment = Environment::new();
    environment.set_auto_escape_callback(|_| AutoEscape::Html);
    environment.add_template("page", TEMPLATE).map_err(io::Error::other)?;
    let focus = plot::focus(facts);
    let of = &facts.timing.statistics;
    let page = context! {
        headline => facts.headline(),
        calm => facts.kind == ReasonKind::OnDemand,
        reason => &facts.reason,
        tiles => tiles(facts),
        next => facts.next.iter().map(|step| safe(with_code(step))).collect::<Vec<_>>(),
        timeline => facts.timeline.iter().map(|line| context! {
            before => format!("{:.3}", -line.before), cycle => line.cycle, phase => &line.phase, text => &line.text,
            weight => Value::from(minijinja::value::Serde(line.weight)),
        }).collect::<Vec<_>>(),
        gaps => &facts.gaps,
        replay => facts.replay.as_ref().map(|replay| context! {
            good => replay.is_identical(), text => text::replay_words(replay),
        }),
        focus => focus + 1,
        strip => safe(plot::strip(facts, recording)),
        position => safe(plot::position(recording, focus)),
        stop => safe(plot::around_the_stop(facts, recording, focus)),
        tracking => safe(plot::tracking(recording)),
        torque => safe(plot::torque(recording)),
        period => safe(plot::timing(recording)),
        joints => recording.about.joints,
        tracking_rows => rows(&facts.tracking),
        torque_rows => rows(&facts.torque),
        timing => context! {
            cycles => of.cycles, seconds => format!("{:.3}", of.elapsed as f64 * PERIOD_S), lost => of.lost,
            longest => of.longest_lost, late => of.late.unwrap_or(0), simulated => of.late.is_none(),
            rows => timing_rows(facts),
            outliers => facts.timing.outliers.iter().map(|one| context! {
                before => format!("{:.3}", -one.before), cycle => one.cycle, text => &one.text,
            }).collect::<Vec<_>>(),
            more => facts.timing.more,
        },
        robot => &facts.robot, mounting => &facts.mounting, recorded => &facts.recorded, file => &facts.file,
        provenance => text::provenance(facts),
    };
    environment.get_template("page").and_then(|template| template.render(page)).map_err(io::Error::other)
}

fn safe(svg: String) -> Value {
    Value::from_safe_string(svg)
}

/// Text as HTML, with backticked parts as code.
fn with_code(text: &str) -> String {
    let escaped = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    let parts = escaped.split('`').enumerate();
    parts.map(|(k, part)| if k % 2 == 1 { format!("<code>{part}</code>") } else { part.to_string() }).collect()
}

/// Key figures of the first screen.
fn tiles(facts: &Facts) -> Vec<Value> {
    let tile = |value: String, unit: &str, what: String, class: &str| context! { value, unit, what, class };
    let mut tiles = Vec::new();
    if let Some(crossing) = &facts.first_limit {
        let what = format!("first limit exceeded, {:.3} s before the end: {}", crossing.before, crossing.text);
        tiles.push(tile(crossing.limit.replace('-', " "), "", what, "bad"));
    }
    if let Some(stop) = &facts.stop {
        let (speed, joint) = stop.speed;
        let (value, class) = (format!("{:.3}", stop.seconds), if stop.at_rest { "good" } else { "bad" });
        let rest = if stop.at_rest { "of braking to rest" } else { "of braking, not yet at rest" };
        let what = format!("{rest}, from {speed:.3} rad/s (joint {joint}); longest travel {:.4} rad", stop.travelled.0);
        tiles.push(tile(value, "s", what, class));
    }
    let largest = |joints: &[JointPeak]| joints.iter().max_by(|a, b| a.share.total_cmp(&b.share)).cloned();
    for (joints, what) in [(&facts.tracking, "of the tracking tolerance"), (&facts.torque, "of the torque limit")] {
        if let Some(JointPeak { joint, share, before, .. }) = largest(joints) {
            let class = if share > 1.0 { "bad" } else { "" };
            let what = format!("{what}, joint {joint}, {before:.3} s before the end");
            tiles.push(tile(format!("{:.0}", 100.0 * share), "%", what, class));
        }
    }
    let of = &facts.timing.statistics;
    let class = if of.lost > 0 { "bad" } else { "good" };
    let late = of.late.map_or("simulated time".to_string(), |late| format!("{late} late"));
    let what = format!("states, at most {} in a row; {late}, of {} cycles", of.longest_lost, of.cycles);
    tiles.push(tile(of.lost.to_string(), "lost", what, class));
    tiles
}

fn rows(joints: &[JointPeak]) -> Vec<Value> {
    let row = |one: &JointPeak| {
        context! {
            joint => one.joint, worst => format!("{:.4}", one.worst), limit => format!("{:.4}", one.limit),
            share => format!("{:.1}", 100.0 * one.share), before => format!("{:.3}", -one.before), bad => one.share > 1.0,
        }
    };
    joints.iter().map(row).collect()
}

fn timing_rows(facts: &Facts) -> Vec<Value> {
    let row = |(name, [p50, p99, _, max]): (&str, [f64; 4])| {
        context! { name, p50 => format!("{p50:.1}"), p99 => format!("{p99:.1}"), max => format!("{max:.1}") }
    };
    facts.timing.times().into_iter().map(row).collect()
}
