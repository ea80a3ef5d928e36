//! Drift of friction with temperature.

use super::family::*;
use super::offset_drift::{WARMING, warmed};
use super::one_row::*;

/// Identity.
pub const ID: &str = "friction-drift";

/// A drift of one joint's friction.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "Grease becomes thinner as the joint warms up, in time or by what its own friction dissipates, so that friction changes.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "linear",
            equation: "tau_j = (fcdrift_j tanh(100 dq_j) + fvdrift_j dq_j) t / 60 s",
            settings: &[],
            build: linear,
            in_c: REFUSED_TIME,
            plot_over: PlotOver::Time,
        },
        Form {
            name: "exponential",
            equation: "tau_j = (fcdrift_j tanh(100 dq_j) + fvdrift_j dq_j) (1 - exp(-t / T))",
            settings: &[WARMING],
            build: exponential,
            in_c: REFUSED_TIME,
            plot_over: PlotOver::Time,
        },
    ],
    stratum: Stratum::Changing,
    typical: "-20 to -50 % of the friction over 10 to 30 min",
    confounded: &[confounded("offset-drift", BOTH_DIRECTIONS_EQUALLY)],
    reference: "Simoni, Beschi, Legnani, Visioli, IROS 2015; Bittencourt, Gunnarsson, Trans. ASME J. Dynamic Systems 134 (2012)",
    rare: Rare::NONE,
};

fn linear(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![
        column("fcdrift", site, "", unit(operating_point, joint, "Nm/min", "N/min")),
        column("fvdrift", site, "", unit(operating_point, joint, "Nms/rad/min", "Ns/m/min")),
    ];
    let law = |at: &At, _: &Settings| scaled(at.own.dq, at.time / 60.0);
    OneRow::new(&FAMILY, "linear", site, settings, columns, law).term()
}

fn exponential(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![
        column("fcdrift", site, "_exponential", unit(operating_point, joint, "Nm", "N")),
        column("fvdrift", site, "_exponential", unit(operating_point, joint, "Nms/rad", "Ns/m")),
    ];
    let law = |at: &At, settings: &Settings| scaled(at.own.dq, warmed(at.time, settings[0]));
    OneRow::new(&FAMILY, "exponential", site, settings, columns, law).term()
}

fn scaled(dq: f64, share: f64) -> [f64; 3] {
    [share * smooth_sign(dq), share * dq, 0.0]
}
