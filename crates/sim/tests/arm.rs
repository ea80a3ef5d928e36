//! The simulated arm as a measuring object: what it reports obeys the model it was built from, it loses nothing it should not lose,
//! and it can be repeated bit by bit.

use nalgebra::DVector;
use plumbline_core::{Backend, Clock, Fault, MAX_JOINTS, Setpoint, State};
use plumbline_model::{Chain, Joint, JointKind, Mounting, Placement, Reduction, rnea};
use plumbline_sim::{
    Exact, Gate, Pace, REFLEX_COMMUNICATION, REFUSED_JUMP, REFUSED_NOT_FINITE, REFUSED_STOPPED, SimArm, SimError, Truth,
};
use plumbline_testkit::sim::{
    READY, THREE_EFFECTS, TestClock, arm, arm_with, command, excitation, panda, silent_panda, sim,
};
use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

const N: usize = 7;

fn fast() -> Pace {
    Pace::Fast(Arc::new(Gate::unlimited()))
}

/// Follows the excitation and hands out every state and what was true.
fn follow(arm: &mut SimArm, ticks: usize) -> Vec<(State, Exact)> {
    (0..ticks)
        .map(|_| {
            let state = arm.read().expect("the arm goes on");
            let exact = *arm.exact();
            arm.write(&command(state.seq, excitation(state.seq))).expect("a smooth motion");
            (state, exact)
        })
        .collect()
}

/// Torque of the model the arm was built from: RNEA and the paper's friction.
fn modelled(truth: &Truth, gravity: Mounting, q: &[f64], dq: &[f64], ddq: &[f64]) -> [f64; MAX_JOINTS] {
    let mut tau = [0.0; MAX_JOINTS];
    rnea(&panda(), &truth.link_parameters(), &gravity.gravity(), q, dq, ddq, &mut tau);
    for (j, joint) in truth.joints.iter().enumerate() {
        tau[j] += joint.fv * dq[j] + joint.fc * (100.0 * dq[j]).tanh();
    }
    tau
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / count).sqrt()
}

#[test]
fn measured_torque_obeys_the_identified_model() {
    let truth = silent_panda();
    let run = follow(&mut sim(&truth, 0, fast()), 5000);
    for j in 0..N {
        let off = |state: &State, exact: &Exact| {
            state.tau[j] - modelled(&truth, Mounting::WALL, &state.q, &state.dq, &exact.ddq)[j]
        };
        let left = rms(run.iter().map(|(state, exact)| off(state, exact)));
        let size = rms(run.iter().map(|(state, _)| state.tau[j]));
        assert!(left < 1e-9 && size > 0.1, "joint {}: {left} Nm left of {size} Nm", j + 1);
    }
}

/// The same with the acceleration from the reported positions alone: the arm really moved the way its torques say.
#[test]
fn reported_positions_agree_with_the_accelerations() {
    let truth = silent_panda();
    let run = follow(&mut sim(&truth, 0, fast()), 5000);
    let dq_peak = run.iter().map(|(state, _)| state.dq[0].abs()).fold(0.0, f64::max);
    assert!(dq_peak > 0.5, "a lively motion, not {dq_peak} rad/s");
    for j in 0..N {
        // Away from reversals; there the friction's step rings faster than 1 kHz differences can tell.
        let calm = |k: &usize| (k - 100..k + 100).all(|k| run[k].0.dq[j].abs() > 0.05);
        let off = (1100..run.len() - 100).filter(calm).map(|k| {
            let second = (run[k + 1].0.q[j] - 2.0 * run[k].0.q[j] + run[k - 1].0.q[j]) / 1e-6;
            second - run[k].1.ddq[j]
        });
        let (left, size) = (rms(off), rms(run.iter().map(|(_, exact)| exact.ddq[j])));
        assert!(left < 0.01 * size, "joint {}: {left} of {size} rad/s2", j + 1);
    }
}

/// Three steps a millisecond are enough for the shipped arm, its steep friction included: eight times as many change nothing that matters.
#[test]
fn substeps_have_converged() {
    for (file, effects) in [("no effect", ""), ("three effects", THREE_EFFECTS)] {
        let mut truth = silent_panda();
        truth.effects = arm_with("sim-panda", effects).effects;
        let shipped = follow(&mut sim(&truth, 0, fast()), 3000);
        truth.substeps *= 8;
        let fine = follow(&mut sim(&truth, 0, fast()), 3000);
        for j in 0..N {
            let tau = rms(shipped.iter().zip(&fine).map(|(a, b)| a.0.tau[j] - b.0.tau[j]));
            let q = rms(shipped.iter().zip(&fine).map(|(a, b)| a.0.q[j] - b.0.q[j]));
            println!("{file} joint {}: torque {tau:.2e} Nm, position {q:.2e} rad", j + 1);
            assert!(tau < 1e-3 && q < 1e-6, "{file}, joint {}: {tau} Nm, {q} rad", j + 1);
        }
    }
}

