//! What becomes of a finding: veto, adequacy, delivery, verdict.

use super::synthetic::{At, DT, FLOOR, Recorded, once, recorded, scaled};
use plumbline_diagnose::Outcome;
use plumbline_diagnose::outcome::{Action, BeforeAfter, Confirmation, Diagnosis, Effect, JointFacts, Verdict};
use plumbline_diagnose::{Input, Settings, diagnose};
use plumbline_identify::solve;
use plumbline_model::term::torque_offset;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Diagnoses `identify`; `veto` decides what is accepted and delivered, errors are measured on `judge`.
fn outcome(identify: &Recorded, veto: &Recorded, judge: &Recorded) -> Outcome {
    let outcome = diagnosed(identify, veto, judge);
    println!("{:?}, {:?}, joint 2: {:?}", outcome.diagnosis.verdict, labels(&outcome), outcome.diagnosis.joints[1]);
    outcome
}

fn diagnosed(identify: &Recorded, veto: &Recorded, judge: &Recorded) -> Outcome {
    let (identified, veto, judge) = (identify.trials(), veto.trials(), judge.trials());
    let input = Input {
        structure: &identify.structure,
        identify: &identified,
        veto: &veto,
        judge: &judge,
        options: &solve::Options::default(),
        came: &[],
    };
    diagnose(&input, &Settings::default(), &|_| {}).unwrap()
}

/// Findings, which are in the model, and hints, which are not.
fn labels(outcome: &Outcome) -> Vec<(&str, usize, bool)> {
    fn label(one: &Effect) -> (&str, usize, bool) {
        (one.id.as_str(), one.joints.first().copied().unwrap_or(0), one.in_model)
    }
    let Diagnosis { effects, hints, .. } = &outcome.diagnosis;
    assert!(effects.iter().all(|one| one.in_model) && hints.iter().all(|one| !one.in_model));
    effects.iter().chain(hints).map(label).collect()
}

/// An offset of joint 2 and a tone of 5 Hz whose phase is another one in every trajectory, in floors of the mean period.
fn torque(offset: f64, tone: f64) -> impl Fn(&At) -> [f64; 2] {
    move |at| {
        let phase = 2.3 * (at.trajectory * at.trajectory) as f64 + 0.4 * at.trajectory as f64;
        [0.0, FLOOR * (offset + tone * 2f64.sqrt() * (TAU * 5.0 * at.t + phase).sin())]
    }
}

/// Runs to identify from, to hold findings against, and to judge by, with these sizes each.
fn of(seed: u64, identify: (f64, f64), veto: (f64, f64), judge: (f64, f64)) -> Outcome {
    outcome(
        &recorded(4, seed, torque(identify.0, identify.1)),
        &recorded(4, seed + 2000, torque(veto.0, veto.1)),
        &recorded(2, seed + 1000, torque(judge.0, judge.1)),
    )
}

#[test]
fn what_unseen_runs_do_not_have_is_taken_out() {
    let held = of(31, (6.0, 0.0), (6.0, 0.0), (6.0, 0.0));
    assert_eq!(labels(&held), [("torque-offset", 2, true)]);
    assert!(held.diagnosis.path.iter().all(|step| step.action != Action::Removed));
    // Beside something larger the error falls by a fifth alone, which is what the effect should take.
    let beside = of(31, (6.0, 0.0), (6.0, 12.0), (6.0, 0.0));
    assert_eq!(labels(&beside), [("torque-offset", 2, true)]);
    assert!(beside.diagnosis.joints[1].adequacy.unwrap() < 0.3);
    let refuted = of(31, (6.0, 0.0), (0.0, 0.0), (6.0, 0.0));
    assert_eq!(labels(&refuted), []);
    let last = refuted.diagnosis.path.last().unwrap();
    assert!(last.action == Action::Removed && last.what == "torque-offset in joint 2", "{last:?}");
    // Nothing is delivered, and the joint stays unexplained.
    assert_eq!(refuted.after.structure.columns().len(), refuted.before.structure.columns().len());
    assert_eq!(refuted.diagnosis.verdict, Verdict::Unexplained);
}

