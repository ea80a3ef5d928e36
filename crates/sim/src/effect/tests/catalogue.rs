//! The catalogue: every id, the onset of every effect, repeatability, and errors of truth files.

use super::super::spec::Kind;
use super::*;
use crate::truth::Truth;
use plumbline_model::term::effect::{FAMILIES, Stratum};

/// One of each, and every form of those that have several.
const EXAMPLES: &str = include_str!("examples.txt");

fn with(effect: &str) -> Truth {
    truth(&format!("effect = [{{ {effect} }}]"))
}

#[test]
fn the_arm_has_every_effect_that_a_model_can_have() {
    // Friction that has changed is the same arm with other friction, and no arm has what is only fitted to the rest.
    let physical = FAMILIES.iter().filter(|family| family.stratum != Stratum::Remainder);
    let model = physical.map(|family| family.id).filter(|id| *id != "friction-change");
    let mut known: Vec<_> = model.chain(["foreign"]).collect();
    let mut ids = Kind::IDS.to_vec();
    known.sort_unstable();
    ids.sort_unstable();
    assert_eq!(ids, known);
    let mut shown: Vec<_> = EXAMPLES.lines().map(|text| with(text).effects[0].kind.id()).collect();
    shown.sort_unstable();
    shown.dedup();
    assert_eq!(shown, known, "an example of each");
}

fn numbers(state: &State) -> impl Iterator<Item = f64> {
    [state.q, state.dq, state.tau].into_iter().flatten()
}

fn most(a: &[(State, Exact)], b: &[(State, Exact)]) -> f64 {
    let apart = a.iter().zip(b).flat_map(|(a, b)| numbers(&a.0).zip(numbers(&b.0)).map(|(a, b)| (a - b).abs()));
    apart.fold(0.0, |most, apart| if apart > most || apart.is_nan() { apart } else { most })
}

/// No effect before its onset, an effect after it, the same in every run.
#[test]
fn every_effect_begins_at_its_onset() {
    let plain = run(&truth(""), 700);
    for text in EXAMPLES.lines() {
        let late = with(&format!("{text}, from = 0.25"));
        let states = run(&late, 700);
        assert!(states.iter().all(|(state, _)| numbers(state).all(f64::is_finite)), "{text}");
        // Friction that will be replaced is summed in another order until then.
        let before = most(&states[..249], &plain[..249]);
        assert!(before < 1e-9, "{text}: {before} before it begins");
        let after = most(&states[249..], &plain[249..]);
        assert!(after > 1e-3, "{text}: {after} after it began");
        assert!(after < 40.0, "{text}: {after} breaks the arm");
        assert_eq!(states, run(&late, 700), "{text}");
        if !late.effects.iter().any(|effect| matches!(effect.kind, Kind::Contact(_))) {
            let short = run(&with(&format!("{text}, from = 0.25, until = 0.4")), 700);
            assert_eq!(short[..399], states[..399], "{text}");
            assert!(most(&short[400..], &states[400..]) > 1e-3, "{text} ends");
        }
        let present = run(&with(text), 700);
        assert!(most(&present, &plain) > 1e-3, "{text}");
    }
}

/// Eight times as many steps of integration change nothing that matters.
#[test]
fn the_integration_has_converged_with_every_effect() {
    for text in EXAMPLES.lines() {
        let mut truth = with(text);
        let shipped = run(&truth, 400);
        truth.substeps *= 8;
        let apart = most(&run(&truth, 400)[100..], &shipped[100..]);
        assert!(apart < 0.02, "{text}: {apart}");
    }
}