#[test]
fn noise_and_steps_are_as_written() {
    let truth = arm("sim-panda");
    let run = follow(&mut sim(&truth, 7, fast()), 4000);
    for (j, joint) in truth.joints.iter().enumerate() {
        let tau = rms(run.iter().map(|(state, exact)| state.tau[j] - exact.tau[j]));
        let expected = joint.torque_noise.hypot(joint.torque_quantum / 12f64.sqrt());
        assert!((tau / expected - 1.0).abs() < 0.05, "joint {}: torque {tau} instead of {expected}", j + 1);
        let q = rms(run.iter().map(|(state, exact)| state.q[j] - exact.q[j]));
        let expected = joint.position_noise.hypot(joint.position_quantum / 12f64.sqrt());
        assert!((q / expected - 1.0).abs() < 0.05, "joint {}: position {q} instead of {expected}", j + 1);
        let dq = rms(run.iter().map(|(state, exact)| state.dq[j] - exact.dq[j]));
        assert!((dq / joint.velocity_noise - 1.0).abs() < 0.05, "joint {}: velocity {dq}", j + 1);
        let steps = run[1234].0.tau[j] / joint.torque_quantum;
        assert!((steps - steps.round()).abs() < 1e-6);
    }
}

#[test]
fn same_seed_and_commands_give_the_same_bits() {
    let mut truth = arm_with("sim-panda", THREE_EFFECTS);
    (truth.drop_probability, truth.drop_burst) = (0.01, 2);
    let states = |seed| follow(&mut sim(&truth, seed, fast()), 800).into_iter().map(|(s, _)| s).collect::<Vec<_>>();
    let bits = |states: &[State]| {
        let numbers = |s: &State| [s.q, s.dq, s.tau, s.q_d].concat().into_iter().map(f64::to_bits).collect::<Vec<_>>();
        states.iter().map(|s| (s.seq, numbers(s))).collect::<Vec<_>>()
    };
    assert_eq!(bits(&states(3)), bits(&states(3)));
    assert_ne!(bits(&states(3)), bits(&states(4)));
}

/// Lost states cost the loop a state, not the arm its motion: those that arrive are as if none had been lost.
#[test]
fn lost_states_leave_gaps_of_the_burst_length() {
    let mut truth = silent_panda();
    let whole = follow(&mut sim(&truth, 9, fast()), 3000);
    (truth.drop_probability, truth.drop_burst) = (0.02, 3);
    let run = follow(&mut sim(&truth, 9, fast()), 2500);
    let gaps: Vec<u64> = run.windows(2).map(|pair| pair[1].0.seq - pair[0].0.seq).collect();
    let lost: u64 = gaps.iter().map(|gap| gap - 1).sum();
    assert!(gaps.iter().all(|gap| (gap - 1) % 3 == 0), "bursts of three");
    let share = lost as f64 / (2500.0 + lost as f64);
    assert!((0.03..0.09).contains(&share), "{share} lost");
    for (state, _) in run.iter().filter(|(state, _)| state.seq <= 3000) {
        let same = &whole[state.seq as usize - 1].0;
        assert_eq!((same.seq, same.time), (state.seq, state.time));
        // The arm went on alone at constant acceleration, so it is off by the jerk over three milliseconds.
        assert!((0..N).all(|j| (same.q[j] - state.q[j]).abs() < 2e-5), "state {}", state.seq);
    }
}

#[test]
fn twenty_missing_commands_are_a_reflex() {
    let mut arm = sim(&silent_panda(), 0, fast());
    for _ in 0..100 {
        arm.read().expect("nobody has commanded anything yet");
    }
    follow(&mut arm, 700);
    // The last command is still under way at the first of these.
    for missing in 0..20 {
        assert!(arm.read().is_ok(), "after {missing} missing commands");
    }
    let reflex = Fault::Reflex { code: REFLEX_COMMUNICATION };
    assert_eq!(arm.read(), Err(reflex));
    assert_eq!(arm.write(&command(0, excitation(700))), Err(Fault::Refused { code: REFUSED_STOPPED }));
    assert_eq!(arm.read(), Err(reflex));
    arm.stop();
    let rest: Vec<State> = (0..500).map(|_| arm.read().expect("stopped")).collect();
    assert!((0..N).all(|j| rest[499].dq[j].abs() < 1e-6), "{:?}", rest[499].dq);
}

