use super::super::logged::logged;
use super::*;
use plumbline_core::{Backend, Command, Fault, LoopStatistics, MAX_JOINTS, Phase, State};
use plumbline_ipc::Ticket;
use plumbline_model::term::Sample;

use plumbline_rt::cycle::Cycle;
use plumbline_rt::os::Rights;
use plumbline_rt::recorder::{RingSink, ring};
use plumbline_rt::{CycleSettings, GuardSettings, Handles, Limit, Succession, Violation};
use std::sync::Arc;
use std::time::{Duration, Instant};

const JOB: &str = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\npace = \"wall-clock\"\n\
    [recorder]\nspan = \"0 s\"\n";
const MODEL: &str = include_str!("../../../config/models/panda-paper-table3.toml");

/// A desk and the folder that its files are in.
fn desk() -> (Desk, tempfile::TempDir) {
    desk_of(JOB)
}

fn desk_of(job: &str) -> (Desk, tempfile::TempDir) {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("job.toml");
    std::fs::write(&file, job).unwrap();
    let job = Job::load(&file, &[]).unwrap();
    let robot = Robot::load(&job.robot, None).unwrap();
    let id = plumbline_ipc::RobotId::parse("test", "robot", "panda").unwrap();
    let recorder = Recorder::start(&job, &id, place.path()).unwrap();
    (Desk::new(job, robot, Vec::new(), recorder, Ending::default()).unwrap(), place)
}

fn ask(desk: &mut Desk, request: Request) -> Response {
    desk.answer(request, &Served::default(), None)
}

fn offer() -> Request {
    Request::OfferModel { toml: MODEL.to_string() }
}

#[track_caller]
fn refusal(answer: Response) -> String {
    let Response::Refused { reason } = answer else { panic!("{answer:?}") };
    reason
}

