//! What a 3-D viewer reads of a recording: the arm's description, and the placements of its links.

use super::*;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use plumbline::recording::cdr::Decoder;
use plumbline::recording::foreign::for_each_message;
use plumbline::store::export::tree::Tree;
use plumbline_model::{Mounting, Placement, Robot};
use std::collections::HashMap;

/// One `/tf` message: parent and placement by child.
fn transforms(data: &[u8]) -> HashMap<String, (String, Placement)> {
    let mut message = Decoder::new(data).unwrap();
    let mut found = HashMap::new();
    for _ in 0..message.u32().unwrap() {
        let _stamp = (message.i32().unwrap(), message.u32().unwrap());
        let (parent, child) = (message.string().unwrap(), message.string().unwrap());
        let [x, y, z, i, j, k, w] = [(); 7].map(|()| message.f64().unwrap());
        let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        let placement = Placement { rotation: *turn.to_rotation_matrix().matrix(), origin: Vector3::new(x, y, z) };
        found.insert(child, (parent, placement));
    }
    found
}

/// The frame in the world, by the parents.
fn in_world(of: &HashMap<String, (String, Placement)>, frame: &str) -> Placement {
    match of.get(frame) {
        Some((parent, placement)) => in_world(of, parent).then(placement),
        None => {
            assert_eq!(frame, "world");
            Placement::identity()
        }
    }
}

fn far(one: &Placement, other: &Placement) -> f64 {
    (one.rotation - other.rotation).amax().max((one.origin - other.origin).amax())
}

#[test]
fn a_viewer_gets_the_arm_in_its_mounting_along_the_recording() {
    let of = run_loop(FakeArm::new(JOINTS, READY), 1_000, whole_job(), vec![1], no_inputs(), Vec::new());
    let text = Robot::description("panda", None).unwrap().1;
    let robot = Robot::load("panda", None).unwrap();
    for mounting in [Mounting::UPRIGHT, Mounting::WALL, Mounting::CEILING, Mounting { rho: 1.0, phi: -0.4 }] {
        let mut written = recording(&of, 0, None);
        written.texts = vec![("robot.toml".into(), text.clone())];
        (written.about.rho, written.about.phi) = (mounting.rho, mounting.phi);
        let bytes = written.to_bytes().unwrap();
        let (mut descriptions, mut messages) = (Vec::new(), Vec::new());
        for_each_message(
            &bytes,
            |error| error,
            |message| {
                match message.topic.as_str() {
                    "/robot_description" => {
                        assert_eq!(message.schema, "std_msgs/msg/String");
                        descriptions.push((message.log_time, Decoder::new(&message.data).unwrap().string().unwrap()));
                    }
                    "/tf" => {
                        assert_eq!(message.schema, "tf2_msgs/msg/TFMessage");
                        messages.push((message.log_time, transforms(&message.data)));
                    }
                    _ => {}
                }
                Ok(())
            },
        )
        .unwrap();

        // The description has the arm's axes, and a shape for every capsule.
        let [(time, urdf)] = &descriptions[..] else { panic!("{} descriptions", descriptions.len()) };
        let at = |record: &Record| written.about.clock.at(record.state.seq, record.stamp_ns);
        assert_eq!(*time, at(&written.records[0]));
        let document = roxmltree::Document::parse(urdf).unwrap();
        let tree = Tree::of("description", &document, &robot).unwrap();
        let names: Vec<&str> = tree.segments.iter().map(|segment| segment.link.as_str()).collect();
        assert_eq!(names, (1..=7).map(|k| format!("panda_link{k}")).collect::<Vec<_>>());
        assert!(urdf.matches("<cylinder").count() > 5 && urdf.matches("<sphere").count() > 5, "{urdf}");

        // Fifty times a second, at the measured positions.
        assert_eq!(messages.len(), written.records.len().div_ceil(20));
        for (time, frames) in &messages {
            let record = written.records.iter().find(|record| at(record) == *time).unwrap();
            let base = in_world(frames, "panda_link0");
            let down = base.rotation * mounting.gravity().normalize();
            assert!((down + Vector3::z()).amax() < 1e-12, "{mounting}: gravity along {down}");
            let q = &record.state.q[..JOINTS];
            let flange = base.then(&robot.chain.end_effector_placement(q));
            assert!(far(&in_world(frames, "panda_flange"), &flange) < 1e-12, "{mounting}");
            let third = robot.chain.joints().iter().zip(q).take(3);
            let third = third.fold(base, |at, (joint, q)| at.then(&joint.placement(*q)));
            assert!(far(&in_world(frames, "panda_link3"), &third) < 1e-12, "{mounting}");
        }
        let first = &messages[0].1["panda_link4"].1;
        assert!(messages.iter().any(|(_, frames)| far(&frames["panda_link4"].1, first) > 0.1), "the arm moves");
    }
}

/// A description that is absent or damaged leaves the recording without them, and nothing else.
#[test]
fn a_recording_without_a_description_has_no_scene() {
    let of = run_loop(FakeArm::new(JOINTS, READY), 200, whole_job(), vec![1], no_inputs(), Vec::new());
    let bytes = recording(&of, 0, None).to_bytes().unwrap();
    let mut topics = HashMap::new();
    for_each_message(
        &bytes,
        |error| error,
        |message| {
            *topics.entry(message.topic).or_insert(0) += 1;
            Ok(())
        },
    )
    .unwrap();
    assert!(!topics.contains_key("/tf") && !topics.contains_key("/robot_description"), "{topics:?}");
    assert_eq!(topics["/joint_states"], recording(&of, 0, None).records.len());
}
