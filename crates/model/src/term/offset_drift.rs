//! Drift of a torque sensor's zero.

use super::family::*;
use super::one_row::*;

/// Identity.
pub const ID: &str = "offset-drift";

/// Time constant of the warming.
pub(super) const WARMING: Setting = Setting {
    name: "T",
    unit: "s",
    what: "time constant",
    low: 30.0,
    high: 1000.0,
    steps: 8,
    scale: Scale::Logarithmic,
};

/// A drift of one joint's offset.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The torque sensor's zero drifts as it warms up.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "linear",
            equation: "tau_j = drift_j t / 60 s",
            settings: &[],
            build: linear,
            in_c: REFUSED_TIME,
            plot_over: PlotOver::Time,
        },
        Form {
            name: "exponential",
            equation: "tau_j = drift_j (1 - exp(-t / T))",
            settings: &[WARMING],
            build: exponential,
            in_c: REFUSED_TIME,
            plot_over: PlotOver::Time,
        },
    ],
    stratum: Stratum::Changing,
    typical: "0.05 to 0.5 Nm over a session",
    confounded: &[
        confounded("friction-drift", BOTH_DIRECTIONS_EQUALLY),
        confounded("contact", "a second recording: a touch does not come back, a drift does"),
    ],
    reference: "Bittencourt, Gunnarsson, Trans. ASME J. Dynamic Systems 134 (2012), for the time constants",
    rare: Rare::NONE,
};

/// Ratio of the warming, `1 - exp(-t / T)`.
pub(super) fn warmed(time: f64, constant: f64) -> f64 {
    -(-time / constant).exp_m1()
}

fn linear(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("drift", site, "", unit(operating_point, joint(site), "Nm/min", "N/min"))];
    OneRow::new(&FAMILY, "linear", site, settings, columns, |at, _| [at.time / 60.0, 0.0, 0.0]).term()
}

fn exponential(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("drift", site, "_exponential", unit(operating_point, joint(site), "Nm", "N"))];
    let law = |at: &At, settings: &Settings| [warmed(at.time, settings[0]), 0.0, 0.0];
    OneRow::new(&FAMILY, "exponential", site, settings, columns, law).term()
}
