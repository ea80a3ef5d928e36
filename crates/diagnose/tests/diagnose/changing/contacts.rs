//! Contacts: of one period among many or few, of motions that do not repeat, and what is none.

use super::{DT, PERIODS, found, kept, prepared, recorded, recorded_periods, stage};
use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_diagnose::Trial;
use plumbline_diagnose::changing::{Changing, add_once, changing};
use plumbline_diagnose::outcome::Acts;
use plumbline_identify::{ExcludedSpan, Experiment, Run, Settings};
use plumbline_model::Placement;
use plumbline_model::term::effect::{Site, Spec};
use plumbline_testkit::scene::lab::{of_force, window};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

/// A push at link 6 for 0.8 s of the fourth period.
fn pushed(seed: u64) -> (Vec<Run>, Vector3<f64>, Vector3<f64>) {
    pushed_at(34.2, PERIODS, seed)
}

/// A push at link 6 for 0.8 s in so many periods.
fn pushed_at(begin: f64, periods: usize, seed: u64) -> (Vec<Run>, Vector3<f64>, Vector3<f64>) {
    let (point, force) = (Vector3::new(0.05, -0.04, 0.02), Vector3::new(4.0, -7.0, 5.0));
    (pushed_by(point, force, periods, seed, |t| window(t, begin, begin + 0.8)), point, force)
}

/// A push at link 6 by a share of a force over time.
fn pushed_by(
    point: Vector3<f64>,
    force: Vector3<f64>,
    periods: usize,
    seed: u64,
    share: impl Fn(f64) -> f64,
) -> Vec<Run> {
    let chain = &stage().chain;
    recorded_periods(1, periods, seed, |at, tau| {
        let share = share(at.t);
        if share > 0.0 {
            of_force(chain, &at.q, 5, point, force * share).iter().zip(tau).for_each(|(own, tau)| *tau += own);
        }
    })
}

#[test]
fn a_contact_is_found_with_time_link_point_and_force() {
    let (runs, point, force) = pushed(6);
    let found = found(&runs);
    assert_eq!((found.contacts.len(), found.transients.len()), (1, 0), "{found:?}");
    let contact = &found.contacts[0];
    assert!((contact.from - 34.2).abs() < 0.2 && (contact.to - 35.0).abs() < 0.2, "{contact:?}");
    assert_eq!((contact.link, contact.periods.as_slice()), (5, [3].as_slice()), "{contact:?}");
    assert!((contact.force - force).norm() < 0.15 * force.norm(), "{contact:?}");
    assert!(contact.explained > 0.95 && contact.gap > 80.0, "{contact:?}");
    // Of the point only the part across the force is known.
    let stage = stage();
    let row = ((contact.from + contact.to) / 2.0 / DT) as usize % stage.periods[0].0.q.nrows();
    let q: Vec<f64> = stage.periods[0].0.q.row(row).iter().copied().collect();
    let mut frame = Placement::identity();
    stage.chain.joints()[..6].iter().zip(&q).for_each(|(joint, &q)| frame = frame.then(&joint.placement(q)));
    let along = frame.rotation.transpose() * force.normalize();
    let off = contact.point.unwrap() - point;
    assert!((off - along * off.dot(&along)).norm() < 0.02, "{contact:?}");
    assert!(found.drifts.is_empty() && found.base_motions.is_empty(), "{found:?}");
}

/// The axes of joints 1 and 2 meet in the frame of link 2: a force at its origin moves nothing.
#[test]
fn a_contact_is_found_on_a_link_whose_origin_is_on_all_axes_before_it() {
    let (point, force) = (Vector3::new(0.1, -0.25, 0.05), Vector3::new(9.0, -12.0, 20.0));
    let chain = &stage().chain;
    for periods in [1, 3] {
        let runs = recorded_periods(1, periods, 63, |at, tau| {
            let share = window(at.t, 4.2, 5.2);
            of_force(chain, &at.q, 1, point, force * share).iter().zip(tau).for_each(|(own, tau)| *tau += own);
        });
        let found = if periods == 1 { found_once(&runs) } else { found(&runs) };
        let [contact] = &found.contacts[..] else { panic!("{periods}: {:?}", found.contacts) };
        assert!((contact.from - 4.2).abs() < 0.2 && (contact.to - 5.2).abs() < 0.2, "{periods}: {contact:?}");
        assert!(contact.link == 1 && contact.explained > 0.95, "{periods}: {contact:?}");
        let torque = |joint: usize| contact.torque(joint, 4.7).abs();
        assert!(torque(0) > 1.0 && torque(1) > 1.0 && torque(2) < 1e-9, "{periods}: {contact:?}");
    }
}

