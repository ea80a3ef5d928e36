//! What differs from period to period as effects, notes and data quality of a diagnosis.

use super::{BEGINS_APART_S, BaseMotion, Changing, Contact, Course, Drift, Drifting, Hygiene, Shared, Step};
use crate::outcome::{Acts, Diagnosis, Effect, Folds, JointFacts, Parameters, Quantity, Verdict, places};
use plumbline_model::term::{base_motion, contact};

/// Note where a drift is taken off the parameters.
pub const AT_THE_END: &str =
    "the parameters are those of the arm at the recording's end: what drifts through it is taken off";

impl Changing {
    /// Adds the findings to a diagnosis. A step has to have a share `least_floor` of the noise of the mean periods, and every finding but a contact
    /// `threshold` \[Nm\] where that is given; what has less is left out.
    pub fn add_to(&self, diagnosis: &mut Diagnosis, least_floor: f64, threshold: Option<f64>) {
        let contacts: Vec<&Contact> = self.contacts.iter().filter(|contact| !self.dates(contact, diagnosis)).collect();
        let joints = &diagnosis.joints;
        let matters = |rms: &[f64]| {
            let enough = |(rms, facts): (&f64, &JointFacts)| {
                let least = threshold.or(facts.floor_of_mean.map(|floor| least_floor * floor));
                least.is_none_or(|least| *rms >= least)
            };
            rms.iter().zip(joints).any(enough)
        };
        let wanted = |rms: &[f64]| threshold.is_none_or(|least| rms.iter().any(|rms| *rms >= least));
        let drifts: Vec<&Drift> = self.drifts.iter().filter(|drift| wanted(&drift.rms)).collect();
        let mut lines = lines(&self.base_motions);
        lines.retain(|(line, _)| wanted(&line.rms));
        let significant = !contacts.is_empty()
            || !drifts.is_empty()
            || !lines.is_empty()
            || self.steps.iter().any(|step| matters(&step.rms));
        diagnosis.verdict = match (diagnosis.verdict, significant) {
            (Verdict::NothingSignificant | Verdict::NotDetermined, true) => Verdict::Diagnosed,
            (Verdict::Unexplained, true) => Verdict::Partly,
            (verdict, _) => verdict,
        };
        for drift in drifts {
            let mut effect = self.drift(drift);
            // What one run has more than the one before is of the same cause.
            let same = |own: &mut Effect| own.acts.is_some() && effect.goes_on_as(own);
            for of_run in diagnosis.effects.extract_if(.., same).collect::<Vec<_>>() {
                let since = of_run.acts.as_ref().map_or(String::new(), ToString::to_string);
                effect.take_over(of_run, &since);
            }
            diagnosis.effects.push(effect);
        }
        // The search of the means has the parameters of those that it found. What it found nothing in beside them is how they came.
        let known = |step: &Step| {
            let near = step.earliest - BEGINS_APART_S..step.time + BEGINS_APART_S;
            let same = |acts: &Acts| acts.run == step.run && near.contains(&acts.from);
            diagnosis.effects.iter().any(|effect| effect.acts.as_ref().is_some_and(same))
        };
        let steps = self.steps.iter().filter(|step| matters(&step.rms) && !known(step)).map(came).collect::<Vec<_>>();
        diagnosis.effects.extend(steps);
        diagnosis.effects.extend(lines.iter().map(|(line, count)| self.base_motion(line, *count)));
        diagnosis.effects.extend(contacts.iter().map(|contact| touched(contact)));
        let notes = self.notes(&contacts, &diagnosis.notes);
        diagnosis.notes.extend(notes);
        self.quality(diagnosis);
    }

    /// Whether a contact that is there when its run ends is what acts since the next run, or one that is there when its run begins the lack of what acts
    /// since then. Such an effect gets the contact's time.
    fn dates(&self, contact: &Contact, diagnosis: &mut Diagnosis) -> bool {
        let next = self.runs.iter().skip_while(|run| **run != contact.run).nth(1);
        let (begun, from) = match (contact.at_ends, next) {
            ([_, true], Some(next)) => (next, contact.from),
            ([true, _], _) => (&contact.run, contact.to),
            _ => return false,
        };
        let of_arm = diagnosis.effects.iter_mut().filter(|effect| effect.joints.is_empty());
        let mut acts = of_arm.filter_map(|effect| effect.acts.as_mut());
        let Some(acts) = acts.find(|acts| acts.run == *begun && acts.from == 0.0) else { return false };
        *acts = Acts { run: contact.run.clone(), from, ..acts.clone() };
        true
    }

