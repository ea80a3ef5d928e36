//! Limits that an arm serves as URDF.

use super::{RobotLimits, fr3};
use roxmltree::{Document, Node};

/// Why a description holds no limits.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum UrdfError {
    #[error("the robot description is not XML: {0}")]
    Xml(#[from] roxmltree::Error),
    #[error("the robot description begins with <{found}> instead of <robot>")]
    Root { found: String },
    #[error("the robot description has no <{element}> for joint {joint}")]
    Missing { element: &'static str, joint: usize },
    #[error("in the robot description {attribute} of joint {joint} is `{found}`, expected a finite number")]
    Number { attribute: &'static str, joint: usize, found: String },
    /// Numbers that contradict each other.
    #[error("in the robot description joint {joint} has {what}")]
    Senseless { joint: usize, what: &'static str },
}

/// The limits in the description that an FR3 serves: position, speed and torque from `<limit lower upper velocity effort>`, the speed
/// towards the ends from `<position_based_velocity_limits velocity_offset deceleration_limit>`. Acceleration, jerk and torque rate are not part of
/// it and come from the table of the FR3.
///
/// As in libfranka, the joints are those whose names contain `joint1` to `joint7`.
///
/// # Errors
///
/// [`UrdfError`].
pub fn from_urdf(text: &str) -> Result<RobotLimits, UrdfError> {
    let document = Document::parse(text)?;
    let root = document.root_element();
    if !root.has_tag_name("robot") {
        return Err(UrdfError::Root { found: root.tag_name().name().to_string() });
    }
    let mut limits = fr3();
    for j in 0..7 {
        let joint = j + 1;
        let name = format!("joint{joint}");
        let node = child(&root, "joint", |node| node.attribute("name").is_some_and(|text| text.contains(&name)));
        let node = node.ok_or(UrdfError::Missing { element: "joint", joint })?;
        let limit = child(&node, "limit", |_| true).ok_or(UrdfError::Missing { element: "limit", joint })?;
        let missing = UrdfError::Missing { element: "position_based_velocity_limits", joint };
        let envelope = child(&node, "position_based_velocity_limits", |_| true).ok_or(missing)?;
        limits.q_min[j] = number(&limit, "lower", joint)?;
        limits.q_max[j] = number(&limit, "upper", joint)?;
        limits.dq[j] = number(&limit, "velocity", joint)?;
        if limit.has_attribute("effort") {
            limits.tau[j] = number(&limit, "effort", joint)?;
        }
        limits.dq_offset[j] = number(&envelope, "velocity_offset", joint)?;
        limits.dq_dec[j] = number(&envelope, "deceleration_limit", joint)?;
        let senseless = |what| Err(UrdfError::Senseless { joint, what });
        if limits.q_min[j] >= limits.q_max[j] {
            return senseless("a lower limit that is not below the upper one");
        }
        if limits.dq[j] <= 0.0 || limits.dq_dec[j] <= 0.0 || limits.tau[j] <= 0.0 {
            return senseless("a velocity, deceleration or effort that is not above 0");
        }
        if limits.dq_offset[j] < 0.0 {
            return senseless("a velocity offset below 0");
        }
    }
    limits.dq_ends = [limits.q_min, limits.q_max];
    Ok(limits)
}

fn child<'a, 'input>(node: &Node<'a, 'input>, tag: &str, fits: impl Fn(&Node) -> bool) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(tag) && fits(child))
}

fn number(node: &Node, attribute: &'static str, joint: usize) -> Result<f64, UrdfError> {
    let text = node.attribute(attribute).unwrap_or_default();
    let value = text.trim().parse::<f64>().ok().filter(|value| value.is_finite());
    value.ok_or_else(|| UrdfError::Number { attribute, joint, found: text.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn urdf(edit: impl Fn(usize, String) -> String) -> String {
        let joints: String = (1..=7)
            .map(|joint| {
                let text = format!(
                    r#"<joint name="fr3_joint{joint}" type="revolute"><limit lower="-2.{joint}" upper="1.{joint}" velocity="3.{joint}"
                    effort="4{joint}"/><position_based_velocity_limits velocity_offset="0.{joint}" deceleration_limit="5.{joint}"/></joint>"#
                );
                edit(joint, text)
            })
            .collect();
        format!("<?xml version=\"1.0\"?><robot name=\"fr3\"><link name=\"base\"/>{joints}</robot>")
    }

    #[test]
    fn every_number_is_read_from_its_joint() {
        let limits = from_urdf(&urdf(|_, text| text)).unwrap();
        assert_eq!(limits.q_min, [-2.1, -2.2, -2.3, -2.4, -2.5, -2.6, -2.7]);
        assert_eq!(limits.q_max, [1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7]);
        assert_eq!(limits.dq, [3.1, 3.2, 3.3, 3.4, 3.5, 3.6, 3.7]);
        assert_eq!(limits.tau, [41.0, 42.0, 43.0, 44.0, 45.0, 46.0, 47.0]);
        assert_eq!(limits.dq_offset, [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]);
        assert_eq!(limits.dq_dec, [5.1, 5.2, 5.3, 5.4, 5.5, 5.6, 5.7]);
        assert_eq!((limits.ddq, limits.jerk), ([10.0; 7], [5000.0; 7]));
        assert_eq!(limits.dq_ends, [limits.q_min, limits.q_max]);
    }

    #[test]
    fn what_is_wrong_is_named() {
        let wrong = |joint, from: &'static str, to: &'static str| {
            from_urdf(&urdf(|at, text| if at == joint { text.replacen(from, to, 1) } else { text }))
                .unwrap_err()
                .to_string()
        };
        assert!(wrong(3, "fr3_joint3", "elbow").contains("<joint> for joint 3"));
        assert!(
            wrong(4, "position_based_velocity_limits", "other")
                .contains("<position_based_velocity_limits> for joint 4")
                || from_urdf("<robot").is_err()
        );
        assert!(wrong(5, "3.5", "fast").contains("velocity of joint 5 is `fast`"));
        assert!(wrong(6, "5.6", "nan").contains("deceleration_limit of joint 6"));
        assert!(wrong(2, "-2.2", "9").contains("joint 2 has a lower limit"));
        assert!(from_urdf("<mujoco/>").unwrap_err().to_string().contains("<mujoco>"));
        assert!(matches!(from_urdf("no xml"), Err(UrdfError::Xml(_))));
    }
}
