//! The whole daemon with a live inclinometer that is SIMULATED, over a Unix socket that stands for the bus: no CAN, no kernel's filter, no
//! driver. What the kernel's own CAN does is `hil/inclinometer/vm.sh`'s business. The arm is the simulated Panda, upright whatever the
//! base does: what is shown is what the daemon makes of the sensor.

use nalgebra::Vector3;
use plumbline::store::ModelFile;
use plumbline_core::{Phase, Validity};
use plumbline_ipc::{FeedForwardClient, FeedForwardMessage, FeedForwardSettings, Gravity, Progress, RobotId};
use plumbline_model::term::Sample;
use plumbline_model::{Mounting, Robot, angle_between};
use plumbline_testkit::inclinometer::Device;
use plumbline_testkit::job::*;
use plumbline_testkit::turns::Turns;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const NODE: u8 = 10;
const MODEL: &str = "config/models/panda-paper-table3.toml";

/// Each test has a loop at 1 kHz: no more at a time than a small machine has processors.
static LOOPS: Turns = Turns::new(2);

/// A device and the socket that plays its bus.
struct SimulatedBus {
    path: String,
    device: Arc<Mutex<Device>>,
    start: Instant,
    end: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl SimulatedBus {
    fn new(place: &Place, tilt: [f64; 2]) -> SimulatedBus {
        let path = place.path().join("bus").display().to_string();
        let socket =
            rustix::net::socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None).unwrap();
        rustix::net::bind(&socket, &SocketAddrUnix::new(path.as_str()).unwrap()).unwrap();
        rustix::net::listen(&socket, 4).unwrap();
        let listener = UnixListener::from(socket);
        listener.set_nonblocking(true).unwrap();
        let device = Arc::new(Mutex::new(Device::new(NODE, tilt, 0.02, 1, 0)));
        let (start, end) = (Instant::now(), Arc::new(AtomicBool::new(false)));
        let (of_thread, ends) = (Arc::clone(&device), Arc::clone(&end));
        let thread = std::thread::spawn(move || {
            while !ends.load(Ordering::Relaxed) {
                match listener.accept() {
                    Ok((stream, _)) => serve(&stream, &of_thread, start, &ends),
                    Err(_) => std::thread::sleep(Duration::from_millis(5)),
                }
            }
        });
        SimulatedBus { path, device, start, end, thread: Some(thread) }
    }

    fn device(&self, what: impl FnOnce(&mut Device, u64)) {
        what(&mut self.device.lock().unwrap(), ns(self.start));
    }

    fn tilt(&self, slopes: [f64; 2], seconds: f64) {
        self.device(|device, now| device.tilt(now, slopes, seconds));
    }
}