#[test]
fn what_the_identified_runs_hardly_show_unseen_runs_that_reach_farther_may_prove() {
    let cubic = |size: f64| move |at: &At| [0.0, size * at.dq[1].powi(3)];
    let found = |seed: u64, reach: f64, size: f64| {
        let of = |seed, reach, size| scaled(&[reach; 4], seed, cubic(size));
        let outcome = outcome(&of(seed, 1.0, 3.6e-4), &of(seed + 2000, reach, size), &of(seed + 1000, reach, 3.6e-4));
        labels(&outcome).into_iter().map(|(id, joint, _)| format!("{id} {joint}")).collect::<Vec<_>>()
    };
    assert_eq!(found(36, 1.0, 3.6e-4), Vec::<String>::new());
    assert_eq!(found(36, 2.0, 3.6e-4), ["nonlinear-viscous 2"]);
    // Unseen runs without it prove nothing.
    assert_eq!(found(36, 2.0, 0.0), Vec::<String>::new());
}

#[test]
fn an_effect_is_delivered_when_it_takes_half_of_what_it_should_from_unseen_runs() {
    for (offset, tone, delivered) in [(5.0, 4.0, true), (4.0, 5.0, false)] {
        let found = of(32, (6.0, 0.0), (offset, tone), (6.0, 0.0));
        assert_eq!(labels(&found), [("torque-offset", 2, delivered)]);
        let explained = offset * offset / (offset * offset + tone * tone);
        let adequacy = found.diagnosis.joints[1].adequacy.unwrap();
        assert!((adequacy - explained).abs() < 0.08, "{adequacy} {explained}");
        let added = &found.after.structure.columns()[found.before.structure.columns().len()..];
        assert_eq!(added.iter().filter(|column| column.name == "offset2").count(), usize::from(delivered));
        // What is stated of the joint is stated of the delivered model.
        let BeforeAfter { before: Some(before), after: Some(after) } = found.diagnosis.joints[1].rms else { panic!() };
        assert!(if delivered { after < 0.5 * before } else { after == before }, "{before} {after}");
    }
}

#[test]
fn what_an_effect_should_take_is_refused_only_beyond_the_noise() {
    // Of what the plain model lacks there, 1.2 and 2 times the noise, the effect explains about a third.
    for (offset, tone) in [(0.8, 0.9), (1.2, 1.6)] {
        let found = of(33, (1.2, 0.0), (offset, tone), (1.2, 0.0));
        let joint = &found.diagnosis.joints[1];
        assert_eq!(labels(&found), [("torque-offset", 2, true)], "{offset} {tone}: {joint:?}");
        assert!(joint.adequacy.unwrap() < 0.5, "{joint:?}");
    }
    // Where it does harm it is taken out.
    assert_eq!(labels(&of(33, (1.2, 0.0), (0.4, 1.0), (1.2, 0.0))), []);
}

#[test]
fn runs_that_judge_decide_nothing() {
    let of = |seed, judge| {
        let size = (6.0, 0.0);
        let identify = recorded(4, 31, torque(size.0, size.1));
        outcome(&identify, &recorded(4, 2031, torque(size.0, size.1)), &recorded(4, seed, torque(judge, 0.0)))
    };
    let (same, other) = (of(1031, 6.0), of(3031, -6.0));
    // The other's offset has the opposite sign: the model is worse there, and that is said.
    assert_eq!(labels(&same), [("torque-offset", 2, true)]);
    let decided = |outcome: &Outcome| {
        let Diagnosis { effects, joints, unexplained, path, scores, .. } = &outcome.diagnosis;
        serde_json::to_string(&(effects, joints, unexplained, path, scores)).unwrap()
    };
    assert_eq!(decided(&same), decided(&other));
    assert_eq!(same.after.identification.beta, other.after.identification.beta);
    let worse = |outcome: &Outcome| outcome.diagnosis.after.validate_rms[1] / outcome.diagnosis.before.validate_rms[1];
    assert!(worse(&same) < 0.6 && worse(&other) > 1.4, "{} {}", worse(&same), worse(&other));
    assert!(same.diagnosis.disagreements.is_empty() && !other.diagnosis.disagreements.is_empty());
}