/// The arm rests as it does in `mounting`.
fn rest(desk: &mut Desk, mounting: &Mounting) {
    let model = check(&desk.robot, &desk.mounting, "test", MODEL).unwrap().model;
    for k in 0..8 {
        let q = [0.1 * f64::from(k), -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
        let tau = model.evaluator(&mounting.gravity()).torque(&Sample { q, ..Sample::default() }).0;
        let mut record = Record { phase: Phase::Hold, ..Record::default() };
        (record.state.q, record.state.tau, record.command.desired.q) = (q, tau, q);
        desk.gravity.take(&vec![record; 400]);
    }
}

#[test]
fn a_stop_bars_every_motion_until_an_operator_lifts_it() {
    for by_its_own_way in [true, false] {
        let (mut desk, _place) = desk();
        assert_eq!(ask(&mut desk, Request::Start {}), Response::Accepted {});
        match by_its_own_way {
            true => desk.take_stop(StopOrder { process: 7, user: 8 }, None),
            false => assert_eq!(ask(&mut desk, Request::Stop {}), Response::Accepted {}),
        }
        // The start that was given before it is gone, too.
        assert!(desk.barred && !desk.start && desk.is_over() && !desk.must_leave());
        let reason = refusal(ask(&mut desk, Request::Start {}));
        assert!(reason.contains("plumbline command resume"), "{reason}");
        assert_eq!(ask(&mut desk, Request::Resume {}), Response::Accepted {});
        assert_eq!(ask(&mut desk, Request::Start {}), Response::Accepted {});
    }
}

#[test]
fn a_stop_between_two_connections_ends_the_programme() {
    let (mut desk, _place) = desk();
    desk.progress = Progress::Driving;
    desk.stop(None);
    assert_eq!((desk.progress, desk.is_over()), (Progress::Stopped, true));
    // With a loop, the loop is told.
    let (mut desk, _place) = self::desk();
    desk.progress = Progress::Driving;
    let controls = Controls::default();
    desk.stop(Some(&controls));
    assert!(controls.stop_requested() && desk.barred);
}

#[test]
fn a_model_that_a_loop_distrusted_is_handed_to_no_other() {
    let (mut desk, _place) = desk();
    assert!(!desk.may_hand_over(&Mounting::UPRIGHT), "there is none");
    let Response::ModelAccepted { model } = ask(&mut desk, offer()) else { panic!() };
    assert!(desk.may_hand_over(&Mounting::UPRIGHT));
    desk.log(&Event::Distrusted { model: model ^ 1, instead: 0 });
    assert!(desk.may_hand_over(&Mounting::UPRIGHT), "another one was");
    desk.log(&Event::Distrusted { model, instead: 0 });
    assert!(!desk.may_hand_over(&Mounting::UPRIGHT));
    assert_eq!(desk.status(&Served::default(), None).model, 0);
    // An operator or the estimator who offers it again takes it upon himself.
    assert_eq!(ask(&mut desk, offer()), Response::ModelAccepted { model });
    assert!(desk.may_hand_over(&Mounting::UPRIGHT));
}

#[test]
fn a_model_is_held_against_the_torques_at_rest_before_it_is_served() {
    let (mut desk, _place) = desk();
    // Declared upright; the arm hangs on a wall.
    desk.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    rest(&mut desk, &Mounting::WALL);
    let reason = refusal(ask(&mut desk, offer()));
    assert!(reason.contains("torques at rest"), "{reason}");
    assert!(desk.model.is_none());

    desk.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    rest(&mut desk, &Mounting::UPRIGHT);
    assert!(matches!(ask(&mut desk, offer()), Response::ModelAccepted { .. }));
}

#[test]
fn a_model_that_does_not_hold_any_more_when_its_check_is_done_is_refused() {
    let (mut desk, _place) = desk();
    let request = Request::OfferModel { toml: MODEL.replace("robot = \"panda\"", "robot = \"ur10\"") };
    let reason = refusal(ask(&mut desk, request));
    assert!(reason.contains("ur10") && reason.contains("panda"), "{reason}");
    let Checked::Offered(model) = Checked::of(&desk.robot, &desk.mounting, offer()) else { panic!() };
    assert!(desk.admit("offered model", &model).is_ok());
}

/// A request of many bytes is read on the other thread, which answers it whatever it is.
#[test]
fn the_checking_thread_takes_one_request_at_a_time() {
    use super::super::check::{Answerable, Checker};
    let (desk, _place) = desk();
    let (robot, mounting) = (desk.robot.clone(), desk.mounting);
    let mut checker = Checker::start(robot, 5).unwrap();
    let bytes = |request: &Request| serde_json::to_vec(request).unwrap();
    let mut now = 1;
    let mut check = |bytes: &[u8]| {
        assert_eq!(checker.room(now), 1);
        checker.give(Ticket::default(), bytes, mounting, now);
        assert_eq!(checker.room(u64::MAX), 0, "it is busy");
        let start = Instant::now();
        let checked = loop {
            match checker.take() {
                Some(Answerable { checked, .. }) => break checked,
                None => assert!(start.elapsed() < Duration::from_secs(60)),
            }
            std::thread::sleep(Duration::from_millis(1));
        };
        assert_eq!(checker.room(now + 99_999_999), 0, "a flood of models waits");
        assert_eq!(checker.room(now + 100_000_000), 1);
        now += 1_000_000_000;
        checked
    };
    assert!(matches!(check(&bytes(&offer())), Checked::Offered(_)));
    assert!(matches!(check(&bytes(&Request::Status {})), Checked::Other(Request::Status {})));
    assert!(matches!(check(&[b'['; 60_000]), Checked::Garbled(_)));
    let nonsense = Request::OfferModel { toml: "x".into() };
    assert!(matches!(check(&bytes(&nonsense)), Checked::Refused(_)));
    let other_start = br#"{"epoch":6,"request":"status"}"#;
    assert!(matches!(check(other_start), Checked::Garbled(Response::Refused { reason }) if reason.contains("start 5")));
}

/// An arm that is at once where it is told to be, loses two states before its third, and is gone after its fifth.
struct ShortLived(State);

impl Backend for ShortLived {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        self.0.seq += match self.0.seq {
            2 => 3,
            7 => return Err(Fault::Disconnected),
            _ => 1,
        };
        // Late by two periods, every time.
        std::thread::sleep(Duration::from_millis(12));
        Ok(self.0)
    }

    fn write(&mut self, _: &Command) -> Result<(), Fault> {
        Ok(())
    }

    fn stop(&mut self) {}
}

/// A loop and its outside end. It has room for two records.
fn real_time_loop(limits: plumbline_core::Limits) -> (Cycle<ShortLived, RingSink>, Handles) {
    let guard = GuardSettings { limits, envelope: None, workspace: None, tracking: [0.1; MAX_JOINTS] };
    let settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
    let q = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
    let arm = ShortLived(State { q, q_d: q, ..State::default() });
    plumbline_rt::cycle::new(arm, ring(2).0, None, settings).unwrap()
}

