//! Effects in exported files: what a format has a place for, and the laws of those in one row as C.

use super::emit::{Program, Value, expression};
use plumbline_identify::consistency::Nearest;
use plumbline_model::term::effect::{Site, Spec, family};
use plumbline_model::term::friction::SHARPNESS;
use plumbline_model::term::{Term, payload, presliding};
use plumbline_model::{LINK_COLUMNS, LinkParameters, TorqueModel, is_consistent};
use std::collections::BTreeSet;

/// Effects of a model that URDF and MJCF have no place for: all but a payload, which is part of the last link.
pub fn unheld_by_bodies(model: &TorqueModel) -> Vec<&'static str> {
    unheld(model, |spec| spec.family == payload::ID)
}

/// Effects of a model that the C function can't compute: what needs the samples before, or the rigid body in another motion.
pub fn unheld_by_c(model: &TorqueModel) -> Vec<&'static str> {
    unheld(model, |spec| spec.family == payload::ID || law(spec, 0, &Names::default()).is_some())
}

/// Coulomb friction that a joint's presliding becomes once the joint slides: what a format without memory holds of it \[Nm\].
pub(super) fn sliding_friction(model: &TorqueModel, joint: usize) -> f64 {
    let of_joint = |term: &dyn Term| term.spec().is_some_and(|spec| spec.site == Site::Joint(joint));
    let own = model.terms().into_iter().filter(|(term, _)| term.id() == presliding::ID && of_joint(*term));
    own.flat_map(|(_, parameters)| parameters).map(|parameter| parameter.value).sum()
}

/// Notes on effects that are left out, or held in part.
pub(super) fn notes(ids: &[&'static str]) -> Vec<String> {
    let note = |id: &&'static str| {
        if *id == presliding::ID {
            return "effect `presliding` is held as the Coulomb friction that it is in sliding; its memory, which tells where a joint that turns \
                    back was, is left out"
                .to_string();
        }
        let physics = family(id).map_or("", |family| family.physics);
        format!("effect `{id}` is left out: {physics}")
    };
    ids.iter().map(note).collect()
}

fn unheld(model: &TorqueModel, holds: impl Fn(&Spec) -> bool) -> Vec<&'static str> {
    let specs = model.structure().terms().iter().filter_map(|term| term.spec());
    let ids: BTreeSet<&'static str> = specs.filter(|spec| !holds(spec)).map(|spec| spec.family).collect();
    ids.into_iter().collect()
}

/// Parameters of a model's payload, about the last link's frame; zero where it has none.
pub fn payload_of(model: &TorqueModel) -> LinkParameters {
    let mut sum = [0.0; LINK_COLUMNS];
    for (term, parameters) in model.terms() {
        if term.id() == payload::ID {
            for (c, parameter) in parameters.iter().enumerate() {
                sum[term.original(c)] += parameter.value;
            }
        }
    }
    sum
}

/// Bodies with the model's payload in the last one. The error is that link's parameters where they are no body's.
pub fn with_payload(model: &TorqueModel, bodies: &Nearest) -> Result<Nearest, LinkParameters> {
    let mut bodies = bodies.clone();
    let payload = payload_of(model);
    if payload == LinkParameters::default() {
        return Ok(bodies);
    }
    if let Some(last) = bodies.links.last_mut() {
        last.iter_mut().zip(payload).for_each(|(own, more)| *own += more);
        if !is_consistent(last) {
            return Err(*last);
        }
    }
    Ok(bodies)
}

/// Column `c` of an effect in one row as a value of the program, and that row; `load` holds the rigid-body torques. `None` for an
/// effect without such a law. Presliding is that of a joint that slides.
pub(super) fn column(program: &mut Program, spec: &Spec, c: usize, load: &[Value]) -> Option<(usize, Value)> {
    let (row, cause) = joints(spec.site);
    let sign = |joint: usize| format!("tanh({SHARPNESS:?}*dq[{joint}])");
    let names = Names {
        sign: expression(&program.named(format!("s{row}"), sign(row))),
        other_sign: expression(&program.named(format!("s{cause}"), sign(cause))),
        load: load.get(cause).map_or(String::new(), expression),
    };
    let sliding = || (spec.family == presliding::ID).then(|| names.sign.clone());
    let text = law(spec, c, &names).or_else(sliding)?;
    let name = program.fresh("e");
    Some((row, program.named(name, text)))
}

/// What a law refers to.
#[derive(Default)]
struct Names {
    /// `tanh(100 dq)` of the row's joint.
    sign: String,
    /// That of the joint that it comes from.
    other_sign: String,
    /// Rigid-body torque of the joint that it comes from.
    load: String,
}

/// Row and cause.
fn joints(site: Site) -> (usize, usize) {
    match site {
        Site::Pair { row, cause } => (row, cause),
        Site::Joint(joint) => (joint, joint),
        Site::Arm => (0, 0),
    }
}

/// Column `c` as a C expression. The second route to the laws in [`plumbline_model::term`]; the test of the C function compares the two.
fn law(spec: &Spec, c: usize, names: &Names) -> Option<String> {
    let (row, cause) = joints(spec.site);
    let (q, dq, other) = (format!("q[{row}]"), format!("dq[{row}]"), format!("dq[{cause}]"));
    let Names { sign, other_sign, load } = names;
    let a = spec.settings.first().copied().unwrap_or_default();
    let wave = ["sin", "cos"].get(c).copied().unwrap_or("cos");
    Some(match (spec.family, spec.form, c) {
        ("asymmetric-coulomb", "", 0) => format!("fabs({sign})"),
        ("asymmetric-viscous", "", 0) => format!("fabs({dq})"),
        ("stribeck", "gaussian", 0) => format!("exp(-({dq}/{a:?})*({dq}/{a:?}))*{sign}"),
        ("stribeck", "exponential", 0) => format!("exp(-fabs({dq})/{a:?})*{sign}"),
        ("nonlinear-viscous", "sigmoid", 0) => format!("tanh({dq}/{a:?})"),
        ("nonlinear-viscous", "cubic", 0) => format!("{dq}*{dq}*{dq}"),
        ("nonlinear-viscous", "quadratic", 0) => format!("{dq}*fabs({dq})"),
        ("load-dependent-friction", "coulomb", 0) => format!("fabs({load})*{sign}"),
        ("load-dependent-friction", "viscous", 0) => format!("fabs({load})*{dq}"),
        ("position-dependent-friction", "", 0 | 1) => format!("{wave}({a:?}*{q})*{sign}"),
        ("position-ripple", "", 0 | 1) => format!("{wave}({a:?}*{q})"),
        ("spring", "linear" | "cubic", 0) => q,
        ("spring", "linear" | "cubic", 1) => "1.0".to_string(),
        ("spring", "cubic", 2) => format!("{q}*{q}*{q}"),
        ("spring", "above", 0) => format!("fmax(0.0, {q} - ({a:?}))"),
        ("spring", "below", 0) => format!("fmax(0.0, ({a:?}) - {q})"),
        ("torque-gain" | "torque-crosstalk", "", 0) => load.clone(),
        ("friction-change", "", 0) => dq,
        ("friction-change", "", 1) => sign.clone(),
        ("transmission-coupling", "friction", 0) => other_sign.clone(),
        ("transmission-coupling", "friction", 1) => other,
        ("transmission-coupling", "sum", 0) => format!("tanh({SHARPNESS:?}*({dq} + ({a:?})*{other}))"),
        ("transmission-coupling", "inertia", 0) => format!("ddq[{cause}]"),
        _ => return None,
    })
}
