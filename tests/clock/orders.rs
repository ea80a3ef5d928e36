//! Who may drive an arm, and what becomes of orders at the wrong moment: locks, owners of files, `resume` while braking, ages after a suspend.

use plumbline_core::Phase;
use plumbline_franka::wire::Protocol;
use plumbline_ipc::{Client, Proposal, Request, Response, RobotId};
use plumbline_testkit::emulator;
use plumbline_testkit::job::*;
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Some user who is not root.
const SOMEBODY: u32 = 4242;

fn is_root() -> bool {
    let root = rustix::process::geteuid().is_root();
    if !root {
        eprintln!("SKIPPED: files can be given to others by root alone");
    }
    root
}

#[test]
fn resume_while_braking_is_refused_and_works_at_rest() {
    let place = Place::new("resume");
    let daemon = place.daemon(&short(&LONG_ON_CLOCK));
    place.command("start").expect_code(0);
    place.await_motion();
    std::thread::sleep(Duration::from_millis(600));
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    let mut ask = |request: &Request| client.send(request, TIMEOUT).unwrap();
    assert_eq!(ask(&Request::Stop {}), Response::Accepted {});
    let mut refused = 0;
    let resumed = wait_for("the rest", || match ask(&Request::Resume {}) {
        Response::Refused { reason } => {
            assert!(reason.contains("is being braked"), "{reason}");
            refused += 1;
            None
        }
        other => Some(other),
    });
    assert_eq!(resumed, Response::Accepted {});
    assert!(refused > 0, "the arm was at rest at once");
    // It has had an effect: the loop holds, and waits for nothing any more.
    wait_for("the hold", || place.status().filter(|now| now.phase == Phase::Hold));
    let again = place.command("resume").expect_code(1);
    assert!(again.err.contains("nothing waits"), "{}", again.output());
    let done = place.quit(daemon);
    // Every order that was carried out is logged with its sender: this process, and the ones of the command line.
    let user = rustix::process::getuid().as_raw();
    for order in ["stop", "resume"] {
        let line =
            done.err.lines().find(|line| line.contains(&format!("`{order}` from process {} (", std::process::id())));
        let line = line.unwrap_or_else(|| panic!("no sender of `{order}`: {}", done.output()));
        assert!(line.contains(&format!(") of user {user}")), "{line}");
    }
    for order in ["start", "quit"] {
        let line = done.err.lines().find(|line| line.contains(&format!("`{order}` from process ")));
        assert!(line.is_some_and(|line| line.contains("(plumbline) of user")), "{}", done.output());
    }
    assert!(!done.err.contains("`status`"), "{}", done.output());
}

#[test]
fn an_order_with_a_model_is_logged_by_its_own_name() {
    let place = Place::new("orders-model");
    let daemon = place.daemon(&short(&LONG_ON_CLOCK));
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut client = Client::connect(&robot, TIMEOUT).unwrap();
    let toml = std::fs::read_to_string("config/models/panda-paper-table3.toml").unwrap();
    // One identity each: a proposed model is held until somebody adopts it.
    let proposed = Request::ProposeModel { toml: format!("{toml}\n# another\n"), proposal: Proposal::default() };
    for (request, name) in [(Request::OfferModel { toml }, "offer-model"), (proposed, "propose-model")] {
        let answer = client.send(&request, TIMEOUT).unwrap();
        assert!(
            matches!(answer, Response::ModelAccepted { .. } | Response::ModelHeld { .. }),
            "{name} was answered with {answer:?}"
        );
    }
    let done = place.quit(daemon);
    for name in ["offer-model", "propose-model"] {
        let line = format!("`{name}` from process {} (", std::process::id());
        assert_eq!(done.err.matches(&line).count(), 1, "{name}: {}", done.output());
    }
}

#[test]
fn a_held_lock_is_a_failed_job_and_no_bad_input() {
    let place = Place::new("held");
    let daemon = place.daemon(&short(&LONG_ON_CLOCK));
    // 2 would keep the service down after the lock has passed (RestartPreventExitStatus).
    let second = Done::of(place.job("daemon", &short(&LONG_ON_CLOCK))).expect_code(1);
    assert!(second.err.contains(&format!("process {}", daemon.pid())), "{}", second.output());
    place.quit(daemon);
    for unit in ["systemd/plumbline.service", "systemd/plumbline-estimator.service", "systemd/plumbline-relay@.service"]
    {
        let unit = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(unit)).unwrap();
        assert!(unit.contains("Restart=on-failure\n") && unit.contains("RestartPreventExitStatus=2\n"), "{unit}");
    }
}

