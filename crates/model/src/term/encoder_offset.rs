//! An encoder whose zero is not where the model's is.

use super::all_rows::{AllRows, Clock, Law};
use super::family::{
    Confounded, Family, Form, InBodies, Place, PlotOver, REFUSED_OTHER_STATE, Rare, Site, Stratum, joint,
};
use super::load::OperatingPoint;
use super::one_row::{column, unit};
use super::position_error::PositionError;
use super::{Sample, Term};
use plumbline_core::JointVec;
use std::sync::Arc;

/// Identity.
pub const ID: &str = "encoder-offset";

/// A constant error of one joint's position: its true position minus the measured one.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A joint's encoder was set to zero in another pose than the one that the robot's geometry is written for.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau = zero_i d tau_rb / d q_i, in all rows",
        settings: &[],
        build,
        in_c: REFUSED_OTHER_STATE,
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    served: true,
    typical: "1 to 10 mrad",
    confounded: &[
        Confounded {
            with: "lx and ly of the same link",
            decided_by: "they hold most of it; a calibration with a tracker or a calibrated pose tells the two apart",
        },
        Confounded {
            with: "joint-elasticity",
            decided_by: "identify in a second mounting: the load turns, the zero stays",
        },
    ],
    reference: "Khalil, Dombre, Modeling, Identification and Control of Robots (2002), chapter 11",
    in_bodies: InBodies::Nothing,
    rare: Rare { may_change: true, ..Rare::NONE },
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![column("zero", site, "", unit(operating_point, joint, "rad", "m"))];
    let load = Arc::clone(&operating_point.load);
    AllRows::term(&FAMILY, "", site, settings, columns, move |gravity| {
        Zero(PositionError { joint, load: load.under(gravity) })
    })
}

struct Zero(PositionError);

impl Law for Zero {
    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        if let Some(column) = columns.first_mut() {
            *column = self.0.signature(sample, [1.0, 0.0, 0.0]);
        }
    }
}
