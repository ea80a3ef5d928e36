//! Replays of recordings are bitwise identical, from any start and after any fault; the reader does not panic on damaged files.

mod file;
mod replay;
mod scene;

use nalgebra::DMatrix;
use plumbline::postmortem::replay::{ReplayError, ReplayInputs, ReplayResult, replay};
use plumbline::recording::Recording;
use plumbline::recording::about::{
    About, FORMAT, LogClock, Reason, ReasonKind, RecordedModel, RecordedOrder, Series, Settings, panic_message,
    panicked,
};
use plumbline::recording::history::{History, Window};
use plumbline_core::{Fault, FeedForward, JointVec, MAX_JOINTS, Phase, Record, Setpoint, Sink};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_rt::cycle::End;
use plumbline_rt::{Event, Handles, Order, OrderKind, StopReason};
use plumbline_testkit::fake_arm::drive::{Job, Model, READY, Run, settings};
use plumbline_testkit::fake_arm::{Disturbance, FakeArm};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

const AWAY: JointVec = [0.3, -0.5, -0.2, -2.0, 0.4, 1.3, 0.5, 0.0];
const JOINTS: usize = 7;

/// A point-to-point order in serialisable form.
fn move_to(motion: u32, target: JointVec) -> RecordedOrder {
    RecordedOrder::Move { motion, target, phase: Phase::Approach as u32 }
}

fn follow(motion: u32, at: JointVec, periods: u32) -> RecordedOrder {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(motion));
    let mut draw = || DMatrix::from_fn(JOINTS, 4, |_, _| rng.random_range(-0.03..0.03));
    let mut fourier = Fourier::new(2.0, at[..JOINTS].to_vec(), draw(), draw()).unwrap();
    fourier.project();
    let rows = |of: &DMatrix<f64>| of.row_iter().map(|row| row.iter().copied().collect()).collect();
    let (a, b) = (rows(&fourier.a), rows(&fourier.b));
    RecordedOrder::Follow { motion, series: Series { period: 2.0, periods, q0: fourier.q0.clone(), a, b } }
}

fn order(order_data: &RecordedOrder) -> Order {
    match order_data {
        RecordedOrder::Move { motion, target, .. } => {
            Order { motion: *motion, kind: OrderKind::MoveTo { target: *target, phase: Phase::Approach } }
        }
        RecordedOrder::Dwell { motion, ticks } => Order { motion: *motion, kind: OrderKind::Dwell { ticks: *ticks } },
        RecordedOrder::Follow { motion, series } => {
            let matrix = |rows: &Vec<Vec<f64>>| DMatrix::from_fn(rows.len(), rows[0].len(), |r, c| rows[r][c]);
            let fourier = Fourier::new(series.period, series.q0.clone(), matrix(&series.a), matrix(&series.b)).unwrap();
            let reference = PeriodicMotion::new(&fourier, series.periods).unwrap();
            Order { motion: *motion, kind: OrderKind::Follow(Box::new(reference)) }
        }
        RecordedOrder::Opaque { .. } => unreachable!("not used in these tests"),
    }
}

/// Test models: smooth, with a jump (66), not finite (others).
fn model(id: u64) -> Box<dyn FeedForward> {
    Box::new(Model(id, move |d: &Setpoint| match id {
        1..=9 => d.q.map(|q| (q * id as f64).sin() + 0.1 * id as f64),
        66 => d.q.map(|q| if q > 0.1 { 1e4 } else { q }),
        _ => [f64::NAN; MAX_JOINTS],
    }))
}

/// A run of the loop with all its inputs.
struct RecordedRun {
    run: Run,
    orders: Vec<RecordedOrder>,
    models: Vec<u64>,
}

type Action = fn(&mut Handles);

