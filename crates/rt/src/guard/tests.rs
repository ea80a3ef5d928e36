use super::*;
use plumbline_core::Torque;

const DT: f64 = 1e-3;

/// Two joints; joint 2 has another range.
fn settings() -> GuardSettings {
    let of = |value: f64| [value; MAX_JOINTS];
    let mut limits = Limits {
        q_min: of(-2.0),
        q_max: of(2.0),
        dq: of(2.0),
        ddq: of(15.0),
        jerk: of(7500.0),
        tau: of(80.0),
        dtau: of(1000.0),
    };
    (limits.q_min[1], limits.q_max[1]) = (-3.0, 0.5);
    GuardSettings { limits, envelope: None, workspace: None, tracking: of(0.1) }
}

/// The guard of an arm that follows joint 1 without an error. Its brake has half of the limits: 7.5 rad/s2 and 3750 rad/s3.
struct Follows {
    guard: Guard,
    q: f64,
}

impl Follows {
    fn new(change: impl Fn(&mut GuardSettings)) -> Follows {
        let mut settings = settings();
        change(&mut settings);
        Follows { guard: Guard::new(2, settings, 0.5, None), q: 0.0 }
    }

    /// The guard's result for a setpoint of joint 1 that is sent `dt` after the last.
    fn send(&mut self, dt: f64, [q, dq, ddq]: [f64; 3]) -> Result<(), Violation> {
        let mut state = State::default();
        state.q[0] = self.q;
        let checked = self.guard.check(dt, &command([q, dq, ddq]), &ModelTorques::default(), &state);
        self.q = q;
        checked
    }

    /// Every sample of `along` until `end` \[s\] passes.
    fn go(&mut self, end: f64, along: impl Fn(f64) -> [f64; 3]) {
        for k in 1..=(end / DT).round() as u32 {
            let t = f64::from(k) * DT;
            assert_eq!(self.send(DT, along(t)), Ok(()), "at {t} s");
        }
    }
}

fn command([q, dq, ddq]: [f64; 3]) -> Command {
    let mut desired = Setpoint::default();
    (desired.q[0], desired.dq[0], desired.ddq[0]) = (q, dq, ddq);
    Command { desired, ..Command::default() }
}

/// From rest at 0 with 5000 rad/s3 to 10 rad/s2 within 2 ms, and on with these.
fn speeding_up(t: f64) -> [f64; 3] {
    let (s, late) = (t.min(2e-3), (t - 2e-3).max(0.0));
    let (q, dq, ddq) = (5000.0 * s.powi(3) / 6.0, 2500.0 * s * s, 5000.0 * s);
    [q + dq * late + 0.5 * ddq * late * late, dq + ddq * late, ddq]
}

fn parts(violation: Violation) -> (Limit, f64, f64) {
    (violation.limit, violation.value, violation.bound)
}

#[test]
fn rounding_is_no_violation() {
    // A microradian at an end of the range, one part in a million of every other limit.
    for (past, passes) in [(0.7e-6, true), (1.4e-6, false)] {
        for joint in [0, 1] {
            let (guard, limits) = (Guard::new(2, settings(), 0.5, None), settings().limits);
            let to = |q: f64| {
                let mut target = JointVec::default();
                target[joint] = q;
                guard.check_target(&target).map_err(|why| (why.limit, why.joint, why.bound))
            };
            for (q, bound) in
                [(limits.q_min[joint] - past, limits.q_min[joint]), (limits.q_max[joint] + past, limits.q_max[joint])]
            {
                assert_eq!(to(q), if passes { Ok(()) } else { Err((Limit::Position, joint, bound)) });
            }
            let mut state = State::default();
            state.tau[joint] = -80.0 * (1.0 + past);
            let checked =
                Guard::new(2, settings(), 0.5, None).check(DT, &command([0.0; 3]), &ModelTorques::default(), &state);
            assert_eq!(checked.is_ok(), passes, "{checked:?}");
        }
    }
}

