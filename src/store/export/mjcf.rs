//! MJCF of an identified arm, for MuJoCo: nested bodies in the modified Denavit-Hartenberg frames, every joint's axis is z.

use super::{Arm, Exported, attribute, comment, numbers, offsets, placements, validity};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use plumbline_model::term::Entry;
use plumbline_model::{Body, JointKind, Placement};
use std::fmt::Write;

/// The arm as a MuJoCo model with one motor per joint; `gravity` is the gravitational acceleration in the base frame \[m/s2\].
pub fn write(arm: &Arm, gravity: &Vector3<f64>) -> Exported {
    let mut notes = Vec::new();
    let mut bodies = String::new();
    let mut motors = String::new();
    let n = arm.joints();
    for (j, (kind, placement)) in placements(arm.chain()).enumerate() {
        let (name, pad) = (j + 1, "  ".repeat(j + 2));
        let body = Body::of(&arm.bodies.links[j]);
        let (moments, axes) = body.principal().expect("the bodies of a model file are finite");
        let kind = match kind {
            JointKind::Revolute => "hinge",
            JointKind::Prismatic => "slide",
        };
        let (fv, fc) = (arm.friction("fv", j, &mut notes), arm.friction("fc", j, &mut notes));
        let (limits, rotor) = (arm.limits, arm.bodies.rotors[j]);
        let effort = limits.tau[j];
        let _ = write!(
            bodies,
            "{pad}<body name=\"link{name}\" {}>\n{pad}  <inertial pos=\"{}\" quat=\"{}\" mass=\"{:?}\" diaginertia=\"{}\"/>\n{pad}  \
             <joint name=\"joint{name}\" type=\"{kind}\" axis=\"0 0 1\" range=\"{:?} {:?}\" actuatorfrcrange=\"{:?} {effort:?}\" \
             damping=\"{fv:?}\" frictionloss=\"{fc:?}\" armature=\"{rotor:?}\"/>\n",
            place(&placement),
            numbers(body.com.iter().copied()),
            quaternion(&axes),
            body.mass,
            numbers(moments.iter().copied()),
            limits.q_min[j],
            limits.q_max[j],
            -effort,
        );
        let _ = writeln!(
            motors,
            "    <motor name=\"motor{name}\" joint=\"joint{name}\" ctrlrange=\"{:?} {effort:?}\"/>",
            -effort
        );
    }
    let _ = writeln!(bodies, "{}<site name=\"flange\" {}/>", "  ".repeat(n + 2), place(arm.chain().flange()));
    for j in (0..n).rev() {
        let _ = writeln!(bodies, "{}</body>", "  ".repeat(j + 2));
    }
    notes.extend(validity(arm.model));
    if arm.has(|entry| matches!(entry, Entry::SmoothSign { .. })) {
        notes.push(
            "Coulomb friction is MuJoCo's frictionloss, a constraint that holds a joint at rest; the model's is smooth, fc tanh(100 dq)"
                .into(),
        );
    }
    notes.extend(offsets(arm));
    notes.extend(arm.lacks());
    let head = comment([format!("Written by plumbline. {}", arm.origin())].into_iter().chain(notes.clone()));
    let text = format!(
        "{head}<mujoco model=\"{}\">\n  <compiler angle=\"radian\" autolimits=\"true\" balanceinertia=\"false\"/>\n  <option \
         gravity=\"{}\" integrator=\"implicitfast\"/>\n  <worldbody>\n{bodies}  </worldbody>\n  <actuator>\n{motors}  </actuator>\n\
         </mujoco>\n",
        attribute(arm.model.robot()),
        numbers(gravity.iter().copied())
    );
    Exported { text, notes }
}

fn place(placement: &Placement) -> String {
    let pos = numbers(placement.origin.iter().copied());
    format!("pos=\"{pos}\" quat=\"{}\"", quaternion(&placement.rotation))
}

/// `w x y z` of a rotation.
fn quaternion(rotation: &Matrix3<f64>) -> String {
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    numbers([q.w, q.i, q.j, q.k])
}
