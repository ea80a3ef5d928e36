//! The robot file of an arm from a URDF.

use super::arm::{Arm, Limit};
use crate::store::export::rpy;
use plumbline_model::{Capsule, JointKind, Placement};
use std::fmt::Write;

/// Limits that a URDF lacks, as ratios of those it has: acceleration over speed \[1/s\], jerk over acceleration \[1/s\], torque rate over torque
/// \[1/s\]. A Panda's are 3 to 9, 500 to 1000 and 11 to 83.
const DDQ_PER_DQ: f64 = 3.0;
const JERK_PER_DDQ: f64 = 50.0;
const DTAU_PER_TAU: f64 = 20.0;

/// Text of a robot file (docs/reference/robot-file.md). `exempt` are pairs of links that self-collision leaves out.
pub fn robot_file(name: &str, source: &str, arm: &Arm, capsules: &[Capsule], exempt: &[[usize; 2]]) -> String {
    let mut text = String::new();
    let links: Vec<&str> = arm.segments.iter().filter_map(|segment| segment.first()).map(|(link, _)| *link).collect();
    let _ = write!(
        text,
        "# {name}: links 0 to {} are {}; the flange is `{}`.\n# Lengths in m, angles in rad, dq in rad/s, ddq in rad/s2, jerk in rad/s3, tau in Nm, \
         dtau in Nm/s.\nname = {name:?}\nfull-name = {name:?}\nsource = {}\nconvention = \"modified-dh\"\n# Sensors between gear and link. \
         \"motor\" where torques are motor currents.\ntorque-sensing = \"link\"\n",
        arm.chain.len(),
        links.join(", "),
        arm.tool_link,
        basic(source),
    );
    for (joint, limit) in arm.chain.joints().iter().zip(&arm.limits) {
        let Limit { name, q_min, q_max, dq, tau, friction: _ } = limit;
        let ddq = three(DDQ_PER_DQ * dq);
        let _ = write!(text, "\n# {name}; ddq, jerk and dtau are chosen: a URDF has none.\n[[joint]]\n");
        if joint.kind == JointKind::Prismatic {
            text.push_str("kind = \"prismatic\"\n");
        }
        let _ = write!(
            text,
            "a = {:?}\nalpha = {:?}\nd = {:?}\ntheta = {:?}\nq-min = {q_min:?}\nq-max = {q_max:?}\ndq = {dq:?}\nddq = {ddq:?}\njerk = {:?}\ntau = \
             {tau:?}\ndtau = {:?}\n",
            joint.a,
            joint.alpha,
            joint.d,
            joint.theta,
            three(JERK_PER_DDQ * ddq),
            three(DTAU_PER_TAU * tau),
        );
    }
    if arm.base != Placement::identity() {
        let _ = write!(
            text,
            "\n# Base frame in the frame of the URDF's root link; a mounting is gravity in the base frame.\n[base]\n{}",
            pose(&arm.base)
        );
    }
    let _ = write!(
        text,
        "\n# `{}` in the frame of link {}.\n[flange]\n{}\n# Without [workspace] neither floor nor walls are checked. In the base frame [m]:\n# \
         [workspace]\n# box-min = [-0.9, -0.9, 0.05]\n# box-max = [0.9, 0.9, 1.3]\n# base-radius = 0.2\n",
        arm.tool_link,
        arm.chain.len(),
        pose(arm.chain.flange())
    );
    if !capsules.is_empty() {
        text.push_str("\n# Capsules around the URDF's collision geometry.\n");
    }
    for (index, Capsule { link, from, to, radius }) in capsules.iter().enumerate() {
        let gap = if index == 0 { "" } else { "\n" };
        let _ = write!(text, "{gap}[[capsule]]\nlink = {link}\nfrom = {from:?}\nto = {to:?}\nradius = {radius:?}\n");
    }
    if !exempt.is_empty() {
        let _ = write!(
            text,
            "\n# Pairs whose capsules overlap in nearly every pose.\n[self-collision]\nexempt = {exempt:?}\n"
        );
    }
    text
}

fn pose(placement: &Placement) -> String {
    let xyz = placement.origin.map(|x| (x * 1e13).round() / 1e13 + 0.0);
    let rpy = rpy(&placement.rotation).map(|x| if x.abs() < 1e-15 { 0.0 } else { x });
    format!("xyz = {:?}\nrpy = {rpy:?}\n", <[f64; 3]>::from(xyz))
}

/// Three digits.
fn three(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

/// A TOML string.
fn basic(text: &str) -> String {
    toml::Value::String(text.to_string()).to_string()
}
