//! A recording through the loop again gives the same commands bit for bit, from wherever it begins and whatever happened in it; and no
//! bytes make its reader panic.

use nalgebra::DMatrix;
use plumbline::postmortem::replay::{Parts, ReplayError, Replayed, replay};
use plumbline::postmortem::story::Story;
use plumbline::postmortem::{page, text};
use plumbline::recording::Recording;
use plumbline::recording::about::{
    About, FORMAT, Given, Handed, LogClock, Reason, ReasonKind, Series, Settings, panic_message, panicked,
};
use plumbline::recording::history::{History, Window};
use plumbline_core::{Fault, FeedForward, JointVec, MAX_JOINTS, Phase, Record, Setpoint, Sink};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_rt::cycle::End;
use plumbline_rt::{Event, Handles, Order, OrderKind, StopReason};
use plumbline_testkit::fake_arm::drive::{Job, Model, READY, Run, settings};
use plumbline_testkit::fake_arm::{FakeArm, Trick};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

const AWAY: JointVec = [0.3, -0.5, -0.2, -2.0, 0.4, 1.3, 0.5, 0.0];
const JOINTS: usize = 7;

/// Orders as data: the loop's own are made of them.
fn move_to(motion: u32, target: JointVec) -> Given {
    Given::Move { motion, target, phase: Phase::Approach as u32 }
}

fn follow(motion: u32, at: JointVec, periods: u32) -> Given {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(motion));
    let mut draw = || DMatrix::from_fn(JOINTS, 4, |_, _| rng.random_range(-0.03..0.03));
    let mut fourier = Fourier::new(2.0, at[..JOINTS].to_vec(), draw(), draw()).unwrap();
    fourier.project();
    let rows = |of: &DMatrix<f64>| of.row_iter().map(|row| row.iter().copied().collect()).collect();
    let (a, b) = (rows(&fourier.a), rows(&fourier.b));
    Given::Follow { motion, series: Series { period: 2.0, periods, q0: fourier.q0.clone(), a, b } }
}

fn order(given: &Given) -> Order {
    match given {
        Given::Move { motion, target, .. } => {
            Order { motion: *motion, kind: OrderKind::MoveTo { target: *target, phase: Phase::Approach } }
        }
        Given::Dwell { motion, ticks } => Order { motion: *motion, kind: OrderKind::Dwell { ticks: *ticks } },
        Given::Follow { motion, series } => {
            let matrix = |rows: &Vec<Vec<f64>>| DMatrix::from_fn(rows.len(), rows[0].len(), |r, c| rows[r][c]);
            let fourier = Fourier::new(series.period, series.q0.clone(), matrix(&series.a), matrix(&series.b)).unwrap();
            let reference = PeriodicMotion::new(&fourier, series.periods).unwrap();
            Order { motion: *motion, kind: OrderKind::Follow(Box::new(reference)) }
        }
        Given::Opaque { .. } => unreachable!("these tests write every order down"),
    }
}

/// Models of the tests: small, one that jumps, one that is no number.
fn model(id: u64) -> Box<dyn FeedForward> {
    Box::new(Model(id, move |d: &Setpoint| match id {
        1..=9 => d.q.map(|q| (q * id as f64).sin() + 0.1 * id as f64),
        66 => d.q.map(|q| if q > 0.1 { 1e4 } else { q }),
        _ => [f64::NAN; MAX_JOINTS],
    }))
}

/// A run and everything that its loop was given.
struct TimedEvent {
    run: Run,
    orders: Vec<Given>,
    models: Vec<u64>,
}

/// Something that the outside does.
type Act = fn(&mut Handles);

/// A job with orders and models from the start, tricks, and things that the outside does in mid-run: orders and models given there are
/// listed by the caller in `later`.
fn told(
    arm: FakeArm,
    quit: u64,
    orders: Vec<Given>,
    models: Vec<u64>,
    later: (Vec<Given>, Vec<u64>),
    outside: Vec<(u64, Act)>,
) -> TimedEvent {
    let mut job = Job::on(arm, quit);
    for given in &orders {
        job = job.order(order(given));
    }
    job.models = models.iter().map(|&id| model(id)).collect();
    for (read, act) in outside {
        job = job.outside(read, act);
    }
    TimedEvent { run: job.run(), orders: [orders, later.0].concat(), models: [models, later.1].concat() }
}

