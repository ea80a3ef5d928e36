//! Vibration of the base.

use super::Sample;
use super::all_rows::*;
use super::family::*;
use super::load::LoadUnder;
use super::mounting::at_rest;
use super::one_row::column;
use nalgebra::Vector3;
use plumbline_core::JointVec;
use std::f64::consts::TAU;

/// Identity.
pub const ID: &str = "base-motion";

/// One frequency of the base's vibration, with amplitude and phase along the three axes of the base.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The table or vehicle under the base vibrates, which acts on the links as a gravity that changes with time.",
    place: Place::Arm,
    forms: &[Form {
        name: "",
        equation: "tau = sum over x, y, z of (ac cos(2 pi f t) + as sin(2 pi f t)) d tau_rb / d g, in all rows",
        settings: &[Setting {
            name: "f",
            unit: "Hz",
            what: "frequency of the vibration",
            low: 0.05,
            high: 30.0,
            steps: 600,
            scale: Scale::Linear,
        }],
        build,
        in_c: REFUSED_TIME,
        plot_over: PlotOver::Nothing,
    }],
    stratum: Stratum::Changing,
    typical: "0.02 to 0.2 m/s2 at 3 to 15 Hz",
    confounded: &[confounded("contact", LONGER_RECORDING)],
    reference: "Wernholt, Gunnarsson, IFAC SYSID 2006, on resonances below the arm",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let (load, f) = (Arc::clone(&operating_point.load), settings[0]);
    let name = |axis: &str, wave: &str| format!("_{axis}_f{}_{wave}", (f * 1e4).round() / 1e4);
    let waves = ["x", "y", "z"].map(|axis| ["cos", "sin"].map(|wave| name(axis, wave)));
    let columns = waves.iter().flatten().map(|tail| column("base", site, tail, "m/s2")).collect();
    AllRows::term(&FAMILY, "", site, settings, columns, move |_| {
        let axes = [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| load.under(&axis));
        Shaking { axes, f }
    })
}

struct Shaking {
    /// The rigid bodies under a unit of gravity along each axis.
    axes: [LoadUnder; 3],
    f: f64,
}

impl Law for Shaking {
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let (sin, cos) = (TAU * self.f * clock.time).sin_cos();
        for (pair, load) in columns.chunks_mut(2).zip(&mut self.axes) {
            let torque = at_rest(load, sample);
            for (column, wave) in pair.iter_mut().zip([cos, sin]) {
                *column = torque.map(|torque| wave * torque);
            }
        }
    }
}
