//! Stribeck friction: friction that falls with speed at low speed.

use super::family::*;
use super::one_row::*;

/// Friction in addition to Coulomb friction at low speed.
pub static FAMILY: Family = Family {
    id: "stribeck",
    physics: "At low speed the lubricant film is too thin to separate the surfaces, so that friction is higher.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "gaussian",
            equation: "tau_j = fs_j exp(-(dq_j / vs)^2) tanh(100 dq_j)",
            settings: &[SPEED],
            build: |operating_point, site, settings| {
                friction(&FAMILY, "gaussian", "fs", operating_point, site, settings, gaussian)
            },
            in_c: InC::Columns(|at, settings| {
                vec![format!("exp(-({0}/{1:?})*({0}/{1:?}))*{2}", at.dq, settings[0], at.sign)]
            }),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "exponential",
            equation: "tau_j = fs_j exp(-|dq_j| / vs) tanh(100 dq_j)",
            settings: &[SPEED],
            build: |operating_point, site, settings| {
                friction(&FAMILY, "exponential", "fs", operating_point, site, settings, exponential)
            },
            in_c: InC::Columns(|at, settings| vec![format!("exp(-fabs({})/{:?})*{}", at.dq, settings[0], at.sign)]),
            plot_over: PlotOver::Velocity,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "10 to 60 % of the Coulomb friction, vs 0.02 to 0.2 rad/s",
    confounded: &[
        confounded("presliding", SLOW_CONSTANT_SPEEDS),
        confounded("nonlinear-viscous", CONSTANT_SPEEDS),
        confounded("coulomb-slope", SLOW_CONSTANT_SPEEDS),
    ],
    reference: "Bittencourt, Gunnarsson, Trans. ASME J. Dynamic Systems 134 (2012)",
    rare: Rare { slight_in_every_arm: true, ..Rare::NONE },
};

const SPEED: Setting = Setting {
    name: "vs",
    unit: "rad/s",
    what: "speed at which the excess has fallen to 37 %",
    // Below it is the slope of the reversal, whose width in the plain model is 0.01 rad/s.
    low: 0.02,
    high: 1.0,
    steps: 10,
    scale: Scale::Logarithmic,
};

fn gaussian(at: &At, settings: &Settings) -> [f64; 3] {
    [(-(at.own.dq / settings[0]).powi(2)).exp() * smooth_sign(at.own.dq), 0.0, 0.0]
}

fn exponential(at: &At, settings: &Settings) -> [f64; 3] {
    [(-at.own.dq.abs() / settings[0]).exp() * smooth_sign(at.own.dq), 0.0, 0.0]
}