/// What the daemon would have said beside a window.
fn about(window: &Window, end: String, dropped_events: u64) -> About {
    let last = window.records.last().unwrap();
    About {
        format: FORMAT,
        plumbline: "test".into(),
        robot: "panda".into(),
        id: "panda".into(),
        joints: JOINTS,
        mounting: "upright".into(),
        rho: 3.1,
        phi: 0.0,
        session: "test".into(),
        job: "none".into(),
        job_sha256: String::new(),
        recorded: "2026-01-01T00:00:00Z".into(),
        reason: Reason::new(ReasonKind::Guard, "a test"),
        end: Some(end),
        next: Vec::new(),
        goes_on: false,
        clock: LogClock::Arm { seq: last.state.seq, epoch_ns: 1_700_000_000_000_000_000 },
        lost: 0,
        late: 0,
        dropped_events,
        motions: vec![(1, "first".into())],
        notes: Vec::new(),
        settings: Settings::from(&settings()),
        under_way: window.before.under_way.clone(),
        orders_before: window.before.orders,
        models_before: window.before.models,
        orders: window.orders.clone(),
        models: window.models.clone(),
    }
}

/// The recording that the daemon would have written from cycle `first` on; near the start, through the file's bytes.
fn recording(of: &TimedEvent, first: u64, lose: Option<u64>) -> Recording {
    let mut history = History::new(60_000, JOINTS, settings().guard.tracking);
    of.orders.iter().for_each(|given| history.ordered(given.clone()));
    of.models.iter().for_each(|&id| history.handed(Handed { id, gravity: [0.0, 0.0, -9.81], vendor: None }));
    // Events overtake their records, as they do in the daemon.
    let mut events = of.run.told.iter().peekable();
    for record in of.run.records.iter().filter(|record| Some(record.cycle) != lose) {
        while let Some(told) = events.next_if(|told| told.cycle <= record.cycle + 3) {
            history.tell(*told);
        }
        history.keep(&[*record]);
    }
    events.for_each(|told| history.tell(*told));
    let window = history.window(first, &[]);
    let last = *window.records.last().unwrap();
    let about = about(&window, of.run.outcome.end.to_string(), of.run.outcome.summary.dropped_events);
    let unanswered =
        of.run.outcome.unanswered.map(|state| Record { cycle: last.cycle + 1, state, ..Record::default() });
    let texts = vec![("robot.toml".to_string(), "name = \"x\"".to_string())];
    let written = Recording { about, records: window.records, unanswered, events: window.events, texts, cut: None };
    if first > 4 {
        return written;
    }
    let read = Recording::parse("memory", &written.to_bytes().unwrap()).unwrap();
    // The file holds every bit. NaN is unequal to itself, its words are not.
    assert_eq!(format!("{:?}", (&read.about, &read.events)), format!("{:?}", (&written.about, &written.events)));
    for (a, b) in read.records.iter().zip(&written.records) {
        assert_eq!(
            format!("{:?} {:?} {:?}", a.state, a.command, a.tick),
            format!("{:?} {:?} {:?}", b.state, b.command, b.tick)
        );
        assert_eq!(
            (a.cycle, a.phase, a.motion, a.model, a.validity),
            (b.cycle, b.phase, b.motion, b.model, b.validity)
        );
        assert_eq!((a.stamp_ns, a.wake_ns, a.work_ns), (b.stamp_ns, b.wake_ns, b.work_ns));
    }
    assert_eq!((read.records.len(), read.texts.len()), (written.records.len(), 1));
    assert_eq!(read.unanswered.map(|one| one.cycle), written.unanswered.map(|one| one.cycle));
    read
}

fn again(recording: &Recording) -> Result<Replayed, ReplayError> {
    let mut build = |handed: &Handed| -> Result<Box<dyn FeedForward>, String> { Ok(model(handed.id)) };
    replay(recording, Parts { kinematics: None, model: &mut build })
}