/// Runs a job with orders and models from the start, faults of the arm, and actions during the run. `later` lists the orders and
/// models of the actions.
fn run_loop(
    arm: FakeArm,
    quit: u64,
    orders: Vec<RecordedOrder>,
    models: Vec<u64>,
    later: (Vec<RecordedOrder>, Vec<u64>),
    actions: Vec<(u64, Action)>,
) -> RecordedRun {
    let mut job = Job::on(arm, quit);
    for order_data in &orders {
        job = job.order(order(order_data));
    }
    job.models = models.iter().map(|&id| model(id)).collect();
    for (read, act) in actions {
        job = job.outside(read, act);
    }
    RecordedRun { run: job.run(), orders: [orders, later.0].concat(), models: [models, later.1].concat() }
}

/// Metadata as the daemon writes them for a window.
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
        automatic_recovery: false,
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

/// The recording from cycle `first` on, as the daemon writes it; near the start, encoded and decoded.
fn recording(of: &RecordedRun, first: u64, lose: Option<u64>) -> Recording {
    let mut history = History::new(60_000, JOINTS, settings().guard.tracking);
    of.orders.iter().for_each(|order_data| history.push_order(order_data.clone()));
    of.models.iter().for_each(|&id| history.push_model(RecordedModel { id, gravity: [0.0, 0.0, -9.81], vendor: None }));
    // Events arrive before their records, as in the daemon.
    let mut events = of.run.timed.iter().peekable();
    for record in of.run.records.iter().filter(|record| Some(record.cycle) != lose) {
        while let Some(timed) = events.next_if(|timed| timed.cycle <= record.cycle + 3) {
            history.push_event(*timed);
        }
        history.push_records(&[*record]);
    }
    events.for_each(|timed| history.push_event(*timed));
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
    assert_same(&(&read.about, &read.events), &(&written.about, &written.events));
    for (a, b) in read.records.iter().zip(&written.records) {
        assert_same(&(a.state, a.command, a.tick), &(b.state, b.command, b.tick));
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

/// Equal, or equal as text: NaN is unequal to itself.
#[track_caller]
fn assert_same<T: PartialEq + std::fmt::Debug>(a: &T, b: &T) {
    if a != b {
        assert_eq!(format!("{a:?}"), format!("{b:?}"));
    }
}

fn replay_of(recording: &Recording) -> Result<ReplayResult, ReplayError> {
    let mut build = |handed: &RecordedModel| -> Result<Box<dyn FeedForward>, String> { Ok(model(handed.id)) };
    replay(recording, ReplayInputs { kinematics: None, model: &mut build })
}

/// Asserts identical replays from the start, from the first cycles and from places all over the run.
#[track_caller]
fn assert_replays_identically(of: &RecordedRun) {
    let cycles = of.run.records.len() as u64;
    let mut rng = ChaCha8Rng::seed_from_u64(cycles);
    let mut firsts = vec![0, 1, 3, cycles - 5];
    firsts.extend((0..4).map(|_| rng.random_range(0..cycles - 4)));
    // Around every event.
    firsts.extend(of.run.timed.iter().flat_map(|timed| [0, 1, 4].map(|back| (timed.cycle + 1).saturating_sub(back))));
    for first in firsts.into_iter().filter(|first| *first + 4 < cycles) {
        let recording = recording(of, first, None);
        let replayed = replay_of(&recording).unwrap_or_else(|error| panic!("from {first}: {error}"));
        assert!(replayed.is_identical(), "from {first}: {replayed:?}");
        let lead = if first == 0 { 0 } else { 3 };
        assert_eq!(replayed.compared, cycles - first - lead, "from {first}: {replayed:?}");
        let by_the_loop = !matches!(of.run.outcome.end, End::Fault(_));
        let expected = recording.unanswered.filter(|_| by_the_loop).map(|_| true);
        assert_eq!(replayed.same_end, expected, "from {first}: {replayed:?}");
    }
}

fn whole_job() -> Vec<RecordedOrder> {
    vec![
        move_to(1, AWAY),
        RecordedOrder::Dwell { motion: 1, ticks: 120 },
        follow(2, AWAY, 2),
        RecordedOrder::Dwell { motion: 3, ticks: 40 },
        move_to(4, READY),
    ]
}

fn no_inputs() -> (Vec<RecordedOrder>, Vec<u64>) {
    (Vec::new(), Vec::new())
}
