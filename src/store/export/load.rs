//! The body on the last link in the formats of robot makers.
//!
//! | format | frame | inertia | source |
//! |---|---|---|---|
//! | Franka Desk, end effector | flange | about the centre of mass, column after column | Desk, Settings, End effector: keys of frankaemika/external_gripper_example |
//! | libfranka `setLoad` | flange | about the centre of mass, column after column | libfranka, robot.h |
//! | UR `set_target_payload` | tool flange | about the centre of mass, `[Ixx, Iyy, Izz, Ixy, Ixz, Iyz]` | URScript manual |
//! | KUKA `LOAD` | flange, lengths in mm | principal moments, their axes by `A B C` in degrees, `R = Rz(A) Ry(B) Rx(C)` | KRL: `STRUC LOAD REAL M, FRAME CM, INERTIA J` |

use super::{Exported, rpy};
use nalgebra::Matrix3;
use plumbline_model::{Body, Chain, LinkParameters, Placement};

/// A maker's format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Maker {
    FrankaDesk,
    Libfranka,
    Ur,
    Kuka,
}

/// Mass above which a body is one \[kg\].
const LEAST_MASS: f64 = 1e-6;

/// The body of the last link's parameters in the frame of the flange. `None` where its mass is not positive.
pub fn seen_from_flange(chain: &Chain, link: &LinkParameters) -> Option<Body> {
    let flange = chain.flange();
    let turned = flange.rotation.transpose();
    let back = Placement { rotation: turned, origin: -(turned * flange.origin) };
    (link[9] > LEAST_MASS && link.iter().all(|value| value.is_finite())).then(|| Body::of(link).seen_from(&back))
}

/// The nearest body that a controller takes, with a note where it is another one.
///
/// Moments of inertia of noise may be those of no body. Principal moments are raised to at least zero, and the largest is at most the sum of the other two.
pub fn possible(found: Body) -> (Body, Option<String>) {
    let Some((moments, axes)) = found.principal() else { return (found, None) };
    let mut raised = moments.map(|moment| moment.max(0.0));
    let largest = raised.imax();
    let others = raised.sum() - raised[largest];
    raised[largest] = raised[largest].min(others);
    if (raised - moments).amax() <= 1e-12 * moments.amax() {
        return (found, None);
    }
    let inertia = axes * Matrix3::from_diagonal(&raised) * axes.transpose();
    let note = format!(
        "no body has the inertia that was found: its principal moments {:?} kg m2 are replaced by {:?} kg m2",
        moments.as_slice(),
        raised.as_slice()
    );
    (Body { inertia: 0.5 * (inertia + inertia.transpose()), ..found }, Some(note))
}

/// The text of a body in the frame of the flange.
pub fn write(maker: Maker, body: &Body) -> Exported {
    let (mass, com, inertia) = (body.mass, body.com, body.inertia);
    let list = |values: &[f64]| values.iter().map(|value| format!("{:?}", value + 0.0)).collect::<Vec<_>>().join(", ");
    // Column after column.
    let columns = list(inertia.as_slice());
    let position = list(com.as_slice());
    let mut notes = Vec::new();
    let text = match maker {
        Maker::FrankaDesk => {
            notes.push("`transformation` is the identity: enter the pose of your tool's frame in the flange's".into());
            notes.push(
                "Desk's end effector replaces the one that is set there: this file has the identified body alone"
                    .into(),
            );
            let identity = list(nalgebra::Matrix4::<f64>::identity().as_slice());
            format!(
                "{{\"mass\": {mass:?}, \"centerOfMass\": [{position}], \"transformation\": [{identity}], \"inertia\": [{columns}]}}\n"
            )
        }
        Maker::Libfranka => format!("robot.setLoad({mass:?}, {{{{{position}}}}}, {{{{{columns}}}}});\n"),
        Maker::Ur => {
            let i = &inertia;
            let six = list(&[i[(0, 0)], i[(1, 1)], i[(2, 2)], i[(0, 1)], i[(0, 2)], i[(1, 2)]]);
            notes.push(
                "the payload replaces the one that is set: add a tool that was mounted at the identification".into(),
            );
            format!("set_target_payload({mass:?}, [{position}], [{six}])\n")
        }
        Maker::Kuka => {
            // Principal frames differ by order and sign of the axes; all are right.
            let (moments, axes) = body.principal().unwrap_or((inertia.diagonal(), Matrix3::identity()));
            let [c, b, a] = rpy(&axes).map(f64::to_degrees);
            let [x, y, z] = [com.x, com.y, com.z].map(|metres| 1e3 * metres + 0.0);
            let [jx, jy, jz] = [moments.x, moments.y, moments.z].map(|moment| moment + 0.0);
            notes.push(
                "replace 1 by the number of your tool; Sunrise takes the same numbers as load data of the tool".into(),
            );
            format!(
                "LOAD_DATA[1]={{M {mass:?},CM {{X {x:?},Y {y:?},Z {z:?},A {a:?},B {b:?},C {c:?}}},J {{X {jx:?},Y {jy:?},Z {jz:?}}}}}\n"
            )
        }
    };
    Exported { text, notes }
}