/// Controls of a loop whose arm rests after a stop and waits for a permission.
fn waiting(desk: &Desk) -> Arc<Controls> {
    let (mut cycle, handles) = real_time_loop(desk.robot.limits);
    let doing = plumbline_rt::Doing::Stopped;
    cycle
        .restore(plumbline_rt::Checkpoint { doing, last: [Record::default(); 3], models: Succession::default() })
        .unwrap();
    assert!(handles.controls.is_waiting());
    Arc::clone(&handles.controls)
}

/// A text of a model that holds where axis 1 is vertical alone: the same parameters but two.
fn vertical() -> String {
    let lacks = |line: &&str| !line.contains("name = \"lx1\"") && !line.contains("name = \"ly1\"");
    let lines: Vec<&str> = MODEL.lines().filter(lacks).collect();
    lines.join("\n").replace("kind = \"GBS\"", "kind = \"VBS\"").replace("rho = 1.57", "rho = 0.0 # 1.57")
}

/// A text of the same model that has another identity.
fn another(number: u32) -> String {
    format!("{MODEL}\n# {number}\n")
}

fn offered(desk: &mut Desk, toml: String) -> u64 {
    match ask(desk, Request::OfferModel { toml }) {
        Response::ModelAccepted { model } => model,
        other => panic!("{other:?}"),
    }
}

fn proposed(desk: &mut Desk, toml: String) -> Response {
    let proposal = Proposal { what: "payload".into(), ..Proposal::default() };
    ask(desk, Request::ProposeModel { toml, proposal })
}

#[test]
fn a_programme_is_started_once_and_a_request_to_quit_ends_the_daemon() {
    let (mut desk, _place) = desk();
    assert!(!desk.must_quit() && !desk.is_over() && !desk.must_leave());
    assert_eq!(ask(&mut desk, Request::Start {}), Response::Accepted {});
    assert!(desk.start && desk.must_leave() && !desk.must_quit() && !desk.is_over());
    for progress in [Progress::Driving, Progress::AwaitingModel, Progress::Done, Progress::Stopped] {
        desk.progress = progress;
        let reason = refusal(ask(&mut desk, Request::Start {}));
        assert!(reason.contains("started before"), "{reason}");
        assert!(!desk.must_leave(), "the connection of the programme goes on");
        assert_eq!(desk.is_over(), progress == Progress::Stopped);
    }
    desk.progress = Progress::Driving;
    assert_eq!(ask(&mut desk, Request::Quit {}), Response::Accepted {});
    assert!(desk.must_quit() && desk.is_over() && desk.must_leave());
    assert_eq!(desk.cause, None);
}

#[test]
fn the_first_reason_to_end_is_that_of_the_stop_and_each_is_logged_once() {
    let (mut desk, _place) = desk();
    assert_eq!(logged(|| desk.announce_end()), "");
    desk.ending.arrive(Cause::Signal(libc::SIGTERM));
    let first = logged(|| desk.announce_end());
    assert!(first.contains("SIGTERM") && first.contains("brakes an arm that moves"), "{first}");
    assert!(desk.must_quit() && desk.must_leave() && desk.is_over());
    assert_eq!(desk.cause.as_deref(), Some("signal SIGTERM arrived"));
    assert_eq!(logged(|| desk.announce_end()), "");
    desk.ending.arrive(Cause::Signal(libc::SIGINT));
    let second = logged(|| desk.announce_end());
    assert!(second.contains("SIGINT") && second.contains("is ending already"), "{second}");
    assert_eq!(desk.cause.as_deref(), Some("signal SIGTERM arrived"), "the stop under way is that of the first");
    assert_eq!(logged(|| desk.announce_end()), "");

    // `plumbline run` asks for the end first and then closes the pipe: no reason to tell.
    for asked in [true, false] {
        let (mut desk, _place) = self::desk();
        desk.quit = asked;
        desk.ending.arrive(Cause::ParentEnded);
        assert_eq!(logged(|| desk.announce_end()).is_empty(), asked);
        assert_eq!(desk.cause.is_none(), asked);
    }
    let (mut desk, _place) = self::desk();
    desk.quit = true;
    desk.ending.arrive(Cause::Signal(libc::SIGTERM));
    assert!(logged(|| desk.announce_end()).contains("SIGTERM"));
}

