//! Before anything is served: declared, measured and implied directions of gravity have to agree.

use nalgebra::Vector3;
use plumbline::store::ModelFile;
use plumbline_core::JointVec;
use plumbline_identify::{Disagreement, GravitySource, Pose, cross_check, implied_gravity};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot, TorqueModel};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/config/models/panda-paper-table3.toml");
const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
const NOISE: [f64; 7] = [0.05; 7];
const TOLERANCE: f64 = 5.0 * std::f64::consts::PI / 180.0;

fn panda() -> TorqueModel {
    let text = std::fs::read_to_string(PATH).unwrap();
    let chain = |_: &str| Ok(Robot::load("panda", None).unwrap().chain);
    ModelFile::parse(PATH, &text, chain).unwrap().model
}

fn at_rest(model: &TorqueModel, mounting: &Mounting, q: JointVec) -> Pose {
    let sample = Sample { q, ..Sample::default() };
    Pose { q, tau: model.evaluator(&mounting.gravity()).torque(&sample).0 }
}

fn tilted(mounting: Mounting, degrees: f64) -> Mounting {
    Mounting { rho: mounting.rho - degrees.to_radians(), ..mounting }
}

fn sensor(mounting: &Mounting, degrees: f64) -> GravitySource {
    GravitySource { name: "the inclinometer", gravity: mounting.gravity(), std: degrees.to_radians() }
}

#[test]
fn three_sides_that_agree_pass_and_the_one_that_is_off_is_named_with_its_angle() {
    let model = panda();
    for base in [Mounting::UPRIGHT, Mounting::WALL, Mounting { rho: 2.0, phi: 0.7 }] {
        for off in [0.0, 4.0, -4.0, 12.0, -30.0] {
            let other = tilted(base, off);
            let torques = |mounting: &Mounting| {
                implied_gravity(&model, &[at_rest(&model, mounting, READY)], &NOISE).unwrap().unwrap()
            };
            let cases = [
                ("the declared mounting", [GravitySource::declared(&other), sensor(&base, 0.2), torques(&base).side]),
                ("the inclinometer", [GravitySource::declared(&base), sensor(&other, 0.2), torques(&base).side]),
                (
                    "what the torques at rest imply",
                    [GravitySource::declared(&base), sensor(&base, 0.2), torques(&other).side],
                ),
            ];
            for (name, sides) in cases {
                match cross_check(&sides, TOLERANCE) {
                    Ok(pairs) => {
                        assert!(f64::abs(off) < 5.0 && pairs.len() == 3, "{name}, {off} deg at {base}: {pairs:?}")
                    }
                    Err(Disagreement::Off { side, off: by, .. }) => {
                        assert!(side.name == name && f64::abs(off) > 5.0, "{name}, {off} deg at {base}");
                        assert!((by.to_degrees() - f64::abs(off)).abs() < 0.1, "{by} {off}");
                    }
                    Err(other) => panic!("{name}, {off} deg at {base}: {other}"),
                }
            }
        }
    }
}