/// The replay is identical from the loop's start, from its first cycles, and from places all over the run.
#[track_caller]
fn replays_from_everywhere(of: &TimedEvent) {
    let cycles = of.run.records.len() as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(cycles);
    let mut firsts = vec![0, 1, 3, cycles - 5];
    firsts.extend((0..8).map(|_| rng.random_range(0..cycles - 4)));
    // Around every event, where the state of the loop changes.
    firsts.extend(of.run.told.iter().flat_map(|told| [0, 1, 4].map(|back| (told.cycle + 1).saturating_sub(back))));
    for first in firsts.into_iter().filter(|first| *first + 4 < cycles) {
        let recording = recording(of, first, None);
        let replayed = again(&recording).unwrap_or_else(|error| panic!("from {first}: {error}"));
        assert!(replayed.is_identical(), "from {first}: {replayed:?}");
        let lead = if first == 0 { 0 } else { 3 };
        assert_eq!(replayed.compared, cycles - first - lead, "from {first}: {replayed:?}");
        let by_the_loop = !matches!(of.run.outcome.end, End::Fault(_));
        let expected = recording.unanswered.filter(|_| by_the_loop).map(|_| true);
        assert_eq!(replayed.same_end, expected, "from {first}: {replayed:?}");
    }
}

fn whole_job() -> Vec<Given> {
    vec![
        move_to(1, AWAY),
        Given::Dwell { motion: 1, ticks: 120 },
        follow(2, AWAY, 2),
        Given::Dwell { motion: 3, ticks: 40 },
        move_to(4, READY),
    ]
}

fn none() -> (Vec<Given>, Vec<u64>) {
    (Vec::new(), Vec::new())
}

#[test]
fn a_whole_job_with_models_and_lost_states() {
    let arm = FakeArm::new(JOINTS, READY).at(500, Trick::Lose(3)).at(4_000, Trick::Lose(9)).at(4_003, Trick::Lose(1));
    let swap: Act = |handles| assert!(handles.models.serve(model(2)).is_ok());
    let of = told(arm, 12_000, whole_job(), vec![1], (Vec::new(), vec![2]), vec![(3_900, swap)]);
    assert_eq!((of.run.outcome.end, of.run.outcome.stops), (End::Quit, 0));
    assert!(of.run.records.iter().any(|r| r.phase == Phase::Excite && r.model == 2));
    replays_from_everywhere(&of);
}

#[test]
fn a_guard_stop_a_permission_and_another_motion() {
    // Somebody holds joint 2, the guard stops the arm; an operator allows motion and it goes on elsewhere.
    let arm = FakeArm::new(JOINTS, READY).at(4_500, Trick::Push(1, -0.11));
    let resume: Act = |handles| assert!(handles.controls.resume());
    let give: Act = |handles| {
        assert!(handles.orders.give(order(&move_to(9, READY))).is_ok());
    };
    let later = (vec![move_to(9, READY)], Vec::new());
    let of = told(arm, 9_000, whole_job(), vec![3], later, vec![(5_500, resume), (5_600, give)]);
    let stops = of.run.events.iter().filter(|e| matches!(e, Event::Stopping { reason: StopReason::Guard(_), .. }));
    assert_eq!((stops.count(), of.run.outcome.end), (1, End::Quit));
    assert!(of.run.events.contains(&Event::Started { motion: 9 }) && of.run.events.contains(&Event::Resumed));
    replays_from_everywhere(&of);
}

#[test]
fn the_limit_is_that_of_the_stop_which_the_recording_is_about() {
    // Somebody holds joint 2, an operator allows motion again, and somebody holds joint 5.
    let arm = FakeArm::new(JOINTS, READY).at(4_500, Trick::Push(1, -0.11)).at(6_200, Trick::Push(4, 0.12));
    let resume: Act = |handles| assert!(handles.controls.resume());
    let give: Act = |handles| assert!(handles.orders.give(order(&move_to(9, READY))).is_ok());
    let later = (vec![move_to(9, READY)], Vec::new());
    let of = told(arm, 9_000, whole_job(), vec![3], later, vec![(5_500, resume), (5_600, give)]);
    let stops: Vec<u64> =
        of.run.told.iter().filter(|t| matches!(t.event, Event::Stopping { .. })).map(|t| t.cycle).collect();
    assert_eq!(stops.len(), 2, "{:?}", of.run.told);
    let story = |last: u64| {
        let mut recording = recording(&of, 4_000, None);
        recording.records.retain(|record| record.cycle <= last);
        recording.events.retain(|told| told.cycle <= last);
        Story::of("two", &recording, None)
    };
    let (first, second) = (story(stops[0] + 300).first_limit, story(u64::MAX).first_limit);
    assert_eq!((first.map(|limit| limit.joint), second.map(|limit| limit.joint)), (Some(2), Some(5)));
    // Between the permission and the second stop nothing is crossed.
    assert_eq!(story(stops[1] - 1).first_limit, None);
}

