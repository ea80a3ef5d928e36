//! Coulomb friction that rises with speed at a reversal less or more steeply than the plain model's.

use super::family::*;
use super::one_row::*;
use std::f64::consts::FRAC_2_PI;

/// The part `fw` of the Coulomb friction whose sign is less, or more, steep than `tanh(100 dq)`.
pub static FAMILY: Family = Family {
    id: "coulomb-slope",
    physics: "Contacts that creep under load slide at every speed, so that friction rises over a range of speeds around zero; dry ones reverse at once.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "tanh",
            equation: "tau_j = fw_j (tanh(dq_j / vw) - tanh(100 dq_j))",
            settings: &[Setting { low: 0.013, steps: 8, ..SPEED }],
            build: |operating_point, site, settings| {
                friction(&FAMILY, "tanh", "fw", operating_point, site, settings, tanh)
            },
            in_c: InC::Columns(in_c_of_tanh),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "steep",
            equation: "tau_j = fw_j (tanh(dq_j / vw) - tanh(100 dq_j))",
            // At 0.01 rad/s it is the plain model's.
            settings: &[Setting { low: 0.001, high: 0.0077, steps: 3, ..SPEED }],
            build: |operating_point, site, settings| {
                friction(&FAMILY, "steep", "fw", operating_point, site, settings, tanh)
            },
            in_c: InC::Columns(in_c_of_tanh),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "arctan",
            equation: "tau_j = fw_j (2/pi atan(dq_j / vw) - tanh(100 dq_j))",
            settings: &[SPEED],
            build: |operating_point, site, settings| {
                friction(&FAMILY, "arctan", "fw", operating_point, site, settings, arctan)
            },
            in_c: InC::Columns(|at, settings| {
                vec![format!("{FRAC_2_PI:?}*atan({}/{:?})-{}", at.dq, settings[0], at.sign)]
            }),
            plot_over: PlotOver::Velocity,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "all of the Coulomb friction, vw 0.001 to 0.05 rad/s",
    confounded: &[confounded("presliding", SLOW_CONSTANT_SPEEDS), confounded("nonlinear-viscous", CONSTANT_SPEEDS)],
    reference: "Makkar et al., IEEE/ASME AIM 2005",
    rare: Rare { slight_in_every_arm: true, ..Rare::NONE },
};

const SPEED: Setting = Setting {
    name: "vw",
    unit: "rad/s",
    what: "speed over which friction rises",
    low: 0.002,
    // Slower rises are the sigmoid of nonlinear viscous friction.
    high: 0.1,
    steps: 12,
    scale: Scale::Logarithmic,
};

fn in_c_of_tanh(at: &Inputs, settings: &[f64]) -> Vec<String> {
    vec![format!("tanh({}/{:?})-{}", at.dq, settings[0], at.sign)]
}

fn tanh(at: &At, settings: &Settings) -> [f64; 3] {
    [(at.own.dq / settings[0]).tanh() - smooth_sign(at.own.dq), 0.0, 0.0]
}

fn arctan(at: &At, settings: &Settings) -> [f64; 3] {
    [FRAC_2_PI * (at.own.dq / settings[0]).atan() - smooth_sign(at.own.dq), 0.0, 0.0]
}
