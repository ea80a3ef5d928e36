//! The serial arm in a URDF: the movable joints between a base and a tool link, in plumbline's frames.

use super::document::{Joint, Urdf, child, number};
use nalgebra::{Matrix3, Vector3};
use plumbline_core::{BadInput, MAX_JOINTS, symmetric_eigen};
use plumbline_model::{Axis, Body, Chain, JointKind, Placement, is_consistent};
use std::f64::consts::{FRAC_PI_2, PI};

/// Angles of a URDF within this of a multiple of a right angle are read as exactly that \[rad\]: 1.5708 is pi/2.
const RIGHT_ANGLE_SLIP: f64 = 1e-3;
/// Names that tool frames have, the first found is taken.
const TOOL_NAMES: [&str; 6] = ["tool0", "tcp", "flange", "end_effector_link", "link_eef", "ee_link"];

/// What the caller decides.
#[derive(Default)]
pub struct Choice<'a> {
    /// Link that the arm's base frame belongs to; the root where absent.
    pub base: Option<&'a str>,
    /// Link whose frame is the flange.
    pub tool: Option<&'a str>,
}

/// Limits and friction of one joint as the URDF has them.
pub struct Limit {
    /// Name of the joint.
    pub name: String,
    pub q_min: f64,
    pub q_max: f64,
    pub dq: f64,
    pub tau: f64,
    /// Viscous and Coulomb friction of `<dynamics>`; `None` where absent or zero.
    pub friction: [Option<f64>; 2],
}

/// A serial arm.
pub struct Arm<'n> {
    pub base_link: &'n str,
    pub tool_link: &'n str,
    /// The chain's base frame in the frame of the URDF's root.
    pub base: Placement,
    pub chain: Chain,
    pub limits: Vec<Limit>,
    /// Links per link of the chain, the base first, with their frames in the chain's.
    pub segments: Vec<Vec<(&'n str, Placement)>>,
    /// Largest distance that the tool frame's origin has from the URDF's own, along random poses \[m\]: what rounded angles cost.
    pub deviation: f64,
    pub notes: Vec<String>,
}