#[test]
fn states_lost_in_every_motion() {
    for read in [300, 3_000, 4_200] {
        let arm = FakeArm::new(JOINTS, READY).at(read, Trick::Lose(14));
        let of = told(arm, 7_000, whole_job(), vec![4], none(), Vec::new());
        let lost = StopReason::LostStates { lost: 14 };
        assert_eq!((of.run.outcome.last_stop, of.run.outcome.end), (Some(lost), End::Quit));
        replays_from_everywhere(&of);
    }
}

#[test]
fn a_stop_that_is_asked_for_and_a_program_that_ends_in_mid_motion() {
    let stop: Act = |handles| handles.controls.stop();
    for (read, quit) in [(200, 2_000), (3_950, 5_000), (9_000, 4_400)] {
        let of = told(FakeArm::new(JOINTS, READY), quit, whole_job(), Vec::new(), none(), vec![(read, stop)]);
        assert_eq!((of.run.outcome.stops, of.run.outcome.end), (1, End::Quit));
        replays_from_everywhere(&of);
    }
}

#[test]
fn a_model_that_is_not_trusted_and_one_that_takes_its_place() {
    let good: Act = |handles| assert!(handles.models.serve(model(5)).is_ok());
    let of =
        told(FakeArm::new(JOINTS, READY), 4_000, whole_job(), vec![66], (Vec::new(), vec![5]), vec![(2_500, good)]);
    assert!(of.run.events.contains(&Event::Distrusted { model: 66, instead: 0 }), "{:?}", of.run.events);
    assert!(of.run.events.contains(&Event::Serving { model: 5 }));
    replays_from_everywhere(&of);
}

#[test]
fn a_model_that_is_not_trusted_and_the_one_before_it_that_takes_its_place() {
    let of = told(FakeArm::new(JOINTS, READY), 4_000, whole_job(), vec![4, 66], none(), Vec::new());
    assert!(of.run.events.contains(&Event::Distrusted { model: 66, instead: 4 }), "{:?}", of.run.events);
    assert_eq!(of.run.records.last().map(|record| record.model), Some(4));
    replays_from_everywhere(&of);
}

#[test]
fn orders_that_can_not_be_begun() {
    let mut far = AWAY;
    far[3] = 0.5;
    let cases =
        [vec![move_to(1, far)], vec![move_to(1, AWAY), follow(1, READY, 1)], vec![move_to(1, AWAY), move_to(1, far)]];
    for orders in cases {
        let of = told(FakeArm::new(JOINTS, READY), 8_000, orders, Vec::new(), none(), Vec::new());
        assert_eq!((of.run.outcome.stops, of.run.outcome.end), (1, End::Quit), "{:?}", of.run.events);
        replays_from_everywhere(&of);
    }
}

#[test]
fn faults_of_the_arm_and_states_that_end_the_loop() {
    let ends: [fn() -> Trick; 6] = [
        || Trick::ReadFault(Fault::Reflex { code: 25 }),
        || Trick::ReadFault(Fault::Disconnected),
        || Trick::ReadFault(Fault::Silent { waited_ms: 20 }),
        || Trick::WriteFault(Fault::Refused { code: 2 }),
        || Trick::Repeat,
        || Trick::NanPosition(2),
    ];
    for (case, trick) in ends.iter().enumerate() {
        // The last one in the middle of a stop: then nothing but the arm's own means are left.
        let arm = FakeArm::new(JOINTS, READY).at(4_520, trick());
        let arm = if case == 5 { arm.at(4_500, Trick::Push(1, 0.12)) } else { arm };
        let of = told(arm, 9_000, whole_job(), vec![6], none(), Vec::new());
        assert_ne!(of.run.outcome.end, End::Quit);
        assert_eq!(of.run.outcome.unanswered.is_some(), case >= 4, "{:?}", of.run.outcome.end);
        replays_from_everywhere(&of);
        if case == 5 {
            let replayed = again(&recording(&of, 2_000, None)).unwrap();
            assert_eq!(replayed.end, Some(of.run.outcome.end.to_string()));
            assert!(replayed.end.unwrap().contains("not a finite number"));
        }
    }
}