#[test]
fn one_arm_has_one_daemon_whatever_folder_and_name_it_has() {
    let address = emulator::address();
    let _arm = emulator::Emulator::start(emulator::Settings::new(address, Protocol::V5)).unwrap();
    let at = format!("backend.franka.address={address}");
    let sets = short(&["excitation.trajectories=1", "validation.mountings=[\"wall\"]", &at]);
    let places = [Place::new("arm-1"), Place::new("arm-2")];
    let daemon = |place: &Place| {
        let mut command = plumbline();
        command.args(["daemon", "config/panda-emulator-wall.toml", "--out"]).arg(place.out());
        command.env("PLUMBLINE_RUNTIME_DIR", place.path().join("run"));
        command.arg("--set").arg(format!("serve.id={}", place.id));
        for set in &sets {
            command.arg("--set").arg(set);
        }
        command
    };
    let status = |place: &Place| {
        let mut command = plumbline();
        command.args(["command", "status", "--robot", &place.id]);
        Done::of(command.env("PLUMBLINE_RUNTIME_DIR", place.path().join("run")))
    };
    let first = Running::start(daemon(&places[0]));
    wait_for("the first daemon", || (status(&places[0]).code == Some(0)).then_some(()));
    let second = Done::of(daemon(&places[1])).expect_code(1);
    let holder = format!("process {} of user {}", first.pid(), rustix::process::geteuid().as_raw());
    assert!(second.err.contains(&holder) && second.err.contains(&address.to_string()), "{}", second.output());
    signal(first.pid(), "TERM");
    first.end();
}

/// A job of root's own, in a folder that is closed to others.
fn job_of_root(place: &Place, sets: &[&str]) -> Command {
    let file = place.path().join("job.toml");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    if !file.exists() {
        std::fs::copy(root.join(WALL), &file).unwrap();
        std::fs::set_permissions(&file, PermissionsExt::from_mode(0o644)).unwrap();
    }
    let mut command = plumbline();
    command.args(["daemon", "--root-owned"]).arg(file).arg("--out").arg(place.out());
    command.arg("--set").arg(format!("serve.id={}", place.id));
    command.arg("--set").arg(format!("backend.arm={}", root.join("config/arms/sim-panda.toml").display()));
    for set in short(&["excitation.trajectories=1"]).iter().chain(sets) {
        command.arg("--set").arg(set);
    }
    command
}

#[test]
fn a_plan_that_somebody_else_can_change_moves_no_arm_of_a_service() {
    if !is_root() {
        return;
    }
    // As the daemon has kept it, and as the job names it.
    let kept = Place::new("plan-kept");
    let plan = kept.out().join("plans/identify-wall.toml");
    let text = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("config/plans/panda-wall.toml")).unwrap();
    std::fs::create_dir_all(plan.parent().unwrap()).unwrap();
    let named = Place::new("plan-named");
    let own = named.path().join("own.toml");
    for (place, plan, set) in [(&kept, &plan, None), (&named, &own, Some(format!("excitation.plan={}", own.display())))]
    {
        let sets: Vec<&str> = set.as_deref().into_iter().collect();
        std::fs::write(plan, &text).unwrap();
        chown(plan, Some(SOMEBODY), None).unwrap();
        let refused = Done::of(job_of_root(place, &sets)).expect_code(2);
        assert!(refused.err.contains(plan.to_str().unwrap()), "{}", refused.output());
        assert!(refused.err.contains(&format!("belongs to user {SOMEBODY}")), "{}", refused.output());
        chown(plan, Some(0), None).unwrap();
        std::fs::set_permissions(plan, PermissionsExt::from_mode(0o646)).unwrap();
        let refused = Done::of(job_of_root(place, &sets)).expect_code(2);
        assert!(
            refused.err.contains(plan.to_str().unwrap()) && refused.err.contains("mode 646"),
            "{}",
            refused.output()
        );
        std::fs::set_permissions(plan, PermissionsExt::from_mode(0o644)).unwrap();
    }
    // Root's own is taken.
    let daemon = Running::start(job_of_root(&kept, &[]));
    wait_for("the daemon", || kept.status());
    kept.quit(daemon);
}

