//! Elasticity of a gear.

use super::all_rows::*;
use super::carried::CarriedFriction;
use super::family::*;
use super::one_row::{column, unit};
use super::position_error::PositionError;
use super::swing::{Gear, QUALITY, ROTOR, SWINGING, Swing, WITH_ROTOR};
use super::{Column, Expected, Motion, Sample};
use plumbline_core::JointVec;

/// Identity.
pub const ID: &str = "joint-elasticity";

/// Name of the form with friction on the link's side of the gear, which the gear transmits.
const LINK_FRICTION: &str = "link-friction";

/// Twist of one joint's gear, for motions that are slow against its resonance.
///
/// Without memory the link is at `q_i - c_i tau_rb_i`, first order in the compliance; `e'` and `e''` are differences of the torques before, so
/// that a regressor needs a motion on a grid that is fine against it (20 samples per period of its highest harmonic).
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The encoder is on the motor's side, and the gear or torque sensor behind it twists under the joint's load.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "",
            equation: "tau = c_i lin_i(-tau_rb_i), lin_i(e) = K_i e + V_i e' + M_i e'' in all rows",
            settings: &[],
            build: of_body,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
        Form {
            name: LINK_FRICTION,
            equation: "tau = c_i lin_i(-(tau_rb_i + fv_i dq_i + fc_i tanh(100 dq_i))): friction behind the gear",
            settings: &[],
            build: with_friction,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
        Form {
            name: SWINGING,
            equation: "tau = c_i lin_i(-theta / c), theta = c (tau_i - sqrt(M_ii / c) / quality dtheta), tau_i = tau_rb_i(q - theta) + f_i(dq_i - dtheta): with the resonance of the link",
            settings: &[COMPLIANCE, QUALITY],
            build: swinging,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
        Form {
            name: WITH_ROTOR,
            equation: "tau = c_i (lin_i(-theta) + ia_i ddtheta) / c, theta = c (tau_i - sqrt((M_ii - ia_i) / c) / quality dtheta), tau_i = tau_rb_i(q - theta) - ia_i (ddq_i - ddtheta) + f_i(dq_i - dtheta), ia_i = rotor M_ii(0): as swinging, where the rigid body has absorbed the inertia of a rotor",
            settings: &[COMPLIANCE, QUALITY, ROTOR],
            build: with_rotor,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Load,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "5e-5 to 2e-4 rad/Nm",
    confounded: &[
        confounded("encoder-offset", SECOND_MOUNTING),
        confounded("lx and ly of the same link", "log the position on both sides of the gear"),
    ],
    reference: "Albu-Schaeffer, Ott, Hirzinger, Int. J. Robotics Research 26 (2007)",
    rare: Rare { with_rotor: Some(WITH_ROTOR), ..Rare::NONE },
};

const COMPLIANCE: Setting = Setting {
    name: "c",
    unit: "rad/Nm",
    what: "compliance on which the link swings",
    low: 1e-5,
    high: 3.2e-2,
    steps: 8,
    scale: Scale::Logarithmic,
};

fn of_body(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    build(operating_point, "", CarriedFriction::default(), site, settings)
}

fn with_friction(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    build(operating_point, LINK_FRICTION, CarriedFriction::of(operating_point), site, settings)
}

fn swinging(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    swing(SWINGING, operating_point, site, settings)
}

fn with_rotor(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    swing(WITH_ROTOR, operating_point, site, settings)
}

fn swing(form: &'static str, operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let gear = Gear::Spring(settings[0]);
    Swing::term(&FAMILY, form, operating_point, site, settings, columns(operating_point, site), gear)
}

fn columns(operating_point: &OperatingPoint, site: Site) -> Vec<Column> {
    vec![column("compliance", site, "", unit(operating_point, joint(site), "rad/Nm", "m/N"))]
}

fn build(
    operating_point: &OperatingPoint,
    form: &'static str,
    friction: CarriedFriction,
    site: Site,
    settings: &[f64],
) -> Arc<dyn Term> {
    let joint = joint(site);
    let load = Arc::clone(&operating_point.load);
    AllRows::term(&FAMILY, form, site, settings, columns(operating_point, site), move |gravity| {
        let error = PositionError::new(joint, &load, gravity);
        Twist { error, friction, past: Past::default() }
    })
}

struct Twist {
    error: PositionError,
    friction: CarriedFriction,
    past: Past,
}

impl Law for Twist {
    const EXPECTS: Expected = Expected::NotNegative;

    fn follow(&mut self, motion: &Motion) {
        self.error.follow(motion);
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let e = -(self.error.own(sample, clock.index) + self.friction.torque(sample, self.error.joint));
        let [de, dde] = self.past.derivatives(e, clock.dt);
        if let Some(column) = columns.first_mut() {
            *column = self.error.signature(sample, clock.index, [e, de, dde]);
        }
    }
}
