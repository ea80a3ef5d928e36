//! What changed since a model was identified, on simulated recordings whose truth is known.

use nalgebra::DMatrix;
use plumbline_diagnose::live::{self, Floor, Found, Remedy};
use plumbline_diagnose::reference::{Change, Changes, between_sessions, changes, extended, single_changes};
use plumbline_diagnose::{Settings, Trial};
use plumbline_identify::solve::identify;
use plumbline_identify::{Experiment, Run, validate};
use plumbline_model::{BaseKind, Chain, Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_sim::Truth;
use plumbline_testkit::scene::lab::{Noise, Period, period, plans};
use plumbline_testkit::sim::arm_with;
use std::sync::OnceLock;

const PAYLOAD: &str = "[[effect]]\nid = \"payload\"\nmass = 0.73\ncom = [0.0, 0.0, 0.15]\n\
    inertia = [0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017]\n";
const NOISE: Noise = Noise { coloured: 0.05 };
const PERIODS: usize = 6;

fn chain() -> &'static Chain {
    static CHAIN: OnceLock<Chain> = OnceLock::new();
    CHAIN.get_or_init(|| Robot::load("panda", None).unwrap().chain)
}

/// The shipped arm with more in its file.
fn truth(more: &str) -> Truth {
    arm_with("sim-panda", more)
}

/// The arm on a base that is turned by this rotation vector, in the base frame \[rad\].
fn tilted(tilt: [f64; 3]) -> Truth {
    truth(&format!("[[effect]]\nid = \"mounting\"\ntilt = {tilt:?}\n"))
}

/// Recordings of that arm: motions that identify, or others.
fn record(truth: &Truth, others: bool, count: usize, mounting: Mounting, seed: u64) -> Vec<Experiment> {
    recorded(truth, (others, count, PERIODS), mounting, seed, |_, run| run)
}

/// So many of the motions that identify, or of others, with so many periods, as they are after a change of each run.
fn recorded(
    truth: &Truth,
    (others, count, periods): (bool, usize, usize),
    mounting: Mounting,
    seed: u64,
    change: impl Fn(usize, Run) -> Run,
) -> Vec<Experiment> {
    let [identify, validate] = plans();
    let plans = if others { validate } else { identify };
    let one = |(k, plan)| {
        let period: Period = period(chain(), truth, plan, mounting, &format!("run {k}"));
        let run = change(k, period.record(truth, periods, NOISE, seed + k as u64));
        Experiment::prepare(&run, &plumbline_identify::Settings::default()).unwrap()
    };
    plans.iter().take(count).enumerate().map(one).collect()
}

fn model_from(kind: BaseKind, experiments: &[Experiment], mounting: Mounting) -> TorqueModel {
    let structure = Structure::of(chain().clone(), Reduction::of_kind(chain(), kind), &["friction"]).unwrap();
    let found = identify(&structure, experiments).unwrap();
    TorqueModel::new("panda", structure, vec![mounting], &found.values()).unwrap()
}

/// The arm as it was, identified on the wall.
fn stored() -> &'static TorqueModel {
    static MODEL: OnceLock<TorqueModel> = OnceLock::new();
    MODEL.get_or_init(|| {
        let experiments = record(&truth(""), false, 2, Mounting::WALL, 7);
        model_from(BaseKind::Gbs, &experiments, Mounting::WALL)
    })
}

fn trials(experiments: &[Experiment], session: u32) -> Vec<Trial<'_>> {
    experiments.iter().map(|experiment| Trial { experiment, session, start: 100.0 * session as f64 }).collect()
}

fn settings() -> Settings {
    Settings { threads: 2, ..Settings::default() }
}

fn found(model: &TorqueModel, experiments: &[Experiment]) -> Changes {
    changes(model, None, &trials(experiments, 1), &settings(), &|_| {})
}

fn names(found: &Changes) -> Vec<String> {
    found.effects.iter().map(|one| format!("{} {}", one.spec.family, one.spec.site)).collect()
}

/// Distance of a parameter from the truth in its standard deviations.
fn z(change: &Change, name: &str, truth: f64) -> f64 {
    let own = change.parameters.iter().find(|own| own.column.name == name).unwrap_or_else(|| panic!("no {name}"));
    (own.value - truth) / own.std.unwrap()
}

