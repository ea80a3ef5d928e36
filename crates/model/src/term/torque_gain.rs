//! A torque sensor that reads too much or too little.

use super::Term;
use super::family::{Confounded, Family, Form, InBodies, InC, Place, PlotOver, Rare, Site, Stratum};
use super::load::OperatingPoint;
use super::one_row::{OneRow, column};
use std::sync::Arc;

/// Identity.
pub const ID: &str = "torque-gain";

/// A share of a joint's own rigid-body torque.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A joint's torque sensor (or its motor's torque constant) is off by a share of what it reads.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = gain_j tau_rb_j",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![at.load.clone()]),
        plot_over: PlotOver::Load,
    }],
    stratum: Stratum::Repeatable,
    served: true,
    typical: "0.5 to 3 %",
    confounded: &[
        Confounded {
            with: "payload",
            decided_by: "a gain common to all joints is a scale of all masses: add a known mass",
        },
        Confounded { with: "load-dependent-friction", decided_by: "pass the same poses slowly in both directions" },
        Confounded {
            with: "the parameters of the last links",
            decided_by: "none on the last joint: no other row sees its link alone; further in, load the outer joints harder",
        },
    ],
    reference: "Gautier, Venture, IROS 2013; Ma, Hollerbach, ICRA 1996",
    in_bodies: InBodies::Nothing,
    rare: Rare { may_change: true, ..Rare::NONE },
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("gain", site, "", "1")];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.load, 0.0, 0.0]).loaded(operating_point).term()
}
