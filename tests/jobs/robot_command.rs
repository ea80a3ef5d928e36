//! `plumbline robot` as people call it: an arm from a URDF, whatever the URDF is like, and a robot on a page.

use nalgebra::{Rotation3, Unit, Vector3};
use plumbline_model::{Body, Mounting, Placement, Robot, rnea};
use plumbline_testkit::job::{Done, plumbline};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::fmt::Write;
use std::path::Path;

fn import(urdf: &Path, out: &Path, arguments: &[&str]) -> Done {
    Done::of(plumbline().args(["robot", "import"]).arg(urdf).arg("--out").arg(out).args(arguments))
}

/// A joint of a made-up arm, and the body of its child.
struct Made {
    xyz: [f64; 3],
    rpy: [f64; 3],
    axis: [f64; 3],
    prismatic: bool,
    body: Body,
}

impl Made {
    fn origin(&self) -> Placement {
        let rotation = *Rotation3::from_euler_angles(self.rpy[0], self.rpy[1], self.rpy[2]).matrix();
        Placement { rotation, origin: Vector3::from(self.xyz) }
    }

    fn axis(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(Vector3::from(self.axis))
    }
}

fn made(rng: &mut ChaCha8Rng, joints: usize) -> Vec<Made> {
    (0..joints)
        .map(|j| {
            let mut triple = |size: f64| std::array::from_fn(|_| rng.random_range(-size..size));
            let (xyz, rpy, axis, com) = (triple(0.4), triple(3.0), triple(1.0), triple(0.1));
            let prismatic = j == 2;
            let body = Body {
                mass: rng.random_range(0.5..4.0),
                com: Vector3::from(com),
                inertia: nalgebra::Matrix3::from_diagonal(&Vector3::new(0.02, 0.03, 0.025)),
            };
            Made { xyz, rpy, axis, prismatic, body }
        })
        .collect()
}

fn triple(values: [f64; 3]) -> String {
    values.map(|value| format!("{value:?}")).join(" ")
}

/// The arm as a URDF with a fixed link between any two joints, and a tool.
fn urdf(arm: &[Made]) -> String {
    let mut text = String::from("<robot name=\"made\">\n<link name=\"root\"/>\n");
    let mut parent = "root".to_string();
    for (j, joint) in arm.iter().enumerate() {
        let kind = if joint.prismatic { "prismatic" } else { "revolute" };
        let (b, i) = (&joint.body, &joint.body.inertia);
        // Half of the offset is in the fixed joint.
        let half = triple(joint.xyz.map(|x| 0.5 * x));
        let _ = write!(
            text,
            "<joint name=\"fix{j}\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"between{j}\"/><origin xyz=\"{half}\"/></joint>\n\
             <link name=\"between{j}\"/>\n<joint name=\"joint{j}\" type=\"{kind}\"><parent link=\"between{j}\"/><child link=\"link{j}\"/>\
             <origin xyz=\"{half}\" rpy=\"{}\"/><axis xyz=\"{}\"/><limit lower=\"-1.5\" upper=\"1.5\" effort=\"50\" velocity=\"2\"/></joint>\n\
             <link name=\"link{j}\"><inertial><origin xyz=\"{}\"/><mass value=\"{:?}\"/><inertia ixx=\"{:?}\" ixy=\"0\" ixz=\"0\" iyy=\"{:?}\" \
             iyz=\"0\" izz=\"{:?}\"/></inertial></link>\n",
            triple(joint.rpy),
            triple(joint.axis),
            triple(b.com.into()),
            b.mass,
            i[(0, 0)],
            i[(1, 1)],
            i[(2, 2)],
        );
        parent = format!("link{j}");
    }
    let _ = write!(
        text,
        "<joint name=\"hand\" type=\"fixed\"><parent link=\"{parent}\"/><child link=\"tool0\"/><origin xyz=\"0.1 0.02 0.3\" rpy=\"0.2 -1.1 \
         0.7\"/></joint>\n<link name=\"tool0\"/>\n</robot>\n"
    );
    text
}

