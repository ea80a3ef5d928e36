//! Effects whose columns are functions of one sample in one joint's row.

use super::family::{Family, Site, Spec, joint};
use super::friction::SHARPNESS;
use super::load::{Load, LoadUnder, OperatingPoint};
use super::{Column, Expected, FixedTerm, Motion, Sample, Term};
use crate::chain::{Chain, JointKind};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::sync::Arc;

/// Columns that a law can have.
pub(super) const MAX_COLUMNS: usize = 3;
/// Nonlinear parameters that a law can have.
const MAX_SETTINGS: usize = 2;

/// Motion of one joint.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Point {
    /// Position \[rad\].
    pub q: f64,
    /// Velocity \[rad/s\].
    pub dq: f64,
    /// Acceleration \[rad/s2\].
    pub ddq: f64,
}

/// Inputs of a law.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct At {
    /// The joint of the row.
    pub own: Point,
    /// The joint that causes the effect; the same joint unless the site is a pair.
    pub cause: Point,
    /// Rigid-body torque of the cause \[Nm\]; 0 unless the law was built with [`OneRow::loaded`].
    pub load: f64,
    /// Time since the start of the recording \[s\]; 0 in the loop, which serves no law of time.
    pub time: f64,
}

/// Nonlinear parameters, padded with zeros.
pub(super) type Settings = [f64; MAX_SETTINGS];

/// Columns at a sample; values past the term's columns are ignored. Each law is a type instead of a function pointer, so that the compiler
/// can prove that the law of a [`FixedRow`] does not panic.
pub(super) trait Law: Fn(&At, &Settings) -> [f64; MAX_COLUMNS] + Copy + Send + Sync + 'static {}

impl<L: Fn(&At, &Settings) -> [f64; MAX_COLUMNS] + Copy + Send + Sync + 'static> Law for L {}

/// `tanh(100 dq)`, the smooth sign of a velocity (paper eq. 2).
pub(super) fn smooth_sign(dq: f64) -> f64 {
    (SHARPNESS * dq).tanh()
}

/// A column of an effect: `stem`, the joints of the site, `tail`. Its symbol and expression are its name.
pub(super) fn column(stem: &str, site: Site, tail: &str, unit: &'static str) -> Column {
    let name = format!("{stem}{}{tail}", site.suffix());
    // Joint 1 represents the whole arm.
    let joint = site.joints().first().map_or(1, |joint| joint + 1);
    Column { symbol: name.clone(), expression: name.clone(), name, joint, unit }
}

/// A unit by the kind of a joint: turning, sliding.
pub(super) fn unit(
    operating_point: &OperatingPoint,
    joint: usize,
    turning: &'static str,
    sliding: &'static str,
) -> &'static str {
    match operating_point.chain.joints()[joint].kind {
        JointKind::Revolute => turning,
        JointKind::Prismatic => sliding,
    }
}

/// An effect in one row, `tau_row = sum of beta_c law_c(sample)`.
pub(super) struct OneRow<L> {
    family: &'static Family,
    spec: Spec,
    law: L,
    settings: Settings,
    columns: Vec<Column>,
    load: Option<Arc<Load>>,
    smooth: bool,
    expects: Expected,
}

impl<L: Law> OneRow<L> {
    /// A law of the motion.
    pub fn new(
        family: &'static Family,
        form: &'static str,
        site: Site,
        settings: &[f64],
        columns: Vec<Column>,
        law: L,
    ) -> OneRow<L> {
        assert!(
            columns.len() <= MAX_COLUMNS && settings.len() <= MAX_SETTINGS,
            "{} is too wide for one row",
            family.id
        );
        let spec = Spec { family: family.id, form, site, settings: settings.to_vec() };
        let mut own = [0.0; MAX_SETTINGS];
        own[..settings.len()].copy_from_slice(settings);
        OneRow { family, spec, law, settings: own, columns, load: None, smooth: false, expects: Expected::Any }
    }

    /// A law of the motion and the rigid-body torque.
    pub fn loaded(self, operating_point: &OperatingPoint) -> OneRow<L> {
        OneRow { load: Some(Arc::clone(&operating_point.load)), ..self }
    }

    /// A law without a step at reversals.
    pub fn smooth(self) -> OneRow<L> {
        OneRow { smooth: true, ..self }
    }

