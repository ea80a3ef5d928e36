//! Coulomb friction that is larger in one direction.

use super::Term;
use super::family::{Confounded, Family, Form, InBodies, InC, Place, PlotOver, Rare, Site, Stratum, joint};
use super::load::OperatingPoint;
use super::one_row::{OneRow, column, smooth_sign, unit};
use std::sync::Arc;

/// Identity.
pub const ID: &str = "asymmetric-coulomb";

/// The part of Coulomb friction that does not change its sign with the velocity.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "Teeth and bearings under a preload rub harder in one direction than in the other.",
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
    served: true,
    typical: "5 to 30 % of the Coulomb friction",
    confounded: &[
        Confounded { with: "torque-offset", decided_by: "hold the joint still for some seconds in several poses" },
        Confounded { with: "spring", decided_by: "move the joint through more than 60 % of its range" },
    ],
    reference: "Elhami, Brookfield, Automatica 33 (1997)",
    in_bodies: InBodies::Nothing,
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fca", site, "", unit(operating_point, joint(site), "Nm", "N"))];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [smooth_sign(at.own.dq).abs(), 0.0, 0.0]).term()
}
