//! Ranges of a job's values, and the resulting limits for one robot.

use super::{BackendKind, Franka, Job, LimitOverrides, Limits, Workspace};
use plumbline_core::{BadInput, JointVec, MAX_JOINTS, MAX_MISSED_COMMANDS};
use plumbline_excite::Margins;
use plumbline_identify::{Settings, solve};

pub(super) fn check(job: &Job) -> Result<(), BadInput> {
    let file = job.file.display().to_string();
    let bad = |key: &str, value: &dyn ToString, expected: &str| {
        Err(BadInput::new(&file, format!("key `{key}`"), value.to_string(), expected))
    };
    let backend = &job.backend;
    if let (BackendKind::Sim | BackendKind::Franka, Some(_)) = (backend.kind, &backend.guest) {
        return bad("backend.guest", &"a table", "none, but for kind = \"guest\"");
    }
    match (backend.kind, &backend.arm, &backend.franka) {
        (BackendKind::Guest, Some(_), _) => return bad("backend.arm", &"a value", "none, for kind = \"guest\""),
        (BackendKind::Guest, _, Some(_)) => return bad("backend.franka", &"a table", "none, for kind = \"guest\""),
        (BackendKind::Guest, None, None) => check_guest(job, &file)?,
        (BackendKind::Sim, None, _) => {
            return bad("backend.arm", &"nothing", "the arm to simulate, for kind = \"sim\"");
        }
        (BackendKind::Sim, Some(_), Some(_)) => return bad("backend.franka", &"a table", "none, for kind = \"sim\""),
        (BackendKind::Franka, _, None) => {
            return bad("backend.franka", &"nothing", "a table with the robot's `address`, for kind = \"franka\"");
        }
        (BackendKind::Franka, Some(_), _) => {
            return bad("backend.arm", &"a value", "none, for kind = \"franka\"");
        }
        (BackendKind::Sim, Some(_), None) => {}
        (BackendKind::Franka, None, Some(franka)) => {
            Franka::robot(job)?;
            franka.check(&file)?;
            if let Some(other) = job.validation.mountings.iter().find(|other| other.angle_to(&job.mounting) > 1e-3) {
                let expected = "`mounting` alone: the mounting of a real arm is constant during a job";
                return bad("validation.mountings", &format!("`{other}`"), expected);
            }
        }
    }
    let excitation = &job.excitation;
    if job.robot.trim().is_empty() {
        return bad("robot", &"``", "the name of a robot or the path of its description");
    }
    if !(3..=16).contains(&excitation.harmonics) {
        return bad("excitation.harmonics", &excitation.harmonics, "3 to 16");
    }
    if !(1.0..=120.0).contains(&excitation.period) || (excitation.period * 1e3).fract().abs() > 1e-6 {
        return bad("excitation.period", &excitation.period, "1 s to 120 s, in whole milliseconds");
    }
    if !(1..=20).contains(&excitation.trajectories) {
        return bad("excitation.trajectories", &excitation.trajectories, "1 to 20");
    }
    if !(1..=1000).contains(&excitation.periods) {
        return bad("excitation.periods", &excitation.periods, "1 to 1000");
    }
    if excitation.lead_in > 100 {
        return bad("excitation.lead-in", &excitation.lead_in, "0 to 100");
    }
    if !(1..=10_000).contains(&excitation.starts) {
        return bad("excitation.starts", &excitation.starts, "1 to 10000");
    }
    if excitation.rounds > 10_000 {
        return bad("excitation.rounds", &excitation.rounds, "0 to 10000");
    }
    if let Some(q0) = &excitation.q0
        && !(1..=MAX_JOINTS).contains(&q0.len())
    {
        return bad("excitation.q0", &format!("{} values", q0.len()), "one position per joint");
    }
    if !(0.5..=200.0).contains(&job.diagnosis.band) {
        return bad("diagnosis.band", &job.diagnosis.band, "0.5 to 200 Hz");
    }
    if let Some(threshold) = job.diagnosis.threshold.filter(|value| !(value.is_finite() && *value > 0.0)) {
        return bad("diagnosis.threshold", &threshold, "a torque in Nm, more than 0");
    }
    if job.diagnosis.rounds > 10 {
        return bad("diagnosis.rounds", &job.diagnosis.rounds, "0 to 10");
    }
    if job.diagnosis.rounds > 0 && !(job.diagnosis.enabled && job.output.dataset) {
        let expected =
            "0 without `diagnosis.enabled` and `output.dataset`: a round is diagnosed with the runs of those before";
        return bad("diagnosis.rounds", &job.diagnosis.rounds, expected);
    }
    if let Some(until) = job.diagnosis.until.filter(|until| !(1e-4..=1.0).contains(until)) {
        return bad("diagnosis.until", &until, "a share of the effect's size, 0.0001 to 1");
    }
    let validation = &job.validation;
    if validation.trajectories > 100 {
        return bad("validation.trajectories", &validation.trajectories, "0 to 100");
    }
    if !(1..=1000).contains(&validation.periods) {
        return bad("validation.periods", &validation.periods, "1 to 1000");
    }
    let limits = &job.limits;
    if !(0.0..=1.0).contains(&limits.margin) {
        return bad("limits.margin", &format!("{} rad", limits.margin), "0 rad to 1 rad");
    }
    let shares = [
        ("speed", limits.speed),
        ("acceleration", limits.acceleration),
        ("jerk", limits.jerk),
        ("torque", limits.torque),
    ];
    for (name, share) in shares {
        if !(share > 0.0 && share <= 1.0) {
            return bad(&format!("limits.{name}"), &share, "a share of the robot's limit, above 0 and at most 1");
        }
    }
    if let Some(Workspace { box_min, box_max, base_radius, links_in_box: _ }) = &job.workspace {
        for axis in 0..3 {
            if !(box_min[axis].is_finite() && box_max[axis].is_finite() && box_min[axis] < box_max[axis]) {
                let found = format!("{} m to {} m", box_min[axis], box_max[axis]);
                return bad(&format!("workspace.box-min[{axis}]"), &found, "less than box-max, both finite");
            }
        }
        if !(base_radius.is_finite() && *base_radius >= 0.0) {
            return bad("workspace.base-radius", base_radius, "0 m or more");
        }
    }
    let estimator = &job.estimator;
    for (name, cutoff) in [("torque-cutoff", estimator.torque_cutoff), ("position-cutoff", estimator.position_cutoff)] {
        if let Some(cutoff) = cutoff
            && !(0.1..=400.0).contains(&cutoff)
        {
            return bad(&format!("estimator.{name}"), &format!("{cutoff} Hz"), "0.1 Hz to 400 Hz");
        }
    }
    if let Some(order) = estimator.filter_order
        && !(order % 2 == 0 && (2..=40).contains(&order))
    {
        return bad("estimator.filter-order", &order, "an even number from 2 to 40");
    }
    if !(0.5f64.to_radians() - 1e-9..=90f64.to_radians()).contains(&job.mounting_check.tolerance) {
        let found = format!("{:.3} deg", job.mounting_check.tolerance.to_degrees());
        return bad("mounting-check.tolerance", &found, "0.5 deg to 90 deg");
    }
    if let Some(inclinometer) = &job.inclinometer {
        inclinometer.check(&file, &job.mounting)?;
        if inclinometer.is_simulated() && backend.kind != BackendKind::Sim {
            let expected = "the name of a CAN interface: a simulated bus goes with a simulated arm alone";
            return bad("inclinometer.interface", &format!("`{}`", inclinometer.interface), expected);
        }
        if job.backend.is_fast() {
            let expected = "a wall-clock pace: an inclinometer has no simulated time";
            return bad("backend.pace", &"`fast`", expected);
        }
        if let Some(other) = job.validation.mountings.iter().find(|other| other.angle_to(&job.mounting) > 1e-3) {
            let expected = "`mounting` alone: the inclinometer's base is not mounted again during a job";
            return bad("validation.mountings", &format!("`{other}`"), expected);
        }
    }
    let recorder = &job.recorder;
    if recorder.span != 0.0 && !(1.0..=120.0).contains(&recorder.span) {
        return bad("recorder.span", &format!("{} s", recorder.span), "1 s to 120 s, or 0 s for no recordings");
    }
    if !(1..=10_000).contains(&recorder.keep) {
        return bad("recorder.keep", &recorder.keep, "1 to 10000");
    }
    if !(1..=10_000).contains(&recorder.keep_on_demand) {
        return bad("recorder.keep-on-demand", &recorder.keep_on_demand, "1 to 10000");
    }
    if job.realtime.priority > 99 {
        return bad("realtime.priority", &job.realtime.priority, "0 to 99");
    }
    if !(job.safety.tracking_error > 0.0 && job.safety.tracking_error <= 1.0) {
        return bad("safety.tracking-error", &format!("{} rad", job.safety.tracking_error), "above 0, at most 1 rad");
    }
    // A Franka stops by itself after more missing commands.
    let most = if job.backend.franka.is_some() { MAX_MISSED_COMMANDS - 1 } else { 1000 };
    if !(1..=most).contains(&job.safety.max_lost) {
        return bad("safety.max-lost", &job.safety.max_lost, &format!("1 to {most} states"));
    }
    if !(1.0..=86_400.0).contains(&job.safety.model_timeout) {
        return bad("safety.model-timeout", &format!("{} s", job.safety.model_timeout), "1 s to 86400 s");
    }
    if let Some(port) = job.serve.metrics_port.filter(|port| !(1..=65_535).contains(port)) {
        return bad("serve.metrics-port", &port, "1 to 65535");
    }
    let live = &job.live;
    if !(2.0..=60.0).contains(&live.window) {
        return bad("live.window", &format!("{} s", live.window), "2 s to 60 s");
    }
    if !(0.0..=86_400.0).contains(&live.motion) {
        return bad("live.motion", &format!("{} s", live.motion), "0 s to 86400 s");
    }
    if job.output.dir.as_os_str().is_empty() {
        return bad("output.dir", &"``", "the path of a folder");
    }
    Ok(())
}

