//! Capsules around the collision geometry of an arm's links.

use super::arm::Arm;
use super::document::{Urdf, child, named, number, origin, triple};
use super::mesh::{Packages, triangles};
use nalgebra::Vector3;
use plumbline_core::BadInput;
use plumbline_model::{Capsule, Enclosing, Placement, enclosing};
use roxmltree::Node;

/// Most capsules of one mesh.
const MOST: usize = 3;
/// Corners of the circles that stand for a cylinder.
const CORNERS: usize = 24;

/// Capsules and what they lack.
pub struct Volumes {
    pub capsules: Vec<Capsule>,
    pub notes: Vec<String>,
}

/// The capsules of every link of an arm, in its frames. A mesh that is not at hand, or cannot be read, is in the notes.
///
/// Spheres are themselves. A cylinder, a box and a mesh are inside the smallest capsules that a search finds.
///
/// # Errors
/// A geometry without its sizes, or of a kind that URDF does not have: by link.
pub fn volumes(urdf: &Urdf, arm: &Arm, packages: &Packages) -> Result<Volumes, BadInput> {
    let mut capsules = Vec::new();
    let mut notes = Vec::new();
    let mut missing: Vec<String> = Vec::new();
    let mut bare: Vec<&str> = Vec::new();
    for (index, segment) in arm.segments.iter().enumerate() {
        let before = capsules.len();
        for (link, at) in segment {
            let Some(element) = urdf.link(link) else { continue };
            for collision in element.children().filter(|node| node.has_tag_name("collision")) {
                let place = format!("link `{link}`, <collision>");
                let at = at.then(&origin(urdf.file, &place, collision)?);
                let Some(geometry) = child(collision, "geometry") else {
                    return Err(BadInput::new(urdf.file, place, "nothing", "a <geometry>"));
                };
                let found = match of(urdf.file, &place, geometry, packages)? {
                    Ok(found) => found,
                    Err(lacks) => {
                        missing.push(format!("{link}: {lacks}"));
                        continue;
                    }
                };
                capsules.extend(found.iter().map(|capsule| placed(index, &at, capsule)));
            }
        }
        if capsules.len() == before
            && let Some((link, _)) = segment.first()
        {
            bare.push(link);
        }
    }
    if !missing.is_empty() {
        let more = if missing.len() > 1 { format!(", and {} more", missing.len() - 1) } else { String::new() };
        notes.push(format!(
            "no volume from {}{more}; --meshes DIR names the folder with the packages of meshes",
            missing[0]
        ));
    }
    if !bare.is_empty() && !capsules.is_empty() {
        notes.push(format!("links without a volume, which self-collision leaves out: {}", bare.join(", ")));
    }
    Ok(Volumes { capsules, notes })
}

/// Capsules of a `<geometry>` in its own frame, or what is not at hand.
fn of(
    file: &str,
    place: &str,
    geometry: Node,
    packages: &Packages,
) -> Result<Result<Vec<Enclosing>, String>, BadInput> {
    let Some(shape) = geometry.children().find(Node::is_element) else {
        return Err(BadInput::new(
            file,
            format!("{place}, <geometry>"),
            "nothing",
            "box, cylinder, sphere, capsule or mesh",
        ));
    };
    let length = |key: &str| match number(file, place, Some(shape), key)? {
        Some(value) if value > 0.0 => Ok(value),
        other => {
            let found = other.map_or("nothing".to_string(), |value| value.to_string());
            Err(BadInput::new(file, format!("{place}, `{key}`"), found, "a length above 0 in m"))
        }
    };
    let upright = |half: f64, radius: f64| Enclosing { ends: [Vector3::z() * -half, Vector3::z() * half], radius };
    Ok(Ok(match shape.tag_name().name() {
        "sphere" => vec![upright(0.0, length("radius")?)],
        "capsule" => vec![upright(0.5 * length("length")?, length("radius")?)],
        "cylinder" => {
            let (radius, half) = (length("radius")?, 0.5 * length("length")?);
            // Circles of corners around the cylinder's own.
            let around = radius / (std::f64::consts::PI / CORNERS as f64).cos();
            let points = (0..2 * CORNERS).map(|k| {
                let turn = (k / 2) as f64 * std::f64::consts::TAU / CORNERS as f64;
                Vector3::new(around * turn.cos(), around * turn.sin(), if k % 2 == 0 { half } else { -half })
            });
            enclosing(&points.map(|point| [point; 3]).collect::<Vec<_>>(), 1)
        }
        "box" => {
            let size = triple(file, place, shape, "size", [0.0; 3])?;
            if size.iter().any(|side| *side <= 0.0) {
                return Err(BadInput::new(
                    file,
                    format!("{place}, `size`"),
                    format!("{size:?}"),
                    "three lengths above 0",
                ));
            }
            let corner =
                |k: usize| Vector3::from_fn(|axis, _| if k >> axis & 1 == 1 { 0.5 } else { -0.5 } * size[axis]);
            enclosing(&(0..8).map(|k| [corner(k); 3]).collect::<Vec<_>>(), 1)
        }
        "mesh" => {
            let name = named(file, shape, "filename")?;
            let scale = triple(file, place, shape, "scale", [1.0; 3])?;
            let Some(path) = packages.find(name) else { return Ok(Err(format!("{name} is not found"))) };
            match triangles(&path) {
                Err(error) => return Ok(Err(error.to_string())),
                Ok(found) => {
                    let scaled: Vec<_> = found.into_iter().map(|face| face.map(|v| v.component_mul(&scale))).collect();
                    enclosing(&scaled, MOST)
                }
            }
        }
        other => {
            let expected = "box, cylinder, sphere, capsule or mesh";
            return Err(BadInput::new(file, format!("{place}, <geometry>"), format!("<{other}>"), expected));
        }
    }))
}

/// In the link's frame, to a tenth of a millimetre; the radius is rounded up.
fn placed(link: usize, at: &Placement, capsule: &Enclosing) -> Capsule {
    let rounded = |v: Vector3<f64>| <[f64; 3]>::from(v.map(|x| (x * 1e4).round() / 1e4 + 0.0));
    let [from, to] = capsule.ends.map(|end| rounded(at.rotation * end + at.origin));
    // Rounding moves an end by up to 0.09 mm.
    Capsule { link, from, to, radius: ((capsule.radius + 9e-5) * 1e4).ceil() / 1e4 }
}
