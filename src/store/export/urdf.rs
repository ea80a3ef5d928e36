//! URDF of an identified arm: its frames are the modified Denavit-Hartenberg frames, every joint's axis is z.

use super::{Arm, Exported, attribute, comment, numbers, offsets, placements, rpy, validity};
use plumbline_model::term::Entry;
use plumbline_model::{Body, JointKind, Placement};
use std::fmt::Write;

/// The arm as a robot description: link `base` is fixed, `link1` .. `linkn` are the bodies, `flange` hangs on the last.
pub fn write(arm: &Arm) -> Exported {
    let mut notes = Vec::new();
    let mut joints = String::new();
    let mut links = String::from("  <link name=\"base\"/>\n");
    for (j, (kind, placement)) in placements(arm.chain()).enumerate() {
        let name = j + 1;
        let body = Body::of(&arm.bodies.links[j]);
        put(&mut links, format_args!("  <link name=\"link{name}\">\n{}  </link>\n", inertial(&body, "    ")));
        let parent = if j == 0 { "base".to_string() } else { format!("link{j}") };
        let limits = arm.limits;
        let kind = match kind {
            JointKind::Revolute => "revolute",
            JointKind::Prismatic => "prismatic",
        };
        put(&mut joints, format_args!("  <joint name=\"joint{name}\" type=\"{kind}\">\n"));
        put(&mut joints, format_args!("    <parent link=\"{parent}\"/>\n    <child link=\"link{name}\"/>\n"));
        put(&mut joints, format_args!("    {}\n    <axis xyz=\"0 0 1\"/>\n", origin(&placement)));
        put(
            &mut joints,
            format_args!(
                "    <limit lower=\"{:?}\" upper=\"{:?}\" effort=\"{:?}\" velocity=\"{:?}\"/>\n",
                limits.q_min[j], limits.q_max[j], limits.tau[j], limits.dq[j]
            ),
        );
        let (fv, fc) = (arm.friction("fv", j, &mut notes), arm.friction("fc", j, &mut notes));
        put(&mut joints, format_args!("    <dynamics damping=\"{fv:?}\" friction=\"{fc:?}\"/>\n  </joint>\n"));
    }
    put(
        &mut joints,
        format_args!(
            "  <link name=\"flange\"/>\n  <joint name=\"flange\" type=\"fixed\">\n    <parent link=\"link{}\"/>\n    <child \
             link=\"flange\"/>\n    {}\n  </joint>\n",
            arm.joints(),
            origin(arm.chain().flange())
        ),
    );
    notes.extend(left_out(arm));
    let head = comment([format!("Written by plumbline. {}", arm.origin())].into_iter().chain(notes.clone()));
    let name = attribute(arm.model.robot());
    let text = format!("<?xml version=\"1.0\"?>\n{head}<robot name=\"{name}\">\n{links}{joints}</robot>\n");
    Exported { text, notes }
}

pub(super) fn left_out(arm: &Arm) -> Vec<String> {
    let mut notes: Vec<String> = validity(arm.model).into_iter().collect();
    if arm.has(|entry| matches!(entry, Entry::SmoothSign { .. })) {
        notes.push(
            "Coulomb friction is the format's constant `friction`; the model's is smooth, fc tanh(100 dq), and simulators treat it in \
             their own ways"
                .into(),
        );
    }
    if arm.has(|entry| matches!(entry, Entry::Acceleration { .. }))
        || arm.bodies.rotors.iter().any(|rotor| *rotor != 0.0)
    {
        notes.push(format!(
            "rotor inertias are left out, a URDF has no place for them: [{}] kg m2 times the joint's acceleration",
            numbers(arm.bodies.rotors.iter().copied()).replace(' ', ", ")
        ));
    }
    notes.extend(offsets(arm));
    notes.extend(arm.lacks());
    notes
}

pub(super) fn inertial(body: &Body, indent: &str) -> String {
    let i = &body.inertia;
    format!(
        "{indent}<inertial>\n{indent}  <origin xyz=\"{}\" rpy=\"0 0 0\"/>\n{indent}  <mass value=\"{:?}\"/>\n{indent}  <inertia \
         ixx=\"{:?}\" ixy=\"{:?}\" ixz=\"{:?}\" iyy=\"{:?}\" iyz=\"{:?}\" izz=\"{:?}\"/>\n{indent}</inertial>\n",
        numbers(body.com.iter().copied()),
        body.mass,
        i[(0, 0)],
        i[(0, 1)],
        i[(0, 2)],
        i[(1, 1)],
        i[(1, 2)],
        i[(2, 2)]
    )
}

fn origin(placement: &Placement) -> String {
    let xyz = numbers(placement.origin.iter().copied());
    format!("<origin xyz=\"{xyz}\" rpy=\"{}\"/>", numbers(rpy(&placement.rotation)))
}

fn put(text: &mut String, args: std::fmt::Arguments) {
    // Writing to a String can't fail.
    let _ = text.write_fmt(args);
}
