//! URDF of an identified arm: its frames are the modified Denavit-Hartenberg frames, every joint's axis is z.

use super::{Arm, Exported, attribute, comment, numbers, offsets, placements, rpy, validity};
use nalgebra::{Matrix3, Rotation3, Vector3};
use plumbline_core::Limits;
use plumbline_model::term::Entry;
use plumbline_model::{Body, Capsule, JointKind, Placement, Robot};
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
        let (fv, fc) = (arm.friction("fv", j, &mut notes), arm.friction("fc", j, &mut notes));
        let parent = if j == 0 { "base".to_string() } else { format!("link{j}") };
        let (own, link) = (format!("joint{name}"), format!("link{name}"));
        let dynamics = format!("    <dynamics damping=\"{fv:?}\" friction=\"{fc:?}\"/>\n");
        joints += &movable([&own, &parent, &link], (kind, &placement), arm.limits, j, &dynamics);
    }
    let names = ["flange", &format!("link{}", arm.joints()), "flange"];
    put(&mut joints, format_args!("  <link name=\"flange\"/>\n{}", fixed(names, arm.chain().flange())));
    notes.extend(left_out(arm));
    let head = comment([format!("Written by plumbline. {}", arm.origin())].into_iter().chain(notes.clone()));
    let name = attribute(arm.model.robot());
    let text = format!("<?xml version=\"1.0\"?>\n{head}<robot name=\"{name}\">\n{links}{joints}</robot>\n");
    Exported { text, notes }
}

/// Joint `j` with its limits: its name, parent and child, and further elements.
fn movable(names: [&str; 3], at: (JointKind, &Placement), limits: &Limits, j: usize, more: &str) -> String {
    let ([name, parent, child], (kind, placement)) = (names, at);
    let kind = match kind {
        JointKind::Revolute => "revolute",
        JointKind::Prismatic => "prismatic",
    };
    format!(
        "  <joint name=\"{name}\" type=\"{kind}\">\n    <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>\n    {}\n    \
         <axis xyz=\"0 0 1\"/>\n    <limit lower=\"{:?}\" upper=\"{:?}\" effort=\"{:?}\" velocity=\"{:?}\"/>\n{more}  </joint>\n",
        origin(placement),
        limits.q_min[j],
        limits.q_max[j],
        limits.tau[j],
        limits.dq[j]
    )
}

/// A fixed joint: its name, parent and child.
fn fixed([name, parent, child]: [&str; 3], placement: &Placement) -> String {
    format!(
        "  <joint name=\"{name}\" type=\"fixed\">\n    <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>\n    {}\n  \
         </joint>\n",
        origin(placement)
    )
}

/// Radius of the segments that are drawn for an arm without volumes \[m\].
const SEGMENT_RADIUS: f64 = 0.03;

/// A robot for viewers: kinematics, limits, and its volumes as cylinders and spheres, without inertia. An arm without volumes has segments from joint
/// to joint. With `prefix` `panda` the links are `panda_link0` (the base) to `panda_link7` and `panda_flange`, the joints `panda_joint1` to
/// `panda_joint7`.
pub fn shown(robot: &Robot, prefix: &str) -> String {
    let prefix = attribute(prefix);
    let (chain, volumes) = (&robot.chain, drawn_volumes(robot));
    let link = |k: usize| format!("{prefix}_link{k}");
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{prefix}\">\n");
    for k in 0..=chain.len() {
        let own = volumes.iter().filter(|volume| volume.link == k).map(visuals).collect::<String>();
        put(&mut text, format_args!("  <link name=\"{}\">\n{own}  </link>\n", link(k)));
    }
    for (j, (kind, placement)) in placements(chain).enumerate() {
        let name = format!("{prefix}_joint{}", j + 1);
        text += &movable([&name, &link(j), &link(j + 1)], (kind, &placement), &robot.limits, j, "");
    }
    let flange = format!("{prefix}_flange");
    let last = fixed([&format!("{prefix}_flange_joint"), &link(chain.len()), &flange], chain.flange());
    put(&mut text, format_args!("  <link name=\"{flange}\"/>\n{last}</robot>\n"));
    text
}

fn drawn_volumes(robot: &Robot) -> Vec<Capsule> {
    if !robot.shape.is_empty() {
        return robot.shape.capsules().to_vec();
    }
    let next = placements(&robot.chain).map(|(_, placement)| placement).chain([*robot.chain.flange()]);
    let segment = |(link, next): (usize, Placement)| Capsule {
        link,
        from: [0.0; 3],
        to: next.origin.into(),
        radius: SEGMENT_RADIUS,
    };
    next.enumerate().map(segment).collect()
}

/// A capsule as a cylinder with a sphere at either end; URDF has no capsule.
fn visuals(of: &Capsule) -> String {
    let [from, to] = [of.from, of.to].map(Vector3::from);
    let (along, middle) = (to - from, 0.5 * (from + to));
    let unturned = |origin: Vector3<f64>| Placement { rotation: Matrix3::identity(), origin };
    let mut shapes = vec![(unturned(from), format!("<sphere radius=\"{:?}\"/>", of.radius))];
    if along.norm() > 0.0 {
        // Antiparallel to z there is no smallest rotation, and none is needed.
        let turn = Rotation3::rotation_between(&Vector3::z(), &along).unwrap_or_else(Rotation3::identity);
        let cylinder = format!("<cylinder radius=\"{:?}\" length=\"{:?}\"/>", of.radius, along.norm());
        shapes.push((unturned(to), format!("<sphere radius=\"{:?}\"/>", of.radius)));
        shapes.push((Placement { rotation: *turn.matrix(), origin: middle }, cylinder));
    }
    let visual = |(at, shape): (Placement, String)| {
        format!("    <visual>\n      {}\n      <geometry>{shape}</geometry>\n    </visual>\n", origin(&at))
    };
    shapes.into_iter().map(visual).collect()
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
