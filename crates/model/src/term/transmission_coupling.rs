//! Joints whose gears or seals are coupled.

use super::all_rows::{AllRows, Clock, Law};
use super::family::*;
use super::friction::SHARPNESS;
use super::one_row::{At, OneRow, Settings, column, row_and_cause, smooth_sign, unit};
use super::{Expected, Sample};
use crate::chain::JointKind::{Prismatic, Revolute};
use plumbline_core::JointVec;

/// Friction or inertia of one joint's drive in another joint's torque, or friction of a shaft that both turn.
///
/// A shaft that turns with `w = dq_j + r dq_k` takes the torque `f(w)` of joint j and `r f(w)` of joint k, by the principle of virtual work:
/// `f w = f dq_j + r f dq_k`.
pub static FAMILY: Family = Family {
    id: "transmission-coupling",
    physics: "A differential, a tendon, or a seal between links makes the motion of one joint load the drive of another.",
    place: Place::Pair,
    forms: &[
        Form {
            name: "friction",
            equation: "tau_j = cfc_j_k tanh(100 dq_k) + cfv_j_k dq_k",
            settings: &[],
            build: friction,
            in_c: InC::Columns(|at, _| vec![at.cause_sign.clone(), at.cause_dq.clone()]),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "sum",
            equation: "tau_j = f, tau_k = r f, f = cfs_j_k tanh(100 (dq_j + r dq_k)): friction of a shaft",
            settings: &[Setting {
                name: "r",
                unit: "1",
                what: "turns of the shaft per turn of joint k; one per turn of joint j",
                // Past 1 it is the shaft seen from joint k, with 1 / r; 1 itself is well within.
                low: -1.25,
                high: 1.25,
                // An even number: r = 0 is joint j's own Coulomb friction.
                steps: 10,
                scale: Scale::Linear,
            }],
            build: sum,
            in_c: InC::BothRows {
                columns: |at, settings| {
                    vec![format!("tanh({SHARPNESS:?}*({} + ({:?})*{}))", at.dq, settings[0], at.cause_dq)]
                },
                share: |settings| settings[0],
            },
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "inertia",
            equation: "tau_j = cia_j_k ddq_k",
            settings: &[],
            build: inertia,
            in_c: InC::Columns(|at, _| vec![at.cause_ddq.clone()]),
            plot_over: PlotOver::Acceleration,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.05 to 0.3 Nm",
    confounded: &[
        confounded("torque-crosstalk", ONE_REVERSES),
        confounded("Lxz and Lyz", "turn one of the two joints through a large angle between the runs"),
    ],
    reference: "Gautier, Janot, Vandanjon, IEEE Trans. Control Systems Technology 21 (2013); Khalil, Dombre, Modeling, Identification and Control of Robots (2002), chapter 9",
    rare: Rare { between_coupled: true, ..Rare::NONE },
};

fn friction(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let unit = unit(operating_point, joint(site), "Nm", "N");
    let slope = per_motion(operating_point, site, ["Nms/rad", "Ns", "Ns/rad", "Ns/m"]);
    let columns = vec![column("cfc", site, "", unit), column("cfv", site, "", slope)];
    let law = |at: &At, _: &Settings| [smooth_sign(at.cause.dq), at.cause.dq, 0.0];
    OneRow::new(&FAMILY, "friction", site, settings, columns, law).term()
}

fn sum(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cfs", site, "", unit(operating_point, joint(site), "Nm", "N"))];
    let ((row, cause), turns) = (row_and_cause(site), settings[0]);
    AllRows::term(&FAMILY, "sum", site, settings, columns, move |_| Shaft { row, cause, turns })
}

struct Shaft {
    row: usize,
    cause: usize,
    turns: f64,
}

impl Law for Shaft {
    /// Friction brakes.
    const EXPECTS: Expected = Expected::NotNegative;

    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        let dq = |joint: usize| sample.dq.get(joint).copied().unwrap_or_default();
        let f = smooth_sign(dq(self.row) + self.turns * dq(self.cause));
        for column in columns {
            for (joint, share) in [(self.row, 1.0), (self.cause, self.turns)] {
                if let Some(torque) = column.get_mut(joint) {
                    *torque = share * f;
                }
            }
        }
    }
}

fn inertia(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("cia", site, "", per_motion(operating_point, site, ["kg m2", "kg m", "kg m", "kg"]))];
    OneRow::new(&FAMILY, "inertia", site, settings, columns, |at, _| [at.cause.ddq, 0.0, 0.0]).term()
}

/// A unit by the kinds of the row's joint and the other one: turning from turning, turning from sliding, sliding from turning,
/// sliding from sliding.
fn per_motion(operating_point: &OperatingPoint, site: Site, units: [&'static str; 4]) -> &'static str {
    let kind = |joint: Option<&usize>| joint.map_or(Revolute, |&joint| operating_point.chain.joints()[joint].kind);
    let joints = site.joints();
    match (kind(joints.first()), kind(joints.get(1))) {
        (Revolute, Revolute) => units[0],
        (Revolute, Prismatic) => units[1],
        (Prismatic, Revolute) => units[2],
        (Prismatic, Prismatic) => units[3],
    }
}
