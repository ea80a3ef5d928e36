//! An identified arm for other programs: URDF, MJCF, and a C function.
//!
//! URDF and MJCF need standard parameters of real bodies ([`plumbline_identify::consistency`]); the C function computes with the base
//! parameters themselves. Effects are in [`effects`]. What a format has no place for is in [`Exported::notes`] and in a comment of the file.

pub mod c;
pub mod effects;
mod emit;
pub mod load;
pub mod mjcf;
pub mod splice;
pub mod tree;
pub mod urdf;

use nalgebra::Matrix3;
use plumbline_core::Limits;
use plumbline_identify::consistency::Nearest;
use plumbline_model::term::Entry;
use plumbline_model::{BaseKind, Chain, JointKind, Placement, TorqueModel};

/// Text of a file and what the reader of it has to know.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    pub text: String,
    /// What the format can't hold, and where the numbers hold; the file has them in a comment, too.
    pub notes: Vec<String>,
}

/// A model with real bodies and the robot's limits.
#[derive(Clone, Copy)]
pub struct Arm<'a> {
    pub model: &'a TorqueModel,
    pub bodies: &'a Nearest,
    pub limits: &'a Limits,
    /// What the bodies lack of the model, as a note.
    pub left_out: Option<&'a str>,
}

impl Arm<'_> {
    fn chain(&self) -> &Chain {
        self.model.structure().chain()
    }

    fn joints(&self) -> usize {
        self.chain().len()
    }

    /// Whether a term of the whole arm has such a column.
    fn has(&self, is: impl Fn(Entry) -> bool) -> bool {
        let terms = self.model.structure().terms().iter();
        terms.filter_map(|term| term.entries()).flatten().any(is)
    }

    /// Value of a column in the parameters that the bodies have; 0 where the model has no such column.
    fn value(&self, stem: &str, joint: usize) -> f64 {
        let name = format!("{stem}{}", joint + 1);
        let columns = self.model.structure().columns();
        columns.iter().position(|column| column.name == name).map_or(0.0, |c| self.bodies.beta[c])
    }

    /// A friction coefficient, Coulomb's with that of presliding, or zero and a note where it is negative: no simulator takes friction that drives.
    fn friction(&self, stem: &str, joint: usize, notes: &mut Vec<String>) -> f64 {
        let sliding = if stem == "fc" { effects::sliding_friction(self.model, joint) } else { 0.0 };
        let value = self.value(stem, joint) + sliding;
        if value < 0.0 {
            notes.push(format!("{stem}{} = {value:?} is negative and stands as 0", joint + 1));
        }
        value.max(0.0)
    }

    /// Notes on what bodies cannot hold of the model.
    fn lacks(&self) -> Vec<String> {
        self.left_out.map(str::to_string).into_iter().chain(effects::notes_of_bodies(self.model)).collect()
    }

    /// How far the bodies are from what was identified, in one sentence.
    fn origin(&self) -> String {
        match self.bodies.exact {
            true => "The bodies have exactly the identified base parameters.".into(),
            false => format!(
                "No real bodies have the identified parameters: these are the nearest, {:.3} standard deviations away ({}).",
                self.bodies.distance,
                self.bodies.weights.text()
            ),
        }
    }
}

/// Where a model of this kind holds, when that is not everywhere.
fn validity(model: &TorqueModel) -> Option<String> {
    (model.kind() == BaseKind::Vbs).then(|| {
        "VERTICAL ONLY: identified with gravity along axis 1; with gravity in any other direction in the base frame the torques of \
         joint 1 are wrong"
            .to_string()
    })
}

/// The offsets of a model as a note: neither URDF nor MJCF holds a constant torque.
fn offsets(arm: &Arm) -> Option<String> {
    arm.has(|entry| matches!(entry, Entry::Constant { .. })).then(|| {
        let values: Vec<String> = (0..arm.joints()).map(|j| format!("{:?}", arm.value("offset", j))).collect();
        format!("torque offsets are left out: [{}] Nm belong to the sensors", values.join(", "))
    })
}

/// Lines of an XML comment; `--` may not stand in one.
fn comment(lines: impl IntoIterator<Item = String>) -> String {
    let lines: Vec<String> = lines.into_iter().map(|line| format!("  {}\n", line.replace("--", "- -"))).collect();
    format!("<!--\n{}-->\n", lines.concat())
}

/// Numbers with a space between, each the shortest text that reads back the same.
fn numbers(values: impl IntoIterator<Item = f64>) -> String {
    // Without the sign of a zero, which no reader needs.
    values.into_iter().map(|value| format!("{:?}", value + 0.0)).collect::<Vec<_>>().join(" ")
}

/// Fixed-axis roll, pitch, yaw of a rotation, `R = Rz(yaw) Ry(pitch) Rx(roll)`; exact to rounding also where pitch is a right angle.
pub(crate) fn rpy(rotation: &Matrix3<f64>) -> [f64; 3] {
    let yaw = rotation[(1, 0)].atan2(rotation[(0, 0)]);
    let (sin, cos) = yaw.sin_cos();
    let rest = Matrix3::new(cos, sin, 0.0, -sin, cos, 0.0, 0.0, 0.0, 1.0) * rotation;
    [(-rest[(1, 2)]).atan2(rest[(1, 1)]), (-rest[(2, 0)]).atan2(rest[(0, 0)]), yaw]
}

/// Placement of every joint's frame in the one before, at position zero.
fn placements(chain: &Chain) -> impl Iterator<Item = (JointKind, Placement)> + '_ {
    chain.joints().iter().map(|joint| (joint.kind, joint.placement(0.0)))
}

fn attribute(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn angles_give_the_rotation_back() {
        for pitch in [0.0, 0.7, FRAC_PI_2, -FRAC_PI_2, FRAC_PI_2 - 1e-9, -FRAC_PI_2 + 1e-13] {
            for (roll, yaw) in [(0.0, 0.0), (1.3, -2.9), (-2.0, 0.4)] {
                let r = *Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
                let [roll, pitch, yaw] = rpy(&r);
                let again = *Rotation3::from_euler_angles(roll, pitch, yaw).matrix();
                assert!((r - again).amax() < 1e-15, "{roll} {pitch} {yaw}");
            }
        }
    }
}