#[test]
fn a_gap_in_the_recording_is_passed_over_and_a_lie_is_noticed() {
    let of = told(FakeArm::new(JOINTS, READY), 5_000, whole_job(), vec![1], none(), Vec::new());
    let with_gap = recording(&of, 1_000, Some(4_100));
    let replayed = again(&with_gap).unwrap();
    assert!(replayed.is_identical() && replayed.first == 4_104, "{replayed:?}");
    assert!(Story::of("f", &with_gap, None).gaps[0].contains("4100"));

    // One bit of one command.
    let mut lie = recording(&of, 1_000, None);
    let q = &mut lie.records[2_000].command.desired.q[4];
    *q = f64::from_bits(q.to_bits() ^ 1);
    let replayed = again(&lie).unwrap();
    assert_eq!((replayed.different, replayed.is_identical()), (1, false));
    assert!(replayed.first_difference.unwrap().contains("joint 5: desired position"));
    let mut lie = recording(&of, 1_000, None);
    lie.records[2_000].command.tau_ff.0[1] += 1e-12;
    assert_eq!(again(&lie).unwrap().torque_different, 1);
    // An order that was another, one that is missing, a model that is missing.
    let mut lie = recording(&of, 3_000, None);
    lie.about.orders[2] = follow(3, AWAY, 2);
    assert!(again(&lie).unwrap().different > 500);
    // Without the motion the stop that ended it can still be run again.
    lie.about.orders.truncate(2);
    let replayed = again(&lie).unwrap();
    assert!(replayed.is_identical() && replayed.first > 4_900, "{replayed:?}");
    lie.about.under_way = Default::default();
    lie.events.retain(|told| !matches!(told.event, Event::Stopping { .. }));
    assert!(!again(&lie).is_ok_and(|replayed| replayed.is_identical()));
    let mut lie = recording(&of, 3_000, None);
    lie.about.models.clear();
    assert!(matches!(again(&lie), Err(ReplayError::Missing { .. })));
}

/// Gives its records away like a ring that nobody drains.
struct Nobody;

impl Sink for Nobody {
    fn put(&mut self, _: &Record) -> bool {
        false
    }
}

#[test]
fn a_panic_in_the_loop_leaves_its_last_cycles_and_stops_the_arm() {
    let arm = FakeArm::new(JOINTS, READY);
    let seen = std::sync::Arc::clone(&arm.seen);
    let mut settings = settings();
    settings.flight = 1_000;
    let (mut cycle, mut handles) = plumbline_rt::cycle::new(arm, Nobody, None, settings).unwrap();
    let faulty = || -> Box<dyn FeedForward> {
        let mut calls = 0;
        Box::new(Model(7, move |d: &Setpoint| {
            calls += 1;
            assert!(calls < 900, "a defect, on purpose");
            d.q
        }))
    };
    assert!(handles.models.serve(faulty()).is_ok());
    assert!(handles.orders.give(order(&move_to(1, AWAY))).is_ok());
    let panic = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| cycle.run())).unwrap_err();
    let (flight, unanswered) = cycle.after_panic();
    assert!(seen.get().2 > 0, "the arm was stopped");
    assert_eq!((flight.len(), flight[898].cycle, unanswered.map(|state| state.seq)), (899, 898, Some(1900)));

    // Run again it panics again, which is the answer and not the end of whoever asked.
    let mut history = History::new(2_000, JOINTS, [0.1; MAX_JOINTS]);
    history.ordered(move_to(1, AWAY));
    history.handed(Handed { id: 7, gravity: [0.0, 0.0, -9.81], vendor: None });
    std::iter::from_fn(|| handles.events.pop().ok()).for_each(|told| history.tell(told));
    let window = history.window(0, &flight);
    let about = about(&window, panicked(&panic_message(&*panic)), 0);
    let unanswered = unanswered.map(|state| Record { cycle: 899, state, ..Record::default() });
    let recording =
        Recording { about, records: window.records, unanswered, events: window.events, texts: Vec::new(), cut: None };
    let replayed = replay(&recording, Parts { kinematics: None, model: &mut |_| Ok(faulty()) }).unwrap();
    assert!(replayed.is_identical() && replayed.same_end == Some(true), "{replayed:?}");
    assert!(replayed.end.unwrap().ends_with("panicked: a defect, on purpose"));
}