/// File, key, value and what was expected, of each effect.
#[test]
fn a_wrong_effect_names_key_and_value() {
    let cases: &[(&str, &[&str])] = &[
        ("id = 'torque-offset', joint = 4, offset = 0.3", &["effect 1, joint", "got 4", "1 to 3"]),
        ("id = 'torque-offset', joint = 0, offset = 0.3", &["effect 1, joint", "got 0", "1 to 3"]),
        ("id = 'torque-offset', joint = 1, offset = nan", &["effect 1, offset", "NaN"]),
        ("id = 'torque-offset', joint = 1, offset = 'much'", &["torque-offset", "much", "f64"]),
        ("id = 'torque-offset', joint = 1", &["missing field `offset`"]),
        ("id = 'torque-offset', joint = 1, ofset = 0.3", &["unknown field `ofset`"]),
        ("id = 'poltergeist', joint = 1", &["poltergeist", "torque-offset"]),
        ("joint = 1", &["missing field `id`"]),
        ("id = 'torque-offset', joint = 1, offset = 0.3, from = -1.0", &["effect 1, from", "-1"]),
        ("id = 'torque-offset', joint = 1, offset = 0.3, from = 'noon'", &["`from`", "noon"]),
        ("id = 'torque-offset', joint = 1, offset = 0.3, until = 'noon'", &["`until`", "noon"]),
        (
            "id = 'torque-offset', joint = 1, offset = 0.3, from = 2.0, until = 2.0",
            &["effect 1, until", "after `from`"],
        ),
        ("id = 'torque-gain', joint = 1, gain = 0.0", &["effect 1, gain", "0.1 to 10"]),
        ("id = 'asymmetric-coulomb', joint = 1, asymmetry = 0.6", &["asymmetry", "0.6", "-0.5 to 0.5"]),
        ("id = 'asymmetric-viscous', joint = 1, asymmetry = 0.6", &["asymmetry", "0.6"]),
        ("id = 'stribeck', joint = 1, excess = 0.1, velocity = 0.0", &["velocity", "0.001 to 10"]),
        ("id = 'stribeck', joint = 1, excess = -0.1, velocity = 0.1", &["excess", "-0.1"]),
        ("id = 'nonlinear-viscous', joint = 1, form = 'sigmoid', size = 1.0", &["velocity", "width of the sigmoid"]),
        (
            "id = 'nonlinear-viscous', joint = 1, form = 'cubic', size = 1.0, velocity = 0.1",
            &["velocity", "only a sigmoid"],
        ),
        ("id = 'nonlinear-viscous', joint = 1, form = 'cubic', size = 1.0, shift = 0.1", &["shift", "only a sigmoid"]),
        ("id = 'nonlinear-viscous', joint = 1, form = 'round', size = 1.0", &["round", "cubic"]),
        ("id = 'load-dependent-friction', joint = 1, coulomb = 0.5", &["coulomb", "0 to 0.3"]),
        ("id = 'friction-drift', joint = 9, share = 0.5, time = 60.0", &["joint", "1 to 3"]),
        ("id = 'friction-drift', share = -2.0, time = 60.0", &["share", "-1 to 10"]),
        ("id = 'offset-drift', joint = 1, drift = 0.1, time = 0.0", &["time", "0.1"]),
        ("id = 'presliding', joint = 1, delta = 0.0001", &["delta", "0.00025 to 1"]),
        ("id = 'presliding', joint = 1", &["keys", "neither", "`delta` or `elements`"]),
        ("id = 'presliding', joint = 1, elements = []", &["elements", "1 to 8"]),
        ("id = 'presliding', joint = 1, elements = [{ share = 0.5, delta = 0.01 }]", &["elements", "0.5", "sum to 1"]),
        (
            "id = 'presliding', joint = 1, elements = [{ share = 1.0, delta = 0.01 }], damping = 1.0",
            &["damping", "none"],
        ),
        ("id = 'rotor-inertia', joint = 1, inertia = -0.1", &["inertia", "-0.1"]),
        ("id = 'joint-elasticity', joint = 1, stiffness = 1.0", &["stiffness", "100 to"]),
        ("id = 'position-ripple', joint = 1, order = 0.0, sine = 0.1", &["order", "0.1 to 2000"]),
        ("id = 'position-ripple', joint = 1, order = 1.0, on = 'foot'", &["foot", "sensor"]),
        ("id = 'position-dependent-friction', joint = 1, sine = 0.4, cosine = 0.4", &["sine and cosine", "0.5 Nm"]),
        ("id = 'spring', joint = 1, stiffness = inf", &["stiffness", "inf"]),
        ("id = 'payload', mass = -1.0, com = [0, 0, 0]", &["effect 1, mass", "-1"]),
        ("id = 'payload', link = 4, mass = 1.0, com = [0, 0, 0]", &["effect 1, link", "1 to 3"]),
        ("id = 'mounting'", &["keys", "`tilt`, or `rho` and `phi`"]),
        ("id = 'mounting', tilt = [0, 0, 0], rho = 1.0, phi = 0.0", &["keys", "tilt, rho, phi"]),
        ("id = 'base-motion', frequency = 5.0, amplitude = 0.1, direction = [0, 0, 0]", &["direction", "not zero"]),
        ("id = 'torque-crosstalk', joint = 1, other = 1, share = 0.1", &["other", "another joint than 1"]),
        ("id = 'transmission-coupling', joint = 1, other = 7, fc = 0.1", &["other", "1 to 3"]),
        ("id = 'delay', delay = 0.2", &["delay", "0 to 0.1"]),
        ("id = 'contact', to = 1.0, from = 0.9", &["effect 1, to", "two edges"]),
        ("id = 'contact', to = 1.0, every = 0.5", &["every", "0.5", "1 s"]),
        ("id = 'encoder-offset', joint = 1, offset = 2.0", &["offset", "-1 to 1"]),
        ("id = 'encoder-eccentricity', joint = 1, amplitude = 0.5", &["amplitude", "0.2"]),
        ("id = 'backlash', joint = 1, gap = 0.5", &["gap", "0 to 0.1"]),
        ("id = 'foreign', form = 'beat', joint = 1, size = 0.1, every = 0.0", &["every", "0.1"]),
        ("id = 'foreign', form = 'beat', joint = 1, size = 0.1, every = 1.0, width = 1.0", &["unknown field `width`"]),
        (
            "id = 'foreign', form = 'region', joint = 1, size = 0.1, first = 5, middle = 0, width = 1",
            &["first", "1 to 3"],
        ),
    ];
    for (effect, parts) in cases {
        let error = parsed(&format!("effect = [{{ {effect} }}]")).expect_err(effect).to_string();
        for part in parts.iter().chain(&["test: "]) {
            assert!(error.contains(part), "{effect}: `{error}` does not say `{part}`");
        }
    }
    let two = |a: &str, b: &str| parsed(&format!("effect = [{{ {a} }}, {{ {b} }}]")).expect_err(b).to_string();
    let presliding = "id = 'presliding', joint = 2, delta = 0.002";
    assert!(two(presliding, presliding).contains("2 on joint 2"));
    let twice = two("id = 'backlash', joint = 1, gap = 0.001", "id = 'joint-elasticity', joint = 1, stiffness = 9000");
    assert!(twice.contains("2 on joint 1"), "{twice}");
}
