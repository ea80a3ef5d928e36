//! What the folds and the relevance are made of, computed once more row by row on the two-joint arm.

use super::*;
use crate::fit::Prior;
use crate::span::Span;
use crate::state::mean_square;
use crate::synthetic::{At, FLOOR, Recorded, once, once_with_effect, recorded, scaled, with_effect_in_noise};
use crate::{Search, Settings};
use nalgebra::DMatrix;
use plumbline_model::term::effect::{Family, Site, Spec, family};
use plumbline_model::term::{joint_elasticity, spring, torque_offset};
use std::borrow::Cow;
use std::f64::consts::TAU;

/// A search among the candidates of one family, with that of joint 2.
fn of_joint_2(recorded: &Recorded, family: &'static Family, look: impl FnOnce(&Search, &State, &Candidate)) {
    recorded.search(&[family], &Settings::default(), |search, base| {
        let item = search.library.iter().find(|item| item.joints() == [1]).unwrap();
        look(search, base, item);
    });
}

/// Rows of the effect in joint 2.
fn part(item: &Candidate) -> Cow<'_, DMatrix<f64>> {
    assert_eq!(item.joints().len(), 1);
    item.rows.of(item.joints()[0]).unwrap()
}

/// The torque that changes in a joint, row by row, divided by the noise.
fn changed(state: &State, item: &Candidate, joint: usize, change: &DVector<f64>) -> DVector<f64> {
    let own = state.fit.theta.len();
    let mut rows = &state.columns.m[joint] * change.rows(0, own);
    if joint == 1 {
        rows += &*part(item) * change.rows(own, change.len() - own);
    }
    rows
}

#[test]
fn the_share_of_a_fold_is_that_of_its_weighted_torque() {
    // Tones of another size in each band and joint: the weights of the bands differ by far.
    let added = |at: &At| {
        let tone = |f: f64, rms: f64| FLOOR * rms * (TAU * f * at.t + (at.trajectory * at.trajectory) as f64).sin();
        [tone(1.0, 30.0), 4.0 * FLOOR + tone(6.0, 20.0) + tone(12.0, 5.0)]
    };
    let recorded = scaled(&[1.5, 1.0, 1.0, 0.5], 81, |at| {
        let [one, two] = added(at);
        [one, two + 0.3 * at.q[1]]
    });
    of_joint_2(&recorded, &spring::FAMILY, |search, base, item| {
        let tried = base.try_in(&search.problem, item).unwrap();
        let phi = &tried.fit.phi;
        let largest = phi.iter().copied().fold(0.0, f64::max);
        assert!(largest > 30.0 && phi.iter().any(|phi| *phi < 3.0), "{phi:?}");
        let mut change = tried.fit.theta.clone();
        for (change, before) in change.iter_mut().zip(&base.fit.theta) {
            *change -= before;
        }
        let mut energy = [0.0; 4];
        for cell in search.problem.evidence.cells() {
            let rows = changed(base, item, cell.joint, &change);
            let square: f64 = rows.rows(cell.rows.start, cell.rows.len()).norm_squared();
            energy[cell.fold] += square / phi[group(cell.joint, cell.band)];
        }
        let total: f64 = energy.iter().sum();
        let own = energies(&search.problem, base, &tried, &tried.moments(search.problem.evidence, base));
        for (own, energy) in own.iter().zip(energy) {
            assert!((own - energy).abs() < 1e-9 * total, "{own} {energy}");
        }
    });
}

/// Share of each fold in the energy of the torque that a candidate changes.
fn shares(search: &Search, base: &State, tried: &Tried) -> Vec<f64> {
    let energies = energies(&search.problem, base, tried, &tried.moments(search.problem.evidence, base));
    let total: f64 = energies.iter().sum();
    energies.iter().map(|energy| energy / total).collect()
}

