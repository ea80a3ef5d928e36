//! How a model is identified once more with its effects.

use super::*;
use plumbline_identify::Experiment;
use plumbline_identify::solve::identify_with;

#[test]
fn columns_are_evaluated_once_more_where_a_parameter_moved_by_more_than_a_tenth_of_its_deviation() {
    let friction = Spec { family: "load-dependent-friction", form: "coulomb", site: Site::Joint(1), settings: vec![] };
    let identify = recorded(2, 88, |_| [0.0; 2]);
    Case::of(&identify, &identify).deliver(&[(friction.clone(), Span::ALL, 9.0)], |delivery, selected| {
        // One identification with the columns at these parameters.
        let once = |beta: &[f64]| {
            let plain = delivery.input.structure;
            let terms = effect::assemble(std::slice::from_ref(&friction), &plain.operating_point(beta)).unwrap();
            let structure = plain.clone().with(terms).unwrap();
            identify_with(&structure, delivery.equations.experiments(), delivery.input.options).unwrap()
        };
        let mut settled = once(selected.state.fit.theta.as_slice());
        for _ in 0..10 {
            settled = once(&settled.beta);
        }
        let mut state = selected.state.clone();
        let mut from = |moved: &dyn Fn(usize) -> f64| {
            for (k, (beta, std)) in settled.beta.iter().zip(&settled.std).enumerate() {
                state.fit.theta[k] = beta + moved(k) * std.unwrap();
            }
            let first = once(state.fit.theta.as_slice()).beta;
            let delivered = delivery.extended(&state, &[true]).unwrap().identification.beta;
            let second = once(&first).beta;
            assert_ne!(first, second);
            (delivered == first, delivered == second)
        };
        for sign in [-1.0, 1.0] {
            assert_eq!(from(&|_| 0.08 * sign), (true, false));
            // One parameter is enough.
            assert_eq!(from(&|k| if k == 1 { 0.15 * sign } else { 0.0 }), (false, true));
            assert_eq!(from(&|_| 30.0 * sign), (false, true));
        }
    });
}

#[test]
fn where_the_noise_is_unknown_the_joints_keep_the_weights_of_the_model_that_the_search_starts_from() {
    // An offset of joint 2 is in the data and repaired: with weights of its own that joint would weigh more.
    let offset = |_: &At| [0.0, 3.0];
    let (once, repeated) = (once(12.0, 78, offset), recorded(2, 79, offset));
    let effects = [(spec("torque-offset", 1), Span::ALL, 9.0)];
    let of = |identify: &Recorded, seeds: Vec<Spec>, estimator| {
        let options = Options { estimator, ..Options::default() };
        Case { seeds, options, ..Case::of(identify, &repeated) }.deliver(&effects, |delivery, selected| {
            let identification = delivery.extended(&selected.state, &[true]).unwrap().identification;
            (identification.sigma, delivery.before.sigma.clone(), identification.estimator)
        })
    };
    let (sigma, plain, _) = of(&once, vec![], Estimator::Wls);
    assert_eq!(sigma, plain);
    // Seeds are in the model that the search starts from.
    let (sigma, plain, _) = of(&once, vec![spec("torque-offset", 1)], Estimator::Wls);
    assert!(sigma[1] < 0.5 * plain[1], "{sigma:?} {plain:?}");
    // The noise is known: weights of its own.
    let (sigma, plain, _) = of(&repeated, vec![], Estimator::Wls);
    assert!(sigma[1] < 0.5 * plain[1], "{sigma:?} {plain:?}");
    // Known in some of the runs is not known.
    let mut mixed = Recorded { structure: structure(), experiments: once.experiments.clone() };
    mixed.experiments.extend(repeated.experiments.iter().cloned());
    let (sigma, plain, _) = of(&mixed, vec![], Estimator::Wls);
    assert_eq!(sigma, plain);
    // Another estimator stays the one that was asked for.
    assert_eq!(of(&once, vec![], Estimator::Ols).2, Estimator::Ols);
}

/// The arm with this multiple of its fifth joint's acceleration on the torque there, identified with the effect.
fn fitted(scene: &Scene, spec: &Spec, per_acceleration: f64) -> Fitted {
    let mut run = scene.record(2, 3);
    for k in 0..run.tau.nrows() {
        run.tau[(k, 4)] += per_acceleration * scene.motion.ddq[(k % scene.motion.samples(), 4)];
    }
    let experiment = Experiment::prepare(&run, &plumbline_identify::Settings::default()).unwrap();
    let terms = effect::assemble(std::slice::from_ref(spec), &scene.structure.operating_point(&scene.beta)).unwrap();
    let structure = scene.structure.clone().with(terms).unwrap();
    let identification = identify(&structure, &[experiment]).unwrap();
    Fitted { structure, identification }
}

#[test]
fn a_parameter_below_zero_is_seen_where_physics_forbids_it() {
    let scene = Scene::panda_on_the_wall();
    let of = |family| Spec { family, form: "", site: Site::Joint(4), settings: Vec::new() };
    // A rotor's column belongs to a term of the whole arm.
    let rotor = of("rotor-inertia");
    let why = implausible(&fitted(&scene, &rotor, -0.2), &rotor).unwrap();
    let value: f64 = why.strip_prefix("ia5 came out as ").unwrap().split(',').next().unwrap().parse().unwrap();
    assert!((value + 0.2).abs() < 0.05 && why.ends_with("it can't be below 0"), "{why}");
    assert_eq!(implausible(&fitted(&scene, &rotor, 0.2), &rotor), None);
    // A compliance is searched for as a setting, and fitted as a parameter once more.
    let elastic = Spec { form: "swinging", settings: vec![1e-4, 5.0], ..of("joint-elasticity") };
    let mut soft = fitted(&scene, &elastic, 0.0);
    let at = soft.structure.columns().iter().position(|column| column.name == "compliance5").unwrap();
    soft.identification.beta[at] = -1e-4;
    let why = implausible(&soft, &elastic).unwrap();
    assert!(why.starts_with("compliance5 came out as -") && why.ends_with("it can't be below 0"), "{why}");
    // An offset may have any sign.
    let offset = of("torque-offset");
    let mut below = fitted(&scene, &offset, 0.0);
    let at = below.structure.columns().iter().position(|column| column.name == "offset5").unwrap();
    below.identification.beta[at] = -0.3;
    assert_eq!(implausible(&below, &offset), None);
}
