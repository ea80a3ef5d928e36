//! The tables of a part of the study.

use plumbline_diagnose::Verdict;
use plumbline_model::term::effect::Spec;
use plumbline_testkit::diagnosis::case::{Case, FAMILIES, What};
use plumbline_testkit::diagnosis::trial::{Judged, same};
use std::collections::BTreeMap;
use std::fmt;

/// Edges of what re-identification leaves of an effect over the noise floor.
const BINS: [(f64, f64); 4] = [(0.0, 0.5), (0.5, 0.75), (0.75, 1.0), (1.0, f64::INFINITY)];

pub struct Tally<'a> {
    pub what: What,
    pub seed: u64,
    pub cases: &'a [(Case, Judged)],
}

fn short(spec: &Spec) -> String {
    let form = if spec.form.is_empty() { String::new() } else { format!(".{}", spec.form) };
    format!("{}{form} @{}", spec.family, spec.site.suffix())
}

pub fn line(case: &Case, judged: &Judged) -> String {
    let list = |specs: &[Spec]| specs.iter().map(short).collect::<Vec<_>>().join(", ");
    let truth = |text: &str| text.replace("id = ", "").trim_end().replace('\n', " ");
    let truths: Vec<String> = case.effects.iter().map(|one| truth(&one.text)).collect();
    let fallback = judged.fallback.as_ref().map_or(String::new(), |found| {
        let names =
            |list: &[plumbline_diagnose::Variable]| list.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        format!(" | depends on [{}], truly [{}]", names(&found.depends_on), names(&case.effects[0].variables))
    });
    format!(
        "{} {} | {} | {} | ratio {:.2} | {} [{}] others [{}] | held out {:.2} > {:.2}{fallback} | {:.1} s",
        case.what.id(),
        case.number,
        if good(case, judged) { "ok" } else { "MISS" },
        truths.join(" + "),
        judged.ratio,
        judged.verdict.id(),
        list(&judged.found),
        list(&judged.others),
        judged.held_out[0],
        judged.held_out[1],
        judged.seconds
    )
}

fn good(case: &Case, judged: &Judged) -> bool {
    match case.what {
        What::None => judged.found.is_empty() && judged.verdict == Verdict::NothingSignificant,
        What::Foreign => matches!(judged.verdict, Verdict::Unexplained | Verdict::Partly),
        _ => judged.right.iter().all(|right| *right) && judged.extra == 0,
    }
}

fn share(count: usize, of: usize) -> String {
    format!("{count}/{of}")
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

impl fmt::Display for Tally<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let cases = self.cases;
        writeln!(f, "\n## {}, seed {}, {} cases", self.what.id(), self.seed, cases.len())?;
        match self.what {
            What::None => self.none(f)?,
            What::Three => self.three(f)?,
            What::Foreign => self.foreign(f)?,
            _ => self.one(f)?,
        }
        let [before, after] = [0, 1].map(|k| median(cases.iter().map(|(_, judged)| judged.held_out[k]).collect()));
        writeln!(f, "worst joint, held-out RMS over the noise floor, median: {before:.2} before, {after:.2} after")?;
        let worse = |judged: &Judged| judged.held_out[1] > 1.02 * judged.held_out[0];
        let worse = cases.iter().filter(|(_, judged)| worse(judged)).count();
        writeln!(f, "held-out RMS of the worst joint more than 2 % higher than before: {worse}")?;
        let seconds: Vec<f64> = cases.iter().map(|(_, judged)| judged.seconds).collect();
        let least = seconds.iter().copied().fold(f64::INFINITY, f64::min);
        writeln!(f, "a diagnosis, one thread: {least:.1} s at least, {:.1} s median", median(seconds))
    }
}

