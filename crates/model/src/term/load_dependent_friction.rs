//! Friction in proportion to the load of a gear.

use super::family::*;
use super::one_row::*;

/// Friction in proportion to the rigid-body torque of the same joint.
pub static FAMILY: Family = Family {
    id: "load-dependent-friction",
    physics: "Gears and bearings have more friction under a higher load.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "coulomb",
            equation: "tau_j = fl_j |tau_rb_j| tanh(100 dq_j)",
            settings: &[],
            build: coulomb,
            in_c: InC::Columns(|at, _| vec![format!("fabs({})*{}", at.load, at.sign)]),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "viscous",
            equation: "tau_j = fl_j |tau_rb_j| dq_j",
            settings: &[],
            build: viscous,
            in_c: InC::Columns(|at, _| vec![format!("fabs({})*{}", at.load, at.dq)]),
            plot_over: PlotOver::Velocity,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.5 to 5 % of the load",
    confounded: &[
        confounded("position-dependent-friction", OTHER_LOAD),
        confounded("torque-gain", SLOW_BOTH_DIRECTIONS),
    ],
    reference: "Hamon, Gautier, Garrec, IROS 2010; Bittencourt, Axelsson, IEEE/ASME Trans. Mechatronics 19 (2014)",
    rare: Rare::NONE,
};

fn coulomb(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fl", site, "_coulomb", "1")];
    let law = |at: &At, _: &Settings| [at.load.abs() * smooth_sign(at.own.dq), 0.0, 0.0];
    OneRow::new(&FAMILY, "coulomb", site, settings, columns, law).loaded(operating_point).not_negative().term()
}

fn viscous(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fl", site, "_viscous", unit(operating_point, joint(site), "s/rad", "s/m"))];
    let law = |at: &At, _: &Settings| [at.load.abs() * at.own.dq, 0.0, 0.0];
    OneRow::new(&FAMILY, "viscous", site, settings, columns, law).loaded(operating_point).not_negative().term()
}