#[test]
fn a_contact_is_found_in_few_periods() {
    for (begin, periods) in [(14.2, 3), (14.2, 2), (4.2, 2)] {
        let (runs, _, force) = pushed_at(begin, periods, 50 + periods as u64);
        let found = found(&runs);
        let [contact] = &found.contacts[..] else { panic!("{periods}: {:?}", found.contacts) };
        assert!((contact.from - begin).abs() < 0.2 && (contact.to - begin - 0.8).abs() < 0.2, "{contact:?}");
        // The mean over its rise and fall too, with the noise of one period.
        assert!(contact.link == 5 && (contact.force - force).norm() < 0.2 * force.norm(), "{contact:?}");
        // What it adds to the torques is nothing before and after it.
        let torque = |t: f64| (0..7).map(|joint| contact.torque(joint, t).abs()).fold(0.0, f64::max);
        assert!(torque(begin + 0.4) > 1.0 && torque(begin - 0.3) < 0.2 && torque(begin + 1.2) < 0.2, "{contact:?}");
        assert!(found.steps.is_empty() && found.drifts.is_empty() && found.transients.is_empty(), "{found:?}");
        let [span] = &found.leave_out[..] else { panic!("{:?}", found.leave_out) };
        assert!(span.from < begin && span.to > begin + 0.8 && span.to - span.from < 1.6, "{span:?}");
    }
}

#[test]
fn what_comes_in_every_period_or_in_one_joint_is_no_contact() {
    // A push of the model's lack: in both periods, at the same place.
    let force = Vector3::new(4.0, -7.0, 5.0);
    let again = pushed_by(Vector3::zeros(), force, 2, 61, |t| window(t % 10.0, 4.2, 5.0));
    // A cable that catches in one joint.
    let alone = recorded_periods(1, 3, 62, |at, tau| tau[3] += 2.0 * window(at.t, 14.2, 15.0));
    for runs in [again, alone] {
        let found = found(&runs);
        assert!(found.contacts.is_empty(), "{:?}", found.contacts);
    }
}

#[test]
fn short_bumps_of_their_own_in_four_joints_are_no_contact() {
    // A wrench on link 4 has six numbers at each knot, and moves with the arm faster than the knots.
    for seed in 75..79 {
        let bumps = recorded_periods(1, 1, seed, |at, tau| {
            for (j, tau) in tau.iter_mut().enumerate().take(4) {
                *tau += 3.0 * window(at.t, 4.2, 4.4) * (TAU * (3.0 + 1.7 * j as f64) * at.t).sin();
            }
        });
        assert!(found_once(&bumps).contacts.is_empty(), "{seed}");
    }
}

#[test]
fn what_no_force_explains_stays_a_transient() {
    // Joints 1, 4 and 7 against each other, in a way of their own.
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let shape: Vec<f64> = (0..7).map(|_| rng.random_range(-2.0..2.0)).collect();
    let runs = recorded(1, 7, |at, tau| {
        let share = window(at.t, 52.0, 54.0);
        for (j, tau) in tau.iter_mut().enumerate() {
            *tau += share * shape[j] * (TAU * (1.0 + 0.7 * j as f64) * at.t).sin();
        }
    });
    let found = found(&runs);
    assert_eq!((found.contacts.len(), found.transients.len()), (0, 1), "{found:?}");
    let event = &found.transients[0];
    assert!((event.from - 52.0).abs() < 0.2 && (event.to - 54.0).abs() < 0.2 && event.period == 5, "{event:?}");
    assert!(event.joints.len() >= 5, "{event:?}");
}