/// What a job may say of an arm that it does not drive.
fn check_guest(job: &Job, file: &str) -> Result<(), BadInput> {
    let bad = |key: &str, value: &dyn ToString, expected: &str| {
        Err(BadInput::new(file, format!("key `{key}`"), value.to_string(), expected))
    };
    job.backend.guest().map_or(Ok(()), |guest| guest.check(file))?;
    if let Some(plan) = &job.excitation.plan {
        return bad("excitation.plan", &plan.display(), "none, for kind = \"guest\": its controller drives the motion");
    }
    if job.diagnosis.rounds > 0 {
        let expected = "0, for kind = \"guest\": plumbline drives no further motion; `plumbline next` plans one";
        return bad("diagnosis.rounds", &job.diagnosis.rounds, expected);
    }
    if job.live.motion > 0.0 {
        let expected = "0 s, for kind = \"guest\": its model is watched as long as the daemon runs";
        return bad("live.motion", &format!("{} s", job.live.motion), expected);
    }
    if job.validation.counter_experiment {
        return bad("validation.counter-experiment", &true, "false, for kind = \"guest\"");
    }
    match &job.inclinometer {
        Some(_) => bad("inclinometer", &"a table", "none, for kind = \"guest\": the declared mounting is used"),
        None => Ok(()),
    }
}

