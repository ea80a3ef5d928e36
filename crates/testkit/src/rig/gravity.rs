//! Step 2: do torque signs, gravity and the declared mounting agree? Nothing moves.

use super::verdict::Verdict;
use super::{Given, Rig};
use clap::Args;
use plumbline::store::ModelFile;
use plumbline_core::{Backend, BadInput, JointVec};
use plumbline_franka::{Connection, Purpose};
use plumbline_identify::{Pose, direction, wrong_sign};
use plumbline_model::Mounting;
use std::error::Error;
use std::path::PathBuf;

/// States that are averaged: 2 s.
const STATES: usize = 2000;
/// Standard deviation of a torque at rest from stiction and sensor offset: the arm's joints and the wrist's \[Nm\].
const SIGMA: [f64; 7] = [0.8, 0.8, 0.8, 0.8, 0.3, 0.3, 0.3];
/// Angle that gravity may be off by, and how many standard deviations.
const ANGLE: f64 = 10.0;
const DEVIATIONS: f64 = 3.0;
/// Tolerance of the magnitude of gravity, a ratio.
const STRENGTH: f64 = 0.15;
const PANDA: &str = include_str!("../../../../config/models/panda-paper-table3.toml");

#[derive(Args, Clone)]
pub struct Options {
    #[command(flatten)]
    pub given: Given,
    /// Model that holds in any mounting; the published one of the Panda where the robot is one
    #[arg(long)]
    model: Option<PathBuf>,
}

/// Reads states and compares their torques with the model's.
pub fn run(rig: &Rig, options: &Options) -> Result<Verdict, Box<dyn Error>> {
    let (file, text) = match &options.model {
        Some(path) => (path.display().to_string(), std::fs::read_to_string(path)?),
        None if rig.robot.name == "panda" => ("panda-paper-table3.toml".to_string(), PANDA.to_string()),
        None => {
            return Err(format!(
                "--model: there is no published model of `{}`; give one that was identified",
                rig.robot.name
            )
            .into());
        }
    };
    let model = ModelFile::parse(&file, &text, |name| {
        let chain = rig.robot.chain.clone();
        (name == rig.robot.name)
            .then_some(chain)
            .ok_or_else(|| BadInput::new(&file, "key `robot`", name, rig.robot.name.clone()))
    })?;
    model.model.valid_in(&rig.job.mounting)?;

    println!("reading {} s of states; nothing moves", STATES / 1000);
    let (mut arm, Connection { info, .. }) =
        plumbline_franka::connect(&rig.franka.settings(&rig.job, Purpose::Monitor)?)?;
    println!("connected to {}", info.image);
    let pose = mean(&mut arm)?;
    let declared = rig.job.mounting;
    let found = direction(&model.model, &[pose], &SIGMA)?;
    let degrees = |angle: f64| angle.to_degrees();
    println!("declared mounting: {declared}");
    println!(
        "gravity by the torques: {}, {:.1} +- {:.1} degrees from the declared one, {:.2} of its strength",
        found.mounting(),
        degrees(found.angle_to(&declared)),
        degrees(found.std()),
        found.strength()
    );
    println!("{:>6} {:>12} {:>12} {:>12}", "joint", "measured", "declared", "difference");
    let expected = model
        .model
        .evaluator(&declared.gravity())
        .torque(&plumbline_model::term::Sample { q: pose.q, ..Default::default() })
        .0;
    for (j, (measured, expected)) in pose.tau.iter().zip(expected).take(SIGMA.len()).enumerate() {
        println!("{:>6} {measured:>9.2} Nm {expected:>9.2} Nm {:>9.2} Nm", j + 1, measured - expected);
    }
    let mut reasons = Vec::new();
    if let Some(joint) = wrong_sign(&model.model, &[pose], &SIGMA)? {
        reasons.push(format!(
            "the torque of joint {} agrees with gravity only with the other sign: have the sensor looked at",
            joint + 1
        ));
    }
    let most = f64::max(ANGLE.to_radians(), DEVIATIONS * found.std());
    if found.angle_to(&declared) > most {
        reasons.push(format!(
            "by the torques gravity is {:.1} degrees off the declared mounting (at most {:.1}): `mounting` should rather be {}",
            degrees(found.angle_to(&declared)),
            degrees(most),
            found.mounting()
        ));
    }
    if (found.strength() - 1.0).abs() > STRENGTH {
        reasons.push(format!(
            "the torques are those of {:.2} times the gravity: a load that the model does not know, or torques that are not the arm's",
            found.strength()
        ));
    }
    match info.gravity {
        Some(own) if own.source == plumbline_franka::Source::Accelerometers => {
            let own = Mounting::along(&own.direction.into());
            println!(
                "gravity by the robot's accelerometers: {own}, {:.1} degrees from the declared one",
                degrees(own.angle_to(&declared))
            );
            if own.angle_to(&declared) > ANGLE.to_radians() {
                reasons.push(format!("by the robot's accelerometers `mounting` should rather be {own}"));
            }
        }
        _ => println!("the robot has no accelerometers to ask"),
    }
    Ok(Verdict::of(reasons, "torques, gravity and the declared mounting agree".into()))
}

fn mean(arm: &mut impl Backend) -> Result<Pose, Box<dyn Error>> {
    let mut sum = Pose { q: JointVec::default(), tau: JointVec::default() };
    for _ in 0..STATES {
        let state = arm.read()?;
        for j in 0..SIGMA.len() {
            sum.q[j] += state.q[j] / STATES as f64;
            sum.tau[j] += state.tau[j] / STATES as f64;
        }
    }
    Ok(sum)
}