#[test]
fn the_words_say_who_and_by_how_much() {
    let model = panda();
    let poses = [at_rest(&model, &Mounting::WALL, READY)];
    let torques = implied_gravity(&model, &poses, &NOISE).unwrap().unwrap();
    let sides = [GravitySource::declared(&Mounting::WALL), sensor(&tilted(Mounting::WALL, 9.0), 0.3), torques.side];
    let message = cross_check(&sides, TOLERANCE).unwrap_err().to_string();
    for part in [
        "the inclinometer is off by 9.00 deg",
        "5.00 deg",
        "the declared mounting and the inclinometer: 9.00 +- 0.30 deg",
    ] {
        assert!(message.contains(part), "no `{part}` in {message}");
    }
    // Two that disagree: nobody can say who is wrong.
    let two = [GravitySource::declared(&Mounting::WALL), sensor(&Mounting::UPRIGHT, 0.3)];
    let message = cross_check(&two, TOLERANCE).unwrap_err();
    assert!(
        matches!(message, Disagreement::Unclear { .. }) && message.to_string().contains("90.00 +- 0.30 deg"),
        "{message}"
    );
    // Three of which no two agree: likewise.
    let three = [
        GravitySource::declared(&Mounting::WALL),
        sensor(&Mounting::UPRIGHT, 0.3),
        GravitySource { name: "c", ..sensor(&Mounting::CEILING, 0.3) },
    ];
    assert!(matches!(cross_check(&three, TOLERANCE), Err(Disagreement::Unclear { .. })));
    // One alone agrees with itself.
    assert_eq!(cross_check(&two[..1], TOLERANCE), Ok(vec![]));
    // A direction that is no number agrees with nobody.
    let nan = GravitySource { name: "c", gravity: Vector3::from_element(f64::NAN), std: 0.0 };
    assert!(cross_check(&[two[0], nan], TOLERANCE).is_err());
    assert!(cross_check(&[two[0], GravitySource { std: f64::NAN, ..two[0] }], TOLERANCE).is_err());
}

#[test]
fn uncertainty_is_taken_into_account() {
    let sides = |std: f64| [GravitySource::declared(&Mounting::UPRIGHT), sensor(&tilted(Mounting::UPRIGHT, 6.0), std)];
    assert!(cross_check(&sides(0.2), TOLERANCE).is_err());
    assert!(cross_check(&sides(0.6), TOLERANCE).is_ok());
}

#[test]
fn noise_and_friction_that_holds_the_arm_do_not_raise_a_false_alarm() {
    let model = panda();
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let (mut alarms, mut worst) = (0, 0f64);
    for _ in 0..300 {
        let base = Mounting { rho: rng.random_range(0.0..3.1), phi: rng.random_range(-3.0..3.0) };
        let mut pose = at_rest(&model, &base, READY);
        for tau in pose.tau.iter_mut().take(7) {
            *tau += rng.random_range(-0.35..0.35);
        }
        let torques = implied_gravity(&model, &[pose], &NOISE).unwrap().unwrap();
        let pairs = cross_check(&[GravitySource::declared(&base), torques.side], TOLERANCE);
        worst = worst.max(pairs.as_ref().map_or(f64::INFINITY, |pairs| pairs[0].angle));
        alarms += usize::from(pairs.is_err());
    }
    assert_eq!(alarms, 0, "worst {} deg", worst.to_degrees());
}

#[test]
fn an_upside_down_base_and_a_wrong_sign_are_found_without_any_motion() {
    let model = panda();
    let hanging = implied_gravity(&model, &[at_rest(&model, &Mounting::CEILING, READY)], &NOISE).unwrap().unwrap();
    let message =
        cross_check(&[GravitySource::declared(&Mounting::UPRIGHT), hanging.side], TOLERANCE).unwrap_err().to_string();
    assert!(message.contains("180.00"), "{message}");
    let mut pose = at_rest(&model, &Mounting::UPRIGHT, READY);
    pose.tau[3] = -pose.tau[3];
    let wrong = implied_gravity(&model, &[pose], &NOISE).unwrap().unwrap_err();
    assert_eq!(wrong, Disagreement::WrongSign { joint: 3 });
    assert!(wrong.to_string().contains("joint 4"), "{wrong}");
}

#[test]
fn a_payload_shows_as_strength_and_widens_the_uncertainty_instead_of_turning_gravity() {
    let model = panda();
    let right = at_rest(&model, &Mounting::UPRIGHT, READY);
    let mut loaded = right;
    for tau in &mut loaded.tau {
        *tau *= 1.4;
    }
    let found = implied_gravity(&model, &[loaded], &NOISE).unwrap().unwrap();
    assert!(
        (found.strength - 1.4).abs() < 0.1 && found.remark().is_some_and(|message| message.contains("payload")),
        "{found:?}"
    );
    assert_eq!(implied_gravity(&model, &[right], &NOISE).unwrap().unwrap().remark(), None);
}
