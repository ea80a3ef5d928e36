//! The structure of a torque model: its terms, and the columns of its regressor.

use super::base::{BaseKind, INDEPENDENCE, Reduction, project_out};
use super::chain::Chain;
use super::expression::six_digits;
use super::fast::closed::ClosedForm;
use super::gravity::Mounting;
use super::term::effect::{EffectError, FAMILIES, OperatingPoint};
use super::term::load::Load;
use super::term::{self, Column, Motion, Term, rigid_body, rotor_inertia, subset::Subset};
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt;
use std::sync::Arc;

/// Why a model can't be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// An unknown term.
    #[error("there is no term `{id}` (known: {})", known_terms())]
    UnknownTerm {
        /// Requested identity.
        id: String,
    },
    /// Two columns with one name.
    #[error("the model has two columns `{name}`")]
    DuplicateColumn {
        /// Their name.
        name: String,
    },
    /// A parameter that the term does not have, or that the rest of the model absorbs.
    #[error("term `{term}` of this arm has no column `{name}` of its own")]
    UnknownColumn {
        /// The term.
        term: String,
        /// Requested column.
        name: String,
    },
    /// A base parameter of the arm is missing.
    #[error("base parameter `{name}` is missing")]
    MissingColumn {
        /// Its name.
        name: String,
    },
    /// Form, site or settings that the effect does not have.
    #[error("term `{term}` has {what}")]
    Effect {
        /// The term.
        term: String,
        /// What is wrong.
        what: String,
    },
    /// An effect that can't be built.
    #[error(transparent)]
    Build(#[from] EffectError),
    /// Not as many values as columns.
    #[error("{found} values for {expected} columns")]
    Count {
        /// Values given.
        found: usize,
        /// Columns of the structure.
        expected: usize,
    },
    /// A value that is not finite.
    #[error("`{name}` is {value}")]
    NotFinite {
        /// Name of the column.
        name: String,
        /// The value given.
        value: f64,
    },
    /// The arm's reduction is of the other kind.
    #[error("this arm has no {expected:?} that differs from its {found:?}")]
    Kind {
        /// Requested kind.
        expected: BaseKind,
        /// Kind of the arm's reduction.
        found: BaseKind,
    },
}

/// Identities of every term that a model can have.
fn known_terms() -> String {
    let effects = FAMILIES.iter().map(|family| family.id).filter(|id| !term::KNOWN.contains(id));
    term::KNOWN.into_iter().chain(effects).collect::<Vec<_>>().join(", ")
}

/// A column that is a linear combination of earlier columns, and therefore not identifiable.
#[derive(Clone, Debug, PartialEq)]
pub struct Absorbed {
    /// The column.
    pub column: Column,
    /// Its coefficients on the columns that absorb it, by name.
    pub into: Vec<(String, f64)>,
}

/// Samples of a probing motion.
const PROBES: usize = 120;

/// Chain, base reduction and terms: a model without parameter values. Cheap to clone.
#[derive(Clone)]
pub struct Structure {
    chain: Chain,
    reduction: Reduction,
    terms: Vec<Arc<dyn Term>>,
    absorbed: Vec<Absorbed>,
    columns: Vec<Column>,
}

impl Structure {
    /// The rigid body of a reduction, then `terms` in their order.
    pub fn new(chain: Chain, reduction: Reduction, terms: Vec<Arc<dyn Term>>) -> Result<Structure, ModelError> {
        let mut all: Vec<Arc<dyn Term>> = vec![Arc::new(rigid_body::RigidBody::new(&reduction))];
        all.extend(terms);
        let columns: Vec<Column> = all.iter().flat_map(|term| term.columns()).collect();
        for (index, column) in columns.iter().enumerate() {
            if columns[..index].iter().any(|before| before.name == column.name) {
                return Err(ModelError::DuplicateColumn { name: column.name.clone() });
            }
        }
        Ok(Structure { chain, reduction, terms: all, absorbed: Vec::new(), columns })
    }

