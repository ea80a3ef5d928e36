//! The true parameters of a simulated arm: masses, friction, controller, sensors and effects.
//!
//! This file and `effect` import each other: a truth lists its effects, and an effect may change the arm's bodies or friction.

use super::effect::{Effect, EffectSpec, Kind, rotor_inertia};
use super::spatial::Inertia;
use nalgebra::{Matrix3, Vector3};
use plumbline_core::{BadInput, MAX_JOINTS, symmetric_eigen};
use plumbline_model::LinkParameters;
use serde::Deserialize;

/// The true parameters of a simulated arm. The estimator has no access to them.
#[derive(Clone, Debug, PartialEq)]
pub struct Truth {
    /// Name of the robot description whose kinematics it has.
    pub robot: String,
    /// Bodies, base first, one per joint.
    pub links: Vec<LinkTruth>,
    /// Friction, controller and sensors, base first, one per link.
    pub joints: Vec<JointTruth>,
    /// Integration steps per millisecond.
    pub substeps: u32,
    /// Probability that a burst of lost states begins at a state.
    pub drop_probability: f64,
    /// States lost in one burst.
    pub drop_burst: u32,
    /// Corner frequency of the coloured part of the torque sensors' noise \[Hz\].
    pub torque_noise_corner: f64,
    /// Probability that a joint's torque is an outlier in a state.
    pub outlier_probability: f64,
    /// Size of an outlier, up or down \[Nm\].
    pub outlier_size: f64,
    /// Probability that a state repeats the readings and the time stamp of the state before.
    pub repeat_probability: f64,
    /// Joints whose torque sensor is dead and reads 0 Nm, counted from 1.
    pub dead_torque_sensors: Vec<usize>,
    /// Effects beyond the rigid body, `fv dq + fc tanh(100 dq)` and white noise, in the order in which they act.
    pub effects: Vec<EffectSpec>,
}

/// A rigid body.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct LinkTruth {
    /// Mass \[kg\].
    pub mass: f64,
    /// Centre of mass in the link's modified-DH frame \[m\].
    pub com: [f64; 3],
    /// Inertia about the centre of mass, in the axes of that frame: `[Ixx Ixy Ixz Iyy Iyz Izz]` \[kg m2\].
    pub inertia: [f64; 6],
}

/// Friction, controller and sensors of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct JointTruth {
    /// Viscous friction \[Nms/rad\].
    #[serde(default)]
    pub fv: f64,
    /// Coulomb friction \[Nm\].
    #[serde(default)]
    pub fc: f64,
    /// Stiffness of the inner controller \[Nm/rad\].
    pub stiffness: f64,
    /// Damping of the inner controller \[Nms/rad\].
    pub damping: f64,
    /// Standard deviation of the torque sensor's white noise \[Nm\].
    #[serde(default)]
    pub torque_noise: f64,
    /// Standard deviation of the coloured noise that the torque sensor has besides: white noise behind a low-pass of first order \[Nm\].
    #[serde(default)]
    pub torque_noise_coloured: f64,
    /// Step of the measured torque, 0 for none \[Nm\].
    #[serde(default)]
    pub torque_quantum: f64,
    /// Standard deviation of the measured position's white noise \[rad\].
    #[serde(default)]
    pub position_noise: f64,
    /// Step of the measured position, 0 for none \[rad\].
    #[serde(default)]
    pub position_quantum: f64,
    /// Standard deviation of the measured velocity's white noise \[rad/s\].
    #[serde(default)]
    pub velocity_noise: f64,
}