#[test]
fn an_upgrade_gives_no_file_to_root_that_the_daemon_has_refused() {
    if !is_root() {
        return;
    }
    let place = tempfile::tempdir().unwrap();
    let path = |name: &str| place.path().join(name);
    for folder in ["etc/plumbline", "lib", "bin"] {
        std::fs::create_dir_all(path(folder)).unwrap();
    }
    std::fs::write(
        path("etc/passwd"),
        "root:x:0:0::/root:/bin/sh\nplumbline:x:998:998::/var/lib/plumbline:/bin/false\n",
    )
    .unwrap();
    std::fs::write(path("etc/group"), "root:x:0:\nplumbline:x:998:\n").unwrap();
    std::fs::write(path("etc/nsswitch.conf"), "passwd: files\ngroup: files\n").unwrap();
    for tool in ["systemd-sysusers", "systemd-tmpfiles"] {
        std::fs::write(path("bin").join(tool), "#!/bin/sh\n").unwrap();
        std::fs::set_permissions(path("bin").join(tool), PermissionsExt::from_mode(0o755)).unwrap();
    }
    // The shipped job after somebody was let at it, and a robot of one's own.
    for name in ["etc/plumbline/daemon.toml", "etc/plumbline/arm.toml"] {
        std::fs::write(path(name), "").unwrap();
        chown(path(name), Some(SOMEBODY), Some(SOMEBODY)).unwrap();
        std::fs::set_permissions(path(name), PermissionsExt::from_mode(0o666)).unwrap();
    }
    let script = "mount --bind \"$0/etc\" /etc && mount --bind \"$0/lib\" /var/lib && mount -t tmpfs tmpfs /run && PATH=\"$0/bin:$PATH\" sh \"$1\" configure";
    let upgrade = || {
        let mut command = Command::new("unshare");
        command.args(["--mount", "sh", "-c", script]).arg(place.path());
        Done::of(command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("systemd/deb/postinst")).stdin(Stdio::null()))
    };
    upgrade().expect_code(0);
    for name in ["etc/plumbline/daemon.toml", "etc/plumbline/arm.toml"] {
        let found = std::fs::metadata(path(name)).unwrap();
        assert_eq!((found.uid(), found.mode() & 0o777), (SOMEBODY, 0o666), "{name}");
    }
    assert_eq!(std::fs::metadata(path("lib/plumbline")).unwrap().uid(), 998);
    // Where the folder was taken away it is made anew, root's.
    std::fs::remove_dir_all(path("etc/plumbline")).unwrap();
    upgrade().expect_code(0);
    let made = std::fs::metadata(path("etc/plumbline")).unwrap();
    assert_eq!((made.uid(), made.mode() & 0o777), (0, 0o755));
}

/// A time namespace whose CLOCK_BOOTTIME is ahead of CLOCK_MONOTONIC is what a client sees after a suspend that has come between a value and its
/// reader. It does not see that it is in one: where the identity of the boot is hidden, a clock is taken for the own one.
#[test]
fn a_torque_from_before_a_suspend_is_stale() {
    let suspended = || {
        let mut command = Command::new("unshare");
        command.args(["--map-root-user", "--mount", "--time", "--boottime", "10", "--fork", "--", "sh", "-c"]);
        command.args(["mount -t tmpfs tmpfs /proc/sys/kernel/random && exec \"$@\"", "sh"]);
        command.current_dir(env!("CARGO_MANIFEST_DIR"));
        command
    };
    if !suspended().arg("true").output().is_ok_and(|tried| tried.status.success()) {
        return eprintln!("SKIPPED: this machine lets nobody make a time namespace");
    }
    let place = Place::new("suspend");
    let daemon = Running::start(place.job("daemon", &short(&LONG_ON_CLOCK)));
    wait_for("the daemon", || place.status().filter(|now| now.cycles > 100));
    let torque = ["torque", "--robot", &place.id, "--count", "1"];
    let line = Done::of(suspended().arg(program()).args(torque)).expect_code(0).out;
    let age: f64 = line.split("age").nth(1).and_then(|rest| rest.split_whitespace().next()?.parse().ok()).expect(&line);
    assert!(line.contains("STALE") && age >= 10_000.0, "{line}");
    let line = Done::of(plumbline().args(torque)).expect_code(0).out;
    let age: f64 = line.split("age").nth(1).and_then(|rest| rest.split_whitespace().next()?.parse().ok()).expect(&line);
    assert!(age < 10_000.0, "{line}");
    place.quit(daemon);
}
