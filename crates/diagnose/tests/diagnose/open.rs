//! What is left open, and what a planned motion is expected to answer, against what it answers once it was driven.

use super::gates::synthetic::{At, FLOOR, PERIODS, Recorded, scaled};
use nalgebra::DMatrix;
use plumbline_diagnose::Outcome;
use plumbline_diagnose::{Input, OpenQuestions, Question, Settings, diagnose};
use plumbline_identify::{Run, solve};
use plumbline_model::Mounting;

fn diagnosed(recorded: &Recorded, until: Option<f64>) -> Outcome {
    let identify = recorded.trials();
    let input = Input {
        structure: &recorded.structure,
        identify: &identify,
        veto: &[],
        judge: &[],
        options: &solve::Options::default(),
        came: &[],
    };
    let outcome = diagnose(&input, &Settings { until, ..Settings::default() }, &|_| {}).unwrap();
    println!("{:?} {:#?} {:?}", outcome.diagnosis.verdict, outcome.diagnosis.effects, outcome.diagnosis.open);
    outcome
}

/// One period of a recorded motion, as a plan gives it.
fn planned(recorded: &Recorded, trajectory: usize) -> Run {
    let motion = &recorded.experiments[trajectory].motion;
    let samples = motion.samples();
    Run {
        name: "planned".into(),
        t: (0..samples).map(|k| k as f64 * motion.dt).collect(),
        q: motion.q.clone(),
        dq: None,
        tau: DMatrix::from_element(samples, 2, 1.0),
        mounting: Mounting::WALL,
        period: Some(samples as f64 * motion.dt),
    }
}

fn rivals(open: &OpenQuestions) -> Vec<(String, String, f64)> {
    let pair = |question: &Question| match question {
        Question::Rivals { effect, rival, gap } => Some((effect.to_string(), rival.to_string(), *gap)),
        _ => None,
    };
    open.questions().filter_map(pair).collect()
}

/// Ripple of one wave per turn: over a short way, a spring.
fn ripple(at: &At) -> [f64; 2] {
    [0.0, 12.0 * FLOOR * at.q[1].sin()]
}

#[test]
fn a_wide_motion_is_expected_to_tell_a_ripple_from_a_spring_and_does() {
    let mut pairs: Vec<(f64, f64)> = Vec::new();
    for seed in 121..129 {
        // The first two trajectories are short, the third as short, the fourth wide.
        let all = scaled(&[0.5, 0.5, 0.5, 5.0], seed, ripple);
        let part = |which: &[usize]| Recorded {
            structure: all.structure.clone(),
            experiments: which.iter().map(|&k| all.experiments[k].clone()).collect(),
        };
        let open = diagnosed(&part(&[0, 1]), None).open;
        let asked = rivals(&open);
        let is_pair = |one: &str, other: &str| one == "position-ripple in joint 2" && other == "spring in joint 2";
        if !asked.iter().any(|(one, other, _)| is_pair(one, other) || is_pair(other, one)) {
            continue;
        }
        assert!(asked.iter().all(|(.., gap)| *gap < 12.0), "{asked:?}");
        let expected = |trajectory: usize| open.answers(&planned(&all, trajectory), PERIODS).unwrap();
        let (narrow, wide) = (expected(2), expected(3));
        println!("expected {narrow:?} {wide:?} largest position {:?}", all.experiments[3].motion.q.amax());
        assert!(OpenQuestions::score(&wide) > OpenQuestions::score(&narrow), "{narrow:?} {wide:?}");
        assert!(narrow.iter().all(|answer| answer.share < 1.0), "{narrow:?}");
        let expected = wide[0].expected;
        let found = diagnosed(&part(&[0, 1, 3]), None);
        let gap = {
            let score = |label: &str| {
                let one = found.diagnosis.scores.iter().find(|one| one.label == label);
                one.map_or(0.0, |one| one.score)
            };
            score("position-ripple in joint 2") - score("spring in joint 2")
        };
        pairs.push((expected, gap));
        if wide[0].share > 1.0 {
            let names: Vec<&str> = found.diagnosis.effects.iter().map(|effect| effect.id.as_str()).collect();
            assert!(rivals(&found.open).is_empty() && names == ["position-ripple"], "{:?}", found.diagnosis.effects);
        }
    }
    println!("expected and found: {pairs:?}");
    assert!(pairs.len() >= 4 && pairs.iter().filter(|(expected, _)| *expected > 24.0).count() >= 2, "{pairs:?}");
}