#[test]
fn a_permission_lifts_a_stop_where_the_arm_rests_and_not_while_it_brakes() {
    let (mut desk, _place) = desk();
    let controls = waiting(&desk);
    let resume =
        |desk: &mut Desk, controls: &Controls| desk.answer(Request::Resume {}, &Served::default(), Some(controls));
    desk.barred = true;
    assert_eq!(resume(&mut desk, &controls), Response::Accepted {});
    assert!(!desk.barred && !controls.is_waiting());
    let reason = refusal(resume(&mut desk, &controls));
    assert!(reason.contains("nothing waits"), "{reason}");
    let reason = refusal(ask(&mut desk, Request::Resume {}));
    assert!(reason.contains("nothing waits"), "{reason}");

    // A stop that the loop has not begun, and one that it has not ended.
    let running = Controls::default();
    desk.stop(Some(&running));
    let reason = refusal(resume(&mut desk, &running));
    assert!(reason.contains("being braked") && desk.barred, "{reason}");
    desk.log(&Event::Stopped);
    assert!(desk.barred && !desk.braking);
    desk.log(&Event::Stopping { motion: 1, reason: StopReason::Requested });
    assert!(desk.barred && desk.braking);
    desk.log(&Event::Started { motion: 2 });
    assert!(desk.braking, "only the rest ends a stop");
    desk.cause = Some("asked for twice".into());
    desk.log(&Event::Resumed);
    assert_eq!((desk.barred, desk.braking, desk.cause.take()), (false, false, None));
}

#[test]
fn a_stop_is_recorded_with_the_daemons_own_reason_where_it_asked_for_it() {
    let stops: [fn(&mut Desk, &Controls); 2] = [
        |desk, controls| desk.stop_for_mounting("the base has turned".into(), controls),
        |desk, controls| desk.stop_without_model("no model came".into(), controls),
    ];
    for (stop, why) in stops.into_iter().zip(["the base has turned", "no model came"]) {
        let (mut desk, _place) = desk();
        let controls = Controls::default();
        stop(&mut desk, &controls);
        assert!(controls.stop_requested() && desk.barred && desk.braking);
        desk.log(&Event::Stopping { motion: 1, reason: StopReason::Requested });
        assert_eq!(desk.stopped.as_deref(), Some(why));
        // The next one has another reason.
        desk.log(&Event::Stopping { motion: 1, reason: StopReason::Requested });
        assert_eq!(desk.stopped, Some(StopReason::Requested.to_string()));
        // A stop of the guard has its own, whatever the daemon was about to ask for.
        desk.cause = Some(why.into());
        let violation = Violation { limit: Limit::Tracking, joint: 2, value: 0.2, bound: 0.1 };
        desk.log(&Event::Stopping { motion: 1, reason: StopReason::Guard(violation) });
        assert_eq!(desk.stopped, Some(StopReason::Guard(violation).to_string()));
    }
}

#[test]
fn a_stop_without_a_loop_ends_a_programme_that_was_begun_and_no_other() {
    for (progress, after) in [
        (Progress::Idle, Progress::Idle),
        (Progress::Driving, Progress::Stopped),
        (Progress::AwaitingModel, Progress::Stopped),
        (Progress::Done, Progress::Done),
    ] {
        let (mut desk, _place) = desk();
        (desk.progress, desk.start) = (progress, true);
        desk.stop(None);
        assert_eq!((desk.progress, desk.barred, desk.braking), (after, true, false));
        assert_eq!(desk.start, progress != Progress::Idle);
    }
}

#[test]
fn the_log_names_motions_and_says_whether_the_programme_goes_on() {
    let (mut desk, _place) = desk();
    desk.names = vec![(1, "approach".into()), (2, "excitation".into())];
    let said = logged(|| desk.log(&Event::Started { motion: 2 }));
    assert!(said.contains("excitation has started") && !said.contains("approach"), "{said}");
    let said = logged(|| desk.log(&Event::Ended { motion: 1 }));
    assert!(said.contains("approach has ended") && !said.contains("excitation"), "{said}");
    let said = logged(|| desk.log(&Event::Stopped));
    assert!(said.contains("plumbline command resume"), "{said}");
    desk.progress = Progress::Stopped;
    let said = logged(|| desk.log(&Event::Stopped));
    assert!(said.contains("plumbline command start") && !said.contains("resume"), "{said}");
}

