//! Direction of gravity during a job, in `report.json`. Angles in rad.

use super::MountingFacts;
use plumbline_ipc::Gravity;
use plumbline_model::Mounting;
use serde::{Deserialize, Serialize};

/// Readings of the inclinometer and their use by the daemon.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GravityReport {
    pub declared: MountingFacts,
    pub status: Gravity,
    pub runs: Vec<RunGravity>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunGravity {
    pub run: String,
    /// The mounting that the run was evaluated with. A base that has not moved since the first run keeps the first run's.
    pub used: MountingFacts,
    /// Angle between it and the declared direction \[rad\].
    pub tilt: f64,
    /// Standard deviation of the direction measured as the motion began \[rad\]; `None` where the inclinometer had no reading then and the
    /// declared mounting is used.
    pub std: Option<f64>,
}

impl RunGravity {
    /// `measured` or `declared`.
    pub fn source(&self) -> &'static str {
        if self.std.is_some() { "measured" } else { "declared" }
    }
}

impl GravityReport {
    /// From the daemon's status, for runs by number, name and the mounting that they were evaluated with; `None` without an inclinometer.
    pub fn new<'r>(
        status: &Gravity,
        declared: Mounting,
        runs: impl IntoIterator<Item = (u32, &'r str, Mounting)>,
    ) -> Option<GravityReport> {
        status.inclinometer.as_ref()?;
        let run = |(number, run, used): (u32, &str, Mounting)| {
            let measured = status.motions.iter().rev().find(|motion| motion.motion == number);
            RunGravity {
                run: run.to_string(),
                used: used.into(),
                tilt: used.angle_to(&declared),
                std: measured.map(|motion| motion.std),
            }
        };
        let runs = runs.into_iter().map(run).collect();
        Some(GravityReport { declared: declared.into(), status: status.clone(), runs })
    }

    /// Angle between the last measured direction and the declared one \[rad\]; `None` without a reading.
    pub fn tilt(&self) -> Option<f64> {
        let [rho, phi] = self.status.measured?;
        let MountingFacts { rho: declared_rho, phi: declared_phi, .. } = self.declared;
        Some(Mounting { rho, phi }.angle_to(&Mounting { rho: declared_rho, phi: declared_phi }))
    }

    /// In one sentence, without its full stop.
    pub fn sentence(&self) -> String {
        let status = &self.status;
        let sensor = if status.simulated { "a SIMULATED inclinometer" } else { "the inclinometer" };
        let measured = self.tilt().map_or("has measured nothing".to_string(), |tilt| {
            let std = status.uncertainty.map_or(String::new(), |std| format!(" +- {:.2}", std.to_degrees()));
            let (tilt, declared) = (tilt.to_degrees(), &self.declared.name);
            format!("measured gravity {tilt:.2}{std} deg off the declared mounting {declared}")
        });
        let on_loss = status.on_loss.as_deref().unwrap_or_default();
        let lost = match status.losses {
            0 => "never lost".to_string(),
            1 => format!("lost once, for {:.1} s in all (on-loss = \"{on_loss}\")", status.lost_s),
            times => format!("lost {times} times, for {:.1} s in all (on-loss = \"{on_loss}\")", status.lost_s),
        };
        let without = match self.runs.iter().filter(|run| run.std.is_none()).count() {
            0 => String::new(),
            some => format!("; {some} of {} motions began without it and have the declared mounting", self.runs.len()),
        };
        format!("{sensor} {measured}; {lost}{without}; {} at the end", status.source)
    }
}