#[test]
fn a_contact_that_is_left_out_leaves_no_trace_in_the_mean() {
    let (runs, _, _) = pushed(9);
    let clean = prepared(&recorded(1, 9, |_, _| {}), &kept());
    let touched = prepared(&runs, &kept());
    let difference = |other: &Experiment| (&other.tau - &clean[0].tau).amax();
    assert!(difference(&touched[0]) > 0.2, "{}", difference(&touched[0]));
    let found = found(&runs);
    let left_out = prepared(&runs, &Settings { leave_out: found.leave_out.clone(), ..kept() });
    // Nine periods instead of ten have a little more noise: 0.15 Nm over the root of 90 or so.
    let off = &left_out[0].tau - &clean[0].tau;
    let at = off.iamax_full();
    assert!(off.amax() < 0.12, "{} at {at:?}, left out {:?}", off[at], found.leave_out);
    let std = |experiment: &Experiment| experiment.scatter.as_ref().unwrap().std.clone();
    for ((touched, left_out), clean) in std(&touched[0]).iter().zip(std(&left_out[0])).zip(std(&clean[0])) {
        assert!((left_out / clean - 1.0).abs() < 0.01 && *touched > left_out, "{touched} {left_out} {clean}");
    }
    // The spectrum of the noise is the same either way.
    let scatter = found.scatter[0].as_ref().unwrap();
    for (a, b) in scatter.std.iter().zip(std(&clean[0])) {
        assert!((a / b - 1.0).abs() < 0.01, "{a} {b}");
    }
    // A whole period that is left out is no period; the others are the mean.
    let period = ExcludedSpan::period(&runs[0].name, 3, 10.0);
    let fewer = prepared(&runs, &Settings { leave_out: vec![period], ..kept() });
    let repeats = fewer[0].repeats.as_ref().unwrap();
    assert_eq!(repeats.periods, [0, 1, 2, 4, 5, 6, 7, 8, 9]);
    assert_eq!(fewer[0].scatter.as_ref().unwrap().periods, 9);
    let mean = |k: usize, j: usize| {
        (0..PERIODS).filter(|p| *p != 3).map(|p| runs[0].tau[(p * 10_000 + k, j)]).sum::<f64>() / 9.0
    };
    for (k, j) in [(0, 0), (4567, 3), (9999, 6)] {
        assert!((fewer[0].tau[(k, j)] - mean(k, j)).abs() < 1e-9);
    }
}

/// Contacts of runs without repeats, each compared with what is known of the arm.
fn found_once(runs: &[Run]) -> Changing {
    found_beside(runs, &[])
}

/// The same where something is known to have come.
fn found_beside(runs: &[Run], came: &[&Acts]) -> Changing {
    let stage = stage();
    let once: Vec<Run> = runs.iter().map(|run| Run { period: None, ..run.clone() }).collect();
    let mut found = Changing::default();
    let plain = |motion: &_| stage.plain(motion);
    add_once(&mut found, &Trial::in_turn(&prepared(&once, &kept())), &stage.operating_point, came, plain);
    found
}

#[test]
fn a_contact_is_found_in_a_motion_that_does_not_repeat() {
    let push = |begin: f64, end: f64| {
        let (point, force) = (Vector3::new(0.05, -0.04, 0.02), Vector3::new(4.0, -7.0, 5.0));
        (found_once(&pushed_by(point, force, 1, 71, |t| window(t, begin, end))), force)
    };
    let (found, force) = push(4.2, 5.2);
    let [contact] = &found.contacts[..] else { panic!("{:?}", found.contacts) };
    assert!((contact.from - 4.2).abs() < 0.2 && (contact.to - 5.2).abs() < 0.2, "{contact:?}");
    assert!(contact.link == 5 && (contact.force - force).norm() < 0.25 * force.norm(), "{contact:?}");
    // What is there when the run ends may have come to stay.
    assert!(push(8.0, 11.0).0.contacts.is_empty());
    assert!(found_once(&recorded_periods(2, 1, 72, |_, _| {})).contacts.is_empty());
}

#[test]
fn where_something_came_in_a_motion_that_does_not_repeat_is_no_contact() {
    let (point, force) = (Vector3::new(0.05, -0.04, 0.02), Vector3::new(4.0, -7.0, 5.0));
    let runs = pushed_by(point, force, 1, 71, |t| window(t, 4.2, 5.2));
    let came = |run: &str, from: f64| Acts { run: run.into(), from, to_end_of_recording: true };
    for (run, from, left) in
        [(&*runs[0].name, 4.7, 0), (&*runs[0].name, 3.9, 0), (&*runs[0].name, 2.0, 1), ("other", 4.7, 1)]
    {
        let found = found_beside(&runs, &[&came(run, from)]).contacts;
        assert_eq!(found.len(), left, "{run} {from}: {found:?}");
    }
}

#[test]
fn torques_that_drop_out_in_a_motion_that_does_not_repeat_are_no_contact() {
    let clean = recorded_periods(1, 1, 72, |_, _| {});
    let touched = |first: usize| {
        let mut runs = clean.clone();
        // Where they were lost there is a line.
        runs[0].tau.view_mut((first, 0), (200, 7)).fill(0.0);
        found_once(&runs).contacts
    };
    for first in (1000..8000).step_by(700) {
        assert!(touched(first).is_empty(), "{first}: {:?}", touched(first));
    }
}

