//! Tilt of the base.

use super::Sample;
use super::all_rows::*;
use super::family::*;
use super::load::LoadUnder;
use super::one_row::column;
use super::quantity;
use crate::chain::JointKind;
use crate::gravity::{Mounting, VERTICAL_TOLERANCE};
use nalgebra::Vector3;
use plumbline_core::JointVec;
use std::f64::consts::PI;

/// A tilt of the base, as the two components of its rotation vector across gravity.
///
/// The torque is linear in gravity, and a tilt `t = t_a a + t_b b` by the angle `r = |t|` turns gravity to
/// `g + (sin r / r) t x g - (1 - cos r) g` (Rodrigues' formula, `t` across `g`). Without a setting the columns are the derivative at no tilt, which a search
/// can try without knowing the tilt. About a tilt `s` they are `(sin s / s) k x g - (1 - cos s) / s^2 s_k g` for `k = a, b`: at `t = s` their sum is exact.
///
/// Identified while gravity is along axis 1, an arm lacks two parameters that a tilt excites: the first moments of link 1 across its axis. Their torque in a
/// tilted base is a first harmonic of `q1` in row 1, of unknown size, and columns of the third form.
pub static FAMILY: Family = Family {
    id: "mounting",
    physics: "The base is mounted at another angle than declared.",
    place: Place::Arm,
    forms: &[
        Form {
            name: "",
            equation: "tau = d tau_rb / d g (tilt_a a x g + tilt_b b x g), in all rows; upright a, b are the base x, y axes",
            settings: &[],
            build: |operating_point, site, settings| build(operating_point, "", site, settings),
            in_c: REFUSED_OTHER_STATE,
            plot_over: PlotOver::Nothing,
        },
        Form {
            name: ABOUT_A_TILT,
            equation: "the same about the tilt a0, b0, where it is exact: tau = d tau_rb / d g (R g - g), R the rotation by the tilt",
            settings: &THE_TILT,
            build: |operating_point, site, settings| build(operating_point, ABOUT_A_TILT, site, settings),
            in_c: REFUSED_OTHER_STATE,
            plot_over: PlotOver::Nothing,
        },
        Form {
            name: WITH_FIRST_LINK,
            equation: "the same about the tilt a0, b0, and tau_1 = tilt_c cos q1 + tilt_s sin q1 where gravity is declared along axis 1",
            settings: &THE_TILT,
            build: |operating_point, site, settings| build(operating_point, WITH_FIRST_LINK, site, settings),
            in_c: REFUSED_OTHER_STATE,
            plot_over: PlotOver::Nothing,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "0.5 degrees, which are 0.1 to 0.2 Nm per joint near the base",
    confounded: &[
        confounded("lx1 and ly1", "turn joint 1 by more than 90 degrees; identify in a second mounting"),
        confounded("spring", "turn joint 1 as far as it goes"),
        confounded("torque-offset", "turn joint 1 by more than 90 degrees"),
        confounded("encoder-offset", "about axis 1 it is the zero of joint 1: level the base"),
    ],
    reference: "the paper's equation 3, whose direction of gravity it turns",
    rare: Rare { may_change: true, comes_at_once: true, quantities: angles, ..Rare::NONE },
};

/// The form whose columns are taken at a tilt. No search tries it, nor the next.
pub const ABOUT_A_TILT: &str = "about-a-tilt";
/// The same with the torque of the first moments of link 1.
pub const WITH_FIRST_LINK: &str = "about-a-tilt-with-first-link";

/// The tilt that columns are taken at.
const THE_TILT: [Setting; 2] = [
    Setting { name: "a0", what: "tilt_a at which the columns are taken", ..COMPONENT },
    Setting { name: "b0", what: "tilt_b at which the columns are taken", ..COMPONENT },
];
const COMPONENT: Setting =
    Setting { name: "", unit: "rad", what: "", low: -PI, high: PI, steps: 0, scale: Scale::Linear };

/// The axes of the two tilts in the base frame: across gravity, and `a`, `b`, up a right-handed frame. `a` is the base's x axis
/// upright, and in every other mounting the part across gravity of its x axis (of its y axis where x is within 37 degrees of
/// gravity).
pub fn axes(gravity: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let up = -gravity.normalize();
    let base = if up.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let a = (base - up * up.dot(&base)).normalize();
    [a, up.cross(&a)]
}

fn build(operating_point: &OperatingPoint, form: &'static str, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let load = Arc::clone(&operating_point.load);
    let has_first = form == WITH_FIRST_LINK;
    let of_first = [("tilt_c", "Nm"), ("tilt_s", "Nm")];
    let names = [("tilt_a", "rad"), ("tilt_b", "rad")].into_iter().chain(of_first.into_iter().filter(|_| has_first));
    let columns = names.map(|(stem, unit)| column(stem, site, "", unit)).collect();
    let about = match settings {
        &[a, b] => [a, b],
        _ => [0.0; 2],
    };
    AllRows::term(&FAMILY, form, site, settings, columns, move |gravity| {
        // Without gravity a tilt has no effect.
        let turned = |by: Vector3<f64>| load.under(&by);
        let turned = if gravity.norm() > 0.0 { turns(gravity, about).map(turned).to_vec() } else { Vec::new() };
        Tilt { turned, has_first: has_first && is_along_axis_1(gravity) }
    })
}

fn is_along_axis_1(gravity: &Vector3<f64>) -> bool {
    gravity.norm() > 0.0 && Mounting::along(gravity).is_along_axis_1(VERTICAL_TOLERANCE)
}

/// Whether a tilt from this gravity brings first moments of link 1 to bear that the model does not have.
pub fn lacks_first_moments(operating_point: &OperatingPoint, gravity: &Vector3<f64>) -> bool {
    let revolute = operating_point.chain.joints().first().is_some_and(|joint| joint.kind == JointKind::Revolute);
    revolute && is_along_axis_1(gravity) && operating_point.load.first_moments() == [0.0; 2]
}

/// The change of gravity by each of the two tilts, whose sum at the tilt `about` is exact \[m/s2 per rad\].
fn turns(gravity: &Vector3<f64>, about: [f64; 2]) -> [Vector3<f64>; 2] {
    let angle = about[0].hypot(about[1]);
    let (along, back) =
        if angle > 0.0 { (angle.sin() / angle, (1.0 - angle.cos()) / angle.powi(2)) } else { (1.0, 0.5) };
    let axes = axes(gravity);
    [0, 1].map(|k| along * axes[k].cross(gravity) - back * about[k] * gravity)
}

/// The rigid bodies under the change of gravity by each tilt.
struct Tilt {
    turned: Vec<LoadUnder>,
    has_first: bool,
}

impl Law for Tilt {
    fn at(&mut self, sample: &Sample, _clock: &Clock, columns: &mut [JointVec]) {
        for (column, load) in columns.iter_mut().zip(&mut self.turned) {
            *column = at_rest(load, sample);
        }
        if self.has_first {
            let (sin, cos) = sample.q[0].sin_cos();
            columns.iter_mut().skip(2).zip([cos, sin]).for_each(|(column, torque)| column[0] = torque);
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
    let [a, b] = turns(&gravity, tilt);
    Mounting::along(&(gravity + tilt[0] * a + tilt[1] * b))
}