#[test]
fn a_fold_is_asked_from_three_to_eighty_per_cent_of_the_energy() {
    let (mut seen, mut more) = (Vec::new(), 0);
    let spring_2 = |at: &At| [0.0, 2.0 * at.q[1]];
    let reaches: [&[f64]; 6] =
        [&[1.0, 1.0, 0.2], &[1.0, 1.0, 0.3], &[1.0, 1.0, 0.4], &[1.0, 0.3], &[1.0, 0.45], &[1.0, 0.8]];
    let repeated = reaches.map(|reach| scaled(reach, 82, spring_2));
    // Blocks of a motion that does not repeat show little each.
    for recorded in repeated.iter().chain([&once(20.0, 82, spring_2)]) {
        of_joint_2(recorded, &spring::FAMILY, |search, base, item| {
            let tried = base.try_in(&search.problem, item).unwrap();
            let shares = shares(search, base, &tried);
            let asked = shares.iter().filter(|share| (0.03..=0.8).contains(*share)).count();
            let found = folds(&search.problem, base, &tried);
            assert_eq!(found.informative, asked, "{shares:?}");
            // Beside them those with five standard deviations of torque, however small their share.
            let energies = energies(&search.problem, base, &tried, &tried.moments(search.problem.evidence, base));
            let shows = |(share, energy): (&f64, &f64)| (0.03..=0.8).contains(share) || *energy >= 25.0;
            assert_eq!(found.showing, shares.iter().zip(&energies).filter(|one| shows(*one)).count(), "{energies:?}");
            more += found.showing - found.informative;
            seen.extend(shares);
        });
    }
    assert!(more > 0);
    for (low, high) in [(0.015, 0.03), (0.03, 0.06), (0.4, 0.8), (0.8, 1.0)] {
        assert!(seen.iter().any(|share| (low..high).contains(share)), "{low} to {high}: {seen:?}");
    }
}

#[test]
fn the_only_run_with_an_effect_and_the_only_one_without_it_are_not_asked() {
    // Friction that changes between two runs: the fit divides it between both, so both show it and neither confirms it.
    for (count, alone_folds, asked) in [(2, vec![1, 0], 0), (3, vec![0], 2)] {
        let recorded = recorded(count, 83, |_| [0.0; 2]);
        let since = recorded.trials()[1].start;
        of_joint_2(&recorded, family("friction-change").unwrap(), |search, base, item| {
            let item = item.in_folds(search.problem.evidence, Span::since(since)).unwrap();
            let tried = base.try_in(&search.problem, &item).unwrap();
            let shares = shares(search, base, &tried);
            assert!(shares.iter().all(|share| (0.03..=0.8).contains(share)), "{shares:?}");
            assert_eq!(alone(&search.problem, base, &tried), alone_folds);
            assert_eq!(folds(&search.problem, base, &tried).informative, asked);
        });
    }
    let recorded = recorded(4, 83, |_| [0.0, 6.0 * FLOOR]);
    let starts: Vec<f64> = recorded.trials().iter().map(|trial| trial.start).collect();
    of_joint_2(&recorded, &torque_offset::FAMILY, |search, base, item| {
        let alone = |from: f64, to: f64| {
            let item = item.in_folds(search.problem.evidence, Span { to, ..Span::since(from) }).unwrap();
            alone(&search.problem, base, &base.try_in(&search.problem, &item).unwrap())
        };
        assert_eq!(alone(starts[2], starts[3]), [2]);
        assert_eq!(alone(starts[3], f64::INFINITY), [3]);
        assert_eq!(alone(starts[1], f64::INFINITY), [0]);
        assert_eq!(alone(starts[2], f64::INFINITY), [] as [usize; 0]);
        assert_eq!(alone(f64::NEG_INFINITY, f64::INFINITY), [] as [usize; 0]);
    });
}

