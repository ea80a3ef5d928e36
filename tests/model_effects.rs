//! Every family of effects: its regressor, its served torque and its file form are the same effect, on every kind of arm.

mod arms;

use arms::{any_mounting, chain, draw};
use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use nalgebra::{DMatrix, DVector};
use plumbline::joint::Torque;
use plumbline::model::base::Reduction;
use plumbline::model::gravity::Mounting;
use plumbline::model::structure::Structure;
use plumbline::model::term::effect::{Confounded, FAMILIES, Family, Ground, Site, Spec, Stratum};
use plumbline::model::term::{Motion, Sample};
use plumbline::model::torque::{NamedEffect, NamedTerm, TorqueModel};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

/// Arms with turning and sliding joints.
const ROBOTS: [&str; 3] = ["panda", "paper-2dof", "scara"];

/// Sines with their derivatives, one period of 4 s at 250 Hz.
fn smooth_motion(rng: &mut ChaCha8Rng, n: usize, periodic: bool) -> Motion {
    let (samples, dt) = (1000, 4e-3);
    let zeros = || DMatrix::zeros(samples, n);
    let (mut q, mut dq, mut ddq) = (zeros(), zeros(), zeros());
    for j in 0..n {
        let middle = rng.random_range(-1.0..1.0);
        q.column_mut(j).fill(middle);
        for harmonic in 1..=4 {
            let (a, phase) = (rng.random_range(0.05..0.3), rng.random_range(-3.0..3.0));
            let w = f64::from(harmonic) * std::f64::consts::FRAC_PI_2;
            for k in 0..samples {
                let (sin, cos) = (w * k as f64 * dt + phase).sin_cos();
                q[(k, j)] += a * sin;
                dq[(k, j)] += a * w * cos;
                ddq[(k, j)] -= a * w * w * sin;
            }
        }
    }
    Motion { dt, q, dq, ddq, gravity: any_mounting(rng).gravity(), periodic, start: 12.0 }
}

fn rigid_model(robot: &str, rng: &mut ChaCha8Rng) -> TorqueModel {
    let chain = chain(robot);
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &["friction"]).unwrap();
    let values: Vec<_> =
        draw(rng, structure.columns().len(), 1.0).into_iter().map(|value| (value, Some(0.1))).collect();
    TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap()
}

fn ground(model: &TorqueModel) -> Ground {
    model.structure().ground(&model.beta())
}

/// Every form of a family at a random site with random settings.
fn specs(family: &'static Family, n: usize, rng: &mut ChaCha8Rng) -> Vec<Spec> {
    let sites = family.place.sites(n);
    let mut spec = |form: &'static plumbline::model::term::effect::Form| Spec {
        family: family.id,
        form: form.name,
        site: sites[rng.random_range(0..sites.len())],
        settings: form.settings.iter().map(|setting| setting.at(rng.random_range(0.0..1.0))).collect(),
    };
    family.forms.iter().map(&mut spec).collect()
}

/// The model with one effect, whose parameters are `0.3, 0.4, ..`.
fn with(model: &TorqueModel, spec: &Spec) -> TorqueModel {
    let term = spec.build(&ground(model)).unwrap();
    let columns = term.columns().len();
    let structure = model.structure().clone().with(vec![term]).unwrap();
    let mut values: Vec<(f64, Option<f64>)> = model.parameters().iter().map(|p| (p.value, p.std)).collect();
    values.extend((0..columns).map(|c| (0.3 + 0.1 * c as f64, Some(0.1))));
    TorqueModel::new(model.robot(), structure, vec![Mounting::WALL], &values).unwrap()
}

/// The regressor of an effect alone, n N x columns.
fn columns(ground: &Ground, spec: &Spec, motion: &Motion) -> DMatrix<f64> {
    let term = spec.build(ground).unwrap();
    let mut y = DMatrix::zeros(motion.joints() * motion.samples(), term.columns().len());
    term.fill(&ground.chain, motion, &mut y, 0);
    y
}