    /// The rigid body, then the named terms (`friction`, `torque-offset`, ..), without the columns that others absorb.
    ///
    /// ```
    /// # use plumbline_model::{Chain, Joint, JointKind, Placement, Reduction, Structure};
    /// let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
    /// let chain = Chain::modified(vec![joint], Placement::identity());
    /// let reduction = Reduction::any_mounting(&chain);
    /// let structure = Structure::of(chain, reduction, &["friction"]).unwrap();
    /// let names: Vec<&str> = structure.columns().iter().map(|column| column.name.as_str()).collect();
    /// assert_eq!(names, ["Lzz1", "lx1", "ly1", "fv1", "fc1"]);
    /// ```
    pub fn of(chain: Chain, reduction: Reduction, ids: &[&str]) -> Result<Structure, ModelError> {
        let mut terms = Vec::new();
        for id in ids.iter().filter(|id| **id != rigid_body::ID) {
            let term = term::by_id(id, &chain, &reduction);
            terms.push(term.ok_or_else(|| ModelError::UnknownTerm { id: id.to_string() })?);
        }
        Ok(Structure::new(chain, reduction, terms)?.identifiable())
    }

    /// Without the columns, rigid body apart, that are linear combinations of the columns before them on every motion.
    ///
    /// For example the rotor inertias of joints 1 and 2 of most arms, which are part of `Lzz1` and `Lzz2`. [`Structure::absorbed`]
    /// lists the removed columns; the expressions of the columns that absorb them name them. Data from one mounting or from a poor
    /// motion may determine fewer parameters.
    #[expect(clippy::expect_used, reason = "runs when a model is made, before the loop")]
    pub fn identifiable(mut self) -> Structure {
        let rigid = self.reduction.len();
        if self.columns.len() == rigid {
            return self;
        }
        let w = self.probe();
        let mut basis: Vec<DVector<f64>> = Vec::new();
        let mut kept = Vec::new();
        for c in 0..self.columns.len() {
            let norm = w.column(c).norm();
            let rest = project_out(&basis, w.column(c).into_owned());
            if c < rigid || rest.norm() > INDEPENDENCE * norm {
                basis.push(rest.normalize());
                kept.push(c);
            }
        }
        if kept.len() == self.columns.len() {
            return self;
        }
        let qr = DMatrix::from_columns(&kept.iter().map(|&c| w.column(c)).collect::<Vec<_>>()).qr();
        for c in (0..self.columns.len()).filter(|c| !kept.contains(c)) {
            let projection = qr.q().transpose() * w.column(c);
            let coefficients = qr.r().solve_upper_triangular(&projection).expect("the kept columns are independent");
            let into = kept.iter().zip(coefficients.iter()).filter(|(_, value)| value.abs() > 1e-6);
            self.absorbed.push(Absorbed {
                column: self.columns[c].clone(),
                into: into.map(|(&by, &value)| (self.columns[by].name.clone(), (value * 1e9).round() / 1e9)).collect(),
            });
        }
        let gone = |column: &Column| self.absorbed.iter().any(|absorbed| absorbed.column.name == column.name);
        self.terms = self.terms.iter().filter_map(|term| Subset::of(term.clone(), |column| !gone(column))).collect();
        self.columns = kept.into_iter().map(|c| self.columns[c].clone()).collect();
        for absorbed in &self.absorbed {
            for (name, coefficient) in &absorbed.into {
                let column =
                    self.columns.iter_mut().find(|column| column.name == *name).expect("absorbed by a kept column");
                let sign = if *coefficient < 0.0 { '-' } else { '+' };
                let factor = match coefficient.abs() {
                    1.0 => String::new(),
                    other => format!("{} ", six_digits(other)),
                };
                column.expression.push_str(&format!(" {sign} {factor}{}", absorbed.column.name));
            }
        }
        self
    }

