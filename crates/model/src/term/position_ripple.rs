//! Torque ripple over the joint's angle.

use super::family::*;
use super::one_row::*;

/// One wave of torque over the joint's angle.
pub static FAMILY: Family = Family {
    id: "position-ripple",
    physics: "Gear meshing, cogging and the torque sensor itself cause a torque ripple over the joint's angle.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = rs_j sin(n q_j) + rc_j cos(n q_j)",
        // A harmonic drive of ratio N makes orders N and 2 N of the output. Steps of 0.5: over a range of 5 rad a wave between two of
        // them is 0.6 rad out of phase at the ends at most.
        settings: &[Setting {
            name: "n",
            unit: "1",
            what: "waves per turn of the joint",
            low: 1.0,
            high: 400.0,
            steps: 799,
            scale: Scale::Linear,
        }],
        build,
        in_c: InC::Columns(|at, settings| {
            ["sin", "cos"].map(|wave| format!("{wave}({:?}*{})", settings[0], at.q)).to_vec()
        }),
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.05 to 0.5 Nm, 1 to 2 % of a sensor's range",
    confounded: &[
        confounded("torque-offset", FULL_TURN),
        confounded("spring", FULL_TURN),
        confounded("lx and ly of the same link", "order 1 only: identify in a second mounting"),
    ],
    reference: "Taghirad, Belanger, Trans. ASME J. Dynamic Systems 120 (1998)",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (unit, n) = (unit(operating_point, joint(site), "Nm", "N"), order(settings[0]));
    let columns = ["sin", "cos"].map(|wave| column("ripple", site, &format!("_{n}_{wave}"), unit)).to_vec();
    let law = |at: &At, settings: &Settings| {
        let (sin, cos) = (settings[0] * at.own.q).sin_cos();
        [sin, cos, 0.0]
    };
    OneRow::new(&FAMILY, "", site, settings, columns, law).smooth().term()
}

/// An order in a column's name: `n12.5`, rounded to three decimals.
pub(super) fn order(n: f64) -> String {
    format!("n{}", (n * 1e3).round() / 1e3)
}