fn named(model: &TorqueModel) -> Vec<NamedTerm> {
    let mut all = Vec::new();
    for (term, parameters) in model.terms() {
        let effect = term.spec().map_or(NamedEffect::default(), |spec| {
            let form = spec.family().unwrap().form(spec.form).unwrap();
            let joints: Vec<usize> = spec.site.joints().iter().map(|joint| joint + 1).collect();
            let settings = form.settings.iter().zip(&spec.settings);
            NamedEffect {
                form: spec.form.to_string(),
                joint: joints.first().copied(),
                cause: joints.get(1).copied(),
                settings: settings.map(|(setting, value)| (setting.name.to_string(), *value)).collect(),
            }
        });
        let parameters = parameters.iter().map(|p| (p.column.name.clone(), p.value, p.std)).collect();
        all.push(NamedTerm { id: term.id().to_string(), effect, parameters });
    }
    all
}

#[test]
fn what_is_served_is_the_regressor_times_the_parameters() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for robot in ROBOTS {
        let model = rigid_model(robot, &mut rng);
        let n = model.structure().chain().len();
        for family in FAMILIES {
            for spec in specs(family, n, &mut rng) {
                let periodic = rng.random_bool(0.5);
                let motion = smooth_motion(&mut rng, n, periodic);
                let full = with(&model, &spec);
                let own = columns(&ground(&model), &spec, &motion);
                assert!(own.iter().all(|value| value.is_finite()), "{spec:?}");
                // A one-sided spring may not be reached.
                let one_sided = ["above", "below"].contains(&spec.form);
                assert!(
                    one_sided || own.column_iter().all(|column| column.amax() > 0.0),
                    "an empty column: {spec:?}, {robot}"
                );
                let served = full.predict(&motion) - model.predict(&motion);
                if !family.served {
                    assert_eq!(served.amax(), 0.0, "{spec:?}");
                    continue;
                }
                let beta = DVector::from_vec(full.beta()[model.beta().len()..].to_vec());
                let expected = own * beta;
                let expected = DMatrix::from_column_slice(motion.samples(), n, expected.as_slice());
                let scale = expected.amax().max(model.predict(&motion).amax());
                let difference = (served - &expected).amax();
                assert!(difference < 1e-9 * scale, "{spec:?} of {robot}: {difference:e} of {scale:e}");
            }
        }
    }
}

#[test]
fn a_model_with_any_effect_comes_back_from_its_names() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for robot in ["panda", "scara"] {
        let model = rigid_model(robot, &mut rng);
        for family in FAMILIES {
            for spec in specs(family, model.structure().chain().len(), &mut rng) {
                let full = with(&model, &spec);
                if full.terms().last().unwrap().0.spec().is_none() {
                    // A term of the whole arm (offsets, rotors), which tests/model_torque.rs has.
                    continue;
                }
                let rebuild = |named: &[NamedTerm]| {
                    TorqueModel::from_named(robot, chain(robot), model.kind(), vec![Mounting::WALL], named)
                };
                let again = rebuild(&named(&full)).unwrap();
                assert_eq!(full.parameters(), again.parameters(), "{spec:?}");
                let motion = smooth_motion(&mut rng, model.structure().chain().len(), false);
                assert_eq!(full.predict(&motion), again.predict(&motion), "{spec:?}");
            }
        }
    }
}

#[test]
fn no_effect_allocates_in_the_loop() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let model = rigid_model("panda", &mut rng);
    // The guard itself works: an allocation under it is counted.
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1.0))));
    let counted = violation_count();
    assert!(counted > 0);
    for family in FAMILIES {
        for spec in specs(family, 7, &mut rng) {
            let mut evaluator = with(&model, &spec).evaluator(&Mounting::WALL.gravity());
            let mut sum = 0.0;
            assert_no_alloc(|| {
                for k in 0..20 {
                    let sample = Sample { q: [0.3 + 1e-3 * f64::from(k); 8], dq: [1.0; 8], ddq: [-1.0; 8] };
                    let Torque(tau) = evaluator.torque(&sample);
                    sum += tau.iter().sum::<f64>();
                }
            });
            assert_eq!(violation_count(), counted, "{spec:?}");
            assert!(sum.is_finite());
        }
    }
}