/// Frames of the links in the root's, joint by joint as the URDF has them, and axis and point of each joint.
fn followed(arm: &[Made], q: &[f64]) -> (Vec<Placement>, Placement) {
    let mut at = Placement::identity();
    let mut frames = Vec::new();
    for (joint, &q) in arm.iter().zip(q) {
        let moved = if joint.prismatic {
            Placement { origin: joint.axis().into_inner() * q, ..Placement::identity() }
        } else {
            Placement { rotation: *Rotation3::from_axis_angle(&joint.axis(), q).matrix(), origin: Vector3::zeros() }
        };
        at = at.then(&joint.origin()).then(&moved);
        frames.push(at);
    }
    let tool = *Rotation3::from_euler_angles(0.2, -1.1, 0.7).matrix();
    let tool = at.then(&Placement { rotation: tool, origin: Vector3::new(0.1, 0.02, 0.3) });
    (frames, tool)
}

/// Potential energy of the bodies without Denavit and Hartenberg; its slope is the torque that gravity needs.
fn energy(arm: &[Made], q: &[f64], gravity: &Vector3<f64>) -> f64 {
    let (frames, _) = followed(arm, q);
    let bodies = arm.iter().zip(&frames);
    -bodies.map(|(joint, at)| joint.body.mass * gravity.dot(&(at.rotation * joint.body.com + at.origin))).sum::<f64>()
}

/// Kinetic energy, by differences of the frames along the motion.
fn kinetic(arm: &[Made], q: &[f64], dq: &[f64]) -> f64 {
    const STEP: f64 = 1e-5;
    let moved = |sign: f64| followed(arm, &q.iter().zip(dq).map(|(q, dq)| q + sign * STEP * dq).collect::<Vec<_>>()).0;
    let (before, here, after) = (moved(-1.0), moved(0.0), moved(1.0));
    let each = arm.iter().enumerate().map(|(j, joint)| {
        let at = |frames: &[Placement]| frames[j].rotation * joint.body.com + frames[j].origin;
        let v = (at(&after) - at(&before)) / (2.0 * STEP);
        let spin = here[j].rotation.transpose() * (after[j].rotation - before[j].rotation) / (2.0 * STEP);
        let w = Vector3::new(spin[(2, 1)], spin[(0, 2)], spin[(1, 0)]);
        0.5 * joint.body.mass * v.norm_squared() + 0.5 * w.dot(&(joint.body.inertia * w))
    });
    each.sum()
}

/// Standard parameters of the simulated arm's links.
fn links(arm_file: &Path) -> Vec<[f64; 10]> {
    let table: toml::Table = std::fs::read_to_string(arm_file).unwrap().parse().unwrap();
    let numbers =
        |value: &toml::Value| -> Vec<f64> { value.as_array().unwrap().iter().map(|x| x.as_float().unwrap()).collect() };
    let link = |link: &toml::Value| {
        let (com, i) = (numbers(&link["com"]), numbers(&link["inertia"]));
        let inertia = nalgebra::Matrix3::new(i[0], i[1], i[2], i[1], i[3], i[4], i[2], i[4], i[5]);
        Body { mass: link["mass"].as_float().unwrap(), com: Vector3::new(com[0], com[1], com[2]), inertia }
            .link_parameters()
    };
    table["link"].as_array().unwrap().iter().map(link).collect()
}

#[test]
fn kinematics_and_dynamics_of_the_files_are_the_urdfs() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    for joints in [1, 3, 7] {
        let place = tempfile::tempdir().unwrap();
        let arm = made(&mut rng, joints);
        let path = place.path().join("made.urdf");
        std::fs::write(&path, urdf(&arm)).unwrap();
        let done = import(&path, place.path(), &[]).expect_code(0);
        assert!(done.out.contains(&format!("{joints} joints from `root` to `tool0`")), "{}", done.output());
        let robot = Robot::load("made.toml", Some(place.path())).unwrap();
        let parameters = links(&place.path().join("sim-made-arm.toml"));
        for _ in 0..5 {
            let mut random = |size: f64| (0..joints).map(|_| rng.random_range(-size..size)).collect::<Vec<f64>>();
            let (q, dq) = (random(1.5), random(1.0));
            let ours = robot.base.then(&robot.chain.end_effector_placement(&q));
            let (_, theirs) = followed(&arm, &q);
            assert!((ours.origin - theirs.origin).amax() < 1e-10 && (ours.rotation - theirs.rotation).amax() < 1e-10);

            // Gravity is the slope of the potential energy, inertia the kinetic energy's: 2 T = dq' M dq.
            let gravity = robot.base.rotation * Mounting::WALL.gravity();
            let still = vec![0.0; joints];
            let mut tau = vec![0.0; joints];
            rnea(&robot.chain, &parameters, &Mounting::WALL.gravity(), &q, &still, &still, &mut tau);
            for j in 0..joints {
                let moved = |step: f64| {
                    let mut q = q.clone();
                    q[j] += step;
                    energy(&arm, &q, &gravity)
                };
                let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!((slope - tau[j]).abs() < 1e-6 * (1.0 + slope.abs()), "{slope} {}", tau[j]);
            }
            rnea(&robot.chain, &parameters, &Vector3::zeros(), &q, &still, &dq, &mut tau);
            let twice: f64 = dq.iter().zip(&tau).map(|(dq, tau)| dq * tau).sum();
            let expected = 2.0 * kinetic(&arm, &q, &dq);
            assert!((twice - expected).abs() < 1e-6 * expected.max(1.0), "{twice} {expected}");
        }
    }
}

