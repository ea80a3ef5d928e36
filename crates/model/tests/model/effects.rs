//! Every family of effects: its regressor, its served torque and its file form are the same effect, on every kind of arm.

use assert_no_alloc::{assert_no_alloc, violation_count};
use nalgebra::{DMatrix, DVector, Rotation3, Unit, Vector3};
use plumbline_core::Torque;
use plumbline_model::term::effect::{
    Confounded, FAMILIES, Family, InBodies, InC, Inputs, OperatingPoint, Place, PlotOver, Site, Spec, Stratum, assemble,
};
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{Mounting, NamedEffect, NamedTerm, Placement, Reduction, Structure, TorqueModel};
use plumbline_testkit::arms::{any_mounting, chain, draw, torque};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::collections::BTreeSet;

/// Arms with turning and sliding joints.
const ROBOTS: [&str; 3] = ["panda", "paper-2dof", "scara"];

/// Sines with their derivatives, one period of 4 s at 250 Hz.
fn smooth_motion(rng: &mut ChaCha8Rng, n: usize, periodic: bool) -> Motion {
    sampled_motion(rng, n, periodic, 1000)
}

/// The same with that many samples.
fn sampled_motion(rng: &mut ChaCha8Rng, n: usize, periodic: bool, samples: usize) -> Motion {
    let dt = 4.0 / samples as f64;
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
    model_within(robot, rng, 1.0)
}

/// With parameters within `span` of zero.
fn model_within(robot: &str, rng: &mut ChaCha8Rng, span: f64) -> TorqueModel {
    let chain = chain(robot);
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &["friction"]).unwrap();
    let values: Vec<_> =
        draw(rng, structure.columns().len(), span).into_iter().map(|value| (value, Some(0.1))).collect();
    TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap()
}

fn operating_point(model: &TorqueModel) -> OperatingPoint {
    model.structure().operating_point(&model.beta())
}

/// Every form of a family at a random site with random settings.
fn specs(family: &'static Family, n: usize, rng: &mut ChaCha8Rng) -> Vec<Spec> {
    let sites = family.place.sites(n);
    let mut spec = |form: &'static plumbline_model::term::effect::Form| Spec {
        family: family.id,
        form: form.name,
        site: sites[rng.random_range(0..sites.len())],
        settings: match family.id {
            // A window inside the motion.
            "contact" => vec![12.5, 15.5],
            _ => form.settings.iter().map(|setting| setting.at(rng.random_range(0.0..1.0))).collect(),
        },
    };
    family.forms.iter().map(&mut spec).collect()
}

/// The model with one effect, whose parameters are `0.3, 0.4, ..`.
fn with(model: &TorqueModel, spec: &Spec) -> TorqueModel {
    let term = spec.build(&operating_point(model)).unwrap();
    let columns = term.columns().len();
    let structure = model.structure().clone().with(vec![term]).unwrap();
    let mut values: Vec<(f64, Option<f64>)> = model.parameters().iter().map(|p| (p.value, p.std)).collect();
    values.extend((0..columns).map(|c| (0.3 + 0.1 * c as f64, Some(0.1))));
    TorqueModel::new(model.robot(), structure, vec![Mounting::WALL], &values).unwrap()
}

