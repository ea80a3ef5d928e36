//! Quantities with a unit: `"90 deg"`, `"10 s"`, `"5 Hz"`. A bare number is refused.

use plumbline_core::BadInput;
use plumbline_model::Mounting;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Error, MapAccess, Visitor, value::MapAccessDeserializer};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::borrow::Cow;
use std::f64::consts::PI;
use std::fmt;

/// A kind of quantity: description for errors, and units with their factors to the SI unit.
pub struct Quantity {
    what: &'static str,
    units: &'static [(&'static str, f64)],
}

/// Angles, read in rad.
pub const ANGLE: Quantity = Quantity {
    what: "an angle with its unit, such as \"90 deg\" or \"1.5708 rad\"",
    units: &[("rad", 1.0), ("deg", PI / 180.0)],
};
/// Angular rates, read in rad/s.
pub const ANGULAR_RATE: Quantity = Quantity {
    what: "an angle per second with its unit, such as \"1 deg/s\"",
    units: &[("rad/s", 1.0), ("deg/s", PI / 180.0)],
};
/// Joint positions, read in rad (revolute) or m (prismatic).
pub const POSITION: Quantity = Quantity {
    what: "a joint position with its unit, such as \"90 deg\", \"1.5708 rad\" or \"0.2 m\"",
    units: &[("rad", 1.0), ("deg", PI / 180.0), ("m", 1.0), ("mm", 1e-3)],
};
/// Durations, read in s.
pub const DURATION: Quantity = Quantity {
    what: "a duration with its unit, such as \"10 s\" or \"5 ms\"",
    units: &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0)],
};
/// Frequencies, read in Hz.
pub const FREQUENCY: Quantity =
    Quantity { what: "a frequency with its unit, such as \"5 Hz\"", units: &[("Hz", 1.0), ("kHz", 1e3)] };

impl Quantity {
    /// The value of `text` in the SI unit, or `None` when the number or the unit is missing, wrong, or not finite.
    pub fn parse(&self, text: &str) -> Option<f64> {
        let text = text.trim();
        // The unit follows the last digit or point.
        let split = text.rfind(|c: char| c.is_ascii_digit() || c == '.')? + 1;
        let (number, unit) = text.split_at(split);
        let factor = self.units.iter().find(|(name, _)| *name == unit.trim())?.1;
        let value = number.parse::<f64>().ok()? * factor;
        value.is_finite().then_some(value)
    }
}

/// Deserializes a quantity from a string; other types are refused.
struct QuantityVisitor(&'static Quantity);

impl Visitor<'_> for QuantityVisitor {
    type Value = f64;

    fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.0.what)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<f64, E> {
        self.0.parse(text).ok_or_else(|| E::custom(self.0.what))
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<f64, E> {
        Err(E::custom(format!("{} (a number needs a unit)", self.0.what)))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<f64, E> {
        self.visit_f64(value as f64)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<f64, E> {
        self.visit_f64(value as f64)
    }
}

impl Quantity {
    /// Schema of a string with a number and one of the units.
    fn schema(&self) -> Schema {
        let units = self.units.iter().map(|(name, _)| *name).collect::<Vec<_>>().join("|");
        // As `parse`: a number of Rust, blanks, the unit.
        let pattern = format!(r"^\s*[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?\s*({units})\s*$");
        json_schema!({ "type": "string", "pattern": pattern, "description": self.what })
    }

    /// Text of a value in the SI unit.
    fn text(&self, value: f64) -> String {
        format!("{value} {}", self.units[0].0)
    }
}

/// Schema of a type that stands for a form of text or tables.
macro_rules! schema {
    ($name:ident, $of:expr) => {
        impl JsonSchema for $name {
            fn schema_name() -> Cow<'static, str> {
                stringify!($name).into()
            }

            fn inline_schema() -> bool {
                true
            }

            fn json_schema(generator: &mut SchemaGenerator) -> Schema {
                let of: fn(&mut SchemaGenerator) -> Schema = $of;
                of(generator)
            }
        }
    };
}

/// A type for serde's `with`: the form of a quantity in a configuration, its schema, and the text of a default value in the schema.
macro_rules! with_unit {
    ($name:ident, $quantity:ident, $doc:literal) => {
        #[doc = concat!("`with` for ", $doc, ".")]
        pub struct $name;

        impl $name {
            pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
                deserializer.deserialize_any(QuantityVisitor(&$quantity))
            }

            pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(&$quantity.text(*value))
            }
        }

        schema!($name, |_| $quantity.schema());
    };
}

