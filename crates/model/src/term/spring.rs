//! Springs on a joint: cables, hoses, gravity compensators.

use super::family::*;
use super::one_row::*;

const Q0: Setting = Setting {
    name: "q0",
    unit: "rad",
    what: "position at which the spring begins to pull",
    low: -3.0,
    high: 3.0,
    steps: 25,
    scale: Scale::Linear,
};

/// A spring on one joint.
pub static FAMILY: Family = Family {
    id: "spring",
    physics: "Cables, hoses or a balancer act as a spring on the joint.",
    place: Place::Joint,
    forms: &[
        Form {
            name: "linear",
            equation: "tau_j = k_j q_j + k0_j",
            settings: &[],
            build: linear,
            in_c: InC::Columns(|at, _| vec![at.q.clone(), "1.0".into()]),
            plot_over: PlotOver::Position,
        },
        Form {
            name: "above",
            equation: "tau_j = k_j max(0, q_j - q0)",
            settings: &[Q0],
            build: above,
            in_c: InC::Columns(|at, settings| vec![format!("fmax(0.0, {} - ({:?}))", at.q, settings[0])]),
            plot_over: PlotOver::Position,
        },
        Form {
            name: "below",
            equation: "tau_j = k_j max(0, q0 - q_j)",
            settings: &[Q0],
            build: below,
            in_c: InC::Columns(|at, settings| vec![format!("fmax(0.0, ({:?}) - {})", settings[0], at.q)]),
            plot_over: PlotOver::Position,
        },
        Form {
            name: "cubic",
            equation: "tau_j = k_j q_j + k3_j q_j^3 + k0_j",
            settings: &[],
            build: cubic,
            in_c: InC::Columns(|at, _| vec![at.q.clone(), "1.0".into(), format!("{0}*{0}*{0}", at.q)]),
            plot_over: PlotOver::Position,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.1 to 2 Nm/rad",
    confounded: &[
        confounded("torque-offset", MOST_OF_RANGE),
        confounded("position-ripple", FULL_TURN),
        confounded("lx and ly of the same link", "identify in a second mounting"),
    ],
    reference: "Swevers et al., IEEE Trans. Robotics and Automation 13 (1997)",
    rare: Rare { may_change: true, ..Rare::NONE },
};

fn linear(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    OneRow::new(&FAMILY, "linear", site, settings, straight(operating_point, site), |at, _| [at.own.q, 1.0, 0.0]).term()
}

fn cubic(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let mut columns = straight(operating_point, site);
    columns.push(column("spring", site, "_cubic", unit(operating_point, joint(site), "Nm/rad3", "N/m3")));
    OneRow::new(&FAMILY, "cubic", site, settings, columns, |at, _| [at.own.q, 1.0, at.own.q.powi(3)]).term()
}

fn straight(operating_point: &OperatingPoint, site: Site) -> Vec<super::Column> {
    let joint = joint(site);
    let stiffness = column("spring", site, "", unit(operating_point, joint, "Nm/rad", "N/m"));
    vec![stiffness, column("spring", site, "_preload", unit(operating_point, joint, "Nm", "N"))]
}

/// It is taut on one side, and pulls back.
fn above(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("spring", site, "_above", unit(operating_point, joint(site), "Nm/rad", "N/m"))];
    let law = |at: &At, settings: &Settings| [(at.own.q - settings[0]).max(0.0), 0.0, 0.0];
    OneRow::new(&FAMILY, "above", site, settings, columns, law).not_negative().term()
}

/// As [`above`]: what pulls up has a negative torque.
fn below(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let columns = vec![column("spring", site, "_below", unit(operating_point, joint(site), "Nm/rad", "N/m"))];
    let law = |at: &At, settings: &Settings| [(settings[0] - at.own.q).max(0.0), 0.0, 0.0];
    OneRow::new(&FAMILY, "below", site, settings, columns, law).not_positive().term()
}

#[cfg(test)]
mod tests {
    use super::super::Expected;
    use super::super::nonlinear_viscous;
    use super::*;
    use crate::{Chain, Joint, JointKind, Mounting, Placement, Reduction, Structure};

    #[test]
    fn signs_are_those_of_what_pulls_back_and_brakes() {
        let chain = Chain::modified(
            vec![Joint { kind: JointKind::Revolute, a: 0.5, alpha: 0.0, d: 0.0, theta: 0.0 }],
            Placement::identity(),
        );
        let reduction = Reduction::in_mounting(&chain, &Mounting::WALL);
        let structure = Structure::of(chain, reduction, &["friction"]).unwrap();
        let operating_point = structure.operating_point(&vec![0.0; structure.columns().len()]);
        let expected = |family: &Family, form: &'static str, settings: &[f64]| {
            let spec = Spec { family: family.id, form, site: Site::Joint(0), settings: settings.to_vec() };
            spec.build(&operating_point).unwrap().expects()
        };
        assert_eq!(expected(&FAMILY, "above", &[0.5]), Expected::NotNegative);
        assert_eq!(expected(&FAMILY, "below", &[0.5]), Expected::NotPositive);
        // A balancer may push away from where it is at rest.
        assert_eq!(expected(&FAMILY, "linear", &[]), Expected::Any);
        let power = |p: f64| expected(&nonlinear_viscous::FAMILY, "power", &[p]);
        assert_eq!([power(0.4), power(1.5)], [Expected::NotNegative, Expected::Any]);
    }
}