    fn drift(&self, drift: &Drift) -> Effect {
        let joints = match drift.what {
            Drifting::Offset(joint) | Drifting::Friction(joint) => vec![joint + 1],
            Drifting::AllFriction => Vec::new(),
        };
        let form = match drift.course {
            Course::Linear => "linear",
            Course::Saturating { .. } | Course::Warming { .. } => "exponential",
        };
        let mut parameters = Vec::new();
        for (set, (values, std)) in drift.values.iter().zip(&drift.std).enumerate() {
            for ((name, unit), (value, std)) in drift.what.parameters().iter().zip(values.iter().zip(std)) {
                let unit = if drift.course == Course::Linear { format!("{unit}/min") } else { unit.to_string() };
                let name = match self.runs.get(set).filter(|_| drift.shared == Shared::Nothing) {
                    Some(run) => format!("{name} in {run}"),
                    None => name.to_string(),
                };
                parameters.push(Quantity { std: Some(*std), ..Quantity::new(name, *value, unit) });
            }
        }
        parameters.extend(drift.course.time().map(|time| Quantity::new("T", time, "s")));
        Effect {
            joints,
            parameters: Parameters(parameters),
            evidence: Some(drift.score),
            delta_log_likelihood: Some(0.5 * drift.evidence),
            penalty: Some(drift.evidence - drift.score),
            torque_rms: drift.rms.iter().copied().reduce(f64::max),
            explained_share: Some(drift.explained),
            // One set of parameters for all runs is what more than one of them says.
            confirmed: drift.shared != Shared::Nothing && self.runs.len() > 1,
            acts: (drift.shared == Shared::Course).then(|| Acts {
                run: self.runs.first().cloned().unwrap_or_default(),
                from: 0.0,
                to_end_of_recording: true,
            }),
            ..Effect::of(drift.what.family(), form)
        }
    }

    fn base_motion(&self, line: &BaseMotion, count: usize) -> Effect {
        let [x, y, z]: [f64; 3] = line.direction.into();
        let amplitude = Quantity { std: Some(line.std), ..Quantity::new("amplitude", line.amplitude, "m/s2") };
        let direction = [("direction_x", x), ("direction_y", y), ("direction_z", z)];
        let direction = direction.map(|(name, share)| Quantity::new(name, share, "1"));
        let parameters = [Quantity::new("f", line.frequency, "Hz"), amplitude].into_iter().chain(direction);
        Effect {
            label: format!("base motion at {:.2} Hz", line.frequency),
            parameters: Parameters(parameters.collect()),
            folds: Folds { positive: count, informative: self.runs.len() + self.once.len() },
            torque_rms: line.rms.iter().copied().reduce(f64::max),
            explained_share: Some(line.explained),
            confirmed: count > 1,
            ..Effect::of(base_motion::ID, "")
        }
    }

    fn notes(&self, contacts: &[&Contact], known: &[String]) -> Vec<String> {
        let mut notes = Vec::new();
        let through = |drift: &Drift| drift.shared == Shared::Course;
        let said = known.iter().any(|note| note == AT_THE_END);
        if self.drifts.iter().any(through) && !said {
            notes.push(AT_THE_END.into());
        }
        if !self.drifts.iter().all(through) && !said {
            notes.push("the parameters are those of the recordings' mean: what drifts is not in the model".into());
        }
        let mut events: Vec<(&str, f64, f64, String)> = Vec::new();
        for one in contacts {
            events.push((&one.run, one.from, one.to, format!(": contact on link {}", one.link + 1)));
        }
        for one in &self.transients {
            let joints: Vec<usize> = one.joints.iter().map(|joint| joint + 1).collect();
            events.push((&one.run, one.from, one.to, format!(", {}: unexplained transient", places(&joints))));
        }
        events.sort_by(|a, b| a.0.cmp(b.0).then(a.1.total_cmp(&b.1)));
        let left_out =
            |run: &str| if self.spared.iter().any(|spared| spared == run) { "not left out" } else { "left out" };
        for (run, from, to, what) in events {
            notes.push(format!("run {run}, {from:.2} to {to:.2} s{what}, {}", left_out(run)));
        }
        for one in &self.hygiene {
            let (torques, positions): (usize, usize) = (one.torques.iter().sum(), one.positions.iter().sum());
            let of = |count: usize, what: &str| (count > 0).then(|| format!("{count} of the {what}"));
            let counts: Vec<String> =
                [of(torques, "torques"), of(positions, "positions")].into_iter().flatten().collect();
            if !counts.is_empty() {
                let counts = counts.join(" and ");
                let left_out = left_out(&one.run);
                notes.push(format!("run {}: spoiled samples, {counts}, {left_out}", one.run));
            }
        }
        notes.extend(self.spared.iter().map(|run| {
            format!(
                "run {run}: more than half of it would have to be left out, so nothing of it is; its mean has all of it"
            )
        }));
        notes
    }

