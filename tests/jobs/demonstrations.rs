//! The six demonstrations `config/demo-*.toml` as they are shipped: what the report says is compared with the arm file of the job.
//!
//! `hil/demonstrations/run.sh` runs them; with `SEED=n` on other motions and with other noise.

use nalgebra::Vector3;
use plumbline::report::Report;
use plumbline::report::diagnosis::{Diagnosis, Effect, Verdict};
use plumbline_model::Mounting;
use plumbline_model::term::mounting::axes;
use plumbline_testkit::job::*;
use std::process::Command;
use std::time::Instant;
use toml::Table;

/// Deviations that hold 99.9 % of a normal distribution.
const WIDE: f64 = 3.29;
/// Largest ratio of an unseen error after to the noise. The resonance of a link in its gap is the least certain.
const AT_THE_FLOOR: f64 = 1.15;

struct Shown {
    report: Report,
    diagnosis: Diagnosis,
    /// The effect of the arm file.
    truth: Table,
}

/// The job `config/demo-NAME.toml`, with a seed on other motions and with other noise.
pub fn demonstration(place: &Place, name: &str, seed: Option<&str>) -> Command {
    let mut command = plumbline();
    command.args(["run", "--verbose", &format!("config/demo-{name}.toml"), "--out"]).arg(place.out());
    command.arg("--set").arg(format!("serve.id={}", place.id));
    if let Some(seed) = seed {
        for key in ["backend", "excitation", "validation"] {
            command.arg("--set").arg(format!("{key}.seed={seed}"));
        }
    }
    command
}

/// Runs a job and checks what all of them show: one effect, the truth's, in the first lines, and unseen errors at the noise.
fn shown(name: &str, found_by: &str, joints: &[usize]) -> Shown {
    let place = Place::new(&format!("demo-{name}"));
    let command = demonstration(&place, name, std::env::var("SEED").ok().as_deref());
    let start = Instant::now();
    let done = Done::of(command).expect_code(0);
    let first: Vec<&str> = done.out.lines().skip(1).take(2).collect();
    println!("\n{name}, {:.0} s\n    {}", start.elapsed().as_secs_f64(), first.join("\n    "));

    let report = place.report();
    let diagnosis = report.diagnosis.clone().unwrap_or_else(|| panic!("no diagnosis: {}", done.output()));
    let found: Vec<(&str, &[usize])> =
        diagnosis.effects.iter().map(|effect| (effect.id.as_str(), effect.joints.as_slice())).collect();
    assert_eq!((diagnosis.verdict, found), (Verdict::Diagnosed, vec![(found_by, joints)]), "{}", done.output());
    assert!(diagnosis.unexplained.is_empty() && diagnosis.disagreements.is_empty(), "{}", done.output());
    let effect = &diagnosis.effects[0];
    assert!(effect.confirmed && effect.counts() && effect.alternatives.is_empty(), "{effect:#?}");

    assert!(first[0].starts_with(&format!("diagnosis: {} ", found_by.replace('-', " "))), "{}", first[0]);
    let error = "error on unseen runs, worst joint (";
    assert!(first[1].starts_with(error) && first[1].contains("unmodelled torque of the mean period"), "{}", first[1]);
    for (j, (after, floor)) in diagnosis.after.validate_rms.iter().zip(&diagnosis.noise_floor).enumerate() {
        assert!(*after < AT_THE_FLOOR * floor, "joint {}: {after} Nm, noise {floor}", j + 1);
    }
    let unmodelled = diagnosis.joints.iter().map(|facts| facts.unmodelled);
    let most = unmodelled.max_by(|a, b| a.before.unwrap().total_cmp(&b.before.unwrap())).unwrap();
    assert!(most.before.unwrap() > 10.0 * most.after.unwrap(), "{most:?}");

    let arm = std::fs::read_to_string(plumbline_testkit::path(format!("config/arms/demo-{name}.toml"))).unwrap();
    let mut arm: Table = arm.parse().unwrap();
    let effects = arm.remove("effect").unwrap().as_array().unwrap().clone();
    assert_eq!(effects.len(), 1);
    let truth = effects[0].as_table().unwrap().clone();
    if let Some(joint) = truth.get("joint") {
        assert_eq!(joint.as_integer().unwrap(), joints[0] as i64);
    }
    Shown { report, diagnosis, truth }
}