/// The identities that reports and model files are keyed by.
const IDS: &str = "torque-offset torque-gain asymmetric-coulomb asymmetric-viscous stribeck nonlinear-viscous \
    load-dependent-friction friction-drift offset-drift presliding rotor-inertia joint-elasticity position-ripple \
    position-dependent-friction spring payload mounting base-motion torque-crosstalk transmission-coupling delay contact \
    encoder-offset encoder-eccentricity backlash";

#[test]
fn the_catalogue_is_whole_and_says_what_people_have_to_know() {
    let ids: Vec<&str> = FAMILIES.iter().map(|family| family.id).collect();
    assert_eq!(ids.iter().collect::<BTreeSet<_>>().len(), ids.len());
    assert!(ids.iter().all(|id| IDS.split_whitespace().any(|known| known == *id)), "{ids:?}");
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let model = rigid_model("panda", &mut rng);
    for family in FAMILIES {
        let id = family.id;
        assert!(family.physics.ends_with('.') && family.physics.matches(". ").count() == 0, "one sentence: {id}");
        assert!(!family.typical.is_empty() && !family.reference.is_empty() && !family.confounded.is_empty(), "{id}");
        assert_eq!(
            family.served,
            family.stratum != Stratum::Changing,
            "what changes over a recording can't be served: {id}"
        );
        for Confounded { with, decided_by } in family.confounded {
            // Another family, or parameters of the model, which begin with a letter of theirs.
            let known = IDS.split_whitespace().any(|other| other == *with && other != id);
            let parameters = ["L", "l", "f", "the "].iter().any(|start| with.starts_with(start));
            assert!(known || parameters, "{id} is confounded with {with}?");
            assert!(decided_by.len() > 10, "{id}");
        }
        let forms: BTreeSet<&str> = family.forms.iter().map(|form| form.name).collect();
        assert_eq!(forms.len(), family.forms.len(), "{id}");
        let mut names = BTreeSet::new();
        for spec in specs(family, 7, &mut rng) {
            let term = spec.build(&ground(&model)).unwrap();
            assert_eq!((term.id(), term.physics()), (id, family.physics));
            let form = family.form(spec.form).unwrap();
            let equation = |name: &str| form.equation.split(|c: char| !c.is_alphanumeric()).any(|word| word == name);
            assert!(form.settings.iter().all(|setting| equation(setting.name)), "settings in the equation of {id}");
            for column in term.columns() {
                assert!(names.insert(column.name.clone()), "two columns {}", column.name);
                assert!((1..=7).contains(&column.joint));
                let plain = |c: char| c.is_ascii_alphanumeric() || "/ ".contains(c);
                assert!(!column.unit.is_empty() && column.unit.chars().all(plain), "{}: {}", column.name, column.unit);
            }
        }
    }
}

/// Effects of one family side by side in one model: two joints, and two waves in one joint.
#[test]
fn columns_of_different_effects_have_different_names() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let model = rigid_model("panda", &mut rng);
    let mut names = BTreeSet::new();
    for family in FAMILIES {
        for site in family.place.sites(7) {
            let form = &family.forms[0];
            let settings = form.settings.iter().map(|setting| setting.at(0.4)).collect();
            let spec = Spec { family: family.id, form: form.name, site, settings };
            for column in spec.build(&ground(&model)).unwrap().columns() {
                assert!(names.insert(column.name.clone()), "{}", column.name);
            }
        }
    }
    for n in [2.5, 3.0, 200.125] {
        let spec = Spec { family: "position-ripple", form: "", site: Site::Joint(3), settings: vec![n] };
        let columns = spec.build(&ground(&model)).unwrap().columns();
        assert_eq!(columns[1].name, format!("ripple4_n{n}_cos"));
        assert!(columns.iter().all(|column| names.insert(column.name.clone())));
    }
}