#[test]
fn an_effect_belongs_to_the_joint_where_it_takes_most_in_units_of_the_noise_power() {
    let form = &joint_elasticity::FAMILY.forms[0];
    let spec = Spec { family: joint_elasticity::ID, form: form.name, site: Site::Joint(1), settings: Vec::new() };
    let mut other_than_by_noise = 0;
    for ratio in [1.0, 1.5, 2.0, 3.0, 4.0, 6.0] {
        for noisy in [0, 1] {
            let noise = [0, 1].map(|j| if j == noisy { ratio } else { 1.0 });
            let recorded = with_effect_in_noise(84, &spec, 60.0 * FLOOR, noise);
            recorded.search(&[&joint_elasticity::FAMILY], &Settings::default(), |search, base| {
                let evidence = search.problem.evidence;
                let item = Candidate::of(evidence, search.operating_point, spec.clone(), Span::ALL).unwrap();
                let tried = base.try_in(&search.problem, &item).unwrap();
                let after = base.with(&search.problem, item.clone());
                let found = relevance(evidence, base, &tried, &item);
                let taken = |joint| base.mean_square(evidence, joint) - after.mean_square(evidence, joint);
                let floor = |joint| evidence.floor(joint).unwrap();
                let most = |worth: &dyn Fn(usize) -> f64| usize::from(worth(1) > worth(0));
                let expected = most(&|joint| taken(joint) / floor(joint).powi(2));
                assert_eq!(found.joint, expected, "noise {noise:?}: {found:?}");
                other_than_by_noise += usize::from(expected != most(&|joint| taken(joint) / floor(joint)));
            });
        }
    }
    assert!(other_than_by_noise > 0, "no case tells the power of the noise from its RMS");
}

#[test]
fn where_the_noise_is_unknown_an_effect_belongs_to_the_joint_of_which_it_explains_the_larger_share() {
    let form = &joint_elasticity::FAMILY.forms[0];
    let spec = Spec { family: joint_elasticity::ID, form: form.name, site: Site::Joint(1), settings: Vec::new() };
    // Beside a tone it explains little.
    for tone_in in [0, 1] {
        let tone = |at: &At| [0, 1].map(|j| if j == tone_in { 90.0 * FLOOR * (TAU * 7.0 * at.t).sin() } else { 0.0 });
        let recorded = once_with_effect(20.0, 84, &spec, 60.0 * FLOOR, tone);
        recorded.search(&[&joint_elasticity::FAMILY], &Settings::default(), |search, base| {
            let evidence = search.problem.evidence;
            let item = Candidate::of(evidence, search.operating_point, spec.clone(), Span::ALL).unwrap();
            let found = relevance(evidence, base, &base.try_in(&search.problem, &item).unwrap(), &item);
            assert!(found.share[1 - tone_in] > found.share[tone_in] + 0.1, "{found:?}");
            assert_eq!(found.joint, 1 - tone_in, "{found:?}");
        });
    }
}

