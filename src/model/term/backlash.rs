//! Play in a gear.

use super::all_rows::{AllRows, Clock, Law, Past};
use super::carried::{CarriedFriction, LINK_FRICTION};
use super::effect::{Confounded, Family, Form, Ground, Place, Scale, Setting, Site, Stratum, joint};
use super::one_row::{column, unit};
use super::position_error::PositionError;
use super::{Sample, Term};
use crate::joint::JointVec;
use std::sync::Arc;

/// Identity.
pub const ID: &str = "backlash";

/// The gap of one joint's gear, which the link falls through when its load changes sign.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "Between a gear's teeth is a gap, and the link falls from one side to the other when its load changes sign.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "",
            equation: "tau = gap_i lin_i(-tanh(tau_rb_i / width)), lin_i(e) = K_i e + V_i e' + M_i e'' in all rows",
            settings: &[WIDTH],
            build: of_body,
        },
        Form {
            name: LINK_FRICTION,
            equation: "tau = gap_i lin_i(-tanh((tau_rb_i + fv_i dq_i + fc_i tanh(100 dq_i)) / width)): friction behind the gear",
            settings: &[WIDTH],
            build: with_friction,
        },
    ],
    stratum: Stratum::Repeatable,
    served: true,
    typical: "half a gap of 0.1 to 1.5 mrad",
    confounded: &[
        Confounded { with: "contact", decided_by: "repeat the motion: the teeth change flanks in every period" },
        Confounded { with: "joint-elasticity", decided_by: "pass through poses without load in several runs" },
    ],
    reference: "Nordin, Gutman, Automatica 38 (2002)",
};

const WIDTH: Setting = Setting {
    name: "width",
    unit: "Nm",
    what: "load at which the teeth lie on a flank with 76 % of the gap",
    low: 0.05,
    high: 5.0,
    steps: 4,
    scale: Scale::Logarithmic,
};

fn of_body(ground: &Ground, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    build(ground, "", site, settings)
}

fn with_friction(ground: &Ground, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    build(ground, LINK_FRICTION, site, settings)
}

fn build(ground: &Ground, form: &'static str, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let friction = CarriedFriction::through_gear(ground, form);
    let (joint, width) = (joint(site), settings[0]);
    let columns = vec![column("gap", site, "", unit(ground, joint, "rad", "m"))];
    let load = Arc::clone(&ground.load);
    AllRows::term(&FAMILY, form, site, settings, columns, move |gravity| {
        let error = PositionError { joint, load: load.under(gravity) };
        Gap { error, friction, width, past: Past::default() }
    })
}

struct Gap {
    error: PositionError,
    friction: CarriedFriction,
    width: f64,
    past: Past,
}

impl Law for Gap {
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let carried = self.error.own(sample) + self.friction.torque(sample, self.error.joint);
        let e = -(carried / self.width).tanh();
        let [de, dde] = self.past.derivatives(e, clock.dt);
        if let Some(column) = columns.first_mut() {
            *column = self.error.signature(sample, [e, de, dde]);
        }
    }
}