with_unit!(Angle, ANGLE, "an angle in rad");
with_unit!(AngularRate, ANGULAR_RATE, "an angle per second in rad/s");
with_unit!(Duration, DURATION, "a duration in s");
with_unit!(Frequency, FREQUENCY, "a frequency in Hz");

/// `with` for a frequency in Hz that may be absent.
pub struct OptionalFrequency;

impl OptionalFrequency {
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
        Frequency::deserialize(deserializer).map(Some)
    }

    pub fn serialize<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        value.map(|value| FREQUENCY.text(value)).serialize(serializer)
    }
}

schema!(OptionalFrequency, |_| FREQUENCY.schema());

/// `with` for two angles in rad.
pub struct AnglePair;

impl AnglePair {
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
        #[derive(Deserialize)]
        struct One(#[serde(with = "Angle")] f64);
        <[One; 2]>::deserialize(deserializer).map(|pair| pair.map(|One(value)| value))
    }

    pub fn serialize<S: Serializer>(value: &[f64; 2], serializer: S) -> Result<S::Ok, S::Error> {
        value.map(|value| ANGLE.text(value)).serialize(serializer)
    }
}

schema!(AnglePair, |_| json_schema!({ "type": "array", "items": ANGLE.schema(), "minItems": 2, "maxItems": 2 }));

/// `with` for one joint position per joint, in rad or m, that may be absent.
pub struct Positions;

impl Positions {
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<f64>>, D::Error> {
        struct Position(f64);
        impl<'de> Deserialize<'de> for Position {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Position, D::Error> {
                deserializer.deserialize_any(QuantityVisitor(&POSITION)).map(Position)
            }
        }
        let positions = Vec::<Position>::deserialize(deserializer)?;
        Ok(Some(positions.into_iter().map(|position| position.0).collect()))
    }

    pub fn serialize<S: Serializer>(value: &Option<Vec<f64>>, serializer: S) -> Result<S::Ok, S::Error> {
        let texts = |values: &Vec<f64>| values.iter().map(|value| POSITION.text(*value)).collect::<Vec<_>>();
        value.as_ref().map(texts).serialize(serializer)
    }
}

schema!(Positions, |_| json_schema!({ "type": "array", "items": POSITION.schema() }));

const MOUNTING: &str = "\"upright\", \"wall\", \"ceiling\" or { rho = \"90 deg\", phi = \"0 deg\" }";

fn named_mounting(name: &str) -> Option<Mounting> {
    match name {
        "upright" => Some(Mounting::UPRIGHT),
        "wall" => Some(Mounting::WALL),
        "ceiling" => Some(Mounting::CEILING),
        _ => None,
    }
}

/// A mounting from a command line: a name, or `RHO,PHI` with units (`"60 deg,0 deg"`); `option` is named in the error.
pub fn parse_mounting(option: &str, text: &str) -> Result<Mounting, BadInput> {
    let angles = || {
        let (rho, phi) = text.split_once(',')?;
        Some(Mounting { rho: ANGLE.parse(rho)?, phi: ANGLE.parse(phi)? }).filter(in_range)
    };
    named_mounting(text.trim()).or_else(angles).ok_or_else(|| {
        let expected = "upright, wall, ceiling or RHO,PHI with units, such as \"60 deg,0 deg\" (rho from 0 to 180 deg)";
        BadInput::new(option, "value", format!("`{text}`"), expected)
    })
}

fn in_range(mounting: &Mounting) -> bool {
    (-1e-9..=PI + 1e-9).contains(&mounting.rho) && mounting.phi.abs() <= 2.0 * PI + 1e-9
}

/// A mounting as the configuration has it: a name, or both angles of paper eq. 3 with units.
struct Setting(Mounting);

