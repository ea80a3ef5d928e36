//! Offset of an encoder's zero.

use super::all_rows::*;
use super::family::*;
use super::one_row::{column, unit};
use super::position_error::{MAX_POSITION_ERROR, PositionError};
use super::{Expected, Motion, Sample};
use plumbline_core::JointVec;

/// Identity.
pub const ID: &str = "encoder-offset";

/// A constant error of one joint's position: its true position minus the measured one.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The zero of a joint's encoder differs from the zero of the robot's kinematics.",
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
    typical: "1 to 10 mrad",
    confounded: &[
        confounded(
            "lx and ly of the same link",
            "they hold most of it; a calibration with a tracker or a calibrated pose tells the two apart",
        ),
        confounded("joint-elasticity", SECOND_MOUNTING),
        confounded("mounting", "of joint 1 they are the same, and the tilt is named; level the base"),
    ],
    reference: "Khalil, Dombre, Modeling, Identification and Control of Robots (2002), chapter 11",
    rare: Rare { may_change: true, comes_at_once: true, ..Rare::NONE },
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![column("zero", site, "", unit(operating_point, joint, "rad", "m"))];
    let load = Arc::clone(&operating_point.load);
    AllRows::term(&FAMILY, "", site, settings, columns, move |gravity| Zero(PositionError::new(joint, &load, gravity)))
}

struct Zero(PositionError);

impl Law for Zero {
    const EXPECTS: Expected = Expected::AtMost(MAX_POSITION_ERROR);

    fn follow(&mut self, motion: &Motion) {
        self.0.follow(motion);
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        if let Some(column) = columns.first_mut() {
            *column = self.0.signature(sample, clock.index, [1.0, 0.0, 0.0]);
        }
    }
}
