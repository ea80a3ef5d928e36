//! A tool or load on the last link that the model was not told of.

use super::all_rows::{AllRows, Clock, Law};
use super::effect::{Confounded, Family, Form, Ground, Place, Site, Stratum};
use super::{Column, Sample, Term};
use crate::fast::links::LinkColumns;
use crate::regressor::LINK_COLUMNS;
use plumbline_core::JointVec;
use std::sync::Arc;

/// Identity.
pub const ID: &str = "payload";

/// A rigid body fixed to the last link, beside the link's own.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A rigid body is fixed to the last link that was not there when the model was identified.",
    place: Place::Arm,
    forms: &[Form {
        name: "",
        equation: "tau = Y_n [Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m], the body's in the last link's frame, in all rows",
        settings: &[],
        build,
    }],
    stratum: Stratum::Reference,
    served: true,
    typical: "0.1 to 3 kg",
    confounded: &[
        Confounded {
            with: "the last link's own parameters",
            decided_by: "a recording without the load, or a model from before",
        },
        Confounded { with: "torque-gain", decided_by: "weigh the load: a gain common to all joints scales all masses" },
        Confounded {
            with: "the link before the last",
            decided_by: "turn the wrist: a centre of mass on the last axis looks like theirs",
        },
    ],
    reference: "Khalil, Gautier, Lemoine, ICRA 2007; Swevers et al., IEEE Control Systems Magazine 27 (2007)",
};

const PARAMETERS: [(&str, &str); LINK_COLUMNS] = [
    ("Lxx", "kg m2"),
    ("Lxy", "kg m2"),
    ("Lxz", "kg m2"),
    ("Lyy", "kg m2"),
    ("Lyz", "kg m2"),
    ("Lzz", "kg m2"),
    ("lx", "kg m"),
    ("ly", "kg m"),
    ("lz", "kg m"),
    ("m", "kg"),
];

fn build(ground: &Ground, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let chain = ground.chain.clone();
    let named = |(what, unit): (&str, &'static str)| {
        let name = format!("payload_{what}");
        Column { symbol: name.clone(), expression: name.clone(), name, joint: chain.len(), unit }
    };
    let columns = PARAMETERS.map(named).to_vec();
    AllRows::term(&FAMILY, "", site, settings, columns, move |gravity| {
        let first = LINK_COLUMNS * (chain.len() - 1);
        let slots: Vec<usize> = (first..first + LINK_COLUMNS).collect();
        Body(LinkColumns::new(&chain, &slots, gravity))
    })
}

struct Body(LinkColumns);

impl Law for Body {
    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        self.0.fill(sample, columns);
    }
}
