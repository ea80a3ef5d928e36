//! The form of a robot description, and its check.

use crate::chain::{Chain, Joint, JointKind, Placement, StandardDh};
use crate::robot::Robot;
use crate::shape::{Capsule, Shape};
use nalgebra::{Rotation3, Vector3};
use plumbline_core::{BadInput, JointVec, Limits, MAX_JOINTS, SpeedEnvelope, Workspace};
use serde::Deserialize;
use std::f64::consts::{FRAC_PI_2, PI};

/// Largest deviation from a right angle that counts as a right angle with too few digits \[rad\].
const RIGHT_ANGLE_SLIP: f64 = 1e-3;
/// Largest deviation from a right angle that the kinematics treat as a right angle \[rad\].
const RIGHT_ANGLE_EXACT: f64 = 1e-15;

/// Denavit-Hartenberg convention of the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Convention {
    /// Craig: row i holds `a_{i-1}`, `alpha_{i-1}`, `d_i`, `theta_i`; the paper's.
    ModifiedDh,
    /// Row i holds `a_i`, `alpha_i`, `d_i`, `theta_i`.
    StandardDh,
}

/// Where torques are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum TorqueSensing {
    /// Sensors between gear and link.
    Link,
    /// Motor currents: the torque includes the rotor's inertia and the gear's friction.
    Motor,
}

/// One joint: its row of the DH table and its limits.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct JointRow {
    /// `revolute` (default) or `prismatic`: units in rad are then m, Nm is N.
    #[serde(default)]
    pub kind: JointKind,
    /// Length along x \[m\].
    pub a: f64,
    /// Twist about x \[rad\], right angles with all digits (1.5707963267948966).
    pub alpha: f64,
    /// Length along z \[m\].
    pub d: f64,
    /// Angle offset about z \[rad\], default 0.
    #[serde(default)]
    pub theta: f64,
    /// Lowest position \[rad\].
    pub q_min: f64,
    /// Highest position \[rad\].
    pub q_max: f64,
    /// Highest speed \[rad/s\].
    pub dq: f64,
    /// Highest acceleration \[rad/s2\].
    pub ddq: f64,
    /// Highest jerk \[rad/s3\].
    pub jerk: f64,
    /// Highest torque \[Nm\].
    pub tau: f64,
    /// Highest torque rate \[Nm/s\].
    pub dtau: f64,
    /// With `dq-braking`: the speed limit falls towards the ends of the range, to `sqrt(2 dq-braking distance) - dq-offset`
    /// \[rad/s\].
    pub dq_offset: Option<f64>,
    /// See `dq-offset` \[rad/s2\].
    pub dq_braking: Option<f64>,
}

/// Pairs of links whose distance is not checked.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct SelfCollision {
    /// Pairs of link numbers, 0 being the base; neighbouring links are always exempt.
    pub exempt: Vec<[usize; 2]>,
}

/// Placement of a frame in another: translation, then fixed-axis rotations about x, y, z as in URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Pose {
    /// Translation \[m\], default zero.
    pub xyz: [f64; 3],
    /// Roll, pitch, yaw \[rad\], default zero.
    pub rpy: [f64; 3],
}

impl Pose {
    fn placement(&self) -> Placement {
        let [roll, pitch, yaw] = self.rpy;
        let rotation = *Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
        Placement { rotation, origin: Vector3::from(self.xyz) }
    }
}

/// Workspace of the end effector in the base frame (paper eq. 14).
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct WorkspaceTable {
    /// Lower corner of the box \[m\].
    pub box_min: [f64; 3],
    /// Upper corner of the box \[m\].
    pub box_max: [f64; 3],
    /// Radius of the forbidden sphere around the base \[m\], default 0.
    #[serde(default)]
    pub base_radius: f64,
}

/// A robot description as written.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct RobotFile {
    /// Short name, as configs and datasets write it.
    pub name: String,
    /// Name for people.
    pub full_name: String,
    /// Where the numbers come from.
    pub source: String,
    /// Convention of the rows.
    pub convention: Convention,
    /// Where torques are measured.
    pub torque_sensing: TorqueSensing,
    /// The joints, base first.
    pub joint: Vec<JointRow>,
    /// Pairs of joints, counted from 1, whose gears are coupled, as in many wrists; default none.
    #[serde(default)]
    pub coupled: Vec<[usize; 2]>,
    /// The base frame in the frame of the root link of the arm's URDF, default the same frame.
    #[serde(default)]
    pub base: Pose,
    /// The flange in the last DH frame, default that frame.
    #[serde(default)]
    pub flange: Pose,
    /// Workspace of the end effector; default a box around the arm's whole reach and no sphere.
    pub workspace: Option<WorkspaceTable>,
    /// Volumes of the links; without them self-collision is not checked.
    #[serde(default)]
    pub capsule: Vec<Capsule>,
    /// Exemptions from the self-collision check.
    #[serde(default)]
    pub self_collision: SelfCollision,
}