#[test]
fn a_recording_on_demand_needs_a_loop() {
    let (mut desk, _place) = desk();
    let reason = refusal(ask(&mut desk, Request::Record {}));
    assert!(reason.contains("not connected"), "{reason}");
    let reason = refusal(desk.answer(Request::Record {}, &Served::default(), Some(&Controls::default())));
    assert!(reason.contains("recorder.span"), "{reason}");
}

#[test]
fn every_sixteenth_cycle_of_the_last_second_is_kept() {
    let mut recent = Recent::default();
    let records: Vec<Record> = (0..3000).map(|cycle| Record { cycle, ..Record::default() }).collect();
    records.chunks(100).for_each(|some| recent.take(some));
    let kept: Vec<u64> = recent.0.iter().map(|record| record.cycle).collect();
    assert_eq!(kept, (0..64).map(|k| 2992 - 16 * (63 - k)).collect::<Vec<u64>>());
    recent.clear();
    assert!(recent.0.is_empty());
}

#[test]
fn a_model_that_lacks_parameters_of_the_mounting_is_neither_offered_nor_handed_over() {
    let (mut desk, _place) = desk();
    let file = std::path::Path::new("vertical.toml");
    let model = desk.accept_text(file, &vertical()).unwrap();
    assert_eq!(desk.model.as_ref().map(|served| served.id), Some(model));
    assert!(desk.may_hand_over(&Mounting::UPRIGHT) && !desk.may_hand_over(&Mounting::WALL));
    // Checked upright; the arm hangs on a wall when it is to be served.
    let upright = Mounting::UPRIGHT;
    let Checked::Offered(checked) = Checked::of(&desk.robot, &upright, Request::OfferModel { toml: vertical() }) else {
        panic!()
    };
    desk.mounting = Mounting::WALL;
    let reason = refusal(desk.conclude(Checked::Offered(checked), &Served::default(), None));
    assert!(reason.contains("holds in the present mounting"), "{reason}");
    let Checked::Refused(response) = Checked::of(&desk.robot, &desk.mounting, Request::OfferModel { toml: vertical() })
    else {
        panic!()
    };
    assert!(refusal(response).contains("holds in the present mounting"));
    // One that was held while the arm stood upright, too; it stays held.
    (desk.mounting, desk.model) = (upright, None);
    assert!(matches!(proposed(&mut desk, vertical()), Response::ModelHeld { .. }));
    desk.mounting = Mounting::WALL;
    for _ in 0..2 {
        let reason = refusal(ask(&mut desk, Request::Adopt {}));
        assert!(reason.contains("wall"), "{reason}");
        assert!(desk.model.is_none());
    }
    desk.mounting = upright;
    assert_eq!(ask(&mut desk, Request::Adopt {}), Response::ModelAccepted { model });
}

#[test]
fn a_proposed_model_is_served_when_a_person_adopts_it_or_the_job_says_so() {
    let (mut desk, _place) = desk();
    let first = offered(&mut desk, another(1));
    let Response::ModelHeld { model: second } = proposed(&mut desk, another(2)) else { panic!() };
    let status = desk.status(&Served::default(), None);
    assert_eq!((status.model, status.offered.map(|held| held.model)), (first, Some(second)));
    assert_eq!(ask(&mut desk, Request::Reject {}), Response::Accepted {});
    assert!(refusal(ask(&mut desk, Request::Adopt {})).contains("no model was proposed"));
    assert!(refusal(ask(&mut desk, Request::Reject {})).contains("no model was proposed"));
    proposed(&mut desk, another(2));
    assert_eq!(ask(&mut desk, Request::Adopt {}), Response::ModelAccepted { model: second });
    assert_eq!(desk.model.as_ref().map(|served| served.id), Some(second));
    // An offered model takes the place of the served one: what was proposed in place of that is no proposal any more.
    proposed(&mut desk, another(3));
    offered(&mut desk, another(4));
    assert!(desk.held.is_none());
    proposed(&mut desk, another(3));
    desk.job.live.adopt = Adopt::Auto;
    let Response::ModelAccepted { model } = proposed(&mut desk, another(5)) else { panic!() };
    assert_eq!(desk.model.as_ref().map(|served| served.id), Some(model));
    assert!(desk.held.is_none());
}

