//! Friction that is another one than when the model was identified.

use super::Term;
use super::effect::{Confounded, Family, Form, Ground, Place, Site, Stratum, joint};
use super::one_row::{OneRow, column, smooth_sign, unit};
use std::sync::Arc;

/// Identity.
pub const ID: &str = "friction-change";

/// A change of one joint's viscous and Coulomb friction.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A joint's friction has changed since the model was identified: new grease, wear, another temperature.",
    place: Place::Joint,
    forms: &[Form { name: "", equation: "tau_j = dfv_j dq_j + dfc_j tanh(100 dq_j)", settings: &[], build }],
    stratum: Stratum::Reference,
    served: true,
    typical: "20 to 50 % between a cold and a warm gear",
    confounded: &[
        Confounded { with: "friction-drift", decided_by: "repeat the motion for half an hour: a drift goes on" },
        Confounded { with: "load-dependent-friction", decided_by: "pass the same poses with and without a load" },
    ],
    reference: "Bittencourt, Gunnarsson, ASME J. Dynamic Systems, Measurement and Control 134 (2012)",
};

fn build(ground: &Ground, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![
        column("dfv", site, "", unit(ground, joint, "Nms/rad", "Ns/m")),
        column("dfc", site, "", unit(ground, joint, "Nm", "N")),
    ];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.own.dq, smooth_sign(at.own.dq), 0.0]).term()
}