    /// A law whose parameter is 0 or more.
    pub fn not_negative(self) -> OneRow<L> {
        OneRow { expects: Expected::NotNegative, ..self }
    }

    /// A law whose parameter is 0 or less.
    pub fn not_positive(self) -> OneRow<L> {
        OneRow { expects: Expected::NotPositive, ..self }
    }

    /// A law whose parameter is at most so large.
    pub fn at_most(self, most: f64) -> OneRow<L> {
        OneRow { expects: Expected::AtMost(most), ..self }
    }

    pub fn term(self) -> Arc<dyn Term> {
        Arc::new(self)
    }
}

/// Row and cause.
pub(super) fn row_and_cause(site: Site) -> (usize, usize) {
    match site {
        Site::Pair { row, cause } => (row, cause),
        Site::Joint(joint) => (joint, joint),
        // No law of one row is a function of two joints.
        Site::Function { row, of: [cause, _] } => (row, cause),
        Site::Arm => (0, 0),
    }
}

impl<L: Law> Term for OneRow<L> {
    fn smooth(&self) -> bool {
        self.smooth
    }

    fn expects(&self) -> Expected {
        self.expects
    }

    fn id(&self) -> &'static str {
        self.family.id
    }

    fn physics(&self) -> &'static str {
        self.family.physics
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let ((row, cause), samples) = (row_and_cause(self.spec.site), motion.samples());
        let load = self.load.as_ref().map(|load| load.along(motion));
        let point = |j: usize, k: usize| Point { q: motion.q[(k, j)], dq: motion.dq[(k, j)], ddq: motion.ddq[(k, j)] };
        for k in 0..samples {
            let at = At {
                own: point(row, k),
                cause: point(cause, k),
                load: load.as_ref().map_or(0.0, |load| load[(k, cause)]),
                time: motion.start + k as f64 * motion.dt,
            };
            let values = (self.law)(&at, &self.settings);
            for (c, value) in values[..self.columns.len()].iter().enumerate() {
                y[(row * samples + k, first + c)] = *value;
            }
        }
    }

    fn spec(&self) -> Option<Spec> {
        Some(self.spec.clone())
    }

    fn fix(&self, _chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        if !self.family.is_served() {
            return Box::new(Nothing);
        }
        let (row, cause) = row_and_cause(self.spec.site);
        let load = self.load.as_ref().map(|load| load.under(gravity));
        let mut own = [0.0; MAX_COLUMNS];
        own[..beta.len()].copy_from_slice(beta);
        Box::new(FixedRow { row, cause, law: self.law, settings: self.settings, beta: own, load })
    }
}

/// Friction torque of a joint: one column in Nm or N, `stem`, the joint and the form, whose parameter is 0 or more.
pub(super) fn friction(
    family: &'static Family,
    form: &'static str,
    stem: &str,
    operating_point: &OperatingPoint,
    site: Site,
    settings: &[f64],
    law: impl Law,
) -> Arc<dyn Term> {
    let columns = vec![column(stem, site, &format!("_{form}"), unit(operating_point, joint(site), "Nm", "N"))];
    OneRow::new(family, form, site, settings, columns, law).not_negative().term()
}

struct FixedRow<L> {
    row: usize,
    cause: usize,
    law: L,
    settings: Settings,
    /// Padded with zeros.
    beta: [f64; MAX_COLUMNS],
    load: Option<LoadUnder>,
}

impl<L: Law> FixedTerm for FixedRow<L> {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let point = |j: usize| {
            let value = |all: &JointVec| all.get(j).copied().unwrap_or_default();
            Point { q: value(&sample.q), dq: value(&sample.dq), ddq: value(&sample.ddq) }
        };
        let load = self.load.as_mut().map_or(0.0, |load| {
            let torque = load.torque(sample);
            torque.get(self.cause).copied().unwrap_or_default()
        });
        let at = At { own: point(self.row), cause: point(self.cause), load, time: 0.0 };
        let values = (self.law)(&at, &self.settings);
        if let Some(tau) = tau.get_mut(self.row) {
            *tau += self.beta.iter().zip(values).map(|(beta, value)| beta * value).sum::<f64>();
        }
    }
}

/// An effect that is not served: no torque.
pub(super) struct Nothing;

impl FixedTerm for Nothing {
    fn torque(&mut self, _sample: &Sample, _tau: &mut JointVec) {}
}
