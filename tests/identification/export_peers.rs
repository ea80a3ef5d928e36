//! URDF and MJCF give other programs the arm that was identified: torques of Pinocchio and MuJoCo are the model's.

use plumbline::store::export::{Arm, mjcf, splice, tree, urdf};
use plumbline_model::Mounting;
use plumbline_testkit::bodies::{Case, ROBOTS, bodies, cases, model, robot};
use plumbline_testkit::peers;
use serde::{Deserialize, Serialize};
use std::io::Write;
use std::path::Path;
use std::process::{Command, Stdio};

const REQUIREMENTS: [&str; 2] = ["pin==4.1.0", "mujoco==3.*"];

#[derive(Serialize)]
struct Exported {
    text: String,
    cases: Vec<Case>,
}

#[derive(Serialize, Default)]
struct Request {
    urdf: Vec<Exported>,
    mjcf: Vec<Exported>,
}

#[derive(Deserialize)]
struct Answer {
    urdf: Vec<Vec<Vec<f64>>>,
    mjcf: Vec<Vec<Vec<f64>>>,
}

fn ask(python: &str, request: &Request) -> Answer {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/testkit/peers/torques.py");
    let mut child =
        Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python runs");
    let mut input = child.stdin.take().unwrap();
    input.write_all(serde_json::to_string(request).unwrap().as_bytes()).unwrap();
    drop(input);
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success());
    serde_json::from_slice(&out.stdout).unwrap()
}

fn assert_same(what: &str, cases: &[Case], theirs: &[Vec<f64>]) {
    assert_eq!(cases.len(), theirs.len());
    for (case, theirs) in cases.iter().zip(theirs) {
        let size = case.tau.iter().fold(1.0, |size: f64, value| size.max(value.abs()));
        assert_eq!(case.tau.len(), theirs.len(), "{what}");
        for (j, (ours, theirs)) in case.tau.iter().zip(theirs).enumerate() {
            assert!((ours - theirs).abs() < 1e-9 * size, "{what}, joint {}: {ours} {theirs}", j + 1);
        }
    }
}

#[test]
fn pinocchio_and_mujoco_need_the_models_torque() {
    let Some(python) = peers::interpreter_with(&REQUIREMENTS) else { return };
    let mut request = Request::default();
    for (seed, name) in ROBOTS.iter().enumerate() {
        let robot = robot(name);
        // Pinocchio's recursion is the rigid body alone.
        let rigid = model(&robot, &[], 40 + seed as u64);
        let found = bodies(&rigid);
        assert!(found.exact, "{name}");
        let arm = Arm { model: &rigid, bodies: &found, limits: &robot.limits, left_out: None };
        request.urdf.push(Exported { text: urdf::write(&arm).text, cases: cases(&rigid, 25) });

        // MuJoCo has armature and damping, too: the model without the Coulomb part of its friction.
        let whole = model(&robot, &["friction", "rotor-inertia"], 60 + seed as u64);
        let structure = whole.structure().clone();
        let values: Vec<_> = whole
            .parameters()
            .iter()
            .map(|own| (if own.column.name.starts_with("fc") { 0.0 } else { own.value }, own.std))
            .collect();
        let whole = plumbline_model::TorqueModel::new(*name, structure, vec![Mounting::WALL], &values).unwrap();
        let found = bodies(&whole);
        assert!(found.exact, "{name}");
        let arm = Arm { model: &whole, bodies: &found, limits: &robot.limits, left_out: None };
        let text = mjcf::write(&arm, &Mounting::WALL.gravity()).text;
        request.mjcf.push(Exported { text, cases: cases(&whole, 25) });
    }
    let answer = ask(&python, &request);
    for (k, name) in ROBOTS.iter().enumerate() {
        assert_same(&format!("{name} in Pinocchio"), &request.urdf[k].cases, &answer.urdf[k]);
        assert_same(&format!("{name} in MuJoCo"), &request.mjcf[k].cases, &answer.mjcf[k]);
    }
}

/// A URDF with link frames of its own, bodies fixed to links, and things of other programs: the bodies go in, the rest stays.
const FOREIGN: &str = r#"<?xml version="1.0"?>
<!-- a <robot name="decoy"> in a comment -->
<robot name="two" note="a > b">
  <material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
  <link name="world"/>
  <link name="upper">
    <inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>
    <visual><geometry><mesh filename="upper.dae"/></geometry></visual>
  </link>
  <link name="lower"/>
  <link name="camera"><inertial><origin xyz="0 0 0.1" rpy="0.1 0 0"/><mass value="0.2"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial></link>
  <joint name="mount" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 0.0" rpy="0 0 0"/></joint>
  <link name="base"/>
  <joint name="one" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.3" rpy="0 0 0.7"/><axis xyz="0 0 1"/></joint>
  <joint name="two" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0.05 0.02 0" rpy="0.4 0 0"/><axis xyz="AXIS"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="eye" type="fixed"><parent link="lower"/><child link="camera"/><origin xyz="0.1 0 0" rpy="0 1 0"/></joint>
  <gazebo reference="upper"><selfCollide>true</selfCollide></gazebo>