#[test]
fn stated_derivatives_are_limited_where_the_positions_keep_the_limits() {
    // 10 ms after the last sample much may have happened between the positions. These say 0.94 rad/s.
    let mut arm = Follows::new(|settings| settings.limits.dq[0] = 0.945);
    arm.go(0.09, speeding_up);
    let [q, ..] = speeding_up(0.09);
    let found = arm.send(0.01, [q + 0.0094, 0.96, -14.9]).map_err(parts);
    assert_eq!(found, Err((Limit::Velocity, 0.96, 0.945)));

    let mut arm = Follows::new(|settings| settings.limits.ddq[0] = 10.5);
    arm.go(0.05, speeding_up);
    let [q, dq, _] = speeding_up(0.051);
    assert_eq!(arm.send(DT, [q, dq, 10.6]).map_err(parts), Err((Limit::Acceleration, 10.6, 10.5)));
}

#[test]
fn stated_derivatives_may_need_one_and_a_half_times_the_jerk_limit() {
    // `1.5 * 7500 rad/s3 * (1 ms)^2 / 6` and `1.5 * 7500 rad/s3 * 3 ms / 3`.
    let (dq, ddq) = (1.875e-3, 11.25);
    for share in [0.97, -0.97, 1.03, -1.03_f64] {
        let cases = [
            (Limit::StatedVelocity, share * dq, [0.0, share * dq, 0.0]),
            (Limit::StatedAcceleration, share * ddq, [0.0, 0.5 * DT * share * ddq, share * ddq]),
        ];
        for (limit, value, stated) in cases {
            let found = Follows::new(|_| ()).send(DT, stated).map_err(parts);
            assert_eq!(found, if share.abs() < 1.0 { Ok(()) } else { Err((limit, value, 0.0)) });
        }
    }
}

#[test]
fn the_speed_ahead_includes_the_decay_of_the_acceleration() {
    // 10 rad/s2 taken back with 3750 rad/s3.
    let ahead = |t: f64| speeding_up(t)[1] + 10.0 * 10.0 / (2.0 * 3750.0);
    for sign in [1.0, -1.0] {
        let along = |t: f64| speeding_up(t).map(|value| sign * value);
        let mut arm = Follows::new(|settings| settings.limits.dq[0] = ahead(0.0505));
        arm.go(0.05, along);
        let (limit, value, bound) = parts(arm.send(DT, along(0.051)).unwrap_err());
        assert_eq!((limit, bound), (Limit::VelocityAhead, ahead(0.0505)));
        assert!((value - sign * ahead(0.051)).abs() < 1e-12, "{value}");

        // Where the speed depends on the position, it is held against where the joint will be: `ahead (7.5 + 10) / 3750` further on.
        let mut arm = Follows::new(|settings| {
            settings.envelope = Some(SpeedEnvelope { offset: [0.05; MAX_JOINTS], deceleration: [20.0; MAX_JOINTS] });
            (settings.limits.q_min[0], settings.limits.q_max[0]) = (-0.05, 0.05);
        });
        let refused =
            |k: u32| arm.send(DT, along(f64::from(k) * DT)).err().map(|violation| (f64::from(k) * DT, violation));
        let (t, violation) = (1..1000).find_map(refused).unwrap();
        let room = 0.05 - speeding_up(t)[0] - ahead(t) * (7.5 + 10.0) / 3750.0;
        // The envelope, lowered to what the brake can do.
        let most = (2.0 * 7.5 * room).sqrt() - 0.05;
        assert_eq!(violation.limit, Limit::VelocityAhead);
        assert!((violation.bound - most).abs() < 1e-9 && ahead(t) > most, "{violation}, by hand {most}");
    }
}