impl RobotFile {
    /// Checks the description and converts it, without the text.
    pub fn check(&self, file: &str) -> Result<Robot, BadInput> {
        let n = self.joint.len();
        if !(1..=MAX_JOINTS).contains(&n) {
            return Err(BadInput::new(file, "joint", format!("{n} joints"), format!("1 to {MAX_JOINTS} joints")));
        }
        for (index, row) in self.joint.iter().enumerate() {
            check_row(row).map_err(|(key, value, expected)| {
                BadInput::new(file, format!("joint {}, key `{key}`", index + 1), value, expected)
            })?;
        }
        let first = &self.joint[0];
        // pi: an arm whose axis 1 points down while it stands upright.
        if self.convention == Convention::ModifiedDh && (!matches!(first.alpha, 0.0 | PI) || first.a != 0.0) {
            let expected = "a = 0 and alpha = 0 (or 3.141592653589793): axis 1 lies in the base frame's z axis, so that a mounting \
                 says how gravity lies to it (paper eq. 3)";
            let value = format!("alpha = {}, a = {}", first.alpha, first.a);
            return Err(BadInput::new(file, "joint 1, keys `alpha` and `a`", value, expected));
        }
        if let Some([one, other]) =
            self.coupled.iter().find(|[a, b]| a == b || ![a, b].iter().all(|j| (1..=n).contains(*j)))
        {
            let expected = format!("pairs of two different joints from 1 to {n}");
            return Err(BadInput::new(file, "coupled", format!("[{one}, {other}]"), expected));
        }
        for (table, pose) in [("base", self.base), ("flange", self.flange)] {
            for (key, values) in [("xyz", pose.xyz), ("rpy", pose.rpy)] {
                if values.iter().any(|value| !value.is_finite()) {
                    let place = format!("{table}, key `{key}`");
                    return Err(BadInput::new(file, place, format!("{values:?}"), "finite numbers"));
                }
            }
        }
        Ok(Robot {
            name: self.name.clone(),
            full_name: self.full_name.clone(),
            source: self.source.clone(),
            chain: self.chain(),
            base: self.base.placement(),
            limits: self.limits(),
            workspace: self.checked_workspace(file)?,
            has_workspace: self.workspace.is_some(),
            shape: self.checked_shape(file)?,
            envelope: self.envelope(),
            torque_sensing: self.torque_sensing,
            description: None,
        })
    }

    fn chain(&self) -> Chain {
        let flange = self.flange.placement();
        let chain = match self.convention {
            Convention::ModifiedDh => {
                let joint = |r: &JointRow| Joint { kind: r.kind, a: r.a, alpha: r.alpha, d: r.d, theta: r.theta };
                Chain::modified(self.joint.iter().map(joint).collect(), flange)
            }
            Convention::StandardDh => {
                let row = |r: &JointRow| StandardDh { kind: r.kind, a: r.a, alpha: r.alpha, d: r.d, theta: r.theta };
                Chain::standard(&self.joint.iter().map(row).collect::<Vec<_>>(), flange)
            }
        };
        chain.with_coupled(self.coupled.iter().map(|pair| pair.map(|joint| joint - 1)).collect())
    }

    fn limits(&self) -> Limits {
        let per_joint = |value: fn(&JointRow) -> f64| {
            let mut all = JointVec::default();
            for (slot, row) in all.iter_mut().zip(&self.joint) {
                *slot = value(row);
            }
            all
        };
        Limits {
            q_min: per_joint(|row| row.q_min),
            q_max: per_joint(|row| row.q_max),
            dq: per_joint(|row| row.dq),
            ddq: per_joint(|row| row.ddq),
            jerk: per_joint(|row| row.jerk),
            tau: per_joint(|row| row.tau),
            dtau: per_joint(|row| row.dtau),
        }
    }

    fn envelope(&self) -> Option<SpeedEnvelope> {
        let mut envelope = SpeedEnvelope { offset: JointVec::default(), deceleration: JointVec::default() };
        for (j, row) in self.joint.iter().enumerate() {
            if let (Some(offset), Some(braking)) = (row.dq_offset, row.dq_braking) {
                (envelope.offset[j], envelope.deceleration[j]) = (offset, braking);
            }
        }
        envelope.deceleration.iter().any(|dec| *dec > 0.0).then_some(envelope)
    }

