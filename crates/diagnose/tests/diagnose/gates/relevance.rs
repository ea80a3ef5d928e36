//! Whether a candidate matters: its torque against the noise and against what is unmodelled.

use super::search::{OFFSET, constant, offset_2, select, taken};
use super::synthetic::{At, FLOOR, PERIODS, once, recorded, with_effect};
use plumbline_diagnose::{Relevance, Settings};
use plumbline_model::term::effect::{Site, Spec, family};
use std::f64::consts::TAU;

#[test]
fn an_effect_counts_from_its_share_of_the_noise_and_of_what_is_unmodelled_on() {
    let settings = Settings::default();
    recorded(2, 6, |_| [0.0; 2]).search(&OFFSET, &settings, |search, _| {
        let evidence = search.problem.evidence;
        let floor = evidence.floor(1).unwrap();
        let matters = |rms: f64, share: f64, settings: &Settings| {
            let found = Relevance {
                rms: vec![1e3, rms],
                share: vec![0.1, share],
                joint: 1,
                low: vec![(0.0, 0.0); 2],
                ..Relevance::default()
            };
            plumbline_diagnose::matters(evidence, &found, settings)
        };
        assert!(matters(0.71 * floor, 0.16, &settings));
        assert!(!matters(0.69 * floor, 0.16, &settings));
        // Or below 4 Hz of the noise of one period.
        let low = |rms: f64, share: f64| {
            let low = vec![(1e3, 0.1), (rms, share)];
            let found = Relevance { rms: vec![0.0; 2], share: vec![0.0; 2], joint: 1, low, ..Relevance::default() };
            plumbline_diagnose::matters(evidence, &found, &settings)
        };
        // What acts in the whole arm is weighed in all joints together.
        let in_both = |ratio: f64, of_arm: bool| {
            let rms = (0..2).map(|joint| ratio * evidence.floor(joint).unwrap()).collect();
            let found = Relevance { rms, share: vec![0.16; 2], joint: 1, low: vec![(0.0, 0.0); 2], of_arm };
            plumbline_diagnose::matters(evidence, &found, &settings)
        };
        assert!(in_both(0.5, true) && !in_both(0.49, true) && !in_both(0.5, false) && in_both(0.71, false));
        let floor_of_a_period = evidence.floor_of_periods_below(1, 4, 1.0).unwrap();
        let floor_of_mean = evidence.floor_below(1, 4).unwrap();
        assert!((floor_of_a_period / floor_of_mean - (PERIODS as f64).sqrt()).abs() < 1e-9);
        assert!(floor_of_mean < 0.8 * floor, "of white noise a half is below a quarter of the band");
        assert!(low(0.71 * floor_of_a_period, 0.16));
        assert!(!low(0.69 * floor_of_a_period, 0.16) && !low(0.71 * floor_of_a_period, 0.14));
        assert!(!matters(0.71 * floor, 0.14, &settings));
        let own = Settings { threshold: Some(0.5), ..settings.clone() };
        assert!(matters(0.51, 0.16, &own) && !matters(0.49, 0.16, &own));
    });
    once(20.0, 6, |_| [0.0; 2]).search(&OFFSET, &settings, |search, _| {
        let matters = |share: f64| {
            let found = Relevance {
                rms: vec![0.0, 1e-6],
                share: vec![0.0, share],
                joint: 1,
                low: vec![(0.0, 0.0); 2],
                ..Relevance::default()
            };
            plumbline_diagnose::matters(search.problem.evidence, &found, &settings)
        };
        assert!(matters(0.031) && !matters(0.029), "without repeats 3 % of the whole residual");
    });
}

#[test]
fn relevance_is_what_the_fit_takes_away() {
    // Beside an offset, a tone of 5 Hz that no candidate explains.
    let (size, tone) = (4.0 * FLOOR, 6.0 * FLOOR);
    let added = |at: &At| [0.0, size + tone * (2f64).sqrt() * (TAU * 5.0 * at.t).sin()];
    recorded(4, 7, added).search(&OFFSET, &Settings::default(), |search, base| {
        let scored = offset_2(search, base);
        let found = plumbline_diagnose::relevance(search.problem.evidence, base, &scored.tried, &scored.item);
        // The base parameters take a part of the offset over; what is left of it is what its square falls by.
        let rest = scored.tried.independence * scored.tried.fit.theta.as_slice().last().unwrap().powi(2);
        let share = rest / (rest + tone * tone);
        assert_eq!(found.joint, 1);
        assert!((found.rms[1] / rest.sqrt() - 1.0).abs() < 0.1, "{found:?}, {}", rest.sqrt());
        assert!((found.share[1] - share).abs() < 0.05, "{found:?}, {share}");
        assert!(found.rms[0] < FLOOR && found.share[0].abs() < 0.5, "{found:?}");
    });
}