impl<'n> Arm<'n> {
    /// The arm of a URDF.
    ///
    /// # Errors
    /// Links that are not there or not on one path, a branch, more than [`MAX_JOINTS`] joints or none, a joint that is neither revolute,
    /// continuous nor prismatic or that mimics another, a limit that is absent or impossible: each by name.
    pub fn of<'d>(urdf: &'n Urdf<'d, 'n>, choice: &Choice) -> Result<Arm<'n>, BadInput> {
        let known = |option: &str, name: Option<&str>| match name {
            None => Ok(None),
            Some(name) => match urdf.links.iter().find(|link| **link == name) {
                Some(link) => Ok(Some(*link)),
                None => {
                    let expected = format!("a link of {}: {}", urdf.file, urdf.links.join(", "));
                    Err(BadInput::new("command line", option, format!("`{name}`"), expected))
                }
            },
        };
        let base_link = known("--base", choice.base)?.unwrap_or(urdf.root);
        let path = match known("--tool", choice.tool)? {
            Some(tool) => path_to(urdf, base_link, tool)?,
            None => path_from(urdf, base_link)?,
        };
        if path.is_empty() || path.len() > MAX_JOINTS {
            let names: Vec<&str> = path.iter().map(|joint| joint.name).collect();
            let found = format!("{} movable joints ({})", path.len(), names.join(", "));
            let expected = format!("1 to {MAX_JOINTS} joints between --base and --tool");
            return Err(BadInput::new(urdf.file, "joints", found, expected));
        }
        for joint in &path {
            check(urdf.file, joint)?;
        }
        let limits = path.iter().map(|joint| limit(urdf.file, joint)).collect::<Result<Vec<_>, _>>()?;

        // Frames at position zero: of every link of the path in the root's frame, with angles squared.
        let on_path = |joint: &Joint| path.iter().any(|other| other.name == joint.name);
        let at_base = frame(urdf, base_link, true);
        let mut links = vec![base_link];
        links.extend(path.iter().map(|joint| joint.child));
        let mut held: Vec<&str> = Vec::new();
        let mut groups: Vec<Vec<(&str, Placement)>> = Vec::new();
        for link in &links {
            let at = frame(urdf, link, true);
            let (fixed, _) = urdf.fixed_to(link, &at, |joint| !on_path(joint));
            groups.push(fixed.iter().map(|(name, _)| (*name, frame(urdf, name, true))).collect());
            held.extend(
                urdf.joints
                    .iter()
                    .filter(|joint| {
                        joint.kind != "fixed" && !on_path(joint) && fixed.iter().any(|(name, _)| *name == joint.child)
                    })
                    .map(|joint| joint.name),
            );
        }
        let tool_link = match choice.tool.and_then(|name| urdf.links.iter().find(|link| **link == name)) {
            Some(link) => link,
            None => tool_of(urdf, links[links.len() - 1], groups.last().map_or(&[], |group| group)),
        };

        let to_base = at_base.inverse();
        let axes: Vec<Axis> = path
            .iter()
            .map(|joint| {
                let at = to_base.then(&frame(urdf, joint.child, true));
                let kind = if joint.kind == "prismatic" { JointKind::Prismatic } else { JointKind::Revolute };
                Axis { kind, point: at.origin, direction: at.rotation * tidy(&joint.axis) }
            })
            .collect();
        let tool = to_base.then(&frame(urdf, tool_link, true));
        let (in_base, chain) = Chain::of_axes(&axes, &tool);
        let base = at_base.then(&in_base);
        let mut ours = base;
        let mut segments = Vec::new();
        for (k, group) in groups.into_iter().enumerate() {
            if k > 0 {
                ours = ours.then(&chain.joints()[k - 1].placement(0.0));
            }
            let inside = ours.inverse();
            segments.push(group.into_iter().map(|(link, at)| (link, inside.then(&at))).collect());
        }

        let mut notes = Vec::new();
        if !held.is_empty() {
            notes.push(format!(
                "joints beside the arm are held at zero, their links are part of the link that carries them: {}",
                held.join(", ")
            ));
        }
        let deviation = deviation(urdf, &path, base_link, tool_link, &at_base.inverse().then(&base), &chain);
        Ok(Arm { base_link, tool_link, base, chain, limits, segments, deviation, notes })
    }

    /// Bodies that move with each joint, in the chain's frames, and what was wrong with the URDF's.
    pub fn bodies(&self, urdf: &Urdf) -> Result<(Vec<Option<Body>>, Vec<String>), BadInput> {
        let mut notes = Vec::new();
        let mut bodies = Vec::new();
        for segment in &self.segments[1..] {
            let mut sum: Option<Body> = None;
            for (link, at) in segment {
                let Some(body) = urdf.inertial(link)?.filter(|body| body.mass != 0.0) else { continue };
                let here = body.seen_from(at);
                sum = Some(sum.map_or(here, |sum| sum.with(&here)));
            }
            let name = segment.first().map_or("", |(link, _)| link);
            bodies.push(match sum {
                Some(body) if body.mass < 0.0 => {
                    notes.push(format!("link `{name}`: a mass of {} kg is no body's", body.mass));
                    None
                }
                Some(body) if !is_consistent(&body.link_parameters()) => {
                    notes.push(format!(
                        "link `{name}`: no body has the moments of <inertia> (one is larger than the sum of the other two, or not positive); \
                         the nearest that one has are taken"
                    ));
                    Some(mended(&body))
                }
                Some(body) => Some(body),
                None => None,
            });
        }
        Ok((bodies, notes))
    }
}

/// The body with the same mass and centre whose second moments are positive.
fn mended(body: &Body) -> Body {
    let half = 0.5 * body.inertia.trace() * Matrix3::identity() - body.inertia;
    let Some(eigen) = symmetric_eigen(half) else {
        return Body { inertia: 1e-4 * body.mass * Matrix3::identity(), ..*body };
    };
    // At least a body of a centimetre.
    let least = (1e-3 * eigen.eigenvalues.amax()).max(1e-4 * body.mass);
    let moments = eigen.eigenvalues.map(|moment| moment.max(least));
    let second = eigen.eigenvectors * Matrix3::from_diagonal(&moments) * eigen.eigenvectors.transpose();
    Body { inertia: second.trace() * Matrix3::identity() - second, ..*body }
}

