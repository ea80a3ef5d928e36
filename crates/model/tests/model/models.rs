//! Models with effects, and the motions that they are evaluated along.

use assert_no_alloc::{assert_no_alloc, violation_count};
use nalgebra::DMatrix;
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{Family, Form, OperatingPoint, Site, Spec, assemble};
use plumbline_model::{Mounting, NamedEffect, NamedTerm, Reduction, Structure, TorqueModel};
use plumbline_testkit::arms::{any_mounting, chain, draw, random_base};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Sines with their derivatives, one period of 4 s.
pub fn smooth_motion(rng: &mut ChaCha8Rng, n: usize, periodic: bool, samples: usize) -> Motion {
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

pub fn rigid_model(robot: &str, rng: &mut ChaCha8Rng) -> TorqueModel {
    model_within(robot, rng, 1.0)
}

/// With parameters within `span` of zero.
pub fn model_within(robot: &str, rng: &mut ChaCha8Rng, span: f64) -> TorqueModel {
    let chain = chain(robot);
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &["friction"]).unwrap();
    let values: Vec<_> =
        draw(rng, structure.columns().len(), span).into_iter().map(|value| (value, Some(0.1))).collect();
    TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap()
}

/// Of rigid bodies that may be.
pub fn physical_model(robot: &str, rng: &mut ChaCha8Rng) -> TorqueModel {
    let model = rigid_model(robot, rng);
    let structure = model.structure();
    let bodies = random_base(structure.reduction(), structure.chain().len(), rng);
    let friction = model.beta().split_off(bodies.len()).into_iter().map(f64::abs);
    let values: Vec<_> = bodies.iter().copied().chain(friction).map(|value| (value, Some(0.1))).collect();
    TorqueModel::new(robot, structure.clone(), vec![Mounting::WALL], &values).unwrap()
}

pub fn operating_point(model: &TorqueModel) -> OperatingPoint {
    model.structure().operating_point(&model.beta())
}

/// Every form of a family at a random site with random settings.
pub fn specs(family: &'static Family, n: usize, rng: &mut ChaCha8Rng) -> Vec<Spec> {
    // What the others get does not depend on how many forms this one has.
    let mut rng = ChaCha8Rng::from_rng(rng);
    let mut spec = |form: &'static Form| Spec {
        family: family.id,
        form: form.name,
        site: {
            let sites = family.sites(form, n);
            sites[rng.random_range(0..sites.len())]
        },
        settings: match family.id {
            // A window inside the motion.
            "contact" => vec![12.5, 15.5],
            // A domain that the motion leaves and comes back to.
            "empirical" => {
                form.settings.iter().map(|one| if one.name.starts_with("middle") { 0.1 } else { 0.7 }).collect()
            }
            _ => form.settings.iter().map(|one| one.at(rng.random_range(shares(one.name)))).collect(),
        },
    };
    family.forms.iter().map(&mut spec).collect()
}

/// Values of a setting, as shares of its range. Hardly damped in a hard gap, or with less inertia than its rotor has, a link swings chaotically: rounding
/// shows after a second.
fn shares(setting: &str) -> std::ops::Range<f64> {
    match setting {
        "width" => 0.5..1.0,
        "quality" => 0.0..0.2,
        "rotor" => 0.0..0.3,
        _ => 0.0..1.0,
    }
}

/// An effect of the family's form.
pub fn effect(family: &'static str, form: &'static str, site: Site, settings: &[f64]) -> Spec {
    Spec { family, form, site, settings: settings.to_vec() }
}

/// The model with effects, whose parameters are `0.3, 0.4, ..`.
pub fn with(model: &TorqueModel, specs: &[Spec]) -> TorqueModel {
    let structure = model.structure().clone().with(assemble(specs, &operating_point(model)).unwrap()).unwrap();
    let mut values: Vec<(f64, Option<f64>)> = model.parameters().iter().map(|p| (p.value, p.std)).collect();
    let added = structure.columns().len() - values.len();
    values.extend((0..added).map(|c| (0.3 + 0.1 * c as f64, Some(0.1))));
    TorqueModel::new(model.robot(), structure, vec![Mounting::WALL], &values).unwrap()
}

/// The regressor of an effect alone, n N x columns.
pub fn columns(operating_point: &OperatingPoint, spec: &Spec, motion: &Motion) -> DMatrix<f64> {
    let term = spec.build(operating_point).unwrap();
    let mut y = DMatrix::zeros(motion.joints() * motion.samples(), term.columns().len());
    term.fill(&operating_point.chain, motion, &mut y, 0);
    y
}

/// The model as a file holds it, the parameters of each term in reverse order.
pub fn named(model: &TorqueModel) -> Vec<NamedTerm> {
    let effect_of = |spec: Spec| {
        let form = spec.family().unwrap().form(spec.form).unwrap();
        let joints: Vec<usize> = spec.site.joints().iter().map(|joint| joint + 1).collect();
        let settings = form.settings.iter().zip(&spec.settings);
        NamedEffect {
            form: spec.form.to_string(),
            joint: joints.first().copied(),
            cause: joints.get(1).copied(),
            other: joints.get(2).copied(),
            settings: settings.map(|(setting, value)| (setting.name.to_string(), *value)).collect(),
        }
    };
    let terms = model.terms().into_iter().map(|(term, parameters)| NamedTerm {
        id: term.id().to_string(),
        effect: term.spec().map_or(NamedEffect::default(), effect_of),
        parameters: parameters.iter().rev().map(|p| (p.column.name.clone(), p.value, p.std)).collect(),
    });
    terms.collect()
}

/// Asserts that `run` neither allocates nor frees, after a check that an allocation is counted.
#[track_caller]
pub fn assert_no_allocation(run: impl FnOnce()) {
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1.0))));
    let counted = violation_count();
    assert!(counted > 0, "allocations are not counted");
    assert_no_alloc(run);
    assert_eq!(violation_count(), counted);
}
