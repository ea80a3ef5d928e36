//! What families of effects declare, and the names of their columns.

use crate::models::{effect, operating_point, rigid_model, specs};
use plumbline_model::term::effect::{
    Confounded, FAMILIES, InBodies, InC, Inputs, Place, PlotOver, Site, Stratum, assemble,
};
use plumbline_model::term::payload;
use plumbline_model::{Reduction, Structure};
use plumbline_testkit::arms::chain;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// The identities that reports and model files are keyed by.
const IDS: &str = "torque-offset torque-gain asymmetric-coulomb asymmetric-viscous stribeck coulomb-slope nonlinear-viscous \
    load-dependent-friction friction-drift offset-drift presliding rotor-inertia joint-elasticity position-ripple \
    position-dependent-friction spring payload mounting base-motion torque-crosstalk transmission-coupling delay contact \
    encoder-offset encoder-eccentricity backlash friction-change empirical";

#[test]
fn the_catalogue_is_complete() {
    let ids: Vec<&str> = FAMILIES.iter().map(|family| family.id).collect();
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len());
    assert_eq!(ids.iter().copied().collect::<BTreeSet<_>>(), IDS.split_whitespace().collect());
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let model = rigid_model("panda", &mut rng);
    for family in FAMILIES {
        let id = family.id;
        assert!(family.physics.ends_with('.') && family.physics.matches(". ").count() == 0, "one sentence: {id}");
        assert!(!family.typical.is_empty() && !family.reference.is_empty() && !family.confounded.is_empty(), "{id}");
        for Confounded { with, decided_by } in family.confounded {
            // Another family, or parameters of the model, which begin with a letter of theirs.
            let known = IDS.split_whitespace().any(|other| other == *with && other != id);
            let parameters = ["L", "l", "f", "the "].iter().any(|start| with.starts_with(start));
            assert!(known || parameters, "{id} is confounded with {with}?");
            assert!(decided_by.len() > 10, "{id}");
        }
        let forms: BTreeSet<&str> = family.forms.iter().map(|form| form.name).collect();
        assert_eq!(forms.len(), family.forms.len(), "{id}");
        for spec in specs(family, 7, &mut rng) {
            let term = spec.build(&operating_point(&model)).unwrap();
            assert_eq!((term.id(), term.physics()), (id, family.physics));
            let form = family.form(spec.form).unwrap();
            let equation = |name: &str| form.equation.split(|c: char| !c.is_alphanumeric()).any(|word| word == name);
            assert!(form.settings.iter().all(|setting| equation(setting.name)), "settings in the equation of {id}");
            let mut names = BTreeSet::new();
            for column in term.columns() {
                assert!(names.insert(column.name.clone()), "two columns {}", column.name);
                assert!((1..=7).contains(&column.joint));
                let plain = |c: char| c.is_ascii_alphanumeric() || "/ ".contains(c);
                assert!(!column.unit.is_empty() && column.unit.chars().all(plain), "{}: {}", column.name, column.unit);
            }
        }
    }
}

/// Declarations that readers of the catalogue rely on.
#[test]
fn declarations_of_a_family_agree() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let model = rigid_model("panda", &mut rng);
    let inputs = Inputs { load: "load".into(), q: "q".into(), ..Inputs::default() };
    for family in FAMILIES {
        let id = family.id;
        assert!(family.stratum != Stratum::Reference || family.rare.may_change, "{id}");
        let last_link = family.rare.in_bodies == InBodies::LastLink;
        for spec in specs(family, 7, &mut rng) {
            let term = spec.build(&operating_point(&model)).unwrap();
            let form = family.form(spec.form).unwrap();
            // A term of the whole arm has no spec of its own.
            assert_eq!(term.spec().is_none(), family.rare.whole_arm.is_some(), "{spec:?}");
            assert_eq!(matches!(form.in_c, InC::LastLink), last_link, "{spec:?}");
            match form.in_c {
                InC::Columns(columns) | InC::BothRows { columns, .. } | InC::Part { columns, .. } => {
                    assert_eq!(columns(&inputs, &spec.settings).len(), term.columns().len(), "{spec:?}");
                }
                InC::Entries => assert!(term.entries().is_some(), "{spec:?}"),
                InC::LastLink => {
                    assert!(term.columns().iter().all(|column| payload::slot(&column.name).is_some()), "{spec:?}");
                }
                InC::Refused(reason) => assert!(reason.len() > 10, "{spec:?}"),
            }
            assert!(family.place != Place::Arm || form.plot_over == PlotOver::Nothing, "{spec:?}");
        }
    }
}

/// Two offsets and two rotors: columns of one term each, in the order of the specs.
#[test]
fn effects_with_a_term_of_the_whole_arm_are_columns_of_that_term() {
    let mut rng = ChaCha8Rng::seed_from_u64(15);
    let model = rigid_model("panda", &mut rng);
    let specs = [("rotor-inertia", "", 5), ("torque-offset", "", 1), ("spring", "linear", 2), ("torque-offset", "", 4)]
        .map(|(family, form, joint)| effect(family, form, Site::Joint(joint), &[]));
    let terms = assemble(&specs, &operating_point(&model)).unwrap();
    let names: Vec<Vec<String>> =
        terms.iter().map(|term| term.columns().into_iter().map(|column| column.name).collect()).collect();
    assert_eq!(names, [vec!["ia6"], vec!["offset2", "offset5"], vec!["spring3", "spring3_preload"]]);
}

/// Effects of one family side by side in one model: two joints, and two waves in one joint.
#[test]
fn columns_of_different_effects_have_different_names() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let model = rigid_model("panda", &mut rng);
    let mut names = BTreeSet::new();
    for family in FAMILIES {
        let form = &family.forms[0];
        for site in family.sites(form, 7) {
            let settings: Vec<f64> = form.settings.iter().map(|setting| setting.at(0.4)).collect();
            let spec = effect(family.id, form.name, site, &settings);
            for column in spec.build(&operating_point(&model)).unwrap().columns() {
                assert!(names.insert(column.name.clone()), "{}", column.name);
            }
        }
    }
    for n in [2.5, 3.0, 200.125] {
        let spec = effect("position-ripple", "", Site::Joint(3), &[n]);
        let columns = spec.build(&operating_point(&model)).unwrap().columns();
        assert_eq!(columns[1].name, format!("ripple4_n{n}_cos"));
        assert!(columns.iter().all(|column| names.insert(column.name.clone())));
    }
}

/// Torques of the motors' side contain the rotors; the first two of a Panda are no parameters of their own, and one that the torques do not contain is nowhere.
#[test]
fn rotors_that_have_no_parameter_of_their_own_are_in_the_rigid_body() {
    let chain = chain("panda");
    let rotors = |terms: &[&str]| {
        let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), terms).unwrap().identifiable();
        let operating_point = structure.operating_point(&vec![0.1; structure.columns().len()]);
        (operating_point.rotors, operating_point.rotor_inertias)
    };
    let (absorbed, inertias) = rotors(&["friction", "rotor-inertia"]);
    assert_eq!(absorbed, [true, true, false, false, false, false, false]);
    assert_eq!(inertias, [0.0, 0.0, 0.1, 0.1, 0.1, 0.1, 0.1]);
    assert_eq!(rotors(&["friction"]), (vec![false; 7], Vec::new()));
}