/// The movable joints from a base up to a tool.
fn path_to<'d, 'n, 'u>(urdf: &'u Urdf<'d, 'n>, base: &str, tool: &str) -> Result<Vec<&'u Joint<'d, 'n>>, BadInput> {
    let mut path = Vec::new();
    let mut link = tool;
    for _ in 0..=urdf.joints.len() {
        if link == base {
            path.reverse();
            return Ok(path);
        }
        let Some(joint) = urdf.joints.iter().find(|joint| joint.child == link) else { break };
        if joint.kind != "fixed" {
            path.push(joint);
        }
        link = joint.parent;
    }
    let expected = format!("a link that joints of {} lead to from `{base}`", urdf.file);
    Err(BadInput::new("command line", "--tool", format!("`{tool}`"), expected))
}

/// The movable joints from a base on, as long as they do not branch.
fn path_from<'d, 'n, 'u>(urdf: &'u Urdf<'d, 'n>, base: &'n str) -> Result<Vec<&'u Joint<'d, 'n>>, BadInput> {
    let mut path: Vec<&Joint> = Vec::new();
    let mut link = base;
    loop {
        let (_, next) = urdf.fixed_to(link, &Placement::identity(), |_| false);
        match next[..] {
            [] => return Ok(path),
            [(joint, _)] if path.len() < urdf.joints.len() => {
                path.push(joint);
                link = joint.child;
            }
            _ => {
                let names: Vec<&str> = next.iter().map(|(joint, _)| joint.name).collect();
                let found = format!("a branch: joints {}", names.join(", "));
                let end = next.first().map_or(link, |(joint, _)| joint.parent);
                let expected = format!(
                    "one serial arm. --tool LINK ends it: --tool {end} leaves these joints out (their links are then held at zero)"
                );
                return Err(BadInput::new(urdf.file, format!("joints behind link `{link}`"), found, expected));
            }
        }
    }
}

fn check(file: &str, joint: &Joint) -> Result<(), BadInput> {
    let place = format!("joint `{}`", joint.name);
    if let Some(mimic) = child(joint.node, "mimic") {
        let found = format!("<mimic joint=\"{}\">", mimic.attribute("joint").unwrap_or_default());
        let expected = "joints with motors of their own; --tool LINK ends the arm before it";
        return Err(BadInput::new(file, place, found, expected));
    }
    if !["revolute", "continuous", "prismatic"].contains(&joint.kind) {
        let expected =
            "revolute, continuous or prismatic; --base LINK begins the arm behind it, --tool LINK ends it before";
        return Err(BadInput::new(file, place, format!("type `{}`", joint.kind), expected));
    }
    Ok(())
}

fn limit(file: &str, joint: &Joint) -> Result<Limit, BadInput> {
    let place = format!("joint `{}`, <limit>", joint.name);
    let node = child(joint.node, "limit");
    let get = |key: &str| number(file, &place, node, key);
    let absent = |key: &str, value: Option<f64>, expected: &str| {
        let found = value.map_or("nothing".to_string(), |value| value.to_string());
        Err(BadInput::new(file, format!("{place}, `{key}`"), found, expected))
    };
    let positive = |key: &str, unit: &str| match get(key)? {
        Some(value) if value > 0.0 => Ok(value),
        other => absent(key, other, &format!("a number above 0 in {unit}, from the arm's data sheet")),
    };
    let (q_min, q_max) = match joint.kind {
        // A motion of one turn shows whatever a longer one would.
        "continuous" => (-PI, PI),
        _ => (get("lower")?.unwrap_or(0.0), get("upper")?.unwrap_or(0.0)),
    };
    if q_min >= q_max {
        let expected = "less than `upper`";
        return Err(BadInput::new(
            file,
            format!("{place}, `lower`"),
            format!("{q_min} with `upper` {q_max}"),
            expected,
        ));
    }
    let units = if joint.kind == "prismatic" { ["m/s", "N"] } else { ["rad/s", "Nm"] };
    let dynamics = child(joint.node, "dynamics");
    let friction = |key: &str| -> Result<Option<f64>, BadInput> {
        Ok(number(file, &format!("joint `{}`, <dynamics>", joint.name), dynamics, key)?.filter(|value| *value > 0.0))
    };
    Ok(Limit {
        name: joint.name.to_string(),
        q_min,
        q_max,
        dq: positive("velocity", units[0])?,
        tau: positive("effort", units[1])?,
        friction: [friction("damping")?, friction("friction")?],
    })
}