#[test]
fn a_payload_is_found_with_its_mass_and_the_model_that_carries_it_predicts() {
    let new = record(&truth(PAYLOAD), true, 2, Mounting::WALL, 107);
    let found = found(stored(), &new);
    assert_eq!(names(&found), ["payload the arm"]);
    let body = found.effects[0].quantities(&[], None);
    println!("payload of 0.73 kg at 0.15 m, 2 trajectories x {PERIODS} periods: {body:.5?}");
    // Mass, centre of mass, inertia: true value, and the largest standard deviation.
    let [mass, com, inertia] = [0.01, 0.005, 0.01];
    let expected =
        [(0.73, mass), (0.0, com), (0.0, com), (0.15, com), (0.001, inertia), (0.0, inertia), (0.0, inertia)];
    let expected = expected.into_iter().chain([(0.0025, inertia), (0.0, inertia), (0.0017, inertia)]);
    assert_eq!(body.len(), 10);
    for (quantity, (truth, widest)) in body.iter().zip(expected) {
        let std = quantity.std.unwrap();
        assert!(std < widest && (quantity.value - truth).abs() < 4.0 * std, "{quantity:?} for {truth}");
    }
    assert!(found.doubt.parameters.is_empty() && found.doubt.runs.is_empty());

    // Folded into the rigid bodies: as many parameters as before, and the error on unseen runs is that of a model of this very arm.
    let carrying = extended(stored(), &found.effects).unwrap();
    assert_eq!(carrying.parameters().len(), stored().parameters().len());
    let unseen = record(&truth(PAYLOAD), false, 1, Mounting::UPRIGHT, 207);
    let rms = |model: &TorqueModel| {
        let of = validate(&unseen[0], |motion| model.predict(motion)).filtered;
        of.iter().sum::<f64>() / of.len() as f64
    };
    let (before, after) = (rms(stored()), rms(&carrying));
    println!("upright, unseen, mean over joints in the 5 Hz band: {before:.3} -> {after:.3} Nm");
    assert!(before > 0.8 && after < 0.04, "{before} -> {after}");
}

/// The parameters' deviations by themselves would allow for all of its torque, their correlations do not.
#[test]
fn a_light_payload_shows_where_the_covariance_of_the_parameters_is_known() {
    let structure = stored().structure();
    let identification = identify(structure, &record(&truth(""), false, 2, Mounting::WALL, 7)).unwrap();
    let payload = |mass: f64| {
        let body = format!("[[effect]]\nid = \"payload\"\nmass = {mass}\ncom = [0.0, 0.0, 0.15]\n");
        truth(if mass > 0.0 { &body } else { "" })
    };
    let found = |mass: f64, seed: u64, covariance: Option<&DMatrix<f64>>| {
        let new = record(&payload(mass), true, 2, Mounting::WALL, seed);
        names(&changes(stored(), covariance, &trials(&new, 1), &settings(), &|_| {}))
    };
    for seed in [117, 127, 137] {
        assert_eq!(found(0.015, seed, Some(&identification.covariance)), ["payload the arm"], "{seed}");
        assert!(found(0.015, seed, None).is_empty() && found(0.0, seed, Some(&identification.covariance)).is_empty());
    }
}

/// What the live watch does with a change: the model with it holds, the one without it does not, and what is known of it tells how far two models
/// from other noise are apart.
#[test]
fn how_well_a_change_is_known_tells_the_error_of_its_torque() {
    let as_it_was = record(&truth(""), true, 2, Mounting::WALL, 507);
    let floor = Floor::of(stored(), &as_it_was[1]);
    let remedy = |seed: u64| -> (Box<Remedy>, Vec<Experiment>) {
        let new = record(&truth(PAYLOAD), true, 2, Mounting::WALL, seed);
        match live::search(stored(), stored(), &new[0], &new[1], &floor, &settings()) {
            Found::Remedy(remedy) => (remedy, new),
            other => panic!("{other:?}"),
        }
    };
    let ((one, new), (other, _)) = (remedy(607), remedy(617));
    let holds = |model: &TorqueModel, motion: &Experiment, seconds: f64| live::holds(model, motion, &floor, seconds);
    assert!(holds(stored(), &as_it_was[1], 0.0) && holds(&one.model, &new[1], 0.0) && holds(&one.model, &new[1], 5.0));
    assert!(!holds(stored(), &new[1], 0.0) && !holds(&one.model, &as_it_was[1], 0.0));

    let unseen = &record(&truth(PAYLOAD), false, 1, Mounting::UPRIGHT, 707)[0];
    let samples = 0..unseen.motion.samples();
    let spread = live::spread(&one.deviations, unseen, samples.clone());
    let apart = live::rms(&(live::residual(&one.model, unseen) - live::residual(&other.model, unseen)), samples);
    println!("apart {apart:.4?}, known to {spread:.4?} Nm");
    // The last joint carries little of it.
    for joint in 0..6 {
        let ratio = apart[joint] / (spread[joint] * 2f64.sqrt());
        assert!((0.1..3.0).contains(&ratio), "joint {}: {} of {} Nm", joint + 1, apart[joint], spread[joint]);
    }
}