impl Drop for SimulatedBus {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn ns(since: Instant) -> u64 {
    u64::try_from(since.elapsed().as_nanos()).unwrap()
}

/// One connection: a packet is a `struct can_frame`, written out here by hand.
fn serve(mut stream: &UnixStream, device: &Mutex<Device>, start: Instant, end: &AtomicBool) {
    stream.set_nonblocking(false).unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let mut frame = [0; 16];
    while !end.load(Ordering::Relaxed) {
        let heard = match stream.read(&mut frame) {
            Ok(16) => Some((u32::from_ne_bytes(frame[..4].try_into().unwrap()), frame[4])),
            Ok(_) => return,
            Err(_) => None,
        };
        let mut device = device.lock().unwrap();
        let now = ns(start);
        if let Some((id, length)) = heard {
            device.receive(now, u16::try_from(id).unwrap(), &frame[8..8 + usize::from(length)]);
        }
        device.tick(now);
        while let Some((id, data)) = device.transmit() {
            let mut frame = [0; 16];
            frame[..4].copy_from_slice(&u32::from(id).to_ne_bytes());
            frame[4] = u8::try_from(data.len()).unwrap();
            frame[8..8 + data.len()].copy_from_slice(&data);
            if stream.write_all(&frame).is_err() {
                return;
            }
        }
    }
}

fn job(place: &Place, subcommand: &str, bus: &SimulatedBus, sets: &[&str]) -> std::process::Command {
    let mut command = plumbline();
    command.args([subcommand, "config/daemon-inclinometer.toml", "--out"]).arg(place.out());
    command.args((subcommand == "run").then_some("--verbose"));
    let own = [format!("serve.id={}", place.id), format!("inclinometer.interface=simulated:{}", bus.path)];
    // A test machine is busy: what it does to the listener is not the matter here.
    let all = ["safety.max-lost=1000", "inclinometer.heartbeat=1 s", "inclinometer.rate=10 Hz"];
    for set in own.iter().map(String::as_str).chain(all).chain(SHORT).chain(sets.iter().copied()) {
        command.arg("--set").arg(set);
    }
    command
}

/// A daemon that serves the paper's model.
fn daemon(place: &Place, bus: &SimulatedBus, sets: &[&str]) -> Running {
    let mut command = job(place, "daemon", bus, sets);
    command.args(["--model", MODEL]);
    Running::start(command)
}

fn gravity(place: &Place) -> Option<Gravity> {
    place.status()?.gravity
}

/// Waits until the daemon's word of gravity is so.
#[track_caller]
fn becomes(place: &Place, what: &str, is: impl Fn(&Gravity) -> bool) -> Gravity {
    wait_for(what, || gravity(place).filter(&is))
}

fn values(place: &Place) -> FeedForwardClient {
    let id = RobotId::parse("test", "id", &place.id).unwrap();
    FeedForwardClient::connect(&id, FeedForwardSettings::default(), TIMEOUT).unwrap()
}

fn latest(client: &mut FeedForwardClient) -> FeedForwardMessage {
    wait_for("a value", || client.latest().unwrap().map(|latest| latest.message))
}

#[track_caller]
fn settles(client: &mut FeedForwardClient, what: &str, is: impl Fn(&FeedForwardMessage) -> bool) -> FeedForwardMessage {
    wait_for(what, || Some(latest(client)).filter(&is))
}

fn tilt_of(message: &FeedForwardMessage) -> f64 {
    angle_between(&Vector3::from(message.gravity), &Mounting::UPRIGHT.gravity()).to_degrees()
}

#[test]
fn a_tilt_turns_the_models_gravity_between_two_cycles_at_a_bounded_rate() {
    let _turn = LOOPS.take();
    let place = Place::new("tilt");
    let bus = SimulatedBus::new(&place, [1.0, 0.0]);
    let daemon = daemon(&place, &bus, &[]);
    becomes(&place, "the measured direction", |gravity| gravity.source == "measured" && gravity.refused.is_none());
    let mut client = values(&place);
    settles(&mut client, "the model at 1 deg", |message| message.model != 0 && (tilt_of(message) - 1.0).abs() < 0.15);

    // From 1 to 4 deg at once: the model follows at 1 deg/s, in steps of at most 0.2 deg.
    bus.tilt([4.0, 0.0], 0.5);
    let mut seen = vec![latest(&mut client)];
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(60) && tilt_of(seen.last().unwrap()) < 3.8 {
        let now = latest(&mut client);
        if now.sequence != seen.last().unwrap().sequence {
            seen.push(now);
        }
        std::thread::sleep(Duration::from_micros(100));
    }
    let file = ModelFile::load(Path::new(MODEL), |robot| Ok(Robot::load(robot, None)?.chain)).unwrap();
    let (mut steps, mut between_two_cycles) = (0, 0);
    for pair in seen.windows(2) {
        let [before, after] = [&pair[0], &pair[1]].map(|message| Vector3::from(message.gravity));
        let by = angle_between(&before, &after).to_degrees();
        let seconds = (pair[1].stamp_ns - pair[0].stamp_ns) as f64 * 1e-9;
        // Two looks that lie far apart may have several steps between them.
        assert!(by <= 0.2 + 1e-6 + 2.0 * seconds, "{by} deg within {seconds} s");
        if by > 0.0 {
            steps += 1;
            between_two_cycles += usize::from(pair[1].sequence == pair[0].sequence + 1);
        }
    }
    assert!(steps >= 10 && between_two_cycles >= 1, "{steps} steps, {between_two_cycles} between two values in a row");
    let seconds = (seen.last().unwrap().stamp_ns - seen[0].stamp_ns) as f64 * 1e-9;
    let turned = tilt_of(seen.last().unwrap()) - tilt_of(&seen[0]);
    assert!(turned <= 1.05 * seconds + 0.2, "{turned} deg in {seconds} s");
    // Every torque is the model's own for the gravity that stands beside it, unless the message names a hand-over: the first model's takes some
    // cycles, a step of the gravity none.
    let valid: Vec<_> = seen.iter().filter(|message| message.validity == Validity::Valid as u32).collect();
    assert!(2 * valid.len() > seen.len(), "{} of {} values are the model's own", valid.len(), seen.len());
    for message in valid {
        let sample = Sample { q: message.q_d, dq: message.dq_d, ..Sample::default() };
        let torque = file.model.evaluator(&Vector3::from(message.gravity)).torque(&sample).0;
        for (j, (served, own)) in message.tau_ff.iter().zip(torque).enumerate() {
            assert!((served - own).abs() < 1e-9, "joint {}, value {}: {served} Nm, {own} Nm", j + 1, message.sequence);
        }
    }
    let status = becomes(&place, "4 deg", |gravity| (gravity.furthest.to_degrees() - 4.0).abs() < 0.3);
    assert!(
        status.simulated
            && status.hand_overs >= 10
            && status.losses == 0
            && !status.events.iter().any(|event| event.contains("is lost")),
        "{status:?}"
    );

    // Beyond the tolerance nothing is served; back within it, the model is.
    bus.tilt([10.0, 0.0], 3.0);
    let status = becomes(&place, "the refusal", |gravity| gravity.refused.is_some());
    // Which side is off can't be said while the torques at rest are as vague as the tilt is large.
    let refused = status.refused.unwrap();
    assert!(refused.contains("the inclinometer") && refused.contains("5.00 deg are allowed"), "{refused}");
    settles(&mut client, "no model", |message| message.model == 0 && message.tau_ff == [0.0; 8]);
    bus.tilt([1.0, 0.0], 3.0);
    becomes(&place, "the model again", |gravity| gravity.refused.is_none());
    settles(&mut client, "its torque again", |message| message.model != 0);
    place.quit(daemon);
}

/// A base at 2 deg whose sensor is unplugged, and plugged in again.
fn loss(test: &str, on_loss: &str, while_gone: impl Fn(&Place, &mut FeedForwardClient)) {
    let _turn = LOOPS.take();
    let place = Place::new(test);
    let bus = SimulatedBus::new(&place, [2.0, 0.0]);
    let daemon = daemon(&place, &bus, &[&format!("inclinometer.on-loss={on_loss}")]);
    becomes(&place, "the measured direction", |gravity| gravity.source == "measured" && gravity.refused.is_none());
    let mut client = values(&place);
    settles(&mut client, "the model at 2 deg", |message| message.model != 0 && (tilt_of(message) - 2.0).abs() < 0.15);
    bus.device(|device, _| device.faults.unplugged = true);
    let status = becomes(&place, "the loss", |gravity| gravity.losses == 1);
    let word = format!("by inclinometer.on-loss = \"{on_loss}\"");
    assert!(
        status.events.iter().any(|event| event.contains("is lost") && event.contains(&word)),
        "{:?}",
        status.events
    );
    assert_eq!(status.on_loss.as_deref(), Some(on_loss));
    while_gone(&place, &mut client);
    bus.device(|device, _| device.faults.unplugged = false);
    let status = becomes(&place, "its return", |gravity| gravity.source == "measured" && gravity.refused.is_none());
    assert!(status.lost_s > 0.0 && status.events.iter().any(|event| event.contains("is back after")), "{status:?}");
    settles(&mut client, "the measured 2 deg again", |message| {
        message.model != 0 && (tilt_of(message) - 2.0).abs() < 0.15
    });
    let done = place.quit(daemon);
    assert!(done.err.contains("is lost") && done.err.contains("inclinometer is simulated"), "{}", done.output());
}

#[test]
fn a_loss_with_refuse_withdraws_the_model() {
    loss("loss-refuse", "refuse", |place, client| {
        settles(client, "no model", |message| message.model == 0);
        let refused = becomes(place, "the refusal", |gravity| gravity.refused.is_some()).refused.unwrap();
        assert!(refused.contains("inclinometer.on-loss = \"refuse\""), "{refused}");
        let start = place.command("start").expect_code(1);
        assert!(start.err.contains("on-loss"), "{}", start.output());
    });
}

#[test]
fn a_loss_in_mid_motion_stops_the_arm_and_the_recording_says_why() {
    let _turn = LOOPS.take();
    let place = Place::new("loss-moving");
    let bus = SimulatedBus::new(&place, [2.0, 0.0]);
    let daemon = daemon(&place, &bus, &["inclinometer.on-loss=refuse", "recorder.span=2 s"]);
    becomes(&place, "the measured direction", |gravity| gravity.source == "measured" && gravity.refused.is_none());
    place.command("start").expect_code(0);
    wait_for("the motion", || place.status().filter(|now| now.phase == Phase::Excite));
    bus.device(|device, _| device.faults.unplugged = true);
    wait_for("the stop", || {
        place.status().filter(|now| now.progress == Progress::Stopped && now.phase == Phase::Stopped)
    });
    let done = place.quit(daemon);
    assert!(done.err.contains("the arm is being stopped: ") && done.err.contains("inclinometer"), "{}", done.output());
    let dir = place.out().join("flight");
    let files: Vec<_> = std::fs::read_dir(&dir).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(files.len() == 1 && files[0].to_string_lossy().ends_with("-mounting.mcap"), "{files:?}");
    let analysis = Done::of(plumbline().arg("postmortem").arg(&files[0])).expect_code(0);
    assert!(analysis.out.contains("because the mounting check failed"), "{}", analysis.output());
    assert!(analysis.out.contains("the inclinometer is lost: "), "{}", analysis.output());
}

#[test]
fn a_loss_with_hold_keeps_the_direction_measured_last() {
    loss("loss-hold", "hold", |place, client| {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(3) {
            let message = latest(client);
            assert!(message.model != 0 && (tilt_of(&message) - 2.0).abs() < 0.2, "{message:?}");
        }
        assert_eq!(gravity(place).unwrap().source, "held");
    });
}

#[test]
fn a_loss_with_declared_goes_back_to_the_declared_direction_no_faster_than_allowed() {
    loss("loss-declared", "declared", |place, client| {
        let first = latest(client);
        let last = settles(client, "the declared direction", |message| tilt_of(message) < 0.1);
        let seconds = (last.stamp_ns - first.stamp_ns) as f64 * 1e-9;
        assert!(tilt_of(&first) - tilt_of(&last) <= 1.05 * seconds + 0.2, "{seconds} s");
        assert!(last.model != 0);
        assert_eq!(gravity(place).unwrap().source, "declared");
    });
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_runs_report_says_what_the_inclinometer_did() {
    let _turn = LOOPS.take();
    let place = Place::new("report");
    let bus = SimulatedBus::new(&place, [1.5, -0.5]);
    let sets = ["inclinometer.on-loss=hold", "safety.on-estimator-loss=finish"];
    let mut running = Some(Running::start(job(&place, "run", &bus, &sets)));
    let mut comes = |what: &str, is: fn(&Gravity) -> bool| {
        wait_for(what, || {
            if !running.as_mut().unwrap().runs() {
                panic!("{what} did not come before the end: {}", running.take().unwrap().end().output());
            }
            gravity(&place).filter(is)
        })
    };
    comes("a motion", |gravity| !gravity.motions.is_empty());
    bus.device(|device, _| device.faults.unplugged = true);
    comes("the loss", |gravity| gravity.losses == 1);
    bus.device(|device, _| device.faults.unplugged = false);
    comes("its return", |gravity| gravity.source == "measured");
    let done = running.unwrap().end().expect_code(0);

    let report = place.report().gravity.unwrap();
    let (status, tilt) = (&report.status, 1.5f64.hypot(0.5));
    assert_eq!((status.simulated, status.source.as_str(), status.losses), (true, "measured", 1), "{report:?}");
    assert_eq!(status.on_loss.as_deref(), Some("hold"));
    assert!((report.tilt().unwrap().to_degrees() - tilt).abs() < 0.1, "{report:?}");
    assert!((0.1..1.0).contains(&status.uncertainty.unwrap().to_degrees()) && status.lost_s > 0.0, "{report:?}");
    let [lost, back] = &status.events[..] else { panic!("{report:?}") };
    assert!(lost.contains("is lost") && back.contains("is back"), "{report:?}");
    let first = &report.runs[0];
    assert!(first.source() == "measured" && (first.tilt.to_degrees() - tilt).abs() < 0.1, "{first:?}");
    assert!(done.out.contains("gravity: a SIMULATED inclinometer measured"), "{}", done.output());
    let html = std::fs::read_to_string(place.out().join("report.html")).unwrap();
    assert!(html.contains("Direction of gravity") && html.contains("a SIMULATED inclinometer"));
}

#[test]
fn a_simulated_bus_goes_with_a_simulated_arm_alone() {
    let place = Place::new("real-arm");
    let job = place.path().join("job.toml");
    let text = std::fs::read_to_string("config/panda.toml").unwrap();
    std::fs::write(
        &job,
        text + "\n[inclinometer]\ninterface = \"simulated:/tmp/bus\"\nnode = 10\nx = \"x\"\nz = \"z\"\n",
    )
    .unwrap();
    let done = Done::of(plumbline().arg("daemon").arg(&job).arg("--out").arg(place.out())).expect_code(2);
    for part in ["job.toml", "inclinometer.interface", "simulated:/tmp/bus", "a simulated arm alone"] {
        assert!(done.err.contains(part), "{}", done.output());
    }
}
