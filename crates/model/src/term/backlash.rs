//! Play in a gear.

use super::all_rows::*;
use super::family::*;
use super::one_row::{column, unit};
use super::position_error::PositionError;
use super::swing::{Gear, QUALITY, ROTOR, SWINGING, Swing, WITH_ROTOR};
use super::{Column, Expected, Motion, Sample};
use plumbline_core::JointVec;

/// The play of one joint's gear, which the link crosses when its load changes sign.
pub static FAMILY: Family = Family {
    id: "backlash",
    physics: "The gear has play, and the link moves from one flank to the other when its load changes sign.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "",
            equation: "tau = gap_i lin_i(-tanh(tau_rb_i / width)), lin_i(e) = K_i e + V_i e' + M_i e'' in all rows",
            settings: &[FLANK_WIDTH],
            build: of_body,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
        Form {
            name: SWINGING,
            equation: "tau = gap_i lin_i(-theta / g), theta = g tanh(s / width) + c s, s = tau_i - d dtheta, d = sqrt(M_ii / (dtheta/ds)) / quality, tau_i = tau_rb_i(q - theta) + f_i(dq_i - dtheta): the link's inertia swings in the gap and on elastic teeth",
            settings: &[HALF_GAP, FLANK_WIDTH, COMPLIANCE, QUALITY],
            build: swinging,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
        Form {
            name: WITH_ROTOR,
            equation: "tau = gap_i (lin_i(-theta) + ia_i ddtheta) / g, theta = g tanh(s / width) + c s, s = tau_i - d dtheta, d = sqrt((M_ii - ia_i) / (dtheta/ds)) / quality, tau_i = tau_rb_i(q - theta) - ia_i (ddq_i - ddtheta) + f_i(dq_i - dtheta), ia_i = rotor M_ii(0): as swinging, where the rigid body has absorbed the inertia of a rotor",
            settings: &[HALF_GAP, FLANK_WIDTH, COMPLIANCE, QUALITY, ROTOR],
            build: with_rotor,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "half a gap of 0.1 to 1.5 mrad",
    confounded: &[
        confounded("contact", "repeat the motion: the teeth change flanks in every period"),
        confounded("joint-elasticity", "pass through poses without load in several runs"),
    ],
    reference: "Nordin, Gutman, Automatica 38 (2002)",
    rare: Rare { with_rotor: Some(WITH_ROTOR), ..Rare::NONE },
};

const HALF_GAP: Setting = Setting {
    name: "g",
    unit: "rad",
    what: "half of the gap in which the link swings",
    low: 5e-5,
    high: 6e-3,
    steps: 4,
    scale: Scale::Logarithmic,
};

const FLANK_WIDTH: Setting = Setting {
    name: "width",
    unit: "Nm",
    what: "load at which the teeth lie on a flank with 76 % of the gap",
    low: 0.0001,
    high: 1.0,
    steps: 3,
    scale: Scale::Logarithmic,
};

const COMPLIANCE: Setting = Setting {
    name: "c",
    unit: "rad/Nm",
    what: "compliance of teeth and shaft",
    low: 1e-6,
    high: 1e-3,
    steps: 3,
    scale: Scale::Logarithmic,
};

fn of_body(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (joint, width) = (joint(site), settings[0]);
    let load = Arc::clone(&operating_point.load);
    AllRows::term(&FAMILY, "", site, settings, columns(operating_point, site), move |gravity| {
        let error = PositionError::new(joint, &load, gravity);
        Gap { error, width, past: Past::default() }
    })
}

fn swinging(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    swing(SWINGING, operating_point, site, settings)
}

fn with_rotor(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    swing(WITH_ROTOR, operating_point, site, settings)
}

fn swing(form: &'static str, operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let gear = Gear::Gap { gap: settings[0], width: settings[1], compliance: settings[2] };
    Swing::term(&FAMILY, form, operating_point, site, settings, columns(operating_point, site), gear)
}

fn columns(operating_point: &OperatingPoint, site: Site) -> Vec<Column> {
    vec![column("gap", site, "", unit(operating_point, joint(site), "rad", "m"))]
}

struct Gap {
    error: PositionError,
    width: f64,
    past: Past,
}

impl Law for Gap {
    const EXPECTS: Expected = Expected::NotNegative;

    fn follow(&mut self, motion: &Motion) {
        self.error.follow(motion);
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let e = -(self.error.own(sample, clock.index) / self.width).tanh();
        let [de, dde] = self.past.derivatives(e, clock.dt);
        if let Some(column) = columns.first_mut() {
            *column = self.error.signature(sample, clock.index, [e, de, dde]);
        }
    }
}
