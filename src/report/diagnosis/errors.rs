//! Errors before and after a diagnosis in plain words.

use super::words::fixed;
use super::{Diagnosis, Effect, Errors};
use crate::report::Band;
use crate::report::summary::{CHANGED, band_of};

/// Errors on unseen runs: the worst joint first, then all of them.
pub(super) fn add_to(lines: &mut Vec<String>, of: &Diagnosis) {
    lines.extend(error(of));
    if of.band != Band::Raw && !of.noise_floor.is_empty() {
        let floor = of.noise_floor.iter().copied().map(fixed).collect::<Vec<_>>().join("  ");
        lines.push(format!("noise floor [Nm] {}: {floor}", band_of(&of.band)));
    }
    if !grown(of) {
        lines.extend((!of.before.validate_rms.is_empty()).then(|| format!("RMS [Nm]: {}", row(&of.before))));
        return;
    }
    for (name, errors) in [("before", Some(&of.before)), ("after", Some(&of.after)), ("change", of.change.as_ref())] {
        let errors = errors.filter(|errors| !errors.validate_rms.is_empty());
        lines.extend(errors.map(|errors| format!("RMS {name} [Nm]: {}", row(errors))));
    }
}

/// What the mean period of the joint that lacked most lacks, before and after; `None` where nothing repeats or no effect was added.
pub(super) fn lead(of: &Diagnosis) -> Option<String> {
    let before = |joint: &usize| of.joints[*joint].unmodelled.before.unwrap_or(0.0);
    let worst =
        (0..of.joints.len()).max_by(|one, other| before(one).total_cmp(&before(other))).filter(|_| grown(of))?;
    let facts = of.joints[worst];
    let (before, after) = (facts.unmodelled.before?, facts.unmodelled.after?);
    facts.floor_of_mean?;
    let (before, after) = (fixed(before), fixed(after));
    Some(format!("Torque that repeats and is not modelled, joint {}: {before} -> {after} Nm", worst + 1))
}

/// The worst joint's error on unseen runs, and what its mean period lacks.
fn error(of: &Diagnosis) -> Option<String> {
    error_with(of, true)
}

/// The worst joint's error on unseen runs alone.
pub(super) fn error_of_runs(of: &Diagnosis) -> Option<String> {
    error_with(of, lead(of).is_none())
}

fn error_with(of: &Diagnosis, mean_period: bool) -> Option<String> {
    let (before, after) = (&of.before, &of.after);
    let worst = worst(of, before)?;
    let band = match band_of(&of.band) {
        band if band.is_empty() => String::new(),
        band => format!(" {band}"),
    };
    let floor =
        |j: usize| of.noise_floor.get(j).map_or(String::new(), |floor| format!("noise floor {}", fixed(*floor)));
    let with = |j: usize| if floor(j).is_empty() { String::new() } else { format!(" ({})", floor(j)) };
    let start = format!("error on unseen runs{band}, worst joint");
    let figure = fixed(before.validate_rms[worst]);
    if !grown(of) {
        let added = if of.effects.is_empty() { "" } else { "; no effect was added to the model" };
        return Some(format!("{start} ({}): {figure} Nm{}{added}", worst + 1, with(worst)));
    }
    let now = after.validate_rms.get(worst).copied().unwrap_or(f64::NAN);
    let apart = |j: usize| size(of, after, j) > (1.0 + CHANGED) * size(of, after, worst);
    let next = self::worst(of, after).filter(|next| apart(*next));
    let next =
        next.map_or(String::new(), |j| format!("; worst now ({}): {}{}", j + 1, fixed(after.validate_rms[j]), with(j)));
    let lacks = unmodelled(of, worst).filter(|_| mean_period).unwrap_or_default();
    Some(format!("{start} ({}): {figure} -> {} Nm{}{lacks}{next}", worst + 1, fixed(now), with(worst)))
}

/// What repeats in a joint and is not noise, before and after; `None` where the noise of the mean period is unknown.
fn unmodelled(of: &Diagnosis, joint: usize) -> Option<String> {
    let facts = of.joints.get(joint).filter(|facts| facts.floor_of_mean.is_some())?;
    let (before, after) = (facts.unmodelled.before?, facts.unmodelled.after?);
    Some(format!("; unmodelled torque of the mean period {} -> {} Nm", fixed(before), fixed(after)))
}

/// Whether the delivered model has effects or learned terms that the one before had not, or was identified without what acts in a part of the recording.
pub(in crate::report) fn grown(of: &Diagnosis) -> bool {
    let learned = of.empirical.iter().any(|term| term.in_model);
    !of.after.validate_rms.is_empty() && (learned || of.effects.iter().any(Effect::counts))
}

/// The joint whose error is farthest above its noise.
fn worst(of: &Diagnosis, errors: &Errors) -> Option<usize> {
    let sizes = (0..errors.validate_rms.len()).map(|j| (j, size(of, errors, j)));
    sizes.filter(|(_, size)| size.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(j, _)| j)
}

/// An error over its noise; the error itself where the noise of a joint is unknown.
fn size(of: &Diagnosis, errors: &Errors, j: usize) -> f64 {
    let rms = errors.validate_rms.get(j).copied().unwrap_or(f64::NAN);
    let known = of.noise_floor.len() == errors.validate_rms.len() && of.noise_floor.iter().all(|floor| *floor > 0.0);
    if known { rms / of.noise_floor[j] } else { rms }
}

/// All joints: value and interval.
fn row(errors: &Errors) -> String {
    let cell = |(j, rms): (usize, &f64)| match errors.intervals.get(j) {
        Some([low, high]) if low.is_finite() && high.is_finite() => {
            format!("{} [{} {}]", fixed(*rms), fixed(*low), fixed(*high))
        }
        _ => fixed(*rms),
    };
    errors.validate_rms.iter().enumerate().map(cell).collect::<Vec<_>>().join("  ")
}
