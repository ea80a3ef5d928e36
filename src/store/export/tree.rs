//! Bodies of a given URDF in this arm's frames.
//!
//! The URDF's joints are followed from its root; its movable joints have to be the arm's, in order, with the same axes at position zero.
//! Link frames may differ: bodies are carried over in the pose that all joints at zero give. Whatever is fixed to a link belongs to it.

use super::numbers;
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use plumbline_core::BadInput;
use plumbline_model::{Body, Chain, JointKind, Placement};
use roxmltree::{Document, Node};

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

struct Jointed<'d> {
    name: &'d str,
    kind: &'d str,
    parent: &'d str,
    child: &'d str,
    placement: Placement,
    axis: Vector3<f64>,
}

impl Tree {
    /// Reads the tree of joints; `file` is only named in errors.
    /// Errors: anything that is not such a URDF, with the element that is not: no joints, several roots or branches, another number of movable
    /// joints, an axis that lies elsewhere than the arm's.
    pub fn of(file: &str, document: &Document, chain: &Chain) -> Result<Tree, BadInput> {
        let robot = document.root_element();
        if !robot.has_tag_name("robot") {
            let found = format!("<{}>", robot.tag_name().name());
            return Err(BadInput::new(file, "root element", found, "<robot>, a URDF"));
        }
        let joints = robot.children().filter(|node| node.has_tag_name("joint"));
        let joints = joints.map(|node| jointed(file, node)).collect::<Result<Vec<_>, _>>()?;
        let names: Vec<&str> = robot
            .children()
            .filter(|node| node.has_tag_name("link"))
            .map(|node| named(file, node, "name"))
            .collect::<Result<_, _>>()?;
        for joint in &joints {
            for link in [joint.parent, joint.child] {
                if !names.contains(&link) {
                    let found = format!("link `{link}`, which is not there");
                    return Err(BadInput::new(file, format!("joint `{}`", joint.name), found, "links of this file"));
                }
            }
        }
        let roots: Vec<&&str> = names.iter().filter(|name| joints.iter().all(|joint| joint.child != **name)).collect();
        let [root] = roots[..] else {
            let found = format!("{} links that no joint carries", roots.len());
            return Err(BadInput::new(file, "links", found, "one root"));
        };

        let n = chain.len();
        let mut segments = Vec::with_capacity(n);
        let mut ours = Placement::identity();
        let (mut link, mut at) = (*root, Placement::identity());
        for j in 0..n {
            let (_, next) = fixed_to(&joints, link, &at, names.len());
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
            let (fixed, _) = fixed_to(&joints, joint.child, &frame, names.len());
            let inside = |placement: &Placement| inverse(&ours).then(placement);
            segments.push(Segment {
                link: joint.child.to_string(),
                placement: inside(&frame),
                fixed: fixed.iter().skip(1).map(|(name, placement)| (name.to_string(), inside(placement))).collect(),
            });
            (link, at) = (joint.child, frame);
        }
        let (_, beyond) = fixed_to(&joints, link, &at, names.len());
        Ok(Tree { segments, beyond: beyond.iter().map(|(joint, _)| joint.name.to_string()).collect() })
    }
}

