//! Cross-talk of a torque sensor from another joint's torque.

use super::family::*;
use super::one_row::*;

/// A share of another joint's rigid-body torque.
pub static FAMILY: Family = Family {
    id: "torque-crosstalk",
    physics: "A torque sensor also deforms under loads across its axis and measures a part of them as torque.",
    place: Place::Pair,
    forms: &[Form {
        name: "",
        equation: "tau_j = cross_j_k tau_rb_k",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![at.load.clone()]),
        plot_over: PlotOver::Load,
    }],
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

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cross", site, "", "1")];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.load, 0.0, 0.0]).loaded(operating_point).term()
}
