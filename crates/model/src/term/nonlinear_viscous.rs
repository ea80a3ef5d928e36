//! Viscous friction that is not proportional to speed.

use super::family::*;
use super::one_row::*;

/// Viscous friction in addition to `fv dq`.
pub static FAMILY: Family = Family {
    id: "nonlinear-viscous",
    physics: "Grease becomes thinner at a higher shear rate, and churning grows with speed: viscous friction is not proportional to speed.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "sigmoid",
            equation: "tau_j = fn_j tanh(dq_j / vt)",
            settings: &[Setting {
                name: "vt",
                unit: "rad/s",
                what: "speed at which friction has reached 76 % of its level",
                // Slower than this, friction that falls with speed is Stribeck's, and friction that rises is Coulomb's.
                low: 0.1,
                high: 3.0,
                steps: 10,
                scale: Scale::Logarithmic,
            }],
            build: sigmoid,
            in_c: InC::Columns(|at, settings| vec![format!("tanh({}/{:?})", at.dq, settings[0])]),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "cubic",
            equation: "tau_j = fn_j dq_j^3",
            settings: &[],
            build: cubic,
            in_c: InC::Columns(|at, _| vec![format!("{0}*{0}*{0}", at.dq)]),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "quadratic",
            equation: "tau_j = fn_j dq_j |dq_j|",
            settings: &[],
            build: quadratic,
            in_c: InC::Columns(|at, _| vec![format!("{0}*fabs({0})", at.dq)]),
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "power",
            equation: "tau_j = fn_j sign(dq_j) |dq_j / (1 rad/s)|^p",
            settings: &[Setting {
                name: "p",
                unit: "1",
                what: "power of the speed: below 1 where grease becomes thinner",
                low: 0.2,
                high: 4.0,
                steps: 5,
                scale: Scale::Logarithmic,
            }],
            build: power,
            in_c: InC::Columns(|at, settings| {
                vec![format!("copysign(pow(fabs({0}), {1:?}), {0})", at.dq, settings[0])]
            }),
            plot_over: PlotOver::Velocity,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.3 to 1.3 Nm over a Panda's joints in the sigmoid form, vt 0.12 to 0.4 rad/s",
    confounded: &[
        confounded("stribeck", "move the joint at constant speeds of 0.02 rad/s up to its rated one"),
        confounded("coulomb-slope", CONSTANT_SPEEDS),
        confounded("presliding", SLOW_CONSTANT_SPEEDS),
        confounded("fv and fc", "they hold most of it: move the joint up to its rated speed"),
    ],
    reference: "Gaz et al., IEEE RA-L 4 (2019); Wolf, Iskandar, ICRA 2018; Waiboer, Aarts, Jonker, Multibody Dynamics (2005)",
    rare: Rare { slight_in_every_arm: true, ..Rare::NONE },
};

fn sigmoid(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let law = |at: &At, settings: &Settings| [(at.own.dq / settings[0]).tanh(), 0.0, 0.0];
    friction(&FAMILY, "sigmoid", "fn", operating_point, site, settings, law)
}

fn cubic(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fn", site, "_cubic", unit(operating_point, joint(site), "Nm s3/rad3", "N s3/m3"))];
    OneRow::new(&FAMILY, "cubic", site, settings, columns, |at, _| [at.own.dq.powi(3), 0.0, 0.0]).term()
}

fn quadratic(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fn", site, "_quadratic", unit(operating_point, joint(site), "Nm s2/rad2", "N s2/m2"))];
    OneRow::new(&FAMILY, "quadratic", site, settings, columns, |at, _| [at.own.dq * at.own.dq.abs(), 0.0, 0.0]).term()
}

fn power(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("fn", site, "_power", unit(operating_point, joint(site), "Nm", "N"))];
    let law = |at: &At, settings: &Settings| [at.own.dq.abs().powf(settings[0]).copysign(at.own.dq), 0.0, 0.0];
    let row = OneRow::new(&FAMILY, "power", site, settings, columns, law);
    // Less of a power below 1 is friction that falls from rest on: Stribeck's.
    if settings[0] < 1.0 { row.not_negative() } else { row }.term()
}
