//! The adapter against control units that other people wrote: franka-sim and franky-sim, both protocol version 10 with MuJoCo behind them.
//!
//! They are installed by pip on first use; without a package index the tests say that they were skipped, unless PLUMBLINE_REQUIRE_PEERS=1.
//! franka-sim checks every command as a robot does, so a motion that ends in order was inside every limit as somebody else reads
//! the documentation. It also gives up after 20 lost commands, as a robot does; both run on this machine's normal scheduler in Python, so a
//! stall is tried again a few times.

use plumbline::store::export::{Arm, mjcf};
use plumbline_franka::wire::{MoveStatus, Protocol};
use plumbline_franka::{RobotKind, Settings};
use plumbline_model::Mounting;
use plumbline_rt::cycle::End;
use plumbline_testkit::franka_loop::{Run, drive_with_retries, plan};
use plumbline_testkit::job::plumbline;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Two simulators at once are too much for a small machine.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

fn address(number: u8) -> String {
    format!("127.77.{}.{number}", std::process::id() % 250)
}

/// A server that ends with its test.
struct Server(Child, IpAddr);

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Server {
    /// Starts a server and waits until it listens.
    fn start(mut command: Command, address: &str, log: &str) -> Server {
        let file = std::fs::File::create(Path::new(env!("CARGO_TARGET_TMPDIR")).join(log)).unwrap();
        let child = command.stdout(file.try_clone().unwrap()).stderr(file).stdin(Stdio::null()).spawn().unwrap();
        let mut server = Server(child, address.parse().unwrap());
        let deadline = Instant::now() + Duration::from_secs(90);
        while TcpStream::connect_timeout(&SocketAddr::new(server.1, 1337), Duration::from_secs(1)).is_err() {
            let output =
                || std::fs::read_to_string(Path::new(env!("CARGO_TARGET_TMPDIR")).join(log)).unwrap_or_default();
            if let Some(status) = server.0.try_wait().unwrap() {
                panic!("the server ended with {status}: {}", output());
            }
            assert!(Instant::now() < deadline, "the server does not listen: {}", output());
            std::thread::sleep(Duration::from_millis(200));
        }
        // It takes that connection for a client: let it notice that it was none.
        std::thread::sleep(Duration::from_secs(1));
        server
    }
}

fn settings(server: &Server) -> Settings {
    // Servers in Python stand still for 100 ms now and then.
    let (connect_timeout, state_timeout) = (Duration::from_secs(5), Duration::from_secs(1));
    Settings { connect_timeout, state_timeout, ..Settings::new(server.1, RobotKind::Fr3) }
}

/// An FR3 by plumbline's own export; without meshes, with bodies that are nobody's.
fn fr3_mjcf() -> PathBuf {
    let robot = plumbline_testkit::bodies::robot("fr3");
    let model = plumbline_testkit::bodies::model(&robot, &["friction"], 5);
    let bodies = plumbline_testkit::bodies::bodies(&model);
    let arm = Arm { model: &model, bodies: &bodies, limits: &robot.limits, left_out: None };
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fci-servers-fr3.xml");
    std::fs::write(&path, mjcf::write(&arm, &Mounting::UPRIGHT.gravity()).text).unwrap();
    path
}

/// `soft` is how far the server's own controller may lag behind what it is told \[rad\].
fn assert_ended_in_order(run: &Run, who: &str, soft: f64) {
    let statistics = &run.statistics;
    eprintln!(
        "{who}: {} cycles, {} lost, {} passed over, {} late commands, success rate {:.3} to {:.3}; tracking {:?} rad; p50, p99, p99.9 and max in us: \
         execution {:.1?}, socket {:.1?}, round trip {:.1?} ({}), limited {}, returning {}, unexplained {}",
        run.outcome.summary.cycles,
        statistics.lost,
        statistics.skipped,
        statistics.late_commands,
        statistics.success_rate.min,
        statistics.success_rate.last,
        run.tracking().map(|rms| (rms * 1e5).round() / 1e5),
        statistics.work.in_us(),
        statistics.wake.in_us(),
        statistics.round_trip.in_us(),
        statistics.round_trip.count,
        statistics.limited,
        statistics.returning,
        statistics.unexplained_points,
    );
    assert!(run.ended && run.outcome.end == End::Quit, "{who}: {}", run.describe());
    assert_eq!(run.connection.info.protocol, Protocol::V10);
    assert!(run.connection.info.limits_from_arm);
    assert!(statistics.reflex().is_empty(), "{who}: {}", statistics.reflex());
    assert_eq!(statistics.status(), Some(MoveStatus::Success), "{who}: the motion was finished, not broken off");
    assert_eq!(run.outcome.allocations, Some(0), "{who}");
    assert!(run.tracking().iter().all(|rms| *rms < soft), "{who}: tracking {:?}", run.tracking());
}