/// A small upright arm with a gripper; each test breaks a line of it.
const GRIPPER: &str = r#"<?xml version="1.0"?>
<robot name="Two Fingers">
  <link name="base"/>
  <link name="upper"><inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/></inertial>
    <collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.05" length="0.4"/></geometry></collision></link>
  <link name="fore"><inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.005"/></inertial>
    <collision><geometry><box size="0.1 0.08 0.3"/></geometry></collision></link>
  <link name="left"><collision><geometry><mesh filename="package://fingers/left.obj" scale="2 2 2"/></geometry></collision></link>
  <link name="right"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><origin xyz="0 0 0.1" rpy="3.1416 0 0"/><axis xyz="0 0 1"/>
    <limit effort="40" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0 0 -0.4" rpy="1.5708 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="20" velocity="2"/><dynamics damping="0.2" friction="0.1"/></joint>
  <joint name="finger" type="prismatic"><parent link="fore"/><child link="left"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="0.2"/></joint>
  <joint name="thumb" type="prismatic"><parent link="fore"/><child link="right"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" effort="20" velocity="0.2"/><mimic joint="finger"/></joint>
</robot>
"#;

#[test]
fn a_gripper_is_held_and_its_meshes_are_found() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().join("fingers/urdf");
    std::fs::create_dir_all(&folder).unwrap();
    let path = folder.join("arm.urdf");
    std::fs::write(&path, GRIPPER).unwrap();
    let out = place.path().join("out");
    let refused = import(&path, &out, &[]).expect_code(2);
    assert!(
        refused.err.contains("a branch: joints finger, thumb") && refused.err.contains("--tool fore"),
        "{}",
        refused.err
    );
    assert!(!out.exists());

    let done = import(&path, &out, &["--tool", "fore"]).expect_code(0);
    for part in [
        "held at zero",
        "finger, thumb",
        "package://fingers/left.obj is not found",
        "2 capsules",
        "two-fingers.toml: 2 joints",
    ] {
        assert!(done.out.contains(part), "no `{part}` in {}", done.output());
    }
    // Nothing is replaced unasked.
    let again = import(&path, &out, &["--tool", "fore"]).expect_code(2);
    assert!(again.err.contains("two-fingers.toml exists") && again.err.contains("--force"), "{}", again.err);

    std::fs::write(place.path().join("fingers/left.obj"), "v 0.1 0 0\nv 0.1 0.01 0\nv 0.1 0 0.03\nf 1 2 3\n").unwrap();
    import(&path, &out, &["--tool", "fore", "--force"]).expect_code(0);
    let robot = Robot::load("two-fingers.toml", Some(&out)).unwrap();
    // Twice as large, as its scale says.
    for corner in [[0.2, 0.0, 0.0], [0.2, 0.02, 0.0], [0.2, 0.0, 0.06]].map(Vector3::from) {
        let holds = |capsule: &plumbline_model::Capsule| {
            let ends = [capsule.from, capsule.to].map(Vector3::from);
            capsule.link == 2 && plumbline_model::nearest(&ends, &[corner; 2]).between.norm() <= capsule.radius
        };
        let fingers = &robot.shape.capsules()[2..];
        assert!(fingers.iter().any(holds) && fingers.iter().all(|capsule| capsule.radius < 0.04), "{fingers:?}");
    }
    // 1.5708 is a right angle, and axis 1 points down.
    let rows: Vec<(f64, f64)> = robot.chain.joints().iter().map(|joint| (joint.a, joint.alpha)).collect();
    assert_eq!(rows, [(0.0, std::f64::consts::PI), (0.0, std::f64::consts::FRAC_PI_2)]);
    assert_eq!(robot.base, Placement::identity());
    let text = std::fs::read_to_string(out.join("sim-two-fingers-arm.toml")).unwrap();
    assert!(text.contains("fc = 0.1\n") && text.contains("fv = 0.2\n"), "{text}");

    // The next commands work on it at once.
    let plan = out.join("plan.toml");
    let mut command = plumbline();
    command.args(["plan", "--mounting", "wall", "--starts", "8", "--rounds", "0", "--period", "4", "--robot"]);
    let done = Done::of(command.arg(out.join("two-fingers.toml")).arg("--out").arg(&plan)).expect_code(0);
    assert!(
        done.out.contains("note: floor and walls are not checked") && !done.out.contains("self-collision is not"),
        "{}",
        done.output()
    );
    let page = out.join("page.html");
    let done = Done::of(plumbline().args(["robot", "show"]).arg(out.join("two-fingers.toml")).arg("--out").arg(&page))
        .expect_code(0);
    assert!(done.out.contains("base parameters: ") && done.out.contains("180.0000"), "{}", done.output());
    assert!(std::fs::read_to_string(&page).unwrap().contains("</svg>"));
}