#[test]
fn a_change_is_found_alone_and_only_above_what_the_model_lacks_by_itself() {
    let new = record(&truth(PAYLOAD), true, 1, Mounting::WALL, 807);
    let trials = [Trial::alone(&new[0])];
    let first = single_changes(stored(), &trials, &settings());
    assert_eq!(first[0].spec.family, "payload");
    let mass = extended(stored(), &first[..1]).unwrap();
    assert!(validate(&new[0], |motion| mass.predict(motion)).filtered[1] < 0.05);
    let found = |usual: f64| {
        let settings = Settings { usual: vec![usual; 7], ..settings() };
        changes(stored(), None, &trials, &settings, &|_| {}).effects.len()
    };
    assert_eq!([found(0.1), found(50.0)], [1, 0]);
}

/// What the live search names in the first of these motions and accepts in the second.
fn only_change(new: &[Experiment], floor: &Floor) -> Change {
    let found = live::search(stored(), stored(), &new[0], &new[1], floor, &settings());
    let Found::Remedy(remedy) = found else { panic!("{found:?}") };
    let [change] = &remedy.changes[..] else { panic!("{:?}", remedy.changes) };
    change.clone()
}

/// A hose that pulls with 1 Nm and a little more where it is stretched: the pull alone takes most of the error in a motion without repeats, whose noise
/// is unknown. What is usual tells that something is left.
#[test]
fn what_is_usual_tells_two_changes_apart_that_are_nearly_as_good() {
    let once = |truth: &Truth, seed: u64| {
        recorded(truth, (true, 2, 2), Mounting::WALL, seed, |_, run| Run { period: None, ..run })
    };
    let floor = Floor::of(stored(), &once(&truth(""), 507)[1]);
    for (stiffness, name) in [(0.05, "torque-offset"), (0.2, "spring")] {
        let rest = -1.7 - 1.0 / stiffness;
        let hose = format!("[[effect]]\nid = \"spring\"\njoint = 4\nstiffness = {stiffness}\nrest = {rest}\n");
        let new = once(&truth(&hose), 1107);
        let first = single_changes(stored(), &[Trial::alone(&new[0])], &settings());
        assert_eq!(first[0].spec.family, "torque-offset");
        let change = only_change(&new, &floor);
        assert_eq!(change.spec.family, name, "{}", change.line());
        let own = &change.parameters[0];
        let off = (own.value - stiffness) / own.std.unwrap();
        assert!(name != "spring" || off.abs() < 3.0, "{}", change.line());
    }
}

/// Joint 2 has twenty times the usual error of joint 7, before and after.
#[test]
fn a_change_in_a_quiet_joint_is_named_beside_a_loud_one() {
    let loud = |truth: &Truth, seed: u64| {
        recorded(truth, (true, 2, PERIODS), Mounting::WALL, seed, |k, mut run| {
            let beat = |(torque, t): (&mut f64, &f64)| *torque += 2.0 * (2.33 * t + k as f64).sin();
            run.tau.column_mut(1).iter_mut().zip(&run.t).for_each(beat);
            run
        })
    };
    let floor = Floor::of(stored(), &loud(&truth(""), 507)[1]);
    assert!(floor.usual[1] > 10.0 * floor.usual[6], "{:?}", floor.usual);
    let new = loud(&truth("[[effect]]\nid = \"torque-offset\"\njoint = 7\noffset = 0.1\n"), 1207);
    let change = only_change(&new, &floor);
    let own = &change.parameters[0];
    assert!(own.column.name == "offset7" && (own.value - 0.1).abs() < 3.0 * own.std.unwrap(), "{}", change.line());
}