impl<'de> Deserialize<'de> for Setting {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Setting, D::Error> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Angles {
            #[serde(with = "Angle")]
            rho: f64,
            #[serde(with = "Angle")]
            phi: f64,
        }
        struct SettingVisitor;
        impl<'de> Visitor<'de> for SettingVisitor {
            type Value = Setting;

            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str(MOUNTING)
            }

            fn visit_str<E: Error>(self, name: &str) -> Result<Setting, E> {
                named_mounting(name).map(Setting).ok_or_else(|| E::custom(MOUNTING))
            }

            fn visit_map<M: MapAccess<'de>>(self, map: M) -> Result<Setting, M::Error> {
                let Angles { rho, phi } = Angles::deserialize(MapAccessDeserializer::new(map))?;
                let mounting = Mounting { rho, phi };
                let range = "rho from 0 to 180 deg, phi at most one turn";
                in_range(&mounting).then_some(Setting(mounting)).ok_or_else(|| M::Error::custom(range))
            }

            fn visit_f64<E: Error>(self, _: f64) -> Result<Setting, E> {
                Err(E::custom(format!("{MOUNTING} (a number needs a unit)")))
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Setting, E> {
                self.visit_f64(value as f64)
            }
        }
        deserializer.deserialize_any(SettingVisitor)
    }
}

/// `with` for a mounting.
pub struct MountingSetting;

impl MountingSetting {
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Mounting, D::Error> {
        Setting::deserialize(deserializer).map(|setting| setting.0)
    }

    pub fn serialize<S: Serializer>(value: &Mounting, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&value.to_string())
    }
}

schema!(MountingSetting, |_| json_schema!({
    "anyOf": [
        { "enum": ["upright", "wall", "ceiling"] },
        {
            "type": "object",
            "properties": { "rho": ANGLE.schema(), "phi": ANGLE.schema() },
            "required": ["rho", "phi"],
            "additionalProperties": false,
        },
    ]
}));

/// `with` for a list of mountings.
pub struct Mountings;

impl Mountings {
    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Mounting>, D::Error> {
        Ok(Vec::<Setting>::deserialize(deserializer)?.into_iter().map(|setting| setting.0).collect())
    }

    pub fn serialize<S: Serializer>(value: &[Mounting], serializer: S) -> Result<S::Ok, S::Error> {
        value.iter().map(Mounting::to_string).collect::<Vec<_>>().serialize(serializer)
    }
}

schema!(Mountings, |generator| json_schema!({
    "type": "array", "items": MountingSetting::json_schema(generator)
}));

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_need_a_number_and_a_unit() {
        assert_eq!(ANGLE.parse("180 deg"), Some(PI));
        assert_eq!(ANGLE.parse(" -1.5rad "), Some(-1.5));
        assert_eq!(ANGLE.parse("1e-3 rad"), Some(1e-3));
        assert_eq!(DURATION.parse("250 ms"), Some(0.25));
        assert_eq!(DURATION.parse("2 min"), Some(120.0));
        assert_eq!(FREQUENCY.parse("1 kHz"), Some(1000.0));
        for bad in ["90", "deg", "", "90 degrees", "inf rad", "NaN deg", "1e999 rad", "1 2 rad", "10 s"] {
            assert_eq!(ANGLE.parse(bad), None, "{bad}");
        }
    }

    #[test]
    fn mountings_read_back_from_their_names() {
        for name in ["upright", "wall", "ceiling"] {
            assert_eq!(parse_mounting("--mounting", name).unwrap().to_string(), name);
        }
        let tilted = parse_mounting("--mounting", "60 deg, -20 deg").unwrap();
        assert_eq!((tilted.rho, tilted.phi), (60_f64.to_radians(), (-20_f64).to_radians()));
        for bad in ["60,20", "floor", "200 deg,0 deg", "60 deg", "NaN deg,0 deg"] {
            let message = parse_mounting("--mounting", bad).unwrap_err().to_string();
            assert!(message.starts_with("--mounting: value: got `") && message.contains("with units"), "{message}");
        }
    }
}
