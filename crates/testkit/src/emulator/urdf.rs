//! The robot description that clients are served from version 8 on: kinematics of the arm, the emulator's own limits, bodies of the
//! simulated truth.
//!
//! Names are `joint1` to `joint8` and `link0` to `link8`: libfranka looks the flange up as `link8`. The
//! element of the speed limits that fall towards the ends, `position_based_velocity_limits`, is Franka's own: clients from libfranka
//! 0.18 on refuse a description without it. Source: franka_description and libfranka's `joint_velocity_limits.h` and `robot_model.cpp` (github.com/frankarobotics).

use super::limits::{JOINTS, Limits};
use nalgebra::Vector3;
use plumbline_model::Chain;
use plumbline_sim::Truth;
use std::fmt::Write;

/// The description of an arm named `name`.
pub fn write(name: &str, chain: &Chain, limits: &Limits, truth: &Truth) -> String {
    let mut text = format!("<?xml version=\"1.0\"?>\n<robot name=\"{name}\">\n  <link name=\"link0\"/>\n");
    for j in 0..JOINTS {
        let (number, joint) = (j + 1, &chain.joints()[j]);
        let body = &truth.links[j];
        let [xx, xy, xz, yy, yz, zz] = body.inertia;
        let place = joint.placement(0.0).origin;
        // A speed limit that does not fall is one that falls so late that it never counts.
        let (offset, deceleration) = match &limits.envelope {
            Some(envelope) => (envelope.offset[j], envelope.deceleration[j]),
            None => (0.0, 1e6),
        };
        put(
            &mut text,
            format_args!(
                "  <link name=\"link{number}\">\n    <inertial>\n      <origin xyz=\"{}\" rpy=\"0 0 0\"/>\n      \
                 <mass value=\"{:?}\"/>\n      <inertia ixx=\"{xx:?}\" ixy=\"{xy:?}\" ixz=\"{xz:?}\" iyy=\"{yy:?}\" \
                 iyz=\"{yz:?}\" izz=\"{zz:?}\"/>\n    </inertial>\n  </link>\n",
                triple(&body.com.into()),
                body.mass
            ),
        );
        put(
            &mut text,
            format_args!(
                "  <joint name=\"joint{number}\" type=\"revolute\">\n    <origin xyz=\"{}\" rpy=\"{:?} 0 0\"/>\n    \
                 <parent link=\"link{j}\"/>\n    <child link=\"link{number}\"/>\n    <axis xyz=\"0 0 1\"/>\n",
                triple(&place),
                joint.alpha
            ),
        );
        put(
            &mut text,
            format_args!(
                "    <limit lower=\"{:?}\" upper=\"{:?}\" effort=\"{:?}\" velocity=\"{:?}\"/>\n    \
                 <position_based_velocity_limits velocity_offset=\"{offset:?}\" deceleration_limit=\"{deceleration:?}\"/>\n  \
                 </joint>\n",
                limits.q_min[j], limits.q_max[j], limits.tau[j], limits.dq[j]
            ),
        );
    }
    put(
        &mut text,
        format_args!(
            "  <link name=\"link8\"/>\n  <joint name=\"joint8\" type=\"fixed\">\n    <origin xyz=\"{}\" \
             rpy=\"0 0 0\"/>\n    <parent link=\"link7\"/>\n    <child link=\"link8\"/>\n  </joint>\n</robot>\n",
            triple(&chain.flange().origin)
        ),
    );
    text
}

fn triple(vector: &Vector3<f64>) -> String {
    format!("{:?} {:?} {:?}", vector.x, vector.y, vector.z)
}

fn put(text: &mut String, args: std::fmt::Arguments) {
    // Writing to a String can't fail.
    let _ = text.write_fmt(args);
}