#[test]
fn nothing_changed_is_nothing_significant_and_says_how_little_would_have_been_seen() {
    let new = record(&truth(""), true, 2, Mounting::WALL, 307);
    let found = found(stored(), &new);
    assert!(found.effects.is_empty(), "{:?}", names(&found));
    assert!(found.lack_of_fit.unwrap().iter().all(|both| both[0] < 2.0 && both[1] == both[0]));
    let offsets = &found.least.iter().find(|(id, _)| *id == "torque-offset").unwrap().1;
    assert!(offsets.iter().all(|rms| (0.005..0.2).contains(rms)), "{offsets:?}");
}

#[test]
fn each_kind_of_change_is_named() {
    // A tilt of half a degree about the axis that the arm stands on when it is upright, as the base frame has it.
    let tilt = 0.5_f64.to_radians();
    let mut slippery = truth("");
    (slippery.joints[3].fc, slippery.joints[3].fv) = (slippery.joints[3].fc * 2.0, slippery.joints[3].fv * 1.5);
    let cases = [
        ("mounting the arm", tilted([0.0, tilt, 0.0])),
        ("friction-change joint 4", slippery),
        ("torque-offset joint 2", truth("[[effect]]\nid = \"torque-offset\"\njoint = 2\noffset = 0.3\n")),
        ("torque-gain joint 1", truth("[[effect]]\nid = \"torque-gain\"\njoint = 1\ngain = 1.03\n")),
        ("spring joint 4", truth("[[effect]]\nid = \"spring\"\njoint = 4\nstiffness = 0.5\nrest = -2.0\n")),
    ];
    for (expected, arm) in cases {
        let new = record(&arm, true, 1, Mounting::WALL, 407);
        let found = found(stored(), &new);
        let said: Vec<String> = found
            .effects
            .iter()
            .flat_map(|one| &one.parameters)
            .map(|own| format!("{} {:.4} +- {:.4}", own.column.name, own.value, own.std.unwrap_or(f64::NAN)))
            .collect();
        println!("{expected}: {:?} {said:?}", names(&found));
        assert_eq!(names(&found), [expected]);
        let change = &found.effects[0];
        match expected {
            "mounting the arm" => {
                let size = change.parameters[0].value.hypot(change.parameters[1].value);
                assert!((size / tilt - 1.0).abs() < 0.1, "{size} rad for {tilt}");
            }
            "friction-change joint 4" => {
                assert!(z(change, "dfc4", 0.1604).abs() < 4.0 && z(change, "dfv4", 0.0262).abs() < 4.0);
                let model = extended(stored(), &found.effects).unwrap();
                let of = |model: &TorqueModel| {
                    model.parameters().iter().find(|own| own.column.name == "fc4").map(|own| own.value).unwrap()
                };
                assert!((of(&model) - of(stored()) - change.parameters[1].value).abs() < 1e-12);
            }
            "torque-offset joint 2" => assert!(z(change, "offset2", 0.3).abs() < 4.0),
            "torque-gain joint 1" => assert!(z(change, "gain1", 0.03).abs() < 4.0),
            _ => assert!((change.parameters[0].value - 0.5).abs() < 0.1, "{:?}", change.parameters),
        }
    }
}

/// The columns that the search tries are of first order in the tilt. What it delivers is exact.
#[test]
fn a_tilt_of_six_degrees_is_exact_and_another_is_added_to_it() {
    let mut model = stored().clone();
    for degrees in [6.0_f64, 6.5] {
        let new = record(&tilted([0.0, degrees.to_radians(), 0.0]), true, 1, Mounting::WALL, 907);
        let first = single_changes(&model, &[Trial::alone(&new[0])], &settings());
        assert_eq!(first[0].spec.family, "mounting");
        model = extended(&model, &first[..1]).unwrap();
        let rms = validate(&new[0], |motion| model.predict(motion)).filtered;
        let tilts: Vec<f64> = model.parameters()[stored().parameters().len()..].iter().map(|own| own.value).collect();
        let size = tilts[0].hypot(tilts[1]).to_degrees();
        println!("{degrees} degrees: {size:.4}, error {rms:.4?} Nm");
        assert!(tilts.len() == 2 && (size - degrees).abs() < 0.02, "{size} degrees for {degrees}");
        assert!(rms.iter().all(|rms| *rms < 0.05), "{rms:?}");
    }
}

