//! Where the columns of a model's regressor come from, row by row.
//!
//! Row `j` of a sample holds the rigid-body columns of link `j` and the links beyond it, and the columns that joint `j` has of its own
//! (friction, offset, rotor). All the others are zero, and are never touched.

use super::super::ExciteError;
use super::adjoint::LinkRow;
use plumbline_core::MAX_JOINTS;
use plumbline_model::term::{friction, rigid_body, rotor_inertia, torque_offset};
use plumbline_model::{LINK_COLUMNS, Structure};

/// A column that a joint has in its own row alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Own {
    /// `dq`
    Viscous,
    /// `tanh(s dq)`
    Coulomb,
    /// 1
    Offset,
    /// `ddq`
    Rotor,
}

impl Own {
    /// The column's value, and its derivatives with respect to `dq` and `ddq`; `s` is the slope of the smoothed sign \[s/rad\].
    pub fn value(self, dq: f64, ddq: f64, s: f64) -> (f64, f64, f64) {
        match self {
            Own::Viscous => (dq, 1.0, 0.0),
            Own::Coulomb => {
                let sign = (s * dq).tanh();
                (sign, s * (1.0 - sign * sign), 0.0)
            }
            Own::Offset => (1.0, 0.0, 0.0),
            Own::Rotor => (ddq, 0.0, 1.0),
        }
    }
}

/// The columns of one row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowColumns {
    /// Rigid-body columns, ordered: link and standard parameter, both from 0.
    pub rigid: Vec<(usize, usize)>,
    /// The joint's own columns, which follow them.
    pub own: Vec<Own>,
    /// Column of the whole regressor for each of both.
    pub global: Vec<usize>,
}

/// All rows of a structure.
#[derive(Clone, Debug, PartialEq)]
pub struct Columns {
    /// One entry per joint.
    pub rows: Vec<RowColumns>,
    /// Columns of the whole regressor.
    pub count: usize,
    /// The rigid body's, which come first.
    pub rigid: usize,
}

impl Columns {
    /// Sorts a structure's columns into rows. Errors when it has a term whose gradient is not known here.
    pub fn of(structure: &Structure) -> Result<Columns, ExciteError> {
        let n = structure.chain().len();
        let mut rows = vec![RowColumns::default(); n];
        let mut rigid = 0;
        for (term, range) in structure.terms().iter().zip(structure.ranges()) {
            if term.id() == rigid_body::ID {
                rigid = range.len();
                for (global, &slot) in range.zip(structure.reduction().independent()) {
                    let (link, parameter) = (slot / LINK_COLUMNS, slot % LINK_COLUMNS);
                    for row in &mut rows[..=link] {
                        row.rigid.push((link, parameter));
                        row.global.push(global);
                    }
                }
                continue;
            }
            for global in range {
                let column = &structure.columns()[global];
                let own = match (term.id(), column.name.as_str()) {
                    (friction::ID, name) if name.starts_with("fv") => Own::Viscous,
                    (friction::ID, name) if name.starts_with("fc") => Own::Coulomb,
                    (torque_offset::ID, _) => Own::Offset,
                    (rotor_inertia::ID, _) => Own::Rotor,
                    (id, name) => return Err(ExciteError::Column { term: id.to_string(), name: name.to_string() }),
                };
                let row = &mut rows[column.joint - 1];
                row.own.push(own);
                row.global.push(global);
            }
        }
        Ok(Columns { rows, count: structure.columns().len(), rigid })
    }
}

/// Gradients with respect to every standard parameter's coefficient, link by link and joint by joint.
pub type LinkRows = [[LinkRow; MAX_JOINTS]; MAX_JOINTS];

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, Vector3};
    use plumbline_model::term::Motion;
    use plumbline_model::{Chain, Joint, JointKind, Placement, Reduction};

    #[test]
    fn every_column_is_in_the_rows_that_it_is_not_zero_in() {
        let joint = |alpha: f64| Joint { kind: JointKind::Revolute, a: 0.1, alpha, d: 0.2, theta: 0.0 };
        let chain = Chain::modified(vec![joint(0.0), joint(1.2), joint(-0.7)], Placement::identity());
        let reduction = Reduction::any_mounting(&chain);
        let ids = ["friction", "torque-offset", "rotor-inertia"];
        let structure = Structure::of(chain, reduction, &ids).unwrap();
        let columns = Columns::of(&structure).unwrap();
        assert_eq!((columns.count, columns.rigid), (structure.columns().len(), structure.reduction().len()));
        let samples = 20;
        let wave = |shift: f64| DMatrix::from_fn(samples, 3, |k, j| ((0.7 + j as f64) * k as f64 + shift).sin());
        let gravity = Vector3::new(2.0, 3.0, 5.0);
        let motion =
            Motion { dt: 0.1, q: wave(0.1), dq: wave(0.5), ddq: wave(1.1), gravity, periodic: false, start: 0.0 };
        let w = structure.regressor(&motion);
        for (j, row) in columns.rows.iter().enumerate() {
            for c in 0..columns.count {
                let used = w.rows(j * samples, samples).column(c).amax() > 0.0;
                assert_eq!(row.global.contains(&c), used, "row {j}, {}", structure.columns()[c].name);
            }
        }
    }
}
