//! A torque sensor that feels another joint's torque.

use super::Term;
use super::family::{Confounded, Family, Form, InBodies, InC, Place, PlotOver, Rare, Site, Stratum};
use super::load::OperatingPoint;
use super::one_row::{OneRow, column};
use std::sync::Arc;

/// Identity.
pub const ID: &str = "torque-crosstalk";

/// A share of another joint's rigid-body torque.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A torque sensor bends under loads across its axis and takes part of them for torque.",
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
    served: true,
    typical: "0.5 to 3 % of the other joint's torque",
    confounded: &[
        Confounded {
            with: "torque-gain",
            decided_by: "move through poses in which the torques of the two joints go their own ways",
        },
        Confounded { with: "transmission-coupling", decided_by: "reverse one joint while the other holds still" },
        Confounded { with: "Lxy, Lxz and Lyz", decided_by: "pass the same poses slowly: products of inertia vanish" },
    ],
    reference: "Taghirad, Belanger, IEEE Trans. Control Systems Technology 9 (2001)",
    in_bodies: InBodies::Nothing,
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cross", site, "", "1")];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.load, 0.0, 0.0]).loaded(operating_point).term()
}