#[test]
fn the_model_served_before_is_in_reserve_unless_a_loop_has_distrusted_it() {
    let of = |accepted: &Option<Accepted>| accepted.as_ref().map(|accepted| accepted.id);
    let (mut desk, _place) = desk();
    let [first, second, third] = [1, 2, 3].map(|number| offered(&mut desk, another(number)));
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(third), Some(second)));
    // The same model again is no change.
    offered(&mut desk, another(3));
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(third), Some(second)));
    // Falls back to the reserve.
    desk.log(&Event::Distrusted { model: third, instead: second });
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(second), None));
    assert!(desk.may_hand_over(&Mounting::UPRIGHT), "another one was distrusted");
    // The one that follows a distrusted one has none behind it.
    desk.log(&Event::Distrusted { model: second, instead: 0 });
    offered(&mut desk, another(1));
    assert_eq!((of(&desk.model), of(&desk.reserve), desk.distrusted), (Some(first), None, None));

    // The reserve itself is distrusted, or both: neither is fallen back to.
    offered(&mut desk, another(2));
    assert_eq!(of(&desk.reserve), Some(first));
    desk.log(&Event::Distrusted { model: first, instead: 0 });
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(second), None));
    offered(&mut desk, another(1));
    assert_eq!(of(&desk.reserve), Some(second));
    // A loop that has fallen back to a model of an older daemon's keeps what this one serves.
    desk.log(&Event::Distrusted { model: first, instead: 99 });
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(first), Some(second)));
    // A loop that still asked an older model fell back to the reserve: the served one stays, the reserve is in use.
    desk.log(&Event::Distrusted { model: 98, instead: second });
    assert_eq!((of(&desk.model), of(&desk.reserve)), (Some(first), None));
}

#[test]
fn the_programme_goes_on_when_the_model_that_it_waits_for_is_there() {
    for (progress, after) in [
        (Progress::AwaitingModel, Progress::Driving),
        (Progress::Done, Progress::Done),
        (Progress::Idle, Progress::Idle),
    ] {
        let (mut desk, _place) = desk();
        desk.progress = progress;
        offered(&mut desk, MODEL.into());
        assert_eq!(desk.progress, after);
    }
}

#[test]
fn what_the_arm_measured_last_refuses_a_model_unless_the_trusted_one_is_as_wrong() {
    // 12 Nm in joint 2 that no model explains.
    let measured = |desk: &mut Desk| {
        let model = check(&desk.robot, &desk.mounting, "test", MODEL).unwrap().model;
        let q = [0.1, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];
        let mut record = Record::default();
        record.state.q = q;
        record.state.tau = model.evaluator(&desk.mounting.gravity()).torque(&Sample { q, ..Sample::default() }).0;
        record.state.tau[1] += 12.0;
        desk.recent.take(&[record]);
    };
    let (mut desk, _place) = desk();
    measured(&mut desk);
    assert!(refusal(ask(&mut desk, offer())).contains("joint 2"));
    assert!(refusal(proposed(&mut desk, another(1))).contains("joint 2"));
    desk.recent.clear();
    let model = offered(&mut desk, MODEL.into());
    measured(&mut desk);
    // Another one is no worse than the served one.
    let second = offered(&mut desk, another(1));
    assert_ne!(model, second);
    desk.log(&Event::Distrusted { model: second, instead: 0 });
    assert!(refusal(ask(&mut desk, Request::OfferModel { toml: another(2) })).contains("joint 2"));
}

#[test]
fn the_loss_of_the_estimator_stops_an_arm_that_moves_where_the_job_says_so() {
    let (name, pid, acknowledged) = ("estimator".to_string(), 7, 5);
    let died = News::Died { name: name.clone(), pid, acknowledged };
    let left = News::Left { name: name.clone(), pid, acknowledged };
    let silent = News::Silent { name: name.clone(), pid, acknowledged, silent_ms: 9 };
    let joined = News::Joined { name, pid, from: 0 };
    let fast = JOB.replace("wall-clock", "fast");
    for (job, watch, waited_for) in
        [(JOB, true, false), (&fast, true, true), (&fast, false, false), (JOB, false, false)]
    {
        for (news, lost) in [(&died, true), (&left, true), (&silent, !waited_for), (&joined, false)] {
            for rule in [OnEstimatorLoss::Stop, OnEstimatorLoss::Finish] {
                for progress in [Progress::Driving, Progress::AwaitingModel, Progress::Idle] {
                    let (mut desk, _place) = desk_of(job);
                    (desk.job.live.watch, desk.job.safety.on_estimator_loss, desk.progress) = (watch, rule, progress);
                    let controls = Controls::default();
                    let said = logged(|| desk.news(news, Some(&controls)));
                    let stops = lost && rule == OnEstimatorLoss::Stop && progress == Progress::Driving;
                    assert_eq!(
                        (controls.stop_requested(), desk.barred),
                        (stops, stops),
                        "{news}, {rule:?}, {progress:?}"
                    );
                    assert_eq!(said.contains("the arm stops"), stops, "{said}");
                    let goes_on = progress == Progress::Driving && !stops && !matches!(news, News::Joined { .. });
                    assert_eq!(said.contains("the arm goes on"), goes_on, "{said}");
                    let waits = progress == Progress::AwaitingModel && matches!(news, News::Died { .. });
                    assert_eq!(said.contains("the arm waits for a model"), waits, "{said}");
                }
            }
        }
    }
}