#[test]
fn a_guard_restored_from_records_decides_as_the_original() {
    let of = || Follows::new(|settings| settings.limits.ddq[0] = 100.0);
    let mut before = of();
    before.go(0.017, speeding_up);
    assert_eq!(before.send(3.0 * DT, speeding_up(0.02)), Ok(()), "two states were lost");
    let mut after = of();
    let records = [16_u32, 17, 20].map(|seq| {
        let mut record = Record { command: command(speeding_up(f64::from(seq) * DT)), ..Record::default() };
        record.state.seq = seq.into();
        record.command.tau_ff = Torque([5.0; MAX_JOINTS]);
        record
    });
    after.guard.restore(&records);
    after.q = before.q;
    // By the four last positions and the times between them.
    let [q, dq, ddq] = speeding_up(0.021);
    let found = [&mut before, &mut after].map(|arm| parts(arm.send(DT, [q + 4e-5, dq, ddq]).unwrap_err()));
    assert_eq!((found[0].0, found[1].0), (Limit::Jerk, Limit::Jerk));
    assert!((found[0].1 - found[1].1).abs() < 1e-6, "{found:?}");
    // The torque of the last record was 5 Nm.
    assert_eq!(after.send(DT, [q, dq, ddq]).map_err(parts), Err((Limit::TorqueRate, -5000.0, 1000.0)));
    // At another start no torque came before the first one.
    after.guard.start(JointVec::default());
    after.q = 0.0;
    assert_eq!(after.send(DT, [0.0; 3]), Ok(()));
}

#[test]
fn a_stop_sample_that_is_not_finite_is_not_sent() {
    for spoiled in [[f64::NAN, 0.0, 0.0], [0.0, f64::INFINITY, 0.0], [0.0, 0.0, f64::NAN]] {
        let mut guard = Guard::new(2, settings(), 0.5, None);
        let checked = guard.check_brake(DT, &command(spoiled), &ModelTorques::default(), None);
        assert_eq!(checked.map_err(|why| why.limit), Err(Limit::NotFinite));
    }
}

#[test]
fn an_edge_of_the_box_is_inside_and_a_violation_names_the_edge() {
    let space = Workspace { box_min: [-0.5, -0.2, 0.0], box_max: [0.5, 0.25, 0.8], base_radius: 0.5 };
    let check = |x: [f64; 3]| inside(&space, x).map_err(|why| (why.limit, why.joint, why.value, why.bound));
    for edge in
        [[-0.5, 0.0, 0.4], [0.5, 0.0, 0.4], [0.5, -0.2, 0.4], [0.5, 0.25, 0.4], [0.5, 0.0, 0.0], [0.4, 0.0, 0.8]]
    {
        assert_eq!(check(edge), Ok(()));
    }
    for (axis, edge, past) in
        [(0, -0.5, -0.51), (0, 0.5, 0.51), (1, -0.2, -0.21), (1, 0.25, 0.26), (2, 0.0, -0.01), (2, 0.8, 0.81)]
    {
        let mut x = [0.4, 0.1, 0.4];
        x[axis] = past;
        assert_eq!(check(x), Err((Limit::EndEffectorBox, axis, past, edge)));
        x[axis] = f64::NAN;
        assert!(matches!(check(x), Err((Limit::EndEffectorBox, found, ..)) if found == axis));
    }
    assert!(matches!(check([0.2, 0.1, 0.4]), Err((Limit::BaseSphere, 0, _, 0.5))));
}

#[test]
fn a_violation_has_joint_value_bound_and_whether_the_model_caused_it() {
    let of = |limit: Limit, joint: usize| Violation { limit, joint, value: 1.25, bound: 0.75 };
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let text = of(Limit::EndEffectorBox, axis).to_string();
        assert!(text.contains(&format!("{name} = 1.25")) && text.contains("0.75"), "{text}");
    }
    for (limit, model) in [
        (Limit::Position, false),
        (Limit::StoppingPosition, false),
        (Limit::Velocity, false),
        (Limit::VelocityAhead, false),
        (Limit::Acceleration, false),
        (Limit::Jerk, false),
        (Limit::StatedVelocity, false),
        (Limit::StatedAcceleration, false),
        (Limit::Tracking, false),
        (Limit::MeasuredTorque, false),
        (Limit::Torque, true),
        (Limit::TorqueRate, true),
    ] {
        let text = of(limit, 3).to_string();
        assert!(text.starts_with("joint 4: ") && text.contains("1.25") && text.contains("0.75"), "{text}");
        assert_eq!(of(limit, 3).is_of_model(), model, "{limit:?}");
    }
    for (limit, model) in [(Limit::NotFinite, false), (Limit::MeasuredNotFinite, false), (Limit::TorqueNotFinite, true)]
    {
        assert_eq!(of(limit, 0).is_of_model(), model, "{limit:?}");
    }
}
