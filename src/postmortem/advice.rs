//! What the operator does next: the backend's own advice first, then advice by the kind of the fault.

use super::story::{Story, is_measured};
use crate::recording::about::{About, ReasonKind};

const RESUME: &str =
    "When it is safe to move: `plumbline command resume`; what was under way is not driven on, start the job again.";
const AGAIN: &str =
    "The daemon has ended. When it is safe to move, start it again; nothing moves before `plumbline command start`.";

const STAND_CLEAR: &str = "Stay clear of the arm: the daemon recovers it and drives the interrupted motion again by itself, as the job allows \
     (`recovery` of its backend), unless `plumbline command stop` keeps it from that.";

/// Steps, first things first.
pub(super) fn next(story: &Story, about: &About) -> Vec<String> {
    if about.goes_on {
        return vec![STAND_CLEAR.to_string()];
    }
    let mut steps = about.next.clone();
    let joint = story.first_limit.as_ref().map_or(0, |crossing| crossing.joint);
    match (story.kind, story.first_limit.as_ref().map(|crossing| crossing.limit.as_str())) {
        (ReasonKind::Guard | ReasonKind::Unsafe, Some(limit)) if is_measured(limit) => steps.push(match limit {
            "tracking" => format!(
                "Look at joint {joint}: what kept it from following? A collision, a person, a payload that is not in the model, a \
                 brake. If nothing did, `safety.tracking-error` may be too tight for this motion."
            ),
            "measured-torque" => format!(
                "Look at joint {joint}: what pushed against it? A collision, a payload that is too heavy, a motion that is too fast."
            ),
            _ => "The arm reported a number that is none: look at its own log, and its sensors.".to_string(),
        }),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some("torque" | "torque-rate" | "torque-not-finite")) => steps.push(
            "The served model gave that torque; it is not asked again. Identify anew, or serve the model from before.".to_string(),
        ),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some("end-effector-box" | "base-sphere")) => steps
            .push("The motion leaves the workspace: compare `[workspace]` of the job with the plan, and plan again.".to_string()),
        (ReasonKind::Guard | ReasonKind::Unsafe, Some(_)) => steps.push(
            format!(
                "The arm did nothing wrong: the commanded motion of joint {joint} breaks a limit, although the programme was held to the \
                 guard's rules before it began. Keep this recording, and start the job again: that reads the arm's limits and plans again \
                 where the plans do not keep them."
            ),
        ),
        (ReasonKind::LostStates, _) => steps.push(
            "States were lost between arm and loop: look at the late cycles below. Network, processor load, or priority? \
             `safety.max-lost` says how many are borne."
                .to_string(),
        ),
        (ReasonKind::HeartbeatLost, _) => steps.push(
            "The daemon's own thread stood still while the arm moved: was the machine suspended, overloaded, or the process stopped? Run \
             `plumbline doctor`."
                .to_string(),
        ),
        (ReasonKind::NotRealTime, _) => steps.push(
            "The machine did not grant what `[realtime]` asks: run `plumbline doctor`, it names what to change.".to_string(),
        ),
        (ReasonKind::Silent | ReasonKind::Disconnected, _) if about.next.is_empty() => {
            steps.push("Look at the cable and at the arm's power.".to_string());
        }
        (ReasonKind::Reflex | ReasonKind::Refused, _) if about.next.is_empty() => {
            steps.push("Look at the arm's own log for its reason; the code is the arm's.".to_string());
        }
        (ReasonKind::Clock, _) => steps.push("The arm or the network repeats states: restart the arm's controller.".to_string()),
        (ReasonKind::Mounting, _) => steps.push(
            "Look at the base, and at the inclinometer and its cable; `plumbline command status` says what each side of the mounting check tells.".to_string(),
        ),
        (ReasonKind::EstimatorLost, _) => {
            steps.push("Look at the estimator's log for why it ended; the samples are kept for the next one.".to_string());
        }
        (ReasonKind::Panic | ReasonKind::NoBrake, _) => {
            steps.push("This is a defect of plumbline: please report it, with this file.".to_string());
        }
        (ReasonKind::NotAtStart | ReasonKind::NoPath, _) => {
            steps.push("The motion does not begin where the arm rests: start the job from its beginning.".to_string());
        }
        _ => {}
    }
    match (story.kind, &story.end) {
        (ReasonKind::OnDemand, _) => {}
        (_, None) => steps.push(RESUME.to_string()),
        (_, Some(_)) => steps.push(AGAIN.to_string()),
    }
    steps
}