#[test]
fn an_arm_that_tolerates_gaps_continues_a_motion_after_one() {
    let truth = silent_panda();
    let whole = follow(&mut sim(&truth, 0, fast()), 3000);
    for gap in [15, 46, 90] {
        let mut arm = sim(&truth, 0, fast()).with_max_missed(1000);
        follow(&mut arm, 2000);
        for missing in 0..gap {
            arm.read().unwrap_or_else(|fault| panic!("after {missing} missing commands: {fault}"));
        }
        // Somewhere that no arm reaches in that time is refused as ever.
        let away = Setpoint { q: READY.map(|q| q + 1.5), ..Setpoint::default() };
        assert_eq!(arm.write(&command(2000, away)), Err(Fault::Refused { code: REFUSED_JUMP }));
        let run = follow(&mut arm, 400);
        let apart = |values: &[f64], others: &[f64]| (0..N).map(|j| (values[j] - others[j]).abs()).fold(0.0, f64::max);
        let (mut q, mut tau) = (0.0_f64, 0.0_f64);
        for (here, _) in &run {
            let undisturbed = &whole[here.seq as usize - 1].0;
            (q, tau) = (q.max(apart(&here.q, &undisturbed.q)), tau.max(apart(&here.tau, &undisturbed.tau)));
        }
        assert!(q > 1e-6, "after {gap} ms it is where it would have been");
        // A step of the velocity would be some 60 Nm.
        assert!(tau < 30.0, "{gap} ms: {q} rad off gave {tau} Nm");
        let last = run.last().expect("400 of them");
        assert!(apart(&last.0.q, &whole[last.0.seq as usize - 1].0.q) < 1e-4, "after {gap} ms it never came back");
    }
}

#[test]
fn refuses_what_a_robot_refuses_and_continues() {
    let mut arm = sim(&silent_panda(), 0, fast());
    let state = arm.read().unwrap();
    let at = |j: usize, value: f64| {
        let mut desired = Setpoint { q: READY, ..Setpoint::default() };
        desired.q[j] = value;
        command(state.seq, desired)
    };
    assert_eq!(arm.write(&at(3, f64::NAN)), Err(Fault::Refused { code: REFUSED_NOT_FINITE }));
    assert_eq!(arm.write(&at(3, READY[3] + 0.001)), Err(Fault::Refused { code: REFUSED_JUMP }));
    assert_eq!(arm.write(&at(3, READY[3] + 0.0001)), Ok(()));
    // A number past the arm's joints is nobody's business.
    assert_eq!(arm.write(&at(7, f64::NAN)), Ok(()));
    let state = arm.read().unwrap();
    assert_eq!(state.q_d[7], 0.0);
}

/// The gate holds simulated time, not samples: whatever the consumer does, every state arrives in order.
#[test]
fn a_slow_consumer_loses_no_state() {
    let gate = Arc::new(Gate::new(16));
    gate.shut();
    let (sender, receiver) = std::sync::mpsc::channel();
    let mut arm = sim(&silent_panda(), 0, Pace::Fast(gate.clone()));
    let thread = std::thread::spawn(move || {
        loop {
            match arm.read() {
                Ok(state) => {
                    sender.send(state.seq).unwrap();
                    arm.write(&command(state.seq, excitation(state.seq))).unwrap();
                }
                Err(fault) => return fault,
            }
        }
    });
    assert!(receiver.recv_timeout(std::time::Duration::from_millis(20)).is_err(), "the gate is shut");
    gate.open();
    for expected in 1..=500 {
        assert_eq!(receiver.recv().unwrap(), expected);
        assert!(gate.under_way() <= 16);
        gate.consumed(1);
    }
    gate.end();
    assert_eq!(thread.join().unwrap(), Fault::Disconnected);
    assert!(receiver.iter().count() <= 16);
}

