//! Friction that depends on the joint's angle.

use super::family::*;
use super::one_row::*;
use super::position_ripple::order;

/// One wave of friction over the joint's angle.
pub static FAMILY: Family = Family {
    id: "position-dependent-friction",
    physics: "A shaft, bearing or seal that is not round has more friction at some angles of the joint than at others.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = (fqs_j sin(n q_j) + fqc_j cos(n q_j)) tanh(100 dq_j)",
        settings: &[Setting {
            name: "n",
            unit: "1",
            what: "waves per turn of the joint",
            low: 1.0,
            high: 20.0,
            steps: 39,
            scale: Scale::Linear,
        }],
        build,
        in_c: InC::Columns(|at, settings| {
            ["sin", "cos"].map(|wave| format!("{wave}({:?}*{})*{}", settings[0], at.q, at.sign)).to_vec()
        }),
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    typical: "5 to 50 % of the Coulomb friction",
    confounded: &[confounded("load-dependent-friction", OTHER_LOAD)],
    reference: "Popovic, Goldenberg, IEEE Trans. Robotics and Automation 14 (1998); Armstrong-Helouvry et al., Automatica 30 (1994)",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (unit, n) = (unit(operating_point, joint(site), "Nm", "N"), order(settings[0]));
    let columns = ["sin", "cos"].map(|wave| column("frictionwave", site, &format!("_{n}_{wave}"), unit)).to_vec();
    let law = |at: &At, settings: &Settings| {
        let ((sin, cos), s) = ((settings[0] * at.own.q).sin_cos(), smooth_sign(at.own.dq));
        [sin * s, cos * s, 0.0]
    };
    OneRow::new(&FAMILY, "", site, settings, columns, law).term()
}