#[test]
fn what_the_data_shows_but_nobody_needs_is_not_taken() {
    let settings = Settings::default();
    let little = recorded(8, 8, constant(0.3 * FLOOR));
    little.search(&OFFSET, &settings, |search, base| {
        let scored = offset_2(search, base);
        let folds = plumbline_diagnose::folds(&search.problem, base, &scored.tried);
        assert!(scored.score > 5.0 && folds.confirm() == Some(true), "score {}, {folds:?}", scored.score);
        assert!(search.forward(base.clone(), &[], &|_| {}).state.items.is_empty());
    });
    // More than the noise, but next to nothing beside what is left over.
    let tone = |at: &At| 12.0 * FLOOR * (TAU * 3.0 * at.t).sin();
    let beside = recorded(8, 8, |at| [0.0, 1.5 * FLOOR + tone(at)]);
    beside.search(&OFFSET, &settings, |search, base| {
        let scored = offset_2(search, base);
        let found = plumbline_diagnose::relevance(search.problem.evidence, base, &scored.tried, &scored.item);
        assert!(scored.score > 5.0 && found.rms[1] > 0.7 * FLOOR, "score {}, {found:?}", scored.score);
        assert!(search.forward(base.clone(), &[], &|_| {}).state.items.is_empty());
    });
    assert_eq!(taken(&select(&recorded(8, 8, constant(1.5 * FLOOR)), &OFFSET, &settings)), [("torque-offset", 2)]);
}

/// Of what every arm has a little is no finding, of a defect it is.
#[test]
fn a_defect_is_taken_where_it_is_certain_and_nobody_says_that_it_does_not_matter() {
    let size = 0.4 * FLOOR;
    let of = |id: &str, settings: &Settings| {
        let family = family(id).unwrap();
        let form = &family.forms[0];
        let middle = form.settings.iter().map(|setting| (setting.low * setting.high).abs().sqrt()).collect();
        let spec = Spec { family: family.id, form: form.name, site: Site::Joint(1), settings: middle };
        let selected = select(&with_effect(12, 8, &spec, size, |_| [0.0; 2]), &[family], settings);
        (selected.first[0].score > 0.5 * selected.first[0].penalty, taken(&selected))
    };
    let settings = Settings::default();
    assert_eq!(of("spring", &settings), (true, vec![("spring", 2)]));
    assert_eq!(of("stribeck", &settings), (true, Vec::new()));
    assert_eq!(of("spring", &Settings { threshold: Some(FLOOR), ..settings.clone() }), (true, Vec::new()));
    assert_eq!(of("spring", &Settings { usual: vec![FLOOR; 2], ..settings }), (true, Vec::new()));
}

#[test]
fn a_small_effect_that_another_joint_has_is_taken_where_its_evidence_is_twice_its_cost() {
    let settings = Settings::default();
    let of = |first: f64, second: f64| {
        let both = recorded(8, 8, move |_| [first * FLOOR, second * FLOOR]);
        let clear = both.search(&OFFSET, &settings, |search, base| {
            let first = search.library.iter().find(|item| item.joints() == [0]).unwrap();
            let state = base.with(&search.problem, first.clone());
            let second = offset_2(search, &state);
            let relevance = plumbline_diagnose::relevance(search.problem.evidence, &state, &second.tried, &second.item);
            assert!(second.score > 0.0 && relevance.rms[1] < 0.6 * FLOOR, "{} {relevance:?}", second.score);
            second.score > second.penalty
        });
        (clear, taken(&select(&both, &OFFSET, &settings)))
    };
    let both = vec![("torque-offset", 1), ("torque-offset", 2)];
    assert_eq!(of(20.0, 0.5), (true, both));
    assert_eq!(of(20.0, 0.2), (false, vec![("torque-offset", 1)]));
    // Alone neither is.
    assert_eq!(of(0.5, 0.5), (true, Vec::new()));
}
