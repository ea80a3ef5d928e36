//! A diagnosis in plain words.

use super::errors;
use super::{
    Changes, Confirmation, Diagnosis, Effect, Empirical, Open, OpenKind, Quantity, Stratum, Symbolic, Unexplained,
    Verdict,
};
use crate::report::summary::digits;
use plumbline_diagnose::outcome::{listed, places};

/// The diagnosis in a few lines, the verdict first; the first line begins with `diagnosis:`.
pub(in crate::report) fn lines(of: &Diagnosis) -> Vec<String> {
    let mut findings = findings(of);
    let verdict = match (of.verdict, findings.len()) {
        (Verdict::NothingSignificant, _) => format!("nothing significant: {}", seen(of)),
        (Verdict::Diagnosed, 1) => findings.remove(0),
        (verdict, 1) => format!("{verdict}: {}", findings.remove(0)),
        (Verdict::Diagnosed, count) if count > 1 => format!("{} found", counted(of)),
        (verdict, 0) => verdict.to_string(),
        (verdict, _) => format!("{verdict}: {}", counted(of)),
    };
    let mut lines = vec![format!("diagnosis: {verdict}")];
    lines.extend(findings.iter().map(|finding| format!("- {finding}")));
    lines.extend(of.empirical.iter().map(|term| format!("- {}", empirical(term))));
    errors::add_to(&mut lines, of);
    lines.extend(open(of).map(|question| format!("open: {question}")));
    lines.extend(of.notes.iter().map(|note| format!("note: {note}")));
    lines
}

/// Effects, what stays unexplained and what changed, one sentence each.
fn findings(of: &Diagnosis) -> Vec<String> {
    let effects = of.effects.iter().map(|effect| {
        format!("{}{}", finding(effect, of.confirmation), left(effect).map_or(String::new(), |why| format!("; {why}")))
    });
    let unexplained = of.unexplained.iter().map(self::unexplained);
    effects
        .chain(unexplained)
        .chain(
            of.changes
                .iter()
                .filter(|changes| !all_listed(changes, of))
                .map(|changes| self::changes(changes, of.confirmation)),
        )
        .collect()
}

/// The findings for a table, the parameters first; what would have been seen where there are none.
pub(in crate::report) fn findings_in_short(of: &Diagnosis) -> Vec<String> {
    if of.verdict == Verdict::NothingSignificant {
        return Vec::from_iter(
            hardest(of).map(|(most, ..)| format!("an effect of {} Nm RMS would have been seen", digits(most))),
        );
    }
    let listed_changes = of.changes.iter().filter(|changes| !all_listed(changes, of));
    let changed = listed_changes.flat_map(|changes| &changes.effects);
    let effects: Vec<&Effect> = of.effects.iter().chain(changed).collect();
    let one = effects.len() == 1;
    let effect = |effect: &&Effect| {
        let parameters = effect.parameters.0.iter().map(|p| format!("{} {}", p.name, quantity(p, "+-")));
        // The headline names an effect that is alone.
        let mut parts: Vec<String> = if one { Vec::new() } else { vec![name(effect)] };
        parts.extend(parameters);
        parts.extend((!one).then(|| confirmed(effect, of.confirmation)));
        let rivals = effect.alternatives.iter().map(|id| format!("or {}", plain(id)));
        parts.into_iter().chain(rivals).collect::<Vec<_>>().join(", ")
    };
    let unexplained = of.unexplained.iter().map(|open| {
        let size = open.rms.map_or(String::new(), |rms| format!(": {} Nm", fixed(rms)));
        let depends = if open.depends_on.is_empty() {
            String::new()
        } else {
            format!(" over {}", listed(open.depends_on.iter().cloned()))
        };
        format!("unexplained in joint {}{size}{depends}", open.joint)
    });
    effects.iter().map(effect).chain(unexplained).filter(|line| !line.is_empty()).collect()
}