</robot>
"#;

/// An arm whose axes are those of [`FOREIGN`].
fn two() -> (plumbline_model::Robot, String) {
    let robot = robot("paper-2dof");
    let second = robot.chain.joints()[0].placement(0.0).then(&robot.chain.joints()[1].placement(0.0));
    let z = second.rotation.column(2).into_owned();
    // Any frame on the arm's second axis does: shifted along it and turned.
    let at = second.origin + 0.13 * z;
    let upper = nalgebra::Rotation3::from_euler_angles(0.0, 0.0, 0.7);
    let lower = nalgebra::Rotation3::from_euler_angles(0.4, 0.0, 0.0);
    let first = nalgebra::Vector3::new(0.0, 0.0, 0.3);
    let origin = upper.inverse() * (at - first);
    let axis = (upper * lower).inverse() * z;
    let spoken = |v: &nalgebra::Vector3<f64>| format!("{:?} {:?} {:?}", v.x, v.y, v.z);
    let text = FOREIGN.replace("0.05 0.02 0", &spoken(&origin)).replace("AXIS", &spoken(&axis));
    (robot, text)
}

#[test]
fn bodies_are_inserted_into_another_urdf() {
    let (robot, text) = two();
    let document = roxmltree::Document::parse(&text).unwrap();
    let tree = tree::Tree::of("foreign.urdf", &document, &robot).unwrap_or_else(|error| panic!("{error}"));
    let model = model(&robot, &[], 5);
    let found = bodies(&model);
    let arm = Arm { model: &model, bodies: &found, limits: &robot.limits, left_out: None };
    let exported = splice::write(&arm, &text, &document, &tree);
    assert!(exported.notes.iter().any(|note| note.contains("`camera`")), "{:?}", exported.notes);
    // Everything but the inertials and one comment is as it was.
    let without = |text: &str| {
        let mut out = text.to_string();
        let start = out.find("<!--\n  Inertials by plumbline");
        if let Some(start) = start {
            let end = start + out[start..].find("-->").unwrap() + 3;
            out.replace_range(start..end, "");
        }
        while let Some(start) = out.find("<inertial>") {
            let end = out.find("</inertial>").unwrap() + "</inertial>".len();
            out.replace_range(start..end, "");
        }
        out.replace("></link>", "/>").split_whitespace().collect::<String>().replace("></link>", "/>")
    };
    assert_eq!(without(&exported.text), without(&text));

    // Read back, it is the model's bodies.
    let again = roxmltree::Document::parse(&exported.text).unwrap();
    let bodies = tree::bodies("again.urdf", &again, &tree).unwrap();
    for (body, link) in bodies.iter().zip(&found.links) {
        let back = body.unwrap().link_parameters();
        assert!(back.iter().zip(link).all(|(a, b)| (a - b).abs() < 1e-12), "{back:?} {link:?}");
    }

    let Some(python) = peers::interpreter_with(&REQUIREMENTS) else { return };
    // The continuous joint has two coordinates in Pinocchio: a revolute one for the test.
    let text = exported.text.replace("\"continuous\"", "\"revolute\"").replace(
        "<axis xyz=\"0 0 1\"/>",
        "<axis xyz=\"0 0 1\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/>",
    );
    let request = Request { urdf: vec![Exported { text, cases: cases(&model, 20) }], mjcf: vec![] };
    assert_same("spliced", &request.urdf[0].cases, &ask(&python, &request).urdf[0]);
}

#[test]
fn a_urdf_of_another_arm_is_refused_by_name() {
    let (robot, text) = two();
    let refused = |text: &str, parts: &[&str]| {
        let document = roxmltree::Document::parse(text).unwrap();
        let error = tree::Tree::of("foreign.urdf", &document, &robot).unwrap_err().to_string();
        for part in parts.iter().chain(&["foreign.urdf"]) {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    };
    refused("<sdf/>", &["<sdf>", "<robot>"]);
    refused(&text.replace("type=\"revolute\"", "type=\"fixed\""), &["1 movable joints", "2"]);
    refused(&text.replace("type=\"revolute\"", "type=\"prismatic\""), &["joint `two`", "prismatic"]);
    refused(&text.replace("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 -1\"/>"), &["joint `one`", "axis"]);
    refused(&text.replace("xyz=\"0 0 0.3\"", "xyz=\"0 0.1 0.3\""), &["joint `one`", "point on axis 1"]);
    refused(&text.replace("<axis xyz=\"0 0 1\"/>", "<axis xyz=\"0 0 one\"/>"), &["joint `one`", "0 0 one"]);
    refused(&text.replace("<child link=\"upper\"/>", "<child link=\"upperr\"/>"), &["joint `one`", "`upperr`"]);
    refused(&text.replace("<link name=\"world\"/>", "<link name=\"world\"/><link name=\"lost\"/>"), &["2 links"]);
}
