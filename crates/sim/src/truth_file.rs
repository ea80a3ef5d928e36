//! The file of a simulated arm: a TOML file with all keys, or one that extends the arm of another file (`base`).

use super::effect::EffectSpec;
use super::truth::{JointTruth, LinkTruth, Truth};
use plumbline_core::{BadInput, from_toml};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Keys of the file; those that are absent are the base's, or the defaults.
#[derive(Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct TruthFile {
    /// File of the arm that this one extends, relative to this file's folder.
    base: Option<PathBuf>,
    /// Name of the robot description whose kinematics it has.
    robot: Option<String>,
    /// Bodies, base first, one per joint.
    #[serde(rename = "link")]
    links: Option<Vec<LinkTruth>>,
    /// Friction, controller and sensors, base first, one per link.
    #[serde(rename = "joint")]
    joints: Option<Vec<JointTruth>>,
    /// Integration steps per millisecond: 4 where absent.
    substeps: Option<u32>,
    /// Probability that a burst of lost states begins at a state.
    drop_probability: Option<f64>,
    /// States lost in one burst.
    drop_burst: Option<u32>,
    /// Corner frequency of the coloured part of the torque sensors' noise \[Hz\].
    torque_noise_corner: Option<f64>,
    /// Probability that a joint's torque is an outlier in a state.
    outlier_probability: Option<f64>,
    /// Size of an outlier, up or down \[Nm\].
    outlier_size: Option<f64>,
    /// Probability that a state repeats the readings and the time stamp of the state before.
    repeat_probability: Option<f64>,
    /// Joints whose torque sensor is dead and reads 0 Nm, counted from 1.
    dead_torque_sensors: Option<Vec<usize>>,
    /// Effects beyond the rigid body, in the order in which they act.
    #[serde(default, rename = "effect")]
    effects: Vec<EffectSpec>,
}

impl Truth {
    /// Parses and checks the text of a truth file. `file` is its path: errors name it, and `base` is relative to its folder.
    ///
    /// With `base` the arm is that of the other file; keys of this file replace those of the base, and effects act after the base's.
    ///
    /// # Errors
    /// Other TOML than of this form, and impossible values: a mass that is not positive, an inertia that no distribution of mass has,
    /// negative friction or noise, an effect on a joint that does not exist. A base that cannot be read, or that has a base itself.
    pub fn parse(file: &str, text: &str) -> Result<Truth, BadInput> {
        from_toml::<TruthFile>(file, text)?.arm(file)
    }
}

impl TruthFile {
    /// The arm of this file, checked.
    fn arm(self, file: &str) -> Result<Truth, BadInput> {
        let base = self.base.as_deref().map(|base| base_of(file, base)).transpose()?;
        let absent =
            [("robot", self.robot.is_none()), ("link", self.links.is_none()), ("joint", self.joints.is_none())];
        if let Some((key, _)) = absent.iter().find(|(_, absent)| *absent && base.is_none()) {
            return Err(BadInput::new(
                file,
                format!("key `{key}`"),
                "nothing",
                format!("`{key}`, or the `base` that has it"),
            ));
        }
        let base = base.unwrap_or(DEFAULTS);
        let inherited = base.effects.len();
        let truth = Truth {
            robot: self.robot.unwrap_or(base.robot),
            links: self.links.unwrap_or(base.links),
            joints: self.joints.unwrap_or(base.joints),
            substeps: self.substeps.unwrap_or(base.substeps),
            drop_probability: self.drop_probability.unwrap_or(base.drop_probability),
            drop_burst: self.drop_burst.unwrap_or(base.drop_burst),
            torque_noise_corner: self.torque_noise_corner.unwrap_or(base.torque_noise_corner),
            outlier_probability: self.outlier_probability.unwrap_or(base.outlier_probability),
            outlier_size: self.outlier_size.unwrap_or(base.outlier_size),
            repeat_probability: self.repeat_probability.unwrap_or(base.repeat_probability),
            dead_torque_sensors: self.dead_torque_sensors.unwrap_or(base.dead_torque_sensors),
            effects: [base.effects, self.effects].concat(),
        };
        truth.check(file, inherited)?;
        Ok(truth)
    }
}

/// The arm that `file` names as its base.
#[expect(clippy::disallowed_methods, reason = "reads an arm file, before the loop")]
fn base_of(file: &str, base: &Path) -> Result<Truth, BadInput> {
    let path = Path::new(file).parent().unwrap_or(Path::new("")).join(base);
    let name = path.display().to_string();
    let wrong = |expected: String| BadInput::new(file, "key `base`", format!("`{}`", base.display()), expected);
    let text =
        std::fs::read_to_string(&path).map_err(|error| wrong(format!("a readable arm file ({name}: {error})")))?;
    let keys: TruthFile = from_toml(&name, &text)?;
    if keys.base.is_some() {
        return Err(wrong(format!("an arm file without a base of its own, which {name} has")));
    }
    keys.arm(&name)
}

/// Values of absent keys. Robot, links and joints have none.
pub(super) const DEFAULTS: Truth = Truth {
    robot: String::new(),
    links: Vec::new(),
    joints: Vec::new(),
    substeps: 4,
    drop_probability: 0.0,
    drop_burst: 1,
    torque_noise_corner: 1.0,
    outlier_probability: 0.0,
    outlier_size: 0.0,
    repeat_probability: 0.0,
    dead_torque_sensors: Vec::new(),
    effects: Vec::new(),
};