impl Truth {
    /// Errors name `file`. The first `inherited` effects are those of another file.
    pub(super) fn check(&self, file: &str, inherited: usize) -> Result<(), BadInput> {
        let n = self.links.len();
        let wrong = |place: String, value: String, expected: &str| Err(BadInput::new(file, place, value, expected));
        if n == 0 || n > MAX_JOINTS {
            return wrong("link".into(), format!("{n} links"), &format!("1 to {MAX_JOINTS}"));
        }
        if self.joints.len() != n {
            return wrong("joint".into(), format!("{} joints", self.joints.len()), &format!("{n}, one per link"));
        }
        for (k, link) in self.links.iter().enumerate() {
            check_body(file, &format!("link {}", k + 1), link.mass, &link.com, &link.inertia, Inside::Needed)?;
        }
        for (k, joint) in self.joints.iter().enumerate() {
            let fields = [
                ("fv", joint.fv),
                ("fc", joint.fc),
                ("stiffness", joint.stiffness),
                ("damping", joint.damping),
                ("torque-noise", joint.torque_noise),
                ("torque-noise-coloured", joint.torque_noise_coloured),
                ("torque-quantum", joint.torque_quantum),
                ("position-noise", joint.position_noise),
                ("position-quantum", joint.position_quantum),
                ("velocity-noise", joint.velocity_noise),
            ];
            for (name, value) in fields {
                if !(value.is_finite() && value >= 0.0) {
                    return wrong(format!("joint {}, {name}", k + 1), value.to_string(), "a finite number, 0 or more");
                }
            }
        }
        if !(1..=1000).contains(&self.substeps) {
            return wrong("substeps".into(), self.substeps.to_string(), "1 to 1000");
        }
        let ranges = [
            ("drop-probability", self.drop_probability, 0.0, 0.5),
            ("torque-noise-corner", self.torque_noise_corner, 1e-3, 500.0),
            ("outlier-probability", self.outlier_probability, 0.0, 0.5),
            ("outlier-size", self.outlier_size, 0.0, 1e3),
            ("repeat-probability", self.repeat_probability, 0.0, 0.5),
        ];
        for (name, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                return wrong(name.into(), value.to_string(), &format!("{low} to {high}"));
            }
        }
        if let Some(joint) = self.dead_torque_sensors.iter().find(|joint| !(1..=n).contains(*joint)) {
            return wrong("dead-torque-sensors".into(), joint.to_string(), &format!("joints from 1 to {n}"));
        }
        if !(1..=1000).contains(&self.drop_burst) {
            return wrong("drop-burst".into(), self.drop_burst.to_string(), "1 to 1000");
        }
        for (k, effect) in self.effects.iter().enumerate() {
            let name = match k.checked_sub(inherited) {
                Some(own) => format!("effect {}", own + 1),
                None => format!("effect {} of the base", k + 1),
            };
            effect.check(file, &name, self)?;
        }
        let effects = self.build_effects();
        for joint in 0..n {
            let count = |has: fn(&dyn Effect, usize) -> bool| effects.iter().filter(|e| has(e.as_ref(), joint)).count();
            let replaced = count(|effect, joint| effect.replaces_coulomb(joint));
            let twisted = count(|effect, joint| effect.twists(joint));
            let found = |count| format!("{count} on joint {}", joint + 1);
            if replaced > 1 {
                return wrong(
                    "effect".into(),
                    found(replaced),
                    "one effect per joint that replaces its Coulomb friction",
                );
            }
            if twisted > 1 {
                return wrong("effect".into(), found(twisted), "one effect per joint that twists its transmission");
            }
        }
        Ok(())
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.links.len()
    }

    /// The same arm with a rotor of `inertia` \[kg m2\] at the joint's side of every gear.
    pub fn with_rotors(mut self, inertia: f64) -> Truth {
        let rotor = |joint| Kind::RotorInertia(rotor_inertia::Config { joint, inertia }).into();
        self.effects.extend((1..=self.joints()).map(rotor));
        self
    }

    /// Standard parameters of the links without effects, for comparison with identified ones (paper eq. 5, inertia about the link
    /// frame's origin).
    pub fn link_parameters(&self) -> Vec<LinkParameters> {
        let parameters = |link: &LinkTruth| {
            let l = link.about_origin();
            let first = link.mass * Vector3::from(link.com);
            let (i, m) = (l.i, link.mass);
            [i[(0, 0)], i[(0, 1)], i[(0, 2)], i[(1, 1)], i[(1, 2)], i[(2, 2)], first.x, first.y, first.z, m]
        };
        self.links.iter().map(parameters).collect()
    }

    /// Whether the steady-state motion of the arm has the period of its reference, `period` \[s\], without noise and losses.
    pub fn repeats(&self, period: f64) -> bool {
        self.build_effects().iter().all(|effect| effect.repeats(period))
    }

    /// The effects in the order in which they act: as written, deflections of transmissions last.
    pub(super) fn build_effects(&self) -> Vec<Box<dyn Effect>> {
        let mut effects: Vec<_> = self.effects.iter().map(|effect| effect.build(self)).collect();
        effects.sort_by_key(|effect| (0..self.joints()).any(|joint| effect.twists(joint)));
        effects
    }

    /// Whether an effect replaces the Coulomb friction of `joint`, counted from 0.
    pub(super) fn replaces_coulomb(&self, joint: usize) -> bool {
        self.effects.iter().any(|effect| effect.replaces_coulomb(joint))
    }

    pub(super) fn inertias(&self) -> Vec<Inertia> {
        self.links.iter().map(LinkTruth::about_origin).collect()
    }
}

impl LinkTruth {
    fn about_origin(&self) -> Inertia {
        Inertia::rigid(self.mass, self.com.into(), symmetric(&self.inertia))
    }
}

/// `[xx xy xz yy yz zz]` as a matrix.
pub(super) fn symmetric(part: &[f64; 6]) -> Matrix3<f64> {
    let [xx, xy, xz, yy, yz, zz] = *part;
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

/// Whether a body must have an inertia, or may be a point mass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Inside {
    Needed,
    MayBeZero,
}

/// A distribution of mass has this inertia: mass positive, and the second moments `tr(I)/2 - I` about the centre of mass not negative,
/// which holds the triangle inequality of the principal moments and makes them positive.
pub(super) fn check_body(
    file: &str,
    place: &str,
    mass: f64,
    com: &[f64; 3],
    inertia: &[f64; 6],
    inside: Inside,
) -> Result<(), BadInput> {
    if !(mass.is_finite() && mass > 0.0) {
        return Err(BadInput::new(file, format!("{place}, mass"), mass, "a positive mass [kg]"));
    }
    if com.iter().chain(inertia).any(|value| !value.is_finite()) {
        return Err(BadInput::new(file, place, format!("com {com:?}, inertia {inertia:?}"), "finite numbers"));
    }
    let Some(eigen) = symmetric_eigen(symmetric(inertia)) else {
        return Err(BadInput::new(
            file,
            format!("{place}, inertia"),
            format!("{inertia:?}"),
            "principal moments that can be computed",
        ));
    };
    let principal = eigen.eigenvalues;
    let room = 1e-9 * principal.amax();
    let spread = 0.5 * principal.sum() - principal.max();
    let positive = inside == Inside::MayBeZero || principal.min() > 0.0;
    if principal.min() < -room || spread < -room || !positive {
        return Err(BadInput::new(
            file,
            format!("{place}, inertia"),
            format!("principal moments {:.6} {:.6} {:.6} kg m2", principal[0], principal[1], principal[2]),
            "positive moments, none larger than the sum of the other two",
        ));
    }
    Ok(())
}
