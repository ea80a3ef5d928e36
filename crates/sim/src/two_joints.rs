use crate::Truth;
use plumbline_model::{Chain, Joint, JointKind, Placement};

/// Two revolute joints.
pub fn chain() -> Chain {
    let joint = |alpha| Joint { kind: JointKind::Revolute, a: 0.1, alpha, d: 0.2, theta: 0.0 };
    Chain::modified(vec![joint(0.0), joint(-1.4)], Placement::identity())
}

/// An arm of that kind. `joint` and `effects` are as in a truth file, `keys` are those of the arm.
pub fn truth(keys: &str, joint: &str, effects: &str) -> Truth {
    let link = "{ mass = 1.0, com = [0.1, 0, 0.05], inertia = [0.02, 0, 0, 0.03, 0, 0.03] }";
    let joint = format!("{{ stiffness = 2000, damping = 50, {joint} }}");
    let arm = format!("link = [{link}, {link}]\njoint = [{joint}, {joint}]\neffect = [{effects}]");
    Truth::parse("test", &format!("robot = 'two'\n{keys}\n{arm}")).unwrap_or_else(|error| panic!("{error}"))
}
