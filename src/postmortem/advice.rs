//! Next steps for the operator: those of the backend first, then those of the kind of fault.

use super::facts::Facts;
use super::replay::ReplayResult;
use crate::recording::Recording;
use crate::recording::about::{About, ReasonKind};
use crate::recording::messages::limit_name;
use plumbline_rt::Limit;

const RESUME: &str = "When it is safe to move: `plumbline command resume`. The interrupted motion is not continued: start the job again.";
const RESTART: &str =
    "The daemon has ended. When it is safe to move, start it again; nothing moves before `plumbline command start`.";

const STAND_CLEAR: &str = "Stay clear of the arm: the daemon recovers it and repeats the interrupted motion automatically \
     (`backend.franka.recovery`). `plumbline command stop` prevents that.";

impl Facts {
    /// Facts of the recording in `file`, with the next steps.
    pub fn of(file: &str, recording: &Recording, replay: Option<ReplayResult>) -> Facts {
        let mut facts = Facts::without_advice(file, recording, replay);
        facts.next = next(&facts, &recording.about);
        facts
    }
}

fn is_measured(limit: &str) -> bool {
    [Limit::Tracking, Limit::MeasuredTorque, Limit::MeasuredNotFinite].iter().any(|one| limit_name(*one) == limit)
}

fn next(facts: &Facts, about: &About) -> Vec<String> {
    if about.automatic_recovery {
        return vec![STAND_CLEAR.to_string()];
    }
    let mut steps = about.next.clone();
    let joint = facts.first_limit.as_ref().map_or(0, |crossing| crossing.joint);
    match (facts.kind, facts.first_limit.as_ref().map(|crossing| crossing.limit.as_str())) {
        (ReasonKind::Guard | ReasonKind::Unsafe, Some(limit)) if is_measured(limit) => steps.push(match limit {
            "tracking" => format!(
                "Check joint {joint} for the cause of the tracking error: a collision, a person, a payload that is not in the model, a \
                 brake. Without such a cause, `safety.tracking-error` may be too tight for this motion."
            ),
            "measured-torque" => format!(
                "Check joint {joint} for the cause of the torque: a collision, a payload that is too heavy, a motion that is too fast."
            ),
            _ => "The arm reported a value that is not finite: check its log and its sensors.".to_string(),
        }),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some("torque" | "torque-rate" | "torque-not-finite")) => steps.push(
            "The served model computed that torque and was withdrawn. Identify again, or serve the previous model.".to_string(),
        ),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some("end-effector-box" | "base-sphere")) => steps
            .push("The motion leaves the workspace: compare `[workspace]` of the job with the plan, and plan again.".to_string()),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some(_)) => steps.push(
            format!(
                "The commanded motion of joint {joint} exceeds a limit, although the programme was checked against the guard's limits \
                 before its start. Keep this recording and start the job again: the arm's limits are then read again, and plans that \
                 exceed them are replaced."
            ),
        ),
        (ReasonKind::LostStates, _) => steps.push(
            "States were lost between arm and loop: check the late cycles below, the network, the processor load and the loop's \
             priority. `safety.max-lost` is the accepted number."
                .to_string(),
        ),
        (ReasonKind::HeartbeatLost, _) => steps.push(
            "The daemon's main thread sent no heartbeat while the arm moved. Check whether the computer was suspended or overloaded, or the \
             process stopped. Run `plumbline doctor`."
                .to_string(),
        ),
        (ReasonKind::NotRealTime, _) => steps.push(
            "The computer did not grant the rights of `[realtime]`: run `plumbline doctor`, which lists the changes needed.".to_string(),
        ),
        (ReasonKind::Silent | ReasonKind::Disconnected, _) if about.next.is_empty() => {
            steps.push("Check the cable and the arm's power.".to_string());
        }
        (ReasonKind::Reflex | ReasonKind::Refused, _) if about.next.is_empty() => {
            steps.push("Check the arm's log for the cause; the code is the arm's.".to_string());
        }
        (ReasonKind::Clock, _) => steps.push("The arm or the network repeats states: restart the arm's controller.".to_string()),
        (ReasonKind::Mounting, _) => steps.push(
            "Check the base, the inclinometer and its cable; `plumbline command status` shows each source of the mounting check.".to_string(),
        ),
        (ReasonKind::EstimatorLost, _) => {
            steps.push("Check the estimator's log for the cause; the samples are kept for the next estimator.".to_string());
        }
        (ReasonKind::Panic | ReasonKind::NoBrake, _) => {
            steps.push("This is a defect of plumbline: please report it, with this file.".to_string());
        }
        (ReasonKind::NotAtStart | ReasonKind::NoPath, _) => {
            steps.push("The motion does not begin at the arm's position: start the job from its beginning.".to_string());
        }
        _ => {}
    }
    match (facts.kind, &facts.end) {
        (ReasonKind::OnDemand, _) => {}
        (_, None) => steps.push(RESUME.to_string()),
        (_, Some(_)) => steps.push(RESTART.to_string()),
    }
    steps
}