#[test]
fn wall_clock_deadlines_are_absolute_and_a_late_reader_loses_states() {
    let zero = Instant::now();
    let mut arm = sim(&silent_panda(), 0, Pace::WallClock(Box::new(TestClock(zero))));
    assert_eq!(arm.deadline_ns(), None);
    let clock = TestClock(zero);
    let origin = arm.read().map(|_| arm.deadline_ns().unwrap()).unwrap();
    let (mut last, mut slept) = (1, 0);
    for k in 1..200u64 {
        if k == 50 {
            std::thread::sleep(std::time::Duration::from_millis(12));
        }
        let came = clock.now_ns();
        let state = arm.read().unwrap();
        let deadline = origin + (state.seq - 1) * 1_000_000;
        assert_eq!(arm.deadline_ns(), Some(deadline), "no drift");
        assert!(clock.now_ns() >= deadline, "not before its time");
        // Whoever comes late gets the newest state that is due and no other: nothing is caught up.
        assert!(deadline + 1_000_000 > came, "state {} was stale when it was asked for", state.seq);
        assert!(state.seq > last, "{} after {last}", state.seq);
        if k == 50 {
            slept = state.seq - last;
        }
        last = state.seq;
    }
    assert!(slept >= 12, "12 ms were slept through, {slept} states went by");
}

/// A machine that needs a millisecond and a half for a millisecond of the arm's life: its clock goes on whenever it is looked at.
struct SlowMachine(AtomicU64);

impl Clock for SlowMachine {
    fn now_ns(&self) -> u64 {
        self.0.fetch_add(1_500_000, Ordering::Relaxed)
    }

    fn sleep_until(&self, ns: u64) {
        self.0.fetch_max(ns, Ordering::Relaxed);
    }
}

#[test]
fn simulated_time_pauses_on_a_host_that_is_too_slow() {
    let mut arm = sim(&silent_panda(), 0, Pace::WallClock(Box::new(SlowMachine(AtomicU64::new(0)))));
    let mut last = arm.read().unwrap().seq;
    for _ in 0..50 {
        let seq = arm.read().unwrap().seq;
        assert!(seq > last && seq - last <= 25, "{seq} after {last}");
        last = seq;
    }
}

/// A machine that is held up twice, the second time while it catches up with the first.
struct HeldUp {
    now: AtomicU64,
    looks: AtomicU64,
}

impl Clock for HeldUp {
    fn now_ns(&self) -> u64 {
        let passes = match self.looks.fetch_add(1, Ordering::Relaxed) {
            300 => 300_000_000,
            360 => 400_000_000,
            _ => 1_000,
        };
        self.now.fetch_add(passes, Ordering::Relaxed) + passes
    }

    fn sleep_until(&self, ns: u64) {
        self.now.fetch_max(ns, Ordering::Relaxed);
    }
}

#[test]
fn a_host_that_stalls_while_it_catches_up_keeps_simulated_time() {
    let clock = HeldUp { now: AtomicU64::new(0), looks: AtomicU64::new(0) };
    let mut arm = sim(&silent_panda(), 0, Pace::WallClock(Box::new(clock)));
    let first = arm.read().unwrap().seq;
    let origin = arm.deadline_ns().unwrap() - first * 1_000_000;
    let seqs: Vec<u64> = (0..200).map(|_| arm.read().unwrap().seq).collect();
    assert!(seqs.windows(2).any(|pair| pair[1] - pair[0] > 650), "it was not held up at all");
    assert_eq!(arm.deadline_ns(), Some(origin + seqs.last().unwrap() * 1_000_000));
}

#[test]
fn arms_that_do_not_fit_are_refused() {
    let truth = silent_panda();
    let short = Chain::modified(panda().joints()[..6].to_vec(), Placement::identity());
    let new = |chain: &Chain, start| SimArm::new(chain, &truth, Mounting::WALL, start, 0, fast()).err();
    assert_eq!(new(&short, READY), Some(SimError::Joints { truth: 7, chain: 6 }));
    let mut start = READY;
    start[2] = f64::INFINITY;
    assert_eq!(new(&panda(), start), Some(SimError::NotFinite { what: "joint 3".into(), value: f64::INFINITY }));
}

#[test]
fn a_wrong_truth_names_the_place() {
    let text = std::fs::read_to_string(plumbline_testkit::path("config/arms/sim-panda.toml")).unwrap() + THREE_EFFECTS;
    let cases = [
        ("mass = 4.970684", "mass = -1.0", "link 1, mass"),
        ("0.027518, 0.039252", "nan, 0.039252", "link 3"),
        ("0.70337, -0.000139", "0.10, -0.000139", "link 1, inertia"),
        ("fc = 0.5182", "fc = -0.5", "joint 1, fc"),
        ("fc = 0.5182", "fx = 0.5182", "line"),
        ("substeps = 3", "substeps = 0", "substeps"),
        ("drop-probability = 0.0", "drop-probability = 0.9", "drop-probability"),
        ("joint = 4\ndelta", "joint = 8\ndelta", "effect 2, joint"),
        ("delta = 0.002", "delta = 0.0", "effect 2, delta"),
        ("id = \"presliding\"", "id = \"poltergeist\"", "line"),
        ("mass = 0.73\n", "mass = 0.73\nlink = 9\n", "effect 3, link"),
    ];
    for (from, to, place) in cases {
        assert!(text.contains(from), "{from}");
        let error = Truth::parse("arm.toml", &text.replacen(from, to, 1)).expect_err(to);
        assert_eq!(error.file, "arm.toml");
        assert!(error.place.contains(place), "{to}: `{error}` does not name {place}");
    }
}