#[test]
fn franka_sim_with_every_limit_enforced_takes_a_whole_excitation() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(python) = plumbline_testkit::peers::interpreter_with(&["franka-sim==1.1.7"]) else { return };
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/testkit/peers/serve_franka_sim.py"));
    let address = address(1);
    command.arg(&address).arg(fr3_mjcf());
    let server = Server::start(command, &address, "franka-sim.log");
    let run = drive_with_retries(&settings(&server), &plan(0.5), Duration::from_secs(40), 8);
    assert_ended_in_order(&run, "franka-sim 1.1.7", 0.05);
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn franky_sim_takes_a_whole_excitation() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(python) = plumbline_testkit::peers::interpreter_with(&["franky-sim==1.0.4"]) else { return };
    let mut command = Command::new(Path::new(&python).with_file_name("franky-sim"));
    let address = address(2);
    command.args(["--simulator", "mujoco", "--hostname", &address]);
    let server = Server::start(command, &address, "franky-sim.log");
    let run = drive_with_retries(&settings(&server), &plan(0.5), Duration::from_secs(40), 8);
    assert_ended_in_order(&run, "franky-sim 1.0.4", 0.15);
}

/// What a server written in Python, or a machine with other work, does to a job: stalls. Everything else that ends one is a finding.
const STALLS: [&str; 3] = ["communication_constraints_violation", "no state came", "states were lost"];

/// The shipped job for an FR3, on a server that serves tighter limits than the robot file: it plans under those and is not stopped by them.
#[test]
fn a_job_on_franka_sim_keeps_the_limits_that_it_serves() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let Some(python) = plumbline_testkit::peers::interpreter_with(&["franka-sim==1.1.7"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    for attempt in 1..=6 {
        let mut command = Command::new(&python);
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/testkit/peers/serve_franka_sim.py"));
        let address = address(10 + attempt);
        command.arg(&address).arg(fr3_mjcf());
        let server = Server::start(command, &address, "franka-sim-job.log");
        let out = folder.path().join(attempt.to_string());
        let mut job = plumbline();
        job.args(["run", "--verbose", "config/fr3.toml", "--out"]).arg(&out);
        for set in [
            format!("serve.id=franka-sim-job-{}", std::process::id()),
            format!("backend.franka.address={address}"),
            "backend.franka.state-timeout=1 s".into(),
            "safety.max-lost=19".into(),
            "safety.tracking-error=0.3 rad".into(),
            // Its own controller overshoots, and it watches the measured speed, too.
            "limits.speed=0.5".into(),
            "limits.acceleration=0.3".into(),
            "excitation.trajectories=1".into(),
            "excitation.periods=1".into(),
            "excitation.lead-in=0".into(),
            "excitation.starts=2".into(),
            "excitation.rounds=0".into(),
            "validation.trajectories=1".into(),
            "diagnosis.enabled=false".into(),
            "realtime.lock-memory=false".into(),
        ] {
            job.args(["--set", &set]);
        }
        let done = job.output().unwrap();
        drop(server);
        let message = String::from_utf8_lossy(&done.stderr).to_string() + &String::from_utf8_lossy(&done.stdout);
        assert!(!message.contains("guard: ") && !message.contains("while braking"), "{message}");
        let plan = plumbline::store::load_plan(&out.join("plans/identify-upright.toml"))
            .unwrap_or_else(|_| panic!("{message}"));
        // Joint 6 ends at 0.5409 rad there, at 0.4398 rad in the robot file.
        assert_eq!(plan.constraints.q_min[5], 0.54092, "{message}");
        // The motion was driven to its end. What follows ends the job by name: this server measures no torque, its `tau_J` is 0 throughout.
        if message.contains("identify-upright has ended") {
            assert!(message.contains("expected a torque that varies"), "{message}");
            return;
        }
        assert!(STALLS.iter().any(|stall| message.contains(stall)), "{message}");
        eprintln!("attempt {attempt} met a stall: {}", message.lines().last().unwrap_or(""));
    }
    panic!("every attempt met a stall");
}
