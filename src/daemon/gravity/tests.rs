use super::*;
use crate::store::ModelFile;
use plumbline_core::JointVec;
use plumbline_ipc::now_ns;
use plumbline_model::Robot;
use plumbline_model::term::Sample;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use std::os::fd::OwnedFd;
use std::path::Path;

const JOB: &str = "robot = \"panda\"\nmounting = \"upright\"\n[backend]\nkind = \"sim\"\narm = \"sim-panda\"\npace = \"wall-clock\"\n";
/// Stretched straight up: the torques say next to nothing of gravity.
const STRAIGHT: JointVec = [0.0, 0.0, 0.0, -0.07, 0.0, 0.0, 0.0, 0.0];
const READY: JointVec = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785, 0.0];

/// The Panda's model from the paper, with noise in which a straight arm is blind.
fn accepted() -> Accepted {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/config/models/panda-paper-table3.toml");
    let text = std::fs::read_to_string(path).unwrap();
    let chain = |_: &str| Ok(Robot::load("panda", None).unwrap().chain);
    Accepted { id: 1, model: ModelFile::parse(path, &text, chain).unwrap().model, text, noise: vec![20.0; 7] }
}

/// Decides, and takes the decision over.
fn verdict(monitor: &mut GravityMonitor, model: &Accepted) -> Verdict {
    let decision = monitor.decide(model);
    monitor.apply(&decision);
    decision.verdict
}

fn rest(monitor: &mut GravityMonitor, model: &Accepted, mounting: &Mounting, q: JointVec) {
    let tau = model.model.evaluator(&mounting.gravity()).torque(&Sample { q, ..Sample::default() }).0;
    let mut record = Record { phase: Phase::Hold, ..Record::default() };
    (record.state.q, record.state.tau, record.command.desired.q) = (q, tau, q);
    monitor.take(&vec![record; 400]);
}

#[test]
fn undetermined_torques_end_the_wait_but_not_the_check() {
    let job = Job::parse(Path::new("job.toml"), JOB, &[]).unwrap();
    let (mut monitor, model) = (GravityMonitor::open(&job).unwrap(), accepted());
    assert!(matches!(verdict(&mut monitor, &model), Verdict::Wait));
    rest(&mut monitor, &model, &Mounting::UPRIGHT, STRAIGHT);
    assert!(matches!(verdict(&mut monitor, &model), Verdict::Serve(_)), "{:?}", monitor.refused());
    // An arm that hangs on a wall, as its next poses tell.
    for k in 0..8 {
        let mut q = READY;
        q[0] += 0.1 * f64::from(k);
        rest(&mut monitor, &model, &Mounting::WALL, q);
    }
    let last = verdict(&mut monitor, &model);
    assert!(matches!(&last, Verdict::Refuse(why) if why.to_string().contains("torques at rest")), "{last:?}");
}

/// A socket that stands for a bus on which nobody answers.
fn silent_bus(path: &Path) -> OwnedFd {
    let socket =
        rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap();
    rustix::net::bind(&socket, &SocketAddrUnix::new(path).unwrap()).unwrap();
    rustix::net::listen(&socket, 4).unwrap();
    socket
}

#[test]
fn an_inclinometer_that_is_not_up_yet_decides_as_one_that_is_lost() {
    let place = tempfile::tempdir().unwrap();
    for (on_loss, is_served) in [("refuse", false), ("hold", true), ("declared", true)] {
        let path = place.path().join(on_loss);
        let _bus = silent_bus(&path);
        let more = format!(
            "[validation]\nmountings = [\"upright\"]\n[mounting-check]\ntorques = false\n[inclinometer]\n\
             interface = \"simulated:{}\"\nnode = 10\nx = \"x\"\nz = \"z\"\non-loss = \"{on_loss}\"\n",
            path.display()
        );
        let job = Job::parse(Path::new("job.toml"), &format!("{JOB}{more}"), &[]).unwrap();
        let (mut monitor, model) = (GravityMonitor::open(&job).unwrap(), accepted());
        // Before the daemon has looked at it for the first time, and after that.
        for _ in 0..2 {
            match verdict(&mut monitor, &model) {
                Verdict::Serve(gravity) => assert!(is_served && gravity == Mounting::UPRIGHT.gravity(), "{gravity}"),
                Verdict::Refuse(why) => {
                    assert!(!is_served && why.to_string().contains("inclinometer.on-loss = \"refuse\""), "{why}")
                }
                Verdict::Wait => panic!("waits"),
            }
            assert_eq!(monitor.refusal().is_some(), !is_served);
            monitor.poll(now_ns(), false);
        }
    }
}

#[test]
fn a_vertical_model_is_refused_where_the_arm_compensates_another_gravity_than_along_axis_1() {
    let job: Job = toml::from_str(JOB).unwrap();
    let robot = Robot::load("panda", None).unwrap();
    let reduction = plumbline_model::Reduction::of_kind(&robot.chain, plumbline_model::BaseKind::Vbs);
    let structure = plumbline_model::Structure::of(robot.chain, reduction, &["rigid-body"]).unwrap();
    let values = vec![(0.5, None); structure.columns().len()];
    let model = plumbline_model::TorqueModel::new("panda", structure, vec![Mounting::UPRIGHT], &values).unwrap();
    let model = Accepted { id: 1, model, text: String::new(), noise: vec![20.0; 7] };
    let mut monitor = GravityMonitor::open(&job).unwrap();
    for (vendor, served) in [(Mounting::UPRIGHT, true), (Mounting::CEILING, true), (Mounting::WALL, false)] {
        monitor.connect(Mounting::UPRIGHT, None, vendor.gravity(), false);
        match verdict(&mut monitor, &model) {
            Verdict::Refuse(why) => {
                assert!(
                    !served && why.to_string().contains("VBS") && why.to_string().contains("not in the mounting wall"),
                    "{why}"
                )
            }
            other => assert!(served, "{other:?}"),
        }
    }
}
