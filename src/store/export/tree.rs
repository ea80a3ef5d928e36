//! Bodies of a given URDF in this arm's frames.
//!
//! The URDF's joints are followed from its root; its movable joints have to be the arm's, in order, with the same axes at position zero.
//! Link frames may differ: bodies are carried over in the pose that all joints at zero give. Whatever is fixed to a link belongs to it.

use crate::urdf::{Joint, Urdf};
use nalgebra::Vector3;
use plumbline_core::BadInput;
use plumbline_model::{Body, Chain, JointKind, Placement, Robot};
use roxmltree::Document;

/// Axes of the URDF may lie this far from the arm's: descriptions come with four to six digits \[m, rad\].
const SAME_AXIS: f64 = 2e-3;

/// The part of a URDF that moves with one joint.
#[derive(Clone, Debug)]
pub struct Segment {
    pub link: String,
    /// Frame of that link in the arm's frame of the same joint.
    pub placement: Placement,
    /// Links fixed to it, with their frames in the arm's frame.
    pub fixed: Vec<(String, Placement)>,
}

/// A URDF whose movable joints are the arm's.
#[derive(Clone, Debug)]
pub struct Tree {
    pub segments: Vec<Segment>,
    /// Movable joints behind the arm's last one, such as a gripper's: their links belong to no segment.
    pub beyond: Vec<String>,
}

impl Tree {
    /// Reads the tree of joints; `file` is only named in errors.
    /// Errors: anything that is not such a URDF, with the element that is not: no joints, several roots or branches, another number of movable
    /// joints, an axis that lies elsewhere than the arm's.
    pub fn of(file: &str, document: &Document, robot: &Robot) -> Result<Tree, BadInput> {
        let urdf = Urdf::of(file, document)?;
        let chain = &robot.chain;
        let n = chain.len();
        let mut segments = Vec::with_capacity(n);
        let mut ours = robot.base;
        let (mut link, mut at) = (urdf.root, Placement::identity());
        for j in 0..n {
            let (_, next) = urdf.fixed_to(link, &at, |_| false);
            let [(joint, frame)] = next[..] else {
                let (found, expected) = match next.len() {
                    0 => (format!("{j} movable joints"), format!("{n}, the arm's joints")),
                    _ => (
                        format!(
                            "a branch: {}",
                            next.iter().map(|(joint, _)| joint.name).collect::<Vec<_>>().join(", ")
                        ),
                        format!("one movable joint as joint {} of the arm", j + 1),
                    ),
                };
                return Err(BadInput::new(file, format!("joints behind link `{link}`"), found, expected));
            };
            ours = ours.then(&chain.joints()[j].placement(0.0));
            let frame = frame.then(&joint.placement);
            same_axis(file, j, joint, &frame, chain, &ours)?;
            let (fixed, _) = urdf.fixed_to(joint.child, &frame, |_| false);
            let inside = |placement: &Placement| ours.inverse().then(placement);
            segments.push(Segment {
                link: joint.child.to_string(),
                placement: inside(&frame),
                fixed: fixed.iter().skip(1).map(|(name, placement)| (name.to_string(), inside(placement))).collect(),
            });
            (link, at) = (joint.child, frame);
        }
        let (_, beyond) = urdf.fixed_to(link, &at, |_| false);
        Ok(Tree { segments, beyond: beyond.iter().map(|(joint, _)| joint.name.to_string()).collect() })
    }
}

/// Joint `j` of the URDF turns about (or slides along) the arm's axis.
fn same_axis(
    file: &str,
    j: usize,
    joint: &Joint,
    frame: &Placement,
    chain: &Chain,
    ours: &Placement,
) -> Result<(), BadInput> {
    let place = format!("joint `{}`", joint.name);
    let kind = chain.joints()[j].kind;
    let matches = match joint.kind {
        "revolute" | "continuous" => kind == JointKind::Revolute,
        "prismatic" => kind == JointKind::Prismatic,
        _ => false,
    };
    if !matches {
        let expected = format!("the type of joint {} of the arm, {kind:?}", j + 1);
        return Err(BadInput::new(file, place, format!("type `{}`", joint.kind), expected));
    }
    let (theirs, axis) = (frame.rotation * joint.axis, ours.rotation.column(2).into_owned());
    let turned = theirs.cross(&axis).norm().atan2(theirs.dot(&axis));
    if turned > SAME_AXIS {
        let expected = format!("axis {} of the arm, {} in the base frame at position zero", j + 1, spoken(&axis));
        return Err(BadInput::new(file, place, format!("axis {}", spoken(&theirs)), expected));
    }
    let between = frame.origin - ours.origin;
    let aside = (between - axis * between.dot(&axis)).norm();
    if kind == JointKind::Revolute && aside > SAME_AXIS {
        let expected = format!("a point on axis {} of the arm, which passes {}", j + 1, spoken(&ours.origin));
        return Err(BadInput::new(file, place, format!("an axis through {}", spoken(&frame.origin)), expected));
    }
    Ok(())
}

fn spoken(v: &Vector3<f64>) -> String {
    format!("({:.4}, {:.4}, {:.4})", v.x, v.y, v.z)
}

/// The bodies that move with each joint, in the arm's frames; `None` where the URDF gives none.
pub fn bodies(file: &str, document: &Document, tree: &Tree) -> Result<Vec<Option<Body>>, BadInput> {
    let urdf = Urdf::of(file, document)?;
    tree.segments
        .iter()
        .map(|segment| {
            let own = std::iter::once((&segment.link, &segment.placement));
            let mut sum: Option<Body> = None;
            for (link, placement) in own.chain(segment.fixed.iter().map(|(link, placement)| (link, placement))) {
                if let Some(body) = urdf.inertial(link)?.filter(|body| body.mass != 0.0) {
                    let here = body.seen_from(placement);
                    sum = Some(sum.map_or(here, |sum| sum.with(&here)));
                }
            }
            Ok(sum)
        })
        .collect()
}