/// Whether the only effect was confirmed; `None` where there is not one alone.
pub(in crate::report) fn confirmation_of_one(of: &Diagnosis) -> Option<String> {
    match &of.effects[..] {
        [effect] => Some(confirmed(effect, of.confirmation)),
        _ => None,
    }
}

/// That an effect is not in the delivered model, where it is not.
pub(super) fn left(effect: &Effect) -> Option<&'static str> {
    match (effect.in_model, effect.stratum) {
        (true, _) => None,
        (false, Stratum::Changing) if effect.acts.is_some() => {
            Some("not in the model, which is that of the arm at the recording's end")
        }
        (false, _) if effect.acts.is_some() => Some("not in the model, which is that of the arm without it"),
        // The model is one of what repeats: nobody has weighed whether to add it.
        (false, Stratum::Changing) => Some("not in the model"),
        (false, _) => Some("not added to the model"),
    }
}

/// Whether everything that changed stands among the effects already.
fn all_listed(changes: &Changes, of: &Diagnosis) -> bool {
    let among =
        |effect: &Effect| of.effects.iter().any(|other| (&other.id, &other.joints) == (&effect.id, &effect.joints));
    !changes.effects.is_empty() && changes.effects.iter().all(among)
}

const NAMED: usize = 2;

/// What was found, in a few words for the head of the page; what the verdict says by itself is not repeated.
pub(in crate::report) fn headline(of: &Diagnosis) -> String {
    let changed = of.changes.iter().filter(|changes| !all_listed(changes, of)).flat_map(|changes| &changes.effects);
    let mut names: Vec<String> = of.effects.iter().chain(changed).map(name).collect();
    names.extend(of.unexplained.iter().map(|open| format!("a residual in joint {}", open.joint)));
    match (of.verdict, names.len()) {
        (Verdict::NothingSignificant, _) => String::new(),
        (_, count) if count <= NAMED => listed(names),
        _ => counted(of),
    }
}

/// What follows the headline and is in none of the tables.
pub(super) fn sentences(of: &Diagnosis) -> Vec<String> {
    let mut sentences = Vec::new();
    if of.verdict == Verdict::NothingSignificant {
        sentences.push(seen(of));
    }
    sentences.extend(of.unexplained.iter().map(unexplained));
    let unchanged = of.changes.iter().filter(|changes| changes.effects.is_empty());
    sentences.extend(unchanged.map(|changes| self::changes(changes, of.confirmation)));
    sentences
}