/// A recording of a few cycles with one of everything in it.
fn small() -> Vec<u8> {
    let arm =
        FakeArm::new(JOINTS, READY).at(30, Trick::Lose(2)).at(60, Trick::Push(1, 0.2)).at(64, Trick::NanPosition(0));
    let of = told(arm, 200, vec![move_to(1, AWAY)], vec![1], none(), Vec::new());
    assert!(matches!(of.run.outcome.end, End::Unsafe(_)), "{:?}", of.run.outcome.end);
    recording(&of, 50, None).to_bytes().unwrap()
}

/// Whatever it reads, it also tells, draws and runs again.
fn try_everything(bytes: &[u8], all: bool) -> bool {
    let Ok(recording) = Recording::parse("fuzz", bytes) else { return false };
    if all {
        let story = Story::of("fuzz", &recording, again(&recording).ok());
        assert!(!text(&story).is_empty() && page(&story, &recording).is_ok());
    }
    true
}

#[test]
fn a_file_that_was_cut_reads_up_to_the_cut() {
    let of = told(FakeArm::new(JOINTS, READY), 3_000, whole_job(), vec![1], none(), Vec::new());
    let bytes = recording(&of, 0, None).to_bytes().unwrap();
    let mut most = 0;
    for percent in [20, 40, 60, 80, 99] {
        let cut = &bytes[..bytes.len() * percent / 100];
        let part = Recording::parse("cut", cut).unwrap();
        assert!(part.cut.as_ref().is_some_and(|cut| cut.contains("byte") && cut.contains("record")), "{:?}", part.cut);
        let cycles = part.records.len();
        assert!(
            cycles >= most && cycles * 100 + 6_000 > 3_000 * percent.saturating_sub(8),
            "{percent} %: {cycles} cycles"
        );
        most = cycles;
        assert!(again(&part).unwrap().is_identical());
        assert!(text(&Story::of("cut", &part, None)).contains("cut short"));
    }
    // Bits that were flipped on the disk are noticed by the checksum.
    let mut rotten = bytes.clone();
    let middle = rotten.len() / 2;
    rotten[middle] ^= 4;
    let part = Recording::parse("rot", &rotten).unwrap();
    assert!(part.cut.is_some_and(|cut| cut.to_lowercase().contains("crc")) && part.records.len() < 3_000);
}

/// Opcode, number of the first byte, and number of the byte behind each record from `at` up to `end`.
fn raw_records(bytes: &[u8], mut at: usize, end: usize) -> Vec<(u8, usize, usize)> {
    let mut found = Vec::new();
    while at + 9 < end {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        found.push((bytes[at], at, at + 9 + length));
        at += 9 + length;
    }
    found
}

/// The file without the checksums of its chunks, which the format allows: what is changed in it then is read.
fn without_checksums(sound: &[u8]) -> Vec<u8> {
    let mut bytes = sound.to_vec();
    for (opcode, at, _) in raw_records(sound, 8, sound.len()) {
        // Of a chunk, after opcode and length: begin, end, size, checksum.
        if opcode == 0x06 {
            bytes[at + 9 + 24..at + 9 + 28].fill(0);
        }
    }
    assert_ne!(bytes, sound);
    bytes
}

#[test]
fn a_record_that_goes_beyond_its_chunk_and_an_attachment_without_an_end_are_cuts() {
    let bytes = without_checksums(&small());
    let all = Recording::parse("seed", &bytes).unwrap();
    let file = raw_records(&bytes, 8, bytes.len());
    let find = |opcode| *file.iter().find(|record| record.0 == opcode).unwrap();
    // The last record of the first chunk says that it is longer.
    let (_, chunk, end) = find(0x06);
    let (_, last, whole) = *raw_records(&bytes, chunk + 9 + 40, end).last().unwrap();
    assert_eq!(whole, end);
    let mut longer = bytes.clone();
    longer[last + 1] = longer[last + 1].wrapping_add(20);
    let part = Recording::parse("longer", &longer).unwrap();
    let cut = part.cut.unwrap();
    assert!(cut.contains(&format!("byte {chunk}")) && cut.contains("beyond the end of its chunk"), "{cut}");
    assert!(part.records.len() < all.records.len());
    // An attachment that ends before its checksum.
    let (_, attachment, _) = find(0x09);
    let name = u32::from_le_bytes(bytes[attachment + 25..attachment + 29].try_into().unwrap()) as usize;
    let at = attachment + 29 + name;
    let media = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let header = at + 4 + media + 8 - (attachment + 9);
    for more in 0..4 {
        let mut short = bytes.clone();
        short[attachment + 1..attachment + 9].copy_from_slice(&((header + more) as u64).to_le_bytes());
        let error = Recording::parse("short", &short).unwrap_err().to_string();
        assert!(error.contains("about.json"), "{error}");
    }
}

