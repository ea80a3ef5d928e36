//! Eccentricity of an encoder.

use super::all_rows::*;
use super::family::*;
use super::one_row::{column, unit};
use super::position_error::{MAX_POSITION_ERROR, PositionError};
use super::{Expected, Motion, Sample};
use plumbline_core::JointVec;

/// An error of one joint's position, true minus measured, with the period of a turn.
pub static FAMILY: Family = Family {
    id: "encoder-eccentricity",
    physics: "An encoder's disc is off the joint's axis, so that the measured angle has an error with the period of a turn.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau = es_i lin_i(sin q_i) + ec_i lin_i(cos q_i), lin_i(e) = K_i e + V_i e' + M_i e'' in all rows",
        settings: &[],
        build,
        in_c: REFUSED_OTHER_STATE,
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.1 to 2 mrad",
    confounded: &[
        confounded("encoder-offset", FULL_TURN),
        confounded("lx and ly of the same link", "move the joint through a full turn; identify in a second mounting"),
    ],
    reference: "Hollerbach, Khalil, Gautier, Handbook of Robotics (2016), chapter 6",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let unit = unit(operating_point, joint, "rad", "m");
    let columns = ["_sin", "_cos"].map(|wave| column("eccentricity", site, wave, unit)).to_vec();
    let load = Arc::clone(&operating_point.load);
    AllRows::term(&FAMILY, "", site, settings, columns, move |gravity| {
        Eccentricity(PositionError::new(joint, &load, gravity))
    })
}

struct Eccentricity(PositionError);

impl Law for Eccentricity {
    const EXPECTS: Expected = Expected::AtMost(MAX_POSITION_ERROR);

    fn follow(&mut self, motion: &Motion) {
        self.0.follow(motion);
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let joint = self.0.joint;
        let (Some(&q), Some(&dq), Some(&ddq)) = (sample.q.get(joint), sample.dq.get(joint), sample.ddq.get(joint))
        else {
            return;
        };
        let (sin, cos) = q.sin_cos();
        let waves = [[sin, cos * dq, cos * ddq - sin * dq * dq], [cos, -sin * dq, -sin * ddq - cos * dq * dq]];
        for (column, wave) in columns.iter_mut().zip(waves) {
            *column = self.0.signature(sample, clock.index, wave);
        }
    }
}