#[test]
fn with_a_prior_only_the_torque_of_the_candidate_itself_counts() {
    // The parameters of the joints move little from the prior, and what they do move is the prior's.
    let added = |at: &At| [0.5 * FLOOR * (TAU * 5.0 * at.t).sin(), 3.0 * at.q[1]];
    of_joint_2(&recorded(4, 85, added), &spring::FAMILY, |search, base, item| {
        let evidence = search.problem.evidence;
        let own = base.fit.theta.len();
        let prior = Prior { precision: DMatrix::identity(own, own) };
        let problem = Problem { evidence, prior: Some(&prior) };
        let tried = base.try_in(&problem, item).unwrap();
        let theta = tried.fit.theta.rows(0, own).into_owned();
        let moved = (&theta - &base.fit.theta).amax();
        assert!(tried.held && moved > 1e-5, "the other parameters move as well: {moved}");
        let mut alone = tried.fit.theta.clone();
        alone.rows_mut(0, own).fill(0.0);
        assert_eq!(change(base, &tried), alone);

        let found = relevance(evidence, base, &tried, item);
        for joint in 0..2 {
            let without = &base.columns.r[joint] - &base.columns.m[joint] * &theta;
            let effect = changed(base, item, joint, &alone);
            let square = |rows: &DVector<f64>| mean_square(evidence, joint, rows);
            let floor = evidence.floor(joint).unwrap().powi(2);
            let share = (square(&without) - square(&(&without - &effect))) / (square(&without) - floor).max(1e-300);
            assert!((found.rms[joint] - square(&effect).sqrt()).abs() < 1e-9, "{found:?}");
            assert!((found.share[joint] - share.clamp(-1.0, 1.0)).abs() < 1e-9, "{found:?} {share}");
        }

        // Folds that are left out are predicted with the same parameters, with the candidate and without it.
        let tested = folds(&problem, base, &tried);
        let (mut sums, mut low, mut weighted) = ([[0.0; 2]; 2], [[0.0; 2]; 2], [[0.0; 2]; 2]);
        for (fold, theta) in
            problem.left_out(&tried.moments(search.problem.evidence, base), &tried.fit.phi).iter().enumerate()
        {
            for cell in evidence.cells().iter().filter(|cell| cell.fold == fold) {
                let rows = |with: bool| {
                    let mut theta = theta.clone();
                    if !with {
                        theta.rows_mut(own, item.rows.width).fill(0.0);
                    }
                    let rest = &base.columns.r[cell.joint] - changed(base, item, cell.joint, &theta);
                    rest.rows(cell.rows.start, cell.rows.len()).norm_squared()
                };
                for (k, with) in [false, true].into_iter().enumerate() {
                    sums[cell.joint][k] += rows(with);
                    low[cell.joint][k] += if cell.band < LOW_BANDS { rows(with) } else { 0.0 };
                    weighted[cell.joint][k] += rows(with) / tried.fit.phi[group(cell.joint, cell.band)];
                }
            }
        }
        assert_eq!((tested.informative, tested.positive), (4, 4));
        let share = [sums, low].map(|sums| 1.0 - sums[1][1] / sums[1][0]).into_iter().fold(f64::MIN, f64::max);
        assert!((tested.share - share).abs() < 1e-6, "{tested:?} {share}");
        let gain: f64 =
            weighted.iter().map(|[without, with]| evidence.per_joint() as f64 * (without / with).ln()).sum();
        assert!((tested.evidence / gain - 1.0).abs() < 1e-6, "{tested:?} {gain}");
    });
}

#[test]
fn a_displacement_within_a_step_of_the_encoder_or_at_the_end_of_its_range_is_not_shown() {
    let mut coarse = recorded(2, 84, |_| [0.0; 2]);
    for experiment in &mut coarse.experiments {
        experiment.resolution = vec![0.0, 1e-3];
    }
    let largest = family("presliding").unwrap().forms[0].settings[0].high;
    coarse.search(&[family("presliding").unwrap(), &spring::FAMILY], &Settings::default(), |search, _| {
        let shown = |item: &Candidate, value: f64| {
            let mut item = item.clone();
            item.spec.settings.iter_mut().for_each(|setting| *setting = value);
            shows(search.problem.evidence, &item)
        };
        let of = |family: &str, joint: usize| {
            let mut library = search.library.iter().filter(|item| item.spec.family == family);
            library.find(|item| item.joints() == [joint] && !item.spec.settings.is_empty()).unwrap()
        };
        assert!(!shown(of("presliding", 1), 0.9e-3) && shown(of("presliding", 1), 1.1e-3));
        assert!(shown(of("presliding", 0), 1e-5), "noise hides the steps of joint 1");
        assert!(!shown(of("presliding", 0), largest) && shown(of("presliding", 0), 0.8 * largest));
        // Where a spring begins to pull is a position.
        assert!(shown(of("spring", 1), 1e-5));
    });
}

#[test]
fn at_the_very_limit_three_quarters_agree_and_a_fifth_is_enough_and_a_penalty_is_not() {
    let good =
        FoldTest { positive: 3, informative: 3, agreement: 1.0, showing: 3, evidence: 20.1, share: 0.21, worst: -0.29 };
    let holds = |folds: FoldTest| folds.hold(20, 20.0, 0.2);
    assert!(holds(FoldTest { share: 0.2, ..good }));
    assert!(!holds(FoldTest { evidence: 20.0, ..good }));
    assert!(!holds(FoldTest { worst: -0.3, ..good }));
    // One fold that says nothing decides nothing; half of the blocks where there are few.
    assert_eq!(FoldTest { informative: 0, ..good }.confirm(), None);
    assert!(FoldTest { showing: 1, ..good }.hold(3, 20.0, 0.2) && !FoldTest { showing: 1, ..good }.hold(4, 20.0, 0.2));
}
