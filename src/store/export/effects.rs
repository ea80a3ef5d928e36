//! Effects in exported files, by what each declares: its part of the C function, and what a description of rigid bodies has of it.

use super::emit::{Program, Value, expression};
use plumbline_identify::consistency::Nearest;
use plumbline_model::term::Entry;
use plumbline_model::term::effect::{EffectError, Family, InBodies, InC, Inputs, OperatingPoint, Site, Spec};
use plumbline_model::term::friction::SHARPNESS;
use plumbline_model::{LinkParameters, TorqueModel, is_consistent};

/// Notes on effects of a model that URDF and MJCF lack, or have a part of.
pub(super) fn notes_of_bodies(model: &TorqueModel) -> Vec<String> {
    notes(model, |family, _| match family.rare.in_bodies {
        InBodies::LastLink => None,
        InBodies::CoulombFriction { note } => Some(note.to_string()),
        InBodies::Nothing => Some(format!("is left out: {}", family.physics)),
    })
}

/// Notes on effects of a model that the C function lacks, or has a part of.
pub(super) fn notes_of_c(model: &TorqueModel) -> Vec<String> {
    let mut notes = notes(model, |family, spec| match family.form(spec.form).map(|form| form.in_c) {
        Some(InC::Columns(_) | InC::BothRows { .. } | InC::Entries | InC::LastLink) => None,
        Some(InC::Part { note, .. }) => Some(note.to_string()),
        Some(InC::Refused(reason)) => Some(format!("is left out, because {reason}: {}", family.physics)),
        None => Some(format!("has no form `{}` and is left out", spec.form)),
    });
    let terms = model.structure().terms().iter();
    let unknown = terms.filter(|term| term.spec().is_none() && term.entries().is_none());
    notes.extend(unknown.map(|term| format!("term `{}` is left out: {}", term.id(), term.physics())));
    notes
}

/// One note per kind of effect, ordered by identity.
fn notes(model: &TorqueModel, what: impl Fn(&Family, &Spec) -> Option<String>) -> Vec<String> {
    let note = |spec: Spec| {
        let text = match spec.family() {
            Ok(family) => what(family, &spec)?,
            Err(error) => format!("is left out: {error}"),
        };
        Some(format!("effect `{}` {text}", spec.family))
    };
    let mut notes: Vec<String> =
        model.structure().terms().iter().filter_map(|term| term.spec()).filter_map(note).collect();
    notes.sort();
    notes.dedup();
    notes
}

/// What descriptions of rigid bodies have of an effect.
fn in_bodies(spec: &Spec) -> Result<InBodies, EffectError> {
    Ok(spec.family()?.rare.in_bodies)
}

/// Coulomb friction of a joint that effects are in sliding: what a format without memory has of them \[Nm\].
pub(super) fn sliding_friction(model: &TorqueModel, joint: usize) -> f64 {
    let slides = |spec: &Spec| {
        spec.site == Site::Joint(joint) && matches!(in_bodies(spec), Ok(InBodies::CoulombFriction { .. }))
    };
    let own = model.terms().into_iter().filter(|(term, _)| term.spec().is_some_and(|spec| slides(&spec)));
    own.flat_map(|(_, parameters)| parameters).map(|parameter| parameter.value).sum()
}

/// Bodies with the model's payload in the last one. The error is that link's parameters where they are no body's.
pub fn with_payload(model: &TorqueModel, bodies: &Nearest) -> Result<Nearest, LinkParameters> {
    let mut bodies = bodies.clone();
    let payload = model.on_last_link();
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

/// Column `c` of an effect as values of the program, each with its row; `load` has the rigid-body torques. Empty for an effect that [`notes_of_c`] names, and
/// for one that is part of the rigid bodies.
pub(super) fn column(
    program: &mut Program,
    spec: &Spec,
    c: usize,
    load: &[Value],
    operating_point: &OperatingPoint,
) -> Vec<(usize, Value)> {
    let (columns, share) = match spec.form().map(|form| form.in_c) {
        Some(InC::Columns(columns) | InC::Part { columns, .. }) => (columns, None),
        Some(InC::BothRows { columns, share }) => (columns, Some(share(&spec.settings))),
        Some(InC::Entries | InC::LastLink | InC::Refused(_)) | None => return Vec::new(),
    };
    let [row, cause, other] = joints(spec.site);
    let [fv, fc] = operating_point.friction.get(cause).copied().unwrap_or_default();
    let ia = operating_point.rotor_inertias.get(cause).copied().unwrap_or_default();
    let inputs = Inputs {
        q: format!("q[{row}]"),
        dq: format!("dq[{row}]"),
        sign: expression(&sign(program, row)),
        cause_q: format!("q[{cause}]"),
        cause_dq: format!("dq[{cause}]"),
        cause_ddq: format!("ddq[{cause}]"),
        cause_sign: expression(&sign(program, cause)),
        other_q: format!("q[{other}]"),
        other_dq: format!("dq[{other}]"),
        other_sign: expression(&sign(program, other)),
        load: load.get(cause).map_or(String::new(), expression),
        cause_drive: format!(
            "({fv:?})*dq[{cause}] + ({fc:?})*{} + ({ia:?})*ddq[{cause}]",
            expression(&sign(program, cause))
        ),
    };
    let Some(text) = columns(&inputs, &spec.settings).into_iter().nth(c) else { return Vec::new() };
    let name = program.fresh("e");
    let value = program.named(name, text);
    let of_cause = share.map(|share| (cause, program.sum(&[(Value::Known(share), value.clone())])));
    [(row, value)].into_iter().chain(of_cause).collect()
}

/// Column of a term of the whole arm as a value of the program, and its row; `None` for a link's, which the recursion computes.
pub(super) fn entry(program: &mut Program, entry: Entry) -> Option<(usize, Value)> {
    match entry {
        Entry::Link { .. } => None,
        Entry::Velocity { joint } => Some((joint, Value::input(format!("dq[{joint}]")))),
        Entry::SmoothSign { joint } => Some((joint, sign(program, joint))),
        Entry::Acceleration { joint } => Some((joint, Value::input(format!("ddq[{joint}]")))),
        Entry::Constant { joint } => Some((joint, Value::Known(1.0))),
    }
}

/// `tanh(100 dq)` of a joint.
fn sign(program: &mut Program, joint: usize) -> Value {
    program.named(format!("s{joint}"), format!("tanh({SHARPNESS:?}*dq[{joint}])"))
}

/// Row, cause and second cause.
fn joints(site: Site) -> [usize; 3] {
    match site {
        Site::Function { row, of: [cause, other] } => [row, cause, other],
        Site::Pair { row, cause } => [row, cause, cause],
        Site::Joint(joint) => [joint; 3],
        Site::Arm => [0; 3],
    }
}
