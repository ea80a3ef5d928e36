//! Coulomb friction that depends on the direction.

use super::family::*;
use super::one_row::*;

/// The part of Coulomb friction whose sign does not change with the velocity.
pub static FAMILY: Family = Family {
    id: "asymmetric-coulomb",
    physics: "Preloaded teeth and bearings have more Coulomb friction in one direction than in the other.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = fca_j |tanh(100 dq_j)|",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![format!("fabs({})", at.sign)]),
        plot_over: PlotOver::Velocity,
    }],
    stratum: Stratum::Repeatable,
    typical: "5 to 30 % of the Coulomb friction",
    confounded: &[confounded("torque-offset", STANDSTILL), confounded("spring", MOST_OF_RANGE)],
    reference: "Elhami, Brookfield, Automatica 33 (1997)",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fca", site, "", unit(operating_point, joint(site), "Nm", "N"))];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [smooth_sign(at.own.dq).abs(), 0.0, 0.0]).term()
}
