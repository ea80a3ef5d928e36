//! The body on the last link in makers' formats, read back: with it on the flange the arm has the torques of the model.

use nalgebra::{DVector, Matrix3, Rotation3, Vector3};
use plumbline::store::export::load::{Maker, possible, seen_from_flange, write};
use plumbline_model::{Body, Chain, LinkParameters, Placement, Robot, rnea};
use plumbline_testkit::arms::draw;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Numbers of a text, in its order.
fn numbers(text: &str) -> Vec<f64> {
    let is_part = |c: char| c.is_ascii_digit() || "+-.eE".contains(c);
    text.split(|c| !is_part(c)).filter_map(|word| word.parse().ok()).collect()
}

/// The body that a controller reads.
fn read(maker: Maker, text: &str) -> Body {
    let symmetric = |six: &[f64]| Matrix3::new(six[0], six[3], six[4], six[3], six[1], six[5], six[4], six[5], six[2]);
    match maker {
        Maker::FrankaDesk => {
            let json: serde_json::Value = serde_json::from_str(text).unwrap();
            let list = |key: &str| -> Vec<f64> { serde_json::from_value(json[key].clone()).unwrap() };
            assert_eq!(list("transformation"), nalgebra::Matrix4::<f64>::identity().as_slice());
            let mass = json["mass"].as_f64().unwrap();
            Body { mass, com: Vector3::from_vec(list("centerOfMass")), inertia: Matrix3::from_vec(list("inertia")) }
        }
        Maker::Libfranka => {
            let all = numbers(text.strip_prefix("robot.setLoad").unwrap());
            assert_eq!(all.len(), 13, "{text}");
            Body {
                mass: all[0],
                com: Vector3::from_row_slice(&all[1..4]),
                inertia: Matrix3::from_column_slice(&all[4..]),
            }
        }
        Maker::Ur => {
            let all = numbers(text.strip_prefix("set_target_payload").unwrap());
            assert_eq!(all.len(), 10, "{text}");
            Body { mass: all[0], com: Vector3::from_row_slice(&all[1..4]), inertia: symmetric(&all[4..]) }
        }
        Maker::Kuka => {
            // Letters before the numbers: M, X Y Z A B C, X Y Z.
            let all = numbers(text.strip_prefix("LOAD_DATA[1]=").unwrap());
            assert_eq!(all.len(), 10, "{text}");
            let [a, b, c] = [all[4], all[5], all[6]].map(f64::to_radians);
            // Rz(A) Ry(B) Rx(C).
            let axes = *Rotation3::from_euler_angles(c, b, a).matrix();
            let moments = Matrix3::from_diagonal(&Vector3::from_row_slice(&all[7..]));
            Body {
                mass: all[0],
                com: Vector3::from_row_slice(&all[1..4]) * 1e-3,
                inertia: axes * moments * axes.transpose(),
            }
        }
    }
}

const MAKERS: [Maker; 4] = [Maker::FrankaDesk, Maker::Libfranka, Maker::Ur, Maker::Kuka];

/// A flange that is turned and moved, as no shipped robot has one: frames that are mixed up give other torques.
fn turned_panda() -> Chain {
    let panda = Robot::load("panda", None).unwrap().chain;
    let rotation = *Rotation3::from_euler_angles(0.3, -0.7, 1.9).matrix();
    Chain::modified(panda.joints().to_vec(), Placement { rotation, origin: Vector3::new(0.02, -0.03, 0.107) })
}

/// The arm with the flange as an eighth link that does not move, which has the body: another way than parameters of the seventh link.
fn torque_with_flange(chain: &Chain, body: &Body, gravity: &Vector3<f64>, [q, dq, ddq]: [&[f64]; 3]) -> DVector<f64> {
    let mut links = vec![[0.0; 10]; chain.len()];
    // The points of a body: three pairs of masses on its principal axes, each placed in the last link's frame and added as point masses.
    let (moments, axes) = body.principal().unwrap();
    let second =
        [moments.y + moments.z - moments.x, moments.x + moments.z - moments.y, moments.x + moments.y - moments.z];
    let flange = chain.flange();
    let last = links.last_mut().unwrap();
    for (axis, second) in second.into_iter().enumerate() {
        // sum m d^2 = second / 2 along this axis, with a third of the mass.
        let distance = (1.5 * second / body.mass).max(0.0).sqrt();
        for side in [-1.0, 1.0] {
            let at = body.com + axes.column(axis) * (side * distance);
            let at = flange.rotation * at + flange.origin;
            let m = body.mass / 6.0;
            let add: LinkParameters = [
                m * (at.y * at.y + at.z * at.z),
                -m * at.x * at.y,
                -m * at.x * at.z,
                m * (at.x * at.x + at.z * at.z),
                -m * at.y * at.z,
                m * (at.x * at.x + at.y * at.y),
                m * at.x,
                m * at.y,
                m * at.z,
                m,
            ];
            last.iter_mut().zip(add).for_each(|(sum, own)| *sum += own);
        }
    }
    let mut tau = DVector::zeros(chain.len());
    rnea(chain, &links, gravity, q, dq, ddq, tau.as_mut_slice());
    tau
}

#[test]
fn what_a_controller_reads_gives_the_torques_of_the_model() {
    let chain = turned_panda();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..20 {
        let com = Vector3::from_vec(draw(&mut rng, 3, 0.1));
        let axes = Rotation3::from_euler_angles(draw(&mut rng, 1, 3.0)[0], 0.4, draw(&mut rng, 1, 3.0)[0]);
        let moments = Matrix3::from_diagonal(&Vector3::new(0.002, 0.0035, 0.0041));
        let link = Body { mass: 0.73, com, inertia: axes * moments * axes.inverse() }.link_parameters();
        let body = seen_from_flange(&chain, &link).unwrap();
        assert_eq!(possible(body).1, None);
        let gravity = Vector3::from_vec(draw(&mut rng, 3, 9.0));
        let [q, dq, ddq] = [3.0, 2.0, 5.0].map(|span| draw(&mut rng, 7, span));
        let mut links = vec![[0.0; 10]; 7];
        links[6] = link;
        let mut expected = DVector::zeros(7);
        rnea(&chain, &links, &gravity, &q, &dq, &ddq, expected.as_mut_slice());
        for maker in MAKERS {
            let text = write(maker, &body).text;
            let found = torque_with_flange(&chain, &read(maker, &text), &gravity, [&q, &dq, &ddq]);
            assert!((&found - &expected).amax() < 1e-9 * expected.amax(), "{maker:?}: {text}");
        }
    }
}

#[test]
fn an_inertia_of_noise_becomes_that_of_a_body_and_no_mass_is_refused() {
    let of = |x: f64, y: f64, z: f64| Body {
        mass: 0.5,
        com: Vector3::zeros(),
        inertia: Matrix3::from_diagonal(&Vector3::new(x, y, z)),
    };
    for (found, expected) in [((-1e-4, 2e-3, 1e-3), (0.0, 1e-3, 1e-3)), ((1e-3, 1e-3, 3e-3), (1e-3, 1e-3, 2e-3))] {
        let (body, note) = possible(of(found.0, found.1, found.2));
        assert!((body.inertia - of(expected.0, expected.1, expected.2).inertia).amax() < 1e-15, "{}", body.inertia);
        assert!(note.unwrap().contains("no body has"));
    }
    let chain = turned_panda();
    assert!(seen_from_flange(&chain, &[0.0; 10]).is_none());
    assert!(seen_from_flange(&chain, &[f64::NAN; 10]).is_none());
}