/// Seeded mutations of a recording; more with PLUMBLINE_FUZZ_CASES.
#[test]
fn no_bytes_make_it_panic() {
    let cases: u64 = std::env::var("PLUMBLINE_FUZZ_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(100_000);
    let seeds = [small(), without_checksums(&small())];
    assert!(seeds.iter().all(|seed| try_everything(seed, true)), "the seeds themselves are sound");
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut read = 0;
    for case in 0..cases {
        let seed = &seeds[(case / 5 % 2) as usize];
        let mut bytes = seed.clone();
        match case % 5 {
            0 => bytes.truncate(rng.random_range(0..=seed.len())),
            1 => {
                // A length or an opcode that lies.
                let at = rng.random_range(0..bytes.len() - 8);
                let lie = [u64::MAX, 1 << 40, 1 << 31, 0, rng.random()][rng.random_range(0..5)];
                bytes[at..at + 8].copy_from_slice(&lie.to_le_bytes());
            }
            2 => {
                let (from, to) = (rng.random_range(0..bytes.len()), rng.random_range(0..bytes.len()));
                let count = rng.random_range(0..200).min(bytes.len() - from.max(to));
                bytes.copy_within(from..from + count, to);
            }
            3 => {
                let at = rng.random_range(0..bytes.len());
                bytes.drain(at..(at + rng.random_range(1..64)).min(seed.len()));
            }
            _ => {
                for _ in 0..rng.random_range(1..6) {
                    let at = rng.random_range(0..bytes.len());
                    bytes[at] = rng.random();
                }
            }
        }
        read += u64::from(try_everything(&bytes, case % 1999 == 0));
    }
    // Many cuts and changes are read as far as they are sound.
    assert!(read > cases / 20, "only {read} of {cases} were read at all");
    // The messages' own fields, with checksums that fit: every value but the bytes around them.
    let sound = Recording::parse("seed", &seeds[0]).unwrap();
    for _ in 0..(cases / 1000).min(2_000) {
        let mut one = sound.clone();
        let place = rng.random_range(0..one.records.len());
        let record = &mut one.records[place];
        let any = f64::from_bits(rng.random());
        let number = [u64::MAX, u64::MAX - 1, 0, rng.random()][rng.random_range(0..4)];
        match rng.random_range(0..9) {
            0 => record.state.q[0] = any,
            1 => record.command.desired.q[1] = any,
            2 => record.state.seq = number,
            3 => record.cycle = number,
            4 => record.stamp_ns = number,
            5 => record.tick = number,
            6 => record.motion = number as u32,
            7 => one.about.motions = vec![(number as u32, "last".into())],
            _ => one.about.orders_before = number as u32,
        }
        if let Ok(bytes) = one.to_bytes() {
            try_everything(&bytes, true);
        }
    }
}

#[test]
fn foreign_files_are_refused_with_what_was_expected() {
    let seed = small();
    let cases: [(&[u8], &[&str]); 4] = [
        (b"", &["byte 0", "empty", "89 4d 43 41 50"]),
        (b"t,q1,tau1\n0,1,2\n", &["byte 0", "74 2c 71", "MCAP"]),
        (&seed[..8], &["about.json", "byte 8"]),
        (&seed[..300], &["about.json"]),
    ];
    for (bytes, parts) in cases {
        let error = Recording::parse("x.mcap", bytes).unwrap_err().to_string();
        assert!(error.starts_with("x.mcap: "), "{error}");
        for part in parts {
            assert!(error.contains(part), "no `{part}` in `{error}`");
        }
    }
}
