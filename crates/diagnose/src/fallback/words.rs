//! What was found of an unexplained residual in sentences, and the experiments that would decide.

use super::{CONCENTRATED_RATIO, Residual, Variable};
use crate::evidence::Evidence;

/// What the figures say.
pub(super) fn findings(found: &Residual) -> Vec<String> {
    let mut said = Vec::new();
    let joint = found.joint + 1;
    let ceiling = found.ceiling.map_or(String::new(), |ceiling| format!(", at most {ceiling:.2} are possible"));
    if found.flat() {
        let best = found.singles.iter().chain(&found.pairs).map(|one| one.r2).fold(0.0, f64::max);
        said.push(format!(
            "No dependence found: the best variables predict {best:.2} of joint {joint}'s residual on other trajectories{ceiling}. It depends on three variables or more, on something that was not measured, or on the past."
        ));
    } else {
        said.push(format!(
            "Joint {joint}'s residual depends on {}: R2 {:.2} on trajectories left out{ceiling}.",
            names(&found.depends_on),
            found.r2()
        ));
    }
    let trajectories = found.trajectories();
    if let Some((run, share)) =
        trajectories.iter().find(|(_, share)| trajectories.len() > 1 && *share > CONCENTRATED_RATIO)
    {
        said.push(format!("{:.0} % of its square are in {run}.", 100.0 * share));
    }
    if let Some(window) = found.concentrated() {
        let (from, to) = (window.from, window.from + window.seconds);
        said.push(format!(
            "{:.0} % of its square are between {from:.1} s and {to:.1} s of {}.",
            100.0 * window.share,
            window.run
        ));
    }
    for line in found.lines.iter().take(3) {
        said.push(format!(
            "A line at {:.2} Hz in {}: {:.3} Nm, {:.0} times the power around it.",
            line.frequency, line.run, line.amplitude, line.ratio
        ));
    }
    said
}

/// Which experiments would tell more.
pub(super) fn experiments(found: &Residual, evidence: &Evidence) -> Vec<String> {
    let mut wanted = Vec::new();
    if !evidence.repeats() {
        wanted.push(
            "Record at least six periods of each trajectory: only repeats tell noise from what a model lacks."
                .to_string(),
        );
    }
    if evidence.experiments() < 2 {
        wanted.push(
            "Record a second and a third trajectory: a dependence has to hold where it was not fitted.".to_string(),
        );
    }
    if found.concentrated().is_some() {
        wanted.push("Look what is near the arm at that moment, and drive the same path from another start: a contact or a taut cable stays at its place, an effect of time at its moment.".to_string());
    }
    match found.depends_on.as_slice() {
        [] => wanted.extend([
            "Dwell at three postures for a minute each: what goes on while the arm stands is no matter of motion.".to_string(),
            "Repeat the trajectories at half the speed: memory (hysteresis, heat, delay) scales otherwise than a function of the state.".to_string(),
        ]),
        [one] => wanted.push(alone(*one)),
        [first, second, ..] => wanted.extend(together(found.joint, *first, *second)),
    }
    wanted
}

fn alone(variable: Variable) -> String {
    match variable {
        Variable::Position(i) => format!(
            "Sweep joint {} slowly through its range and back, all others at rest, in a second mounting or with another payload too: a function of the position alone stays as it is, an effect of load scales.",
            i + 1
        ),
        Variable::Velocity(i) => format!(
            "Drive joint {} at six constant speeds in both directions, all others at rest: the friction curve without inertia.",
            i + 1
        ),
        Variable::Acceleration(i) => format!(
            "Repeat the trajectories at half the speed: what follows the acceleration of joint {} falls to a quarter.",
            i + 1
        ),
        Variable::Time => "Repeat with a slower time scale: what belongs to the time stays at its second, what belongs to the motion moves with it.".to_string(),
    }
}

fn together(joint: usize, first: Variable, second: Variable) -> Vec<String> {
    let mut wanted = Vec::new();
    let (i, k) = (first.joint().unwrap_or(joint), second.joint().unwrap_or(joint));
    match (first, second) {
        (Variable::Position(_), Variable::Velocity(_)) | (Variable::Velocity(_), Variable::Position(_)) => {
            let (still, swept) = if matches!(first, Variable::Position(_)) { (i, k) } else { (k, i) };
            wanted.push(if still == swept {
                format!("Sweep joint {} slowly in both directions at three speeds, all others at rest.", swept + 1)
            } else {
                format!(
                    "Sweep joint {} at a constant speed in both directions, joint {} held at five positions, all others at rest.",
                    swept + 1,
                    still + 1
                )
            });
        }
        (Variable::Position(_), _) => wanted.push(format!(
            "Sweep joint {} slowly, joint {} held at five positions, all others at rest.",
            k + 1,
            i + 1
        )),
        _ => wanted.push(format!(
            "Drive joint {} at constant speeds while joint {} stands, then moves with it, then against it.",
            i + 1,
            k + 1
        )),
    }
    if i != joint || k != joint {
        wanted.push(
            "Repeat in a second mounting and with another payload: what scales is an effect of the load.".to_string(),
        );
    }
    wanted
}

fn names(variables: &[Variable]) -> String {
    variables.iter().map(|variable| variable.to_string()).collect::<Vec<_>>().join(" and ")
}