#[test]
fn a_verdict_says_what_is_left_over() {
    let same = |seed, size: (f64, f64)| of(seed, size, size, size);
    assert_eq!(same(34, (0.0, 0.0)).diagnosis.verdict, Verdict::NothingSignificant);
    assert!(matches!(same(34, (6.0, 0.0)).diagnosis.verdict, Verdict::Diagnosed | Verdict::Ambiguous));
    // Nine tenths of what was lacking, and less than 2.5 times the noise left over: explained.
    let most = same(34, (12.0, 2.0));
    assert!(most.diagnosis.joints[1].lacking_after(), "{:?}", most.diagnosis.joints[1]);
    assert!(matches!(most.diagnosis.verdict, Verdict::Diagnosed | Verdict::Ambiguous), "{:?}", most.diagnosis.verdict);
    // More left over, or a smaller share.
    assert_eq!(same(34, (20.0, 3.3)).diagnosis.verdict, Verdict::Partly);
    assert_eq!(same(34, (5.0, 2.2)).diagnosis.verdict, Verdict::Partly);
}

#[test]
fn what_unseen_runs_cannot_tell_the_identified_ones_do() {
    let identify = recorded(4, 34, torque(12.0, 2.0));
    let diagnosed = |unseen: &Recorded| {
        let found = outcome(&identify, unseen, unseen).diagnosis;
        assert!(found.joints[1].lacking_after(), "{:?}", found.joints[1]);
        (matches!(found.verdict, Verdict::Diagnosed | Verdict::Ambiguous), found.joints[1].adequacy)
    };
    // One run that does not repeat tells it: the noise is known from the others.
    let (explained, adequacy) = diagnosed(&once(12.0, 134, torque(12.0, 2.0)));
    assert!(explained && (0.9..1.0).contains(&adequacy.unwrap()), "{adequacy:?}");
    let (explained, adequacy) = diagnosed(&once(12.0, 134, torque(12.0, 6.0)));
    assert!(!explained && adequacy.unwrap() < 0.9, "{adequacy:?}");
    // Where unseen runs have nothing to explain the identified ones tell.
    let explained = |after: f64, adequacy: Option<f64>| {
        JointFacts {
            floor_of_mean: Some(1.0),
            unmodelled: BeforeAfter::both([6.0, after]),
            threshold: Some(0.75),
            adequacy,
            ..JointFacts::default()
        }
        .is_explained()
    };
    assert!(explained(1.8, None) && !explained(2.0, None));
    assert!(explained(2.4, Some(0.91)) && !explained(2.6, Some(0.91)) && !explained(1.8, Some(0.89)));
}

#[test]
fn what_follows_no_variable_is_unexplained_from_twice_its_noise_on() {
    let same = |seed, tone: f64| of(seed, (0.0, tone), (0.0, tone), (0.0, tone));
    let little = same(35, 0.9);
    assert!(little.diagnosis.joints[1].lacking_before(), "{:?}", little.diagnosis.joints[1]);
    assert_eq!(little.diagnosis.verdict, Verdict::NothingSignificant);
    let more = same(35, 1.3);
    assert_eq!(more.diagnosis.verdict, Verdict::Unexplained);
    assert_eq!(more.diagnosis.unexplained.iter().map(|one| one.joint).collect::<Vec<_>>(), [2]);
}

#[test]
fn a_joint_lacks_something_above_its_noise_and_above_the_threshold() {
    let lacking = |ratio: Option<f64>, unmodelled: f64| {
        let facts = JointFacts {
            floor_of_mean: Some(1.0),
            unmodelled: BeforeAfter::both([unmodelled, 0.0]),
            lack_of_fit: ratio.map_or(BeforeAfter::default(), |ratio| BeforeAfter::both([ratio, 1.0])),
            threshold: Some(0.75),
            ..JointFacts::default()
        };
        assert!(!facts.lacking_after());
        facts.lacking_before()
    };
    assert!(lacking(Some(1.31), 0.76));
    assert!(!lacking(Some(1.29), 0.76));
    assert!(!lacking(Some(1.31), 0.74));
    assert!(!lacking(None, 9.0), "nobody knows the noise");
}

