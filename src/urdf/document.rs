//! The links and joints of a URDF document.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use plumbline_core::BadInput;
use plumbline_model::{Body, Placement};
use roxmltree::{Document, Node};
use std::path::Path;

/// A joint: `placement` is that of the child's frame in the parent's at position zero, `axis` a unit vector in the child's frame.
pub struct Joint<'d, 'n> {
    pub node: Node<'n, 'd>,
    pub name: &'n str,
    pub kind: &'n str,
    pub parent: &'n str,
    pub child: &'n str,
    pub placement: Placement,
    pub axis: Vector3<f64>,
}

/// A tree of links; `file` is only named in errors.
pub struct Urdf<'d, 'n> {
    pub file: &'n str,
    pub robot: Node<'n, 'd>,
    pub links: Vec<&'n str>,
    pub joints: Vec<Joint<'d, 'n>>,
    /// The link that no joint carries.
    pub root: &'n str,
}

/// Name for errors and text of a URDF.
pub fn read(path: &Path) -> Result<(String, String), BadInput> {
    let file = path.display().to_string();
    match std::fs::read_to_string(path) {
        Ok(text) => Ok((file, text)),
        Err(error) => Err(BadInput::new(file, "file", error, "a readable URDF")),
    }
}

/// The text with a declaration for every namespace prefix that lacks one: descriptions carry `drake:` and `gazebo:` elements without.
pub fn declared(mut text: String) -> String {
    for _ in 0..16 {
        let Err(roxmltree::Error::UnknownNamespace(prefix, _)) = Document::parse(&text) else { break };
        let Some(at) = text.find("<robot").map(|at| at + "<robot".len()) else { break };
        text.insert_str(at, &format!(" xmlns:{prefix}=\"undeclared:{prefix}\""));
    }
    text
}

pub fn parse<'d>(file: &str, text: &'d str) -> Result<Document<'d>, BadInput> {
    Document::parse(text).map_err(|error| {
        let at = error.pos();
        BadInput::new(file, format!("line {}, column {}", at.row, at.col), error, "XML")
    })
}

impl<'d, 'n> Urdf<'d, 'n> {
    /// Errors: another root element, a joint without parent, child or type, links that are not there, a number that is none, several roots.
    pub fn of(file: &'n str, document: &'n Document<'d>) -> Result<Urdf<'d, 'n>, BadInput> {
        let robot = document.root_element();
        if !robot.has_tag_name("robot") {
            let found = format!("<{}>", robot.tag_name().name());
            return Err(BadInput::new(file, "root element", found, "<robot>, a URDF"));
        }
        if let Some(node) =
            robot.children().find(|node| node.tag_name().namespace().is_some_and(|of| of.contains("xacro")))
        {
            let line = document.text_pos_at(node.range().start).row;
            let found = format!("<xacro:{}>", node.tag_name().name());
            let expected = "a URDF; one is made of a xacro file by `xacro FILE.xacro > FILE.urdf`";
            return Err(BadInput::new(file, format!("line {line}"), found, expected));
        }
        let joints = robot.children().filter(|node| node.has_tag_name("joint"));
        let joints = joints.map(|node| joint(file, node)).collect::<Result<Vec<_>, _>>()?;
        let links: Vec<&str> = robot
            .children()
            .filter(|node| node.has_tag_name("link"))
            .map(|node| named(file, node, "name"))
            .collect::<Result<_, _>>()?;
        for joint in &joints {
            for link in [joint.parent, joint.child] {
                if !links.contains(&link) {
                    let found = format!("link `{link}`, which is not there");
                    return Err(BadInput::new(file, format!("joint `{}`", joint.name), found, "links of this file"));
                }
            }
            if joints.iter().filter(|other| other.name == joint.name).count() > 1 {
                let expected = "a name of its own for every joint";
                return Err(BadInput::new(
                    file,
                    format!("joint `{}`", joint.name),
                    "the name of several joints",
                    expected,
                ));
            }
            if let Some(other) = joints.iter().find(|other| other.child == joint.child && other.name != joint.name) {
                let place = format!("joints `{}` and `{}`", joint.name, other.name);
                let found = format!("both carry link `{}`", joint.child);
                return Err(BadInput::new(file, place, found, "one joint per link: a tree"));
            }
        }
        let roots: Vec<&&str> = links.iter().filter(|name| joints.iter().all(|joint| joint.child != **name)).collect();
        let [root] = roots[..] else {
            let found = format!("{} links that no joint carries", roots.len());
            return Err(BadInput::new(file, "links", found, "one root"));
        };
        Ok(Urdf { file, robot, root, links, joints })
    }

