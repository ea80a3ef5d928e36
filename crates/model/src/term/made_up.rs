//! Made up, for one test: a torque that no arm has. `tests/made_up_effect.rs` finds it in the program, as any effect that is added by the
//! recipe in CONTRIBUTING.md. Only the feature `made-up-effect` has it.

use super::family::*;
use super::one_row::*;

/// A torque in proportion to position times velocity.
pub static FAMILY: Family = Family {
    id: "made-up",
    physics: "Made up for a test: a torque in proportion to position times velocity.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = madeup_j q_j dq_j",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![format!("{}*{}", at.q, at.dq)]),
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    typical: "none on any arm",
    confounded: &[confounded("asymmetric-viscous", "none is needed: no arm has it")],
    reference: "tests/made_up_effect.rs",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("madeup", site, "", unit(operating_point, joint(site), "Nms/rad2", "Ns/m2"))];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.own.q * at.own.dq, 0.0, 0.0]).smooth().term()
}
