//! Cross-talk of a torque sensor from another joint's torque.

use super::carried::Drives;
use super::family::*;
use super::one_row::*;

/// Largest share that a sensor measures of another joint's torque: more is a transmission that the two have in common.
const MAX_SHARE: f64 = 0.1;

/// A share of another joint's torque.
pub static FAMILY: Family = Family {
    id: "torque-crosstalk",
    physics: "A torque sensor also deforms under loads across its axis and measures a part of them as torque.",
    place: Place::Pair,
    forms: &[
        Form {
            name: "",
            equation: "tau_j = cross_j_k tau_rb_k",
            settings: &[],
            build: load,
            in_c: InC::Columns(|at, _| vec![at.load.clone()]),
            plot_over: PlotOver::Load,
        },
        Form {
            name: "whole",
            equation: "tau_j = cross_j_k (tau_rb_k + tau_friction_k + tau_rotor_k)",
            settings: &[],
            build: whole,
            in_c: InC::Columns(|at, _| vec![format!("({} + {})", at.load, at.cause_drive)]),
            plot_over: PlotOver::Load,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.5 to 3 % of the other joint's torque",
    confounded: &[
        confounded("torque-gain", "move through poses in which the torques of the two joints go their own ways"),
        confounded("transmission-coupling", ONE_REVERSES),
        confounded("Lxy, Lxz and Lyz", "pass the same poses slowly: products of inertia vanish"),
    ],
    reference: "Taghirad, Belanger, IEEE Trans. Control Systems Technology 9 (2001)",
    rare: Rare::NONE,
};

fn load(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cross", site, "", "1")];
    let law = |at: &At, _: &Settings| [at.load, 0.0, 0.0];
    OneRow::new(&FAMILY, "", site, settings, columns, law).loaded(operating_point).at_most(MAX_SHARE).term()
}

fn whole(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cross", site, "_whole", "1")];
    let (drives, (_, cause)) = (Drives::of(operating_point), row_and_cause(site));
    let law = move |at: &At, _: &Settings| [at.load + drives.at(at.cause.dq, at.cause.ddq, cause), 0.0, 0.0];
    OneRow::new(&FAMILY, "whole", site, settings, columns, law).loaded(operating_point).at_most(MAX_SHARE).term()
}