/// Writes an arm file with an effect (`base.toml`), and parses one beside it that extends it.
fn parsed_over_base(text: &str) -> Result<Truth, String> {
    let folder = tempfile::tempdir().unwrap();
    let shipped = std::fs::read_to_string(plumbline_testkit::path("config/arms/sim-panda.toml")).unwrap();
    let base = shipped + "[[effect]]\nid = \"torque-offset\"\njoint = 1\noffset = 0.3\n";
    std::fs::write(folder.path().join("base.toml"), &base).unwrap();
    std::fs::write(folder.path().join("based.toml"), "base = \"base.toml\"\n").unwrap();
    std::fs::write(folder.path().join("light.toml"), base.replace("mass = 4.970684", "mass = -1.0")).unwrap();
    let own = folder.path().join("own.toml").display().to_string();
    let place = format!("{}/", folder.path().display());
    Truth::parse(&own, text).map_err(|error| error.to_string().replace(&place, ""))
}

#[test]
fn an_arm_file_extends_its_base() {
    let base = parsed_over_base("base = \"base.toml\"").unwrap();
    assert_eq!(base, arm_with("sim-panda", "[[effect]]\nid = \"torque-offset\"\njoint = 1\noffset = 0.3\n"));

    let spring = "[[effect]]\nid = \"spring\"\njoint = 6\nstiffness = 1.0\n";
    let own = parsed_over_base(&format!("base = \"base.toml\"\nsubsteps = 5\ndrop-burst = 2\n{spring}")).unwrap();
    let expected =
        arm_with("sim-panda", &format!("[[effect]]\nid = \"torque-offset\"\njoint = 1\noffset = 0.3\n{spring}"));
    assert_eq!(own, Truth { substeps: 5, drop_burst: 2, ..expected });
}

#[test]
fn a_wrong_base_is_refused_with_file_key_and_value() {
    let cases = [
        ("base = \"lost.toml\"", "own.toml: key `base`: got `lost.toml`, expected a readable arm file (lost.toml: "),
        (
            "base = \"based.toml\"",
            "own.toml: key `base`: got `based.toml`, expected an arm file without a base of its own",
        ),
        ("base = \"own.toml\"", "own.toml: key `base`: got `own.toml`, expected a readable arm file"),
        ("base = \"light.toml\"", "light.toml: link 1, mass: got -1"),
        ("base = 3", "own.toml: line 1, key `base`: got `3`"),
        ("base = \"base.toml\"\nbase-file = \"x\"", "own.toml: line 2, key `base-file`"),
        ("base = \"base.toml\"\nsubsteps = 0", "own.toml: substeps: got 0"),
        ("base = \"base.toml\"\n[[effect]]\nid = \"spring\"\njoint = 8", "own.toml: effect 1, joint: got 8"),
        ("base = \"base.toml\"\nlink = []\njoint = []", "own.toml: link: got 0 links"),
        ("robot = \"panda\"", "own.toml: key `link`: got nothing, expected `link`, or the `base` that has it"),
    ];
    for (text, expected) in cases {
        let error = parsed_over_base(text).expect_err(text);
        assert!(error.starts_with(expected), "{text}: `{error}` does not begin with `{expected}`");
    }
}

#[test]
fn the_paper_arm_has_the_base_parameters_of_table_2() {
    let joint = |alpha| Joint { kind: JointKind::Revolute, a: 0.0, alpha, d: 0.0, theta: 0.0 };
    let chain = Chain::modified(vec![joint(0.0), joint(-FRAC_PI_2)], Placement::identity());
    let truth = arm("sim-paper-2dof");
    let delta = DVector::from_vec(truth.link_parameters().concat());
    let beta = Reduction::any_mounting(&chain).regroup() * delta;
    let paper = [0.320, 0.800, 1.100, 1.590, 0.210, -0.030, 0.210, 1.660, 0.300, -2.100];
    assert_eq!(beta.len(), paper.len());
    assert!(beta.iter().zip(paper).all(|(found, value)| (found - value).abs() < 1e-9), "{beta}");
}