#[test]
fn an_interval_is_as_wide_as_expected_once_the_motion_was_driven() {
    let all = scaled(&[0.8, 0.8, 2.0], 131, offset);
    let part = |which: &[usize]| Recorded {
        structure: all.structure.clone(),
        experiments: which.iter().map(|&k| all.experiments[k].clone()).collect(),
    };
    let half_width = |outcome: &Outcome| {
        let interval = |question: &Question| match question {
            Question::Interval { effect, parameter, half_width, wanted } => {
                assert!(effect.to_string() == "torque-offset in joint 2" && parameter == "offset2", "{question:?}");
                assert!((wanted / (0.001 * 8.0 * FLOOR) - 1.0).abs() < 0.5, "{question:?}");
                Some(*half_width)
            }
            _ => None,
        };
        outcome.open.questions().find_map(interval)
    };
    let before = diagnosed(&part(&[0, 1]), Some(1e-3));
    let index = before.open.questions().position(|question| matches!(question, Question::Interval { .. })).unwrap();
    let expected = before.open.answers(&planned(&all, 2), PERIODS).unwrap()[index];
    let after = diagnosed(&all, Some(1e-3));
    let (before_width, after_width) = (half_width(&before).unwrap(), half_width(&after).unwrap());
    assert!(after_width < 0.8 * before_width, "{before_width} {after_width}");
    assert!((expected.expected / after_width - 1.0).abs() < 0.15, "{expected:?} {after_width}");
    // Narrow enough, and not asked for.
    assert!([Some(0.5), None].iter().all(|until| half_width(&diagnosed(&all, *until)).is_none()));
}

fn offset(_: &At) -> [f64; 2] {
    [0.0, 8.0 * FLOOR]
}

#[test]
fn both_parts_of_a_ripple_are_measured_by_its_size() {
    let size = 12.0 * FLOOR;
    let all = scaled(&[2.0, 2.0, 2.0], 151, |at| [0.0, size * (5.0 * at.q[1]).sin()]);
    let asked = |until: f64| {
        let interval = |question: &Question| match question {
            Question::Interval { parameter, wanted, .. } => Some((parameter.clone(), *wanted)),
            _ => None,
        };
        diagnosed(&all, Some(until)).open.questions().filter_map(interval).collect::<Vec<_>>()
    };
    let found = asked(1e-4);
    let [(sine, of_sine), (cosine, of_cosine), (order, of_order)] = &found[..] else { panic!("{found:?}") };
    assert!(sine.ends_with("sin") && cosine.ends_with("cos") && order == "n", "{found:?}");
    assert!(of_sine == of_cosine && (of_sine / (1e-4 * size) - 1.0).abs() < 0.1, "{found:?}");
    assert!((of_order / (1e-4 * 5.0) - 1.0).abs() < 0.02, "{found:?}");
    // The cosine's part is near zero, and known well.
    assert!(asked(0.3).is_empty(), "{:?}", asked(0.3));
}

#[test]
fn what_has_no_name_asks_for_a_motion_unlike_the_recorded_ones() {
    // A torque that follows the product of both velocities' signs and no effect of the library.
    let strange = |at: &At| [0.0, 20.0 * FLOOR * (9.0 * at.q[0]).sin() * (7.0 * at.q[1]).cos()];
    let all = scaled(&[1.0, 1.0, 1.0, 0.2, 1.6], 141, strange);
    let recorded = Recorded { structure: all.structure.clone(), experiments: all.experiments[..3].to_vec() };
    let open = diagnosed(&recorded, None).open;
    assert!(matches!(open.questions().last(), Some(Question::Parameters)));
    let last = |trajectory: usize| *open.answers(&planned(&all, trajectory), PERIODS).unwrap().last().unwrap();
    let (little, much) = (last(3), last(4));
    // Half as many runs again: deviations fall, and more with more motion.
    assert!(much.expected < little.expected && little.expected <= 1.0 && much.expected > 0.5, "{little:?} {much:?}");
    assert!((much.share - (1.0 / much.expected).log2()).abs() < 1e-9, "{much:?}");
}