/// Everything fixed to a link, itself first, with placements, and the movable joints that leave from there with the placement of their
/// parents. `most` bounds the walk where joints go round in a circle.
#[allow(clippy::type_complexity)] // two plain lists
fn fixed_to<'t, 'd>(
    joints: &'t [Jointed<'d>],
    link: &'d str,
    at: &Placement,
    most: usize,
) -> (Vec<(&'d str, Placement)>, Vec<(&'t Jointed<'d>, Placement)>) {
    let mut fixed = vec![(link, *at)];
    let mut movable = Vec::new();
    let mut k = 0;
    while k < fixed.len() && k < most {
        let (link, at) = fixed[k];
        for joint in joints.iter().filter(|joint| joint.parent == link) {
            match joint.kind {
                "fixed" => fixed.push((joint.child, at.then(&joint.placement))),
                _ => movable.push((joint, at)),
            }
        }
        k += 1;
    }
    (fixed, movable)
}

/// Joint `j` of the URDF turns about (or slides along) the arm's axis.
fn same_axis(
    file: &str,
    j: usize,
    joint: &Jointed,
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

pub(super) fn inverse(placement: &Placement) -> Placement {
    let rotation = placement.rotation.transpose();
    Placement { rotation, origin: -(rotation * placement.origin) }
}

fn jointed<'d>(file: &str, node: Node<'d, '_>) -> Result<Jointed<'d>, BadInput> {
    let name = named(file, node, "name")?;
    let place = format!("joint `{name}`");
    let child = |tag: &str| node.children().find(|node| node.has_tag_name(tag));
    let link = |tag: &str| match child(tag) {
        Some(node) => named(file, node, "link"),
        None => Err(BadInput::new(file, place.clone(), "nothing", format!("a <{tag}>"))),
    };
    let axis = match child("axis") {
        Some(node) => triple(file, &place, node, "xyz", [1.0, 0.0, 0.0])?,
        None => Vector3::x(),
    };
    let kind = named(file, node, "type")?;
    let Some(axis) = Unit::try_new(axis, 1e-9) else {
        return Err(BadInput::new(
            file,
            place,
            format!("axis {}", numbers(axis.iter().copied())),
            "an axis with a length",
        ));
    };
    let placement = match child("origin") {
        Some(node) => origin(file, &place, node)?,
        None => Placement::identity(),
    };
    Ok(Jointed { name, kind, parent: link("parent")?, child: link("child")?, placement, axis: axis.into_inner() })
}

fn named<'d>(file: &str, node: Node<'d, '_>, attribute: &str) -> Result<&'d str, BadInput> {
    node.attribute(attribute).ok_or_else(|| {
        let line = node.document().text_pos_at(node.range().start).row;
        BadInput::new(file, format!("line {line}, <{}>", node.tag_name().name()), "nothing", format!("`{attribute}`"))
    })
}

fn origin(file: &str, place: &str, node: Node) -> Result<Placement, BadInput> {
    let rpy = triple(file, place, node, "rpy", [0.0; 3])?;
    let rotation = *Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z).matrix();
    Ok(Placement { rotation, origin: triple(file, place, node, "xyz", [0.0; 3])? })
}

fn triple(file: &str, place: &str, node: Node, key: &str, otherwise: [f64; 3]) -> Result<Vector3<f64>, BadInput> {
    let Some(text) = node.attribute(key) else { return Ok(otherwise.into()) };
    let values: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    match values.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|value| value.is_finite()) => Ok(Vector3::new(x, y, z)),
        _ => Err(BadInput::new(file, format!("{place}, `{key}`"), format!("`{text}`"), "three numbers")),
    }
}

/// The `<inertial>` of a link by name, in the link's frame; `None` where it has none.
pub fn inertial(file: &str, document: &Document, link: &str) -> Result<Option<Body>, BadInput> {
    let place = format!("link `{link}`, <inertial>");
    let link = document
        .root_element()
        .children()
        .find(|node| node.has_tag_name("link") && node.attribute("name") == Some(link));
    let Some(inertial) = link.and_then(|node| node.children().find(|node| node.has_tag_name("inertial"))) else {
        return Ok(None);
    };
    let child = |tag: &str| inertial.children().find(|node| node.has_tag_name(tag));
    let number = |tag: &str, key: &str| -> Result<f64, BadInput> {
        let text = child(tag).and_then(|node| node.attribute(key)).unwrap_or("nothing");
        match text.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(BadInput::new(file, format!("{place}, <{tag} {key}>"), text, "a number")),
        }
    };
    let mass = number("mass", "value")?;
    let [xx, xy, xz, yy, yz, zz] = [
        number("inertia", "ixx")?,
        number("inertia", "ixy")?,
        number("inertia", "ixz")?,
        number("inertia", "iyy")?,
        number("inertia", "iyz")?,
        number("inertia", "izz")?,
    ];
    let at = match child("origin") {
        Some(node) => origin(file, &place, node)?,
        None => Placement::identity(),
    };
    let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
    Ok(Some(Body { mass, com: Vector3::zeros(), inertia }.seen_from(&at)))
}

/// The bodies that move with each joint, in the arm's frames; `None` where the URDF gives none.
pub fn bodies(file: &str, document: &Document, tree: &Tree) -> Result<Vec<Option<Body>>, BadInput> {
    tree.segments
        .iter()
        .map(|segment| {
            let own = std::iter::once((&segment.link, &segment.placement));
            let mut sum: Option<Body> = None;
            for (link, placement) in own.chain(segment.fixed.iter().map(|(link, placement)| (link, placement))) {
                if let Some(body) = inertial(file, document, link)?.filter(|body| body.mass != 0.0) {
                    let here = body.seen_from(placement);
                    sum = Some(sum.map_or(here, |sum| sum.with(&here)));
                }
            }
            Ok(sum)
        })
        .collect()
}
