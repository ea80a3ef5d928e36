//! Robot descriptions: kinematics and limits of an arm, built in or from a file of the same form.

use crate::chain::{Chain, Joint, JointKind, Placement, StandardDh};
use crate::shape::{Capsule, Shape};
use nalgebra::{Rotation3, Vector3};
use plumbline_core::{BadInput, JointVec, Limits, MAX_JOINTS, SpeedEnvelope, Workspace, from_toml};
use serde::Deserialize;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

/// The built-in robots, name and file.
const BUILT_IN: [(&str, &str); 7] = [
    ("panda", include_str!("../../../config/robots/panda.toml")),
    ("fr3", include_str!("../../../config/robots/fr3.toml")),
    ("ur10", include_str!("../../../config/robots/ur10.toml")),
    ("ur10e", include_str!("../../../config/robots/ur10e.toml")),
    ("kuka-lwr4p", include_str!("../../../config/robots/kuka-lwr4p.toml")),
    ("tx40", include_str!("../../../config/robots/tx40.toml")),
    ("paper-2dof", include_str!("../../../config/robots/paper-2dof.toml")),
];

/// Largest deviation from a right angle that counts as a right angle with too few digits \[rad\].
const RIGHT_ANGLE_SLIP: f64 = 1e-3;
/// Largest deviation from a right angle that the kinematics treat as a right angle \[rad\].
const RIGHT_ANGLE_EXACT: f64 = 1e-15;

/// Denavit-Hartenberg convention of the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Convention {
    /// Craig: row i holds `a_{i-1}`, `alpha_{i-1}`, `d_i`, `theta_i`; the paper's.
    ModifiedDh,
    /// Row i holds `a_i`, `alpha_i`, `d_i`, `theta_i`.
    StandardDh,
}

/// Where torques are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TorqueSensing {
    /// Sensors between gear and link.
    Link,
    /// Motor currents: the torque includes the rotor's inertia and the gear's friction.
    Motor,
}

/// One joint: its row of the DH table and its limits.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
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
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct SelfCollision {
    /// Pairs of link numbers, 0 being the base; neighbouring links are always exempt.
    pub exempt: Vec<[usize; 2]>,
}

/// Placement of a frame in another: translation, then fixed-axis rotations about x, y, z as in URDF.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
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

/// A robot, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Short name.
    pub name: String,
    /// Name for people.
    pub full_name: String,
    /// Where the numbers come from.
    pub source: String,
    /// Kinematics.
    pub chain: Chain,
    /// The base frame in the frame of the root link of the arm's URDF.
    pub base: Placement,
    /// Limits of the joints.
    pub limits: Limits,
    /// Workspace of the end effector.
    pub workspace: Workspace,
    /// Whether the description has a workspace; otherwise `workspace` is larger than the arm's reach.
    pub has_workspace: bool,
    /// Bodies of the links; empty when the description has none.
    pub shape: Shape,
    /// Speed limits that fall towards the ends of the ranges, where the arm has them.
    pub envelope: Option<SpeedEnvelope>,
    /// Where torques are measured.
    pub torque_sensing: TorqueSensing,
    /// Text of the description, unless the robot is built in.
    pub description: Option<String>,
}

