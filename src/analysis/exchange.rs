//! Runs that take each other's places: an unseen run that differs from those identified from may have changed, or shows what they do not excite.

use crate::analysis::SAME_MOUNTING;
use crate::analysis::diagnosis::{self, Diagnosed, Question};
use crate::dataset::Run;
use crate::failure::Failure;
use plumbline_diagnose::{Diagnosis, Disagreement};
use std::collections::BTreeSet;

/// Periods from which on a motion counts as repeating when runs are exchanged.
const MIN_PERIODS: usize = 2;
/// Runs to identify from of which one may become an unseen one.
const MIN_IDENTIFIED: usize = 2;
/// What an effect of the model costs,
const COST_OF_MODEL: usize = 2;
/// one that acts in some runs only,
const COST_OF_OTHERS: usize = 3;
/// one thing without a name: two effects are rather believed;
const COST_OF_NAMELESS: usize = 4;
/// and a run that only the errors of the parameters explain.
const COST_OF_UNDETERMINED: usize = 2;

/// Diagnoses runs of one arm; an unseen run that differs is identified from, too, where that explains more with less. Returns the runs that were
/// identified from and the unseen ones.
pub fn run<'a>(question: &Question<'a>) -> Result<(Diagnosed, Vec<&'a Run>, Vec<&'a Run>), Failure> {
    let first = diagnosis::run(question)?;
    let second = exchanged(question, &first.block).and_then(|(identify, unseen)| {
        let second = diagnosis::run(&Question { identify: &identify, unseen: &unseen, ..*question }).ok()?;
        let [before, after] = [&first, &second].map(|of| (&of.block, of.unnamed));
        explains_more(before, after).then_some((second, identify, unseen))
    });
    let Some((mut second, identify, unseen)) = second else {
        return Ok((first, question.identify.to_vec(), question.unseen.to_vec()));
    };
    let names = |runs: &[&Run]| runs.iter().map(|run| run.data.name.as_str()).collect::<Vec<_>>().join(", ");
    let known = |run: &&Run| question.identify.iter().any(|own| std::ptr::eq(*own, *run));
    let moved: Vec<&Run> = identify.iter().copied().filter(|run| !known(run)).collect();
    second.block.notes.push(format!(
        "identified from {}, too, for it differs from the others; unseen: {}",
        names(&moved),
        names(&unseen)
    ));
    Ok((second, identify, unseen))
}

/// Whether the second of two diagnoses, each with the number of runs that differ without a name, has as many effects and asks to believe less.
fn explains_more(first: (&Diagnosis, usize), second: (&Diagnosis, usize)) -> bool {
    let as_many = kinds(second.0) >= kinds(first.0).max(1);
    as_many && cost(second) < cost(first)
}

/// Effects that were found, in any number of runs.
fn kinds(of: &Diagnosis) -> usize {
    of.effects.iter().map(|effect| (&effect.id, &effect.joints)).collect::<BTreeSet<_>>().len()
}

/// What a verdict asks to believe: more where an effect acts in some runs only than in all of them, and most where a joint or run has something
/// without a name.
fn cost((of, unnamed): (&Diagnosis, usize)) -> usize {
    let of_model = of.effects.iter().filter(|effect| effect.in_model).count();
    let others = of.effects.len() - of_model;
    let nameless = of.unexplained.len() + unnamed;
    COST_OF_MODEL * of_model
        + COST_OF_OTHERS * others
        + COST_OF_NAMELESS * nameless
        + COST_OF_UNDETERMINED * of.undetermined.len()
}