#[test]
fn the_status_sums_up_every_connection_and_the_running_loop() {
    let (mut desk, _place) = desk();
    desk.names = vec![(1, "approach".into()), (2, "excitation".into())];
    desk.last.motion = 2;
    let model = offered(&mut desk, MODEL.into());
    let session = SessionStatistics {
        statistics: LoopStatistics {
            cycles: 1000,
            lost: 100,
            late: Some(10),
            dropped_records: 20,
            ..Default::default()
        },
        ..Default::default()
    };
    desk.sessions = vec![session; 2];
    let (mut cycle, handles) = real_time_loop(desk.robot.limits);
    let outcome = cycle.run();
    let controls = &handles.controls;
    let running = [controls.cycles(), controls.lost(), controls.late(), controls.dropped_records()];
    assert_eq!((running[0], running[1], running[3]), (5, 2, 3), "{:?}", outcome.end);
    assert!(running[2] > 0);
    for (controls, more) in [(None, [0; 4]), (Some(&**controls), running)] {
        let status = desk.status(&Served::default(), controls);
        let counts = [status.cycles, status.lost, status.late, status.dropped_records];
        assert_eq!(counts, [2000 + more[0], 200 + more[1], 20 + more[2], 40 + more[3]]);
        assert_eq!((status.joints, status.model, status.motion), (7, model, 2));
        assert!(status.job.ends_with(": excitation"), "{}", status.job);
    }
    desk.last.motion = 3;
    assert_eq!(desk.status(&Served::default(), None).job, "upright");
}

#[test]
fn the_flight_recorder_is_given_the_reason_of_every_stop_that_the_daemon_asks_for() {
    let (mut desk, _place) = desk();
    let mut remarks = desk.recorder.remarks();
    let controls = Controls::default();
    desk.stop_for_mounting("the base has turned".into(), &controls);
    assert_eq!(remarks(), ["mounting: the base has turned"]);
    desk.stop_without_model("no model came".into(), &controls);
    assert_eq!(remarks(), ["model-timeout: no model came"]);
    desk.ending.arrive(Cause::Signal(libc::SIGTERM));
    desk.announce_end();
    desk.announce_end();
    assert_eq!(remarks(), ["signal: signal SIGTERM arrived"]);
    let news = News::Left { name: "estimator".into(), pid: 7, acknowledged: 5 };
    for (rule, count) in [(OnEstimatorLoss::Stop, 2), (OnEstimatorLoss::Finish, 1)] {
        (desk.progress, desk.job.safety.on_estimator_loss) = (Progress::Driving, rule);
        desk.news(&news, Some(&controls));
        let found = remarks();
        assert!(found.len() == count && found[0].contains("estimator (process 7) left"), "{found:?}");
        assert!(found[1..].iter().all(|reason| reason.starts_with("estimator-lost: ")), "{found:?}");
    }
    // The torques at rest contradict the declared mounting.
    desk.gravity.connect(Mounting::UPRIGHT, None, Mounting::UPRIGHT.gravity(), false);
    let model = check(&desk.robot, &desk.mounting, "test", MODEL).unwrap();
    rest(&mut desk, &Mounting::WALL);
    desk.gravity.verdict(&model);
    assert!(remarks().is_empty());
    desk.note_gravity();
    desk.note_gravity();
    let found = remarks();
    assert!(found.len() == 1 && found[0].contains("is not served"), "{found:?}");
}
