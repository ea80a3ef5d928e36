//! Delay of torques against positions.

use super::all_rows::*;
use super::carried::Drives;
use super::family::*;
use super::load::LoadUnder;
use super::one_row::column;
use super::{Column, Expected, Sample};
use nalgebra::Vector3;
use plumbline_core::JointVec;

/// Longest delay of the shifted form \[s\].
const LONGEST_S: f64 = 0.05;
/// Samples that the shifted form remembers: as long at 1.2 kHz.
const MEMORY: usize = 64;

/// One delay of all torques against all positions.
///
/// To first order it is the slope of the torques, a backward difference. Friction is delayed, too: at a reversal its slope is a pulse as wide as the
/// reversal. The shifted form is exact also where the delay is longer than that: it interpolates between samples, and `delay` is `shift`.
pub static FAMILY: Family = Family {
    id: "delay",
    physics: "The torque is measured, filtered or sent later than the position of the same sample.",
    place: Place::Arm,
    forms: &[
        Form {
            name: "",
            equation: "tau = -delay d tau_arm / dt, tau_arm = tau_rb + tau_friction + tau_rotor, in all rows",
            settings: &[],
            build: build_slope,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Nothing,
        },
        Form {
            name: "shifted",
            equation: "tau = delay (tau_arm(t - shift) - tau_arm(t)) / shift, tau_arm = tau_rb + tau_friction + tau_rotor, in all rows",
            settings: &[Setting {
                name: "shift",
                unit: "s",
                what: "the delay that the torques are computed with",
                low: 1e-3,
                high: LONGEST_S,
                steps: 5,
                scale: Scale::Logarithmic,
            }],
            build: build_shifted,
            in_c: REFUSED_MEMORY,
            plot_over: PlotOver::Nothing,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "1 to 20 ms; negative where the positions are late",
    confounded: &[confounded("presliding", HIGHER_HARMONICS), confounded("fv of every joint", HIGHER_HARMONICS)],
    reference: "Swevers et al., IEEE Trans. Robotics and Automation 13 (1997), on phases of filtered data",
    rare: Rare { slight_in_every_arm: true, ..Rare::NONE },
};

fn build_slope(operating_point: &OperatingPoint, site: Site, _settings: &[f64]) -> Arc<dyn Term> {
    let arm = Arm::of(operating_point);
    let start = move |gravity: &Vector3<f64>| Slope { arm: arm(gravity), past: PastOfJoints::default() };
    AllRows::term(&FAMILY, "", site, &[], columns(site), start)
}

fn build_shifted(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (arm, shift) = (Arm::of(operating_point), settings[0]);
    let start = move |gravity: &Vector3<f64>| Shifted {
        arm: arm(gravity),
        shift,
        past: [JointVec::default(); MEMORY],
        newest: None,
    };
    AllRows::term(&FAMILY, "shifted", site, settings, columns(site), start)
}

fn columns(site: Site) -> Vec<Column> {
    vec![column("delay", site, "", "s")]
}

/// Torques of all joints.
struct Arm {
    load: LoadUnder,
    drives: Drives,
}

impl Arm {
    /// Of an operating point, under a gravity vector.
    fn of(operating_point: &OperatingPoint) -> impl Fn(&Vector3<f64>) -> Arm + Send + Sync + 'static {
        let (load, drives) = (Arc::clone(&operating_point.load), Drives::of(operating_point));
        move |gravity| Arm { load: load.under(gravity), drives }
    }

    fn torques(&mut self, sample: &Sample) -> JointVec {
        let mut torques = self.load.torque(sample);
        torques.iter_mut().zip(self.drives.torques(sample)).for_each(|(torque, drive)| *torque += drive);
        torques
    }
}

struct Slope {
    arm: Arm,
    past: PastOfJoints,
}

impl Law for Slope {
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let Some(column) = columns.first_mut() else { return };
        for ((value, past), torque) in column.iter_mut().zip(&mut self.past).zip(self.arm.torques(sample)) {
            *value = -past.derivatives(torque, clock.dt)[0];
        }
    }
}

struct Shifted {
    arm: Arm,
    shift: f64,
    /// Torques of the last samples, going round; those before the first sample are its own.
    past: [JointVec; MEMORY],
    /// Place of the newest.
    newest: Option<usize>,
}

impl Shifted {
    /// Remembers the torques of a sample.
    fn remember(&mut self, torques: JointVec) {
        let Some(before) = self.newest else {
            (self.past, self.newest) = ([torques; MEMORY], Some(0));
            return;
        };
        let newest = (before + 1) % MEMORY;
        self.newest = Some(newest);
        if let Some(place) = self.past.get_mut(newest) {
            *place = torques;
        }
    }

    /// Torques that many samples before the newest, or the oldest known.
    fn before(&self, samples: usize) -> JointVec {
        let at = self.newest.unwrap_or_default() + MEMORY - samples.min(MEMORY - 1);
        self.past.get(at % MEMORY).copied().unwrap_or_default()
    }
}

impl Law for Shifted {
    const EXPECTS: Expected = Expected::FirstSetting;

    fn memory(&self, dt: f64) -> usize {
        ((self.shift / dt) as usize + 2).min(MEMORY)
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let Some(column) = columns.first_mut() else { return };
        let torques = self.arm.torques(sample);
        self.remember(torques);
        let samples = self.shift / clock.dt;
        let (whole, part) = (samples as usize, samples.fract());
        let both = self.before(whole).into_iter().zip(self.before(whole.saturating_add(1)));
        for ((value, (late, later)), now) in column.iter_mut().zip(both).zip(torques) {
            *value = (late + part * (later - late) - now) / self.shift;
        }
    }
}