    /// Everything fixed to a link, itself first, with placements, and the movable joints that leave from there with the placement of their
    /// parents. A joint that `rigid` names counts as fixed, at position zero.
    #[allow(clippy::type_complexity)] // two plain lists
    pub fn fixed_to(
        &self,
        link: &'n str,
        at: &Placement,
        rigid: impl Fn(&Joint) -> bool,
    ) -> (Vec<(&'n str, Placement)>, Vec<(&Joint<'d, 'n>, Placement)>) {
        let mut fixed = vec![(link, *at)];
        let mut movable = Vec::new();
        let mut k = 0;
        // As many as there are links, where joints go round in a circle.
        while k < fixed.len() && k < self.links.len() {
            let (link, at) = fixed[k];
            for joint in self.joints.iter().filter(|joint| joint.parent == link) {
                match joint.kind == "fixed" || rigid(joint) {
                    true => fixed.push((joint.child, at.then(&joint.placement))),
                    false => movable.push((joint, at)),
                }
            }
            k += 1;
        }
        (fixed, movable)
    }

    /// The element of a link.
    pub fn link(&self, name: &str) -> Option<Node<'n, 'd>> {
        self.robot.children().find(|node| node.has_tag_name("link") && node.attribute("name") == Some(name))
    }

    /// The `<inertial>` of a link by name, in the link's frame; `None` where it has none.
    pub fn inertial(&self, link: &str) -> Result<Option<Body>, BadInput> {
        let place = format!("link `{link}`, <inertial>");
        let Some(inertial) = self.link(link).and_then(|node| child(node, "inertial")) else {
            return Ok(None);
        };
        let number = |tag: &str, key: &str| -> Result<f64, BadInput> {
            let text = child(inertial, tag).and_then(|node| node.attribute(key)).unwrap_or("nothing");
            match text.trim().parse::<f64>() {
                Ok(value) if value.is_finite() => Ok(value),
                _ => Err(BadInput::new(self.file, format!("{place}, <{tag} {key}>"), text, "a number")),
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
        let at = origin(self.file, &place, inertial)?;
        let inertia = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz);
        Ok(Some(Body { mass, com: Vector3::zeros(), inertia }.seen_from(&at)))
    }
}

pub fn child<'d, 'n>(node: Node<'n, 'd>, tag: &str) -> Option<Node<'n, 'd>> {
    node.children().find(|node| node.has_tag_name(tag))
}

fn joint<'d, 'n>(file: &str, node: Node<'n, 'd>) -> Result<Joint<'d, 'n>, BadInput> {
    let name = named(file, node, "name")?;
    let place = format!("joint `{name}`");
    let link = |tag: &str| match child(node, tag) {
        Some(node) => named(file, node, "link"),
        None => Err(BadInput::new(file, place.clone(), "nothing", format!("a <{tag}>"))),
    };
    let axis = match child(node, "axis") {
        Some(node) => triple(file, &place, node, "xyz", [1.0, 0.0, 0.0])?,
        None => Vector3::x(),
    };
    let kind = named(file, node, "type")?;
    let (parent, child) = (link("parent")?, link("child")?);
    let axis = match Unit::try_new(axis, 1e-9) {
        Some(axis) => axis.into_inner(),
        // No motion is along it.
        None if kind == "fixed" => Vector3::x(),
        None => {
            let found = format!("axis {} {} {}", axis.x, axis.y, axis.z);
            return Err(BadInput::new(file, place, found, "an axis with a length"));
        }
    };
    let placement = origin(file, &place, node)?;
    Ok(Joint { node, name, kind, parent, child, placement, axis })
}

pub fn named<'n>(file: &str, node: Node<'n, '_>, attribute: &str) -> Result<&'n str, BadInput> {
    node.attribute(attribute).ok_or_else(|| {
        let line = node.document().text_pos_at(node.range().start).row;
        BadInput::new(file, format!("line {line}, <{}>", node.tag_name().name()), "nothing", format!("`{attribute}`"))
    })
}

/// The `<origin>` of an element; the identity where it has none.
pub fn origin(file: &str, place: &str, element: Node) -> Result<Placement, BadInput> {
    let Some(node) = child(element, "origin") else { return Ok(Placement::identity()) };
    let rpy = triple(file, place, node, "rpy", [0.0; 3])?;
    let rotation = *Rotation3::from_euler_angles(rpy.x, rpy.y, rpy.z).matrix();
    Ok(Placement { rotation, origin: triple(file, place, node, "xyz", [0.0; 3])? })
}

/// Three numbers of an attribute.
pub fn triple(file: &str, place: &str, node: Node, key: &str, otherwise: [f64; 3]) -> Result<Vector3<f64>, BadInput> {
    let Some(text) = node.attribute(key) else { return Ok(otherwise.into()) };
    let values: Option<Vec<f64>> = text.split_whitespace().map(|word| word.parse().ok()).collect();
    match values.as_deref() {
        Some(&[x, y, z]) if [x, y, z].iter().all(|value| value.is_finite()) => Ok(Vector3::new(x, y, z)),
        _ => Err(BadInput::new(file, format!("{place}, `{key}`"), format!("`{text}`"), "three numbers")),
    }
}

/// One number of an attribute; `None` where it is absent.
pub fn number(file: &str, place: &str, node: Option<Node>, key: &str) -> Result<Option<f64>, BadInput> {
    let Some(text) = node.and_then(|node| node.attribute(key)) else { return Ok(None) };
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(Some(value)),
        _ => Err(BadInput::new(file, format!("{place}, `{key}`"), format!("`{text}`"), "a number")),
    }
}