/// Runs to identify from and unseen ones, where those that decide on findings and differ are identified from. If no other is unseen, the last run that
/// was identified from takes their place. `None` where none differs that is comparable with the identified ones.
fn exchanged<'a>(question: &Question<'a>, block: &Diagnosis) -> Option<(Vec<&'a Run>, Vec<&'a Run>)> {
    let first = question.identify.first()?;
    let repeats = |run: &Run| run.data.periods() >= MIN_PERIODS;
    let comparable =
        |run: &Run| run.data.mounting.angle_to(&first.data.mounting) < SAME_MOUNTING && repeats(run) == repeats(first);
    let with_effects = block.effects.iter().any(|effect| effect.in_model);
    let differs = |run: &Run| {
        let among = |runs: &[Disagreement]| runs.iter().any(|one| one.run == run.data.name);
        // What only the errors of the parameters explain is not excited by the identified runs.
        among(&block.disagreements) || with_effects && among(&block.undetermined)
    };
    let (deciding, measuring) = question.unseen.split_at(diagnosis::deciding(question.unseen.len()));
    let (moved, mut unseen): (Vec<&Run>, Vec<&Run>) = deciding.iter().partition(|run| differs(run) && comparable(run));
    if moved.is_empty() {
        return None;
    }
    unseen.extend(measuring);
    let mut identify = question.identify.to_vec();
    if unseen.is_empty() {
        unseen.extend(identify.pop().filter(|_| question.identify.len() >= MIN_IDENTIFIED));
    }
    identify.extend(moved);
    (!unseen.is_empty()).then_some((identify, unseen))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::dataset::Role;
    use nalgebra::DMatrix;
    use plumbline_diagnose::Effect;
    use plumbline_diagnose::errors::Of;
    use plumbline_diagnose::outcome::Unexplained;
    use plumbline_identify::Settings;
    use plumbline_identify::solve::Options;
    use plumbline_model::{Mounting, Robot};

    /// Two periods of a second, or a run without repeats.
    fn recording(name: &str, mounting: Mounting, repeats: bool) -> Run {
        let t: Vec<f64> = (0..200).map(|k| k as f64 * 1e-2).collect();
        let (q, tau) = (DMatrix::zeros(t.len(), 7), DMatrix::zeros(t.len(), 7));
        let period = repeats.then_some(1.0);
        Run::new(plumbline_identify::Run { name: name.into(), t, q, dq: None, tau, mounting, period }, Role::Identify)
    }

    /// Names of the runs to identify from and of the unseen ones after an exchange, where these `differ`.
    fn after(identify: &[&Run], unseen: &[&Run], differ: &[&str]) -> Option<[Vec<String>; 2]> {
        let block = Diagnosis { disagreements: differ.iter().map(differs).collect(), ..Diagnosis::default() };
        after_of(identify, unseen, &block)
    }

    fn differs(run: &&str) -> Disagreement {
        Disagreement { run: run.to_string(), joint: 1, ..Disagreement::default() }
    }

    fn after_of(identify: &[&Run], unseen: &[&Run], block: &Diagnosis) -> Option<[Vec<String>; 2]> {
        let robot = Robot::load("panda", None).unwrap();
        let structure = crate::setup::friction_structure(&robot, &Mounting::WALL);
        let question = Question {
            robot: &robot,
            structure: &structure,
            identify,
            unseen,
            settings: &Settings::default(),
            options: &Options::default(),
            diagnosis: &plumbline_diagnose::Settings::default(),
            of: Of::Filtered,
        };
        let names = |runs: Vec<&Run>| runs.iter().map(|run| run.data.name.clone()).collect();
        exchanged(&question, block).map(|(identify, unseen)| [names(identify), names(unseen)])
    }

    #[test]
    fn a_run_that_differs_is_identified_from_and_some_run_stays_unseen() {
        let [a, b, c, d, e] = ["a", "b", "c", "d", "e"].map(|name| recording(name, Mounting::WALL, true));
        let words = |of: [&str; 2]| Some(of.map(|names| names.split(' ').map(str::to_string).collect::<Vec<_>>()));
        assert_eq!(after(&[&a, &b], &[&c, &d, &e], &["c"]), words(["a b c", "d e"]));
        assert_eq!(after(&[&a, &b], &[&c], &["c"]), words(["a c", "b"]), "the last one takes its place");
        assert_eq!(after(&[&a], &[&c], &["c"]), None, "nothing would be unseen");
        assert_eq!(after(&[&a, &b], &[&c, &d], &["d"]), None, "the second half only measures");
        let (tilted, once) = (recording("tilted", Mounting::UPRIGHT, true), recording("once", Mounting::WALL, false));
        assert_eq!(after(&[&a, &b], &[&tilted, &d], &["tilted"]), None);
        assert_eq!(after(&[&a, &b], &[&once, &d], &["once"]), None);
    }

    /// Of a plain model they say that nothing is determined; effects may be what they do not show.
    #[test]
    fn a_run_that_the_errors_of_the_parameters_explain_is_identified_from_where_there_are_effects() {
        let [a, b, c] = ["a", "b", "c"].map(|name| recording(name, Mounting::WALL, true));
        let effect = |in_model: bool| Effect { id: "spring".into(), in_model, ..Effect::default() };
        let block =
            |effects: Vec<Effect>| Diagnosis { effects, undetermined: vec![differs(&"c")], ..Diagnosis::default() };
        let after = |effects: Vec<Effect>| after_of(&[&a, &b], &[&c], &block(effects));
        assert_eq!(after(vec![effect(true)]).unwrap()[0], ["a", "c"]);
        assert_eq!((after(vec![]), after(vec![effect(false)])), (None, None));
        let determined = Diagnosis { undetermined: Vec::new(), ..block(vec![effect(true)]) };
        assert!(explains_more((&block(vec![effect(true)]), 0), (&determined, 0)), "with as many effects");
    }

    #[test]
    fn a_diagnosis_of_exchanged_runs_is_taken_where_it_names_as_much_and_asks_to_believe_less() {
        let effect = |id: &str, in_model: bool| Effect { id: id.into(), in_model, ..Effect::default() };
        let block = |effects: Vec<Effect>, unexplained: usize| Diagnosis {
            effects,
            unexplained: vec![Unexplained::default(); unexplained],
            ..Diagnosis::default()
        };
        let (nothing, nameless) = (block(vec![], 0), block(vec![], 1));
        let spring = block(vec![effect("spring", true)], 0);
        assert!(explains_more((&nameless, 0), (&spring, 0)) && explains_more((&nothing, 1), (&spring, 0)));
        assert!(!explains_more((&spring, 0), (&nothing, 0)), "an effect is not given up");
        // What all runs have is less than what changed in one of them, and that in two of them is still one effect.
        let once = block(vec![effect("spring", false)], 0);
        let twice = block(vec![effect("spring", false), effect("spring", false)], 0);
        assert!(explains_more((&once, 0), (&spring, 0)) && explains_more((&twice, 0), (&spring, 0)));
        assert!(!explains_more((&spring, 0), (&once, 0)) && !explains_more((&once, 0), (&once, 0)));
        // Two effects rather than one thing without a name, and no more of them.
        let effects = |count: usize| block((0..count).map(|k| effect(&k.to_string(), true)).collect(), 0);
        assert!(explains_more((&nameless, 1), (&effects(3), 0)) && !explains_more((&nameless, 0), (&effects(2), 0)));
        let beside = block(vec![effect("spring", true), effect("mounting", false)], 0);
        assert!(!explains_more((&beside, 0), (&once, 0)), "the spring would be lost");
    }
}