    /// With more terms after the others. None of their columns is removed: the caller has tested that the data can identify them.
    ///
    /// # Errors
    /// Two columns of one name.
    pub fn with(mut self, terms: Vec<Arc<dyn Term>>) -> Result<Structure, ModelError> {
        for column in terms.iter().flat_map(|term| term.columns()) {
            if self.columns.iter().any(|before| before.name == column.name) {
                return Err(ModelError::DuplicateColumn { name: column.name });
            }
            self.columns.push(column);
        }
        self.terms.extend(terms);
        Ok(self)
    }

    /// The operating point of the effects at these parameters, the rigid body's first.
    pub fn operating_point(&self, beta: &[f64]) -> OperatingPoint {
        let load = Load::new(&self.chain, &self.reduction, &beta[..self.reduction.len()]);
        let of = |name: String| {
            let at = self.columns.iter().position(|column| column.name == name)?;
            beta.get(at).copied()
        };
        let joint = |j: usize| [of(format!("fv{j}")), of(format!("fc{j}"))];
        let known: Vec<[Option<f64>; 2]> = (1..=self.chain.len()).map(joint).collect();
        let any = known.iter().flatten().any(Option::is_some);
        let friction = known.iter().filter(|_| any).map(|joint| joint.map(Option::unwrap_or_default)).collect();
        // Where torques contain the rotors, one without a column of its own has been absorbed.
        let rotor = |term: &&Arc<dyn Term>| term.id() == rotor_inertia::ID;
        let own: Option<Vec<Column>> = self.terms.iter().find(rotor).map(|term| term.columns());
        let absorbed = |joint: usize| own.as_ref().is_some_and(|own| own.iter().all(|column| column.joint != joint));
        let rotors = (1..=self.chain.len()).map(absorbed).collect();
        let rotor_inertias = own.map_or_else(Vec::new, |_| {
            (1..=self.chain.len()).map(|j| of(format!("ia{j}")).unwrap_or_default()).collect()
        });
        OperatingPoint { chain: self.chain.clone(), load: Arc::new(load), friction, rotor_inertias, rotors }
    }

    /// Without the columns that `keep` rejects, except those of the rigid body. Their parameters are zero.
    pub fn restricted(mut self, keep: impl Fn(&Column) -> bool) -> Structure {
        let rigid: Vec<String> =
            self.columns[..self.reduction.len()].iter().map(|column| column.name.clone()).collect();
        let keep = |column: &Column| rigid.contains(&column.name) || keep(column);
        self.terms = self.terms.iter().filter_map(|term| Subset::of(term.clone(), keep)).collect();
        self.columns.retain(keep);
        self
    }

    /// The arm.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The base reduction of its rigid body.
    pub fn reduction(&self) -> &Reduction {
        &self.reduction
    }

    /// GBS or VBS.
    pub fn kind(&self) -> BaseKind {
        self.reduction.kind()
    }

    /// Its terms, the rigid body first.
    pub fn terms(&self) -> &[Arc<dyn Term>] {
        &self.terms
    }

    /// Columns taken out by [`Structure::identifiable`].
    pub fn absorbed(&self) -> &[Absorbed] {
        &self.absorbed
    }

    /// Its columns, term by term; the first `reduction().len()` are the rigid body's.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// Range of columns of each term.
    pub fn ranges(&self) -> Vec<std::ops::Range<usize>> {
        let mut first = 0;
        let range = |term: &Arc<dyn Term>| {
            let range = first..first + term.columns().len();
            first = range.end;
            range
        };
        self.terms.iter().map(range).collect()
    }

    /// The regressor `W` of a motion, n N rows (joint `j` from 0, sample `k`: row `j N + k`), one column per parameter:
    /// `tau = W beta`. Panics when the motion has another number of joints than the arm.
    pub fn regressor(&self, motion: &Motion) -> DMatrix<f64> {
        self.regressor_from(0, motion)
    }