/// Upright the first moments of link 1 do no work; tilted they do, and the model that was identified upright does not have them.
#[test]
fn a_tilt_of_an_arm_that_was_identified_upright_brings_its_first_link_to_bear() {
    let mounting = Mounting::UPRIGHT;
    let model = model_from(BaseKind::Vbs, &record(&truth(""), false, 2, mounting, 7), mounting);
    let tilt = [0.02_f64, 0.03];
    let new = record(&tilted([tilt[0], tilt[1], 0.0]), true, 1, mounting, 1007);
    let first = single_changes(&model, &[Trial::alone(&new[0])], &settings());
    assert_eq!(first[0].spec.family, "mounting");
    let model = extended(&model, &first[..1]).unwrap();
    let rms = validate(&new[0], |motion| model.predict(motion)).filtered;
    let size = first[0].parameters[0].value.hypot(first[0].parameters[1].value);
    println!("{size:.5} rad, {:?}, error {rms:.4?} Nm", first[0].parameters);
    assert!((size / tilt[0].hypot(tilt[1]) - 1.0).abs() < 0.01, "{size}");
    assert!(rms.iter().all(|rms| *rms < 0.05), "{rms:?}");
}

#[test]
fn what_was_never_identified_is_doubted_and_no_effect_is_blamed() {
    // A generalized structure identified upright: two of its parameters are anything.
    let upright = record(&truth(""), false, 2, Mounting::UPRIGHT, 507);
    let model = model_from(BaseKind::Gbs, &upright, Mounting::UPRIGHT);
    assert!(model.parameters().iter().any(|own| own.std.is_none()));
    let wall = record(&truth(""), true, 2, Mounting::WALL, 607);
    let found = found(&model, &wall);
    assert!(found.effects.is_empty(), "{:?}", names(&found));
    assert!(!found.doubt.parameters.is_empty(), "{:?}", found.doubt);
    for name in &found.doubt.parameters {
        let own = model.parameters().iter().find(|own| own.column.name == *name).unwrap();
        assert!(own.std.is_none(), "{name} was identified");
    }
    assert_eq!(found.doubt.runs, ["run 0", "run 1"]);
    // Where it was identified, it can be asked.
    let again = record(&truth(""), true, 2, Mounting::UPRIGHT, 707);
    let found = self::found(&model, &again);
    assert!(found.effects.is_empty() && found.doubt == Default::default(), "{:?} {:?}", names(&found), found.doubt);
}

#[test]
fn sessions_tell_a_payload_without_a_stored_model() {
    let first = record(&truth(""), false, 2, Mounting::WALL, 807);
    let second = record(&truth(PAYLOAD), true, 2, Mounting::WALL, 907);
    let all: Vec<Trial> = trials(&first, 1).into_iter().chain(trials(&second, 2)).collect();
    let structure = stored().structure();
    let found = between_sessions(structure, &all, &settings(), &|_| {});
    assert_eq!(names(&found), ["payload the arm"]);
    assert_eq!(found.effects[0].since, Some(2));
    let mass = found.effects[0].quantities(&[], None).swap_remove(0);
    assert!((mass.value - 0.73).abs() < 4.0 * mass.std.unwrap() && mass.std.unwrap() < 0.01, "{mass:?}");
    // In one session it can't be seen.
    assert!(between_sessions(structure, &trials(&second, 2), &settings(), &|_| {}).effects.is_empty());
}

#[test]
fn the_spread_of_parameters_is_that_of_the_torque() {
    let model = stored();
    let unseen = &record(&truth(""), true, 1, Mounting::WALL, 21)[0];
    let samples = 1000..4000;
    // Along one direction of the parameters the torque moves by its columns.
    let values: Vec<f64> = model.beta();
    let step: Vec<f64> = values.iter().enumerate().map(|(k, value)| 0.01 * (k as f64).sin() * value).collect();
    let moved: Vec<(f64, Option<f64>)> = values.iter().zip(&step).map(|(value, step)| (value + step, None)).collect();
    let moved = TorqueModel::new("panda", model.structure().clone(), vec![Mounting::WALL], &moved).unwrap();
    let apart = live::rms(&(moved.predict(&unseen.motion) - model.predict(&unseen.motion)), samples.clone());
    let step = nalgebra::DVector::from_vec(step);
    let covariance = &step * step.transpose();
    let spread = live::parameter_spread(model.structure(), &covariance, unseen, samples);
    for (spread, apart) in spread.iter().zip(&apart) {
        assert!((spread / apart - 1.0).abs() < 0.02, "{spread} and {apart}");
    }
}