    fn checked_shape(&self, file: &str) -> Result<Shape, BadInput> {
        let n = self.joint.len();
        for (index, capsule) in self.capsule.iter().enumerate() {
            let bad = |key: &str, value: String, expected: String| {
                Err(BadInput::new(file, format!("capsule {}, key `{key}`", index + 1), value, expected))
            };
            if capsule.link > n {
                return bad("link", capsule.link.to_string(), format!("0 (the base) to {n}"));
            }
            for (key, point) in [("from", capsule.from), ("to", capsule.to)] {
                if point.iter().any(|x| !x.is_finite()) {
                    return bad(key, format!("{point:?}"), "finite numbers".into());
                }
            }
            if !(capsule.radius.is_finite() && capsule.radius > 0.0) {
                return bad("radius", capsule.radius.to_string(), "a radius above 0 in m".into());
            }
        }
        if let Some(pair) = self.self_collision.exempt.iter().find(|pair| pair.iter().any(|link| *link > n)) {
            let expected = format!("pairs of link numbers from 0 to {n}");
            return Err(BadInput::new(file, "self-collision, key `exempt`", format!("{pair:?}"), expected));
        }
        Ok(Shape::new(self.capsule.clone(), &self.self_collision.exempt))
    }

    fn checked_workspace(&self, file: &str) -> Result<Workspace, BadInput> {
        let Some(table) = self.workspace else {
            let reach = self.reach();
            return Ok(Workspace { box_min: [-reach; 3], box_max: [reach; 3], base_radius: 0.0 });
        };
        for (axis, (low, high)) in table.box_min.iter().zip(&table.box_max).enumerate() {
            if !(low.is_finite() && high.is_finite() && low < high) {
                let value = format!("{} from {low} to {high}", ["x", "y", "z"][axis]);
                return Err(BadInput::new(
                    file,
                    "workspace, keys `box-min` and `box-max`",
                    value,
                    "box-min below box-max",
                ));
            }
        }
        if !(table.base_radius.is_finite() && table.base_radius >= 0.0) {
            let expected = "a radius of 0 or more in m";
            return Err(BadInput::new(file, "workspace, key `base-radius`", table.base_radius, expected));
        }
        Ok(Workspace { box_min: table.box_min, box_max: table.box_max, base_radius: table.base_radius })
    }

    /// Upper bound of the distance of any point of the arm from the base, its volumes included \[m\].
    fn reach(&self) -> f64 {
        let slide = |row: &JointRow| match row.kind {
            JointKind::Revolute => row.d.abs(),
            JointKind::Prismatic => (row.d + row.q_min).abs().max((row.d + row.q_max).abs()),
        };
        let frames = self.joint.iter().map(|row| row.a.abs() + slide(row)).sum::<f64>();
        let bodies = self.capsule.iter().flat_map(|c| [c.from, c.to].map(|end| Vector3::from(end).norm() + c.radius));
        frames + bodies.fold(Vector3::from(self.flange.xyz).norm(), f64::max)
    }
}

/// Key, value found, and what was expected.
type Wrong = (&'static str, String, &'static str);

fn check_row(row: &JointRow) -> Result<(), Wrong> {
    let wrong = |key, value: f64, expected| Err((key, value.to_string(), expected));
    let geometry = [("a", row.a), ("alpha", row.alpha), ("d", row.d), ("theta", row.theta)];
    for (key, value) in geometry.into_iter().chain([("q-min", row.q_min), ("q-max", row.q_max)]) {
        if !value.is_finite() {
            return wrong(key, value, "a finite number");
        }
    }
    let right_angles = row.alpha / FRAC_PI_2;
    let slip = (right_angles - right_angles.round()).abs() * FRAC_PI_2;
    if slip > RIGHT_ANGLE_EXACT * row.alpha.abs().max(1.0) && slip < RIGHT_ANGLE_SLIP {
        return wrong(
            "alpha",
            row.alpha,
            "right angles with all digits (1.5707963267948966): base parameters depend on them",
        );
    }
    if row.q_min >= row.q_max {
        return Err(("q-min", format!("{} with q-max = {}", row.q_min, row.q_max), "less than q-max"));
    }
    let limits = [("dq", row.dq), ("ddq", row.ddq), ("jerk", row.jerk), ("tau", row.tau), ("dtau", row.dtau)];
    for (key, value) in limits {
        if !(value.is_finite() && value > 0.0) {
            return wrong(key, value, "a finite number above 0");
        }
    }
    match (row.dq_offset, row.dq_braking) {
        (None, None) => Ok(()),
        (Some(offset), Some(braking)) => {
            if !(offset.is_finite() && offset >= 0.0) {
                return wrong("dq-offset", offset, "0 or more in rad/s");
            }
            if !(braking.is_finite() && braking > 0.0) {
                return wrong("dq-braking", braking, "a finite number above 0");
            }
            Ok(())
        }
        (Some(_), None) => Err(("dq-braking", "nothing".into(), "a deceleration beside dq-offset")),
        (None, Some(_)) => Err(("dq-offset", "nothing".into(), "a speed beside dq-braking")),
    }
}