impl Tally<'_> {
    fn none(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let alarms = self.cases.iter().filter(|(_, judged)| judged.extra > 0).count();
        let quiet = |judged: &Judged| judged.verdict == Verdict::NothingSignificant;
        let quiet = self.cases.iter().filter(|(_, judged)| quiet(judged)).count();
        writeln!(f, "false alarms: {}; verdict `nothing-significant`: {}", share(alarms, self.cases.len()), quiet)
    }

    fn three(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = |of: fn(&Judged) -> &[bool]| -> usize {
            self.cases.iter().flat_map(|(_, judged)| of(judged)).filter(|right| **right).count()
        };
        let all: usize = self.cases.iter().map(|(case, _)| case.effects.len()).sum();
        let (right, listed) = (count(|judged| &judged.right), count(|judged| &judged.listed));
        let extra: usize = self.cases.iter().map(|(_, judged)| judged.extra).sum();
        writeln!(f, "found: {}; with rivals {listed}; extra {extra}", share(right, all))
    }

    fn foreign(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "form | unexplained or partly | nothing | explained away | variables found | first variable right"
        )?;
        let mut rows: BTreeMap<String, [usize; 6]> = BTreeMap::new();
        for (case, judged) in self.cases {
            let truth = &case.effects[0];
            let form = truth.text.split('"').nth(3).unwrap_or("?").to_string();
            for row in [form, "all".to_string()] {
                let row = rows.entry(row).or_default();
                row[0] += 1;
                match judged.verdict {
                    Verdict::Unexplained | Verdict::Partly => row[1] += 1,
                    Verdict::NothingSignificant | Verdict::NotDetermined => row[2] += 1,
                    Verdict::Diagnosed | Verdict::Ambiguous => row[3] += 1,
                }
                let Some(found) = &judged.fallback else { continue };
                let all = truth.variables.iter().all(|variable| found.depends_on.contains(variable));
                row[4] += usize::from(all && found.depends_on.len() == truth.variables.len());
                row[5] += usize::from(found.depends_on.iter().any(|variable| truth.variables.contains(variable)));
            }
        }
        for (form, [count, flagged, nothing, wrong, both, one]) in rows {
            writeln!(f, "{form} | {} | {nothing} | {wrong} | {both} | {one}", share(flagged, count))?;
        }
        Ok(())
    }

    fn one(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "family | cases | right | in the list | of those left at >= 1 floor | taken for")?;
        let mut all = [0; 5];
        for family in FAMILIES {
            let own: Vec<_> = self.cases.iter().filter(|(case, _)| case.effects[0].family == family).collect();
            let strong: Vec<_> = own.iter().filter(|(_, judged)| judged.ratio >= 1.0).collect();
            let right = |cases: &[&(Case, Judged)]| cases.iter().filter(|(_, judged)| judged.right[0]).count();
            let listed = own.iter().filter(|(_, judged)| judged.listed[0]).count();
            let mut taken: BTreeMap<String, usize> = BTreeMap::new();
            for (case, judged) in own.iter().filter(|(_, judged)| !judged.right[0]) {
                let first = judged.found.first().map_or("nothing".to_string(), |spec| {
                    let place = if spec.site == case.effects[0].site { "" } else { " elsewhere" };
                    format!("{}{place}", spec.family)
                });
                *taken.entry(first).or_default() += 1;
            }
            let taken: Vec<String> = taken.into_iter().map(|(name, count)| format!("{name} {count}")).collect();
            let strong_right = strong.iter().filter(|(_, judged)| judged.right[0]).count();
            let row = [own.len(), right(&own), listed, strong_right, strong.len()];
            all.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
            if !own.is_empty() {
                let [count, right, listed, strong_right, strong] = row;
                writeln!(
                    f,
                    "{family} | {count} | {right} | {listed} | {} | {}",
                    share(strong_right, strong),
                    taken.join(", ")
                )?;
            }
        }
        let [count, right, listed, strong_right, strong] = all;
        writeln!(f, "all | {count} | {right} | {listed} | {} |", share(strong_right, strong))?;
        let extra: usize = self.cases.iter().map(|(_, judged)| judged.extra).sum();
        let not_right = |(case, judged): &&(Case, Judged)| {
            judged.found.iter().any(|spec| !case.effects.iter().any(|truth| same(spec, truth)))
        };
        let with = self.cases.iter().filter(not_right).count();
        writeln!(f, "effects that were not there: {extra}, in {with} cases")?;
        writeln!(f, "left by the plain model over the noise floor | cases | found | right")?;
        for (low, high) in BINS {
            let inside: Vec<_> =
                self.cases.iter().filter(|(_, judged)| (low..high).contains(&judged.ratio)).map(|(_, j)| j).collect();
            let found = inside.iter().filter(|judged| !judged.found.is_empty()).count();
            let right = inside.iter().filter(|judged| judged.right[0]).count();
            let count = inside.len();
            writeln!(f, "{low} to {high} | {count} | {} | {}", share(found, count), share(right, count))?;
        }
        Ok(())
    }
}