impl Shown {
    fn effect(&self) -> &Effect {
        &self.diagnosis.effects[0]
    }

    /// A number of the arm file.
    fn truth(&self, key: &str) -> f64 {
        self.truth[key].as_float().unwrap()
    }

    fn truths(&self, key: &str) -> Vec<f64> {
        self.truth[key].as_array().unwrap().iter().map(|value| value.as_float().unwrap()).collect()
    }

    /// A parameter that was found, and its standard deviation.
    fn found(&self, name: &str) -> (f64, f64) {
        let parameter = self.effect().parameters.0.iter().find(|parameter| parameter.name == name);
        let parameter = parameter.unwrap_or_else(|| panic!("no {name} in {:#?}", self.effect()));
        (parameter.value, parameter.std.unwrap_or(0.0))
    }

    /// A parameter is the truth: within its 99.9 % interval, or within `share` of it, for what the effect's law leaves out.
    #[track_caller]
    fn is(&self, name: &str, truth: f64, share: f64) {
        let (value, std) = self.found(name);
        let off = (value - truth).abs();
        assert!(off < WIDE * std || off < share * truth.abs(), "{name}: {value} +- {std}, true {truth}");
        assert!(std < 0.1 * truth.abs(), "{name}: {value} +- {std} is not known well");
    }
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn a_bottle_is_weighed() {
    let shown = shown("payload", "payload", &[]);
    shown.is("mass", shown.truth("mass"), 0.01);
    for (axis, truth) in ["com_x", "com_y", "com_z"].iter().zip(shown.truths("com")) {
        let (value, std) = shown.found(axis);
        assert!((value - truth).abs() < WIDE * std + 0.001, "{axis}: {value} +- {std} m, true {truth}");
    }
    let acts = shown.effect().acts.as_ref().unwrap();
    assert!(acts.run == "identify-upright-2.csv" && acts.from == 0.0 && acts.to_end_of_recording, "{acts:?}");
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn a_wall_out_of_plumb_is_measured() {
    let shown = shown("tilt", "mounting", &[]);
    let tilt = Vector3::from_vec(shown.truths("tilt"));
    // The base is tilted: gravity turns the other way.
    for (name, axis) in ["tilt_a", "tilt_b"].iter().zip(axes(&Mounting::WALL.gravity())) {
        shown.is(name, -axis.dot(&tilt), 0.01);
    }
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn play_in_a_worn_gear_is_measured() {
    let shown = shown("backlash", "backlash", &[6]);
    // The parameter is half of the gap.
    shown.is("gap6", 0.5 * shown.truth("gap"), 0.03);
    shown.is("width", shown.truth("load"), 0.1);
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn a_sensor_that_reads_too_much_is_named() {
    let shown = shown("torque-gain", "torque-gain", &[2]);
    shown.is("gain2", shown.truth("gain") - 1.0, 0.02);
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn a_hose_is_a_spring() {
    let shown = shown("hose", "spring", &[6]);
    let (stiffness, rest) = (shown.truth("stiffness"), shown.truth("rest"));
    shown.is("spring6", stiffness, 0.01);
    shown.is("spring6_preload", -stiffness * rest, 0.01);
}

#[test]
#[ignore = "hil/demonstrations/run.sh"]
fn a_joint_that_warms_up_is_found() {
    let shown = shown("hot-joint", "friction-drift", &[1]);
    let time = shown.found("T").0;
    assert!((time / shown.truth("time") - 1.0).abs() < 0.3, "{time} s");
    // The recording begins some seconds after the arm was switched on, and ends before the joint is as warm as it gets.
    let cold = plumbline_testkit::sim::arm("sim-panda").joints[0].fc;
    let (falls, std) = shown.found("fc");
    let begin = 1.0 - falls / (shown.truth("share") * cold);
    assert!(begin > -WIDE * std / (0.5 * cold) && begin < 0.4, "the share of the drift before the recording: {begin}");
    let parameters = &shown.report.base.parameters;
    let warm = parameters.iter().find(|parameter| parameter.name == "fc1").unwrap().value;
    let end = (1.0 + shown.truth("share")) * cold;
    assert!(warm > end - 0.01 && warm < end + 0.06, "{warm} Nm at the recording's end, {end} in the end");
}
