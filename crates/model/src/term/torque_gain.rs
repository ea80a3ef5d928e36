//! Gain error of a torque sensor.

use super::family::*;
use super::one_row::*;

/// A share of a joint's own rigid-body torque.
pub static FAMILY: Family = Family {
    id: "torque-gain",
    physics: "The sensitivity of a joint's torque sensor, or its motor's torque constant, is wrong by a constant factor.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = gain_j tau_rb_j",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![at.load.clone()]),
        plot_over: PlotOver::Load,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.5 to 3 %",
    confounded: &[
        confounded("payload", "a gain common to all joints is a scale of all masses: add a known mass"),
        confounded("load-dependent-friction", SLOW_BOTH_DIRECTIONS),
        confounded(
            "the parameters of the last links",
            "none on the last joint: no other row sees its link alone; further in, load the outer joints harder",
        ),
    ],
    reference: "Gautier, Venture, IROS 2013; Ma, Hollerbach, ICRA 1996",
    rare: Rare { may_change: true, ..Rare::NONE },
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("gain", site, "", "1")];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.load, 0.0, 0.0]).loaded(operating_point).term()
}