#[test]
fn a_contact_is_found_where_all_but_two_periods_are_left_out() {
    let (runs, _, force) = pushed_at(14.2, 3, 73);
    let settled = ExcludedSpan { run: runs[0].name.clone(), from: 3.5, to: 5.5 };
    let experiments = prepared(&runs, &Settings { leave_out: vec![settled], ..kept() });
    let found = changing(&stage().operating_point, &Trial::in_turn(&experiments), |motion| stage().plain(motion));
    let [contact] = &found.contacts[..] else { panic!("{:?}", found.contacts) };
    assert!((contact.from - 14.2).abs() < 0.2 && contact.periods == [1], "{contact:?}");
    assert!(contact.link == 5 && (contact.force - force).norm() < 0.25 * force.norm(), "{contact:?}");
}

/// What the model lacks is in both of two periods, of which the first is not settled while most of it acts.
#[test]
fn what_two_periods_do_not_differ_by_is_no_contact() {
    let force = Vector3::new(4.0, -7.0, 5.0);
    for seed in 81..84 {
        let found = |share: &dyn Fn(f64) -> f64| {
            let runs = pushed_by(Vector3::zeros(), force, 2, seed, share);
            let unsettled = ExcludedSpan { run: runs[0].name.clone(), from: 0.0, to: 2.5 };
            let experiments = prepared(&runs, &Settings { leave_out: vec![unsettled], ..kept() });
            changing(&stage().operating_point, &Trial::in_turn(&experiments), |motion| stage().plain(motion)).contacts
        };
        let lack = found(&|t| window(t % 10.0, 1.4, 3.0));
        assert!(lack.is_empty(), "{seed}: {lack:?}");
        // A push in the second period alone shows in the part that can be compared.
        let push = found(&|t| window(t, 11.4, 13.0));
        assert!(push.len() == 1 && (push[0].from - 11.4).abs() < 0.3, "{seed}: {push:?}");
    }
}

/// Of three periods the first is not settled for some seconds: there one has the load, and one has not.
#[test]
fn what_is_picked_up_is_no_contact_where_no_other_period_has_it() {
    let stage = stage();
    let spec = Spec { family: "payload", form: "light", site: Site::Arm, settings: Vec::new() };
    let payload = spec.build(&stage.operating_point).unwrap();
    // 0.3 kg, 15 cm in front of the flange.
    let (mass, place) = (0.3, Vector3::new(0.0, 0.02, 0.15));
    let body = DVector::from_vec(vec![mass * place.x, mass * place.y, mass * place.z, mass]);
    let soon = (75..79).map(|seed| (seed, 2.5, 14.03));
    for (seed, settled, time) in soon.chain([(76, 5.0, 16.03), (75, 7.0, 18.03), (76, 7.0, 18.03)]) {
        let mut runs = recorded_periods(1, 3, seed, |_, _| {});
        let motion = &prepared(&runs, &kept())[0].motion;
        let (samples, joints) = (motion.samples(), motion.joints());
        let mut columns = DMatrix::zeros(samples * joints, body.len());
        payload.fill(&stage.chain, motion, &mut columns, 0);
        let load = columns * &body;
        for row in (time / DT) as usize..runs[0].tau.nrows() {
            (0..joints).for_each(|joint| runs[0].tau[(row, joint)] += load[joint * samples + row % samples]);
        }
        let unsettled = ExcludedSpan { run: runs[0].name.clone(), from: 0.0, to: settled };
        let experiments = prepared(&runs, &Settings { leave_out: vec![unsettled], ..kept() });
        let found = changing(&stage.operating_point, &Trial::in_turn(&experiments), |motion| stage.plain(motion));
        assert!(found.contacts.is_empty(), "{seed}: {:?}", found.contacts);
        let [step] = &found.steps[..] else { panic!("{seed}: {:?}", found.steps) };
        assert!(step.spec.family == "payload" && (step.time - time).abs() < 0.1, "{seed}: {step:?}");
    }
}

#[test]
fn a_contact_shows_behind_noise_of_high_frequency() {
    let (point, force) = (Vector3::new(0.05, -0.04, 0.02), Vector3::new(4.0, -7.0, 5.0));
    let mut runs = pushed_by(point, force, 2, 74, |t| window(t, 14.2, 15.2));
    for (row, mut tau) in runs[0].tau.row_iter_mut().enumerate() {
        tau.add_scalar_mut(5.0 * (TAU * 31.7 * row as f64 * DT).sin());
    }
    let found = found(&runs);
    let [contact] = &found.contacts[..] else { panic!("none") };
    assert!(contact.link == 5 && (contact.force - force).norm() < 0.25 * force.norm(), "{contact:?}");
}
