//! Delay of torques against positions.

use super::Sample;
use super::all_rows::*;
use super::carried::CarriedFriction;
use super::family::*;
use super::load::LoadUnder;
use super::one_row::column;
use plumbline_core::JointVec;

/// One delay of all torques against all positions.
///
/// First order in the delay. Friction is delayed, too: at a reversal its slope is a pulse as wide as the reversal. The slope is a backward
/// difference of the torques.
pub static FAMILY: Family = Family {
    id: "delay",
    physics: "The torque is measured, filtered or sent later than the position of the same sample.",
    place: Place::Arm,
    forms: &[Form {
        name: "",
        equation: "tau = -delay d (tau_rb + tau_friction) / dt, in all rows",
        settings: &[],
        build,
        in_c: REFUSED_MEMORY,
        plot_over: PlotOver::Nothing,
    }],
    stratum: Stratum::Repeatable,
    typical: "1 to 5 ms; negative where the positions are late",
    confounded: &[confounded("presliding", HIGHER_HARMONICS), confounded("fv of every joint", HIGHER_HARMONICS)],
    reference: "Swevers et al., IEEE Trans. Robotics and Automation 13 (1997), on phases of filtered data",
    rare: Rare::NONE,
};

fn build(operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    let load = Arc::clone(&operating_point.load);
    let friction = CarriedFriction::of(operating_point);
    AllRows::term(&FAMILY, "", site, settings, vec![column("delay", site, "", "s")], move |gravity| Late {
        load: load.under(gravity),
        friction,
        past: PastOfJoints::default(),
    })
}

struct Late {
    load: LoadUnder,
    friction: CarriedFriction,
    past: PastOfJoints,
}

impl Law for Late {
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let Some(column) = columns.first_mut() else { return };
        let torques = self.load.torque(sample).into_iter().zip(self.friction.torques(sample));
        for ((value, past), (body, friction)) in column.iter_mut().zip(&mut self.past).zip(torques) {
            *value = -past.derivatives(body + friction, clock.dt)[0];
        }
    }
}