/// `2 effects, 1 joint unexplained`.
fn counted(of: &Diagnosis) -> String {
    let count = |count: usize, one: &str, many: &str| match count {
        0 => None,
        1 => Some(format!("1 {one}")),
        _ => Some(format!("{count} {many}")),
    };
    let apart = of.changes.iter().filter(|changes| !all_listed(changes, of));
    let changed: usize = apart.map(|changes| changes.effects.len()).sum();
    let parts = [
        count(of.effects.len(), "effect", "effects"),
        count(of.unexplained.len(), "joint unexplained", "joints unexplained"),
        count(changed, "change", "changes"),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

/// Torque RMS of the effect that is hardest to see, of the median one, and which it is, in which joint (from 0).
fn hardest(of: &Diagnosis) -> Option<(f64, f64, &str, usize)> {
    let each = of
        .minimum_detectable
        .iter()
        .flat_map(|(id, least)| least.torque_rms.iter().enumerate().map(move |(j, rms)| (*rms, id.as_str(), j)));
    let mut all: Vec<(f64, &str, usize)> = each.filter(|(rms, ..)| rms.is_finite()).collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (&(most, id, j), &(half, ..)) = (all.last()?, all.get(all.len() / 2)?);
    Some((most, half, id, j))
}

/// What "nothing" means, as a number.
fn seen(of: &Diagnosis) -> String {
    let Some((most, half, id, j)) = hardest(of) else {
        return "how small an effect would have been seen is not known".into();
    };
    let except = if of.not_identifiable.is_empty() { "" } else { ", unless the base parameters absorb it" };
    format!(
        "any known effect of {} Nm RMS or more would have been seen{except}, half of them from {} Nm on (hardest to see: {} in joint {})",
        digits(most),
        digits(half),
        plain(id),
        j + 1
    )
}

pub(super) fn plain(id: &str) -> String {
    id.replace('-', " ")
}

/// An effect by id and place: `presliding in joint 4`.
pub(super) fn placed(id: &str, joints: &[usize]) -> String {
    let place = places(joints);
    if place.is_empty() { plain(id) } else { format!("{} in {place}", plain(id)) }
}

/// The name of an effect: `presliding in joint 4`, `mounting since session 2`, `payload since 10.1 s of run_3.csv`, or its own label.
pub(in crate::report) fn name(effect: &Effect) -> String {
    if !effect.label.is_empty() {
        return effect.label.clone();
    }
    let since = effect.since_session.map_or(String::new(), |session| format!(" since session {session}"));
    let acts = effect.acts.as_ref().map_or(String::new(), |acts| format!(" {acts}"));
    placed(&effect.id, &effect.joints) + &since + &acts
}

fn finding(effect: &Effect, confirmation: Option<Confirmation>) -> String {
    let parameters: Vec<String> =
        effect.parameters.0.iter().map(|p| format!("{} {}", p.name, quantity(p, "+-"))).collect();
    let parameters = if parameters.is_empty() { String::new() } else { format!(" ({})", parameters.join(", ")) };
    format!("{}{parameters}, {}{}", name(effect), confirmed(effect, confirmation), rivals(effect))
}

/// Whether an effect held in trajectories that were left out; `why` not, where nobody could say.
pub(super) fn confirmed(effect: &Effect, confirmation: Option<Confirmation>) -> String {
    let (positive, informative) = (effect.folds.positive, effect.folds.informative);
    // What the search of the means has found was tested as any other.
    if effect.stratum == Stratum::Changing && effect.idf.is_none() {
        // No trajectory is left out for it; some effects show in each for itself.
        let trajectories =
            if informative > 1 { format!(" in {positive} of {informative} trajectories") } else { String::new() };
        return format!("changes from period to period{trajectories}");
    }
    match (effect.confirmed, informative) {
        (true, 0) => "confirmed".into(),
        (true, _) => format!("confirmed in {positive} of {informative} trajectories"),
        (false, 0) => match confirmation {
            None | Some(Confirmation::Full { .. }) => "unconfirmed".into(),
            Some(why) => format!("unconfirmed ({why})"),
        },
        (false, _) => {
            let left_out = if confirmation == Some(Confirmation::NoRepeats) { "blocks" } else { "trajectories" };
            format!("unconfirmed (held in {positive} of {informative} {left_out})")
        }
    }
}

/// What this data can't tell from an effect, and what would decide.
fn rivals(effect: &Effect) -> String {
    if effect.alternatives_detail.is_empty() {
        let ids: Vec<String> = effect.alternatives.iter().map(|id| plain(id)).collect();
        return if ids.is_empty() { String::new() } else { format!("; or {}", ids.join(", or ")) };
    }
    let names = effect.alternatives_detail.iter().map(|other| {
        let gap = other.score_gap.map_or(String::new(), |gap| format!(" (score {} lower)", digits(gap)));
        format!("{}{gap}", placed(&other.id, &other.joints))
    });
    let mut text = format!("; or {}", names.collect::<Vec<_>>().join(", or "));
    let mut experiments: Vec<&str> = Vec::new();
    for other in &effect.alternatives_detail {
        let experiment = other.deciding_experiment.trim_end_matches('.');
        if !experiment.is_empty() && !experiments.contains(&experiment) {
            experiments.push(experiment);
        }
    }
    if !experiments.is_empty() {
        text += &format!("; to decide: {}", experiments.join("; or "));
    }
    text
}

/// What the recorded runs leave open where a motion is planned for it; what the verdict says is not repeated elsewhere.
pub(super) fn open(of: &Diagnosis) -> impl Iterator<Item = String> {
    of.open.iter().filter(|open| open.expected.is_some()).map(open_question)
}

/// What the recorded runs leave open, and what the planned motion is expected to answer.
pub(in crate::report) fn open_question(open: &Open) -> String {
    let Open { question, kind, now, wanted, expected } = open;
    let what = match kind {
        OpenKind::Rivals => "score difference",
        OpenKind::Interval => "half width of the 95 % interval",
        OpenKind::Parameters => "deviations, relative to the recorded runs'",
    };
    let expected =
        expected.map_or(String::new(), |expected| format!(", expected with the planned motion {}", digits(expected)));
    format!("{question}: {what} {}{expected} ({} answers it)", digits(*now), digits(*wanted))
}

/// What stays unexplained in a joint, in one sentence.
pub(super) fn unexplained(of: &Unexplained) -> String {
    let size = of.rms.map_or("a residual".to_string(), |rms| format!("{} Nm", fixed(rms)));
    let dependence = if of.depends_on.is_empty() {
        "for which no dependence was found".to_string()
    } else {
        let r2 = of.r2.map_or(String::new(), |r2| format!(" (R2 {r2:.2})"));
        format!("that depends on {}{r2}", listed(of.depends_on.iter().cloned()))
    };
    let mut text = match (of.rms, of.floor) {
        // Without repeats nobody knows how much of it is noise.
        (Some(_), None) => format!("joint {} keeps {size} {dependence}", of.joint),
        (_, floor) => {
            let floor = floor.map_or(String::new(), |floor| format!(" ({})", fixed(floor)));
            format!("joint {} has {size} beyond its noise{floor} {dependence}", of.joint)
        }
    };
    for (what, more) in [("", &of.note), ("to decide: ", &of.deciding_experiment)] {
        if !more.is_empty() {
            text += &format!("; {what}{}", more.trim_end_matches('.'));
        }
    }
    text
}

/// What a learned term takes of a joint's residual, in one sentence.
pub(super) fn empirical(of: &Empirical) -> String {
    let joint = of.joint;
    let share = of.share.map_or("a part".to_string(), |share| format!("{:.0} %", 100.0 * share));
    let mut text = format!("{} takes {share} of what is left in joint {joint} where it was not fitted", of.name());
    if let Some(cap) = of.cap {
        text += &format!(", at most {} Nm in any state", fixed(cap));
    }
    if let (Some(before), Some(after)) = (of.rms.before, of.rms.after) {
        text += &format!("; RMS of joint {joint} on unseen runs {} -> {} Nm", fixed(before), fixed(after));
    }
    if let Some(Symbolic { law, parameters, .. }) = &of.symbolic {
        let values: Vec<String> = parameters.0.iter().map(|p| format!("{} {}", p.name, quantity(p, "+-"))).collect();
        text += &format!("; nearly as much takes {law} ({})", values.join(", "));
    }
    if let Some(why) = &of.withheld {
        text += &format!("; not added to the model: {why}");
    }
    text
}

fn changes(of: &Changes, confirmation: Option<Confirmation>) -> String {
    let effects: Vec<String> = of.effects.iter().map(|effect| finding(effect, confirmation)).collect();
    let effects = if effects.is_empty() { "nothing changed".to_string() } else { effects.join("; ") };
    let session = if of.session.is_empty() { String::new() } else { format!("{}, ", of.session) };
    let note = if of.note.is_empty() { String::new() } else { format!("; {}", of.note.trim_end_matches('.')) };
    let helped = helped(of).map_or(String::new(), |text| format!("; {text}"));
    format!("{session}since {}: {effects}{helped}{note}", of.since)
}

/// How much better the earlier model is with the changes, in its worst joint.
pub(super) fn helped(of: &Changes) -> Option<String> {
    let (before, after) = (of.before.as_ref()?, of.after.as_ref()?);
    let known = before.validate_rms.iter().enumerate().filter(|(_, rms)| rms.is_finite());
    let (worst, rms) = known.max_by(|a, b| a.1.total_cmp(b.1))?;
    let now = after.validate_rms.get(worst).copied().unwrap_or(f64::NAN);
    Some(format!(
        "error of that model, worst joint ({}): {} -> {} Nm with the changes",
        worst + 1,
        fixed(*rms),
        fixed(now)
    ))
}

/// Three decimals; a dash where there is no number.
pub(super) fn fixed(value: f64) -> String {
    if !value.is_finite() {
        return "-".into();
    }
    // Adding zero takes the sign from a rounded zero.
    format!("{:.3}", (value * 1e3).round() / 1e3 + 0.0)
}

/// Value, standard deviation and unit of a parameter, with as many decimals as the standard deviation has meaning; `sign` stands
/// between the two.
pub(super) fn quantity(p: &Quantity, sign: &str) -> String {
    if !p.value.is_finite() {
        return "-".into();
    }
    // A thousandth of a radian, second or metre is what such parameters come in.
    let small = p.value.abs() < 0.1 && p.std.is_none_or(|std| std < 0.1);
    let milli = small && ["rad", "s", "m", "rad/Nm"].contains(&p.unit.as_str());
    let (scale, prefix) = if milli { (1e3, "m") } else { (1.0, "") };
    let unit = if p.unit.is_empty() || p.unit == "1" { String::new() } else { format!(" {prefix}{}", p.unit) };
    let value = p.value * scale;
    let Some(std) = p.std.map(|std| std * scale).filter(|std| *std > 0.0 && std.is_finite()) else {
        return format!("{}{unit}", digits(value));
    };
    // Two digits of a deviation that starts with 1 or 2, else one.
    let exponent = std.log10().floor();
    let leading = (std / 10f64.powf(exponent)).round();
    let decimals = (if leading < 3.0 { 1.0 - exponent } else { -exponent }).clamp(0.0, 9.0) as usize;
    format!("{:.decimals$} {sign} {std:.decimals$}{unit}", value + 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary_of(value: f64, std: Option<f64>, unit: &str) -> String {
        quantity(&Quantity { name: "p".into(), value, std, unit: unit.into() }, "+-")
    }

    #[test]
    fn quantities_have_the_digits_that_their_deviation_allows() {
        assert_eq!(summary_of(0.002137, Some(0.000098), "rad"), "2.14 +- 0.10 mrad");
        assert_eq!(summary_of(0.1603, Some(0.0123), "Nm"), "0.160 +- 0.012 Nm");
        assert_eq!(summary_of(0.73104, Some(0.0041), "kg"), "0.731 +- 0.004 kg");
        assert_eq!(summary_of(-123.4, Some(56.0), "s"), "-123 +- 56 s");
        assert_eq!(summary_of(0.004, None, "s"), "4.00 ms");
        assert_eq!(summary_of(0.02, Some(0.0), "Nm"), "0.0200 Nm");
        assert_eq!(summary_of(1.0342, Some(0.0021), "1"), "1.0342 +- 0.0021");
        assert_eq!(summary_of(f64::NAN, Some(1.0), "Nm"), "-");
        assert_eq!((fixed(-0.0002), fixed(f64::NAN), fixed(0.1234)), ("0.000".into(), "-".into(), "0.123".into()));
    }

    #[test]
    fn lists_are_joined_as_people_do() {
        let list = |items: &[&str]| listed(items.iter().map(|item| item.to_string()));
        assert_eq!((list(&[]), list(&["a"]), list(&["a", "b"])), (String::new(), "a".into(), "a and b".into()));
        assert_eq!(list(&["a", "b", "c"]), "a, b and c");
        assert_eq!(placed("torque-crosstalk", &[5, 6]), "torque crosstalk in joints 5 and 6");
        assert_eq!(placed("base-motion", &[]), "base motion");
    }
}
