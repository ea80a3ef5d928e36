//! Contact of the arm with its environment.

use super::Sample;
use super::all_rows::*;
use super::family::*;
use super::one_row::column;
use crate::chain::{Chain, JointKind, Placement};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// Identity.
pub const ID: &str = "contact";

/// Longest recording: a day.
const MAX_RECORDING_S: f64 = 86_400.0;

/// A wrench at one link for a limited time.
///
/// Forces and moments are those that the arm exerts on the environment, in the axes of the base and about the origin of the
/// link's frame.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The arm touched its environment, or a load hung on it, during a part of the recording.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau = J_link(q)' [force, moment] for from <= t < to, else 0",
        settings: &[
            Setting {
                name: "from",
                unit: "s",
                what: "start of the contact",
                low: 0.0,
                high: MAX_RECORDING_S,
                steps: 1,
                scale: Scale::Linear,
            },
            Setting {
                name: "to",
                unit: "s",
                what: "end of the contact",
                low: 0.0,
                high: MAX_RECORDING_S,
                steps: 1,
                scale: Scale::Linear,
            },
        ],
        build,
        in_c: REFUSED_TIME,
        plot_over: PlotOver::Time,
    }],
    stratum: Stratum::Changing,
    typical: "1 to 30 N",
    confounded: &[
        confounded("payload", "a second recording: a payload stays and turns with gravity, a touch does not"),
        confounded("base-motion", LONGER_RECORDING),
    ],
    reference: "Haddadin, De Luca, Albu-Schaeffer, IEEE Trans. Robotics 33 (2017)",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (link, chain, window) = (joint(site), operating_point.chain.clone(), [settings[0], settings[1]]);
    let tail = |what: &str| {
        let [from, to] = window.map(|time| (time * 1e3).round() / 1e3);
        format!("_t{from}_{to}_{what}")
    };
    let units = [("fx", "N"), ("fy", "N"), ("fz", "N"), ("mx", "Nm"), ("my", "Nm"), ("mz", "Nm")];
    let columns = units.map(|(what, unit)| column("contact", site, &tail(what), unit)).to_vec();
    AllRows::term(&FAMILY, "", site, settings, columns, move |_| Touch { chain: chain.clone(), link, window })
}

struct Touch {
    chain: Chain,
    link: usize,
    window: [f64; 2],
}

impl Law for Touch {
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let [from, to] = self.window;
        if !(from..to).contains(&clock.time) {
            return;
        }
        let joints = || self.chain.joints().iter().take(self.link + 1);
        let mut frames = [Placement::identity(); MAX_JOINTS];
        let mut frame = Placement::identity();
        for ((at, joint), q) in frames.iter_mut().zip(joints()).zip(&sample.q) {
            frame = frame.then(&joint.placement(*q));
            *at = frame;
        }
        for (j, (joint, at)) in joints().zip(&frames).enumerate() {
            let axis = Vector3::new(at.rotation.m13, at.rotation.m23, at.rotation.m33);
            let (forces, moments) = match joint.kind {
                // axis . (lever x f + m)
                JointKind::Revolute => (axis.cross(&(frame.origin - at.origin)), axis),
                JointKind::Prismatic => (axis, Vector3::zeros()),
            };
            let values = [forces.x, forces.y, forces.z, moments.x, moments.y, moments.z];
            for (column, value) in columns.iter_mut().zip(values) {
                if let Some(entry) = column.get_mut(j) {
                    *entry = value;
                }
            }
        }
    }
}