/// The regressor of an effect alone, n N x columns.
fn columns(operating_point: &OperatingPoint, spec: &Spec, motion: &Motion) -> DMatrix<f64> {
    let term = spec.build(operating_point).unwrap();
    let mut y = DMatrix::zeros(motion.joints() * motion.samples(), term.columns().len());
    term.fill(&operating_point.chain, motion, &mut y, 0);
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
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for robot in ROBOTS {
        let model = rigid_model(robot, &mut rng);
        let n = model.structure().chain().len();
        for family in FAMILIES {
            for spec in specs(family, n, &mut rng) {
                let periodic = rng.random_bool(0.5);
                let motion = smooth_motion(&mut rng, n, periodic);
                let full = with(&model, &spec);
                let own = columns(&operating_point(&model), &spec, &motion);
                assert!(own.iter().all(|value| value.is_finite()), "{spec:?}");
                // A one-sided spring may not be reached, and a small arm or the first link does not feel every force, tilt or parameter.
                // Nor does anything depend on where a sliding joint is.
                let sliding = family.id.starts_with("encoder") && robot == "scara";
                let may_be = ["above", "below"].contains(&spec.form)
                    || ((robot != "panda" || spec.site == Site::Joint(0)) && own.ncols() > 1)
                    || sliding;
                assert!(
                    may_be || own.column_iter().all(|column| column.amax() > 0.0),
                    "an empty column: {spec:?}, {robot}"
                );
                let served = full.predict(&motion) - model.predict(&motion);
                if !family.is_served() {
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

/// Columns that the data can't tell can be left out of an effect; what is left is the same effect.
#[test]
fn an_effect_may_be_short_of_columns() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let model = rigid_model("panda", &mut rng);
    let spec = Spec { family: "payload", form: "", site: Site::Arm, settings: vec![] };
    let full = with(&model, &spec);
    let kept = ["payload_lx", "payload_m"];
    let mut names = named(&full);
    let term = names.last_mut().unwrap();
    term.parameters.retain(|(name, _, _)| kept.contains(&name.as_str()));
    let short = TorqueModel::from_named("panda", chain("panda"), model.kind(), vec![Mounting::WALL], &names).unwrap();
    let (last, parameters) = *short.terms().last().unwrap();
    assert_eq!(last.spec(), Some(spec));
    assert_eq!((last.original(0), last.original(1)), (6, 9));
    assert_eq!(parameters.iter().map(|own| own.column.name.as_str()).collect::<Vec<_>>(), kept);
    assert_eq!(named(&short), names, "what is left out stays out of the file");
    let motion = smooth_motion(&mut rng, 7, false);
    let own = columns(&operating_point(&model), last.spec().as_ref().unwrap(), &motion);
    let expected = own.column(6) * parameters[0].value + own.column(9) * parameters[1].value;
    let served = short.predict(&motion) - model.predict(&motion);
    assert!((DVector::from_column_slice(served.as_slice()) - &expected).amax() < 1e-9 * expected.amax());
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
    encoder-offset encoder-eccentricity backlash friction-change";

#[test]
fn the_catalogue_is_whole_and_says_what_people_have_to_know() {
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
        let mut names = BTreeSet::new();
        for spec in specs(family, 7, &mut rng) {
            let term = spec.build(&operating_point(&model)).unwrap();
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

/// Declarations that readers of the catalogue rely on.
#[test]
fn declarations_of_a_family_agree() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let model = rigid_model("panda", &mut rng);
    let inputs = Inputs { load: "load".into(), q: "q".into(), ..Inputs::default() };
    for family in FAMILIES {
        let id = family.id;
        assert!(family.stratum != Stratum::Reference || family.rare.may_change, "{id}");
        if let Some(part) = family.rare.part_of {
            assert!(
                family.form(part.form).is_some() && plumbline_model::term::effect::family(part.family).is_some(),
                "{id}"
            );
        }
        let last_link = family.rare.in_bodies == InBodies::LastLink;
        for spec in specs(family, 7, &mut rng) {
            let term = spec.build(&operating_point(&model)).unwrap();
            let form = family.form(spec.form).unwrap();
            // A term of the whole arm has no spec of its own.
            assert_eq!(term.spec().is_none(), family.rare.whole_arm.is_some(), "{spec:?}");
            assert_eq!(matches!(form.in_c, InC::LastLink), last_link, "{spec:?}");
            match form.in_c {
                InC::Columns(columns) | InC::Part { columns, .. } => {
                    assert_eq!(columns(&inputs, &spec.settings).len(), term.columns().len(), "{spec:?}");
                }
                InC::Entries => assert!(term.entries().is_some(), "{spec:?}"),
                InC::LastLink => assert_eq!(term.columns().len(), 10, "{spec:?}"),
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
    let one = |family, joint| Spec { family, form: "", site: Site::Joint(joint), settings: vec![] };
    let specs = [one("rotor-inertia", 5), one("torque-offset", 1), one("spring", 2), one("torque-offset", 4)];
    let specs = specs.map(|spec| if spec.family == "spring" { Spec { form: "linear", ..spec } } else { spec });
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
        for site in family.place.sites(7) {
            let form = &family.forms[0];
            let settings = form.settings.iter().map(|setting| setting.at(0.4)).collect();
            let spec = Spec { family: family.id, form: form.name, site, settings };
            for column in spec.build(&operating_point(&model)).unwrap().columns() {
                assert!(names.insert(column.name.clone()), "{}", column.name);
            }
        }
    }
    for n in [2.5, 3.0, 200.125] {
        let spec = Spec { family: "position-ripple", form: "", site: Site::Joint(3), settings: vec![n] };
        let columns = spec.build(&operating_point(&model)).unwrap().columns();
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
        let difference = columns(&operating_point(&model), &gain, &motion).rows(samples, samples) - rows(1);
        assert!(difference.amax() < 1e-11 * load.amax());
        let site = Site::Pair { row: 0, cause: 1 };
        let cross = Spec { family: "torque-crosstalk", form: "", site, settings: vec![] };
        let own = columns(&operating_point(&model), &cross, &motion);
        assert!((own.rows(0, samples) - rows(1)).amax() < 1e-11 * load.amax());
        assert_eq!(own.rows(samples, samples).amax(), 0.0, "only in its own row");
    }
}

/// Laws by hand, at one sample each.
#[test]
fn laws_are_what_their_equations_say() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let model = rigid_model("panda", &mut rng);
    let operating_point = operating_point(&model);
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
        ("stribeck", "gaussian", one, vec![0.1], &|_, dq, _| vec![(-dq * dq / 0.01).exp() * sign(dq)]),
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
        let own = columns(&operating_point, &spec, &motion);
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

/// `tau_rb` along a motion by the regressor, N x n.
fn load(model: &TorqueModel, motion: &Motion) -> DMatrix<f64> {
    let rigid = model.structure().reduction().len();
    let beta = DVector::from_vec(model.beta()[..rigid].to_vec());
    let stacked = model.structure().regressor(motion).columns(0, rigid) * beta;
    DMatrix::from_column_slice(motion.samples(), motion.joints(), stacked.as_slice())
}

/// A column of an effect as N x n.
fn column_of(operating_point: &OperatingPoint, spec: &Spec, motion: &Motion, column: usize) -> DMatrix<f64> {
    let all = columns(operating_point, spec, motion);
    DMatrix::from_column_slice(motion.samples(), motion.joints(), all.column(column).clone_owned().as_slice())
}

/// First and second derivative of a periodic signal by central differences.
fn differences(signal: &[f64], dt: f64) -> (Vec<f64>, Vec<f64>) {
    let n = signal.len();
    let around = |k: usize| (signal[(k + n - 1) % n], signal[k], signal[(k + 1) % n]);
    let first = (0..n).map(|k| (around(k).2 - around(k).0) / (2.0 * dt));
    let second = (0..n).map(|k| (around(k).2 - 2.0 * around(k).1 + around(k).0) / (dt * dt));
    (first.collect(), second.collect())
}

/// Effects of a position error are what the rigid body does on the motion that is really shifted.
#[test]
fn a_position_error_shifts_the_motion() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for robot in ["panda", "paper-2dof"] {
        // Small torques, so that a gap of a few Nm is wide against the steps of the motion.
        let model = model_within(robot, &mut rng, 0.02);
        let (operating_point, n) = (operating_point(&model), model.structure().chain().len());
        // Friction turns within milliseconds.
        let motion = sampled_motion(&mut rng, n, true, 40_000);
        let torque = load(&model, &motion);
        let i = rng.random_range(0..n);
        let q: Vec<f64> = motion.q.column(i).iter().copied().collect();
        let own: Vec<f64> = torque.column(i).iter().copied().collect();
        let through: Vec<f64> =
            own.iter().zip(&friction(&operating_point, &motion, i)).map(|(own, tau)| own + tau).collect();
        let width = (0.5 * torque.column(i).amax()).min(5.0);
        let twist = |load: &[f64]| load.iter().map(|tau| -tau).collect();
        let gap = |load: &[f64]| load.iter().map(|tau| -(tau / width).tanh()).collect();
        let cases = [
            ("encoder-offset", "", vec![], 0, vec![1.0; q.len()]),
            ("encoder-eccentricity", "", vec![], 0, q.iter().map(|q| q.sin()).collect()),
            ("encoder-eccentricity", "", vec![], 1, q.iter().map(|q| q.cos()).collect()),
            ("joint-elasticity", "", vec![], 0, twist(&own)),
            ("joint-elasticity", "link-friction", vec![], 0, twist(&through)),
            ("backlash", "", vec![width], 0, gap(&own)),
        ];
        for (id, form, settings, c, error) in cases {
            let family = FAMILIES.iter().find(|family| family.id == id).unwrap();
            let spec = Spec { family: family.id, form, site: Site::Joint(i), settings };
            let found = column_of(&operating_point, &spec, &motion, c);
            let a = 1e-5;
            let (first, second) = differences(&error, motion.dt);
            let shifted = |a: f64| {
                let mut motion = motion.clone();
                for k in 0..motion.samples() {
                    motion.q[(k, i)] += a * error[k];
                    motion.dq[(k, i)] += a * first[k];
                    motion.ddq[(k, i)] += a * second[k];
                }
                load(&model, &motion)
            };
            let expected = (shifted(a) - shifted(-a)) / (2.0 * a);
            let (difference, scale) = ((&found - &expected).amax(), expected.amax());
            // Differences across the moments in which a joint turns, some ten samples, are coarse.
            let precision = if form.is_empty() { 2e-3 } else { 0.1 };
            assert!(
                scale > 1e-3 && difference < precision * scale,
                "{id} {form} of {robot}: {difference:e} of {scale:e}"
            );
        }
    }
}

/// `fv dq + fc tanh(100 dq)` of one joint \[Nm\].
fn friction(operating_point: &OperatingPoint, motion: &Motion, joint: usize) -> Vec<f64> {
    let [fv, fc] = operating_point.friction[joint];
    motion.dq.column(joint).iter().map(|dq| fv * dq + fc * (100.0 * dq).tanh()).collect()
}

/// What a swinging link adds to its joint's torque is what the rigid body and the friction on its side add where the link truly is, and that is where the
/// gear gives way to this torque.
#[test]
fn a_link_swings_on_its_gear() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let mut inertia = 0.0;
    // The last joint's inertia is a parameter of its own, and the only one that has to be positive here.
    while inertia < 0.01 {
        let model = model_within("panda", &mut rng, 0.1);
        let (operating_point, i) = (operating_point(&model), 6);
        let motion = sampled_motion(&mut rng, 7, true, 40_000);
        let torque = load(&model, &motion);
        let mut faster = motion.clone();
        faster.ddq.column_mut(i).add_scalar_mut(1.0);
        inertia = load(&model, &faster)[(0, i)] - torque[(0, i)];
        if inertia < 0.01 {
            continue;
        }
        // Flanks that are wide against the load: between sharp ones the link jumps.
        let width = (0.5 * torque.column(i).amax()).min(5.0);
        let (compliance, gap) = (5e-4, 5e-4 * width);
        let quality = 4.0;
        let cases = [
            ("joint-elasticity", vec![compliance, quality], compliance),
            ("backlash", vec![gap, width, quality], gap / width),
        ];
        for (id, settings, slack) in cases {
            let (size, gapped) = (settings[0], id == "backlash");
            let twist = |tau: f64| if gapped { gap * (tau / width).tanh() } else { compliance * tau };
            let family = FAMILIES.iter().find(|family| family.id == id).unwrap();
            let spec = Spec { family: family.id, form: "swinging", site: Site::Joint(i), settings };
            let added = size * column_of(&operating_point, &spec, &motion, 0).column(i);
            let still = friction(&operating_point, &motion, i);
            let tau: Vec<f64> = (0..motion.samples()).map(|k| torque[(k, i)] + still[k] + added[k]).collect();
            // theta = twist(tau - d dtheta), by the implicit Euler method and bisection: another way than the law's.
            let damping = (inertia / slack).sqrt() / quality;
            let mut theta = vec![0.0; motion.samples()];
            for k in 0..2 * motion.samples() {
                let (now, before) = (k % motion.samples(), theta[(k + motion.samples() - 1) % motion.samples()]);
                let (mut low, mut high) = (-0.1, 0.1);
                for _ in 0..60 {
                    let middle = 0.5 * (low + high);
                    let behind = twist(tau[now] - damping * (middle - before) / motion.dt);
                    if middle > behind { high = middle } else { low = middle }
                }
                theta[now] = 0.5 * (low + high);
            }
            let (first, second) = differences(&theta, motion.dt);
            let mut there = motion.clone();
            for k in 0..motion.samples() {
                there.q[(k, i)] -= theta[k];
                there.dq[(k, i)] -= first[k];
                there.ddq[(k, i)] -= second[k];
            }
            let carried = load(&model, &there).column(i) + DVector::from_vec(friction(&operating_point, &there, i));
            // The second half: how it swings at the beginning is no longer seen there.
            let half = motion.samples() / 2..motion.samples();
            let wrong = half.clone().map(|k| (carried[k] - tau[k]).powi(2)).sum::<f64>().sqrt();
            let whole = half.map(|k| added[k].powi(2)).sum::<f64>().sqrt();
            assert!(wrong < 0.05 * whole, "{id}: {wrong} of {whole}");
        }
    }
}

#[test]
fn a_delay_is_the_slope_of_the_torque() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let model = rigid_model("panda", &mut rng);
    let operating_point = operating_point(&model);
    let motion = sampled_motion(&mut rng, 7, true, 40_000);
    let torque = load(&model, &motion);
    let spec = Spec { family: "delay", form: "", site: Site::Arm, settings: vec![] };
    let found = column_of(&operating_point, &spec, &motion, 0);
    for j in 0..7 {
        let friction = friction(&operating_point, &motion, j);
        let whole: Vec<f64> = torque.column(j).iter().zip(&friction).map(|(body, friction)| body + friction).collect();
        let (slope, _) = differences(&whole, motion.dt);
        let expected = -DVector::from_vec(slope);
        let (difference, scale) = ((found.column(j) - &expected).amax(), expected.amax());
        assert!(difference < 0.03 * scale, "joint {}: {difference:e} of {scale:e}", j + 1);
    }
}

/// A tilt turns gravity about its axis; upright the axes are the base's x and y.
#[test]
fn a_tilt_turns_gravity() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let up = plumbline_model::term::mounting::axes(&Mounting::UPRIGHT.gravity());
    assert!((up[0] - Vector3::x()).norm() < 1e-12 && (up[1] - Vector3::y()).norm() < 1e-12);
    let model = rigid_model("panda", &mut rng);
    for _ in 0..4 {
        let motion = sampled_motion(&mut rng, 7, false, 50);
        for (c, axis) in plumbline_model::term::mounting::axes(&motion.gravity).into_iter().enumerate() {
            assert!(axis.dot(&motion.gravity).abs() < 1e-12 && (axis.norm() - 1.0).abs() < 1e-12);
            let spec = Spec { family: "mounting", form: "", site: Site::Arm, settings: vec![] };
            let found = column_of(&operating_point(&model), &spec, &motion, c);
            let tilted = |angle: f64| {
                let turn = Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle);
                load(&model, &Motion { gravity: turn * motion.gravity, ..motion.clone() })
            };
            let a = 1e-5;
            let expected = (tilted(a) - tilted(-a)) / (2.0 * a);
            assert!((found - &expected).amax() < 1e-7 * expected.amax());
        }
    }
}

#[test]
fn a_shaking_base_is_a_gravity_that_changes() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let model = rigid_model("panda", &mut rng);
    let motion = sampled_motion(&mut rng, 7, false, 50);
    let spec = Spec { family: "base-motion", form: "", site: Site::Arm, settings: vec![3.7] };
    let a = [0.3, -0.2, 0.5, 0.1, -0.4, 0.2];
    let found = columns(&operating_point(&model), &spec, &motion) * DVector::from_row_slice(&a);
    let still = load(&model, &motion);
    for k in 0..motion.samples() {
        let (sin, cos) = (std::f64::consts::TAU * 3.7 * (motion.start + k as f64 * motion.dt)).sin_cos();
        let shake = Vector3::new(a[0] * cos + a[1] * sin, a[2] * cos + a[3] * sin, a[4] * cos + a[5] * sin);
        let shaken = load(&model, &Motion { gravity: motion.gravity + shake, ..motion.clone() });
        for j in 0..7 {
            let expected = shaken[(k, j)] - still[(k, j)];
            assert!((found[j * motion.samples() + k] - expected).abs() < 1e-10);
        }
    }
}

/// A body on the last link is a last link with more in it; held still it is a force at that link, which contact has, too.
#[test]
fn a_payload_is_a_heavier_last_link_and_at_rest_a_contact() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    for robot in ["panda", "scara"] {
        let model = rigid_model(robot, &mut rng);
        let (chain, operating_point) = (chain(robot), operating_point(&model));
        let n = chain.len();
        let mut motion = sampled_motion(&mut rng, n, false, 30);
        let spec = Spec { family: "payload", form: "", site: Site::Arm, settings: vec![] };
        let (body, delta) = (draw(&mut rng, 10, 1.0), draw(&mut rng, 10 * n, 1.0));
        let found = columns(&operating_point, &spec, &motion) * DVector::from_row_slice(&body);
        let mut heavier = delta.clone();
        heavier[10 * (n - 1)..].iter_mut().zip(&body).for_each(|(own, more)| *own += more);
        for k in 0..motion.samples() {
            let row = |matrix: &DMatrix<f64>| matrix.row(k).iter().copied().collect::<Vec<f64>>();
            let (q, dq, ddq) = (row(&motion.q), row(&motion.dq), row(&motion.ddq));
            let difference = torque(&chain, &heavier, &motion.gravity, &q, &dq, &ddq)
                - torque(&chain, &delta, &motion.gravity, &q, &dq, &ddq);
            for j in 0..n {
                assert!((found[j * motion.samples() + k] - difference[j]).abs() < 1e-10);
            }
        }

        motion.dq.fill(0.0);
        motion.ddq.fill(0.0);
        let (site, settings) = (Site::Joint(n - 1), vec![motion.start, motion.start + 3.0]);
        let touch = columns(&operating_point, &Spec { family: "contact", form: "", site, settings }, &motion);
        // The arm holds a mass of 1 kg at the frame's origin, and a first moment of 1 kg m beside it.
        let weight = -motion.gravity;
        let held = touch.columns(0, 3) * DVector::from_row_slice(weight.as_slice());
        let payload = columns(&operating_point, &spec, &motion);
        for k in 0..motion.samples() {
            let inside = k as f64 * motion.dt < 3.0 - 1e-9;
            let frame = chain
                .joints()
                .iter()
                .enumerate()
                .fold(Placement::identity(), |frame, (j, joint)| frame.then(&joint.placement(motion.q[(k, j)])));
            let moment = (frame.rotation * Vector3::x()).cross(&weight);
            for j in 0..n {
                let row = j * motion.samples() + k;
                let turned: f64 = (0..3).map(|axis| touch[(row, 3 + axis)] * moment[axis]).sum();
                let (mass, lever) = if inside { (payload[(row, 9)], payload[(row, 6)]) } else { (0.0, 0.0) };
                assert!((held[row] - mass).abs() < 1e-10 && (turned - lever).abs() < 1e-10, "{robot} {j} {k}");
            }
        }
    }
}
