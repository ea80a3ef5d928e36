//! Nonzero columns of each row of a model's regressor.
//!
//! Row `j` of a sample has the rigid-body columns of link `j` and the links beyond it, and the columns of joint `j` (friction, offset,
//! rotor). All others are zero and are skipped.

use super::super::ExciteError;
use super::adjoint::LinkRow;
use plumbline_core::MAX_JOINTS;
use plumbline_model::term::Entry;
use plumbline_model::{LINK_COLUMNS, Structure};

/// Column that is nonzero in one joint's row only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointColumn {
    /// `dq`
    Viscous,
    /// `tanh(s dq)`
    Coulomb,
    /// 1
    Offset,
    /// `ddq`
    Rotor,
}

impl JointColumn {
    /// The column's value, and its derivatives with respect to `dq` and `ddq`; `s` is the slope of the smoothed sign \[s/rad\].
    pub fn value(self, dq: f64, ddq: f64, s: f64) -> (f64, f64, f64) {
        match self {
            JointColumn::Viscous => (dq, 1.0, 0.0),
            JointColumn::Coulomb => {
                let sign = (s * dq).tanh();
                (sign, s * (1.0 - sign * sign), 0.0)
            }
            JointColumn::Offset => (1.0, 0.0, 0.0),
            JointColumn::Rotor => (ddq, 0.0, 1.0),
        }
    }
}

/// The columns of one row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RowColumns {
    /// Rigid-body columns, ordered: link and standard parameter, both from 0.
    pub rigid: Vec<(usize, usize)>,
    /// Columns of the joint, after the rigid-body columns.
    pub own: Vec<JointColumn>,
    /// Column index in the whole regressor of each rigid-body and joint column.
    pub global: Vec<usize>,
}

/// Nonzero columns of all rows of a structure.
#[derive(Clone, Debug, PartialEq)]
pub struct Columns {
    /// One entry per joint.
    pub rows: Vec<RowColumns>,
    /// Number of columns of the whole regressor.
    pub count: usize,
    /// Number of rigid-body columns, which come first.
    pub rigid: usize,
}

impl Columns {
    /// Nonzero columns of a structure.
    ///
    /// # Errors
    /// A term without a gradient here.
    pub fn of(structure: &Structure) -> Result<Columns, ExciteError> {
        let n = structure.chain().len();
        let mut rows = vec![RowColumns::default(); n];
        let mut rigid = 0;
        for (term, range) in structure.terms().iter().zip(structure.ranges()) {
            let entries = term.entries().unwrap_or_default();
            for (index, global) in range.enumerate() {
                let (joint, own) = match entries.get(index).copied() {
                    Some(Entry::Link { slot }) => {
                        let (link, parameter) = (slot / LINK_COLUMNS, slot % LINK_COLUMNS);
                        for row in &mut rows[..=link] {
                            row.rigid.push((link, parameter));
                            row.global.push(global);
                        }
                        rigid += 1;
                        continue;
                    }
                    Some(Entry::Velocity { joint }) => (joint, JointColumn::Viscous),
                    Some(Entry::SmoothSign { joint }) => (joint, JointColumn::Coulomb),
                    Some(Entry::Constant { joint }) => (joint, JointColumn::Offset),
                    Some(Entry::Acceleration { joint }) => (joint, JointColumn::Rotor),
                    None => {
                        let (term, name) = (term.id().to_string(), structure.columns()[global].name.clone());
                        return Err(ExciteError::Column { term, name });
                    }
                };
                rows[joint].own.push(own);
                rows[joint].global.push(global);
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
    fn columns_are_listed_in_the_rows_where_they_are_nonzero() {
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