impl Job {
    /// Limits of the guard: the robot's, or tighter ones of the job.
    /// Errors: a list of another length than the robot has joints (`n`), or a limit that is wider than the robot's.
    pub fn guard_limits(&self, robot: &plumbline_core::Limits, n: usize) -> Result<plumbline_core::Limits, BadInput> {
        let LimitOverrides { q_min, q_max, dq, ddq, jerk, tau, dtau } = &self.limits.overrides;
        let mut limits = *robot;
        let below: fn(f64, f64) -> bool = |own, robots| own > 0.0 && own <= robots;
        self.tighten("q-min", q_min, n, &mut limits.q_min, |own, robots| own >= robots)?;
        self.tighten("q-max", q_max, n, &mut limits.q_max, |own, robots| own <= robots)?;
        self.tighten("dq", dq, n, &mut limits.dq, below)?;
        self.tighten("ddq", ddq, n, &mut limits.ddq, below)?;
        self.tighten("jerk", jerk, n, &mut limits.jerk, below)?;
        self.tighten("tau", tau, n, &mut limits.tau, below)?;
        self.tighten("dtau", dtau, n, &mut limits.dtau, below)?;
        match (0..n).find(|&j| limits.q_min[j] >= limits.q_max[j]) {
            Some(j) => {
                Err(self.bad_limit("q-min", j, limits.q_min[j], format!("less than q-max, {}", limits.q_max[j])))
            }
            None => Ok(limits),
        }
    }

    pub fn margins(&self) -> Margins {
        let Limits { margin, speed, acceleration, jerk, torque, .. } = self.limits;
        Margins {
            position: margin,
            velocity: speed,
            acceleration,
            jerk,
            torque,
            torque_rate: torque,
            ..Margins::default()
        }
    }

    /// Signal processing of the estimator: defaults with the job's values.
    pub fn settings(&self) -> Settings {
        let own = &self.estimator;
        let defaults = own.method.settings();
        Settings {
            torque_cutoff: own.torque_cutoff.unwrap_or(defaults.torque_cutoff),
            position_cutoff: own.position_cutoff.or(defaults.position_cutoff),
            order: own.filter_order.unwrap_or(defaults.order),
            derivative: own.derivative.unwrap_or(defaults.derivative),
            ..defaults
        }
    }

    pub fn solver(&self) -> solve::Options {
        solve::Options { estimator: self.estimator.solver, essential: self.estimator.essential }
    }

    /// The workspace: the job's, else the robot's.
    pub fn workspace(&self, robot: &plumbline_core::Workspace) -> plumbline_core::Workspace {
        self.workspace.map_or(*robot, |own| plumbline_core::Workspace {
            box_min: own.box_min,
            box_max: own.box_max,
            base_radius: own.base_radius,
        })
    }

    fn tighten(
        &self,
        name: &str,
        own: &Option<Vec<f64>>,
        n: usize,
        limits: &mut JointVec,
        tighter: impl Fn(f64, f64) -> bool,
    ) -> Result<(), BadInput> {
        let Some(own) = own else { return Ok(()) };
        if own.len() != n {
            let (file, place) = (self.file.display().to_string(), format!("key `limits.override.{name}`"));
            return Err(BadInput::new(file, place, format!("{} values", own.len()), format!("{n}, one per joint")));
        }
        for (j, (&own, limit)) in own.iter().zip(limits).enumerate() {
            // Also refuses NaN.
            if !tighter(own, *limit) {
                return Err(self.bad_limit(name, j, own, format!("a limit not wider than the robot's {limit}")));
            }
            *limit = own;
        }
        Ok(())
    }

    fn bad_limit(&self, name: &str, j: usize, value: f64, expected: String) -> BadInput {
        BadInput::new(self.file.display().to_string(), format!("key `limits.override.{name}[{j}]`"), value, expected)
    }
}
