//! Robot descriptions: kinematics and limits of an arm, built in or from a file of the same form.

use crate::chain::{Chain, Placement};
use crate::robot_file::{RobotFile, TorqueSensing};
use crate::shape::Shape;
use plumbline_core::{BadInput, Limits, SpeedEnvelope, Workspace, from_toml};
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

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