/// What is proportional to a joint's rigid-body torque is just that.
#[test]
fn gains_are_shares_of_the_rigid_bodys_torque() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    for robot in ROBOTS {
        let model = rigid_model(robot, &mut rng);
        let (n, rigid) = (model.structure().chain().len(), model.structure().reduction().len());
        let motion = smooth_motion(&mut rng, n, false);
        let samples = motion.samples();
        let beta = DVector::from_vec(model.beta()[..rigid].to_vec());
        let load = model.structure().regressor(&motion).columns(0, rigid) * beta;
        let rows = |joint: usize| load.rows(joint * samples, samples);
        let gain = Spec { family: "torque-gain", form: "", site: Site::Joint(1), settings: vec![] };
        let difference = columns(&ground(&model), &gain, &motion).rows(samples, samples) - rows(1);
        assert!(difference.amax() < 1e-11 * load.amax());
        let site = Site::Pair { row: 0, cause: 1 };
        let cross = Spec { family: "torque-crosstalk", form: "", site, settings: vec![] };
        let own = columns(&ground(&model), &cross, &motion);
        assert!((own.rows(0, samples) - rows(1)).amax() < 1e-11 * load.amax());
        assert_eq!(own.rows(samples, samples).amax(), 0.0, "only in its own row");
    }
}

/// Laws by hand, at one sample each.
#[test]
fn laws_are_what_their_equations_say() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let model = rigid_model("panda", &mut rng);
    let ground = ground(&model);
    let motion = smooth_motion(&mut rng, 7, false);
    let (j, k) = (3, 2);
    let at = |matrix: &DMatrix<f64>, joint: usize, sample: usize| matrix[(sample, joint)];
    let sign = |dq: f64| (100.0 * dq).tanh();
    type Law<'a> = &'a dyn Fn(f64, f64, usize) -> Vec<f64>;
    let pair = Site::Pair { row: j, cause: k };
    let one = Site::Joint(j);
    let other = |sample: usize| at(&motion.dq, k, sample);
    let minutes = |sample: usize| (12.0 + 4e-3 * sample as f64) / 60.0;
    let cases: [(&str, &str, Site, Vec<f64>, Law); 13] = [
        ("asymmetric-coulomb", "", one, vec![], &|_, dq, _| vec![sign(dq).abs()]),
        ("asymmetric-viscous", "", one, vec![], &|_, dq, _| vec![dq.abs()]),
        ("stribeck", "", one, vec![0.1], &|_, dq, _| vec![(-dq * dq / 0.01).exp() * sign(dq)]),
        ("nonlinear-viscous", "sigmoid", one, vec![0.2], &|_, dq, _| vec![(dq / 0.2).tanh()]),
        ("nonlinear-viscous", "cubic", one, vec![], &|_, dq, _| vec![dq * dq * dq]),
        ("nonlinear-viscous", "quadratic", one, vec![], &|_, dq, _| vec![dq * dq.abs()]),
        ("position-ripple", "", one, vec![7.5], &|q, _, _| vec![(7.5 * q).sin(), (7.5 * q).cos()]),
        ("spring", "cubic", one, vec![], &|q, _, _| vec![q, 1.0, q * q * q]),
        ("spring", "above", one, vec![0.2], &|q, _, _| vec![if q > 0.2 { q - 0.2 } else { 0.0 }]),
        ("spring", "below", one, vec![0.2], &|q, _, _| vec![if q < 0.2 { 0.2 - q } else { 0.0 }]),
        ("transmission-coupling", "friction", pair, vec![], &|_, _, s| vec![sign(other(s)), other(s)]),
        ("transmission-coupling", "sum", pair, vec![0.5], &|_, dq, s| vec![sign(dq + 0.5 * other(s))]),
        ("friction-drift", "linear", one, vec![], &|_, dq, s| vec![minutes(s) * sign(dq), minutes(s) * dq]),
    ];
    for (family, form, site, settings, law) in cases {
        let spec = Spec { family: FAMILIES.iter().find(|f| f.id == family).unwrap().id, form, site, settings };
        let own = columns(&ground, &spec, &motion);
        for sample in (0..motion.samples()).step_by(37) {
            let expected = law(at(&motion.q, j, sample), at(&motion.dq, j, sample), sample);
            assert_eq!(own.ncols(), expected.len(), "{spec:?}");
            for (c, expected) in expected.iter().enumerate() {
                let found = own[(j * motion.samples() + sample, c)];
                assert!((found - expected).abs() < 1e-12, "{spec:?} column {c}: {found} {expected}");
            }
        }
    }
}
