//! The stored model with what was found to have changed.

use super::Change;
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::effect::{Family, InBodies, assemble};
use plumbline_model::term::{mounting, payload};
use plumbline_model::{LINK_COLUMNS, ModelError, Parameter, TorqueModel};

/// The model with the changes: a payload becomes part of the rigid bodies (`beta + regroup delta`), a change of friction or of an offset
/// goes into the parameter that the model has for it, everything else is one more term. A tilt is a term, too: the mounting that
/// people declare stays the one that the tilt is reckoned from. A second tilt is added to the first. No other parameter moves.
///
/// # Errors
/// An effect that can't be built, or whose columns the model has already at other settings.
pub fn extended(reference: &TorqueModel, changes: &[Change]) -> Result<TorqueModel, ModelError> {
    let mut parameters = reference.parameters().to_vec();
    let mut rest: Vec<&Change> = Vec::new();
    for change in changes {
        let family = change.spec.family()?;
        if family.rare.in_bodies == InBodies::LastLink {
            carry(reference, change, &mut parameters);
        } else if !joined(change, family, &mut parameters) {
            rest.push(change);
        }
    }
    let beta: Vec<f64> = parameters.iter().map(|parameter| parameter.value).collect();
    let specs: Vec<_> = rest.iter().map(|change| change.spec.clone()).collect();
    let terms = assemble(&specs, &reference.structure().operating_point(&beta))?;
    let structure = reference.structure().clone().with(terms)?;
    // Terms are put together in an order of their own: values find their columns by name.
    let added: Vec<&Parameter> = rest.iter().flat_map(|change| &change.parameters).collect();
    let mut values: Vec<(f64, Option<f64>)> = parameters.iter().map(|own| (own.value, own.std)).collect();
    for column in &structure.columns()[parameters.len()..] {
        let own = added.iter().find(|own| own.column.name == column.name);
        let own = own.ok_or_else(|| ModelError::MissingColumn { name: column.name.clone() })?;
        values.push((own.value, own.std));
    }
    TorqueModel::new(reference.robot(), structure, reference.mountings().to_vec(), &values)
}

/// Adds a body on the last link to the base parameters.
fn carry(reference: &TorqueModel, change: &Change, parameters: &mut [Parameter]) {
    let regroup = reference.structure().reduction().regroup();
    let first = regroup.ncols() - LINK_COLUMNS;
    let slots = change.parameters.iter().filter_map(|own| payload::slot(&own.column.name)).map(|slot| first + slot);
    let own = regroup.select_columns(&slots.collect::<Vec<_>>());
    let delta = DVector::from_iterator(own.ncols(), change.parameters.iter().map(|own| own.value));
    let moved = &own * delta;
    let spread: DMatrix<f64> = &own * &change.covariance * own.transpose();
    for (k, parameter) in parameters.iter_mut().take(regroup.nrows()).enumerate() {
        parameter.value += moved[k];
        parameter.std = parameter.std.map(|std| std.hypot(spread[(k, k)].max(0.0).sqrt()));
    }
}

/// Adds to parameters that the model has for the same thing; false when it lacks one of them.
fn joined(change: &Change, family: &Family, parameters: &mut [Parameter]) -> bool {
    // The same name at other settings is another thing; but a tilt on top of a tilt.
    if !change.spec.settings.is_empty() && change.spec.family != mounting::FAMILY.id {
        return false;
    }
    let name = family.rare.changed_parameter;
    let place = |own: &Parameter| parameters.iter().position(|other| other.column.name == name(&own.column.name));
    let Some(places) = change.parameters.iter().map(place).collect::<Option<Vec<usize>>>() else { return false };
    for (place, own) in places.into_iter().zip(&change.parameters) {
        let parameter = &mut parameters[place];
        parameter.value += own.value;
        parameter.std = parameter.std.zip(own.std).map(|(old, new)| old.hypot(new));
    }
    true
}
