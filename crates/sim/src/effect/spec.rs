//! The catalogue: every effect by its stable id, as a truth file writes it.

use super::onset::Onset;
use super::*;
use serde::de::Error;
use serde::{Deserialize, Deserializer};
use std::cmp::Ordering;

/// The catalogue: an enum to deserialise, its ids, and the module of each effect.
macro_rules! catalogue {
    ($($(#[doc = $doc:literal])* $(#[cfg($cfg:meta)])? $variant:ident, $id:literal, $module:ident;)*) => {
        /// Kind of an effect.
        #[derive(Clone, Debug, PartialEq, Deserialize)]
        #[serde(tag = "id")]
        pub enum Kind {
            $($(#[doc = $doc])* $(#[cfg($cfg)])? #[serde(rename = $id)] $variant($module::Config),)*
        }

        /// The tables of all effects, without the keys that each may have.
        #[cfg(feature = "schema")]
        fn tables(generator: &mut schemars::SchemaGenerator) -> Vec<(&'static str, schemars::Schema)> {
            use schemars::JsonSchema;
            vec![$($(#[cfg($cfg)])? ($id, $module::Config::json_schema(generator)),)*]
        }

        impl Kind {
            /// The ids of all effects.
            pub const IDS: &[&str] = &[$($(#[cfg($cfg)])? $id),*];

            /// The effect's id.
            pub fn id(&self) -> &'static str {
                match self {
                    $($(#[cfg($cfg)])? Kind::$variant(_) => $id,)*
                }
            }

            fn spec(&self) -> &dyn Spec {
                match self {
                    $($(#[cfg($cfg)])? Kind::$variant(config) => config,)*
                }
            }
        }
    };
}

catalogue! {
    /// A torque sensor's zero is off.
    TorqueOffset, "torque-offset", torque_offset;
    /// A torque sensor's scale is off.
    TorqueGain, "torque-gain", torque_gain;
    /// Coulomb friction that depends on the direction.
    AsymmetricCoulomb, "asymmetric-coulomb", asymmetric_coulomb;
    /// Viscous friction that depends on the direction.
    AsymmetricViscous, "asymmetric-viscous", asymmetric_viscous;
    /// Friction that falls as the lubricant builds its film.
    Stribeck, "stribeck", stribeck;
    /// Friction that rises with speed at a reversal.
    CoulombSlope, "coulomb-slope", coulomb_slope;
    /// Friction that is not proportional to velocity.
    NonlinearViscous, "nonlinear-viscous", nonlinear_viscous;
    /// Friction that grows with the torque that a joint carries.
    LoadDependentFriction, "load-dependent-friction", load_dependent_friction;
    /// Friction that changes as the arm warms up.
    FrictionDrift, "friction-drift", friction_drift;
    /// Drift of a torque sensor's zero.
    OffsetDrift, "offset-drift", offset_drift;
    /// Elastic friction before sliding.
    Presliding, "presliding", presliding;
    /// A motor's rotor behind its gear.
    RotorInertia, "rotor-inertia", rotor_inertia;
    /// A transmission that twists under load.
    JointElasticity, "joint-elasticity", joint_elasticity;
    /// Torque ripple over the position.
    PositionRipple, "position-ripple", position_ripple;
    /// Friction that depends on the position.
    PositionDependentFriction, "position-dependent-friction", position_dependent_friction;
    /// A spring between two links.
    Spring, "spring", spring;
    /// An undeclared body.
    Payload, "payload", payload;
    /// Wrong declared mounting.
    Mounting, "mounting", mounting;
    /// Vibration of the base.
    BaseMotion, "base-motion", base_motion;
    /// Cross-talk of a torque sensor.
    TorqueCrosstalk, "torque-crosstalk", torque_crosstalk;
    /// Friction that depends on two joints.
    TransmissionCoupling, "transmission-coupling", transmission_coupling;
    /// Delay of the measured torque.
    Delay, "delay", delay;
    /// An external wrench on a link.
    Contact, "contact", contact;
    /// An encoder's zero is off.
    EncoderOffset, "encoder-offset", encoder_offset;
    /// An encoder's disc is off its axis.
    EncoderEccentricity, "encoder-eccentricity", encoder_eccentricity;
    /// A transmission with play.
    Backlash, "backlash", backlash;
    /// An effect of tests that the model's catalogue lacks.
    Foreign, "foreign", foreign;
    /// An effect of one test, in the model's catalogue too.
    #[cfg(feature = "made-up-effect")]
    MadeUp, "made-up", made_up;
}

/// An effect as it is written in a truth file.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectSpec {
    /// When it begins; 0 for an effect that is always there \[s\].
    pub from: f64,
    /// When it ends; infinity for one that stays \[s\].
    pub until: f64,
    /// Kind and parameters.
    pub kind: Kind,
}

impl From<Kind> for EffectSpec {
    fn from(kind: Kind) -> EffectSpec {
        EffectSpec { from: 0.0, until: f64::INFINITY, kind }
    }
}

impl EffectSpec {
    /// # Errors
    /// An invalid effect for the arm of `truth`; `name` is its place in `file`.
    pub(crate) fn check(&self, file: &str, name: &str, truth: &Truth) -> Result<(), BadInput> {
        let place = Place { file, name, truth, from: self.from };
        place.range("from", self.from, 0.0, 1e9)?;
        if self.until.partial_cmp(&self.from) != Some(Ordering::Greater) {
            return Err(place.wrong("until", self.until, "a time after `from` [s]"));
        }
        self.kind.spec().check(&place)
    }

    /// Whether it replaces the Coulomb friction of `joint`, counted from 0.
    pub(crate) fn replaces_coulomb(&self, joint: usize) -> bool {
        self.kind.spec().replaces_coulomb(joint)
    }

    pub(crate) fn build(&self, truth: &Truth) -> Box<dyn Effect> {
        let effect = self.kind.spec().build(truth, self.from);
        let always = self.from <= 0.0 && self.until == f64::INFINITY;
        if always { effect } else { Box::new(Onset::new(effect, self.from..self.until, truth)) }
    }
}

/// One table per effect, each with the keys that every effect has.
#[cfg(feature = "schema")]
impl schemars::JsonSchema for EffectSpec {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Effect".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let tables: Vec<schemars::Schema> = tables(generator)
            .into_iter()
            .map(|(id, mut table)| {
                add_common_keys(&mut table, id);
                table
            })
            .collect();
        schemars::json_schema!({ "oneOf": tables })
    }
}

/// Adds `id`, `from` and `until` to a table, or to every form that it has.
#[cfg(feature = "schema")]
fn add_common_keys(table: &mut schemars::Schema, id: &str) {
    if let Some(serde_json::Value::Array(forms)) = table.get_mut("oneOf") {
        for form in forms.iter_mut().filter_map(|form| form.try_into().ok()) {
            add_common_keys(form, id);
        }
        return;
    }
    let time = |description: &str| serde_json::json!({ "type": "number", "description": description });
    let own = table.ensure_object();
    if let Some(keys) = own.entry("properties").or_insert_with(|| serde_json::json!({})).as_object_mut() {
        keys.insert("id".into(), serde_json::json!({ "const": id }));
        keys.insert("from".into(), time("When it begins; 0 for an effect that is always there [s]."));
        keys.insert("until".into(), time("When it ends; absent for one that stays [s]."));
    }
    if let Some(required) = own.entry("required").or_insert_with(|| serde_json::json!([])).as_array_mut() {
        required.push("id".into());
    }
}

/// `from` and `until` belong to every effect; the rest of the table is the effect's own, and may hold no unknown key.
impl<'de> Deserialize<'de> for EffectSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<EffectSpec, D::Error> {
        let mut table = toml::Table::deserialize(deserializer)?;
        let id = table.get("id").map_or("?".into(), ToString::to_string);
        let mut time = |key: &str, absent: f64| {
            table.remove(key).map_or(Ok(absent), |value| {
                let found = value.to_string();
                f64::deserialize(value)
                    .map_err(|_| D::Error::custom(format!("a time in s for key `{key}`, not {found}")))
            })
        };
        let (from, until) = (time("from", 0.0)?, time("until", f64::INFINITY)?);
        let kind = Kind::deserialize(table).map_err(|error| {
            // From serde's message: a missing or unknown key, or the value of a wrong type.
            let message = error.message();
            D::Error::custom(match message.split_once(", expected ") {
                Some((found, wanted)) if !message.starts_with("unknown") => {
                    format!("{wanted} in the effect {id} ({found})")
                }
                _ => message.to_string(),
            })
        })?;
        Ok(EffectSpec { from, until, kind })
    }
}
