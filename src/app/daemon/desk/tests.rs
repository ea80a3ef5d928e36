use super::*;
use crate::ipc::Ticket;
use crate::joint::Phase;
use crate::model::term::Sample;
use std::time::{Duration, Instant};

const JOB: &str = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\npace = \"wall-clock\"\n\
    [recorder]\nspan = \"0 s\"\n";
const MODEL: &str = include_str!("../../../../config/models/panda-paper-table3.toml");

/// A desk and the folder that its files are in.
fn desk() -> (Desk, tempfile::TempDir) {
    let place = tempfile::tempdir().unwrap();
    let file = place.path().join("job.toml");
    std::fs::write(&file, JOB).unwrap();
    let job = Job::load(&file, &[]).unwrap();
    let robot = Robot::load(&job.robot, None).unwrap();
    let id = crate::ipc::RobotId::parse("test", "robot", "panda").unwrap();
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
    assert!(controls.take_stop() && desk.barred);
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
        assert_eq!(checker.room(now), 0, "a flood of models waits");
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
