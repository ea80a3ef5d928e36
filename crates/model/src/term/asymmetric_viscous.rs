//! Viscous friction that depends on the direction.

use super::family::*;
use super::one_row::*;

/// Identity.
pub const ID: &str = "asymmetric-viscous";

/// The part of viscous friction whose sign does not change with the velocity.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A lubricant resists more in one direction of motion than in the other.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = fva_j |dq_j|",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![format!("fabs({})", at.dq)]),
        plot_over: PlotOver::Velocity,
    }],
    stratum: Stratum::Repeatable,
    typical: "5 to 20 % of the viscous friction",
    confounded: &[
        confounded("asymmetric-coulomb", "move the joint at speeds that differ five times and more"),
        confounded("Lxy and Lzz of outer links", "move that joint alone, fast, in several poses of the others"),
    ],
    reference: "Elhami, Brookfield, Automatica 33 (1997)",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fva", site, "", unit(operating_point, joint(site), "Nms/rad", "Ns/m"))];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.own.dq.abs(), 0.0, 0.0]).term()
}