#[test]
fn what_is_no_arm_is_refused_by_name() {
    let place = tempfile::tempdir().unwrap();
    let path = place.path().join("arm.urdf");
    let out = place.path().join("out");
    let cases = [
        ("type=\"continuous\"", "type=\"floating\"", "joint `shoulder`: got type `floating`"),
        (
            "<axis xyz=\"0 0 1\"/>\n    <limit effort",
            "<axis xyz=\"0 0 0\"/>\n    <limit effort",
            "joint `shoulder`: got axis 0 0 0",
        ),
        ("effort=\"40\"", "effort=\"0\"", "joint `shoulder`, <limit>, `effort`: got 0"),
        (
            "velocity=\"2\"/></joint>\n  <joint name=\"elbow\"",
            "/></joint>\n  <joint name=\"elbow\"",
            "`velocity`: got nothing",
        ),
        ("lower=\"-2\"", "lower=\"2\"", "joint `elbow`, <limit>, `lower`: got 2 with `upper` 2"),
        ("<dynamics", "<mimic joint=\"shoulder\"/><dynamics", "joint `elbow`: got <mimic joint=\"shoulder\">"),
        ("<mass value=\"2\"/>", "<mass value=\"heavy\"/>", "link `upper`, <inertial>, <mass value>: got heavy"),
        ("size=\"0.1 0.08 0.3\"", "size=\"0.1 0.3\"", "link `fore`, <collision>, `size`: got `0.1 0.3`"),
        ("<cylinder radius=\"0.05\"", "<cylinder radius=\"nan\"", "`radius`: got `nan`"),
        ("<child link=\"upper\"/>", "<child link=\"uper\"/>", "link `uper`, which is not there"),
        ("<child link=\"right\"/>", "<child link=\"upper\"/>", "both carry link `upper`"),
        ("</robot>", "", "expected XML"),
        (
            "<link name=\"base\"/>",
            "<xacro:macro xmlns:xacro=\"http://www.ros.org/wiki/xacro\"/><link name=\"base\"/>",
            "xacro FILE.xacro",
        ),
    ];
    for (good, bad, part) in cases {
        assert!(GRIPPER.contains(good), "{good}");
        std::fs::write(&path, GRIPPER.replacen(good, bad, 1)).unwrap();
        let done = import(&path, &out, &["--tool", "fore"]).expect_code(2);
        assert!(done.err.contains(part) && done.err.contains("arm.urdf"), "no `{part}` in {}", done.err);
        assert!(!out.exists());
    }
    std::fs::write(&path, GRIPPER).unwrap();
    for (option, value, part) in
        [("--tool", "hand", "a link of"), ("--base", "fore", "0 movable joints"), ("--name", "a/b", "letters")]
    {
        let tool = if option == "--tool" { vec![] } else { vec!["--tool", "fore"] };
        let done = import(&path, &out, &[&[option, value], &tool[..]].concat()).expect_code(2);
        assert!(done.err.contains(part), "no `{part}` in {}", done.err);
    }
    // Prefixes without a declaration are common, and bodies that are none, too.
    let odd = GRIPPER
        .replacen("<link name=\"base\"/>", "<link name=\"base\"/><drake:limit/>", 1)
        .replace("izz=\"0.005\"", "izz=\"0.5\"");
    std::fs::write(&path, odd).unwrap();
    let done = import(&path, &out, &["--tool", "fore"]).expect_code(0);
    assert!(done.out.contains("link `fore`: no body has the moments"), "{}", done.output());
}