#[test]
fn facts_of_a_joint_are_those_of_its_residual() {
    let found = of(40, (6.0, 1.0), (6.0, 1.0), (6.0, 1.0));
    let facts = &found.diagnosis.joints[1];
    let floor = facts.floor_of_mean.unwrap();
    let both = |of: BeforeAfter| [of.before.unwrap(), of.after.unwrap()];
    let (unmodelled, rms) = (both(facts.unmodelled), both(facts.rms));
    assert!((floor / FLOOR - 1.0).abs() < 0.05, "{floor} {FLOOR}");
    assert!((facts.threshold.unwrap() - 0.75 * floor).abs() < 1e-12);
    // The base parameters take a part of the offset over; the tone is left.
    assert!((3.0..6.5).contains(&(unmodelled[0] / FLOOR)), "{facts:?}");
    let withheld: Vec<_> = found.diagnosis.effects.iter().map(|effect| &effect.withheld).collect();
    assert!((unmodelled[1] / FLOOR - 1.0).abs() < 0.25, "{facts:?} {withheld:?}");
    for when in 0..2 {
        let square = rms[when].powi(2);
        assert!((unmodelled[when].powi(2) - (square - floor * floor)).abs() < 1e-12, "{facts:?}");
    }
    // Power over that of the noise, row by row; the tone leaves as much as the noise.
    let [was, is] = both(facts.lack_of_fit);
    assert!(was > 15.0 && (is / 2.0 - 1.0).abs() < 0.25, "{facts:?}");
    // Trajectories that were left out are predicted a little worse than those that were fitted.
    for (left_out, fitted) in both(facts.left_out).into_iter().zip(rms) {
        assert!((1.0..1.3).contains(&(left_out / fitted)), "{facts:?}");
    }
}

#[test]
fn the_least_offset_that_would_be_found_is_three_quarters_of_the_noise() {
    let found = of(37, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0));
    let offsets = &found.diagnosis.minimum_detectable["torque-offset"];
    let identify = recorded(4, 37, torque(0.0, 0.0));
    for (joint, (torque, parameter)) in offsets.torque_rms.iter().zip(&offsets.parameter).enumerate() {
        // What the base columns leave of a constant, by projection on their rows.
        let independence = identify.search(&[&torque_offset::FAMILY], &Settings::default(), |search, base| {
            let item = search.library.iter().find(|item| item.joints() == [joint]).unwrap();
            let part = item.rows.of(joint).unwrap();
            let whole: f64 = part.norm_squared();
            let rows = base.columns.m[0].nrows();
            let (mut m, mut c) = (nalgebra::DMatrix::zeros(2 * rows, base.base), nalgebra::DVector::zeros(2 * rows));
            for j in 0..2 {
                m.rows_mut(j * rows, rows).copy_from(&base.columns.m[j]);
            }
            c.rows_mut(joint * rows, rows).copy_from(&part.column(0));
            let q = m.qr().q();
            (&c - &q * q.tr_mul(&c)).norm_squared() / whole
        });
        let expected = 0.75 * found.diagnosis.joints[joint].floor_of_mean.unwrap() / independence.sqrt();
        assert!((torque / expected - 1.0).abs() < 0.05, "joint {}: {torque} {expected}", joint + 1);
        assert!((parameter - torque).abs() < 1e-6, "an offset of 1 Nm is a torque of 1 Nm");
    }
    assert_eq!(offsets.torque_rms.len(), 2);
}

#[test]
fn the_deviation_of_an_effect_is_that_of_trajectories_that_disagree() {
    // An offset that is larger in every other trajectory, by four noise floors.
    let deviation = |spread: f64| {
        let alternating =
            |at: &At| [0.0, FLOOR * (20.0 + spread * if at.trajectory.is_multiple_of(2) { 1.0 } else { -1.0 })];
        let found =
            outcome(&recorded(4, 38, alternating), &recorded(4, 2038, alternating), &recorded(2, 1038, alternating));
        assert_eq!(labels(&found), [("torque-offset", 2, true)]);
        found.diagnosis.effects[0].parameters.0[0].std.unwrap()
    };
    let [alike, apart] = [0.0, 4.0].map(deviation);
    // The mean of four whose standard deviation is 4 sqrt(4/3) floors.
    let expected = FLOOR * 4.0 * (4.0_f64 / 3.0).sqrt() / 2.0;
    println!("{alike} {apart} {expected}");
    assert!(alike < 0.3 * expected && (0.7..1.5).contains(&(apart / expected)), "{alike} {apart} {expected}");
}