    fn quality(&self, diagnosis: &mut Diagnosis) {
        if self.hygiene.is_empty() {
            return;
        }
        let sum = |count: &dyn Fn(&Hygiene) -> usize| -> u64 { self.hygiene.iter().map(|one| count(one) as u64).sum() };
        let quality = &mut diagnosis.quality;
        quality.outliers = Some(sum(&|one| one.torques.iter().chain(&one.positions).sum()));
        quality.repeated_stamps = Some(sum(&|one| one.repeated_stamps));
        for (count, what) in [
            (sum(&|one| one.repeated_rows), "rows repeat the one before"),
            (sum(&|one| one.missing), "samples are missing"),
        ] {
            quality.notes.extend((count > 0).then(|| format!("{count} {what}")));
        }
    }
}

/// Lines by frequency: the strongest of each, and the number of runs that have it.
pub(super) fn lines(found: &[BaseMotion]) -> Vec<(&BaseMotion, usize)> {
    let mut lines: Vec<(&BaseMotion, Vec<&str>)> = Vec::new();
    for one in found {
        match lines.iter_mut().find(|(line, _)| line.is_same_line(one)) {
            Some((line, runs)) => {
                if !runs.contains(&one.run.as_str()) {
                    runs.push(&one.run);
                }
                if one.amplitude > line.amplitude {
                    *line = one;
                }
            }
            None => lines.push((one, vec![&one.run])),
        }
    }
    lines.into_iter().map(|(line, runs)| (line, runs.len())).collect()
}

fn touched(one: &Contact) -> Effect {
    let mut parameters = vec![Quantity::new("from", one.from, "s"), Quantity::new("to", one.to, "s")];
    for (k, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let std = Some(one.force_std[k]);
        parameters.push(Quantity { std, ..Quantity::new(format!("force_{axis}"), one.force[k], "N") });
    }
    if let Some(point) = one.point {
        let axes = ["x", "y", "z"].into_iter().zip(point.iter());
        parameters.extend(axes.map(|(axis, at)| Quantity::new(format!("point_{axis}"), *at, "m")));
    } else {
        let axes = ["x", "y", "z"].into_iter().zip(one.moment.iter());
        parameters.extend(axes.map(|(axis, moment)| Quantity::new(format!("moment_{axis}"), *moment, "Nm")));
    }
    Effect {
        joints: vec![one.link + 1],
        label: format!("contact on link {} in {}, {:.2} to {:.2} s", one.link + 1, one.run, one.from, one.to),
        parameters: Parameters(parameters),
        explained_share: Some(one.explained),
        ..Effect::of(contact::ID, "")
    }
}

/// What came within a run, where the search of the means did not find it.
fn came(step: &Step) -> Effect {
    Effect {
        joints: crate::outcome::joints(step.spec.site),
        evidence: Some(step.score),
        delta_log_likelihood: Some(0.5 * step.evidence),
        penalty: Some(step.evidence - step.score),
        torque_rms: step.rms.iter().copied().reduce(f64::max),
        acts: Some(Acts { run: step.run.clone(), from: step.time, to_end_of_recording: false }),
        ..Effect::of(step.spec.family, step.spec.form)
    }
}