/// The link whose frame is the flange: one with a tool frame's name, the end of an unbranched row of fixed links, or the last moving link.
fn tool_of<'n>(urdf: &Urdf<'_, 'n>, last: &'n str, fixed: &[(&'n str, Placement)]) -> &'n str {
    let named = TOOL_NAMES.iter().find_map(|name| fixed.iter().find(|(link, _)| link.ends_with(name)));
    if let Some((link, _)) = named {
        return link;
    }
    let children = |link: &str| urdf.joints.iter().filter(|joint| joint.parent == link).count();
    match fixed.last() {
        Some((end, _)) if fixed.iter().all(|(link, _)| children(link) <= 1) => end,
        _ => last,
    }
}

/// A link's frame in the root's at position zero, with angles squared or as written.
fn frame(urdf: &Urdf, link: &str, squared: bool) -> Placement {
    let mut at = Placement::identity();
    let mut link = link;
    for _ in 0..urdf.joints.len() {
        let Some(joint) = urdf.joints.iter().find(|joint| joint.child == link) else { break };
        let own = if squared { square(&joint.placement) } else { joint.placement };
        at = own.then(&at);
        link = joint.parent;
    }
    at
}

/// The placement with every roll, pitch and yaw that is nearly a multiple of a right angle made one.
fn square(placement: &Placement) -> Placement {
    let [roll, pitch, yaw] = crate::store::export::rpy(&placement.rotation).map(|angle| {
        let turns = (angle / FRAC_PI_2).round();
        if (angle - turns * FRAC_PI_2).abs() < RIGHT_ANGLE_SLIP { turns * FRAC_PI_2 } else { angle }
    });
    let exact = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let snap = |x: f64| if (x - x.round()).abs() < 1e-15 { x.round() } else { x };
        (snap(sin), snap(cos))
    };
    let ((sr, cr), (sp, cp), (sy, cy)) = (exact(roll), exact(pitch), exact(yaw));
    let rotation = Matrix3::new(
        cy * cp,
        cy * sp * sr - sy * cr,
        cy * sp * cr + sy * sr,
        sy * cp,
        sy * sp * sr + cy * cr,
        sy * sp * cr - cy * sr,
        -sp,
        cp * sr,
        cp * cr,
    );
    Placement { rotation, ..*placement }
}

/// A unit vector along a frame's axis where it nearly is.
fn tidy(axis: &Vector3<f64>) -> Vector3<f64> {
    let near = axis.map(|x| if x.abs() < RIGHT_ANGLE_SLIP { 0.0 } else { x });
    near.normalize()
}

/// Largest distance between the chain's tool and the URDF's own, which is followed joint by joint as written.
fn deviation(urdf: &Urdf, path: &[&Joint], base: &str, tool: &str, ours: &Placement, chain: &Chain) -> f64 {
    let mut worst: f64 = 0.0;
    for case in 0..50 {
        // Low-discrepancy angles over a whole turn.
        let q: Vec<f64> = (0..path.len())
            .map(|j| {
                let share = (f64::from(case) * 0.754_877_666 + j as f64 * 0.569_840_291 * f64::from(case + 1)).fract();
                (share - 0.5) * if path[j].kind == "prismatic" { 1.0 } else { 2.0 * PI }
            })
            .collect();
        let theirs = followed(urdf, path, base, tool, &q);
        worst = worst.max((ours.then(&chain.end_effector_placement(&q)).origin - theirs.origin).norm());
    }
    worst
}

/// The tool's frame in the base link's, joint by joint as the URDF has it.
pub fn followed(urdf: &Urdf, path: &[&Joint], base: &str, tool: &str, q: &[f64]) -> Placement {
    let mut at = Placement::identity();
    let mut link = tool;
    while link != base {
        let Some(joint) = urdf.joints.iter().find(|joint| joint.child == link) else { break };
        let moved = match path.iter().position(|other| other.name == joint.name) {
            None => Placement::identity(),
            Some(j) if joint.kind == "prismatic" => Placement { origin: q[j] * joint.axis, ..Placement::identity() },
            Some(j) => {
                let axis = nalgebra::Unit::new_normalize(joint.axis);
                Placement {
                    rotation: *nalgebra::Rotation3::from_axis_angle(&axis, q[j]).matrix(),
                    origin: Vector3::zeros(),
                }
            }
        };
        at = joint.placement.then(&moved).then(&at);
        link = joint.parent;
    }
    at
}