#[test]
fn what_is_reported_is_what_was_found_and_what_the_delivered_model_predicts() {
    let found = of(42, (6.0, 0.0), (6.0, 0.0), (6.0, 0.0)).diagnosis;
    // Four trajectories agree; one trajectory confirms nothing.
    let [effect] = &found.effects[..] else { panic!("{:?}", found.effects) };
    assert_eq!((effect.confirmed, effect.folds.positive, effect.folds.informative), (true, 4, 4));
    let one = outcome(
        &recorded(1, 42, torque(6.0, 0.0)),
        &recorded(1, 43, torque(6.0, 0.0)),
        &recorded(1, 44, torque(6.0, 0.0)),
    );
    assert!(!one.diagnosis.effects.is_empty() && one.diagnosis.effects.iter().all(|effect| !effect.confirmed));
    assert!(one.diagnosis.joints.iter().all(|joint| joint.left_out == BeforeAfter::default()));
    assert!(found.joints.iter().all(|joint| joint.left_out.before.is_some()));
    // Errors before and after on the runs to judge by, and their difference.
    let change = found.change.as_ref().unwrap();
    for joint in 0..2 {
        let [before, after] = [&found.before, &found.after].map(|errors| errors.validate_rms[joint]);
        assert!((after - before - change.validate_rms[joint]).abs() < 1e-12, "{change:?}");
    }
    assert!(found.after.validate_rms[1] < 0.5 * found.before.validate_rms[1], "{found:?}");
    // The steps begin with the plain model and what it lacks in all joints.
    let [start, added] = &found.path[..] else { panic!("{:?}", found.path) };
    let lacking: f64 = found.joints.iter().map(|joint| joint.unmodelled.before.unwrap().powi(2)).sum();
    assert!(start.action == Action::Start && start.score.is_none() && start.what == "the plain model", "{start:?}");
    assert!((start.unmodelled.unwrap() - lacking.sqrt()).abs() < 1e-12, "{start:?}");
    let left: f64 = found.joints.iter().map(|joint| joint.unmodelled.after.unwrap().powi(2)).sum();
    assert!((added.unmodelled.unwrap() - left.sqrt()).abs() < 1e-9, "{added:?}");
    assert!(added.action == Action::Added && added.what == "torque-offset in joint 2", "{added:?}");
    // Ten candidates, the best first, of which one is the effect.
    let scores: Vec<f64> = found.scores.iter().map(|one| one.score).collect();
    assert!(scores.len() == 10 && scores.is_sorted_by(|a, b| a >= b), "{scores:?}");
    let offset = |label: &str| label == "torque-offset in joint 2";
    assert!(offset(&found.scores[0].label), "{:?}", found.scores);
    assert!(found.scores.iter().all(|one| one.chosen == offset(&one.label)), "{:?}", found.scores);
    let rivals = &found.effects[0].alternatives_detail;
    for one in &found.scores {
        let named = rivals
            .iter()
            .any(|rival| one.label.starts_with(&rival.id) && one.label.contains(&format!("joint {}", rival.joints[0])));
        assert_eq!(one.equivalent, named, "{one:?} {rivals:?}");
    }
    // Runs that decide are named as such, and nothing else is remarked.
    let remarks = found.notes.iter().filter(|note| note.ends_with("delivered; it is in no error shown here"));
    assert_eq!((remarks.count(), found.notes.len()), (4, 4), "{:?}", found.notes);
    assert!(one.diagnosis.notes.iter().any(|note| note.starts_with("one trajectory: no finding could be confirmed")));
}

#[test]
fn what_a_finding_was_tested_on_is_said() {
    let size = (6.0, 0.0);
    assert_eq!(of(38, size, size, size).diagnosis.confirmation, Some(Confirmation::Full { trajectories: 4 }));
    let with = |count| recorded(count, 38, torque(size.0, size.1));
    assert_eq!(outcome(&with(1), &with(2), &with(3)).diagnosis.confirmation, Some(Confirmation::OneTrajectory));
    let free = once(12.0, 38, torque(0.0, 0.0));
    let other = once(6.0, 39, torque(0.0, 0.0));
    let found = outcome(&free, &other, &other);
    assert_eq!(found.diagnosis.confirmation, Some(Confirmation::NoRepeats));
    let blocks = |count: usize| found.diagnosis.notes.iter().any(|note| note.contains(&format!("{count} blocks")));
    assert!(blocks(11) || blocks(12), "{:?}", found.diagnosis.notes);
    assert!(found.diagnosis.joints.iter().all(|facts| facts.floor_of_mean.is_none() && !facts.lacking_before()));
}