impl Robot {
    /// Names of the built-in robots.
    pub fn names() -> impl Iterator<Item = &'static str> {
        BUILT_IN.iter().map(|(name, _)| *name)
    }

    /// A built-in robot by name, or the description in a file when the name ends in `.toml` (relative to `config_dir` where given).
    pub fn load(name_or_path: &str, config_dir: Option<&Path>) -> Result<Robot, BadInput> {
        let (file, text) = Robot::description(name_or_path, config_dir)?;
        Robot::parse(&file, &text)
    }

    /// Name for errors and text of the description that [`load`](Robot::load) reads.
    #[expect(clippy::disallowed_methods, reason = "reads a robot description, before the loop")]
    pub fn description(name_or_path: &str, config_dir: Option<&Path>) -> Result<(String, String), BadInput> {
        if name_or_path.ends_with(".toml") {
            let path = config_dir.map_or_else(|| name_or_path.into(), |dir| dir.join(name_or_path));
            let file = path.display().to_string();
            let text = std::fs::read_to_string(&path)
                .map_err(|error| BadInput::new(&file, "robot description", error, "a file that can be read"))?;
            return Ok((file, text));
        }
        match BUILT_IN.iter().find(|(name, _)| *name == name_or_path) {
            Some((name, text)) => Ok((format!("built-in robot {name}"), text.to_string())),
            None => {
                let known = Robot::names().collect::<Vec<_>>().join(", ");
                let expected = format!("one of {known}, or the path of a robot description ending in .toml");
                Err(BadInput::new("robot", "name", format!("`{name_or_path}`"), expected))
            }
        }
    }

    /// A robot from the text of a description; `file` is only named in errors.
    pub fn parse(file: &str, text: &str) -> Result<Robot, BadInput> {
        let robot = from_toml::<RobotFile>(file, text)?.check(file)?;
        let built_in = BUILT_IN.iter().any(|(_, known)| *known == text);
        Ok(Robot { description: (!built_in).then(|| text.to_string()), ..robot })
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_robot_loads() {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config/robots");
        let mut files = 0;
        for entry in std::fs::read_dir(&dir).unwrap() {
            let name = entry.unwrap().path().file_stem().unwrap().to_str().unwrap().to_string();
            let robot = Robot::load(&name, None).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(robot.name, name);
            assert_eq!(Robot::load(&format!("{name}.toml"), Some(&dir)).unwrap(), robot);
            assert!(robot.limits.dq[robot.chain.len()..].iter().all(|dq| *dq == 0.0));
            files += 1;
        }
        assert_eq!(files, Robot::names().count());
    }

    #[test]
    fn the_panda_is_as_tall_as_its_data_sheet_says() {
        let robot = Robot::load("panda", None).unwrap();
        // Stretched upwards: 0.333 + 0.316 + 0.384 less the flange, which then points down, 0.088 aside.
        let end = robot.chain.end_effector(&[0.0; 7]);
        assert!((end - Vector3::new(0.088, 0.0, 0.333 + 0.316 + 0.384 - 0.107)).norm() < 1e-12);
    }

    /// Each wrong value is answered with its place, itself, and what was expected.
    #[test]
    fn wrong_values_are_named() {
        let panda = BUILT_IN[0].1;
        let cases = [
            ("alpha = -1.5707963267948966", "alpha = -1.5708", "joint 2, key `alpha`", "-1.5708"),
            ("q-min = -2.8973", "q-min = 3.0", "joint 1, key `q-min`", "3 with q-max = 2.8973"),
            ("jerk = 3750.0", "jerk = 0.0", "joint 2, key `jerk`", "0"),
            ("d = 0.316", "d = nan", "joint 3, key `d`", "NaN"),
            ("alpha = 0.0", "alpha = 0.7", "joint 1, keys `alpha` and `a`", "alpha = 0.7, a = 0"),
            ("base-radius = 0.3", "base-radius = -0.3", "workspace, key `base-radius`", "-0.3"),
            ("box-min = [-0.9", "box-min = [9.0", "workspace, keys `box-min` and `box-max`", "x from 9 to 0.9"),
            ("link = 7", "link = 8", "capsule 9, key `link`", "8"),
            ("radius = 0.025", "radius = 0.0", "capsule 7, key `radius`", "0"),
            ("torque-sensing = \"link\"", "torque-sensing = \"link\"\ncoupled = [[5, 8]]", "coupled", "[5, 8]"),
            ("torque-sensing = \"link\"", "torque-sensing = \"link\"\ncoupled = [[5, 5]]", "coupled", "[5, 5]"),
            ("exempt = [[1, 3]]", "exempt = [[1, 9]]", "self-collision, key `exempt`", "[1, 9]"),
            ("jerk = 7500.0", "dq-offset = 0.3\njerk = 7500.0", "joint 1, key `dq-braking`", "nothing"),
        ];
        for (good, bad, place, value) in cases {
            assert!(panda.contains(good), "{good}");
            let error = Robot::parse("arm.toml", &panda.replacen(good, bad, 1)).unwrap_err();
            assert_eq!((error.file.as_str(), error.place.as_str(), error.value.as_str()), ("arm.toml", place, value));
        }
        let error = Robot::parse("arm.toml", &panda.replacen("\njerk", "\njrek", 1)).unwrap_err();
        assert!(error.to_string().contains("jrek"), "{error}");
        let joints = panda.find("[[joint]]").unwrap();
        let many = format!("{}{}", &panda[..joints], panda[joints..panda.find("# Flange").unwrap()].repeat(2));
        assert_eq!(Robot::parse("arm.toml", &many).unwrap_err().value, "14 joints");
    }

    #[test]
    fn coupled_joints_are_a_pair_in_either_order() {
        let chain = Robot::load("tx40", None).unwrap().chain;
        assert!(chain.are_coupled(4, 5) && chain.are_coupled(5, 4) && !chain.are_coupled(3, 4));
    }

    #[test]
    fn an_unknown_robot_is_answered_with_the_known_ones() {
        let error = Robot::load("pandda", None).unwrap_err();
        assert!(error.to_string().contains("`pandda`") && error.expected.contains("paper-2dof"), "{error}");
        let error = Robot::load("no-such-arm.toml", Some(Path::new("nowhere"))).unwrap_err();
        assert!(error.file.ends_with("no-such-arm.toml"), "{error}");
    }

    #[test]
    fn without_a_workspace_the_box_contains_every_pose() {
        let robot = Robot::load("paper-2dof", None).unwrap();
        assert_eq!(robot.workspace.base_radius, 0.0);
        for q1 in [-2.0, 0.0, 1.0] {
            for q2 in [-2.0, 0.0, 1.5] {
                let end = robot.chain.end_effector(&[q1, q2]);
                assert!(end.amax() <= robot.workspace.box_max[0]);
            }
        }
    }
}
