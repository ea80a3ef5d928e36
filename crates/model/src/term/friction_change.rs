//! Change of friction since an identification.

use super::family::*;
use super::one_row::*;
use super::quantity;
use crate::torque::Parameter;

/// Identity.
pub const ID: &str = "friction-change";

/// A change of one joint's viscous and Coulomb friction.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "A joint's friction has changed since the model was identified: new grease, wear, another temperature.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = dfv_j dq_j + dfc_j tanh(100 dq_j)",
        settings: &[],
        build,
        in_c: InC::Columns(|at, _| vec![at.dq.clone(), at.sign.clone()]),
        plot_over: PlotOver::Velocity,
    }],
    stratum: Stratum::Reference,
    typical: "20 to 50 % between a cold and a warm gear",
    confounded: &[
        confounded("friction-drift", "repeat the motion for half an hour: a drift goes on"),
        confounded("load-dependent-friction", "pass the same poses with and without a load"),
    ],
    reference: "Bittencourt, Gunnarsson, ASME J. Dynamic Systems, Measurement and Control 134 (2012)",
    rare: Rare {
        may_change: true,
        comes_at_once: true,
        changed_parameter,
        quantities: parameters_and_factors,
        ..Rare::NONE
    },
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let joint = joint(site);
    let columns = vec![
        column("dfv", site, "", unit(operating_point, joint, "Nms/rad", "Ns/m")),
        column("dfc", site, "", unit(operating_point, joint, "Nm", "N")),
    ];
    OneRow::new(&FAMILY, "", site, settings, columns, |at, _| [at.own.dq, smooth_sign(at.own.dq), 0.0]).term()
}

/// `dfv3` changes `fv3`.
fn changed_parameter(column: &str) -> &str {
    column.trim_start_matches('d')
}

/// The parameters, and each coefficient as a factor of the one before the change.
fn parameters_and_factors(results: &Results) -> Vec<Quantity> {
    let before = |name: &str| results.stored.iter().find(|stored| stored.column.name == name);
    let factor = |own: &Parameter| {
        let stored =
            before(changed_parameter(&own.column.name)).filter(|stored| stored.value.abs() > f64::MIN_POSITIVE)?;
        let name = format!("{}_factor", stored.column.name);
        let std = own.std.map(|std| std / stored.value.abs());
        Some(Quantity { name, value: 1.0 + own.value / stored.value, std, unit: "1".into() })
    };
    quantity::own(results).into_iter().chain(results.parameters.iter().filter_map(factor)).collect()
}