    /// The columns of [`Structure::regressor`] that the terms from `first` on have.
    pub fn regressor_from(&self, first: usize, motion: &Motion) -> DMatrix<f64> {
        assert_eq!(motion.joints(), self.chain.len(), "joints of the motion and of the arm");
        let before: usize = self.terms[..first].iter().map(|term| term.columns().len()).sum();
        let mut y = DMatrix::zeros(motion.joints() * motion.samples(), self.columns.len() - before);
        for (term, range) in self.terms.iter().zip(self.ranges()).skip(first) {
            term.fill(&self.chain, motion, &mut y, range.start - before);
        }
        y
    }

    /// `W beta` along a motion, N x n \[Nm\]. Terms with a closed form are evaluated by it, sample after sample: without a column of `W`.
    pub fn torques(&self, beta: &[f64], motion: &Motion) -> DMatrix<f64> {
        let (samples, n) = (motion.samples(), motion.joints());
        let mut closed = ClosedForm::default();
        let mut tau = DMatrix::zeros(samples, n);
        for (term, range) in self.terms.iter().zip(self.ranges()) {
            let beta = &beta[range];
            if term.fix(&self.chain, &motion.gravity, beta).join(&mut closed) {
                continue;
            }
            let mut y = DMatrix::zeros(n * samples, beta.len());
            term.fill(&self.chain, motion, &mut y, 0);
            let own = y * DVector::from_column_slice(beta);
            tau.as_mut_slice().iter_mut().zip(own.as_slice()).for_each(|(tau, own)| *tau += own);
        }
        for k in 0..samples {
            let own = closed.torque(&motion.sample(k));
            (0..n).for_each(|j| tau[(k, j)] += own[j]);
        }
        tau
    }

    /// Stacked regressor of random smooth motions, in mountings that excite every parameter of this kind of set.
    fn probe(&self) -> DMatrix<f64> {
        let mountings: &[Mounting] = match self.kind() {
            BaseKind::Gbs => &[Mounting::WALL, Mounting { rho: 2.2, phi: 0.7 }],
            BaseKind::Vbs => &[Mounting::UPRIGHT],
        };
        let mut rng = ChaCha8Rng::seed_from_u64(0x7374_7275_6374);
        let mut stacked = DMatrix::zeros(0, self.columns.len());
        for mounting in mountings {
            let part = self.regressor(&probing_motion(&mut rng, self.chain.len(), mounting));
            let first = stacked.nrows();
            stacked = stacked.resize_vertically(first + part.nrows(), 0.0);
            stacked.rows_mut(first, part.nrows()).copy_from(&part);
        }
        stacked
    }
}

impl fmt::Debug for Structure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ids: Vec<_> = self.terms.iter().map(|term| term.id()).collect();
        f.debug_struct("Structure")
            .field("kind", &self.kind())
            .field("terms", &ids)
            .field("columns", &self.columns)
            .finish()
    }
}

/// A sum of three sines per joint with its exact derivatives.
fn probing_motion(rng: &mut ChaCha8Rng, n: usize, mounting: &Mounting) -> Motion {
    let dt = 0.05;
    let zeros = || DMatrix::zeros(PROBES, n);
    let (mut q, mut dq, mut ddq) = (zeros(), zeros(), zeros());
    for j in 0..n {
        for _ in 0..3 {
            let amplitude = rng.random_range(0.3..0.9);
            let omega: f64 = rng.random_range(0.5..4.0);
            let phase = rng.random_range(-3.1..3.1);
            for k in 0..PROBES {
                let (sin, cos) = (omega * k as f64 * dt + phase).sin_cos();
                q[(k, j)] += amplitude * sin;
                dq[(k, j)] += amplitude * omega * cos;
                ddq[(k, j)] -= amplitude * omega * omega * sin;
            }
        }
    }
    Motion { dt, q, dq, ddq, gravity: mounting.gravity(), periodic: false, start: 0.0 }
}
