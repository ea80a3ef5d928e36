//! Tilt of the base.

use super::Sample;
use super::all_rows::*;
use super::family::*;
use super::load::LoadUnder;
use super::one_row::column;
use super::quantity;
use crate::gravity::Mounting;
use nalgebra::Vector3;
use plumbline_core::JointVec;

/// A small tilt of the base, as two angles. A VBS lacks two parameters that a tilt excites, so that its columns are incomplete.
pub static FAMILY: Family = Family {
    id: "mounting",
    physics: "The base is mounted at another angle than declared.",
    place: Place::Arm,
    forms: &[Form {
        name: "",
        equation: "tau = d tau_rb / d g (tilt_a a x g + tilt_b b x g), in all rows; upright a, b are the base x, y axes",
        settings: &[],
        build,
        in_c: REFUSED_OTHER_STATE,
        plot_over: PlotOver::Nothing,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.5 degrees, which are 0.1 to 0.2 Nm per joint near the base",
    confounded: &[
        confounded("lx1 and ly1", "turn joint 1 by more than 90 degrees; identify in a second mounting"),
        confounded("spring", "turn joint 1 as far as it goes"),
        confounded("torque-offset", "turn joint 1 by more than 90 degrees"),
    ],
    reference: "the paper's equation 3, whose direction of gravity it turns",
    rare: Rare { may_change: true, comes_at_once: true, quantities: angles, ..Rare::NONE },
};

/// The axes of the two tilts in the base frame: across gravity, and `a`, `b`, up a right-handed frame. `a` is the base's x axis
/// upright, and in every other mounting the part across gravity of its x axis (of its y axis where x is within 37 degrees of
/// gravity).
pub fn axes(gravity: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let up = -gravity.normalize();
    let base = if up.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let a = (base - up * up.dot(&base)).normalize();
    [a, up.cross(&a)]
}

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let load = Arc::clone(&operating_point.load);
    let columns = ["tilt_a", "tilt_b"].map(|stem| column(stem, site, "", "rad")).to_vec();
    AllRows::term(&FAMILY, "", site, settings, columns, move |gravity| {
        // Without gravity a tilt has no effect.
        let turned = |axis: Vector3<f64>| load.under(&axis.cross(gravity));
        let tilts = if gravity.norm() > 0.0 { axes(gravity).map(turned).to_vec() } else { Vec::new() };
        Tilt(tilts)
    })
}

/// The rigid bodies under the change of gravity by each tilt.
struct Tilt(Vec<LoadUnder>);

impl Law for Tilt {
    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        for (column, load) in columns.iter_mut().zip(&mut self.0) {
            *column = at_rest(load, sample);
        }
    }
}

/// Gravity torque in the pose of a sample: the part of `tau_rb` that is linear in gravity.
pub(super) fn at_rest(load: &mut LoadUnder, sample: &Sample) -> JointVec {
    load.torque(&Sample { q: sample.q, ..Sample::default() })
}

/// The parameters, the tilt as one angle, and the mounting that the base then has.
fn angles(results: &Results) -> Vec<Quantity> {
    let [a, b] = [0, 1].map(|k| results.parameters.get(k).map_or(0.0, |own| own.value));
    let size = a.hypot(b);
    let share = [a / size, b / size];
    let variance =
        (0..2).flat_map(|i| (0..2).map(move |k| (i, k))).map(|(i, k)| share[i] * share[k] * results.covariance[(i, k)]);
    let std = (size > 0.0).then(|| variance.sum::<f64>().max(0.0).sqrt());
    let angle = |name: &str, value: f64, std| Quantity { name: name.into(), value, std, unit: "rad".into() };
    let mounting = results.declared.map(|declared| tilted(declared, [a, b]));
    let mounting = mounting.map(|mounting| [angle("rho", mounting.rho, None), angle("phi", mounting.phi, None)]);
    let tilt = angle("tilt", size, std);
    quantity::own(results).into_iter().chain([tilt]).chain(mounting.into_iter().flatten()).collect()
}

/// The declared mounting turned by a tilt.
fn tilted(declared: &Mounting, tilt: [f64; 2]) -> Mounting {
    let gravity = declared.gravity();
    let [a, b] = axes(&gravity);
    Mounting::along(&(gravity + tilt[0] * a.cross(&gravity) + tilt[1] * b.cross(&gravity)))
}
