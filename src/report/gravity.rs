//! What was known of the direction of gravity while a job was driven, as it stands in `report.json`. Angles in rad.

use super::MountingFacts;
use plumbline_ipc::Gravity;
use plumbline_model::Mounting;
use serde::{Deserialize, Serialize};

/// What the inclinometer did, and what was made of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct GravityFacts {
    /// Whether a socket played the bus, and no sensor was there.
    pub simulated: bool,
    /// Where the model's gravity came from at the end: `measured`, `held` from before the sensor was lost, or `declared`.
    pub source: String,
    /// How the inclinometer was at the end.
    pub inclinometer: String,
    /// What is served without a reading, by the job: `refuse`, `hold` or `declared`.
    pub on_loss: String,
    /// The mounting by the job.
    pub declared: MountingFacts,
    /// What was measured last; absent where nothing ever was.
    pub measured: Option<MountingFacts>,
    /// Angle between that and the declared direction \[rad\].
    pub tilt: Option<f64>,
    /// Standard deviation of the direction measured last \[rad\].
    pub std: Option<f64>,
    /// What the torques at rest imply under the model, where they were asked.
    pub implied: Option<MountingFacts>,
    /// How often the inclinometer was lost after it had been there.
    pub losses: u64,
    /// How long it was gone, all together \[s\].
    pub lost_s: f64,
    /// How often the served model got another gravity.
    pub hand_overs: u64,
    /// Largest angle between the gravity that the served model had and the declared one \[rad\].
    pub furthest: f64,
    /// With which mounting each motion was evaluated.
    pub motions: Vec<MotionGravityFacts>,
    /// What has happened, the latest last.
    pub events: Vec<String>,
    /// Older events that were not kept.
    pub forgotten: u64,
}

/// The direction of gravity of one motion.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionGravityFacts {
    /// Name of its run.
    pub run: String,
    /// The mounting that the run was evaluated with. A base that has not moved since the first run keeps the first run's.
    pub used: MountingFacts,
    /// Where that comes from: `measured` or `declared`, where the inclinometer had no reading as the motion began.
    pub source: String,
    /// Angle between it and the declared direction \[rad\].
    pub tilt: f64,
    /// Standard deviation of the direction measured as the motion began \[rad\].
    pub std: Option<f64>,
}

impl GravityFacts {
    /// From the daemon's word, for runs by number, name and the mounting that they were evaluated with; `None` where no inclinometer
    /// was there.
    pub fn of<'r>(
        said: &Gravity,
        declared: Mounting,
        runs: impl IntoIterator<Item = (u32, &'r str, Mounting)>,
    ) -> Option<GravityFacts> {
        let (inclinometer, on_loss) = (said.inclinometer.clone()?, said.on_loss.clone().unwrap_or_default());
        let mounting = |[rho, phi]: [f64; 2]| Mounting { rho, phi };
        let motion = |(number, run, used): (u32, &str, Mounting)| {
            let measured = said.motions.iter().rev().find(|own| own.motion == number);
            MotionGravityFacts {
                run: run.to_string(),
                used: used.into(),
                source: if measured.is_some() { "measured" } else { "declared" }.to_string(),
                tilt: used.angle_to(&declared),
                std: measured.map(|own| own.std),
            }
        };
        let measured = said.measured.map(mounting);
        Some(GravityFacts {
            simulated: said.simulated,
            source: said.source.clone(),
            inclinometer,
            on_loss,
            declared: declared.into(),
            measured: measured.map(MountingFacts::from),
            tilt: measured.map(|measured| measured.angle_to(&declared)),
            std: said.uncertainty,
            implied: said.torques.map(mounting).map(MountingFacts::from),
            losses: said.losses,
            lost_s: said.lost_s,
            hand_overs: said.hand_overs,
            furthest: said.furthest,
            motions: runs.into_iter().map(motion).collect(),
            events: said.events.clone(),
            forgotten: said.forgotten,
        })
    }

    /// In one sentence, without its full stop.
    pub fn sentence(&self) -> String {
        let sensor = if self.simulated { "a SIMULATED inclinometer" } else { "the inclinometer" };
        let measured = self.tilt.map_or("has measured nothing".to_string(), |tilt| {
            let std = self.std.map_or(String::new(), |std| format!(" +- {:.2}", std.to_degrees()));
            format!(
                "measured gravity {:.2}{std} deg off the declared mounting {}",
                tilt.to_degrees(),
                self.declared.name
            )
        });
        let lost = match self.losses {
            0 => "never lost".to_string(),
            times => {
                let times = if times == 1 { "once".to_string() } else { format!("{times} times") };
                format!("lost {times}, for {:.1} s in all (on-loss = \"{}\")", self.lost_s, self.on_loss)
            }
        };
        let declared = self.motions.iter().filter(|motion| motion.source == "declared").count();
        let without = match declared {
            0 => String::new(),
            some => format!(
                "; {some} of {} motions began without it and stand by the declared mounting",
                self.motions.len()
            ),
        };
        format!("{sensor} {measured}; {lost}{without}; {} at the end", self.source)
    }
}