/// The file is written from the outcome's own types, and read into them.
#[test]
fn a_diagnosis_comes_back_from_its_file() {
    let of = |torque: (f64, f64)| of(41, torque, torque, torque).diagnosis;
    for diagnosis in [of((6.0, 4.0)), of((0.0, 0.0))] {
        let text = serde_json::to_string_pretty(&diagnosis).unwrap();
        let again: Diagnosis = serde_json::from_str(&text).unwrap();
        // A figure that could not be measured is NaN, which equals nothing: the texts are compared.
        assert_eq!(serde_json::to_string_pretty(&again).unwrap(), text);
        assert_eq!((again.verdict, again.confirmation), (diagnosis.verdict, diagnosis.confirmation));
        assert_eq!(again.effects, diagnosis.effects);
    }
}

/// Joints with a residual that nothing explains, of one motion that does not repeat.
fn unexplained(seconds: f64, seed: u64, torque: impl Fn(&At) -> [f64; 2]) -> Vec<usize> {
    let unseen = once(6.0, seed + 500, |_| [0.0; 2]);
    let found = outcome(&once(seconds, seed, torque), &unseen, &unseen).diagnosis;
    found.unexplained.iter().map(|one| one.joint).collect()
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn slow_noise_of_a_motion_without_repeats_is_no_dependence_and_a_bump_is_one() {
    let mut alarms = 0;
    for seed in 0..12u64 {
        // Eight tones from 0.1 to 0.4 Hz, of which none is in the motion.
        let slow = |at: &At| {
            let tone = |k: u64| {
                let own = ((seed * 8 + k) as f64 * 0.618_034).fract();
                (TAU * (0.1 + 0.0375 * (k as f64 + own)) * at.t + TAU * (7.0 * own).fract()).sin()
            };
            [0.0, 0.2 * (0..8).map(tone).sum::<f64>()]
        };
        alarms += unexplained(12.0, 60 + seed, slow).len();
    }
    assert_eq!(alarms, 0, "of 24 joints");
    let bump = |at: &At| [0.0, 0.3 * (-((at.q[1] - 0.2) / 0.15).powi(2)).exp()];
    assert_eq!(unexplained(20.0, 60, bump), [2]);
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn slow_noise_of_a_motion_without_repeats_is_no_effect_that_came_and_an_offset_is_one() {
    // First-order noise of 0.5 s, in blocks of two seconds.
    let noise = |seed: u64| {
        let (mut rng, keep) = (ChaCha8Rng::seed_from_u64(seed), (-DT / 0.5).exp());
        let mut state = [0.0; 2];
        let mut step = || {
            let unit: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut rng));
            state = std::array::from_fn(|j| keep * state[j] + 0.25 * (1.0 - keep * keep).sqrt() * unit[j]);
            state
        };
        let samples: Vec<[f64; 2]> = (0..(32.0 / DT) as usize).map(|_| step()).collect();
        move |at: &At| samples[at.k]
    };
    let came = |seed: u64, offset: f64| {
        let noise = noise(seed);
        let torque = |at: &At| [noise(at)[0], noise(at)[1] + if at.t > 17.3 { offset } else { 0.0 }];
        let unseen = once(6.0, seed + 500, |_| [0.0; 2]);
        let found = diagnosed(&once(30.0, seed, torque), &unseen, &unseen).diagnosis;
        found.effects.iter().filter(|effect| effect.acts.is_some()).map(Effect::place).collect::<Vec<_>>()
    };
    let alarms: Vec<String> = (800..812).flat_map(|seed| came(seed, 0.0)).collect();
    assert!(alarms.is_empty(), "{alarms:?}");
    let found = came(800, 0.6);
    assert!(found.len() == 1 && found[0].starts_with("torque-offset in joint 2"), "{found:?}");
}
